//! The axes.

use serde::{Deserialize, Serialize};

use crate::AXES;

/// The axes, in the order of every array of four.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Axis {
    /// The sample's pan.
    Pan,
    /// The sample's tilt.
    Tilt,
    /// The sample's roll about its normal.
    Roll,
    /// The light on its rail.
    Light,
}

impl Axis {
    /// The axes in order.
    pub const ALL: [Self; AXES] = [Self::Pan, Self::Tilt, Self::Roll, Self::Light];

    /// The axis's place in arrays of four.
    pub const fn index(self) -> usize {
        self as usize
    }

    /// The axis's name in lower case.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Pan => "pan",
            Self::Tilt => "tilt",
            Self::Roll => "roll",
            Self::Light => "light",
        }
    }
}
