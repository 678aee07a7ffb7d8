//! What a fit leaves: poses that stand out over the whole sample, and texels with a residual that their noise
//! does not explain.
//!
//! A pose is judged by some texels, evenly spread. A sample's residual counts in units of its expected error:
//! σ where that is known, 2 % for lamp, geometry and registration, and 20 % of a highlight, since no real one
//! is quite a lobe. What is left of a texel at most poses is the model's misfit and is divided out by its
//! median over the poses; what many texels have at a pose is summed up by two quantiles over texels, the
//! median for light that is wrong everywhere and the 90th percentile for photographs that are shifted, which
//! shows at edges. Lobes fit some directions worse than others: so a pose is held against the poses nearest
//! in direction as well as against all.

use glam::Vec3;
use rayon::prelude::*;

use lobelia_base::error::Result;
use lobelia_base::warning::{Kind, Warning, median, named, quantile};
use lobelia_reflectance::distance::{DirectionPair, distance};
use lobelia_reflectance::sampled::{SampledSbrdf, SampledStore, Window};
use lobelia_reflectance::{Brdf as _, SbrdfMap, colour};

/// Edge of a window of texels, how many windows are looked at, and how many texels of them at most.
const WINDOW: usize = 16;
const WINDOWS: usize = 12;
const TEXELS: usize = 1024;
/// Expected error beside σ: a share of the fitted value and of this many sr⁻¹, and a share of what the lobes
/// have of it.
const SHARE: f64 = 0.02;
const DARK: f64 = 0.01;
const SHARE_OF_LOBES: f64 = 0.2;
/// A texel's median residual counts as at least this many expected errors.
const LEAST_MEDIAN: f64 = 0.5;
/// A pose is held against at least this many times the texels' median residuals: what is within the expected
/// errors never stands out.
const LEAST_LEVEL: f64 = 1.0;
/// Samples whose half vector is nearer to the normal are not looked at: mirrors and the sharpest lobes are
/// not resolved there.
const MIRROR_DEG: f64 = 3.0;
/// Fewer poses, or fewer texels at a pose, say nothing.
const FEWEST_POSES: usize = 12;
const FEWEST_TEXELS: usize = 16;
/// Poses nearest in direction that a pose is held against, and how many are looked through for those that
/// were seen.
const NEIGHBOURS: usize = 6;
const NEAR: usize = 48;
/// A pose stands out from this many times the residual of the others on, if that is also this many of the
/// robust standard deviations of all poses.
const TIMES: f64 = 3.0;
const DEVIATIONS: f64 = 6.0;
/// The robust standard deviation of the residuals' logarithms is at least this.
const LEAST_SPREAD: f64 = 0.1;

/// What the poses' residuals are.
#[derive(Debug, Clone, Default)]
pub struct PoseResiduals {
    /// How many times that of the other poses, those nearest in direction included, each pose's residual is;
    /// none where too little was seen.
    pub times: Vec<Option<f64>>,
    /// Median over texels of the samples' brightness over that of the fit, a pose.
    pub brightness: Vec<f64>,
    /// The poses that stand out, the worst first.
    pub outstanding: Vec<usize>,
}

/// Some texels' residuals at every pose.
struct Texel {
    /// Over the expected error; NaN where it is not looked at.
    residual: Vec<f64>,
    /// Luminance over that of the fit.
    brightness: Vec<f64>,
}

/// Windows of texels, evenly spread over an image.
fn windows(size: [usize; 2]) -> Vec<Window> {
    let all = Window::blocks(size, [WINDOW, WINDOW]);
    let count = all.len().min(WINDOWS);
    // Steps by the golden ratio fall on no grid of rows or columns.
    let mut chosen: Vec<usize> = (0..all.len())
        .scan(0.0f64, |share, _| {
            *share = (*share + 0.618_033_988_749_894_9).fract();
            Some((*share * all.len() as f64) as usize)
        })
        .collect();
    let mut seen = vec![false; all.len()];
    chosen.retain(|&k| !std::mem::replace(&mut seen[k], true));
    chosen.extend((0..all.len()).filter(|&k| !seen[k]));
    chosen.into_iter().take(count).map(|k| all[k].clone()).collect()
}

