//! Fits lobes (4.1)–(4.4) to sampled reflectance: texel by texel into an SBRDF map, or to one measured table.
//!
//! Five methods. [`Method::Separable`]: variable projection with the albedos of all channels in closed form ([`separable`]), for residuals
//! that are linear in f. [`Method::Lm`]: shapes by Levenberg–Marquardt on luminance ([`lm`]) from a deterministic search for the start ([`start`]),
//! then the colours by non-negative least squares ([`albedo`]); any number of lobes up to [`MOST_LOBES`]. [`Method::Ratio`]: the same with the published colours (4.10). [`Method::LineSearch`]: the
//! published search over n for one lobe ([`line_search`]), above a percentile for ρ_d ([`diffuse`]); [`Method::LineSearchScaled`]: a variant of it that stands noise better.
//!
//! [`pool`] fits one BRDF to all texels of a region; [`held_out`] tells errors on poses that were not fitted.

pub mod albedo;
pub mod brent;
pub mod chunks;
pub mod coat;
pub mod conserve;
pub mod diffuse;
pub mod evaluate;
pub mod extensions;
pub mod gpu;
pub mod held_out;
pub mod line_search;
pub mod linear;
pub mod lm;
pub mod model;
pub mod noted;
pub mod pool;
pub mod quadratic;
pub mod request;
pub mod samples;
pub mod separable;
pub mod start;
pub mod table;
#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
pub mod texel;
pub mod weights;

use rayon::prelude::*;

use extensions::Extensions;
use lobelia_base::error::{Error, Result};
use lobelia_base::progress;
use lobelia_reflectance::SbrdfMap;
use lobelia_reflectance::sampled::SampledSbrdf;
use separable::mirror::Mirror;
use separable::uncertainty::Sigma;
use texel::{TexelFit, Workspace};
use weights::Weights;

/// Most lobes of a fit.
pub const MOST_LOBES: usize = 4;

/// The percentile for ρ_d that the source uses.
pub const PERCENTILE: f64 = 10.0;

/// How the shapes are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Method {
    /// Variable projection, any number of lobes; residuals that are linear in f.
    #[default]
    Separable,
    /// Levenberg–Marquardt over shapes and amplitudes, any number of lobes and any residual.
    Lm,
    /// As [`Self::Lm`], but with the published colours (4.10), one for all lobes: what least squares are compared with.
    Ratio,
    /// The published line search over n, one lobe.
    LineSearch,
    /// The line search with an error that no unit of reflectance changes, over all n; one lobe.
    LineSearchScaled,
}

impl Method {
    /// The name on the command line and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Separable => "separable",
            Self::Lm => "lm",
            Self::Ratio => "ratio",
            Self::LineSearch => "line-search",
            Self::LineSearchScaled => "line-search-scaled",
        }
    }

    /// What the method is called in a sentence.
    pub fn title(self) -> &'static str {
        match self {
            Self::Separable => "variable projection",
            Self::Lm => "Levenberg–Marquardt",
            Self::Ratio => "Levenberg–Marquardt with mean ratios for colours",
            Self::LineSearch => "line search",
            Self::LineSearchScaled => "line search with a scaled error",
        }
    }

    /// Which line search it is, if it is one: a fit of one lobe above a ρ_d from a percentile.
    pub fn line_search(self) -> Option<line_search::Variant> {
        match self {
            Self::LineSearch => Some(line_search::Variant::Published),
            Self::LineSearchScaled => Some(line_search::Variant::Scaled),
            Self::Separable | Self::Lm | Self::Ratio => None,
        }
    }
}

/// What fits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Device {
    /// The CPU, in f64.
    #[default]
    Cpu,
    /// The GPU, in f32, finished in f64 ([`gpu`]); the separable method alone.
    Gpu,
}

/// Where ρ_d comes from.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Diffuse {
    /// An unknown beside the lobes. The line search cannot do that and takes the percentile.
    #[default]
    Joint,
    /// This percentile of the samples, channel by channel.
    Percentile(f64),
}

/// What the directional albedo of a fit is held to at every incidence, also where no pose looked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum AlbedoBound {
    /// Nothing.
    Free,
    /// 1, with 1.5 % for the error of the measurement's scale.
    #[default]
    Bounded,
    /// 1, to 0.1 %.
    Conserved,
}

impl AlbedoBound {
    /// The largest directional albedo; none where the fit is free, as the published line search always is.
    pub fn limit(self, method: Method) -> Option<f64> {
        match self {
            _ if method == Method::LineSearch => None,
            Self::Free => None,
            Self::Bounded => Some(1.015),
            Self::Conserved => Some(1.0),
        }
    }

