//! Procedural meshes with exact texture coordinates and tangent frames. All have +y up and are about one unit
//! in size.

pub mod height_field;
#[cfg(test)]
pub(in crate::scene) mod solid_tests;
pub mod solids;
pub(in crate::scene) mod tolerance;
pub mod turned;

use std::f32::consts::{FRAC_PI_2, PI, TAU};

use glam::{Vec2, Vec3};

use super::frame::perpendicular;
use super::mesh::{Mesh, Vertex};

/// A rectangular grid of columns × rows cells over u, v in 0..1; `vertex` gives the position and the normal's
/// direction.
fn grid(columns: u32, rows: u32, surface: impl Fn(Vec2) -> Vec3, normal: impl Fn(Vec2) -> Vec3) -> Mesh {
    let mut mesh = Mesh::default();
    for row in 0..=rows {
        for column in 0..=columns {
            let uv = Vec2::new(column as f32 / columns as f32, row as f32 / rows as f32);
            let normal = normal(uv).normalize_or(Vec3::Y);
            let along_u = derivative(&surface, uv, Vec2::X);
            let position = surface(uv);
            let tangent = perpendicular(along_u, normal);
            mesh.vertices.push(Vertex { position, normal, tangent, handedness: 1.0, uv });
        }
    }
    let at = |row: u32, column: u32| row * (columns + 1) + column;
    for row in 0..rows {
        for column in 0..columns {
            let [a, b, c, d] =
                [at(row, column), at(row + 1, column), at(row + 1, column + 1), at(row, column + 1)];
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    mesh
}

/// Central difference of a surface along a direction in texture space.
fn derivative(surface: &impl Fn(Vec2) -> Vec3, uv: Vec2, along: Vec2) -> Vec3 {
    const STEP: f32 = 1e-3;
    surface(uv + along * STEP) - surface(uv - along * STEP)
}

/// The outward normal of a surface whose u runs right and v down.
fn normal_of(surface: &impl Fn(Vec2) -> Vec3, uv: Vec2) -> Vec3 {
    derivative(surface, uv, Vec2::X).cross(-derivative(surface, uv, Vec2::Y))
}

/// Unit sphere about the origin; u runs once around to the east, v from the north pole (+y) down.
pub fn sphere(columns: u32, rows: u32) -> Mesh {
    let point = |uv: Vec2| {
        let (polar, azimuth) = (uv.y * PI, uv.x * TAU);
        Vec3::new(polar.sin() * azimuth.sin(), polar.cos(), polar.sin() * azimuth.cos())
    };
    let mut mesh = grid(columns, rows, point, point);
    // At the poles dP/du vanishes: the frame of the meridian is its limit.
    for vertex in &mut mesh.vertices {
        let azimuth = vertex.uv.x * TAU;
        vertex.tangent = Vec3::new(azimuth.cos(), 0.0, -azimuth.sin());
    }
    // Half of the triangles at the poles have two corners in one point.
    let has_area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|i| mesh.vertices[i as usize].position);
        a.distance(b).min(b.distance(c)).min(c.distance(a)) > 1e-6
    };
    let kept = mesh.triangles.iter().copied().filter(has_area).collect();
    mesh.triangles = kept;
    mesh
}

/// So many balls of unequal size, spread evenly over the cube −1..1.
pub fn swarm(count: u32) -> Mesh {
    /// Powers of the inverse of the root of x⁴ = x + 1: no gaps and no clusters, whatever the count.
    const STEPS: Vec3 = Vec3::new(0.819_172_5, 0.671_043_6, 0.549_700_5);
    let ball = sphere(16, 8);
    let mut mesh = Mesh::default();
    for k in 0..count {
        let place = 2.0 * (STEPS * (k as f32 + 0.5)).fract() - 1.0;
        let radius = 0.02 + 0.03 * (0.618_034 * k as f32).fract();
        let first = mesh.vertices.len() as u32;
        let placed = |vertex: &Vertex| Vertex { position: vertex.position * radius + place, ..*vertex };
        mesh.vertices.extend(ball.vertices.iter().map(placed));
        mesh.triangles.extend(ball.triangles.iter().map(|triangle| triangle.map(|i| i + first)));
    }
    mesh
}

/// Square −1..1 in the x–z plane facing +y; u along +x, v along +z.
pub fn plane(cells: u32) -> Mesh {
    grid(cells, cells, |uv| Vec3::new(2.0 * uv.x - 1.0, 0.0, 2.0 * uv.y - 1.0), |_| Vec3::Y)
}

/// A photographer's backdrop: floor −1..1 that curves up into a wall at z = −1; faces +y and +z.
pub fn backdrop(cells: u32) -> Mesh {
    const RADIUS: f32 = 0.5;
    const FLOOR: f32 = 2.0 - RADIUS;
    let arc = RADIUS * FRAC_PI_2;
    let total = FLOOR + arc + 1.0;
    let surface = move |uv: Vec2| {
        let x = 2.0 * uv.x - 1.0;
        // Arc length from the floor's front edge.
        let s = (1.0 - uv.y) * total;
        if s <= FLOOR {
            return Vec3::new(x, 0.0, 1.0 - s);
        }
        let angle = ((s - FLOOR) / RADIUS).min(FRAC_PI_2);
        let above = (s - FLOOR - arc).max(0.0);
        Vec3::new(x, RADIUS * (1.0 - angle.cos()) + above, 1.0 - FLOOR - RADIUS * angle.sin())
    };
    grid(cells, cells, surface, move |uv| normal_of(&surface, uv))
}

