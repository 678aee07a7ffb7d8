//! The rig: its file, its geometry, and the client that speaks to its controller.

pub mod client;
pub mod config;
mod explain;
pub mod geometry;
pub mod port;

pub use client::RigClient;
pub use port::{Port, open_port};
