//! Poses that a fit of texels does not see, and its error there: of all errors the one that is on what was
//! not fitted.
//!
//! A pose that is held out weighs nothing, so that every way to fit (chunk by chunk, in parts, pooled,
//! levels) leaves it out. Errors are told apart by how far a held-out pose is from the poses that were
//! fitted, since a fit that interpolates between near ones says little of where none looked.

use std::collections::BTreeSet;
use std::str::FromStr;

use rayon::prelude::*;

use super::samples;
use super::weights::Weights;
use lobelia_base::error::{Error, Result};
use lobelia_base::progress;
use lobelia_base::random::Random;
use lobelia_reflectance::SbrdfMap;
use lobelia_reflectance::distance::{DirectionPair, distance};
use lobelia_reflectance::sampled::{PoseGeometry, SampledSbrdf, SampledStore, Window};

/// Which poses are held out.
#[derive(Debug, Clone, PartialEq)]
pub enum Which {
    /// This share of them, at random.
    Share(f64),
    /// This many, at random.
    Count(usize),
    /// Poses 0, N, 2 N and so on.
    Every(usize),
    /// These, counted from 0.
    List(Vec<usize>),
}

impl FromStr for Which {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let wrong = || {
            "must be a share such as 0.1, a number of poses such as 20, every:N or list:I,J,… (poses count \
             from 0)"
                .to_string()
        };
        if let Some(step) = text.strip_prefix("every:") {
            let step = step.parse().ok().filter(|&step: &usize| step > 1);
            return step.map(Self::Every).ok_or_else(wrong);
        }
        if let Some(list) = text.strip_prefix("list:") {
            let list: std::result::Result<Vec<usize>, _> = list.split(',').map(str::parse).collect();
            return list.map(Self::List).map_err(|_| wrong());
        }
        if let Ok(count) = text.parse() {
            return if count > 0 { Ok(Self::Count(count)) } else { Err(wrong()) };
        }
        let share = text.parse().ok().filter(|share| 0.0 < *share && *share < 1.0);
        share.map(Self::Share).ok_or_else(wrong)
    }
}

/// The attribute of a map that lists the poses that it was not fitted to.
const NOTE: &str = "fit.held_out_poses";

/// The attribute of a map that lists the poses that weigh nothing in the samples: those that were skipped,
/// not photographed or not registered.
const LEFT_OUT: &str = "fit.left_out_poses";

/// The poses that a map says it was not fitted to, counted from 0.
pub fn noted(map: &SbrdfMap) -> Vec<usize> {
    let lists = [NOTE, LEFT_OUT].into_iter().filter_map(|name| map.attributes.get(name));
    lists.flat_map(|list| list.split(' ')).filter_map(|pose| pose.parse().ok()).collect()
}

/// What maps of these poses say of those without a weight: name and text of an attribute; none where all have
/// one.
pub fn left_out(poses: &[PoseGeometry]) -> Option<(String, String)> {
    let weightless = (0..poses.len()).filter(|&pose| poses[pose].weight <= 0.0);
    let list: Vec<String> = weightless.map(|pose| pose.to_string()).collect();
    (!list.is_empty()).then(|| (LEFT_OUT.to_string(), list.join(" ")))
}

/// Poses that are held out.
#[derive(Debug, Clone, PartialEq)]
pub struct HeldOut {
    /// The poses, in order, counted from 0.
    pub poses: Vec<usize>,
    /// Poses that are left to fit.
    pub fitted: usize,
    /// Bi-angular distance of each to the nearest pose that is fitted, radians.
    pub distance: Vec<f64>,
    /// The distance up to which a pose counts as near: the median, over all poses, of that to the nearest
    /// other one, radians.
    pub near: f64,
}

impl HeldOut {
    /// Chooses among the poses that have a weight, and takes the weight from those that are held out. For an
    /// isotropic fit pairs of directions that differ by a turn about the normal are the same.
    ///
    /// # Errors
    /// Input errors: a pose that is not there or has no weight, or fewer than two poses to fit or none to
    /// hold out.
    pub fn choose(poses: &mut [PoseGeometry], which: &Which, isotropic: bool, seed: u64) -> Result<Self> {
        let usable: Vec<usize> = (0..poses.len()).filter(|&pose| poses[pose].weight > 0.0).collect();
        let held = held(&usable, poses.len(), which, seed)?;
        let fitted: Vec<usize> =
            usable.iter().copied().filter(|pose| held.binary_search(pose).is_err()).collect();
        if held.is_empty() || fitted.len() < 2 {
            return Err(Error::input(format!(
                "--hold-out-poses would hold out {} of {} poses; at least one has to be held out and two \
                 fitted",
                held.len(),
                usable.len()
            )));
        }
        let pair = |pose: usize| DirectionPair {
            wi: poses[pose].light_mm.normalize(),
            wo: poses[pose].camera_mm.normalize(),
        };
        let nearest = |pose: usize, others: &[usize]| {
            let others = others.iter().filter(|&&other| other != pose);
            others.map(|&other| distance(pair(pose), pair(other), isotropic)).fold(f64::INFINITY, f64::min)
        };
        let mut all: Vec<f64> = usable.par_iter().map(|&pose| nearest(pose, &usable)).collect();
        all.sort_by(f64::total_cmp);
        let distance = held.iter().map(|&pose| nearest(pose, &fitted)).collect();
        held.iter().for_each(|&pose| poses[pose].weight = 0.0);
        Ok(Self { poses: held, fitted: fitted.len(), distance, near: all[all.len() / 2] })
    }

