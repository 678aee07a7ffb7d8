//! What the controller promises, seen at its pins and its link.
#![allow(clippy::unwrap_used)]

mod bench;

use bench::{Rig, SESSION, SWITCH_AT, configuration, refusal};
use lobelia_protocol::{
    Answer, Axis, AxisParameters, Command, Configuration, Event, Fault, Field, Hello, HomeDirection, Outcome,
    Refusal, Request, Settings, ToController, ToHost, Verdict,
};
use proptest::prelude::*;

/// Where the motor is when the axis is truly at a position: the switch opens one step above the last closed
/// one, and that step is −1000.
fn with_coordination(coordinated: bool) -> Configuration {
    let configuration = configuration();
    Configuration { settings: Settings { coordinated, ..configuration.settings }, ..configuration }
}

fn motor_position(position: i32) -> i64 {
    SWITCH_AT + 1 + 1000 + i64::from(position)
}

#[test]
fn other_schema_is_refused_and_nothing_but_a_hello_is_understood() {
    let mut rig = Rig::new();
    rig.send(&ToController::Hello(Hello { schema: 1, version: 9, session: SESSION }));
    let [ToHost::Hello(reply)] = rig.received()[..] else { panic!("no reply") };
    assert_eq!((reply.verdict, reply.hello), (Verdict::DifferentSchema, Hello::new(SESSION)));
    let rest = [Command::Home, Command::Lamp { on: true, level: 9 }];
    for command in configuration().commands().into_iter().chain(rest) {
        assert_eq!(refusal(rig.ask(command)), Refusal::NoSession);
    }
    assert_eq!((rig.step_count(), rig.bench.borrow().lamp), (0, false));
}

#[test]
fn homing_puts_the_edge_where_the_configuration_says() {
    let mut rig = Rig::homed();
    let motors = rig.bench.borrow().motors;
    let Outcome::Done(Answer::Status(status)) = rig.ask(Command::Status) else { panic!("no status") };
    assert_eq!(status.positions.map(motor_position), motors);
    assert_eq!(status.known, [true; 4]);
}

#[test]
fn homing_begun_on_the_switch_finds_the_same_edge() {
    let mut rig = Rig::greeted(configuration());
    rig.bench.borrow_mut().motors = [SWITCH_AT - 50; 4];
    assert!(matches!(rig.ask(Command::Home), Outcome::Done(_)));
    rig.ask(Command::MoveTo([0; 4]));
    assert_eq!(rig.bench.borrow().motors, [motor_position(0); 4]);
}

#[test]
fn homing_at_the_upper_end_measures_the_edge_upward() {
    let mut upper = configuration();
    for axis in &mut upper.axes {
        (axis.home_direction, axis.home_position) = (HomeDirection::Positive, 6000);
    }
    let mut rig = Rig::greeted(upper);
    rig.bench.borrow_mut().switch_up = true;
    assert!(matches!(rig.ask(Command::Home), Outcome::Done(_)));
    rig.ask(Command::MoveTo([0; 4]));
    assert_eq!(rig.bench.borrow().motors, [-SWITCH_AT - 6000; 4]);
}

#[test]
fn repeated_request_is_not_run_twice() {
    let mut rig = Rig::homed();
    let request = Request { session: SESSION, id: 1, seen: 0, command: Command::MoveTo([300, 200, 10, 400]) };
    rig.send(&ToController::Request(request));
    rig.pass_event();
    rig.received();
    rig.send(&ToController::Request(request));
    let running = rig.received();
    assert!(matches!(running[..], [ToHost::Response(response)] if response.outcome == Outcome::Running));
    let done = rig.outcome(1);
    let steps = rig.step_count();
    rig.send(&ToController::Request(request));
    let again = rig.received();
    assert!(matches!(again[..], [ToHost::Response(response)] if response.outcome == done));
    assert!(!rig.pass_event());
    assert_eq!(rig.step_count(), steps);
}

#[test]
fn old_request_without_a_kept_answer_is_not_run() {
    let mut rig = Rig::homed();
    rig.begin(Command::Status);
    let late = Request { session: SESSION, id: 0, seen: 0, command: Command::MoveTo([300; 4]) };
    rig.received();
    rig.send(&ToController::Request(late));
    let answers = rig.received();
    assert!(matches!(answers[..], [ToHost::Response(response)]
            if response.outcome == Outcome::Refused(Refusal::Stale)));
    assert_eq!(rig.step_count(), 0);
}

