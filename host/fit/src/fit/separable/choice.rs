//! As many lobes as the samples support: a model is judged by how well it predicts poses that it was not
//! fitted to.
//!
//! Leaving a pose out moves its residuals r to (I − H)⁻¹ r to first order, with H the pose's 3 × 3 block of
//! the hat matrix of all unknowns, so no refit is needed. A lobe that stands on one or two samples has H near
//! I there and predicts nothing. A larger model has to be better by two standard errors of the difference
//! over poses, or much better on the whole: what errors of direction do to a few poses at the flank of a
//! highlight no lobe should be fitted to.

use glam::{DMat3, DVec3};

use super::super::linear;
use super::super::model::Model;
use super::layout::{CHANNELS, LINEAR, UNKNOWNS};
use super::levels;
use super::normal::{self, Amplitudes};
use super::solver::Solver;
use super::task::Task;
use super::uncertainty::{Covariance, Response};

/// Standard errors by which a larger model has to be better.
const ERRORS: f64 = 2.0;
/// Standard errors below which a larger model that was taken is not better by much.
const CLOSE: f64 = 3.0;
/// Standard errors from which on a larger model that is not better beyond doubt makes one more lobe worth a
/// look.
const DOUBTFUL: f64 = 0.5;
/// Or the share of the sum of squares that it may leave: a sharp lobe that only two or three poses meet is
/// never two standard errors better, but leaves next to nothing there.
const SHARE: f64 = 0.7;

/// The squared residuals of every pose, summed over channels, predicted without it; the model was evaluated
/// last.
pub fn left_out(solver: &Solver, task: Task, model: &Model, at: &Amplitudes) -> Vec<f64> {
    let layout = solver.layout(task.family, task.diffuse, model);
    let covariance = Covariance::new(&normal::normal(&solver.gram, layout, at));
    let responses: Vec<Option<Response>> =
        (0..layout.channels).map(|channel| Response::new(solver, layout, at, channel)).collect();
    let columns = &solver.columns;
    let weight = columns.column(0);
    let own = levels::shares(&solver.data.texels, weight);
    (0..weight.len())
        .map(|k| {
            if weight[k] <= 0.0 {
                return 0.0;
            }
            let mut residual = DVec3::ZERO;
            // Derivatives of the pose's values by the shapes, amplitudes following; what of the hat matrix is
            // the amplitudes' own.
            let mut slopes = [[0.0; UNKNOWNS]; CHANNELS];
            let mut hat = DMat3::IDENTITY * own.get(k).copied().unwrap_or(0.0);
            let mut solved = [0.0; LINEAR];
            for (channel, response) in responses.iter().enumerate() {
                let x = &at.x[channel];
                residual[channel] = columns.column(1 + channel)[k];
                for (unknown, &x) in x.iter().enumerate().take(layout.terms() + 1).filter(|&(_, &x)| x != 0.0)
                {
                    residual[channel] -= x * columns.column(layout.column(unknown))[k];
                }
                for (term, column) in layout.each_derivative().filter(|&(term, _)| x[1 + term] != 0.0) {
                    let by = columns.column(layout.derivative(term, column))[k];
                    slopes[channel][layout.unknown(term, column)] += x[1 + term] * by;
                }
                let Some(response) = response else { continue };
                let count = response.members.len();
                let mut row = [0.0; LINEAR];
                for (place, &unknown) in row.iter_mut().zip(&response.members) {
                    *place = columns.column(layout.column(unknown))[k];
                }
                let before = channel.checked_sub(1).and_then(|before| responses[before].as_ref());
                if before.is_none_or(|before| before.members != response.members) {
                    solved = row;
                    linear::substitute(&response.factor, &mut solved[..count]);
                }
                for (place, by_shape) in response.by_shape.iter().enumerate() {
                    hat.col_mut(channel)[channel] += row[place] * solved[place];
                    for (slope, by_shape) in slopes[channel].iter_mut().zip(by_shape) {
                        *slope += row[place] * by_shape;
                    }
                }
            }
            for b in 0..layout.channels {
                let of_b = covariance.times(&slopes[b]);
                for (a, slopes) in slopes.iter().enumerate().take(layout.channels) {
                    let product = slopes.iter().zip(&of_b).map(|(slope, of_b)| slope * of_b);
                    hat.col_mut(b)[a] += product.take(layout.size()).sum::<f64>();
                }
            }
            let rest = DMat3::IDENTITY - hat;
            // A pose that some unknown stands on alone is predicted by nothing: its whole value is the error.
            let told = rest.determinant() > 1e-6;
            let values = DVec3::from_array(std::array::from_fn(|channel| columns.column(1 + channel)[k]));
            let predicted = if told { rest.inverse() * residual } else { values };
            predicted.length_squared()
        })
        .collect()
}

/// What comes of one lobe more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// It is better beyond doubt.
    Better,
    /// It predicts the poses a little better, but not beyond doubt: two lobes more may be, where one alone
    /// stands for both badly.
    Doubtful,
    /// It is no better.
    No,
}

/// Judges a model of more lobes by its squared residuals `large` against those of one of fewer.
pub fn verdict(large: &[f64], small: &[f64]) -> Verdict {
    let (gain, error, whole) = gain(large, small);
    match gain {
        gain if gain > ERRORS * error || gain > (1.0 - SHARE) * whole => Verdict::Better,
        gain if gain > DOUBTFUL * error => Verdict::Doubtful,
        _ => Verdict::No,
    }
}

/// Whether two numbers of lobes are told apart by little: the larger model is neither better by more than
/// three standard errors nor no better at all.
pub fn is_close(large: &[f64], small: &[f64]) -> bool {
    let (gain, error, whole) = gain(large, small);
    gain > DOUBTFUL * error && gain <= CLOSE * error && gain <= (1.0 - SHARE) * whole
}

/// By how much squared residuals fall, the standard error of that, and their sum before.
fn gain(large: &[f64], small: &[f64]) -> (f64, f64, f64) {
    let (mut gain, mut squares) = (0.0, 0.0);
    for (large, small) in large.iter().zip(small) {
        gain += small - large;
        squares += (small - large) * (small - large);
    }
    (gain, squares.sqrt(), small.iter().sum())
}

/// Looks for the last number of lobes that is better beyond doubt than the best before it, one lobe beyond
/// the first that is not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Ascent {
    doubted: bool,
}

impl Ascent {
    /// Whether to take the model with one lobe more, and whether to go on to the next.
    pub fn step(&mut self, large: &[f64], best: &[f64]) -> (bool, bool) {
        match verdict(large, best) {
            Verdict::Better => {
                self.doubted = false;
                (true, true)
            }
            Verdict::Doubtful if !self.doubted => {
                self.doubted = true;
                (false, true)
            }
            _ => (false, false),
        }
    }
}

/// Whether poses are predicted better with the squared residuals `large` than with `small`, beyond doubt.
pub fn is_better(large: &[f64], small: &[f64]) -> bool {
    verdict(large, small) == Verdict::Better
}
