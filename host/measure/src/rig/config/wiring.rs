//! How the rig is wired, where that is otherwise than the controller's table of pins says; and what an older
//! file leaves unsaid.

use lobelia_protocol::{Alarm, Pin, Pins};
use serde::{Deserialize, Serialize};

use super::{AXIS_NAMES, Axis, RigConfig};

/// `[wiring]`: of pins that are no axis's.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Wiring {
    /// Those that are inverted: `lamp`, `shutter` (the camera's trigger), `fan`, `over-temperature`,
    /// `camera-ready`.
    pub invert: Vec<Pin>,
}

impl Axis {
    /// What its alarm input means: what the file says, or else a stall where its driver is told to look for
    /// one.
    pub fn alarm(&self) -> Alarm {
        let stalls = self.driver.as_ref().is_some_and(|driver| driver.stall_threshold > 0);
        self.alarm.unwrap_or(if stalls { Alarm::Edge } else { Alarm::None })
    }
}

/// The first pin that does not belong to those that may be named, with those that may.
pub(super) fn stranger(invert: &[Pin], own: Pins) -> Result<(), String> {
    let name = |pin: &Pin| toml::Value::try_from(pin).map_or(String::new(), |name| name.to_string());
    match invert.iter().find(|pin| !own.contains(**pin)) {
        None => Ok(()),
        Some(pin) => {
            let known: Vec<_> = Pin::ALL.iter().filter(|pin| own.contains(**pin)).map(name).collect();
            Err(format!("has {}, may have {}", name(pin), known.join(", ")))
        }
    }
}

/// Tables whose keys concern safety: what a file leaves out of them is told.
const TOLD: [&str; 3] = ["motion", "lamp", "wiring"];

/// What a file of a whole rig, with its axes, leaves to the defaults, as the keys would stand there; nothing
/// when it says all.
pub(super) fn unsaid(file: &toml::Table, rig: &RigConfig) -> Option<String> {
    let axes = file.get("axes")?.as_table()?;
    let mut rig = rig.clone();
    let mut keys = Vec::new();
    for axis in [&mut rig.axes.pan, &mut rig.axes.tilt, &mut rig.axes.roll, &mut rig.axes.light] {
        axis.alarm = Some(axis.alarm());
    }
    let whole = toml::Table::try_from(&rig).ok()?;
    let table = |of: &toml::Table, name: &str| {
        of.get(name).and_then(toml::Value::as_table).cloned().unwrap_or_default()
    };
    let all_axes = table(&whole, "axes");
    for name in AXIS_NAMES.iter().filter(|name| axes.contains_key(**name)) {
        let said = table(axes, name);
        let left = table(&all_axes, name)
            .into_iter()
            .filter(|(key, value)| !said.contains_key(key) && !value.is_table());
        keys.extend(left.map(|(key, value)| (format!("axes.{name}.{key}"), value)));
    }
    for name in TOLD {
        let said = table(file, name);
        let left = table(&whole, name).into_iter().filter(|(key, _)| !said.contains_key(key));
        keys.extend(left.map(|(key, value)| (format!("{name}.{key}"), value)));
    }
    let text: Vec<_> = keys.iter().map(|(key, value)| format!("{key} = {value}")).collect();
    (!text.is_empty()).then(|| text.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::config::Driver;

    fn parse(text: &str) -> RigConfig {
        toml::from_str(text).unwrap()
    }

    #[test]
    fn inverted_pins_and_alarms_reach_the_controller() {
        let text = toml::to_string(&RigConfig::default()).unwrap();
        let text = text.replacen("invert = []", "invert = [\"home\", \"enable\"]", 1);
        let text = text.replacen("alarm = \"none\"", "alarm = \"level\"", 1);
        let text =
            text.replace("[wiring]\ninvert = []", "[wiring]\ninvert = [\"lamp\", \"over-temperature\"]");
        let rig = parse(&text);
        rig.validate().unwrap();
        let configuration = rig.configuration().unwrap();
        let [pan, tilt, ..] = configuration.axes;
        assert_eq!(pan.inverted, [Pin::Home, Pin::Enable].into_iter().collect());
        assert_eq!((pan.alarm, tilt.alarm, tilt.inverted), (Alarm::Level, Alarm::None, Pins::NONE));
        assert_eq!(configuration.settings.inverted, [Pin::Lamp, Pin::OverTemperature].into_iter().collect());
    }

    #[test]
    fn pins_of_somebody_else_are_refused_with_those_that_may_be_named() {
        let mut rig = RigConfig::default();
        rig.axes.roll.invert = vec![Pin::Step, Pin::Lamp];
        let why = rig.validate().unwrap_err().to_string();
        assert!(
            why.contains("axes.roll.invert has \"lamp\"") && why.contains("\"home\", \"alarm\""),
            "{why}"
        );
        let mut rig = RigConfig::default();
        rig.wiring.invert = vec![Pin::Home];
        assert!(rig.validate().unwrap_err().to_string().contains("wiring.invert has \"home\""));
    }

    #[test]
    fn file_from_before_there_was_wiring_is_read_and_what_it_leaves_out_is_told() {
        let today = toml::to_string(&RigConfig::default()).unwrap();
        let told = |text: &str| unsaid(&toml::from_str(text).unwrap(), &parse(text));
        assert_eq!(told(&today), None);
        let new = ["invert = ", "alarm = ", "alarm_debounce_us = ", "[wiring]", "fan_run_on_s = "];
        let older: String = today
            .lines()
            .filter(|line| !new.iter().any(|key| line.starts_with(key)))
            .map(|line| format!("{line}\n"))
            .collect();
        assert_eq!(parse(&older).configuration().unwrap(), RigConfig::default().configuration().unwrap());
        let text = told(&older).unwrap();
        for key in [
            "axes.pan.alarm = \"none\"",
            "axes.light.invert = []",
            "wiring.invert = []",
            "lamp.fan_run_on_s = 300.0",
        ] {
            assert!(text.contains(key), "{key} is not in {text}");
        }
        assert_eq!(told("[camera]\nwidth = 640\n"), None, "no file of a whole rig");
    }

    #[test]
    fn driver_that_looks_for_stalls_has_its_output_heeded_unless_the_file_says_otherwise() {
        let mut axis = RigConfig::default().axes.pan;
        (axis.alarm, axis.driver) = (None, Some(Driver::default()));
        assert_eq!(axis.alarm(), Alarm::None);
        axis.driver = Some(Driver { stall_threshold: 60, ..Driver::default() });
        assert_eq!(axis.alarm(), Alarm::Edge);
        axis.alarm = Some(Alarm::None);
        assert_eq!(axis.alarm(), Alarm::None);
    }
}
