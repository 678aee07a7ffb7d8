//! Incident radiance of a region of the sphere about a point, whose edges are arcs of great circles, by integrals
//! along them; with ∇_S on the unit sphere, n the edge's inward normal, s its length, r the distance of what bounds:
//!
//! ∫ Y_lm dω = Σ ∫ n·∇_S Y_lm ds / l(l + 1),  as −l(l + 1) Y is the Laplacian of Y, and Y_00 times the solid angle,
//!
//! ∇ = Σ n ∫ Y / r ds,  ∇∇ = −Σ n ⊗ ∫ (∇_S Y − 3 Y ω) / r² ds, its symmetric part.
//!
//! Of a straight edge 1/r = ω·k with k the nearest point of its line over that point's squared distance: what is
//! integrated is a trigonometric polynomial of s, for which Gauss and Legendre's nodes are as good as exact.
//! Where one polygon hides part of another the edge is the front one's, so that visibility is differentiated too;
//! the second derivative leaves out that corners between edges of two polygons slide along both.

use glam::DVec3;

use super::harmonics::{self, COUNT, MOST_NODES};

/// An arc between two directions, of any length, with the region on its left seen from the point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Edge {
    pub(super) from: DVec3,
    pub(super) to: DVec3,
    /// 1/r = ω·near for the straight line that is seen as the arc.
    pub(super) near: DVec3,
}

impl Edge {
    /// The edge that a straight line between two points is seen as.
    pub(super) fn of_line(from: DVec3, to: DVec3) -> Self {
        let along = (to - from).normalize_or_zero();
        let foot = from - along * from.dot(along);
        Self { from, to, near: foot / foot.length_squared().max(f64::MIN_POSITIVE) }
    }
}

/// How much is wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Detail {
    /// Coefficients.
    Values,
    /// And their gradients.
    Gradients,
    /// And their second derivatives.
    Seconds,
}

/// Coefficients of unit radiance from a region, and how they change with the point.
#[derive(Debug, Clone)]
pub(super) struct Region {
    pub(super) values: [f64; COUNT],
    pub(super) gradients: [DVec3; COUNT],
    /// xx, yy, zz, xy, xz, yz.
    pub(super) seconds: [[f64; 6]; COUNT],
}

impl Region {
    /// Nothing.
    pub(super) fn empty() -> Self {
        Self { values: [0.0; COUNT], gradients: [DVec3::ZERO; COUNT], seconds: [[0.0; 6]; COUNT] }
    }

    /// Adds a convex region that is smaller than a hemisphere, its edges in order.
    pub(super) fn add(&mut self, edges: &[Edge], degree: usize, detail: Detail) {
        let Some(first) = edges.first() else { return };
        let apex = first.from.normalize_or_zero();
        let y0 = (4.0 * std::f64::consts::PI).sqrt().recip();
        for edge in edges {
            let [a, b] = [edge.from, edge.to].map(DVec3::normalize_or_zero);
            let below = 1.0 + apex.dot(a) + a.dot(b) + b.dot(apex);
            self.values[0] += y0 * 2.0 * apex.dot(a.cross(b)).atan2(below);
            self.add_edge([a, b], edge.near, degree, detail);
        }
    }

    fn add_edge(&mut self, [a, b]: [DVec3; 2], near: DVec3, degree: usize, detail: Detail) {
        let across = a.cross(b);
        let sin = across.length();
        if sin < 1e-14 {
            return;
        }
        let inward = across / sin;
        let aside = inward.cross(a);
        let length = sin.atan2(a.dot(b));
        // The integrand's degree is at most two above that of the harmonics.
        let phase = (degree + 2) as f64 * length / 2.0;
        let nodes = ((3.0 + 1.2 * phase).ceil() as usize).min(MOST_NODES);
        for &[x, weight] in harmonics::gauss(nodes) {
            let (sin, cos) = (length * (x + 1.0) / 2.0).sin_cos();
            let direction = a * cos + aside * sin;
            let weight = weight * length / 2.0;
            let (y, slopes) = harmonics::basis_with_gradients(degree, direction);
            let inverse = direction.dot(near);
            for l in 0..=degree {
                let part = weight / (l * (l + 1)).max(1) as f64;
                for i in l * l..harmonics::count(l) {
                    // Of degree 0 the slope is 0.
                    self.values[i] += part * inward.dot(slopes[i]);
                    if detail >= Detail::Gradients {
                        self.gradients[i] += inward * (weight * y[i] * inverse);
                    }
                    if detail >= Detail::Seconds {
                        let w = (slopes[i] - direction * (3.0 * y[i])) * (weight * inverse * inverse);
                        let n = inward;
                        let terms = [
                            n.x * w.x,
                            n.y * w.y,
                            n.z * w.z,
                            (n.x * w.y + n.y * w.x) / 2.0,
                            (n.x * w.z + n.z * w.x) / 2.0,
                            (n.y * w.z + n.z * w.y) / 2.0,
                        ];
                        self.seconds[i].iter_mut().zip(terms).for_each(|(second, term)| *second -= term);
                    }
                }
            }
        }
    }
}