    /// Notes in a map which poses it was not fitted to.
    pub fn note(&self, map: &mut SbrdfMap) {
        let list: Vec<String> = self.poses.iter().map(usize::to_string).collect();
        map.attributes.insert(NOTE.into(), list.join(" "));
    }

    /// The error of a map on the samples of the held-out poses, read from the store chunk by chunk: of all of
    /// them, of the near and of the far ones. Texels that the map has no coefficients for, since they had no
    /// samples or are of no region of a pooled fit, do not count.
    ///
    /// # Errors
    /// When a chunk cannot be read.
    pub fn errors(&self, store: &SampledStore, map: &SbrdfMap) -> Result<[HeldOutError; 3]> {
        let mut weights = vec![0.0; store.poses.len()];
        self.poses.iter().for_each(|&pose| weights[pose] = 1.0);
        let far: BTreeSet<usize> = (self.poses.iter().zip(&self.distance))
            .filter(|&(_, &distance)| distance > self.near)
            .map(|(&pose, _)| pose)
            .collect();
        let bar = progress::bar("judging", map.rho_d.len() as u64, "texels");
        let of_block = |window: &Window| -> Result<Vec<(usize, TexelError)>> {
            let mut sampled = store.read(window, false)?;
            sampled.poses.iter_mut().zip(&weights).for_each(|(pose, &weight)| pose.weight = weight);
            let texels = window.y.clone().flat_map(|y| window.x.clone().map(move |x| y * map.width + x));
            let of = |(index, texel)| (texel, texel_error(map, texel, &sampled, index, &far));
            let errors = texels.enumerate().map(of).collect();
            bar.advance(window.texels() as u64);
            Ok(errors)
        };
        let blocks: Vec<Result<Vec<(usize, TexelError)>>> = store.blocks().par_iter().map(of_block).collect();
        let mut groups: [Vec<(f64, usize)>; 3] = Default::default();
        for block in blocks {
            for (texel, errors) in block? {
                for (group, error) in groups.iter_mut().zip(errors) {
                    group.extend(error.map(|error| (error, texel)));
                }
            }
        }
        let counts = [self.poses.len(), self.poses.len() - far.len(), far.len()];
        let mut of = |group: usize| HeldOutError::of(&mut groups[group], counts[group], map.width);
        Ok([of(0), of(1), of(2)])
    }
}

/// ‖f̂ − f‖ / ‖f‖ of a texel at all held-out poses, the near and the far ones; none without a sample that is
/// not black.
type TexelError = [Option<f64>; 3];

/// The error of a map at the samples of a texel, which is number `index` of those that were read; none where
/// the map has no coefficients for it.
fn texel_error(
    map: &SbrdfMap,
    texel: usize,
    sampled: &SampledSbrdf,
    index: usize,
    far: &BTreeSet<usize>,
) -> TexelError {
    let none = |plane: &str| map.extra.get(plane).map(|values| values[texel] == 0.0);
    // A texel of a region has the region's coefficients without any sample of its own.
    if none("region").or_else(|| none("samples")).unwrap_or(false) {
        return [None; 3];
    }
    let mut sums = [[0.0; 2]; 3];
    for sample in samples::of_texel(sampled, index, Weights::Pose) {
        let off = map.eval(texel, sample.wi, sample.wo) - sample.rgb;
        for group in [0, if far.contains(&sample.pose) { 2 } else { 1 }] {
            sums[group][0] += off.as_dvec3().length_squared();
            sums[group][1] += sample.rgb.as_dvec3().length_squared();
        }
    }
    // What overflows stays finite, so that reports can hold it.
    sums.map(|[off, whole]| (whole > 0.0).then(|| (off / whole).sqrt().min(f64::from(f32::MAX))))
}

