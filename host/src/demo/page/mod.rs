//! The demo's page: what was measured, fitted and rendered, and how wrong it is, in one HTML file that needs
//! no other file and no network.

use std::path::Path;

use crate::demo::DemoOutcome;
use crate::demo::fits::{FitOutcome, lobes_title};
use crate::error::Result;
use crate::files;
use crate::page::scale::quantile;
use crate::page::{self, html, numbers};
use crate::report::Report;

mod errors;
mod frame;
mod hemisphere;
mod histogram;
mod maps;
mod pick;
mod polar;
mod texels;
mod texture;
mod timing;

pub use errors::fit_name;

/// A rendered picture for the top of the page.
pub struct Rendered {
    /// What it shows.
    pub title: String,
    /// By which method, in what time.
    pub caption: String,
    /// The picture as a PNG file.
    pub png: Vec<u8>,
}

/// Writes the page of a demo whose report is finished.
///
/// # Errors
/// When the outcome has no registered pose, a frame of the run cannot be read, or the disk refuses.
pub fn write(outcome: &DemoOutcome, report: &Report, renderings: &[Rendered], path: &Path) -> Result<()> {
    files::write_bytes(path, page(outcome, report, renderings)?.as_bytes())
}

/// The page as HTML.
fn page(outcome: &DemoOutcome, report: &Report, renderings: &[Rendered]) -> Result<String> {
    let result = &outcome.fits.result;
    let sections = [
        head(outcome, result, report, renderings),
        frame::section(outcome)?,
        texture::section(outcome)?,
        texels::section(outcome, result)?,
        maps::section(&outcome.fits)?,
        errors::section(outcome),
        errors::by_angle(outcome),
        errors::registration(outcome, report),
        timing::section(report),
    ];
    let body = format!("<main>\n{}</main>\n{}", sections.concat(), footer(report));
    Ok(page::document("Lobelia demo", &body))
}

/// What was done, the pictures, the figures.
fn head(outcome: &DemoOutcome, result: &FitOutcome, report: &Report, renderings: &[Rendered]) -> String {
    let carrier = &outcome.run.rig.carrier;
    let photographs: usize = outcome.run.plan.poses.iter().map(|pose| pose.exposures_s.len()).sum();
    let sentence = format!(
        "A simulated gonioreflectometer photographed a flat sample, {} × {} mm, {} times in {} poses of \
         light and camera; the photographs became the reflectance of every texel, and each texel was fitted \
         with {} by {}.",
        numbers::tick(carrier.sample_width_mm),
        numbers::tick(carrier.sample_height_mm),
        numbers::count(photographs),
        numbers::count(outcome.run.plan.poses.len()),
        lobes_title(&result.options),
        result.options.method.title()
    );
    let title = match renderings {
        [] => "A material, measured and fitted",
        _ => "A material, measured, fitted and rendered",
    };
    format!(
        "<header id=\"head\">\n<h1>{title}</h1>\n<p class=\"lead\">{sentence}</p>\n</header>\n{}{}",
        hero(renderings),
        tiles(outcome, result, report)
    )
}

/// The rendered pictures; the first is the largest when their number is odd.
fn hero(renderings: &[Rendered]) -> String {
    if renderings.is_empty() {
        return String::new();
    }
    let figure = |rendered: &Rendered| {
        let caption =
            format!("<b>{}</b>: {}", html::escape(&rendered.title), html::escape(&rendered.caption));
        html::figure(&html::picture(&rendered.png, &rendered.title, "rendered"), &caption)
    };
    let class = if renderings.len() % 2 == 1 { "hero odd" } else { "hero" };
    format!(
        "<div class=\"{class}\" id=\"rendered\">{}</div>\n",
        renderings.iter().map(figure).collect::<String>()
    )
}

/// The key figures.
fn tiles(outcome: &DemoOutcome, result: &FitOutcome, report: &Report) -> String {
    let sampled = &outcome.developed.sampled;
    let camera = &outcome.run.rig.camera;
    let registered = outcome.developed.registrations.iter().filter(|found| found.is_ok()).count();
    let squares: f64 = outcome.registration_texels.iter().map(|error| error * error).sum();
    let registration = (squares / outcome.registration_texels.len().max(1) as f64).sqrt();
    let tiles = [
        (format!("{} × {}", sampled.width, sampled.height), "texels".to_string()),
        (numbers::count(sampled.poses.len()), format!("poses, {} registered", numbers::count(registered))),
        (format!("{} × {}", camera.width, camera.height), "pixels, raw Bayer sensor".into()),
        (numbers::seconds(report.seconds()), format!("all stages, {} threads", report.machine.cores)),
        (numbers::bytes(report.peak_memory_bytes), "peak memory".into()),
        (numbers::significant(registration, 2), "texel, RMS registration error".into()),
        (
            numbers::percent(quantile(&result.errors, 0.5)),
            "relative RMS error of the fit, median of the texels".into(),
        ),
        (numbers::percent(quantile(&result.errors, 0.95)), "the same, 95th percentile".into()),
    ];
    let tile = |(value, label): &(String, String)| format!("<div><b>{value}</b><span>{label}</span></div>");
    format!("<div class=\"tiles\">{}</div>\n", tiles.iter().map(tile).collect::<String>())
}

/// With what the page was made, and what lies beside it.
fn footer(report: &Report) -> String {
    format!(
        "<footer><p>Lobelia {}, seed {}. Beside this page: <code>run/</code> (plan, rig, journal, raw \
         frames), <code>sampled.zarr</code> (measured reflectance), <code>material.exr</code> (fitted \
         coefficients), the pictures as <code>.exr</code> (linear) and <code>.png</code>, \
         <code>report.json</code> (all figures). Reflectance is in sr⁻¹; luminance by Rec. \
         709.</p></footer>\n",
        html::escape(&report.lobelia),
        report.seed
    )
}

#[cfg(test)]
mod tests;
