//! Triangle meshes whose vertices carry what an SBRDF needs: normal, tangent frame, texture coordinates.

use bytemuck::{Pod, Zeroable};
use glam::{Affine3A, Vec2, Vec3};

use super::frame;
use crate::error::{Error, Result};

/// A vertex. The sample's x axis is `tangent`, y is `handedness` · normal × tangent, z is `normal`; y points against v.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Vertex {
    /// Position.
    pub position: Vec3,
    /// Unit outward normal.
    pub normal: Vec3,
    /// Unit vector along which u grows, perpendicular to the normal (6.1).
    pub tangent: Vec3,
    /// +1, or −1 where the texture is mirrored.
    pub handedness: f32,
    /// Texture coordinates, v downwards.
    pub uv: Vec2,
}

/// Triangles over shared vertices, counter-clockwise seen from outside.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Mesh {
    /// The vertices.
    pub vertices: Vec<Vertex>,
    /// Three vertex indices a triangle.
    pub triangles: Vec<[u32; 3]>,
}

/// A mesh as files hold it: normals and texture coordinates may be missing.
#[derive(Debug, Clone, Default)]
pub struct RawMesh {
    /// Positions.
    pub positions: Vec<Vec3>,
    /// Normals a vertex, or empty: computed from the triangles.
    pub normals: Vec<Vec3>,
    /// Texture coordinates a vertex (v downwards), or empty: projected from a box around the mesh.
    pub uvs: Vec<Vec2>,
    /// Three vertex indices a triangle.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Completes a mesh from a file: normals (angle-weighted), box-projected texture coordinates, tangent frames (6.1).
    /// Vertices are split where mirrored and unmirrored texture meet.
    ///
    /// # Errors
    /// Input errors for a mesh without triangles, an index out of range, or a position that is not finite.
    pub fn from_raw(raw: RawMesh) -> Result<Self> {
        let count = raw.positions.len();
        if raw.triangles.is_empty() {
            return Err(Error::input("the mesh has no triangles"));
        }
        if let Some(t) = raw.triangles.iter().position(|t| t.iter().any(|&i| i as usize >= count)) {
            return Err(Error::input(format!(
                "triangle {t} refers to a vertex beyond the mesh's {count} vertices"
            )));
        }
        if let Some(v) = raw.positions.iter().position(|p| !p.is_finite()) {
            return Err(Error::input(format!("the position of vertex {v} is not finite")));
        }
        for (what, length) in [("normals", raw.normals.len()), ("texture coordinates", raw.uvs.len())] {
            if length != 0 && length != count {
                return Err(Error::input(format!("{length} {what} for {count} vertices")));
            }
        }
        Ok(frame::complete(raw))
    }

    /// The mesh in another frame; a mirroring transform turns triangles and texture handedness over.
    pub fn transformed(&self, transform: &Affine3A) -> Self {
        let normal_matrix = transform.matrix3.inverse().transpose();
        let mirrored = transform.matrix3.determinant() < 0.0;
        let vertices = self.vertices.iter().map(|vertex| {
            let normal = (normal_matrix * vertex.normal).normalize_or_zero();
            let along = transform.transform_vector3(vertex.tangent);
            Vertex {
                position: transform.transform_point3(vertex.position),
                normal,
                tangent: frame::perpendicular(along, normal),
                handedness: if mirrored { -vertex.handedness } else { vertex.handedness },
                uv: vertex.uv,
            }
        });
        let turn = |&[a, b, c]: &[u32; 3]| if mirrored { [a, c, b] } else { [a, b, c] };
        Self { vertices: vertices.collect(), triangles: self.triangles.iter().map(turn).collect() }
    }

    /// Smallest and largest corner.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        let start = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        self.vertices.iter().fold(start, |(low, high), v| (low.min(v.position), high.max(v.position)))
    }
}
