//! What shines nearby: flat convex polygons that shine evenly to their front, are black behind, and hide one
//! another.

use glam::DVec3;

use super::polygon::{Detail, Edge, Region};
use crate::scene::Light;

/// A convex polygon.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Emitter {
    /// Counter-clockwise seen from its front.
    pub(super) corners: Vec<DVec3>,
    /// Unit vector to its front.
    normal: DVec3,
    /// Radiance of the front.
    radiance: DVec3,
}

/// The polygons of a scene's lights that have a surface.
pub(super) fn of_lights(lights: &[Light]) -> Vec<Emitter> {
    lights.iter().flat_map(of_light).collect()
}

/// The polygons of one light.
fn of_light(light: &Light) -> Option<Emitter> {
    let Light::Rectangle { centre, edges, radiance } = *light else { return None };
    let [u, v] = edges.map(|edge| edge.as_dvec3() / 2.0);
    let centre = centre.as_dvec3();
    Some(Emitter {
        corners: [-u - v, u - v, u + v, v - u].map(|corner| centre + corner).into(),
        normal: u.cross(v).normalize(),
        radiance: radiance.as_dvec3(),
    })
}

impl Emitter {
    /// The middle of its corners.
    pub(super) fn middle(&self) -> DVec3 {
        self.corners.iter().sum::<DVec3>() / self.corners.len() as f64
    }

    /// Whether a point is on the side that shines.
    pub(super) fn shines_to(&self, point: DVec3) -> bool {
        self.radiance != DVec3::ZERO && self.normal.dot(point - self.corners[0]) > 0.0
    }
}

/// An emitter seen from a point.
struct Seen {
    /// Its outline, counter-clockwise as it is seen, in points of its plane.
    outline: Vec<Edge>,
    /// Of its plane, away from the viewer, and its distance.
    normal: DVec3,
    distance: f64,
    radiance: DVec3,
}

impl Seen {
    /// None for an emitter in whose plane the point lies.
    fn new(emitter: &Emitter, point: DVec3) -> Option<Self> {
        let mut corners: Vec<DVec3> = emitter.corners.iter().map(|&corner| corner - point).collect();
        let size = corners.iter().map(|corner| corner.length()).fold(0.0, f64::max);
        let distance = -emitter.normal.dot(corners[0]);
        if distance.abs() <= 1e-9 * size {
            return None;
        }
        let front = distance > 0.0;
        if front {
            corners.reverse();
        }
        Some(Self {
            outline: closed(&corners),
            normal: if front { -emitter.normal } else { emitter.normal },
            distance: distance.abs(),
            radiance: if front { emitter.radiance } else { DVec3::ZERO },
        })
    }

    /// The part of another's outline that lies before this one's plane.
    fn before(&self, other: &Self) -> Vec<Edge> {
        let height = |point: DVec3| self.distance - self.normal.dot(point);
        let mut kept = Vec::with_capacity(other.outline.len() + 1);
        for &Edge { from, to, .. } in &other.outline {
            let [a, b] = [height(from), height(to)];
            if a > 0.0 {
                kept.push(from);
            }
            if (a > 0.0) != (b > 0.0) {
                kept.push(from + (to - from) * (a / (a - b)));
            }
        }
        if kept.len() < 3 { Vec::new() } else { closed(&kept) }
    }
}

/// Edges between corners in order.
fn closed(corners: &[DVec3]) -> Vec<Edge> {
    let next = corners.iter().cycle().skip(1);
    corners.iter().zip(next).map(|(&from, &to)| Edge::of_line(from, to)).collect()
}

/// Whether no corner of a convex outline is beyond a plane through the viewer, to the normal's side.
fn below(outline: &[Edge], normal: DVec3) -> bool {
    outline.iter().all(|edge| normal.dot(edge.from) <= 1e-12 * normal.length() * edge.from.length())
}

/// Whether two convex outlines overlap as they are seen.
fn overlap(a: &[Edge], b: &[Edge]) -> bool {
    let apart = |a: &[Edge], b: &[Edge]| a.iter().any(|edge| below(b, edge.from.cross(edge.to)));
    !apart(a, b) && !apart(b, a)
}

