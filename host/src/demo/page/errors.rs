//! Errors against the simulator's truth: the methods beside each other, the result by angle, the
//! registration.

use super::histogram::Axes;
use crate::by_angle::{PERCENTILES, Side};
use crate::chart::{Cell, Table};
use crate::demo::fits::{FitOutcome, lobes_title};
use crate::demo::{DemoOutcome, truth};
use crate::figures::ErrorFigure;
use crate::page::scale::{Histogram, Scale, quantile};
use crate::page::{html, numbers};
use crate::report::Report;

/// Bins of every histogram.
const BINS: usize = 36;

/// The section on the fits.
pub(super) fn section(outcome: &DemoOutcome) -> String {
    let fits = &outcome.fits;
    let texels = fits.window.texels();
    let lead = format!(
        "The simulator knows what really lies at every texel. Each fit is compared with that on {} direction \
         pairs that were never posed, the same for all, within the polar cuts of the plan; the error is ‖f̂ \
         − f‖ / ‖f‖ over pairs and channels. All methods are judged over the same {} texels{}, line searches \
         with the one lobe that they have.",
        truth::PAIRS,
        numbers::count(texels),
        if texels < fits.result.errors.len() { " in the middle of the sample" } else { "" }
    );
    let content = format!(
        "{}<h3>In numbers</h3>\n<div class=\"scroll\">{}</div>\n",
        histograms(outcome),
        methods(outcome).html()
    );
    html::section("errors", "Methods against the truth", &lead, &content)
}

/// The section on errors by angle.
pub(super) fn by_angle(outcome: &DemoOutcome) -> String {
    let fits = &outcome.fits;
    let lead = format!(
        "A direction pair lies inside the measured cone when a pose is within θ<sub>d</sub> = {}° of it, the \
         spacing of the plan; outside, a fit tells what nobody measured. Judged on {} random pairs over the \
         whole hemispheres.",
        numbers::significant(outcome.cone.spacing_deg(), 3),
        numbers::count(crate::by_angle::PAIRS * (crate::by_angle::BANDS_DEG.len() - 1))
    );
    let content = format!(
        "<h3>The methods, over {} texels</h3>\n<div class=\"scroll\">{}</div>\n<h3>The result by angle, over \
         all {} texels</h3>\n<div class=\"scroll\">{}</div>\n",
        numbers::count(fits.window.texels()),
        cones(outcome).html(),
        numbers::count(fits.result.errors.len()),
        fits.result.by_angle.table().html()
    );
    html::section("angles", "Inside and outside the measured cone", &lead, &content)
}

/// The section on the registration, and the report's other figures.
pub(super) fn registration(outcome: &DemoOutcome, report: &Report) -> String {
    let histogram = registration_histogram(&outcome.registration_texels);
    let content = format!("<div class=\"aside\">{histogram}<div>{}</div></div>\n", table(&report.errors));
    let lead = "How far from its true place in the photograph a point of the sample is taken to be.";
    html::section("registration", "Registration against the truth", lead, &content)
}

/// What a fit is called.
pub fn fit_name(fit: &FitOutcome) -> String {
    let method = capitalised(fit.options.method.title());
    let channel = if fit.options.separate_channels { " a channel" } else { "" };
    format!("{method}, {}{channel}", lobes_title(&fit.options))
}

fn capitalised(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map(|first| first.to_uppercase().chain(letters).collect()).unwrap_or_default()
}

/// The compared fits, those of one lobe and the others, all by the same errors, each row by its own counts.
fn histograms(outcome: &DemoOutcome) -> String {
    let fits: Vec<(&FitOutcome, Vec<f32>)> = (outcome.fits.compared().into_iter())
        .map(|(_, fit)| (fit, fit.errors_in(&outcome.fits.window)))
        .collect();
    let all: Vec<f32> = fits.iter().flat_map(|(_, errors)| errors.iter().copied()).collect();
    let scale = Scale::of(&all, 0.002, 0.998, true).rounded();
    let counted = |errors: &[f32]| Histogram::new(errors.iter().map(|&e| f64::from(e)), &scale, BINS);
    let figure = |(fit, errors): &(&FitOutcome, Vec<f32>), highest: usize| {
        let [median, most] = [0.5, 0.95].map(|share| quantile(errors, share));
        let axes = Axes {
            scale: &scale,
            most: highest,
            x: "relative RMS error",
            y: "texels",
            label: numbers::percent,
        };
        let caption = format!(
            "<b>{}</b>: median {}, 95 % of the texels below {}; {} µs a texel",
            fit_name(fit),
            numbers::percent(median),
            numbers::percent(most),
            numbers::significant(fit.us_a_texel(), 2)
        );
        html::figure(&axes.draw(&counted(errors), median, &fit_name(fit)), &caption)
    };
    let group = |title: &str, one: bool| {
        let chosen = || fits.iter().filter(|(fit, _)| (fit.options.lobes <= 1) == one);
        let highest = chosen().map(|(_, errors)| counted(errors).most()).max().unwrap_or(1);
        let figures: String = chosen().map(|fit| figure(fit, highest)).collect();
        format!("<h3>{title}</h3>\n<div class=\"four\">{figures}</div>\n")
    };
    let none = fits.iter().any(|(fit, _)| fit.options.lobes == 0);
    group(if none { "One lobe or none" } else { "One lobe" }, true) + &group("Two lobes and more", false)
}

