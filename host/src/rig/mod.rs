//! The rig: the link to its controller.

pub mod client;
mod explain;
pub mod port;

pub use client::RigClient;
pub use port::{Port, open_port};
