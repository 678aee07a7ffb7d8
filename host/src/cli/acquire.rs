//! `lobelia acquire`: drives a rig and its camera through a plan.

use std::path::{Path, PathBuf};

use clap::Args;

use super::{Context, seconds_of};
use crate::acquire::WatchedFolder;
use crate::acquire::journal;
use crate::acquire::station::Station;
use crate::acquire::{self, RunFolder};
use crate::error::{Error, Result};
use crate::files;
use crate::interrupt;
use crate::plan::{Plan, lamp};
use crate::progress::counted;
use crate::rig::config::RigConfig;
use crate::rig::trace::Recorder;
use crate::rig::{RigClient, open_port};
use crate::warning::samples::{self, Step};
use crate::warning::{self, Kind, Warning};

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
    /// Writes every request to the rig and its answer as JSON lines, for `lobelia rig replay`
    #[arg(long, value_name = "TRACE")]
    record: Option<PathBuf>,
}

/// Runs `lobelia acquire`.
pub(super) fn run(args: &AcquireArgs, context: &mut Context) -> Result<()> {
    files::try_folder(&args.output)?;
    // A new run's folder is laid out last: a rig that does not answer leaves nothing behind.
    let (run, mut journal, mut station) = if args.resume {
        let (run, journal) = RunFolder::resume(&args.output)?;
        same_run(args, &run, context.given_seed)?;
        if run.finished() {
            context.note(format!("{}: the run is complete already", args.output.display()));
            return Ok(());
        }
        context.run_input(&args.output);
        let too_long = lamp::too_long(&run.rig, &run.plan.poses[run.first_left()..]);
        context.warn(too_long.map(|why| Warning::new(Kind::LampTime, format!("{why}; {}", lamp::GO_ON))));
        let material = run_material(args)?;
        let station = connect(args, material.as_deref(), &run.rig)?;
        (run, journal, station)
    } else {
        let (plan, rig) = read_inputs(args, context)?;
        journal::refuse_recorded(&args.output)?;
        let station = connect(args, args.material.as_deref(), &rig)?;
        keep_material(args)?;
        let (run, journal) = RunFolder::create(&args.output, &plan, &rig)?;
        (run, journal, station)
    };
    if let Some(path) = &args.record {
        station.client.record(Recorder::create(path)?);
    }
    context.warn(warning::of_plan(&run.rig, &run.plan));
    interrupt::catch_interrupts();
    let acquired = context.report.stage("acquire", || acquire::run(&run, &mut journal, &mut station))?;
    context.report.figure("poses", acquired.poses);
    context.report.figure("controller_s", acquired.controller_s);
    let path = args.output.display();
    println!(
        "{path}: {} photographed, {:.0} s by the rig's clock",
        counted(acquired.poses as u64, "pose", "poses"),
        acquired.controller_s
    );
    context.report.figure(samples::BY_POSE, samples::by_pose(&acquired.samples));
    context.warn(samples::warnings(Step::Acquire, &acquired.samples));
    Ok(())
}

/// A resumed run goes on by its own plan and rig: others that are named beside it must be the same.
fn same_run(args: &AcquireArgs, run: &RunFolder, seed: Option<u64>) -> Result<()> {
    let own = run.rig.simulator.seed;
    if let Some(seed) = seed.filter(|seed| *seed != own) {
        let message =
            format!("--seed is {seed}, but the run's is {own}, by which --resume goes on; leave it out");
        return Err(Error::input(message));
    }
    let differs = |path: &Path, what: &str| {
        let message =
            format!("not {what} of the run, by which --resume goes on; leave it out, or begin another run");
        Err(Error::input(format!("{}: {message}", path.display())))
    };
    if let Some(path) = &args.rig {
        let mut rig = RigConfig::read_recorded(path)?;
        // --seed may have given the run another.
        rig.simulator.seed = own;
        if rig != run.rig {
            return differs(path, "the rig");
        }
    }
    match &args.plan {
        Some(path) if Plan::read(path, &run.rig)? != run.plan => differs(path, "the plan"),
        _ => Ok(()),
    }
}

fn read_inputs(args: &AcquireArgs, context: &mut Context) -> Result<(Plan, RigConfig)> {
    let missing = || Error::input("a plan and --rig are needed for a new run");
    let rig_path = args.rig.as_ref().ok_or_else(missing)?;
    let plan_path = args.plan.as_ref().ok_or_else(missing)?;
    let mut rig = RigConfig::read(rig_path)?;
    if let Some(seed) = context.given_seed {
        rig.simulator.seed = seed;
    }
    let plan = Plan::read(plan_path, &rig)?;
    if let Some(why) = lamp::too_long(&rig, &plan.poses) {
        return Err(Error::input(format!("{}: {why}; {}", plan_path.display(), lamp::PLAN_LESS)));
    }
    context.report.input(rig_path);
    context.report.input(plan_path);
    args.material.iter().for_each(|path| context.input_with_parts(path));
    Ok((plan, rig))
}

fn connect(args: &AcquireArgs, material: Option<&Path>, rig: &RigConfig) -> Result<Station> {
    let camera = args.camera.as_str();
    if camera != "sim" && !camera.starts_with("watch:") {
        let message = format!("--camera {camera} is not known; it is sim or watch:DIR");
        return Err(Error::input(message));
    }
    match (args.port.as_str(), camera) {
        ("sim", "sim") => simulated(material, rig),
        ("sim", _) | (_, "sim") => Err(Error::input(
            "--port sim and --camera sim go together: the simulated camera sees the simulated rig",
        )),
        _ if args.material.is_some() => Err(Error::input(
            "--material is what the simulated camera sees; with another camera leave it out",
        )),
        (port, camera) => {
            let folder = camera.strip_prefix("watch:").unwrap_or(camera);
            let timeout = seconds_of("--camera-timeout-s", args.camera_timeout_s, 0.0)?;
            let folder = WatchedFolder::new(Path::new(folder), timeout)?;
            Ok(Station::new(RigClient::connect(open_port(port)?)?, Box::new(folder)))
        }
    }
}

/// Name of the recipe in a simulated run's folder.
const MATERIAL_FILE: &str = "material.toml";

/// The recipe that a simulated run was begun with, so that a resumed one photographs the same sample.
fn run_material(args: &AcquireArgs) -> Result<Option<PathBuf>> {
    if args.material.is_some() {
        return Err(Error::input("--resume goes on with the run's own material; leave --material out"));
    }
    let kept = args.output.join(MATERIAL_FILE);
    Ok(kept.is_file().then_some(kept))
}

/// Keeps the recipe in the run's folder.
#[cfg(feature = "sim")]
fn keep_material(args: &AcquireArgs) -> Result<()> {
    let kept = args.output.join(MATERIAL_FILE);
    let Some(path) = &args.material else {
        // Of a run that was broken off before it began, if there is one.
        let _ = std::fs::remove_file(&kept);
        return Ok(());
    };
    let recipe = crate::acquire::recipe::Recipe::load(path)?;
    let text = toml::to_string(&recipe)
        .map_err(|error| Error::failure(format!("{MATERIAL_FILE}: {error}")).caused_by(error))?;
    files::create_folder(&args.output)?;
    files::write_bytes(&kept, text.as_bytes())
}

#[cfg(not(feature = "sim"))]
fn keep_material(_: &AcquireArgs) -> Result<()> {
    Ok(())
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
