//! Faults: what makes the controller stop everything and refuse to move until it is told that all is well
//! again.

use serde::{Deserialize, Serialize};

use crate::axis::Axis;

/// One reason to stop. A fault stays set until the host clears it; positions are unknown afterwards.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Fault {
    /// The emergency stop was pressed.
    EmergencyStop,
    /// A home switch closed during a move that should have stayed clear of it: steps were lost.
    LimitHit,
    /// A home switch was not found, or did not open again, within the axis's travel.
    HomingFailed,
    /// A pin could not be driven or read.
    Hardware,
    /// A check found the home switch elsewhere than it should be: steps were lost.
    StepsLost,
    /// A motor's driver told a stall by its alarm input.
    Stall,
    /// Lamp or driver is too hot.
    OverTemperature,
    /// The lamp was on and warm, but its photodiode stayed dark.
    LampFailure,
    /// No request came for the time of the lease.
    LeaseExpired,
    /// A step came later than by half the interval between steps: the controller could not keep up, and the
    /// motor may have lost it.
    StepsLate,
    /// A home switch stayed closed over its whole width: it is stuck, or its wire is broken.
    SwitchStuck,
    /// The lamp burnt for as long as it may.
    LampTimeout,
    /// A motor's driver has lost its settings, as when its supply was cut, or no longer answers.
    DriverLost,
    /// A motor's driver told an alarm.
    DriverAlarm,
}

impl Fault {
    /// Every fault, in the order of its bit in [`Faults`].
    pub const ALL: [Self; 14] = [
        Self::EmergencyStop,
        Self::LimitHit,
        Self::HomingFailed,
        Self::Hardware,
        Self::StepsLost,
        Self::Stall,
        Self::OverTemperature,
        Self::LampFailure,
        Self::LeaseExpired,
        Self::StepsLate,
        Self::SwitchStuck,
        Self::LampTimeout,
        Self::DriverLost,
        Self::DriverAlarm,
    ];

    const fn bit(self) -> u16 {
        1 << self as u8
    }
}

/// A set of faults.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Faults(u16);

impl Faults {
    /// No fault.
    pub const NONE: Self = Self(0);

    /// Adds a fault.
    pub fn insert(&mut self, fault: Fault) {
        self.0 |= fault.bit();
    }

    /// Whether the fault is set.
    pub const fn contains(self, fault: Fault) -> bool {
        self.0 & fault.bit() != 0
    }

    /// Whether no fault is set.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The faults that are set.
    pub fn iter(self) -> impl Iterator<Item = Fault> {
        Fault::ALL.into_iter().filter(move |fault| self.contains(*fault))
    }
}

impl FromIterator<Fault> for Faults {
    fn from_iter<I: IntoIterator<Item = Fault>>(faults: I) -> Self {
        let mut set = Self::NONE;
        for fault in faults {
            set.insert(fault);
        }
        set
    }
}

/// Sent unasked when a fault is raised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct FaultReport {
    /// What happened.
    pub fault: Fault,
    /// On which axis, where that can be said.
    pub axis: Option<Axis>,
    /// When, in the controller's time in µs.
    pub at_us: u64,
}
