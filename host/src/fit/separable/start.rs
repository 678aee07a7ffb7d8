//! Starts from neighbours ([`follow`]) and from data ([`Search`]): the shapes of a small bank that explain most of what is left of a
//! texel's samples, and those whose highlight passes through the largest residuals.
//!
//! The bank's shapes are those at a place near the texel, so one bank serves a block of texels; the solver then works with the
//! texel's own directions. Lobes are added one after the other: the local maxima of what a shape explains beside those
//! found so far, over directions of C round the (Cxy, Cz) circle and n = 1, 2, 4, …, are each optimised for a few steps,
//! and the best go on.

use super::super::linear;
use super::super::lm::{Limits, Outcome};
use super::super::model::{Model, ModelLobe, isotropic_c};
use super::bank::{Bank, EXPONENTS, Fill, Products32, ROWS, ridge_angle};
use super::choice::{self, Ascent};
use super::columns::{CHANNELS, MOST_LOBES, WIDTH};
use super::normal::{Amplitudes, LINEAR, Layout};
use super::shape::{self, Family};
use super::solver::Solver;
use super::uncertainty;

/// How far the search goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Effort {
    /// Shapes tried as the next lobe of each set.
    pub tries: usize,
    /// Steps for each of them.
    pub steps: usize,
    /// Sets that go on to the next lobe.
    pub beam: usize,
    /// When the last set counts as converged.
    pub limits: Limits,
}

impl Effort {
    /// For one of thousands of texels. Up to two lobes little effort finds the best start in all but a few per cent of texels; with
    /// more, sets of shapes compete that look alike for the first few steps.
    pub fn texel(lobes: usize) -> Self {
        if lobes <= 2 {
            return Self { tries: 3, steps: 3, beam: 2, limits: Limits { iterations: 40, tolerance: 1e-5 } };
        }
        Self { tries: 4, steps: 6, beam: 3, limits: Limits { iterations: 60, tolerance: 1e-6 } }
    }

    /// For a texel from which others start.
    pub fn thorough(lobes: usize) -> Self {
        let Self { limits, .. } = Self::texel(lobes);
        Self { tries: 6, steps: 8, beam: 6, limits }
    }
}

/// Sets whose costs differ by no more than this share are the same.
const ALIKE: f64 = 1e-3;
/// A set that after a few steps is above so many times the best cost is not followed further.
const HOPEFUL: f64 = 1.1;
/// Poses with the largest residuals, of which each proposes a direction.
const RIDGE: usize = 8;

/// Columns that a set spans at most: its linear unknowns and four derivatives of two lobes each.
const SPANNED: usize = LINEAR + 8;

/// A set of shapes with its cost.
#[derive(Debug, Clone)]
struct Candidate {
    cost: f64,
    model: Model,
}

/// The search with its buffers; one a thread.
#[derive(Debug, Clone, Default)]
pub struct Search {
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

/// What is fitted, beside the data.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Task {
    /// Lobes.
    pub lobes: usize,
    /// Shapes.
    pub family: Family,
    /// Whether ρ_d is an unknown.
    pub diffuse: bool,
    /// Effort.
    pub effort: Effort,
    /// Whether `lobes` is the most: then as many as [`choice`] finds supported.
    pub choose: bool,
}

/// A model and how well it does, for texels nearby to start from.
#[derive(Debug, Clone)]
pub struct Known {
    /// The shapes.
    pub model: Model,
    /// Cost a valid sample that the search came to with as many lobes, here or at the texel that it was handed on from.
    pub level: f64,
    /// Cost here.
    pub cost: f64,
}

/// What a search found.
#[derive(Debug, Clone)]
pub struct Found {
    /// The shapes.
    pub model: Model,
    /// Their amplitudes.
    pub at: Amplitudes,
    /// Cost and convergence.
    pub outcome: Outcome,
    /// Squared residuals of the poses, each predicted without it; empty where there is no choice to make.
    pub left_out: Vec<f64>,
    /// The models with 1, 2, … lobes that there was a choice of, or that it came from where there was none.
    pub known: Vec<Known>,
    /// Whether another number of lobes would do almost as well, see [`choice`].
    pub doubtful: bool,
}

