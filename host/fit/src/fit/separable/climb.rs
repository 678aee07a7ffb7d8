//! One texel's search: from fits with fewer lobes to those with more, from isotropic ones to anisotropic
//! ones, each from its neighbours' where that is as good.
//!
//! Every fit contains those below it, so it starts from them as well: a texel never ends at a higher cost
//! than with fewer lobes or with isotropic ones, whatever its neighbours or the bank proposed. A neighbour's
//! minimum that is a wrong one is not carried on where a simpler fit does better.

use super::super::FitOptions;
use super::super::lm::Limits;
use super::super::model::Model;
use super::choice::Ascent;
use super::extend::{Plain, extend};
use super::layout::Family;
use super::start::{self, Found, Known};
use super::task::{Effort, Task};
use super::texel::Workspace;
use super::{choice, normal, solver, uncertainty};

/// What was found for channels that are fitted together: the models with 1, 2, … lobes of the task's own
/// family, and isotropic ones where that is another.
pub(super) type Trail = [Vec<Known>; 2];

/// Lobes are isotropic if, made anisotropic, they explain no more than this, times one more than their
/// number, of the noise's variance. Noise alone comes to that in one texel of fifty.
const NOISE_GAIN: f64 = 4.0;
/// A lobe more is not worth a try where the bank's best explains less than this, times the noise's variance:
/// the best of all shapes takes about 10 of it from noise alone.
const PROMISING: f64 = 16.0;
/// When a fit is good enough to tell whether it predicts left-out poses better.
const TO_JUDGE: Limits = Limits { iterations: 20, tolerance: 3e-5 };

impl Task {
    /// Of the fits of both families the one to keep, with its task: isotropic unless the other is better or
    /// does with fewer lobes.
    pub fn better_family(self, anisotropic: Found, isotropic: Found) -> (Self, Model) {
        let fewer = anisotropic.model.lobes.len() < isotropic.model.lobes.len();
        let better = choice::is_better(&anisotropic.left_out, &isotropic.left_out);
        let worse = choice::is_better(&isotropic.left_out, &anisotropic.left_out);
        if better || fewer && !worse {
            (Self { family: Family::Anisotropic, ..self }, anisotropic.model)
        } else {
            (Self { family: Family::Isotropic, ..self }, isotropic.model)
        }
    }
}

impl Workspace {
    /// The model that is found, with the task whose family it belongs to: where the number of lobes is a
    /// choice, so is isotropy.
    pub(super) fn search(&mut self, task: Task, near: &[&Trail]) -> (Task, Model, Trail) {
        let of = |family: usize| near.iter().map(|trail| &trail[family][..]).collect::<Vec<_>>();
        if task.family == Family::Isotropic {
            let found = self.ladder(task, &of(0), None);
            self.doubtful = found.doubtful;
            return (task, self.finished(task, found.model), [found.known, Vec::new()]);
        }
        let isotropic = Task { family: Family::Isotropic, ..task };
        let other = self.ladder(isotropic, &of(1), None);
        if task.choose && !self.may_be_anisotropic(task, &other) {
            self.doubtful = other.doubtful;
            return (isotropic, self.finished(isotropic, other.model), [Vec::new(), other.known]);
        }
        let found = self.ladder(task, &of(0), Some(&other.known));
        let trail = [found.known.clone(), other.known.clone()];
        self.doubtful = found.doubtful && other.doubtful;
        let (task, model) = if task.choose { task.better_family(found, other) } else { (task, found.model) };
        (task, self.finished(task, model), trail)
    }

    /// A model that was chosen, optimised to the end; those that it was compared with were not.
    fn finished(&mut self, task: Task, mut model: Model) -> Model {
        if task.choose {
            start::minimise(&mut self.solver, task, task.effort.limits, &mut model);
        }
        model
    }

    /// Whether lobes may be anisotropic beyond doubt: whether from any of the isotropic fits one step over
    /// symmetric C, two more unknowns a lobe, would lower the cost by more than noise allows.
    fn may_be_anisotropic(&mut self, task: Task, isotropic: &Found) -> bool {
        let solver = &mut self.solver;
        let most = isotropic.model.lobes.len().max(1);
        isotropic.known.iter().filter(|known| known.model.lobes.len() <= most).any(|known| {
            let at = solver.evaluate(Family::Split, task.diffuse, &known.model);
            let layout = solver.layout(Family::Split, task.diffuse, &known.model);
            let normal = normal::normal(&solver.gram, layout, &at);
            let Some(step) = solver::solve(&normal, layout, &known.model, 1e-6) else { return true };
            let gain = solver::predicted_gain(&normal, &step);
            gain > NOISE_GAIN * (1 + layout.lobes) as f64 * uncertainty::variance(solver, layout, &at)
        })
    }

