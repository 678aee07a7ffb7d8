//! `lobelia demo`: the whole chain on a simulated rig.

use std::path::{Path, PathBuf};

use clap::Args;

use super::Context;
use crate::demo::{self, DemoOutcome, FitOutcome, Settings, Size, page, pictures, truth};
use crate::error::{Error, Result};
use crate::files;
use crate::report::Report;

/// Arguments of `lobelia demo`.
#[derive(Debug, Args)]
pub(super) struct DemoArgs {
    /// Folder for all that the demo makes; an earlier demo there is replaced
    #[arg(short = 'o', long, alias = "output", default_value = "demo-out")]
    out: PathBuf,
    /// How much to measure
    #[arg(long, value_enum, default_value_t = Size::Medium)]
    size: Size,
    /// Number of poses, instead of the size's
    #[arg(long, value_parser = clap::value_parser!(u32).range(4..))]
    poses: Option<u32>,
    /// What to measure instead of the demo's brocade, see `lobelia template material`
    #[arg(long, value_name = "MATERIAL.toml")]
    material: Option<PathBuf>,
    /// Lobes of the result, 0 to 3
    #[arg(long, default_value_t = 2)]
    lobes: usize,
    /// Lobes of its own for every channel of the result
    #[arg(long, conflicts_with = "anisotropic")]
    separate_channels: bool,
    /// Anisotropic lobes, and poses for them
    #[arg(long)]
    anisotropic: bool,
}

/// Runs `lobelia demo`.
pub(super) fn run(args: &DemoArgs, context: &mut Context) -> Result<()> {
    let seed = context.seed;
    let settings = Settings {
        poses: args.poses.map(|poses| poses as usize),
        recipe: args.material.clone(),
        lobes: args.lobes,
        separate_channels: args.separate_channels,
        anisotropic: args.anisotropic,
        ..Settings::new(args.size, seed)
    };
    // Before an earlier demo is removed.
    settings.check()?;
    args.material.iter().for_each(|path| context.report.input(path));
    files::try_folder(&args.out)?;
    clear(&args.out)?;
    let outcome = demo::run(&args.out, &settings, &mut context.report)?;
    let result = outcome.fits.last().ok_or_else(|| Error::failure("the demo made no fit"))?;
    let (pictures, no_gpu) =
        pictures::render(&result.map, args.size.picture(), &args.out, seed, &mut context.report)?;
    context.report.finish();
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
    println!(
        "reflectance on unposed direction pairs, relative RMS error, median over texels (and over each material's):"
    );
    for fit in &outcome.fits {
        let error = 100.0 * truth::median(&fit.errors);
        println!("{error:>8.2} %  {}{}", page::fit_name(fit), of_materials(outcome, fit));
    }
}

/// The median error of every material's texels, in brackets; nothing for a sample of one material.
fn of_materials(outcome: &DemoOutcome, fit: &FitOutcome) -> String {
    let medians = outcome.medians_by_material(fit);
    if medians.len() < 2 {
        return String::new();
    }
    let percent = medians.iter().map(|median| format!("{:.2}", 100.0 * median));
    format!(" ({})", percent.collect::<Vec<_>>().join(", "))
}

/// The file by which a folder is known to be a demo's, whose run may be replaced.
const MARKER: &str = ".lobelia-demo";

/// Removes the run of an earlier demo from its folder, and nothing else: other results are replaced as they are written. Refuses a
/// folder that is something else.
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
