//! Exposures, the lamp, heat and the camera.
#![allow(clippy::unwrap_used)]

mod bench;

use bench::devices::ShutterTimer;
use bench::{Rig, SESSION, configuration, refusal};
use lobelia_protocol::{
    Answer, Command, Fault, Field, Hello, LAMP_LONGEST_S, Outcome, Refusal, ToController,
};

#[test]
fn exposure_opens_for_its_time_once_the_lamp_is_warm() {
    let mut rig = Rig::homed();
    rig.ask(Command::Lamp { on: true, level: 65535 });
    let expose = Command::Expose { duration_us: 488, warm_lamp: true };
    assert_eq!(refusal(rig.ask(expose)), Refusal::LampNotWarm { remaining_s: Some(10) });
    rig.bench.borrow_mut().now_us += 10_000_000;
    rig.bench.borrow_mut().shutter.clear();
    let Outcome::Done(Answer::Exposed(exposure)) = rig.ask(expose) else { panic!("no exposure") };
    assert_eq!((exposure.open_us, exposure.reference_q8, exposure.readings), (488, 1234 * 256, 16));
    let start = exposure.start_us;
    assert_eq!(rig.bench.borrow().shutter, [(start, true), (start + 488, false)]);
}

/// A lamp that the lease has dimmed, say, glows as long as one likes and is still cold for full level.
#[test]
fn lamp_raised_from_a_lower_level_warms_up_anew_and_one_set_to_the_same_level_does_not() {
    let mut rig = Rig::homed();
    rig.ask(Command::Lamp { on: true, level: 16384 });
    rig.bench.borrow_mut().now_us += 20_000_000;
    let remaining = |rig: &mut Rig, level: u16| {
        rig.ask(Command::Lamp { on: true, level });
        let Outcome::Done(Answer::Status(status)) = rig.ask(Command::Status) else { panic!("no status") };
        (status.lamp.warm, status.lamp.remaining_s)
    };
    assert_eq!(remaining(&mut rig, 16384), (true, 0));
    assert_eq!(remaining(&mut rig, 65535), (false, 10));
    rig.bench.borrow_mut().now_us += 4_000_000;
    assert_eq!(remaining(&mut rig, 65535), (false, 6));
    rig.bench.borrow_mut().now_us += 6_000_000;
    assert_eq!(remaining(&mut rig, 65535), (true, 0));
    assert_eq!(remaining(&mut rig, 30000), (true, 0));
}

/// A rig whose lamp is warm.
fn lit() -> Rig {
    rig_lit(Rig::homed())
}

fn rig_lit(mut rig: Rig) -> Rig {
    rig.ask(Command::Lamp { on: true, level: 65535 });
    rig.bench.borrow_mut().now_us += 10_000_000;
    rig
}

const EXPOSE: Command = Command::Expose { duration_us: 32_000, warm_lamp: true };

#[test]
fn flicker_is_the_deviation_of_the_readings_over_their_mean() {
    let mut rig = lit();
    for (readings, mean, ppm) in [(vec![1000u16, 1200, 800, 1000], 1000, 141_421), (vec![65535], 65535, 0)] {
        rig.bench.borrow_mut().readings = readings.into();
        let Outcome::Done(Answer::Exposed(exposure)) = rig.ask(EXPOSE) else { panic!("no exposure") };
        assert_eq!((exposure.reference_q8, exposure.readings, exposure.flicker_ppm), (mean * 256, 32, ppm));
    }
}

#[test]
fn lamp_that_stays_dark_is_a_fault_unless_the_frame_is_meant_to_be() {
    let mut rig = lit();
    rig.bench.borrow_mut().readings = [299].into();
    assert!(matches!(rig.ask(Command::Expose { duration_us: 500, warm_lamp: false }), Outcome::Done(_)));
    assert!(
        matches!(refusal(rig.ask(EXPOSE)), Refusal::Faulted(faults) if faults.contains(Fault::LampFailure))
    );
    assert!(!rig.bench.borrow().shutter.last().unwrap().1);
}

#[test]
fn over_temperature_puts_the_lamp_out_stops_everything_and_drops_no_arm() {
    let mut rig = lit();
    let id = rig.begin(EXPOSE);
    rig.bench.borrow_mut().hot = true;
    assert!(matches!(refusal(rig.outcome(id)), Refusal::Faulted(faults)
            if faults.contains(Fault::OverTemperature)));
    assert_eq!((rig.bench.borrow().lamp, rig.bench.borrow().enabled), (false, [true; 4]));
    // Cleared while it is still hot, it comes again.
    rig.ask(Command::ClearFaults);
    rig.poll();
    assert!(matches!(refusal(rig.ask(Command::Home)), Refusal::Faulted(_)));
    rig.bench.borrow_mut().hot = false;
    rig.ask(Command::ClearFaults);
    assert!(matches!(rig.ask(Command::Home), Outcome::Done(_)));
}

