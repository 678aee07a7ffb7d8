//! Errors against the simulator's truth: of the fits, on direction pairs that were never posed, and of the registration.

use glam::{DVec2, Vec3};
use lobelia_hil_sim::optics::{OpticalBench, noise};
use rayon::prelude::*;

use crate::develop::camera;
use crate::develop::registration::Registration;
use crate::plan::choose::{MAX_THETA_I_DEG, MAX_THETA_O_DEG};
use crate::reflectance::{Brdf, SbrdfMap};
use crate::rig::config::RigConfig;
use crate::sampled::texel_position_mm;

/// Direction pairs on which fits are judged.
pub const PAIRS: usize = 500;

/// Random direction pairs, uniform in solid angle within the polar cuts.
pub fn unposed_pairs(seed: u64) -> Vec<(Vec3, Vec3)> {
    let uniform = |k: usize, part: u64| {
        (noise::combine(&[seed, 0x7061_6972, k as u64, part]) >> 40) as f32 / (1u64 << 24) as f32
    };
    let direction = |k: usize, part: u64, max_deg: f64| {
        let z = 1.0 - uniform(k, part) * (1.0 - max_deg.to_radians().cos()) as f32;
        let (sin, cos) = (std::f32::consts::TAU * uniform(k, part + 1)).sin_cos();
        let r = (1.0 - z * z).max(0.0).sqrt();
        Vec3::new(r * cos, r * sin, z)
    };
    (0..PAIRS).map(|k| (direction(k, 0, MAX_THETA_I_DEG), direction(k, 2, MAX_THETA_O_DEG))).collect()
}

/// Relative RMS error ‖f̂ − f‖ / ‖f‖ over `pairs` and the three channels, a texel.
pub fn reflectance_errors(
    config: &RigConfig,
    bench: &OpticalBench,
    map: &SbrdfMap,
    pairs: &[(Vec3, Vec3)],
) -> Vec<f32> {
    let sample = &bench.config().sample;
    let error = |texel: usize| {
        let place = texel_position_mm(map.width, map.height, config.carrier.texel_mm(), texel);
        let material = sample.at(place.x, place.y);
        let (mut off, mut all) = (0.0f64, 0.0f64);
        for &(wi, wo) in pairs {
            let truth = material.eval(wi, wo);
            off += f64::from((map.eval(texel, wi, wo) - truth).length_squared());
            all += f64::from(truth.length_squared());
        }
        (off / all).sqrt() as f32
    };
    (0..map.width * map.height).into_par_iter().map(error).collect()
}

/// RMS distance, in texels, between where a pose's registration puts points of the sample and where they really are,
/// over a grid of 9 × 9 points.
pub fn registration_error_texels(
    config: &RigConfig,
    bench: &OpticalBench,
    axes_rad: [f64; 4],
    registration: &Registration,
) -> f64 {
    let carrier = &config.carrier;
    let at = |k: usize, length: f64| (k as f64 / 8.0 - 0.5) * length;
    let squares: Vec<f64> = (0..81)
        .map(|k| {
            let place = DVec2::new(at(k % 9, carrier.sample_width_mm), at(k / 9, carrier.sample_height_mm));
            let seen = DVec2::from(bench.project(axes_rad, place.x, place.y));
            let found = registration.homography.invert(camera::to_normalised(&config.camera, seen));
            (found - place).length_squared()
        })
        .collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt() / carrier.texel_mm()
}

/// The middle value; NaN without values.
pub fn median(values: &[f32]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f32::total_cmp);
    sorted.get(sorted.len() / 2).copied().map_or(f64::NAN, f64::from)
}
