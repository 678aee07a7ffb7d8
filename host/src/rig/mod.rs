//! The rig: its file, its geometry, and the client that speaks to its controller.

pub mod config;
pub mod geometry;
