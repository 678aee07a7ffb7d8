//! `lobelia fit`: a sampled SBRDF into an SBRDF map, at once or in parts, or one measured table into lobes a wavelength.

mod held_out;
mod parts;
mod pool;
mod table;
mod warnings;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, ValueEnum};
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::figures::ErrorFigure;
use crate::files;
use crate::fit::chunks::{self, Part};
use crate::fit::extensions::{Extensions, Microfacets};
use crate::fit::held_out::{HeldOut, Which, left_out};
use crate::fit::pool::{MOST_SAMPLES, RhoD};
use crate::fit::weights::Weights;
use crate::fit::{AlbedoBound, Device, Diffuse, FitOptions, MOST_LOBES, Method, Residual, gpu};
use crate::mip;
use crate::progress::counted;
use crate::provenance::Texts;
use crate::reflectance::{MapEncoding, SbrdfMap, albedo};
use crate::report::Report;
use crate::sampled::SampledStore;
use crate::warning::Warning;
use crate::warning::samples::Tally;
use crate::warning::texels::unexplained_in_words;

/// Directional albedo from which on a texel counts as making light: the error of a measurement's scale and of sums is below.
const MAKES_LIGHT: f32 = 1.02;
/// Lobes where the method cannot choose: what most materials need and no start fails on.
const AUTO_LOBES: usize = 2;

