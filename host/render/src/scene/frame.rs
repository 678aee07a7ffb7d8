//! Tangent frames from texture coordinates (6.1), with what the equation leaves open: mirrored texture,
//! missing normals, missing texture coordinates, triangles without area.

use std::collections::HashMap;

use glam::{DVec3, Vec2, Vec3};

use super::mesh::{Corner, Mesh, RawMesh, Vertex};
use super::winding;

/// The unit vector nearest to `along` that is perpendicular to `normal`; any perpendicular one when they are
/// parallel.
pub(crate) fn perpendicular(along: Vec3, normal: Vec3) -> Vec3 {
    let flat = along - normal * normal.dot(along);
    if flat.length_squared() > 1e-12 * along.length_squared().max(1e-30) {
        flat.normalize()
    } else if normal.length_squared() > 0.5 {
        normal.any_orthonormal_vector()
    } else {
        Vec3::X
    }
}

/// See [`Mesh::from_raw`], which has checked the indices and gives the origin.
pub(crate) fn complete(raw: &RawMesh, origin: DVec3) -> Mesh {
    let mut triangles = raw.triangles.clone();
    drop_empty_normals(&mut triangles, &raw.normals);
    let positions: Vec<Vec3> = raw.positions.iter().map(|&position| (position - origin).as_vec3()).collect();
    // Frames are found on the mesh at the size of 1: areas of very large or small meshes are beyond single
    // precision.
    let size =
        raw.positions.iter().map(|&position| (position - origin).abs().max_element()).fold(0.0, f64::max);
    let shape: Vec<Vec3> = raw
        .positions
        .iter()
        .map(|&position| ((position - origin) / size.max(f64::MIN_POSITIVE)).as_vec3())
        .collect();
    let computed = computed_normals(&shape, &mut triangles);
    let normal = |corner: &Corner| match corner.normal {
        Some(index) => raw.normals[index as usize].normalize_or(Vec3::Y),
        None => computed[corner.position as usize],
    };
    let projected = BoxProjection::new(&shape);

    let mut joined = Joined::default();
    for triangle in &triangles {
        let corners = triangle.map(|corner| shape[corner.position as usize]);
        let edges = (corners[1] - corners[0], corners[2] - corners[0]);
        let face = edges.0.cross(edges.1);
        // One corner without texture coordinates leaves the triangle without.
        let given = triangle.iter().all(|corner| corner.uv.is_some());
        let side = if given { None } else { Some(BoxProjection::side(face)) };
        let uvs = [0, 1, 2].map(|k| match (side, triangle[k].uv) {
            (None, Some(index)) => raw.uvs[index as usize],
            _ => projected.uv(corners[k], side.unwrap_or_default()),
        });
        // Twice the signed area in a texture frame whose y points up.
        let area = -(uvs[1] - uvs[0]).perp_dot(uvs[2] - uvs[0]);
        let facing = triangle.iter().map(normal).sum::<Vec3>().dot(face);
        let mirrored = (area < 0.0) != (facing < 0.0);
        // (6.1)'s B, which is dP/dv; its sign follows the texture's orientation.
        let (u1, u2) = (uvs[1].x - uvs[0].x, uvs[2].x - uvs[0].x);
        let up = (u1 * edges.1 - u2 * edges.0).normalize_or_zero() * if area < 0.0 { -1.0 } else { 1.0 };
        let corner = |k: usize| {
            let corner = &triangle[k];
            let uv = if given { corner.uv } else { None };
            let key = (corner.position, corner.normal, uv, side, mirrored);
            let handedness = if mirrored { -1.0 } else { 1.0 };
            let vertex = Vertex {
                position: positions[corner.position as usize],
                normal: normal(corner),
                tangent: Vec3::ZERO,
                handedness,
                uv: uvs[k],
            };
            (key, vertex, up * face.length())
        };
        joined.add([corner(0), corner(1), corner(2)]);
    }
    joined.finish()
}

/// Takes normals without length as missing.
fn drop_empty_normals(triangles: &mut [[Corner; 3]], normals: &[Vec3]) {
    for corner in triangles.iter_mut().flatten() {
        corner.normal = corner.normal.filter(|&index| normals[index as usize].try_normalize().is_some());
    }
}

