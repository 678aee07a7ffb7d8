//! Errors against the simulator's truth: histograms and a table of the report's figures.

use crate::demo::{DemoOutcome, FitOutcome, truth};
use crate::fit::figures::ErrorFigure;
use crate::page::scale::{Histogram, Scale};
use crate::page::{html, numbers};
use crate::report::Report;

/// Bins of every histogram.
const BINS: usize = 36;

/// Plot area in a drawing of 360 × 230: left, top, width, height.
const AREA: [f64; 4] = [46.0, 20.0, 288.0, 160.0];

/// The section.
pub(super) fn section(outcome: &DemoOutcome, report: &Report) -> String {
    let fits = format!("<div class=\"three\">{}</div>\n", fit_histograms(&outcome.fits));
    let registration = registration_histogram(&outcome.registration_texels);
    let content =
        format!("{fits}<div class=\"aside\">{registration}<div>{}</div></div>\n", table(&report.errors));
    let lead = format!(
        "The simulator knows what really lies at every texel. Each fit is compared with that on {} direction pairs that were never posed, the same for all; the error is ‖f̂ − f‖ / ‖f‖ over pairs and channels.",
        truth::PAIRS
    );
    html::section("errors", "Errors against the truth", &lead, &content)
}

/// What a fit is called.
pub fn fit_name(fit: &FitOutcome) -> String {
    let method = match fit.method.name() {
        "lm" => "Levenberg–Marquardt",
        "line-search" => "Line search",
        other => other,
    };
    let channel = if fit.separate_channels { " a channel" } else { "" };
    format!("{method}, {} {}{channel}", fit.lobes, if fit.lobes == 1 { "lobe" } else { "lobes" })
}

/// The fits side by side, on the same axes.
fn fit_histograms(fits: &[FitOutcome]) -> String {
    let all: Vec<f32> = fits.iter().flat_map(|fit| fit.errors.iter().copied()).collect();
    let scale = Scale::of(&all, 0.002, 0.998, true).rounded();
    let histogram = |fit: &FitOutcome| Histogram::new(fit.errors.iter().map(|&e| f64::from(e)), &scale, BINS);
    let counted: Vec<Histogram> = fits.iter().map(histogram).collect();
    let most = counted.iter().map(Histogram::most).max().unwrap_or(1);
    fits.iter()
        .zip(&counted)
        .map(|(fit, histogram)| {
            let median = truth::median(&fit.errors);
            let axes =
                Axes { scale: &scale, most, x: "relative RMS error", y: "texels", label: numbers::percent };
            let caption = format!(
                "<b>{}</b>: median {}, {}",
                fit_name(fit),
                numbers::percent(median),
                numbers::seconds(fit.seconds)
            );
            html::figure(&axes.draw(histogram, median, &fit_name(fit)), &caption)
        })
        .collect()
}

/// The registration's error over the poses.
fn registration_histogram(errors: &[f64]) -> String {
    let values: Vec<f32> = errors.iter().map(|&e| e as f32).collect();
    let scale = Scale::of(&values, 0.0, 1.0, true).rounded();
    let histogram = Histogram::new(errors.iter().copied(), &scale, BINS / 2);
    let median = truth::median(&values);
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

/// The axes of a histogram.
struct Axes<'a> {
    scale: &'a Scale,
    most: usize,
    x: &'a str,
    y: &'a str,
    /// How the median is written.
    label: fn(f64) -> String,
}

impl Axes<'_> {
    /// The histogram as SVG with its median marked.
    fn draw(&self, histogram: &Histogram, median: f64, alt: &str) -> String {
        let [left, top, width, height] = AREA;
        let bottom = top + height;
        let top_count = Scale::linear(0.0, 1.05 * self.most.max(1) as f64);
        let y = |count: f64| bottom - height * top_count.place(count);
        let step = width / histogram.counts.len() as f64;
        let mut drawn = String::new();
        for tick in top_count.ticks(5).into_iter().filter(|tick| tick.fract() == 0.0) {
            let at = y(tick);
            drawn += &format!(
                "<path class=\"grid\" d=\"M{left} {at:.1}h{width}\"/><text class=\"end\" x=\"{:.1}\" y=\"{:.1}\">{}</text>",
                left - 6.0,
                at + 4.0,
                numbers::count(tick as usize)
            );
        }
        for (bin, &count) in histogram.counts.iter().enumerate().filter(|(_, count)| **count > 0) {
            let (x, at) = (left + step * bin as f64, y(count as f64));
            drawn += &format!(
                "<rect class=\"column\" x=\"{:.1}\" y=\"{at:.1}\" width=\"{:.1}\" height=\"{:.1}\"/>",
                x + 0.5,
                step - 1.0,
                bottom - at
            );
        }
        drawn += &self.x_axis(bottom);
        if median.is_finite() {
            drawn += &self.median(median);
        }
        format!(
            "<svg role=\"img\" aria-label=\"histogram: {}\" viewBox=\"0 0 360 230\">{drawn}<text class=\"middle name\" x=\"{:.1}\" y=\"222\">{}</text><text class=\"name\" x=\"4\" y=\"13\">{}</text></svg>",
            html::escape(alt),
            left + width / 2.0,
            self.x,
            self.y
        )
    }

    /// Line and ticks under the columns.
    fn x_axis(&self, bottom: f64) -> String {
        let [left, _, width, _] = AREA;
        let percent = self.x.starts_with("relative");
        let ticks = self.scale.ticks(6).into_iter().map(|value| {
            let x = left + width * self.scale.place(value);
            let text = if percent { format!("{}\u{202f}%", numbers::tick(100.0 * value)) } else { numbers::tick(value) };
            format!("<path class=\"axis\" d=\"M{x:.1} {bottom}v4\"/><text class=\"middle\" x=\"{x:.1}\" y=\"{:.1}\">{text}</text>", bottom + 17.0)
        });
        format!("<path class=\"axis\" d=\"M{left} {bottom}h{width}\"/>{}", ticks.collect::<String>())
    }

    /// A line at the median, its value above.
    fn median(&self, median: f64) -> String {
        let [left, top, width, height] = AREA;
        let x = left + width * self.scale.place(median).clamp(0.0, 1.0);
        format!(
            "<path class=\"median\" d=\"M{x:.1} {top}v{height}\"/><text class=\"middle strong\" x=\"{:.1}\" y=\"{:.1}\">median {}</text>",
            x.clamp(left + 56.0, left + width - 40.0),
            top - 7.0,
            (self.label)(median)
        )
    }
}

/// The report's errors.
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
        "<table class=\"figures\"><thead><tr><th>figure</th><th class=\"number\">value</th><th>unit</th><th>over</th></tr></thead><tbody>\n{}</tbody></table>",
        errors.iter().filter(|error| !error.depends.contains_key("material")).map(row).collect::<String>()
    )
}
