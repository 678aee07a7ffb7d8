//! The pose chooser: direction pairs that the rig reaches, inside the polar cuts, as far from each other as
//! can be.
//!
//! Farthest-point insertion over quasi-random candidates: each step takes the candidate that is farthest, in
//! the bi-angular distance, from all taken ones, so the spacing after k poses is known for every k and both a
//! spacing and a number can be asked for. Candidates are uniform in solid angle, so that the poles are not
//! oversampled.

use glam::DVec3;
use rayon::prelude::*;

use super::Extent;
use super::density;
use crate::rig::config::RigConfig;
use crate::rig::geometry::{MotorAngles, motor_angles};
use lobelia_base::error::{Error, Result};
use lobelia_base::progress;
use lobelia_reflectance::distance::{DirectionPair, MAX_THETA_I_DEG, MAX_THETA_O_DEG, distance};

/// Candidates for every pose that a budget asks for; more gain under 2 % of spacing.
const CANDIDATES_PER_POSE: usize = 150;

/// The most poses of a plan: a month of measuring at a minute a pose, three times what the source ever took.
const MOST_POSES: usize = 40_000;

/// The poses chosen and the least distance between two of them.
pub struct Chosen {
    /// Motor angles, first the ones that matter most.
    pub angles: Vec<MotorAngles>,
    /// Least bi-angular distance between two poses, degrees.
    pub spacing_deg: f64,
}

/// Chooses poses for the rig.
///
/// # Errors
/// When the extent asks for nothing, or the rig reaches no pose at all.
pub fn poses(config: &RigConfig, extent: Extent, isotropic: bool, seed: u64) -> Result<Chosen> {
    let (spacing, most) = match extent {
        Extent::Density(degrees) if degrees > 0.0 => (degrees.to_radians(), usize::MAX),
        Extent::SharpestExponent(n) if n >= 1.0 => {
            (if isotropic { density::spacing_3d(n) } else { density::spacing_4d(n) }, usize::MAX)
        }
        Extent::Budget(poses) if poses > 0 => (0.0, poses),
        Extent::Density(_) => return Err(Error::input("--density-deg must be above 0")),
        Extent::SharpestExponent(_) => return Err(Error::input("--sharpest-n must be at least 1")),
        Extent::Budget(_) => return Err(Error::input("--budget must be at least 1")),
    };
    let expected = if most == usize::MAX { expected_count(spacing, isotropic) } else { most };
    if expected > MOST_POSES {
        let message = format!("about {expected} poses would be needed, at most {MOST_POSES} can be planned");
        return Err(Error::input(message));
    }
    let wanted = expected.saturating_mul(CANDIDATES_PER_POSE).clamp(20_000, 2_000_000);
    let candidates = candidates(config, wanted, seed);
    if candidates.is_empty() {
        return Err(Error::input("the rig's limits leave no pose within the polar cuts of 75° and 65°"));
    }
    Ok(farthest_points(&candidates, (spacing, most, expected), isotropic))
}

/// Roughly how many poses a spacing (radians) admits: the volume of the direction pairs over that of a ball.
fn expected_count(spacing: f64, isotropic: bool) -> usize {
    // Solid angles of the two cuts, 4.66 and 3.63 sr; halved by reciprocity, and for isotropic pairs by
    // mirror and 2π.
    let volume = 4.66 * 3.63 / 2.0;
    let count = if isotropic {
        volume / (2.0 * std::f64::consts::TAU) / (0.52 * spacing.powi(3))
    } else {
        volume / (0.31 * spacing.powi(4))
    };
    count.min(1e9) as usize + 1
}

/// A direction pair and the motor angles that reach it.
struct Candidate {
    pair: DirectionPair,
    angles: MotorAngles,
}

/// Direction pairs from the additive recurrence of the generalised golden ratio in four dimensions, with
/// those that the rig cannot reach left out.
fn candidates(config: &RigConfig, count: usize, seed: u64) -> Vec<Candidate> {
    // The real root of x⁵ = x + 1; its inverse powers are the steps.
    const GOLDEN: f64 = 1.167_303_978_261_418_7;
    let offset = (seed % 1_000_003) as f64 * 0.618_033_988_749_894_9;
    let cap = |share: f64, max_deg: f64| 1.0 - share * (1.0 - max_deg.to_radians().cos());
    let direction = |z: f64, turn: f64| {
        let r = (1.0 - z * z).max(0.0).sqrt();
        let (sin, cos) = (turn * std::f64::consts::TAU).sin_cos();
        DVec3::new(r * cos, r * sin, z)
    };
    (0..count)
        .into_par_iter()
        .filter_map(|k| {
            let share = |power: i32| ((k + 1) as f64 * GOLDEN.powi(-power) + offset).fract();
            let wi = direction(cap(share(1), MAX_THETA_I_DEG), share(2));
            let wo = direction(cap(share(3), MAX_THETA_O_DEG), share(4));
            let angles = motor_angles(config, wi, wo)?;
            Some(Candidate { pair: DirectionPair { wi, wo }, angles })
        })
        .collect()
}

