//! Several requests in flight, events behind answers, and the lease.
#![allow(clippy::unwrap_used)]

mod bench;

use bench::{Rig, SESSION, configuration};
use lobelia_protocol::{
    Answer, Command, Configuration, Event, Fault, Happening, Hello, LogLine, Outcome, Refusal, Request,
    Response, SafeCommand, SafeState, Settings, ToController, ToHost,
};

fn request(id: u32, command: Command) -> ToController {
    ToController::Request(Request { session: SESSION, id, seen: id.saturating_sub(8), command })
}

/// Ids and outcomes that have come, in order.
fn answers(rig: &mut Rig) -> Vec<(u32, Outcome)> {
    let answer = |packet| match packet {
        ToHost::Response(Response { id, outcome, .. }) => Some((id, outcome)),
        _ => None,
    };
    rig.received().into_iter().filter_map(answer).collect()
}

fn level(id: u32) -> Command {
    Command::Lamp { on: true, level: id as u16 * 6554 }
}

#[test]
fn requests_that_come_in_any_order_run_in_that_of_their_ids() {
    for order in [[1, 2, 3, 4], [4, 3, 2, 1], [3, 1, 4, 2]] {
        let mut rig = Rig::greeted(configuration());
        for id in order {
            rig.send(&request(id, level(id)));
        }
        let done = answers(&mut rig).into_iter().filter(|(_, outcome)| *outcome != Outcome::Running);
        assert_eq!(done.map(|(id, _)| id).collect::<Vec<_>>(), [1, 2, 3, 4], "{order:?}");
        // Of 1000: the level of the last one.
        assert_eq!(rig.bench.borrow().lamp_level, 400);
    }
}

#[test]
fn too_many_in_flight_are_refused_and_none_is_lost() {
    let mut rig = Rig::greeted(configuration());
    for id in 2..7 {
        rig.send(&request(id, level(id)));
    }
    let refused: Vec<_> =
        answers(&mut rig).into_iter().filter(|(_, outcome)| *outcome != Outcome::Running).collect();
    assert_eq!(refused, [5, 6].map(|id| (id, Outcome::Refused(Refusal::OutOfWindow))));
    for id in [1, 5, 6] {
        rig.send(&request(id, level(id)));
    }
    let done: Vec<_> = answers(&mut rig).into_iter().map(|(id, _)| id).collect();
    assert_eq!(done, [1, 2, 3, 4, 5, 6]);
}

#[test]
fn stop_waits_for_nothing_and_what_went_before_it_never_runs() {
    let mut rig = Rig::homed();
    rig.send(&request(2, Command::MoveTo([500; 4])));
    rig.send(&request(3, Command::Stop));
    rig.send(&request(1, Command::MoveTo([500; 4])));
    rig.send(&request(2, Command::MoveTo([500; 4])));
    while rig.pass_event() {}
    assert_eq!(rig.step_count(), 0);
    let stale = Outcome::Refused(Refusal::Stale);
    assert_eq!(finals(&mut rig)[1..], [(1, stale), (2, stale)]);
}

#[test]
fn events_wait_until_the_answers_are_sent() {
    let mut rig = Rig::homed();
    rig.bench.borrow_mut().line_stuck = true;
    for id in 1..5 {
        rig.bench.borrow_mut().stop_pressed = true;
        rig.poll();
        rig.bench.borrow_mut().stop_pressed = false;
        rig.poll();
        rig.send(&request(id, Command::ClearFaults));
    }
    rig.bench.borrow_mut().line_stuck = false;
    rig.poll();
    let packets = rig.received();
    let kinds: Vec<_> = packets.iter().map(|packet| matches!(packet, ToHost::Response(_))).collect();
    // The first event was on its way before there was an answer.
    assert_eq!(kinds, [false, true, true, true, true, false, false, false]);
}

fn leased(lamp_safe_level: u16) -> Configuration {
    let configuration = configuration();
    let leases = Settings { lease_ms: 2000, lamp_lease_ms: 3000, ..configuration.settings };
    Configuration { settings: Settings { lamp_safe_level, ..leases }, ..configuration }
}

