//! `lobelia demo`: the whole chain on a simulated rig.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::Context;
use crate::by_angle::{PERCENTILES, Row, Side};
use crate::demo::fits::FitOutcome;
use crate::demo::{self, DemoOutcome, Settings, Size, page, pictures, truth};
use crate::error::{Error, Result};
use crate::files;
use crate::page::scale::quantile;
use crate::report::Report;

/// Arguments of `lobelia demo`.
#[derive(Debug, Args)]
pub(super) struct DemoArgs {
    /// Folder for all that the demo makes; an earlier demo there is replaced
    #[arg(short = 'o', long, alias = "output", default_value = "demo-out")]
    out: PathBuf,
    /// How much to measure
    #[arg(long, value_enum, default_value_t = SizeName::Medium)]
    size: SizeName,
    /// Number of poses, instead of the size's
    #[arg(long, value_parser = clap::value_parser!(u32).range(4..))]
    poses: Option<u32>,
    /// What to measure instead of the demo's brocade, see `lobelia template material`
    #[arg(long, value_name = "MATERIAL.toml")]
    material: Option<PathBuf>,
    /// Lobes of the result, 0 to 4
    #[arg(long, default_value_t = 2)]
    lobes: usize,
    /// Lobes of its own for every channel of the result
    #[arg(long, conflicts_with = "anisotropic")]
    separate_channels: bool,
    /// Anisotropic lobes, and poses for them
    #[arg(long)]
    anisotropic: bool,
}

/// Names of sizes on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum SizeName {
    /// 48 × 48 texels, 80 poses: seconds
    Small,
    /// 128 × 128 texels, 200 poses: about half a minute
    Medium,
    /// 256 × 256 texels, 400 poses: many minutes
    Full,
}

/// Runs `lobelia demo`.
pub(super) fn run(args: &DemoArgs, context: &mut Context) -> Result<()> {
    let seed = context.seed;
    let size = match args.size {
        SizeName::Small => Size::Small,
        SizeName::Medium => Size::Medium,
        SizeName::Full => Size::Full,
    };
    let settings = Settings {
        poses: args.poses.map(|poses| poses as usize),
        recipe: args.material.clone(),
        lobes: args.lobes,
        separate_channels: args.separate_channels,
        anisotropic: args.anisotropic,
        ..Settings::new(size, seed)
    };
    // Before an earlier demo is removed.
    settings.check()?;
    args.material.iter().for_each(|path| context.input_with_parts(path));
    files::try_folder(&args.out)?;
    let run = args.out.join("run");
    let is_in_run = |path: &PathBuf| path.ancestors().any(|folder| files::same(folder, &run));
    if let Some(material) = args.material.iter().find(|path| is_in_run(path)) {
        let message = "in the run of an earlier demo, which is removed; copy it elsewhere";
        return Err(Error::input(format!("{}: {message}", material.display())));
    }
    clear(&args.out)?;
    let outcome = demo::run(&args.out, &settings, &mut context.report)?;
    let (pictures, no_gpu) =
        pictures::render(&outcome.fits.result.map, size.picture(), &args.out, seed, &mut context.report)?;
    context.report.finish(crate::sampled::geometry_sha256);
    let page = args.out.join("report.html");
    page::write(&outcome, &context.report, &pictures, &page)?;
    context.report.write(&args.out.join("report.json"))?;
    print(&outcome, &context.report);
    if let Some(why) = no_gpu {
        println!("pictures by the CPU alone: {why}");
    }
    println!("open {}", page.display());
    Ok(())
}

