//! `rig.toml`: every number of the rig that the host needs, with defaults for the simulated one.
//!
//! Lengths in mm, angles in degrees, times in seconds, as the key names say.

use lobelia_protocol::{Configuration, Settings};
use std::path::Path;

use serde::{Deserialize, Serialize};

use lobelia_base::{progress, toml_file};

mod axes;
mod carrier;
pub mod check;
mod homing;
pub mod keep_out;
mod wiring;

pub use axes::{AXIS_NAMES, Axes, Axis, Driver};
pub use carrier::{Carrier, Tag};
pub use homing::{End, Homing};
pub use keep_out::{AxisName, KeepOut};
pub use wiring::Wiring;

/// The whole file.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RigConfig {
    /// The four motor axes.
    pub axes: Axes,
    /// How the axes move together.
    pub motion: Motion,
    /// Where camera, light and sample stand.
    pub geometry: Geometry,
    /// The camera's lens and sensor.
    pub camera: Camera,
    /// The light source.
    pub lamp: Lamp,
    /// The sample and the fiducials around it.
    pub carrier: Carrier,
    /// How exposures are chosen.
    pub exposure: Exposure,
    /// How pins are wired that are no axis's.
    pub wiring: Wiring,
    /// What the simulated rig does that a real one does by itself.
    pub simulator: Simulator,
    /// Where two axes must not be together.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub keep_out: Vec<KeepOut>,
}

/// How the axes move together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Motion {
    /// Whether all axes arrive at once, each slowed down to the slowest one's time; or else each as soon as
    /// it can.
    pub coordinated: bool,
    /// A run looks for the home switches after every so many poses, and after the last; 0 for never. Poses
    /// since the last look are photographed again when steps were lost.
    pub check_every_poses: usize,
    /// Shortest time that a step pin stays high, and low, µs: the longest that a driver wants, which is 1 for
    /// an A4988, 1.9 for a DRV8825, 2.5 for a DM542.
    pub pulse_us: u8,
    /// Shortest time from a change of direction to the next step, µs: the longest that a driver wants, 5 for
    /// a DM542.
    pub direction_setup_us: u8,
    /// The controller stops smoothly when it hears nothing for this long while it is moving; 0 for never.
    pub lease_s: f64,
}

impl Default for Motion {
    fn default() -> Self {
        Self { coordinated: true, check_every_poses: 500, pulse_us: 3, direction_setup_us: 6, lease_s: 2.0 }
    }
}

/// A time in s as the controller counts it.
fn milliseconds(seconds: f64) -> u32 {
    (seconds * 1e3).round().clamp(0.0, 1e9) as u32
}

/// Positions on the bench.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Geometry {
    /// From the crossing of pan and tilt to the camera's centre of projection.
    pub camera_distance_mm: f64,
    /// Radius of the light's arc.
    pub light_radius_mm: f64,
    /// The carrier's surface above the crossing of pan and tilt, along the sample's normal.
    pub carrier_offset_mm: f64,
    /// How far the carrier's centre may lie from where it should be, one standard deviation.
    pub carrier_slack_mm: f64,
}

impl Default for Geometry {
    fn default() -> Self {
        Self {
            camera_distance_mm: 1050.0,
            light_radius_mm: 1000.0,
            carrier_offset_mm: 25.4,
            carrier_slack_mm: 0.3,
        }
    }
}

/// The camera: pinhole with Brown–Conrady distortion, Bayer RGGB sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Camera {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Focal lengths in pixels, x and y.
    pub focal_px: [f64; 2],
    /// Principal point in pixels; the centre of the first pixel is (0, 0).
    pub principal_px: [f64; 2],
    /// Brown–Conrady coefficients k1, k2, p1, p2, k3.
    pub distortion: [f64; 5],
    /// Value of a pixel without light.
    pub black_level: f64,
    /// Value at which a pixel is saturated.
    pub white_level: f64,
    /// Value above black a unit of radiance and second, for R, G and B.
    pub responsivity: [f64; 3],
    /// Electrons a pixel value: with the read noise it gives the standard deviations of the samples.
    pub electrons_per_value: f64,
    /// Read noise, electrons RMS.
    pub read_noise_e: f64,
    /// Shortest exposure.
    pub min_exposure_s: f64,
    /// Longest exposure.
    pub max_exposure_s: f64,
    /// Relative aperture, as written into the frames.
    pub f_number: f64,
    /// How long an exposure waits for the camera's ready output, where the controller has an input for it.
    pub ready_wait_s: f64,
    /// How far the exposure that a frame's EXIF block states must be the controller's.
    pub exif: ExifExposure,
}

