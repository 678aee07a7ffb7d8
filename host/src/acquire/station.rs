//! The station: the rig's controller and the camera that is fired with it, real or simulated.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, SystemTime};

use lobelia_protocol::Exposure;

use super::judge;
pub use super::watch::WatchedFolder;
use super::watch::{self, Arrival};
use crate::develop::frame::RawFrame;
use crate::error::{Error, Result};
use crate::progress;
use crate::rig::RigClient;
use crate::rig::config::RigConfig;
use crate::rig::geometry::MotorAngles;

/// How often a shot is made until its photograph is right.
const TRIES: usize = 3;

/// Name of the folder in a run's for photographs that were put aside.
const ASIDE: &str = "aside";

/// One photograph to take.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shot<'a> {
    /// Time that the shutter shall be open, s.
    pub open_s: f64,
    /// Whether the lamp must be warm; false for dark frames.
    pub warm_lamp: bool,
    /// Where the motors stand, by which the tags are expected; `None` for dark frames.
    pub angles: Option<MotorAngles>,
    /// The dark frames before this one, of as long exposures or shorter ones; none before a pose's.
    pub darks: &'a [RawFrame],
    /// What the photograph is (kind, pose, exposure), from which a simulated camera draws its noise.
    pub key: [u64; 3],
}

/// Something that turns an exposure into a file.
pub enum Camera {
    /// Software that stores the camera's photographs in a folder.
    Watch(Box<WatchedFolder>),
    /// The simulated camera on the simulated rig.
    #[cfg(feature = "sim")]
    Simulated(Box<crate::acquire::simulated::SimulatedCamera>),
}

impl Camera {
    /// Puts aside what a watched folder holds of earlier shots, or what comes within a time.
    fn drain(&mut self, aside: &Path, within: Duration) -> Result<()> {
        match self {
            Self::Watch(folder) => folder.drain(aside, within),
            #[cfg(feature = "sim")]
            Self::Simulated(_) => Ok(()),
        }
    }
}

/// Set by the first Ctrl-C, see [`catch_interrupts`].
static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// From now on Ctrl-C asks a run to end after the photograph in hand, with the rig at rest, instead of killing it.
pub fn catch_interrupts() {
    // A second handler in one process is refused; the first one serves.
    let _ = ctrlc::set_handler(|| INTERRUPTED.store(true, Ordering::Relaxed));
}

/// Whether Ctrl-C was pressed since it is caught.
pub fn interrupted() -> bool {
    INTERRUPTED.load(Ordering::Relaxed)
}

/// Fails once the user has asked to stop.
pub(super) fn check_interrupt() -> Result<()> {
    if interrupted() {
        return Err(Error::failure("interrupted; the run can be continued with --resume"));
    }
    Ok(())
}

/// The controller and the camera.
pub struct Station {
    /// The controller.
    pub client: RigClient,
    /// The camera.
    pub camera: Camera,
}

impl Station {
    /// Connects both; Ctrl-C (if caught) stops the rig.
    pub fn new(mut client: RigClient, camera: Camera) -> Self {
        client.set_interrupt(interrupted);
        Self { client, camera }
    }

    /// Whether the controller knows where all axes are.
    pub(super) fn homed(&mut self) -> Result<bool> {
        Ok(self.client.status()?.known.iter().all(|&known| known))
    }

    /// Whether rig and camera are simulated.
    pub(super) fn is_simulated(&self) -> bool {
        match &self.camera {
            Camera::Watch(_) => false,
            #[cfg(feature = "sim")]
            Camera::Simulated(_) => true,
        }
    }

    /// The controller's clock, µs. A simulated rig is asked directly, so that asking takes no time.
    pub(super) fn clock_us(&mut self) -> Result<u64> {
        #[cfg(feature = "sim")]
        if let Camera::Simulated(camera) = &self.camera {
            return Ok(camera.rig().now_us());
        }
        Ok(self.client.status()?.uptime_us)
    }

    /// Lets a simulated rig's clock run on; a real rig's does so by itself.
    pub(super) fn idle_until_us(&mut self, time_us: u64) {
        #[cfg(feature = "sim")]
        if let Camera::Simulated(camera) = &self.camera {
            camera.rig().idle_until_us(time_us);
        }
        #[cfg(not(feature = "sim"))]
        let _ = time_us;
    }

    /// Takes a photograph into `file`, which appears whole or not at all. One that is wrong, late or lost is put aside and the shot
    /// repeated a few times.
    ///
    /// # Errors
    /// Failures of the rig; when no try gave a right photograph, with what was wrong with the last; on Ctrl-C.
    pub(super) fn photograph(
        &mut self,
        config: &RigConfig,
        file: &Path,
        shot: &Shot<'_>,
    ) -> Result<Exposure> {
        let mut last = String::new();
        for attempt in 1..=TRIES {
            match self.try_shot(config, file, shot)? {
                Ok(exposure) => return Ok(exposure),
                Err(why) => {
                    progress::note(&format!("{}, try {attempt} of {TRIES}: {why}", name(file)));
                    last = why;
                }
            }
        }
        Err(Error::failure(format!("{}: no right photograph in {TRIES} tries: {last}", name(file))))
    }

    /// One try; the inner error says what was wrong with it.
    fn try_shot(
        &mut self,
        config: &RigConfig,
        file: &Path,
        shot: &Shot<'_>,
    ) -> Result<std::result::Result<Exposure, String>> {
        let duration_us = (shot.open_s * 1e6).round() as u32;
        let aside = file.parent().and_then(Path::parent).unwrap_or(Path::new(".")).join(ASIDE);
        self.camera.drain(&aside, Duration::ZERO)?;
        let began = SystemTime::now();
        let exposure = match self.client.expose_or_late(duration_us, shot.warm_lamp)? {
            Ok(exposure) => exposure,
            Err(late_us) => {
                self.camera.drain(&aside, watch::GRACE)?;
                return Ok(Err(format!("the shutter closed {late_us} µs late")));
            }
        };
        match &mut self.camera {
            Camera::Watch(folder) => {
                let open_s = f64::from(exposure.open_us) / 1e6;
                let judged = |photograph: &_| judge::judge(config, shot, open_s, photograph);
                match folder.collect(began, &judged, file, &aside)? {
                    Arrival::Taken => Ok(Ok(exposure)),
                    Arrival::Missing { why, again: true } => Ok(Err(why)),
                    Arrival::Missing { why, again: false } => Err(Error::input(why)),
                }
            }
            #[cfg(feature = "sim")]
            Camera::Simulated(camera) => {
                camera.store(file, shot)?;
                Ok(Ok(exposure))
            }
        }
    }

    /// Motors at rest, lamp off, even after Ctrl-C.
    pub(super) fn rest(&mut self) -> Result<()> {
        self.client.rest()
    }
}

fn name(file: &Path) -> String {
    file.file_name().unwrap_or_default().to_string_lossy().into_owned()
}
