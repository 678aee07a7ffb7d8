//! The event log: what a controller tells unasked, and what changed between two statuses, each with the
//! controller's time.

use lobelia_protocol::{AXES, Axis, CrashRecord, Event, Happening, LogLine, Status, Telemetry};

use crate::rig::config::RigConfig;
use crate::rig::explain;
use crate::rig::status::{degrees, fault_name, health};
use lobelia_base::progress::counted;

/// A line of the log: controller's time in s, and what happened.
pub fn line(time_us: u64, what: &str) -> String {
    format!("{:>14.6} s  {what}", time_us as f64 / 1e6)
}

/// When an event was told, in the controller's time in µs, if it says so.
pub fn time_us(event: &Event) -> Option<u64> {
    match event {
        Event::Fault(report) => Some(report.at_us),
        Event::Telemetry(telemetry) => Some(telemetry.at_us),
        Event::Log(line) => Some(line.at_us),
        Event::Crashed(_) | Event::Migrated { .. } => None,
    }
}

/// The line of an event that came when the controller's clock was about `now_us` and the positions of some
/// axes were known.
pub fn event(event: &Event, now_us: u64, known: [bool; AXES], config: &RigConfig) -> String {
    let report = match event {
        Event::Fault(report) => report,
        Event::Telemetry(telemetry) => {
            return line(telemetry.at_us, &self::telemetry(telemetry, known, config));
        }
        Event::Log(LogLine { at_us, what }) => return line(*at_us, &happening(what)),
        Event::Crashed(CrashRecord { cause, place }) => {
            let what = format!("the controller had crashed before it was started: {cause:?} at {place:#x}");
            return line(now_us, &what);
        }
        Event::Migrated { from } => {
            let what = format!(
                "the controller's parameters were saved by an older program ({from:08x}), so new ones have \
                 their defaults; look at them with `lobelia rig params` and save them anew"
            );
            return line(now_us, &what);
        }
    };
    let of = report.axis.map_or(String::new(), |axis| format!(" ({})", axis.name()));
    let what = format!("fault: {}{of}: {}", fault_name(report.fault), explain::fault_report(report));
    line(report.at_us, &what)
}

fn telemetry(telemetry: &Telemetry, known: [bool; AXES], config: &RigConfig) -> String {
    let mut text = String::new();
    for axis in Axis::ALL {
        let place = degrees(config, axis, telemetry.positions[axis.index()]);
        let place = if known[axis.index()] { format!("{place:.3}°") } else { "not homed".to_owned() };
        text += &format!("{} {place} ", axis.name());
    }
    let reading = telemetry.photodiode.map_or("-".to_owned(), |counts| counts.to_string());
    text += &format!("photodiode {reading}, frames {}", telemetry.frames);
    if telemetry.bad_frames > 0 {
        text += &format!(", damaged {}", telemetry.bad_frames);
    }
    if telemetry.dropped > 0 {
        text += &format!(", events left out {}", telemetry.dropped);
    }
    text + ", " + &health(&telemetry.health)
}

fn happening(what: &Happening) -> String {
    match what {
        Happening::Began { id } => format!("request {id} begun"),
        Happening::Ended { id, done: true } => format!("request {id} done"),
        Happening::Ended { id, done: false } => format!("request {id} refused or given up"),
        Happening::Lamp { on: true, level } => {
            format!("lamp set to {:.1} %", 100.0 * f64::from(*level) / f64::from(u16::MAX))
        }
        Happening::Lamp { on: false, .. } => "lamp set off".to_owned(),
        Happening::FaultsCleared => "faults cleared".to_owned(),
        Happening::BadFrames { count } => {
            format!("{} came damaged since the start", counted(*count, "frame", "frames"))
        }
        Happening::Dropped { count } => {
            let were = if *count == 1 { "log line was" } else { "log lines were" };
            format!("{count} {were} left out here")
        }
    }
}

