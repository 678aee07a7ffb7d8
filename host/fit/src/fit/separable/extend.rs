//! From the plain fit of a texel to one with a normal of its own, lobes that sharpen, or a microfacet term
//! ([`extended`](super::extended)).
//!
//! Each starts from the plain fits with 1, 2, … lobes: what a single tilted lobe is, plain ones may have
//! taken two for. Where there is a choice, an extension stays only if it predicts left-out poses better than
//! what there was before ([`choice`]).

use glam::DVec2;

use super::super::coat::Coat;
use super::super::extensions::{Extensions, Microfacets};
use super::super::lm::Limits;
use super::super::model::Model;
use super::bank::Bank;
use super::choice;
use super::layout::Family;
use super::search::Search;
use super::solver::Solver;
use super::start::{self, Found, Known};
use super::task::{Effort, Task};

/// Widths from which a microfacet term is optimised.
const COAT_WIDTHS: [f64; 6] = [0.01, 0.03, 0.08, 0.2, 0.4, 0.8];
/// Standard errors by which an extension has to be better: there are several, each with starts of its own,
/// and with two errors for each one plain texel in a hundred would get something that it has not.
const ERRORS: f64 = 3.0;
/// Or the share of the sum of squares that it may leave: what few poses meet can never be so many standard
/// errors better.
const SHARE: f64 = 0.5;
/// Sets of a microfacet term alone that lobes are added to.
const COATS: usize = 2;

/// What was found for a texel: a model with the task that it belongs to, and the models with 1, 2, … lobes of
/// the task's own family and, where there is a choice of families, isotropic ones.
#[derive(Debug, Clone)]
pub struct Plain<'a> {
    /// Task of the family that was chosen.
    pub task: Task,
    /// The model.
    pub model: Model,
    /// The models that were compared.
    pub trail: [&'a [Known]; 2],
}

/// The fit with what `extensions` allow, `whole` being the task before a family was chosen. The solver has
/// begun with the texel's data.
pub fn extend(
    (solver, bank, search): (&mut Solver, &Bank, &mut Search),
    extensions: Extensions,
    whole: Task,
    plain: Plain<'_>,
) -> (Task, Model) {
    let mut taken = (plain.task, Found::of(solver, plain.task, plain.model));
    let mut trail = plain.trail.map(<[Known]>::to_vec);
    if extensions.microfacets != Microfacets::Never {
        let (coated, others) = coated(solver, bank, search, whole);
        let always = extensions.microfacets == Microfacets::Always || !whole.choose;
        if always || is_surely_better(&coated.1, &taken.1) {
            (taken, trail) = (coated, others);
        }
    }
    let (mut normals, mut sharpening) = (false, false);
    for (wanted, normal) in [(extensions.normals, true), (extensions.sharpening, false)] {
        if !wanted {
            continue;
        }
        let tried = (normals || normal, sharpening || !normal);
        let more = |model: &Model| {
            let mut model = model.clone();
            model.normal = (tried.0 && !model.lobes.is_empty()).then_some(DVec2::ZERO);
            for lobe in model.lobes.iter_mut().filter(|_| tried.1) {
                lobe.n_grazing = Some(lobe.n);
            }
            model
        };
        let Some(found) = best_extended(solver, whole, taken.0, &taken.1.model, &trail, more) else {
            continue;
        };
        if !whole.choose || is_surely_better(&found.1, &taken.1) {
            (taken, normals, sharpening) = (found, tried.0, tried.1);
        }
    }
    (taken.0, taken.1.model)
}

/// Whether an extended fit predicts left-out poses better than one without the extension.
fn is_surely_better(extended: &Found, plain: &Found) -> bool {
    let gains = || plain.left_out.iter().zip(&extended.left_out).map(|(plain, extended)| plain - extended);
    let (gain, error) = (gains().sum::<f64>(), gains().map(|gain| gain * gain).sum::<f64>().sqrt());
    gain > ERRORS * error || gain > (1.0 - SHARE) * plain.left_out.iter().sum::<f64>()
}

/// The best of the models that are extended by `more`: of the one that was taken, or where there is a choice
/// of those in the trail, the largest that is better than the one before it, by families.
fn best_extended(
    solver: &mut Solver,
    whole: Task,
    task: Task,
    model: &Model,
    trail: &[Vec<Known>; 2],
    more: impl Fn(&Model) -> Model,
) -> Option<(Task, Found)> {
    if !whole.choose {
        return Some((task, Found::of(solver, task, more(model))));
    }
    let mut chain = |family: Family, known: &[Known]| {
        let task = Task { family, ..whole };
        let mut best: Option<Found> = None;
        for known in known {
            let found = Found::of(solver, task, more(&known.model));
            if best.as_ref().is_some_and(|best| !choice::is_better(&found.left_out, &best.left_out)) {
                break;
            }
            best = Some(found);
        }
        best.map(|found| (task, found))
    };
    let own = chain(whole.family, &trail[0]);
    let isotropic = chain(Family::Isotropic, &trail[1]);
    match (own, isotropic) {
        (Some(own), Some(isotropic)) => {
            let better = choice::is_better(&own.1.left_out, &isotropic.1.left_out);
            Some(if better { own } else { isotropic })
        }
        (own, isotropic) => own.or(isotropic),
    }
}

/// The fit with a microfacet term, found first, and lobes beside it; and the models that were compared.
fn coated(
    solver: &mut Solver,
    bank: &Bank,
    search: &mut Search,
    whole: Task,
) -> ((Task, Found), [Vec<Known>; 2]) {
    let few = Limits { iterations: 8, ..whole.effort.limits };
    let mut bases: Vec<(f64, Model)> = (COAT_WIDTHS.iter())
        .map(|&alpha| {
            let mut model = Model { coat: Some(Coat { f0: 0.0, f90: 0.0, alpha }), ..Model::default() };
            let cost = start::minimise(solver, whole, few, &mut model).1.cost;
            (cost, model)
        })
        .collect();
    bases.sort_by(|a, b| a.0.total_cmp(&b.0));
    bases.dedup_by(|b, a| (b.0 - a.0).abs() <= 1e-5 * a.0);
    let bases: Vec<Model> = bases.into_iter().take(COATS).map(|(_, model)| model).collect();
    let task = Task { effort: Effort::thorough(whole.lobes), ..whole };
    if !whole.choose || whole.family != Family::Anisotropic {
        let found = search.best_from(solver, bank, task, &bases);
        let known = found.known.clone();
        return ((whole, found), [known, Vec::new()]);
    }
    let isotropic = Task { family: Family::Isotropic, ..task };
    let other = search.best_from(solver, bank, isotropic, &bases);
    let found = search.widened_from(solver, bank, task, &other.known, &bases[0]);
    let trail = [found.known.clone(), other.known.clone()];
    let better = choice::is_better(&found.left_out, &other.left_out);
    let taken = if better { (whole, found) } else { (Task { family: Family::Isotropic, ..whole }, other) };
    (taken, trail)
}
