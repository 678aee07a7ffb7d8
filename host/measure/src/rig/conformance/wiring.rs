//! Checks of inputs that are told to be wired the other way round, and of alarms. Only inputs: an output the
//! wrong way round would burn or step.

use lobelia_protocol::{AXES, Alarm, Axis, Command, Event, Fault, Field, Outcome, Pin, Pins, Refusal};

use super::Script;
use super::bench::{Bench, Result, ensure, same};

pub(super) const CHECKS: &[(&str, Script)] = &[
    ("a home switch that is told to be the other way round reads so", home_inverted),
    ("an alarm input raises a fault that names its axis, or is refused where there is none", alarm),
];

/// These pins with one the other way round.
fn turned(pins: Pins, pin: Pin) -> Pins {
    Pin::ALL.into_iter().filter(|&one| pins.contains(one) != (one == pin)).collect()
}

fn home_inverted(bench: &mut Bench) -> Result<()> {
    let before = bench.settle()?.at_switch;
    for axis in Axis::ALL {
        let k = axis.index();
        let mut other = bench.configuration;
        other.axes[k].inverted = turned(other.axes[k].inverted, Pin::Home);
        bench.configure(&other)?;
        let mut expected = before;
        expected[k] = !expected[k];
        same("switches", &expected, &bench.status()?.at_switch)?;
    }
    bench.settle().map(|_| ())
}

fn alarm(bench: &mut Bench) -> Result<()> {
    for axis in Axis::ALL {
        bench.settle()?;
        one_alarm(bench, axis)?;
    }
    bench.settle().map(|_| ())
}

/// Takes the input of an axis both ways: one of them is an alarm.
fn one_alarm(bench: &mut Bench, axis: Axis) -> Result<()> {
    let k = axis.index();
    let mut alarmed = bench.configuration;
    (alarmed.axes[k].alarm, alarmed.axes[k].alarm_debounce_us) = (Alarm::Level, 1000);
    let refused = Refusal::BadParameter { axis: Some(axis), field: Field::Alarm };
    let mut active = [false; 2];
    for active in &mut active {
        for command in alarmed.commands() {
            match bench.ask(command)? {
                Outcome::Done(_) => {}
                // The board has no input for it.
                Outcome::Refused(refusal) if refusal == refused => return Ok(()),
                other => return ensure(false, || format!("parameters with an alarm came to {other:?}")),
            }
        }
        // An alarm of the round before is over.
        bench.done(Command::ClearFaults)?;
        bench.events.clear();
        *active = bench.status()?.alarms[k];
        if *active {
            bench.wait("the fault of an alarm", |status| status.faults.contains(Fault::DriverAlarm))?;
            // Events come when no answer waits.
            bench.pause(20 * super::bench::LOOK)?;
            let named = |event: &Event| {
                matches!(event, Event::Fault(report)
                if report.fault == Fault::DriverAlarm && report.axis == Some(axis))
            };
            ensure(bench.events.iter().any(named), || format!("no event names {}", axis.name()))?;
            same("known axes", &[false; AXES], &bench.status()?.known)?;
            let faults = [Fault::DriverAlarm].into_iter().collect();
            bench.refused(Command::Home, Refusal::Faulted(faults))?;
        }
        alarmed.axes[k].inverted = turned(alarmed.axes[k].inverted, Pin::Alarm);
    }
    ensure(active[0] != active[1], || {
        format!("the alarm input of {} reads the same both ways round: {active:?}", axis.name())
    })?;
    // With the rig's own parameters it is quiet again.
    bench.configure(&bench.configuration.clone())?;
    bench.done(Command::ClearFaults).map(|_| ())
}
