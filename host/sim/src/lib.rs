//! The simulated rig as a station of the host: the firmware on simulated mechanics, a camera that photographs
//! a known sample, recipes of samples, and the sample of the demo.

pub mod recipe;
pub mod sample;
pub mod simulated;
pub mod size;
