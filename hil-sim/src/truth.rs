//! What truly happened, for whoever compares it with what a host was told.

use lobelia_protocol::Axis;

/// What an exposure truly was.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExposureTruth {
    /// Counts exposures from 1; one that was broken off counts too.
    pub sequence: u64,
    /// When the shutter opened, in virtual µs.
    pub start_us: u64,
    /// How long it was open, s.
    pub open_s: f64,
    /// True angles of pan, tilt, roll and light in radians, errors included.
    pub axes_rad: [f64; 4],
    /// The lamp's mean radiance over the open time; 1 is the warm lamp at full level without drift.
    pub lamp_relative: f64,
}

/// A step that an axis's driver received.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Step {
    /// Which axis.
    pub axis: Axis,
    /// Whether it went up.
    pub up: bool,
    /// When, in virtual µs.
    pub at_us: u64,
}