/// How far the exposure of an EXIF block must be the controller's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ExifExposure {
    /// Within a third of a stop: cameras write nominal speeds, 1/60 for 1/64.
    #[default]
    Nominal,
    /// Within 2 %.
    Exact,
    /// Not at all; it need not be there.
    Ignore,
}

impl Default for Camera {
    fn default() -> Self {
        Self {
            width: 800,
            height: 600,
            focal_px: [4060.0, 4060.0],
            principal_px: [402.3, 297.6],
            distortion: [-1.2, 5.0, 4e-4, -3e-4, 0.0],
            black_level: 512.0,
            white_level: 16383.0,
            responsivity: [4.2e6, 5.2e6, 3.8e6],
            electrons_per_value: 2.5,
            read_noise_e: 6.0,
            min_exposure_s: 1.0 / 8000.0,
            max_exposure_s: 2.0,
            f_number: 16.0,
            ready_wait_s: 2.0,
            exif: ExifExposure::Nominal,
        }
    }
}

impl Camera {
    /// Value between black and saturation.
    pub fn range(&self) -> f64 {
        self.white_level - self.black_level
    }
}

/// The light source.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Lamp {
    /// Diameter of the aperture, which counts as a radially uniform disc facing the bench's origin.
    pub aperture_diameter_mm: f64,
    /// Radiance of the warm lamp, for R, G and B.
    pub radiance: [f64; 3],
    /// Reading of the reference photodiode with the warm lamp at this radiance.
    pub reference_reading: f64,
    /// Time after switching on before it may be used.
    pub warm_up_s: f64,
    /// The controller puts the lamp to its safe level when it hears nothing for this long; 0 for never. While
    /// a program of ours holds the port, it is heard from every half second, whatever else it does, until it
    /// has asked for nothing itself for ten minutes.
    pub lease_s: f64,
    /// The lamp's level then, 0 to 1; at 0 it is switched off.
    pub safe_level: f64,
    /// The controller puts the lamp out when it has burnt for this long, whatever it hears.
    pub longest_s: f64,
    /// How long the lamp's fan, where the controller has one, runs on when the lamp has gone out.
    pub fan_run_on_s: f64,
}

impl Default for Lamp {
    fn default() -> Self {
        Self {
            aperture_diameter_mm: 10.0,
            radiance: [1000.0, 1000.0, 1000.0],
            reference_reading: 3000.0,
            warm_up_s: 900.0,
            lease_s: 2.0,
            safe_level: 0.0,
            longest_s: 172_800.0,
            fan_run_on_s: 300.0,
        }
    }
}

impl Lamp {
    /// The part of the warm lamp's light that a reading of the photodiode in a dark frame tells of; `None`
    /// when that is darkness: below a hundredth, of which noise and the converter's offset are most.
    pub fn lit(&self, reading: f64) -> Option<f64> {
        let light = reading / self.reference_reading;
        (light.is_nan() || light.abs() > 0.01).then_some(light)
    }

    /// Area A_s of the aperture, mm².
    pub fn aperture_mm2(&self) -> f64 {
        std::f64::consts::PI * (self.aperture_diameter_mm / 2.0).powi(2)
    }
}

/// How exposures are chosen from the geometry of a pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Exposure {
    /// Exposures a pose, 1 to 3.
    pub count: usize,
    /// Reflectance (sr⁻¹) that the longest exposure should still resolve well.
    pub darkest_reflectance: f64,
    /// Reflectance (sr⁻¹) of the brightest highlight, which the shortest exposure must not clip.
    pub brightest_reflectance: f64,
    /// Angle between half vector and normal within which the highlight is expected.
    pub highlight_deg: f64,
    /// Frames averaged for the dark signal, at the shortest and at the longest exposure each.
    pub dark_frames: usize,
}

