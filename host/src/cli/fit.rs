//! `lobelia fit`: a sampled SBRDF into an SBRDF map, at once or in parts, or one measured table into lobes a wavelength.

mod parts;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, ValueEnum};

use crate::error::{Error, Result};
use crate::fit::chunks::{self, Part};
use crate::fit::figures::ErrorFigure;
use crate::fit::table::{self, TableOptions, WavelengthFit};
use crate::fit::{Diffuse, FitOptions, MOST_LOBES, Method, Residual, mip};
use crate::reflectance::{MeasuredTable, SbrdfMap};
use crate::sampled::SampledStore;

/// Lobes where the method cannot choose: what most materials need and no start fails on.
const AUTO_LOBES: usize = 2;

/// Arguments of `lobelia fit`.
#[derive(Debug, Clone, Args)]
pub(super) struct FitArgs {
    /// A sampled SBRDF (folder.zarr) or a measured table (FILE.brdf); with --merge optional: shards are then checked against it
    #[arg(required_unless_present = "merge")]
    pub(super) input: Option<PathBuf>,
    /// The SBRDF map to write (OpenEXR); required for a sampled SBRDF
    #[arg(short, long, value_name = "FILE.exr")]
    pub(super) output: Option<PathBuf>,
    /// Lobes beside the diffuse term: 0 to 4, or `auto`: for each texel of a sampled SBRDF as many as its samples support, at most 4 or
    /// N with `auto:N`, anisotropic only where that is better (separable method); 2 for tables and lm, 1 with the line search
    #[arg(long, default_value = "auto", value_name = "auto[:N]|N", value_parser = parse_lobes)]
    pub(super) lobes: Lobes,
    /// How the lobes' shapes are found
    #[arg(long, value_enum, default_value_t = MethodName::Auto)]
    pub(super) method: MethodName,
    /// The scale on which fitted and measured values are compared; `auto` is proportional for texels, balanced for tables
    #[arg(long, value_enum, default_value_t = ResidualName::Auto)]
    pub(super) residual: ResidualName,
    /// Let samples that lie far off the rest (dust, shadows, glints) weigh less or nothing, by Huber's and Tukey's weights; separable method. A
    /// highlight that very few poses meet may be lost with them
    #[arg(long)]
    pub(super) robust: bool,
    /// Isotropic lobes only: Cx = Cy, no direction of anisotropy. Tables are always fitted so
    #[arg(long)]
    pub(super) isotropic: bool,
    /// Lobes of its own for every channel of a sampled SBRDF, instead of shapes that the channels share; implies --isotropic
    #[arg(long)]
    pub(super) separate_channels: bool,
    /// Take the diffuse term from this percentile of a texel's samples instead of fitting it with the lobes
    #[arg(long, value_name = "PERCENT")]
    pub(super) diffuse_percentile: Option<f64>,
    /// Wavelengths of a table to fit, nm; three of them can be written as red, green and blue, the longest as red
    #[arg(long, value_delimiter = ',', value_name = "NM,…", default_values_t = [450.0, 550.0, 650.0])]
    pub(super) wavelengths_nm: Vec<f64>,
    /// Incidences of a table that the fit does not see, degrees; the errors there are reported
    #[arg(long, value_delimiter = ',', value_name = "DEG,…")]
    pub(super) hold_out_theta_deg: Vec<f64>,
    /// Compare the deterministic start on a table with the best of this many random ones
    #[arg(long, default_value_t = 0, value_name = "N")]
    pub(super) random_starts: usize,
    /// Fit part I of N of a sampled SBRDF and write it as a shard for --merge; a shard that is there already is left as it is
    #[arg(long, value_name = "I/N", conflicts_with = "merge")]
    pub(super) chunks: Option<Part>,
    /// Fit MIP levels as well, each to the samples averaged over its texels, down to one texel: FILE.mip1.exr, FILE.mip2.exr, …
    #[arg(long, conflicts_with_all = ["chunks", "merge"])]
    pub(super) mip: bool,
    /// Join the shards of all parts into the map: the same, byte for byte, as of one run
    #[arg(long, value_name = "SHARD.exr", num_args = 1..)]
    pub(super) merge: Vec<PathBuf>,
}

