//! The arguments of `lobelia fit`, and what is asked of the fit by them.

use std::path::PathBuf;
use std::str::FromStr as _;

use clap::{Args, ValueEnum};

use super::pool;
use crate::cli::map_encoding;
use crate::fit::chunks::Part;
use crate::fit::held_out::Which;
use crate::fit::pool::{MOST_SAMPLES, RhoD};
use crate::fit::request::{Lobes, Request, Terms};
use crate::fit::weights::Weights;
use crate::fit::{AlbedoBound, Device, Diffuse, Method, Residual};
use crate::provenance::Texts;
use crate::reflectance::MapEncoding;

/// Arguments of `lobelia fit`.
#[derive(Debug, Clone, Args)]
pub(in crate::cli) struct FitArgs {
    /// A sampled SBRDF (folder.zarr) or a measured table (Cornell's .brdf, ALTA's .dat, .txt or .alta, MERL's
    /// .binary); with --merge optional: shards are then checked against it
    #[arg(required_unless_present = "merge")]
    pub(super) input: Option<PathBuf>,
    /// The SBRDF map to write (OpenEXR); required for a sampled SBRDF
    #[arg(short, long, value_name = "FILE.exr")]
    pub(super) output: Option<PathBuf>,
    /// Lobes beside the diffuse term: 0 to 4, or `auto`: as many as the samples support, at most 4 or N with
    /// `auto:N`, for each texel of a sampled SBRDF (separable method; anisotropic only where that is better)
    /// or each wavelength of a table; else 2 for lm, 1 with the line search
    #[arg(long, default_value = "auto", value_name = "auto[:N]|N", value_parser = Lobes::from_str)]
    pub(super) lobes: Lobes,
    /// What is fitted beside the diffuse term. `auto`, the default for tables, is lobes where --lobes is a
    /// number; the default for texels is lobes
    #[arg(long, value_enum)]
    pub(super) model: Option<ModelName>,
    /// Fit texels with a normal of their own, about which their lobes stand: channels normal.x and normal.y.
    /// Where --lobes is `auto`, a texel has one only if its samples are predicted better with it; separable
    /// method
    #[arg(long)]
    pub(super) normals: bool,
    /// Fit lobes whose exponent goes from n along the normal to n_grazing at the horizon: channels
    /// lobe0.n_grazing and so on. Where --lobes is `auto`, only for texels whose samples are predicted better
    /// so; separable method. Tables too, by lm
    #[arg(long)]
    pub(super) sharpening: bool,
    /// How the lobes' shapes are found
    #[arg(long, value_enum, default_value_t = MethodName::Auto)]
    pub(super) method: MethodName,
    /// The scale on which fitted and measured values are compared; `auto` is balanced for tables,
    /// proportional for texels, linear where those weigh by their standard deviations
    #[arg(long, value_enum, default_value_t = ResidualName::Auto)]
    pub(super) residual: ResidualName,
    /// What a sample of a sampled SBRDF weighs. `auto` is sigma, with the linear residual, where the standard
    /// deviations are there and neither residual nor method are named otherwise; else pose
    #[arg(long, value_enum, default_value_t = WeightsName::Auto)]
    pub(super) weights: WeightsName,
    /// Let samples that lie far off the rest (dust, shadows, glints) weigh less or nothing, by Huber's and
    /// Tukey's weights; separable method. A highlight that very few poses meet may be lost with them
    #[arg(long)]
    pub(super) robust: bool,
    /// What fits a sampled SBRDF. Both find the same lobes but for rounding; only the CPU gives the same
    /// bytes on every machine. The GPU does the separable method
    #[arg(long, value_enum, default_value_t = DeviceName::Auto)]
    pub(super) device: DeviceName,
    /// Isotropic lobes only: Cx = Cy, no direction of anisotropy. Tables are always fitted so
    #[arg(long)]
    pub(super) isotropic: bool,
    /// Lobes of its own for every channel of a sampled SBRDF, instead of shapes that the channels share;
    /// implies --isotropic
    #[arg(long)]
    pub(super) separate_channels: bool,
    /// Take the diffuse term from this percentile of a texel's samples instead of fitting it with the lobes
    #[arg(long, value_name = "PERCENT")]
    pub(super) diffuse_percentile: Option<f64>,
    /// Hold the directional albedo of every texel or wavelength to 1, to 0.1 %. Without it the limit
    /// is 1.015, for the error of the measurement's scale. What that costs is printed and reported
    #[arg(long, conflicts_with = "no_bound")]
    pub(super) conserve_energy: bool,
    /// Let texels and wavelengths reflect more light than they receive. Where no pose looked, such fits may
    /// be off by any factor
    #[arg(long)]
    pub(super) no_bound: bool,
    /// Wavelengths of a table to fit, nm; three of them can be written as red, green and blue, the longest as
    /// red. Without it 450, 550 and 650, or the one of a table that has no other
    #[arg(long, value_delimiter = ',', value_name = "NM,…")]
    pub(super) wavelengths_nm: Vec<f64>,
    /// Incidences of a table that the fit does not see, degrees; the errors there are reported
    #[arg(long, value_delimiter = ',', value_name = "DEG,…")]
    pub(super) hold_out_theta_deg: Vec<f64>,
    /// Hold each pair of a table's incidences out in turn and compare what auto takes with every fixed size
    /// on them; minutes
    #[arg(long)]
    pub(super) hold_out_each_pair: bool,
    /// Compare the deterministic start on a table with the best of this many random ones
    #[arg(long, default_value_t = 0, value_name = "N")]
    pub(super) random_starts: usize,
    /// Fit part I of N of a sampled SBRDF and write it as a shard for --merge; a shard that is there already
    /// is left as it is
    #[arg(long, value_name = "I/N", conflicts_with = "merge")]
    pub(super) chunks: Option<Part>,
    /// Fit MIP levels as well, each to the samples averaged over its texels, down to one texel:
    /// FILE.mip1.exr, FILE.mip2.exr, … For a fit in parts give it to --merge, with the sampled SBRDF and the
    /// options of the parts
    #[arg(long)]
    pub(super) mip: bool,
    /// Write maps in lines deflated by ZIP, which every program that reads OpenEXR opens, instead of in
    /// tiles, which are faster. For a fit in parts give it to --merge
    #[arg(long, conflicts_with = "chunks")]
    pub(super) scanlines: bool,
    /// Join the shards of all parts into the map: the same, byte for byte, as of one run
    #[arg(long, value_name = "SHARD.exr", num_args = 1..)]
    pub(super) merge: Vec<PathBuf>,
    /// What the maps say of how they were made.
    #[arg(skip)]
    pub(super) made: Texts,
    /// Leave poses of a sampled SBRDF out of the fit and tell its error on them: a share such as 0.1 or a
    /// number such as 20, drawn by --seed, every:N (poses 0, N, 2 N, …) or list:I,J,… (poses count from 0).
    /// For a fit in parts give it to each part and to --merge
    #[arg(long, value_name = "SHARE|N|every:N|list:I,J")]
    pub(super) hold_out_poses: Option<Which>,
    /// Fit one BRDF a region to the samples of all its texels, each at its own directions. Texels of one
    /// colour of this picture are one region; transparent ones are of none and stay black. `lobelia edit
    /// cluster --index` writes such pictures; any PNG of one pixel a texel will do
    #[arg(long, value_name = "INDEX.png", conflicts_with_all = ["chunks", "merge", "mip"])]
    pub(super) pool: Option<PathBuf>,
    /// Whether a pooled fit has one diffuse term a region, or one a texel beside the region's lobes
    #[arg(long, value_enum, default_value_t = RhoDName::Region, value_name = "WHOSE", requires = "pool")]
    pub(super) pool_rho_d: RhoDName,
    /// The colour of texels that are of no region, #rrggbb or a grey value from 0 to 255
    #[arg(long, value_name = "COLOUR", requires = "pool", value_parser = pool::parse_colour)]
    pub(super) pool_outside: Option<[u8; 3]>,
    /// Most samples to which a region is fitted: those of whole texels that have any, drawn by --seed; errors
    /// are of all
    #[arg(long, value_name = "N", default_value_t = MOST_SAMPLES, requires = "pool")]
    pub(super) pool_samples: usize,
}

