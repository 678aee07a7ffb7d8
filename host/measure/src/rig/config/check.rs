//! What the types of `rig.toml` cannot say: numbers that are finite and in range, limits in order, tags that
//! are known and lie beside the sample.

use std::ops::RangeInclusive;

use lobelia_protocol::{EXPOSURE_US, LAMP_LONGEST_S, Pins};

use super::{AXIS_NAMES, Axis, Driver, End, RigConfig, wiring};
use lobelia_base::error::{Error, Result};

/// Tags of the family 36h11 that are known: ids below this.
const KNOWN_TAGS: u32 = 48;

/// Anything that is a length, time or count above 0 and not absurd.
const POSITIVE: RangeInclusive<f64> = 1e-12..=1e12;

/// The same with 0.
const NOT_NEGATIVE: RangeInclusive<f64> = 0.0..=1e12;

/// The shortest lease that a host keeps which speaks every half second, and may be late once.
const LEAST_LEASE_S: f64 = 1.0;

impl RigConfig {
    /// Checks what types cannot, and what driving the rig needs.
    ///
    /// # Errors
    /// An input error that names the key and what it must be.
    pub fn validate(&self) -> Result<()> {
        self.validate_recorded()?;
        self.can_be_driven()
    }

    /// Checks what developing the photographs of a run needs: they were taken, whatever else this host would
    /// ask of the rig.
    ///
    /// # Errors
    /// As [`Self::validate`].
    pub(crate) fn validate_recorded(&self) -> Result<()> {
        self.numbers_are_finite()?;
        for (name, axis) in AXIS_NAMES.iter().zip(self.axes.in_order()) {
            check_axis(axis).map_err(|(key, why)| refused(&format!("axes.{name}.{key}"), &why))?;
        }
        for (key, value, range) in self.ranges() {
            in_range(value, &range).map_err(|why| refused(key, &why))?;
        }
        self.check_camera()?;
        self.check_tags()
    }

    /// Leases that the host keeps, home searches that end before the hard stop.
    fn can_be_driven(&self) -> Result<()> {
        for (key, lease) in [("lamp.lease_s", self.lamp.lease_s), ("motion.lease_s", self.motion.lease_s)] {
            if lease != 0.0 && lease < LEAST_LEASE_S {
                let why = format!(
                    "is {lease}, must be 0 for never or at least {LEAST_LEASE_S}: the host is heard every \
                     half second"
                );
                return Err(refused(key, &why));
            }
        }
        for (name, axis) in AXIS_NAMES.iter().zip(self.axes.in_order()) {
            check_search(axis).map_err(|(key, why)| refused(&format!("axes.{name}.{key}"), &why))?;
        }
        wiring::stranger(&self.wiring.invert, Pins::OF_RIG).map_err(|why| refused("wiring.invert", &why))?;
        self.check_keep_outs().map_err(|why| refused("keep_out", &why))
    }

    /// No number of the file, wherever it stands, is NaN or infinite.
    fn numbers_are_finite(&self) -> Result<()> {
        let file = toml::Value::try_from(self).map_err(|error| {
            Error::input(format!("the rig's file cannot be read back: {error}")).caused_by(error)
        })?;
        match not_finite(&file, String::new()) {
            Some(key) => Err(refused(&key, "is not a finite number")),
            None => Ok(()),
        }
    }