/// A number of lobes, or the choice left to the command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Lobes {
    /// What the samples support up to this many; [`AUTO_LOBES`] where the method cannot choose, or 1 where it cannot do more.
    Auto(usize),
    /// This many.
    Count(usize),
}

/// Names of methods on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum MethodName {
    /// Separable where the residual is linear in f, else Levenberg–Marquardt
    Auto,
    /// Variable projection: only the shapes are searched, the albedos of all channels follow in closed form
    Separable,
    /// The published line search over the exponent; one lobe
    LineSearch,
    /// Levenberg–Marquardt over shapes and albedos, on luminance, then colours
    Lm,
}

/// Names of residuals on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum ResidualName {
    /// Proportional for texels, balanced for tables
    Auto,
    /// f
    Linear,
    /// f cosθ_o
    CosineWeighted,
    /// f over the measured f plus 0.02 sr⁻¹
    Proportional,
    /// ln(1e-3 + f cosθ_o)
    Log,
    /// As log, but relative where a bright sample is exceeded
    Balanced,
    /// Cube root of (1e-3 + f cosθ_o)
    CubeRoot,
}

/// What the command found, for the report.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct FitOutcome {
    /// Errors.
    pub(super) errors: Vec<ErrorFigure>,
    /// Counts and rates.
    pub(super) figures: BTreeMap<String, serde_json::Value>,
}

fn parse_lobes(text: &str) -> std::result::Result<Lobes, String> {
    if text == "auto" {
        return Ok(Lobes::Auto(MOST_LOBES));
    }
    let (number, lobes): (_, fn(usize) -> Lobes) = match text.strip_prefix("auto:") {
        Some(most) => (most, Lobes::Auto),
        None => (text, Lobes::Count),
    };
    match number.parse() {
        Ok(count) if count <= MOST_LOBES => Ok(lobes(count)),
        _ => Err(format!("must be `auto`, `auto:N` or N, with N from 0 to {MOST_LOBES}")),
    }
}

impl FitArgs {
    fn method(&self, residual: Residual) -> Method {
        match self.method {
            MethodName::LineSearch => Method::LineSearch,
            MethodName::Separable => Method::Separable,
            MethodName::Auto if residual.is_linear() => Method::Separable,
            MethodName::Auto | MethodName::Lm => Method::Lm,
        }
    }

    fn lobes(&self) -> usize {
        match (self.lobes, self.method) {
            (Lobes::Count(count), _) => count,
            (Lobes::Auto(most), MethodName::LineSearch) => most.min(1),
            (Lobes::Auto(most), _) => most.min(AUTO_LOBES),
        }
    }

    /// The number of lobes of texels, and whether that is the most among which each texel chooses.
    fn texel_lobes(&self, method: Method) -> (usize, bool) {
        match self.lobes {
            Lobes::Auto(most) if method == Method::Separable => (most, true),
            _ => (self.lobes(), false),
        }
    }

    fn residual(&self, auto: Residual) -> Residual {
        match self.residual {
            ResidualName::Auto => auto,
            ResidualName::Linear => Residual::Linear,
            ResidualName::CosineWeighted => Residual::CosineWeighted,
            ResidualName::Proportional => Residual::Proportional,
            ResidualName::Log => Residual::Log,
            ResidualName::Balanced => Residual::Balanced,
            ResidualName::CubeRoot => Residual::CubeRoot,
        }
    }
}

/// Runs `lobelia fit` and notes errors, figures and time.
///
/// # Errors
/// As [`fit_input`].
pub(super) fn run(args: &FitArgs, context: &mut super::Context) -> Result<()> {
    args.input.iter().chain(&args.merge).for_each(|path| context.report.input(path));
    let seed = context.seed;
    let outcome = context.report.stage("fit", || fit_input(args, seed))?;
    context.report.errors.extend(outcome.errors);
    context.report.figures.extend(outcome.figures);
    Ok(())
}

