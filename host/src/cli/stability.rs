//! `lobelia stability`: methods where they break.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::Context;
use crate::chart::stability;
use crate::error::Result;
use crate::files;

/// Arguments of `lobelia stability`.
#[derive(Debug, Args)]
pub(super) struct StabilityArgs {
    #[command(subcommand)]
    what: What,
    /// Folder for NAME.html, NAME.json and the plots as SVG
    #[arg(short, long, global = true, default_value = "charts")]
    output: PathBuf,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Fits by noise, exponent and density, random starts, estimators of the diffuse term, registration blur,
    /// grazing poses and materials that are no lobes: where each method breaks, and whether it said so
    Fit,
}

/// Runs `lobelia stability`.
pub(super) fn run(args: &StabilityArgs, context: &mut Context) -> Result<()> {
    files::try_folder(&args.output)?;
    let seed = context.seed;
    let chart = match args.what {
        What::Fit => context.report.stage("stability", || stability::fit(seed))?,
    };
    let page = chart.write(&args.output)?;
    print!("{chart}");
    println!("{}", page.display());
    Ok(())
}
