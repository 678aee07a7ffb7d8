//! `lobelia develop`: a run's photographs to a sampled SBRDF.

use std::path::PathBuf;

use clap::Args;

use super::Context;
use crate::acquire::journal;
use crate::develop;
use crate::error::Result;
use crate::fit::figures::ErrorFigure;
use crate::sampled::SampledSbrdf;

/// Arguments of `lobelia develop`.
#[derive(Debug, Args)]
pub(super) struct DevelopArgs {
    /// The run's folder
    run: PathBuf,
    /// Zarr store to write
    #[arg(short, long, default_value = "sampled.zarr")]
    output: PathBuf,
}

/// Runs `lobelia develop`.
pub(super) fn run(args: &DevelopArgs, context: &mut Context) -> Result<()> {
    SampledSbrdf::may_write_zarr(&args.output)?;
    context.report.input(&args.run.join(journal::FILE_NAME));
    let developed = context.report.stage("develop", || develop::run(&args.run))?;
    for (index, registration) in developed.registrations.iter().enumerate() {
        match registration {
            Err(why) => context.note(format!("pose {index} is left out: {why}")),
            Ok(found) => context.detail(format!(
                "pose {index}: {} tags, RMS {:.3} mm on the sample",
                found.tags, found.residual_mm
            )),
        }
    }
    developed.common_fault.iter().for_each(|fault| context.note(fault));
    context.report.stage("write", || developed.sampled.write_zarr(&args.output))?;
    let kept: Vec<_> = developed.registrations.iter().flatten().collect();
    let rms = (kept.iter().map(|r| r.residual_mm.powi(2)).sum::<f64>() / kept.len() as f64).sqrt();
    let over = format!("tag corners of {} poses, against the homography", kept.len());
    context.report.errors.push(ErrorFigure::new("registration_residual_rms", rms, "mm", over));
    context.report.figure("poses", developed.registrations.len());
    context.report.figure("poses_registered", kept.len());
    println!(
        "{}: {} × {} texels, {} of {} poses registered, tags fit to {rms:.3} mm RMS",
        args.output.display(),
        developed.sampled.width,
        developed.sampled.height,
        kept.len(),
        developed.registrations.len()
    );
    Ok(())
}