/// Prints what was found to stdout and writes the map where one is asked for. `seed` is that of the random starts.
///
/// # Errors
/// Input errors for files and options that make no sense; failures of the disk.
fn fit_input(args: &FitArgs, seed: u64) -> Result<FitOutcome> {
    if let Some(output) = &args.output
        && output.extension().is_none_or(|extension| extension != "exr")
    {
        return Err(Error::input(format!("{}: an SBRDF map's name ends in .exr", output.display())));
    }
    if !args.merge.is_empty() {
        return parts::merge(args);
    }
    let Some(input) = &args.input else {
        return Err(Error::input("there is nothing to fit: name a sampled SBRDF or a measured table"));
    };
    match input.extension().and_then(|extension| extension.to_str()) {
        Some("zarr") => fit_sampled(args, input),
        Some("brdf") => fit_table(args, input, seed),
        _ => Err(Error::input(format!(
            "{}: `fit` reads a sampled SBRDF (.zarr) or a measured table (.brdf); the name's ending must say which",
            input.display()
        ))),
    }
}

/// The map to write, which a sampled SBRDF needs.
fn output(args: &FitArgs) -> Result<&Path> {
    let message = "a sampled SBRDF needs -o FILE.exr, the SBRDF map to write";
    args.output.as_deref().ok_or_else(|| Error::input(message))
}

fn fit_sampled(args: &FitArgs, input: &Path) -> Result<FitOutcome> {
    let output = output(args)?;
    if !args.hold_out_theta_deg.is_empty() || args.random_starts > 0 {
        return Err(Error::input("--hold-out-theta-deg and --random-starts are for measured tables (.brdf)"));
    }
    let residual = args.residual(FitOptions::default().residual);
    let method = args.method(residual);
    let (lobes, choose) = args.texel_lobes(method);
    let options = FitOptions {
        lobes,
        choose,
        method,
        isotropic: args.isotropic || args.separate_channels,
        separate_channels: args.separate_channels,
        robust: args.robust,
        diffuse: args.diffuse_percentile.map_or(Diffuse::Joint, Diffuse::Percentile),
        residual,
    };
    options.check()?;
    let store = SampledStore::open(input)?;
    if let Some(part) = args.chunks {
        return parts::fit(&store, &options, part, output);
    }
    let start = Instant::now();
    let map = chunks::fit_store(&store, &options)?;
    let seconds = start.elapsed().as_secs_f64();
    write_map(&map, output)?;
    if args.mip {
        for level in 1..=mip::last([store.width, store.height]) {
            let path = output.with_extension(format!("mip{level}.exr"));
            write_map(&chunks::fit_level(&store, &options, level)?, &path)?;
        }
    }
    let outcome = sampled_outcome(&map, seconds);
    let (texels, poses) = (store.width * store.height, store.poses.len());
    print(&format!(
        "{texels} texels × {poses} poses, {} by {}: {seconds:.1} s\n{}",
        lobes_in_words(&map, &options),
        options.method.name(),
        outcome.residuals()
    ))?;
    Ok(outcome)
}

/// `2 lobes`, or how many texels took how many.
fn lobes_in_words(map: &SbrdfMap, options: &FitOptions) -> String {
    let word = |count: usize| if count == 1 { "lobe" } else { "lobes" };
    let Some(chosen) = map.extra.get("lobes") else {
        return format!("{} {}", options.lobes, word(options.lobes));
    };
    let most = map.lobes.len();
    let share = |count: usize| {
        let texels = chosen.iter().filter(|&&lobes| lobes as usize == count).count();
        100.0 * texels as f64 / chosen.len().max(1) as f64
    };
    let shares: Vec<String> =
        (0..=most).map(|count| format!("{count} {} in {:.0} %", word(count), share(count))).collect();
    shares.join(", ")
}

impl FitOutcome {
    /// The residuals in a sentence.
    fn residuals(&self) -> String {
        let percent = |name: &str| {
            100.0 * self.errors.iter().find(|error| error.name == name).map_or(0.0, |error| error.value)
        };
        format!(
            "residual: median {:.2} % of the samples' RMS, 95 % of the texels below {:.2} %\n",
            percent("residual_relative_median"),
            percent("residual_relative_p95"),
        )
    }
}

