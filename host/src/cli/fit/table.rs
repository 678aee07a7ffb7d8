//! One measured table into lobes, and a microfacet term where that predicts better, wavelength by wavelength.

use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;

use super::{Findings, FitArgs, print, write_map};
use crate::error::{Error, Result};
use crate::figures::ErrorFigure;
use crate::fit::request::TableRequest;
use crate::fit::table::{self, Size, TableOptions, Take, WavelengthFit, judge};
use crate::progress::counted;
use crate::reflectance::MeasuredTable;
use serde_json::json;

/// Fits the table at `input`.
pub(super) fn fit(args: &FitArgs, input: &Path, seed: u64) -> Result<Findings> {
    if args.chunks.is_some() || args.mip {
        return Err(Error::input("--chunks and --mip are for sampled SBRDFs (.zarr)"));
    }
    if args.pool.is_some() || args.hold_out_poses.is_some() {
        return Err(Error::input("--pool and --hold-out-poses are for sampled SBRDFs (.zarr)"));
    }
    let TableRequest { method, residual, sizes, take } = args.request().of_table()?;
    let options = TableOptions {
        method,
        residual,
        hold_out_theta_deg: args.hold_out_theta_deg.clone(),
        random_starts: args.random_starts,
        seed,
        bound: args.bound(),
    };
    let measured = MeasuredTable::read(input).map_err(Error::format)?;
    let wavelengths_nm = match &args.wavelengths_nm[..] {
        [] => table::wavelengths_nm(&measured),
        named => named.to_vec(),
    };
    if args.output.is_some() && !matches!(wavelengths_nm.len(), 1 | 3) {
        return Err(table::no_colours(wavelengths_nm.len()));
    }
    if args.hold_out_each_pair {
        return judge_choice(&measured, &wavelengths_nm, &sizes, take, &options)
            .map_err(|error| error.at(input.display()));
    }
    let start = Instant::now();
    let fits = table::fit(&measured, &wavelengths_nm, &sizes, take, &options)
        .map_err(|error| error.at(input.display()))?;
    let seconds = start.elapsed().as_secs_f64();
    print(&described(&measured, &fits, &options, seconds)?)?;
    if let Some(output) = &args.output {
        let mut map = table::map(&fits, &options)?;
        map.attributes.extend(args.made.clone());
        write_map(&map, output, args.encoding())?;
    }
    let mut outcome = Findings { errors: table::figures(&fits, &options), ..Findings::default() };
    outcome.figures.insert("rows".into(), measured.rows.len().into());
    outcome.figures.insert("coefficients".into(), coefficients(&fits));
    outcome.figures.insert("fits".into(), fits.len().into());
    outcome.figures.insert("fit_seconds".into(), seconds.into());
    Ok(outcome)
}

/// Holds each pair of incidences out in turn and sets the choice beside every fixed size.
fn judge_choice(
    measured: &MeasuredTable,
    wavelengths_nm: &[f64],
    sizes: &[Size],
    take: Take,
    options: &TableOptions,
) -> Result<Findings> {
    if take != Take::Choose || !options.hold_out_theta_deg.is_empty() {
        let message = "--hold-out-each-pair judges the choice: use it with --lobes auto and without \
             --hold-out-theta-deg";
        return Err(Error::input(message));
    }
    let judged = judge::each_pair(measured, wavelengths_nm, sizes, options)?;
    let pairs = judge::incidences_deg(measured).len();
    let pairs = pairs * (pairs - 1) / 2;
    let mut text = format!(
        "{pairs} pairs of incidences, each held out in turn; means of the errors on them\n\n{:>8}  {:<20} \
         {:>12} {:>11}  {:>16}\n",
        "nm", "lobes", "held-out log", "relative", "auto as good in"
    );
    let mut outcome = Findings::default();
    for of in &judged {
        let size = of.size.map_or("auto".to_string(), |size| size.to_string());
        let share = of.size.map_or(String::new(), |_| format!("{:.0} %", 100.0 * of.choice_as_good));
        text += &format!(
            "{:>8}  {size:<20} {:>12.3} {:>11.3}  {share:>16}\n",
            of.wavelength_nm, of.log_rms, of.relative_l2
        );
        let over = format!("mean over {pairs} pairs of incidences held out");
        for (name, value) in [("held_out_log_rms", of.log_rms), ("held_out_relative_l2", of.relative_l2)] {
            let figure = ErrorFigure::new(name, value, "1", over.clone());
            outcome.errors.push(figure.with("size", size.as_str()).with("wavelength_nm", of.wavelength_nm));
        }
    }
    print(&text)?;
    Ok(outcome)
}

/// The comparison of all fits, the chosen ones marked, then the coefficients of those.
fn described(
    measured: &MeasuredTable,
    fits: &[WavelengthFit],
    options: &TableOptions,
    seconds: f64,
) -> Result<String> {
    let mut text = String::new();
    write_description(&mut text, measured, fits, options, seconds)
        .map_err(|error| Error::failure(error.to_string()).caused_by(error))?;
    Ok(text)
}