impl Default for Exposure {
    fn default() -> Self {
        Self {
            count: 2,
            darkest_reflectance: 0.02,
            brightest_reflectance: 3.0,
            highlight_deg: 25.0,
            dark_frames: 3,
        }
    }
}

/// What the simulated rig does besides obeying.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Simulator {
    /// Seed of every random effect.
    pub seed: u64,
    /// Whether positions carry the axes' repeatability error.
    pub repeatability: bool,
    /// Dead band of pan, tilt, roll and light.
    pub backlash_deg: [f64; 4],
    /// Time constant of the lamp's warm-up.
    pub lamp_time_constant_s: f64,
    /// Relative amplitude of the lamp's slow drift.
    pub lamp_drift: f64,
    /// Electrons a pixel value.
    pub electrons_per_value: f64,
    /// Read noise, electrons RMS.
    pub read_noise_e: f64,
    /// Dark signal, electrons a second.
    pub dark_e_s: f64,
    /// Albedo of the tags' white and black and of the carrier.
    pub carrier_albedo: [f64; 3],
}

impl Default for Simulator {
    fn default() -> Self {
        Self {
            seed: 1,
            repeatability: true,
            backlash_deg: [0.1, 0.1, 0.1, 0.02],
            lamp_time_constant_s: 180.0,
            lamp_drift: 0.02,
            electrons_per_value: 2.5,
            read_noise_e: 6.0,
            dark_e_s: 8.0,
            carrier_albedo: [0.75, 0.04, 0.03],
        }
    }
}

impl RigConfig {
    /// Reads and checks a rig's file.
    ///
    /// # Errors
    /// Input errors that name file, line and key.
    pub fn read(path: &Path) -> lobelia_base::Result<Self> {
        let rig: Self = toml_file::read_as(path, toml_file::Kind::Rig)?;
        rig.validate().map_err(|error| error.at(path.display()))?;
        if let Some(unsaid) = toml_file::read(path).ok().and_then(|file| wiring::unsaid(&file, &rig)) {
            progress::note(&format!("{} does not say and so has: {unsaid}", path.display()));
        }
        Ok(rig)
    }

