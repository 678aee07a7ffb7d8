//! `lobelia demo`: the whole chain on a simulated rig.

use std::path::PathBuf;

use clap::Args;

use super::Context;
use crate::demo::{self, Size};
use crate::error::{Error, Result};

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
    let mut renderings = Vec::new();
    if let Some(result) = outcome.fits.last() {
        let (pictures, no_gpu) = demo::pictures::render(&result.map, &args.out, seed, &mut context.report)?;
        if let Some(why) = no_gpu {
            context.note(format!("no picture by the GPU: {why}"));
        }
        renderings = pictures;
    }
    let _ = &renderings;
    context.report.finish();
    context.report.write(&args.out.join("report.json"))?;
    for stage in &context.report.stages {
        println!("{:>8.2} s  {}", stage.seconds, stage.name);
    }
    for error in &context.report.errors {
        println!("{} = {:.4} {} ({})", error.name, error.value, error.unit, error.over);
    }
    Ok(())
}

/// The file by which a folder is known to be a demo's, whose content may be replaced.
const MARKER: &str = ".lobelia-demo";

/// Empties the folder of an earlier demo; refuses a folder that is something else.
fn clear(folder: &std::path::Path) -> Result<()> {
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
fn empty_folder(folder: &std::path::Path) -> std::io::Result<()> {
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
