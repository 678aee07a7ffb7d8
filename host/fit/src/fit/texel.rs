//! One texel: shapes from its luminance, colours channel by channel.

use super::lm::{Freedom, Optimiser};
use super::model::Model;
use super::samples::{Samples, Target};
use super::separable::mirror::Mirror;
use super::separable::uncertainty::Sigma;
use super::start::{Effort, Problem, Search};
use super::weights::Weights;
use super::{Diffuse, FitOptions, Method, albedo, conserve, diffuse, evaluate, line_search};
use lobelia_reflectance::{LobeBrdf, Rgb, colour};

/// Plane of a map: the residual's RMS over the noise's ([`TexelFit::over_noise`]).
pub const OVER_NOISE: &str = "error.over_noise";

/// What one thread needs to fit texels without allocating for each.
#[derive(Debug, Clone, Default)]
pub struct Workspace {
    /// Samples of the texel at hand.
    pub samples: Samples,
    target: Target,
    optimiser: Optimiser,
    search: Search,
}

/// The fit of one texel; by default black, without a sample.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TexelFit {
    /// Coefficients.
    pub brdf: LobeBrdf,
    /// RMS of the residual over samples and channels, sr⁻¹.
    pub rms: f64,
    /// The same over the RMS of the samples; 0 for black samples.
    pub relative: f64,
    /// Samples that were valid.
    pub samples: usize,
    /// Standard deviations of the coefficients; the separable fit alone gives them.
    pub sigma: Option<Sigma>,
    /// The mirror term, where the number of lobes was a choice and one was found.
    pub mirror: Option<Mirror>,
    /// Combinations of the shapes' coefficients that the samples do not tell and a prior decided; the
    /// separable fit alone has one.
    pub tied: usize,
    /// Whether the number of lobes was a choice and another would have predicted left-out poses almost as
    /// well.
    pub doubtful: bool,
    /// The residual's RMS over that of the noise, both a sample and channel, with the unknowns counted out: 1
    /// where noise explains it. None where the samples do not weigh by their standard deviations.
    pub over_noise: Option<f64>,
    /// By how much `relative` rose where the fit had to be changed so that it makes no light; none where it
    /// did not.
    pub bound_price: Option<f64>,
}

/// The channels that share their lobes' shapes, and what the shapes are fitted to.
const TOGETHER: [&[usize]; 1] = [&[0, 1, 2]];
const APART: [&[usize]; 3] = [&[0], &[1], &[2]];

/// Fits the samples in the workspace. With fewer samples than unknowns fewer lobes are fitted, with none the
/// texel is black.
pub fn fit(workspace: &mut Workspace, options: &FitOptions) -> TexelFit {
    let count = workspace.samples.len();
    let lobes = affordable_lobes(count, options);
    let fixed = fixed_diffuse(&workspace.samples, options, lobes);
    let groups: &[&[usize]] = if options.separate_channels { &APART } else { &TOGETHER };
    let mut brdf = LobeBrdf::default();
    let (mut error, mut whole) = (0.0, 0.0);
    for channels in groups {
        let model = shapes(workspace, options, lobes, channels, fixed);
        let Workspace { samples, target, .. } = &mut *workspace;
        let mut amplitudes = Vec::with_capacity(channels.len());
        for &channel in *channels {
            target.set(samples, samples.rgb.iter().map(|rgb| rgb[channel]), options.residual);
            let mut of_channel = albedo::solve(samples, target, &model, fixed.map(|rgb| rgb[channel]));
            if options.method == Method::Ratio {
                albedo::mean_ratio(samples, target, &model, &mut of_channel);
            }
            amplitudes.push(of_channel);
        }
        let colour_of = |index: usize| {
            let mut colour = Rgb::ZERO;
            for (&channel, amplitudes) in channels.iter().zip(&amplitudes) {
                colour[channel] = amplitudes[index] as f32;
            }
            colour
        };
        let rho_s: Vec<Rgb> = (1..=model.lobes.len()).map(colour_of).collect();
        let group = model.to_brdf(colour_of(0), &rho_s);
        brdf.rho_d += group.rho_d;
        brdf.beta = group.beta;
        brdf.lobes.extend(group.lobes);
        let squares = evaluate::squares(samples, &model, channels, &amplitudes);
        (error, whole) = (error + squares.0, whole + squares.1);
    }
    let rms = (error / (3 * count).max(1) as f64).sqrt();
    let relative = if whole > 0.0 { (error / whole).sqrt() } else { 0.0 };
    let mut fit = TexelFit {
        brdf,
        rms,
        relative,
        samples: count,
        sigma: None,
        mirror: None,
        tied: 0,
        doubtful: false,
        over_noise: None,
        bound_price: None,
    };
    if let Some(limit) = options.largest_albedo() {
        hold(&mut fit, &workspace.samples, options, limit);
    }
    if options.weights == Weights::Sigma {
        let weighted = conserve::weighted_squares(&fit.brdf, &workspace.samples);
        fit.over_noise = over_noise(weighted, count, &fit.brdf, options);
    }
    fit
}

