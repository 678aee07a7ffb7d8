//! A rectangular light seen from a point: its solid angle, and directions drawn evenly within it
//! (Ureña, Fajardo and King 2013, "An area-preserving parametrization for spherical rectangles").

use std::f64::consts::TAU;

use glam::{DVec2, DVec3, Vec3};

/// A rectangular light: its middle, half its size, and the axes of its frame: sides x and y, z away from its front.
pub(super) struct Rectangle {
    centre: DVec3,
    half: DVec2,
    axes: [DVec3; 3],
}

/// A rectangle as a point sees it, in the rectangle's frame about the point. f64, since small solid angles are differences.
pub(super) struct Seen<'a> {
    rectangle: &'a Rectangle,
    low: DVec2,
    high: DVec2,
    depth: f64,
    solid_angle: f64,
}

impl Rectangle {
    /// The rectangle with the middle `centre` and sides `u`, `v`; u × v is its front.
    pub(super) fn new(centre: Vec3, [u, v]: [Vec3; 2]) -> Self {
        let (u, v) = (u.as_dvec3(), v.as_dvec3());
        let (x, y) = (u.normalize(), v.normalize());
        let half = DVec2::new(u.length(), v.length()) / 2.0;
        Self { centre: centre.as_dvec3(), half, axes: [x, y, -x.cross(y)] }
    }

    /// The rectangle from `point`; `None` from behind its front, edge on, or where it is too small to tell.
    pub(super) fn seen(&self, point: Vec3) -> Option<Seen<'_>> {
        let to = self.centre - point.as_dvec3();
        let [x, y, z] = self.axes.map(|axis| to.dot(axis));
        if z <= 1e-9 * (self.half.x + self.half.y) {
            return None;
        }
        let middle = DVec2::new(x, y);
        let mut seen = Seen {
            rectangle: self,
            low: middle - self.half,
            high: middle + self.half,
            depth: z,
            solid_angle: 0.0,
        };
        let [a, b, c, d] = seen.corners();
        seen.solid_angle = angle(product(product(a, b), product(c, d)));
        (seen.solid_angle > 1e-9 && seen.solid_angle < TAU - 1e-9).then_some(seen)
    }
}

/// Product of complex numbers, whose arguments add up.
fn product(a: DVec2, b: DVec2) -> DVec2 {
    DVec2::new(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x)
}

/// Argument of a complex number, 0 to 2π.
fn angle(a: DVec2) -> f64 {
    let angle = a.y.atan2(a.x);
    if angle < 0.0 { angle + TAU } else { angle }
}

impl Seen<'_> {
    /// The angles between the planes through the point and the rectangle's edges, γ₀ to γ₃ of the paper, as arguments of
    /// complex numbers.
    fn corners(&self) -> [DVec2; 4] {
        let (low, high) = (self.low, self.high);
        let corner = |x: f64, y: f64, sign: f64| {
            DVec2::new(sign * x * y, self.depth * (x * x + y * y + self.depth * self.depth).sqrt())
        };
        [
            corner(high.x, low.y, 1.0),
            corner(high.x, high.y, -1.0),
            corner(low.x, high.y, 1.0),
            corner(low.x, low.y, -1.0),
        ]
    }

    /// Solid angle, sr.
    pub(super) fn solid_angle(&self) -> f32 {
        self.solid_angle as f32
    }

    /// The offset from the point to a place on the rectangle, drawn evenly over its solid angle by two numbers in 0..1.
    pub(super) fn sample(&self, [r, s]: [f32; 2]) -> Vec3 {
        let depth = self.depth;
        // z of the normals of the planes through the point and the edges at low and high y.
        let normal = |y: f64| y / (y * y + depth * depth).sqrt();
        let (b0, b1) = (-normal(self.low.y), normal(self.high.y));
        // The angle r Ω − γ₂ − γ₃, of which only the direction counts.
        let [_, _, c, d] = self.corners();
        let (sin, cos) = (f64::from(r) * self.solid_angle).sin_cos();
        let before = product(c, d).normalize();
        let turn = product(DVec2::new(cos, sin), DVec2::new(before.x, -before.y));
        let f = (turn.x * b0 - b1) / turn.y;
        let c = (f.signum() / (f * f + b0 * b0).sqrt()).clamp(-1.0, 1.0);
        let x = (c * depth / (1.0 - c * c).max(1e-30).sqrt()).clamp(self.low.x, self.high.x);
        let distance = (x * x + depth * depth).sqrt();
        let sine = |y: f64| y / (distance * distance + y * y).sqrt();
        let (h0, h1) = (sine(self.low.y), sine(self.high.y));
        let h = h0 + f64::from(s) * (h1 - h0);
        let y = (h * distance / (1.0 - h * h).max(1e-30).sqrt()).clamp(self.low.y, self.high.y);
        let axes = &self.rectangle.axes;
        (axes[0] * x + axes[1] * y + axes[2] * depth).as_vec3()
    }
}
