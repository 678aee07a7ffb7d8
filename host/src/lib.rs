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
pub mod warning;

pub use lobelia_base::{
    Error, Result, durable, error, figures, files, hash, interrupt, linalg, memory, page, progress,
    provenance, random, report, toml_file,
};
pub use lobelia_fit::{edit, fit, synth};
pub use lobelia_measure::{develop, plan, rig, run};
pub use lobelia_reflectance as reflectance;
pub use lobelia_reflectance::{distance, mip, sampled};
pub use lobelia_render::{render, scene};