/// What was done, how long it took and how wrong it is.
fn print(outcome: &DemoOutcome, report: &Report) {
    let (sampled, camera) = (&outcome.developed.sampled, &outcome.run.rig.camera);
    println!(
        "{} × {} texels, {} poses, sensor of {} × {} pixels",
        sampled.width,
        sampled.height,
        sampled.poses.len(),
        camera.width,
        camera.height
    );
    for stage in &report.stages {
        println!("{:>8.1} s  {}", stage.seconds, stage.name);
    }
    println!("{:>8.1} s  in all, {} MiB at most", report.seconds(), report.peak_memory_bytes >> 20);
    for error in report.errors.iter().filter(|error| error.name == "registration_rms") {
        println!("registration: {:.3} texel RMS over {}", error.value, error.over);
    }
    let fits = &outcome.fits;
    println!(
        "reflectance, relative RMS error on {} unposed direction pairs, {} texels: median, 95 %, worst \
         (medians by material):",
        truth::PAIRS,
        fits.window.texels()
    );
    for (_, fit) in fits.compared() {
        let errors = fit.errors_in(&fits.window);
        let [median, most, worst] = [0.5, 0.95, 1.0].map(|share| percent(quantile(&errors, share)));
        println!("{median:>9} {most:>9} {worst:>9}  {}{}", page::fit_name(fit), of_materials(outcome, fit));
    }
    let result = &fits.result;
    println!(
        "the result over all {} texels, by the directions at which it is asked: {}",
        result.errors.len(),
        PERCENTILES.map(title).join(", ")
    );
    for (side, what) in [
        (
            Side::Inside,
            format!("inside the measured cone, within {:.1}° of a pose", outcome.cone.spacing_deg()),
        ),
        (Side::Outside, "outside, where nothing was measured".into()),
    ] {
        if let Some(Row { errors, .. }) = result.by_angle.side(side) {
            let [median, most, nearly_all, worst] = errors.map(percent);
            println!("{median:>9} {most:>9} {nearly_all:>9} {worst:>9}  {what}");
        }
    }
}

/// What a percentile is called.
fn title(percentile: u8) -> String {
    match percentile {
        50 => "median".into(),
        100 => "worst".into(),
        other => format!("{other} %"),
    }
}

fn percent(error: f64) -> String {
    format!("{:.2} %", 100.0 * error)
}

/// The median error of every material's texels, in brackets; nothing for a sample of one material.
fn of_materials(outcome: &DemoOutcome, fit: &FitOutcome) -> String {
    let errors = fit.errors_by_material(&outcome.fits.window);
    if errors.len() < 2 {
        return String::new();
    }
    let medians = errors.iter().map(|errors| format!("{:.2}", 100.0 * quantile(errors, 0.5)));
    format!(" ({})", medians.collect::<Vec<_>>().join(", "))
}

/// The file by which a folder is known to be a demo's, whose run may be replaced.
const MARKER: &str = ".lobelia-demo";

/// Removes the run of an earlier demo from its folder, and nothing else: other results are replaced as they
/// are written. Refuses a folder that is something else.
fn clear(folder: &Path) -> Result<()> {
    let empty = || std::fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_none());
    if folder.exists() && !empty() {
        if !folder.join(MARKER).is_file() {
            let message = "not empty and no earlier demo; name another folder with --out";
            return Err(Error::input(format!("{}: {message}", folder.display())));
        }
        let run = folder.join("run");
        if run.exists() {
            std::fs::remove_dir_all(&run).map_err(|error| Error::writing(&run, error))?;
        }
    }
    files::create_folder(folder)?;
    files::write_bytes(&folder.join(MARKER), b"")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_earlier_demos_run_is_removed_and_a_users_own_files_beside_it_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let own = folder.path().join("notes.txt");
        std::fs::write(&own, "mine").unwrap();
        assert_eq!(clear(folder.path()).unwrap_err().exit_code(), 2);
        files::write_bytes(&folder.path().join(MARKER), b"").unwrap();
        files::write_bytes(&folder.path().join("run/journal.jsonl"), b"{}\n").unwrap();
        clear(folder.path()).unwrap();
        assert!(!folder.path().join("run").exists() && own.is_file());
    }
}
