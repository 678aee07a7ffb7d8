//! Scenes of SBRDF materials, and the renderers that draw them.

pub mod render;
pub mod scene;