/// The part of a convex outline on the normal's side of a plane through the viewer; `near` is of the line
/// that cuts.
fn clipped(outline: &[Edge], normal: DVec3, near: DVec3) -> Vec<Edge> {
    if below(outline, normal) {
        return Vec::new();
    }
    let mut kept = Vec::with_capacity(outline.len() + 1);
    let (mut leaves, mut enters) = (None, None);
    for &Edge { from, to, near } in outline {
        let [a, b] = [from, to].map(|point| normal.dot(point));
        let cut = || from + (to - from) * (a / (a - b));
        match (a > 0.0, b > 0.0) {
            (true, true) => kept.push(Edge { from, to, near }),
            (true, false) => {
                kept.push(Edge { from, to: cut(), near });
                leaves = Some((kept.len(), cut()));
            }
            (false, true) => {
                enters = Some(cut());
                kept.push(Edge { from: cut(), to, near });
            }
            (false, false) => {}
        }
    }
    if let (Some((at, from)), Some(to)) = (leaves, enters) {
        kept.insert(at, Edge { from, to, near });
    }
    kept
}

/// Convex parts of what is seen of one emitter beside others in front of it.
fn visible(one: &Seen, all: &[Seen], index: usize) -> Vec<Vec<Edge>> {
    let mut parts = vec![one.outline.clone()];
    for (_, other) in all.iter().enumerate().filter(|(k, _)| *k != index) {
        let blocker = one.before(other);
        if blocker.is_empty() {
            continue;
        }
        let mut left = Vec::with_capacity(parts.len());
        for mut part in parts {
            if !overlap(&part, &blocker) {
                left.push(part);
                continue;
            }
            for edge in &blocker {
                let inward = edge.from.cross(edge.to);
                let outside = clipped(&part, -inward, edge.near);
                if !outside.is_empty() {
                    left.push(outside);
                }
                part = clipped(&part, inward, edge.near);
                if part.is_empty() {
                    break;
                }
            }
        }
        parts = left;
    }
    parts
}

/// Incident radiance at a point, red, green and blue of each coefficient, and how it changes with the point.
#[derive(Debug, Clone)]
pub(super) struct Incident {
    pub(super) values: Vec<DVec3>,
    /// Along x, y, z, where they are wanted.
    pub(super) gradients: Vec<[DVec3; 3]>,
    /// xx, yy, zz, xy, xz, yz, where they are wanted.
    pub(super) seconds: Vec<[DVec3; 6]>,
}

impl Incident {
    /// At a point, from all emitters.
    pub(super) fn at(emitters: &[Emitter], point: DVec3, degree: usize, detail: Detail) -> Self {
        let mut region = Region::new(degree, detail);
        let mut incident = Self {
            values: vec![DVec3::ZERO; region.values.len()],
            gradients: vec![[DVec3::ZERO; 3]; region.gradients.len()],
            seconds: vec![[DVec3::ZERO; 6]; region.seconds.len()],
        };
        let seen: Vec<Seen> = emitters.iter().filter_map(|emitter| Seen::new(emitter, point)).collect();
        for (index, one) in seen.iter().enumerate().filter(|(_, one)| one.radiance != DVec3::ZERO) {
            region.clear();
            visible(one, &seen, index).iter().for_each(|part| region.add(part));
            for (sum, value) in incident.values.iter_mut().zip(&region.values) {
                *sum += one.radiance * *value;
            }
            for (sum, gradient) in incident.gradients.iter_mut().zip(&region.gradients) {
                sum.iter_mut().zip(gradient.to_array()).for_each(|(sum, value)| *sum += one.radiance * value);
            }
            for (sum, seconds) in incident.seconds.iter_mut().zip(&region.seconds) {
                sum.iter_mut().zip(seconds).for_each(|(sum, value)| *sum += one.radiance * *value);
            }
        }
        incident
    }
}