    /// The name in maps.
    pub fn name(self) -> &'static str {
        match self {
            Self::Free => "free",
            Self::Bounded => "bounded",
            Self::Conserved => "conserved",
        }
    }
}

/// The scale on which fitted and measured values are compared: the fit minimises Σ w (g(f̂) − g(f))².
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Residual {
    /// g(f) = f.
    #[default]
    Linear,
    /// g(f) = f cosθ_o.
    CosineWeighted,
    /// g(f) = f / (0.02 sr⁻¹ + measured f): noise that is a share of the value above a small floor.
    Proportional,
    /// g(f) = ln(1e-3 + f cosθ_o).
    Log,
    /// As [`Self::Log`], but where a bright sample (against 0.3 sr⁻¹) is exceeded by a ratio t it counts as t − 1 instead of ln t:
    /// the logarithm alone lets a peak rise to several times what was measured.
    Balanced,
    /// g(f) = ∛(1e-3 + f cosθ_o): between linear and logarithmic.
    CubeRoot,
}

impl Residual {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Linear, Self::CosineWeighted, Self::Proportional, Self::Log, Self::Balanced, Self::CubeRoot];

    /// Floor of the logarithm and the cube root, sr⁻¹.
    const FLOOR: f64 = 1e-3;
    /// f cosθ_o at which the balanced residual is half logarithmic, half relative, sr⁻¹.
    const BRIGHT: f64 = 0.3;
    /// Floor of the proportional residual, sr⁻¹: additive noise over relative noise.
    pub(super) const NOISE_RATIO: f64 = 0.02;

    /// The name on the command line and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::CosineWeighted => "cosine-weighted",
            Self::Proportional => "proportional",
            Self::Log => "log",
            Self::Balanced => "balanced",
            Self::CubeRoot => "cube-root",
        }
    }

    /// Whether g is linear in f.
    pub fn is_linear(self) -> bool {
        matches!(self, Self::Linear | Self::CosineWeighted | Self::Proportional)
    }

    /// g and dg/df at a value; the proportional residual's share is in [`Self::own_weight`].
    #[inline]
    pub fn transform(self, value: f64, cos_o: f64) -> (f64, f64) {
        let above = || Self::FLOOR + value.max(0.0) * cos_o;
        match self {
            Self::Linear | Self::Proportional => (value, 1.0),
            Self::CosineWeighted => (value * cos_o, cos_o),
            Self::Log | Self::Balanced => (above().ln(), cos_o / above()),
            Self::CubeRoot => {
                let root = above().cbrt();
                (root, cos_o / (3.0 * root * root))
            }
        }
    }

    /// The difference of a fitted value from a measured one, of which g is `goal`, and its derivative by the fitted value.
    #[inline]
    pub fn difference(self, value: f64, cos_o: f64, goal: f64) -> (f64, f64) {
        let (g, slope) = self.transform(value, cos_o);
        let difference = g - goal;
        if self == Self::Balanced && difference > 0.0 {
            // e^d − 1 with d kept where its square is finite.
            let ratio = difference.min(300.0).exp();
            let measured = goal.exp() - Self::FLOOR;
            let share = measured / (measured + Self::BRIGHT);
            return (difference + share * (ratio - 1.0 - difference), (1.0 + share * (ratio - 1.0)) * slope);
        }
        (difference, slope)
    }

    /// The weight that depends on the measured value.
    pub fn own_weight(self, measured: f64) -> f64 {
        match self {
            Self::Proportional => 1.0 / (Self::NOISE_RATIO + measured.max(0.0)),
            _ => 1.0,
        }
    }
}

/// How texels are fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FitOptions {
    /// Lobes, 0 (diffuse only) to [`MOST_LOBES`].
    pub lobes: usize,
    /// Whether `lobes` is the most, and every texel gets as many as its samples support, anisotropic ones only where they are
    /// better by the same criterion; the separable method alone.
    pub choose: bool,
    /// Method.
    pub method: Method,
    /// Cx = Cy and β = 0.
    pub isotropic: bool,
    /// Lobes of its own for every channel, instead of shapes shared by all three; isotropic only, since a texel has one β.
    pub separate_channels: bool,
    /// Source of ρ_d.
    pub diffuse: Diffuse,
    /// Scale of comparison.
    pub residual: Residual,
    /// What a sample's squared residual weighs beside what the residual says.
    pub weights: Weights,
    /// Whether samples that lie far off weigh less, see [`separable::robust`]; the separable method alone.
    pub robust: bool,
    /// What fits.
    pub device: Device,
    /// What directional albedos are held to.
    pub bound: AlbedoBound,
    /// What texels may have beyond lobes of one exponent about the surface's normal.
    pub extensions: Extensions,
}

