//! What the controller is told: its parameters as a table, and which of them it has otherwise.

use std::fmt;

use lobelia_protocol::{Axis, AxisParameters, Configuration, DriverParameters, KeepOut, Pin, Pins, Settings};

/// A parameter that the controller has otherwise.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    /// Name, that of its axis before it.
    pub name: String,
    /// Unit; empty where it has none.
    pub unit: &'static str,
    /// Value here.
    pub ours: String,
    /// Value in the controller.
    pub theirs: String,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, unit, ours, theirs } = self;
        write!(f, "{name} is {theirs} {unit} in the controller, {ours} here")
    }
}

/// The parameters that the controller has otherwise.
pub fn differences(ours: &Configuration, theirs: &Configuration) -> Vec<Difference> {
    let mut differences = Vec::new();
    let mut compare = |name: String, unit: &'static str, ours: String, theirs: String| {
        if ours != theirs {
            differences.push(Difference { name, unit, ours, theirs });
        }
    };
    for axis in Axis::ALL {
        let [ours, theirs] = [ours, theirs].map(|all| &all.axes[axis.index()]);
        for (name, unit, number) in ROWS {
            let name = format!("{} {name}", axis.name());
            compare(name, unit, number(ours).to_string(), number(theirs).to_string());
        }
        compare(
            format!("{} home_direction", axis.name()),
            "end",
            format!("{:?}", ours.home_direction),
            format!("{:?}", theirs.home_direction),
        );
        let alarm = |axis: &AxisParameters| format!("{:?}", axis.alarm);
        compare(format!("{} alarm", axis.name()), "", alarm(ours), alarm(theirs));
        compare(format!("{} inverted", axis.name()), "", pins(ours.inverted), pins(theirs.inverted));
        for (name, unit, number) in DRIVER_ROWS {
            let of = |axis: &AxisParameters| number_of_driver(axis, number);
            compare(format!("{} driver {name}", axis.name()), unit, of(ours), of(theirs));
        }
    }
    for (ours, theirs) in ours.keep_outs.into_iter().zip(theirs.keep_outs) {
        compare("keep_out".to_owned(), "", keep_out(ours), keep_out(theirs));
    }
    for (ours, theirs) in settings(&ours.settings).into_iter().zip(settings(&theirs.settings)) {
        compare(ours.0.to_owned(), ours.1, ours.2, theirs.2);
    }
    differences
}

/// Names of pins.
fn pins(pins: Pins) -> String {
    let names: Vec<_> =
        Pin::ALL.into_iter().filter(|&pin| pins.contains(pin)).map(|pin| format!("{pin:?}")).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(" ") }
}

/// A keep-out in words.
fn keep_out(keep_out: Option<KeepOut>) -> String {
    keep_out.map_or("none".to_owned(), |k| {
        let part = |axis: Axis, [from, to]: [i32; 2]| format!("{} {from} to {to}", axis.name());
        format!("{} with {}", part(k.first, k.first_steps), part(k.second, k.second_steps))
    })
}

/// A row: what it is, its unit, and the number of an axis.
type Row = (&'static str, &'static str, fn(&AxisParameters) -> i64);

/// What the controller is told of each axis.
const ROWS: [Row; 19] = [
    ("min", "steps", |axis| axis.min_steps.into()),
    ("max", "steps", |axis| axis.max_steps.into()),
    ("max_speed", "steps/s", |axis| axis.max_speed.into()),
    ("acceleration", "steps/s²", |axis| axis.acceleration.into()),
    ("jerk", "steps/s³", |axis| axis.jerk.into()),
    ("full_turn", "steps", |axis| axis.full_turn_steps.into()),
    ("take_up", "steps", |axis| axis.take_up_steps.into()),
    ("settle", "ms", |axis| axis.settle_ms.into()),
    ("home_position", "steps", |axis| axis.home_position.into()),
    ("home_speed", "steps/s", |axis| axis.home_speed.into()),
    ("home_slow_speed", "steps/s", |axis| axis.home_slow_speed.into()),
    ("home_back_off", "steps", |axis| axis.home_back_off.into()),
    ("home_switch", "steps", |axis| axis.home_switch_steps.into()),
    ("home_order", "", |axis| axis.home_order.into()),
    ("home_travel", "steps", |axis| axis.home_travel.into()),
    ("home_debounce", "µs", |axis| axis.home_debounce_us.into()),
    ("index_tolerance", "steps", |axis| axis.index_tolerance.into()),
    ("alarm_debounce", "µs", |axis| axis.alarm_debounce_us.into()),
    ("most_turns", "turns", |axis| axis.most_turns.into()),
];

