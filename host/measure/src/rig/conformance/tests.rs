//! The checks on the real firmware, and on controllers that are wrong in one way each.
#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

use lobelia_hil_sim::{MechanicsConfig, SimulatedRig};
use lobelia_protocol::{Answer, Outcome, ToController, ToHost};

use super::*;
use crate::rig::testing::{Bent, fresh_ids};

fn failures(port: Box<dyn Port>) -> Vec<&'static str> {
    let configuration = MechanicsConfig::ideal().configuration();
    let checks = run(port, &configuration, true, |_| {}).unwrap();
    assert_eq!(checks.len(), count());
    checks
        .into_iter()
        .filter(|check| matches!(check.outcome, Finding::Fail(_)))
        .map(|check| check.name)
        .collect()
}

fn rig() -> SimulatedRig {
    SimulatedRig::new(&MechanicsConfig::ideal())
}

#[test]
fn the_simulated_rig_conforms_and_is_left_dark_and_at_rest() {
    let rig = rig();
    let configuration = MechanicsConfig::ideal().configuration();
    let mut told = 0;
    let checks = run(Box::new(rig.link()), &configuration, true, |_| told += 1).unwrap();
    assert_eq!(told, count());
    for check in checks {
        assert_eq!(check.outcome, Finding::Pass, "{}", check.name);
    }
    assert!(!rig.shutter_open());
}

#[test]
fn a_rig_with_play_scatter_and_noise_conforms() {
    let config = MechanicsConfig::default();
    let link = Box::new(SimulatedRig::new(&config).link());
    let checks = run(link, &config.configuration(), true, |_| {}).unwrap();
    assert!(checks.iter().all(|check| check.outcome == Finding::Pass), "{checks:?}");
}

#[test]
fn without_the_lamp_the_checks_that_strike_it_are_left_out() {
    let configuration = MechanicsConfig::ideal().configuration();
    let checks = run(Box::new(rig().link()), &configuration, false, |_| {}).unwrap();
    let skipped = checks.iter().filter(|check| matches!(check.outcome, Finding::Skipped(_)));
    assert_eq!(skipped.count(), light::STRIKES.len());
}

#[test]
fn flipped_positions_fail_the_moves() {
    let flip = |packet: &mut ToHost| {
        if let ToHost::Response(response) = packet
            && let Outcome::Done(Answer::At(positions)) = &mut response.outcome
        {
            *positions = positions.map(|steps| -steps);
        }
    };
    let failed = failures(Box::new(Bent::new(rig().link(), |_| {}, flip)));
    assert!(failed.contains(&"moves end exactly at the upper and the lower limits"), "{failed:?}");
    assert!(!failed.contains(&"a hello opens a session and is answered with schema and session"));
}

#[test]
fn a_controller_that_runs_repetitions_again_fails_the_link() {
    let (out, back) = fresh_ids();
    let failed = failures(Box::new(Bent::new(rig().link(), out, back)));
    let expected = "a request repeated after its answer is answered alike and not run again";
    assert!(failed.contains(&expected), "{failed:?}");
}

#[test]
fn a_shutter_that_is_wrong_by_a_thousandth_fails_the_light() {
    let late = |packet: &mut ToHost| {
        if let ToHost::Response(response) = packet
            && let Outcome::Done(Answer::Exposed(exposure)) = &mut response.outcome
        {
            exposure.open_us += exposure.open_us / 1000;
        }
    };
    let failed = failures(Box::new(Bent::new(rig().link(), |_| {}, late)));
    assert_eq!(failed, ["a dark exposure lasts as long as it was asked to, within 10 µs"]);
}

#[test]
fn a_controller_without_limits_fails_the_refusals() {
    let own = MechanicsConfig::ideal().configuration().axes;
    let widen = move |packet: &mut ToController| {
        if let ToController::Request(request) = packet
            && let Command::PrepareAxis { axis, parameters } = &mut request.command
            && *parameters == own[axis.index()]
        {
            parameters.max_steps += 1;
        }
    };
    let failed = failures(Box::new(Bent::new(rig().link(), widen, |_| {})));
    let expected = [
        "parameters are read back as they were set",
        "moves beyond a limit are refused with the axis, and move nothing",
    ];
    assert_eq!(failed, expected);
}