    /// The fit with what the options allow beyond plain lobes; `whole` is the task before a family was
    /// chosen.
    pub(super) fn extended(
        &mut self,
        options: &FitOptions,
        whole: Task,
        plain: (Task, Model),
        trail: &Trail,
    ) -> (Task, Model) {
        if options.extensions.is_none() {
            return plain;
        }
        let Self { solver, bank, search, .. } = self;
        let plain = Plain { task: plain.0, model: plain.1, trail: trail.each_ref().map(Vec::as_slice) };
        extend((solver, bank, search), options.extensions, whole, plain)
    }

    /// The fits with 1, 2, … lobes of a family: up to the task's number, or, where that is a choice, to one
    /// that predicts left-out poses no better. `isotropic` are those of isotropic lobes where the family is
    /// another.
    fn ladder(&mut self, task: Task, near: &[&[Known]], isotropic: Option<&[Known]>) -> Found {
        let mut best = Found::of(&mut self.solver, Task { lobes: 0, ..task }, Model::default());
        let mut ascent = Ascent::default();
        let mut known: Vec<Known> = Vec::with_capacity(task.lobes);
        for lobes in 1..=task.lobes {
            let mut effort = if near.is_empty() { Effort::thorough(lobes) } else { Effort::texel(lobes) };
            if task.choose {
                effort.limits = TO_JUDGE;
            }
            let of_rung = Task { lobes, effort, ..task };
            let wide = isotropic.and_then(|known| known.get(lobes - 1));
            // Where isotropic lobes had no part in the choice, anisotropic ones have none.
            if task.choose && (isotropic.is_some() && wide.is_none() || self.is_noise(of_rung, known.last()))
            {
                break;
            }
            let rung = self.rung(of_rung, near, known.last(), wide);
            if task.choose {
                let found = Found::judged(&mut self.solver, task, &rung);
                known.push(rung);
                let close = choice::is_close(&found.left_out, &best.left_out);
                let (better, further) = ascent.step(&found.left_out, &best.left_out);
                if better {
                    best = Found { doubtful: close, ..found };
                } else {
                    best.doubtful |= close;
                }
                if !further {
                    break;
                }
            } else {
                best.model.clone_from(&rung.model);
                known.push(rung);
            }
        }
        Found { known, ..best }
    }

    /// Whether a fit leaves nothing that one lobe more could explain better than it explains noise.
    fn is_noise(&mut self, task: Task, below: Option<&Known>) -> bool {
        let Self { solver, bank, search, .. } = self;
        let Some(below) = below else { return false };
        let at = solver.evaluate(task.family, task.diffuse, &below.model);
        let layout = solver.layout(task.family, task.diffuse, &below.model);
        search.scores.promise(solver, bank, task, &below.model, &at)
            < PROMISING * uncertainty::variance(solver, layout, &at)
    }

    /// The fit with a number of lobes: from the neighbour whose shapes describe this texel best, or else from
    /// a search as well.
    fn rung(&mut self, task: Task, near: &[&[Known]], below: Option<&Known>, wide: Option<&Known>) -> Known {
        let Self { solver, bank, search, .. } = self;
        let mut start: Option<(f64, &Known)> = None;
        for known in near.iter().filter_map(|known| known.get(task.lobes - 1)) {
            let mut model = known.model.clone();
            solver.refer(&mut model);
            let cost = solver.evaluate(task.family, task.diffuse, &model).cost;
            if start.is_none_or(|(least, _)| cost < least) {
                start = Some((cost, known));
            }
            if start::may_do(solver, cost, known) {
                break;
            }
        }
        let floor = below.into_iter().chain(wide).map(|known| known.cost).fold(f64::INFINITY, f64::min);
        let fresh = start.is_none();
        // A neighbour's lobe that only fits noise here leads nowhere.
        let start = start.filter(|(_, near)| {
            task.choose || wide.is_some() || task.lobes > 2 || start::is_told(solver, task, near)
        });
        let followed = start.map(|(_, near)| start::follow(solver, task, near, floor, wide));
        match followed {
            // Of three lobes and more a neighbour's may be good, and others better.
            Some((found, true)) if task.lobes > 2 && !task.choose => {
                search.exchanged(solver, bank, task, found)
            }
            Some((found, true)) => found,
            followed => {
                search.rung(solver, bank, task, [below, wide], followed.map(|(found, _)| found), fresh)
            }
        }
    }
}
