//! Lobelia's host library: plans poses, drives the rig and its camera, develops photographs into reflectance,
//! fits that with a few lobes per texel, and renders the result.
//!
//! The modules stand in crates of their own, named here together: lobelia-base, lobelia-reflectance,
//! lobelia-measure, lobelia-gpu, lobelia-fit and lobelia-render. Arrows run one way: base ← reflectance ←
//! measure, fit ← render; gpu ← fit, render. Here are what sees them all, the charts, the comparison with
//! photographs and the demo, and the `lobelia` command. The simulator comes in with the feature `sim`.

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
pub use lobelia_fit::{edit, findings, fit, synth};
pub use lobelia_measure::{develop, plan, rig, run};
pub use lobelia_reflectance as reflectance;
pub use lobelia_reflectance::{distance, mip, sampled};
pub use lobelia_render::{render, scene};
