//! Checks of what shows only after a while: moves once parameters were saved, changes of target at full
//! speed, a long session.

use lobelia_protocol::{AXES, Answer, Axis, AxisParameters, Command, Outcome, Refusal};

use super::Script;
use super::bench::{Bench, Result, ensure, same};

/// A move may take so many times as long as it needs, and this more, s: settling, and what host and line add.
const SLOWER: f64 = 1.5;
const MORE_S: f64 = 1.0;
/// Rounds of a long session.
const ROUNDS: i32 = 100;

pub(super) const CHECKS: &[(&str, Script)] = &[
    ("moves after parameters were saved take no longer than before", saved),
    ("moves that get other targets at full speed end there, in time and without a fault", retarget_at_speed),
    ("a session of hundreds of requests ends where its moves went", long_session),
    ("some axes are homed alone and the others stay", home_axes),
];

/// How long an axis needs for a distance, take-up there and back included, s.
fn needed_s(p: &AxisParameters, distance: u32) -> f64 {
    let [v, a, j] = [p.max_speed, p.acceleration, p.jerk].map(f64::from);
    let take_up = f64::from(p.take_up_steps);
    // Two runs at most, each no longer than at the highest speed with whole ramps.
    (f64::from(distance) + 2.0 * take_up) / v + 2.0 * (v / a + (a / j).max((v / j).sqrt()))
}

/// Moves, and fails when that took much longer than it needs.
fn move_in_time(bench: &mut Bench, targets: [i32; AXES]) -> Result<()> {
    let before = bench.status()?;
    bench.move_to(targets)?;
    in_time(bench, before.uptime_us, before.positions, targets)
}

fn in_time(bench: &mut Bench, since_us: u64, from: [i32; AXES], to: [i32; AXES]) -> Result<()> {
    let took_s = bench.status()?.uptime_us.saturating_sub(since_us) as f64 / 1e6;
    let needs = |axis: Axis| {
        let p = &bench.configuration.axes[axis.index()];
        needed_s(p, to[axis.index()].abs_diff(from[axis.index()])) + f64::from(p.settle_ms) / 1e3
    };
    let needs_s = Axis::ALL.map(needs).into_iter().fold(0.0, f64::max);
    ensure(took_s <= SLOWER * needs_s + MORE_S, || {
        format!("a move that needs {needs_s:.2} s took {took_s:.2} s by the controller's clock")
    })
}

fn saved(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    bench.done(Command::Lamp { on: false, level: 0 })?;
    move_in_time(bench, bench.part_way(0.4))?;
    let outcome = bench.ask(Command::SaveParameters)?;
    let stored = [Outcome::Done(Answer::Nothing), Outcome::Refused(Refusal::NoStorage)];
    ensure(stored.contains(&outcome), || format!("saving came to {outcome:?}"))?;
    for part in [0.6, 0.3, 0.5] {
        move_in_time(bench, bench.part_way(part))?;
    }
    same("known axes", &[true; AXES], &bench.status()?.known)
}

fn retarget_at_speed(bench: &mut Bench) -> Result<()> {
    for (from, to, then) in [(0.0, 0.9, 1.0), (1.0, 0.1, 0.0), (0.0, 0.8, 0.1)] {
        bench.homed()?;
        bench.move_to(bench.part_way(from))?;
        let begun = bench.begin(Command::MoveTo(bench.part_way(to)))?;
        let (start, end) = (bench.part_way(from), bench.part_way(to));
        // A third of the way: well past the ramps of any long travel.
        let third =
            |at: [i32; AXES]| (0..AXES).all(|k| at[k].abs_diff(start[k]) >= end[k].abs_diff(start[k]) / 3);
        let under_way = bench.wait("a third of a move", |status| !status.busy || third(status.positions))?;
        let targets = bench.part_way(then);
        let answer = bench.done(Command::Retarget(targets))?;
        same("where it ended", &Answer::At(targets), &answer)?;
        // It may have to brake first, and come back.
        let far = |k: usize| {
            let brakes = i64::from(end[k]) - i64::from(under_way.positions[k]);
            (i64::from(under_way.positions[k]) + brakes).clamp(i32::MIN.into(), i32::MAX.into()) as i32
        };
        in_time(bench, under_way.uptime_us, std::array::from_fn(far), start)?;
        bench.outcome(&begun)?;
        let status = bench.status()?;
        ensure(status.faults.is_empty(), || format!("it raised {:?}", status.faults))?;
    }
    Ok(())
}

fn long_session(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    bench.open()?;
    let middle = bench.part_way(0.5);
    for round in 0..ROUNDS {
        let targets = middle.map(|steps| steps + (round * 37 % 101) - 50);
        bench.move_to(targets)?;
        bench.done(Command::Expose { duration_us: 1000, warm_lamp: false })?;
        same("positions in the status", &targets, &bench.status()?.positions)?;
    }
    let Answer::Checked(lost) = bench.done(Command::CheckIndex)? else {
        return ensure(false, || "a check wasn't answered by what was found".to_owned());
    };
    for axis in Axis::ALL {
        let (lost, most) = (lost[axis.index()], bench.configuration.axes[axis.index()].index_tolerance);
        ensure(lost.unsigned_abs() <= most.into(), || format!("{} has lost {lost} steps", axis.name()))?;
    }
    Ok(())
}

fn home_axes(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    bench.move_to(bench.part_way(0.1))?;
    let before = bench.status()?.positions;
    for axis in Axis::ALL {
        let mut axes = [false; AXES];
        axes[axis.index()] = true;
        let answer = bench.done(Command::HomeAxes { axes, approaches: 1 })?;
        let status = bench.status()?;
        same("the answer", &Answer::At(status.positions), &answer)?;
        same("known axes", &[true; AXES], &status.known)?;
        for other in Axis::ALL.into_iter().filter(|&other| other.index() > axis.index()) {
            same(other.name(), &before[other.index()], &status.positions[other.index()])?;
        }
    }
    let none = bench.ask(Command::HomeAxes { axes: [false; AXES], approaches: 1 })?;
    ensure(matches!(none, Outcome::Refused(Refusal::BadParameter { .. })), || {
        format!("no axes came to {none:?}")
    })
}