/// The lines of what changed from one status to the next, at the time of the next.
pub fn changes(before: &Status, after: &Status, config: &RigConfig) -> Vec<String> {
    let mut lines = Vec::new();
    let mut note = |what: String| lines.push(line(after.uptime_us, &what));
    if after.uptime_us < before.uptime_us {
        note("the controller was restarted".to_owned());
    }
    for axis in Axis::ALL {
        let (k, name) = (axis.index(), axis.name());
        let place = degrees(config, axis, after.positions[k]);
        match (before.known[k], after.known[k]) {
            (false, true) => note(format!("{name} homed, at {place:.3}°")),
            (true, false) => note(format!("{name} is no longer known")),
            _ => {}
        }
        match (before.moving[k], after.moving[k]) {
            (false, true) => note(format!("{name} began to move")),
            (true, false) if !after.known[k] => note(format!("{name} at rest, not homed")),
            (true, false) => note(format!("{name} at rest at {place:.3}°")),
            (false, false)
                if before.known[k] && after.known[k] && before.positions[k] != after.positions[k] =>
            {
                note(format!("{name} moved to {place:.3}°"));
            }
            _ => {}
        }
    }
    match (before.lamp.on, after.lamp.on) {
        (false, true) => note(format!("lamp switched on, warm in {} s", after.lamp.remaining_s)),
        (true, false) => note("lamp switched off".to_owned()),
        (true, true) if after.lamp.warm && !before.lamp.warm => note("lamp warm".to_owned()),
        _ => {}
    }
    match (before.emergency_stop, after.emergency_stop) {
        (false, true) => note("emergency stop pressed".to_owned()),
        (true, false) => note("emergency stop released".to_owned()),
        _ => {}
    }
    for fault in before.faults.iter().filter(|fault| !after.faults.contains(*fault)) {
        note(format!("cleared: {}", fault_name(fault)));
    }
    lines
}

#[cfg(test)]
mod tests {
    use lobelia_protocol::{Fault, FaultReport, Faults, LampStatus};

    use super::*;

    fn idle() -> Status {
        Status {
            positions: [0; 4],
            known: [true; 4],
            moving: [false; 4],
            at_switch: [false; 4],
            configured: true,
            busy: false,
            waiting: 0,
            lamp: LampStatus::default(),
            faults: Faults::NONE,
            emergency_stop: false,
            uptime_us: 1_500_000,
            alarms: [false; 4],
        }
    }

    #[test]
    fn nothing_is_logged_while_nothing_happens() {
        let later = Status { uptime_us: 9_000_000, ..idle() };
        assert_eq!(changes(&idle(), &later, &RigConfig::default()), Vec::<String>::new());
    }

    #[test]
    fn changes_are_logged_at_the_controllers_time() {
        let mut later = Status { uptime_us: 2_000_000, positions: [1000, 0, 0, 0], ..idle() };
        later.known[2] = false;
        later.lamp = LampStatus { on: true, level: 65535, warm: false, remaining_s: 900 };
        let lines = changes(&idle(), &later, &RigConfig::default());
        let expected = ["pan moved to 12.900°", "roll is no longer known", "lamp switched on, warm in 900 s"];
        assert_eq!(lines, expected.map(|what| line(2_000_000, what)));
        assert_eq!(lines[0], "      2.000000 s  pan moved to 12.900°");
    }

    #[test]
    fn an_axis_that_is_not_homed_shows_no_angle() {
        let telemetry = Telemetry { positions: [1000; 4], ..Telemetry::default() };
        let known = [true, false, true, true];
        let told = event(&Event::Telemetry(telemetry), 0, known, &RigConfig::default());
        assert!(told.contains("pan 12.900° tilt not homed roll 12.900°"), "{told}");
        let mut moving = idle();
        (moving.moving[1], moving.known[1]) = (true, false);
        let rest = Status { moving: [false; 4], ..moving };
        let lines = changes(&moving, &rest, &RigConfig::default());
        assert_eq!(lines, [line(rest.uptime_us, "tilt at rest, not homed")]);
    }

    #[test]
    fn a_fault_is_one_line_with_its_own_time_and_axis() {
        let report = FaultReport { fault: Fault::LimitHit, axis: Some(Axis::Tilt), at_us: 12_345_678 };
        let told = event(&Event::Fault(report), 0, [true; AXES], &RigConfig::default());
        assert!(told.starts_with("     12.345678 s  fault: limit hit (tilt): the tilt axis"), "{told}");
        assert_eq!(told.lines().count(), 1);
    }
}
