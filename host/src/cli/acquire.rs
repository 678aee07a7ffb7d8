//! `lobelia acquire`: drives a rig and its camera through a plan.

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;

use super::Context;
use crate::acquire::journal::Journal;
use crate::acquire::station::{self, Camera, Station, WatchedFolder};
use crate::acquire::{self, RunFolder};
use crate::error::{Error, Result};
use crate::plan::Plan;
use crate::rig::config::RigConfig;
use crate::rig::{RigClient, open_port};
use crate::toml_file;

/// Arguments of `lobelia acquire`.
#[derive(Debug, Args)]
pub(super) struct AcquireArgs {
    /// The plan, see `lobelia plan`; not needed with --resume
    #[arg(required_unless_present = "resume")]
    plan: Option<PathBuf>,
    /// The rig, see `lobelia template rig`; not needed with --resume
    #[arg(long, required_unless_present = "resume")]
    rig: Option<PathBuf>,
    /// The controller: sim, /dev/ttyACM0 or tcp://host:port
    #[arg(long)]
    port: String,
    /// The camera: sim, or watch:DIR for software that stores photographs in a folder
    #[arg(long)]
    camera: String,
    /// The run's folder
    #[arg(short, long, value_name = "RUN")]
    output: PathBuf,
    /// Continues a run that was broken off
    #[arg(long)]
    resume: bool,
    /// What lies on the simulated carrier, see `lobelia template material`
    #[arg(long, value_name = "MATERIAL.toml")]
    material: Option<PathBuf>,
    /// Seconds to wait for a photograph in the watched folder
    #[arg(long, default_value_t = 60.0, value_name = "S")]
    camera_timeout_s: f64,
}

/// Runs `lobelia acquire`.
pub(super) fn run(args: &AcquireArgs, context: &mut Context) -> Result<()> {
    let (run, mut journal) = open(args, context)?;
    if run.finished() {
        context.note(format!("{}: the run is complete already", args.output.display()));
        return Ok(());
    }
    station::catch_interrupts();
    let mut station = connect(args, &run.rig)?;
    let acquired = context.report.stage("acquire", || acquire::run(&run, &mut journal, &mut station))?;
    context.report.figure("poses", acquired.poses);
    context.report.figure("controller_s", acquired.controller_s);
    let path = args.output.display();
    println!(
        "{path}: {} poses photographed, {:.0} s by the rig's clock",
        acquired.poses, acquired.controller_s
    );
    Ok(())
}

fn open(args: &AcquireArgs, context: &mut Context) -> Result<(RunFolder, Journal)> {
    if args.resume {
        return RunFolder::resume(&args.output);
    }
    let missing = || Error::input("a plan and --rig are needed for a new run");
    let rig_path = args.rig.as_ref().ok_or_else(missing)?;
    let plan_path = args.plan.as_ref().ok_or_else(missing)?;
    let rig: RigConfig = toml_file::read(rig_path)?;
    let plan = Plan::read(plan_path, &rig)?;
    context.report.input(rig_path);
    context.report.input(plan_path);
    RunFolder::create(&args.output, &plan, &rig)
}

fn connect(args: &AcquireArgs, rig: &RigConfig) -> Result<Station> {
    match (args.port.as_str(), args.camera.as_str()) {
        ("sim", "sim") => simulated(args.material.as_deref(), rig),
        ("sim", _) | (_, "sim") => Err(Error::input(
            "--port sim and --camera sim go together: the simulated camera sees the simulated rig",
        )),
        (port, camera) => {
            let Some(folder) = camera.strip_prefix("watch:") else {
                let message = format!("--camera {camera} is not known; it is sim or watch:DIR");
                return Err(Error::input(message));
            };
            let timeout = Duration::try_from_secs_f64(args.camera_timeout_s)
                .map_err(|error| Error::input(format!("--camera-timeout-s: {error}")))?;
            let folder = WatchedFolder::new(Path::new(folder), timeout)?;
            Ok(Station::new(RigClient::connect(open_port(port)?)?, Camera::Watch(folder)))
        }
    }
}

#[cfg(feature = "sim")]
fn simulated(material: Option<&Path>, rig: &RigConfig) -> Result<Station> {
    use crate::acquire::{recipe::Recipe, simulated};
    let sample = match material {
        Some(path) => Recipe::read(path, &rig.carrier)?,
        None => crate::demo::sample::recipe().layout(Path::new("."), &rig.carrier)?,
    };
    simulated::station(rig, sample)
}

#[cfg(not(feature = "sim"))]
fn simulated(_: Option<&Path>, _: &RigConfig) -> Result<Station> {
    Err(Error::input("this build has no simulator; build with the feature `sim`"))
}
