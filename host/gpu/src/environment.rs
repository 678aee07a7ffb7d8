//! The shaders of light from afar: one that gathers prefiltered maps, one that reflects them; and what they
//! read.

use bytemuck::{Pod, Zeroable};
use glam::Vec4;

/// What is put after [`crate::lights::SHADER`]: light from afar by prefiltered maps.
pub const SHADER: &str = include_str!("../../../shaders/environment.wgsl");

/// Gathers a prefiltered map.
pub const PREFILTER: &str = include_str!("../../../shaders/prefilter.wgsl");

/// Uniforms of [`SHADER`].
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct Sky {
    pub(crate) turn: [f32; 2],
    pub(crate) maps: u32,
    pub(crate) horizon: u32,
    pub(crate) harmonics: u32,
    padding: [u32; 3],
    pub(crate) coefficients: [Vec4; 9],
}

impl Sky {
    /// An environment turned about +y, with so many maps of S. `horizon` says whether lobes are corrected
    /// near it; of `harmonics`, where there are any, comes D(N) instead of from its map.
    pub fn new(turn: f32, maps: u32, horizon: bool, harmonics: Option<[Vec4; 9]>) -> Self {
        let (sin, cos) = turn.sin_cos();
        Self {
            turn: [cos, sin],
            maps,
            horizon: horizon.into(),
            harmonics: harmonics.is_some().into(),
            padding: [0; 3],
            coefficients: harmonics.unwrap_or_default(),
        }
    }
}

/// Where a map lies in the run of all pixels.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct Map {
    /// Exponent.
    pub n: f32,
    /// First pixel.
    pub first: u32,
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// Uniforms of [`PREFILTER`].
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct Task {
    /// Pixels of the source.
    pub source: [u32; 2],
    /// Pixels of the map.
    pub map: [u32; 2],
    /// Exponent.
    pub n: f32,
    /// Cosine at the rim of the lobe.
    pub least_cosine: f32,
    /// How far the lobe reaches.
    pub reach: f32,
    /// First pixel of this dispatch.
    pub first: u32,
}
