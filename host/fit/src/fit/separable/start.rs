//! What is known of a fit ([`Known`], [`Found`]), starts from neighbours ([`follow`]), and the optimisation
//! of all starts ([`minimise`]).

use super::super::lm::{Descent, Limits};
use super::super::model::Model;
use super::choice;
use super::layout::{Family, MOST_LOBES};
use super::normal::Amplitudes;
use super::solver::Solver;
use super::task::Task;
use super::uncertainty;

/// A model and how well it does, for texels nearby to start from.
#[derive(Debug, Clone)]
pub struct Known {
    /// The shapes.
    pub model: Model,
    /// Cost a valid sample that the search came to with as many lobes, here or at the texel that it was
    /// handed on from.
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
    pub outcome: Descent,
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
    pub(super) fn better_of(solver: &mut Solver, task: Task, model: Model, other: Option<Model>) -> Self {
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
        let outcome = Descent { cost: at.cost, iterations: 0, converged: true };
        Self { model: known.model.clone(), at, outcome, left_out, known: Vec::new(), doubtful: false }
    }

    /// The model with its cost.
    pub(super) fn known(&self, solver: &Solver) -> Known {
        Known { model: self.model.clone(), level: level(solver, &self.at), cost: self.at.cost }
    }
}

/// Cost a valid sample.
pub(super) fn level(solver: &Solver, at: &Amplitudes) -> f64 {
    at.cost / solver.data.valid.max(1) as f64
}

/// A start from a neighbour has led to as good a fit as a search would if its cost is within this range of
/// what the search came to there. The cost of 600 samples with nothing but noise scatters by 6 %; a cost far
/// lower is that of another material, of which the neighbour's search tells nothing.
const AS_GOOD: std::ops::RangeInclusive<f64> = 0.8..=1.15;

/// Whether a neighbour's shapes as they are come so close to its own cost that no other start needs a look.
pub fn may_do(solver: &Solver, cost: f64, near: &Known) -> bool {
    cost <= AS_GOOD.end() * near.level * solver.data.valid as f64
}

/// Whether the samples tell every lobe of a neighbour's shapes, as they are, from noise.
pub fn is_told(solver: &mut Solver, task: Task, near: &Known) -> bool {
    let mut model = near.model.clone();
    solver.refer(&mut model);
    let at = solver.evaluate(task.family, task.diffuse, &model);
    let layout = solver.layout(task.family, task.diffuse, &model);
    uncertainty::told(solver, layout, &at).into_iter().all(|told| told)
}

/// The fit of a fixed number of lobes from shapes that were found nearby, and whether it is as good as a
/// search would find. It may not be where it is worse than there, or far better (then it is of another
/// material), above `floor`, the cost of a fit that it contains, or where an isotropic lobe of it only fits
/// noise, in which the neighbour's has no meaning here.
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

/// Optimises within the task's family. An anisotropic fit of lobes that are still isotropic first finds their
/// direction.
pub fn minimise(solver: &mut Solver, task: Task, limits: Limits, model: &mut Model) -> (Amplitudes, Descent) {
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

/// Gives isotropic lobes the direction β and the difference of Cx and Cy that one Gauss–Newton step over
/// symmetric C suggests: its entries h cos 2β and h sin 2β have no singularity at h = 0. Lobes vote for the
/// common axis by their information.
fn spread(solver: &mut Solver, diffuse: bool, model: &mut Model) {
    let at = solver.evaluate(Family::Split, diffuse, model);
    let layout = solver.layout(Family::Split, diffuse, model);
    let normal = super::normal::normal(&solver.gram, layout, &at);
    let Some(step) = super::solver::solve(&normal, layout, model, 1e-3) else { return };
    let (mut cos, mut sin) = (0.0, 0.0);
    for lobe in 0..model.lobes.len() {
        let entry = |column| Family::Split.unknown(lobe, column, layout.lobes);
        let (a, b) = (step[entry(2)], step[entry(3)]);
        let diagonal = |i: usize| normal.matrix[i * normal.size + i];
        let information = diagonal(entry(2)) + diagonal(entry(3));
        cos += information * (a * a - b * b);
        sin += information * 2.0 * a * b;
    }
    let double = 0.5 * sin.atan2(cos);
    for (index, lobe) in model.lobes.iter_mut().enumerate().take(MOST_LOBES) {
        let entry = |column| step[Family::Split.unknown(index, column, layout.lobes)];
        let spread = entry(2) * double.cos() + entry(3) * double.sin();
        let spread = spread.clamp(-0.3, 0.3);
        lobe.c = (lobe.c + glam::DVec3::new(spread, -spread, 0.0)).normalize();
    }
    model.beta = 0.5 * double;
}
