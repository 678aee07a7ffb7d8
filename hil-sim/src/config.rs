//! What the simulated mechanics and lamp are like. The defaults are those of the source's rig (its
//! Table 3.1).

use lobelia_protocol::{Alarm, AxisParameters, Configuration, HomeDirection, KEEP_OUTS, Pins, Settings};
use serde::{Deserialize, Deserializer, Serialize};

/// The simulated rig's mechanics and lamp.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MechanicsConfig {
    /// Of all scatter, drift and noise.
    pub seed: u64,
    /// The sample's pan.
    #[serde(deserialize_with = "over_pan")]
    pub pan: AxisMechanics,
    /// The sample's tilt.
    #[serde(deserialize_with = "over_tilt")]
    pub tilt: AxisMechanics,
    /// The sample's roll.
    #[serde(deserialize_with = "over_roll")]
    pub roll: AxisMechanics,
    /// The light on its rail.
    #[serde(deserialize_with = "over_light")]
    pub light: AxisMechanics,
    /// The lamp and its photodiode.
    pub lamp: LampConfig,
    /// Whether the board has a timer for the shutter and a converter that reads the photodiode by itself, as
    /// the STM32F405 has; or else the controller's polls do both.
    pub timed_exposures: bool,
    /// Pins that are wired the other way round.
    #[serde(skip)]
    pub wiring: Wiring,
}

/// Pins that are wired the other way round, of each axis and of the rest.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Wiring {
    /// Pan, tilt, roll, light.
    pub axes: [Pins; 4],
    /// Lamp, shutter.
    pub rest: Pins,
}

/// One axis's mechanics. Angles count as the host's do: 0 steps is 0°.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AxisMechanics {
    /// Angle of one motor step.
    pub degrees_per_step: f64,
    /// Each position is off by up to this much either way, always equally for the same commanded steps.
    pub repeatability_deg: f64,
    /// Play between motor and axis.
    pub backlash_deg: f64,
    /// Lowest and highest angle that a host may ask for.
    pub limits_deg: [f64; 2],
    /// Angle at which the home switch, at the lower end, opens on the way up.
    pub home_switch_deg: f64,
    /// How much lower the switch closes on the way down.
    pub switch_hysteresis_deg: f64,
    /// Angles of the hard stops, where a motor loses steps.
    pub stops_deg: [f64; 2],
    /// Angle when the rig is switched on.
    pub start_deg: f64,
    /// Highest speed, °/s.
    pub max_speed_deg_s: f64,
    /// Acceleration, °/s².
    pub acceleration_deg_s2: f64,
    /// Change of acceleration, °/s³.
    pub jerk_deg_s3: f64,
}

/// The lamp and the photodiode beside it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LampConfig {
    /// Radiance comes up, and warmth goes down, exponentially with this time constant.
    pub warm_up_time_constant_s: f64,
    /// How long a host should let it burn.
    pub warm_up_s: u16,
    /// Largest relative change of radiance by drift.
    pub drift_amplitude: f64,
    /// Period of the slowest part of the drift.
    pub drift_period_s: f64,
    /// Relative standard deviation of one photodiode reading.
    pub photodiode_noise: f64,
    /// The photodiode's reading of the warm lamp at full level, in counts of a 12-bit converter.
    pub photodiode_counts: f64,
    /// By how much of its mean the dimmer makes the lamp brighter and darker, half of each of its periods.
    pub ripple: f64,
    /// The dimmer's frequency.
    pub ripple_hz: f64,
}

impl Default for MechanicsConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            pan: AxisMechanics::pan(),
            tilt: AxisMechanics::tilt(),
            roll: AxisMechanics::roll(),
            light: AxisMechanics::light(),
            lamp: LampConfig::default(),
            timed_exposures: false,
            wiring: Wiring::default(),
        }
    }
}

impl Default for LampConfig {
    fn default() -> Self {
        Self {
            warm_up_time_constant_s: 180.0,
            warm_up_s: 900,
            drift_amplitude: 0.02,
            drift_period_s: 3600.0,
            photodiode_noise: 1e-3,
            photodiode_counts: 3000.0,
            ripple: 0.0,
            ripple_hz: 20_000.0,
        }
    }
}

