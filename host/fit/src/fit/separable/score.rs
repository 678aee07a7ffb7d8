//! How much each shape of a [`bank`] would lower the cost beside a model's.
//!
//! To first order, from products of the bank's shapes with what the model leaves of the samples, what the
//! model spans being free to follow: its amplitudes and, of one lobe or two, its shapes.

use super::super::linear;
use super::super::model::Model;
use super::bank::{self, Bank, EXPONENTS, Fill, Products32, ROWS, STEP, ridge_angle};
use super::layout::{LINEAR, Layout, WIDTH};
use super::normal::Amplitudes;
use super::solver::Solver;
use super::task::Task;

/// Poses with the largest residuals, of which each proposes a direction.
const RIDGE: usize = 8;

/// Columns that a set spans at most: its linear unknowns and four derivatives of two lobes each.
const SPANNED: usize = LINEAR + 8;

/// What of the channels' products of a shape with the residual counts.
#[derive(Debug, Clone, Copy)]
enum Along {
    /// Their sum: what a shape explains in all channels, of which chance has less.
    Sum,
    /// Those that are positive, each by itself: what an amplitude a channel, at least 0, explains.
    Channels,
}

impl Along {
    fn of(self, products: &[f32]) -> f64 {
        match self {
            Self::Sum => f64::from(products.iter().sum::<f32>().max(0.0)).powi(2),
            Self::Channels => products.iter().map(|&along| f64::from(along.max(0.0)).powi(2)).sum(),
        }
    }
}

/// A shape that would lower the cost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Maximum {
    /// By how much, to first order.
    pub score: f32,
    /// Angle of C on the circle, radians.
    pub angle: f64,
    /// Exponent.
    pub n: f64,
}

/// The scores of a bank's shapes, with their buffers.
#[derive(Debug, Clone, Default)]
pub struct Scores {
    /// Weighted residuals a channel, weights, weighted columns that the set spans: [list][pose].
    lists: Vec<f32>,
    /// How many of them are residuals.
    channels: usize,
    /// Those columns, of which column 0 has the weights for its list.
    spanned: Vec<usize>,
    /// Products of the bank's rows with those lists, [row][list].
    products: Vec<f32>,
    scores: Vec<f32>,
    /// Shapes of the directions that the largest residuals propose.
    ridge: Bank,
}

impl Scores {
    /// By how much the bank's best shape would lower the cost beside a model's, to first order.
    pub fn promise(
        &mut self,
        solver: &Solver,
        bank: &Bank,
        task: Task,
        model: &Model,
        at: &Amplitudes,
    ) -> f64 {
        self.list(solver, task, model, at);
        self.score(solver, bank, Along::Sum);
        let best = self.scores.iter().copied().fold(0.0, f32::max);
        let ridge = self.best_of_ridge(solver, 1, Along::Sum).first().map_or(0.0, |best| best.score);
        f64::from(best.max(ridge))
    }

    /// The shapes that would lower the cost most beside a model's, the best first: score, angle of C and
    /// exponent of the local maxima over the bank, and of the best whose highlight passes through one of the
    /// largest residuals.
    pub fn maxima(
        &mut self,
        solver: &Solver,
        bank: &Bank,
        task: Task,
        model: &Model,
        at: &Amplitudes,
    ) -> Vec<Maximum> {
        self.list(solver, task, model, at);
        self.score(solver, bank, Along::Channels);
        let maxima = (0..self.scores.len()).filter(|&i| self.is_maximum(bank, i));
        let mut starts: Vec<Maximum> = maxima
            .map(|i| self.between(i, |place| bank.neighbours(place), bank.angles[i / EXPONENTS]))
            .collect();
        starts.extend(self.best_of_ridge(solver, task.effort.ridge, Along::Channels));
        starts.sort_by(|a, b| b.score.total_cmp(&a.score));
        starts
    }

    /// The best lobes, with their scores, whose highlights pass through the poses with the largest residuals,
    /// at most `count`. The directions of the bank lie too far apart for sharp highlights that few poses
    /// meet.
    fn best_of_ridge(&mut self, solver: &Solver, count: usize, along: Along) -> Vec<Maximum> {
        let products = &solver.data.products;
        let poses = products.plane.len();
        let mut residuals = self.lists[..poses].to_vec();
        for list in self.lists[poses..].chunks_exact(poses).take(self.channels - 1) {
            residuals.iter_mut().zip(list).for_each(|(sum, value)| *sum += value);
        }
        let mut largest: Vec<usize> = (0..residuals.len()).filter(|&k| residuals[k] > 0.0).collect();
        let by_size = |&a: &usize, &b: &usize| residuals[b].total_cmp(&residuals[a]).then(a.cmp(&b));
        if largest.len() > RIDGE {
            largest.select_nth_unstable_by(RIDGE, by_size);
            largest.truncate(RIDGE);
        }
        largest.sort_by(by_size);
        let angles: Vec<f64> = largest.into_iter().filter_map(|k| ridge_angle(products, k)).collect();
        let mut ridge = std::mem::take(&mut self.ridge);
        solver.arch.dispatch(Fill(&mut ridge, &angles, products, solver.data.cone));
        self.score(solver, &ridge, along);
        let mut best = Vec::with_capacity(ridge.angles.len());
        for (place, &angle) in ridge.angles.iter().enumerate() {
            let of_place =
                (place * EXPONENTS..(place + 1) * EXPONENTS).filter(|&i| self.scores[i].is_finite());
            if let Some(i) = of_place.max_by(|&a, &b| self.scores[a].total_cmp(&self.scores[b])) {
                best.push(self.between(i, |_| None, angle));
            }
        }
        best.sort_by(|a, b| b.score.total_cmp(&a.score));
        best.truncate(count);
        self.ridge = ridge;
        best
    }

