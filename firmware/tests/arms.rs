//! Cables that must not twist and arms that must not touch.
#![allow(clippy::unwrap_used)]

mod bench;

use bench::{Rig, configuration};
use lobelia_protocol::{Answer, Axis, Command, Configuration, Field, KeepOut, Outcome, Refusal};

/// Whatever moves and homings there are, the cables of a full-turn axis are never wound up by more turns than
/// they bear, and where they would be, the longer way is taken.
#[test]
fn cables_of_a_full_turn_axis_are_wound_up_by_no_more_turns_than_they_bear() {
    for most_turns in [0, 1, 2] {
        let mut round = configuration();
        let roll = &mut round.axes[2];
        (roll.full_turn_steps, roll.min_steps, roll.max_steps) = (2000, -1000, 999);
        (roll.take_up_steps, roll.most_turns, roll.home_travel) = (10, most_turns, 9000);
        let mut rig = Rig::greeted(round);
        // Homing itself may go round by a turn.
        rig.ask(Command::Home);
        rig.ask(Command::MoveTo([0; 4]));
        let zero = rig.bench.borrow().motors[2];
        let (mut target, mut most) = (0, 0);
        for step in 0..60 {
            // Always onward, then always back, each time by less than half a turn.
            target += if step < 40 { 700 } else { -700 };
            let named = (target + 1000i32).rem_euclid(2000) - 1000;
            let targets = [0, 0, named, 0];
            assert_eq!(rig.ask(Command::MoveTo(targets)), Outcome::Done(Answer::At(targets)));
            let wound = rig.bench.borrow().motors[2] - zero;
            assert_eq!(wound.rem_euclid(2000), i64::from(named).rem_euclid(2000), "true to its name");
            let slack = 2000 * i64::from(most_turns);
            assert!((-1000 - slack..=999 + slack).contains(&wound), "{most_turns} turns: {wound}");
            most = most.max(wound);
            if step == 20 {
                // Homing anew does not make it forget.
                rig.ask(Command::Home);
                rig.ask(Command::MoveTo(targets));
            }
        }
        assert!(most > 2000 * i64::from(most_turns), "the turns allowed are used: {most}");
    }
}

/// A home switch that no longer closes, and somebody who tries again and again.
#[test]
fn homing_that_never_finds_its_switch_winds_cables_up_by_no_more_than_it_may_and_then_is_refused() {
    let mut round = configuration();
    let roll = &mut round.axes[2];
    (roll.full_turn_steps, roll.min_steps, roll.max_steps) = (2000, -1000, 999);
    (roll.take_up_steps, roll.most_turns, roll.home_travel) = (10, 1, 2200);
    let mut rig = Rig::greeted(round).at_home();
    rig.ask(Command::MoveTo([0; 4]));
    let zero = rig.bench.borrow().motors[2];
    rig.bench.borrow_mut().switch_shift[2] = -1_000_000;
    let roll_alone = Command::HomeAxes { axes: [false, false, true, false], approaches: 1 };
    let mut last = Outcome::Running;
    for _ in 0..10 {
        last = rig.ask(roll_alone);
        assert!(matches!(last, Outcome::Refused(_)), "{last:?}");
        rig.ask(Command::ClearFaults);
    }
    assert_eq!(last, Outcome::Refused(Refusal::OutOfLimits(Axis::Roll)));
    let wound = zero - rig.bench.borrow().motors[2];
    // A turn more than moves may have it, and then one homing.
    assert!((1000 + 2 * 2000..=1000 + 2 * 2000 + 2210).contains(&wound), "{wound}");
    // The others can be homed all the same.
    let tilt_alone = Command::HomeAxes { axes: [false, true, false, false], approaches: 1 };
    assert!(matches!(rig.ask(tilt_alone), Outcome::Done(_)));
}

