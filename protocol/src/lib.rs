//! Messages and frames between the host and the rig's controller: what goes over the wire, and nothing else.
//!
//! A message is written with postcard, followed by its CRC-32, wrapped by COBS and set between zero bytes
//! ([`frame`]). A session starts with a [`hello`], whose layout never changes, so that two programs of
//! different versions can name both; but for a few messages that are [`frozen`] nothing else is understood
//! before the schemas are known to be equal. All set points are absolute and each request bears an id, so a
//! repeated request does no harm ([`message`]).
#![no_std]

pub mod axis;
pub mod event;
pub mod fault;
pub mod frame;
pub mod frozen;
pub mod hello;
pub mod message;
pub mod packet;
pub mod parameters;
pub mod schema;
pub mod wiring;

pub use axis::Axis;
pub use event::{CrashCause, CrashRecord, Event, Happening, Health, LogLine, Telemetry};
pub use fault::{Fault, FaultReport, Faults};
pub use frame::{EncodedFrame, FrameDecoder, FrameError};
pub use frozen::{SafeCommand, SafeState};
pub use hello::{Hello, HelloReply, Verdict};
pub use message::{
    Answer, Command, EXPOSURE_US, Exposure, Field, HomingReport, LampStatus, Outcome, Refusal, Request,
    Response, Status,
};
pub use packet::{CodecError, ToController, ToHost};
pub use parameters::{
    AxisParameters, Configuration, DriverParameters, DriverTrouble, HomeDirection, KEEP_OUTS, KeepOut,
    LAMP_LONGEST_S, Settings,
};
pub use wiring::{Alarm, Pin, Pins};

/// Number of axes; their order everywhere is pan, tilt, roll, light.
pub const AXES: usize = 4;