impl Found {
    /// Optimises a model to convergence.
    pub fn of(solver: &mut Solver, task: Task, model: Model) -> Self {
        Self::better_of(solver, task, model, None)
    }

    /// Optimises one model or two to convergence and takes the better.
    fn better_of(solver: &mut Solver, task: Task, model: Model, other: Option<Model>) -> Self {
        let mut end = |mut model: Model| {
            let (at, outcome) = minimise(solver, task, task.effort.limits, &mut model);
            (model, at, outcome)
        };
        let mut best = end(model);
        if let Some(other) = other.map(end)
            && other.1.cost < best.1.cost
        {
            best = other;
        }
        let (model, at, outcome) = best;
        let mut left_out = Vec::new();
        if task.choose {
            // The last step tried may have been another one.
            solver.evaluate(task.family, task.diffuse, &model);
            left_out = choice::left_out(solver, task, &model, &at);
        }
        Self { model, at, outcome, left_out, known: Vec::new(), doubtful: false }
    }

    /// A model that is optimised, with how well it predicts left-out poses.
    pub fn judged(solver: &mut Solver, task: Task, known: &Known) -> Self {
        let at = solver.evaluate(task.family, task.diffuse, &known.model);
        let left_out = choice::left_out(solver, task, &known.model, &at);
        let outcome = Outcome { cost: at.cost, iterations: 0, converged: true };
        Self { model: known.model.clone(), at, outcome, left_out, known: Vec::new(), doubtful: false }
    }

    /// The model with its cost.
    fn known(&self, solver: &Solver) -> Known {
        Known { model: self.model.clone(), level: level(solver, &self.at), cost: self.at.cost }
    }
}

/// Cost a valid sample.
fn level(solver: &Solver, at: &Amplitudes) -> f64 {
    at.cost / solver.data.valid.max(1) as f64
}

/// A start from a neighbour has led to as good a fit as a search would if its cost is within this range of what the search came to
/// there. The cost of 600 samples with nothing but noise scatters by 6 %; a cost far lower is that of another material, of
/// which the neighbour's search tells nothing.
const AS_GOOD: std::ops::RangeInclusive<f64> = 0.8..=1.15;

/// Whether a neighbour's shapes as they are come so close to its own cost that no other start needs a look.
pub fn may_do(solver: &Solver, cost: f64, near: &Known) -> bool {
    cost <= AS_GOOD.end() * near.level * solver.data.valid as f64
}

/// The fit of a fixed number of lobes from shapes that were found nearby, and whether it is as good as a search would find. It may not be where
/// it is worse than there, or far better (then it is of another material), above `floor`, the cost of a fit that it contains, or where an
/// isotropic lobe of it only fits noise, in which the neighbour's has no meaning here.
///
/// Anisotropic lobes start from the isotropic ones here as well: what noise makes of them differs.
pub fn follow(
    solver: &mut Solver,
    task: Task,
    near: &Known,
    floor: f64,
    wide: Option<&Known>,
) -> (Known, bool) {
    let reach = |solver: &mut Solver, start: &Model| {
        let mut model = start.clone();
        let (at, _) = minimise(solver, task, task.effort.limits, &mut model);
        Known { model, level: near.level, cost: at.cost }
    };
    let mut found = reach(solver, &near.model);
    let mut told = true;
    match wide {
        Some(wide) => {
            let spread = reach(solver, &wide.model);
            for other in [spread, Known { level: near.level, ..wide.clone() }] {
                if other.cost < found.cost {
                    found = other;
                }
            }
        }
        None => {
            let at = solver.evaluate(task.family, task.diffuse, &found.model);
            let layout = solver.layout(task.family, task.diffuse, &found.model);
            told = uncertainty::told(solver, layout, &at).into_iter().all(|told| told);
        }
    }
    let level = found.cost / solver.data.valid.max(1) as f64;
    let good = told && found.cost <= floor && AS_GOOD.contains(&(level / near.level));
    (found, good)
}

