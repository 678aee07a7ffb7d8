//! Starts from data: lobes of a small bank that explain most of what is left of a texel's samples, and those
//! whose highlight passes through the largest residuals.
//!
//! The bank's shapes are those at a place near the texel, so one bank serves a block of texels; the solver
//! then works with the texel's own directions. Lobes are added one after the other: the local maxima of what
//! a shape explains beside those found so far ([`Scores`]), over directions of C round the (Cxy, Cz) circle
//! and n = 1, 2, 4, …, are each optimised for a few steps, and the best go on.

use super::super::lm::Limits;
use super::super::model::{Model, ModelLobe, isotropic_c};
use super::bank::Bank;
use super::choice::Ascent;
use super::score::{Maximum, Scores};
use super::solver::Solver;
use super::start::{Found, Known, level, minimise};
use super::task::{Effort, Task};

/// Sets whose costs differ by no more than this share are the same.
const ALIKE: f64 = 1e-3;
/// A set that after a few steps is above so many times the best cost is not followed further.
const HOPEFUL: f64 = 1.1;

/// A set of shapes with its cost.
#[derive(Debug, Clone)]
struct Candidate {
    cost: f64,
    model: Model,
}

impl Candidate {
    /// A set that was not tried.
    fn of(model: Model) -> Self {
        Self { cost: f64::INFINITY, model }
    }
}

/// The search with its buffers; one a thread.
#[derive(Debug, Clone, Default)]
pub struct Search {
    /// Scores of the bank's shapes.
    pub scores: Scores,
}

impl Search {
    /// The best fit that the search finds. The solver has begun with the texel's data.
    pub fn best(&mut self, solver: &mut Solver, bank: &Bank, task: Task) -> Found {
        self.best_from(solver, bank, task, &[Model::default()])
    }

