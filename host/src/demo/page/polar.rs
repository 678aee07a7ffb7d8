//! Polar plots of reflectance in the plane of incidence.

use std::f64::consts::FRAC_PI_2;

use glam::Vec3;

use super::pick::{self, Chosen};
use crate::distance::{DirectionPair, distance};
use crate::page::numbers;
use crate::page::scale::Scale;
use crate::reflectance::{Brdf, SbrdfMap, colour};
use crate::sampled::SampledSbrdf;

/// Angles of incidence shown, degrees.
pub(super) const INCIDENCES_DEG: [f64; 3] = [0.0, 30.0, 60.0];

/// Samples farther than this from the plane's pairs are not shown, degrees.
pub(super) const NEAR_DEG: f64 = 8.0;

/// Curves end at this angle from the normal.
const LAST_DEG: f64 = 80.0;

/// Centre and radius of the half disc in a drawing of 560 × 300.
const CENTRE: (f64, f64) = (280.0, 264.0);
const RADIUS: f64 = 232.0;

/// A measured sample near the plane of incidence.
struct Near {
    /// Angle of the nearest direction in the plane, radians.
    theta_o: f64,
    /// Measured luminance, sr⁻¹.
    measured: f64,
    /// The fit's luminance at the sample's own directions.
    fitted: f64,
}

/// One angle of incidence: curves and samples.
struct Curves {
    theta_i: f64,
    /// θ_o, fitted and true luminance.
    points: Vec<(f64, f64, f64)>,
    samples: Vec<Near>,
}

/// The plot of one texel.
pub(super) fn plot(sampled: &SampledSbrdf, map: &SbrdfMap, isotropic: bool, texel: &Chosen<'_>) -> String {
    let curves: Vec<Curves> = INCIDENCES_DEG
        .iter()
        .map(|deg| {
            let theta_i = deg.to_radians();
            let samples = near_samples(sampled, map, isotropic, texel.index, theta_i);
            Curves { theta_i, points: curve(map, texel, theta_i), samples }
        })
        .collect();
    let values = curves.iter().flat_map(|curve| {
        let lines = curve.points.iter().map(|(_, fitted, truth)| fitted.max(*truth));
        lines.chain(curve.samples.iter().map(|sample| sample.measured))
    });
    let scale = Scale::linear(0.0, values.fold(1e-6, f64::max) * 1.04);
    let drawn: String = curves.iter().enumerate().map(|(k, curve)| draw(&scale, k, curve)).collect();
    format!(
        "<svg role=\"img\" aria-label=\"polar plot of reflectance in the plane of incidence\" viewBox=\"0 0 \
         560 300\">{}{drawn}</svg>",
        grid(&scale)
    )
}

/// Luminance of the fit and the truth along the plane.
fn curve(map: &SbrdfMap, texel: &Chosen<'_>, theta_i: f64) -> Vec<(f64, f64, f64)> {
    let wi = pick::in_plane(-theta_i);
    let last = LAST_DEG as i32;
    (-2 * last..=2 * last)
        .map(|half| {
            let theta_o = (f64::from(half) / 2.0).to_radians();
            let wo = pick::in_plane(theta_o);
            let fitted = colour::luminance(map.eval(texel.index, wi, wo));
            (theta_o, f64::from(fitted), f64::from(colour::luminance(texel.material.eval(wi, wo))))
        })
        .collect()
}

/// The measured samples near pairs of the plane, each at the pair that it is nearest to.
fn near_samples(
    sampled: &SampledSbrdf,
    map: &SbrdfMap,
    isotropic: bool,
    texel: usize,
    theta_i: f64,
) -> Vec<Near> {
    let pair = |wi: Vec3, wo: Vec3| DirectionPair { wi: wi.as_dvec3(), wo: wo.as_dvec3() };
    let wi_plane = pick::in_plane(-theta_i);
    let last = LAST_DEG as i32;
    let place = |(pose, rgb): (usize, Vec3)| {
        let (wi, wo) = sampled.directions(texel, pose);
        let apart = |theta: f64| distance(pair(wi, wo), pair(wi_plane, pick::in_plane(theta)), isotropic);
        let angles = (-last..=last).map(|deg| f64::from(deg).to_radians());
        let (least, theta_o) =
            angles.map(|theta| (apart(theta), theta)).min_by(|a, b| a.0.total_cmp(&b.0))?;
        (least <= NEAR_DEG.to_radians() && rgb.is_finite()).then(|| Near {
            theta_o,
            measured: f64::from(colour::luminance(rgb)),
            fitted: f64::from(colour::luminance(map.eval(texel, wi, wo))),
        })
    };
    let kept = sampled.samples(texel).enumerate().filter(|(pose, _)| sampled.poses[*pose].weight > 0.0);
    kept.filter_map(place).collect()
}