#[test]
fn silent_host_ends_a_move_smoothly_and_dims_the_lamp() {
    let mut rig = Rig::greeted(leased(6554));
    let home = rig.begin(Command::Home);
    let mut id = home;
    // A host that asks now and then keeps its lease.
    while rig.answered(home).is_none() {
        let until = rig.bench.borrow().now_us + 1_900_000;
        while rig.next_event_us() < until && rig.pass_event() {}
        rig.bench.borrow_mut().now_us = until;
        id = rig.begin(Command::Status);
        if rig.bench.borrow().now_us > 600_000_000 {
            break;
        }
    }
    assert!(id > home + 2);
    rig.ask(Command::Lamp { on: true, level: 65535 });
    let began = rig.bench.borrow().now_us;
    let id = rig.begin(Command::MoveTo([0, 0, 5000, 0]));
    assert!(matches!(rig.outcome(id), Outcome::Refused(Refusal::Faulted(faults))
            if faults.contains(Fault::LeaseExpired)));
    let last_step = rig.bench.borrow().steps[2].last().unwrap().0;
    // At rest after the lease and the ramp: 300 steps/s at 100 steps/s² and 2000 steps/s³.
    assert!((2_000_000..5_200_000).contains(&(last_step - began)), "{}", last_step - began);
    assert_eq!((rig.bench.borrow().lamp, rig.bench.borrow().lamp_level), (true, 100));
    // Nothing is left but the lamp's longest time.
    assert!(rig.next_event_us() > 172_800_000_000);
    // Positions are known still.
    rig.ask(Command::ClearFaults);
    rig.ask(Command::Lamp { on: false, level: 0 });
    let id = rig.begin(Command::MoveTo([0, 0, 10, 0]));
    assert_eq!(rig.answered(id), None, "the move isn't begun");
}

#[test]
fn burning_lamp_alone_holds_a_lease_and_its_end_is_told() {
    let mut rig = Rig::greeted(leased(0));
    rig.ask(Command::Lamp { on: true, level: 65535 });
    assert_eq!(rig.next_event_us(), 3_000_000);
    assert!(rig.pass_event());
    let told = |packet: &ToHost| {
        matches!(packet, ToHost::Event(Event::Fault(report))
        if report.fault == Fault::LeaseExpired)
    };
    assert!(rig.received().iter().any(told));
    assert_eq!((rig.bench.borrow().lamp, rig.bench.borrow().lamp_level), (false, 0));
    assert!(!rig.pass_event());
}

/// Ids and outcomes that came, without those that only say that the answer comes later.
fn finals(rig: &mut Rig) -> Vec<(u32, Outcome)> {
    let mut all = answers(rig);
    all.retain(|(_, outcome)| *outcome != Outcome::Running);
    all
}

fn expose(id: u32) -> Command {
    Command::Expose { duration_us: 1000 * id, warm_lamp: false }
}

#[test]
fn requests_wait_for_their_turn_and_run_once_each_in_order() {
    let mut rig = Rig::homed();
    // One is run, four wait, three more are held by the link.
    for id in 1..=8 {
        let command = if id % 2 == 1 { Command::MoveTo([100 * id as i32; 4]) } else { expose(id) };
        for _ in 0..3 {
            rig.send(&request(id, command));
        }
    }
    let running = answers(&mut rig);
    assert!(running.iter().all(|(_, outcome)| *outcome == Outcome::Running), "{running:?}");
    while rig.pass_event() {}
    let done = finals(&mut rig);
    assert_eq!(done.iter().map(|(id, _)| *id).collect::<Vec<_>>(), (1..=8).collect::<Vec<_>>());
    for (id, outcome) in done {
        match outcome {
            Outcome::Done(Answer::At(positions)) => assert_eq!(positions, [100 * id as i32; 4]),
            Outcome::Done(Answer::Exposed(exposure)) => assert_eq!(exposure.open_us, 1000 * id),
            other => panic!("{id}: {other:?}"),
        }
    }
    let bench = rig.bench.borrow();
    let open: Vec<_> = bench.shutter.chunks(2).map(|pair| pair[1].0 - pair[0].0).collect();
    assert_eq!(open, [2000, 4000, 6000, 8000]);
}

