//! A rectangular light seen from a point: its solid angle, and directions drawn evenly within it
//! (Ureña, Fajardo and King 2013, "An area-preserving parametrization for spherical rectangles").

use std::f64::consts::TAU;

use glam::{DVec3, Vec3};

/// A rectangle as a point sees it: sides x and y, z away from the point. f64, since small solid angles are differences.
pub(super) struct Seen {
    axes: [DVec3; 3],
    low: DVec3,
    high: DVec3,
    b0: f64,
    b1: f64,
    k: f64,
    solid_angle: f64,
}

impl Seen {
    /// The rectangle with the middle `centre` and sides `u`, `v` from `point`; `None` from behind its front
    /// (u × v), edge on, or where it is too small to tell.
    pub(super) fn new(centre: Vec3, [u, v]: [Vec3; 2], point: Vec3) -> Option<Self> {
        let (u, v) = (u.as_dvec3(), v.as_dvec3());
        let to = centre.as_dvec3() - point.as_dvec3();
        let (width, height) = (u.length(), v.length());
        let (x, y) = (u / width, v / height);
        // The point is on the front side when the way to the light runs against the normal.
        let away = -x.cross(y);
        let depth = to.dot(away);
        if depth <= 1e-9 * (width + height) {
            return None;
        }
        let low = DVec3::new(to.dot(x) - width / 2.0, to.dot(y) - height / 2.0, -depth);
        let high = DVec3::new(low.x + width, low.y + height, -depth);
        // Normals of the four planes through the point and an edge.
        let edge = |a: DVec3, b: DVec3| a.cross(b).normalize();
        let corner = |x: f64, y: f64| DVec3::new(x, y, -depth);
        let corners = [low, corner(high.x, low.y), high, corner(low.x, high.y)];
        let n: [DVec3; 4] = std::array::from_fn(|i| edge(corners[i], corners[(i + 1) % 4]));
        let angle = |i: usize| (-n[i].dot(n[(i + 1) % 4])).clamp(-1.0, 1.0).acos();
        let (g2, g3) = (angle(2), angle(3));
        let solid_angle = angle(0) + angle(1) + g2 + g3 - TAU;
        (solid_angle > 1e-9).then(|| Self {
            axes: [x, y, -away],
            low,
            high,
            b0: n[0].z,
            b1: n[2].z,
            k: TAU - g2 - g3,
            solid_angle,
        })
    }

    /// Solid angle, sr.
    pub(super) fn solid_angle(&self) -> f32 {
        self.solid_angle as f32
    }

    /// The offset from the point to a place on the rectangle, drawn evenly over its solid angle by two numbers in 0..1.
    pub(super) fn sample(&self, [r, s]: [f32; 2]) -> Vec3 {
        let depth = -self.low.z;
        let turn = f64::from(r) * self.solid_angle + self.k;
        let f = (turn.cos() * self.b0 - self.b1) / turn.sin();
        let c = (f.signum() / (f * f + self.b0 * self.b0).sqrt()).clamp(-1.0, 1.0);
        let x = (c * depth / (1.0 - c * c).max(1e-30).sqrt()).clamp(self.low.x, self.high.x);
        let distance = (x * x + depth * depth).sqrt();
        let sine = |y: f64| y / (distance * distance + y * y).sqrt();
        let (h0, h1) = (sine(self.low.y), sine(self.high.y));
        let h = h0 + f64::from(s) * (h1 - h0);
        let y = (h * distance / (1.0 - h * h).max(1e-30).sqrt()).clamp(self.low.y, self.high.y);
        (self.axes[0] * x + self.axes[1] * y + self.axes[2] * self.low.z).as_vec3()
    }
}
