//! Lobes that exceed what was measured where no pose looked, and whose shape the samples do not tell.

use super::super::model::{EXPONENTS, Model};
use super::super::samples::MOST_OVER_SEEN;
use super::layout::Family;
use super::normal::Amplitudes;
use super::solver::{Solver, Tame, UNTOLD, WILD};
use super::uncertainty;

/// Limit of a lobe that is told from noise, but hardly its shape: what it makes of grazing directions may be
/// so much more than what was seen.
const VAGUE: f64 = 30.0;

/// Limits for the lobes of a model that was evaluated last of which the samples do not tell the shape and
/// which exceed them where no pose looked; none where no lobe does. Lobes that were `chosen` for what they
/// predict do not only fit noise.
pub(super) fn limits(
    solver: &Solver,
    task: (Family, bool),
    chosen: bool,
    model: &Model,
    at: &Amplitudes,
) -> Option<Tame> {
    let layout = solver.layout(task.0, task.1, model);
    let exceeds = |index: usize, limit: f64| {
        let growth = MOST_OVER_SEEN * model.lobes[index].growth();
        (0..layout.channels)
            .any(|channel| at.x[channel][1 + index] * growth > limit * solver.data.most[channel])
    };
    let loud = |index: &usize| exceeds(*index, 1.0 + 1e-9);
    if !(0..model.lobes.len()).any(|index| loud(&index)) {
        return None;
    }
    let told = uncertainty::told(solver, layout, at);
    let sigma = uncertainty::sigma(solver, task.0, task.1, model, at);
    let mut limits = WILD;
    for index in (0..model.lobes.len()).filter(loud) {
        if !told[index] && !chosen {
            limits[index] = UNTOLD;
        } else if sigma.lobes[index].n >= EXPONENTS[1] && exceeds(index, VAGUE) {
            limits[index] = VAGUE;
        }
    }
    (limits != WILD).then_some(limits)
}
