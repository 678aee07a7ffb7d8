//! Several requests in flight, events behind answers, and the lease.
#![allow(clippy::unwrap_used)]

mod bench;

use bench::{Rig, SESSION, configuration};
use lobelia_protocol::{
    Command, Configuration, Event, Fault, Outcome, Refusal, Request, Response, ToController, ToHost,
};

fn request(id: u32, command: Command) -> ToController {
    ToController::Request(Request { session: SESSION, id, command })
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
    for order in [[2, 3, 4, 5], [5, 4, 3, 2], [4, 2, 5, 3]] {
        let mut rig = Rig::greeted(configuration());
        for id in order {
            rig.send(&request(id, level(id)));
        }
        let done = answers(&mut rig).into_iter().filter(|(_, outcome)| *outcome != Outcome::Running);
        assert_eq!(done.map(|(id, _)| id).collect::<Vec<_>>(), [2, 3, 4, 5], "{order:?}");
        // Of 1000: the level of the last one.
        assert_eq!(rig.bench.borrow().lamp_level, 500);
    }
}

#[test]
fn too_many_in_flight_are_refused_and_none_is_lost() {
    let mut rig = Rig::greeted(configuration());
    for id in 3..8 {
        rig.send(&request(id, level(id)));
    }
    let refused: Vec<_> =
        answers(&mut rig).into_iter().filter(|(_, outcome)| *outcome != Outcome::Running).collect();
    assert_eq!(refused, [6, 7].map(|id| (id, Outcome::Refused(Refusal::OutOfWindow))));
    for id in [2, 6, 7] {
        rig.send(&request(id, level(id)));
    }
    let done: Vec<_> = answers(&mut rig).into_iter().map(|(id, _)| id).collect();
    assert_eq!(done, [2, 3, 4, 5, 6, 7]);
}

#[test]
fn stop_waits_for_nothing_and_what_went_before_it_never_runs() {
    let mut rig = Rig::homed();
    rig.send(&request(4, Command::MoveTo([500; 4])));
    rig.send(&request(5, Command::Stop));
    rig.send(&request(3, Command::MoveTo([500; 4])));
    rig.send(&request(4, Command::MoveTo([500; 4])));
    while rig.pass_event() {}
    assert_eq!(rig.step_count(), 0);
    let stale = Outcome::Refused(Refusal::Stale);
    assert_eq!(answers(&mut rig)[2..], [(3, stale), (4, stale)]);
}

#[test]
fn events_wait_until_the_answers_are_sent() {
    let mut rig = Rig::homed();
    rig.bench.borrow_mut().line_stuck = true;
    for id in 3..7 {
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

fn leased() -> Configuration {
    Configuration { lease_ms: 2000, lamp_lease_ms: 3000, lamp_safe_level: 6554, ..configuration() }
}

#[test]
fn silent_host_ends_a_move_smoothly_and_dims_the_lamp() {
    let mut rig = Rig::greeted(leased());
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
    assert!(
        matches!(rig.outcome(id), Outcome::Refused(Refusal::Faulted(faults)) if faults.contains(Fault::LeaseExpired))
    );
    let last_step = rig.bench.borrow().steps[2].last().unwrap().0;
    // At rest after the lease and the ramp: 300 steps/s at 100 steps/s² and 2000 steps/s³.
    assert!((2_000_000..5_200_000).contains(&(last_step - began)), "{}", last_step - began);
    assert_eq!((rig.bench.borrow().lamp, rig.bench.borrow().lamp_level), (true, 100));
    assert!(!rig.pass_event());
    // Positions are known still.
    rig.ask(Command::ClearFaults);
    rig.ask(Command::Lamp { on: false, level: 0 });
    let id = rig.begin(Command::MoveTo([0, 0, 10, 0]));
    assert_eq!(rig.answered(id), None, "the move isn't begun");
}

#[test]
fn burning_lamp_alone_holds_a_lease_and_its_end_is_told() {
    let mut rig = Rig::greeted(Configuration { lamp_safe_level: 0, ..leased() });
    rig.ask(Command::Lamp { on: true, level: 65535 });
    assert_eq!(rig.next_event_us(), 3_000_000);
    assert!(rig.pass_event());
    let told = |packet: &ToHost| matches!(packet, ToHost::Event(Event::Fault(report)) if report.fault == Fault::LeaseExpired);
    assert!(rig.received().iter().any(told));
    assert_eq!((rig.bench.borrow().lamp, rig.bench.borrow().lamp_level), (false, 0));
    assert!(!rig.pass_event());
}
