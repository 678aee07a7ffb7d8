//! `[axes.NAME.homing]`: how an axis looks for its home switch, where that is otherwise than usual.

use lobelia_protocol::HomeDirection;
use serde::{Deserialize, Serialize};

/// At which end of the travel the home switch is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum End {
    /// Below the lower limit.
    #[default]
    Lower,
    /// Above the upper limit.
    Upper,
}

/// How an axis is homed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Homing {
    /// At which end the switch is.
    pub end: End,
    /// Speed of the first search. Where it is left out a third of the highest, or less where the axis could
    /// not stop from that within `home_switch_deg`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub speed_deg_s: Option<f64>,
    /// Speed at which the edge is measured; a sixtieth of the highest where it is left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub slow_speed_deg_s: Option<f64>,
    /// How far the axis backs off before the slow search.
    pub back_off_deg: f64,
    /// The switch counts once it has been closed, or open, for so long, ms.
    pub debounce_ms: f64,
    /// A check of the position passes within so many steps.
    pub index_tolerance_steps: u16,
}

impl Default for Homing {
    fn default() -> Self {
        Self {
            end: End::Lower,
            speed_deg_s: None,
            slow_speed_deg_s: None,
            back_off_deg: 1.0,
            debounce_ms: 3.0,
            index_tolerance_steps: 4,
        }
    }
}

impl Homing {
    pub(super) fn direction(&self) -> HomeDirection {
        match self.end {
            End::Lower => HomeDirection::Negative,
            End::Upper => HomeDirection::Positive,
        }
    }

    /// The position of the switch's edge in steps: the first above it at the lower end, where it opens on the
    /// way up, and the first at or above it at the upper end, where it closes.
    pub(super) fn edge(&self, home_steps: f64) -> f64 {
        match self.end {
            End::Lower => home_steps.floor() + 1.0,
            End::Upper => home_steps.ceil(),
        }
    }

    /// The first number out of range: its key and what is wrong with it.
    pub(super) fn check(&self, highest_deg_s: f64) -> Result<(), (&'static str, String)> {
        for (key, speed) in
            [("homing.speed_deg_s", self.speed_deg_s), ("homing.slow_speed_deg_s", self.slow_speed_deg_s)]
        {
            if let Some(speed) = speed
                && !(speed > 0.0 && speed <= highest_deg_s)
            {
                return Err((key, format!("is {speed}, must be above 0 and at most max_speed_deg_s")));
            }
        }
        if !(self.back_off_deg > 0.0 && self.back_off_deg <= 90.0) {
            return Err((
                "homing.back_off_deg",
                format!("is {}, must be above 0, at most 90", self.back_off_deg),
            ));
        }
        if !(0.0..=65.0).contains(&self.debounce_ms) {
            return Err(("homing.debounce_ms", format!("is {}, must lie in 0 to 65", self.debounce_ms)));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::config::RigConfig;

    #[test]
    fn homing_is_optional_and_its_numbers_reach_the_controller() {
        let text = toml::to_string(&RigConfig::default()).unwrap();
        assert!(!text.contains("homing"));
        let own = "[axes.tilt.homing]\nend = \"upper\"\nspeed_deg_s = 12.9\nback_off_deg = 2.58\ndebounce_ms \
             = 10\n\n[axes.roll]";
        let mut config: RigConfig = toml::from_str(&text.replace("[axes.roll]", own)).unwrap();
        config.axes.tilt.home_deg = 94.5;
        config.validate().unwrap();
        let [pan, tilt, ..] = config.configuration().unwrap().axes;
        assert_eq!(
            (pan.home_direction, pan.home_back_off, pan.home_debounce_us),
            (HomeDirection::Negative, 78, 3000)
        );
        assert_eq!(
            (tilt.home_direction, tilt.home_back_off, tilt.home_debounce_us),
            (HomeDirection::Positive, 200, 10_000)
        );
        // 12.9°/s and 1°/s in steps of 0.0129°; the edge is at step 7325.58.
        assert_eq!((tilt.home_speed, tilt.home_slow_speed, tilt.home_position), (1000, 78, 7326));
        // From the lower limit up to the switch, and 20° more.
        assert!((f64::from(tilt.home_travel) * 0.0129 - 204.5).abs() < 0.02);
    }

    /// By hand: from 20°/s at 20°/s² the way is v²/2a = 10° and more for the jerk, and the hard stop stands
    /// 8° behind the edge.
    #[test]
    fn an_axis_that_brakes_softly_looks_for_its_switch_so_slowly_that_it_stops_before_the_hard_stop() {
        let mut config = RigConfig::default();
        let speed_deg_s = |config: &RigConfig| {
            let axis = config.configuration().unwrap().axes[0];
            f64::from(axis.home_speed) * config.axes.pan.degrees_per_step
        };
        assert!((speed_deg_s(&config) - 20.0).abs() < 0.02, "a third of the highest where that is safe");
        for acceleration in [40.0, 20.0, 10.0, 5.0] {
            config.axes.pan.acceleration_deg_s2 = acceleration;
            config.validate().unwrap();
            let speed = speed_deg_s(&config);
            let way = speed * speed / (2.0 * acceleration) + speed * acceleration / (2.0 * 1200.0);
            assert!(
                way < 7.0 && speed > 0.9 * (2.0f64 * 5.5 * acceleration).sqrt().min(20.0),
                "{speed} {way}"
            );
        }
        config.axes.pan.homing = Some(Homing { speed_deg_s: Some(20.0), ..Homing::default() });
        let error = config.validate().unwrap_err().to_string();
        assert!(error.contains("axes.pan.homing.speed_deg_s is 20, from which the axis needs"), "{error}");
        config.axes.pan.homing = None;
        config.axes.pan.home_switch_deg = 1e-6;
        let error = config.validate().unwrap_err().to_string();
        assert!(error.contains("axes.pan.home_switch_deg"), "{error}");
    }

    #[test]
    fn switch_on_the_wrong_side_and_numbers_out_of_range_are_refused_by_their_key() {
        let refused = |change: fn(&mut Homing)| {
            let mut config = RigConfig::default();
            let mut homing = Homing::default();
            change(&mut homing);
            config.axes.tilt.homing = Some(homing);
            config.validate().map_err(|error| error.to_string())
        };
        assert_eq!(refused(|_| {}), Ok(()));
        type Change = fn(&mut Homing);
        let keys: [(Change, &str); 4] = [
            (|homing| homing.end = End::Upper, "axes.tilt.home_deg"),
            (|homing| homing.slow_speed_deg_s = Some(61.0), "axes.tilt.homing.slow_speed_deg_s"),
            (|homing| homing.back_off_deg = 0.0, "axes.tilt.homing.back_off_deg"),
            (|homing| homing.debounce_ms = 66.0, "axes.tilt.homing.debounce_ms"),
        ];
        for (change, key) in keys {
            assert!(refused(change).unwrap_err().contains(key), "{key}");
        }
    }
}