impl Default for FitOptions {
    fn default() -> Self {
        Self {
            lobes: 1,
            choose: false,
            method: Method::Separable,
            isotropic: true,
            separate_channels: false,
            diffuse: Diffuse::Joint,
            residual: Residual::Proportional,
            weights: Weights::Pose,
            robust: false,
            device: Device::Cpu,
            bound: AlbedoBound::default(),
            extensions: Extensions::default(),
        }
    }
}

impl FitOptions {
    /// The largest directional albedo that a fit may have.
    pub fn largest_albedo(&self) -> Option<f64> {
        self.bound.limit(self.method)
    }

    /// Refuses what no method can do.
    ///
    /// # Errors
    /// Too many lobes, more than one with the line search, anisotropic lobes of separate channels, or a percentile outside
    /// 0..100.
    pub fn check(&self) -> Result<()> {
        if self.lobes > MOST_LOBES {
            return Err(Error::input(format!(
                "{} lobes were asked for; at most {MOST_LOBES} can be fitted",
                self.lobes
            )));
        }
        if self.method.line_search().is_some() && self.lobes > 1 {
            return Err(Error::input(format!(
                "the line search fits one lobe, not {}; use --method lm for more",
                self.lobes
            )));
        }
        if self.weights == Weights::Sigma && self.residual != Residual::Linear {
            return Err(Error::input(format!(
                "weights by standard deviation are for the linear residual, not {}, which has weights of its own",
                self.residual.name()
            )));
        }
        if self.method == Method::Separable && !self.residual.is_linear() {
            return Err(Error::input(format!(
                "the separable fit needs a residual that is linear in f, which {} is not; use --method lm",
                self.residual.name()
            )));
        }
        if self.device == Device::Gpu && self.robust {
            return Err(Error::input("a robust fit is made on the CPU alone; use --device cpu"));
        }
        if self.device == Device::Gpu && self.method != Method::Separable {
            return Err(Error::input(format!(
                "the GPU does the separable fit alone, not {}; use --device cpu",
                self.method.name()
            )));
        }
        if self.choose && self.method != Method::Separable {
            return Err(Error::input(format!(
                "only the separable fit chooses the number of lobes; name one for {}",
                self.method.name()
            )));
        }
        if self.robust && self.method != Method::Separable {
            return Err(Error::input(format!(
                "only the separable fit is robust; {} is not",
                self.method.name()
            )));
        }
        Extensions::check(self)?;
        if self.separate_channels && !self.isotropic {
            return Err(Error::input(
                "lobes of separate channels must be isotropic: a texel has one direction of anisotropy",
            ));
        }
        match self.diffuse {
            Diffuse::Percentile(percentile) if !(0.0..=100.0).contains(&percentile) => {
                Err(Error::input(format!("percentile {percentile} for ρ_d lies outside 0 to 100")))
            }
            _ => Ok(()),
        }
    }
}

/// Fits every texel in parallel. Beside the coefficients the map has the planes `error.rms` (sr⁻¹), `error.relative` and
/// `samples` (valid ones a texel), where any does not tell all of its shapes' coefficients `tied` ([`separable::prior`]: how many were not), where lobes are chosen and a mirror was met `mirror.R`, `.G`, `.B` and `mirror.poses` ([`separable::mirror`]), and after the separable fit a standard deviation a coefficient, `sigma.rho_d.R` and so on. Where the number of lobes is a choice, `lobes` has it and `lobes.doubtful` marks texels in which another would predict left-out poses almost as well. Where samples weigh by their standard deviations, `error.over_noise` is the residual's RMS over that of the noise. Unless albedos are free, `bounded` marks the texels
/// that were changed so that they make no light and `error.bound_price` says by how much `error.relative` rose for it. The result is the same byte for byte whatever the number of threads.
///
/// # Errors
/// Input errors: options that no method can do, or not one valid sample in any texel.
pub fn fit_sbrdf(sampled: &SampledSbrdf, options: &FitOptions) -> Result<SbrdfMap> {
    options.check()?;
    let bar = progress::bar("fitting", sampled.texels() as u64, "texels");
    let map = fit_window(sampled, options, || bar.advance(1))?;
    has_samples(&map)?;
    Ok(map)
}

/// Refuses a map of which no texel had a valid sample.
fn has_samples(map: &SbrdfMap) -> Result<()> {
    if map.extra["samples"].iter().all(|&samples| samples == 0.0) {
        return Err(Error::input("the sampled SBRDF has no valid sample in any texel"));
    }
    Ok(())
}

