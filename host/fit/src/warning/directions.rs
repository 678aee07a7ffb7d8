//! Where light and camera stood: poses that are not known, too few of them, and directions that leave the
//! shape of a lobe open.
//!
//! A lobe's base (4.1) is linear in the products ω_ix ω_ox, ω_iy ω_oy, ω_ix ω_oy + ω_iy ω_ox and ω_iz ω_oz,
//! an isotropic one's in the sum of the first two and the last. Its shape is determined where these, over all
//! poses, are linearly independent.

use glam::DVec3;

use crate::fit::linear::eigen;
use crate::fit::texel::unknowns;
use crate::fit::{FitOptions, MOST_LOBES};
use lobelia_base::warning::{Kind, Warning};
use lobelia_reflectance::sampled::PoseGeometry;

/// Directions count as in one plane when none is farther from it than this.
const IN_PLANE_DEG: f64 = 5.0;
/// A combination of the products counts as 0 when its RMS over the poses is below this; over poses all round
/// it is 0.1 or more.
const LEAST_PRODUCT: f64 = 0.02;

/// Unit directions toward light and camera from the sample's centre at the poses that are not left out.
pub fn of_poses(poses: &[PoseGeometry]) -> Vec<(DVec3, DVec3)> {
    let kept = poses.iter().filter(|pose| pose.weight > 0.0);
    kept.map(|pose| (pose.light_mm.normalize(), pose.camera_mm.normalize())).collect()
}

/// Names poses of which it is not known where light or camera stood; they are left out.
pub fn unknown_poses(poses: &[usize]) -> Option<Warning> {
    let (first, others) = poses.split_first()?;
    let list: Vec<String> = others.iter().take(9).map(|pose| format!(", {pose}")).collect();
    let more = match others.len().saturating_sub(9) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    let (word, are) = if others.is_empty() { ("pose", "is") } else { ("poses", "are") };
    let text = format!(
        "{word} {first}{}{more} {are} left out: position of light or camera, or weight, is not a number \
         (NaN)",
        list.concat()
    );
    Some(Warning { poses: poses.to_vec(), ..Warning::new(Kind::UnknownPose, text) })
}

/// What `lobelia fit` does with samples by itself: as many lobes as they support.
pub fn by_default(isotropic: bool) -> FitOptions {
    FitOptions { lobes: MOST_LOBES, choose: true, isotropic, ..FitOptions::default() }
}

/// Warns where `poses` poses are too few for the lobes of a fit.
pub fn too_few(poses: usize, options: &FitOptions) -> Option<Warning> {
    let enough = |lobes: &usize| poses > unknowns(*lobes, options);
    if enough(&options.lobes) {
        return None;
    }
    let needed = unknowns(options.lobes, options);
    let most = match (0..options.lobes).rev().find(enough).unwrap_or(0) {
        0 => "a fit can have no lobe".to_string(),
        1 => "a fit can have 1 lobe at most".to_string(),
        lobes => format!("a fit can have {lobes} lobes at most"),
    };
    let word = if poses == 1 { "pose" } else { "poses" };
    let kind = if options.isotropic { "isotropic" } else { "anisotropic" };
    let lobes = if options.lobes == 1 { "lobe" } else { "lobes" };
    let text = format!(
        "{poses} {word} for the {needed} unknowns of {} {kind} {lobes}: {most}; more poses are needed",
        options.lobes
    );
    Some(Warning::new(Kind::FewPoses, text))
}

/// Warns where the directions (toward light and camera) leave the shape of a lobe open.
pub fn shape(directions: &[(DVec3, DVec3)], isotropic: bool) -> Option<Warning> {
    if directions.len() < 2 {
        return None;
    }
    if let Some((azimuth_deg, off_deg)) = plane(directions) {
        let open = if isotropic {
            "nothing was seen out of that plane"
        } else {
            "Cy and β of a lobe are not determined"
        };
        let text = format!(
            "light and camera are always in one plane through the normal (at {azimuth_deg:.0}° from x, \
             within {off_deg:.1}°): {open}; add poses with the sample turned or tilted out of it"
        );
        return Some(Warning::new(Kind::Shape, text));
    }
    if least_product(directions, isotropic) < LEAST_PRODUCT {
        let text = "the directions of light and camera are too much alike to determine the shape of a lobe; \
             add poses in which both stand away from the normal, on different sides";
        return Some(Warning::new(Kind::Shape, text));
    }
    None
}

/// The plane through the normal in which all directions lie, if there is one: its angle from x and the
/// largest angle to it, degrees.
fn plane(directions: &[(DVec3, DVec3)]) -> Option<(f64, f64)> {
    let all = || directions.iter().flat_map(|&(wi, wo)| [wi, wo]);
    let mut scatter = [0.0; 4];
    for d in all() {
        scatter[0] += d.x * d.x;
        scatter[1] += d.x * d.y;
        scatter[3] += d.y * d.y;
    }
    // The direction of largest scatter: half the angle of the doubled angles' mean.
    let azimuth = 0.5 * (2.0 * scatter[1]).atan2(scatter[0] - scatter[3]);
    let (sin, cos) = azimuth.sin_cos();
    let off = all().map(|d| (cos * d.y - sin * d.x).clamp(-1.0, 1.0).asin().abs()).fold(0.0, f64::max);
    let off_deg = off.to_degrees();
    (off_deg < IN_PLANE_DEG).then(|| (azimuth.to_degrees().round() + 0.0, off_deg))
}

