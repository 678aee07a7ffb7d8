//! The optical bench: what the simulated camera sees.

pub mod tags;
