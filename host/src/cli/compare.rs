//! `lobelia compare`: a fitted map against the photographs that it came from.

use std::path::PathBuf;

use clap::Args;

use super::Context;
use crate::acquire::journal;
use crate::compare;
use crate::error::{Error, Result};
use crate::files;
use crate::fit::figures::ErrorFigure;
use crate::reflectance::SbrdfMap;

/// Renders poses of a run from the fitted map with the rig's own camera and light, and shows photograph, rendering and
/// difference.
///
/// The run may be another than the map was measured in: with `cylinder_radius_mm` under [carrier] in its rig.toml, the
/// sample is bent over a cylinder, its axis along y.
#[derive(Debug, Args)]
pub(super) struct CompareArgs {
    /// The run's folder
    run: PathBuf,
    /// The fitted map (.exr)
    material: PathBuf,
    /// A pose of the plan, from 0; may be given more than once [default: all]
    #[arg(long)]
    pose: Vec<usize>,
    /// Folder for compare.html and compare.json
    #[arg(short, long, default_value = "compare")]
    output: PathBuf,
}

/// Runs `lobelia compare`.
pub(super) fn run(args: &CompareArgs, context: &mut Context) -> Result<()> {
    if args.run.is_file() && args.material.is_dir() {
        return Err(Error::input(format!(
            "{} is a folder and {} a file; the run comes first: lobelia compare RUN MAP.exr",
            args.material.display(),
            args.run.display()
        )));
    }
    files::try_folder(&args.output)?;
    context.report.input(&args.run.join(journal::FILE_NAME));
    context.report.input(&args.material);
    let map = SbrdfMap::read_exr(&args.material).map_err(|error| Error::reading(&args.material, error))?;
    let (compared, chart) = context.report.stage("compare", || compare::run(&args.run, &map, &args.pose))?;
    let page = chart.write(&args.output)?;
    let median = |value: fn(&compare::Difference) -> f64| {
        let mut values: Vec<f64> = compared.iter().map(|pose| value(&pose.difference)).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let psnr_db = median(|d| d.psnr_db);
    let delta_e = median(|d| d.delta_e[0]);
    let relative = median(|d| d.relative_rms);
    let over = format!("median of {} poses, rendering against photograph on the sample", compared.len());
    for (name, value, unit) in [
        ("relative_rms_radiance", relative, "1"),
        ("psnr", psnr_db, "dB"),
        ("mean_delta_e_2000", delta_e, "ΔE"),
    ] {
        context.report.errors.push(ErrorFigure::new(name, value, unit, over.clone()));
    }
    println!(
        "{}: {} poses, median PSNR {psnr_db:.1} dB, mean ΔE {delta_e:.2}, relative RMS {:.2} %",
        page.display(),
        compared.len(),
        100.0 * relative
    );
    Ok(())
}
