//! A shining triangle seen from a point: its solid angle, and places on it drawn evenly over the solid angle
//! where that is large (Arvo 1995, "Stratified sampling of spherical triangles"), over its area where it is
//! small and both are the same.

use std::f64::consts::{PI, TAU};

use glam::{DVec3, Vec3};

/// Solid angles, sr, between which places are drawn over the solid angle.
const SPHERICAL: [f64; 2] = [1e-3, 0.95 * TAU];

/// A triangle that shines from the side on which its corners run counter-clockwise.
#[derive(Debug, Clone, Copy)]
pub(super) struct Triangle {
    corners: [Vec3; 3],
    /// Unit normal, and area.
    pub(super) normal: Vec3,
    pub(super) area: f32,
}

/// A triangle from a point.
pub(super) struct Seen<'a> {
    triangle: &'a Triangle,
    from: Vec3,
    /// Sr, where places are drawn over it.
    solid_angle: Option<f64>,
}

impl Triangle {
    /// None where it has no area.
    pub(super) fn new(corners: [Vec3; 3]) -> Option<Self> {
        let [a, b, c] = corners.map(Vec3::as_dvec3);
        let cross = (b - a).cross(c - a);
        let normal = cross.try_normalize()?.as_vec3();
        Some(Self { corners, normal, area: 0.5 * cross.length() as f32 })
    }

    /// The triangle from a point; `None` from behind its front or edge on.
    pub(super) fn seen(&self, from: Vec3) -> Option<Seen<'_>> {
        let to = self.corners.map(|corner| corner - from);
        let nearest = to.iter().map(|v| v.length_squared()).fold(f32::INFINITY, f32::min);
        if -self.normal.dot(to[0]) <= 1e-6 * nearest.sqrt() {
            return None;
        }
        // No part of a far triangle has a larger solid angle than the area over the square of its distance.
        let edge =
            (self.corners[1] - self.corners[0]).length().max((self.corners[2] - self.corners[0]).length());
        let reach = (nearest.sqrt() - edge).max(0.0);
        let small = self.area < SPHERICAL[0] as f32 * reach * reach;
        let solid_angle = (!small).then(|| solid_angle(to.map(Vec3::as_dvec3)));
        let spherical = |angle: &f64| (SPHERICAL[0]..SPHERICAL[1]).contains(angle);
        Some(Seen { triangle: self, from, solid_angle: solid_angle.filter(spherical) })
    }
}

/// Solid angle of a triangle by the vectors to its corners (Van Oosterom and Strackee 1983).
fn solid_angle(to: [DVec3; 3]) -> f64 {
    let [a, b, c] = to.map(DVec3::normalize_or_zero);
    let angle = 2.0 * a.dot(b.cross(c)).abs().atan2(1.0 + a.dot(b) + b.dot(c) + c.dot(a));
    if angle < 0.0 { angle + TAU } else { angle }
}

impl Seen<'_> {
    /// Density, sr⁻¹, with which [`Self::sample`] draws the direction to a place on the triangle.
    pub(super) fn density(&self, to: Vec3) -> f32 {
        if let Some(angle) = self.solid_angle {
            return (1.0 / angle) as f32;
        }
        let square = to.length_squared();
        square * square.sqrt() / (self.triangle.area * -self.triangle.normal.dot(to)).max(f32::MIN_POSITIVE)
    }

    /// The offset from the point to a place on the triangle, by two numbers in 0..1.
    pub(super) fn sample(&self, [r, s]: [f32; 2]) -> Vec3 {
        let [a, b, c] = self.triangle.corners;
        if let Some(angle) = self.solid_angle {
            let to = self.triangle.corners.map(|corner| (corner - self.from).as_dvec3());
            let direction = spherical(to, angle, [f64::from(r), f64::from(s)]);
            let normal = self.triangle.normal.as_dvec3();
            let distance = to[0].dot(normal) / direction.dot(normal);
            if distance.is_finite() && distance > 0.0 {
                return (direction * distance).as_vec3();
            }
        }
        let root = r.sqrt();
        a + (b - a) * (root * (1.0 - s)) + (c - a) * (root * s) - self.from
    }
}

/// A direction in a spherical triangle of a solid angle, drawn evenly.
fn spherical(to: [DVec3; 3], solid_angle: f64, [r, s]: [f64; 2]) -> DVec3 {
    let [a, b, c] = to.map(DVec3::normalize);
    let [ab, bc, ca] = [a.cross(b), b.cross(c), c.cross(a)].map(DVec3::normalize_or_zero);
    let alpha = ab.angle_between(-ca);
    let beta = bc.angle_between(-ab);
    let gamma = ca.angle_between(-bc);
    // Of the part of the triangle between the arc a b and the one from b to the new c.
    let part = r * solid_angle;
    let sum = part + PI;
    debug_assert!((alpha + beta + gamma - PI - solid_angle).abs() < 1e-3);
    let (sin_alpha, cos_alpha) = alpha.sin_cos();
    let (sin, cos) = (sum.sin(), sum.cos());
    let sin_phi = sin * cos_alpha - cos * sin_alpha;
    let cos_phi = cos * cos_alpha + sin * sin_alpha;
    let u = cos_phi + cos_alpha;
    let v = sin_phi - sin_alpha * a.dot(b);
    let cosine = (v + (v * cos_phi - u * sin_phi) * cos_alpha) / ((v * sin_phi + u * cos_phi) * sin_alpha);
    let cosine = if cosine.is_finite() { cosine.clamp(-1.0, 1.0) } else { 1.0 };
    let across = |v: DVec3, axis: DVec3| (v - axis * v.dot(axis)).normalize_or_zero();
    let new = a * cosine + across(c, a) * (1.0 - cosine * cosine).max(0.0).sqrt();
    let z = 1.0 - s * (1.0 - new.dot(b));
    b * z + across(new, b) * (1.0 - z * z).max(0.0).sqrt()
}
