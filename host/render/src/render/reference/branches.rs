//! How many rays leave the first surface of a pixel's paths: most where the noise is in what they find.
//!
//! With s branches a sample costs c₀ + s c₁ rays and has the variance v₀ + v₁ / s, of the parts that
//! [`Traced`] tells apart. Over a picture, mean cost C times mean variance V is least at s² = (v₁ / c₁) (C /
//! V) in every pixel (Rath et al. 2022, "EARS: Efficiency-aware Russian roulette and splitting", without the
//! roulette). Samples of a few pixels, which the picture does not take, tell variances and costs; with those
//! that the picture takes, pixels that had luck would stay lucky. Samples of a pixel are spread evenly, so
//! that their mean varies less than theirs would if they were independent: by a factor for each part, which
//! two runs a pixel tell. Costs are counted in rays, so that a picture does not depend on the machine.

use rayon::prelude::*;

use super::trace::{Numbers, PARTS, Shaders, Traced};
use super::{View, hash};
use crate::render::compare;
use lobelia_reflectance::colour;

/// Powers of two: with them the numbers of any power of two of samples stay stratified.
const MOST_LOG2: f32 = 4.0;
/// Samples a run at most, and the part of a pixel's samples that a run has.
const MOST_SAMPLES: u32 = 16;
const SHARE: u32 = 4;
const LEAST_SAMPLES: u32 = 4;
/// Two runs of one pixel stand for a block of so many by so many.
const BLOCK: usize = 4;
/// Blocks on each side that are taken together.
const RADIUS: usize = 1;

/// What some samples found.
pub(super) struct Look {
    /// Pixels and blocks a row.
    width: [usize; 2],
    /// Pixels.
    count: usize,
    /// What was found by part and block.
    found: Vec<[Found; PARTS]>,
    /// Rays by part, mean over the samples.
    cost: [f32; PARTS],
    /// Rays in all.
    pub(super) rays: u64,
}

/// Luminance of one part at one pixel.
#[derive(Debug, Clone, Copy, Default)]
struct Found {
    /// Mean.
    mean: f32,
    /// Variance of a run's mean, as if the samples were independent.
    variance: f32,
    /// The same, by the difference of the two runs.
    of_runs: f32,
}

/// Looks at a view that is to have so many samples a pixel; `None` where they are too few to spend any.
pub(super) fn look(view: &View<'_>, samples: u32) -> Option<Look> {
    let run = (samples / SHARE).min(MOST_SAMPLES);
    if run < LEAST_SAMPLES {
        return None;
    }
    let count = view.branches.len();
    let height = count / view.width;
    let [columns, rows] = [view.width, height].map(|pixels| pixels.div_ceil(BLOCK));
    let mut found = vec![[Found::default(); PARTS]; columns * rows];
    let of_row = |shaders: &mut Shaders, (row, found): (usize, &mut [[Found; PARTS]])| {
        let mut rays = [0; PARTS];
        let middle = |block: usize, size: usize| (block * BLOCK + BLOCK / 2).min(size - 1);
        for (column, found) in found.iter_mut().enumerate() {
            let at = [middle(column, view.width), middle(row, height)];
            let runs = [0, 1].map(|k| view.run(at, k, run, shaders, &mut rays));
            let n = run as f32;
            *found = std::array::from_fn(|part| {
                let [a, b] = runs.map(|run| run[part]);
                let difference = (a[0] - b[0]) / n;
                let spread = a[1] + b[1] - (a[0] * a[0] + b[0] * b[0]) / n;
                Found {
                    mean: 0.5 * (a[0] + b[0]) / n,
                    variance: spread.max(0.0) / (2.0 * (n - 1.0) * n),
                    of_runs: 0.5 * difference * difference,
                }
            });
        }
        rays
    };
    let rays = found.par_chunks_mut(columns).enumerate().map_init(Shaders::new, of_row);
    let rays = rays.reduce(|| [0; PARTS], |a, b| std::array::from_fn(|part| a[part] + b[part]));
    let samples = (2 * run) as f32 * found.len() as f32;
    let cost = rays.map(|rays| rays as f32 / samples);
    Some(Look { width: [view.width, columns], count, found, cost, rays: rays.iter().sum() })
}

impl View<'_> {
    /// Sums of luminance and of its square over a run of samples of a pixel, by part.
    fn run(
        &self,
        [x, y]: [usize; 2],
        which: u32,
        samples: u32,
        shaders: &mut Shaders,
        rays: &mut [u64; PARTS],
    ) -> [[f32; 2]; PARTS] {
        let place = (2 * (y * self.width + x)) as u32 + which;
        let pixel = hash(!self.seed ^ hash(place));
        let mut sums = [[0.0; 2]; PARTS];
        for index in 0..samples {
            let numbers = Numbers { pixel, index };
            let Traced { parts, .. } = self.sample([x, y], &numbers, 1, shaders, rays);
            for ([sum, squares], part) in sums.iter_mut().zip(parts) {
                let value = colour::luminance(part);
                *sum += value;
                *squares += value * value;
            }
        }
        sums
    }
}

impl Look {
    /// Branches by pixel.
    pub(super) fn branches(&self) -> Vec<u32> {
        let [width, columns] = self.width;
        let weights = self.weights();
        let spread = self.spread(&weights);
        let variances: Vec<[f32; PARTS]> =
            (0..self.found.len()).map(|block| self.variances(block, &weights, spread)).collect();
        let branches = best(&variances, self.cost);
        let block = |place: usize| place / width / BLOCK * columns + place % width / BLOCK;
        (0..self.count).map(|place| branches[block(place)]).collect()
    }

