//! The controller at its pins, with a step interrupt that breaks into it anywhere: what no single virtual
//! clock can show.
#![allow(clippy::unwrap_used)]

mod alarms;
mod any_run;
mod pins;
mod rig;

use lobelia_protocol::{
    Alarm, Answer, AxisParameters, Command, Configuration, Fault, HomeDirection, Outcome, Pins, Refusal,
    Settings,
};
use rig::{Costs, Rig, SWITCH_AT, Skew, Step};

/// Four like axes, whose switch opens at their step −100.
fn configuration(max_speed: u32, acceleration: u32, jerk: u32) -> Configuration {
    let axis = AxisParameters {
        min_steps: 0,
        max_steps: 200_000,
        max_speed,
        acceleration,
        jerk,
        full_turn_steps: 0,
        take_up_steps: 0,
        settle_ms: 0,
        home_direction: HomeDirection::Negative,
        home_position: -100,
        home_speed: 1550.min(max_speed),
        home_slow_speed: 78,
        home_back_off: 78,
        home_switch_steps: 400,
        home_order: 0,
        home_travel: 20_000,
        home_debounce_us: 3000,
        index_tolerance: 4,
        driver: None,
        inverted: Pins::NONE,
        alarm: Alarm::None,
        alarm_debounce_us: 20,
        most_turns: 1,
    };
    let settings = Settings {
        lamp_warm_up_s: 10,
        lamp_least_reading: 0,
        lease_ms: 2000,
        lamp_lease_ms: 2000,
        lamp_safe_level: 0,
        lamp_longest_s: 172_800,
        fan_run_on_s: 300,
        camera_wait_ms: 0,
        coordinated: false,
        pulse_us: 3,
        direction_setup_us: 6,
        inverted: Pins::NONE,
    };
    Configuration { axes: [axis; 4], settings, keep_outs: [None; 4] }
}

/// Where a motor is when its axis is at a position.
fn motor(position: i32) -> i64 {
    SWITCH_AT + 1 + 100 + i64::from(position)
}

/// The fault by which a request was refused.
fn has_fault(outcome: Outcome, fault: Fault) -> bool {
    matches!(outcome, Outcome::Refused(Refusal::Faulted(faults)) if faults.contains(fault))
}

/// From each step to the next the speed changes by no more than the acceleration allows, with step times
/// uncertain by so many ns, and each late by no more than a part of its interval.
fn check_speeds(steps: &[Step], p: &AxisParameters, uncertain_ns: u64, late: f64) -> Result<(), String> {
    let uncertain_s = uncertain_ns as f64 * 1e-9;
    for run in steps.chunk_by(|a, b| a.up == b.up) {
        let intervals: Vec<f64> =
            run.windows(2).map(|pair| (pair[1].at_ns - pair[0].at_ns) as f64 * 1e-9).collect();
        for (k, pair) in intervals.windows(2).enumerate() {
            let (a, b) = (pair[0], pair[1]);
            let shorter = a.min(b);
            let fastest = 1.0 / (shorter + uncertain_s);
            if fastest > f64::from(p.max_speed) * 1.0001 {
                return Err(format!("{fastest:.0} steps/s at step {k}"));
            }
            let off = 2.0 * uncertain_s + late * shorter;
            let jump = (1.0 / a - 1.0 / b).abs();
            let most = f64::from(p.acceleration) * (a + b) * 1.001 + off / (shorter * (shorter + off));
            if jump > most {
                return Err(format!(
                    "speed jumps by {jump:.0} steps/s, {most:.0} at most, at step {k}: {a} {b}"
                ));
            }
        }
    }
    Ok(())
}

fn check_all_speeds(rig: &Rig, configuration: &Configuration, uncertain_ns: u64) {
    for (steps, p) in rig.world.borrow().steps.iter().zip(&configuration.axes) {
        if let Err(why) = check_speeds(steps, p, uncertain_ns, 0.0) {
            panic!("{why}");
        }
    }
}

