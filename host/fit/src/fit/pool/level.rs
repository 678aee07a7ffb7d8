//! The ρ_d of a texel beside the lobes of its region.

use glam::DVec3;

use super::super::samples::Sample;
use super::super::{FitOptions, Residual};
use lobelia_reflectance::{Brdf, LobeBrdf, Rgb, colour};

/// ρ_d of one texel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Level {
    /// The weighted mean that the lobes leave a channel, at least 0, sr⁻¹.
    pub rho_d: [f64; 3],
    /// The sum of weights a channel.
    pub weight: [f64; 3],
}

impl Level {
    /// ρ_d where it may be at most `room`.
    pub(super) fn held(&self, room: Option<Rgb>) -> Rgb {
        let free = DVec3::from_array(self.rho_d).as_vec3();
        room.map_or(free, |room| free.min(room))
    }
}

/// What a sample's squared residual weighs in a channel, as in the separable fit.
pub(super) fn weight(sample: &Sample, channel: usize, options: &FitOptions) -> f64 {
    let measured =
        if options.separate_channels { sample.rgb[channel] } else { colour::luminance(sample.rgb) };
    let cosine = if options.residual == Residual::CosineWeighted { f64::from(sample.wo.z) } else { 1.0 };
    sample.weight * (cosine * options.residual.own_weight(f64::from(measured))).powi(2)
}

/// The fitted value less the measured one, a channel, sr⁻¹.
pub(super) fn off(brdf: &LobeBrdf, sample: &Sample) -> DVec3 {
    (brdf.eval(sample.wi, sample.wo) - sample.rgb).as_dvec3()
}

/// The ρ_d of a texel beside lobes without one; none without samples.
pub(super) fn level(samples: &[Sample], lobes: &LobeBrdf, options: &FitOptions) -> Option<Level> {
    let (mut sums, mut weights) = ([0.0; 3], [0.0; 3]);
    for sample in samples {
        let left = -off(lobes, sample);
        for channel in 0..3 {
            let weight = weight(sample, channel, options);
            sums[channel] += weight * left[channel];
            weights[channel] += weight;
        }
    }
    let rho_d = std::array::from_fn(|channel| (sums[channel] / weights[channel]).max(0.0));
    weights.iter().all(|&weight| weight > 0.0).then_some(Level { rho_d, weight: weights })
}