/// A driver's parameter: its name, its unit and its value.
type DriverRow = (&'static str, &'static str, fn(&DriverParameters) -> u32);

/// What the controller is told of drivers.
const DRIVER_ROWS: [DriverRow; 6] = [
    ("run", "mA", |driver| driver.run_ma.into()),
    ("hold", "mA", |driver| driver.hold_ma.into()),
    ("sense", "mOhm", |driver| driver.sense_mohm.into()),
    ("microsteps", "", |driver| driver.microsteps.into()),
    ("stall_threshold", "", |driver| driver.stall_threshold.into()),
    ("stall_above", "steps/s", |driver| driver.stall_above_speed),
];

/// A parameter of the driver of an axis; a dash without one.
fn number_of_driver(axis: &AxisParameters, number: fn(&DriverParameters) -> u32) -> String {
    axis.driver.as_ref().map_or("-".to_owned(), |driver| number(driver).to_string())
}

/// The parameters as a table, an axis a column.
pub fn table(configuration: &Configuration) -> String {
    let mut text = format!("{:<18}{:<10}", "parameter", "unit");
    for axis in Axis::ALL {
        text += &format!("{:>10}", axis.name());
    }
    for (name, unit, number) in ROWS {
        text += &format!("\n{name:<18}{unit:<10}");
        for axis in &configuration.axes {
            text += &format!("{:>10}", number(axis));
        }
    }
    if configuration.axes.iter().any(|axis| axis.driver.is_some()) {
        for (name, unit, number) in DRIVER_ROWS {
            text += &format!("\n{name:<18}{unit:<10}");
            for axis in &configuration.axes {
                text += &format!("{:>10}", number_of_driver(axis, number));
            }
        }
    }
    for axis in Axis::ALL {
        let p = &configuration.axes[axis.index()];
        text += &format!("\n{:<6}alarm {:?}, inverted {}", axis.name(), p.alarm, pins(p.inverted));
    }
    for k in configuration.keep_outs.into_iter().filter(Option::is_some) {
        text += &format!("\n{:<18}{:<10} {}", "keep_out", "steps", keep_out(k));
    }
    for (name, unit, value) in settings(&configuration.settings) {
        text += &format!("\n{name:<19}{unit:<9}{value:>10}");
    }
    text + "\n"
}

/// What the controller is told besides: name, unit and value.
fn settings(settings: &Settings) -> [(&'static str, &'static str, String); 12] {
    [
        ("lamp_warm_up", "s", settings.lamp_warm_up_s.to_string()),
        ("lamp_least_reading", "counts", settings.lamp_least_reading.to_string()),
        ("lease", "ms", settings.lease_ms.to_string()),
        ("lamp_lease", "ms", settings.lamp_lease_ms.to_string()),
        ("lamp_safe_level", "of 65535", settings.lamp_safe_level.to_string()),
        ("lamp_longest", "s", settings.lamp_longest_s.to_string()),
        ("fan_run_on", "s", settings.fan_run_on_s.to_string()),
        ("camera_wait", "ms", settings.camera_wait_ms.to_string()),
        ("coordinated", "", settings.coordinated.to_string()),
        ("pulse", "µs", settings.pulse_us.to_string()),
        ("direction_setup", "µs", settings.direction_setup_us.to_string()),
        ("inverted", "", pins(settings.inverted)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::config::RigConfig;

    #[test]
    fn parameters_that_the_controller_has_otherwise_are_named_with_both_values() {
        let ours = RigConfig::default().configuration().unwrap();
        let mut theirs = ours;
        theirs.axes[1].max_speed = 7;
        theirs.settings.lease_ms = 1;
        let expected = [
            "tilt max_speed is 7 steps/s in the controller, 4651 here",
            "lease is 1 ms in the controller, 2000 here",
        ];
        let lines = |theirs| -> Vec<String> {
            differences(&ours, theirs).iter().map(Difference::to_string).collect()
        };
        assert_eq!(lines(&theirs), expected);
        assert!(lines(&ours).is_empty());
    }

    #[test]
    fn a_driver_s_current_is_a_parameter_too() {
        let driver = DriverParameters {
            run_ma: 800,
            hold_ma: 400,
            sense_mohm: 110,
            microsteps: 16,
            stall_threshold: 10,
            stall_above_speed: 500,
        };
        let mut ours = RigConfig::default().configuration().unwrap();
        ours.axes[2].driver = Some(driver);
        let mut theirs = ours;
        theirs.axes[2].driver = Some(DriverParameters { run_ma: driver.run_ma + 50, ..driver });
        let found = differences(&ours, &theirs);
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(found[0].name.ends_with("driver run") && found[0].unit == "mA", "{found:?}");
    }
}
