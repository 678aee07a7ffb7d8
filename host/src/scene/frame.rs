//! Tangent frames from texture coordinates (6.1), with what the equation leaves open: mirrored texture, missing normals,
//! missing texture coordinates, triangles without area.

use std::collections::HashMap;

use glam::{Vec2, Vec3};

use super::mesh::{Mesh, RawMesh, Vertex};
use super::winding;

/// The unit vector nearest to `along` that is perpendicular to `normal`; any perpendicular one when they are parallel.
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

/// See [`Mesh::from_raw`], which has checked the indices.
pub(crate) fn complete(mut raw: RawMesh) -> Mesh {
    if raw.normals.is_empty() {
        winding::unify(&mut raw.triangles);
        raw.normals = smooth_normals(&raw.positions, &raw.triangles);
    }
    if raw.uvs.is_empty() {
        project_from_box(&mut raw);
    }
    let mirrored: Vec<bool> = raw.triangles.iter().map(|t| texture_area(&raw, t) < 0.0).collect();
    split_by(&mut raw, |triangle, _| u8::from(mirrored[triangle]));

    // Sums over the triangles of (6.1)'s B, which is dP/dv; its sign follows the texture's orientation.
    let mut down = vec![Vec3::ZERO; raw.positions.len()];
    let mut handedness = vec![1.0f32; raw.positions.len()];
    for (t, triangle) in raw.triangles.iter().enumerate() {
        let [a, b, c] = triangle.map(|i| i as usize);
        let (v1, v2) = (raw.positions[b] - raw.positions[a], raw.positions[c] - raw.positions[a]);
        let (u1, u2) = (raw.uvs[b].x - raw.uvs[a].x, raw.uvs[c].x - raw.uvs[a].x);
        let sign = if mirrored[t] { -1.0 } else { 1.0 };
        let along_v = (u1 * v2 - u2 * v1).normalize_or_zero() * -sign;
        for i in [a, b, c] {
            down[i] += along_v * v1.cross(v2).length();
            handedness[i] = sign;
        }
    }
    let vertices = (0..raw.positions.len()).map(|i| {
        let normal = raw.normals[i].normalize_or(Vec3::Y);
        let y = perpendicular(-down[i], normal);
        Vertex {
            position: raw.positions[i],
            normal,
            tangent: y.cross(normal) * handedness[i],
            handedness: handedness[i],
            uv: raw.uvs[i],
        }
    });
    Mesh { vertices: vertices.collect(), triangles: raw.triangles }
}

