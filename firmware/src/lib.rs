//! The rig's controller, whole: motion, homing, lamp, shutter, safety and link, for any board with embedded-hal pins.
//!
//! It has no heap, no interrupts of its own and no clock: a board calls [`Controller::poll`] with the time in µs as often
//! as it can, or at the latest when [`Controller::next_event_us`] says. The step path is integer arithmetic.
//! The same crate runs in the simulator on a virtual clock.
#![no_std]
#![forbid(unsafe_code)]

pub mod board;
mod controller;
pub mod driver;
mod homing;
mod lamp;
mod link;
mod motion;
pub mod safety;
mod shutter;
pub mod storage;

pub use board::{
    AnalogInput, AxisPins, Board, ByteLink, Options, Peripherals, Pulses, PulsesCell, StepPins, Watchdog,
};
pub use controller::Controller;