/// Names of models on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum ModelName {
    /// Lobes alone, or with a GGX microfacet term: what predicts left-out incidences, or poses, better
    Auto,
    /// Lobes alone
    Lobes,
    /// Lobes and one GGX microfacet term
    Ggx,
}

/// Names of methods on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum MethodName {
    /// Separable where the residual is linear in f, else Levenberg–Marquardt
    Auto,
    /// Variable projection: only the shapes are searched, the albedos of all channels follow in closed form
    Separable,
    /// The published line search over the exponent; one lobe
    LineSearch,
    /// The line search with its error over the roots' mean square, and over all exponents: n stands a hundred
    /// times the noise, C does not; one lobe
    LineSearchScaled,
    /// Levenberg–Marquardt over shapes and albedos, on luminance, then colours
    Lm,
    /// As lm, with one colour for all lobes as published: the mean ratio of the samples to the lobes; for
    /// comparison, since it fails with noise where the lobes are near zero. Texels alone
    Ratio,
}

/// Whose diffuse term is, on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum RhoDName {
    /// One a region
    Region,
    /// One a texel
    Texel,
}

/// Names of weights on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum WeightsName {
    /// Sigma where that is known
    Auto,
    /// The pose's weight, and what the residual says
    Pose,
    /// 1/σ² of the sample
    Sigma,
}

