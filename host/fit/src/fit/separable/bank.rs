//! Banks of lobes' shapes, in single precision: how much each would explain of what is left of a texel's samples is told by their products
//! with it.

use pulp::WithSimd;

use super::super::model::{ModelLobe, isotropic_c};
use super::data::Products;

/// Directions of C round the circle.
const DIRECTIONS: usize = 24;
/// Exponents 1, 2, 4, …
pub const EXPONENTS: usize = 10;
/// Rows a direction: the exponents and the square of the last.
pub const ROWS: usize = EXPONENTS + 1;

/// Shapes of some directions of C at every pose.
#[derive(Debug, Clone, Default)]
pub struct Bank {
    /// `[direction][exponent][pose]`.
    pub shapes: Vec<f32>,
    /// Directions with a base that is positive somewhere, by their angle on the circle.
    pub angles: Vec<f64>,
    /// Poses.
    pub count: usize,
}

impl Bank {
    /// Computes the shapes of directions all round the circle for the products at one place.
    pub fn fill(&mut self, products: &Products, cone: [f64; 2]) {
        let angle = |direction: usize| (direction as f64 + 0.5) / DIRECTIONS as f64 * std::f64::consts::TAU;
        self.fill_with((0..DIRECTIONS).map(angle), products, cone);
    }

    /// Computes the shapes of directions by their angles.
    #[inline(always)]
    fn fill_with(&mut self, angles: impl Iterator<Item = f64>, products: &Products, cone: [f64; 2]) {
        self.count = products.plane.len();
        self.angles.clear();
        self.shapes.clear();
        for angle in angles {
            let lobe = ModelLobe::unit(isotropic_c(angle), 1.0).within(cone);
            let (plane, zz) = (lobe.c.x / lobe.reference, lobe.c.z / lobe.reference);
            let start = self.shapes.len();
            self.shapes.resize(start + ROWS * self.count, 0.0);
            let (mut row, mut rest) = self.shapes[start..].split_at_mut(self.count);
            let mut largest = 0f32;
            for ((base, p), z) in row.iter_mut().zip(&products.plane).zip(&products.zz) {
                *base = (plane * p + zz * z).clamp(0.0, 4.0) as f32;
                largest = largest.max(*base);
            }
            if largest <= 0.0 {
                self.shapes.truncate(start);
                continue;
            }
            self.angles.push(angle);
            while !rest.is_empty() {
                let (next, others) = rest.split_at_mut(self.count);
                for (square, root) in next.iter_mut().zip(row.iter()) {
                    // Without denormal numbers, which are slow, and without infinities.
                    let value = (root * root).min(1e9);
                    *square = if *root < 1e-15 { 0.0 } else { value };
                }
                (row, rest) = (next, others);
            }
        }
    }
}

/// The shapes of the directions of some angles, as vector code.
pub struct Fill<'a>(pub &'a mut Bank, pub &'a [f64], pub &'a Products, pub [f64; 2]);

impl WithSimd for Fill<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        self.0.fill_with(self.1.iter().copied(), self.2, self.3);
    }
}

/// The angle of the C that sends light from a pose's light straight to its camera: cosθ_i C ω_i is then along ω_o as far as the plane of
/// incidence goes. None near normal incidence, which tells nothing about C.
pub fn ridge_angle(products: &Products, pose: usize) -> Option<f64> {
    let [cos_i, cos_o] = [0, 1].map(|side: usize| products.cos[side][pose]);
    let sin2_i = 1.0 - cos_i * cos_i;
    let across = products.plane[pose] * cos_i * std::f64::consts::SQRT_2;
    (sin2_i > 0.01).then(|| across.atan2(cos_o * sin2_i))
}

/// Σ a b, in sixteen partial sums.
#[inline(always)]
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0f32; 16];
    let (a16, b16) = (a.chunks_exact(16), b.chunks_exact(16));
    for (lane, (x, y)) in a16.remainder().iter().zip(b16.remainder()).enumerate() {
        sums[lane] = x * y;
    }
    for (x, y) in a16.zip(b16) {
        for lane in 0..16 {
            sums[lane] += x[lane] * y[lane];
        }
    }
    let half: [f32; 8] = std::array::from_fn(|i| sums[i] + sums[i + 8]);
    let quarter: [f32; 4] = std::array::from_fn(|i| half[i] + half[i + 4]);
    (quarter[0] + quarter[2]) + (quarter[1] + quarter[3])
}

/// The products of all rows of the bank with some lists, as vector code.
pub struct Products32<'a> {
    /// `[row][pose]`.
    pub rows: &'a [f32],
    /// `[list][pose]`.
    pub lists: &'a [f32],
    /// Poses.
    pub count: usize,
    /// `[row][list]`.
    pub out: &'a mut Vec<f32>,
}

impl WithSimd for Products32<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        self.out.clear();
        for row in self.rows.chunks_exact(self.count.max(1)) {
            for list in self.lists.chunks_exact(self.count.max(1)) {
                self.out.push(dot(row, list));
            }
        }
    }
}
