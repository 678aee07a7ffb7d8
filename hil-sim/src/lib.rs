//! A simulated rig: the very firmware of the controller on a virtual clock, against simulated mechanics, lamp
//! and link.
//!
//! Time passes only while the host waits for bytes or lets it pass, and all scatter is a function of a seed
//! and of what it scatters (a target, an instant), never of how many numbers were drawn before. So the same
//! commands give the same truth, in one process or after a kill and a restart.

mod bench;
pub mod config;
mod drivers;
pub mod faults;
mod lamp;
pub mod link;
mod mechanics;
mod metering;
mod noise;
pub mod optics;
mod pins;
pub mod rig;
pub mod server;
pub mod truth;
mod wire;
mod world;

pub use config::{AxisMechanics, LampConfig, MechanicsConfig, Wiring};
pub use faults::{FaultRates, FaultyLink, LineCounts};
pub use link::SimulatedLink;
pub use rig::{SimulatedRig, Way};
pub use server::serve_tcp;
pub use truth::{ExposureTruth, Step};
pub use wire::LineConfig;
