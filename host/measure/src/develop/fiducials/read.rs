//! Reading a tag's data modules: samples at the modules' centres against the local levels of black and white.

use glam::DVec2;

use super::family::{MODULES, Word, decode};
use super::homography::TagMap;
use super::{Detection, GrayImage};
use lobelia_base::linalg::Normal;

/// Modules across, the quiet zone included.
const GRID: usize = MODULES + 2;

/// How much of a module's neighbours is taken out of its sample, which undoes part of a small tag's blur.
const SHARPENING: f64 = 0.25;

/// Border and quiet modules that must be darker or brighter than the threshold, of 28 and 36. A highlight or
/// an object over an edge may spoil some.
const LEAST_BORDER: usize = 25;
const LEAST_QUIET: usize = 28;

/// Samples of a tag's modules and quiet zone, `[row][column]`.
pub(super) type Samples = [[f64; GRID]; GRID];

/// The tag that a dark quadrilateral shows, with its corners put in their order, and the wrong modules.
pub(super) fn read(image: &GrayImage, quad: &[DVec2; 4]) -> Option<(Detection, u32)> {
    let samples = sample(image, &TagMap::to_quad(quad)?, DVec2::ZERO)?;
    let threshold = Threshold::of(&samples)?;
    let Word { id, turns, errors } = decode(threshold.word(&samples))?;
    // A quarter turn of the pattern takes its top left to where the top right was.
    let corners = std::array::from_fn(|i| quad[(i + 4 - turns) % 4]);
    Some((Detection { id, corners }, errors))
}

/// Samples all modules, shifted by some pixels; nothing if a part of the tag is not in the picture.
pub(super) fn sample(image: &GrayImage, map: &TagMap, shift: DVec2) -> Option<Samples> {
    let mut samples = [[0.0; GRID]; GRID];
    for (y, row) in samples.iter_mut().enumerate() {
        for (x, sample) in row.iter_mut().enumerate() {
            for (dx, dy) in [(-0.2, -0.2), (0.2, -0.2), (-0.2, 0.2), (0.2, 0.2)] {
                let tag = DVec2::new(x as f64 - 0.5 + dx, y as f64 - 0.5 + dy) / MODULES as f64;
                *sample += 0.25 * image.between(map.pixel(tag) + shift)?;
            }
        }
    }
    Some(samples)
}

/// Planes through the levels of the border and of the quiet zone.
struct Threshold {
    black: [f64; 3],
    white: [f64; 3],
}

impl Threshold {
    fn of(samples: &Samples) -> Option<Self> {
        let (mut black, mut white) = (Normal::new(), Normal::new());
        for (x, y) in cells() {
            let row = [1.0, x as f64, y as f64];
            match ring(x, y) {
                0 => white.add(&row, samples[y][x], 1.0),
                1 => black.add(&row, samples[y][x], 1.0),
                _ => {}
            }
        }
        let threshold = Self { black: black.solve(0.0)?, white: white.solve(0.0)? };
        threshold.separates(samples).then_some(threshold)
    }

    fn at(&self, x: usize, y: usize) -> f64 {
        let plane = |p: &[f64; 3]| p[0] + p[1] * x as f64 + p[2] * y as f64;
        0.5 * (plane(&self.black) + plane(&self.white))
    }

    /// Whether the border is dark and the quiet zone bright.
    fn separates(&self, samples: &Samples) -> bool {
        let count = |which: usize, is_white: bool| {
            let on_ring = cells().filter(|&(x, y)| ring(x, y) == which);
            on_ring.filter(|&(x, y)| (samples[y][x] > self.at(x, y)) == is_white).count()
        };
        count(0, true) >= LEAST_QUIET && count(1, false) >= LEAST_BORDER
    }

    fn word(&self, samples: &Samples) -> u64 {
        cells().filter(|&(x, y)| ring(x, y) >= 2).fold(0, |word, (x, y)| {
            let around = samples[y - 1][x] + samples[y + 1][x] + samples[y][x - 1] + samples[y][x + 1];
            let sharp = samples[y][x] + SHARPENING * (4.0 * samples[y][x] - around);
            word << 1 | u64::from(sharp > self.at(x, y))
        })
    }
}

/// All modules as (column, row), row by row.
fn cells() -> impl Iterator<Item = (usize, usize)> {
    (0..GRID * GRID).map(|i| (i % GRID, i / GRID))
}

/// 0 for the quiet zone, 1 for the border, more for the data.
fn ring(x: usize, y: usize) -> usize {
    x.min(y).min(GRID - 1 - x).min(GRID - 1 - y)
}