    /// Keys, their values and the ranges that those must lie in.
    fn ranges(&self) -> Vec<(&'static str, f64, RangeInclusive<f64>)> {
        let (camera, simulator, lamp) = (&self.camera, &self.simulator, &self.lamp);
        let mut ranges = vec![
            ("geometry.light_radius_mm", self.geometry.light_radius_mm, POSITIVE),
            ("geometry.carrier_slack_mm", self.geometry.carrier_slack_mm, POSITIVE),
            ("lamp.aperture_diameter_mm", lamp.aperture_diameter_mm, POSITIVE),
            ("lamp.reference_reading", lamp.reference_reading, POSITIVE),
            ("lamp.warm_up_s", lamp.warm_up_s, 0.0..=65535.0),
            ("lamp.lease_s", lamp.lease_s, 0.0..=1e6),
            ("lamp.safe_level", lamp.safe_level, 0.0..=1.0),
            ("camera.ready_wait_s", camera.ready_wait_s, 0.0..=65.0),
            ("lamp.longest_s", lamp.longest_s, lamp_s()),
            ("lamp.fan_run_on_s", lamp.fan_run_on_s, 0.0..=65535.0),
            ("motion.lease_s", self.motion.lease_s, 0.0..=1e6),
            ("motion.pulse_us", self.motion.pulse_us.into(), 1.0..=100.0),
            ("carrier.sample_width_mm", self.carrier.sample_width_mm, POSITIVE),
            ("carrier.sample_height_mm", self.carrier.sample_height_mm, POSITIVE),
            ("carrier.tag_size_mm", self.carrier.tag_size_mm, POSITIVE),
            ("carrier.texels_across", self.carrier.texels_across as f64, 1.0..=16384.0),
            ("camera.width", camera.width as f64, 16.0..=65535.0),
            ("camera.height", camera.height as f64, 16.0..=65535.0),
            ("camera.black_level", camera.black_level, 0.0..=65535.0),
            ("camera.white_level", camera.white_level, 1.0..=65535.0),
            ("camera.min_exposure_s", camera.min_exposure_s, exposures_s()),
            ("camera.max_exposure_s", camera.max_exposure_s, exposures_s()),
            ("camera.f_number", camera.f_number, POSITIVE),
            ("camera.electrons_per_value", camera.electrons_per_value, POSITIVE),
            ("camera.read_noise_e", camera.read_noise_e, NOT_NEGATIVE),
            ("exposure.count", self.exposure.count as f64, 1.0..=3.0),
            ("exposure.dark_frames", self.exposure.dark_frames as f64, 1.0..=100.0),
            ("exposure.darkest_reflectance", self.exposure.darkest_reflectance, POSITIVE),
            ("exposure.brightest_reflectance", self.exposure.brightest_reflectance, POSITIVE),
            ("exposure.highlight_deg", self.exposure.highlight_deg, POSITIVE),
            ("simulator.lamp_time_constant_s", simulator.lamp_time_constant_s, POSITIVE),
            ("simulator.lamp_drift", simulator.lamp_drift, 0.0..=0.9),
            ("simulator.electrons_per_value", simulator.electrons_per_value, POSITIVE),
            ("simulator.read_noise_e", simulator.read_noise_e, NOT_NEGATIVE),
            ("simulator.dark_e_s", simulator.dark_e_s, NOT_NEGATIVE),
        ];
        // At most half way round.
        let least_radius = self.carrier.sample_width_mm / std::f64::consts::PI;
        let radius = self.carrier.cylinder_radius_mm;
        ranges.extend(radius.map(|r| ("carrier.cylinder_radius_mm", r, least_radius..=1e6)));
        ranges.extend(camera.focal_px.map(|f| ("camera.focal_px", f, POSITIVE)));
        ranges.extend(camera.responsivity.map(|r| ("camera.responsivity", r, POSITIVE)));
        ranges.extend(lamp.radiance.map(|l| ("lamp.radiance", l, POSITIVE)));
        ranges.extend(simulator.backlash_deg.map(|b| ("simulator.backlash_deg", b, 0.0..=10.0)));
        ranges.extend(simulator.carrier_albedo.map(|a| ("simulator.carrier_albedo", a, 0.0..=1.0)));
        ranges
    }

    fn check_camera(&self) -> Result<()> {
        let camera = &self.camera;
        if camera.range() <= 0.0 {
            return Err(refused("camera.white_level", "is not above black_level"));
        }
        if camera.max_exposure_s < camera.min_exposure_s {
            return Err(refused("camera.max_exposure_s", "is below min_exposure_s"));
        }
        let nearest = self.geometry.carrier_offset_mm.abs();
        if self.geometry.camera_distance_mm <= nearest {
            return Err(refused("geometry.camera_distance_mm", "puts the camera into the carrier"));
        }
        let texels = self.carrier.texels_down();
        if !(1..=16384).contains(&texels) {
            return Err(refused("carrier.texels_across", &format!("gives {texels} rows of texels")));
        }
        Ok(())
    }