#[test]
fn exposure_waits_for_the_camera_but_not_for_ever() {
    let mut rig = lit();
    let now = rig.bench.borrow().now_us;
    rig.bench.borrow_mut().camera_ready_us = now + 30_000;
    let Outcome::Done(Answer::Exposed(exposure)) = rig.ask(EXPOSE) else { panic!("no exposure") };
    assert!((30_000..=31_000).contains(&(exposure.start_us - now)));
    rig.bench.borrow_mut().camera_ready_us = u64::MAX;
    let before = rig.bench.borrow().shutter.len();
    assert_eq!(refusal(rig.ask(EXPOSE)), Refusal::CameraNotReady);
    assert_eq!(rig.bench.borrow().shutter.len(), before);
}

#[test]
fn exposure_is_within_ten_microseconds_of_its_time_or_refused() {
    for late_us in [0, 10, 11, 5000] {
        let mut rig = lit();
        let edges = rig.bench.borrow().shutter.len();
        let id = rig.begin(EXPOSE);
        while rig.bench.borrow().shutter.len() == edges {
            rig.pass_event();
        }
        let open_us = rig.bench.borrow().now_us;
        while rig.next_event_us() < open_us + 32_000 {
            rig.pass_event();
        }
        rig.bench.borrow_mut().now_us = open_us + 32_000 + late_us;
        match rig.outcome(id) {
            Outcome::Done(Answer::Exposed(exposure)) => {
                assert!(late_us <= 10);
                assert_eq!(u64::from(exposure.open_us), 32_000 + late_us);
            }
            outcome => {
                assert!(late_us > 10);
                assert_eq!(refusal(outcome), Refusal::ShutterLate { late_us: late_us as u32 });
            }
        }
    }
}

#[test]
fn lamp_without_parameters_is_refused_since_nothing_would_put_it_out() {
    let mut rig = Rig::new();
    rig.send(&ToController::Hello(Hello::new(SESSION)));
    assert_eq!(refusal(rig.ask(Command::Lamp { on: true, level: 65535 })), Refusal::NotConfigured);
    assert!(!rig.bench.borrow().lamp);
    assert!(matches!(rig.ask(Command::Lamp { on: false, level: 0 }), Outcome::Done(_)));
}

#[test]
fn lamp_goes_out_when_it_has_burnt_for_its_longest_time_whatever_the_host_says() {
    let mut limited = configuration();
    limited.settings.lamp_longest_s = 3600;
    // No lease, and a safe level that would burn on.
    limited.settings.lamp_safe_level = 20_000;
    let mut rig = Rig::greeted(limited);
    rig.ask(Command::Lamp { on: true, level: 30_000 });
    for minute in 1..60 {
        rig.bench.borrow_mut().now_us += 60_000_000;
        // Another level is no new beginning.
        rig.ask(Command::Lamp { on: true, level: 30_000 + minute });
        assert!(rig.bench.borrow().lamp, "minute {minute}");
    }
    let due_us = rig.next_event_us();
    rig.bench.borrow_mut().now_us = due_us;
    rig.poll();
    assert_eq!((rig.bench.borrow().lamp, rig.bench.borrow().lamp_level), (false, 0));
    let Outcome::Done(Answer::Status(status)) = rig.ask(Command::Status) else { panic!("no status") };
    assert!(status.faults.contains(Fault::LampTimeout));
    rig.ask(Command::ClearFaults);
    let field = Refusal::BadParameter { axis: None, field: Field::LampTime };
    for unlimited in [0, LAMP_LONGEST_S.end() + 1, u32::MAX] {
        limited.settings.lamp_longest_s = unlimited;
        assert_eq!(refusal(rig.configure(limited)), field, "{unlimited} s");
    }
}

#[test]
fn lamp_does_not_warm_up_at_level_zero() {
    let mut rig = Rig::homed();
    rig.ask(Command::Lamp { on: true, level: 0 });
    rig.bench.borrow_mut().now_us += 20_000_000;
    let Outcome::Done(Answer::Status(status)) = rig.ask(Command::Status) else { panic!("no status") };
    assert_eq!((status.lamp.on, status.lamp.warm, status.lamp.remaining_s), (true, false, 10));
    rig.ask(Command::Lamp { on: true, level: 65535 });
    let Outcome::Done(Answer::Status(status)) = rig.ask(Command::Status) else { panic!("no status") };
    assert_eq!((status.lamp.warm, status.lamp.remaining_s), (false, 10));
}

#[test]
fn fan_runs_while_the_lamp_burns_and_for_its_time_after_that() {
    let mut cooled = configuration();
    cooled.settings.fan_run_on_s = 300;
    let mut rig = Rig::greeted(cooled);
    assert!(!rig.bench.borrow().fan);
    rig.ask(Command::Lamp { on: true, level: 65535 });
    assert!(rig.bench.borrow().fan);
    rig.ask(Command::Lamp { on: false, level: 0 });
    let out_us = rig.bench.borrow().now_us;
    assert!(rig.bench.borrow().fan);
    while rig.pass_event() {}
    assert_eq!((rig.bench.borrow().fan, rig.bench.borrow().now_us), (false, out_us + 300_000_000));
}

