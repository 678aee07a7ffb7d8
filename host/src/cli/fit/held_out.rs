//! `lobelia fit --hold-out-poses`: the error on poses that were not fitted, in the report and on the
//! terminal.

use super::{Findings, FitArgs};
use crate::error::Result;
use crate::fit::held_out::{HeldOut, HeldOutError};
use crate::progress::counted;
use crate::reflectance::SbrdfMap;
use crate::sampled::SampledStore;

/// Takes the weight from the poses that are held out, if any are.
///
/// # Errors
/// As [`HeldOut::choose`].
pub(super) fn hold_out(args: &FitArgs, store: &mut SampledStore, seed: u64) -> Result<Option<HeldOut>> {
    let isotropic = args.isotropic || args.separate_channels;
    let which = args.hold_out_poses.as_ref();
    which.map(|which| HeldOut::choose(&mut store.poses, which, isotropic, seed)).transpose()
}

/// Adds the errors of a map on held-out poses to what the command found, and says them in a line; empty
/// without such poses.
///
/// # Errors
/// When a chunk of the store cannot be read.
pub(super) fn judge(
    held: Option<&HeldOut>,
    store: &SampledStore,
    map: &SbrdfMap,
    outcome: &mut Findings,
) -> Result<String> {
    let Some(held) = held else { return Ok(String::new()) };
    let errors = held.errors(store, map)?;
    outcome.add_held_out(held, &errors);
    Ok(words(held, &errors))
}

/// The errors in a line, and in another those of near and far poses where there are both.
fn words(held: &HeldOut, [all, near, far]: &[HeldOutError; 3]) -> String {
    let of = |error: &HeldOutError| {
        let [p50, p95, p99, worst] =
            [error.p50, error.p95, error.p99, error.worst].map(|value| format!("{:.2} %", 100.0 * value));
        let [x, y] = error.worst_texel;
        format!("median {p50}, p95 {p95}, p99 {p99}, worst {worst} at texel ({x}, {y})")
    };
    let poses = |error: &HeldOutError| counted(error.poses as u64, "pose", "poses");
    if all.texels == 0 {
        return format!("held out: {}, at which no texel has a sample\n", poses(all));
    }
    let mut text = format!("held out: {}, relative error {}\n", poses(all), of(all));
    let groups = [(near, "at most"), (far, "more than")];
    for (error, how_far) in groups.into_iter().filter(|(error, _)| 0 < error.poses && error.poses < all.poses)
    {
        text += &format!(
            "held out, {how_far} {:.1}° from the nearest fitted pose: {}, {}\n",
            held.near.to_degrees(),
            poses(error),
            of(error)
        );
    }
    text
}