    /// Ids of the family, none twice, none over the sample or over another tag.
    fn check_tags(&self) -> Result<()> {
        let carrier = &self.carrier;
        let size = carrier.tag_size_mm;
        for (k, tag) in carrier.tags.iter().enumerate() {
            let refuse = |why: &str| Err(refused("carrier.tags", &format!("has the tag {} {why}", tag.id)));
            if tag.id >= KNOWN_TAGS {
                return refuse(&format!("but only ids below {KNOWN_TAGS} are known"));
            }
            let over = |x: f64, y: f64, width: f64, height: f64| {
                (tag.x_mm - x).abs() < 0.5 * (size + width) && (tag.y_mm - y).abs() < 0.5 * (size + height)
            };
            if over(0.0, 0.0, carrier.sample_width_mm, carrier.sample_height_mm) {
                return refuse("on the sample");
            }
            for other in &carrier.tags[..k] {
                if other.id == tag.id {
                    return refuse("twice");
                }
                if over(other.x_mm, other.y_mm, size, size) {
                    return refuse(&format!("over the tag {}", other.id));
                }
            }
        }
        Ok(())
    }
}

/// Exposures that the controller makes, s.
pub fn exposures_s() -> RangeInclusive<f64> {
    f64::from(*EXPOSURE_US.start()) / 1e6..=f64::from(*EXPOSURE_US.end()) / 1e6
}

/// How long a lamp may burn at a stretch, s.
fn lamp_s() -> RangeInclusive<f64> {
    f64::from(*LAMP_LONGEST_S.start())..=f64::from(*LAMP_LONGEST_S.end())
}

/// A refusal that names the key.
fn refused(key: &str, why: &str) -> Error {
    Error::input(format!("{key} {why}"))
}

/// The first number that is not finite, as the key that leads to it.
fn not_finite(value: &toml::Value, key: String) -> Option<String> {
    let below = |name: &str| if key.is_empty() { name.to_string() } else { format!("{key}.{name}") };
    match value {
        toml::Value::Float(number) if !number.is_finite() => Some(key),
        toml::Value::Array(items) => items.iter().find_map(|item| not_finite(item, key.clone())),
        toml::Value::Table(table) => table.iter().find_map(|(name, item)| not_finite(item, below(name))),
        _ => None,
    }
}

fn in_range(value: f64, range: &RangeInclusive<f64>) -> std::result::Result<(), String> {
    if range.contains(&value) {
        return Ok(());
    }
    if *range == POSITIVE {
        return Err(format!("is {value}, must be above 0"));
    }
    Err(format!("is {value}, must lie in {} to {}", range.start(), range.end()))
}

/// One axis; the key and what is wrong with it.
fn check_axis(axis: &Axis) -> std::result::Result<(), (&'static str, String)> {
    if axis.min_deg >= axis.max_deg {
        return Err(("min_deg", "is not below max_deg".into()));
    }
    let numbers = [
        ("degrees_per_step", axis.degrees_per_step, POSITIVE),
        ("max_speed_deg_s", axis.max_speed_deg_s, POSITIVE),
        ("acceleration_deg_s2", axis.acceleration_deg_s2, POSITIVE),
        ("jerk_deg_s3", axis.jerk_deg_s3, POSITIVE),
        ("min_deg", axis.min_deg, -3600.0..=3600.0),
        ("max_deg", axis.max_deg, -3600.0..=3600.0),
        ("take_up_deg", axis.take_up_deg, 0.0..=90.0),
        ("home_switch_deg", axis.home_switch_deg, 1e-9..=360.0),
        ("settle_s", axis.settle_s, 0.0..=60.0),
        ("repeatability_deg", axis.repeatability_deg, 1e-9..=90.0),
    ];
    for (key, value, range) in numbers {
        in_range(value, &range).map_err(|why| (key, why))?;
    }
    wiring::stranger(&axis.invert, Pins::OF_AXIS).map_err(|why| ("invert", why))?;
    let homing = axis.homing.clone().unwrap_or_default();
    homing.check(axis.max_speed_deg_s)?;
    match homing.end {
        _ if axis.full_turn => {}
        End::Lower if axis.home_deg >= axis.min_deg => {
            return Err(("home_deg", "is not below min_deg".into()));
        }
        End::Upper if axis.home_deg <= axis.max_deg => {
            return Err(("home_deg", "is not above max_deg".into()));
        }
        _ => {}
    }
    axis.driver.as_ref().map_or(Ok(()), check_driver)?;
    let turn = 360.0 / axis.degrees_per_step;
    if axis.full_turn && (turn - turn.round()).abs() > 1e-6 {
        return Err(("full_turn", format!("is true, but a turn is {turn} steps, which is no whole number")));
    }
    Ok(())
}