/// Arguments of `lobelia fit`.
#[derive(Debug, Clone, Args)]
pub(super) struct FitArgs {
    /// A sampled SBRDF (folder.zarr) or a measured table (Cornell's .brdf, ALTA's .dat, .txt or .alta, MERL's .binary); with --merge optional: shards are then checked against it
    #[arg(required_unless_present = "merge")]
    pub(super) input: Option<PathBuf>,
    /// The SBRDF map to write (OpenEXR); required for a sampled SBRDF
    #[arg(short, long, value_name = "FILE.exr")]
    pub(super) output: Option<PathBuf>,
    /// Lobes beside the diffuse term: 0 to 4, or `auto`: as many as the samples support, at most 4 or N with `auto:N`, for each texel of
    /// a sampled SBRDF (separable method; anisotropic only where that is better) or each wavelength of a table; else 2 for lm, 1 with the line search
    #[arg(long, default_value = "auto", value_name = "auto[:N]|N", value_parser = parse_lobes)]
    pub(super) lobes: Lobes,
    /// What is fitted beside the diffuse term. `auto`, the default for tables, is lobes where --lobes is a number; the default for texels is
    /// lobes
    #[arg(long, value_enum)]
    pub(super) model: Option<ModelName>,
    /// Fit texels with a normal of their own, about which their lobes stand: channels normal.x and normal.y. Where --lobes is `auto`, a texel has
    /// one only if its samples are predicted better with it; separable method
    #[arg(long)]
    pub(super) normals: bool,
    /// Fit lobes whose exponent goes from n along the normal to n_grazing at the horizon: channels lobe0.n_grazing and so on. Where --lobes is
    /// `auto`, only for texels whose samples are predicted better so; separable method. Tables too, by lm
    #[arg(long)]
    pub(super) sharpening: bool,
    /// How the lobes' shapes are found
    #[arg(long, value_enum, default_value_t = MethodName::Auto)]
    pub(super) method: MethodName,
    /// The scale on which fitted and measured values are compared; `auto` is balanced for tables, proportional for texels, linear where those weigh by their standard deviations
    #[arg(long, value_enum, default_value_t = ResidualName::Auto)]
    pub(super) residual: ResidualName,
    /// What a sample of a sampled SBRDF weighs. `auto` is sigma, with the linear residual, where the standard deviations are there and neither
    /// residual nor method are named otherwise; else pose
    #[arg(long, value_enum, default_value_t = WeightsName::Auto)]
    pub(super) weights: WeightsName,
    /// Let samples that lie far off the rest (dust, shadows, glints) weigh less or nothing, by Huber's and Tukey's weights; separable method. A
    /// highlight that very few poses meet may be lost with them
    #[arg(long)]
    pub(super) robust: bool,
    /// What fits a sampled SBRDF. Both find the same lobes but for rounding; only the CPU gives the same bytes on every machine. The GPU does the
    /// separable method
    #[arg(long, value_enum, default_value_t = DeviceName::Auto)]
    pub(super) device: DeviceName,
    /// Isotropic lobes only: Cx = Cy, no direction of anisotropy. Tables are always fitted so
    #[arg(long)]
    pub(super) isotropic: bool,
    /// Lobes of its own for every channel of a sampled SBRDF, instead of shapes that the channels share; implies --isotropic
    #[arg(long)]
    pub(super) separate_channels: bool,
    /// Take the diffuse term from this percentile of a texel's samples instead of fitting it with the lobes
    #[arg(long, value_name = "PERCENT")]
    pub(super) diffuse_percentile: Option<f64>,
    /// Hold the directional albedo of every texel or wavelength to 1, to 0.1 %. Without it the limit is 1.015, for the error of the
    /// measurement's scale. What that costs is printed and reported
    #[arg(long, conflicts_with = "no_bound")]
    pub(super) conserve_energy: bool,
    /// Let texels and wavelengths reflect more light than they receive. Where no pose looked, such fits may be off by any factor
    #[arg(long)]
    pub(super) no_bound: bool,
    /// Wavelengths of a table to fit, nm; three of them can be written as red, green and blue, the longest as red. Without it 450, 550
    /// and 650, or the one of a table that has no other
    #[arg(long, value_delimiter = ',', value_name = "NM,…")]
    pub(super) wavelengths_nm: Vec<f64>,
    /// Incidences of a table that the fit does not see, degrees; the errors there are reported
    #[arg(long, value_delimiter = ',', value_name = "DEG,…")]
    pub(super) hold_out_theta_deg: Vec<f64>,
    /// Hold each pair of a table's incidences out in turn and compare what auto takes with every fixed size on them; minutes
    #[arg(long)]
    pub(super) hold_out_each_pair: bool,
    /// Compare the deterministic start on a table with the best of this many random ones
    #[arg(long, default_value_t = 0, value_name = "N")]
    pub(super) random_starts: usize,
    /// Fit part I of N of a sampled SBRDF and write it as a shard for --merge; a shard that is there already is left as it is
    #[arg(long, value_name = "I/N", conflicts_with = "merge")]
    pub(super) chunks: Option<Part>,
    /// Fit MIP levels as well, each to the samples averaged over its texels, down to one texel: FILE.mip1.exr, FILE.mip2.exr, … For a fit
    /// in parts give it to --merge, with the sampled SBRDF and the options of the parts
    #[arg(long)]
    pub(super) mip: bool,
    /// Write maps in lines deflated by ZIP, which every program that reads OpenEXR opens, instead of in tiles, which are faster. For a fit
    /// in parts give it to --merge
    #[arg(long, conflicts_with = "chunks")]
    pub(super) scanlines: bool,
    /// Join the shards of all parts into the map: the same, byte for byte, as of one run
    #[arg(long, value_name = "SHARD.exr", num_args = 1..)]
    pub(super) merge: Vec<PathBuf>,
    /// What the maps say of how they were made.
    #[arg(skip)]
    pub(super) made: Texts,
    /// Leave poses of a sampled SBRDF out of the fit and tell its error on them: a share such as 0.1 or a number such as 20, drawn by --seed,
    /// every:N (poses 0, N, 2 N, …) or list:I,J,… (poses count from 0). For a fit in parts give it to each part and to --merge
    #[arg(long, value_name = "SHARE|N|every:N|list:I,J")]
    pub(super) hold_out_poses: Option<Which>,
    /// Fit one BRDF a region to the samples of all its texels, each at its own directions. Texels of one colour of this picture are one region;
    /// transparent ones are of none and stay black. `lobelia edit cluster --index` writes such pictures; any PNG of one pixel a texel will do
    #[arg(long, value_name = "INDEX.png", conflicts_with_all = ["chunks", "merge", "mip"])]
    pub(super) pool: Option<PathBuf>,
    /// Whether a pooled fit has one diffuse term a region, or one a texel beside the region's lobes
    #[arg(long, value_enum, default_value_t = RhoDName::Region, value_name = "WHOSE", requires = "pool")]
    pub(super) pool_rho_d: RhoDName,
    /// The colour of texels that are of no region, #rrggbb or a grey value from 0 to 255
    #[arg(long, value_name = "COLOUR", requires = "pool", value_parser = pool::parse_colour)]
    pub(super) pool_outside: Option<[u8; 3]>,
    /// Most samples to which a region is fitted: those of whole texels that have any, drawn by --seed; errors are of all
    #[arg(long, value_name = "N", default_value_t = MOST_SAMPLES, requires = "pool")]
    pub(super) pool_samples: usize,
}