/// The harmonic mean, by solid angle, of the distances of all emitters that are seen from a point, from
/// behind too; none where none is.
pub(super) fn harmonic_distance(emitters: &[Emitter], point: DVec3) -> Option<f64> {
    let seen: Vec<Seen> = emitters.iter().filter_map(|emitter| Seen::new(emitter, point)).collect();
    let (mut solid, mut inverse) = (0.0, 0.0);
    for (index, one) in seen.iter().enumerate() {
        let mut region = Region::new(1, Detail::Values);
        visible(one, &seen, index).iter().for_each(|part| region.add(part));
        let [zero, y, z, x] = [0, 1, 2, 3].map(|i| region.values[i]);
        // Y_00 is a constant, those of degree 1 are −y, z and −x times another.
        let pi = std::f64::consts::PI;
        solid += zero * (4.0 * pi).sqrt();
        inverse += DVec3::new(-x, -y, z).dot(one.normal) * (4.0 * pi / 3.0).sqrt() / one.distance;
    }
    (solid > 1e-12 && inverse > 0.0).then(|| solid / inverse)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::render::incident::harmonics::{COUNT, MOST, basis, gauss};
    use glam::{DQuat, Vec3};

    pub(in super::super) fn rectangle(
        centre: Vec3,
        turn: [f32; 2],
        sides: [f32; 2],
        radiance: Vec3,
    ) -> Light {
        let rotation = glam::Quat::from_euler(glam::EulerRot::YXZ, turn[0], turn[1], 0.0);
        let edges = [rotation * Vec3::X * sides[0], rotation * Vec3::Y * sides[1]];
        Light::Rectangle { centre, edges, radiance }
    }

    /// By 24 × 24 nodes in each of some squares of the rectangles, as far as no other is in between.
    fn by_quadrature(lights: &[Light], point: DVec3, squares: usize) -> [DVec3; COUNT] {
        let all: Vec<_> = lights
            .iter()
            .map(|light| {
                let Light::Rectangle { centre, edges, radiance } = *light else { panic!() };
                (centre.as_dvec3(), edges.map(|edge| edge.as_dvec3()), radiance.as_dvec3())
            })
            .collect();
        let hidden = |own: usize, to: DVec3| {
            all.iter().enumerate().any(|(k, &(centre, [u, v], _))| {
                let normal = u.cross(v);
                let t = (centre - point).dot(normal) / to.dot(normal);
                let at = point + to * t - centre;
                let inside = |edge: DVec3| (at.dot(edge) / edge.length_squared()).abs() < 0.5;
                k != own && t > 0.0 && t < 1.0 && inside(u) && inside(v)
            })
        };
        let mut sum = [DVec3::ZERO; COUNT];
        for (k, &(centre, [u, v], radiance)) in all.iter().enumerate() {
            let normal = u.cross(v);
            if (point - centre).dot(normal) <= 0.0 {
                continue;
            }
            let nodes = || {
                (0..squares).flat_map(|cell| {
                    let of = move |&[x, w]: &[f64; 2]| {
                        let part = (cell as f64 + (x + 1.0) / 2.0) / squares as f64 - 0.5;
                        [part, w / 2.0 / squares as f64]
                    };
                    gauss(24).iter().map(of)
                })
            };
            for [a, wa] in nodes() {
                for [b, wb] in nodes() {
                    let to = centre + u * a + v * b - point;
                    if hidden(k, to) {
                        continue;
                    }
                    let solid = -normal.dot(to) / to.length().powi(3) * wa * wb;
                    for (sum, y) in sum.iter_mut().zip(basis(MOST, to.normalize())) {
                        *sum += radiance * (y * solid);
                    }
                }
            }
        }
        sum
    }

    fn norm(values: &[DVec3]) -> f64 {
        values.iter().map(|value| value.length_squared()).sum::<f64>().sqrt()
    }

    fn distance(a: &[DVec3], b: &[DVec3]) -> f64 {
        norm(&a.iter().zip(b).map(|(a, b)| *a - *b).collect::<Vec<_>>())
    }

    /// One rectangle near, one far and tilted, one seen from behind.
    fn apart() -> Vec<Light> {
        vec![
            rectangle(Vec3::new(0.2, 0.1, -1.5), [0.3, -0.2], [1.2, 0.8], Vec3::new(2.0, 1.0, 0.5)),
            rectangle(Vec3::new(6.0, 1.0, -3.0), [-1.2, 0.1], [2.0, 2.5], Vec3::new(0.3, 1.0, 4.0)),
            rectangle(Vec3::new(-2.0, 0.4, 0.0), [-1.4, 0.3], [0.8, 0.8], Vec3::ONE * 5.0),
        ]
    }

    /// A plate before a part of a light, and a light that cuts through both.
    fn hiding() -> Vec<Light> {
        vec![
            rectangle(Vec3::new(0.2, 0.1, -1.5), [0.1, -0.2], [2.0, 1.4], Vec3::new(2.0, 1.0, 0.5)),
            rectangle(Vec3::new(0.3, 0.2, -0.9), [0.3, 0.4], [0.5, 0.4], Vec3::ZERO),
            rectangle(Vec3::new(-0.5, -0.2, -1.3), [0.9, 0.2], [1.0, 0.7], Vec3::new(0.1, 0.5, 3.0)),
        ]
    }

    #[test]
    fn coefficients_are_those_of_quadrature_over_the_emitters() {
        let lights = apart();
        let emitters = of_lights(&lights);
        for point in [DVec3::ZERO, DVec3::new(0.4, 0.1, -1.2), DVec3::new(-0.3, 0.9, 0.8)] {
            let found = Incident::at(&emitters, point, MOST, Detail::Values);
            let expected = by_quadrature(&lights, point, 6);
            let error = distance(&found.values, &expected) / norm(&expected);
            assert!(error < 1e-9, "{point}: {error:e}");
        }
    }

    #[test]
    fn what_another_hides_is_left_out_of_the_coefficients() {
        let lights = hiding();
        let emitters = of_lights(&lights);
        for point in [DVec3::ZERO, DVec3::new(0.4, 0.1, -0.2), DVec3::new(-0.3, 0.9, 0.8)] {
            let found = Incident::at(&emitters, point, MOST, Detail::Values);
            let expected = by_quadrature(&lights, point, 20);
            let error = distance(&found.values, &expected) / norm(&expected);
            let open = Incident::at(&emitters[..1], point, MOST, Detail::Values);
            let hidden = distance(&found.values, &open.values) / norm(&expected);
            // Quadrature sees the plates' edges to its own spacing.
            assert!(error < 2e-3 && hidden > 0.1, "{point}: {error:e}, hidden {hidden}");
        }
    }

    /// With the edge of what hides at its own distance: at the hidden light's it would be wrong by much.
    #[test]
    fn gradients_are_differences_of_coefficients_behind_blockers_too() {
        for lights in [apart(), hiding()] {
            let emitters = of_lights(&lights);
            for point in [DVec3::ZERO, DVec3::new(0.4, 0.1, -0.2), DVec3::new(-0.3, 0.9, 0.8)] {
                let found = Incident::at(&emitters, point, MOST, Detail::Gradients);
                for (axis, along) in DVec3::AXES.into_iter().enumerate() {
                    let at = |step: f64| {
                        Incident::at(&emitters, point + along * step, MOST, Detail::Values).values
                    };
                    let (up, down) = (at(1e-5), at(-1e-5));
                    let expected: [DVec3; COUNT] = std::array::from_fn(|i| (up[i] - down[i]) / 2e-5);
                    let gradient: [DVec3; COUNT] = std::array::from_fn(|i| found.gradients[i][axis]);
                    let error = distance(&gradient, &expected) / norm(&expected);
                    assert!(error < 1e-6, "{point}, axis {axis}: {error:e}");
                }
            }
        }
    }

    #[test]
    fn second_derivatives_are_differences_of_gradients_where_nothing_hides() {
        let emitters = of_lights(&apart());
        for point in [DVec3::ZERO, DVec3::new(0.4, 0.1, -1.2)] {
            let found = Incident::at(&emitters, point, MOST, Detail::Seconds);
            for (axis, along) in DVec3::AXES.into_iter().enumerate() {
                let at = |step: f64| {
                    Incident::at(&emitters, point + along * step, MOST, Detail::Gradients).gradients
                };
                let (up, down) = (at(1e-5), at(-1e-5));
                for other in 0..3 {
                    let place = [[0, 3, 4], [3, 1, 5], [4, 5, 2]][axis][other];
                    let expected: [DVec3; COUNT] =
                        std::array::from_fn(|i| (up[i][other] - down[i][other]) / 2e-5);
                    let second: [DVec3; COUNT] = std::array::from_fn(|i| found.seconds[i][place]);
                    let error = distance(&second, &expected) / norm(&expected);
                    assert!(error < 1e-5, "{point}, {axis} {other}: {error:e}");
                }
            }
        }
    }

    #[test]
    fn the_harmonic_distance_is_that_of_quadrature_and_counts_what_hides() {
        let lights = apart();
        let point = DVec3::new(0.3, -0.2, 0.1);
        let (mut solid, mut inverse) = (0.0, 0.0);
        for light in &lights {
            let Light::Rectangle { centre, edges: [u, v], .. } = *light else { panic!() };
            let [centre, u, v] = [centre, u, v].map(Vec3::as_dvec3);
            for k in 0..200 * 200 {
                let [a, b] = [k % 200, k / 200].map(|k| (f64::from(k) + 0.5) / 200.0 - 0.5);
                let to = centre + u * a + v * b - point;
                let part = u.cross(v).dot(to).abs() / to.length().powi(3);
                solid += part;
                inverse += part / to.length();
            }
        }
        let found = harmonic_distance(&of_lights(&lights), point).unwrap();
        assert!((found / (solid / inverse) - 1.0).abs() < 1e-4, "{found}");
        assert_eq!(harmonic_distance(&[], point), None);
    }

    #[test]
    fn a_box_of_light_about_a_point_is_even_whichever_way_it_is_turned() {
        let sides = |turn: DQuat| -> Vec<Emitter> {
            let faces = [DVec3::X, DVec3::Y, DVec3::Z].into_iter().flat_map(|axis| [axis, -axis]);
            let of = |face: DVec3| {
                let u = face.any_orthonormal_vector();
                let v = -face.cross(u);
                let [centre, u, v] = [face, u * 2.0, v * 2.0].map(|vector| (turn * vector).as_vec3());
                Light::Rectangle { centre, edges: [u, v], radiance: Vec3::ONE }
            };
            of_lights(&faces.map(of).collect::<Vec<_>>())
        };
        for turn in [DQuat::IDENTITY, DQuat::from_rotation_y(0.7), DQuat::from_rotation_x(1.1)] {
            let found = Incident::at(&sides(turn), DVec3::new(0.1, -0.2, 0.05), MOST, Detail::Values);
            let even = (4.0 * std::f64::consts::PI).sqrt();
            assert!((found.values[0].x - even).abs() < 1e-5 * even);
            assert!(found.values[1..].iter().all(|value| value.length() < 1e-5), "{:?}", &found.values[..9]);
        }
    }

    #[test]
    fn a_point_in_the_plane_of_an_emitter_sees_nothing_of_it() {
        let lights = [rectangle(Vec3::ZERO, [0.0, 0.0], [1.0, 1.0], Vec3::ONE)];
        for point in [DVec3::new(2.0, 0.0, 0.0), DVec3::new(0.2, 0.0, 0.0), DVec3::new(0.5, 0.5, 0.0)] {
            let found = Incident::at(&of_lights(&lights), point, MOST, Detail::Seconds);
            assert!(
                norm(&found.values) == 0.0 && found.seconds.iter().flatten().all(|second| second.is_finite())
            );
        }
    }
}
