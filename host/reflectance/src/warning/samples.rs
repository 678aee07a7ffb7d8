//! Samples by pose that are of no use: saturated in every exposure, darker than their noise, or not there.

use std::sync::{Mutex, PoisonError};

use serde::Serialize;

use crate::sampled::SampledSbrdf;
use lobelia_base::warning::{Kind, Warning, named, percent};

/// How the samples of one pose fared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PoseSamples {
    /// Samples that were looked at, one a texel.
    pub all: u64,
    /// Those that are saturated in every exposure.
    pub clipped: u64,
    /// Those of which no exposure shows more than its noise: the sum of the channels is below that of their
    /// standard deviations.
    pub starved: u64,
    /// Those that are not there for another reason: outside the photograph, or unlit.
    pub missing: u64,
}

impl PoseSamples {
    /// One sample with the standard deviations of its channels; `shown` where the photograph shows it, and
    /// lit.
    pub fn of_one(value: [f32; 3], sigma: [f32; 3], shown: bool) -> Self {
        let there = value.iter().all(|value| value.is_finite());
        Self {
            all: 1,
            clipped: u64::from(!there && shown),
            starved: u64::from(there && value.iter().sum::<f32>() < sigma.iter().sum::<f32>()),
            missing: u64::from(!there && !shown),
        }
    }

    /// Adds those of another part of the sample.
    pub fn add(&mut self, other: Self) {
        self.all += other.all;
        self.clipped += other.clipped;
        self.starved += other.starved;
        self.missing += other.missing;
    }

    fn share(&self, count: u64) -> f64 {
        if self.all == 0 { 0.0 } else { count as f64 / self.all as f64 }
    }

    /// Share of the samples that are clipped.
    pub fn clipped_share(&self) -> f64 {
        self.share(self.clipped)
    }
}

/// What counts the samples, which decides what can be done about them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// A prediction from the plan's exposures and the rig's range of reflectances.
    Plan,
    /// The photographs of a run as they come in.
    Acquire,
    /// The developed photographs.
    Develop,
    /// The samples of a store.
    Fit,
}

/// A pose is named when more than this share of its samples is of no use.
const MOST_OF_A_POSE: f64 = 0.1;
/// So are the worst ones when more than this share of all samples is.
const MOST_OF_ALL: f64 = 0.02;

/// Name of the report's figure with [`by_pose`].
pub const BY_POSE: &str = "samples_by_pose";

/// Shares of a pose as the report has them.
#[derive(Debug, Serialize)]
struct Shares {
    pose: usize,
    clipped: f64,
    starved: f64,
    missing: f64,
}

/// The shares of every pose for the report: `[{"pose": 0, "clipped": 0.57, "starved": 0.0, "missing": 0.0},
/// …]`.
pub fn by_pose(counts: &[(usize, PoseSamples)]) -> serde_json::Value {
    let rounded = |share: f64| (1e4 * share).round() / 1e4;
    let shares = counts.iter().map(|&(pose, samples)| Shares {
        pose,
        clipped: rounded(samples.share(samples.clipped)),
        starved: rounded(samples.share(samples.starved)),
        missing: rounded(samples.share(samples.missing)),
    });
    serde_json::json!(shares.collect::<Vec<_>>())
}

/// One warning for each way in which too many samples, of a pose or of all, are of no use. Poses without any
/// sample count as none.
pub fn warnings(step: Step, counts: &[(usize, PoseSamples)]) -> Vec<Warning> {
    [Kind::Clipped, Kind::Starved, Kind::Missing]
        .into_iter()
        .filter_map(|kind| {
            let (poses, text) = worst(kind, counts)?;
            let text = format!("{} {text}; {}", what(step, kind), advice(step, kind));
            Some(Warning { poses, ..Warning::new(kind, text) })
        })
        .collect()
}

