//! Stepper drivers that are set up over a wire, where the board has one ([`crate::Options::drivers`]): when
//! parameters are set, and before each homing, since a driver forgets when its supply is cut. After each move
//! they are asked whether they have. Their stall outputs are alarm inputs ([`crate::safety::alarm`]).

pub mod tmc2209;

use lobelia_protocol::{DriverParameters, DriverTrouble};

/// A driver that can be set up.
pub trait StepperDriver {
    /// Sets it up and makes sure that it took what was sent.
    fn set_up(&mut self, settings: &DriverParameters) -> Result<(), DriverTrouble>;
    /// Whether it still has its settings: one that was reset steps otherwise, and nobody would know.
    fn keeps(&mut self, settings: &DriverParameters) -> Result<bool, DriverTrouble>;
}

/// A wire to drivers that carries datagrams.
pub trait DriverBus {
    /// Sends all bytes; false when it can't.
    fn send(&mut self, bytes: &[u8]) -> bool;
    /// Waits for `into.len()` bytes, without the echo of what was sent; false when they don't come in time.
    fn receive(&mut self, into: &mut [u8]) -> bool;
}
