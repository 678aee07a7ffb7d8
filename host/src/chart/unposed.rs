//! Errors of fits on directions that they were not posed at.

use glam::Vec3;

use crate::reflectance::{Brdf, LobeBrdf, SbrdfMap};
use crate::synth;

/// Pairs of directions that samples of the same seed were not posed at.
pub(super) fn pairs(seed: u64) -> Vec<(Vec3, Vec3)> {
    (synth::poses(300, seed ^ 0x7465_7374).iter())
        .map(|pose| (pose.light_mm.normalize().as_vec3(), pose.camera_mm.normalize().as_vec3()))
        .collect()
}

/// ‖f̂ − f‖ / ‖f‖ of a texel over pairs of directions and the channels.
pub(super) fn relative_error(map: &SbrdfMap, texel: usize, truth: &impl Brdf, pairs: &[(Vec3, Vec3)]) -> f64 {
    let (mut off, mut all) = (0.0f64, 0.0f64);
    for &(wi, wo) in pairs {
        let f = truth.eval(wi, wo);
        off += f64::from((map.eval(texel, wi, wo) - f).length_squared());
        all += f64::from(f.length_squared());
    }
    (off / all).sqrt()
}

/// Relative errors of the texels on unposed directions, sorted.
pub(super) fn errors(map: &SbrdfMap, truth: &[LobeBrdf], seed: u64) -> Vec<f64> {
    let pairs = pairs(seed);
    let error = |(index, truth): (usize, &LobeBrdf)| relative_error(map, index, truth, &pairs);
    let mut errors: Vec<f64> = truth.iter().enumerate().map(error).collect();
    errors.sort_by(f64::total_cmp);
    errors
}
