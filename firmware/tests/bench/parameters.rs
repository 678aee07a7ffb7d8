//! What the bench's host tells of its rig.

use lobelia_protocol::{Alarm, AxisParameters, Configuration, HomeDirection, KEEP_OUTS, Pins, Settings};

/// Axes of different speeds; home switch at the lower end, at step −1000 of the axis.
pub(crate) fn configuration() -> Configuration {
    let axis = |max_speed, acceleration| AxisParameters {
        min_steps: -900,
        max_steps: 5000,
        max_speed,
        acceleration,
        jerk: 20 * acceleration,
        full_turn_steps: 0,
        take_up_steps: 40,
        settle_ms: 20,
        home_direction: HomeDirection::Negative,
        home_position: -1000,
        home_speed: max_speed / 2,
        home_slow_speed: 50,
        home_back_off: 60,
        home_switch_steps: 500,
        home_order: 0,
        home_travel: 4000,
        home_debounce_us: 2000,
        index_tolerance: 2,
        driver: None,
        inverted: Pins::NONE,
        alarm: Alarm::Edge,
        alarm_debounce_us: 20,
        most_turns: 1,
    };
    Configuration {
        axes: [axis(2000, 4000), axis(1000, 20_000), axis(300, 100), axis(20_000, 50_000)],
        settings: Settings {
            lamp_warm_up_s: 10,
            lamp_least_reading: 300,
            lease_ms: 0,
            lamp_lease_ms: 0,
            lamp_safe_level: 0,
            lamp_longest_s: 172_800,
            fan_run_on_s: 0,
            camera_wait_ms: 50,
            coordinated: true,
            pulse_us: 2,
            direction_setup_us: 5,
            inverted: Pins::NONE,
        },
        keep_outs: [None; KEEP_OUTS],
    }
}