    /// Reads the file of a rig whose photographs are developed, or that a run was begun with.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn read_recorded(path: &Path) -> lobelia_base::Result<Self> {
        let rig: Self = toml_file::read_as(path, toml_file::Kind::Rig)?;
        rig.validate_recorded().map_err(|error| error.at(path.display()))?;
        Ok(rig)
    }

    /// This rig with keys set to other values, to develop a run by: `camera.focal_px=[4100, 4100]`,
    /// `carrier.texels_across=64`.
    ///
    /// # Errors
    /// Input errors that name the setting: no `KEY=VALUE`, an unknown key, a value of another type or out of
    /// range.
    pub fn with_settings(&self, settings: &[String]) -> lobelia_base::Result<Self> {
        let mut file = toml::Value::try_from(self).map_err(|error| {
            lobelia_base::Error::input(format!("the rig's file cannot be read back: {error}"))
                .caused_by(error)
        })?;
        for setting in settings {
            let refused = |why: &str| lobelia_base::Error::input(format!("--set {setting}: {why}"));
            let (key, text) = setting.split_once('=').ok_or_else(|| refused("must be KEY=VALUE"))?;
            let value: toml::Table =
                toml::from_str(&format!("value = {text}")).map_err(|_| refused("the value is no TOML"))?;
            let value = value.get("value").cloned().ok_or_else(|| refused("the value is missing"))?;
            let mut place = &mut file;
            for part in key.trim().split('.') {
                let table = place.as_table_mut().ok_or_else(|| refused("rig.toml has no such key"))?;
                place = table.entry(part).or_insert(toml::Value::Boolean(false));
            }
            // A whole number is as good as one with a fraction.
            *place = match value {
                toml::Value::Integer(number) if place.is_float() => toml::Value::Float(number as f64),
                value => value,
            };
            let read: std::result::Result<Self, _> = file.clone().try_into();
            let read = read.map_err(|error| refused(&lobelia_base::toml_file::plain(error.message())))?;
            read.validate_recorded().map_err(|error| refused(&error.to_string()))?;
        }
        file.try_into()
            .map_err(|error: toml::de::Error| lobelia_base::Error::input(error.message().to_string()))
    }

    /// Angles in degrees (pan, tilt, roll, light) as motor steps, rounded to the nearest.
    pub fn steps(&self, degrees: [f64; 4]) -> [i32; 4] {
        let axes = self.axes.in_order();
        std::array::from_fn(|k| (degrees[k] / axes[k].degrees_per_step).round() as i32)
    }

    /// What the controller has to know.
    ///
    /// # Errors
    /// When a number of the file does not fit the controller's integers.
    pub fn configuration(&self) -> lobelia_base::Result<Configuration> {
        let mut axes = Vec::with_capacity(4);
        for (name, axis) in AXIS_NAMES.iter().zip(self.axes.in_order()) {
            axes.push(axis.parameters().ok_or_else(|| {
                lobelia_base::Error::input(format!("axes.{name} has a number beyond the controller's range"))
            })?);
        }
        // Within the controller's range, as `validate` sees to.
        let lamp_warm_up_s = self.lamp.warm_up_s.ceil() as u16;
        let axes = axes.try_into().map_err(|_| lobelia_base::Error::input("there must be four axes"))?;
        Ok(Configuration {
            axes,
            settings: Settings {
                lamp_warm_up_s,
                // A tenth of what the lamp should give.
                lamp_least_reading: (self.lamp.reference_reading / 10.0) as u16,
                lease_ms: milliseconds(self.motion.lease_s),
                lamp_lease_ms: milliseconds(self.lamp.lease_s),
                lamp_safe_level: (self.lamp.safe_level.clamp(0.0, 1.0) * 65535.0).round() as u16,
                lamp_longest_s: self.lamp.longest_s.ceil() as u32,
                fan_run_on_s: self.lamp.fan_run_on_s.ceil() as u16,
                camera_wait_ms: milliseconds(self.camera.ready_wait_s) as u16,
                coordinated: self.motion.coordinated,
                pulse_us: self.motion.pulse_us,
                direction_setup_us: self.motion.direction_setup_us,
                inverted: self.wiring.invert.iter().copied().collect(),
            },
            keep_outs: self.keep_outs().ok_or_else(|| {
                lobelia_base::Error::input("rig.toml: keep_out has a number beyond the controller's range")
            })?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_replace_single_keys_and_wrong_ones_are_named() {
        let rig = RigConfig::default();
        let set = |settings: &[&str]| {
            rig.with_settings(&settings.iter().map(ToString::to_string).collect::<Vec<_>>())
        };
        let changed =
            set(&["camera.focal_px=[4100.5, 4099]", "carrier.texels_across=64", "camera.read_noise_e = 3"])
                .unwrap();
        let mut expected = rig.clone();
        (expected.camera.focal_px, expected.carrier.texels_across) = ([4100.5, 4099.0], 64);
        expected.camera.read_noise_e = 3.0;
        assert_eq!(changed, expected);
        assert_eq!(set(&["carrier.cylinder_radius_mm=40"]).unwrap().carrier.cylinder_radius_mm, Some(40.0));
        for (setting, part) in [
            ("camera.focal_px", "KEY=VALUE"),
            ("camera.focal=3", "unknown field"),
            ("camera.focal_px.x=3", "no such key"),
            ("camera.width=\"wide\"", "expected a whole number"),
            ("carrier.texels_across=1e5", "the number `100000.0`, expected a whole number"),
            ("camera.white_level=10", "white_level"),
            ("camera.f_number=", "no TOML"),
        ] {
            let message = set(&[setting]).unwrap_err().to_string();
            assert!(
                message.contains(setting) && message.contains(part) && !message.contains('\n'),
                "{message}"
            );
        }
    }

    #[test]
    fn the_default_file_survives_toml_and_is_valid() {
        let text = toml::to_string(&RigConfig::default()).unwrap();
        let read: RigConfig = lobelia_base::toml_file::parse(&text, "rig.toml").unwrap();
        assert_eq!(read, RigConfig::default());
        read.validate().unwrap();
        assert_eq!(read.carrier.tags.len(), 16);
        assert_eq!(read.carrier.texels_down(), 128);
    }
}