    /// Makes the lists that shapes are multiplied with: residual, weight, the shapes of the set.
    fn list(&mut self, solver: &Solver, task: Task, model: &Model, at: &Amplitudes) {
        let columns = &solver.columns;
        let layout = solver.layout(task.family, task.diffuse, model);
        let channels = layout.channels;
        let root = columns.column(0);
        self.channels = channels;
        self.lists.clear();
        for channel in 0..channels {
            let start = self.lists.len();
            self.lists.extend(columns.column(1 + channel).iter().map(|&goal| goal as f32));
            let rest = &mut self.lists[start..];
            for unknown in 0..=layout.terms() {
                let x = at.x[channel][unknown] as f32;
                let column = columns.column(layout.column(unknown));
                rest.iter_mut().zip(column).for_each(|(rest, &value)| *rest -= x * value as f32);
            }
            rest.iter_mut().zip(root).for_each(|(rest, &root)| *rest *= root as f32);
        }
        self.lists.extend(root.iter().map(|root| (root * root) as f32));
        self.spanned.clear();
        self.spanned.extend(spanned(layout, at));
        for &column in self.spanned.iter().filter(|&&column| column > 0) {
            let shape = columns.column(column);
            self.lists.extend(shape.iter().zip(root).map(|(shape, root)| (shape * root) as f32));
        }
    }

    /// How much each shape of the bank would lower the cost beside the model's, to first order, what is there
    /// moving along; −∞ where it adds nothing. The lists are made.
    fn score(&mut self, solver: &Solver, bank: &Bank, along: Along) {
        let count = bank.count;
        let known = self.spanned.len();
        let (channels, lists) = (self.channels, self.lists.len() / count.max(1));
        let products = Products32 { rows: &bank.shapes, lists: &self.lists, count, out: &mut self.products };
        solver.arch.dispatch(products);

        // Scaled to a diagonal of 1: derivatives and shapes have other sizes.
        let mut scale = [0.0; SPANNED];
        let mut factor = [0.0; SPANNED * SPANNED];
        for (i, &a) in self.spanned.iter().enumerate() {
            scale[i] = 1.0 / solver.gram[a * (WIDTH + 1)].max(f64::MIN_POSITIVE).sqrt();
            for (j, &b) in self.spanned[..=i].iter().enumerate() {
                factor[i * known + j] = solver.gram[a * WIDTH + b] * scale[i] * scale[j];
            }
            factor[i * known + i] += 1e-9;
        }
        let regular = linear::factor(&mut factor[..known * known], known);
        self.scores.clear();
        for place in 0..bank.angles.len() {
            for exponent in 0..EXPONENTS {
                let row = &self.products[(place * ROWS + exponent) * lists..][..lists];
                // The square of a shape is the next row of the bank.
                let square = f64::from(self.products[(place * ROWS + exponent + 1) * lists + channels]);
                let mut rest = square;
                if regular {
                    let mut inner = [0.0; SPANNED];
                    let mut shape = channels + 1;
                    for (i, &column) in self.spanned.iter().enumerate() {
                        let product = if column == 0 { row[channels] } else { row[shape] };
                        shape += usize::from(column > 0);
                        let dot: f64 = (0..i).map(|k| factor[i * known + k] * inner[k]).sum();
                        inner[i] = (f64::from(product) * scale[i] - dot) / factor[i * known + i];
                        rest -= inner[i] * inner[i];
                    }
                }
                let gain = along.of(&row[..channels]);
                let adds = gain > 0.0 && square > 0.0;
                let score = gain / rest.max(1e-3 * square);
                self.scores.push(if adds { score as f32 } else { f32::NEG_INFINITY });
            }
        }
    }

