//! Two texels closely: polar plots, exitant hemispheres and coefficients, each beside the truth.

use lobelia_hil_sim::optics::Material;

use super::maps::{lobe_name, sorted_lobes};
use super::pick::Chosen;
use super::{hemisphere, pick, polar};
use crate::demo::DemoOutcome;
use crate::demo::fits::FitOutcome;
use crate::distance::MAX_THETA_O_DEG;
use crate::error::Result;
use crate::page::{html, numbers};
use crate::reflectance::{Lobe, LobeBrdf, Rgb};

/// The section.
pub(super) fn section(outcome: &DemoOutcome, result: &FitOutcome) -> Result<String> {
    let chosen = pick::two_texels(outcome);
    let names: &[&str] = if chosen.len() > 1 { &["glossiest", "mattest"] } else { &["only"] };
    let mut content = polar::legend();
    for (texel, name) in chosen.iter().zip(names) {
        content += &closely(outcome, result, texel, name)?;
    }
    content += &format!(
        "<p class=\"note\">Hemispheres: light at θ<sub>i</sub> = 30° (○), mirror direction (+), equal-area \
         projection, the rim being the horizon; rings at 30° and 60°, dashed at {MAX_THETA_O_DEG:.0}°, \
         beyond which nothing is measured. “Measured” takes the nearest of all samples in the bi-angular \
         distance that counts reciprocal{} pairs as one.</p>\n",
        if outcome.run.plan.isotropic { ", turned and mirrored" } else { "" }
    );
    let lead = "The glossiest and the mattest of the materials that are wide enough to have texels away from \
         the pattern’s edges; of those texels the one of median error: what was measured, what was fitted \
         and what is true.";
    Ok(html::section("texels", "Two texels closely", lead, &content))
}

/// One texel.
fn closely(outcome: &DemoOutcome, result: &FitOutcome, texel: &Chosen<'_>, name: &str) -> Result<String> {
    let sampled = &outcome.developed.sampled;
    let isotropic = outcome.run.plan.isotropic;
    let (column, row) = (texel.index % sampled.width, texel.index / sampled.width);
    let error = result.errors.get(texel.index).copied().map_or(f64::NAN, f64::from);
    let plot = polar::plot(sampled, &result.map, isotropic, texel);
    let discs = hemisphere::discs(sampled, &result.map, isotropic, texel)?;
    Ok(format!(
        "<h3>Texel in column {column}, row {row}: the {name} material, relative error {}</h3>\n<div \
         class=\"aside\">{}<div>{}</div></div>\n{discs}",
        numbers::percent(error),
        html::figure(&plot, ""),
        coefficients(result, texel)
    ))
}

/// The fitted coefficients, and the true ones where the truth is lobes too.
fn coefficients(result: &FitOutcome, texel: &Chosen<'_>) -> String {
    let fitted = result.map.texel(texel.index);
    let lobes = sorted_lobes(&result.map, texel.index);
    let truth = match texel.material {
        Material::Lobes(brdf) => Some(brdf),
        Material::Measured(_) => None,
    };
    let mut true_lobes: Vec<Lobe> = truth.iter().flat_map(|brdf| &brdf.lobes).map(Lobe::normalised).collect();
    true_lobes.sort_by(|a, b| b.n.total_cmp(&a.n));
    let diffuse = |brdf: &LobeBrdf| rgb(brdf.rho_d);
    let mut rows = row("ρ<sub>d</sub>, sr⁻¹", Some(diffuse(&fitted)), truth.map(diffuse));
    let count = lobes.len().max(true_lobes.len());
    for rank in 0..count {
        rows += &format!("<tr><th colspan=\"3\">{}</th></tr>\n", lobe_name(rank, count));
        let mut coefficient = |name: &str, value: fn(&Lobe) -> String| {
            rows += &row(name, lobes.get(rank).map(value), true_lobes.get(rank).map(value));
        };
        coefficient("ρ<sub>s</sub>, sr⁻¹", |lobe| rgb(lobe.rho_s));
        coefficient("C<sub>x</sub>, C<sub>y</sub>, C<sub>z</sub>", |lobe| {
            lobe.c.to_array().map(|c| numbers::significant(f64::from(c), 3)).join(", ")
        });
        coefficient("n", |lobe| numbers::significant(f64::from(lobe.n), 3));
    }
    format!(
        "<table class=\"coefficients\"><thead>\
         <tr><th>coefficient</th><th>fitted</th><th>true</th></tr></thead>\
         <tbody>\n{rows}</tbody></table>\n"
    )
}

fn row(name: &str, fitted: Option<String>, truth: Option<String>) -> String {
    let text = |value: Option<String>| value.unwrap_or_else(|| "–".into());
    format!("<tr><td>{name}</td><td>{}</td><td>{}</td></tr>\n", text(fitted), text(truth))
}

/// Three channels to two digits.
fn rgb(value: Rgb) -> String {
    value.to_array().map(|channel| numbers::significant(f64::from(channel), 2)).join(" ")
}