/// Looks at what a map leaves of a store's samples at every pose.
///
/// # Errors
/// When a chunk cannot be read.
pub fn look(store: &SampledStore, map: &SbrdfMap) -> Result<PoseResiduals> {
    if (map.width, map.height) != (store.width, store.height) {
        return Ok(PoseResiduals::default());
    }
    let mut texels = Vec::new();
    let windows = windows([store.width, store.height]);
    let every = windows.iter().map(|window| window.x.len() * window.y.len()).sum::<usize>().div_ceil(TEXELS);
    for window in windows {
        let sampled = store.read(&window, true)?;
        let places: Vec<usize> =
            window.y.clone().flat_map(|y| window.x.clone().map(move |x| y * store.width + x)).collect();
        let looked_at = places.par_iter().enumerate().step_by(every.max(1));
        texels.par_extend(looked_at.filter_map(|(index, &place)| texel(&sampled, index, map, place)));
    }
    Ok(judged(&sampled_directions(store), &texels))
}

/// Direction pairs at the sample's centre.
fn sampled_directions(store: &SampledStore) -> Vec<DirectionPair> {
    let pair = |pose: &lobelia_reflectance::sampled::PoseGeometry| DirectionPair {
        wi: pose.light_mm.normalize(),
        wo: pose.camera_mm.normalize(),
    };
    store.poses.iter().map(pair).collect()
}

/// What the map's texel at `place` leaves of the samples of texel `index`; none where it was fitted to none.
fn texel(sampled: &SampledSbrdf, index: usize, map: &SbrdfMap, place: usize) -> Option<Texel> {
    let brdf = map.texel(place);
    let sigmas = sampled.sigmas(index);
    let poses = sampled.poses.len();
    let mut texel = Texel { residual: vec![f64::NAN; poses], brightness: vec![f64::NAN; poses] };
    for (pose, rgb) in sampled.samples(index).enumerate() {
        let (wi, wo) = sampled.directions(index, pose);
        let seen = sampled.poses[pose].weight > 0.0 && rgb.is_finite() && wi.z > 0.0 && wo.z > 0.0;
        if !seen || near_mirror(wi, wo) {
            continue;
        }
        let fitted = brdf.eval(wi, wo);
        let mut square = 0.0;
        for channel in 0..3 {
            let (value, goal) = (f64::from(fitted[channel]), f64::from(rgb[channel]));
            let sigma = sigmas.map_or(0.0, |sigmas| f64::from(sigmas[3 * pose + channel]));
            let lobes = (value - f64::from(brdf.rho_d[channel])).max(0.0);
            let misfit = SHARE * (value + DARK) + SHARE_OF_LOBES * lobes;
            square += (value - goal).powi(2) / (sigma * sigma + misfit * misfit) / 3.0;
        }
        texel.residual[pose] = square.sqrt();
        texel.brightness[pose] = f64::from(colour::luminance(rgb)) / f64::from(colour::luminance(fitted));
    }
    let mut seen: Vec<f64> = texel.residual.iter().copied().filter(|x| x.is_finite()).collect();
    if seen.len() < FEWEST_POSES {
        return None;
    }
    let usual = median(&mut seen).max(LEAST_MEDIAN);
    texel.residual.iter_mut().for_each(|residual| *residual /= usual);
    Some(texel)
}

fn near_mirror(wi: Vec3, wo: Vec3) -> bool {
    (wi + wo).normalize().z > (MIRROR_DEG.to_radians().cos()) as f32
}

