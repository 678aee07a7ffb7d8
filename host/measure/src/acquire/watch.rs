//! A folder into which other software stores photographs: which files are new, whole and of the shot just
//! made.
//!
//! A file counts as whole when its size and its time of change have stood still for a while and it reads as a
//! frame; it is of the shot when it passes the [judge](super::judge) and the camera's clock does not say
//! otherwise. What was there before the run is left alone.

use std::collections::{HashMap, HashSet};
use std::fs;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use lobelia_base::hash::sha256;

use super::camera::{Arrival, Camera, Fired, GRACE};
use super::check_interrupt;
use super::judge::{self, Fault};
use crate::develop::frame::{self, Photograph};
use lobelia_base::error::{Error, Result};
use lobelia_base::{files, progress};

/// A file counts as whole when nothing of it has changed for so long.
const STILL: Duration = Duration::from_millis(500);

/// Between two looks at the folder.
const LOOK_AGAIN: Duration = Duration::from_millis(50);

/// Size and time of change of a file, by which a changed one is known.
type Seen = (u64, Option<SystemTime>);

/// A folder into which other software stores photographs.
pub struct WatchedFolder {
    path: PathBuf,
    timeout: Duration,
    /// Files that are no news, as they were when they were last seen.
    known: HashMap<PathBuf, Seen>,
    /// Files that are new, and since when they are as they are.
    arriving: HashMap<PathBuf, (Seen, Instant)>,
    begun: bool,
    /// Hashes of the photographs taken so far.
    taken: HashSet<String>,
    clock: CameraClock,
}

impl Camera for WatchedFolder {
    /// Before a shot: what is there at the run's start is left alone; photographs that came too late for an
    /// earlier shot are put into the folder `aside`. One that is sure to come is waited for as long as
    /// `patience`.
    ///
    /// # Errors
    /// When a folder cannot be read or written; on Ctrl-C.
    fn drain(&mut self, aside: &Path, patience: Duration) -> Result<()> {
        if !std::mem::replace(&mut self.begun, true) {
            self.known = self.files()?;
        }
        let patience = Instant::now() + patience;
        let mut deadline = patience + STILL + GRACE;
        let mut came = false;
        loop {
            let news = self.look()?;
            for path in self.whole() {
                if self.put_aside(&path, aside, LATE)? {
                    (came, deadline) = (true, Instant::now() + STILL + GRACE);
                }
            }
            let now = Instant::now();
            if (!news && (came || now >= patience)) || now >= deadline {
                return Ok(());
            }
            check_interrupt()?;
            std::thread::sleep(LOOK_AGAIN);
        }
    }

    fn take(&mut self, fired: &Fired<'_>) -> Result<Arrival> {
        let judged = |photograph: &_| judge::judge(fired.config, fired.shot, fired.open_s, photograph);
        self.collect(fired.began, &judged, fired.file, fired.aside)
    }
}

impl WatchedFolder {
    /// Watches `path`; a photograph that has not arrived after `timeout` counts as lost.
    ///
    /// # Errors
    /// When the folder is not there.
    pub fn new(path: &Path, timeout: Duration) -> Result<Self> {
        if !path.is_dir() {
            return Err(Error::input(format!("{}: the folder to watch is not there", path.display())));
        }
        Ok(Self {
            path: path.into(),
            timeout,
            known: HashMap::new(),
            arriving: HashMap::new(),
            begun: false,
            taken: HashSet::new(),
            clock: CameraClock::default(),
        })
    }

