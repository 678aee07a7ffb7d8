//! How much each shape of a [`bank`](super::bank) would lower the cost beside a model's.
//!
//! To first order, from products of the bank's shapes with what the model leaves of the samples, what the model spans being free to follow: its amplitudes
//! and, of one lobe or two, its shapes.

use super::super::linear;
use super::super::model::Model;
use super::bank::{Bank, EXPONENTS, Fill, Products32, ROWS, ridge_angle};
use super::layout::{CHANNELS, LINEAR, Layout, WIDTH};
use super::normal::Amplitudes;
use super::solver::Solver;
use super::task::Task;

/// Poses with the largest residuals, of which each proposes a direction.
const RIDGE: usize = 8;

/// Columns that a set spans at most: its linear unknowns and four derivatives of two lobes each.
const SPANNED: usize = LINEAR + 8;

/// The scores of a bank's shapes, with their buffers.
#[derive(Debug, Clone, Default)]
pub struct Scores {
    /// Weighted residual, weights, weighted columns that the set spans: [list][pose].
    lists: Vec<f32>,
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
        self.of_bank(solver, bank, task, model, at);
        let best = self.scores.iter().copied().fold(0.0, f32::max);
        let ridge = self.best_of_ridge(solver, 1).first().map_or(0.0, |best| best.0);
        f64::from(best.max(ridge))
    }

    /// The shapes that would lower the cost most beside a model's, the best first: score, angle of C and place of the exponent of the local maxima over the
    /// bank, and of the best whose highlight passes through one of the largest residuals.
    pub fn maxima(
        &mut self,
        solver: &Solver,
        bank: &Bank,
        task: Task,
        model: &Model,
        at: &Amplitudes,
    ) -> Vec<(f32, f64, usize)> {
        self.of_bank(solver, bank, task, model, at);
        let maxima = (0..self.scores.len()).filter(|&i| self.is_maximum(bank, i));
        let mut starts: Vec<(f32, f64, usize)> =
            maxima.map(|i| (self.scores[i], bank.angles[i / EXPONENTS], i % EXPONENTS)).collect();
        starts.extend(self.best_of_ridge(solver, task.effort.ridge));
        starts.sort_by(|a, b| b.0.total_cmp(&a.0));
        starts
    }

    /// Scores the bank's shapes beside a model.
    fn of_bank(&mut self, solver: &Solver, bank: &Bank, task: Task, model: &Model, at: &Amplitudes) {
        self.list(solver, task, model, at);
        self.score(solver, bank);
    }

    /// The best lobes, with their scores, whose highlights pass through the poses with the largest residuals, at most `count`. The directions of
    /// the bank lie too far apart for sharp highlights that few poses meet.
    fn best_of_ridge(&mut self, solver: &Solver, count: usize) -> Vec<(f32, f64, usize)> {
        let products = &solver.data.products;
        let residuals = &self.lists[..products.plane.len()];
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
        self.score(solver, &ridge);
        let by_direction = self.scores.chunks_exact(EXPONENTS).zip(&ridge.angles);
        let mut best: Vec<(f32, f64, usize)> = by_direction
            .filter_map(|(scores, &angle)| {
                let scores = scores.iter().copied().enumerate().filter(|(_, score)| score.is_finite());
                let best = scores.max_by(|a, b| a.1.total_cmp(&b.1));
                best.map(|(exponent, score)| (score, angle, exponent))
            })
            .collect();
        best.sort_by(|a, b| b.0.total_cmp(&a.0));
        best.truncate(count);
        self.ridge = ridge;
        best
    }

    /// Makes the lists that shapes are multiplied with: residual, weight, the shapes of the set.
    fn list(&mut self, solver: &Solver, task: Task, model: &Model, at: &Amplitudes) {
        let (columns, count) = (&solver.columns, solver.data.len());
        let layout = solver.layout(task.family, task.diffuse, model);
        let channels = layout.channels;
        let root = columns.column(0);
        let mut rest = vec![0.0; count];
        let mut add = |factor: f64, column: &[f64]| {
            for (rest, value) in rest.iter_mut().zip(column) {
                *rest += factor * value;
            }
        };
        (0..channels).for_each(|channel| add(1.0, columns.column(1 + channel)));
        for unknown in 0..=layout.terms() {
            let total: f64 = (0..CHANNELS).map(|channel| at.x[channel][unknown]).sum();
            add(-total, columns.column(layout.column(unknown)));
        }
        self.lists.clear();
        self.lists.extend(rest.iter().zip(root).map(|(rest, root)| (rest * root) as f32));
        self.lists.extend(root.iter().map(|root| (root * root) as f32));
        self.spanned.clear();
        self.spanned.extend(spanned(layout, at));
        for &column in self.spanned.iter().filter(|&&column| column > 0) {
            let shape = columns.column(column);
            self.lists.extend(shape.iter().zip(root).map(|(shape, root)| (shape * root) as f32));
        }
    }

    /// How much each shape of the bank would lower the cost beside the model's, to first order, what is there moving along; −∞ where it adds
    /// nothing. The lists are made.
    fn score(&mut self, solver: &Solver, bank: &Bank) {
        let count = bank.count;
        let known = self.spanned.len();
        let lists = self.lists.len() / count.max(1);
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
                let square = f64::from(self.products[(place * ROWS + exponent + 1) * lists + 1]);
                let mut rest = square;
                if regular {
                    let mut inner = [0.0; SPANNED];
                    let mut shape = 2;
                    for (i, &column) in self.spanned.iter().enumerate() {
                        let product = if column == 0 { row[1] } else { row[shape] };
                        shape += usize::from(column > 0);
                        let dot: f64 = (0..i).map(|k| factor[i * known + k] * inner[k]).sum();
                        inner[i] = (f64::from(product) * scale[i] - dot) / factor[i * known + i];
                        rest -= inner[i] * inner[i];
                    }
                }
                let along = f64::from(row[0]);
                let adds = along > 0.0 && square > 0.0;
                let score = along * along / rest.max(1e-3 * square);
                self.scores.push(if adds { score as f32 } else { f32::NEG_INFINITY });
            }
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

/// The columns that the model spans: those of the linear unknowns that are free in any channel, and, of one lobe or two, the derivatives of their shapes.
fn spanned(layout: Layout, at: &Amplitudes) -> impl Iterator<Item = usize> {
    let free = move |unknown: usize| (0..layout.channels).any(|channel| at.free[channel][unknown]);
    let lit = move |term: usize| (0..layout.channels).any(|channel| at.x[channel][1 + term] > 0.0);
    let linear =
        (0..=layout.terms()).filter(move |&unknown| free(unknown)).map(move |unknown| layout.column(unknown));
    let plain = layout.extension.is_none() && layout.lobes <= 2;
    let moving = layout.each_derivative().filter(move |&(term, _)| plain && lit(term));
    linear.chain(moving.map(move |(term, column)| layout.derivative(term, column)))
}
