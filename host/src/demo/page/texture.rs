//! The registered texture under three lights.

use super::pick;
use crate::demo::DemoOutcome;
use crate::error::Result;
use crate::page::html::{self, Raster};
use crate::page::numbers;
use crate::page::scale::quantile;
use crate::reflectance::{Rgb, colour};
use crate::sampled::SampledSbrdf;

/// The section.
pub(super) fn section(outcome: &DemoOutcome) -> Result<String> {
    let sampled = &outcome.developed.sampled;
    let figures = pick::three_lights(sampled)
        .into_iter()
        .map(|pose| texture(sampled, pose))
        .collect::<Result<String>>()?;
    let lead = format!(
        "All photographs resampled to the same {} × {} texels of {} mm, in three poses seen from near the \
         normal. Shown is measured reflectance times cos θ<sub>i</sub>: how bright each texel looks under \
         that light.",
        numbers::count(sampled.width),
        numbers::count(sampled.height),
        numbers::significant(sampled.texel_mm, 3)
    );
    Ok(html::section(
        "texture",
        "The texture under three lights",
        &lead,
        &format!("<div class=\"three\">{figures}</div>\n"),
    ))
}

/// One pose's texture.
fn texture(sampled: &SampledSbrdf, pose: usize) -> Result<String> {
    let value = |texel: usize| {
        let (wi, _) = sampled.directions(texel, pose);
        let start = 3 * (texel * sampled.poses.len() + pose);
        Rgb::from_slice(&sampled.reflectance[start..start + 3]) * wi.z.max(0.0)
    };
    let values: Vec<Rgb> = (0..sampled.texels()).map(value).collect();
    let brightest: Vec<f32> = values.iter().map(|rgb| rgb.max_element()).collect();
    let white = quantile(&brightest, 0.995).max(1e-6);
    let raster =
        Raster::opaque(sampled.width, sampled.height, |k| colour::to_srgb8(values[k] / white as f32));
    let missing = values.iter().filter(|rgb| !rgb.is_finite()).count();
    let missing = if missing == 0 {
        String::new()
    } else {
        format!(" {} texels without a valid exposure are black.", numbers::count(missing))
    };
    let (wi, wo) = pick::central_directions(sampled, pose);
    let caption = format!(
        "<b>Pose {pose}</b>: light at θ<sub>i</sub> = {}, φ<sub>i</sub> = {}; camera at θ<sub>o</sub> = {}. \
         White is {} sr⁻¹.{missing}",
        numbers::degrees(pick::polar(wi)),
        numbers::degrees(pick::azimuth(wi)),
        numbers::degrees(pick::polar(wo)),
        numbers::significant(white, 2)
    );
    let alt = format!("registered texture, light {} from the normal", numbers::degrees(pick::polar(wi)));
    Ok(html::figure(&html::picture(&raster.png()?, &alt, "texels"), &caption))
}