/// The poses to hold out, in order.
fn held(usable: &[usize], count: usize, which: &Which, seed: u64) -> Result<Vec<usize>> {
    let random = |wanted: usize| {
        let mut poses = usable.to_vec();
        Random::new(seed ^ 0x6865_6c64).draw(&mut poses, wanted);
        poses
    };
    Ok(match which {
        Which::Share(share) => random((share * usable.len() as f64).round() as usize),
        Which::Count(wanted) => random(*wanted),
        Which::Every(step) => usable.iter().copied().filter(|pose| pose % step == 0).collect(),
        Which::List(list) => {
            if let Some(pose) = list.iter().find(|&&pose| pose >= count) {
                let message =
                    format!("--hold-out-poses: pose {pose} is not there; the sampled SBRDF has poses 0 to");
                return Err(Error::input(format!("{message} {}", count.saturating_sub(1))));
            }
            if let Some(pose) = list.iter().find(|&pose| usable.binary_search(pose).is_err()) {
                let message = "is not fitted anyway: it has no weight";
                return Err(Error::input(format!("--hold-out-poses: pose {pose} {message}")));
            }
            list.iter().copied().collect::<BTreeSet<usize>>().into_iter().collect()
        }
    })
}

/// Relative errors over the texels, ‖f̂ − f‖ / ‖f‖ over the samples of some held-out poses and the channels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeldOutError {
    /// Poses.
    pub poses: usize,
    /// Texels with a sample there that is not black; the rest is 0 without any.
    pub texels: usize,
    /// Median.
    pub p50: f64,
    /// What 95 % of the texels are below.
    pub p95: f64,
    /// What 99 % of the texels are below.
    pub p99: f64,
    /// The largest.
    pub worst: f64,
    /// Column and row of its texel.
    pub worst_texel: [usize; 2],
}

