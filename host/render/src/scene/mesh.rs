//! Triangle meshes whose vertices carry what an SBRDF needs: normal, tangent frame, texture coordinates.

use bytemuck::{Pod, Zeroable};
use glam::{Affine3A, DVec3, Vec2, Vec3};

use super::frame;
use lobelia_base::error::{Error, Result};

/// A vertex. The sample's x axis is `tangent`, y is `handedness` · normal × tangent, z is `normal`; y points
/// against v.
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

/// What a corner of a triangle refers to in a [`RawMesh`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Corner {
    /// Index of its position.
    pub position: u32,
    /// Index of its normal; none: computed from the triangles about its position.
    pub normal: Option<u32>,
    /// Index of its texture coordinates; none: projected from a box around the mesh.
    pub uv: Option<u32>,
}

/// A mesh as files hold it: every corner may have a normal and texture coordinates or not, whatever others
/// have.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RawMesh {
    /// Positions, in double precision: some lie far from the origin.
    pub positions: Vec<DVec3>,
    /// Normals.
    pub normals: Vec<Vec3>,
    /// Texture coordinates, v downwards.
    pub uvs: Vec<Vec2>,
    /// Three corners a triangle.
    pub triangles: Vec<[Corner; 3]>,
}

impl RawMesh {
    /// The middle of the mesh where its coordinates are so large that single precision would blur it, else 0.
    pub fn origin(&self) -> DVec3 {
        /// Distance from 0, in sizes of the mesh, up to which coordinates stay: 2⁻¹⁸ of the size is then the
        /// step between two.
        const FAR: f64 = 64.0;
        let low = self.positions.iter().copied().reduce(DVec3::min).unwrap_or_default();
        let high = self.positions.iter().copied().reduce(DVec3::max).unwrap_or_default();
        let far = low.abs().max(high.abs()).max_element() > FAR * (high - low).max_element();
        if far { (low + high) / 2.0 } else { DVec3::ZERO }
    }
}

impl Mesh {
    /// Completes a mesh from a file: normals (angle-weighted), box-projected texture coordinates, tangent
    /// frames (6.1). Positions are relative to [`RawMesh::origin`], which is given back. Vertices are split
    /// where mirrored and unmirrored texture meet.
    ///
    /// # Errors
    /// Input errors for a mesh without triangles, an index out of range, or a position or texture coordinates
    /// that are not finite.
    pub fn from_raw(raw: RawMesh) -> Result<(Self, DVec3)> {
        if raw.triangles.is_empty() {
            return Err(Error::input("the mesh has no triangles"));
        }
        let beyond = |index: Option<u32>, count: usize| index.is_some_and(|index| index as usize >= count);
        for (t, corner) in
            raw.triangles.iter().enumerate().flat_map(|(t, three)| three.map(|corner| (t, corner)))
        {
            for (what, index, count) in [
                ("vertex", Some(corner.position), raw.positions.len()),
                ("normal", corner.normal, raw.normals.len()),
                ("texture coordinate", corner.uv, raw.uvs.len()),
            ] {
                if beyond(index, count) {
                    return Err(Error::input(format!(
                        "triangle {t} refers to a {what} beyond the mesh's {count}"
                    )));
                }
            }
        }
        if u32::try_from(raw.triangles.len().saturating_mul(3)).is_err() {
            return Err(Error::input("the mesh has more than 1.4 billion triangles; split it"));
        }
        if let Some(v) = raw.positions.iter().position(|p| !p.as_vec3().is_finite()) {
            return Err(Error::input(format!("the position of vertex {v} is not finite")));
        }
        if let Some(v) = raw.uvs.iter().position(|uv| !uv.is_finite()) {
            return Err(Error::input(format!("texture coordinate {v} is not finite")));
        }
        let origin = raw.origin();
        Ok((frame::complete(&raw, origin), origin))
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