#[test]
fn one_too_many_may_be_sent_again_and_a_status_does_not_wait() {
    let mut rig = Rig::homed();
    rig.send(&request(1, Command::MoveTo([4000; 4])));
    for id in 2..=8 {
        rig.send(&request(id, expose(id)));
    }
    rig.received();
    // Nine are beyond what is kept: the host has not seen the first answer yet.
    let ninth = ToController::Request(Request { session: SESSION, id: 9, seen: 0, command: Command::Status });
    rig.send(&ninth);
    assert_eq!(answers(&mut rig), [(9, Outcome::Refused(Refusal::OutOfWindow))]);
    let mut rig = Rig::homed();
    rig.send(&request(1, Command::MoveTo([4000; 4])));
    rig.send(&request(2, expose(2)));
    rig.send(&request(3, Command::Status));
    let done = finals(&mut rig);
    let Outcome::Done(Answer::Status(status)) = done[0].1 else { panic!("{done:?}") };
    assert_eq!((status.busy, status.waiting), (true, 1));
}

#[test]
fn a_stop_refuses_what_waits_and_what_comes_after_it_runs() {
    let mut rig = Rig::homed();
    rig.send(&request(1, Command::MoveTo([4000; 4])));
    rig.send(&request(2, expose(2)));
    rig.send(&request(3, Command::MoveTo([0; 4])));
    for _ in 0..500 {
        rig.pass_event();
    }
    rig.send(&request(4, Command::Stop));
    rig.send(&request(5, expose(5)));
    while rig.pass_event() {}
    let stopped = Outcome::Refused(Refusal::Stopped);
    let done = finals(&mut rig);
    assert_eq!(done[..4], [(2, stopped), (3, stopped), (4, Outcome::Done(Answer::Nothing)), (1, stopped)]);
    assert!(matches!(done[4..], [(5, Outcome::Done(Answer::Exposed(_)))]), "{done:?}");
    assert_eq!(rig.bench.borrow().shutter.len(), 3, "shut by the stop, then open and shut once");
}

#[test]
fn a_fault_refuses_what_waits_and_it_is_told() {
    let mut rig = Rig::homed();
    rig.send(&request(1, Command::MoveTo([4000; 4])));
    rig.send(&request(2, expose(2)));
    rig.bench.borrow_mut().alarm[1] = true;
    while rig.pass_event() {}
    let faulted = Outcome::Refused(Refusal::Faulted([Fault::Stall].into_iter().collect()));
    assert_eq!(finals(&mut rig), [(1, faulted), (2, faulted)]);
}

#[test]
fn what_was_sent_without_knowing_of_a_refusal_is_skipped() {
    let unseen = |id, command| ToController::Request(Request { session: SESSION, id, seen: id - 2, command });
    let mut rig = Rig::homed();
    rig.send(&request(1, Command::MoveTo([9999; 4])));
    rig.send(&unseen(2, expose(2)));
    let skipped = Outcome::Refused(Refusal::Skipped { after: 1 });
    assert_eq!(finals(&mut rig)[1], (2, skipped));
    // The one after next is asked for with the refusal known.
    rig.send(&ToController::Request(Request { session: SESSION, id: 3, seen: 2, command: expose(3) }));
    while rig.pass_event() {}
    assert!(matches!(finals(&mut rig)[..], [(3, Outcome::Done(_))]));
    // What waits is skipped too when what it waits for is refused.
    rig.send(&request(4, Command::MoveTo([9999; 4])));
    rig.send(&ToController::Request(Request { session: SESSION, id: 5, seen: 4, command: Command::Home }));
    rig.send(&unseen(6, Command::MoveTo([9999; 4])));
    rig.send(&unseen(7, expose(7)));
    while rig.pass_event() {}
    let last = finals(&mut rig).pop();
    assert_eq!(last, Some((7, Outcome::Refused(Refusal::Skipped { after: 6 }))));
}

