//! Stepper drivers that are set up over a wire. The controller needs none of this: a board calls it when it starts, and
//! wires the driver's stall output to [`crate::Options::stall`].

pub mod tmc2209;

/// What a driver is set up with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DriverSettings {
    /// Current of a phase while the motor turns, mA RMS.
    pub run_ma: u16,
    /// Current of a phase at rest, mA RMS.
    pub hold_ma: u16,
    /// Below this load reserve the stall output rises; 0 never. What is right has to be tried on the rig.
    pub stall_threshold: u8,
    /// Stalls are looked for above this speed only, in microsteps/s.
    pub stall_above_speed: u32,
}

/// Why a driver could not be set up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DriverError {
    /// The current asked for is beyond what the driver and its sense resistors can do.
    Current,
    /// Bytes could not be sent, or nothing came back in time.
    Silent,
    /// What came back is no datagram, or its checksum is wrong.
    Garbled,
    /// The driver counted other writes than were made: one was lost.
    WriteLost,
}

/// A driver that can be set up.
pub trait StepperDriver {
    /// Sets it up and makes sure that it took what was sent.
    fn set_up(&mut self, settings: &DriverSettings) -> Result<(), DriverError>;
}

/// A wire to drivers that carries datagrams.
pub trait DriverBus {
    /// Sends all bytes; false when it can't.
    fn send(&mut self, bytes: &[u8]) -> bool;
    /// Waits for `into.len()` bytes, without the echo of what was sent; false when they don't come in time.
    fn receive(&mut self, into: &mut [u8]) -> bool;
}
