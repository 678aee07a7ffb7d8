//! Replays a trace: sends its requests again, to the same or another controller, and compares what comes of
//! them.
//!
//! Two good controllers differ in when things happen, so times and what follows from them (a photodiode's
//! noise, positions of axes under way) are compared only on demand, as between simulated rigs.

use std::time::Duration;

use lobelia_protocol::{Answer, Axis, Command, Exposure, Outcome, Refusal, Status};

use crate::rig::RigClient;
use crate::rig::trace::{Entry, Exchange, Step};
use lobelia_base::error::Result;

/// Homing may end this far from where it ended before, in steps: switches scatter.
const HOMING_STEPS: u32 = 16;
/// Shutters may differ by this, µs.
const SHUTTER_US: u32 = 10;
/// The lamp's reading may differ by this part of the recorded one, and one count more.
const REFERENCE_PART: f64 = 0.05;

/// A step may come this much before or after the recorded one, counted from the first of its request, µs:
/// what a controller makes late puts off what follows.
const STEP_US: u32 = 1000;

/// What was otherwise than recorded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    /// Line of the trace, from 1.
    pub line: usize,
    /// What differs.
    pub what: String,
}

/// What a replay showed.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Replay {
    /// Requests sent.
    pub requests: u64,
    /// Steps compared, where the trace and the port tell them, and the largest difference of their times, µs.
    pub steps: u64,
    /// See [`Self::steps`].
    pub most_us: u32,
    /// What was otherwise than recorded, in order.
    pub differences: Vec<Difference>,
}

/// Sends the requests of a trace and compares; with `exact` everything, times too. Calls `advance` after each
/// entry.
///
/// # Errors
/// When the link fails or the user interrupts; differences are none.
pub fn run(
    client: &mut RigClient,
    trace: &[(usize, Entry)],
    exact: bool,
    advance: impl Fn(),
) -> Result<Replay> {
    let mut replay = Replay::default();
    let mut homing = false;
    client.look_at_steps();
    for (line, entry) in trace {
        match entry {
            Entry::Trace(_) => {}
            // Where a search ends depends on how the switch scatters.
            Entry::Steps(recorded) => {
                if let Some(now) = client.last_steps().filter(|_| !homing) {
                    replay.steps += now.len() as u64;
                    let differences = steps(recorded, now, &mut replay.most_us);
                    let differences = differences.into_iter().map(|what| Difference { line: *line, what });
                    replay.differences.extend(differences);
                }
            }
            Entry::PauseUs(us) => while client.listen(Duration::from_micros(*us))?.is_some() {},
            Entry::Exchange(exchange) => {
                replay.requests += 1;
                homing = is_homing(&exchange.command);
                let now = client.ask(exchange.command)?;
                let differences = differences(exchange, &now, exact);
                replay.differences.extend(differences.into_iter().map(|what| Difference {
                    line: *line,
                    what: format!("{}: {what}", command_name(&exchange.command)),
                }));
            }
        }
        advance();
    }
    Ok(replay)
}

/// What of an outcome is otherwise than recorded.
fn differences(recorded: &Exchange, now: &Outcome, exact: bool) -> Vec<String> {
    if recorded.outcome == *now {
        return Vec::new();
    }
    let whole = || vec![format!("recorded {:?}, now {now:?}", recorded.outcome)];
    if exact {
        return whole();
    }
    let (before, after) = match (&recorded.outcome, now) {
        (Outcome::Done(before), Outcome::Done(after)) => (before, after),
        (
            Outcome::Refused(Refusal::LampNotWarm { remaining_s: Some(_) }),
            Outcome::Refused(Refusal::LampNotWarm { remaining_s: Some(_) }),
        ) => return Vec::new(),
        _ => return whole(),
    };
    let homing = is_homing(&recorded.command);
    match (before, after) {
        (Answer::At(before), Answer::At(after)) if homing && near(before, after) => Vec::new(),
        (Answer::Homed(before), Answer::Homed(after))
            if before.approaches == after.approaches && near(&before.positions, &after.positions) =>
        {
            Vec::new()
        }
        (Answer::Checked(before), Answer::Checked(after)) if near(before, after) => Vec::new(),
        (Answer::Exposed(before), Answer::Exposed(after)) => exposure(before, after),
        (Answer::Status(before), Answer::Status(after)) => status(before, after),
        _ => whole(),
    }
}

fn is_homing(command: &Command) -> bool {
    matches!(
        command,
        Command::Home | Command::HomeRepeatedly { .. } | Command::HomeAxes { .. } | Command::CheckIndex
    )
}

/// What of each axis's steps is otherwise than recorded; `most_us` is raised to the largest difference of
/// times.
fn steps(recorded: &[Step], now: &[Step], most_us: &mut u32) -> Vec<String> {
    let mut differences = Vec::new();
    for axis in Axis::ALL {
        let of = |steps: &[Step]| -> Vec<Step> {
            steps.iter().filter(|step| step.axis == axis).copied().collect()
        };
        let (before, after) = (of(recorded), of(now));
        let up = |steps: &[Step]| steps.iter().map(|step| step.up).collect::<Vec<_>>();
        if up(&before) != up(&after) {
            let (was, is) = (before.len(), after.len());
            differences.push(format!("{}: recorded {was} steps, now {is}, or not the same way", axis.name()));
            continue;
        }
        let late = before.iter().zip(&after).map(|(before, after)| before.at_us.abs_diff(after.at_us)).max();
        *most_us = late.unwrap_or(0).max(*most_us);
        if let Some(late) = late.filter(|late| *late > STEP_US) {
            differences.push(format!("{}: steps come up to {late} µs earlier or later", axis.name()));
        }
    }
    differences
}