impl Search {
    /// The best fit that the search finds. The solver has begun with the texel's data.
    pub fn best(&mut self, solver: &mut Solver, bank: &Bank, task: Task) -> Found {
        self.best_from(solver, bank, task, &[Model::default()])
    }

    /// As [`Self::best`], with lobes added to the first of some models without any, or to each of them.
    pub fn best_from(&mut self, solver: &mut Solver, bank: &Bank, task: Task, bases: &[Model]) -> Found {
        let of = |model: &Model| Candidate { cost: f64::INFINITY, model: model.clone() };
        let mut beam: Vec<Candidate> = bases.iter().map(of).collect();
        let mut chosen: Option<Found> = None;
        let mut known = Vec::new();
        let mut ascent = Ascent::default();
        if task.choose {
            chosen = Some(Found::of(solver, task, bases[0].clone()));
        }
        for added in 1..=task.lobes {
            let last = added == task.lobes;
            let next = self.extended(solver, bank, task, &beam, !last || task.choose);
            if next.is_empty() {
                break;
            }
            beam = next;
            if let Some(best) = &mut chosen {
                let found = Found::of(solver, task, beam[0].model.clone());
                known.push(found.known(solver));
                let (better, further) = ascent.step(&found.left_out, &best.left_out);
                if better {
                    *best = found;
                }
                if !further {
                    break;
                }
            } else if last {
                beam.truncate(1);
            }
        }
        match chosen {
            Some(found) => Found { known, ..found },
            None => {
                let found = Found::of(solver, task, beam.swap_remove(0).model);
                Found { known: vec![found.known(solver)], ..found }
            }
        }
    }

    /// The best fit of anisotropic lobes, as many as are supported, that starts from the isotropic models with 1, 2, … lobes or from the
    /// anisotropic one with one lobe less; with lobes added to a model without any.
    pub fn widened_from(
        &mut self,
        solver: &mut Solver,
        bank: &Bank,
        task: Task,
        isotropic: &[Known],
        base: &Model,
    ) -> Found {
        let task = Task { effort: Effort { beam: 1, ..task.effort }, ..task };
        let mut best = Found::of(solver, task, base.clone());
        let mut known: Vec<Known> = Vec::with_capacity(isotropic.len());
        let mut ascent = Ascent::default();
        for start in isotropic {
            let mut longer = Vec::new();
            if let Some(last) = known.last() {
                let set = Candidate { cost: f64::INFINITY, model: last.model.clone() };
                longer = self.extended(solver, bank, task, &[set], true);
            }
            let longer = longer.pop().map(|candidate| candidate.model);
            let found = Found::better_of(solver, task, start.model.clone(), longer);
            known.push(found.known(solver));
            let (better, further) = ascent.step(&found.left_out, &best.left_out);
            if better {
                best = found;
            }
            if !further {
                break;
            }
        }
        Found { known, ..best }
    }