impl HeldOutError {
    fn of(errors: &mut [(f64, usize)], poses: usize, width: usize) -> Self {
        errors.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let at = |share: f64| {
            let place = (share * errors.len() as f64) as usize;
            errors.get(place.min(errors.len().saturating_sub(1))).copied().unwrap_or_default()
        };
        let (worst, texel) = at(1.0);
        let worst_texel = [texel % width.max(1), texel / width.max(1)];
        Self {
            poses,
            texels: errors.len(),
            p50: at(0.5).0,
            p95: at(0.95).0,
            p99: at(0.99).0,
            worst,
            worst_texel,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{FitOptions, chunks};
    use super::*;
    use crate::synth;
    use lobelia_reflectance::Brdf;

    fn sampled(folder: &std::path::Path) -> (SampledSbrdf, SampledStore) {
        let options = synth::Options {
            width: 20,
            height: 18,
            texel_mm: 2.0,
            poses: 60,
            noise: 1e-3,
            relative_noise: 0.0,
            seed: 5,
        };
        let brdf = synth::material(1, &mut Random::new(3));
        let mut sampled = synth::sample(&options, |_, _, wi, wo| brdf.eval(wi, wo));
        // A texel that is otherwise at two poses, and one without a sample there.
        for (texel, pose, value) in [(41, 7, 3.0), (41, 14, 3.0), (50, 7, f32::NAN), (50, 14, f32::NAN)] {
            sampled.reflectance[(texel * 60 + pose) * 3..][..3].fill(value);
        }
        let path = folder.join("sampled.zarr");
        sampled.write_zarr(&path).unwrap();
        (sampled, SampledStore::open(&path).unwrap())
    }

    #[test]
    fn what_is_held_out_is_not_fitted_and_its_error_is_that_of_the_map_evaluated_there() {
        let folder = tempfile::tempdir().unwrap();
        let (mut sampled, mut store) = sampled(folder.path());
        let which = "list:14,7".parse().unwrap();
        let held = HeldOut::choose(&mut store.poses, &which, true, 1).unwrap();
        assert_eq!((held.poses.as_slice(), held.fitted), ([7, 14].as_slice(), 58));
        let options = FitOptions::default();
        let map = chunks::fit_store(&store, &options).unwrap();
        // The same as where those samples were never made.
        for texel in 0..sampled.texels() {
            for pose in [7, 14] {
                sampled.reflectance[(texel * 60 + pose) * 3..][..3].fill(f32::NAN);
            }
        }
        let without = super::super::fit_sbrdf(&sampled, &options).unwrap();
        assert_eq!(map.extra["samples"], without.extra["samples"]);
        assert!((map.rho_d[41].x / without.rho_d[41].x - 1.0).abs() < 1e-4);

        let [all, near, far] = held.errors(&store, &map).unwrap();
        let read = SampledSbrdf::read_zarr(&folder.path().join("sampled.zarr")).unwrap();
        let mut errors: Vec<f64> = (0..read.texels())
            .filter(|&texel| texel != 50)
            .map(|texel| {
                let (mut off, mut whole) = (0.0, 0.0);
                for pose in [7, 14] {
                    let (wi, wo) = read.directions(texel, pose);
                    let value = read.samples(texel).nth(pose).unwrap().as_dvec3();
                    let fitted = map.texel(texel).eval(wi, wo).as_dvec3();
                    off += (fitted - value).length_squared();
                    whole += value.length_squared();
                }
                (off / whole).sqrt()
            })
            .collect();
        errors.sort_by(f64::total_cmp);
        assert_eq!((all.poses, all.texels, all.worst_texel), (2, 359, [1, 2]));
        for (found, expected) in [(all.p50, 359 / 2), (all.p95, 341), (all.p99, 355), (all.worst, 358)] {
            assert!((found / errors[expected] - 1.0).abs() < 1e-5, "{found} {}", errors[expected]);
        }
        assert_eq!((near.poses + far.poses, all.worst > 0.5), (2, true));
    }

    #[test]
    fn texels_without_samples_count_where_they_have_the_coefficients_of_a_region() {
        let folder = tempfile::tempdir().unwrap();
        let (sampled, _) = sampled(folder.path());
        let mut map = SbrdfMap::new(sampled.width, sampled.height, 1);
        let judged = |map: &SbrdfMap| texel_error(map, 0, &sampled, 0, &BTreeSet::new())[0].is_some();
        let plane = |value: f32| vec![value; sampled.texels()];
        assert!(judged(&map));
        map.extra.insert("samples".into(), plane(0.0));
        assert!(!judged(&map));
        map.extra.insert("region".into(), plane(1.0));
        assert!(judged(&map));
        map.extra.insert("region".into(), plane(0.0));
        assert!(!judged(&map));
    }

    #[test]
    fn near_and_far_are_told_apart_by_the_distance_to_what_is_fitted() {
        // Poses 0 and 1 are neighbours; 5 stands alone.
        let at = |x: f64, weight: f64| PoseGeometry {
            light_mm: glam::DVec3::new(x, 0.0, 1000.0),
            camera_mm: glam::DVec3::new(0.0, 0.0, 1000.0),
            weight,
        };
        let mut poses: Vec<PoseGeometry> =
            [0.0, 10.0, 100.0, 120.0, 140.0, 900.0, 160.0].map(|x| at(x, 1.0)).into();
        poses.push(at(500.0, 0.0));
        let which = "list:0,5".parse().unwrap();
        let held = HeldOut::choose(&mut poses, &which, false, 1).unwrap();
        assert!((held.near - 0.02).abs() < 1e-3, "{}", held.near);
        assert!(held.distance[0] <= held.near && held.distance[1] > 0.5, "{held:?}");
        let weights: Vec<f64> = poses.iter().map(|pose| pose.weight).collect();
        assert_eq!(weights, [0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 1.0, 0.0]);
    }

    #[test]
    fn a_map_says_which_poses_were_held_out_and_which_weigh_nothing_in_its_samples() {
        let mut poses = synth::poses(8, 1);
        assert_eq!(left_out(&poses), None);
        (poses[2].weight, poses[6].weight) = (0.0, 0.0);
        let mut map = SbrdfMap::new(1, 1, 1);
        map.attributes.extend(left_out(&poses));
        assert_eq!(noted(&map), [2, 6]);
        let held = HeldOut::choose(&mut poses, &"list:3".parse().unwrap(), true, 1).unwrap();
        held.note(&mut map);
        assert_eq!(noted(&map), [3, 2, 6]);
    }

    #[test]
    fn poses_are_chosen_by_share_number_step_or_list_among_those_with_a_weight() {
        let usable: Vec<usize> = (0..40).filter(|pose| *pose != 10).collect();
        let chosen = |text: &str, seed| held(&usable, 40, &text.parse().unwrap(), seed).unwrap();
        let (tenth, again) = (chosen("0.1", 1), chosen("0.1", 1));
        assert!(tenth == again && tenth.len() == 4 && tenth != chosen("0.1", 2));
        assert!(!tenth.contains(&10) && tenth.is_sorted());
        assert_eq!(chosen("7", 3).len(), 7);
        assert_eq!(chosen("every:10", 3), [0, 20, 30]);
        assert_eq!(chosen("list:5,3,5", 3), [3, 5]);
        for wrong in ["0", "1.5", "-3", "every:1", "list:", "list:a", "some"] {
            assert!(wrong.parse::<Which>().is_err(), "{wrong}");
        }
        let refused = |text: &str| held(&usable, 40, &text.parse().unwrap(), 1).unwrap_err().to_string();
        assert!(refused("list:40").contains("pose 40 is not there"));
        assert!(refused("list:10").contains("pose 10 is not fitted anyway"));
        let mut poses = synth::poses(5, 1);
        let error = HeldOut::choose(&mut poses, &Which::Count(4), true, 1).unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains("4 of 5 poses"), "{error}");
        assert!(poses.iter().all(|pose| pose.weight == 1.0));
    }
}