#[test]
fn clock_that_a_flash_erase_has_stopped_gives_a_fault_and_no_endless_move() {
    // The board's own clocks cannot part; a port to another board may have two.
    for behind_us in [400_000, 800_000] {
        let configuration = configuration(4651, 9302, 93_023);
        let mut rig = Rig::homed(1, Costs::LIGHT, &configuration);
        rig.ask(Command::MoveTo([10; 4]));
        rig.skew = Skew { behind_us, drift_ppm: 0 };
        let before_ns = rig.ns();
        let outcome = rig.ask(Command::MoveTo([10_000, 10, 10, 10]));
        assert!(has_fault(outcome, Fault::StepsLate), "{behind_us} µs: {outcome:?}");
        assert!(rig.ns() - before_ns < 5_000_000_000);
        assert_eq!(rig.status().known, [false; 4]);
    }
}

#[test]
fn main_loop_that_stands_for_milliseconds_loses_nothing_or_raises_a_fault() {
    for (stands_ms, late) in [(1, false), (2, false), (3, false), (5, false), (12, true), (30, true)] {
        let configuration = configuration(50_000, 200_000, 4_000_000);
        let mut rig = Rig::homed(2, Costs::LIGHT, &configuration);
        rig.ask(Command::MoveTo([10; 4]));
        rig.forget_steps();
        let id = rig.begin(Command::MoveTo([60_000, 10, 10, 10]));
        rig.run(700_000_000);
        rig.stand(stands_ms * 1_000_000);
        let outcome = rig.outcome(id);
        if late {
            assert!(has_fault(outcome, Fault::StepsLate), "{stands_ms} ms: {outcome:?}");
            assert_eq!(rig.status().known, [false; 4]);
        } else {
            assert_eq!(outcome, Outcome::Done(Answer::At([60_000, 10, 10, 10])), "{stands_ms} ms");
            check_all_speeds(&rig, &configuration, 4000);
        }
    }
}

#[test]
fn retarget_of_four_axes_at_full_speed_leaves_no_gap() {
    // Looks take so long that planning takes as long as on a small processor.
    let costs = Costs { look_ns: 30_000, ..Costs::LIGHT };
    for seed in 1..6 {
        let configuration = configuration(9000, 60_000, 1_000_000);
        let mut rig = Rig::homed(seed, costs, &configuration);
        rig.ask(Command::MoveTo([10; 4]));
        rig.forget_steps();
        let first = rig.begin(Command::MoveTo([20_000, 21_000, 22_000, 23_000]));
        rig.run(900_000_000);
        let targets = [30_000, 28_000, 500, 26_000];
        let second = rig.begin(Command::Retarget(targets));
        assert_eq!(rig.outcome(first), Outcome::Refused(Refusal::Stopped));
        assert_eq!(rig.outcome(second), Outcome::Done(Answer::At(targets)));
        assert_eq!(rig.world.borrow().motors, targets.map(motor));
        check_all_speeds(&rig, &configuration, 8000);
    }
}

#[test]
fn pulses_and_direction_set_up_are_never_undercut() {
    for (pulse_us, direction_setup_us, speed) in
        [(1, 0, 40_000), (2, 5, 40_000), (5, 20, 30_000), (20, 200, 10_000)]
    {
        let mut configuration = configuration(speed, 400_000, 8_000_000);
        configuration.settings.pulse_us = pulse_us;
        configuration.settings.direction_setup_us = direction_setup_us;
        for (seed, inverted) in [(1, Pins::NONE), (2, Pins::NONE), (3, Pins::OF_AXIS)] {
            configuration.axes.iter_mut().for_each(|axis| axis.inverted = inverted);
            let costs = Costs { latency_ns: 8000, look_ns: 20_000, poll_ns: 300_000, ..Costs::LIGHT };
            let mut rig = Rig::homed(seed, costs, &configuration);
            for targets in [[4000, 3900, 3800, 3700], [10, 20, 30, 40], [500; 4]] {
                assert_eq!(rig.ask(Command::MoveTo(targets)), Outcome::Done(Answer::At(targets)));
            }
            let world = rig.world.borrow();
            let least_ns = u64::from(pulse_us) * 1000;
            assert!(world.shortest_high_ns >= least_ns, "{} ns high", world.shortest_high_ns);
            assert!(world.shortest_low_ns >= least_ns, "{} ns low", world.shortest_low_ns);
            assert!(world.shortest_setup_ns >= u64::from(direction_setup_us) * 1000);
        }
    }
}

