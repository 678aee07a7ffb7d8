//! The shader of the separable fit, and what it reads and writes.

use bytemuck::{Pod, Zeroable};
use glam::{Vec3, Vec4};

/// The shader; constants are put before it.
pub const SHADER: &str = concat!(
    include_str!("../../../shaders/fit.wgsl"),
    include_str!("../../../shaders/fit/linear.wgsl"),
    include_str!("../../../shaders/fit/shapes.wgsl"),
    include_str!("../../../shaders/fit/columns.wgsl"),
    include_str!("../../../shaders/fit/normal.wgsl"),
    include_str!("../../../shaders/fit/solver.wgsl"),
    include_str!("../../../shaders/fit/start.wgsl"),
);

/// A set of shapes with its amplitudes.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Fit {
    /// Place of the texel among the samples.
    pub texel: u32,
    /// Turn of the lobes about the normal.
    pub beta: f32,
    /// Σ over channels of the squared residuals.
    pub cost: f32,
    pub(crate) unused: u32,
    /// C and n.
    pub lobes: [Vec4; 4],
    /// ρ_d and amplitudes, times the channel's scale.
    pub x: [Vec4; 5],
}

impl Fit {
    /// The set without lobes.
    pub fn diffuse(texel: usize, cost: f32, rho_d: Vec3) -> Self {
        let mut fit = Self { texel: texel as u32, cost, ..Self::default() };
        fit.x[0] = rho_d.extend(0.0);
        fit
    }

    /// The set with one lobe more, of amplitude 0.
    #[must_use]
    pub fn with_lobe(mut self, lobe: usize, c: Vec3, n: f32) -> Self {
        self.lobes[lobe] = c.extend(n);
        self.x[1 + lobe] = Vec4::ZERO;
        self
    }
}

/// What the shader has to know of a texel beside its samples.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Texel {
    /// Largest amplitude a channel; the sum of the squared goals.
    pub most: Vec4,
    /// Largest θ_i and θ_o; two places unused.
    pub cone: Vec4,
}

/// Uniforms.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct Job {
    /// Places a texel in the lists of samples.
    pub poses: u32,
    /// Channels that are fitted together.
    pub channels: u32,
    /// 1 where ρ_d is an unknown.
    pub diffuse: u32,
    /// Steps at most.
    pub iterations: u32,
    /// Relative fall in cost below which a set is done.
    pub tolerance: f32,
    /// Lobes of every set.
    pub lobes: u32,
    /// Unknowns of the shapes.
    pub unknowns: u32,
    /// First set of this dispatch.
    pub first: u32,
}