#[test]
fn another_host_ends_what_the_last_one_began_and_keeps_positions() {
    let mut rig = Rig::homed();
    let id = rig.begin(Command::MoveTo([2000; 4]));
    for _ in 0..50 {
        rig.pass_event();
    }
    rig.received();
    rig.send(&ToController::Hello(Hello::new(SESSION + 1)));
    while rig.pass_event() {}
    let answered =
        rig.received().iter().any(|packet| matches!(packet, ToHost::Response(response) if response.id == id));
    assert!(!answered);
    let status = Request { session: SESSION + 1, id: 1, seen: 0, command: Command::Status };
    rig.send(&ToController::Request(status));
    let Outcome::Done(Answer::Status(status)) = rig.outcome(1) else { panic!("no status") };
    assert_eq!((status.known, status.busy), ([true; 4], false));
    assert!(status.positions.iter().all(|&position| position < 2000));
}

#[test]
fn emergency_stop_ceases_steps_at_once_and_needs_clearing_and_homing() {
    let mut rig = Rig::homed();
    rig.ask(Command::Lamp { on: true, level: 65535 });
    let id = rig.begin(Command::MoveTo([2000; 4]));
    for _ in 0..200 {
        rig.pass_event();
    }
    let before = rig.step_count();
    rig.bench.borrow_mut().stop_pressed = true;
    rig.poll();
    assert!(!rig.pass_event());
    assert_eq!(rig.step_count(), before);
    assert_eq!((rig.bench.borrow().enabled, rig.bench.borrow().lamp), ([false; 4], false));
    let packets = rig.received();
    let told = |packet: &ToHost| {
        matches!(packet, ToHost::Event(Event::Fault(report))
        if report.fault == Fault::EmergencyStop)
    };
    assert!(packets.iter().any(told));
    assert!(packets.iter().any(|packet| matches!(packet, ToHost::Response(response) if response.id == id)));
    assert_eq!(refusal(rig.ask(Command::ClearFaults)), Refusal::EmergencyStopPressed);
    rig.bench.borrow_mut().stop_pressed = false;
    assert!(matches!(refusal(rig.ask(Command::Home)), Refusal::Faulted(_)));
    assert!(matches!(rig.ask(Command::ClearFaults), Outcome::Done(_)));
    assert_eq!(refusal(rig.ask(Command::MoveTo([0; 4]))), Refusal::PositionUnknown(Axis::Pan));
    assert!(matches!(rig.ask(Command::Home), Outcome::Done(_)));
    assert!(matches!(rig.ask(Command::MoveTo([0; 4])), Outcome::Done(_)));
}

#[test]
fn switch_that_closes_during_a_move_is_a_fault() {
    let mut rig = Rig::homed();
    rig.ask(Command::MoveTo([500; 4]));
    // The tilt motor has lost steps: its axis is lower than counted.
    rig.bench.borrow_mut().motors[1] -= 400;
    let id = rig.begin(Command::MoveTo([-800; 4]));
    assert!(matches!(refusal(rig.outcome(id)), Refusal::Faulted(faults) if faults.contains(Fault::LimitHit)));
    // It counts once it has been closed for 2 ms, at up to 1000 steps/s.
    let beyond = SWITCH_AT - rig.bench.borrow().motors[1];
    assert!((0..=3).contains(&beyond), "{beyond} steps into the switch");
    // No arm falls.
    assert_eq!(rig.bench.borrow().enabled, [true; 4]);
}

#[test]
fn repeated_homing_reports_the_spread_of_the_switch_and_bouncing_adds_none() {
    for bouncy in [false, true] {
        let mut rig = Rig::greeted(configuration());
        rig.bench.borrow_mut().bouncy = bouncy;
        let outcome = rig.ask(Command::HomeRepeatedly { approaches: 6 });
        let Outcome::Done(Answer::Homed(report)) = outcome else { panic!("{outcome:?}") };
        // A bounce can hide the edge from the very step that passes it.
        assert!(report.spread_steps.iter().all(|&spread| spread <= u32::from(bouncy)), "{report:?}");
        for (position, motor) in report.positions.iter().zip(rig.bench.borrow().motors) {
            assert!((motor_position(*position) - motor).abs() <= i64::from(bouncy));
        }
        assert_eq!(report.approaches, 6);
    }
    let field = Refusal::BadParameter { axis: None, field: Field::Approaches };
    assert_eq!(refusal(Rig::greeted(configuration()).ask(Command::HomeRepeatedly { approaches: 0 })), field);
}

