//! The motor axes.

use lobelia_protocol::{Alarm, AxisParameters, DriverParameters, Pin};
use serde::{Deserialize, Serialize};

use super::homing::{End, Homing};

/// The four axes, in the protocol's order.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Axes {
    /// Turns the sample about the bench's y axis.
    pub pan: Axis,
    /// Turns the sample about its (panned) x axis.
    pub tilt: Axis,
    /// Turns the sample about its normal.
    pub roll: Axis,
    /// Moves the light along its arc; 0 is the camera's direction.
    pub light: Axis,
}

impl Axes {
    /// The axes in the protocol's order: pan, tilt, roll, light.
    pub fn in_order(&self) -> [&Axis; 4] {
        [&self.pan, &self.tilt, &self.roll, &self.light]
    }
}

/// Names of the axes, in the protocol's order.
pub const AXIS_NAMES: [&str; 4] = ["pan", "tilt", "roll", "light"];

/// One motor axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axis {
    /// Angle of one motor step.
    pub degrees_per_step: f64,
    /// Lower soft limit.
    pub min_deg: f64,
    /// Upper soft limit.
    pub max_deg: f64,
    /// Angle of the home switch's edge, below the lower limit, or above the upper one with `homing.end =
    /// "upper"`.
    pub home_deg: f64,
    /// How far the axis can go with its home switch closed, from the edge to the hard stop. A switch that
    /// stays closed over this is stuck, or its wire is broken.
    #[serde(default = "default_switch")]
    pub home_switch_deg: f64,
    /// Axes with a lower number are homed before those with a higher one; those with the same together.
    #[serde(default)]
    pub home_order: u8,
    /// Highest speed.
    pub max_speed_deg_s: f64,
    /// Highest acceleration.
    pub acceleration_deg_s2: f64,
    /// Highest change of acceleration, °/s³. Ten times the acceleration, as for the default axes, reaches it
    /// in 0.1 s; a file that leaves it out gets 400.
    #[serde(default = "default_jerk")]
    pub jerk_deg_s3: f64,
    /// Whether the axis can turn round and round, so that moves go the shorter way. A turn has to be a whole
    /// number of steps.
    #[serde(default)]
    pub full_turn: bool,
    /// How many whole turns an axis that turns round and round may be wound up beyond its limits, either way,
    /// counted from where it was switched on: what its cables bear. Homing may wind it up by one more.
    #[serde(default = "default_turns")]
    pub most_turns: u8,
    /// Overshoot that takes up the backlash, so that every position is approached from below.
    pub take_up_deg: f64,
    /// Rest after a move before the rig counts as still.
    pub settle_s: f64,
    /// Largest angular error of a position (table 3.1); the weight of the motors against the fiducials.
    pub repeatability_deg: f64,
    /// Those of its pins that are wired the other way round than the controller's table of pins says: `step`,
    /// `direction`, `enable`, `home` (its limit switch too), `alarm`.
    #[serde(default)]
    pub invert: Vec<Pin>,
    /// What its alarm input, from the motor's driver, means: see [`Self::alarm`] for a file that leaves it
    /// out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alarm: Option<Alarm>,
    /// The alarm counts once it has lasted for so long, µs; 0 takes the shortest pulse.
    #[serde(default = "default_alarm_debounce")]
    pub alarm_debounce_us: u16,
    /// How the axis is homed, where that is otherwise than usual.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub homing: Option<Homing>,
    /// The axis's TMC2209, where the controller sets it up over its wire; its address is the axis's number
    /// from 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub driver: Option<Driver>,
}

/// How a TMC2209 is set up.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Driver {
    /// Current of a phase while the motor turns, mA RMS.
    pub run_ma: u16,
    /// Current of a phase at rest, mA RMS.
    pub hold_ma: u16,
    /// The driver's sense resistors, mΩ.
    pub sense_mohm: u16,
    /// Microsteps a full step, a power of two up to 256; one of them is a step of the axis.
    pub microsteps: u16,
    /// How much load counts as a stall, to be found by trying; 0 for never.
    pub stall_threshold: u8,
    /// Stalls are looked for above this speed only, °/s.
    pub stall_above_deg_s: f64,
}

impl Default for Driver {
    fn default() -> Self {
        Self {
            run_ma: 800,
            hold_ma: 400,
            sense_mohm: 110,
            microsteps: 16,
            stall_threshold: 0,
            stall_above_deg_s: 5.0,
        }
    }
}

fn default_jerk() -> f64 {
    400.0
}

fn default_alarm_debounce() -> u16 {
    50
}

fn default_turns() -> u8 {
    1
}

fn default_switch() -> f64 {
    8.0
}

