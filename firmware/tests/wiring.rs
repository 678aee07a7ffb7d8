//! Pins that are wired the other way round, alarm inputs, and what is driven before the wiring is known.
#![allow(clippy::unwrap_used)]

mod bench;

use bench::devices::{AllOutputs, Supply};
use bench::{Rig, SESSION, configuration, refusal};
use lobelia_firmware::safety::alarm::Alarms;
use lobelia_protocol::{
    Alarm, Answer, Axis, Command, Configuration, Event, Fault, Field, Hello, Outcome, Pin, Pins, Refusal,
    SafeCommand, Status, ToController, ToHost,
};

fn status(rig: &mut Rig) -> Status {
    match rig.ask(Command::Status) {
        Outcome::Done(Answer::Status(status)) => status,
        other => panic!("no status: {other:?}"),
    }
}

/// A rig whose every pin is the other way round, and what its file says of that.
fn turned() -> (Rig, Configuration) {
    let rig = Rig::with_options(|options| options.outputs = Some(Box::leak(Box::new(AllOutputs))));
    rig.bench.borrow_mut().inverted = ([Pins::OF_AXIS; 4], Pins::OF_RIG);
    let mut configuration = configuration();
    configuration.axes.iter_mut().for_each(|axis| axis.inverted = Pins::OF_AXIS);
    configuration.settings.inverted = Pins::OF_RIG;
    (rig, configuration)
}

#[test]
fn rig_with_every_pin_the_other_way_round_homes_moves_exposes_and_burns_like_any() {
    let (rig, configuration) = turned();
    let mut rig = rig.ready(configuration).at_home();
    let mut usual = Rig::homed();
    assert_eq!(rig.ask(Command::MoveTo([700; 4])), Outcome::Done(Answer::At([700; 4])));
    usual.ask(Command::MoveTo([700; 4]));
    assert_eq!(rig.bench.borrow().motors, usual.bench.borrow().motors);
    assert!(!rig.bench.borrow().pulse_too_short);
    assert_eq!(status(&mut rig).at_switch, [false; 4]);
    rig.ask(Command::Lamp { on: true, level: 65535 });
    assert!(rig.bench.borrow().lamp && rig.bench.borrow().fan);
    rig.bench.borrow_mut().now_us += 10_000_000;
    let outcome = rig.ask(Command::Expose { duration_us: 500, warm_lamp: true });
    assert!(matches!(outcome, Outcome::Done(_)), "{outcome:?}");
    assert!(!rig.bench.borrow().shutter.last().unwrap().1);
    rig.bench.borrow_mut().hot = true;
    rig.poll();
    assert_eq!((rig.bench.borrow().lamp, rig.bench.borrow().enabled), (false, [true; 4]));
    assert!(status(&mut rig).faults.contains(Fault::OverTemperature));
}

#[test]
fn no_output_is_driven_before_its_wiring_is_known_whatever_happens() {
    let (mut rig, configuration) = turned();
    rig.send(&ToController::Hello(Hello::new(SESSION)));
    // Even the stop drives nothing: which level is off is not known.
    rig.bench.borrow_mut().stop_pressed = true;
    rig.poll();
    rig.bench.borrow_mut().stop_pressed = false;
    rig.poll();
    rig.ask(Command::Lamp { on: false, level: 0 });
    rig.ask(Command::Stop);
    rig.ask(Command::ClearFaults);
    // Nor do the words of every version, which are heard all the same.
    for command in [SafeCommand::Stop, SafeCommand::Darken] {
        rig.send(&ToController::Safe(command));
        let answered = |packet: &ToHost| {
            matches!(packet, ToHost::Safe(state)
            if state.command == command && !state.fault)
        };
        assert!(rig.received().iter().any(answered));
    }
    assert_eq!((rig.bench.borrow().writes, rig.bench.borrow().devices.wired), (0, None));
    assert!(matches!(rig.configure(configuration), Outcome::Done(_)));
    let told = Some(([Pins::OF_AXIS; 4], Pins::OF_RIG));
    assert_eq!(rig.bench.borrow().devices.wired, told);
    // All are off by the new wiring.
    assert_eq!((rig.bench.borrow().lamp, rig.bench.borrow().enabled), (false, [false; 4]));
    // The same parameters again write nothing.
    let before = rig.bench.borrow().writes;
    rig.configure(configuration);
    assert_eq!(rig.bench.borrow().writes, before);
}

