//! Where two axes must not be together. Between two rests nobody knows how far each axis is when, so a move
//! may enter no keep-out with any pair of the positions that its axes pass.

use lobelia_protocol::{AXES, Axis, AxisParameters, Configuration, KEEP_OUTS, KeepOut, Refusal};

/// Positions that an axis passes: lowest and highest.
pub(crate) type Sweep = [i32; 2];

/// The smallest sweep that has both.
pub(crate) fn hull(a: Sweep, b: Sweep) -> Sweep {
    [a[0].min(b[0]), a[1].max(b[1])]
}

fn meet(a: Sweep, b: Sweep) -> bool {
    a[0] <= b[1] && b[0] <= a[1]
}

fn refusal(keep_out: &KeepOut) -> Refusal {
    Refusal::KeepOut { first: keep_out.first, second: keep_out.second }
}

/// Refuses what could bring two axes together where they must not be.
pub(crate) fn check(keep_outs: &[Option<KeepOut>; KEEP_OUTS], sweeps: &[Sweep; AXES]) -> Result<(), Refusal> {
    let entered = |keep_out: &&KeepOut| {
        meet(sweeps[keep_out.first.index()], keep_out.first_steps)
            && meet(sweeps[keep_out.second.index()], keep_out.second_steps)
    };
    keep_outs.iter().flatten().find(entered).map_or(Ok(()), |keep_out| Err(refusal(keep_out)))
}

/// Of the two axes of a keep-out the one that is homed before the other, with its interval, and the other. It
/// has to be one that can be homed wherever the other stands.
fn homed_before(axes: &[AxisParameters; AXES], keep_out: &KeepOut) -> (Axis, Sweep, Axis) {
    let order = |axis: Axis| axes[axis.index()].home_order;
    if order(keep_out.first) < order(keep_out.second) {
        (keep_out.first, keep_out.first_steps, keep_out.second)
    } else {
        (keep_out.second, keep_out.second_steps, keep_out.first)
    }
}

/// Refuses to home some axes while another, whose position may be `known`, is where they could meet it.
pub(crate) fn check_homing(
    configuration: &Configuration,
    homed: [bool; AXES],
    known: [bool; AXES],
    positions: [i32; AXES],
) -> Result<(), Refusal> {
    let in_the_way = |keep_out: &&KeepOut| {
        let (before, interval, after) = homed_before(&configuration.axes, keep_out);
        let k = before.index();
        homed[after.index()] && !homed[k] && (!known[k] || meet([positions[k]; 2], interval))
    };
    let first = configuration.keep_outs.iter().flatten().find(in_the_way);
    first.map_or(Ok(()), |keep_out| Err(refusal(keep_out)))
}

/// Whether a keep-out makes sense: of two axes that do not turn round and round, one of which is homed before
/// the other and then stands out of its way.
pub(crate) fn is_sensible(axes: &[AxisParameters; AXES], keep_out: &KeepOut) -> bool {
    let of = |axis: Axis| &axes[axis.index()];
    let (before, interval, _) = homed_before(axes, keep_out);
    let p = of(before);
    let home = [
        p.home_position.saturating_sub_unsigned(p.home_back_off),
        p.home_position.saturating_add_unsigned(p.home_back_off),
    ];
    keep_out.first != keep_out.second
        && keep_out.first_steps[0] <= keep_out.first_steps[1]
        && keep_out.second_steps[0] <= keep_out.second_steps[1]
        && of(keep_out.first).home_order != of(keep_out.second).home_order
        && of(keep_out.first).full_turn_steps == 0
        && of(keep_out.second).full_turn_steps == 0
        && !meet(home, interval)
}
