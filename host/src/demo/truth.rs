//! Errors against the simulator's truth: of the fits, on direction pairs that were never posed, and of the
//! registration.

use glam::{DVec2, Vec3};
use lobelia_hil_sim::optics::{Material, OpticalBench, noise};
use rayon::prelude::*;

use crate::by_angle::{self, ByAngle, Cone, Probes};
use crate::develop::camera;
use crate::develop::registration::Registration;
use crate::distance::{MAX_THETA_I_DEG, MAX_THETA_O_DEG};
use crate::reflectance::{Brdf, Rgb, SbrdfMap};
use crate::rig::config::RigConfig;
use crate::sampled::{SampledSbrdf, Window};

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

/// What really lies at every texel, and its reflectance at the pairs on which fits are judged.
pub struct Judge {
    pairs: Vec<(Vec3, Vec3)>,
    probes: Probes,
    /// Texels a row.
    width: usize,
    /// Which of the materials, turned ones apart, each texel has.
    kind: Vec<usize>,
    /// A material's number in the recipe, its reflectance at the pairs and at the probes.
    kinds: Vec<Kind>,
}

/// One material, in one direction of its pattern.
struct Kind {
    number: usize,
    at_pairs: Vec<Rgb>,
    at_probes: Vec<Rgb>,
}

impl Judge {
    /// A judge of fits to `sampled`, of what lies on the bench; errors by angle are told by `cone`.
    pub fn new(sampled: &SampledSbrdf, bench: &OpticalBench, cone: &Cone, seed: u64) -> Self {
        let (pairs, probes) = (unposed_pairs(seed), Probes::new(cone, seed));
        let sample = &bench.config().sample;
        let mut known: Vec<&Material> = Vec::new();
        let mut kinds = Vec::new();
        let kind = (0..sampled.texels()).map(|texel| {
            let place = sampled.position_mm(texel);
            let material = sample.at(place.x, place.y);
            known.iter().position(|other| std::ptr::eq(*other, material)).unwrap_or_else(|| {
                known.push(material);
                kinds.push(Kind {
                    number: sample.index_at(place.x, place.y),
                    at_pairs: pairs.iter().map(|&(wi, wo)| material.eval(wi, wo)).collect(),
                    at_probes: probes.values(|wi, wo| material.eval(wi, wo)),
                });
                kinds.len() - 1
            })
        });
        let kind = kind.collect();
        Self { pairs, probes, width: sampled.width, kind, kinds }
    }

    /// What lies at each texel of a window, row by row.
    fn at(&self, window: &Window) -> Vec<&Kind> {
        window.indices(self.width).map(|texel| &self.kinds[self.kind[texel]]).collect()
    }

    /// The number in the recipe of the material of each texel of a window.
    pub fn materials(&self, window: &Window) -> Vec<usize> {
        self.at(window).iter().map(|kind| kind.number).collect()
    }

    /// Relative RMS error ‖f̂ − f‖ / ‖f‖ over the unposed pairs and the three channels, a texel of a map of a
    /// window.
    pub fn errors(&self, map: &SbrdfMap, window: &Window) -> Vec<f32> {
        let error = |(texel, kind): (usize, &&Kind)| {
            let (mut off, mut all) = (0.0f64, 0.0f64);
            for (&(wi, wo), &truth) in self.pairs.iter().zip(&kind.at_pairs) {
                off += f64::from((map.eval(texel, wi, wo) - truth).length_squared());
                all += f64::from(truth.length_squared());
            }
            by_angle::relative(off, all)
        };
        self.at(window).par_iter().enumerate().map(error).collect()
    }

    /// The same by angle, inside and outside the measured cone.
    pub fn by_angle(&self, map: &SbrdfMap, window: &Window) -> ByAngle {
        let at = self.at(window);
        let fitted = |texel, wi, wo| map.eval(texel, wi, wo);
        self.probes.errors(at.len(), fitted, |texel| &at[texel].at_probes)
    }
}

/// RMS distance, in texels, between where a pose's registration puts points of the sample and where they
/// really are, over a grid of 9 × 9 points.
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
