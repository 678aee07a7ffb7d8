//! What the page shows of much: poses and texels, chosen the same way every time.

use std::f64::consts::TAU;

use glam::Vec3;
use lobelia_hil_sim::optics::Material;

use crate::demo::DemoOutcome;
use crate::reflectance::{Brdf, colour};
use crate::sampled::SampledSbrdf;

/// Texels around one that must be of its material, each way, where the pattern is coarse enough.
const MARGIN: usize = 2;

/// Directions toward light and camera at the middle of the sample.
pub(super) fn central_directions(sampled: &SampledSbrdf, pose: usize) -> (Vec3, Vec3) {
    let geometry = &sampled.poses[pose];
    (geometry.light_mm.normalize().as_vec3(), geometry.camera_mm.normalize().as_vec3())
}

/// Angle from the normal, radians.
pub(super) fn polar(direction: Vec3) -> f64 {
    f64::from(direction.z.clamp(-1.0, 1.0)).acos()
}

/// Angle about the normal, 0..2π.
pub(super) fn azimuth(direction: Vec3) -> f64 {
    f64::from(direction.y).atan2(f64::from(direction.x)).rem_euclid(TAU)
}

/// A direction in the plane of incidence: the light comes from the negative side.
pub(super) fn in_plane(theta: f64) -> Vec3 {
    Vec3::new(theta.sin() as f32, 0.0, theta.cos() as f32)
}

/// Three poses seen from near the normal with the light high, oblique and low, from different sides.
pub(super) fn three_lights(sampled: &SampledSbrdf) -> Vec<usize> {
    let mut chosen: Vec<usize> = Vec::new();
    for target in [12.0, 40.0, 68.0] {
        let cost = |pose: usize| {
            let (wi, wo) = central_directions(sampled, pose);
            let side = |other: &usize| {
                let apart = (azimuth(wi) - azimuth(central_directions(sampled, *other).0)).cos().acos();
                (80.0 - apart.to_degrees()).max(0.0) * 0.3
            };
            let same_side: f64 = chosen.iter().map(side).sum();
            (polar(wi).to_degrees() - target).abs() + 0.7 * polar(wo).to_degrees() + same_side
        };
        let free = (0..sampled.poses.len()).filter(|k| sampled.poses[*k].weight > 0.0 && !chosen.contains(k));
        chosen.extend(free.min_by(|&a, &b| cost(a).total_cmp(&cost(b))));
    }
    chosen
}

/// A texel that the page looks at closely.
pub(super) struct Chosen<'a> {
    /// Row · width + column.
    pub(super) index: usize,
    /// What really lies there.
    pub(super) material: &'a Material,
}

/// The texels of median error, away from edges of the pattern, of the glossiest and the mattest material.
pub(super) fn two_texels(outcome: &DemoOutcome) -> Vec<Chosen<'_>> {
    let sampled = &outcome.developed.sampled;
    let materials: Vec<&Material> = (0..sampled.texels()).map(|texel| material(outcome, texel)).collect();
    let mut kinds: Vec<&Material> = Vec::new();
    for &found in &materials {
        if !kinds.iter().any(|kind| std::ptr::eq(*kind, found)) {
            kinds.push(found);
        }
    }
    kinds.sort_by(|a, b| gloss(b).total_cmp(&gloss(a)));
    let ends = if kinds.len() > 1 { vec![kinds[0], kinds[kinds.len() - 1]] } else { kinds };
    let typical = |kind| Some(Chosen { index: typical_texel(outcome, &materials, kind)?, material: kind });
    ends.into_iter().filter_map(typical).collect()
}

/// What lies at a texel's centre.
fn material(outcome: &DemoOutcome, texel: usize) -> &Material {
    let place = outcome.developed.sampled.position_mm(texel);
    outcome.bench.config().sample.at(place.x, place.y)
}

/// Luminance of the mirror direction at 30°.
fn gloss(material: &Material) -> f32 {
    let theta = 30f64.to_radians();
    colour::luminance(material.eval(in_plane(-theta), in_plane(theta)))
}

/// The texel of median error among those of `kind` with the widest margin that there is.
fn typical_texel(outcome: &DemoOutcome, materials: &[&Material], kind: &Material) -> Option<usize> {
    let (width, height) = (outcome.developed.sampled.width, outcome.developed.sampled.height);
    let inside = |texel: usize, margin: usize| {
        let (x, y) = (texel % width, texel / width);
        let near = |at: usize, length: usize| at.saturating_sub(margin)..=(at + margin).min(length - 1);
        near(y, height)
            .all(|row| near(x, width).all(|column| std::ptr::eq(materials[row * width + column], kind)))
    };
    let errors = outcome.fits.last().map(|fit| fit.errors.as_slice()).unwrap_or_default();
    (0..=MARGIN).rev().find_map(|margin| {
        let mut texels: Vec<usize> = (0..materials.len()).filter(|&texel| inside(texel, margin)).collect();
        let error = |texel: usize| errors.get(texel).copied().unwrap_or(f32::NAN);
        texels.sort_by(|&a, &b| error(a).total_cmp(&error(b)).then(a.cmp(&b)));
        texels.get(texels.len() / 2).copied()
    })
}