/// Normals a position for corners that have none, of the triangles that have such; these are turned so that
/// neighbours agree.
fn computed_normals(positions: &[Vec3], triangles: &mut [[Corner; 3]]) -> Vec<Vec3> {
    let bare: Vec<usize> =
        (0..triangles.len()).filter(|&t| triangles[t].iter().any(|corner| corner.normal.is_none())).collect();
    if bare.is_empty() {
        return Vec::new();
    }
    let indices = |t: &usize| triangles[*t].map(|corner| corner.position);
    let to_turn = winding::to_turn(&bare.iter().map(indices).collect::<Vec<_>>());
    for (&t, _) in bare.iter().zip(to_turn).filter(|(_, turn)| *turn) {
        triangles[t].swap(1, 2);
    }
    let turned: Vec<[u32; 3]> = bare.iter().map(|&t| triangles[t].map(|corner| corner.position)).collect();
    smooth_normals(positions, &turned)
}

/// What makes corners one vertex: position, normal, texture coordinates or the side that they are projected
/// from, orientation.
type Key = (u32, Option<u32>, Option<u32>, Option<u8>, bool);

/// Vertices being joined from corners.
#[derive(Default)]
struct Joined {
    mesh: Mesh,
    indices: HashMap<Key, u32>,
    /// Sums over the triangles of the direction against v.
    up: Vec<Vec3>,
}

impl Joined {
    /// Adds a triangle: keys, vertices and directions against v of its corners.
    fn add(&mut self, corners: [(Key, Vertex, Vec3); 3]) {
        let triangle = corners.map(|(key, vertex, up)| {
            let next = self.mesh.vertices.len() as u32;
            let index = *self.indices.entry(key).or_insert(next);
            if index == next {
                self.mesh.vertices.push(vertex);
                self.up.push(Vec3::ZERO);
            }
            self.up[index as usize] += up;
            index
        });
        self.mesh.triangles.push(triangle);
    }

    fn finish(mut self) -> Mesh {
        for (vertex, up) in self.mesh.vertices.iter_mut().zip(self.up) {
            let y = perpendicular(up, vertex.normal);
            vertex.tangent = y.cross(vertex.normal) * vertex.handedness;
        }
        self.mesh
    }
}

/// Normals that weigh every triangle by its angle at the vertex.
fn smooth_normals(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    let mut normals = vec![Vec3::ZERO; positions.len()];
    for triangle in triangles {
        let [a, b, c] = triangle.map(|i| positions[i as usize]);
        let face = (b - a).cross(c - a).normalize_or_zero();
        for (i, (p, q, r)) in [(a, b, c), (b, c, a), (c, a, b)].into_iter().enumerate() {
            let cosine = (q - p).normalize_or_zero().dot((r - p).normalize_or_zero());
            normals[triangle[i] as usize] += face * cosine.clamp(-1.0, 1.0).acos();
        }
    }
    normals.into_iter().map(|n| n.normalize_or(Vec3::Y)).collect()
}

/// Texture coordinates by projection along the axis that each triangle faces most, 0..1 over the longest side
/// of the box.
struct BoxProjection {
    low: Vec3,
    scale: f32,
}

impl BoxProjection {
    fn new(positions: &[Vec3]) -> Self {
        let low = positions.iter().copied().reduce(Vec3::min).unwrap_or_default();
        let high = positions.iter().copied().reduce(Vec3::max).unwrap_or_default();
        Self { low, scale: (high - low).max_element().max(f32::MIN_POSITIVE) }
    }

    /// The side of the box that a triangle of this normal, of any length, faces.
    fn side(normal: Vec3) -> u8 {
        let axis = normal.abs().max_position();
        (axis * 2 + usize::from(normal[axis] < 0.0)) as u8
    }