/// How one axis looks for its home switch; the key and what is wrong with it.
fn check_search(axis: &Axis) -> std::result::Result<(), (&'static str, String)> {
    let homing = axis.homing.clone().unwrap_or_default();
    let fits = axis.stopping_speed_deg_s();
    let too_fast = |speed: f64| {
        format!(
            "is {speed}, from which the axis needs {:.2}° to stop, too much of home_switch_deg, {}; at most \
             {fits:.2} fits",
            axis.stopping_deg(speed),
            axis.home_switch_deg
        )
    };
    for (key, speed) in
        [("homing.speed_deg_s", homing.speed_deg_s), ("homing.slow_speed_deg_s", homing.slow_speed_deg_s)]
    {
        if let Some(speed) = speed.filter(|speed| *speed > fits) {
            return Err((key, too_fast(speed)));
        }
    }
    // A search that must creep would never end.
    let slowest = axis.max_speed_deg_s / 1e3;
    if fits < slowest {
        let why = format!("is {}, so little that the axis could not stop within it", axis.home_switch_deg);
        return Err(("home_switch_deg", why));
    }
    Ok(())
}

/// A driver over a wire; the controller knows which currents it can make.
fn check_driver(driver: &Driver) -> std::result::Result<(), (&'static str, String)> {
    if !driver.microsteps.is_power_of_two() || driver.microsteps > 256 {
        let why = format!("is {}, must be a power of two up to 256", driver.microsteps);
        return Err(("driver.microsteps", why));
    }
    if driver.hold_ma > driver.run_ma {
        return Err(("driver.hold_ma", format!("is above run_ma, {}", driver.run_ma)));
    }
    in_range(f64::from(driver.sense_mohm), &(10.0..=1000.0)).map_err(|why| ("driver.sense_mohm", why))?;
    in_range(driver.stall_above_deg_s, &(0.0..=1e4)).map_err(|why| ("driver.stall_above_deg_s", why))
}

#[cfg(test)]
mod tests {
    use super::super::Homing;
    use super::*;
    use crate::plan::{self, Extent};

    /// Every number of the file, one after the other, replaced by `value`.
    fn with_each_number(value: &toml::Value) -> Vec<(String, RigConfig)> {
        fn paths(value: &toml::Value, path: Vec<String>, all: &mut Vec<Vec<String>>) {
            match value {
                toml::Value::Float(_) | toml::Value::Integer(_) => all.push(path),
                toml::Value::Array(items) => items.iter().enumerate().take(3).for_each(|(k, item)| {
                    paths(item, [path.clone(), vec![k.to_string()]].concat(), all);
                }),
                toml::Value::Table(table) => table.iter().for_each(|(name, item)| {
                    paths(item, [path.clone(), vec![name.clone()]].concat(), all);
                }),
                _ => {}
            }
        }
        let file = toml::Value::try_from(RigConfig::default()).unwrap();
        let mut all = Vec::new();
        paths(&file, Vec::new(), &mut all);
        let replaced = all.iter().filter_map(|path| {
            let mut changed = file.clone();
            let mut place = &mut changed;
            for step in path {
                place = match place {
                    toml::Value::Array(items) => &mut items[step.parse::<usize>().unwrap()],
                    other => &mut other[step.as_str()],
                };
            }
            *place = match value {
                toml::Value::Float(number) if place.is_integer() => {
                    toml::Value::Integer(number.is_finite().then_some(*number as i64)?)
                }
                other => other.clone(),
            };
            Some((path.join("."), changed.try_into().ok()?))
        });
        replaced.collect()
    }

    #[test]
    fn whatever_one_number_is_the_rig_is_refused_or_can_be_planned_for() {
        for number in [0.0, -1.0, 1e300, -1e300, f64::NAN, f64::INFINITY] {
            for (key, config) in with_each_number(&toml::Value::Float(number)) {
                match config.validate() {
                    Ok(()) => drop(plan::make(&config, Extent::Budget(2), true, 1)),
                    Err(error) => {
                        let last = key.split('.').find(|part| error.to_string().contains(*part));
                        assert!(last.is_some(), "{key} = {number}: {error}");
                    }
                }
                assert!(number.is_finite() || config.validate().is_err(), "{key} = {number}");
            }
        }
    }

