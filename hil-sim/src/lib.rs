//! Lobelia.

pub mod optics;
