//! How a rig is wired: pins that are inverted against the board's table of pins, and what alarm inputs mean.

use serde::{Deserialize, Serialize};

/// A pin that may be inverted. The first five are those of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pin {
    /// An axis's step output.
    Step,
    /// An axis's direction output.
    Direction,
    /// An axis's enable output.
    Enable,
    /// An axis's home switch, which is its limit switch too.
    Home,
    /// An axis's alarm input.
    Alarm,
    /// The lamp's relay.
    Lamp,
    /// The shutter, or the camera's trigger.
    Shutter,
    /// The lamp's fan.
    Fan,
    /// The over-temperature input.
    OverTemperature,
    /// The camera's ready input.
    CameraReady,
}

impl Pin {
    /// Every pin, in the order of its bit in [`Pins`].
    pub const ALL: [Self; 10] = [
        Self::Step,
        Self::Direction,
        Self::Enable,
        Self::Home,
        Self::Alarm,
        Self::Lamp,
        Self::Shutter,
        Self::Fan,
        Self::OverTemperature,
        Self::CameraReady,
    ];

    const fn bit(self) -> u16 {
        1 << self as u8
    }
}

/// A set of pins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Pins(u16);

impl Pins {
    /// No pin.
    pub const NONE: Self = Self(0);
    /// All pins that an axis has.
    pub const OF_AXIS: Self = Self(Pin::Lamp.bit() - 1);
    /// All pins that are no axis's.
    pub const OF_RIG: Self = Self(2 * Pin::CameraReady.bit() - Pin::Lamp.bit());

    /// Whether the pin is one of them.
    pub const fn contains(self, pin: Pin) -> bool {
        self.0 & pin.bit() != 0
    }

    /// Whether all of these are among others.
    pub const fn are_among(self, others: Self) -> bool {
        self.0 & !others.0 == 0
    }
}

impl FromIterator<Pin> for Pins {
    fn from_iter<I: IntoIterator<Item = Pin>>(pins: I) -> Self {
        Self(pins.into_iter().fold(0, |bits, pin| bits | pin.bit()))
    }
}

/// What an axis's alarm input means. It counts once it has been active for the debounce time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Alarm {
    /// Nothing: it is not wired.
    #[default]
    None,
    /// The driver has failed for as long as it is active (ALARM, ERR): a fault at any time.
    Level,
    /// The motor has stalled, though it is active for an instant only (DIAG of TMC drivers): a fault while
    /// the axis moves.
    Edge,
}