/// Radius of the form under [`drape`], and the height of its centre.
const FORM: f32 = 0.62;
/// Half the edge of the draped cloth.
const HALF_EDGE: f32 = 1.30;
/// Polar angle at which the cloth leaves the form.
const LEAVES: f32 = 1.36;
/// Radius of the bend where the cloth meets the floor, and how far above the floor it lies.
const BEND: f32 = 0.09;
const CLEARANCE: f32 = 0.02;

/// A square cloth over a sphere that stands on the floor y = 0: it hangs in folds, its corners lie on the
/// floor. About 1.25 high and 2 wide.
///
/// Lengths along the cloth's radii are kept; around the form the surplus cloth goes into folds, whose depth
/// follows from the surplus: waves of depth a and number k add (k a / 2 r)² of the circumference.
pub fn drape(cells: u32) -> Mesh {
    grid(cells, cells, drape_point, |uv| normal_of(&drape_point, uv))
}

/// Position of the cloth's point (u, v).
fn drape_point(uv: Vec2) -> Vec3 {
    const WAVES: f32 = 8.0;
    let flat = Vec2::new(2.0 * uv.x - 1.0, 2.0 * uv.y - 1.0) * HALF_EDGE;
    // Arc length from the top, measured along the cloth.
    let s = flat.length();
    let azimuth = flat.y.atan2(flat.x);
    let profile = drape_profile(s);

    // Folds begin where the surplus is worth a fold; uneven waves look like cloth.
    let surplus = (s / profile.x.max(1e-4) - 1.0).max(0.0);
    let start = smoothstep(0.6 * FORM, 1.9 * FORM, s);
    let phase = (azimuth * 2.0 + 0.6).sin() + 0.7 * (azimuth * 3.0 - 1.1).sin();
    let depth = start * profile.x.min(FORM) * 1.35 / WAVES * surplus.min(1.2).sqrt();
    let wave = (azimuth * WAVES + phase).cos() + 0.25 * (azimuth * 5.0 + 0.8).cos();
    let radius = profile.x + depth * (wave + 0.35);
    let direction = if s > 0.0 { flat / s } else { Vec2::ZERO };
    Vec3::new(direction.x * radius, profile.y + CLEARANCE, direction.y * radius)
}

/// Radius and height of the unfolded cloth at arc length `s` from the top: over the form, straight down, out
/// on the floor.
fn drape_profile(s: f32) -> Vec2 {
    let on_form = (s / FORM).min(LEAVES);
    let at_form = Vec2::new(FORM * on_form.sin(), FORM + FORM * on_form.cos());
    let (sin, cos) = LEAVES.sin_cos();
    let leaving = Vec2::new(cos, -sin);
    let falls = s - FORM * LEAVES;
    if falls <= 0.0 {
        return at_form;
    }
    // The bend turns by what the fall lacks to be level: LEAVES radians.
    let drop_in_bend = BEND * (1.0 - cos);
    let straight = (at_form.y - drop_in_bend) / sin;
    if falls <= straight {
        return at_form + leaving * falls;
    }
    let foot = at_form + leaving * straight;
    let turned = ((falls - straight) / BEND).min(LEAVES);
    let left = LEAVES - turned;
    let bent = foot + BEND * Vec2::new(sin - left.sin(), cos - left.cos());
    bent + Vec2::new((falls - straight - BEND * LEAVES).max(0.0), 0.0)
}

/// Hermite step from 0 at `from` to 1 at `to`.
fn smoothstep(from: f32, to: f32, x: f32) -> f32 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames_fit_their_triangles(mesh: &Mesh) {
        for vertex in &mesh.vertices {
            assert!((vertex.normal.length() - 1.0).abs() < 1e-4 && vertex.position.is_finite());
            assert!((vertex.tangent.length() - 1.0).abs() < 1e-4, "{vertex:?}");
            assert!(vertex.normal.dot(vertex.tangent).abs() < 1e-4, "{vertex:?}");
        }
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|i| mesh.vertices[i as usize]);
            let (ab, ac) = (b.position - a.position, c.position - a.position);
            let face = ab.cross(ac);
            assert!(face.dot(a.normal + b.normal + c.normal) > 0.0, "turned triangle {triangle:?}");
            // Counter-clockwise in texture space too: not mirrored.
            assert!((b.uv - a.uv).perp_dot(c.uv - a.uv) < 0.0);
        }
    }

    #[test]
    fn every_shape_has_outward_triangles_and_orthonormal_frames() {
        for mesh in [sphere(24, 12), plane(4), backdrop(16), drape(96), swarm(5)] {
            frames_fit_their_triangles(&mesh);
        }
    }

    #[test]
    fn the_frame_follows_the_texture_coordinates() {
        for mesh in [sphere(64, 32), plane(4), backdrop(64), drape(200)] {
            let mut agreeing = 0;
            for triangle in &mesh.triangles {
                let [a, b, c] = triangle.map(|i| mesh.vertices[i as usize]);
                let (v1, v2) = (b.position - a.position, c.position - a.position);
                let (d1, d2) = (b.uv - a.uv, c.uv - a.uv);
                let along_u = (v1 * d2.y - v2 * d1.y) / d1.perp_dot(d2);
                agreeing += usize::from(along_u.normalize().dot(a.tangent) > 0.9);
            }
            assert!(agreeing * 100 >= mesh.triangles.len() * 97, "{agreeing} of {}", mesh.triangles.len());
        }
    }

    #[test]
    fn the_drape_stands_on_the_floor_without_sinking_through() {
        let (low, high) = drape(128).bounds();
        assert!(low.y > 0.0 && low.y < 0.05, "{low}");
        assert!(high.y > 1.1 && high.y < 1.4, "{high}");
    }
}
