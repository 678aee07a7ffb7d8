//! Sampled SBRDFs of known materials, without a rig: random poses, exact directions, noise as it is asked
//! for.

use glam::{DVec3, Vec3};
use half::f16;
use rayon::prelude::*;

use lobelia_base::random::Random;
use lobelia_reflectance::distance::{MAX_THETA_I_DEG, MAX_THETA_O_DEG};
use lobelia_reflectance::sampled::{PoseGeometry, SampledSbrdf};
use lobelia_reflectance::{Lobe, LobeBrdf, Rgb};

/// Distance of light and camera from the sample's centre, mm.
pub const DISTANCE_MM: f64 = 1000.0;

/// What is sampled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Texels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Edge of a texel, mm.
    pub texel_mm: f64,
    /// Poses.
    pub poses: usize,
    /// Standard deviation of the noise on every value, sr⁻¹.
    pub noise: f64,
    /// Standard deviation of the noise that is a share of the value.
    pub relative_noise: f64,
    /// Seed of poses and noise.
    pub seed: u64,
}

/// Random poses, uniform in solid angle within the polar cuts of plans.
pub fn poses(count: usize, seed: u64) -> Vec<PoseGeometry> {
    let mut random = Random::new(seed);
    let mut direction = |most_deg: f64| {
        let z = random.uniform(most_deg.to_radians().cos(), 1.0);
        let (sin, cos) = random.uniform(0.0, std::f64::consts::TAU).sin_cos();
        let r = (1.0 - z * z).sqrt();
        DVec3::new(r * cos, r * sin, z)
    };
    (0..count)
        .map(|_| PoseGeometry {
            light_mm: DISTANCE_MM * direction(MAX_THETA_I_DEG),
            camera_mm: DISTANCE_MM * direction(MAX_THETA_O_DEG),
            weight: 1.0,
        })
        .collect()
}

/// Samples `reflectance`, which is given a texel's index, its place on the sample (mm), `wi` and `wo`, at
/// random poses. Noise may make values negative.
pub fn sample(
    options: &Options,
    reflectance: impl Fn(usize, DVec3, Vec3, Vec3) -> Rgb + Sync,
) -> SampledSbrdf {
    sample_at(poses(options.poses, options.seed), options, reflectance)
}

/// As [`sample`], at poses that are given. With noise, its standard deviations are there too.
pub fn sample_at(
    poses: Vec<PoseGeometry>,
    options: &Options,
    reflectance: impl Fn(usize, DVec3, Vec3, Vec3) -> Rgb + Sync,
) -> SampledSbrdf {
    let mut sampled = SampledSbrdf::empty(options.width, options.height, options.texel_mm, poses);
    let span = 3 * sampled.poses.len();
    let mut values = std::mem::take(&mut sampled.reflectance);
    let mut deviations = vec![f16::NAN; values.len()];
    let texels = values.par_chunks_mut(span.max(1)).zip(deviations.par_chunks_mut(span.max(1)));
    texels.enumerate().for_each(|(index, (values, deviations))| {
        // A texel's noise depends on nothing but the seed and its index.
        let mut random = Random::new(Random::new(options.seed ^ 0x6e6f_6973).bits() ^ index as u64);
        let place = sampled.position_mm(index);
        let samples = values.chunks_exact_mut(3).zip(deviations.chunks_exact_mut(3));
        for (pose, (values, deviations)) in samples.enumerate() {
            let (wi, wo) = sampled.directions(index, pose);
            let truth = reflectance(index, place, wi, wo);
            for ((value, deviation), truth) in values.iter_mut().zip(deviations).zip(truth.to_array()) {
                let truth = f64::from(truth);
                *deviation = f16::from_f64(options.noise.hypot(options.relative_noise * truth));
                let mut noisy = truth;
                if options.relative_noise > 0.0 {
                    noisy += options.relative_noise * truth * random.normal();
                }
                if options.noise > 0.0 {
                    noisy += options.noise * random.normal();
                }
                *value = noisy as f32;
            }
        }
    });
    sampled.reflectance = values;
    if options.noise > 0.0 || options.relative_noise > 0.0 {
        sampled.sigma = Some(deviations);
    }
    sampled
}

/// A random material of lobes with shapes shared by the channels, n 5..150: forward off-specular and
/// retro-reflective ones.
pub fn material(lobes: usize, random: &mut Random) -> LobeBrdf {
    let mut brdf = LobeBrdf::diffuse(colour(random, 0.1, 0.6));
    for index in 0..lobes {
        let n = random.uniform(5f64.ln(), 150f64.ln()).exp();
        let sign = if index > 0 && random.uniform(0.0, 1.0) < 0.4 { 1.0 } else { -1.0 };
        let cx = sign * random.uniform(0.85, 1.0);
        let c = Vec3::new(cx as f32, cx as f32, random.uniform(0.75, 1.0) as f32);
        let peak = random.uniform(0.1f64.ln(), 3f64.ln()).exp() as f32;
        brdf.lobes.push(Lobe::new(colour(random, 0.3, 1.0) * peak, c, n as f32));
    }
    brdf
}

fn colour(random: &mut Random, low: f64, high: f64) -> Rgb {
    let mut channel = || random.uniform(low, high) as f32;
    Rgb::new(channel(), channel(), channel())
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_reflectance::{Brdf, materials};

    fn options(noise: f64, relative_noise: f64) -> Options {
        Options { width: 12, height: 9, texel_mm: 0.5, poses: 200, noise, relative_noise, seed: 7 }
    }

    #[test]
    fn samples_without_noise_are_the_material_and_noise_has_the_spread_that_was_asked_for() {
        let felt = materials::published("felt").unwrap();
        let make = |options: &Options| sample(options, |_, _, wi, wo| felt.eval(wi, wo));
        let exact = make(&options(0.0, 0.0));
        let (wi, wo) = exact.directions(40, 17);
        assert_eq!(exact.samples(40).nth(17).unwrap(), felt.eval(wi, wo));
        let (noisy, again) = (make(&options(0.01, 0.0)), make(&options(0.01, 0.0)));
        assert_eq!(noisy, again);
        let off = |sampled: &SampledSbrdf, share: bool| {
            let squares: f64 = (sampled.reflectance.iter().zip(&exact.reflectance))
                .map(|(a, b)| f64::from(a - b) / if share { f64::from(*b) } else { 1.0 })
                .map(|off| off * off)
                .sum();
            (squares / exact.reflectance.len() as f64).sqrt()
        };
        assert_eq!(exact.sigma, None);
        let both = make(&options(0.01, 0.1));
        let (sigma, value) = (both.sigma.unwrap()[77].to_f64(), f64::from(exact.reflectance[77]));
        assert!((sigma / 0.01f64.hypot(0.1 * value) - 1.0).abs() < 1e-3);
        // 64,800 values: the spread is known to 0.3 %.
        assert!((off(&noisy, false) / 0.01 - 1.0).abs() < 0.02);
        assert!((off(&make(&options(0.0, 0.05)), true) / 0.05 - 1.0).abs() < 0.02);
    }
}
