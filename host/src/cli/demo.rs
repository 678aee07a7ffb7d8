//! `lobelia demo`: the whole chain on a simulated rig.

use std::path::{Path, PathBuf};

use clap::Args;

use super::Context;
use crate::demo::{self, DemoOutcome, Size, page, pictures, truth};
use crate::error::{Error, Result};
use crate::report::Report;

/// Arguments of `lobelia demo`.
#[derive(Debug, Args)]
pub(super) struct DemoArgs {
    /// Folder for all that the demo makes; an earlier demo there is replaced
    #[arg(long, default_value = "demo-out")]
    out: PathBuf,
    /// How much to measure
    #[arg(long, value_enum, default_value_t = Size::Medium)]
    size: Size,
}

/// Runs `lobelia demo`.
pub(super) fn run(args: &DemoArgs, context: &mut Context) -> Result<()> {
    clear(&args.out)?;
    let seed = context.seed;
    let outcome = demo::run(&args.out, args.size, seed, &mut context.report)?;
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
    println!("reflectance on unposed direction pairs, relative RMS error, median over texels:");
    for fit in &outcome.fits {
        let error = 100.0 * truth::median(&fit.errors);
        println!("{error:>8.2} %  {}, {} lobes", fit.method.name(), fit.lobes);
    }
}

/// The file by which a folder is known to be a demo's, whose content may be replaced.
const MARKER: &str = ".lobelia-demo";

/// Empties the folder of an earlier demo; refuses a folder that is something else.
fn clear(folder: &Path) -> Result<()> {
    let empty = || std::fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_none());
    if folder.exists() && !empty() {
        if !folder.join(MARKER).is_file() {
            let message = "not empty and no earlier demo; name another folder with --out";
            return Err(Error::input(format!("{}: {message}", folder.display())));
        }
        empty_folder(folder).map_err(|error| Error::writing(folder, error))?;
    }
    crate::files::create_folder(folder)?;
    crate::files::write_bytes(&folder.join(MARKER), b"")
}

/// Removes what is in a folder, the marker last, so that a killed removal can be repeated.
fn empty_folder(folder: &Path) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_name() == MARKER {
            continue;
        }
        if entry.file_type()?.is_dir() {
            std::fs::remove_dir_all(entry.path())?;
        } else {
            std::fs::remove_file(entry.path())?;
        }
    }
    std::fs::remove_file(folder.join(MARKER))
}