impl MechanicsConfig {
    /// A rig without backlash, scatter, drift or noise.
    pub fn ideal() -> Self {
        let mut config = Self::default();
        for axis in [&mut config.pan, &mut config.tilt, &mut config.roll, &mut config.light] {
            axis.repeatability_deg = 0.0;
            axis.backlash_deg = 0.0;
        }
        config.lamp.drift_amplitude = 0.0;
        config.lamp.photodiode_noise = 0.0;
        config
    }

    /// The axes in order: pan, tilt, roll, light.
    pub fn axes(&self) -> [&AxisMechanics; 4] {
        [&self.pan, &self.tilt, &self.roll, &self.light]
    }

    /// What a host that knows the rig would tell the controller.
    pub fn configuration(&self) -> Configuration {
        Configuration {
            axes: std::array::from_fn(|k| AxisParameters {
                inverted: self.wiring.axes[k],
                ..self.axes()[k].parameters()
            }),
            settings: Settings {
                lamp_warm_up_s: self.lamp.warm_up_s,
                lamp_least_reading: (self.lamp.photodiode_counts / 10.0) as u16,
                lease_ms: 2000,
                lamp_lease_ms: 2000,
                lamp_safe_level: 0,
                lamp_longest_s: 172_800,
                fan_run_on_s: 300,
                camera_wait_ms: 2000,
                coordinated: true,
                pulse_us: 3,
                direction_setup_us: 6,
                inverted: self.wiring.rest,
            },
            keep_outs: [None; KEEP_OUTS],
        }
    }
}

impl AxisMechanics {
    /// Pan of a PTU-46-70.
    pub fn pan() -> Self {
        Self {
            degrees_per_step: 0.0129,
            repeatability_deg: 0.786,
            backlash_deg: 0.1,
            limits_deg: [-90.0, 90.0],
            home_switch_deg: -95.0,
            switch_hysteresis_deg: 0.3,
            stops_deg: [-100.0, 100.0],
            start_deg: 10.0,
            max_speed_deg_s: 60.0,
            acceleration_deg_s2: 120.0,
            jerk_deg_s3: 1200.0,
        }
    }

    /// Tilt: like pan.
    pub fn tilt() -> Self {
        Self { start_deg: -20.0, ..Self::pan() }
    }

    /// Roll: like pan, but all the way round.
    pub fn roll() -> Self {
        Self {
            limits_deg: [-180.0, 180.0],
            home_switch_deg: -185.0,
            stops_deg: [-190.0, 190.0],
            start_deg: 0.0,
            ..Self::pan()
        }
    }

    /// The light, from 10° to 175° from the camera. Its drive steps by ten of the table's motor counts
    /// of 1.6e-4°: that is still 1/88 of its repeatability, and a tenth of the steps to simulate.
    pub fn light() -> Self {
        Self {
            degrees_per_step: 1.6e-3,
            repeatability_deg: 0.1411,
            backlash_deg: 0.02,
            limits_deg: [10.0, 175.0],
            home_switch_deg: 5.0,
            switch_hysteresis_deg: 0.3,
            stops_deg: [2.0, 180.0],
            start_deg: 60.0,
            max_speed_deg_s: 20.0,
            acceleration_deg_s2: 40.0,
            jerk_deg_s3: 400.0,
        }
    }

    /// An angle in whole steps, rounded.
    pub fn steps(&self, degrees: f64) -> i32 {
        (degrees / self.degrees_per_step).round() as i32
    }

    /// The step at which the home switch opens on the way up.
    pub fn home_position(&self) -> i32 {
        (self.home_switch_deg / self.degrees_per_step).floor() as i32 + 1
    }

