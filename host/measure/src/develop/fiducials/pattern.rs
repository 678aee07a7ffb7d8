//! A printed tag as a blurred camera sees it, with the derivatives that a fit needs.
//!
//! The blur of lens and pixel is a Gaussian. In tag coordinates it is taken as a product of one along u and
//! one along v, with the standard deviations that each has across edges of constant u and of constant v:
//! exact along the edges, and off only within a blur's width of the modules' corners when the tag is sheared.

use std::f64::consts::{FRAC_1_SQRT_2, TAU};

use glam::DVec2;

use super::family::{MODULES, Modules, modules};

/// Beyond this many standard deviations a blurred edge is over.
const REACH: f64 = 4.5;

/// A tag's reflectance, 0 for black and 1 for white.
#[derive(Debug, Clone)]
pub(super) struct Pattern {
    modules: Modules,
}

/// A blurred pattern at a point.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Tone {
    /// Its value, 0..1.
    pub(super) value: f64,
    /// Its derivative by (u, v).
    pub(super) slope: DVec2,
    /// Its derivatives by the variances along u and along v.
    pub(super) by_variance: DVec2,
}

impl Pattern {
    pub(super) fn new(id: u32) -> Option<Self> {
        Some(Self { modules: modules(id)? })
    }

    /// Whether the module in a column and row is white, the quiet zone being column and row 0 and 9.
    pub(super) fn is_white(&self, column: usize, row: usize) -> bool {
        self.modules[row][column]
    }

    /// The pattern at a point of the tag's plane (0..1 across the black border's outer edge), blurred with
    /// these variances in the same coordinates.
    pub(super) fn tone(&self, tag: DVec2, variance: DVec2) -> Tone {
        let (across, down) = (Blend::new(tag.x, variance.x), Blend::new(tag.y, variance.y));
        let mut tone = Tone::default();
        for y in down.first..=down.last {
            let (mut value, mut slope, mut spread) = (0.0, 0.0, 0.0);
            for x in (across.first..=across.last).filter(|&x| self.is_white(x, y)) {
                value += across.value[x];
                slope += across.slope[x];
                spread += across.by_variance[x];
            }
            tone.value += down.value[y] * value;
            tone.slope += DVec2::new(down.value[y] * slope, down.slope[y] * value);
            tone.by_variance += DVec2::new(down.value[y] * spread, down.by_variance[y] * value);
        }
        tone
    }
}

/// How much each module (and the quiet zone on both sides, which has no end) contributes along one axis.
struct Blend {
    first: usize,
    last: usize,
    value: [f64; MODULES + 2],
    slope: [f64; MODULES + 2],
    by_variance: [f64; MODULES + 2],
}

impl Blend {
    fn new(at: f64, variance: f64) -> Self {
        let deviation = variance.sqrt();
        let column = |t: f64| (t * MODULES as f64 + 1.0).floor().clamp(0.0, MODULES as f64 + 1.0) as usize;
        let (first, last) = (column(at - REACH * deviation), column(at + REACH * deviation));
        let mut blend = Self { first, last, value: [0.0; 10], slope: [0.0; 10], by_variance: [0.0; 10] };
        blend.value[first] = 1.0;
        // Each edge between two modules passes a part of the whole from the one before it to the one after.
        for edge in first..last {
            let z = (at - edge as f64 / MODULES as f64) / deviation;
            let density = (-0.5 * z * z).exp() / TAU.sqrt();
            let passed = [cumulative(z), density / deviation, -0.5 * z * density / variance];
            for (k, list) in
                [&mut blend.value, &mut blend.slope, &mut blend.by_variance].into_iter().enumerate()
            {
                list[edge + 1] = passed[k];
                list[edge] -= passed[k];
            }
        }
        blend
    }
}

/// The normal distribution's cumulative function to 1e-7 (Abramowitz and Stegun 7.1.26).
fn cumulative(z: f64) -> f64 {
    let x = z.abs() * FRAC_1_SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * x);
    let series = [1.061_405_429, -1.453_152_027, 1.421_413_741, -0.284_496_736, 0.254_829_592];
    let tail = 0.5 * series.iter().fold(0.0, |sum, c| sum * t + c) * t * (-x * x).exp();
    if z < 0.0 { tail } else { 1.0 - tail }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_are_those_of_the_value() {
        let pattern = Pattern::new(5).unwrap();
        let variance = DVec2::new(0.002, 0.001);
        for i in 0..200 {
            let tag = DVec2::new(f64::from(i % 17) / 14.0 - 0.1, f64::from(i % 23) / 19.0 - 0.1);
            let tone = pattern.tone(tag, variance);
            let value = |du: DVec2, dv: DVec2| pattern.tone(tag + du, variance + dv).value;
            let quotient = |du: DVec2, dv: DVec2| (value(du, dv) - value(-du, -dv)) / 2.0;
            for (axis, k) in [(DVec2::X, 0), (DVec2::Y, 1)] {
                let slope = quotient(axis * 1e-4, DVec2::ZERO) / 1e-4;
                assert!((slope - tone.slope[k]).abs() < 0.03, "{slope} {:?}", tone.slope);
                let slope = quotient(DVec2::ZERO, axis * 1e-5) / 1e-5;
                assert!((slope - tone.by_variance[k]).abs() < 0.5, "{slope} {:?}", tone.by_variance);
            }
        }
    }

    #[test]
    fn little_blur_leaves_the_print() {
        let pattern = Pattern::new(0).unwrap();
        for (x, y) in (0..100).map(|i| (i % 10, i / 10)) {
            let tag = DVec2::new(x as f64 - 0.5, y as f64 - 0.5) / MODULES as f64;
            let value = pattern.tone(tag, DVec2::splat(1e-5)).value;
            assert!((value - f64::from(u8::from(pattern.is_white(x, y)))).abs() < 1e-6);
        }
    }
}
