//! The fit of one region.

use super::super::FitOptions;
use super::super::samples::Samples;
use super::super::separable::texel::Workspace;
use super::super::texel::{TexelFit, affordable_lobes};
use super::level::{self, Level};
use super::{Gathered, RhoD};
use lobelia_reflectance::{LobeBrdf, Rgb, albedo};

/// What every texel of a region has in common.
#[derive(Debug, Clone)]
pub(super) struct RegionFit {
    /// The fit of all its samples; with a ρ_d a texel that is black.
    pub fit: TexelFit,
    /// The median ρ_d, for a texel without a sample; with a ρ_d a texel.
    pub typical: Rgb,
    /// The largest ρ_d a channel with which a texel makes no light; with a ρ_d a texel, where albedos are
    /// bounded.
    pub room: Option<Rgb>,
    /// Variance of a sample of weight 1, a channel, sr⁻²; with a ρ_d a texel.
    pub variance: [f64; 3],
    /// Samples to which it was fitted.
    pub fitted: usize,
}

/// Fits the samples of a region's texels.
pub(super) fn fit(
    workspace: &mut Workspace,
    gathered: &Gathered,
    options: &FitOptions,
    rho_d: RhoD,
) -> RegionFit {
    let mut samples = Samples::default();
    for sample in &gathered.samples {
        samples.push_rgb(sample.wi, sample.wo, sample.rgb, sample.weight);
    }
    let fitted = samples.len();
    let black =
        RegionFit { fit: TexelFit::default(), typical: Rgb::ZERO, room: None, variance: [0.0; 3], fitted };
    if fitted == 0 {
        return black;
    }
    if rho_d == RhoD::Region {
        workspace.take(&samples);
        return RegionFit { fit: workspace.fit(options), ..black };
    }
    let texels = gathered.starts.len() - 1;
    let telling = fitted.saturating_sub(texels);
    let mut fit = if affordable_lobes(telling, options) > 0 || (options.lobes == 0 && telling > 0) {
        beside(workspace, &samples, gathered, options, Rgb::ZERO)
    } else {
        // So few samples a texel tell no more than its ρ_d.
        TexelFit::default()
    };
    let mut typical = typical(gathered, &fit.brdf, options);
    let limit = options.largest_albedo().map(|limit| limit as f32);
    if let Some(limit) = limit
        && (typical - room(&fit.brdf, limit)).max_element() > 0.0
    {
        // Lobes that leave half of the texels no room for their ρ_d are fitted again beside it.
        fit = beside(
            workspace,
            &samples,
            gathered,
            options,
            typical.min(Rgb::splat(limit / std::f32::consts::PI)),
        );
        typical = self::typical(gathered, &fit.brdf, options);
    }
    let room = limit.map(|limit| room(&fit.brdf, limit));
    let variance = variance(gathered, &fit.brdf, room, options);
    RegionFit { fit, typical: room.map_or(typical, |room| typical.min(room)), room, variance, fitted }
}

/// The lobes of a fit in which every texel has its own ρ_d; they keep the bound beside `level`.
fn beside(
    workspace: &mut Workspace,
    samples: &Samples,
    gathered: &Gathered,
    options: &FitOptions,
    level: Rgb,
) -> TexelFit {
    workspace.take_texels(samples, &gathered.starts, level.as_dvec3().to_array());
    let mut fit = workspace.fit(options);
    fit.brdf.rho_d = Rgb::ZERO;
    fit
}

/// The ρ_d that lobes leave of a limit on the directional albedo.
fn room(lobes: &LobeBrdf, limit: f32) -> Rgb {
    ((Rgb::splat(limit) - albedo::largest(lobes)) / std::f32::consts::PI).max(Rgb::ZERO)
}

/// The ρ_d of the texels without regard to the bound.
fn levels<'a>(
    gathered: &'a Gathered,
    lobes: &'a LobeBrdf,
    options: &'a FitOptions,
) -> impl Iterator<Item = Level> + 'a {
    gathered.texels().filter_map(|samples| level::level(samples, lobes, options))
}

/// The median of the texels' ρ_d, channel by channel; of two the lower.
fn typical(gathered: &Gathered, lobes: &LobeBrdf, options: &FitOptions) -> Rgb {
    let levels: Vec<Level> = levels(gathered, lobes, options).collect();
    let median = |channel: usize| {
        let mut values: Vec<f64> = levels.iter().map(|level| level.rho_d[channel]).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len().saturating_sub(1) / 2).map_or(0.0, |&value| value as f32)
    };
    Rgb::new(median(0), median(1), median(2))
}

/// The variance a channel of a sample of weight 1 about lobes and the texels' ρ_d.
fn variance(gathered: &Gathered, lobes: &LobeBrdf, room: Option<Rgb>, options: &FitOptions) -> [f64; 3] {
    let mut sums = [0.0; 3];
    for samples in gathered.texels() {
        let Some(level) = level::level(samples, lobes, options) else { continue };
        let brdf = LobeBrdf { rho_d: level.held(room), ..lobes.clone() };
        for sample in samples {
            let off = level::off(&brdf, sample);
            for (channel, sum) in sums.iter_mut().enumerate() {
                *sum += level::weight(sample, channel, options) * off[channel].powi(2);
            }
        }
    }
    // A lobe has a colour a channel, and four unknowns that the channels share.
    let unknowns = gathered.starts.len() - 1 + 2 * lobes.lobes.len();
    let freedom = gathered.samples.len().saturating_sub(unknowns).max(1) as f64;
    sums.map(|sum| sum / freedom)
}
