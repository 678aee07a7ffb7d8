//! `lobelia compare`: a fitted map against the photographs that it came from.

use std::path::PathBuf;

use clap::Args;

use super::Context;
use crate::by_angle::Side;
use crate::compare::{self, Comparison};
use crate::error::{Error, Result};
use crate::figures::ErrorFigure;
use crate::files;
use crate::progress::counted;
use crate::reflectance::SbrdfMap;
use crate::warning::{Kind, Warning};

/// Renders poses of a run from the fitted map with the rig's own camera and light, and shows photograph,
/// rendering and difference.
///
/// The run may be another than the map was measured in: with `cylinder_radius_mm` under [carrier] in its
/// rig.toml, the sample is bent over a cylinder, its axis along y.
#[derive(Debug, Args)]
pub(super) struct CompareArgs {
    /// The run's folder
    run: PathBuf,
    /// The fitted map (.exr)
    material: PathBuf,
    /// A pose of the plan, from 0; may be given more than once [default: all]
    #[arg(long)]
    pose: Vec<usize>,
    /// The run that the map was fitted from, by whose poses errors are told inside and outside of what was
    /// measured [default: RUN itself, where the sample lies flat in it]
    #[arg(long, value_name = "RUN")]
    measured_in: Option<PathBuf>,
    /// Another rig to compare by, by which the run was developed
    #[arg(long, value_name = "RIG.toml")]
    rig: Option<PathBuf>,
    /// Sets a key of the rig to compare by, as the run was developed
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
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
    if let Some(what) = files::what_is(&args.material).filter(|_| files::ending(&args.material) != "exr") {
        let hint = if what == "a sampled SBRDF" { "; fit it first" } else { "" };
        let message = format!("{what}, not an SBRDF map, which `fit` writes as .exr{hint}");
        return Err(Error::input(format!("{}: {message}", args.material.display())));
    }
    files::try_folder(&args.output)?;
    context.run_input(&args.run);
    args.measured_in.iter().for_each(|run| context.run_input(run));
    context.report.input(&args.material);
    let map = SbrdfMap::read_exr(&args.material).map_err(|error| Error::reading(&args.material, error))?;
    args.rig.iter().for_each(|path| context.report.input(path));
    let measured_in = args.measured_in.as_deref();
    let rig = super::develop::rig(&args.run, args.rig.as_deref(), &args.set)?;
    let (comparison, chart) =
        context.report.stage("compare", || compare::run(&args.run, &map, &args.pose, rig, measured_in))?;
    for (pose, why) in &comparison.left_out {
        let text = format!("pose {pose} is left out: {why}");
        context.warn([Warning { poses: vec![*pose], ..Warning::new(Kind::LeftOut, text) }]);
    }
    context.warn(comparison.notes.iter().map(|note| Warning::new(Kind::LeftOut, note)));
    let compared = &comparison.poses;
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
    let photographs = format!("{} photographs", compared.len());
    context.report.errors.extend(comparison.by_angle.figures(&photographs));
    println!(
        "{}: {}, median PSNR {psnr_db:.1} dB, mean ΔE {delta_e:.2}, relative RMS {:.2} %",
        page.display(),
        counted(compared.len() as u64, "pose", "poses"),
        100.0 * relative
    );
    by_angle(&comparison);
    Ok(())
}

/// One line a side of the cone's rim, and one where nothing is known.
fn by_angle(comparison: &Comparison) {
    for side in [Side::Inside, Side::Outside, Side::Unknown] {
        if let Some(row) = comparison.by_angle.side(side) {
            let [median, most, nearly_all, worst] = row.errors.map(|error| 100.0 * error);
            let what = match side {
                Side::Inside => "inside the measured cone",
                Side::Outside => "outside the measured cone",
                Side::Unknown => {
                    "inside or outside of what was measured (--measured-in RUN tells them apart)"
                }
            };
            println!(
                "reflectance {what}: off by {median:.2} % in median over {} texels, 95 % below {most:.2} %, \
                 99 % below {nearly_all:.2} %, worst {worst:.2} %",
                row.texels
            );
        }
    }
    if comparison.cone.is_some() && comparison.by_angle.side(Side::Outside).is_none() {
        println!("reflectance outside the measured cone: not known, no photograph was taken there");
    }
}
