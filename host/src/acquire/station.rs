//! The station: the rig's controller and the camera that is fired with it, real or simulated.

use std::collections::{HashMap, HashSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime};

use lobelia_protocol::Exposure;

use crate::develop::frame;
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
    /// Software that stores the camera's photographs in a folder; the first whole frame that is new after a shot is the photograph.
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

/// Size and time of change of a file, by which a changed one is known.
type Seen = Option<(u64, Option<SystemTime>)>;

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

    /// Waits for a photograph that was not there before and is whole, and moves it to `file`. Software may store in pieces, with
    /// pauses, and leave other files beside: a file counts once it reads as a frame.
    fn collect(&self, before: &HashSet<PathBuf>, file: &Path) -> Result<()> {
        const LOOK_AGAIN: Duration = Duration::from_millis(50);
        let deadline = Instant::now() + self.timeout;
        // Files that did not read as a frame, as they were then.
        let mut refused: HashMap<PathBuf, (Seen, Error)> = HashMap::new();
        while Instant::now() < deadline {
            let mut new: Vec<_> = self.files()?.into_iter().filter(|path| !before.contains(path)).collect();
            new.sort();
            for path in new {
                let seen = fs::metadata(&path).ok().map(|meta| (meta.len(), meta.modified().ok()));
                if refused.get(&path).is_some_and(|(before, _)| *before == seen) {
                    continue;
                }
                match take(&path, file)? {
                    Ok(()) => return Ok(()),
                    Err(reason) => refused.insert(path, (seen, reason)),
                };
            }
            std::thread::sleep(LOOK_AGAIN);
        }
        let seconds = self.timeout.as_secs_f64();
        let hint = match refused.into_iter().min_by(|a, b| a.0.cmp(&b.0)) {
            Some((_, (_, reason))) => format!("what came is none: {reason}"),
            None => "is the camera's software storing here?".into(),
        };
        let folder = self.path.display();
        Err(Error::failure(format!("{folder}: no photograph arrived within {seconds} s; {hint}")))
    }
}

/// Copies a photograph under a temporary name, renames it, and removes the original. The inner error says why the file is not a
/// frame, or not yet.
fn take(from: &Path, to: &Path) -> Result<Result<()>> {
    let bytes = fs::read(from).map_err(|error| Error::reading(from, error))?;
    if bytes.starts_with(&frame::JPEG_START) {
        let message = "the camera stored a JPEG, which is not linear; set it to store 16-bit TIFF files";
        return Err(Error::input(format!("{}: {message}", from.display())));
    }
    if let Err(reason) = frame::decode(&bytes, from) {
        return Ok(Err(reason));
    }
    crate::files::write_bytes(to, &bytes)?;
    fs::remove_file(from).map_err(|error| Error::writing(from, error))?;
    Ok(Ok(()))
}

#[cfg(all(test, feature = "sim"))]
#[allow(clippy::unwrap_used, reason = "clippy does not see that this is a test module")]
mod tests {
    use super::*;
    use lobelia_hil_sim::optics::frame::{FrameNotes, write_tiff};
    use std::io::Cursor;

    fn frame() -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        let notes = FrameNotes { exposure_s: 0.1, f_number: 16.0, taken_s: 5 };
        write_tiff(&mut bytes, 8, 6, &[7; 48], &notes).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn a_watched_folder_gives_the_new_frame_once_it_is_whole_and_leaves_all_else() {
        let (folder, target) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        fs::write(folder.path().join("old.tiff"), frame()).unwrap();
        let watched = WatchedFolder::new(folder.path(), Duration::from_secs(20)).unwrap();
        let before = watched.files().unwrap();
        let (sidecar, new) = (folder.path().join("new.log"), folder.path().join("new.tiff"));
        fs::write(&sidecar, b"stored").unwrap();
        let bytes = frame();
        fs::write(&new, &bytes[..bytes.len() / 2]).unwrap();
        let file = target.path().join("frame.tiff");
        std::thread::scope(|scope| {
            // Longer than it takes to look twice.
            scope.spawn(|| {
                std::thread::sleep(Duration::from_millis(150));
                fs::write(&new, &bytes).unwrap();
            });
            watched.collect(&before, &file).unwrap();
        });
        assert_eq!(fs::read(&file).unwrap(), bytes);
        fs::remove_file(sidecar).unwrap();
        assert_eq!(watched.files().unwrap(), before);
    }

    #[test]
    fn a_photograph_that_does_not_arrive_is_a_failure_that_says_what_came() {
        let folder = tempfile::tempdir().unwrap();
        let watched = WatchedFolder::new(folder.path(), Duration::from_millis(120)).unwrap();
        let collect = || watched.collect(&HashSet::new(), &folder.path().join("x")).unwrap_err();
        assert_eq!(collect().exit_code(), 1);
        assert!(collect().to_string().contains("storing here?"));
        fs::write(folder.path().join("half.tiff"), &frame()[..60]).unwrap();
        assert!(collect().to_string().contains("half.tiff: the frame is truncated"));
        fs::write(folder.path().join("a.jpg"), b"\xff\xd8\xff\xe0\x00\x10JFIF").unwrap();
        assert_eq!(collect().exit_code(), 2);
        assert!(WatchedFolder::new(&folder.path().join("gone"), Duration::ZERO).is_err());
    }
}
