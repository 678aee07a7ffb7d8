//! Alarm inputs between interrupt and polls.

use lobelia_protocol::{Alarm, Answer, Command, Configuration, Fault, Outcome};

use super::{configuration, has_fault};
use crate::rig::{Costs, Rig};

/// Axes whose alarm inputs mean the same, debounced by so many µs.
fn alarmed(alarm: Alarm, alarm_debounce_us: u16) -> Configuration {
    let mut configuration = configuration(9000, 60_000, 1_000_000);
    for axis in &mut configuration.axes {
        (axis.alarm, axis.alarm_debounce_us) = (alarm, alarm_debounce_us);
    }
    configuration
}

/// Polls that last long enough for many pulses to be between two of them. The interrupt comes late by some µs
/// too, more where the steps' runs before it: a pulse's length is known to that.
const BUSY: Costs = Costs { latency_ns: 4000, look_ns: 20_000, poll_ns: 400_000, long_every: 0, long_ns: 0 };

/// A rig in the middle of a move of all axes, and the move.
fn under_way(seed: u64, configuration: &Configuration) -> (Rig, u32) {
    let mut rig = Rig::homed(seed, BUSY, configuration);
    rig.ask(Command::MoveTo([10; 4]));
    let id = rig.begin(Command::MoveTo([9000; 4]));
    rig.run(300_000_000);
    (rig, id)
}

#[test]
fn stall_pulse_of_any_time_and_axis_is_not_missed_though_no_poll_sees_it() {
    for seed in 1..40 {
        let (mut rig, id) = under_way(seed, &alarmed(Alarm::Edge, 30));
        let (axis, at_ns) = ((seed % 4) as usize, rig.ns() + seed * 7_919_000);
        rig.world.borrow_mut().ring([(axis, at_ns, 60_000)]);
        let outcome = rig.outcome(id);
        assert!(has_fault(outcome, Fault::Stall), "{seed}: {outcome:?}");
        let last_ns = rig.world.borrow().steps.iter().filter_map(|steps| Some(steps.last()?.at_ns)).max();
        assert!(last_ns.unwrap() < at_ns + 2_000_000, "steps cease within 2 ms");
        assert_eq!(rig.status().known, [false; 4]);
    }
}

#[test]
fn glitches_shorter_than_the_debounce_end_no_move_however_many_there_are() {
    for (alarm, debounce_us, lasts_ns) in [(Alarm::Edge, 30, 8000), (Alarm::Level, 2000, 1_900_000)] {
        let (mut rig, id) = under_way(3, &alarmed(alarm, debounce_us));
        let from_ns = rig.ns();
        rig.world.borrow_mut().ring((1..120).map(|k| ((k % 4) as usize, from_ns + k * 5_003_000, lasts_ns)));
        assert_eq!(rig.outcome(id), Outcome::Done(Answer::At([9000; 4])), "{alarm:?}");
    }
}

#[test]
fn stall_pulses_at_rest_are_of_no_move_and_drivers_alarms_at_rest_are_faults() {
    let mut rig = Rig::homed(5, BUSY, &alarmed(Alarm::Edge, 20));
    let from_ns = rig.ns();
    rig.world.borrow_mut().ring((1..20).map(|k| (1, from_ns + k * 1_003_000, 300_000)));
    rig.run(40_000_000);
    assert_eq!(rig.ask(Command::MoveTo([500; 4])), Outcome::Done(Answer::At([500; 4])));

    let mut rig = Rig::homed(6, BUSY, &alarmed(Alarm::Level, 2000));
    let from_ns = rig.ns();
    rig.world.borrow_mut().ring([(2, from_ns + 1_000_000, 3_000_000)]);
    rig.run(10_000_000);
    let status = rig.status();
    assert!(status.faults.contains(Fault::DriverAlarm), "{:?}", status.faults);
    assert_eq!(status.known, [false; 4]);
}