/// Twice the signed area in a texture frame whose y points up: positive when the texture is not mirrored.
fn texture_area(raw: &RawMesh, triangle: &[u32; 3]) -> f32 {
    let [a, b, c] = triangle.map(|i| raw.uvs[i as usize]);
    -(b - a).perp_dot(c - a)
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

/// Texture coordinates by projection along the axis that each triangle faces most, 0..1 over the longest side of the box.
fn project_from_box(raw: &mut RawMesh) {
    let side = |p: &[Vec3; 3]| {
        let normal = (p[1] - p[0]).cross(p[2] - p[0]);
        let axis = normal.abs().max_position();
        (axis * 2 + usize::from(normal[axis] < 0.0)) as u8
    };
    let corners = |t: &[u32; 3]| t.map(|i| raw.positions[i as usize]);
    let sides: Vec<u8> = raw.triangles.iter().map(|t| side(&corners(t))).collect();
    let low = raw.positions.iter().copied().reduce(Vec3::min).unwrap_or_default();
    let high = raw.positions.iter().copied().reduce(Vec3::max).unwrap_or_default();
    let scale = (high - low).max_element().max(f32::MIN_POSITIVE);

    split_by(raw, |triangle, _| sides[triangle]);
    raw.uvs = vec![Vec2::ZERO; raw.positions.len()];
    for (triangle, side) in raw.triangles.iter().zip(&sides) {
        for &i in triangle {
            let p = (raw.positions[i as usize] - low) / scale;
            // Right and up as seen from outside, so that no side is mirrored.
            let (right, up) = match side {
                0 => (-p.z, p.y),
                1 => (p.z, p.y),
                2 => (p.x, -p.z),
                3 => (p.x, p.z),
                4 => (p.x, p.y),
                _ => (-p.x, p.y),
            };
            raw.uvs[i as usize] = Vec2::new(right, -up);
        }
    }
}

/// Gives every vertex a copy for each class of triangle that uses it.
fn split_by(raw: &mut RawMesh, class: impl Fn(usize, usize) -> u8) {
    let mut first_class: Vec<Option<u8>> = vec![None; raw.positions.len()];
    let mut copies: HashMap<(u32, u8), u32> = HashMap::new();
    for t in 0..raw.triangles.len() {
        for k in 0..3 {
            let (vertex, class) = (raw.triangles[t][k], class(t, k));
            let first = first_class[vertex as usize].get_or_insert(class);
            if *first == class {
                continue;
            }
            raw.triangles[t][k] = *copies.entry((vertex, class)).or_insert_with(|| {
                raw.positions.push(raw.positions[vertex as usize]);
                raw.normals.push(raw.normals[vertex as usize]);
                if !raw.uvs.is_empty() {
                    raw.uvs.push(raw.uvs[vertex as usize]);
                }
                raw.positions.len() as u32 - 1
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quad(mirror: bool) -> RawMesh {
        let u = |x: f32| if mirror { 1.0 - x } else { x };
        RawMesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y],
            normals: vec![],
            uvs: vec![
                Vec2::new(u(0.0), 1.0),
                Vec2::new(u(1.0), 1.0),
                Vec2::new(u(1.0), 0.0),
                Vec2::new(u(0.0), 0.0),
            ],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        }
    }

    #[test]
    fn frame_of_a_plain_quad_is_that_of_the_sample() {
        for vertex in Mesh::from_raw(quad(false)).unwrap().vertices {
            assert!((vertex.tangent - Vec3::X).length() < 1e-6, "{vertex:?}");
            assert!((vertex.normal - Vec3::Z).length() < 1e-6);
            assert_eq!(vertex.handedness, 1.0);
        }
    }

    #[test]
    fn mirrored_texture_keeps_u_along_the_tangent_and_is_marked() {
        for vertex in Mesh::from_raw(quad(true)).unwrap().vertices {
            assert!((vertex.tangent + Vec3::X).length() < 1e-6, "{vertex:?}");
            let y = vertex.handedness * vertex.normal.cross(vertex.tangent);
            assert!((y - Vec3::Y).length() < 1e-6, "y must point against v: {y}");
        }
    }

    #[test]
    fn vertices_are_split_where_mirrored_and_plain_texture_meet() {
        let mut raw = quad(false);
        raw.positions.extend([Vec3::new(2.0, 0.0, 0.0), Vec3::new(2.0, 1.0, 0.0)]);
        raw.uvs.extend([Vec2::new(0.0, 1.0), Vec2::new(0.0, 0.0)]);
        raw.triangles.extend([[1, 4, 5], [1, 5, 2]]);
        let mesh = Mesh::from_raw(raw).unwrap();
        assert_eq!(mesh.vertices.len(), 8);
        for triangle in &mesh.triangles {
            let signs = triangle.map(|i| mesh.vertices[i as usize].handedness);
            assert!(signs.iter().all(|&s| s == signs[0]));
        }
    }

    #[test]
    fn missing_texture_coordinates_are_projected_without_mirroring() {
        let sphere = crate::scene::shapes::sphere(16, 8);
        let raw = RawMesh {
            positions: sphere.vertices.iter().map(|v| v.position).collect(),
            triangles: sphere.triangles.clone(),
            ..RawMesh::default()
        };
        let mesh = Mesh::from_raw(raw).unwrap();
        assert!(mesh.vertices.iter().all(|v| v.handedness == 1.0 && v.uv.is_finite()));
        assert!(mesh.vertices.iter().all(|v| v.normal.dot(v.tangent).abs() < 1e-5));
    }

    #[test]
    fn degenerate_texture_still_gives_a_unit_frame() {
        let mut raw = quad(false);
        raw.uvs = vec![Vec2::splat(0.5); 4];
        for vertex in Mesh::from_raw(raw).unwrap().vertices {
            assert!((vertex.tangent.length() - 1.0).abs() < 1e-5);
            assert!(vertex.tangent.dot(vertex.normal).abs() < 1e-5);
        }
    }

    #[test]
    fn an_index_out_of_range_is_named() {
        let mut raw = quad(false);
        raw.triangles.push([0, 1, 9]);
        let text = Mesh::from_raw(raw).unwrap_err().to_string();
        assert!(text.contains("triangle 2") && text.contains("4 vertices"), "{text}");
    }
}