    /// As [`Self::best`], with lobes added to the first of some models without any, or to each of them.
    pub fn best_from(&mut self, solver: &mut Solver, bank: &Bank, task: Task, bases: &[Model]) -> Found {
        let mut beam: Vec<Candidate> = bases.iter().cloned().map(Candidate::of).collect();
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

    /// The best fit of anisotropic lobes, as many as are supported, that starts from the isotropic models
    /// with 1, 2, … lobes or from the anisotropic one with one lobe less; with lobes added to a model without
    /// any.
    pub fn widened_from(
        &mut self,
        solver: &mut Solver,
        bank: &Bank,
        task: Task,
        isotropic: &[Known],
        base: &Model,
    ) -> Found {
        let mut best = Found::of(solver, task, base.clone());
        let mut known: Vec<Known> = Vec::with_capacity(isotropic.len());
        let mut ascent = Ascent::default();
        for start in isotropic {
            let longer = known.last().and_then(|last| self.one_more(solver, bank, task, &last.model));
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

    /// The best fit of a fixed number of lobes that the search finds, from the fits `below`, with one lobe
    /// less, and `wide`, with as many isotropic lobes where the family is another: at no higher cost than
    /// either, nor than `followed`, which came from a neighbour. Where there is no neighbour (`fresh`) sets
    /// are looked for that are better only with more lobes.
    pub fn rung(
        &mut self,
        solver: &mut Solver,
        bank: &Bank,
        task: Task,
        [below, wide]: [Option<&Known>; 2],
        followed: Option<Known>,
        fresh: bool,
    ) -> Known {
        let of = |known: &Known| Candidate { cost: known.cost, model: known.model.clone() };
        let mut beam: Vec<Candidate> = below.map(of).into_iter().collect();
        if wide.is_none() && (fresh || task.lobes > 2 && !task.choose) && task.lobes > 1 {
            // Sets that look worse with few lobes may be the better ones with more.
            let mut other = vec![Candidate::of(Model::default())];
            for lobes in 1..task.lobes {
                let effort = Effort { limits: Effort::texel(lobes).limits, ..task.effort };
                other = self.extended(solver, bank, Task { lobes, effort, ..task }, &other, true);
            }
            other.retain(|other| beam.iter().all(|set| (set.cost - other.cost).abs() > ALIKE * set.cost));
            beam.extend(other);
            beam.truncate(task.effort.beam);
        }
        if beam.is_empty() {
            beam.push(Candidate::of(Model::default()));
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
        let mut found = best.unwrap_or_else(|| Found::of(solver, task, Model::default()).known(solver));
        if task.lobes > 2 && !task.choose {
            found = self.exchanged(solver, bank, task, found);
        }
        // What a search came to here is what neighbours are judged by.
        Known { level: found.cost / solver.data.valid.max(1) as f64, ..found }
    }

    /// A fit with lobes exchanged, one after the other, for better ones of the bank as long as that lowers
    /// the cost: with three lobes and more, one that stands where two of them would do better lets no single
    /// lobe be added there.
    pub fn exchanged(&mut self, solver: &mut Solver, bank: &Bank, task: Task, mut best: Known) -> Known {
        let (mut place, mut kept) = (0, 0);
        while kept < best.model.lobes.len() {
            let mut rest = best.model.clone();
            rest.lobes.remove(place % best.model.lobes.len());
            place += 1;
            kept += 1;
            let (hoped, mut sets) = self.proposed(solver, bank, task, &rest);
            if hoped > HOPEFUL * best.cost {
                continue;
            }
            tried_out(solver, task, &mut sets);
            sets.sort_by(|a, b| a.cost.total_cmp(&b.cost));
            sets.dedup_by(|b, a| (b.cost - a.cost).abs() <= ALIKE * a.cost);
            for Candidate { cost, mut model } in sets.into_iter().take(task.effort.beam) {
                let same = (cost - best.cost).abs() <= ALIKE * best.cost;
                if same || cost > HOPEFUL * best.cost {
                    continue;
                }
                let (at, _) = minimise(solver, task, task.effort.limits, &mut model);
                if at.cost < (1.0 - ALIKE) * best.cost {
                    best = Known { model, level: level(solver, &at), cost: at.cost };
                    kept = 0;
                }
            }
        }
        best
    }

    /// The model with the bank's best lobe more, after a few steps.
    pub fn one_more(&mut self, solver: &mut Solver, bank: &Bank, task: Task, model: &Model) -> Option<Model> {
        let task = Task { effort: Effort { beam: 1, ..task.effort }, ..task };
        self.extended(solver, bank, task, &[Candidate::of(model.clone())], true).pop().map(|set| set.model)
    }

    /// A fit within the task from one that it contains: as it is where lobes are only isotropic, else with a
    /// lobe more.
    fn widest(&mut self, solver: &mut Solver, bank: &Bank, task: Task, nested: &Known) -> Known {
        let as_it_is = Known { level: nested.cost / solver.data.valid.max(1) as f64, ..nested.clone() };
        if nested.model.lobes.len() == task.lobes {
            return as_it_is;
        }
        let found = self
            .one_more(solver, bank, task, &nested.model)
            .map(|model| Found::of(solver, task, model).known(solver));
        found.filter(|found| found.cost <= nested.cost).unwrap_or(as_it_is)
    }

    /// The best sets of one lobe more than those of the beam, the best first; tried for a few steps where
    /// `tried`, or where there are several.
    fn extended(
        &mut self,
        solver: &mut Solver,
        bank: &Bank,
        task: Task,
        beam: &[Candidate],
        tried: bool,
    ) -> Vec<Candidate> {
        let mut next = Vec::with_capacity(task.effort.tries * beam.len());
        for set in beam {
            next.extend(self.proposed(solver, bank, task, &set.model).1);
        }
        if next.len() > 1 || tried {
            tried_out(solver, task, &mut next);
        }
        next.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        next.dedup_by(|b, a| (b.cost - a.cost).abs() <= 1e-5 * a.cost);
        next.truncate(task.effort.beam);
        next
    }

    /// The model with one lobe of the bank more, for the best of its shapes, and the cost that the best of
    /// them would come to, to first order and at best.
    fn proposed(
        &mut self,
        solver: &mut Solver,
        bank: &Bank,
        task: Task,
        model: &Model,
    ) -> (f64, Vec<Candidate>) {
        let at = solver.evaluate(task.family, task.diffuse, model);
        let maxima = self.scores.maxima(solver, bank, task, model, &at);
        let left =
            at.cost - maxima.first().map_or(0.0, |best| f64::from(best.score)) * solver.data.channels as f64;
        let with = |best: &Maximum| {
            let mut model = model.clone();
            model.lobes.push(ModelLobe::unit(isotropic_c(best.angle), best.n));
            Candidate::of(model)
        };
        (left, maxima.iter().take(task.effort.tries).map(with).collect())
    }
}

/// Optimises sets for a few steps.
fn tried_out(solver: &mut Solver, task: Task, sets: &mut [Candidate]) {
    let few = Limits { iterations: task.effort.steps, ..task.effort.limits };
    for set in sets {
        set.cost = minimise(solver, task, few, &mut set.model).1.cost;
    }
}