#[test]
fn spread_is_what_the_switch_moved_between_approaches() {
    let mut rig = Rig::greeted(configuration());
    let id = rig.begin(Command::HomeRepeatedly { approaches: 4 });
    let shifts = [0, 3, -2, 1];
    let (mut backed_off, mut away) = (0, false);
    let outcome = loop {
        rig.pass_event();
        let far = rig.bench.borrow().motors[2] > SWITCH_AT + 30;
        if far && !away && backed_off < shifts.len() {
            rig.bench.borrow_mut().switch_shift[2] = shifts[backed_off];
            backed_off += usize::from(rig.bench.borrow().steps[2].len() > 600);
        }
        away = far;
        if let Some(outcome) = rig.answered(id) {
            break outcome;
        }
    };
    let Outcome::Done(Answer::Homed(report)) = outcome else { panic!("{outcome:?}") };
    assert_eq!((report.spread_steps, backed_off), ([0, 0, 5, 0], 4));
}

#[test]
fn check_keeps_positions_and_finds_lost_steps() {
    let mut rig = Rig::homed();
    rig.ask(Command::MoveTo([500; 4]));
    assert_eq!(rig.ask(Command::CheckIndex), Outcome::Done(Answer::Checked([0; 4])));
    rig.ask(Command::MoveTo([0; 4]));
    assert_eq!(rig.bench.borrow().motors, [motor_position(0); 4]);
    // Within the tolerance it is told and borne.
    rig.bench.borrow_mut().motors[3] -= 2;
    assert_eq!(rig.ask(Command::CheckIndex), Outcome::Done(Answer::Checked([0, 0, 0, 2])));
    assert_eq!(rig.ask(Command::MoveTo([100; 4])), Outcome::Done(Answer::At([100; 4])));
    rig.bench.borrow_mut().motors[1] += 9;
    assert_eq!(rig.ask(Command::CheckIndex), Outcome::Done(Answer::Checked([0, -9, 0, 2])));
    assert!(matches!(refusal(rig.ask(Command::MoveTo([0; 4]))), Refusal::Faulted(faults)
            if faults.contains(Fault::StepsLost)));
    rig.ask(Command::ClearFaults);
    assert_eq!(refusal(rig.ask(Command::MoveTo([0; 4]))), Refusal::PositionUnknown(Axis::Pan));
    assert_eq!(refusal(rig.ask(Command::CheckIndex)), Refusal::PositionUnknown(Axis::Pan));
}

#[test]
fn stall_ceases_all_steps_and_positions_are_unknown() {
    let mut rig = Rig::homed();
    let id = rig.begin(Command::MoveTo([2000; 4]));
    for _ in 0..300 {
        rig.pass_event();
    }
    rig.bench.borrow_mut().alarm[3] = true;
    assert!(matches!(refusal(rig.outcome(id)), Refusal::Faulted(faults) if faults.contains(Fault::Stall)));
    assert!(!rig.pass_event());
    rig.bench.borrow_mut().alarm[3] = false;
    rig.ask(Command::ClearFaults);
    assert_eq!(refusal(rig.ask(Command::MoveTo([0; 4]))), Refusal::PositionUnknown(Axis::Pan));
}

#[test]
fn homing_without_a_switch_fails_within_the_travel() {
    let mut rig = Rig::greeted(configuration());
    rig.bench.borrow_mut().motors[2] = 1_000_000;
    assert!(matches!(refusal(rig.ask(Command::Home)), Refusal::Faulted(faults)
            if faults.contains(Fault::HomingFailed)));
    assert!(rig.bench.borrow().steps[2].len() <= 4000);
}

#[test]
fn stop_answers_at_once_and_leaves_positions_known_at_rest() {
    let mut rig = Rig::homed();
    let moving = rig.begin(Command::MoveTo([4000; 4]));
    for _ in 0..500 {
        rig.pass_event();
    }
    rig.begin(Command::Stop);
    assert_eq!(refusal(rig.outcome(moving)), Refusal::Stopped);
    let motors = rig.bench.borrow().motors;
    let Outcome::Done(Answer::Status(status)) = rig.ask(Command::Status) else { panic!("no status") };
    assert_eq!((status.known, status.moving), ([true; 4], [false; 4]));
    assert_eq!(status.positions.map(motor_position), motors);
}