/// The poses' residuals from those of the texels.
fn judged(pairs: &[DirectionPair], texels: &[Texel]) -> PoseResiduals {
    let of = |pose: usize, values: fn(&Texel) -> &Vec<f64>| -> Vec<f64> {
        texels.iter().map(|texel| values(texel)[pose]).filter(|value| value.is_finite()).collect()
    };
    let brightness = (0..pairs.len()).map(|pose| median(&mut of(pose, |texel| &texel.brightness))).collect();
    let nearest = nearest(pairs);
    let mut times: Vec<Option<f64>> = vec![None; pairs.len()];
    let mut outstanding = vec![false; pairs.len()];
    for share in [0.5, 0.9] {
        let level = |pose: usize| {
            let mut residuals = of(pose, |texel| &texel.residual);
            (residuals.len() >= FEWEST_TEXELS).then(|| quantile(&mut residuals, share))
        };
        let levels: Vec<Option<f64>> = (0..pairs.len()).map(level).collect();
        for (pose, (ratio, stands_out)) in over_others(&nearest, &levels).into_iter().enumerate() {
            times[pose] = times[pose].into_iter().chain(ratio).reduce(f64::max);
            outstanding[pose] |= stands_out;
        }
    }
    let mut poses: Vec<usize> = (0..pairs.len()).filter(|&pose| outstanding[pose]).collect();
    poses.sort_by(|&a, &b| times[b].unwrap_or(0.0).total_cmp(&times[a].unwrap_or(0.0)));
    PoseResiduals { times, brightness, outstanding: poses }
}