/// Names of devices on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum DeviceName {
    /// The GPU if there are 16,384 texels or more, it is no software, and it fits the middle chunk in less
    /// time than the CPU; the CPU for --chunks, whose parts may be fitted on different machines
    Auto,
    /// The CPU, on as many threads as --threads
    Cpu,
    /// The GPU, also one in software
    Gpu,
}

/// Names of residuals on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum ResidualName {
    /// Proportional for texels, linear where they weigh by their standard deviations; balanced for tables
    Auto,
    /// f
    Linear,
    /// f cosθ_o
    CosineWeighted,
    /// f over the measured f plus 0.02 sr⁻¹
    Proportional,
    /// ln(1e-3 + f cosθ_o)
    Log,
    /// As log, but relative where a bright sample is exceeded
    Balanced,
    /// Cube root of (1e-3 + f cosθ_o)
    CubeRoot,
}

impl FitArgs {
    /// What is asked of the fit.
    pub(super) fn request(&self) -> Request {
        Request {
            lobes: self.lobes,
            terms: self.model.map(|model| match model {
                ModelName::Auto => Terms::Choose,
                ModelName::Lobes => Terms::Lobes,
                ModelName::Ggx => Terms::Ggx,
            }),
            method: match self.method {
                MethodName::Auto => None,
                MethodName::Separable => Some(Method::Separable),
                MethodName::LineSearch => Some(Method::LineSearch),
                MethodName::LineSearchScaled => Some(Method::LineSearchScaled),
                MethodName::Lm => Some(Method::Lm),
                MethodName::Ratio => Some(Method::Ratio),
            },
            residual: match self.residual {
                ResidualName::Auto => None,
                ResidualName::Linear => Some(Residual::Linear),
                ResidualName::CosineWeighted => Some(Residual::CosineWeighted),
                ResidualName::Proportional => Some(Residual::Proportional),
                ResidualName::Log => Some(Residual::Log),
                ResidualName::Balanced => Some(Residual::Balanced),
                ResidualName::CubeRoot => Some(Residual::CubeRoot),
            },
            weights: match self.weights {
                WeightsName::Auto => None,
                WeightsName::Pose => Some(Weights::Pose),
                WeightsName::Sigma => Some(Weights::Sigma),
            },
            device: match self.device {
                DeviceName::Auto => None,
                DeviceName::Cpu => Some(Device::Cpu),
                DeviceName::Gpu => Some(Device::Gpu),
            },
            isotropic: self.isotropic,
            separate_channels: self.separate_channels,
            diffuse: self.diffuse_percentile.map_or(Diffuse::Joint, Diffuse::Percentile),
            robust: self.robust,
            bound: self.bound(),
            normals: self.normals,
            sharpening: self.sharpening,
        }
    }

    pub(super) fn bound(&self) -> AlbedoBound {
        match (self.no_bound, self.conserve_energy) {
            (true, _) => AlbedoBound::Free,
            (_, true) => AlbedoBound::Conserved,
            _ => AlbedoBound::Bounded,
        }
    }

    /// Whose ρ_d a pooled fit has.
    pub(super) fn rho_d(&self) -> RhoD {
        match self.pool_rho_d {
            RhoDName::Region => RhoD::Region,
            RhoDName::Texel => RhoD::Texel,
        }
    }

    pub(super) fn encoding(&self) -> MapEncoding {
        map_encoding(self.scanlines)
    }
}