/// The poses that are to be named, the worst first, and how bad all and they are.
fn worst(kind: Kind, counts: &[(usize, PoseSamples)]) -> Option<(Vec<usize>, String)> {
    let of = |samples: &PoseSamples| {
        samples.share(match kind {
            Kind::Clipped => samples.clipped,
            Kind::Starved => samples.starved,
            _ => samples.missing,
        })
    };
    let mut total = PoseSamples::default();
    counts.iter().for_each(|&(_, samples)| total.add(samples));
    let mut poses: Vec<(usize, f64)> =
        counts.iter().map(|(pose, samples)| (*pose, of(samples))).filter(|&(_, share)| share > 0.0).collect();
    poses.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    let bad = poses.iter().filter(|&&(_, share)| share > MOST_OF_A_POSE).count();
    let many = of(&total) > MOST_OF_ALL;
    if bad == 0 && !many {
        return None;
    }
    poses.truncate(bad.max(usize::from(many)));
    let list: Vec<(usize, String)> = poses.iter().map(|&(pose, share)| (pose, percent(share))).collect();
    let text = format!("{} of all, most in {}", percent(of(&total)), named(&list));
    Some((poses.into_iter().map(|(pose, _)| pose).collect(), text))
}

fn what(step: Step, kind: Kind) -> &'static str {
    match (step, kind) {
        (Step::Plan, Kind::Clipped) => "reflectances expected to be saturated even in the shortest exposure:",
        (Step::Plan, Kind::Starved) => {
            "reflectances expected to be darker than their noise even in the longest exposure:"
        }
        (Step::Plan, _) => "samples expected outside the photograph or unlit:",
        (_, Kind::Clipped) => "samples saturated in every exposure:",
        (_, Kind::Starved) => "samples darker than their noise:",
        (Step::Fit, _) => "samples without a value:",
        _ => "samples outside the photograph or unlit:",
    }
}

fn advice(step: Step, kind: Kind) -> &'static str {
    match (step, kind) {
        (Step::Plan, Kind::Clipped) => {
            "exposures are at camera.min_exposure_s of rig.toml: stop the lens down or dim the lamp"
        }
        (Step::Plan, Kind::Starved) => {
            "raise exposure.count or camera.max_exposure_s in rig.toml, or open the lens"
        }
        (Step::Acquire | Step::Develop, Kind::Clipped) => {
            "raise exposure.brightest_reflectance in rig.toml, plan and acquire again"
        }
        (Step::Acquire | Step::Develop, Kind::Starved) => {
            "lower exposure.darkest_reflectance or raise exposure.count in rig.toml, plan and acquire again"
        }
        (Step::Fit, Kind::Clipped) => {
            "the fit does not see these highlights; plan with a higher exposure.brightest_reflectance"
        }
        (Step::Fit, Kind::Starved) => {
            "they say little of the material; plan with a lower exposure.darkest_reflectance"
        }
        (Step::Fit, _) => "the fit does without them",
        (_, _) => "look at carrier, camera and limits of the axes in rig.toml",
    }
}

/// Counts of a store's samples by pose, block by block, in any order.
#[derive(Debug, Default)]
pub struct Tally(Mutex<Vec<PoseSamples>>);

impl Tally {
    /// Counts the samples of a block. `starved` is known where the standard deviations were read; all that is
    /// not a number counts as missing.
    pub fn count(&self, block: &SampledSbrdf) {
        let mut counts = vec![PoseSamples::default(); block.poses.len()];
        for texel in 0..block.texels() {
            let values = block.values(texel).as_chunks::<3>().0;
            for (count, [red, green, blue]) in counts.iter_mut().zip(values) {
                count.all += 1;
                count.missing += u64::from(!(red + green + blue).is_finite());
            }
            let sigmas = block.sigmas(texel).map(|sigmas| sigmas.as_chunks::<3>().0);
            for ((count, value), sigma) in counts.iter_mut().zip(values).zip(sigmas.into_iter().flatten()) {
                let noise: f32 = sigma.iter().map(|sigma| widened(sigma.to_bits())).sum();
                count.starved += u64::from(value.iter().sum::<f32>() < noise && noise < UNKNOWN);
            }
        }
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let length = counts.len().max(all.len());
        all.resize(length, PoseSamples::default());
        all.iter_mut().zip(counts).for_each(|(all, counts)| all.add(counts));
    }

    /// The counts of the poses that are not left out. Of the missing samples those count as clipped that
    /// `clipped`, a share a pose, says to be so.
    pub fn counts(self, weights: &[f64], clipped: Option<&[f64]>) -> Vec<(usize, PoseSamples)> {
        let counts = self.0.into_inner().unwrap_or_else(PoisonError::into_inner);
        let split = |(pose, mut samples): (usize, PoseSamples)| {
            let share = clipped.and_then(|shares| shares.get(pose)).copied().unwrap_or(0.0);
            samples.clipped = ((share * samples.all as f64).round() as u64).min(samples.missing);
            samples.missing -= samples.clipped;
            (pose, samples)
        };
        let seen = |pose: &usize| weights.get(*pose).is_none_or(|&weight| weight > 0.0);
        counts.into_iter().enumerate().map(split).filter(|(pose, _)| seen(pose)).collect()
    }
}

