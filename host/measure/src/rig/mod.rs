//! The rig: its file, its geometry, and the client that speaks to its controller.

pub mod client;
pub mod config;
pub mod conformance;
mod explain;
pub mod geometry;
mod keep_alive;
pub mod monitor;
pub mod parameters;
pub mod port;
pub mod replay;
pub mod safe;
pub mod status;
#[cfg(test)]
mod testing;
pub mod trace;
mod wire;

pub use client::RigClient;
pub use port::{Port, open_port};
pub(crate) use wire::PLUG_IN;