fn write_description(
    text: &mut String,
    measured: &MeasuredTable,
    fits: &[WavelengthFit],
    options: &TableOptions,
    seconds: f64,
) -> std::fmt::Result {
    let (method, residual) = (options.method.name(), options.residual.name());
    writeln!(
        text,
        "{}, {method}, {residual} residual: {} in {seconds:.1} s",
        counted(measured.rows.len() as u64, "row", "rows"),
        counted(fits.len() as u64, "fit", "fits")
    )?;
    let held_out = !options.hold_out_theta_deg.is_empty();
    write!(text, "\n{:>8}  {:<20} {:>12} {:>11}", "nm", "lobes", "train log", "relative")?;
    if held_out {
        write!(text, "  {:>12} {:>11}", "held-out log", "relative")?;
    }
    let starts = format!("cost / best of {}", options.random_starts);
    writeln!(text, "{}", if options.random_starts > 0 { format!("  {starts:>18}") } else { String::new() })?;
    for fit in fits {
        let errors = &fit.training;
        write!(
            text,
            "{:>8}  {:<20} {:>12.3} {:>11.3}",
            fit.wavelength_nm,
            format!("{}{}", fit.size, if fit.chosen { " *" } else { "" }),
            errors.log_rms,
            errors.relative_l2
        )?;
        if let Some(errors) = &fit.held_out {
            write!(text, "  {:>12.3} {:>11.3}", errors.log_rms, errors.relative_l2)?;
        }
        if let Some(ratio) = fit.start_ratio {
            write!(text, "  {ratio:>18.4}")?;
        }
        writeln!(text)?;
    }
    if let Some(thinned) = fits.iter().find_map(|fit| fit.thinned) {
        let worst = fits.iter().filter_map(|fit| fit.thinned).map(|thinned| thinned.loss).fold(0.0, f64::max);
        writeln!(
            text,
            "\nsearched with {} of the rows, then fitted to all: before that costs were up to {:.2} % higher",
            thinned.rows,
            100.0 * worst
        )?;
    }
    writeln!(
        text,
        "\n* taken\n\n{:>8} {:>10}  lobes: rho_s (Cx = Cy, Cz) n; ggx: f0 f90 alpha; ± standard deviation",
        "nm", "rho_d"
    )?;
    for fit in fits.iter().filter(|fit| fit.chosen) {
        let (model, of) = (&fit.model, fit.deviations.as_ref());
        write!(
            text,
            "{:>8} {:>10.5}{}",
            fit.wavelength_nm,
            model.diffuse,
            give_or_take(of.map(|of| of.rho_d), 5)
        )?;
        for (index, lobe) in model.lobes.iter().enumerate().filter(|(_, lobe)| lobe.amplitude > 0.0) {
            let c = lobe.c / lobe.reference;
            let retro = if c.x > 0.0 && c.z > 0.0 { " retro" } else { "" };
            let grazing = lobe.n_grazing.map_or(String::new(), |grazing| format!(" to {grazing:.1}"));
            let off = |place: usize, digits| give_or_take(of.map(|of| of.lobes[index][place]), digits);
            let (rho_s, x, z, n) = (off(0, 4), off(1, 4), off(2, 4), off(3, 1));
            write!(
                text,
                "  {:.4}{rho_s} ({:.4}{x}, {:.4}{z}) {:.1}{n}{grazing}{retro}",
                lobe.amplitude, c.x, c.z, lobe.n
            )?;
        }
        if let Some(coat) = model.coat {
            let off = |place: usize| give_or_take(of.and_then(|of| of.coat).map(|of| of[place]), 4);
            let (f0, f90, alpha) = (off(0), off(1), off(2));
            write!(text, "  ggx {:.4}{f0} {:.4}{f90} {:.4}{alpha}", coat.f0, coat.f90, coat.alpha)?;
        }
        if let Some(free) = &fit.free {
            let (log, relative) = (free.log_rms, free.relative_l2);
            write!(text, "  held to an albedo of 1 (train log {log:.3}, relative {relative:.3} without)")?;
        }
        writeln!(text)?;
    }
    Ok(())
}

/// A standard deviation behind its coefficient; empty where it is not known.
fn give_or_take(deviation: Option<f64>, digits: usize) -> String {
    match deviation {
        Some(deviation) if deviation.is_finite() => format!(" ±{:.digits$}", deviation.abs()),
        Some(_) => " (untold)".into(),
        None => String::new(),
    }
}

/// The coefficients of the fits that were taken, with their standard deviations; null where those are not
/// known.
fn coefficients(fits: &[WavelengthFit]) -> serde_json::Value {
    let of = |fit: &WavelengthFit| {
        let (model, sigma) = (&fit.model, fit.deviations.as_ref());
        let lobe = |(index, lobe): (usize, &crate::fit::model::ModelLobe)| {
            let (c, sigma) = (lobe.c / lobe.reference, sigma.map(|sigma| sigma.lobes[index]));
            let at = |place: usize| sigma.map(|sigma| sigma[place]);
            json!({ "rho_s": lobe.amplitude, "rho_s_sigma": at(0), "cx": c.x, "cx_sigma": at(1),
                "cz": c.z, "cz_sigma": at(2), "n": lobe.n, "n_sigma": at(3) })
        };
        let coat = model.coat.map(|coat| {
            let sigma = sigma.and_then(|sigma| sigma.coat);
            json!({ "f0": coat.f0, "f90": coat.f90, "alpha": coat.alpha, "sigma": sigma })
        });
        let lobes: Vec<_> = model.lobes.iter().enumerate().map(lobe).collect();
        json!({ "wavelength_nm": fit.wavelength_nm, "rho_d": model.diffuse,
            "rho_d_sigma": sigma.map(|sigma| sigma.rho_d), "lobes": lobes, "ggx": coat })
    };
    fits.iter().filter(|fit| fit.chosen).map(of).collect()
}