#[test]
fn a_retargeted_move_refuses_what_waits_behind_it() {
    let mut rig = Rig::homed();
    rig.send(&request(1, Command::MoveTo([4000; 4])));
    rig.send(&request(2, expose(2)));
    rig.send(&request(3, Command::Retarget([100; 4])));
    while rig.pass_event() {}
    let stopped = Outcome::Refused(Refusal::Stopped);
    assert_eq!(finals(&mut rig), [(1, stopped), (2, stopped), (3, Outcome::Done(Answer::At([100; 4])))]);
}

#[test]
fn parameters_are_read_back_as_they_were_set() {
    let mut rig = Rig::new();
    rig.send(&ToController::Hello(lobelia_protocol::Hello::new(SESSION)));
    assert_eq!(rig.ask(Command::ReadSettings), Outcome::Refused(Refusal::NotConfigured));
    let wanted = configuration();
    let mut rig = Rig::greeted(wanted);
    assert_eq!(rig.ask(Command::ReadSettings), Outcome::Done(Answer::Settings(wanted.settings)));
    for axis in lobelia_protocol::Axis::ALL {
        let read = rig.ask(Command::ReadAxis(axis));
        assert_eq!(read, Outcome::Done(Answer::Axis(wanted.axes[axis.index()])));
    }
    // An axis that is prepared but not set is not what the controller has.
    let parameters = lobelia_protocol::AxisParameters { settle_ms: 7, ..wanted.axes[0] };
    let axis = lobelia_protocol::Axis::Pan;
    rig.ask(Command::PrepareAxis { axis, parameters });
    assert_eq!(rig.ask(Command::ReadAxis(axis)), Outcome::Done(Answer::Axis(wanted.axes[0])));
    rig.ask(Command::Configure(wanted.settings));
    assert_eq!(rig.ask(Command::ReadAxis(axis)), Outcome::Done(Answer::Axis(parameters)));
}

fn events(rig: &mut Rig) -> Vec<Event> {
    let event = |packet| match packet {
        ToHost::Event(event) => Some(event),
        _ => None,
    };
    rig.received().into_iter().filter_map(event).collect()
}

