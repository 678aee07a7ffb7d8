//! The station: the rig's controller and the camera that is fired with it, real or simulated.

use std::path::Path;
use std::time::{Duration, SystemTime};

use lobelia_base::error::{Error, Result};
use lobelia_base::interrupt::interrupted;
use lobelia_base::progress;
use lobelia_protocol::Exposure;

use super::camera::{Arrival, Camera, Clock, Fired, GRACE, Shot};
use crate::rig::RigClient;
use crate::rig::config::RigConfig;

/// How often a shot is made until its photograph is right.
const TRIES: usize = 3;

/// Name of the folder in a run's for photographs that were put aside.
const ASIDE: &str = "aside";

/// The controller and the camera.
pub struct Station {
    /// The controller.
    pub client: RigClient,
    camera: Box<dyn Camera>,
    /// Of a simulated rig.
    clock: Option<Box<dyn Clock>>,
}

impl Station {
    /// Connects both; Ctrl-C (if caught) stops the rig.
    pub fn new(mut client: RigClient, camera: Box<dyn Camera>) -> Self {
        client.set_interrupt(interrupted);
        Self { client, camera, clock: None }
    }

    /// A simulated station, whose time passes only while it is used.
    pub fn simulated(client: RigClient, camera: Box<dyn Camera>, clock: Box<dyn Clock>) -> Self {
        Self { clock: Some(clock), ..Self::new(client, camera) }
    }

    /// Whether the controller knows where all axes are.
    pub(super) fn homed(&mut self) -> Result<bool> {
        Ok(self.client.status()?.known.iter().all(|&known| known))
    }

    /// Whether rig and camera are simulated.
    pub(super) fn is_simulated(&self) -> bool {
        self.clock.is_some()
    }

    /// The controller's clock, µs. A simulated rig is asked directly, so that asking takes no time.
    pub(super) fn clock_us(&mut self) -> Result<u64> {
        match &self.clock {
            Some(clock) => Ok(clock.now_us()),
            None => Ok(self.client.status()?.uptime_us),
        }
    }

    /// Lets a simulated rig's clock run on; a real rig's does so by itself.
    pub(super) fn idle_until_us(&mut self, time_us: u64) {
        if let Some(clock) = &self.clock {
            clock.idle_until_us(time_us);
        }
    }

    /// Takes a photograph into `file`, which appears whole or not at all. One that is wrong, late or lost is
    /// put aside and the shot repeated a few times.
    ///
    /// # Errors
    /// Failures of the rig; when no try gave a right photograph, with what was wrong with the last; on
    /// Ctrl-C.
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
                self.camera.drain(&aside, GRACE)?;
                return Ok(Err(format!("the shutter closed {late_us} µs late")));
            }
        };
        let open_s = f64::from(exposure.open_us) / 1e6;
        let fired = Fired { config, shot, began, open_s, file, aside: &aside };
        match self.camera.take(&fired)? {
            Arrival::Taken => Ok(Ok(exposure)),
            Arrival::Missing { why, again: true } => Ok(Err(why)),
            Arrival::Missing { why, again: false } => Err(Error::input(why)),
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