/// Errors and rates of a fitted map.
fn sampled_outcome(map: &SbrdfMap, seconds: f64) -> FitOutcome {
    let mut relative: Vec<f32> = (map.extra["error.relative"].iter().zip(&map.extra["samples"]))
        .filter(|&(_, &samples)| samples > 0.0)
        .map(|(&error, _)| error)
        .collect();
    relative.sort_by(f32::total_cmp);
    let texels = map.width * map.height;
    let over = format!("{} texels", relative.len());
    let mut outcome = FitOutcome::default();
    for (name, share) in [("residual_relative_median", 0.5), ("residual_relative_p95", 0.95)] {
        let place = ((relative.len() as f64 * share) as usize).min(relative.len().saturating_sub(1));
        let value = relative.get(place).map_or(0.0, |&error| f64::from(error));
        let mut figure = ErrorFigure::new(name, value, "1", over.clone());
        for key in ["lobes", "method", "residual"] {
            let text = map.attributes.get(&format!("fit.{key}")).map_or("unknown", String::as_str);
            figure = match text.parse::<usize>() {
                Ok(number) => figure.with(key, number),
                Err(_) => figure.with(key, text),
            };
        }
        outcome.errors.push(figure);
    }
    outcome.figures.insert("texels".into(), texels.into());
    outcome.figures.insert("texels_without_samples".into(), (texels - relative.len()).into());
    outcome.figures.insert("texels_per_second".into(), (texels as f64 / seconds.max(1e-9)).into());
    outcome
}

fn fit_table(args: &FitArgs, input: &Path, seed: u64) -> Result<FitOutcome> {
    if args.chunks.is_some() || args.mip {
        return Err(Error::input("--chunks and --mip are for sampled SBRDFs (.zarr)"));
    }
    if args.diffuse_percentile.is_some() || args.separate_channels {
        return Err(Error::input(
            "--diffuse-percentile and --separate-channels are for sampled SBRDFs (.zarr)",
        ));
    }
    let method = match args.method {
        MethodName::LineSearch => Method::LineSearch,
        MethodName::Auto | MethodName::Lm => Method::Lm,
        MethodName::Separable => {
            return Err(Error::input(
                "--method separable is for sampled SBRDFs (.zarr); tables are fitted by lm",
            ));
        }
    };
    let options = TableOptions {
        method,
        residual: args.residual(Residual::Balanced),
        hold_out_theta_deg: args.hold_out_theta_deg.clone(),
        random_starts: args.random_starts,
        seed,
    };
    if args.output.is_some() && args.wavelengths_nm.len() != 3 {
        return Err(Error::input(format!(
            "-o writes red, green and blue: give three --wavelengths-nm, not {}",
            args.wavelengths_nm.len()
        )));
    }
    let measured = MeasuredTable::read(input).map_err(|error| Error::input(error.to_string()))?;
    let wanted = args.lobes();
    let most = if options.method == Method::LineSearch { 1 } else { AUTO_LOBES };
    let lobes: Vec<usize> = (0..=most.max(wanted)).collect();
    let start = Instant::now();
    let fits = table::fit(&measured, &args.wavelengths_nm, &lobes, &options)
        .map_err(|error| error.at(input.display()))?;
    let seconds = start.elapsed().as_secs_f64();
    print(&described(&measured, &fits, wanted, &options, seconds)?)?;
    if let Some(output) = &args.output {
        write_map(&table_map(&fits, wanted, &options), output)?;
    }
    let mut outcome = FitOutcome { errors: table::figures(&fits, &options), ..FitOutcome::default() };
    outcome.figures.insert("rows".into(), measured.rows.len().into());
    outcome.figures.insert("fits".into(), fits.len().into());
    outcome.figures.insert("fit_seconds".into(), seconds.into());
    Ok(outcome)
}

/// The comparison of all fits, then the lobes of those that were asked for.
fn described(
    measured: &MeasuredTable,
    fits: &[WavelengthFit],
    wanted: usize,
    options: &TableOptions,
    seconds: f64,
) -> Result<String> {
    let mut text = String::new();
    write_description(&mut text, measured, fits, wanted, options, seconds)
        .map_err(|error| Error::failure(error.to_string()))?;
    Ok(text)
}