#[test]
fn commands_that_make_no_sense_are_refused_without_a_fault() {
    let mut rig = Rig::new();
    rig.send(&ToController::Hello(Hello::new(SESSION)));
    assert_eq!(refusal(rig.ask(Command::Home)), Refusal::NotConfigured);
    let mut bad = configuration();
    bad.axes[3].acceleration = 0;
    let field = Refusal::BadParameter { axis: Some(Axis::Light), field: Field::Acceleration };
    assert_eq!(refusal(rig.configure(bad)), field);
    rig.configure(configuration());
    assert_eq!(refusal(rig.ask(Command::MoveTo([0; 4]))), Refusal::PositionUnknown(Axis::Pan));
    rig.ask(Command::Home);
    assert_eq!(refusal(rig.ask(Command::MoveTo([0, 0, 5001, 0]))), Refusal::OutOfLimits(Axis::Roll));
    let dark = Command::Expose { duration_us: 1000, warm_lamp: true };
    assert_eq!(refusal(rig.ask(dark)), Refusal::LampNotWarm { remaining_s: None });
    rig.begin(Command::Home);
    assert_eq!(refusal(rig.ask(Command::Retarget([0; 4]))), Refusal::Busy);
}

#[test]
fn more_steps_than_the_board_makes_or_its_pulses_leave_room_for_are_refused() {
    let mut rig = Rig::new();
    rig.send(&ToController::Hello(Hello::new(SESSION)));
    let field = |axis, field| Refusal::BadParameter { axis, field };
    // The board makes 30,000 steps/s, the other axes 3300.
    for (speed, refused) in [(26_701, true), (26_700, false)] {
        let mut fast = configuration();
        fast.axes[3].max_speed = speed;
        let outcome = rig.configure(fast);
        match refused {
            true => assert_eq!(refusal(outcome), field(None, Field::StepRate)),
            false => assert!(matches!(outcome, Outcome::Done(_)), "{outcome:?}"),
        }
    }
    // 20,000 steps/s leave 50 µs: twice 23 and a µs each, and 1.
    for (pulse_us, refused) in [(0, Some(None)), (101, Some(None)), (24, Some(Some(Axis::Light))), (23, None)]
    {
        let mut long = configuration();
        long.settings.pulse_us = pulse_us;
        let outcome = rig.configure(long);
        match refused {
            Some(axis) => assert_eq!(refusal(outcome), field(axis, Field::Pulse), "{pulse_us}"),
            None => assert!(matches!(outcome, Outcome::Done(_)), "{outcome:?}"),
        }
    }
}

#[test]
fn same_configuration_again_keeps_positions_and_another_forgets_them() {
    let mut rig = Rig::homed();
    rig.configure(configuration());
    assert!(matches!(rig.ask(Command::MoveTo([100; 4])), Outcome::Done(_)));
    let mut other = configuration();
    other.axes[0].home_position -= 1;
    rig.configure(other);
    assert_eq!(refusal(rig.ask(Command::MoveTo([0; 4]))), Refusal::PositionUnknown(Axis::Pan));
}

#[test]
fn coordinated_axes_arrive_at_once_and_others_each_as_soon_as_they_can() {
    for coordinated in [true, false] {
        let mut rig = Rig::greeted(with_coordination(coordinated));
        rig.ask(Command::Home);
        rig.ask(Command::MoveTo([0; 4]));
        rig.bench.borrow_mut().steps = Default::default();
        // Tilt and roll end downward and so take up their play.
        let id = rig.begin(Command::MoveTo([900, -700, -40, 4000]));
        let mut rested_us = [0; 4];
        loop {
            let before = rig.moving();
            assert!(rig.pass_event());
            for (axis, moving) in rig.moving().into_iter().enumerate() {
                if before[axis] && !moving {
                    rested_us[axis] = rig.bench.borrow().now_us;
                }
            }
            if rig.moving() == [false; 4] {
                break;
            }
        }
        let apart = rested_us.iter().max().unwrap() - rested_us.iter().min().unwrap();
        // Runs begin one after the other, one a poll.
        assert_eq!(apart <= 4, coordinated, "{rested_us:?}");
        assert_eq!(rig.outcome(id), Outcome::Done(Answer::At([900, -700, -40, 4000])));
    }
}

#[test]
fn full_turn_axis_goes_the_shorter_way_through_zero_and_keeps_its_names() {
    let mut round = configuration();
    let roll = &mut round.axes[2];
    (roll.full_turn_steps, roll.min_steps, roll.max_steps) = (2000, -1000, 999);
    let mut rig = Rig::greeted(round);
    rig.ask(Command::Home);
    for (target, way) in
        [(0, None), (900, Some(900)), (-900, Some(200)), (950, Some(-150)), (-1000, Some(50))]
    {
        let before = rig.bench.borrow().motors[2];
        let targets = [0, 0, target, 0];
        assert_eq!(rig.ask(Command::MoveTo(targets)), Outcome::Done(Answer::At(targets)));
        let went = rig.bench.borrow().motors[2] - before;
        assert!(way.is_none_or(|way| way == went), "{went} steps to {target}");
    }
    round.axes[2].full_turn_steps = 1998;
    let field = Refusal::BadParameter { axis: Some(Axis::Roll), field: Field::FullTurn };
    assert_eq!(refusal(rig.configure(round)), field);
}

