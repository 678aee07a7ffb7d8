//! What a controller tells unasked. A change here changes what the bytes mean, as in [`crate::message`].

use serde::{Deserialize, Serialize};

use crate::AXES;
use crate::fault::FaultReport;

/// Why a controller crashed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum CrashCause {
    /// The program found itself in an impossible state.
    Panic,
    /// The stack grew over its end.
    StackOverflow,
    /// The processor met something that it can't run.
    HardFault,
    /// The watchdog wasn't fed.
    Watchdog,
}

/// What a crash left behind.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct CrashRecord {
    /// Why.
    pub cause: CrashCause,
    /// Where: a source line for a panic, else an address, as the cause has it; 0 when unknown.
    pub place: u32,
}

/// How things go, told at a period.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Telemetry {
    /// When, in the controller's time in µs.
    pub at_us: u64,
    /// Positions in steps.
    pub positions: [i32; AXES],
    /// The photodiode's reading in counts; not while the shutter is open.
    pub photodiode: Option<u16>,
    /// Frames received whole since the start.
    pub frames: u32,
    /// Frames received damaged since the start, which were passed over.
    pub bad_frames: u32,
    /// Events that were left out since the start, because too many waited.
    pub dropped: u32,
    /// How well the controller keeps up.
    pub health: Health,
}

/// How well the controller keeps up: the worst since it started.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Health {
    /// How late the latest step was, but for the first of each run, µs.
    pub worst_late_us: u32,
    /// How long the longest turn of the main loop took while axes moved, µs; 0 where the board does not tell.
    pub longest_poll_us: u32,
    /// Bytes of the stack that were ever used, and that there are, where the board can tell.
    pub stack: Option<[u32; 2]>,
    /// Bytes received that were lost because nobody took them in time, each a damaged frame.
    pub overruns: u32,
    /// The processor's supply, mV, where the board can measure it.
    pub supply_mv: Option<u16>,
}

/// Something that happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Happening {
    /// A request was begun.
    Began {
        /// Which.
        id: u32,
    },
    /// What a request began has ended, or it was refused.
    Ended {
        /// Which.
        id: u32,
        /// Whether as asked for.
        done: bool,
    },
    /// The lamp was switched.
    Lamp {
        /// Burning or not.
        on: bool,
        /// Level, of 65535.
        level: u16,
    },
    /// The faults were cleared.
    FaultsCleared,
    /// Damaged frames were passed over.
    BadFrames {
        /// How many since the start.
        count: u32,
    },
    /// Log lines were left out here, because too many waited.
    Dropped {
        /// How many.
        count: u32,
    },
}

/// A line of the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct LogLine {
    /// When, in the controller's time in µs.
    pub at_us: u64,
    /// What.
    pub what: Happening,
}

/// What the controller tells unasked. An event is sent only while no answer waits, and not before the last
/// one has left.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Event {
    /// A fault was raised.
    Fault(FaultReport),
    /// The controller crashed before it was started last. Told once, after a hello.
    Crashed(CrashRecord),
    /// How things go, if the host watches. One that is overtaken by the next before it could be sent is left
    /// out.
    Telemetry(Telemetry),
    /// What happened, if the host watches.
    Log(LogLine),
    /// The parameters that the controller started with were saved by an older program: those that it did not
    /// know have their defaults. Told once, after a hello.
    Migrated {
        /// Low half of the identity of what they were saved as.
        from: u32,
    },
}