#[test]
fn rig_with_every_pin_the_other_way_round_is_stopped_and_darkened_by_a_host_of_any_version() {
    let (rig, configuration) = turned();
    let mut rig = rig.ready(configuration).at_home();
    rig.ask(Command::Lamp { on: true, level: 65535 });
    rig.begin(Command::Expose { duration_us: 50_000, warm_lamp: false });
    (0..5).for_each(|_| assert!(rig.pass_event()));
    assert!(rig.bench.borrow().lamp && rig.bench.borrow().shutter.last().unwrap().1);
    rig.send(&ToController::Safe(SafeCommand::Darken));
    assert!(!rig.bench.borrow().lamp && !rig.bench.borrow().shutter.last().unwrap().1);
    while rig.pass_event() {}
    rig.begin(Command::MoveTo([4000; 4]));
    (0..200).for_each(|_| assert!(rig.pass_event()));
    assert_ne!(rig.moving(), [false; 4]);
    rig.send(&ToController::Safe(SafeCommand::Stop));
    while rig.pass_event() {}
    let stopped = status(&mut rig);
    assert!(stopped.positions.iter().all(|&position| position < 4000), "{stopped:?}");
    assert_eq!((stopped.known, rig.moving()), ([true; 4], [false; 4]));
}

#[test]
fn another_wiring_puts_the_lamp_out_and_pins_of_somebody_else_are_refused() {
    let mut rig = Rig::homed();
    rig.ask(Command::Lamp { on: true, level: 30_000 });
    let mut other = configuration();
    other.settings.inverted = [Pin::Fan].into_iter().collect();
    rig.configure(other);
    let now = status(&mut rig);
    assert_eq!((now.lamp.on, now.known, rig.bench.borrow().lamp), (false, [false; 4], false));
    let mut wrong = configuration();
    wrong.axes[2].inverted = [Pin::Lamp].into_iter().collect();
    let refused = Refusal::BadParameter { axis: Some(Axis::Roll), field: Field::Wiring };
    assert_eq!(refusal(rig.configure(wrong)), refused);
    let mut wrong = configuration();
    wrong.settings.inverted = [Pin::Home].into_iter().collect();
    let refused = Refusal::BadParameter { axis: None, field: Field::Wiring };
    assert_eq!(refusal(rig.configure(wrong)), refused);
}

/// All axes with drivers that tell when they have failed.
fn alarmed() -> Configuration {
    let mut configuration = configuration();
    for axis in &mut configuration.axes {
        (axis.alarm, axis.alarm_debounce_us) = (Alarm::Level, 5000);
    }
    configuration
}

fn alarms_told(rig: &mut Rig) -> Vec<(Fault, Option<Axis>)> {
    let told = |packet| match packet {
        ToHost::Event(Event::Fault(report)) => Some((report.fault, report.axis)),
        _ => None,
    };
    rig.received().into_iter().filter_map(told).collect()
}

#[test]
fn drivers_alarm_is_a_fault_at_rest_too_and_names_each_axis_once() {
    let mut rig = Rig::greeted(alarmed()).at_home();
    rig.bench.borrow_mut().alarm[1] = true;
    rig.poll();
    assert_eq!(
        (status(&mut rig).alarms, status(&mut rig).faults.is_empty()),
        ([false, true, false, false], true)
    );
    // It asks to be polled when the alarm will have lasted long enough.
    assert_eq!(rig.next_event_us(), rig.bench.borrow().now_us + 5000);
    while rig.pass_event() {}
    assert_eq!(alarms_told(&mut rig), [(Fault::DriverAlarm, Some(Axis::Tilt))]);
    assert_eq!(status(&mut rig).known, [false; 4]);
    rig.bench.borrow_mut().alarm[3] = true;
    rig.poll();
    while rig.pass_event() {}
    rig.poll();
    assert_eq!(alarms_told(&mut rig), [(Fault::DriverAlarm, Some(Axis::Light))]);
    // Cleared while it lasts, it comes again.
    rig.bench.borrow_mut().alarm[3] = false;
    rig.ask(Command::ClearFaults);
    rig.poll();
    assert!(matches!(refusal(rig.ask(Command::Home)), Refusal::Faulted(_)));
    rig.bench.borrow_mut().alarm[1] = false;
    rig.poll();
    rig.ask(Command::ClearFaults);
    assert!(matches!(rig.ask(Command::Home), Outcome::Done(_)));
}