/// What is wrong where samples are to weigh by standard deviations that are not there.
fn no_sigma() -> Error {
    Error::input("the sampled SBRDF has no standard deviations to weigh by (array sigma); use --weights pose")
}

/// As [`fit_sbrdf`] with options that are checked, for a window that may be without any sample; `done` is called a texel.
fn fit_window(sampled: &SampledSbrdf, options: &FitOptions, done: impl Fn() + Sync) -> Result<SbrdfMap> {
    if options.weights == Weights::Sigma && sampled.sigma.is_none() {
        return Err(no_sigma());
    }
    let fits = match options.method {
        Method::Separable if options.device == Device::Gpu => gpu::fit(sampled, options, &done)?,
        Method::Separable => fit_blocks(sampled, options, &done),
        Method::Lm | Method::Ratio | Method::LineSearch | Method::LineSearchScaled => {
            fit_texels(sampled, options, &done)
        }
    };
    Ok(map_of(sampled, options, &fits))
}

/// Texel by texel.
fn fit_texels(sampled: &SampledSbrdf, options: &FitOptions, done: &(impl Fn() + Sync)) -> Vec<TexelFit> {
    (0..sampled.texels())
        .into_par_iter()
        .with_min_len(16)
        .map_init(Workspace::default, |workspace, index| {
            load(&mut workspace.samples, sampled, index, options, &[]);
            let fit = texel::fit(workspace, options);
            done();
            fit
        })
        .collect()
}

/// Edge of the blocks of texels that share the directions from which the separable fit starts.
const BLOCK: usize = 16;

/// The separable fit, block by block.
fn fit_blocks(sampled: &SampledSbrdf, options: &FitOptions, done: &(impl Fn() + Sync)) -> Vec<TexelFit> {
    let poses = separable::data::Poses::new(&sampled.poses).off_normal(options.extensions.normals);
    let (width, height) = (sampled.width, sampled.height);
    let columns = width.div_ceil(BLOCK);
    let blocks: Vec<Vec<TexelFit>> = (0..columns * height.div_ceil(BLOCK))
        .into_par_iter()
        .map_init(separable::texel::Workspace::default, |workspace, block| {
            let texels = block_texels(width, height, columns, block);
            workspace.settle(&poses, sampled, texels.clone().nth(texels.clone().count() / 2).unwrap_or(0));
            let fits = texels.map(|index| {
                workspace.load(&poses, sampled, index, options);
                let fit = workspace.fit_next(options, index % width % BLOCK);
                done();
                fit
            });
            fits.collect()
        })
        .collect();
    let mut fits: Vec<Option<TexelFit>> = vec![None; sampled.texels()];
    for (block, done) in blocks.into_iter().enumerate() {
        for (index, fit) in block_texels(width, height, columns, block).zip(done) {
            fits[index] = Some(fit);
        }
    }
    fits.into_iter().flatten().collect()
}

/// The texels of a block, row by row.
fn block_texels(
    width: usize,
    height: usize,
    columns: usize,
    block: usize,
) -> impl Iterator<Item = usize> + Clone {
    let (left, top) = (block % columns * BLOCK, block / columns * BLOCK);
    let (right, bottom) = ((left + BLOCK).min(width), (top + BLOCK).min(height));
    (top..bottom).flat_map(move |y| (left..right).map(move |x| y * width + x))
}

/// The samples of texel `index` but for some poses.
fn load(
    samples: &mut samples::Samples,
    sampled: &SampledSbrdf,
    index: usize,
    options: &FitOptions,
    left_out: &[usize],
) {
    samples.clear();
    let all = samples::of_texel(sampled, index, options.weights);
    for sample in all.filter(|sample| !left_out.contains(&sample.pose)) {
        samples.push_rgb(sample.wi, sample.wo, sample.rgb, sample.weight);
    }
}

/// The planes `sigma.*`.
fn add_sigmas(map: &mut SbrdfMap, fits: &[TexelFit]) {
    let mut plane = |name: String, value: &dyn Fn(&Sigma) -> f64| {
        let of = |fit: &TexelFit| fit.sigma.as_ref().map_or(0.0, |sigma| value(sigma) as f32);
        map.extra.insert(format!("sigma.{name}"), fits.iter().map(of).collect());
    };
    for (channel, letter) in ["R", "G", "B"].into_iter().enumerate() {
        plane(format!("rho_d.{letter}"), &|sigma| sigma.rho_d[channel]);
    }
    plane("beta".into(), &|sigma| sigma.beta);
    let lobes = fits.iter().filter_map(|fit| fit.sigma.as_ref()).map(|sigma| sigma.lobes.len()).max();
    for lobe in 0..lobes.unwrap_or(0) {
        let of = |sigma: &Sigma| sigma.lobes.get(lobe).copied().unwrap_or_default();
        for (channel, letter) in ["R", "G", "B"].into_iter().enumerate() {
            plane(format!("lobe{lobe}.rho_s.{letter}"), &|sigma| of(sigma).rho_s[channel]);
        }
        for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
            plane(format!("lobe{lobe}.C.{letter}"), &|sigma| of(sigma).c[axis]);
        }
        plane(format!("lobe{lobe}.n"), &|sigma| of(sigma).n);
    }
}

