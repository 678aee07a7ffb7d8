//! The station: the rig's controller and the camera that is fired with it, real or simulated.

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use lobelia_protocol::Exposure;

use crate::error::{Error, Result};
use crate::rig::RigClient;

/// One photograph to take.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shot {
    /// Time that the shutter shall be open, s.
    pub open_s: f64,
    /// Whether the lamp must be warm; false for dark frames.
    pub warm_lamp: bool,
    /// What the photograph is (kind, pose, exposure), from which a simulated camera draws its noise.
    pub key: [u64; 3],
}

/// Something that turns an exposure into a file.
pub enum Camera {
    /// Software that stores the camera's photographs in a folder; the newest file after a shot is the photograph.
    Watch(WatchedFolder),
    /// The simulated camera on the simulated rig.
    #[cfg(feature = "sim")]
    Simulated(Box<crate::acquire::simulated::SimulatedCamera>),
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

    /// Fails once the user has asked to stop.
    pub(super) fn check_interrupt(&self) -> Result<()> {
        if interrupted() {
            return Err(Error::failure("interrupted; the run can be continued with --resume"));
        }
        Ok(())
    }

    /// Whether the controller knows where all axes are.
    pub(super) fn homed(&mut self) -> Result<bool> {
        Ok(self.client.status()?.known.iter().all(|&known| known))
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

    /// Takes a photograph into `file`, which appears whole or not at all.
    pub(super) fn photograph(&mut self, file: &Path, shot: &Shot) -> Result<Exposure> {
        let duration_us = (shot.open_s * 1e6).round() as u32;
        match &mut self.camera {
            Camera::Watch(folder) => {
                let before = folder.files()?;
                let exposure = self.client.expose(duration_us, shot.warm_lamp)?;
                folder.collect(&before, file)?;
                Ok(exposure)
            }
            #[cfg(feature = "sim")]
            Camera::Simulated(camera) => {
                let exposure = self.client.expose(duration_us, shot.warm_lamp)?;
                camera.store(file, shot)?;
                Ok(exposure)
            }
        }
    }

    /// Motors at rest, lamp off.
    pub(super) fn rest(&mut self) -> Result<()> {
        self.client.stop()?;
        self.client.lamp(false, 0.0)
    }
}

/// A folder into which other software stores photographs.
pub struct WatchedFolder {
    path: PathBuf,
    timeout: Duration,
}

impl WatchedFolder {
    /// Watches `path`; a photograph that has not arrived after `timeout` is an error.
    ///
    /// # Errors
    /// When the folder is not there.
    pub fn new(path: &Path, timeout: Duration) -> Result<Self> {
        if !path.is_dir() {
            return Err(Error::input(format!("{}: the folder to watch is not there", path.display())));
        }
        Ok(Self { path: path.into(), timeout })
    }

    /// The files that are there.
    fn files(&self) -> Result<HashSet<PathBuf>> {
        let entries = fs::read_dir(&self.path).map_err(|error| Error::reading(&self.path, error))?;
        Ok(entries.filter_map(|entry| Some(entry.ok()?.path())).filter(|path| path.is_file()).collect())
    }

    /// Waits for a file that was not there before and has stopped growing, and moves it to `file`.
    fn collect(&self, before: &HashSet<PathBuf>, file: &Path) -> Result<()> {
        const LOOK_AGAIN: Duration = Duration::from_millis(50);
        let deadline = Instant::now() + self.timeout;
        let mut last: Option<(PathBuf, u64)> = None;
        while Instant::now() < deadline {
            let newest = self.files()?.into_iter().filter(|path| !before.contains(path)).min();
            let size = newest.as_ref().and_then(|path| fs::metadata(path).ok()).map_or(0, |meta| meta.len());
            let now = newest.map(|path| (path, size));
            if let (Some((path, size)), true) = (&now, now == last)
                && *size > 0
            {
                return take(path, file);
            }
            last = now;
            std::thread::sleep(LOOK_AGAIN);
        }
        let seconds = self.timeout.as_secs_f64();
        let message =
            format!("no photograph arrived within {seconds} s; is the camera's software storing here?");
        Err(Error::failure(format!("{}: {message}", self.path.display())))
    }
}

/// Copies a photograph under a temporary name, renames it, and removes the original.
fn take(from: &Path, to: &Path) -> Result<()> {
    let bytes = fs::read(from).map_err(|error| Error::reading(from, error))?;
    if bytes.starts_with(&crate::develop::frame::JPEG_START) {
        let message =
            "the camera stored a JPEG, which is not linear; set it to store raw or 16-bit TIFF files";
        return Err(Error::input(format!("{}: {message}", from.display())));
    }
    crate::files::write_bytes(to, &bytes)?;
    fs::remove_file(from).map_err(|error| Error::writing(from, error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_watched_folder_gives_the_new_file_and_leaves_the_old() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("old.tiff"), b"old").unwrap();
        let watched = WatchedFolder::new(folder.path(), Duration::from_secs(20)).unwrap();
        let before = watched.files().unwrap();
        fs::write(folder.path().join("new.tiff"), b"new").unwrap();
        let target = tempfile::tempdir().unwrap();
        let file = target.path().join("frame.tiff");
        watched.collect(&before, &file).unwrap();
        assert_eq!(fs::read(&file).unwrap(), b"new");
        assert_eq!(watched.files().unwrap(), before);
    }

    #[test]
    fn a_photograph_that_does_not_arrive_is_a_failure() {
        let folder = tempfile::tempdir().unwrap();
        let watched = WatchedFolder::new(folder.path(), Duration::from_millis(120)).unwrap();
        let error = watched.collect(&HashSet::new(), &folder.path().join("x")).unwrap_err();
        assert_eq!(error.exit_code(), 1);
        assert!(WatchedFolder::new(&folder.path().join("gone"), Duration::ZERO).is_err());
    }
}