fn write_description(
    text: &mut String,
    measured: &MeasuredTable,
    fits: &[WavelengthFit],
    wanted: usize,
    options: &TableOptions,
    seconds: f64,
) -> std::fmt::Result {
    let (method, residual) = (options.method.name(), options.residual.name());
    writeln!(
        text,
        "{} rows, {method}, {residual} residual: {} fits in {seconds:.1} s",
        measured.rows.len(),
        fits.len()
    )?;
    let held_out = !options.hold_out_theta_deg.is_empty();
    write!(text, "\n{:>8} {:>5}  {:>12} {:>11}", "nm", "lobes", "train log", "relative")?;
    if held_out {
        write!(text, "  {:>12} {:>11}", "held-out log", "relative")?;
    }
    let starts = format!("cost / best of {}", options.random_starts);
    writeln!(text, "{}", if options.random_starts > 0 { format!("  {starts:>18}") } else { String::new() })?;
    for fit in fits {
        let errors = &fit.training;
        write!(
            text,
            "{:>8} {:>5}  {:>12.3} {:>11.3}",
            fit.wavelength_nm, fit.lobes, errors.log_rms, errors.relative_l2
        )?;
        if let Some(errors) = &fit.held_out {
            write!(text, "  {:>12.3} {:>11.3}", errors.log_rms, errors.relative_l2)?;
        }
        if let Some(ratio) = fit.start_ratio {
            write!(text, "  {ratio:>18.4}")?;
        }
        writeln!(text)?;
    }
    writeln!(text, "\n{:>8} {:>10}  lobes: rho_s (Cx = Cy, Cz) n", "nm", "rho_d")?;
    for fit in fits.iter().filter(|fit| fit.lobes == wanted) {
        write!(text, "{:>8} {:>10.5}", fit.wavelength_nm, fit.model.diffuse)?;
        for lobe in &fit.model.lobes {
            let c = lobe.c / lobe.reference;
            write!(text, "  {:.4} ({:.4}, {:.4}) {:.1}", lobe.amplitude, c.x, c.z, lobe.n)?;
        }
        writeln!(text)?;
    }
    Ok(())
}

/// A map of one texel: the longest wavelength as red, the shortest as blue.
fn table_map(fits: &[WavelengthFit], wanted: usize, options: &TableOptions) -> SbrdfMap {
    let mut channels: Vec<&WavelengthFit> = fits.iter().filter(|fit| fit.lobes == wanted).collect();
    channels.sort_by(|a, b| b.wavelength_nm.total_cmp(&a.wavelength_nm));
    let brdf = table::brdf([channels[0], channels[1], channels[2]]);
    let mut map = SbrdfMap::from_texels(1, 1, &[brdf]);
    let wavelengths: Vec<String> = channels.iter().map(|fit| fit.wavelength_nm.to_string()).collect();
    for (key, value) in [
        ("fit.method", options.method.name().to_string()),
        ("fit.residual", options.residual.name().to_string()),
        ("fit.wavelengths_nm", wavelengths.join(",")),
    ] {
        map.attributes.insert(key.into(), value);
    }
    map
}

fn write_map(map: &SbrdfMap, path: &Path) -> Result<()> {
    map.write_exr(path).map_err(|error| Error::writing(path, error))
}

