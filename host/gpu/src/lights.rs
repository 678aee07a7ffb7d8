//! The shader that draws a scene with its lights, and what it reads.

use bytemuck::{Pod, Zeroable};
use glam::{Mat4, Vec4};

/// The shader and its parts; what is reflected of light from afar is put after it.
pub const SHADER: &str = concat!(
    include_str!("../../../shaders/lights.wgsl"),
    include_str!("../../../shaders/lights/texels.wgsl"),
    include_str!("../../../shaders/lights/footprint.wgsl"),
    include_str!("../../../shaders/lights/shadows.wgsl"),
    include_str!("../../../shaders/lights/lamps.wgsl"),
);

/// Where there is no light from afar.
pub const NOT_DISTANT: &str = "fn distant_of(object: u32, footprint: Footprint, frame: mat3x3f, wo: vec3f) \
     -> vec3f { return vec3f(0.0); }";

/// Uniforms.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct View {
    /// World to clip space.
    pub projection: Mat4,
    /// Centre of projection; w: number of lamps.
    pub eye: Vec4,
    /// x: length by which shadow rays are kept off surfaces.
    pub offset: Vec4,
}

/// A light in one layout for CPU and shader.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct Lamp {
    /// Directional: unit vector toward the light, w = 0. Point: position, w = 1. Rectangle: centre, w = 2.
    pub place: Vec4,
    /// Directional: irradiance. Point: intensity. Rectangle: radiance.
    pub power: Vec4,
    /// A rectangle's edges, u and v of the shader; it shines to the side of their cross product.
    pub edges: [Vec4; 2],
}

/// A material: its texels and how they are looked up.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Material {
    /// First texel of the finest level; those of the other levels follow.
    pub first: u32,
    /// Texels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// 1 for bilinear, 0 for nearest.
    pub bilinear: u32,
    /// Repeats along u and v.
    pub tiling: [f32; 2],
    /// MIP levels beyond the finest.
    pub levels: u32,
    /// The largest albedo factor, where 8 bits are scaled to it; else 1.
    pub brightest: f32,
    /// Of a rectangular light's front.
    pub emission: [f32; 3],
    /// 1 for a rectangular light.
    pub emits: u32,
    /// First word, columns, rows.
    pub mask: [u32; 3],
    /// Most lobes of a texel.
    pub lobes: u32,
    /// Microfacet terms of every texel.
    pub coats: u32,
    /// Up to the size that a list of them has on the device.
    pub padding: [u32; 3],
}

/// A node of the tree, a node's first child after it; for leaves the run of triangles, else a count of 0 and
/// the node that follows its last descendant.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct Node {
    /// Lower corner of the box.
    pub low: [f32; 3],
    /// First triangle, or the node that follows.
    pub first: u32,
    /// Upper corner of the box.
    pub high: [f32; 3],
    /// Triangles.
    pub count: u32,
}

/// A triangle in the tree's order.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct Leaf {
    pub(crate) corner: [f32; 3],
    pub(crate) triangle: u32,
    pub(crate) e1: [f32; 3],
    pub(crate) object: u32,
    pub(crate) e2: [f32; 3],
    padding: u32,
}

impl Leaf {
    /// A triangle of an object by its first corner and its edges: from the second corner to the first, and
    /// from the first to the third.
    pub fn new(corner: [f32; 3], [e1, e2]: [[f32; 3]; 2], triangle: u32, object: u32) -> Self {
        Self { corner, triangle, e1, object, e2, padding: 0 }
    }
}
