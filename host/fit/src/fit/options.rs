//! How texels are fitted: method, device, scale of comparison, bounds; and what no method can do.

use super::extensions::Extensions;
use super::line_search;
use super::weights::Weights;
use lobelia_base::error::{Error, Result};

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
    /// As [`Self::Lm`], but with the published colours (4.10), one for all lobes: what least squares are
    /// compared with.
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
    /// The GPU, in f32, finished in f64 ([`super::gpu`]); the separable method alone.
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
    /// As [`Self::Log`], but where a bright sample (against 0.3 sr⁻¹) is exceeded by a ratio t it counts as t
    /// − 1 instead of ln t: the logarithm alone lets a peak rise to several times what was measured.
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

    /// The difference of a fitted value from a measured one, of which g is `goal`, and its derivative by the
    /// fitted value.
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
    /// Whether `lobes` is the most, and every texel gets as many as its samples support, anisotropic ones
    /// only where they are better by the same criterion; the separable method alone.
    pub choose: bool,
    /// Method.
    pub method: Method,
    /// Cx = Cy and β = 0.
    pub isotropic: bool,
    /// Lobes of its own for every channel, instead of shapes shared by all three; isotropic only, since a
    /// texel has one β.
    pub separate_channels: bool,
    /// Source of ρ_d.
    pub diffuse: Diffuse,
    /// Scale of comparison.
    pub residual: Residual,
    /// What a sample's squared residual weighs beside what the residual says.
    pub weights: Weights,
    /// Whether samples that lie far off weigh less, see [`super::separable::robust`]; the separable method
    /// alone.
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
    /// Too many lobes, more than one with the line search, anisotropic lobes of separate channels, or a
    /// percentile outside 0..100.
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
                "weights by standard deviation are for the linear residual, not {}, which has weights of its \
                 own",
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
