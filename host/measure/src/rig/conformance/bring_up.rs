//! The first hour with a board: what somebody has to do at it, one thing after the other, and whether the
//! controller sees it.

use std::fmt;
use std::ops::RangeInclusive;
use std::time::Duration;

use lobelia_protocol::{AXES, Alarm, Answer, Axis, Command, Configuration, Fault, Status};

use super::bench::{Bench, Result as Checked, Trouble, ensure, same};
use crate::rig::port::Port;
use lobelia_base::error::{Error, Result};

/// The lamp's level in its check, of 65535: enough to be seen.
const DIM: u16 = 6554;

/// The lamp's lease in its check, ms: nothing is sent while somebody looks at the bulb.
const LOOKING_MS: u32 = 600_000;

/// The lamp's lease where it has to go out by it, ms.
const SHORT_MS: u32 = 1000;

/// What a processor's supply may be, mV.
const SUPPLY_MV: RangeInclusive<u16> = 3200..=3400;

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
    /// Gives an axis's alarm input the level that its driver gives it in an alarm.
    RaiseAlarm(Axis),
    /// Leaves the alarm input to its driver again, which is quiet.
    LowerAlarm(Axis),
    /// Closes the lamp's circuit, with a small bulb in the lamp's place.
    SmallBulb,
    /// Looks whether the lamp burns.
    SeesLight,
    /// Looks whether the lamp is dark.
    SeesDark,
    /// Unplugs the thermostat, whose wire then reads as too hot.
    UnplugThermostat,
    /// Plugs it in again.
    PlugThermostat,
    /// Unplugs the thermal cut-out in the coil's circuit.
    UnplugCutOut,
    /// Plugs it in again.
    PlugCutOut,
    /// Holds the controller's reset, looks, and lets it go: whether the lamp was dark within the blink of an
    /// eye.
    SeesDarkInReset,
    /// Switches the motors' supply on, a hand on the stop.
    MotorsOn,
    /// Looks whether an axis went to its switch, off it, and slowly back.
    SeesHoming(Axis),
    /// Looks with a scope whether step pulses and the direction's set-up are as long as the rig's file asks
    /// for.
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
            Self::RaiseAlarm(axis) => {
                write!(f, "Bridge the alarm input of {} to the level that it has in an alarm.", axis.name())
            }
            Self::LowerAlarm(axis) => {
                write!(
                    f,
                    "Take the bridge from the alarm input of {}; give it its quiet level, if its driver does \
                     not.",
                    axis.name()
                )
            }
            Self::UnplugThermostat => {
                write!(f, "Unplug the thermostat (n: the controller has no such input).")
            }
            Self::PlugThermostat => write!(f, "Plug the thermostat in again."),
            Self::UnplugCutOut => write!(f, "Unplug the thermal cut-out in the relay's circuit."),
            Self::PlugCutOut => write!(f, "Plug the thermal cut-out in again."),
            Self::SeesDarkInReset => {
                write!(
                    f,
                    "Hold the controller's reset, and let it go again. Was the bulb dark at once, and stayed \
                     so?"
                )
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
                "On a scope: are step pulses of each driver at least pulse_us long, high and low, and does \
                 direction change direction_setup_us before the first step?"
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

/// Walks through the first hour: supply, stop, switches, alarms, all that puts the lamp out, and each axis's
/// homing. Ends at the first thing that is wrong.
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
    supply(bench)?;
    stop(bench, operator)?;
    // Drivers that are set up over a wire do not answer without the motors' supply, and their alarms mean
    // nothing.
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
    alarms(bench, operator, &whole)?;
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

/// Where the board tells it.
fn supply(bench: &mut Bench) -> Checked<()> {
    let answer = bench.done(Command::ReadHealth)?;
    let Answer::Health(health) = answer else {
        return Err(Trouble::Wrong(format!("ReadHealth was answered by {answer:?}")));
    };
    ensure(health.supply_mv.is_none_or(|mv| SUPPLY_MV.contains(&mv)), || {
        format!(
            "the processor's supply is {:?} mV: look at its regulator before anything else",
            health.supply_mv
        )
    })
}

/// Each alarm input that is wired; as stalls, which are no faults at rest.
fn alarms(bench: &mut Bench, operator: &mut dyn Operator, whole: &Configuration) -> Checked<()> {
    let wired = |axis: &Axis| whole.axes[axis.index()].alarm != Alarm::None;
    for axis in Axis::ALL.into_iter().filter(wired) {
        bench.configuration.axes[axis.index()].alarm = Alarm::Edge;
    }
    bench.settle()?;
    for axis in Axis::ALL.into_iter().filter(wired) {
        let k = axis.index();
        let why = "the controller does not see the alarm: look at its wire and at `invert` of its axis";
        seen(bench, operator, Act::RaiseAlarm(axis), |status| status.alarms[k], why)?;
        seen(bench, operator, Act::LowerAlarm(axis), |status| !status.alarms[k], why)?;
        bench.configuration.axes[k].alarm = Alarm::None;
    }
    bench.settle().map(|_| ())
}

/// The bulb in the lamp's place burns, and goes out by each of what must put it out.
fn lamp(bench: &mut Bench, operator: &mut dyn Operator) -> Checked<()> {
    must(operator, Act::SmallBulb, "the lamp must not be tried first")?;
    must(operator, Act::SeesDark, "the lamp burns while it is off: look at the relay and its pull-down")?;
    let usual = bench.configuration;
    let mut patient = usual;
    patient.settings.lamp_lease_ms = LOOKING_MS;
    bench.configure(&patient)?;
    light(bench, operator)?;
    let why = "the stop does not put the lamp out";
    seen(bench, operator, Act::PressStop, |status| status.emergency_stop && !status.lamp.on, why)?;
    must(operator, Act::SeesDark, why)?;
    seen(bench, operator, Act::ReleaseStop, |status| !status.emergency_stop, why)?;
    bench.done(Command::ClearFaults)?;

    light(bench, operator)?;
    if operator.act(Act::UnplugThermostat)? {
        let why = "the thermostat does not put the lamp out";
        let hot = |status: &Status| status.faults.contains(Fault::OverTemperature) && !status.lamp.on;
        bench.wait(why, hot)?;
        must(operator, Act::SeesDark, why)?;
        must(operator, Act::PlugThermostat, "it was left out")?;
        bench.done(Command::ClearFaults)?;
        light(bench, operator)?;
    }

    must(operator, Act::UnplugCutOut, "without a thermal cut-out of its own a lamp is not to be left alone")?;
    must(operator, Act::SeesDark, "the cut-out does not open the relay: it belongs in the coil's circuit")?;
    must(operator, Act::PlugCutOut, "it was left out")?;

    must(
        operator,
        Act::SeesDarkInReset,
        "the lamp burns on without the program: look at the monostable, and at the pull-down of the lamp's \
         pin",
    )?;
    bench.open()?;
    bench.settle()?;

    // A host that has died: nothing is sent for longer than the lease.
    let mut hasty = usual;
    (hasty.settings.lamp_lease_ms, hasty.settings.lamp_safe_level) = (SHORT_MS, 0);
    bench.configure(&hasty)?;
    bench.done(Command::Lamp { on: true, level: DIM })?;
    bench.pause(Duration::from_millis((2 * SHORT_MS).into()))?;
    let status = bench.status()?;
    let why = "the lamp of a host that fell silent";
    same(why, &(false, true), &(status.lamp.on, status.faults.contains(Fault::LeaseExpired)))?;
    must(operator, Act::SeesDark, "the lamp burns on when the host is silent")?;
    bench.done(Command::ClearFaults)?;
    bench.configure(&usual)
}

fn light(bench: &mut Bench, operator: &mut dyn Operator) -> Checked<()> {
    bench.done(Command::Lamp { on: true, level: DIM })?;
    must(operator, Act::SeesLight, "the lamp stays dark: look at relay, monostable, cut-out and dimmer")
}