#[test]
fn direction_set_up_holds_though_the_main_loop_stands_between_direction_and_steps() {
    let mut configuration = configuration(4000, 400_000, 8_000_000);
    configuration.settings.direction_setup_us = 200;
    let mut rig = Rig::homed(3, Costs { poll_ns: 30_000_000, ..Costs::LIGHT }, &configuration);
    for k in 0..20 {
        let targets = [100 + k % 2 * 40, 100, 100, 100];
        // Long polls may cost the move, never the set-up.
        rig.ask(Command::MoveTo(targets));
    }
    assert!(rig.world.borrow().shortest_setup_ns >= 200_000);
}

#[test]
fn broken_wire_of_a_switch_is_named_and_moves_the_axis_no_farther_than_the_switch_is_wide() {
    let configuration = configuration(4651, 9302, 93_023);
    let mut rig = Rig::new(4, Costs::LIGHT);
    rig.configure(&configuration);
    rig.world.borrow_mut().stuck[2] = Some(true);
    let outcome = rig.ask(Command::Home);
    assert!(has_fault(outcome, Fault::SwitchStuck), "{outcome:?}");
    assert!(rig.world.borrow().motors[2] <= 400 + 78, "{:?}", rig.world.borrow().motors);
    assert_eq!(rig.status().known, [false; 4]);
    // One that breaks on the way is found by the time that the axis should have left it.
    rig.world.borrow_mut().stuck[2] = None;
    rig.ask(Command::ClearFaults);
    let id = rig.begin(Command::Home);
    while rig.world.borrow().motors[2] > SWITCH_AT {
        rig.turn();
    }
    rig.world.borrow_mut().stuck[2] = Some(true);
    assert!(has_fault(rig.outcome(id), Fault::SwitchStuck));
    assert!(rig.world.borrow().motors[2] <= SWITCH_AT + 400 + 78);
}

#[test]
fn homing_begun_deep_in_the_switch_is_no_stuck_switch() {
    let configuration = configuration(4651, 9302, 93_023);
    let mut rig = Rig::new(5, Costs::LIGHT);
    rig.configure(&configuration);
    rig.world.borrow_mut().motors = [SWITCH_AT - 390; 4];
    let outcome = rig.ask(Command::Home);
    assert!(matches!(outcome, Outcome::Done(_)), "{outcome:?}");
    rig.ask(Command::MoveTo([0; 4]));
    assert_eq!(rig.world.borrow().motors, [motor(0); 4]);
}

#[test]
fn glitch_of_a_switch_at_a_step_of_the_slow_search_moves_no_home() {
    let configuration = configuration(4651, 9302, 93_023);
    for seed in 1..8 {
        let mut rig = Rig::new(seed, Costs { poll_ns: 400_000, ..Costs::LIGHT });
        rig.configure(&configuration);
        let id = rig.begin(Command::Home);
        let mut backed_off = false;
        loop {
            rig.turn();
            let at = rig.world.borrow().motors[0];
            let slow = rig.world.borrow().steps[0].last().is_some_and(|step| !step.up);
            backed_off |= !slow && at > SWITCH_AT;
            if backed_off && slow && at < SWITCH_AT + 60 {
                break;
            }
        }
        // From just before the next step on.
        let before = rig.world.borrow().steps[0].len();
        let from_ns = rig.ns();
        rig.world.borrow_mut().glitch = Some((0, from_ns, u64::MAX));
        while rig.world.borrow().steps[0].len() == before {
            rig.turn();
        }
        let step_ns = rig.world.borrow().steps[0].last().unwrap().at_ns;
        rig.world.borrow_mut().glitch = Some((0, step_ns, step_ns + 20_000));
        let outcome = rig.outcome(id);
        assert!(matches!(outcome, Outcome::Done(_)), "{outcome:?}");
        rig.ask(Command::MoveTo([0; 4]));
        let off = rig.world.borrow().motors[0] - motor(0);
        assert!(off.abs() <= 1, "home is {off} steps off");
    }
}

