//! `lobelia chart`: what methods cost against how right they are.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::Context;
use crate::chart;
use crate::error::Result;
use crate::rig::config::RigConfig;
use crate::toml_file;

/// Arguments of `lobelia chart`.
#[derive(Debug, Args)]
pub(super) struct ChartArgs {
    #[command(subcommand)]
    what: What,
    /// Folder for NAME.html, NAME.json and the plots as SVG
    #[arg(short, long, global = true, default_value = "charts")]
    output: PathBuf,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Time and error of fits by method, number of lobes and noise; cost by the amount of data; direction of anisotropy by blur
    Fit,
    /// Poses and travel of plans by their density
    Plan {
        /// The rig; the default one when not given
        rig: Option<PathBuf>,
    },
    /// Coefficients in fewer bits: f16 and 8 bits against f32
    Storage,
    /// Interpolated coefficients against interpolated reflectance, between texels and in MIP levels
    Interpolation,
}

/// Runs `lobelia chart`.
pub(super) fn run(args: &ChartArgs, context: &mut Context) -> Result<()> {
    let seed = context.seed;
    let chart = match &args.what {
        What::Fit => context.report.stage("chart", || chart::fit::chart(seed))?,
        What::Plan { rig } => {
            let config = match rig {
                Some(path) => {
                    context.report.input(path);
                    toml_file::read(path)?
                }
                None => RigConfig::default(),
            };
            context.report.stage("chart", || chart::plan::chart(&config, seed))?
        }
        What::Storage => context.report.stage("chart", || chart::storage::chart(seed)),
        What::Interpolation => context.report.stage("chart", chart::interpolation::chart),
    };
    let page = chart.write(&args.output)?;
    print!("{chart}");
    println!("{}", page.display());
    Ok(())
}
