//! Sphere, torus, cylinder and box to a tolerance: closed, centred on the origin, outside out.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DVec2, Vec2, Vec3};

use super::turned::{Segment, turned};
use crate::scene::mesh::{Mesh, Vertex};
use lobelia_base::error::{Error, Result};

/// Refuses a length that is none, by its key.
fn positive(key: &str, length: f64) -> Result<()> {
    if length.is_finite() && length > 0.0 {
        return Ok(());
    }
    Err(Error::input(format!("key {key}: {length} is no length; use more than 0")))
}

/// A ball; u runs once around to the east, v from the north pole (+y) down.
///
/// # Errors
/// Input errors for a radius or tolerance that is not positive, or takes too many triangles; so below.
pub fn ball(radius: f64, tolerance: f64) -> Result<Mesh> {
    positive("radius", radius)?;
    let meridian = Segment::Arc { centre: DVec2::ZERO, radius, from: FRAC_PI_2, to: -FRAC_PI_2 };
    turned(&[meridian], tolerance)
}

/// A ring about the y axis: a circle of radius `tube` whose centre goes around at `radius`. u runs around the
/// axis, v around the tube, from its inside up and over.
///
/// # Errors
/// As [`ball`]; a tube as thick as the ring's radius is refused.
pub fn torus(radius: f64, tube: f64, tolerance: f64) -> Result<Mesh> {
    positive("radius", radius)?;
    positive("tube", tube)?;
    if tube >= radius {
        return Err(Error::input(format!("key tube: {tube} must be less than the radius, {radius}")));
    }
    let circle = Segment::Arc { centre: DVec2::new(radius, 0.0), radius: tube, from: PI, to: -PI };
    turned(&[circle], tolerance)
}

/// A cylinder about the y axis. On its side u runs around and v down; the lids have the texture of a square
/// about them, u along +x.
///
/// # Errors
/// As [`ball`].
pub fn cylinder(radius: f64, height: f64, lids: bool, tolerance: f64) -> Result<Mesh> {
    positive("radius", radius)?;
    positive("height", height)?;
    let top = DVec2::new(radius, height / 2.0);
    let mut mesh = turned(&[Segment::Line([top, DVec2::new(radius, -top.y)])], tolerance)?;
    if lids {
        let ring = mesh.vertices.len() / 2;
        lid(&mut mesh, 0, ring, radius as f32, 1.0);
        lid(&mut mesh, ring, ring, radius as f32, -1.0);
    }
    Ok(mesh)
}

/// Closes a ring of vertices, whose first and last are at one place, by a flat lid that faces along ±y.
fn lid(mesh: &mut Mesh, start: usize, count: usize, radius: f32, up: f32) {
    let first = mesh.vertices.len() as u32;
    let ring: Vec<Vec3> = mesh.vertices[start..start + count - 1].iter().map(|v| v.position).collect();
    let middle = Vec3::new(0.0, ring[0].y, 0.0);
    for position in std::iter::once(middle).chain(ring.iter().copied()) {
        mesh.vertices.push(Vertex {
            position,
            normal: Vec3::Y * up,
            tangent: Vec3::X,
            handedness: 1.0,
            uv: 0.5 + Vec2::new(position.x, position.z * up) / (2.0 * radius),
        });
    }
    let count = ring.len() as u32;
    for k in 0..count {
        let [a, b] = [first + 1 + k, first + 1 + (k + 1) % count];
        mesh.triangles.push(if up > 0.0 { [first, a, b] } else { [first, b, a] });
    }
}

/// A box of these sides; each face has the whole texture, upright seen from outside, the lids with u along
/// +x.
///
/// # Errors
/// As [`ball`].
pub fn cuboid(size: [f64; 3]) -> Result<Mesh> {
    size.iter().try_for_each(|&side| positive("size", side))?;
    let half = Vec3::from_array(size.map(|side| (side / 2.0) as f32));
    let mut mesh = Mesh::default();
    // The directions in which u grows and v falls.
    for (right, up) in [
        (Vec3::NEG_Z, Vec3::Y),
        (Vec3::Z, Vec3::Y),
        (Vec3::X, Vec3::NEG_Z),
        (Vec3::X, Vec3::Z),
        (Vec3::X, Vec3::Y),
        (Vec3::NEG_X, Vec3::Y),
    ] {
        let (normal, first) = (right.cross(up), mesh.vertices.len() as u32);
        for (u, v) in [(0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, 0.0)] {
            mesh.vertices.push(Vertex {
                position: (normal + right * (2.0 * u - 1.0) + up * (1.0 - 2.0 * v)) * half,
                normal,
                tangent: right,
                handedness: 1.0,
                uv: Vec2::new(u, v),
            });
        }
        mesh.triangles.extend([[0, 1, 2], [0, 2, 3]].map(|triangle| triangle.map(|i: u32| i + first)));
    }
    Ok(mesh)
}

/// A profile turned about the y axis, given as points of radius and height: corners of straight pieces, or
/// control points of cubic Bézier pieces, three a piece after the first point. Where it ends at its start or
/// at the axis on both ends, it bounds a solid.
///
/// # Errors
/// As [`turned`]; too few points, or not three a piece.
pub fn lathe(points: &[[f64; 2]], smooth: bool, tolerance: f64) -> Result<Mesh> {
    let at = |k: usize| DVec2::from_array(points[k]);
    let segments: Vec<Segment> = if smooth {
        if points.len() < 4 || points.len() % 3 != 1 {
            return Err(Error::input(format!(
                "key profile: a smooth one has 4, 7, 10, … points, three a piece after the first; these are \
                 {}",
                points.len()
            )));
        }
        (0..points.len() / 3)
            .map(|k| Segment::Cubic([at(3 * k), at(3 * k + 1), at(3 * k + 2), at(3 * k + 3)]))
            .collect()
    } else {
        if points.len() < 2 {
            return Err(Error::input("key profile: there must be two points at least"));
        }
        (1..points.len()).map(|k| Segment::Line([at(k - 1), at(k)])).collect()
    };
    turned(&segments, tolerance).map_err(|error| error.at("key profile"))
}