/// Pan in 1000..=1500 while light is in 2000..=3000; pan is homed first, out of light's way.
fn kept_out() -> Configuration {
    let mut configuration = configuration();
    configuration.axes[3].home_order = 1;
    configuration.keep_outs[0] = Some(KeepOut {
        first: Axis::Light,
        first_steps: [2000, 3000],
        second: Axis::Pan,
        second_steps: [1000, 1500],
    });
    configuration
}

const BOTH: Refusal = Refusal::KeepOut { first: Axis::Light, second: Axis::Pan };

#[test]
fn two_axes_never_come_where_they_must_not_be_together_and_the_refusal_names_both() {
    let mut rig = Rig::greeted(kept_out());
    let expected = Outcome::Done(Answer::KeepOuts(kept_out().keep_outs));
    assert_eq!(rig.ask(Command::ReadKeepOuts), expected);
    assert!(matches!(rig.ask(Command::Home), Outcome::Done(_)));
    let go = |rig: &mut Rig, pan: i32, light: i32| rig.ask(Command::MoveTo([pan, 0, 0, light]));
    let there = |pan, light| Outcome::Done(Answer::At([pan, 0, 0, light]));
    assert_eq!(go(&mut rig, 0, 0), there(0, 0));
    let before = rig.step_count();
    assert_eq!(go(&mut rig, 1200, 2500), Outcome::Refused(BOTH), "inside");
    assert_eq!(go(&mut rig, 2000, 4000), Outcome::Refused(BOTH), "on the way");
    assert_eq!(go(&mut rig, 990, 2000), there(990, 2000), "beside it");
    assert_eq!(go(&mut rig, 990, 3500), there(990, 3500));
    assert_eq!(go(&mut rig, 1200, 3500), there(1200, 3500), "one after the other");
    assert_eq!(
        go(&mut rig, 1200, 3030),
        Outcome::Refused(BOTH),
        "the take-up leads 40 steps below the target"
    );
    assert!(rig.step_count() > before);
    // A new target on the way: what the old one would have passed counts too.
    let first = rig.begin(Command::MoveTo([2000, 0, 0, 4500]));
    assert_eq!(rig.ask(Command::Retarget([2000, 0, 0, 2500])), Outcome::Refused(BOTH));
    assert_eq!(rig.outcome(first), there(2000, 4500));
    assert_eq!(go(&mut rig, 2000, 2500), there(2000, 2500));
    // Light is homed only while pan stands out of its way.
    let light_alone = Command::HomeAxes { axes: [false, false, false, true], approaches: 1 };
    assert!(matches!(rig.ask(light_alone), Outcome::Done(_)));
    assert_eq!(go(&mut rig, 1200, 0), there(1200, 0));
    assert_eq!(rig.ask(light_alone), Outcome::Refused(BOTH));
    // All of them are homed in their order.
    rig.bench.borrow_mut().steps = Default::default();
    assert!(matches!(rig.ask(Command::Home), Outcome::Done(_)));
    let bench = rig.bench.borrow();
    assert!(bench.steps[0].last().unwrap().0 < bench.steps[3][0].0);
}

#[test]
fn keep_outs_that_make_no_sense_are_refused() {
    let changes: [fn(&mut Configuration); 5] = [
        |all| all.axes[3].home_order = 0,
        |all| all.keep_outs[0].as_mut().unwrap().first_steps = [3000, 2000],
        |all| all.keep_outs[0].as_mut().unwrap().second = Axis::Light,
        // Pan, homed first, would stand in light's way.
        |all| all.keep_outs[0].as_mut().unwrap().second_steps = [-1020, 1500],
        |all| (all.axes[0].full_turn_steps, all.axes[0].take_up_steps) = (20_000, 10),
    ];
    for change in changes {
        let mut all = kept_out();
        change(&mut all);
        let outcome = Rig::new_session().configure(all);
        assert!(
            matches!(outcome, Outcome::Refused(Refusal::BadParameter { field: Field::KeepOut, .. })),
            "{outcome:?}"
        );
    }
}
