//! What happens when something goes wrong, and that the table of faults says so.
#![allow(clippy::unwrap_used)]

mod bench;

use std::sync::atomic::Ordering::Relaxed;

use bench::{Rig, SESSION};
use lobelia_firmware::safety::emergency_stop;
use lobelia_protocol::{
    Command, CrashCause, CrashRecord, Event, Fault, Hello, Outcome, Refusal, ToController, ToHost,
};

#[test]
fn stop_from_an_interrupt_at_any_instant_of_a_move_ceases_steps_within_a_millisecond() {
    for events in [1, 10, 77, 300, 1234, 4000] {
        let mut rig = Rig::homed();
        rig.ask(Command::Lamp { on: true, level: 65535 });
        let id = rig.begin(Command::MoveTo([4000; 4]));
        for _ in 0..events {
            rig.pass_event();
        }
        let tripped_us = rig.bench.borrow().now_us;
        emergency_stop(rig.emergency_stop);
        while rig.pass_event() {}
        for steps in &rig.bench.borrow().steps {
            assert!(steps.last().is_none_or(|&(last_us, _)| last_us <= tripped_us + 1000));
        }
        assert_eq!((rig.bench.borrow().enabled, rig.bench.borrow().lamp), ([false; 4], false));
        let refused = rig.answered(id).unwrap();
        assert!(
            matches!(refused, Outcome::Refused(Refusal::Faulted(set)) if set.contains(Fault::EmergencyStop))
        );
        // A contact that was closed for an instant only stays a fault all the same.
        assert!(matches!(rig.ask(Command::Home), Outcome::Refused(Refusal::Faulted(_))));
    }
}

#[test]
fn watchdog_and_the_lamps_monostable_are_fed_at_each_poll_until_the_hardware_fails() {
    let mut rig = Rig::homed();
    let fed = |rig: &Rig| (rig.meals.load(Relaxed), rig.bench.borrow().beats);
    let before = fed(&rig);
    rig.poll();
    assert_eq!(fed(&rig), (before.0 + 1, before.1 + 1));
    rig.bench.borrow_mut().diode_broken = true;
    let broken = rig.ask(Command::Expose { duration_us: 5000, warm_lamp: false });
    assert!(matches!(broken, Outcome::Refused(Refusal::Faulted(set)) if set.contains(Fault::Hardware)));
    assert!(!rig.bench.borrow().shutter.last().unwrap().1);
    let before = fed(&rig);
    rig.poll();
    assert_eq!(fed(&rig), before);
    rig.ask(Command::ClearFaults);
    assert!(fed(&rig).0 > before.0 && fed(&rig).1 > before.1);
}

#[test]
fn loop_that_makes_steps_too_late_does_not_feed_the_watchdog() {
    for (late_us, meals) in [(1000, 1), (1001, 0), (50_000, 0), (0, 1)] {
        let mut rig = Rig::homed();
        rig.begin(Command::MoveTo([4000; 4]));
        rig.bench.borrow_mut().now_us = rig.next_event_us() + late_us;
        let before = rig.meals.load(Relaxed);
        rig.poll();
        assert_eq!(rig.meals.load(Relaxed) - before, meals, "{late_us} µs late");
    }
}

#[test]
fn crash_is_told_once_at_the_next_hello() {
    let mut rig = Rig::new();
    let told = |rig: &mut Rig| {
        rig.send(&ToController::Hello(Hello::new(SESSION)));
        let packets = rig.received();
        assert!(matches!(packets[0], ToHost::Hello(_)));
        packets[1..].to_vec()
    };
    let crash = CrashRecord { cause: CrashCause::HardFault, place: 0x0800_1234 };
    assert_eq!(told(&mut rig), [ToHost::Event(Event::Crashed(crash))]);
    assert_eq!(told(&mut rig), []);
}

#[test]
fn table_of_faults_has_each_fault_once_in_the_order_of_the_code() {
    let rows: Vec<Vec<&str>> = include_str!("../README.md")
        .lines()
        .skip_while(|line| *line != "## Faults")
        .filter(|line| line.starts_with('|') && !line.starts_with("|---") && !line.starts_with("| fault"))
        .map(|line| line.trim_matches('|').split('|').map(str::trim).collect())
        .collect();
    let names: Vec<String> = Fault::ALL.iter().map(|fault| format!("{fault:?}")).collect();
    assert_eq!(rows.iter().map(|row| row[0]).collect::<Vec<_>>(), names);
    assert!(rows.iter().all(|row| row.len() == 4 && row.iter().all(|cell| !cell.is_empty())));
}