#[test]
fn glitch_of_an_alarm_shorter_than_its_debounce_is_none() {
    let mut rig = Rig::greeted(alarmed()).at_home();
    let id = rig.begin(Command::MoveTo([3000; 4]));
    for _ in 0..20 {
        for _ in 0..10 {
            rig.pass_event();
        }
        let from = rig.bench.borrow().now_us;
        rig.bench.borrow_mut().alarm[0] = true;
        rig.poll();
        while rig.bench.borrow().now_us < from + 4000 {
            rig.pass_event();
        }
        rig.bench.borrow_mut().alarm[0] = false;
        rig.poll();
    }
    assert_eq!(rig.outcome(id), Outcome::Done(Answer::At([3000; 4])));
}

#[test]
fn stall_pulse_between_two_polls_is_not_missed_where_an_interrupt_sees_it() {
    static ALARMS: Alarms = Alarms::new();
    for (lasts_us, counts) in [(19, false), (20, true), (60, true)] {
        let mut rig =
            Rig::with_options(|options| options.alarms = Some(&ALARMS)).ready(configuration()).at_home();
        // What an axis at rest shows is of no move to come.
        ALARMS.changed(2, true, 1000);
        ALARMS.changed(2, false, 2000);
        let id = rig.begin(Command::MoveTo([2000; 4]));
        for _ in 0..300 {
            rig.pass_event();
        }
        let now = rig.bench.borrow().now_us as u32;
        ALARMS.changed(2, true, now + 1);
        ALARMS.changed(2, false, now + 1 + lasts_us);
        while rig.moving() != [false; 4] {
            rig.pass_event();
        }
        if counts {
            assert_eq!(alarms_told(&mut rig), [(Fault::Stall, Some(Axis::Roll))], "{lasts_us} µs");
            assert!(status(&mut rig).faults.contains(Fault::Stall));
        } else {
            assert_eq!(rig.outcome(id), Outcome::Done(Answer::At([2000; 4])), "{lasts_us} µs");
        }
    }
}

#[test]
fn alarm_for_which_the_board_has_no_input_is_refused() {
    let mut rig = Rig::with_options(|options| options.alarm[3] = None);
    rig.send(&ToController::Hello(Hello::new(SESSION)));
    let refused = Refusal::BadParameter { axis: Some(Axis::Light), field: Field::Alarm };
    assert_eq!(refusal(rig.configure(alarmed())), refused);
    let mut without = alarmed();
    without.axes[3].alarm = Alarm::None;
    assert!(matches!(rig.configure(without), Outcome::Done(_)));
}

#[test]
fn brown_out_level_is_set_once_if_it_differs_at_rest_and_dark() {
    let writes = |is_set: bool| {
        let rig = Rig::with_options(|options| options.brown_out = Some(Box::leak(Box::new(Supply))));
        rig.bench.borrow_mut().devices.brown_out_set = is_set;
        let mut rig = rig.ready(configuration());
        rig.ask(Command::Lamp { on: true, level: 30_000 });
        rig.bench.borrow_mut().now_us = 5_000_000;
        rig.poll();
        let id = rig.begin(Command::Home);
        rig.ask(Command::Lamp { on: false, level: 0 });
        while rig.moving() != [false; 4] {
            rig.pass_event();
        }
        let before = rig.bench.borrow().devices.brown_out_writes.len();
        rig.outcome(id);
        (0..3).for_each(|_| rig.poll());
        (before, rig.bench.borrow().devices.brown_out_writes.len())
    };
    assert_eq!(writes(false), (0, 1));
    assert_eq!(writes(true), (0, 0));
}

#[test]
fn brown_out_level_waits_until_the_supply_has_risen() {
    let mut rig = Rig::with_options(|options| options.brown_out = Some(Box::leak(Box::new(Supply))));
    for (now_us, writes) in [(0, 0), (999_999, 0), (1_000_000, 1), (9_000_000, 1)] {
        rig.bench.borrow_mut().now_us = now_us;
        rig.poll();
        assert_eq!(rig.bench.borrow().devices.brown_out_writes.len(), writes);
    }
}
