//! A controller's status as text, in degrees of `rig.toml`.

use std::fmt::Write;

use lobelia_protocol::{Axis, Fault, Health, LampStatus, Status};

use crate::rig::config::RigConfig;

/// Steps of one axis in degrees.
pub fn degrees(config: &RigConfig, axis: Axis, steps: i32) -> f64 {
    f64::from(steps) * config.axes.in_order()[axis.index()].degrees_per_step
}

/// The status, a line for each axis, the lamp, the faults and the controller.
pub fn text(status: &Status, config: &RigConfig) -> String {
    let mut text = String::new();
    // Writing into a string can't fail.
    for axis in Axis::ALL {
        let _ = writeln!(text, "{:<11}{}", axis.name(), axis_line(status, config, axis));
    }
    let _ = writeln!(text, "{:<11}{}", "lamp", lamp(&status.lamp));
    let _ = writeln!(text, "{:<11}{}", "faults", faults(status));
    let _ = writeln!(text, "{:<11}{}", "controller", controller(status));
    text
}

/// How well the controller keeps up, in a line.
pub fn health(health: &Health) -> String {
    let mut text = format!("steps late by {} µs at most", health.worst_late_us);
    if health.longest_poll_us > 0 {
        let _ = write!(text, ", longest turn {} µs", health.longest_poll_us);
    }
    if let Some([used, of]) = health.stack {
        let _ = write!(text, ", stack {used} of {of} bytes");
    }
    if health.overruns > 0 {
        let _ = write!(text, ", {} bytes lost on receipt", health.overruns);
    }
    if let Some(millivolts) = health.supply_mv {
        let _ = write!(text, ", supply {:.2} V", f64::from(millivolts) / 1e3);
    }
    text
}

fn axis_line(status: &Status, config: &RigConfig, axis: Axis) -> String {
    let k = axis.index();
    let mut line = if status.known[k] {
        format!("{:>10.3}°  homed", degrees(config, axis, status.positions[k]))
    } else {
        format!("{:>10}   not homed", "unknown")
    };
    if status.moving[k] {
        line += ", moving";
    }
    if status.at_switch[k] {
        line += ", on its home switch";
    }
    if status.alarms[k] {
        line += ", its driver tells an alarm";
    }
    line
}

fn lamp(lamp: &LampStatus) -> String {
    if !lamp.on {
        return "off".to_owned();
    }
    let level = 100.0 * f64::from(lamp.level) / f64::from(u16::MAX);
    match lamp.warm {
        true => format!("on at {level:.0} %, warm"),
        false => format!("on at {level:.0} %, warm in {} s", lamp.remaining_s),
    }
}

fn faults(status: &Status) -> String {
    let mut names: Vec<_> = status.faults.iter().map(fault_name).collect();
    if status.emergency_stop {
        names.push("(the emergency stop is pressed now)".to_owned());
    }
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// A fault's name in words: `LimitHit` is "limit hit".
pub fn fault_name(fault: Fault) -> String {
    let mut words = String::new();
    for letter in format!("{fault:?}").chars() {
        if letter.is_uppercase() && !words.is_empty() {
            words.push(' ');
        }
        words.extend(letter.to_lowercase());
    }
    words
}

fn controller(status: &Status) -> String {
    let work = match (status.busy, status.waiting) {
        (false, _) => "idle".to_owned(),
        (true, 0) => "busy".to_owned(),
        (true, waiting) => format!("busy, {waiting} waiting"),
    };
    let parameters = if status.configured { "parameters set" } else { "no parameters set" };
    format!("{work}, {parameters}, up for {}", uptime(status.uptime_us))
}

/// A time since switching on, as `2 h 05 min 09 s` without the parts that are zero in front.
fn uptime(us: u64) -> String {
    let seconds = us / 1_000_000;
    let (hours, minutes, rest) = (seconds / 3600, seconds / 60 % 60, seconds % 60);
    if hours > 0 {
        format!("{hours} h {minutes:02} min {rest:02} s")
    } else if minutes > 0 {
        format!("{minutes} min {rest:02} s")
    } else {
        format!("{:.1} s", us as f64 / 1e6)
    }
}

#[cfg(test)]
mod tests {
    use lobelia_protocol::Faults;

    use super::*;

    fn status() -> Status {
        Status {
            positions: [1000, -1000, 0, 50_000],
            known: [true, true, false, true],
            moving: [false, true, false, false],
            at_switch: [false, false, true, false],
            configured: true,
            busy: true,
            waiting: 2,
            lamp: LampStatus { on: true, level: 32768, warm: false, remaining_s: 431 },
            faults: Faults::NONE,
            emergency_stop: false,
            uptime_us: 3_723_400_000,
            alarms: [true, false, false, false],
        }
    }

    #[test]
    fn a_status_is_told_in_degrees_with_what_each_axis_does() {
        let expected = "\
pan            12.900°  homed, its driver tells an alarm
tilt          -12.900°  homed, moving
roll          unknown   not homed, on its home switch
light          80.000°  homed
lamp       on at 50 %, warm in 431 s
faults     none
controller busy, 2 waiting, parameters set, up for 1 h 02 min 03 s
";
        assert_eq!(text(&status(), &RigConfig::default()), expected);
    }

    #[test]
    fn faults_and_a_pressed_stop_are_named() {
        let faults = [Fault::LimitHit, Fault::EmergencyStop].into_iter().collect();
        let told = text(&Status { faults, emergency_stop: true, ..status() }, &RigConfig::default());
        assert!(told.contains("emergency stop, limit hit, (the emergency stop is pressed now)"), "{told}");
    }

    #[test]
    fn health_tells_what_the_board_can_tell() {
        let none = Health { worst_late_us: 12, ..Health::default() };
        assert_eq!(health(&none), "steps late by 12 µs at most");
        let all = Health {
            longest_poll_us: 900,
            stack: Some([9000, 28_672]),
            overruns: 2,
            supply_mv: Some(3312),
            ..none
        };
        let told = "steps late by 12 µs at most, longest turn 900 µs, stack 9000 of 28672 bytes, 2 bytes \
             lost on receipt, supply 3.31 V";
        assert_eq!(health(&all), told);
    }

    #[test]
    fn every_fault_has_a_name_in_words() {
        for fault in Fault::ALL {
            let name = fault_name(fault);
            assert!(name.chars().all(|letter| letter.is_lowercase() || letter == ' '), "{name}");
        }
    }
}
