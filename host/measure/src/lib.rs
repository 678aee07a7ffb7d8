//! Measures: plans poses, drives the rig and its camera, keeps the run, and develops its photographs into
//! reflectance.
//!
//! Arrows run one way: [`rig`] ← [`plan`] ← [`run`] ← [`develop`] ← [`acquire`], which judges photographs as
//! they come in. Camera and clock are [traits](acquire::camera), so that nothing here knows a simulator.
//!
//! ```
//! use lobelia_measure::{plan, rig::config::RigConfig};
//!
//! # fn main() -> lobelia_base::Result<()> {
//! let rig = RigConfig::default();
//! let plan = plan::make(&rig, plan::Extent::Budget(6), true, 1)?;
//! assert_eq!(plan.poses.len(), 6);
//! // What the rig cannot do is refused by name.
//! plan.validate(&rig)?;
//! # Ok(())
//! # }
//! ```

pub mod acquire;
pub mod develop;
pub mod plan;
pub mod rig;
pub mod run;
pub mod warning;
