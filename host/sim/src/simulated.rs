//! The simulated station: the firmware on simulated mechanics, and a camera that photographs a known sample.

use std::fs::OpenOptions;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::time::Duration;

use lobelia_hil_sim::optics::bench::PrintedTag;
use lobelia_hil_sim::optics::frame::{FrameNotes, write_tiff};
use lobelia_hil_sim::optics::noise;
use lobelia_hil_sim::optics::{
    BenchConfig, CameraModel, OpticalBench, RadianceImage, SampleLayout, SensorModel,
};
use lobelia_hil_sim::{AxisMechanics, LampConfig, MechanicsConfig, SimulatedLink, SimulatedRig, Wiring};
use serde::{Deserialize, Serialize};

use lobelia_base::error::{Error, Result};
use lobelia_base::files;
use lobelia_measure::acquire::camera::{Arrival, Camera, Clock, Fired, Shot};
use lobelia_measure::acquire::station::Station;
use lobelia_measure::rig::config::{Axis, RigConfig};
use lobelia_measure::rig::trace::Step;
use lobelia_measure::rig::{Port, RigClient};

/// Name of the file in a simulated run's folder that says where the axes really were.
pub const TRUTH_FILE: &str = "truth.jsonl";

/// Where the axes really were for one photograph.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// What was photographed: kind (0 dark, 1 pose), pose, exposure.
    pub key: [u64; 3],
    /// True angles of pan, tilt, roll and light, rad.
    pub axes_rad: [f64; 4],
    /// True radiance of the lamp, relative to nominal.
    pub lamp_relative: f64,
}

/// A camera on a simulated rig.
pub struct SimulatedCamera {
    rig: SimulatedRig,
    bench: OpticalBench,
    seed: u64,
    f_number: f64,
    /// The last radiance image and the angles that it belongs to: a bracket's frames share it.
    last: Option<([f64; 4], RadianceImage)>,
}

impl SimulatedCamera {
    /// Writes what the sensor recorded of the exposure just made.
    fn store(&mut self, file: &Path, shot: &Shot<'_>) -> Result<()> {
        let truth =
            self.rig.last_exposure().ok_or_else(|| Error::failure("the simulated shutter never opened"))?;
        let stale = self.last.as_ref().is_none_or(|(angles, _)| *angles != truth.axes_rad);
        if stale {
            self.last = Some((truth.axes_rad, self.bench.radiance(truth.axes_rad)));
        }
        let Some((_, image)) = &self.last else {
            return Err(Error::failure("the simulated camera has no image"));
        };
        let [kind, pose, exposure] = shot.key;
        let key = noise::combine(&[self.seed, kind, pose, exposure]);
        let values = self.bench.record(image, truth.lamp_relative, truth.open_s, key);
        let notes = FrameNotes {
            exposure_s: truth.open_s,
            f_number: self.f_number,
            taken_s: truth.start_us / 1_000_000,
        };
        let camera = &self.bench.config().camera;
        let mut bytes = std::io::Cursor::new(Vec::with_capacity(2 * values.len() + 1024));
        write_tiff(&mut bytes, camera.width, camera.height, &values, &notes)
            .map_err(|error| Error::writing(file, error))?;
        files::write_bytes(file, bytes.get_ref())?;
        self.note_truth(
            file,
            Truth { key: shot.key, axes_rad: truth.axes_rad, lamp_relative: truth.lamp_relative },
        )
    }

    /// Appends to the truth file beside the frames' folder.
    fn note_truth(&self, file: &Path, truth: Truth) -> Result<()> {
        let folder = file.parent().and_then(Path::parent).unwrap_or(Path::new("."));
        let path = folder.join(TRUTH_FILE);
        let mut line =
            serde_json::to_vec(&truth).map_err(|error| Error::failure(error.to_string()).caused_by(error))?;
        line.push(b'\n');
        append_line(&path, &line).map_err(|error| Error::writing(&path, error))
    }
}

impl Camera for SimulatedCamera {
    fn drain(&mut self, _: &Path, _: Duration) -> Result<()> {
        Ok(())
    }