/// Where a reflectance at an angle is drawn.
fn at(scale: &Scale, theta: f64, value: f64) -> (f64, f64) {
    let radius = RADIUS * scale.place(value).clamp(0.0, 1.0);
    (CENTRE.0 + radius * theta.sin(), CENTRE.1 - radius * theta.cos())
}

/// Rings at round reflectances, spokes every 30°.
fn grid(scale: &Scale) -> String {
    let (x, y) = CENTRE;
    let mut drawn = String::new();
    for value in scale.ticks(4).into_iter().filter(|value| *value > 0.0) {
        let r = RADIUS * scale.place(value);
        drawn += &format!(
            "<path class=\"grid\" d=\"M{:.1} {y}A{r:.1} {r:.1} 0 0 1 {:.1} {y}\"/><text class=\"middle\" \
             x=\"{:.1}\" y=\"{:.1}\">{}</text>",
            x - r,
            x + r,
            x + r,
            y + 16.0,
            numbers::tick(value)
        );
    }
    for deg in [-60, -30, 0, 30, 60] {
        let (sin, cos) = f64::from(deg).to_radians().sin_cos();
        let (ex, ey) = (x + RADIUS * sin, y - RADIUS * cos);
        let (tx, ty) = (x + (RADIUS + 16.0) * sin, y - (RADIUS + 12.0) * cos + 4.0);
        let text = numbers::degrees(f64::from(deg).to_radians());
        drawn += &format!(
            "<path class=\"grid\" d=\"M{x} {y}L{ex:.1} {ey:.1}\"/><text class=\"middle\" x=\"{tx:.1}\" \
             y=\"{ty:.1}\">{text}</text>"
        );
    }
    drawn += &format!("<path class=\"axis\" d=\"M{} {y}h{}\"/>", x - RADIUS, 2.0 * RADIUS);
    drawn += &format!("<text class=\"middle\" x=\"{x}\" y=\"{:.1}\">0</text>", y + 16.0);
    drawn
        + &format!(
            "<text class=\"middle name\" x=\"{x}\" y=\"{:.1}\">luminance of f, sr⁻¹, by θₒ; light from the \
             left</text>",
            y + 32.0
        )
}

/// The truth as a broad band, the fit as a line in it, samples as circles, and where the light comes from.
fn draw(scale: &Scale, k: usize, curves: &Curves) -> String {
    let path = |value: fn(&(f64, f64, f64)) -> f64| {
        let points = curves.points.iter().map(|point| {
            let (x, y) = at(scale, point.0, value(point));
            format!("{x:.1} {y:.1}")
        });
        format!("M{}", points.collect::<Vec<_>>().join("L"))
    };
    let mut drawn = format!(
        "<path class=\"truth c{k}\" d=\"{}\"/><path class=\"fitted c{k}\" d=\"{}\"/>",
        path(|point| point.2),
        path(|point| point.1)
    );
    for sample in &curves.samples {
        let (x, y) = at(scale, sample.theta_o, sample.measured);
        let (fx, fy) = at(scale, sample.theta_o, sample.fitted);
        drawn += &format!(
            "<path class=\"whisker c{k}\" d=\"M{x:.1} {y:.1}L{fx:.1} {fy:.1}\"/><circle class=\"sample \
             c{k}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.5\"/>"
        );
    }
    drawn + &light_mark(k, curves.theta_i)
}

/// An arrow head on the rim, pointing in from the light.
fn light_mark(k: usize, theta_i: f64) -> String {
    let place = |radius: f64, turn: f64| {
        let theta = (-theta_i + turn).clamp(-FRAC_PI_2, FRAC_PI_2);
        format!("{:.1},{:.1}", CENTRE.0 + radius * theta.sin(), CENTRE.1 - radius * theta.cos())
    };
    let points = [place(RADIUS - 12.0, 0.0), place(RADIUS, -0.022), place(RADIUS, 0.022)];
    format!("<polygon class=\"light c{k}\" points=\"{}\"/>", points.join(" "))
}

/// The legend, HTML.
pub(super) fn legend() -> String {
    let incidence =
        |(k, deg): (usize, &f64)| format!("<span class=\"key c{k}\">θ<sub>i</sub> = {deg:.0}°</span>");
    let colours: String = INCIDENCES_DEG.iter().enumerate().map(incidence).collect();
    format!(
        "<p class=\"legend\">{colours}<span><svg class=\"swatch\" viewBox=\"0 0 28 12\"><path \
         class=\"truth\" d=\"M1 6h26\"/><path class=\"fitted\" d=\"M1 6h26\"/></svg>fitted (line) on the \
         truth (band)</span><span><svg class=\"swatch\" viewBox=\"0 0 28 12\"><path class=\"whisker\" d=\"M8 \
         6h16\"/><circle class=\"sample\" cx=\"8\" cy=\"6\" r=\"3.5\"/></svg>measured sample within \
         {NEAR_DEG:.0}° of the plane’s pair, with a stroke to the fit at that sample’s own \
         directions</span></p>\n"
    )
}
