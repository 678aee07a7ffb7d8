//! `lobelia rig`: looks at a rig and drives it by hand.

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::{Args, Subcommand};
use lobelia_protocol::AXES;

use super::Context;
use crate::error::{Error, Result};
use crate::interrupt;
use crate::rig::config::RigConfig;
use crate::rig::trace::Recorder;
use crate::rig::{Port, RigClient, open_port};

mod check;
mod drive;
mod light;
mod look;
mod safe;

/// Arguments of `lobelia rig`.
#[derive(Debug, Args)]
pub(super) struct RigArgs {
    #[command(subcommand)]
    command: RigCommand,
}

#[derive(Debug, Subcommand)]
enum RigCommand {
    /// Tells where the axes are, how the lamp is, and what is wrong
    Status(look::StatusArgs),
    /// Homes all axes, after which their positions are known
    Home(drive::HomeArgs),
    /// Moves axes to absolute angles; the others stay where they are
    Move(drive::MoveArgs),
    /// Switches the lamp, and waits until it is warm
    Lamp(light::LampArgs),
    /// Opens the shutter once
    Expose(light::ExposeArgs),
    /// Clears the faults; the rig has to be homed afterwards
    Clear(drive::ClearArgs),
    /// Stops and darkens a rig whose controller is of any version, and tells its state
    Safe(safe::SafeArgs),
    /// Logs what happens on the rig, one line an event, with the controller's time
    Monitor(look::MonitorArgs),
    /// Prints what rig.toml tells the controller, in its steps, and where the controller has it otherwise
    Params(look::ParamsArgs),
    /// Checks a controller against the protocol; moves all axes to their limits
    Conformance(check::ConformanceArgs),
    /// Sends a recorded session again and compares the answers
    Replay(check::ReplayArgs),
}

/// Where the rig is and what it is like.
#[derive(Debug, Clone, Args)]
struct Connection {
    /// The controller: sim (a fresh one each time), /dev/ttyACM0 or tcp://host:port
    #[arg(long)]
    port: String,
    /// The rig, see `lobelia template rig`; the simulated one when not given
    #[arg(long, value_name = "RIG.toml")]
    rig: Option<PathBuf>,
}

/// A connection that can be recorded.
#[derive(Debug, Clone, Args)]
struct Session {
    #[command(flatten)]
    connection: Connection,
    /// Writes every request and answer as JSON lines, for `lobelia rig replay`
    #[arg(long, value_name = "TRACE")]
    record: Option<PathBuf>,
    /// Records each step too, where the port can tell (`sim`): some 40 bytes a step
    #[arg(long, requires = "record")]
    record_steps: bool,
}

/// Runs `lobelia rig`.
pub(super) fn run(args: &RigArgs, context: &mut Context) -> Result<()> {
    interrupt::catch_interrupts();
    match &args.command {
        RigCommand::Status(args) => look::status(args, context),
        RigCommand::Home(args) => drive::home(args, context),
        RigCommand::Move(args) => drive::move_axes(args, context),
        RigCommand::Lamp(args) => light::lamp(args, context),
        RigCommand::Expose(args) => light::expose(args, context),
        RigCommand::Clear(args) => drive::clear(args, context),
        RigCommand::Safe(args) => safe::safe(args, context),
        RigCommand::Monitor(args) => look::monitor(args, context),
        RigCommand::Params(args) => look::params(args, context),
        RigCommand::Conformance(args) => check::conformance(args, context),
        RigCommand::Replay(args) => check::replay(args, context),
    }
}

/// Reads the rig's file, or gives the built-in rig.
fn rig_config(path: Option<&Path>, context: &mut Context) -> Result<RigConfig> {
    let Some(path) = path else { return Ok(RigConfig::default()) };
    let config = RigConfig::read(path)?;
    context.report.input(path);
    Ok(config)
}

impl Connection {
    fn is_simulated(&self) -> bool {
        self.port == "sim"
    }

    /// A simulated rig's time takes none; what goes on until Ctrl-C is slowed down to real time.
    fn keep_pace(&self, time: Duration) {
        if self.is_simulated() {
            std::thread::sleep(time);
        }
    }

    fn open(&self, config: &RigConfig) -> Result<Box<dyn Port>> {
        if self.is_simulated() { simulated(config) } else { open_port(&self.port) }
    }
}

#[cfg(feature = "sim")]
fn simulated(config: &RigConfig) -> Result<Box<dyn Port>> {
    let mechanics = crate::acquire::simulated::mechanics(config);
    Ok(crate::acquire::simulated::port(&lobelia_hil_sim::SimulatedRig::new(&mechanics)))
}

#[cfg(not(feature = "sim"))]
fn simulated(_: &RigConfig) -> Result<Box<dyn Port>> {
    Err(Error::input("this build has no simulator; build with the feature `sim`"))
}

impl Session {
    /// Connects without touching the controller's parameters.
    fn connect(&self, context: &mut Context) -> Result<(RigConfig, RigClient)> {
        let config = rig_config(self.connection.rig.as_deref(), context)?;
        let mut client = RigClient::connect(self.connection.open(&config)?)?;
        client.set_interrupt(interrupt::interrupted);
        if let Some(path) = &self.record {
            let recorder = Recorder::create(path)?;
            client.record(if self.record_steps { recorder.with_steps() } else { recorder });
        }
        Ok((config, client))
    }

    /// Connects, waits until what another program began has come to rest, and sets the parameters of the
    /// rig's file.
    fn configure(&self, context: &mut Context) -> Result<(RigConfig, RigClient)> {
        let (config, mut client) = self.connect(context)?;
        let parameters = config.configuration()?;
        let mut before = client.status()?;
        while before.busy {
            client.pause(Duration::from_millis(50))?;
            check_interrupt()?;
            before = client.status()?;
        }
        client.configure(&parameters)?;
        let forgotten = before.known == [true; AXES] && client.status()?.known != [true; AXES];
        if forgotten {
            context
                .note("the controller had other parameters, so its positions no longer hold; home the rig");
        }
        Ok((config, client))
    }
}

/// Fails once the user has pressed Ctrl-C.
fn check_interrupt() -> Result<()> {
    if interrupt::interrupted() { Err(Error::failure("interrupted")) } else { Ok(()) }
}

#[cfg(all(test, feature = "sim"))]
mod tests;