#[test]
fn retargeted_move_is_answered_as_stopped_and_ends_on_the_new_target() {
    for coordinated in [true, false] {
        for (events, targets) in [(40, [3000, 100, -600, 4000]), (2500, [-800, 2000, 500, 1500])] {
            let mut rig = Rig::greeted(with_coordination(coordinated));
            rig.ask(Command::Home);
            rig.ask(Command::MoveTo([0; 4]));
            let first = rig.begin(Command::MoveTo([2000; 4]));
            for _ in 0..events {
                rig.pass_event();
            }
            rig.bench.borrow_mut().steps = Default::default();
            let second = rig.begin(Command::Retarget(targets));
            assert_eq!(refusal(rig.outcome(first)), Refusal::Stopped);
            assert_eq!(rig.outcome(second), Outcome::Done(Answer::At(targets)));
            assert_eq!(rig.bench.borrow().motors, targets.map(motor_position));
            for (steps, p) in rig.bench.borrow().steps.iter().zip(&configuration().axes) {
                check_limits(steps, p).unwrap();
                assert!(steps.iter().rev().take(40).all(|&(_, up)| up), "the play isn't taken up");
            }
        }
    }
}

#[test]
fn retarget_beyond_the_limits_changes_nothing() {
    let mut rig = Rig::homed();
    let id = rig.begin(Command::MoveTo([500; 4]));
    rig.pass_event();
    assert_eq!(refusal(rig.ask(Command::Retarget([0, 5001, 0, 0]))), Refusal::OutOfLimits(Axis::Tilt));
    assert_eq!(rig.outcome(id), Outcome::Done(Answer::At([500; 4])));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn moves_keep_limits_end_on_target_and_end_upward(
        targets in proptest::collection::vec(proptest::array::uniform4(-900..=5000i32), 1..4),
    ) {
        let mut rig = Rig::homed();
        for target in targets {
            rig.bench.borrow_mut().steps = Default::default();
            prop_assert_eq!(rig.ask(Command::MoveTo(target)), Outcome::Done(Answer::At(target)));
            let bench = rig.bench.borrow();
            for (axis, parameters) in configuration().axes.iter().enumerate() {
                prop_assert_eq!(bench.motors[axis], motor_position(target[axis]));
                let steps = &bench.steps[axis];
                prop_assert!(steps.iter().rev().take(40).all(|&(_, up)| up), "the play isn't taken up");
                check_limits(steps, parameters)?;
            }
            prop_assert!(!bench.pulse_too_short);
        }
    }
}

/// Speed, acceleration and jerk at the emitted step times, which are whole µs; runs in one direction are told
/// apart. The n-th divided difference times n! is a mean of the n-th derivative; steps 40 apart leave little
/// of the rounding.
fn check_limits(steps: &[(u64, bool)], p: &AxisParameters) -> Result<(), TestCaseError> {
    for run in steps.chunk_by(|a, b| a.1 == b.1) {
        for pair in run.windows(2) {
            let least_interval = (pair[1].0 - pair[0].0 + 1) as f64 * 1e-6;
            prop_assert!(1.0 / least_interval <= f64::from(p.max_speed) * 1.0001);
        }
        // A turn between two runs upward takes at least this long; a derivative means nothing across it.
        for four in run.windows(121).step_by(7) {
            let at = [0, 40, 80, 120].map(|k| four[k].0 as f64 * 1e-6);
            let first = [0, 1, 2].map(|k| 40.0 / (at[k + 1] - at[k]));
            let second = [0, 1].map(|k| (first[k + 1] - first[k]) / (at[k + 2] - at[k]) * 2.0);
            let third = (second[1] - second[0]) / (at[3] - at[0]) * 3.0;
            // ±1 µs on each time, at the highest speed.
            let blur = 4e-6 * f64::from(p.max_speed) / (at[3] - at[0]).powi(2) * 9.0;
            prop_assert!(
                second.iter().all(|a| a.abs() <= f64::from(p.acceleration) * 1.001 + 2.0 * blur),
                "{:?}",
                at
            );
            let blur = 8e-6 * f64::from(p.max_speed) / (at[3] - at[0]).powi(3) * 162.0;
            prop_assert!(third.abs() <= f64::from(p.jerk) * 1.001 + blur, "jerk {} at {:?}", third, at);
        }
    }
    Ok(())
}
