//! `lobelia develop`: a run's photographs to a sampled SBRDF.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::Args;

use super::Context;
use crate::acquire::{PLAN_FILE, RIG_FILE, RunFolder};
use crate::develop::{self, Developed, Options};
use crate::error::{Error, Result};
use crate::figures::ErrorFigure;
use crate::files;
use crate::report::Report;
use crate::rig::config::RigConfig;
use crate::sampled::{Attributes, SampledSbrdf, Window, attributes_of};
use crate::warning::samples::{self, Step};
use crate::warning::{Kind, Warning, directions};

/// Arguments of `lobelia develop`.
#[derive(Debug, Args)]
pub(super) struct DevelopArgs {
    /// The run's folder
    run: PathBuf,
    /// Zarr store to write
    #[arg(short, long, default_value = "sampled.zarr")]
    output: PathBuf,
    /// Another rig to develop by, as after a calibration; the store keeps it beside the run's own
    #[arg(long, value_name = "RIG.toml")]
    rig: Option<PathBuf>,
    /// Sets a key of the rig to develop by, as `carrier.texels_across=64`, `camera.focal_px=[4100, 4100]`,
    /// `camera.read_noise_e=4`
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Develops a part of the sample: first column and row of texels, columns, rows
    #[arg(long, value_name = "X,Y,WIDTH,HEIGHT")]
    region: Option<Region>,
    /// Develops what is there of a run that is not finished, and leaves frames out that are damaged
    #[arg(long)]
    partial: bool,
    /// Leaves poses out, as `3,7-9`
    #[arg(long, value_name = "POSES", value_delimiter = ',')]
    skip_pose: Vec<Poses>,
}

/// Columns and rows of texels.
#[derive(Debug, Clone, Copy)]
struct Region([usize; 4]);

impl FromStr for Region {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let numbers: std::result::Result<Vec<u16>, _> =
            text.split(',').map(|part| part.trim().parse()).collect();
        match numbers.ok().and_then(|numbers| <[u16; 4]>::try_from(numbers).ok()) {
            Some(numbers) => Ok(Self(numbers.map(usize::from))),
            None => Err("must be four whole numbers: first column, first row, columns, rows".into()),
        }
    }
}

/// One pose, or some that follow each other.
#[derive(Debug, Clone)]
struct Poses(std::ops::RangeInclusive<usize>);

impl FromStr for Poses {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let (first, last) = text.split_once('-').unwrap_or((text, text));
        match (first.trim().parse::<u16>(), last.trim().parse::<u16>()) {
            (Ok(first), Ok(last)) if first <= last => Ok(Self(first.into()..=last.into())),
            _ => Err("must be the number of a pose, counted from 0, or two as in 7-9".into()),
        }
    }
}

impl DevelopArgs {
    /// What to develop otherwise than the run says, and what the store says of that.
    fn options(&self) -> Result<(Options, Attributes)> {
        let own = self.run.join(RIG_FILE);
        let rig = rig(&self.run, self.rig.as_deref(), &self.set)?;
        let mut texts = Attributes::new();
        if let Some(rig) = &rig {
            let text = toml::to_string(rig)
                .map_err(|error| Error::failure(format!("the rig: {error}")).caused_by(error))?;
            texts.insert("developed_by_rig_toml".into(), text.into());
            texts.insert("run_rig_toml".into(), files::read_text(&own)?.into());
        }
        let region =
            self.region.map(|Region([x, y, width, height])| Window { x: x..x + width, y: y..y + height });
        let skip = self.skip_pose.iter().flat_map(|poses| poses.0.clone()).collect();
        Ok((Options { rig, partial: self.partial, skip, region }, texts))
    }
}

/// The rig to go by instead of the run's own: another one, or that with keys set; none where neither is asked
/// for.
///
/// # Errors
/// Input errors for a rig, a run or a setting that is wrong.
pub(super) fn rig(run: &Path, other: Option<&Path>, settings: &[String]) -> Result<Option<RigConfig>> {
    let rig = match other {
        None if settings.is_empty() => return Ok(None),
        None => RunFolder::open(run)?.rig,
        Some(other) => RigConfig::read_recorded(other)?,
    };
    rig.with_settings(settings).map(Some)
}

/// Runs `lobelia develop`.
pub(super) fn run(args: &DevelopArgs, context: &mut Context) -> Result<()> {
    SampledSbrdf::may_write_zarr(&args.output)?;
    context.run_input(&args.run);
    args.rig.iter().for_each(|path| context.report.input(path));
    let (options, mut attributes) = args.options()?;
    let developed = context.report.stage("develop", || develop::run_with(&args.run, &options))?;
    tell(&developed, &options.skip, context);
    // The journal has times of its own, which a run that was interrupted has otherwise.
    let mut made = Report { inputs: Vec::new(), ..context.report.clone() };
    [PLAN_FILE, RIG_FILE].iter().for_each(|name| made.input(&args.run.join(name)));
    args.rig.iter().for_each(|path| made.input(path));
    attributes.extend(attributes_of(made.provenance()));
    attributes.extend(developed.attributes());
    context.report.stage("write", || developed.sampled.write_zarr_with(&args.output, &attributes))?;
    sum_up(&developed, &args.output, context);
    warn(&developed, context);
    Ok(())
}

/// Warns of samples that are of no use, and of poses that determine too little.
fn warn(developed: &Developed, context: &mut Context) {
    context.report.figure(samples::BY_POSE, samples::by_pose(&developed.samples));
    context.warn(samples::warnings(Step::Develop, &developed.samples));
    let seen = directions::of_poses(&developed.sampled.poses);
    // Whether the material is isotropic only the fit is told.
    let options = directions::by_default(true);
    context.warn(directions::too_few(seen.len(), &options));
    context.warn(directions::shape(&seen, options.isotropic));
}

/// Warns of what was left out, and says why. What was asked for is no warning.
fn tell(developed: &Developed, skip: &BTreeSet<usize>, context: &mut Context) {
    let warning = |text: String, poses: Vec<usize>| Warning { poses, ..Warning::new(Kind::LeftOut, text) };
    let mut wrong = Vec::new();
    for (index, registration) in developed.registrations.iter().enumerate() {
        match registration {
            Err(why) if skip.contains(&index) => context.note(format!("pose {index} is left out: {why}")),
            Err(why) => {
                wrong.push(index);
                context.warn([warning(format!("pose {index} is left out: {why}"), vec![index])]);
            }
            Ok(found) => context.detail(format!(
                "pose {index}: {} tags, RMS {:.3} mm on the sample",
                found.tags, found.residual_mm
            )),
        }
    }
    let frames =
        developed.left_out.iter().map(|why| warning(format!("a frame is left out: {why}"), Vec::new()));
    context.warn(frames);
    context.warn(developed.common_fault.iter().map(|fault| warning(fault.clone(), wrong.clone())));
}

fn sum_up(developed: &Developed, output: &Path, context: &mut Context) {
    let kept: Vec<_> = developed.registrations.iter().flatten().collect();
    let rms = (kept.iter().map(|r| r.residual_mm.powi(2)).sum::<f64>() / kept.len() as f64).sqrt();
    let over = format!("tag corners of {} poses, against the homography", kept.len());
    context.report.errors.push(ErrorFigure::new("registration_residual_rms", rms, "mm", over));
    context.report.figure("poses", developed.registrations.len());
    context.report.figure("poses_registered", kept.len());
    println!(
        "{}: {} × {} texels, {} of {} poses registered, tags fit to {rms:.3} mm RMS",
        output.display(),
        developed.sampled.width,
        developed.sampled.height,
        kept.len(),
        developed.registrations.len()
    );
}