/// A number of lobes, or the choice left to the command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Lobes {
    /// What the samples support up to this many; [`AUTO_LOBES`] where the method cannot choose, or 1 where it cannot do more.
    Auto(usize),
    /// This many.
    Count(usize),
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
    /// The line search with its error over the roots' mean square, and over all exponents: n stands a hundred times the noise, C does not; one
    /// lobe
    LineSearchScaled,
    /// Levenberg–Marquardt over shapes and albedos, on luminance, then colours
    Lm,
    /// As lm, with one colour for all lobes as published: the mean ratio of the samples to the lobes; for comparison, since it fails with
    /// noise where the lobes are near zero. Texels alone
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

impl From<RhoDName> for RhoD {
    fn from(name: RhoDName) -> Self {
        match name {
            RhoDName::Region => Self::Region,
            RhoDName::Texel => Self::Texel,
        }
    }
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
    /// The GPU if there are 16,384 texels or more, it is no software, and it fits the middle chunk in less time than the CPU; the CPU for
    /// --chunks, whose parts may be fitted on different machines
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

/// What the command found, for the report.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct FitOutcome {
    /// Errors.
    pub(super) errors: Vec<ErrorFigure>,
    /// Counts and rates.
    pub(super) figures: BTreeMap<String, serde_json::Value>,
    /// What a person needs to know before the fit is trusted.
    pub(super) warnings: Vec<Warning>,
}

fn parse_lobes(text: &str) -> std::result::Result<Lobes, String> {
    if text == "auto" {
        return Ok(Lobes::Auto(MOST_LOBES));
    }
    let (number, lobes): (_, fn(usize) -> Lobes) = match text.strip_prefix("auto:") {
        Some(most) => (most, Lobes::Auto),
        None => (text, Lobes::Count),
    };
    match number.parse() {
        Ok(count) if count <= MOST_LOBES => Ok(lobes(count)),
        _ => Err(format!("must be `auto`, `auto:N` or N, with N from 0 to {MOST_LOBES}")),
    }
}

impl FitArgs {
    /// Lets the samples of a store weigh by their standard deviations where they are there and nothing else was asked for.
    fn weigh(&self, options: &mut FitOptions, store: &SampledStore) {
        let free = self.weights == WeightsName::Auto && self.residual == ResidualName::Auto;
        if free && options.method == Method::Separable && store.has_sigma() {
            (options.weights, options.residual) = (Weights::Sigma, Residual::Linear);
        }
    }

    fn encoding(&self) -> MapEncoding {
        super::map_encoding(self.scanlines)
    }

    fn bound(&self) -> AlbedoBound {
        match (self.no_bound, self.conserve_energy) {
            (true, _) => AlbedoBound::Free,
            (_, true) => AlbedoBound::Conserved,
            _ => AlbedoBound::Bounded,
        }
    }

    fn method(&self, residual: Residual) -> Method {
        match self.method {
            MethodName::LineSearch => Method::LineSearch,
            MethodName::LineSearchScaled => Method::LineSearchScaled,
            MethodName::Separable => Method::Separable,
            MethodName::Ratio => Method::Ratio,
            MethodName::Auto if residual.is_linear() => Method::Separable,
            MethodName::Auto | MethodName::Lm => Method::Lm,
        }
    }

    fn lobes(&self) -> usize {
        match (self.lobes, self.method) {
            (Lobes::Count(count), _) => count,
            (Lobes::Auto(most), MethodName::LineSearch | MethodName::LineSearchScaled) => most.min(1),
            (Lobes::Auto(most), _) => most.min(AUTO_LOBES),
        }
    }

    /// The number of lobes of texels, and whether that is the most among which each texel chooses.
    fn texel_lobes(&self, method: Method) -> (usize, bool) {
        match self.lobes {
            Lobes::Auto(most) if method == Method::Separable => (most, true),
            _ => (self.lobes(), false),
        }
    }

