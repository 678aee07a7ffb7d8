//! Banks of lobes' shapes, in single precision: how much each would explain of what is left of a texel's
//! samples is told by their products with it.

use pulp::WithSimd;

use super::super::model::{ModelLobe, isotropic_c};
use super::data::Products;

/// Directions of C round the circle.
const DIRECTIONS: usize = 24;
/// Between two of them, radians.
pub const STEP: f64 = std::f64::consts::TAU / DIRECTIONS as f64;
/// Exponents ½, 1, 2, …
pub const EXPONENTS: usize = 11;
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

/// The exponent at a place, or between two.
pub fn exponent(place: f64) -> f64 {
    (place - 1.0).exp2()
}

impl Bank {
    /// Computes the shapes of directions all round the circle for the products at one place.
    pub fn fill(&mut self, products: &Products, cone: [f64; 2]) {
        let angle = |direction: usize| (direction as f64 + 0.5) * STEP;
        self.fill_with((0..DIRECTIONS).map(angle), products, cone);
    }

    /// The places of the directions one step before and after one, of a bank that goes all round the circle,
    /// where both are there.
    pub fn neighbours(&self, place: usize) -> Option<[usize; 2]> {
        let count = self.angles.len();
        let beside = [(place + count - 1) % count, (place + 1) % count];
        let near = |other: usize, step: f64| {
            let off = self.angles[place] + step - self.angles[other];
            (off / std::f64::consts::TAU - (off / std::f64::consts::TAU).round()).abs() < 1e-9
        };
        (near(beside[0], -STEP) && near(beside[1], STEP)).then_some(beside)
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
            for ((root, p), z) in row.iter_mut().zip(&products.plane).zip(&products.zz) {
                *root = ((plane * p + zz * z).clamp(0.0, 4.0) as f32).sqrt();
                largest = largest.max(*root);
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

/// The angle of the C that sends light from a pose's light straight to its camera: cosθ_i C ω_i is then along
/// ω_o as far as the plane of incidence goes. None near normal incidence, which tells nothing about C.
pub fn ridge_angle(products: &Products, pose: usize) -> Option<f64> {
    let [cos_i, cos_o] = [0, 1].map(|side: usize| products.cos[side][pose]);
    let sin2_i = 1.0 - cos_i * cos_i;
    let across = products.plane[pose] * cos_i * std::f64::consts::SQRT_2;
    (sin2_i > 0.01).then(|| across.atan2(cos_o * sin2_i))
}

/// Σ a b of a list with each of four, in sixteen partial sums.
#[inline(always)]
fn dots(a: &[f32], b: [&[f32]; 4]) -> [f32; 4] {
    let [b0, b1, b2, b3] = b.map(|list| list.as_chunks::<16>().0.iter());
    // Four lists by name: a compiler keeps these in registers, and an array of them in memory.
    let [mut s0, mut s1, mut s2, mut s3] = [[0f32; 16]; 4];
    for ((((a, b0), b1), b2), b3) in a.as_chunks::<16>().0.iter().zip(b0).zip(b1).zip(b2).zip(b3) {
        let (a, b0, b1, b2, b3) = (*a, *b0, *b1, *b2, *b3);
        for lane in 0..16 {
            s0[lane] += a[lane] * b0[lane];
            s1[lane] += a[lane] * b1[lane];
            s2[lane] += a[lane] * b2[lane];
            s3[lane] += a[lane] * b3[lane];
        }
    }
    let mut sums = [0.0; 4];
    for (sum, (lanes, b)) in sums.iter_mut().zip([s0, s1, s2, s3].iter().zip(b)) {
        *sum = total(lanes);
        for (x, y) in a.as_chunks::<16>().1.iter().zip(b.as_chunks::<16>().1) {
            *sum += x * y;
        }
    }
    sums
}

/// The sum of all lanes. Not inlined: beside it, compilers make no vector code of the loop before.
#[inline(never)]
fn total(sums: &[f32; 16]) -> f32 {
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
        let count = self.count.max(1);
        let lists = self.lists.len() / count;
        let list = |index: usize| &self.lists[index.min(lists - 1) * count..][..count];
        self.out.clear();
        if lists == 0 {
            return;
        }
        for row in self.rows.chunks_exact(count) {
            for first in (0..lists).step_by(4) {
                // Places beyond the last are computed again.
                let products = dots(row, std::array::from_fn(|k| list(first + k)));
                self.out.extend_from_slice(&products[..(lists - first).min(4)]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_of_any_length_and_number_of_lists_agree_with_plain_sums() {
        for (count, lists) in [(8, 1), (16, 3), (24, 4), (200, 7), (456, 9)] {
            let make = |length: usize, slope: f32| -> Vec<f32> {
                (0..length).map(|k| (slope * k as f32).sin() + 0.3).collect()
            };
            let (rows, all) = (make(3 * count, 0.7), make(lists * count, 0.31));
            let mut out = Vec::new();
            pulp::Arch::new().dispatch(Products32 { rows: &rows, lists: &all, count, out: &mut out });
            assert_eq!(out.len(), 3 * lists);
            for (place, found) in out.iter().enumerate() {
                let (row, list) =
                    (&rows[place / lists * count..][..count], &all[place % lists * count..][..count]);
                let plain: f64 = row.iter().zip(list).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
                assert!((f64::from(*found) - plain).abs() < 1e-5 * count as f64, "{count} {lists} {place}");
            }
        }
    }
}
