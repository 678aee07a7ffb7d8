//! Measures: plans poses, drives the rig and its camera, keeps the run, and develops its photographs into
//! reflectance.
//!
//! Arrows run one way: [`rig`] ← [`plan`] ← [`run`] ← [`develop`] ← [`acquire`], which judges photographs as they come
//! in. Camera and clock are [traits](acquire::camera), so that nothing here knows a simulator.

pub mod acquire;
pub mod develop;
pub mod plan;
pub mod rig;
pub mod run;
pub mod warning;