#[test]
fn telemetry_comes_at_its_period_until_the_watch_ends() {
    let mut rig = Rig::homed();
    rig.ask(Command::Watch { telemetry_ms: 20, log: false });
    rig.received();
    let start = rig.bench.borrow().now_us;
    for _ in 0..10 {
        assert!(rig.pass_event());
    }
    let at: Vec<_> = events(&mut rig)
        .into_iter()
        .map(|event| match event {
            Event::Telemetry(telemetry) => {
                assert_eq!((telemetry.photodiode, telemetry.dropped), (Some(1234), 0));
                telemetry.at_us - start
            }
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(at, (1..=10).map(|k| k * 20_000).collect::<Vec<_>>());
    rig.ask(Command::Watch { telemetry_ms: 0, log: false });
    assert!(!rig.pass_event());
    assert_eq!(events(&mut rig), []);
    assert!(matches!(
        rig.ask(Command::Watch { telemetry_ms: 19, log: false }),
        Outcome::Refused(Refusal::BadParameter { .. })
    ));
}

#[test]
fn log_lines_tell_what_is_run_and_which_were_left_out() {
    let mut rig = Rig::homed();
    rig.send(&request(1, Command::Watch { telemetry_ms: 0, log: true }));
    rig.send(&request(2, expose(2)));
    while rig.pass_event() {}
    let log = |rig: &mut Rig| -> Vec<_> {
        let line = |event| match event {
            Event::Log(LogLine { what, .. }) => Some(what),
            _ => None,
        };
        events(rig).into_iter().filter_map(line).collect()
    };
    let told = log(&mut rig);
    let ended = |id| Happening::Ended { id, done: true };
    assert_eq!(told, [Happening::Began { id: 2 }, ended(2)]);
    // A stuck line leaves room for eight; what comes after it's free says how many are missing.
    rig.bench.borrow_mut().line_stuck = true;
    for id in 3..=20 {
        rig.send(&request(id, Command::Lamp { on: false, level: 0 }));
    }
    rig.bench.borrow_mut().line_stuck = false;
    rig.poll();
    rig.received();
    rig.send(&request(21, Command::ClearFaults));
    let told = log(&mut rig);
    let lost = 2 * 18 - 8;
    assert_eq!(told, [Happening::Dropped { count: lost }, Happening::FaultsCleared, ended(21)]);
}

#[test]
fn damaged_frames_are_counted_and_told() {
    let mut rig = Rig::homed();
    rig.send(&request(1, Command::Watch { telemetry_ms: 0, log: true }));
    rig.received();
    rig.send_bytes(&[0, 5, 6, 7, 8, 9, 0, 1, 0]);
    let what = Happening::BadFrames { count: 2 };
    assert!(matches!(events(&mut rig)[..], [Event::Log(line)] if line.what == what));
}

#[test]
fn a_request_that_comes_as_another_ends_does_not_overtake_those_that_wait() {
    let mut rig = Rig::homed();
    rig.send(&request(1, expose(9)));
    rig.send(&request(2, expose(2)));
    // Nothing is looked at until the first exposure is over.
    rig.deliver(&request(3, expose(3)).encode().unwrap());
    rig.bench.borrow_mut().now_us += 9000;
    while rig.pass_event() {}
    let bench = rig.bench.borrow();
    let open: Vec<_> = bench.shutter.chunks(2).map(|pair| pair[1].0 - pair[0].0).collect();
    assert_eq!(open, [9000, 2000, 3000]);
    let shut: Vec<_> = bench.shutter[1..5].chunks(2).map(|pair| pair[1].0 - pair[0].0).collect();
    assert_eq!(shut, [1000, 1000], "the shutter's rest");
}

#[test]
fn an_answer_waits_for_one_event_at_most() {
    let mut rig = Rig::homed();
    rig.send(&request(1, Command::Watch { telemetry_ms: 20, log: true }));
    rig.received();
    for id in 2..6 {
        rig.bench.borrow_mut().line_busy = true;
        rig.send(&request(id, Command::Lamp { on: true, level: 9 }));
        rig.bench.borrow_mut().now_us += 20_000;
        rig.poll();
        let kinds = |rig: &mut Rig| -> Vec<_> {
            rig.received().iter().map(|packet| matches!(packet, ToHost::Response(_))).collect()
        };
        assert_eq!(kinds(&mut rig), [true], "the answer goes at once, and no event behind it");
        rig.bench.borrow_mut().line_busy = false;
        rig.poll();
        assert_eq!(kinds(&mut rig), [false; 3], "two log lines, and telemetry last");
    }
}

/// Asks in the words of every version.
fn safe(rig: &mut Rig, command: SafeCommand) -> SafeState {
    rig.send(&ToController::Safe(command));
    let state = |packet: &ToHost| match packet {
        ToHost::Safe(state) => Some(*state),
        _ => None,
    };
    rig.received().iter().find_map(state).unwrap()
}

#[test]
fn host_of_another_version_may_always_stop_darken_and_ask() {
    // Whose hello was refused, so that no session is open.
    let mut rig = Rig::homed();
    assert!(matches!(rig.ask(Command::Lamp { on: true, level: u16::MAX }), Outcome::Done(_)));
    let other = Hello { schema: 1, version: 99, session: 5 };
    rig.begin(Command::MoveTo([4000; 4]));
    (0..200).for_each(|_| assert!(rig.pass_event()));
    let state = safe(&mut rig, SafeCommand::Ask);
    assert!(state.moving && state.busy && state.lamp && state.known && state.configured && !state.fault);
    assert!(safe(&mut rig, SafeCommand::Unknown(9)).moving);
    assert!(!safe(&mut rig, SafeCommand::Darken).lamp);
    assert!(!rig.bench.borrow().lamp && rig.moving() != [false; 4]);
    let stopping = safe(&mut rig, SafeCommand::Stop);
    assert_eq!((stopping.command, stopping.busy), (SafeCommand::Stop, true));
    while rig.pass_event() {}
    let stopped = safe(&mut rig, SafeCommand::Ask);
    assert!(!stopped.moving && !stopped.busy && stopped.known, "{stopped:?}");
    assert!(stopped.positions.iter().all(|&position| position < 4000));
    // And so where there never was a session.
    rig.send(&ToController::Hello(other));
    rig.received();
    assert_eq!(safe(&mut rig, SafeCommand::Stop).positions, stopped.positions);
}

#[test]
fn lease_of_a_host_that_was_quiet_for_an_exposure_runs_anew_when_another_ends_that() {
    let mut configuration = leased(0);
    (configuration.settings.lease_ms, configuration.settings.lamp_lease_ms) = (20_000, 20_000);
    let mut rig = Rig::greeted(configuration).at_home();
    assert!(matches!(rig.ask(Command::Lamp { on: true, level: u16::MAX }), Outcome::Done(_)));
    let id = rig.begin(Command::Expose { duration_us: 60_000_000, warm_lamp: false });
    let end_us = rig.bench.borrow().now_us + 30_000_000;
    while rig.bench.borrow().now_us < end_us {
        assert!(rig.pass_event());
    }
    assert!(safe(&mut rig, SafeCommand::Ask).shutter);
    let stopped = safe(&mut rig, SafeCommand::Stop);
    assert!(!stopped.shutter && stopped.lamp && !stopped.fault, "{stopped:?}");
    assert_eq!(rig.outcome(id), Outcome::Refused(Refusal::Stopped));
    assert!(rig.bench.borrow().lamp && !safe(&mut rig, SafeCommand::Ask).fault);
}

#[test]
fn exposure_in_the_dark_of_another_host_is_given_up_and_no_lease_is_renewed() {
    let mut rig = Rig::homed();
    let id = rig.begin(Command::Expose { duration_us: 50_000, warm_lamp: false });
    (0..5).for_each(|_| assert!(rig.pass_event()));
    assert!(safe(&mut rig, SafeCommand::Ask).shutter);
    assert!(!safe(&mut rig, SafeCommand::Darken).shutter);
    assert_eq!(rig.outcome(id), Outcome::Refused(Refusal::Stopped));
    let mut rig = Rig::greeted(leased(0));
    assert!(matches!(rig.ask(Command::Lamp { on: true, level: u16::MAX }), Outcome::Done(_)));
    let lit_us = rig.bench.borrow().now_us;
    while rig.bench.borrow().lamp {
        let now = rig.bench.borrow().now_us + 100_000;
        assert!(now < lit_us + 5_000_000, "asking keeps the lamp alight");
        rig.bench.borrow_mut().now_us = now;
        safe(&mut rig, SafeCommand::Ask);
    }
    assert!(safe(&mut rig, SafeCommand::Ask).fault);
}

#[test]
fn health_is_told_with_the_telemetry_and_when_asked() {
    let mut rig = Rig::greeted(configuration());
    let health = |rig: &mut Rig| match rig.ask(Command::ReadHealth) {
        Outcome::Done(Answer::Health(health)) => health,
        other => panic!("{other:?}"),
    };
    let rested = health(&mut rig);
    assert_eq!((rested.stack, rested.overruns, rested.supply_mv), (Some([3000, 8000]), 7, Some(3300)));
    assert_eq!((rested.worst_late_us, rested.longest_poll_us), (0, 0));
    let homing = rig.begin(Command::Home);
    (0..500).for_each(|_| assert!(rig.pass_event()));
    // The loop stands for as long as a motor bears, and a step comes late by that.
    let due = rig.next_event_us();
    rig.bench.borrow_mut().now_us = due + 60;
    rig.pass_event();
    assert!(matches!(rig.outcome(homing), Outcome::Done(_)));
    let late = health(&mut rig);
    assert!((1..=60).contains(&late.worst_late_us), "{late:?}");
    rig.ask(Command::Watch { telemetry_ms: 20, log: false });
    rig.pass_event();
    let told = events(&mut rig).into_iter().find_map(|event| match event {
        Event::Telemetry(telemetry) => Some(telemetry.health),
        _ => None,
    });
    assert_eq!(told, Some(late));
}