    fn residual(&self, auto: Residual) -> Residual {
        match self.residual {
            ResidualName::Auto => auto,
            ResidualName::Linear => Residual::Linear,
            ResidualName::CosineWeighted => Residual::CosineWeighted,
            ResidualName::Proportional => Residual::Proportional,
            ResidualName::Log => Residual::Log,
            ResidualName::Balanced => Residual::Balanced,
            ResidualName::CubeRoot => Residual::CubeRoot,
        }
    }
}

/// Runs `lobelia fit` and notes errors, figures and time.
///
/// # Errors
/// As [`fit_input`].
pub(super) fn run(args: &FitArgs, context: &mut super::Context) -> Result<()> {
    let asked_to_merge = !args.merge.is_empty();
    let mut args = args.with_store_named_last();
    if asked_to_merge && args.merge.is_empty() {
        return Err(Error::input("--merge names no shard: give it those that --chunks wrote"));
    }
    args.input.iter().chain(&args.merge).chain(&args.pool).for_each(|path| context.report.input(path));
    args.made = made(&args, &context.report);
    let seed = context.seed;
    let outcome = context.report.stage("fit", || fit_input(&args, seed))?;
    context.report.errors.extend(outcome.errors);
    context.report.figures.extend(outcome.figures);
    context.warn(outcome.warnings);
    Ok(())
}

/// What maps say of how they were made, and which poses of their samples weigh nothing. Of a sampled SBRDF the hash is that of its size and poses: for one of the samples each part
/// of a fit would have to read them all.
fn made(args: &FitArgs, report: &Report) -> Texts {
    let mut of_map = Report { inputs: Vec::new(), ..report.clone() };
    let mut weightless = None;
    if let Some(input) = &args.input {
        match SampledStore::open(input) {
            Ok(store) => {
                of_map.input_by(input, store.geometry_sha256());
                weightless = left_out(&store.poses);
            }
            Err(_) => of_map.input(input),
        }
    }
    args.pool.iter().for_each(|index| of_map.input(index));
    of_map.provenance().into_iter().chain(weightless).collect()
}

/// Prints what was found to stdout and writes the map where one is asked for. `seed` is that of the random starts.
///
/// # Errors
/// Input errors for files and options that make no sense; failures of the disk.
fn fit_input(args: &FitArgs, seed: u64) -> Result<FitOutcome> {
    args.output.iter().try_for_each(|output| files::try_file(output))?;
    if let Some(output) = &args.output
        && files::ending(output) != "exr"
    {
        return Err(Error::input(format!("{}: an SBRDF map's name ends in .exr", output.display())));
    }
    if !args.merge.is_empty() {
        return parts::merge(args, seed);
    }
    let Some(input) = &args.input else {
        return Err(Error::input("there is nothing to fit: name a sampled SBRDF or a measured table"));
    };
    match files::ending(input).as_str() {
        "zarr" => fit_sampled(args, input, seed),
        "brdf" | "dat" | "txt" | "alta" | "binary" => table::fit(args, input, seed),
        _ if files::what_is(input) == Some("a run") => {
            let run = input.display();
            Err(Error::input(format!(
                "{run}: a run; develop it first: lobelia develop {run} -o sampled.zarr"
            )))
        }
        _ => Err(Error::input(format!(
            "{}{}: `fit` reads a sampled SBRDF (.zarr) or a measured table (.brdf, .dat, .txt, .alta, .binary); the name's ending must say which",
            input.display(),
            files::what_is(input).map_or_else(String::new, |what| format!(": {what}"))
        ))),
    }
}

/// The map to write, which a sampled SBRDF needs.
fn output(args: &FitArgs) -> Result<&Path> {
    let message = "a sampled SBRDF needs -o FILE.exr, the SBRDF map to write";
    args.output.as_deref().ok_or_else(|| Error::input(message))
}

/// On Ctrl-C says what is kept and how to go on, and ends. Writing is atomic, so nothing half-written is left in a map's place.
fn say_when_interrupted(part: bool) {
    let hint = if part {
        "this part is not written; the same command does it again, and parts that are done are kept"
    } else {
        "nothing is written; the same command begins again, and one in parts (--chunks 1/8 to 8/8, then --merge) keeps those that are done"
    };
    // A second handler in one process is refused; the first one serves.
    let _ = ctrlc::set_handler(move || {
        eprintln!("lobelia: the fit was interrupted: {hint}");
        std::process::exit(1);
    });
}