/// A lit rig whose board has a timer for the shutter and a converter that reads by itself, and whose lamp's
/// dimmer shows.
fn equipped() -> Rig {
    let rig = Rig::with_options(|options| options.timed_shutter = Some(Box::leak(Box::new(ShutterTimer))));
    rig.bench.borrow_mut().devices.reads_by_itself = true;
    rig.bench.borrow_mut().devices.ripple_percent = 20;
    let rig = rig_lit(rig.ready(configuration()).at_home());
    rig.bench.borrow_mut().devices.timed_us = None;
    rig
}

#[test]
fn converter_that_reads_by_itself_sees_the_dimmer_at_all_its_phases_over_just_the_open_time() {
    let mut rig = equipped();
    for duration_us in [500, 32_000, 250_000] {
        let Outcome::Done(Answer::Exposed(exposure)) =
            rig.ask(Command::Expose { duration_us, warm_lamp: true })
        else {
            panic!("no exposure")
        };
        // A reading each 4.571 µs, of 800 and 1200 in turn: a fifth of the mean.
        assert!(exposure.readings.abs_diff(duration_us * 1000 / 4571) <= 1, "{exposure:?}");
        assert!((exposure.reference_q8 / 256).abs_diff(1000) <= 10, "{exposure:?}");
        assert!(exposure.flicker_ppm.abs_diff(200_000) < 3000, "{exposure:?}");
    }
}

#[test]
fn lamp_read_at_each_millisecond_shows_no_flicker_of_a_dimmer_of_the_same_crystal() {
    // What the other way of reading is for: 1 ms is a whole number of the dimmer's periods.
    let mut rig = lit();
    let start_ns = 1_000_000_000;
    let readings =
        (0..32u64).map(|k| rig.bench.borrow().devices.light(start_ns + 500_000 + k * 1_000_000)).collect();
    rig.bench.borrow_mut().readings = readings;
    let Outcome::Done(Answer::Exposed(exposure)) = rig.ask(EXPOSE) else { panic!("no exposure") };
    assert_eq!((exposure.readings, exposure.flicker_ppm), (32, 0));
}

#[test]
fn timer_closes_the_shutter_to_the_tick_however_late_the_polls_are() {
    for late_us in [0, 11, 5000, 30_000] {
        let mut rig = equipped();
        let id = rig.begin(EXPOSE);
        while rig.bench.borrow().devices.timed_us.is_none() {
            rig.pass_event();
        }
        let (from_us, until_us) = rig.bench.borrow().devices.timed_us.unwrap();
        rig.bench.borrow_mut().now_us = until_us + late_us;
        let Outcome::Done(Answer::Exposed(exposure)) = rig.outcome(id) else {
            panic!("{late_us} µs late: no exposure")
        };
        assert_eq!((exposure.start_us, exposure.open_us), (from_us, 32_000));
        assert_eq!(rig.bench.borrow().devices.timed_us, Some((from_us, from_us + 32_000)));
        assert_eq!(rig.bench.borrow().shutter, [], "the timer's pin is no other's");
    }
}

#[test]
fn timer_that_did_not_close_the_shutter_is_told_and_the_shutter_closed() {
    let mut rig = equipped();
    let id = rig.begin(EXPOSE);
    rig.bench.borrow_mut().devices.jammed = true;
    while rig.bench.borrow().devices.timed_us.is_none() {
        rig.pass_event();
    }
    let (_, until_us) = rig.bench.borrow().devices.timed_us.unwrap();
    rig.bench.borrow_mut().now_us = until_us + 700;
    assert_eq!(refusal(rig.outcome(id)), Refusal::ShutterLate { late_us: 700 });
    assert!(!rig.bench.borrow().devices.jammed);
}

#[test]
fn stop_closes_a_timed_shutter_at_once() {
    let mut rig = equipped();
    let id = rig.begin(EXPOSE);
    while rig.bench.borrow().devices.timed_us.is_none() {
        rig.pass_event();
    }
    rig.pass_event();
    rig.bench.borrow_mut().stop_pressed = true;
    let pressed_us = rig.bench.borrow().now_us;
    rig.poll();
    assert!(matches!(refusal(rig.outcome(id)), Refusal::Faulted(_)));
    assert_eq!(rig.bench.borrow().devices.timed_us.unwrap().1, pressed_us);
}

#[test]
fn lease_does_not_end_while_the_shutter_is_open_but_after_it() {
    let mut leased = configuration();
    (leased.settings.lease_ms, leased.settings.lamp_lease_ms) = (20_000, 20_000);
    let mut rig = Rig::greeted(leased).at_home();
    rig.ask(Command::Lamp { on: true, level: 30_000 });
    let id = rig.begin(Command::Expose { duration_us: 50_000_000, warm_lamp: false });
    // Nobody says a word: not to disturb it.
    let outcome = rig.outcome(id);
    assert!(matches!(outcome, Outcome::Done(_)), "{outcome:?}");
    let closed_us = rig.bench.borrow().shutter.last().unwrap().0;
    assert!(rig.bench.borrow().lamp);
    while rig.bench.borrow().lamp {
        assert!(rig.pass_event());
    }
    assert_eq!(rig.bench.borrow().now_us, closed_us + 20_000_000);
}