/// Errors as cells of a table, percent.
fn cells(errors: impl IntoIterator<Item = f64>) -> impl Iterator<Item = Cell> {
    errors.into_iter().map(|error| Cell::from(100.0 * error))
}

/// Percentiles, time and medians by material, a row a method.
fn methods(outcome: &DemoOutcome) -> Table {
    let fits = &outcome.fits;
    let materials = fits.result.errors_by_material(&fits.window).len();
    let mut table = Table::new(["method", "µs a texel", "median, %", "95 %", "99 %", "worst, %"]);
    if materials > 1 {
        table.columns.extend((0..materials).map(|number| format!("material {number}: median, %")));
    }
    for (name, fit) in fits.compared() {
        let errors = fit.errors_in(&fits.window);
        let mut row: Vec<Cell> = vec![name.into(), fit.us_a_texel().into()];
        row.extend(cells(PERCENTILES.map(|percentile| quantile(&errors, f64::from(percentile) / 100.0))));
        if materials > 1 {
            let by_material = fit.errors_by_material(&fits.window);
            row.extend(cells(by_material.iter().map(|errors| quantile(errors, 0.5))));
        }
        table.rows.push(row);
    }
    table
}

/// Percentiles on both sides of the cone's rim, a row a method.
fn cones(outcome: &DemoOutcome) -> Table {
    let fits = &outcome.fits;
    let mut table = Table::new([
        "method",
        "inside: median, %",
        "95 %",
        "99 %",
        "worst, %",
        "outside: median, %",
        "95 %",
        "99 %",
        "worst, %",
    ]);
    for (name, fit) in fits.compared() {
        let by_angle = fit.by_angle.of(fit.indices(&fits.window));
        let mut row: Vec<Cell> = vec![name.into()];
        for side in [Side::Inside, Side::Outside] {
            let errors = by_angle.side(side).map_or([f64::NAN; PERCENTILES.len()], |row| row.errors);
            row.extend(cells(errors));
        }
        table.rows.push(row);
    }
    table
}

/// The registration's error over the poses.
fn registration_histogram(errors: &[f64]) -> String {
    let values: Vec<f32> = errors.iter().map(|&e| e as f32).collect();
    let scale = Scale::of(&values, 0.0, 1.0, true).rounded();
    let histogram = Histogram::new(errors.iter().copied(), &scale, BINS / 2);
    let median = quantile(&values, 0.5);
    let label = |value: f64| numbers::significant(value, 2);
    let axes = Axes {
        scale: &scale,
        most: histogram.most(),
        x: "RMS registration error, texels",
        y: "poses",
        label,
    };
    let caption = format!(
        "<b>Registration</b>: {} poses, median {} texel, worst {}",
        errors.len(),
        label(median),
        label(errors.iter().copied().fold(0.0, f64::max))
    );
    html::figure(&axes.draw(&histogram, median, "registration error"), &caption)
}

/// The report's errors, but for the many percentiles, which have their own tables.
fn table(errors: &[ErrorFigure]) -> String {
    let row = |error: &ErrorFigure| {
        let depends = error.depends.iter().map(|(key, value)| {
            let value = value.as_str().map_or_else(|| value.to_string(), str::to_string);
            format!("{} {}", html::escape(&key.replace('_', " ")), html::escape(&value))
        });
        let unit = if error.unit == "1" { "ratio" } else { &error.unit };
        format!(
            "<tr><td>{}<small>{}</small></td><td class=\"number\">{}</td><td>{}</td><td>{}</td></tr>\n",
            html::escape(&error.name.replace('_', " ").replace("rms", "RMS")),
            depends.collect::<Vec<_>>().join(", "),
            numbers::significant(error.value, 3),
            html::escape(unit),
            html::escape(&error.over)
        )
    };
    format!(
        "<table class=\"figures\"><thead><tr><th>figure</th><th \
         class=\"number\">value</th><th>unit</th><th>over</th></tr></thead><tbody>\n{}</tbody></table>",
        errors.iter().filter(|error| !error.depends.contains_key("percentile")).map(row).collect::<String>()
    )
}