/// Takes the farthest candidate again and again until `most` are taken or none is `spacing` (radians) away;
/// about `expected` are foreseen.
fn farthest_points(
    candidates: &[Candidate],
    (spacing, most, expected): (f64, usize, usize),
    isotropic: bool,
) -> Chosen {
    // The first is the one nearest to looking straight down with the light at 30°.
    let light = DVec3::new(0.5, 0.0, 0.75f64.sqrt());
    let start = DirectionPair { wi: light, wo: DVec3::Z };
    let first = (0..candidates.len())
        .min_by(|&a, &b| {
            distance(candidates[a].pair, start, isotropic).total_cmp(&distance(
                candidates[b].pair,
                start,
                isotropic,
            ))
        })
        .unwrap_or(0);
    let mut nearest = vec![f64::INFINITY; candidates.len()];
    let mut angles = vec![candidates[first].angles];
    let mut last = candidates[first].pair;
    let mut reached = f64::INFINITY;
    let bar = progress::bar("choosing", expected as u64, "poses");
    while angles.len() < most {
        let farthest = nearest
            .par_iter_mut()
            .zip(candidates)
            .enumerate()
            .map(|(index, (near, candidate))| {
                *near = near.min(distance(candidate.pair, last, isotropic));
                (*near, index)
            })
            // Ties go to the smaller index, so that the order of threads does not matter.
            .reduce(|| (-1.0, 0), |a, b| if (b.0, a.1) > (a.0, b.1) { b } else { a });
        if farthest.0 <= 0.0 || farthest.0 < spacing {
            break;
        }
        reached = farthest.0;
        last = candidates[farthest.1].pair;
        angles.push(candidates[farthest.1].angles);
        bar.advance(1);
    }
    Chosen { angles, spacing_deg: if reached.is_finite() { reached.to_degrees() } else { 180.0 } }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::geometry::directions;

    fn pairs(config: &RigConfig, chosen: &Chosen) -> Vec<DirectionPair> {
        chosen
            .angles
            .iter()
            .map(|angles| {
                let (wi, wo) = directions(config, angles);
                DirectionPair { wi, wo }
            })
            .collect()
    }

    #[test]
    fn chosen_poses_keep_their_distance_and_the_polar_cuts() {
        let config = RigConfig::default();
        for isotropic in [true, false] {
            let chosen = poses(&config, Extent::Budget(80), isotropic, 1).unwrap();
            let pairs = pairs(&config, &chosen);
            assert_eq!(pairs.len(), 80);
            for (k, a) in pairs.iter().enumerate() {
                assert!(a.wi.z >= MAX_THETA_I_DEG.to_radians().cos() - 1e-6);
                assert!(a.wo.z >= MAX_THETA_O_DEG.to_radians().cos() - 1e-6);
                for b in &pairs[..k] {
                    assert!(distance(*a, *b, isotropic).to_degrees() >= chosen.spacing_deg - 1e-3);
                }
            }
        }
    }

    #[test]
    fn a_density_needs_fewer_poses_than_the_source_took() {
        let config = RigConfig::default();
        let chosen = poses(&config, Extent::Density(10.0), true, 1).unwrap();
        assert!((100..=385).contains(&chosen.angles.len()), "{} poses", chosen.angles.len());
    }

    #[test]
    fn any_direction_pair_has_a_pose_within_the_density_asked_for() {
        let config = RigConfig::default();
        let chosen = poses(&config, Extent::Density(15.0), true, 1).unwrap();
        let pairs = pairs(&config, &chosen);
        let others = candidates(&config, 3000, 77);
        let far = others.iter().filter(|other| {
            let near = pairs.iter().map(|pair| distance(*pair, other.pair, true)).fold(f64::MAX, f64::min);
            near.to_degrees() > 15.5
        });
        assert_eq!(far.count(), 0);
    }
}
