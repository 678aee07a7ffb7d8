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

/// The texels of median error of the glossiest and the mattest material, each inside its material; at an edge
/// of the pattern only where no material has a texel with neighbours of its own all around.
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
    let mut chosen: Vec<(usize, Chosen<'_>)> = Vec::new();
    for kind in kinds {
        let own: Vec<bool> = materials.iter().map(|&found| std::ptr::eq(found, kind)).collect();
        let (margin, texels) = innermost(&own, sampled.width);
        let index = median_of(&texels, &outcome.fits.result.errors);
        chosen.extend(index.map(|index| (margin, Chosen { index, material: kind })));
    }
    let widest = chosen.iter().map(|(margin, _)| *margin).max().unwrap_or(0);
    chosen.retain(|(margin, _)| *margin >= widest.min(1));
    let last = chosen.len().saturating_sub(1);
    let ends = chosen.into_iter().enumerate().filter(|(place, _)| *place == 0 || *place == last);
    ends.map(|(_, (_, chosen))| chosen).collect()
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

/// The texels of `own` that are the farthest from any other, and how many texels of their own they have
/// around them on every side, at most [`MARGIN`]; the sample's border counts as an edge.
fn innermost(own: &[bool], width: usize) -> (usize, Vec<usize>) {
    let height = own.len() / width.max(1);
    let is_own = |x: i64, y: i64| {
        let within = (0..width as i64).contains(&x) && (0..height as i64).contains(&y);
        within && own[y as usize * width + x as usize]
    };
    let inside = |texel: usize, margin: i64| {
        let (x, y) = ((texel % width) as i64, (texel / width) as i64);
        (-margin..=margin).all(|dy| (-margin..=margin).all(|dx| is_own(x + dx, y + dy)))
    };
    let of = |margin: usize| -> Vec<usize> {
        (0..own.len()).filter(|&texel| inside(texel, margin as i64)).collect()
    };
    let margins = (0..=MARGIN).rev().map(|margin| (margin, of(margin)));
    margins.into_iter().find(|(_, texels)| !texels.is_empty()).unwrap_or_default()
}

/// The texel of median error.
fn median_of(texels: &[usize], errors: &[f32]) -> Option<usize> {
    let error = |texel: usize| errors.get(texel).copied().unwrap_or(f32::NAN);
    let mut sorted = texels.to_vec();
    sorted.sort_by(|&a, &b| error(a).total_cmp(&error(b)).then(a.cmp(&b)));
    sorted.get(sorted.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_texel_lies_inside_its_material_and_not_at_an_edge() {
        // Columns 5 to 11 of 16 × 9 texels, with a hole at (8, 4); errors are least in the middle column and
        // largest at the edges.
        let own: Vec<bool> = (0..144).map(|k| (5..12).contains(&(k % 16)) && k != 4 * 16 + 8).collect();
        let errors: Vec<f32> = (0..144).map(|k| (k % 16) as f32 - 8.0).map(f32::abs).collect();
        let (margin, texels) = innermost(&own, 16);
        // With two texels around none is left by the hole but those above and below it.
        assert_eq!(margin, 1);
        for &texel in &texels {
            let (x, y) = (texel % 16, texel / 16);
            assert!((6..11).contains(&x) && (1..8).contains(&y), "({x}, {y})");
            assert!(x.abs_diff(8) > 1 || y.abs_diff(4) > 1, "({x}, {y})");
        }
        let median = median_of(&texels, &errors).unwrap();
        let below = texels.iter().filter(|&&texel| errors[texel] < errors[median]).count();
        assert!(texels.contains(&median) && below <= texels.len() / 2);
        assert_eq!(innermost(&own, 16), innermost(&own, 16));
    }

    #[test]
    fn threads_of_one_texel_have_no_inside() {
        let own: Vec<bool> = (0..64).map(|k| k % 2 == 0).collect();
        let (margin, texels) = innermost(&own, 8);
        assert_eq!((margin, texels.len()), (0, 32));
        assert_eq!(innermost(&[false; 4], 2), (0, Vec::new()));
        assert_eq!(median_of(&[], &[]), None);
    }
}