    fn uv(&self, position: Vec3, side: u8) -> Vec2 {
        let p = (position - self.low) / self.scale;
        // Right and up as seen from outside, so that no side is mirrored.
        let (right, up) = match side {
            0 => (-p.z, p.y),
            1 => (p.z, p.y),
            2 => (p.x, -p.z),
            3 => (p.x, p.z),
            4 => (p.x, p.y),
            _ => (-p.x, p.y),
        };
        Vec2::new(right, -up)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Triangles whose corners have normals and texture coordinates of the positions' indices, where there
    /// are any.
    fn raw(positions: &[Vec3], normals: Vec<Vec3>, uvs: Vec<Vec2>, triangles: &[[u32; 3]]) -> RawMesh {
        let has = (!normals.is_empty(), !uvs.is_empty());
        let corner =
            |position| Corner { position, normal: has.0.then_some(position), uv: has.1.then_some(position) };
        RawMesh {
            positions: positions.iter().map(|position| position.as_dvec3()).collect(),
            normals,
            uvs,
            triangles: triangles.iter().map(|triangle| triangle.map(corner)).collect(),
        }
    }

    fn quad(mirror: bool) -> RawMesh {
        let u = |x: f32| if mirror { 1.0 - x } else { x };
        let uv = |x: f32, y: f32| Vec2::new(u(x), y);
        raw(
            &[Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y],
            vec![],
            vec![uv(0.0, 1.0), uv(1.0, 1.0), uv(1.0, 0.0), uv(0.0, 0.0)],
            &[[0, 1, 2], [0, 2, 3]],
        )
    }

    fn mesh(raw: RawMesh) -> Mesh {
        Mesh::from_raw(raw).unwrap().0
    }

    #[test]
    fn frame_of_a_plain_quad_is_that_of_the_sample() {
        for vertex in mesh(quad(false)).vertices {
            assert!((vertex.tangent - Vec3::X).length() < 1e-6, "{vertex:?}");
            assert!((vertex.normal - Vec3::Z).length() < 1e-6);
            assert_eq!(vertex.handedness, 1.0);
        }
    }

    #[test]
    fn mirrored_texture_keeps_u_along_the_tangent_and_is_marked() {
        for vertex in mesh(quad(true)).vertices {
            assert!((vertex.tangent + Vec3::X).length() < 1e-6, "{vertex:?}");
            let y = vertex.handedness * vertex.normal.cross(vertex.tangent);
            assert!((y - Vec3::Y).length() < 1e-6, "y must point against v: {y}");
        }
    }

    #[test]
    fn u_grows_along_the_tangent_and_v_against_y_whichever_way_triangles_run_against_their_normals() {
        for (mirror, normal, turn) in [
            (false, 1.0, true),
            (false, -1.0, false),
            (true, -1.0, false),
            (true, 1.0, true),
            (false, 1.0, false),
        ] {
            let mut raw = quad(mirror);
            raw.normals = vec![Vec3::Z * normal; 4];
            for triangle in &mut raw.triangles {
                triangle.iter_mut().for_each(|corner| corner.normal = Some(corner.position));
                if turn {
                    triangle.swap(1, 2);
                }
            }
            let along_u = if mirror { Vec3::NEG_X } else { Vec3::X };
            for vertex in mesh(raw).vertices {
                assert!((vertex.tangent - along_u).length() < 1e-6, "{mirror} {normal} {turn}: {vertex:?}");
                let y = vertex.handedness * vertex.normal.cross(vertex.tangent);
                assert!((y - Vec3::Y).length() < 1e-6, "{mirror} {normal} {turn}: y {y}");
            }
        }
    }

    #[test]
    fn vertices_are_split_where_mirrored_and_plain_texture_meet() {
        let mut quad = quad(false);
        quad.positions.extend([DVec3::new(2.0, 0.0, 0.0), DVec3::new(2.0, 1.0, 0.0)]);
        quad.uvs.extend([Vec2::new(0.0, 1.0), Vec2::new(0.0, 0.0)]);
        let corner = |position| Corner { position, normal: None, uv: Some(position) };
        quad.triangles.extend([[1, 4, 5], [1, 5, 2]].map(|triangle| triangle.map(corner)));
        let mesh = mesh(quad);
        assert_eq!(mesh.vertices.len(), 8);
        for triangle in &mesh.triangles {
            let signs = triangle.map(|i| mesh.vertices[i as usize].handedness);
            assert!(signs.iter().all(|&s| s == signs[0]));
        }
    }

    #[test]
    fn missing_texture_coordinates_are_projected_without_mirroring() {
        let sphere = crate::scene::shapes::sphere(16, 8);
        let positions: Vec<Vec3> = sphere.vertices.iter().map(|v| v.position).collect();
        let mesh = mesh(raw(&positions, vec![], vec![], &sphere.triangles));
        assert!(mesh.vertices.iter().all(|v| v.handedness == 1.0 && v.uv.is_finite()));
        assert!(mesh.vertices.iter().all(|v| v.normal.dot(v.tangent).abs() < 1e-5));
    }

    #[test]
    fn a_triangle_without_normals_or_texture_leaves_those_of_the_others() {
        let mut quad = quad(false);
        quad.normals = vec![Vec3::new(0.0, 0.6, 0.8)];
        quad.triangles[0].iter_mut().for_each(|corner| corner.normal = Some(0));
        quad.triangles[1].iter_mut().for_each(|corner| corner.uv = None);
        let mesh = mesh(quad);
        let corners = |t: usize| mesh.triangles[t].map(|i| mesh.vertices[i as usize]);
        assert!(corners(0).iter().all(|v| v.normal == Vec3::new(0.0, 0.6, 0.8)));
        assert_eq!(corners(0)[0].uv, Vec2::new(0.0, 1.0));
        assert!(corners(1).iter().all(|v| (v.normal - Vec3::Z).length() < 1e-6));
        // Projected: 0..1 to the right, 0..−1 upwards.
        assert_eq!(corners(1)[1].uv, Vec2::new(1.0, -1.0));
    }

    #[test]
    fn degenerate_texture_and_normals_without_length_still_give_a_unit_frame() {
        let mut raw = quad(false);
        raw.uvs = vec![Vec2::splat(0.5); 4];
        raw.normals = vec![Vec3::ZERO];
        raw.triangles[0][1].normal = Some(0);
        for vertex in mesh(raw).vertices {
            assert!((vertex.tangent.length() - 1.0).abs() < 1e-5);
            assert!(vertex.tangent.dot(vertex.normal).abs() < 1e-5);
            assert!((vertex.normal - Vec3::Z).length() < 1e-6);
        }
    }

    #[test]
    fn coordinates_far_from_zero_keep_their_digits() {
        let mut raw = quad(false);
        let far = DVec3::new(4_000_000.125, -70_000.5, 310.0);
        raw.positions.iter_mut().for_each(|position| *position = *position * 0.001 + far);
        let (mesh, origin) = Mesh::from_raw(raw).unwrap();
        let (low, high) = mesh.bounds();
        assert!((high - low - Vec3::new(0.001, 0.001, 0.0)).length() < 1e-9, "{low} {high}");
        assert!((origin - far).length() < 0.001 && (mesh.vertices[0].normal - Vec3::Z).length() < 1e-6);
        assert_eq!(Mesh::from_raw(quad(false)).unwrap().1, DVec3::ZERO);
    }

    #[test]
    fn a_mesh_of_any_size_has_the_frames_of_one_of_size_1() {
        let expected = mesh(quad(true));
        for size in [1e-30, 1e-12, 1e12, 2e38] {
            let mut raw = quad(true);
            raw.positions.iter_mut().for_each(|position| *position = (*position - 0.5) * size);
            let projected = mesh(RawMesh {
                triangles: raw
                    .triangles
                    .iter()
                    .map(|t| t.map(|corner| Corner { uv: None, ..corner }))
                    .collect(),
                ..raw.clone()
            });
            assert!(
                projected.vertices.iter().all(|v| v.uv.is_finite() && v.uv.abs().max_element() <= 1.0),
                "{size}"
            );
            for (vertex, known) in mesh(raw).vertices.iter().zip(&expected.vertices) {
                assert!((vertex.normal - known.normal).length() < 1e-6, "{size}: {vertex:?}");
                assert!((vertex.tangent - known.tangent).length() < 1e-6, "{size}: {vertex:?}");
            }
        }
    }

    #[test]
    fn an_index_out_of_range_is_named() {
        let mut quad = quad(false);
        quad.triangles.push([0, 1, 9].map(|position| Corner { position, normal: None, uv: None }));
        let text = Mesh::from_raw(quad).unwrap_err().to_string();
        assert!(text.contains("triangle 2") && text.contains("vertex beyond the mesh's 4"), "{text}");
    }
}
