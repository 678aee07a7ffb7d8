//! The first hour with a board: what somebody has to do at it, one thing after the other, and whether the controller sees it.

use std::fmt;

use lobelia_protocol::{AXES, Alarm, Axis, Command, Configuration, Status};

use super::bench::{Bench, Result as Checked, Trouble, ensure};
use crate::rig::port::Port;
use lobelia_base::error::{Error, Result};

/// The lamp's level in its check, of 65535: enough to be seen.
const DIM: u16 = 6554;

/// The lamp's lease in its check, ms: nothing is sent while somebody looks at the bulb.
const LOOKING_MS: u32 = 600_000;

/// What somebody does at the rig, or looks at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Act {
    /// Has only the controller powered.
    OnlyController,
    /// Presses the emergency stop.
    PressStop,
    /// Releases it.
    ReleaseStop,
    /// Unplugs an axis's home switch.
    UnplugSwitch(Axis),
    /// Plugs it in again, its axis clear of it.
    PlugSwitch(Axis),
    /// Closes the lamp's circuit, with a small bulb in the lamp's place.
    SmallBulb,
    /// Looks whether the lamp burns.
    SeesLight,
    /// Looks whether the lamp is dark.
    SeesDark,
    /// Switches the motors' supply on, a hand on the stop.
    MotorsOn,
    /// Looks whether an axis went to its switch, off it, and slowly back.
    SeesHoming(Axis),
    /// Looks with a scope whether step pulses and the direction's set-up are as long as the rig's file asks for.
    SeesPulses,
}

impl fmt::Display for Act {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OnlyController => {
                write!(f, "Power the controller alone; motors and lamp stay without supply.")
            }
            Self::PressStop => write!(f, "Press the emergency stop."),
            Self::ReleaseStop => write!(f, "Release the emergency stop."),
            Self::UnplugSwitch(axis) => write!(f, "Unplug the home switch of {}.", axis.name()),
            Self::PlugSwitch(axis) => {
                write!(f, "Plug the home switch of {} in again, the axis clear of it.", axis.name())
            }
            Self::SmallBulb => write!(f, "Put a bulb of 20 W in the lamp's place and close its circuit."),
            Self::SeesLight => write!(f, "Does the bulb burn, dimly?"),
            Self::SeesDark => write!(f, "Is the bulb dark?"),
            Self::MotorsOn => {
                write!(f, "Switch the motors' supply on, its current limited, and keep a hand on the stop.")
            }
            Self::SeesHoming(axis) => {
                write!(f, "Did {} go to its switch, off it, and slowly back?", axis.name())
            }
            Self::SeesPulses => write!(
                f,
                "On a scope: are step pulses of each driver at least pulse_us long, high and low, and does direction change \
                 direction_setup_us before the first step?"
            ),
        }
    }
}

/// Whoever stands at the rig.
pub trait Operator {
    /// Has something done or looked at; false when it can't be done, or is not so.
    ///
    /// # Errors
    /// When nobody answers.
    fn act(&mut self, act: Act) -> Result<bool>;
}

/// Walks through the first hour: stop, switches, lamp, and each axis's homing. Ends at the first thing that is wrong.
///
/// # Errors
/// What is wrong, and what to look at; a port that fails.
pub fn run(port: Box<dyn Port>, configuration: &Configuration, operator: &mut dyn Operator) -> Result<()> {
    let mut bench = Bench::new(port, *configuration);
    let outcome = walk(&mut bench, operator);
    // Whatever was wrong: at rest and dark.
    let _ = bench.ask(Command::Stop);
    let _ = bench.ask(Command::Lamp { on: false, level: 0 });
    outcome.map_err(|trouble| match trouble {
        Trouble::Link(error) => error,
        Trouble::Wrong(why) => Error::failure(format!("the first hour ends here: {why}")),
    })
}

/// Has something done that must be so.
fn must(operator: &mut dyn Operator, act: Act, otherwise: &str) -> Checked<()> {
    let done = operator.act(act)?;
    ensure(done, || otherwise.to_owned())
}

/// Has something done and waits until the controller sees it.
fn seen(
    bench: &mut Bench,
    operator: &mut dyn Operator,
    act: Act,
    sees: impl Fn(&Status) -> bool,
    otherwise: &str,
) -> Checked<()> {
    must(operator, act, "it was left out")?;
    bench.wait(otherwise, sees).map(|_| ())
}

fn walk(bench: &mut Bench, operator: &mut dyn Operator) -> Checked<()> {
    must(
        operator,
        Act::OnlyController,
        "motors and lamp must stay without supply until the inputs are known to work",
    )?;
    bench.open()?;
    stop(bench, operator)?;
    // Drivers that are set up over a wire do not answer without the motors' supply, and their alarms mean nothing.
    let whole = bench.configuration;
    for axis in &mut bench.configuration.axes {
        (axis.driver, axis.alarm) = (None, Alarm::None);
    }
    bench.settle()?;
    for axis in Axis::ALL {
        let k = axis.index();
        let why = "the controller does not see the switch: look at its wire and the pull-up";
        seen(bench, operator, Act::UnplugSwitch(axis), |status| status.at_switch[k], why)?;
        seen(bench, operator, Act::PlugSwitch(axis), |status| !status.at_switch[k], why)?;
    }
    lamp(bench, operator)?;
    must(operator, Act::MotorsOn, "the motors stay without supply")?;
    bench.configuration = whole;
    bench.configure(&whole)?;
    for axis in Axis::ALL {
        let mut axes = [false; AXES];
        axes[axis.index()] = true;
        bench.done(Command::HomeAxes { axes, approaches: 1 })?;
        must(operator, Act::SeesHoming(axis), "look at the coils' plugs, the switch's end, and home_deg")?;
    }
    must(operator, Act::SeesPulses, "look at the drivers' data sheets and at pulse_us and direction_setup_us")
}

fn stop(bench: &mut Bench, operator: &mut dyn Operator) -> Checked<()> {
    let why = "the controller does not see the emergency stop: look at its wire and the pull-up";
    seen(bench, operator, Act::PressStop, |status| status.emergency_stop, why)?;
    seen(bench, operator, Act::ReleaseStop, |status| !status.emergency_stop, why)?;
    bench.done(Command::ClearFaults).map(|_| ())
}

fn lamp(bench: &mut Bench, operator: &mut dyn Operator) -> Checked<()> {
    must(operator, Act::SmallBulb, "the lamp must not be tried first")?;
    must(operator, Act::SeesDark, "the lamp burns while it is off: look at the relay and its pull-down")?;
    let usual = bench.configuration;
    let mut patient = usual;
    patient.settings.lamp_lease_ms = LOOKING_MS;
    bench.configure(&patient)?;
    bench.done(Command::Lamp { on: true, level: DIM })?;
    must(operator, Act::SeesLight, "the lamp stays dark: look at relay, monostable, cut-out and dimmer")?;
    let why = "the stop does not put the lamp out";
    seen(bench, operator, Act::PressStop, |status| status.emergency_stop && !status.lamp.on, why)?;
    must(operator, Act::SeesDark, why)?;
    seen(bench, operator, Act::ReleaseStop, |status| !status.emergency_stop, why)?;
    bench.done(Command::ClearFaults)?;
    bench.configure(&usual)
}