fn fit_sampled(args: &FitArgs, input: &Path, seed: u64) -> Result<FitOutcome> {
    let output = output(args)?;
    let mut options = sampled_options(args)?;
    if args.chunks.is_some() && args.mip {
        return Err(Error::input(
            "a part has the finest level alone; give --mip to --merge, which fits the others",
        ));
    }
    let mut store = SampledStore::open(input)?;
    let held = held_out::hold_out(args, &mut store, seed)?;
    say_when_interrupted(args.chunks.is_some());
    args.weigh(&mut options, &store);
    if let Some(part) = args.chunks {
        return parts::fit(&store, &options, part, held.as_ref(), output, &args.made);
    }
    if let Some(index) = &args.pool {
        let tally = Tally::default();
        let mut outcome = pool::fit(args, &store, &options, index, held.as_ref(), seed, &tally)?;
        warnings::of_samples(&mut outcome, &store, tally);
        return Ok(outcome);
    }
    if args.device == DeviceName::Auto {
        options.device = gpu::faster(&store, &options)?;
    }
    let start = Instant::now();
    let tally = Tally::default();
    let mut map = chunks::fit_store_counted(&store, &options, &tally)?;
    let seconds = start.elapsed().as_secs_f64();
    map.attributes.extend(args.made.clone());
    held.iter().for_each(|held| held.note(&mut map));
    write_map(&map, output, args.encoding())?;
    if args.mip {
        write_levels(&store, &options, (output, &map, args.encoding()), (&args.made, held.as_ref()))?;
    }
    let mut outcome = sampled_outcome(&map, seconds);
    let held_out = held_out::judge(held.as_ref(), &store, &map, &mut outcome)?;
    warnings::of_samples(&mut outcome, &store, tally);
    warnings::of_fit(&mut outcome, &store, &map, &options)?;
    let (texels, poses) = (store.width * store.height, store.poses.len());
    let device = match options.device {
        Device::Cpu => String::new(),
        Device::Gpu => format!(" on {}", gpu::name()?),
    };
    print(&format!(
        "{texels} texels × {}, {} by {}{device}: {seconds:.1} s\n{}",
        counted(poses as u64, "pose", "poses"),
        lobes_in_words(&map, &options),
        options.method.name(),
        outcome.residuals()
            + &held_out
            + &albedos_in_words(&map)
            + &mirrors_in_words(&map)
            + &ties_in_words(&map)
            + &unexplained_in_words(&map)
    ))?;
    Ok(outcome)
}

/// How texels are fitted; on the CPU unless the GPU was named.
fn sampled_options(args: &FitArgs) -> Result<FitOptions> {
    if !args.hold_out_theta_deg.is_empty() || args.random_starts > 0 || args.hold_out_each_pair {
        return Err(Error::input(
            "--hold-out-theta-deg, --hold-out-each-pair and --random-starts are for measured tables (.brdf)",
        ));
    }
    if !args.wavelengths_nm.is_empty() {
        return Err(Error::input(
            "--wavelengths-nm is for measured tables (.brdf); a sampled SBRDF has red, green and blue",
        ));
    }
    let weights = if args.weights == WeightsName::Sigma { Weights::Sigma } else { Weights::Pose };
    let auto = if weights == Weights::Sigma { Residual::Linear } else { FitOptions::default().residual };
    let residual = args.residual(auto);
    let method = args.method(residual);
    let (lobes, choose) = args.texel_lobes(method);
    let options = FitOptions {
        lobes,
        choose,
        method,
        isotropic: args.isotropic || args.separate_channels,
        separate_channels: args.separate_channels,
        robust: args.robust,
        diffuse: args.diffuse_percentile.map_or(Diffuse::Joint, Diffuse::Percentile),
        residual,
        weights,
        device: if args.device == DeviceName::Gpu { Device::Gpu } else { Device::Cpu },
        bound: args.bound(),
        extensions: Extensions {
            normals: args.normals,
            sharpening: args.sharpening,
            microfacets: match args.model {
                Some(ModelName::Ggx) => Microfacets::Always,
                Some(ModelName::Auto) if choose => Microfacets::Choose,
                _ => Microfacets::Never,
            },
        },
    };
    options.check()?;
    Ok(options)
}

