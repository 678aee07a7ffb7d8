//! The rig's controller, whole: motion, homing, lamp, shutter, safety and link, for any board with
//! embedded-hal pins.
//!
//! It has no heap, no interrupts of its own and no clock. Steps are planned in bursts some milliseconds
//! ahead; a board has an interrupt make them ([`Pulses::step`]) and calls [`Controller::poll`] when
//! [`Controller::next_poll_us`] says or a byte has come. Without such an interrupt it calls
//! [`Controller::tick`] when [`Controller::next_event_us`] says, as the simulator does on a virtual clock.
//! The step path is integer additions.
#![no_std]
#![forbid(unsafe_code)]

pub mod board;
mod controller;
pub mod driver;
mod homing;
mod lamp;
mod link;
mod motion;
mod pin;
pub mod safety;
mod shutter;
pub mod storage;

pub use board::{
    AnalogInput, AxisPins, Board, BrownOut, ByteLink, Options, Outputs, Peripherals, Pulses, PulsesCell,
    Readings, StepPins, TimedShutter, Vitals, Watchdog,
};
pub use controller::Controller;