    /// Waits for the photograph of a shot that began at `began` and moves it to `file`. `judge` says what is
    /// wrong with one; wrong ones go into the folder `aside`, each with its reason.
    ///
    /// # Errors
    /// When a folder cannot be read or written, on Ctrl-C, and for JPEG files instead of frames.
    pub(super) fn collect(
        &mut self,
        began: SystemTime,
        judge: &dyn Fn(&Photograph) -> std::result::Result<(), Fault>,
        file: &Path,
        aside: &Path,
    ) -> Result<Arrival> {
        let mut deadline = Instant::now() + self.timeout;
        let began_s = began.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default().as_secs_f64();
        let (mut jpeg, mut wrong): (Option<PathBuf>, Option<String>) = (None, None);
        // Files that did not read as a frame, and why.
        let mut refused: HashMap<PathBuf, String> = HashMap::new();
        loop {
            self.look()?;
            let mut found: Vec<(f64, PathBuf, Vec<u8>, Option<f64>)> = Vec::new();
            for path in self.whole() {
                let Some(bytes) = self.read_still(&path)? else { continue };
                if bytes.starts_with(&frame::JPEG_START) {
                    self.pass_over(&path);
                    jpeg = Some(path);
                    continue;
                }
                let photograph = match frame::decode(&bytes, &path) {
                    Ok(photograph) => photograph,
                    // As every photograph of this camera will be.
                    Err(reason) if frame::is_turned(&bytes) => {
                        let reason = reason.to_string();
                        let why = reason.strip_prefix(&format!("{}: ", path.display())).unwrap_or(&reason);
                        self.put_aside(&path, aside, why)?;
                        deadline = deadline.min(Instant::now() + GRACE.min(self.timeout));
                        wrong = Some(reason);
                        continue;
                    }
                    Err(reason) => {
                        self.pass_over(&path);
                        refused.insert(path, reason.to_string());
                        continue;
                    }
                };
                let taken_s = photograph.notes.taken_s;
                let verdict = if self.taken.contains(&sha256(&bytes)) {
                    Err(Fault::Wrong("it is a photograph that was delivered before".into()))
                } else if let Some(early_s) = taken_s.and_then(|taken| self.clock.too_early(began_s, taken)) {
                    Err(Fault::Wrong(format!(
                        "by the camera's clock it was taken {early_s:.0} s before the shot"
                    )))
                } else {
                    judge(&photograph)
                };
                match verdict {
                    Ok(()) => {
                        let off = taken_s.map_or(f64::MAX, |taken| self.clock.off(began_s, taken).abs());
                        found.push((off, path, bytes, taken_s.map(|taken| taken.0)));
                    }
                    Err(Fault::Unfinished(why)) => {
                        self.pass_over(&path);
                        refused.insert(path.clone(), format!("{}: {why}", path.display()));
                    }
                    Err(Fault::Wrong(why)) => {
                        self.put_aside(&path, aside, &why)?;
                        deadline = deadline.min(Instant::now() + GRACE.min(self.timeout));
                        wrong = Some(format!("{}: {why}", path.display()));
                    }
                }
            }
            // Of several that are right, the one taken nearest to the shot; the others are put aside before
            // the next shot.
            found.sort_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.cmp(&b.1)));
            if let Some((_, path, bytes, taken_s)) = found.into_iter().next() {
                files::write_bytes(file, &bytes)?;
                self.taken.insert(sha256(&bytes));
                if let Some(taken_s) = taken_s {
                    self.clock.note(began_s, taken_s);
                }
                remove(&path)?;
                self.forget(&path);
                return Ok(Arrival::Taken);
            }
            check_interrupt()?;
            if Instant::now() >= deadline {
                break;
            }
            std::thread::sleep(LOOK_AGAIN);
        }
        Ok(self.missing(wrong, refused, jpeg))
    }

    /// What to say when no photograph of the shot came.
    fn missing(
        &self,
        wrong: Option<String>,
        refused: HashMap<PathBuf, String>,
        jpeg: Option<PathBuf>,
    ) -> Arrival {
        if let Some(why) = wrong {
            return Arrival::Missing { why, again: true };
        }
        let (folder, seconds) = (self.path.display(), self.timeout.as_secs_f64());
        let nothing = |hint: String| format!("{folder}: no photograph arrived within {seconds} s; {hint}");
        if let Some((_, reason)) = refused.into_iter().min_by(|a, b| a.0.cmp(&b.0)) {
            return Arrival::Missing { why: nothing(format!("what came is none: {reason}")), again: true };
        }
        let Some(path) = jpeg else {
            let why = nothing("is the camera's software storing here?".into());
            return Arrival::Missing { why, again: true };
        };
        let path = path.display();
        if self.taken.is_empty() {
            let message = "the camera stored a JPEG, which is not linear; set it to store 16-bit TIFF files";
            return Arrival::Missing { why: format!("{path}: {message}"), again: false };
        }
        // It has stored frames beside its JPEG files before, so one was lost.
        Arrival::Missing { why: nothing(format!("only the JPEG {path} came")), again: true }
    }

    /// The files that are there, without those that other software marks as its temporary ones.
    fn files(&self) -> Result<HashMap<PathBuf, Seen>> {
        let entries = fs::read_dir(&self.path)
            .map_err(|error| Error::input(format!("{}: cannot be read: {error}", self.path.display())))?;
        let named = entries.filter_map(|entry| Some(entry.ok()?.path())).filter(|path| !is_temporary(path));
        // A file that is gone meanwhile was renamed or removed by its owner.
        let seen = named.filter_map(|path| Some((seen(&path)?, path)));
        Ok(seen.map(|(seen, path)| (path, seen)).collect())
    }

    /// Looks at the folder; whether there is anything new.
    fn look(&mut self) -> Result<bool> {
        let now = Instant::now();
        let files = self.files()?;
        self.arriving.retain(|path, _| files.contains_key(path));
        self.known.retain(|path, _| files.contains_key(path));
        for (path, seen) in files {
            if self.known.get(&path) == Some(&seen) {
                continue;
            }
            let entry = self.arriving.entry(path).or_insert((seen, now));
            if entry.0 != seen {
                *entry = (seen, now);
            }
        }
        Ok(!self.arriving.is_empty())
    }

    /// New files that have stood still for long enough, by name.
    fn whole(&self) -> Vec<PathBuf> {
        let still = self.arriving.iter().filter(|(_, (_, since))| since.elapsed() >= STILL);
        let mut paths: Vec<PathBuf> = still.map(|(path, _)| path.clone()).collect();
        paths.sort();
        paths
    }

    /// The bytes of a file, unless it is gone, locked by its owner, or changed while it was read.
    fn read_still(&self, path: &Path) -> Result<Option<Vec<u8>>> {
        let expected = self.arriving.get(path).map(|(seen, _)| *seen);
        match fs::read(path) {
            Ok(bytes) => Ok((seen(path) == expected).then_some(bytes)),
            Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::PermissionDenied) => {
                Ok(None)
            }
            Err(error) => Err(Error::reading(path, error)),
        }
    }

    /// Counts a file as no news, as it is.
    fn pass_over(&mut self, path: &Path) {
        if let Some((seen, _)) = self.arriving.remove(path) {
            self.known.insert(path.to_path_buf(), seen);
        }
    }

    fn forget(&mut self, path: &Path) {
        self.arriving.remove(path);
        self.known.remove(path);
    }

    /// Puts a photograph into the folder `aside` under a name of its own and notes why; what is no photograph
    /// is left where it is, and a second copy of one that was taken is removed. Whether it was a photograph.
    fn put_aside(&mut self, path: &Path, aside: &Path, why: &str) -> Result<bool> {
        let Some(bytes) = self.read_still(path)? else { return Ok(false) };
        if frame::decode(&bytes, path).is_err() && !frame::is_turned(&bytes) {
            self.pass_over(path);
            return Ok(false);
        }
        if self.taken.contains(&sha256(&bytes)) && why == LATE {
            // The copy that was taken had another name before its software renamed it.
            remove(path)?;
            self.forget(path);
            return Ok(true);
        }
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        files::create_folder(aside)?;
        let mut kept = aside.join(&name);
        let mut number = 1;
        while kept.exists() {
            number += 1;
            kept = aside.join(format!("{number}-{name}"));
        }
        files::write_bytes(&kept, &bytes)?;
        let note = format!("{}: {why}\n", kept.file_name().unwrap_or_default().to_string_lossy());
        let reasons = aside.join(REASONS);
        let append =
            || fs::OpenOptions::new().append(true).create(true).open(&reasons)?.write_all(note.as_bytes());
        append().map_err(|error| Error::writing(&reasons, error))?;
        remove(path)?;
        self.forget(path);
        progress::note(&format!("{name} is put aside: {why}"));
        Ok(true)
    }
}

