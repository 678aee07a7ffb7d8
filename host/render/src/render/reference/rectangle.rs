//! A rectangular light seen from a point: its solid angle, and directions drawn evenly within it
//! (Ureña, Fajardo and King 2013, "An area-preserving parametrization for spherical rectangles").

use std::f64::consts::TAU;

use glam::{DVec2, DVec3, Vec3};

/// A rectangular light: its middle, half its size, and the axes of its frame: sides x and y, z away from its
/// front.
pub(super) struct Rectangle {
    centre: DVec3,
    half: DVec2,
    axes: [DVec3; 3],
}

/// A rectangle as a point sees it, in the rectangle's frame about the point. f64, since small solid angles
/// are differences.
pub(super) struct Seen<'a> {
    rectangle: &'a Rectangle,
    low: DVec2,
    high: DVec2,
    depth: f64,
    /// Complex numbers with the arguments γ₀ + γ₁ and γ₂ + γ₃, the angles between the planes through the
    /// point and the edges.
    angles: [DVec2; 2],
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
        let (low, high) = (middle - self.half, middle + self.half);
        let [a, b, c, d] = corners(low, high, z);
        let angles = [product(a, b), product(c, d)];
        let solid_angle = angle(product(angles[0], angles[1]));
        let tells = solid_angle > 1e-9 && solid_angle < TAU - 1e-9;
        tells.then_some(Seen { rectangle: self, low, high, depth: z, angles, solid_angle })
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

/// The angles between the planes through a point and a rectangle's edges, γ₀ to γ₃ of the paper, as arguments
/// of complex numbers.
fn corners(low: DVec2, high: DVec2, depth: f64) -> [DVec2; 4] {
    let x = [high.x, high.x, low.x, low.x];
    let y = [low.y, high.y, high.y, low.y];
    let sign = [1.0, -1.0, 1.0, -1.0];
    let length: [f64; 4] = std::array::from_fn(|i| (x[i] * x[i] + y[i] * y[i] + depth * depth).sqrt());
    std::array::from_fn(|i| DVec2::new(sign[i] * x[i] * y[i], depth * length[i]))
}

impl Seen<'_> {
    /// Solid angle, sr.
    pub(super) fn solid_angle(&self) -> f32 {
        self.solid_angle as f32
    }

    /// The offset from the point to a place on the rectangle, drawn evenly over its solid angle by two
    /// numbers in 0..1.
    pub(super) fn sample(&self, [r, s]: [f32; 2]) -> Vec3 {
        let depth = self.depth;
        let ends = [self.low.y, self.high.y];
        // z of the normals of the planes through the point and the edges at low and high y.
        let [b0, b1] = ends.map(|y| y / (y * y + depth * depth).sqrt());
        // The angle r Ω − γ₂ − γ₃, of which only the direction counts.
        let (sin, cos) = (f64::from(r) * self.solid_angle).sin_cos();
        let before = self.angles[1];
        let turn = product(DVec2::new(cos, sin), DVec2::new(before.x, -before.y));
        // b0 is the negative of the paper's.
        let f = -(turn.x * b0 + b1 * before.length()) / turn.y;
        // c / √(1 − c²) for the paper's c = ±1 / √(f² + b0²).
        let x = f.signum() * depth / (f * f + b0 * b0 - 1.0).max(1e-30).sqrt();
        let x = x.clamp(self.low.x, self.high.x);
        let square = x * x + depth * depth;
        let [h0, h1] = ends.map(|y| y / (square + y * y).sqrt());
        let h = h0 + f64::from(s) * (h1 - h0);
        let y = (h * (square / (1.0 - h * h).max(1e-30)).sqrt()).clamp(self.low.y, self.high.y);
        let axes = &self.rectangle.axes;
        (axes[0] * x + axes[1] * y + axes[2] * depth).as_vec3()
    }
}