#[test]
fn an_unplugged_controller_is_an_error_and_no_result() {
    let rig = rig();
    rig.unplug();
    let configuration = MechanicsConfig::ideal().configuration();
    let error = run(Box::new(rig.link()), &configuration, true, |_| {}).unwrap_err();
    assert_eq!(error.exit_code(), 1);
}

/// Does at the simulated rig what is asked for, but for one thing that is broken.
struct Hands {
    rig: SimulatedRig,
    acts: Vec<bring_up::Act>,
    broken: Option<bring_up::Act>,
    /// Whether the cut-out in the coil's circuit is open, of which the controller knows nothing.
    cut_out: bool,
}

impl bring_up::Operator for Hands {
    fn act(&mut self, act: bring_up::Act) -> Result<bool> {
        use bring_up::Act;
        self.acts.push(act);
        if self.broken == Some(act) {
            return Ok(true);
        }
        match act {
            Act::PressStop => self.rig.press_emergency_stop(),
            Act::ReleaseStop => self.rig.release_emergency_stop(),
            Act::UnplugSwitch(axis) => self.rig.set_home_switch_wire(axis, true),
            Act::PlugSwitch(axis) => self.rig.set_home_switch_wire(axis, false),
            Act::RaiseAlarm(axis) => self.rig.set_driver_alarm(axis, true),
            Act::LowerAlarm(axis) => self.rig.set_driver_alarm(axis, false),
            Act::UnplugThermostat => self.rig.set_over_temperature(true),
            Act::PlugThermostat => self.rig.set_over_temperature(false),
            Act::UnplugCutOut => self.cut_out = true,
            Act::PlugCutOut => self.cut_out = false,
            Act::SeesDarkInReset => {
                self.rig.reset_controller();
                return Ok(self.rig.lamp_level() == 0.0);
            }
            Act::SeesLight => {
                // Nobody looks and answers within the lamp's lease.
                self.rig.abandon_until_us(self.rig.now_us() + 20_000_000);
                return Ok(self.rig.lamp_level() > 0.0);
            }
            Act::SeesDark => return Ok(self.rig.lamp_level() == 0.0 || self.cut_out),
            _ => {}
        }
        Ok(true)
    }
}

#[test]
fn first_hour_goes_through_with_a_good_rig_and_ends_at_what_the_controller_does_not_see() {
    use bring_up::Act;
    use lobelia_protocol::{Alarm, Axis};
    let mut configuration = MechanicsConfig::ideal().configuration();
    configuration.axes[1].alarm = Alarm::Level;
    let walk = |broken| {
        let rig = rig();
        let mut hands = Hands { rig: rig.clone(), acts: Vec::new(), broken, cut_out: false };
        let outcome = bring_up::run(Box::new(rig.link()), &configuration, &mut hands);
        (outcome.map_err(|error| error.to_string()), hands.acts)
    };
    let (outcome, acts) = walk(None);
    assert_eq!((outcome, acts.last()), (Ok(()), Some(&Act::SeesPulses)));
    let alarms = acts.iter().filter(|act| matches!(act, Act::RaiseAlarm(_)));
    assert_eq!(alarms.collect::<Vec<_>>(), [&Act::RaiseAlarm(Axis::Tilt)], "those that are wired");
    // Each way by which the lamp must go out was tried while it burnt.
    for out in [Act::PressStop, Act::UnplugThermostat, Act::UnplugCutOut] {
        let at = acts.iter().rposition(|act| *act == out).unwrap();
        let lit = acts[..at].iter().rposition(|act| *act == Act::SeesLight).unwrap();
        assert!(!acts[lit..at].contains(&Act::SeesDark), "{out:?}: {acts:?}");
        assert_eq!(acts[at + 1], Act::SeesDark, "{out:?}");
    }
    for (broken, word, last) in [
        (Act::UnplugSwitch(Axis::Roll), "switch", Act::UnplugSwitch(Axis::Roll)),
        (Act::RaiseAlarm(Axis::Tilt), "alarm", Act::RaiseAlarm(Axis::Tilt)),
        (Act::UnplugThermostat, "thermostat", Act::UnplugThermostat),
        (Act::UnplugCutOut, "cut-out", Act::SeesDark),
    ] {
        let (outcome, acts) = walk(Some(broken));
        assert!(outcome.unwrap_err().contains(word), "{broken:?}");
        assert_eq!(acts.last(), Some(&last), "{broken:?}");
    }
}
