//! Safety: the emergency stop's input, the drivers' alarms, and the faults, which stay until the host clears
//! them.

pub mod alarm;

use core::sync::atomic::{AtomicBool, Ordering};

use embedded_hal::digital::InputPin;
use lobelia_protocol::{Fault, Faults, Refusal};

use crate::pin::{PinFailure, is_high};

/// The emergency stop as an interrupt sees it.
///
/// The handler calls [`Self::trip`] and should let the step pins go itself. The controller cuts everything at
/// its next poll, half a millisecond later at most while axes move. [`emergency_stop`] is the same as a
/// function.
#[derive(Debug, Default)]
pub struct EmergencyStop(AtomicBool);

impl EmergencyStop {
    /// Not tripped.
    pub const fn new() -> Self {
        Self(AtomicBool::new(false))
    }

    /// Trips it; for an interrupt handler.
    pub fn trip(&self) {
        self.0.store(true, Ordering::Release);
    }

    /// Whether it was tripped and the controller hasn't yet cut everything.
    pub fn is_tripped(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }

    /// Whether it was tripped since this was last asked.
    pub(crate) fn take(&self) -> bool {
        // Load and store, since small cores have no swap; only the interrupt sets it and only the controller
        // resets it.
        let tripped = self.0.load(Ordering::Acquire);
        if tripped {
            self.0.store(false, Ordering::Release);
        }
        tripped
    }
}

/// What an interrupt handler of the emergency stop calls.
pub fn emergency_stop(stop: &EmergencyStop) {
    stop.trip();
}

/// The emergency stop and what has gone wrong so far.
#[derive(Debug)]
pub(crate) struct Safety<P> {
    emergency_stop: P,
    faults: Faults,
    pressed: bool,
}

impl<P: InputPin> Safety<P> {
    pub(crate) fn new(emergency_stop: P) -> Self {
        Self { emergency_stop, faults: Faults::NONE, pressed: false }
    }

    /// Looks at the emergency stop; true when it's a new press.
    pub(crate) fn newly_pressed(&mut self) -> Result<bool, PinFailure> {
        self.pressed = is_high(&mut self.emergency_stop)?;
        Ok(self.pressed && !self.faults.contains(Fault::EmergencyStop))
    }

    /// Whether the emergency stop was pressed when last looked at.
    pub(crate) fn pressed(&self) -> bool {
        self.pressed
    }

    /// The faults set.
    pub(crate) fn faults(&self) -> Faults {
        self.faults
    }

    /// Sets a fault; false if it was set already.
    pub(crate) fn latch(&mut self, fault: Fault) -> bool {
        let new = !self.faults.contains(fault);
        self.faults.insert(fault);
        new
    }

    /// Forgets the faults, unless the emergency stop is still pressed.
    pub(crate) fn clear(&mut self) -> Result<(), Refusal> {
        if self.pressed {
            return Err(Refusal::EmergencyStopPressed);
        }
        self.faults = Faults::NONE;
        Ok(())
    }

    /// Refuses while a fault is set.
    pub(crate) fn check(&self) -> Result<(), Refusal> {
        if self.faults.is_empty() { Ok(()) } else { Err(Refusal::Faulted(self.faults)) }
    }
}