    /// The best fit of a fixed number of lobes that the search finds, from the fits `below`, with one lobe less, and `wide`, with as many isotropic
    /// lobes where the family is another: at no higher cost than either, nor than `followed`, which came from a neighbour.
    pub fn rung(
        &mut self,
        solver: &mut Solver,
        bank: &Bank,
        task: Task,
        [below, wide]: [Option<&Known>; 2],
        followed: Option<Known>,
    ) -> Known {
        let of = |known: &Known| Candidate { cost: known.cost, model: known.model.clone() };
        let mut beam: Vec<Candidate> = below.map(of).into_iter().collect();
        if wide.is_none() && (followed.is_none() || task.lobes > 2 && !task.choose) && task.lobes > 1 {
            // Sets that look worse with few lobes may be the better ones with more.
            let mut other = vec![Candidate { cost: f64::INFINITY, model: Model::default() }];
            for lobes in 1..task.lobes {
                let effort = Effort { limits: Effort::texel(lobes).limits, ..task.effort };
                other = self.extended(solver, bank, Task { lobes, effort, ..task }, &other, true);
            }
            other.retain(|other| beam.iter().all(|set| (set.cost - other.cost).abs() > ALIKE * set.cost));
            beam.extend(other);
            beam.truncate(task.effort.beam);
        }
        if beam.is_empty() {
            beam.push(Candidate { cost: f64::INFINITY, model: Model::default() });
        }
        let mut ends = self.extended(solver, bank, task, &beam, true);
        ends.truncate(if wide.is_some() { 2 } else { 1 });
        if followed.is_none() {
            ends.extend(wide.map(of));
        }
        let mut best = followed;
        for end in ends {
            if best.as_ref().is_none_or(|best| end.cost < HOPEFUL * best.cost) {
                let mut model = end.model;
                let (at, _) = minimise(solver, task, task.effort.limits, &mut model);
                if best.as_ref().is_none_or(|best| at.cost < best.cost) {
                    best = Some(Known { model, level: level(solver, &at), cost: at.cost });
                }
            }
        }
        for nested in below.into_iter().chain(wide) {
            if best.as_ref().is_none_or(|best| nested.cost < best.cost) {
                best = Some(self.widest(solver, bank, task, nested));
            }
        }
        let found = best.unwrap_or_else(|| Found::of(solver, task, Model::default()).known(solver));
        // What a search came to here is what neighbours are judged by.
        Known { level: found.cost / solver.data.valid.max(1) as f64, ..found }
    }

