//! What `lobelia fit` warns of, and what its report has of that.

use super::FitOutcome;
use crate::error::Result;
use crate::fit::{FitOptions, noted};
use crate::reflectance::SbrdfMap;
use crate::sampled::SampledStore;
use crate::warning::samples::{self, Step, Tally};
use crate::warning::{directions, residual, texels};

/// Warns of poses that are not known and of samples that are of no use.
pub(super) fn of_samples(outcome: &mut FitOutcome, store: &SampledStore, tally: Tally) {
    let weights: Vec<f64> = store.poses.iter().map(|pose| pose.weight).collect();
    let counts = tally.counts(&weights, store.clipped.as_deref());
    outcome.figures.insert(samples::BY_POSE.into(), samples::by_pose(&counts));
    outcome.warnings.extend(directions::unknown_poses(&store.unknown_poses));
    outcome.warnings.extend(samples::warnings(Step::Fit, &counts));
}

/// Warns of what makes a whole map less trustworthy than it looks.
///
/// # Errors
/// When a chunk of the store cannot be read.
pub(super) fn of_fit(
    outcome: &mut FitOutcome,
    store: &SampledStore,
    map: &SbrdfMap,
    options: &FitOptions,
) -> Result<()> {
    let seen = directions::of_poses(&store.poses);
    let few = directions::too_few(seen.len(), options).or_else(|| texels::few_samples(map, options));
    outcome.warnings.extend(few);
    outcome.warnings.extend(directions::shape(&seen, options.isotropic));
    of_texels(outcome, map);
    of_poses(outcome, store, map)
}

/// Warns of the poses and texels of a map that was joined of parts, as after one fit; samples are counted by the parts.
///
/// # Errors
/// When a chunk of the store cannot be read.
pub(super) fn of_joined(
    outcome: &mut FitOutcome,
    store: Option<&SampledStore>,
    map: &SbrdfMap,
) -> Result<()> {
    let options = noted::options(map);
    let options = options.as_ref();
    let few_samples = || options.and_then(|options| texels::few_samples(map, options));
    let Some(store) = store else {
        outcome.warnings.extend(few_samples());
        of_texels(outcome, map);
        return Ok(());
    };
    let seen = directions::of_poses(&store.poses);
    outcome.warnings.extend(directions::unknown_poses(&store.unknown_poses));
    let few = options.and_then(|options| directions::too_few(seen.len(), options)).or_else(few_samples);
    outcome.warnings.extend(few);
    let isotropic = options.is_some_and(|options| options.isotropic);
    outcome.warnings.extend(directions::shape(&seen, isotropic));
    of_texels(outcome, map);
    of_poses(outcome, store, map)
}

/// Warns of texels with a residual that their noise does not explain.
pub(super) fn of_texels(outcome: &mut FitOutcome, map: &SbrdfMap) {
    if let Some(flags) = texels::unexplained(map) {
        let count = flags.iter().filter(|&&flag| flag).count();
        outcome.figures.insert("texels_unexplained".into(), count.into());
    }
    outcome.warnings.extend(texels::unexplained_warning(map));
}

/// Warns of poses with a residual that stands out.
///
/// # Errors
/// When a chunk of the store cannot be read.
fn of_poses(outcome: &mut FitOutcome, store: &SampledStore, map: &SbrdfMap) -> Result<()> {
    let residuals = residual::look(store, map)?;
    let rounded = |times: &Option<f64>| times.map(|times| (1e3 * times).round() / 1e3);
    let times: Vec<Option<f64>> = residuals.times.iter().map(rounded).collect();
    outcome.figures.insert("residual_by_pose".into(), times.into());
    outcome.warnings.extend(residuals.warning());
    Ok(())
}
