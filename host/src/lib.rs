//! Lobelia's host library: plans poses, drives the rig and its camera, develops photographs into reflectance,
//! fits that with a few lobes per texel, and renders the result.
//!
//! The `lobelia` command is a thin layer over these modules; arrows run one way:
//! `rig` ← `plan` ← `acquire` ← `develop` ← `fit` ← `render` ← `cli`.

pub mod acquire;
pub mod by_angle;
pub mod chart;
pub mod cli;
pub mod compare;
#[cfg(feature = "sim")]
pub mod demo;
pub mod develop;
pub mod edit;
pub mod error;
pub mod files;
pub mod fit;
pub mod linalg;
pub mod memory;
mod page;
mod picture_file;
pub mod plan;
pub mod progress;
pub mod provenance;
mod radiance_file;
pub mod render;
pub mod report;
pub mod rig;
pub mod sampled;
pub mod scene;
pub mod synth;
pub mod toml_file;
pub mod warning;

pub use error::{Error, Result};
pub use lobelia_reflectance as reflectance;
