//! One texel: shapes from its luminance, colours channel by channel.

use super::lm::{Freedom, Optimiser};
use super::samples::{Samples, Target};
use super::start::{Effort, Problem, Search};
use super::{Diffuse, FitOptions, Method, albedo, diffuse, evaluate, line_search};
use crate::reflectance::{LobeBrdf, Rgb, colour};

/// What one thread needs to fit texels without allocating for each.
#[derive(Debug, Clone, Default)]
pub struct Workspace {
    /// Samples of the texel at hand.
    pub samples: Samples,
    target: Target,
    optimiser: Optimiser,
    search: Search,
}

/// The fit of one texel.
#[derive(Debug, Clone, PartialEq)]
pub struct TexelFit {
    /// Coefficients.
    pub brdf: LobeBrdf,
    /// RMS of the residual over samples and channels, sr⁻¹.
    pub rms: f64,
    /// The same over the RMS of the samples; 0 for black samples.
    pub relative: f64,
    /// Samples that were valid.
    pub samples: usize,
}

/// Fits the samples in the workspace. With fewer samples than unknowns fewer lobes are fitted, with none the texel is black.
pub fn fit(workspace: &mut Workspace, options: &FitOptions) -> TexelFit {
    let Workspace { samples, target, optimiser, search } = workspace;
    let count = samples.len();
    let per_lobe = if options.isotropic { 3 } else { 4 };
    let unknowns = |lobes: usize| 1 + lobes * per_lobe + usize::from(!options.isotropic);
    let lobes = (0..=options.lobes).rev().find(|&lobes| lobes == 0 || count > unknowns(lobes)).unwrap_or(0);
    let fixed = match (options.diffuse, options.method) {
        (Diffuse::Joint, Method::Lm) => None,
        (Diffuse::Percentile(percentile), _) => Some(percentile_of(samples, percentile)),
        (Diffuse::Joint, Method::LineSearch) => Some(percentile_of(samples, super::PERCENTILE)),
    };
    // A percentile says what lies below the lobes; without lobes it would only bias the mean.
    let fixed = if lobes == 0 { None } else { fixed };
    let fixed_luminance =
        fixed.map(|rgb| f64::from(colour::luminance(Rgb::from_array(rgb.map(|x| x as f32)))));
    let freedom = Freedom { isotropic: options.isotropic, diffuse: fixed.is_none() };
    target.set(samples, samples.value.iter().copied(), options.residual);
    let model = match options.method {
        Method::LineSearch if lobes > 0 => {
            line_search::fit(samples, target, fixed_luminance.unwrap_or(0.0), freedom)
        }
        _ => {
            let problem = Problem { samples, target, freedom, fixed_diffuse: fixed_luminance.unwrap_or(0.0) };
            search.best(optimiser, &problem, lobes, Effort::TEXEL).0
        }
    };
    let mut channels = [const { Vec::new() }; 3];
    for (channel, amplitudes) in channels.iter_mut().enumerate() {
        target.set(samples, samples.rgb.iter().map(|rgb| rgb[channel]), options.residual);
        *amplitudes = albedo::solve(samples, target, &model, fixed.map(|rgb| rgb[channel]));
    }
    let colour_of = |index: usize| Rgb::from_array(std::array::from_fn(|c| channels[c][index] as f32));
    let rho_s: Vec<Rgb> = (1..=model.lobes.len()).map(colour_of).collect();
    let brdf = model.to_brdf(colour_of(0), &rho_s);
    let (rms, relative) = evaluate::residual(samples, &model, &channels);
    TexelFit { brdf, rms, relative, samples: count }
}

/// The percentile of every channel.
fn percentile_of(samples: &Samples, percentile: f64) -> [f64; 3] {
    std::array::from_fn(|channel| {
        let mut values: Vec<f64> = samples.rgb.iter().map(|rgb| rgb[channel]).collect();
        diffuse::percentile(&mut values, percentile)
    })
}