/// The least RMS over the poses of a combination of the products with unit coefficients.
fn least_product(directions: &[(DVec3, DVec3)], isotropic: bool) -> f64 {
    let size = if isotropic { 2 } else { 4 };
    let mut gram = vec![0.0; size * size];
    for &(wi, wo) in directions {
        let (xx, yy, zz) = (wi.x * wo.x, wi.y * wo.y, wi.z * wo.z);
        let products = [xx, yy, wi.x * wo.y + wi.y * wo.x, zz];
        let row = if isotropic { vec![xx + yy, zz] } else { products.to_vec() };
        for (i, a) in row.iter().enumerate() {
            for (j, b) in row.iter().enumerate() {
                gram[i * size + j] += a * b / directions.len() as f64;
            }
        }
    }
    eigen(&mut gram, &mut vec![0.0; size * size], size);
    let least = (0..size).map(|k| gram[k * (size + 1)]).fold(f64::INFINITY, f64::min);
    least.max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth;
    use lobelia_measure::plan::{self, Extent};
    use lobelia_measure::rig::config::RigConfig;
    use lobelia_measure::rig::geometry::directions;

    fn direction(theta_deg: f64, phi_deg: f64) -> DVec3 {
        let (theta, phi) = (theta_deg.to_radians(), phi_deg.to_radians());
        DVec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos())
    }

    /// Light and camera at any polar angles, on either side, in the plane at an azimuth.
    fn in_plane(azimuth_deg: f64, wobble_deg: f64) -> Vec<(DVec3, DVec3)> {
        let at = |k: usize, step: f64| {
            let theta = (k as f64 * step) % 130.0 - 65.0;
            direction(theta, azimuth_deg + if k.is_multiple_of(2) { wobble_deg } else { -wobble_deg })
        };
        (0..40).map(|k| (at(k, 37.0), at(k, 53.0))).collect()
    }

    #[test]
    fn poses_all_round_determine_shapes_whether_planned_or_random() {
        let rig = RigConfig::default();
        for isotropic in [true, false] {
            for poses in [20, 80] {
                let plan = plan::make(&rig, Extent::Budget(poses), isotropic, 1).unwrap();
                let planned: Vec<_> = (0..poses).map(|k| directions(&rig, &plan.angles(k))).collect();
                assert!(least_product(&planned, isotropic) > 3.0 * LEAST_PRODUCT);
                assert_eq!(shape(&planned, isotropic), None);
                assert_eq!(shape(&of_poses(&synth::poses(poses, 3)), isotropic), None);
            }
        }
    }

    #[test]
    fn a_plane_is_found_with_its_azimuth_and_directions_out_of_it_are_none() {
        for isotropic in [true, false] {
            let found = shape(&in_plane(30.0, 1.0), isotropic).unwrap();
            assert!(found.kind == Kind::Shape && found.text.contains("at 30° from x"), "{}", found.text);
        }
        // Pairs in two planes tell of isotropic lobes all there is, of anisotropic ones two of three
        // products.
        assert_eq!(shape(&in_plane(30.0, 20.0), true), None);
        assert!(shape(&in_plane(30.0, 20.0), false).unwrap().text.contains("too much alike"));
    }

    #[test]
    fn a_camera_that_only_looks_along_the_normal_tells_no_shape_and_an_oblique_one_does() {
        let lights = || (0..60).map(|k| direction(10.0 + f64::from(k), 40.0 * f64::from(k)));
        let along: Vec<_> = lights().map(|wi| (wi, DVec3::Z)).collect();
        let oblique: Vec<_> = lights().map(|wi| (wi, direction(40.0, 0.0))).collect();
        for isotropic in [true, false] {
            assert!(shape(&along, isotropic).unwrap().text.contains("too much alike"));
        }
        assert_eq!(shape(&oblique, true), None);
    }

    #[test]
    fn poses_without_a_weight_are_not_looked_at() {
        let mut poses = synth::poses(4, 1);
        poses[2].weight = 0.0;
        assert_eq!(of_poses(&poses).len(), 3);
    }

    #[test]
    fn too_few_poses_are_told_with_what_they_are_enough_for() {
        let options = by_default(true);
        assert_eq!((unknowns(4, &options), unknowns(2, &by_default(false))), (13, 10));
        assert_eq!(too_few(14, &options), None);
        for (poses, words) in
            [(13, "3 lobes at most"), (5, "1 lobe at most"), (4, "no lobe"), (1, "1 pose for")]
        {
            let found = too_few(poses, &options).unwrap();
            assert!(found.kind == Kind::FewPoses && found.text.contains(words), "{}", found.text);
        }
    }

    #[test]
    fn unknown_poses_are_named() {
        assert_eq!(unknown_poses(&[]), None);
        let one = unknown_poses(&[3]).unwrap();
        assert!(one.text.starts_with("pose 3 is left out") && one.poses == [3], "{}", one.text);
        let many: Vec<usize> = (0..12).collect();
        assert!(unknown_poses(&many).unwrap().text.contains(", 9 and 2 more are left out"));
    }
}
