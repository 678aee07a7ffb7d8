//! Incident radiance of a region of the sphere about a point, whose edges are arcs of great circles, by
//! integrals along them; with ∇_S on the unit sphere, n the edge's inward normal, s its length, r the
//! distance of what bounds:
//!
//! ∫ Y_lm dω = Σ ∫ n·∇_S Y_lm ds / l(l + 1), as −l(l + 1) Y is the Laplacian of Y, and Y_00 times the solid
//! angle,
//!
//! ∇ = Σ n ∫ Y / r ds,  ∇∇ = −Σ n ⊗ ∫ (∇_S Y − 3 Y ω) / r² ds, its symmetric part.
//!
//! Of a straight edge 1/r = ω·k with k the nearest point of its line over that point's squared distance: what
//! is integrated is a trigonometric polynomial of s, for which Gauss and Legendre's nodes are as good as
//! exact. Where one polygon hides part of another the edge is the front one's, so that visibility is
//! differentiated too; the second derivative leaves out that corners between edges of two polygons slide
//! along both.

use glam::DVec3;

use super::harmonics::{self, MOST_NODES};

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
    degree: usize,
    pub(super) values: Vec<f64>,
    /// Where they are wanted.
    pub(super) gradients: Vec<DVec3>,
    /// xx, yy, zz, xy, xz, yz, where they are wanted.
    pub(super) seconds: Vec<[f64; 6]>,
}

impl Region {
    /// Nothing yet.
    pub(super) fn new(degree: usize, detail: Detail) -> Self {
        let count = |least: Detail| if detail >= least { harmonics::count(degree) } else { 0 };
        Self {
            degree,
            values: vec![0.0; count(Detail::Values)],
            gradients: vec![DVec3::ZERO; count(Detail::Gradients)],
            seconds: vec![[0.0; 6]; count(Detail::Seconds)],
        }
    }

    /// Nothing again.
    pub(super) fn clear(&mut self) {
        self.values.fill(0.0);
        self.gradients.fill(DVec3::ZERO);
        self.seconds.fill([0.0; 6]);
    }

    /// Adds a convex region that is smaller than a hemisphere, its edges in order.
    pub(super) fn add(&mut self, edges: &[Edge]) {
        let Some(first) = edges.first() else { return };
        let apex = first.from.normalize_or_zero();
        let y0 = (4.0 * std::f64::consts::PI).sqrt().recip();
        for edge in edges {
            let [a, b] = [edge.from, edge.to].map(DVec3::normalize_or_zero);
            let below = 1.0 + apex.dot(a) + a.dot(b) + b.dot(apex);
            self.values[0] += y0 * 2.0 * apex.dot(a.cross(b)).atan2(below);
            self.add_edge([a, b], edge.near);
        }
    }

    fn add_edge(&mut self, [a, b]: [DVec3; 2], near: DVec3) {
        let across = a.cross(b);
        let sin = across.length();
        if sin < 1e-14 {
            return;
        }
        let inward = across / sin;
        let aside = inward.cross(a);
        let length = sin.atan2(a.dot(b));
        let degree = self.degree;
        // The integrand's degree is at most two above that of the harmonics.
        let phase = (degree + 2) as f64 * length / 2.0;
        let nodes = ((3.0 + 1.2 * phase).ceil() as usize).min(MOST_NODES);
        for &[x, weight] in harmonics::gauss(nodes) {
            let (sin, cos) = (length * (x + 1.0) / 2.0).sin_cos();
            let direction = a * cos + aside * sin;
            let along = aside * cos - a * sin;
            let weight = weight * length / 2.0;
            let (y, [slopes, turns]) = harmonics::basis_with_slopes(degree, direction, [inward, along]);
            let inverse = direction.dot(near);
            for l in 1..=degree {
                let part = weight / (l * (l + 1)) as f64;
                let own = l * l..harmonics::count(l);
                let values = &mut self.values[own.clone()];
                values.iter_mut().zip(&slopes[own]).for_each(|(value, slope)| *value += part * slope);
            }
            let by_distance = inward * (weight * inverse);
            self.gradients.iter_mut().zip(y).for_each(|(gradient, y)| *gradient += by_distance * y);
            let by_square = weight * inverse * inverse;
            for (i, second) in self.seconds.iter_mut().enumerate() {
                let w = (inward * slopes[i] + along * turns[i] - direction * (3.0 * y[i])) * by_square;
                let n = inward;
                let terms = [
                    n.x * w.x,
                    n.y * w.y,
                    n.z * w.z,
                    (n.x * w.y + n.y * w.x) / 2.0,
                    (n.x * w.z + n.z * w.x) / 2.0,
                    (n.y * w.z + n.z * w.y) / 2.0,
                ];
                second.iter_mut().zip(terms).for_each(|(second, term)| *second -= term);
            }
        }
    }
}
