//! The camera beside a rig: whatever turns an exposure into a file. And the clock of a rig whose time is not
//! ours.

use std::path::Path;
use std::time::{Duration, SystemTime};

use lobelia_base::error::Result;

use crate::develop::frame::RawFrame;
use crate::rig::config::RigConfig;
use crate::rig::geometry::MotorAngles;

/// After a wrong photograph the right one is waited for no longer than this.
pub(super) const GRACE: Duration = Duration::from_secs(5);

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

/// An exposure that was just made.
#[derive(Debug, Clone, Copy)]
pub struct Fired<'a> {
    /// The rig.
    pub config: &'a RigConfig,
    /// What was asked for.
    pub shot: &'a Shot<'a>,
    /// When the shot began.
    pub began: SystemTime,
    /// Time that the shutter was open, s.
    pub open_s: f64,
    /// Where the photograph goes.
    pub file: &'a Path,
    /// The folder for photographs that are not of this shot.
    pub aside: &'a Path,
}

/// What came of waiting for a photograph.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Arrival {
    /// It is in its place.
    Taken,
    /// None came, or none of this shot.
    Missing {
        /// What to say of it.
        why: String,
        /// Whether another try may help.
        again: bool,
    },
}

/// Something that turns an exposure into a file.
pub trait Camera: Send {
    /// Before a shot: puts photographs of earlier shots into the folder `aside`. One that is sure to come is
    /// waited for as long as `patience`.
    ///
    /// # Errors
    /// When a folder cannot be read or written; on Ctrl-C.
    fn drain(&mut self, aside: &Path, patience: Duration) -> Result<()>;

    /// Brings the photograph of a shot to its file, which appears whole or not at all.
    ///
    /// # Errors
    /// When a folder cannot be read or written; on Ctrl-C.
    fn take(&mut self, fired: &Fired<'_>) -> Result<Arrival>;
}

/// The clock of a simulated controller, which stands still while nobody uses it.
pub trait Clock: Send {
    /// Time since power-up, µs.
    fn now_us(&self) -> u64;

    /// Lets it run on to a time, µs.
    fn idle_until_us(&self, time_us: u64);
}