fn print(text: &str) -> Result<()> {
    use std::io::Write as _;
    match std::io::stdout().write_all(text.as_bytes()) {
        // Whoever read the output has seen enough.
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        written => written.map_err(|error| Error::failure(format!("stdout: {error}"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampled::SampledSbrdf;
    use clap::Parser;

    #[derive(Parser)]
    struct Command {
        #[command(flatten)]
        args: FitArgs,
    }

    fn parsed(arguments: &[&str]) -> FitArgs {
        Command::try_parse_from(std::iter::once(&"fit").chain(arguments)).unwrap().args
    }

    fn run_on(text: &str, arguments: &[&str]) -> (tempfile::TempDir, Result<FitOutcome>) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("paint.brdf");
        std::fs::write(&path, text).unwrap();
        let mut all = vec![path.to_str().unwrap()];
        all.extend(arguments);
        let outcome = fit_input(&parsed(&all), 1);
        (folder, outcome)
    }

    /// A wide table of a white lobe.
    fn table_text() -> String {
        let mut text = String::from("3 450 550 650\n");
        for (i, o, p) in (1..8).flat_map(|i| (0..8).flat_map(move |o| (0..7).map(move |p| (i, o, p)))) {
            let (i, o, p) = (f64::from(i) * 0.17, f64::from(o) * 0.17, f64::from(p) * 0.52);
            let base = -0.95 * i.sin() * o.sin() * p.cos() + 0.9 * i.cos() * o.cos();
            let f = 0.05 + base.max(0.0).powi(20);
            writeln!(text, "{i} 0 {o} {p} {f} {f} {f}").unwrap();
        }
        text
    }

    #[test]
    fn a_table_is_fitted_reported_and_written_as_a_map_of_one_texel() {
        let folder = tempfile::tempdir().unwrap();
        let output = folder.path().join("paint.exr");
        let held = (3.0f64 * 0.17).to_degrees().to_string();
        let arguments = [
            "--hold-out-theta-deg",
            &held,
            "--lobes",
            "1",
            "-o",
            output.to_str().unwrap(),
            "--random-starts",
            "2",
        ];
        let (_input, outcome) = run_on(&table_text(), &arguments);
        let errors = outcome.unwrap().errors;
        let one =
            errors.iter().find(|e| e.name == "held_out_relative_l2" && e.depends["lobes"] == 1).unwrap();
        assert!(one.value < 1e-2 && one.depends["wavelength_nm"] == 450.0, "{one:?}");
        assert_eq!(errors.iter().filter(|e| e.name == "start_cost_ratio").count(), 9);
        let map = SbrdfMap::read_exr(&output).unwrap();
        assert_eq!((map.width, map.height, map.lobes.len()), (1, 1, 3));
        assert!((map.rho_d[0].x - 0.05).abs() < 1e-3);
        assert_eq!(map.attributes["fit.wavelengths_nm"], "650,550,450");
    }

    #[test]
    fn wrong_inputs_end_with_a_sentence_and_exit_code_2() {
        let refused = |text: &str, arguments: &[&str]| {
            let error = run_on(text, arguments).1.unwrap_err();
            assert_eq!(error.exit_code(), 2);
            error.to_string()
        };
        assert!(
            refused("1 500 0.1 0 0.1 0 nan", &[]).contains("paint.brdf: line 1: row 1: the value at 500 nm")
        );
        assert!(refused("1 500 0.1 0 0.1 0 1", &[]).contains("450 nm lies outside"));
        let two = ["--wavelengths-nm", "450,550", "-o", "x.exr"];
        assert!(refused(&table_text(), &two).contains("three --wavelengths-nm"));
        assert!(refused(&table_text(), &["--method", "line-search", "--lobes", "2"]).contains("one lobe"));
        assert!(refused(&table_text(), &["--hold-out-theta-deg", "45"]).contains("held-out 45°"));
        let unknown = fit_input(&parsed(&["paint.txt"]), 1).unwrap_err();
        assert!(unknown.exit_code() == 2 && unknown.to_string().contains("paint.txt"));
        let no_output = fit_input(&parsed(&["a.zarr"]), 1).unwrap_err();
        assert!(no_output.to_string().contains("-o FILE.exr"));
    }

    #[test]
    fn the_zarr_path_goes_from_a_store_to_a_map() {
        let folder = tempfile::tempdir().unwrap();
        let (input, output) = (folder.path().join("s.zarr"), folder.path().join("m.exr"));
        let pose = |x: f64| crate::sampled::PoseGeometry {
            light_mm: glam::DVec3::new(x, 100.0, 900.0),
            camera_mm: glam::DVec3::new(-x, 0.0, 900.0),
            weight: 1.0,
        };
        let poses: Vec<_> = (0..30).map(|k| pose(f64::from(k) * 40.0)).collect();
        let mut sampled = SampledSbrdf::empty(3, 2, 1.0, poses);
        sampled.reflectance.fill(0.25);
        sampled.write_zarr(&input).unwrap();
        let arguments = [input.to_str().unwrap(), "-o", output.to_str().unwrap(), "--lobes", "1", "--mip"];
        let outcome = fit_input(&parsed(&arguments), 1).unwrap();
        assert!(outcome.errors[0].value < 1e-3, "{outcome:?}");
        let map = SbrdfMap::read_exr(&output).unwrap();
        assert_eq!((map.width, map.height), (3, 2));
        for (level, size) in [(1, (2, 1)), (2, (1, 1))] {
            let map = SbrdfMap::read_exr(&folder.path().join(format!("m.mip{level}.exr"))).unwrap();
            assert_eq!((map.width, map.height), size);
        }
        assert!(!folder.path().join("m.mip3.exr").exists());
    }
}
