//! Weights for samples that may lie far off: first Huber's (1964), by which a large residual counts by its
//! size instead of its square, then Tukey's biweight, by which one that is larger still does not count at
//! all.
//!
//! The distance of a pose is the norm of its weighted residuals over the channels; its scale comes from the
//! median of all poses, which up to half of them cannot move. Weights and fit follow each other (iteratively
//! reweighted least squares).

use super::layout::{CHANNELS, Layout};
use super::normal::Amplitudes;
use super::solver::Solver;

/// Times that weights are made.
pub const ROUNDS: usize = 8;
/// The first rounds are Huber's: Tukey's weights need a fit that is nearly right.
const HUBER: usize = 3;
/// The distance from which on Tukey's weight is 0, over that from which on Huber's falls: 4.7 standard
/// deviations of one channel.
const NOTHING: f64 = 2.4;
/// Median and 95 % quantile of the norm of 1, 2 and 3 standard normal values. Beyond the second a pose weighs
/// less.
const MEDIAN: [f64; CHANNELS] = [0.674, 1.177, 1.538];
const FAR: [f64; CHANNELS] = [1.960, 2.448, 2.795];

/// A factor for the weight of every pose in a round, from the residuals of a model that was evaluated last;
/// `before` are the factors in the data.
pub fn factors(round: usize, solver: &Solver, layout: Layout, at: &Amplitudes, before: &[f64]) -> Vec<f64> {
    let columns = &solver.columns;
    let mut squares = vec![0.0; solver.data.len()];
    for (channel, x) in at.x.iter().enumerate().take(layout.channels) {
        let mut rest = columns.column(1 + channel).to_vec();
        for (unknown, x) in x.iter().enumerate().take(layout.terms() + 1) {
            for (rest, value) in rest.iter_mut().zip(columns.column(layout.column(unknown))) {
                *rest -= x * value;
            }
        }
        squares.iter_mut().zip(&rest).for_each(|(square, rest)| *square += rest * rest);
    }
    let distances: Vec<f64> =
        squares.iter().zip(before).map(|(square, factor)| (square / factor).sqrt()).collect();
    let mut valid: Vec<f64> =
        distances.iter().zip(columns.column(0)).filter(|&(_, &root)| root > 0.0).map(|(&d, _)| d).collect();
    let middle = valid.len() / 2;
    if valid.is_empty() {
        return vec![1.0; distances.len()];
    }
    let (_, median, _) = valid.select_nth_unstable_by(middle, f64::total_cmp);
    let far = *median * FAR[layout.channels - 1] / MEDIAN[layout.channels - 1];
    let factor = |distance: f64| match distance / far {
        share if round < HUBER => {
            if share > 1.0 {
                1.0 / share
            } else {
                1.0
            }
        }
        share if share < NOTHING => (1.0 - (share / NOTHING).powi(2)).powi(2),
        _ => 0.0,
    };
    // Never 0, which would be a pose without a sample.
    distances.into_iter().map(|distance| factor(distance).max(1e-6)).collect()
}
