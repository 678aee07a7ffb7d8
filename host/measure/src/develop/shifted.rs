//! What photographs have in common that are not of their pose: whose pose each shows, a run that is shifted
//! as a whole or by single photographs, a carrier that sits askew.

use super::registration::{Shown, Unregistered};
use super::seen::SeenPose;
use crate::rig::geometry::MotorAngles;
use crate::run::RunFolder;
use lobelia_base::error::{Error, Result};

/// Fewer photographs than this make no rule.
const LEAST: usize = 3;

/// Adds to every rejected pose whose photograph it shows, and says what they have in common.
///
/// # Errors
/// An input error for a run most of whose photographs are those of other poses by the same shift, or most of
/// whose poses are off alike: the few that seem right are so by chance.
pub fn explain<T>(
    run: &RunFolder,
    registrations: &mut [std::result::Result<T, Unregistered>],
) -> Result<Option<String>> {
    let elsewhere: Vec<(usize, SeenPose)> = registrations
        .iter()
        .enumerate()
        .filter_map(|(pose, found)| Some((pose, found.as_ref().err()?.elsewhere?)))
        .collect();
    let shows = |seen: &SeenPose, pose: usize| {
        pose < run.plan.poses.len() && seen.difference(&run.rig, &run.plan.angles(pose)).allowed
    };
    for (pose, seen) in &elsewhere {
        // The nearest in the plan, when several poses differ in the light alone.
        let theirs = (0..run.plan.poses.len()).filter(|&other| shows(seen, other));
        if let (Some(other), Err(unregistered)) =
            (theirs.min_by_key(|other| other.abs_diff(*pose)), &mut registrations[*pose])
        {
            unregistered.why += &format!("; they fit pose {other}, whose photograph it may be");
        }
    }
    let contradictory: Vec<Contradictory<'_>> = registrations
        .iter()
        .enumerate()
        .filter_map(|(pose, found)| Some((pose, found.as_ref().err()?.contradictory.as_slice())))
        .filter(|(_, shown)| !shown.is_empty())
        .collect();
    let of_poses = || shift(run, &elsewhere, shows).or_else(|| askew(run, &elsewhere));
    let of_poses = if elsewhere.len() < LEAST { None } else { of_poses() };
    let of_exposures = mixed(&contradictory, shows);
    let faults = of_poses.into_iter().chain(of_exposures);
    let Some(fault) = faults.reduce(|most, other| if other.poses > most.poses { other } else { most }) else {
        return Ok(None);
    };
    let registered = registrations.iter().filter(|found| found.is_ok()).count();
    if fault.poses > registered {
        return Err(Error::input(format!("{}: {}", run.path.display(), fault.sentence)));
    }
    Ok(Some(fault.sentence))
}

/// What some poses have in common.
struct CommonFault {
    poses: usize,
    sentence: String,
}

/// A shift by the same number of poses that more than half of the photographs have.
fn shift(
    run: &RunFolder,
    elsewhere: &[(usize, SeenPose)],
    shows: impl Fn(&SeenPose, usize) -> bool,
) -> Option<CommonFault> {
    let count = run.plan.poses.len() as isize;
    let by = |offset: isize| {
        let shifted = elsewhere.iter().filter(move |(pose, _)| *pose as isize + offset >= 0);
        shifted.filter(move |(pose, _)| (*pose as isize + offset) < count)
    };
    let matches = |offset: isize| {
        by(offset).filter(|(pose, seen)| shows(seen, (*pose as isize + offset) as usize)).count()
    };
    let offsets = (1..count).flat_map(|distance| [-distance, distance]);
    let counted = offsets.map(|offset| (offset, matches(offset)));
    // The nearest of those that match as many.
    let (offset, poses) = counted.reduce(|best, other| if other.1 > best.1 { other } else { best })?;
    if poses < LEAST || 2 * poses <= elsewhere.len() {
        return None;
    }
    let mut places = by(offset).filter(|(pose, seen)| shows(seen, (*pose as isize + offset) as usize));
    let first = places.next()?.0;
    let last = places.last().map_or(first, |(pose, _)| *pose);
    let distance = offset.unsigned_abs();
    let which = if offset < 0 { "before" } else { "after" };
    let poses_off =
        if distance == 1 { "the pose".to_string() } else { format!("the pose {distance} places") };
    let sentence = format!(
        "{poses} photographs, of poses {first} to {last}, show {poses_off} {which} theirs: from pose {first} \
         on the camera's photographs are shifted against the rig's poses, so photograph these poses again"
    );
    Some(CommonFault { poses, sentence })
}

