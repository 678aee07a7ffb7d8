//! Checks of homing and moves.

use std::time::Duration;

use lobelia_protocol::{
    AXES, Answer, Axis, Command, Fault, HomeDirection, KeepOut, Outcome, Refusal, Status,
};

use super::Script;
use super::bench::{Bench, LOOK, Result, Trouble, ensure, same};

/// The lease of its check, ms.
const LEASE_MS: u32 = 2000;
/// How long an axis takes over its whole travel in that check, s.
const SLOW_S: u32 = 20;
/// Clock and ramps may make a move this much shorter than its length at the highest speed, as a part.
const FASTER: f64 = 0.02;

pub(super) const CHECKS: &[(&str, Script)] = &[
    ("homing makes all positions known", home),
    ("repeated homing tells how the switches scatter", home_repeatedly),
    ("homing no times is refused", home_no_times),
    ("moves end exactly at the upper and the lower limits", limits),
    ("moves go exactly through zero and back", through_zero),
    ("one axis moves and the others stay", one_axis),
    ("a move to where the axes are is done at once", nowhere),
    ("a move takes at least its length at the highest speed", speed),
    ("moves beyond a limit are refused with the axis, and move nothing", beyond),
    ("a status during a move tells that it moves", moving),
    ("another move during a move waits for it and is then made", queue),
    ("a stop refuses what waits behind a move", stop_waiting),
    ("a stop ends a move on its way, with positions known", stop),
    ("a move goes on to another target on its way", retarget),
    ("a new session ends the move of the one before", takeover),
    ("a host that falls silent ends its move by the lease, with positions known", lease),
    ("an index check finds no lost steps", check_index),
    ("a target in a keep-out is refused with both axes, and moves nothing", keep_out),
];

fn home(bench: &mut Bench) -> Result<()> {
    bench.settle()?;
    let answer = bench.done(Command::Home)?;
    let status = bench.status()?;
    same("known axes", &[true; AXES], &status.known)?;
    same("the answer", &Answer::At(status.positions), &answer)?;
    at_rest(&status)
}

fn at_rest(status: &Status) -> Result<()> {
    ensure(!status.busy && status.moving == [false; AXES], || {
        format!("after the answer it's still busy ({}) or moving ({:?})", status.busy, status.moving)
    })
}

fn home_repeatedly(bench: &mut Bench) -> Result<()> {
    bench.settle()?;
    match bench.done(Command::HomeRepeatedly { approaches: 3 })? {
        Answer::Homed(report) if report.approaches == 3 => {
            same("positions", &bench.status()?.positions, &report.positions)
        }
        other => Err(Trouble::Wrong(format!("it was answered by {other:?}"))),
    }
}

fn home_no_times(bench: &mut Bench) -> Result<()> {
    bench.settle()?;
    let outcome = bench.ask(Command::HomeRepeatedly { approaches: 0 })?;
    ensure(matches!(outcome, Outcome::Refused(Refusal::BadParameter { .. })), || {
        format!("it came to {outcome:?}")
    })
}

fn limits(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    for part in [1.0, 0.0] {
        let targets = bench.part_way(part);
        bench.move_to(targets)?;
        let status = bench.status()?;
        same("positions in the status", &targets, &status.positions)?;
        at_rest(&status)?;
    }
    Ok(())
}

fn through_zero(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    let axes = bench.configuration.axes;
    for around in [-1, 1, -1, 0] {
        bench.move_to(axes.map(|axis| {
            let reach = (axis.max_steps / 8).max(1);
            (around * reach).clamp(axis.min_steps, axis.max_steps)
        }))?;
    }
    Ok(())
}

fn one_axis(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    let mut targets = bench.part_way(0.4);
    bench.move_to(targets)?;
    for axis in Axis::ALL {
        targets[axis.index()] += 101;
        bench.move_to(targets)?;
        same("positions in the status", &targets, &bench.status()?.positions)?;
    }
    Ok(())
}

fn nowhere(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    bench.move_to(bench.part_way(0.5))?;
    let before = bench.status()?;
    bench.move_to(bench.part_way(0.5))?;
    same("positions", &before.positions, &bench.status()?.positions)
}

