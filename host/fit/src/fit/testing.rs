//! Synthetic samples for the tests of the fitters: random poses, noise and errors of direction as a rig has
//! them.

use glam::Vec3;

use super::samples::Samples;
use lobelia_base::random::Random;
use lobelia_reflectance::{Brdf, Rgb};

/// A random direction, uniform in solid angle up to a polar angle.
fn direction(random: &mut Random, most_deg: f64) -> Vec3 {
    let z = random.uniform(most_deg.to_radians().cos(), 1.0);
    let (sin, cos) = random.uniform(0.0, std::f64::consts::TAU).sin_cos();
    let r = (1.0 - z * z).sqrt();
    Vec3::new((r * cos) as f32, (r * sin) as f32, z as f32)
}

/// Random pairs of directions, θ_i ≤ 75° and θ_o ≤ 65°.
pub(crate) fn directions(count: usize, seed: u64) -> Vec<(Vec3, Vec3)> {
    let mut random = Random::new(seed);
    (0..count).map(|_| (direction(&mut random, 75.0), direction(&mut random, 65.0))).collect()
}

/// Samples of a function at pairs of directions.
pub(crate) fn samples(pairs: &[(Vec3, Vec3)], f: impl Fn(Vec3, Vec3) -> Rgb) -> Samples {
    let mut samples = Samples::default();
    for &(wi, wo) in pairs {
        samples.push_rgb(wi, wo, f(wi, wo), 1.0);
    }
    samples
}

/// Samples as the rig would deliver them: directions off by `error_deg` RMS, noise 0.5 % of the value and
/// 1e-4 sr⁻¹.
pub(crate) fn measured(
    pairs: &[(Vec3, Vec3)],
    brdf: &impl Brdf,
    error_deg: f64,
    random: &mut Random,
) -> Samples {
    let mut samples = Samples::default();
    for &(wi, wo) in pairs {
        let mut off = |d: Vec3| {
            let mut turn = || (random.normal() * error_deg.to_radians() / 2f64.sqrt()) as f32;
            let (s, t) = (turn(), turn());
            let (u, v) = d.any_orthonormal_pair();
            (d + u * s + v * t).normalize()
        };
        let truth = brdf.eval(off(wi), off(wo));
        let mut noisy = |f: f32| f * (1.0 + 0.005 * random.normal() as f32) + 1e-4 * random.normal() as f32;
        let rgb = Rgb::new(noisy(truth.x), noisy(truth.y), noisy(truth.z));
        samples.push_rgb(wi, wo, rgb, 1.0);
    }
    samples
}

pub(crate) use crate::synth::material;

/// ‖f̂ − f‖ / ‖f‖ over pairs of directions and channels.
pub(crate) fn relative_error(fitted: &impl Brdf, truth: &impl Brdf, pairs: &[(Vec3, Vec3)]) -> f64 {
    let (mut error, mut whole) = (0.0, 0.0);
    for &(wi, wo) in pairs {
        let (a, b) = (fitted.eval(wi, wo).as_dvec3(), truth.eval(wi, wo).as_dvec3());
        error += (a - b).length_squared();
        whole += b.length_squared();
    }
    (error / whole).sqrt()
}