/// Standard deviations from here on are infinite or NaN: of those nothing is known.
const UNKNOWN: f32 = 65_536.0;

/// A standard deviation in half precision as a number, without branches; one that is infinite or NaN comes
/// out as [`UNKNOWN`] or more.
fn widened(bits: u16) -> f32 {
    // The exponent's bias is 15 in half precision and 127 in single.
    f32::from_bits(u32::from(bits) << 13) * f32::from_bits((127 + 112) << 23)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampled::PoseGeometry;
    use glam::DVec3;
    use half::f16;

    fn samples(all: u64, clipped: u64, starved: u64, missing: u64) -> PoseSamples {
        PoseSamples { all, clipped, starved, missing }
    }

    #[test]
    fn good_poses_raise_no_warning_and_bad_ones_are_named_worst_first() {
        let mut counts: Vec<(usize, PoseSamples)> = (0..100).map(|k| (k, samples(1000, 5, 3, 9))).collect();
        for step in [Step::Plan, Step::Acquire, Step::Develop, Step::Fit] {
            assert_eq!(warnings(step, &counts), []);
        }
        counts[7].1 = samples(1000, 570, 0, 0);
        counts[40].1 = samples(1000, 990, 0, 0);
        let found = warnings(Step::Develop, &counts);
        assert_eq!((found.len(), found[0].kind, &found[0].poses), (1, Kind::Clipped, &vec![40, 7]));
        assert!(
            found[0].text.contains("2.1 % of all, most in poses 40 (99 %) and 7 (57 %)"),
            "{}",
            found[0].text
        );
        assert!(found[0].text.contains("brightest_reflectance"));
    }

    #[test]
    fn many_samples_over_all_poses_are_told_where_no_pose_has_many() {
        let counts: Vec<(usize, PoseSamples)> = (0..10).map(|k| (k, samples(100, 0, 5, 0))).collect();
        let found = warnings(Step::Fit, &counts);
        assert_eq!((found.len(), found[0].kind, &found[0].poses), (1, Kind::Starved, &vec![0]));
    }

    #[test]
    fn the_report_has_the_shares_of_every_pose() {
        let json = by_pose(&[(3, samples(200, 114, 1, 0))]);
        assert_eq!(json[0]["pose"], 3);
        assert_eq!((json[0]["clipped"].as_f64(), json[0]["starved"].as_f64()), (Some(0.57), Some(0.005)));
    }

    #[test]
    fn a_store_s_samples_are_counted_by_pose_and_what_was_clipped_is_told_from_what_is_missing() {
        let pose = PoseGeometry { light_mm: DVec3::Z, camera_mm: DVec3::Z, weight: 1.0 };
        let mut block = SampledSbrdf::empty(5, 2, 1.0, vec![pose; 3]);
        for texel in 0..10 {
            for value in &mut block.reflectance[texel * 9..texel * 9 + 6] {
                *value = 0.1;
            }
        }
        block.reflectance[4] = f32::NAN;
        block.reflectance[9..12].fill(1e-3);
        block.sigma = Some(vec![f16::from_f32(2e-3); 90]);
        let tally = Tally::default();
        tally.count(&block);
        tally.count(&block);
        let counts = tally.counts(&[1.0, 0.0, 1.0], Some(&[0.0, 0.0, 0.4]));
        assert_eq!(counts, [(0, samples(20, 0, 2, 0)), (2, samples(20, 8, 0, 12))]);
    }

    #[test]
    fn standard_deviations_are_widened_as_the_conversion_does_and_unknown_ones_do_not_count() {
        for value in [0.0, 6e-8, 1e-5, 1e-3, 0.3, 900.0] {
            let half = f16::from_f32(value);
            assert_eq!(widened(half.to_bits()), half.to_f32());
        }
        assert!([f16::NAN, f16::INFINITY].iter().all(|half| widened(half.to_bits()) >= UNKNOWN));
    }
}