fn speed(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    bench.move_to(bench.part_way(0.45))?;
    let before = bench.status()?;
    let targets = bench.part_way(0.55);
    bench.move_to(targets)?;
    let took_s = (bench.status()?.uptime_us.saturating_sub(before.uptime_us)) as f64 / 1e6;
    for axis in Axis::ALL {
        let k = axis.index();
        let length = f64::from(targets[k].abs_diff(before.positions[k]));
        let least_s = length / f64::from(bench.configuration.axes[k].max_speed) * (1.0 - FASTER);
        ensure(took_s >= least_s, || {
            format!(
                "{} needs {least_s:.3} s for {length} steps, the move took {took_s:.3} s by the controller's \
                 clock",
                axis.name()
            )
        })?;
    }
    Ok(())
}

fn beyond(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    bench.move_to(bench.part_way(0.5))?;
    let before = bench.status()?.positions;
    for axis in Axis::ALL {
        let limits = bench.configuration.axes[axis.index()];
        for target in [limits.min_steps - 1, limits.max_steps + 1, i32::MIN, i32::MAX] {
            let mut targets = before;
            targets[axis.index()] = target;
            bench.refused(Command::MoveTo(targets), Refusal::OutOfLimits(axis))?;
        }
    }
    same("positions", &before, &bench.status()?.positions)
}

fn moving(bench: &mut Bench) -> Result<()> {
    let (request, status) = bench.under_way()?;
    ensure(status.busy, || "it says that it isn't busy".to_owned())?;
    ensure(status.moving.contains(&true), || "it says that no axis moves".to_owned())?;
    let outcome = bench.outcome(&request)?;
    same("the move's outcome", &Outcome::Done(Answer::At(bench.part_way(1.0))), &outcome)
}

fn queue(bench: &mut Bench) -> Result<()> {
    let (first, _) = bench.under_way()?;
    let second = bench.begin(Command::MoveTo(bench.part_way(0.9)))?;
    let waiting = bench.status()?;
    same("how many wait", &1, &waiting.waiting)?;
    let outcome = bench.outcome(&first)?;
    same("the first move's outcome", &Outcome::Done(Answer::At(bench.part_way(1.0))), &outcome)?;
    let outcome = bench.outcome(&second)?;
    same("the second move's outcome", &Outcome::Done(Answer::At(bench.part_way(0.9))), &outcome)
}

fn stop_waiting(bench: &mut Bench) -> Result<()> {
    let (first, _) = bench.under_way()?;
    let waiting = bench.begin(Command::MoveTo(bench.part_way(0.0)))?;
    bench.done(Command::Stop)?;
    for request in [&first, &waiting] {
        same("its outcome", &Outcome::Refused(Refusal::Stopped), &bench.outcome(request)?)?;
    }
    let status = bench.wait("at rest after a stop", |status| !status.busy)?;
    bench.pause(20 * LOOK)?;
    same("positions a while later", &status.positions, &bench.status()?.positions)
}

fn stop(bench: &mut Bench) -> Result<()> {
    let (request, _) = bench.under_way()?;
    same("the stop's answer", &Answer::Nothing, &bench.done(Command::Stop)?)?;
    let outcome = bench.outcome(&request)?;
    same("the move's outcome", &Outcome::Refused(Refusal::Stopped), &outcome)?;
    let status = bench.wait("at rest after a stop", |status| !status.busy)?;
    at_rest(&status)?;
    same("known axes", &[true; AXES], &status.known)?;
    let targets = bench.part_way(1.0);
    ensure(status.positions != targets, || "it went on to the target".to_owned())?;
    bench.pause(20 * LOOK)?;
    same("positions a while later", &status.positions, &bench.status()?.positions)
}

fn retarget(bench: &mut Bench) -> Result<()> {
    let (request, _) = bench.under_way()?;
    let targets = bench.part_way(0.3);
    let answer = bench.done(Command::Retarget(targets))?;
    same("where it ended", &Answer::At(targets), &answer)?;
    let outcome = bench.outcome(&request)?;
    same("the first move's outcome", &Outcome::Refused(Refusal::Stopped), &outcome)
}

fn takeover(bench: &mut Bench) -> Result<()> {
    bench.under_way()?;
    let old = bench.session;
    bench.open()?;
    ensure(bench.session != old, || "no new session".to_owned())?;
    let status = bench.wait("at rest in the new session", |status| !status.busy)?;
    same("known axes", &[true; AXES], &status.known)?;
    ensure(status.positions != bench.part_way(1.0), || "it went on to the target".to_owned())
}