/// Fits all MIP levels but the finest and writes each beside it, with how it was made and which poses were held out.
fn write_levels(
    store: &SampledStore,
    options: &FitOptions,
    (finest, map, encoding): (&Path, &SbrdfMap, MapEncoding),
    (made, held): (&Texts, Option<&HeldOut>),
) -> Result<()> {
    let of = mip::fingerprint(map);
    for level in 1..=mip::last([store.width, store.height]) {
        let mut map = chunks::fit_level(store, options, level)?;
        map.attributes.extend(made.clone());
        map.attributes.insert(mip::OF.into(), of.clone());
        held.iter().for_each(|held| held.note(&mut map));
        write_map(&map, &mip::path(finest, level), encoding)?;
    }
    Ok(())
}

/// `2 lobes`, or how many texels took how many.
fn lobes_in_words(map: &SbrdfMap, options: &FitOptions) -> String {
    let word = |count: usize| if count == 1 { "lobe" } else { "lobes" };
    let Some(chosen) = map.extra.get("lobes") else {
        return format!("{} {}", options.lobes, word(options.lobes));
    };
    let most = map.lobes.len();
    let share = |count: usize| {
        let texels = chosen.iter().filter(|&&lobes| lobes as usize == count).count();
        100.0 * texels as f64 / chosen.len().max(1) as f64
    };
    let shares: Vec<String> =
        (0..=most).map(|count| format!("{count} {} in {:.0} %", word(count), share(count))).collect();
    let doubtful =
        map.extra.get("lobes.doubtful").map_or(0, |plane| plane.iter().filter(|&&x| x > 0.0).count());
    match doubtful {
        0 => shares.join(", "),
        count => format!(
            "{} (told apart from another number by little in {:.0} %)",
            shares.join(", "),
            100.0 * count as f64 / chosen.len().max(1) as f64
        ),
    }
}

/// The texels in which a mirror was met.
fn mirrors(map: &SbrdfMap) -> usize {
    map.extra.get("mirror.poses").map_or(0, |poses| poses.iter().filter(|&&count| count > 0.0).count())
}

/// How many those are; empty where there is none.
fn mirrors_in_words(map: &SbrdfMap) -> String {
    match mirrors(map) {
        0 => String::new(),
        count => format!(
            "mirror: {count} of {} texels have a peak that the poses do not resolve; left out of the lobes, in mirror.*\n",
            map.width * map.height
        ),
    }
}

/// The texels with coefficients that a prior decided.
fn tied(map: &SbrdfMap) -> usize {
    map.extra.get("tied").map_or(0, |tied| tied.iter().filter(|&&count| count > 0.0).count())
}

/// How many those are; empty where there is none.
fn ties_in_words(map: &SbrdfMap) -> String {
    match tied(map) {
        0 => String::new(),
        count => format!(
            "tied: {count} of {} texels have coefficients that the poses do not tell, taken from neighbours or Phong's lobe\n",
            map.width * map.height
        ),
    }
}

/// How many texels make no light only because they are held to that, and at what price; of a free fit how many make light.
fn albedos_in_words(map: &SbrdfMap) -> String {
    let texels = map.width * map.height;
    match bound_prices(map) {
        Some(prices) if prices.is_empty() => String::new(),
        Some(prices) => format!(
            "bounded: {} of {texels} texels would, where no pose looked, reflect more light than they receive or far more than was measured; holding them costs {:.2} % of the samples' RMS in median, {:.2} % at most\n",
            prices.len(),
            100.0 * quantile(&prices, 0.5),
            100.0 * quantile(&prices, 1.0)
        ),
        None => match making_light(map) {
            (0, _) => String::new(),
            (count, largest) => format!(
                "not to be trusted: {count} of {texels} texels reflect more light than they receive, up to {largest:.3} times; leave out --no-bound\n"
            ),
        },
    }
}

/// By how much the relative residual rose in each texel that was changed so that it makes no light, ascending; none after a free fit.
fn bound_prices(map: &SbrdfMap) -> Option<Vec<f32>> {
    let (prices, bounded) = (map.extra.get("error.bound_price")?, map.extra.get("bounded")?);
    let mut prices: Vec<f32> =
        prices.iter().zip(bounded).filter(|pair| *pair.1 > 0.0).map(|pair| *pair.0).collect();
    prices.sort_by(f32::total_cmp);
    Some(prices)
}