    /// Each would end every run: the host is heard every half second, and an axis that needs 10° to stop hits
    /// its stop 8° behind the switch. Photographs that were taken all the same are developed.
    #[test]
    fn a_rig_that_no_run_would_end_well_with_is_not_driven_but_a_run_of_it_is_read() {
        let refused = |change: fn(&mut RigConfig), why: &str| {
            let mut config = RigConfig::default();
            change(&mut config);
            let error = config.validate().unwrap_err().to_string();
            assert!(error.starts_with(why), "{error}");
            config.validate_recorded().unwrap();
            config.with_settings(&["carrier.texels_across=64".to_string()]).unwrap();
        };
        refused(|rig| rig.lamp.lease_s = 0.4, "lamp.lease_s is 0.4, must be 0 for never or at least 1");
        refused(|rig| rig.motion.lease_s = 0.1, "motion.lease_s is 0.1");
        let fast = |rig: &mut RigConfig| {
            rig.axes.pan.acceleration_deg_s2 = 20.0;
            rig.axes.pan.homing = Some(Homing { speed_deg_s: Some(20.0), ..Homing::default() });
        };
        refused(fast, "axes.pan.homing.speed_deg_s is 20");
        let mut never = RigConfig::default();
        (never.lamp.lease_s, never.motion.lease_s) = (0.0, 0.0);
        never.validate().unwrap();
    }

    #[test]
    fn driver_is_optional_and_its_numbers_are_checked() {
        let refused = |change: fn(&mut Driver)| {
            let mut config = RigConfig::default();
            let mut driver = Driver::default();
            change(&mut driver);
            config.axes.tilt.driver = Some(driver);
            config.validate().map_err(|error| error.to_string())
        };
        assert_eq!(refused(|_| {}), Ok(()));
        assert!(
            refused(|driver| driver.microsteps = 12).unwrap_err().contains("axes.tilt.driver.microsteps")
        );
        assert!(refused(|driver| driver.hold_ma = 900).unwrap_err().contains("hold_ma"));
        assert!(refused(|driver| driver.stall_above_deg_s = -1.0).unwrap_err().contains("stall_above_deg_s"));
        let text = toml::to_string(&RigConfig::default()).unwrap();
        assert!(!text.contains("driver"));
        let config: RigConfig =
            toml::from_str(&text.replace("[axes.roll]", "[axes.pan.driver]\nrun_ma = 500\n\n[axes.roll]"))
                .unwrap();
        let axes = config.configuration().unwrap().axes;
        let driver = axes[0].driver.unwrap();
        // 5°/s in steps of 0.0129°.
        assert_eq!((driver.run_ma, driver.hold_ma, driver.stall_above_speed), (500, 400, 388));
        assert_eq!(axes[1].driver, None);
    }

    #[test]
    fn every_tag_that_a_rig_may_have_is_known_to_the_detector() {
        assert_eq!(KNOWN_TAGS, crate::develop::fiducials::COUNT);
    }

    #[test]
    fn tags_that_are_unknown_twice_or_in_the_way_are_refused() {
        let refused = |change: fn(&mut RigConfig)| {
            let mut config = RigConfig::default();
            change(&mut config);
            config.validate().unwrap_err().to_string()
        };
        assert!(refused(|rig| rig.carrier.tags[3].id = 99_999).contains("99999"));
        assert!(refused(|rig| rig.carrier.tags[3].id = 2).contains("twice"));
        assert!(
            refused(|rig| rig.carrier.tags[3].x_mm = rig.carrier.tags[2].x_mm + 5.0).contains("over the tag")
        );
        assert!(refused(|rig| rig.carrier.sample_width_mm = 640.0).contains("on the sample"));
        assert!(refused(|rig| rig.carrier.cylinder_radius_mm = Some(20.0)).contains("cylinder_radius_mm"));
        assert!(refused(|rig| rig.camera.max_exposure_s = 1e-5).contains("max_exposure_s"));
    }
}