    /// What the variance of a block counts in the square of the picture's relative RMSE, as
    /// [`compare::Errors`] has it.
    fn weights(&self) -> Vec<f32> {
        let mean = |[a, b]: &[Found; PARTS]| a.mean + b.mean;
        let whole = self.found.iter().map(mean).sum::<f32>() / self.found.len() as f32;
        self.found.iter().map(|found| compare::relative_weight(mean(found), whole)).collect()
    }

    /// By what factor the variance of a run is that of independent samples, by part.
    fn spread(&self, weights: &[f32]) -> [f32; PARTS] {
        std::array::from_fn(|part| {
            let sum = |of: fn(&Found) -> f32| -> f32 {
                self.found.iter().zip(weights).map(|(found, weight)| of(&found[part]) * weight).sum()
            };
            let independent = sum(|found| found.variance);
            if independent > 0.0 { (sum(|found| found.of_runs) / independent).min(1.0) } else { 1.0 }
        })
    }

    /// Relative variance of a run by part, from the blocks around one.
    fn variances(&self, block: usize, weights: &[f32], spread: [f32; PARTS]) -> [f32; PARTS] {
        let columns = self.width[1];
        let rows = self.found.len() / columns;
        let around = |at: usize, size: usize| at.saturating_sub(RADIUS)..(at + RADIUS + 1).min(size);
        let (mut sums, mut count) = ([0.0; PARTS], 0.0);
        for y in around(block / columns, rows) {
            for x in around(block % columns, columns) {
                let place = y * columns + x;
                for (sum, found) in sums.iter_mut().zip(&self.found[place]) {
                    *sum += found.variance * weights[place];
                }
                count += 1.0;
            }
        }
        std::array::from_fn(|part| sums[part] * spread[part] / count)
    }
}

/// Branches by block, from the variances of their parts and the mean cost of a sample's parts.
fn best(variances: &[[f32; PARTS]], cost: [f32; PARTS]) -> Vec<u32> {
    let count = variances.len() as f32;
    let mut branches = vec![1; variances.len()];
    if cost[1] <= 0.0 {
        return branches;
    }
    // The totals follow from the branches and these from the totals; that settles in a few rounds.
    for _ in 0..8 {
        let mean = |of: &dyn Fn(usize) -> f32| (0..variances.len()).map(of).sum::<f32>() / count;
        let whole_cost = cost[0] + cost[1] * mean(&|k| branches[k] as f32);
        let whole = mean(&|k| variances[k][0] + variances[k][1] / branches[k] as f32);
        if whole <= 0.0 || !whole.is_finite() {
            break;
        }
        for (branches, [_, of_rest]) in branches.iter_mut().zip(variances) {
            let square = of_rest / cost[1] * (whole_cost / whole);
            let log2 = 0.5 * square.max(1.0).log2();
            *branches = 1 << log2.round().min(MOST_LOG2) as u32;
        }
    }
    branches
}

#[cfg(test)]
mod tests {
    use super::super::Pixel;
    use super::super::trace::Tracer;
    use super::*;

    /// Mean cost times mean variance.
    fn product(variances: &[[f32; PARTS]], cost: [f32; PARTS], branches: &[u32]) -> f32 {
        let costs: f32 = branches.iter().map(|&s| cost[0] + cost[1] * s as f32).sum();
        let noise: f32 = variances.iter().zip(branches).map(|(v, &s)| v[0] + v[1] / s as f32).sum();
        costs * noise
    }

    #[test]
    fn no_other_number_of_branches_of_any_pixel_is_cheaper_at_equal_noise() {
        let cost = [2.0, 4.0];
        // Noise of the rest between 10⁻⁴ and 10, falling steeply.
        let variances: Vec<[f32; PARTS]> =
            (0..200).map(|k| [0.01, 10.0 * (-11.5 * k as f32 / 200.0).exp()]).collect();
        let branches = best(&variances, cost);
        let least = product(&variances, cost, &branches);
        assert!(least < 0.5 * product(&variances, cost, &[1; 200]), "{least}");
        for place in 0..200 {
            for other in [1, 2, 4, 8, 16] {
                let mut changed = branches.clone();
                changed[place] = other;
                assert!(product(&variances, cost, &changed) > 0.998 * least, "{place}: {other}");
            }
        }
    }

    #[test]
    fn branches_lower_the_noise_and_leave_the_mean() {
        let scene = crate::scene::showcase::published(12, 9);
        let tracer = Tracer::new(&scene, 4, 2);
        let picture = |branches: u32, seed: u32| {
            let view = View::new(&tracer, &scene.camera, seed, 16, vec![branches; 12 * 9]);
            let mut pixels = vec![Pixel::default(); 12 * 9];
            for pass in 1..=8 {
                view.add(&mut pixels, pass, None, |_| ());
            }
            let mean = pixels.iter().map(|pixel| colour::luminance(pixel.mean.truncate())).sum::<f32>();
            (mean, pixels.iter().map(|pixel| colour::luminance(pixel.spread)).sum::<f32>())
        };
        let [(one, noise), (eight, less)] = [picture(1, 1), picture(8, 2)];
        assert!((eight / one - 1.0).abs() < 0.02, "{one} {eight}");
        assert!(less < 0.9 * noise, "{noise} {less}");
    }

    #[test]
    fn pixels_without_noise_have_one_branch() {
        assert_eq!(best(&[[1.0, 0.0], [0.0, 0.0]], [1.0, 2.0]), [1, 1]);
        assert_eq!(best(&[[0.0, 0.0], [0.0, 0.0]], [1.0, 2.0]), [1, 1]);
        assert_eq!(best(&[[1.0, 5.0]], [1.0, 0.0]), [1]);
    }
}