/// The poses nearest in direction to each pose, the nearest first, by the isotropic distance and by the
/// other.
fn nearest(pairs: &[DirectionPair]) -> Vec<[Vec<usize>; 2]> {
    let of_pose = |pose: usize, isotropic: bool| {
        let others = (0..pairs.len()).filter(|&other| other != pose);
        let mut near: Vec<(f64, usize)> =
            others.map(|other| (distance(pairs[pose], pairs[other], isotropic), other)).collect();
        let by_distance = |a: &(f64, usize), b: &(f64, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        if near.len() > NEAR {
            near.select_nth_unstable_by(NEAR, by_distance);
            near.truncate(NEAR);
        }
        near.sort_by(by_distance);
        near.into_iter().map(|(_, other)| other).collect()
    };
    (0..pairs.len())
        .into_par_iter()
        .map(|pose| [true, false].map(|isotropic| of_pose(pose, isotropic)))
        .collect()
}

/// How many times that of the others each pose's residual is, and whether it stands out.
fn over_others(nearest: &[[Vec<usize>; 2]], levels: &[Option<f64>]) -> Vec<(Option<f64>, bool)> {
    let judged: Vec<usize> =
        (0..levels.len()).filter(|&pose| levels[pose].is_some_and(|x| x > 0.0)).collect();
    if judged.len() < FEWEST_POSES {
        return vec![(None, false); levels.len()];
    }
    let level = |pose: usize| levels[pose].unwrap_or(f64::NAN);
    let usual = median(&mut judged.iter().map(|&pose| level(pose)).collect::<Vec<_>>());
    let of_nearest = |near: &Vec<usize>| {
        let judged = near.iter().filter_map(|&other| levels[other].filter(|level| *level > 0.0));
        let mut levels: Vec<f64> = judged.take(NEIGHBOURS).collect();
        if levels.is_empty() { 0.0 } else { median(&mut levels) }
    };
    let ratio = |pose: usize| {
        let of_nearest = nearest[pose].each_ref().map(of_nearest).into_iter().fold(0.0, f64::max);
        let expected = usual.max(of_nearest).max(LEAST_LEVEL);
        level(pose) / expected
    };
    let ratios: Vec<f64> = judged.iter().map(|&pose| ratio(pose)).collect();
    let middle = median(&mut ratios.iter().map(|ratio| ratio.ln()).collect::<Vec<_>>());
    let off = median(&mut ratios.iter().map(|ratio| (ratio.ln() - middle).abs()).collect::<Vec<_>>());
    let spread = (1.4826 * off).max(LEAST_SPREAD);
    let mut found = vec![(None, false); levels.len()];
    for (&pose, &ratio) in judged.iter().zip(&ratios) {
        let deviations = (ratio.ln() - middle) / spread;
        found[pose] = (Some(ratio), ratio > TIMES && deviations > DEVIATIONS);
    }
    found
}

impl PoseResiduals {
    /// Names the poses that stand out.
    pub fn warning(&self) -> Option<Warning> {
        if self.outstanding.is_empty() {
            return None;
        }
        let remark = |&pose: &usize| {
            let times = self.times[pose].unwrap_or(0.0);
            let percent = 100.0 * (self.brightness[pose] - 1.0);
            let light = match percent {
                p if p >= 5.0 => format!(", {p:.0} % brighter than the fit"),
                p if p <= -5.0 => format!(", {:.0} % darker than the fit", -p),
                _ => String::new(),
            };
            (pose, format!("{times:.1} times that of the others{light}"))
        };
        let list: Vec<(usize, String)> = self.outstanding.iter().map(remark).collect();
        let text = format!(
            "the residual over the whole sample stands out at {}: the photograph may be misregistered, of \
             another pose or lit otherwise; look at it, or leave it out with develop --skip-pose",
            named(&list)
        );
        Some(Warning { poses: self.outstanding.clone(), ..Warning::new(Kind::OutstandingPose, text) })
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::fit::weights::Weights;
    use crate::fit::{FitOptions, Residual, fit_sbrdf};
    use crate::synth::{self, Options};
    use lobelia_measure::rig::config::RigConfig;
    use lobelia_reflectance::materials;
    use lobelia_sim::sample;

    const SIDE: usize = 40;
    const SPOILT: usize = 17;

    fn options(poses: usize) -> Options {
        Options {
            width: SIDE,
            height: SIDE,
            texel_mm: 1.6,
            poses,
            noise: 1e-3,
            relative_noise: 0.01,
            seed: 5,
        }
    }

    /// The demo's brocade, edges and all, at random poses.
    fn brocade(poses: usize) -> SampledSbrdf {
        let layout = sample::recipe().layout(Path::new("."), &RigConfig::default().carrier).unwrap();
        synth::sample(&options(poses), |_, place, wi, wo| layout.at(place.x, place.y).eval(wi, wo))
    }

    fn looked_at(what: &str, sampled: &SampledSbrdf, weights: Weights) -> PoseResiduals {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sampled.zarr");
        sampled.write_zarr(&path).unwrap();
        let residual = if weights == Weights::Sigma { Residual::Linear } else { Residual::Proportional };
        let options = FitOptions { lobes: 2, weights, residual, ..FitOptions::default() };
        let found =
            look(&SampledStore::open(&path).unwrap(), &fit_sbrdf(sampled, &options).unwrap()).unwrap();
        let mut largest: Vec<f64> = found.times.iter().flatten().copied().collect();
        largest.sort_by(f64::total_cmp);
        println!(
            "{what} {weights:?}: largest {:.2?}, pose {SPOILT} {:.2?}",
            &largest[largest.len() - 3..],
            found.times[SPOILT]
        );
        found
    }

    /// Changes the samples of one pose, each by those of texel and pose before.
    fn spoilt(sampled: &SampledSbrdf, value: impl Fn(&SampledSbrdf, usize) -> [f32; 3]) -> SampledSbrdf {
        let mut other = sampled.clone();
        let span = 3 * sampled.poses.len();
        for texel in 0..sampled.texels() {
            let place = texel * span + 3 * SPOILT;
            other.reflectance[place..place + 3].copy_from_slice(&value(sampled, texel));
        }
        other
    }

    fn at(sampled: &SampledSbrdf, texel: usize, pose: usize) -> [f32; 3] {
        let values = &sampled.values(texel)[3 * pose..3 * pose + 3];
        [values[0], values[1], values[2]]
    }

    #[test]
    fn no_pose_of_a_good_measurement_stands_out_whatever_its_noise_weights_and_material() {
        let sampled = brocade(80);
        for weights in [Weights::Sigma, Weights::Pose] {
            assert_eq!(looked_at("good", &sampled, weights).outstanding, [0; 0]);
        }
        // Two lobes miss the sharp highlight of brushed metal, which one pose may meet alone.
        for name in materials::NAMES.into_iter().filter(|name| *name != "brushed-metal") {
            let material = materials::published(name).unwrap();
            for noise in [0.0, 1e-3] {
                let options = Options { width: 16, height: 16, noise, relative_noise: noise, ..options(100) };
                let sampled = synth::sample(&options, |_, _, wi, wo| material.eval(wi, wo));
                let found = looked_at(name, &sampled, Weights::Pose);
                assert_eq!(found.outstanding, [0; 0], "{name} {noise}: {:?}", found.warning());
            }
        }
    }

    #[test]
    fn a_pose_that_is_lit_wrongly_shifted_or_of_another_direction_is_named_by_its_number() {
        let sampled = brocade(80);
        let brighter = spoilt(&sampled, |sampled, texel| at(sampled, texel, SPOILT).map(|f| 1.5 * f));
        let shifted = spoilt(&sampled, |sampled, texel| {
            let x = (texel % SIDE + 3).min(SIDE - 1);
            at(sampled, texel / SIDE * SIDE + x, SPOILT)
        });
        // The pose that shows the sample most differently from the one that is spoilt.
        let mean = |pose: usize| -> f32 {
            (0..sampled.texels()).map(|texel| at(&sampled, texel, pose)[1]).sum::<f32>()
                / sampled.texels() as f32
        };
        let unlike = |pose: &usize| (mean(*pose) / mean(SPOILT)).ln().abs();
        let far = (0..80).max_by(|a, b| unlike(a).total_cmp(&unlike(b))).unwrap();
        let other = spoilt(&sampled, |sampled, texel| at(sampled, texel, far));
        for (what, spoilt) in [("brighter", brighter), ("shifted", shifted), ("other", other)] {
            for weights in [Weights::Sigma, Weights::Pose] {
                let found = looked_at(what, &spoilt, weights);
                assert_eq!(found.outstanding, [SPOILT], "{what}");
                let warning = found.warning().unwrap();
                assert!(warning.text.contains("pose 17 (") && warning.poses == [SPOILT], "{}", warning.text);
                let told = warning.text.contains("% brighter than the fit");
                assert!(told || what != "brighter", "{}", warning.text);
            }
        }
    }

    #[test]
    fn too_few_poses_or_a_map_of_another_size_say_nothing() {
        let sampled = brocade(8);
        let found = looked_at_any(&sampled);
        assert!(found.outstanding.is_empty() && found.times.iter().all(Option::is_none));
    }

    fn looked_at_any(sampled: &SampledSbrdf) -> PoseResiduals {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sampled.zarr");
        sampled.write_zarr(&path).unwrap();
        let store = SampledStore::open(&path).unwrap();
        assert!(look(&store, &SbrdfMap::new(3, 3, 1)).unwrap().times.is_empty());
        look(&store, &fit_sbrdf(sampled, &FitOptions::default()).unwrap()).unwrap()
    }

    #[test]
    fn windows_are_spread_over_the_image_and_none_is_taken_twice() {
        for size in [[5, 5], [128, 128], [16, 4096], [512, 512]] {
            let chosen = windows(size);
            assert_eq!(chosen.len(), size[0].div_ceil(16).saturating_mul(size[1].div_ceil(16)).min(WINDOWS));
            let corners: std::collections::BTreeSet<_> =
                chosen.iter().map(|w| (w.x.start, w.y.start)).collect();
            assert_eq!(corners.len(), chosen.len());
            for (edge, along) in size.into_iter().zip([0, 1]).filter(|(edge, _)| *edge > 64) {
                let start = |w: &Window| if along == 0 { w.x.start } else { w.y.start };
                let beyond = chosen.iter().filter(|w| start(w) >= edge / 2).count();
                assert!((3..=9).contains(&beyond), "{size:?}: {beyond}");
            }
        }
    }
}