    /// The maximum near a shape at an angle, between it and its neighbours: exponents, and directions where
    /// `beside` tells their places. Each way it is that of the parabola through three scores.
    fn between(&self, index: usize, beside: impl Fn(usize) -> Option<[usize; 2]>, angle: f64) -> Maximum {
        let (place, exponent) = (index / EXPONENTS, index % EXPONENTS);
        let score = self.scores[index];
        let vertex = |before: f32, after: f32| {
            let bend = 2.0 * score - before - after;
            if !(bend > 0.0 && bend.is_finite()) {
                return [0.0; 2];
            }
            let off = (0.5 * (after - before) / bend).clamp(-0.5, 0.5);
            [off, 0.25 * (after - before) * off]
        };
        let at = |place: usize| self.scores[place * EXPONENTS + exponent];
        let [turn, by_turn] = beside(place).map_or([0.0; 2], |[before, after]| vertex(at(before), at(after)));
        let [octaves, by_octaves] = match exponent {
            1.. if exponent + 1 < EXPONENTS => vertex(self.scores[index - 1], self.scores[index + 1]),
            _ => [0.0; 2],
        };
        Maximum {
            score: score + by_turn + by_octaves,
            angle: angle + f64::from(turn) * STEP,
            n: bank::exponent(exponent as f64 + f64::from(octaves)),
        }
    }

    fn is_maximum(&self, bank: &Bank, index: usize) -> bool {
        let (score, directions) = (self.scores[index], bank.angles.len());
        let (place, exponent) = (index / EXPONENTS, index % EXPONENTS);
        let at = |place: usize, exponent: usize| self.scores[place % directions * EXPONENTS + exponent];
        score.is_finite()
            && (exponent == 0 || score >= at(place, exponent - 1))
            && (exponent + 1 == EXPONENTS || score > at(place, exponent + 1))
            && (directions < 2 || score >= at(place + directions - 1, exponent))
            && (directions < 2 || score > at(place + 1, exponent))
    }
}

/// The columns that the model spans: those of the linear unknowns that are free in any channel, and, of one
/// lobe or two, the derivatives of their shapes.
fn spanned(layout: Layout, at: &Amplitudes) -> impl Iterator<Item = usize> {
    let free = move |unknown: usize| (0..layout.channels).any(|channel| at.free[channel][unknown]);
    let lit = move |term: usize| (0..layout.channels).any(|channel| at.x[channel][1 + term] > 0.0);
    let linear =
        (0..=layout.terms()).filter(move |&unknown| free(unknown)).map(move |unknown| layout.column(unknown));
    let plain = layout.extension.is_none() && layout.lobes <= 2;
    let moving = layout.each_derivative().filter(move |&(term, _)| plain && lit(term));
    linear.chain(moving.map(move |(term, column)| layout.derivative(term, column)))
}

#[cfg(test)]
mod tests {
    use super::super::bank::exponent;
    use super::*;

    /// Scores of 24 directions whose maximum lies at a place between them, a parabola each way.
    fn parabola(direction: f64, octave: f64) -> Scores {
        let score = |i: usize| {
            let (place, step) = ((i / EXPONENTS) as f64, (i % EXPONENTS) as f64);
            (9.0 - 2.0 * (place - direction).powi(2) - 3.0 * (step - octave).powi(2)) as f32
        };
        Scores { scores: (0..24 * EXPONENTS).map(score).collect(), ..Scores::default() }
    }

    /// Vertex and height of the parabolas are known.
    #[test]
    fn a_maximum_between_the_banks_shapes_is_found_there() {
        for (direction, octave) in [(7.0, 4.0), (7.3, 4.0), (6.6, 4.4), (7.1, 3.7)] {
            let scores = parabola(direction, octave);
            let index = 7 * EXPONENTS + 4;
            let found = scores.between(index, |place| Some([place - 1, place + 1]), 7.0 * STEP);
            assert!((found.angle - direction * STEP).abs() < 1e-5, "{direction} {octave}: {found:?}");
            assert!((found.n / exponent(octave) - 1.0).abs() < 1e-5, "{direction} {octave}: {found:?}");
            assert!((found.score - 9.0).abs() < 1e-5, "{direction} {octave}: {found:?}");
            // Without neighbours all round, the direction stays.
            let alone = scores.between(index, |_| None, 7.0 * STEP);
            assert!(alone.angle == 7.0 * STEP && alone.n == found.n, "{alone:?}");
        }
    }

    #[test]
    fn directions_beside_a_gap_have_no_two_neighbours() {
        let all: Vec<f64> = (0..24).map(|k| (f64::from(k) + 0.5) * STEP).collect();
        let bank = |angles: &[f64]| Bank { angles: angles.to_vec(), ..Bank::default() };
        assert_eq!(bank(&all).neighbours(0), Some([23, 1]));
        assert_eq!(bank(&all).neighbours(5), Some([4, 6]));
        let gap = bank(&[&all[..6], &all[8..]].concat());
        assert_eq!([gap.neighbours(4), gap.neighbours(5), gap.neighbours(6)], [Some([3, 5]), None, None]);
    }
}
