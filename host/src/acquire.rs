//! Runs plans, see [`lobelia_measure::acquire`]; on a simulated rig too.

pub use lobelia_measure::acquire::*;
#[cfg(feature = "sim")]
pub use lobelia_sim::{recipe, simulated};