    fn take(&mut self, fired: &Fired<'_>) -> Result<Arrival> {
        self.store(fired.file, fired.shot)?;
        Ok(Arrival::Taken)
    }
}

/// A link to a simulated rig, as a port.
struct Link(SimulatedLink);

impl Read for Link {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        self.0.read(into)
    }
}

impl Write for Link {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

impl Port for Link {
    fn set_read_timeout(&mut self, timeout: Duration) -> io::Result<()> {
        self.0.set_timeout(timeout);
        Ok(())
    }

    fn steps(&mut self) -> Option<Vec<Step>> {
        let steps = self.0.take_steps();
        let first = steps.first().map_or(0, |step| step.at_us);
        let step = |step: lobelia_hil_sim::Step| Step {
            axis: step.axis,
            up: step.up,
            at_us: (step.at_us - first) as u32,
        };
        Some(steps.into_iter().map(step).collect())
    }

    fn is_real_time(&self) -> bool {
        false
    }
}

/// A port to a simulated rig.
pub fn port(rig: &SimulatedRig) -> Box<dyn Port> {
    Box::new(Link(rig.link()))
}

/// The simulated rig's clock.
struct RigClock(SimulatedRig);

impl Clock for RigClock {
    fn now_us(&self) -> u64 {
        self.0.now_us()
    }

