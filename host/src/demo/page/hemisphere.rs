//! Exitant hemispheres for one direction of light: equal-area discs, logarithmic colours.

use std::f64::consts::{FRAC_PI_6, SQRT_2};

use glam::Vec3;
use rayon::prelude::*;

use super::pick::{self, Chosen};
use crate::distance::MAX_THETA_O_DEG;
use crate::distance::{DirectionPair, distance};
use crate::error::Result;
use crate::page::colour_map::ColourMap;
use crate::page::html::{self, Raster};
use crate::page::scale::{Scale, quantile};
use crate::reflectance::{Brdf, SbrdfMap, colour};
use crate::sampled::SampledSbrdf;

/// Pixels across a disc.
const PIXELS: usize = 180;

/// The angle of incidence, 30°.
const THETA_I: f64 = FRAC_PI_6;

/// The light's direction.
fn light() -> Vec3 {
    pick::in_plane(-THETA_I)
}

/// The direction at a place of the unit disc (Lambert's equal-area projection, y up); `None` outside.
fn direction(x: f64, y: f64) -> Option<Vec3> {
    let r2 = x * x + y * y;
    // The rim is the horizon: z = 1 − r² is equal-area.
    let z = 1.0 - r2;
    let stretch = (1.0 + z).max(0.0).sqrt();
    (r2 < 1.0).then(|| Vec3::new((x * stretch) as f32, (y * stretch) as f32, z as f32))
}

/// Radius on the disc of an angle from the normal.
fn radius(theta: f64) -> f64 {
    SQRT_2 * (theta / 2.0).sin()
}

/// Values over the disc, row by row from the top; NaN outside.
fn disc(value: impl Fn(Vec3) -> f32 + Sync) -> Vec<f32> {
    let centre = |k: usize| (k as f64 + 0.5) / PIXELS as f64 * 2.0 - 1.0;
    let pixel = |k: usize| direction(centre(k % PIXELS), -centre(k / PIXELS)).map_or(f32::NAN, &value);
    (0..PIXELS * PIXELS).into_par_iter().map(pixel).collect()
}

/// Luminance of the measured sample nearest to each pair: as the source shows hemispheres.
fn measured(sampled: &SampledSbrdf, isotropic: bool, texel: usize) -> Vec<f32> {
    let pair = |wi: Vec3, wo: Vec3| DirectionPair { wi: wi.as_dvec3(), wo: wo.as_dvec3() };
    let valid = sampled.samples(texel).enumerate();
    let valid = valid.filter(|(pose, rgb)| rgb.is_finite() && sampled.poses[*pose].weight > 0.0);
    let samples: Vec<(DirectionPair, f32)> = valid
        .map(|(pose, rgb)| {
            let (wi, wo) = sampled.directions(texel, pose);
            (pair(wi, wo), colour::luminance(rgb))
        })
        .collect();
    disc(|wo| {
        let wanted = pair(light(), wo);
        let apart = samples.iter().map(|(own, value)| (distance(*own, wanted, isotropic), *value));
        apart.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(f32::NAN, |nearest| nearest.1)
    })
}

/// Measured, fitted and true hemispheres of one texel with their colour bar.
///
/// # Errors
/// When a picture cannot be encoded.
pub(super) fn discs(
    sampled: &SampledSbrdf,
    map: &SbrdfMap,
    isotropic: bool,
    texel: &Chosen<'_>,
) -> Result<String> {
    let measured = measured(sampled, isotropic, texel.index);
    let fitted = disc(|wo| colour::luminance(map.eval(texel.index, light(), wo)));
    let truth = disc(|wo| colour::luminance(texel.material.eval(light(), wo)));
    let all: Vec<f32> = [&fitted, &truth].into_iter().flatten().copied().collect();
    let high = quantile(&all, 1.0);
    // Nearest samples may be far ones: they do not set the range. Three decades at most: darker is dark.
    let scale = Scale::log(quantile(&all, 0.005).max(1e-3 * high), high);
    let figures = [
        (measured, "Measured", "the nearest sample’s luminance, without interpolation"),
        (fitted, "Fitted", "the lobes of the result"),
        (truth, "Truth", "what the simulator rendered"),
    ];
    let drawn = figures
        .iter()
        .map(|(values, name, what)| {
            let png = Raster::mapped(PIXELS, values, &scale, ColourMap::Viridis).png()?;
            Ok(html::figure(&hemisphere(&png, name), &format!("<b>{name}</b>: {what}")))
        })
        .collect::<Result<String>>()?;
    let bar = html::colour_bar(ColourMap::Viridis, &scale, "luminance of f, sr⁻¹", 5);
    Ok(format!("<div class=\"four discs\">{drawn}<div>{bar}</div></div>\n"))
}

/// A disc with rings at 30° and 60° and at the measured limit, the light and the mirror direction.
fn hemisphere(png: &[u8], name: &str) -> String {
    let ring = |deg: f64, class: &str| {
        format!("<circle class=\"{class}\" r=\"{:.1}\"/>", 100.0 * radius(deg.to_radians()))
    };
    let place = 100.0 * radius(THETA_I);
    let cross = |x: f64| format!("<path class=\"mark\" d=\"M{:.1} 0h8M{x:.1} -4v8\"/>", x - 4.0);
    format!(
        "<svg class=\"disc\" role=\"img\" aria-label=\"{name} exitant hemisphere\" viewBox=\"-106 -106 212 \
         212\"><image x=\"-100\" y=\"-100\" width=\"200\" height=\"200\" href=\"{}\"/>{}{}{}<circle \
         class=\"rim\" r=\"100\"/><circle class=\"mark\" cx=\"{:.1}\" r=\"4.5\"/>{}</svg>",
        html::data_uri(png),
        ring(30.0, "ring"),
        ring(60.0, "ring"),
        ring(MAX_THETA_O_DEG, "limit"),
        -place,
        cross(place)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_disc_is_equal_area_and_its_rim_the_horizon() {
        let inside = direction(0.5, 0.3).unwrap();
        assert!((inside.length() - 1.0).abs() < 1e-6);
        assert!((radius(std::f64::consts::FRAC_PI_2) - 1.0).abs() < 1e-12);
        assert!(direction(0.8, 0.7).is_none());
        // Half of the disc's area holds half of the hemisphere's solid angle: z above a half.
        let values = disc(|wo| f32::from(wo.z > 0.5));
        let (sum, count) =
            values.iter().filter(|v| v.is_finite()).fold((0.0, 0.0), |(s, n), v| (s + v, n + 1.0));
        assert!((sum / count - 0.5f32).abs() < 0.01);
    }
}
