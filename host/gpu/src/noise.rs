//! Keeps a driver's noise off the terminal: where XDG_RUNTIME_DIR is not set, as in batch jobs and
//! containers, Mesa writes a line about it for every device that is opened, though nothing is wrong.

use std::io::{Read, Seek, Write};
use std::sync::{Mutex, PoisonError};

/// What the line has that is left out.
const NOISE: &str = "XDG_RUNTIME_DIR";

/// One at a time: there is one standard error.
static DIVERTED: Mutex<()> = Mutex::new(());

/// Runs some work; what it writes to standard error comes out afterwards, but for the noise.
pub(crate) fn kept_off<T>(work: impl FnOnce() -> T) -> T {
    let _one = DIVERTED.lock().unwrap_or_else(PoisonError::into_inner);
    let diverted = if std::env::var_os(NOISE).is_none() { Diverted::new() } else { None };
    let done = work();
    drop(diverted);
    done
}

/// Standard error going into a file until this is dropped.
struct Diverted {
    file: std::fs::File,
    before: std::os::fd::OwnedFd,
}

impl Diverted {
    fn new() -> Option<Self> {
        let file = tempfile::tempfile().ok()?;
        let before = rustix::io::dup(std::io::stderr()).ok()?;
        rustix::stdio::dup2_stderr(&file).ok()?;
        Some(Self { file, before })
    }
}

impl Drop for Diverted {
    fn drop(&mut self) {
        // Without standard error there is nobody to tell.
        let _ = rustix::stdio::dup2_stderr(&self.before);
        let mut written = Vec::new();
        if self.file.rewind().is_ok() && self.file.read_to_end(&mut written).is_ok() {
            let _ = std::io::stderr().write_all(&without_noise(&written));
        }
    }
}

/// The lines without those that are noise.
fn without_noise(written: &[u8]) -> Vec<u8> {
    let noise = |line: &[u8]| String::from_utf8_lossy(line).contains(NOISE);
    written.split_inclusive(|&byte| byte == b'\n').filter(|line| !noise(line)).flatten().copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_about_the_folder_is_left_out_and_all_others_stay() {
        let written =
            b"error: XDG_RUNTIME_DIR is invalid or not set in the environment.\nMESA: warning\nno end";
        assert_eq!(without_noise(written), b"MESA: warning\nno end");
        assert_eq!(kept_off(|| 5), 5);
    }
}