/// A pose and what each of its exposures shows.
type Contradictory<'a> = (usize, &'a [Shown]);

/// Exposures of one pose that do not show the same, in several poses: those of a shift by fewer photographs
/// than a pose has show its own pose and a neighbour's.
fn mixed(
    contradictory: &[Contradictory<'_>],
    shows: impl Fn(&SeenPose, usize) -> bool,
) -> Option<CommonFault> {
    let poses = contradictory.len();
    if poses < LEAST {
        return None;
    }
    let of = |shown: &Shown, pose: Option<usize>| match (shown, pose) {
        (Shown::Elsewhere(seen), Some(pose)) => shows(seen, pose),
        _ => false,
    };
    let late = |(pose, shown): &Contradictory<'_>| match shown {
        [first, .., Shown::Own] => of(first, pose.checked_sub(1)),
        _ => false,
    };
    let early = |(pose, shown): &Contradictory<'_>| match shown {
        [Shown::Own, .., last] => of(last, pose.checked_add(1)),
        _ => false,
    };
    let places = |is: &dyn Fn(&Contradictory<'_>) -> bool| -> Vec<usize> {
        contradictory.iter().filter(|one| is(one)).map(|(pose, _)| *pose).collect()
    };
    let (late, early) = (places(&late), places(&early));
    let (shifted, which) = if late.len() >= early.len() {
        (late, "first show the pose before")
    } else {
        (early, "last show the pose after")
    };
    let sentence = match shifted.as_slice() {
        [first, .., last] if 2 * shifted.len() > poses && shifted.len() >= LEAST => format!(
            "of the photographs of {} poses, {first} to {last}, the {which} theirs and the others their own: \
             the camera's photographs are shifted by less than a pose against the rig's exposures, so \
             photograph these poses again",
            shifted.len()
        ),
        _ => format!(
            "the exposures of {poses} poses do not show the same: either photographs are in others' places, \
             or the camera did not expose for as long as the controller opened the shutter; look at \
             camera.exif in rig.toml and at the camera's exposure, and photograph these poses again"
        ),
    };
    Some(CommonFault { poses, sentence })
}

/// The same deviation of pan, tilt and roll in more than half of the photographs.
fn askew(run: &RunFolder, elsewhere: &[(usize, SeenPose)]) -> Option<CommonFault> {
    let angles = |pose: usize| run.plan.angles(pose);
    let off: Vec<[f64; 3]> =
        elsewhere.iter().map(|(pose, seen)| seen.difference(&run.rig, &angles(*pose)).axes).collect();
    let [pan, tilt, roll] = std::array::from_fn(|k| {
        let mut values: Vec<f64> = off.iter().map(|axes| axes[k]).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    });
    let corrected = |pose: usize| {
        let angles = angles(pose);
        MotorAngles { pan: angles.pan + pan, tilt: angles.tilt + tilt, roll: angles.roll + roll, ..angles }
    };
    let alike = |(pose, seen): &&(usize, SeenPose)| seen.difference(&run.rig, &corrected(*pose)).allowed;
    let poses = elsewhere.iter().filter(alike).count();
    if poses < LEAST || 2 * poses <= elsewhere.len() {
        return None;
    }
    let [pan, tilt, roll] = [pan, tilt, roll].map(f64::to_degrees);
    let sentence = format!(
        "the tags of {poses} poses show the sample off by about the same: pan {pan:+.1}°, tilt {tilt:+.1}°, \
         roll {roll:+.1}°; correct home_deg of these axes in rig.toml, or the way the carrier sits and the \
         tags' places"
    );
    Some(CommonFault { poses, sentence })
}