fn lease(bench: &mut Bench) -> Result<()> {
    bench.settle()?;
    let mut slow = bench.configuration;
    slow.settings.lease_ms = LEASE_MS;
    for axis in &mut slow.axes {
        // So slow that the move lasts much longer than the lease.
        axis.max_speed = axis.max_speed.min(axis.min_steps.abs_diff(axis.max_steps) / SLOW_S).max(1);
        axis.home_speed = axis.home_speed.min(axis.max_speed);
        axis.home_slow_speed = axis.home_slow_speed.min(axis.max_speed);
    }
    bench.configure(&slow)?;
    bench.done(Command::Home)?;
    bench.move_to(bench.part_way(0.0))?;
    let request = bench.begin(Command::MoveTo(bench.part_way(1.0)))?;
    bench.pause(2 * Duration::from_millis(LEASE_MS.into()))?;
    let status = bench.status()?;
    ensure(status.faults.contains(Fault::LeaseExpired), || {
        format!("after twice the lease of {LEASE_MS} ms in silence it tells the faults {:?}", status.faults)
    })?;
    same("known axes", &[true; AXES], &status.known)?;
    let status = bench.wait("at rest after the lease", |status| !status.busy)?;
    ensure(status.positions != bench.part_way(1.0), || "it went on to the target".to_owned())?;
    let outcome = bench.outcome(&request)?;
    let fault = [Fault::LeaseExpired].into_iter().collect();
    same("the move's outcome", &Outcome::Refused(Refusal::Faulted(fault)), &outcome)?;
    bench.refused(Command::MoveTo(bench.part_way(0.5)), Refusal::Faulted(fault))?;
    bench.settle().map(|_| ())
}

fn check_index(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    bench.move_to(bench.part_way(0.2))?;
    let Answer::Checked(lost) = bench.done(Command::CheckIndex)? else {
        return Err(Trouble::Wrong("it wasn't answered by what was found".to_owned()));
    };
    for axis in Axis::ALL {
        let (lost, most) = (lost[axis.index()], bench.configuration.axes[axis.index()].index_tolerance);
        ensure(lost.unsigned_abs() <= most.into(), || {
            format!("{} has lost {lost} steps since it was homed", axis.name())
        })?;
    }
    same("known axes", &[true; AXES], &bench.status()?.known)
}

/// Two axes whose far halves exclude each other.
fn keep_out(bench: &mut Bench) -> Result<()> {
    bench.settle()?;
    let configuration = bench.configuration;
    let straight = |axis: &Axis| configuration.axes[axis.index()].full_turn_steps == 0;
    let mut axes = Axis::ALL.into_iter().filter(straight);
    // Where all but one turn round and round there is nothing to keep apart.
    let (Some(first), Some(second)) = (axes.next(), axes.next_back()) else { return Ok(()) };
    let away = |axis: Axis| {
        let p = &configuration.axes[axis.index()];
        let middle = i32::midpoint(p.min_steps, p.max_steps);
        match p.home_direction {
            HomeDirection::Negative => [middle, p.max_steps],
            HomeDirection::Positive => [p.min_steps, middle],
        }
    };
    let mut other = configuration;
    other.keep_outs[0] =
        Some(KeepOut { first, first_steps: away(first), second, second_steps: away(second) });
    (other.axes[first.index()].home_order, other.axes[second.index()].home_order) = (0, 1);
    bench.configure(&other)?;
    bench.done(Command::Home)?;
    let mut near = bench.part_way(0.5);
    for axis in [first, second] {
        let p = &other.axes[axis.index()];
        let [from, to] = away(axis);
        // A quarter of the travel on the switch's side, and the far end.
        near[axis.index()] = if from > p.min_steps {
            p.min_steps + (from - p.min_steps) / 2
        } else {
            p.max_steps - (p.max_steps - to) / 2
        };
    }
    bench.move_to(near)?;
    let mut inside = near;
    for axis in [first, second] {
        let [from, to] = away(axis);
        inside[axis.index()] = i32::midpoint(from, to);
    }
    bench.refused(Command::MoveTo(inside), Refusal::KeepOut { first, second })?;
    same("positions", &near, &bench.status()?.positions)?;
    bench.configure(&configuration)
}