/// The root of a sum of squared residuals over σ, by what noise makes of it with the unknowns of a BRDF; none
/// without more values than unknowns.
pub(super) fn over_noise(
    weighted: f64,
    samples: usize,
    brdf: &LobeBrdf,
    options: &FitOptions,
) -> Option<f64> {
    let groups = if options.separate_channels { 3 } else { 1 };
    let amplitudes = 3 * (1 + brdf.lobes.len() / groups);
    // Of the unknowns of one channel ρ_d and ρ_s are amplitudes.
    let of_shapes = unknowns(brdf.lobes.len(), options) - 1 - brdf.lobes.len();
    let free = (3 * samples).checked_sub(amplitudes + of_shapes).filter(|&free| free > 0)?;
    Some((weighted / free as f64).sqrt())
}

/// Fits a texel with a directional albedo above `limit` again so that it has none, and measures its error
/// again.
fn hold(fit: &mut TexelFit, samples: &Samples, options: &FitOptions, limit: f64) {
    let targets: [Target; 3] = std::array::from_fn(|channel| {
        let mut target = Target::default();
        target.set(samples, samples.rgb.iter().map(|rgb| rgb[channel]), options.residual);
        target
    });
    let Some(brdf) = conserve::conserve(&fit.brdf, samples, &[0, 1, 2], &targets, limit) else { return };
    let (error, whole) = conserve::squares(&brdf, samples);
    let free = fit.relative;
    fit.rms = (error / (3 * samples.len()).max(1) as f64).sqrt();
    fit.relative = if whole > 0.0 { (error / whole).sqrt() } else { 0.0 };
    (fit.brdf, fit.sigma, fit.bound_price) = (brdf, None, Some((fit.relative - free).max(0.0)));
}

/// The lobes asked for, or as many as `count` samples can tell apart.
pub(super) fn affordable_lobes(count: usize, options: &FitOptions) -> usize {
    (0..=options.lobes).rev().find(|&lobes| lobes == 0 || count > unknowns(lobes, options)).unwrap_or(0)
}

/// Unknowns of one channel of a texel with so many lobes: ρ_d, and of each lobe ρ_s, the direction of C and
/// n; β of anisotropic ones, and what the options have beyond.
pub fn unknowns(lobes: usize, options: &FitOptions) -> usize {
    let [more, more_a_lobe] = options.extensions.unknowns();
    let per_lobe = more_a_lobe + if options.isotropic { 3 } else { 4 };
    1 + lobes * per_lobe + usize::from(!options.isotropic) + more
}

/// The diffuse term a channel where it is not fitted with the lobes. A percentile says what lies below the
/// lobes; without lobes it would only bias the mean.
fn fixed_diffuse(samples: &Samples, options: &FitOptions, lobes: usize) -> Option<[f64; 3]> {
    match (options.diffuse, options.method) {
        _ if lobes == 0 => None,
        (Diffuse::Joint, Method::Lm | Method::Ratio | Method::Separable) => None,
        (Diffuse::Percentile(percentile), _) => Some(percentile_of(samples, percentile)),
        (Diffuse::Joint, Method::LineSearch | Method::LineSearchScaled) => {
            Some(percentile_of(samples, super::PERCENTILE))
        }
    }
}

/// The lobes' shapes from one channel, or from the luminance of all three.
fn shapes(
    workspace: &mut Workspace,
    options: &FitOptions,
    lobes: usize,
    channels: &[usize],
    fixed: Option<[f64; 3]>,
) -> Model {
    let Workspace { samples, target, optimiser, search } = workspace;
    let luminance = |rgb: [f64; 3]| f64::from(colour::luminance(Rgb::from_array(rgb.map(|x| x as f32))));
    let diffuse = match channels {
        [channel] => {
            target.set(samples, samples.rgb.iter().map(|rgb| rgb[*channel]), options.residual);
            fixed.map(|rgb| rgb[*channel])
        }
        _ => {
            target.set(samples, samples.value.iter().copied(), options.residual);
            fixed.map(luminance)
        }
    };
    let freedom = Freedom { isotropic: options.isotropic, diffuse: diffuse.is_none() };
    let fixed_diffuse = diffuse.unwrap_or(0.0);
    match options.method.line_search() {
        Some(variant) if lobes > 0 => line_search::fit(samples, target, fixed_diffuse, freedom, variant),
        _ => {
            let problem = Problem { samples, target, freedom, fixed_diffuse };
            search.best(optimiser, &problem, lobes, Effort::TEXEL).0
        }
    }
}

/// The percentile of every channel.
fn percentile_of(samples: &Samples, percentile: f64) -> [f64; 3] {
    std::array::from_fn(|channel| {
        let mut values: Vec<f64> = samples.rgb.iter().map(|rgb| rgb[channel]).collect();
        diffuse::percentile(&mut values, percentile)
    })
}