    /// The model with the bank's best lobe more, after a few steps.
    pub fn one_more(&mut self, solver: &mut Solver, bank: &Bank, task: Task, model: &Model) -> Option<Model> {
        let set = Candidate { cost: f64::INFINITY, model: model.clone() };
        self.extended(solver, bank, task, &[set], true).pop().map(|set| set.model)
    }

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
        self.score(solver, bank);
        let best = self.scores.iter().copied().fold(0.0, f32::max);
        let ridge = self.best_of_ridge(solver).map_or(0.0, |(score, ..)| score);
        f64::from(best.max(ridge))
    }

    /// A fit within the task from one that it contains: as it is where lobes are only isotropic, else with a lobe more.
    fn widest(&mut self, solver: &mut Solver, bank: &Bank, task: Task, nested: &Known) -> Known {
        let as_it_is = Known { level: nested.cost / solver.data.valid.max(1) as f64, ..nested.clone() };
        if nested.model.lobes.len() == task.lobes {
            return as_it_is;
        }
        let set = Candidate { cost: nested.cost, model: nested.model.clone() };
        let next = self.extended(
            solver,
            bank,
            Task { effort: Effort { beam: 1, ..task.effort }, ..task },
            &[set],
            true,
        );
        let found = next.into_iter().next().map(|set| Found::of(solver, task, set.model).known(solver));
        found.filter(|found| found.cost <= nested.cost).unwrap_or(as_it_is)
    }

    /// The best sets of one lobe more than those of the beam, the best first; tried for a few steps where `tried`, or where there are several.
    fn extended(
        &mut self,
        solver: &mut Solver,
        bank: &Bank,
        task: Task,
        beam: &[Candidate],
        tried: bool,
    ) -> Vec<Candidate> {
        let Task { family, diffuse, effort, .. } = task;
        let mut next = Vec::with_capacity(effort.tries * beam.len());
        for set in beam {
            let at = solver.evaluate(family, diffuse, &set.model);
            self.extend(solver, bank, task, &set.model, &at, &mut next);
        }
        let few = Limits { iterations: effort.steps, ..effort.limits };
        if next.len() > 1 || tried {
            for candidate in &mut next {
                candidate.cost = minimise(solver, task, few, &mut candidate.model).1.cost;
            }
        }
        next.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        next.dedup_by(|b, a| (b.cost - a.cost).abs() <= 1e-5 * a.cost);
        next.truncate(effort.beam);
        next
    }

    /// Adds to `found` the model with one lobe of the bank more, for the best local maxima.
    fn extend(
        &mut self,
        solver: &Solver,
        bank: &Bank,
        task: Task,
        model: &Model,
        at: &Amplitudes,
        found: &mut Vec<Candidate>,
    ) {
        self.list(solver, task, model, at);
        self.score(solver, bank);
        let starts = (0..self.scores.len()).filter(|&i| self.is_maximum(bank, i));
        let mut starts: Vec<(f32, f64, usize)> =
            starts.map(|i| (self.scores[i], bank.angles[i / EXPONENTS], i % EXPONENTS)).collect();
        starts.extend(self.best_of_ridge(solver));
        starts.sort_by(|a, b| b.0.total_cmp(&a.0));
        for &(_, angle, exponent) in starts.iter().take(task.effort.tries) {
            let mut model = model.clone();
            model.lobes.push(ModelLobe::unit(isotropic_c(angle), f64::from(1u32 << exponent)));
            found.push(Candidate { cost: f64::INFINITY, model });
        }
    }

    /// The best lobe, with its score, whose highlight passes through one of the poses with the largest residuals. The directions of the
    /// bank lie too far apart for sharp highlights that few poses meet.
    fn best_of_ridge(&mut self, solver: &Solver) -> Option<(f32, f64, usize)> {
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
        let scores = self.scores.iter().enumerate().filter(|(_, score)| score.is_finite());
        let best = scores.max_by(|a, b| a.1.total_cmp(b.1));
        let best = best.map(|(i, &score)| (score, ridge.angles[i / EXPONENTS], i % EXPONENTS));
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

/// Optimises within the task's family. An anisotropic fit of lobes that are still isotropic first finds their direction.
pub fn minimise(solver: &mut Solver, task: Task, limits: Limits, model: &mut Model) -> (Amplitudes, Outcome) {
    let Task { family, diffuse, .. } = task;
    if family != Family::Anisotropic
        || model.lobes.is_empty()
        || model.lobes.iter().any(|lobe| lobe.c.x != lobe.c.y)
    {
        return solver.minimise(family, diffuse, limits, model);
    }
    solver.minimise(Family::Isotropic, diffuse, limits, model);
    spread(solver, diffuse, model);
    solver.minimise(family, diffuse, limits, model)
}

/// Gives isotropic lobes the direction β and the difference of Cx and Cy that one Gauss–Newton step over symmetric C suggests: its entries
/// h cos 2β and h sin 2β have no singularity at h = 0. Lobes vote for the common axis by their information.
fn spread(solver: &mut Solver, diffuse: bool, model: &mut Model) {
    let at = solver.evaluate(Family::Split, diffuse, model);
    let layout = solver.layout(Family::Split, diffuse, model);
    let normal = super::normal::normal(&solver.gram, layout, &at);
    let Some(step) = super::solver::solve(&normal, layout, model, 1e-3) else { return };
    let (mut cos, mut sin) = (0.0, 0.0);
    for lobe in 0..model.lobes.len() {
        let entry = |column| shape::Family::Split.unknown(lobe, column, layout.lobes);
        let (a, b) = (step[entry(2)], step[entry(3)]);
        let diagonal = |i: usize| normal.matrix[i * normal.size + i];
        let information = diagonal(entry(2)) + diagonal(entry(3));
        cos += information * (a * a - b * b);
        sin += information * 2.0 * a * b;
    }
    let double = 0.5 * sin.atan2(cos);
    for (index, lobe) in model.lobes.iter_mut().enumerate().take(MOST_LOBES) {
        let entry = |column| step[shape::Family::Split.unknown(index, column, layout.lobes)];
        let spread = entry(2) * double.cos() + entry(3) * double.sin();
        let spread = spread.clamp(-0.3, 0.3);
        lobe.c = (lobe.c + glam::DVec3::new(spread, -spread, 0.0)).normalize();
    }
    model.beta = 0.5 * double;
}