fn near(before: &[i32; 4], after: &[i32; 4]) -> bool {
    before.iter().zip(after).all(|(before, after)| before.abs_diff(*after) <= HOMING_STEPS)
}

fn exposure(before: &Exposure, after: &Exposure) -> Vec<String> {
    let mut differences = Vec::new();
    if before.open_us.abs_diff(after.open_us) > SHUTTER_US {
        differences.push(format!("recorded {} µs open, now {} µs", before.open_us, after.open_us));
    }
    let [was, is] = [before, after].map(|exposure| f64::from(exposure.reference_q8) / 256.0);
    if (was - is).abs() > REFERENCE_PART * was + 1.0 {
        differences.push(format!("recorded the lamp at {was:.1} counts, now {is:.1}"));
    }
    differences
}

fn status(before: &Status, after: &Status) -> Vec<String> {
    let mut differences = Vec::new();
    let mut note = |what: &str, before: &dyn std::fmt::Debug, after: &dyn std::fmt::Debug| {
        let (before, after) = (format!("{before:?}"), format!("{after:?}"));
        if before != after {
            differences.push(format!("{what} recorded {before}, now {after}"));
        }
    };
    note("known axes", &before.known, &after.known);
    note("configured", &before.configured, &after.configured);
    note("faults", &faults(before), &faults(after));
    note("emergency stop", &before.emergency_stop, &after.emergency_stop);
    note("lamp on", &before.lamp.on, &after.lamp.on);
    note("lamp level", &before.lamp.level, &after.lamp.level);
    if !before.busy && !after.busy {
        for axis in Axis::ALL {
            let k = axis.index();
            // Homing may have ended a few steps off.
            if before.known[k]
                && after.known[k]
                && before.positions[k].abs_diff(after.positions[k]) > HOMING_STEPS
            {
                note(axis.name(), &before.positions[k], &after.positions[k]);
            }
        }
    }
    differences
}

fn faults(status: &Status) -> Vec<lobelia_protocol::Fault> {
    status.faults.iter().collect()
}

/// The name of a request, for a line about it.
fn command_name(command: &Command) -> String {
    match command {
        Command::Configure(_) => "Configure".to_owned(),
        Command::PrepareAxis { axis, .. } => format!("PrepareAxis {}", axis.name()),
        other => format!("{other:?}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXPOSED: Exposure =
        Exposure { start_us: 5, open_us: 20_000, reference_q8: 256_000, readings: 20, flicker_ppm: 900 };

    fn compare(command: Command, recorded: Answer, now: Answer) -> usize {
        let recorded = Exchange { command, outcome: Outcome::Done(recorded) };
        differences(&recorded, &Outcome::Done(now), false).len()
    }

    #[test]
    fn exposures_may_differ_in_when_they_were_but_not_in_how_long() {
        let expose = Command::Expose { duration_us: 20_000, warm_lamp: true };
        let with = |now| compare(expose, Answer::Exposed(EXPOSED), Answer::Exposed(now));
        assert_eq!(with(Exposure { start_us: 99, flicker_ppm: 0, ..EXPOSED }), 0);
        assert_eq!(with(Exposure { open_us: 20_011, ..EXPOSED }), 1);
        assert_eq!(with(Exposure { reference_q8: 200_000, ..EXPOSED }), 1);
    }

    #[test]
    fn homing_may_end_a_few_steps_off_and_a_move_may_not() {
        let (there, near) = (Answer::At([5, 6, 7, 8]), Answer::At([5, 6, 9, 8]));
        assert_eq!(compare(Command::Home, there, near), 0);
        assert_eq!(compare(Command::MoveTo([5, 6, 7, 8]), there, near), 1);
        assert_eq!(compare(Command::Home, there, Answer::At([5, 6, 70, 8])), 1);
    }

    #[test]
    fn steps_are_compared_axis_by_axis_in_number_direction_and_time() {
        let step = |axis, up, at_us| Step { axis, up, at_us };
        let recorded = [step(Axis::Pan, true, 0), step(Axis::Roll, false, 50), step(Axis::Pan, true, 900)];
        let with = |now: &[Step]| {
            let mut most_us = 0;
            (steps(&recorded, now, &mut most_us).len(), most_us)
        };
        assert_eq!(with(&recorded), (0, 0));
        // Steps of two axes may change places.
        assert_eq!(with(&[step(Axis::Roll, false, 0), step(Axis::Pan, true, 7), recorded[2]]), (0, 50));
        assert_eq!(with(&recorded[..2]), (1, 0));
        assert_eq!(with(&[recorded[0], step(Axis::Roll, true, 50), recorded[2]]), (1, 0));
        assert_eq!(with(&[recorded[0], recorded[1], step(Axis::Pan, true, 1901)]), (1, 1001));
    }

    #[test]
    fn another_refusal_is_a_difference_and_other_seconds_of_warming_up_are_none() {
        let cold = |s| Outcome::Refused(Refusal::LampNotWarm { remaining_s: Some(s) });
        let recorded = Exchange { command: Command::Home, outcome: cold(100) };
        assert!(differences(&recorded, &cold(7), false).is_empty());
        assert_eq!(differences(&recorded, &cold(7), true).len(), 1);
        assert_eq!(differences(&recorded, &Outcome::Refused(Refusal::Busy), false).len(), 1);
    }
}