/// The planes `mirror.*`.
fn add_mirrors(map: &mut SbrdfMap, fits: &[TexelFit]) {
    let mut plane = |name: &str, value: &dyn Fn(&Mirror) -> f32| {
        let of = |fit: &TexelFit| fit.mirror.as_ref().map_or(0.0, value);
        map.extra.insert(format!("mirror.{name}"), fits.iter().map(of).collect());
    };
    for (channel, letter) in ["R", "G", "B"].into_iter().enumerate() {
        plane(letter, &|mirror| mirror.value[channel] as f32);
    }
    plane("poses", &|mirror| mirror.poses.len() as f32);
}

/// The map of the fits, with planes of errors and provenance.
fn map_of(sampled: &SampledSbrdf, options: &FitOptions, fits: &[TexelFit]) -> SbrdfMap {
    let planes = if options.choose {
        fits.iter().map(|fit| fit.brdf.lobes.len()).max().unwrap_or(0)
    } else {
        options.lobes * if options.separate_channels { 3 } else { 1 }
    };
    let mut map = SbrdfMap::new(sampled.width, sampled.height, planes);
    map.add_microfacets(fits.iter().map(|fit| fit.brdf.microfacets.len()).max().unwrap_or(0));
    for (index, fit) in fits.iter().enumerate() {
        map.set(index, &fit.brdf);
    }
    let mut plane = |name: &str, value: fn(&TexelFit) -> f32| {
        map.extra.insert(name.into(), fits.iter().map(value).collect());
    };
    plane("error.rms", |fit| fit.rms as f32);
    plane("error.relative", |fit| fit.relative as f32);
    plane("samples", |fit| fit.samples as f32);
    if options.choose {
        plane("lobes", |fit| fit.brdf.lobes.len() as f32);
        plane("lobes.doubtful", |fit| f32::from(u8::from(fit.doubtful)));
        plane("anisotropic", |fit| {
            f32::from(u8::from(fit.brdf.lobes.iter().any(|lobe| lobe.c.x != lobe.c.y)))
        });
    }
    if options.weights == Weights::Sigma {
        plane(texel::OVER_NOISE, |fit| fit.over_noise.unwrap_or(0.0) as f32);
    }
    if options.largest_albedo().is_some() {
        plane("bounded", |fit| f32::from(u8::from(fit.bound_price.is_some())));
        plane("error.bound_price", |fit| fit.bound_price.unwrap_or(0.0) as f32);
    }
    if fits.iter().any(|fit| fit.tied > 0) {
        map.extra.insert("tied".into(), fits.iter().map(|fit| fit.tied as f32).collect());
    }
    if fits.iter().any(|fit| fit.mirror.is_some()) {
        add_mirrors(&mut map, fits);
    }
    if options.method == Method::Separable {
        add_sigmas(&mut map, fits);
        extensions::add_sigmas(&mut map, fits);
    }
    let diffuse = match options.diffuse {
        Diffuse::Joint if options.method.line_search().is_none() => "joint".to_string(),
        Diffuse::Joint => format!("percentile {PERCENTILE}"),
        Diffuse::Percentile(percentile) => format!("percentile {percentile}"),
    };
    for (key, value) in [
        ("fit.method", options.method.name().to_string()),
        (
            "fit.lobes",
            if options.choose { format!("auto:{}", options.lobes) } else { options.lobes.to_string() },
        ),
        ("fit.residual", options.residual.name().to_string()),
        ("fit.diffuse", diffuse),
        ("fit.isotropic", options.isotropic.to_string()),
        ("fit.weights", options.weights.name().to_string()),
        ("fit.robust", options.robust.to_string()),
        ("fit.bound", options.bound.name().to_string()),
        ("texel_mm", sampled.texel_mm.to_string()),
    ] {
        map.attributes.insert(key.into(), value);
    }
    for (key, value) in options.extensions.attributes() {
        map.attributes.insert(key.into(), value);
    }
    if options.device == Device::Gpu {
        map.attributes.insert("fit.device".into(), "gpu".into());
    }
    map
}