    fn idle_until_us(&self, time_us: u64) {
        self.0.idle_until_us(time_us);
    }
}

/// Appends a line; one before it that a kill has torn is ended first, so that it spoils nothing but itself.
fn append_line(path: &Path, line: &[u8]) -> std::io::Result<()> {
    let mut file = OpenOptions::new().read(true).append(true).create(true).open(path)?;
    let mut last = [b'\n'];
    if file.metadata()?.len() > 0 {
        file.seek(SeekFrom::End(-1))?;
        file.read_exact(&mut last)?;
    }
    let ending: &[u8] = if last == [b'\n'] { b"" } else { b"\n" };
    file.write_all(&[ending, line].concat())
}

/// Reads the truth of a simulated run: the true axis angles a pose.
///
/// # Errors
/// Input errors for a missing or damaged file.
pub fn read_truth(run: &Path, poses: usize) -> Result<Vec<[f64; 4]>> {
    let path = run.join(TRUTH_FILE);
    let mut angles = vec![None; poses];
    for (index, line) in files::read_text(&path)?.lines().enumerate() {
        // A line torn by a kill belongs to a photograph that was taken again.
        let Ok(truth) = serde_json::from_str::<Truth>(line) else { continue };
        if let ([1, pose, _], true) = (truth.key, truth.key[1] < poses as u64) {
            angles[pose as usize] = Some(truth.axes_rad);
        } else if truth.key[0] > 1 {
            return Err(Error::input(format!("{}, line {}: unknown kind", path.display(), index + 1)));
        }
    }
    let missing = || Error::input(format!("{}: not all poses are there", path.display()));
    angles.into_iter().collect::<Option<Vec<_>>>().ok_or_else(missing)
}

/// Builds the bench that `rig.toml` describes, with `sample` on the carrier.
pub fn bench(config: &RigConfig, sample: SampleLayout) -> OpticalBench {
    let (camera, simulator) = (&config.camera, &config.simulator);
    let tags = &config.carrier.tags;
    let reach = tags.iter().map(|tag| tag.x_mm.abs().max(tag.y_mm.abs())).fold(0.0, f64::max);
    OpticalBench::new(BenchConfig {
        camera: CameraModel {
            width: camera.width,
            height: camera.height,
            focal_px: camera.focal_px,
            principal_px: camera.principal_px,
            distortion: camera.distortion,
        },
        sensor: SensorModel {
            responsivity: camera.responsivity,
            black_level: camera.black_level,
            white_level: camera.white_level,
            electrons_per_value: simulator.electrons_per_value,
            read_noise_e: simulator.read_noise_e,
            dark_e_s: simulator.dark_e_s,
        },
        camera_distance_mm: config.geometry.camera_distance_mm,
        light_radius_mm: config.geometry.light_radius_mm,
        carrier_offset_mm: config.geometry.carrier_offset_mm,
        aperture_diameter_mm: config.lamp.aperture_diameter_mm,
        lamp_radiance: config.lamp.radiance,
        tag_size_mm: config.carrier.tag_size_mm,
        carrier_half_mm: reach + config.carrier.tag_size_mm * 0.75,
        tags: tags.iter().map(|tag| PrintedTag { id: tag.id, centre_mm: [tag.x_mm, tag.y_mm] }).collect(),
        carrier_albedo: simulator.carrier_albedo,
        sample,
        cylinder_radius_mm: config.carrier.cylinder_radius_mm,
    })
}

/// A simulated rig and its camera with `sample` on the carrier, ready to run.
///
/// # Errors
/// When the simulated controller does not answer.
pub fn station(config: &RigConfig, sample: SampleLayout) -> Result<Station> {
    let rig = SimulatedRig::new(&mechanics(config));
    station_of(&rig, port(&rig), config, sample)
}

/// The same with a rig that there is already, over a port to it.
///
/// # Errors
/// When the simulated controller does not answer.
pub fn station_of(
    rig: &SimulatedRig,
    port: Box<dyn Port>,
    config: &RigConfig,
    sample: SampleLayout,
) -> Result<Station> {
    let camera = SimulatedCamera {
        rig: rig.clone(),
        bench: bench(config, sample),
        seed: config.simulator.seed,
        f_number: config.camera.f_number,
        last: None,
    };
    let client = RigClient::connect(port)?;
    Ok(Station::simulated(client, Box::new(camera), Box::new(RigClock(rig.clone()))))
}

/// Asks the firmware whether a controller takes a rig's numbers, before anything is planned or done with
/// them. Drivers are left out: which there are is the board's.
///
/// # Errors
/// An input error that names the number.
pub fn accepts(config: &RigConfig) -> Result<()> {
    let mut bare = config.clone();
    for axis in [&mut bare.axes.pan, &mut bare.axes.tilt, &mut bare.axes.roll, &mut bare.axes.light] {
        axis.driver = None;
    }
    let rig = SimulatedRig::new(&mechanics(&bare));
    RigClient::connect(port(&rig))?.configure(&bare.configuration()?)
}

/// The simulated mechanics and lamp that `rig.toml` describes.
pub fn mechanics(config: &RigConfig) -> MechanicsConfig {
    let simulator = &config.simulator;
    let axis = |k: usize| {
        let axis: &Axis = config.axes.in_order()[k];
        AxisMechanics {
            degrees_per_step: axis.degrees_per_step,
            repeatability_deg: if simulator.repeatability { axis.repeatability_deg } else { 0.0 },
            backlash_deg: simulator.backlash_deg[k],
            limits_deg: [axis.min_deg, axis.max_deg],
            home_switch_deg: axis.home_deg,
            stops_deg: [axis.home_deg - axis.home_switch_deg, axis.max_deg + 10.0],
            start_deg: 0.5 * (axis.min_deg + axis.max_deg),
            max_speed_deg_s: axis.max_speed_deg_s,
            acceleration_deg_s2: axis.acceleration_deg_s2,
            jerk_deg_s3: axis.jerk_deg_s3,
            ..AxisMechanics::pan()
        }
    };
    let lamp = LampConfig {
        warm_up_time_constant_s: simulator.lamp_time_constant_s,
        warm_up_s: config.lamp.warm_up_s.ceil() as u16,
        drift_amplitude: simulator.lamp_drift,
        photodiode_counts: config.lamp.reference_reading,
        ..LampConfig::default()
    };
    let wiring = Wiring {
        axes: config.axes.in_order().map(|axis| axis.invert.iter().copied().collect()),
        rest: config.wiring.invert.iter().copied().collect(),
    };
    MechanicsConfig {
        seed: simulator.seed,
        pan: axis(0),
        tilt: axis(1),
        roll: axis(2),
        light: axis(3),
        lamp,
        wiring,
        ..MechanicsConfig::default()
    }
}
