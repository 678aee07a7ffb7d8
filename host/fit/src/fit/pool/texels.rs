//! A texel of a region: its ρ_d, if that is its own, and its errors.

use super::super::FitOptions;
use super::super::samples::Sample;
use super::super::separable::uncertainty::Sigma;
use super::super::texel::TexelFit;
use super::super::weights::Weights;
use super::RhoD;
use super::level::{level, off};
use super::region::RegionFit;
use lobelia_reflectance::LobeBrdf;

/// Sums over the texels of a region.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Totals {
    pub texels: usize,
    pub samples: usize,
    pub bounded: usize,
    /// Squares of the residuals and of the samples, over channels, sr⁻².
    pub error: f64,
    pub whole: f64,
}

impl Totals {
    /// Adds those of other texels.
    pub(super) fn add(&mut self, other: Self) {
        self.texels += other.texels;
        self.samples += other.samples;
        self.bounded += other.bounded;
        self.error += other.error;
        self.whole += other.whole;
    }
}

/// The fit of a texel of a region, of which the sums become part of the region's.
pub(super) fn fit(
    samples: &[Sample],
    region: &RegionFit,
    options: &FitOptions,
    rho_d: RhoD,
    totals: &mut Totals,
) -> TexelFit {
    let mut fit = TexelFit { samples: samples.len(), ..region.fit.clone() };
    let mut free = None;
    if rho_d == RhoD::Texel {
        let level = level(samples, &fit.brdf, options);
        let unbound = level.map_or(region.typical, |level| level.held(None));
        fit.brdf.rho_d = level.map_or(region.typical, |level| level.held(region.room));
        free = (fit.brdf.rho_d != unbound).then(|| LobeBrdf { rho_d: unbound, ..fit.brdf.clone() });
        let sigma = fit.sigma.get_or_insert_with(Sigma::default);
        let deviation = |channel: usize| {
            level.map_or(0.0, |level| (region.variance[channel] / level.weight[channel]).sqrt())
        };
        sigma.rho_d = std::array::from_fn(deviation);
    }
    let (error, whole) = squares(&fit.brdf, samples);
    let share = |error: f64| if whole > 0.0 { (error / whole).sqrt() } else { 0.0 };
    fit.rms = (error / (3 * samples.len()).max(1) as f64).sqrt();
    fit.relative = share(error);
    if options.weights == Weights::Sigma {
        fit.over_noise = over_noise(&fit.brdf, samples, rho_d);
    }
    if let Some(free) = free {
        let price = (fit.relative - share(squares(&free, samples).0)).max(0.0);
        fit.bound_price = Some(fit.bound_price.unwrap_or(0.0) + price);
    }
    let bounded = usize::from(fit.bound_price.is_some());
    totals.add(Totals { texels: 1, samples: samples.len(), bounded, error, whole });
    fit
}

/// The residual's RMS over that of the noise where samples weigh by their standard deviations. The lobes are
/// the region's: of a texel's own unknowns there is ρ_d at most.
fn over_noise(brdf: &LobeBrdf, samples: &[Sample], rho_d: RhoD) -> Option<f64> {
    let unknowns = if rho_d == RhoD::Texel { 3 } else { 0 };
    let free = (3 * samples.len()).saturating_sub(unknowns);
    let weighted: f64 = samples.iter().map(|sample| sample.weight * off(brdf, sample).length_squared()).sum();
    (free > 0).then(|| (weighted / free as f64).sqrt())
}

/// Sums over samples and channels of the squares of the residuals and of the values, sr⁻².
fn squares(brdf: &LobeBrdf, samples: &[Sample]) -> (f64, f64) {
    let sum = |of: &dyn Fn(&Sample) -> f64| samples.iter().map(of).sum();
    (sum(&|sample| off(brdf, sample).length_squared()), sum(&|sample| sample.rgb.as_dvec3().length_squared()))
}