#[test]
fn noise_on_a_limit_switch_ends_no_move_and_a_closed_one_does() {
    let configuration = configuration(4651, 9302, 93_023);
    let mut rig = Rig::homed(6, Costs::LIGHT, &configuration);
    rig.ask(Command::MoveTo([10_000; 4]));
    let from_ns = rig.ns() + 1_000_000_000;
    rig.world.borrow_mut().glitch = Some((1, from_ns, from_ns + 250_000));
    assert_eq!(rig.ask(Command::MoveTo([100; 4])), Outcome::Done(Answer::At([100; 4])));
    rig.ask(Command::MoveTo([10_000; 4]));
    // Steps were lost: the switch is met on the way, and counts once it has been closed for its 3 ms.
    rig.world.borrow_mut().motors[1] -= 2000;
    let outcome = rig.ask(Command::MoveTo([100; 4]));
    assert!(has_fault(outcome, Fault::LimitHit), "{outcome:?}");
    let beyond = SWITCH_AT - rig.world.borrow().motors[1];
    assert!((0..=4651 * 4 / 1000).contains(&beyond), "{beyond} steps into the switch");
}

#[test]
fn axes_are_homed_in_the_order_asked_for_and_some_alone() {
    let mut ordered = configuration(4651, 9302, 93_023);
    for (axis, order) in ordered.axes.iter_mut().zip([1, 0, 1, 2]) {
        axis.home_order = order;
    }
    let mut rig = Rig::new(7, Costs::LIGHT);
    rig.configure(&ordered);
    assert!(matches!(rig.ask(Command::Home), Outcome::Done(_)));
    let span = |axis: usize| {
        let world = rig.world.borrow();
        (world.steps[axis][0].at_ns, world.steps[axis].last().unwrap().at_ns)
    };
    let [pan, tilt, roll, light] = [0, 1, 2, 3].map(span);
    assert!(tilt.1 < pan.0 && tilt.1 < roll.0 && pan.1 < light.0 && roll.1 < light.0);
    assert!(pan.0 < roll.1 && roll.0 < pan.1, "the same order is together");
    rig.ask(Command::MoveTo([500; 4]));
    rig.forget_steps();
    let axes = [false, false, true, false];
    assert!(matches!(rig.ask(Command::HomeAxes { axes, approaches: 1 }), Outcome::Done(_)));
    assert_eq!(rig.world.borrow().steps.each_ref().map(|steps| !steps.is_empty()), axes);
    assert_eq!(rig.status().known, [true; 4]);
    assert_eq!(rig.ask(Command::MoveTo([500; 4])), Outcome::Done(Answer::At([500; 4])));
    assert_eq!(rig.world.borrow().motors, [motor(500); 4]);
    let none = rig.ask(Command::HomeAxes { axes: [false; 4], approaches: 1 });
    assert!(matches!(none, Outcome::Refused(Refusal::BadParameter { .. })), "{none:?}");
}

#[test]
fn lamp_relay_opens_on_the_stop_though_the_dimmer_is_broken() {
    let configuration = configuration(4651, 9302, 93_023);
    let mut rig = Rig::homed(8, Costs::LIGHT, &configuration);
    rig.ask(Command::Lamp { on: true, level: 65535 });
    assert!(rig.world.borrow().lamp);
    rig.world.borrow_mut().dimmer_broken = true;
    rig.world.borrow_mut().stop_pressed = true;
    rig.turn();
    assert!(!rig.world.borrow().lamp);
}

#[test]
fn dimmer_that_fails_leaves_the_lamp_off() {
    let configuration = configuration(4651, 9302, 93_023);
    let mut rig = Rig::homed(9, Costs::LIGHT, &configuration);
    rig.ask(Command::Lamp { on: true, level: 30_000 });
    rig.world.borrow_mut().dimmer_broken = true;
    assert!(has_fault(rig.ask(Command::Lamp { on: true, level: 65535 }), Fault::Hardware));
    assert!(!rig.world.borrow().lamp);
}

#[test]
fn silent_host_leaves_the_lamp_dark_and_the_axes_at_rest() {
    let configuration = configuration(4651, 9302, 93_023);
    let mut rig = Rig::homed(10, Costs::LIGHT, &configuration);
    rig.ask(Command::Lamp { on: true, level: 65535 });
    rig.begin(Command::MoveTo([20_000; 4]));
    rig.heard = false;
    rig.run(2_100_000_000);
    assert_eq!((rig.world.borrow().lamp, rig.world.borrow().level_set), (false, 0));
    rig.run(2_000_000_000);
    rig.forget_steps();
    rig.run(1_000_000_000);
    assert!(rig.world.borrow().steps.iter().all(Vec::is_empty));
}