/// Why a photograph is put aside that was not waited for.
const LATE: &str = "it came too late for the shot before";

/// Name of the file in the folder of photographs put aside that says why each is there.
const REASONS: &str = "reasons.txt";

/// Whether a name is one that software gives to files that it will rename.
fn is_temporary(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    name.starts_with('.') || [".tmp", ".part", ".partial", "~"].iter().any(|ending| name.ends_with(ending))
}

fn seen(path: &Path) -> Option<Seen> {
    let meta = fs::metadata(path).ok().filter(fs::Metadata::is_file)?;
    Some((meta.len(), meta.modified().ok()))
}

/// Removes a file that may be gone already.
fn remove(path: &Path) -> Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(Error::writing(path, error)),
        _ => Ok(()),
    }
}

/// The camera's clock against the host's, from the photographs that were taken so far. A camera's clock may
/// stand still or be of another time zone: it is believed once it has been seen to run along.
#[derive(Debug, Clone, Copy, Default)]
struct CameraClock {
    /// The most that the camera's time was ahead of a shot's beginning, s.
    ahead_s: Option<f64>,
    /// The first photograph: the host's time at the shot, the camera's.
    first: Option<(f64, f64)>,
    runs: bool,
}

impl CameraClock {
    /// How far the two clocks may disagree between shots, s: both whole seconds, and some delay.
    const LEEWAY_S: f64 = 2.0;

    /// Notes a photograph that was right.
    fn note(&mut self, began_s: f64, taken_s: f64) {
        let (host, camera) = *self.first.get_or_insert((began_s, taken_s));
        let (passed, by_camera) = (began_s - host, taken_s - camera);
        if passed > 2.0 * Self::LEEWAY_S {
            self.runs = (by_camera - passed).abs() < Self::LEEWAY_S + 0.01 * passed;
        }
        let ahead = taken_s - began_s;
        self.ahead_s = Some(self.ahead_s.map_or(ahead, |most| most.max(ahead)));
    }

    /// By how much a photograph was taken after (or, below 0, before) a shot began; 0 while the clocks have
    /// not met.
    fn off(&self, began_s: f64, (taken_s, _): (f64, f64)) -> f64 {
        self.ahead_s.map_or(0.0, |ahead| taken_s - began_s - ahead)
    }

    /// By how much a photograph was taken too early to be of a shot, s, if it was.
    fn too_early(&self, began_s: f64, taken: (f64, f64)) -> Option<f64> {
        let early = -self.off(began_s, taken) - taken.1;
        (self.runs && early > Self::LEEWAY_S).then_some(early)
    }
}

#[cfg(test)]
#[path = "watch_tests.rs"]
mod tests;