/// The texels whose directional albedo is above [`MAKES_LIGHT`], and the largest albedo where there are any.
fn making_light(map: &SbrdfMap) -> (usize, f32) {
    let with = |(count, largest): (usize, f32), texel: usize| {
        let brdf = map.texel(texel);
        // Most texels need no look at every incidence.
        if albedo::at_most(&brdf).is_some_and(|most| most <= MAKES_LIGHT) {
            return (count, largest);
        }
        let albedo = albedo::largest(&brdf).max_element();
        (count + usize::from(albedo > MAKES_LIGHT), largest.max(albedo))
    };
    let texels = (0..map.width * map.height).into_par_iter();
    texels.fold(|| (0, 0.0), with).reduce(|| (0, 0.0), |a, b| (a.0 + b.0, a.1.max(b.1)))
}

/// A quantile of ascending values; 0 without any.
fn quantile(sorted: &[f32], share: f64) -> f64 {
    let place = (share * sorted.len() as f64) as usize;
    sorted.get(place.min(sorted.len().saturating_sub(1))).map_or(0.0, |&value| f64::from(value))
}

impl FitOutcome {
    /// The residuals in a sentence.
    fn residuals(&self) -> String {
        let percent = |name: &str| {
            100.0 * self.errors.iter().find(|error| error.name == name).map_or(0.0, |error| error.value)
        };
        format!(
            "residual: median {:.2} % of the samples' RMS, 95 % of the texels below {:.2} %\n",
            percent("residual_relative_median"),
            percent("residual_relative_p95"),
        )
    }
}

/// Errors and rates of a fitted map.
fn sampled_outcome(map: &SbrdfMap, seconds: f64) -> FitOutcome {
    let mut relative: Vec<f32> = (map.extra["error.relative"].iter().zip(&map.extra["samples"]))
        .filter(|&(_, &samples)| samples > 0.0)
        .map(|(&error, _)| error)
        .collect();
    relative.sort_by(f32::total_cmp);
    let texels = map.width * map.height;
    let over = format!("{} texels", relative.len());
    let mut outcome = FitOutcome::default();
    for (name, share) in [("residual_relative_median", 0.5), ("residual_relative_p95", 0.95)] {
        let mut figure = ErrorFigure::new(name, quantile(&relative, share), "1", over.clone());
        for key in ["lobes", "method", "residual"] {
            let text = map.attributes.get(&format!("fit.{key}")).map_or("unknown", String::as_str);
            figure = match text.parse::<usize>() {
                Ok(number) => figure.with(key, number),
                Err(_) => figure.with(key, text),
            };
        }
        outcome.errors.push(figure);
    }
    if let Some(prices) = bound_prices(map) {
        let over = format!("{} texels held to the bound on albedo", prices.len());
        for (name, share) in [("bound_price_median", 0.5), ("bound_price_largest", 1.0)] {
            outcome.errors.push(ErrorFigure::new(name, quantile(&prices, share), "1", over.clone()));
        }
        outcome.figures.insert("texels_bounded".into(), prices.len().into());
    }
    outcome.figures.insert("texels_making_light".into(), making_light(map).0.into());
    outcome.figures.insert("texels".into(), texels.into());
    outcome.figures.insert("texels_tied".into(), tied(map).into());
    outcome.figures.insert("texels_with_mirror".into(), mirrors(map).into());
    outcome.figures.insert("texels_without_samples".into(), (texels - relative.len()).into());
    outcome.figures.insert("texels_per_second".into(), (texels as f64 / seconds.max(1e-9)).into());
    outcome
}

fn write_map(map: &SbrdfMap, path: &Path, encoding: MapEncoding) -> Result<()> {
    map.write_exr_as(path, encoding).map_err(|error| Error::writing(path, error))
}

fn print(text: &str) -> Result<()> {
    use std::io::Write as _;
    match std::io::stdout().write_all(text.as_bytes()) {
        // Whoever read the output has seen enough.
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        written => written.map_err(|error| Error::failure(format!("stdout: {error}"))),
    }
}

#[cfg(test)]
mod tests;