    /// What a host that knows the axis would tell the controller.
    pub fn parameters(&self) -> AxisParameters {
        let steps = |degrees: f64| (degrees / self.degrees_per_step).ceil() as u32;
        let travel = self.stops_deg[1] - self.stops_deg[0];
        AxisParameters {
            min_steps: self.steps(self.limits_deg[0]),
            max_steps: self.steps(self.limits_deg[1]),
            max_speed: steps(self.max_speed_deg_s),
            acceleration: steps(self.acceleration_deg_s2),
            jerk: steps(self.jerk_deg_s3),
            full_turn_steps: 0,
            take_up_steps: steps(2.0 * self.backlash_deg) + 10,
            settle_ms: 200,
            home_direction: HomeDirection::Negative,
            home_position: self.home_position(),
            home_speed: steps(self.max_speed_deg_s / 3.0),
            home_slow_speed: steps(self.max_speed_deg_s / 60.0),
            home_back_off: steps(1.0),
            home_switch_steps: steps(8.0),
            home_order: 0,
            home_travel: steps(travel),
            home_debounce_us: 3000,
            index_tolerance: 4,
            driver: None,
            inverted: Pins::NONE,
            alarm: Alarm::None,
            alarm_debounce_us: 20,
            most_turns: 1,
        }
    }
}

/// An axis as a file gives it: what it leaves out is as in the default of that very axis.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AxisOverrides {
    degrees_per_step: Option<f64>,
    repeatability_deg: Option<f64>,
    backlash_deg: Option<f64>,
    limits_deg: Option<[f64; 2]>,
    home_switch_deg: Option<f64>,
    switch_hysteresis_deg: Option<f64>,
    stops_deg: Option<[f64; 2]>,
    start_deg: Option<f64>,
    max_speed_deg_s: Option<f64>,
    acceleration_deg_s2: Option<f64>,
    jerk_deg_s3: Option<f64>,
}

fn over<'de, D: Deserializer<'de>>(base: AxisMechanics, from: D) -> Result<AxisMechanics, D::Error> {
    let given = AxisOverrides::deserialize(from)?;
    let positive =
        [given.degrees_per_step, given.max_speed_deg_s, given.acceleration_deg_s2, given.jerk_deg_s3];
    if positive.into_iter().flatten().any(|value| !(value > 0.0 && value.is_finite())) {
        let names =
            "degrees_per_step, max_speed_deg_s, acceleration_deg_s2 and jerk_deg_s3 have to be above 0";
        return Err(serde::de::Error::custom(names));
    }
    Ok(AxisMechanics {
        degrees_per_step: given.degrees_per_step.unwrap_or(base.degrees_per_step),
        repeatability_deg: given.repeatability_deg.unwrap_or(base.repeatability_deg),
        backlash_deg: given.backlash_deg.unwrap_or(base.backlash_deg),
        limits_deg: given.limits_deg.unwrap_or(base.limits_deg),
        home_switch_deg: given.home_switch_deg.unwrap_or(base.home_switch_deg),
        switch_hysteresis_deg: given.switch_hysteresis_deg.unwrap_or(base.switch_hysteresis_deg),
        stops_deg: given.stops_deg.unwrap_or(base.stops_deg),
        start_deg: given.start_deg.unwrap_or(base.start_deg),
        max_speed_deg_s: given.max_speed_deg_s.unwrap_or(base.max_speed_deg_s),
        acceleration_deg_s2: given.acceleration_deg_s2.unwrap_or(base.acceleration_deg_s2),
        jerk_deg_s3: given.jerk_deg_s3.unwrap_or(base.jerk_deg_s3),
    })
}

fn over_pan<'de, D: Deserializer<'de>>(from: D) -> Result<AxisMechanics, D::Error> {
    over(AxisMechanics::pan(), from)
}

fn over_tilt<'de, D: Deserializer<'de>>(from: D) -> Result<AxisMechanics, D::Error> {
    over(AxisMechanics::tilt(), from)
}

fn over_roll<'de, D: Deserializer<'de>>(from: D) -> Result<AxisMechanics, D::Error> {
    over(AxisMechanics::roll(), from)
}

fn over_light<'de, D: Deserializer<'de>>(from: D) -> Result<AxisMechanics, D::Error> {
    over(AxisMechanics::light(), from)
}