impl Default for Axes {
    fn default() -> Self {
        let head = |limit: f64, repeatability_deg: f64| Axis {
            degrees_per_step: 0.0129,
            min_deg: -limit,
            max_deg: limit,
            home_deg: -limit - 5.0,
            home_switch_deg: default_switch(),
            home_order: 0,
            max_speed_deg_s: 60.0,
            acceleration_deg_s2: 120.0,
            jerk_deg_s3: 1200.0,
            full_turn: false,
            most_turns: default_turns(),
            take_up_deg: 0.5,
            settle_s: 0.2,
            repeatability_deg,
            invert: Vec::new(),
            alarm: Some(Alarm::None),
            alarm_debounce_us: default_alarm_debounce(),
            homing: None,
            driver: None,
        };
        let light = Axis {
            // Ten of table 3.1's motor counts: still 1/88 of the repeatability.
            degrees_per_step: 1.6e-3,
            min_deg: 10.0,
            max_deg: 175.0,
            home_deg: 5.0,
            home_switch_deg: default_switch(),
            home_order: 0,
            max_speed_deg_s: 20.0,
            acceleration_deg_s2: 40.0,
            jerk_deg_s3: 400.0,
            full_turn: false,
            most_turns: default_turns(),
            take_up_deg: 0.2,
            settle_s: 0.3,
            repeatability_deg: 0.1411,
            invert: Vec::new(),
            alarm: Some(Alarm::None),
            alarm_debounce_us: default_alarm_debounce(),
            homing: None,
            driver: None,
        };
        Self { pan: head(90.0, 0.786), tilt: head(90.0, 0.786), roll: head(180.0, 0.786), light }
    }
}

/// Share of the way from the home switch's edge to the hard stop in which an axis that looks for its switch
/// must come to rest.
const STOPPING_SHARE: f64 = 0.8;

impl Axis {
    /// How far the axis goes from a speed, °/s, till it rests, once its home switch has closed: the jerk is
    /// limited at both ends.
    pub(super) fn stopping_deg(&self, speed: f64) -> f64 {
        let (acceleration, jerk) = (self.acceleration_deg_s2, self.jerk_deg_s3);
        let braking_s = if speed * jerk < acceleration * acceleration {
            2.0 * (speed / jerk).sqrt()
        } else {
            speed / acceleration + acceleration / jerk
        };
        let debounce_s = self.homing.clone().unwrap_or_default().debounce_ms / 1e3;
        speed * (0.5 * braking_s + debounce_s)
    }

    /// The highest speed, °/s, from which the axis stops well before the hard stop when it finds its home
    /// switch closed.
    pub(super) fn stopping_speed_deg_s(&self) -> f64 {
        let room = STOPPING_SHARE * self.home_switch_deg;
        let (mut low, mut high) = (0.0, self.max_speed_deg_s);
        if self.stopping_deg(high) <= room {
            return high;
        }
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            *(if self.stopping_deg(middle) <= room { &mut low } else { &mut high }) = middle;
        }
        low
    }

    /// The axis in the controller's steps; `None` when a number is out of range.
    pub(super) fn parameters(&self) -> Option<AxisParameters> {
        let signed = |degrees: f64| {
            let steps = (degrees / self.degrees_per_step).round();
            (steps.abs() < 1e9).then_some(steps as i32)
        };
        let positive = |degrees: f64| signed(degrees).and_then(|steps| u32::try_from(steps).ok());
        let settle_ms = (self.settle_s * 1e3).round();
        let homing = self.homing.clone().unwrap_or_default();
        let stopping = self.stopping_speed_deg_s();
        let speed = |own: Option<f64>, part: f64| {
            positive(own.unwrap_or((self.max_speed_deg_s / part).min(stopping)))
        };
        let far_limit = match homing.end {
            End::Lower => self.max_deg,
            End::Upper => self.min_deg,
        };
        Some(AxisParameters {
            min_steps: signed(self.min_deg)?,
            max_steps: signed(self.max_deg)?,
            max_speed: positive(self.max_speed_deg_s)?,
            acceleration: positive(self.acceleration_deg_s2)?,
            jerk: positive(self.jerk_deg_s3)?,
            full_turn_steps: if self.full_turn { positive(360.0)? } else { 0 },
            take_up_steps: positive(self.take_up_deg)?,
            settle_ms: (0.0..=65535.0).contains(&settle_ms).then_some(settle_ms as u16)?,
            home_direction: homing.direction(),
            home_position: signed(
                homing.edge(self.home_deg / self.degrees_per_step) * self.degrees_per_step,
            )?,
            home_speed: speed(homing.speed_deg_s, 3.0)?.max(1),
            home_slow_speed: speed(homing.slow_speed_deg_s, 60.0)?.max(1),
            home_back_off: positive(homing.back_off_deg)?.max(1),
            home_switch_steps: positive(self.home_switch_deg)?.max(1),
            home_order: self.home_order,
            home_travel: positive((far_limit - self.home_deg).abs() + 20.0)?,
            home_debounce_us: (homing.debounce_ms * 1e3).round() as u16,
            index_tolerance: homing.index_tolerance_steps,
            driver: match &self.driver {
                None => None,
                Some(driver) => Some(DriverParameters {
                    run_ma: driver.run_ma,
                    hold_ma: driver.hold_ma,
                    sense_mohm: driver.sense_mohm,
                    microsteps: driver.microsteps,
                    stall_threshold: driver.stall_threshold,
                    stall_above_speed: positive(driver.stall_above_deg_s)?,
                }),
            },
            inverted: self.invert.iter().copied().collect(),
            alarm: self.alarm(),
            alarm_debounce_us: self.alarm_debounce_us,
            most_turns: self.most_turns,
        })
    }
}
