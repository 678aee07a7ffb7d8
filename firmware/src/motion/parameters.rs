//! Which parameters are allowed. What passes here can't overflow a position, outrun a step pulse, or ask for
//! more steps than the board makes.

use lobelia_protocol::{
    Axis, AxisParameters, Configuration, Field, HomeDirection, LAMP_LONGEST_S, Pins, Refusal,
};

use crate::motion::keep_out;

/// Highest speed, steps/s: a step every 5 µs.
const MAX_SPEED: u32 = 200_000;
/// Longest pulse, µs.
const MAX_PULSE_US: u8 = 100;
/// What making a step takes besides its pulse, µs.
const MAKING_US: u32 = 1;
/// Highest acceleration, steps/s².
const MAX_ACCELERATION: u32 = 10_000_000;
/// Highest jerk, steps/s³.
const MAX_JERK: u32 = 1_000_000_000;
/// Longest time to reach the highest speed, s: step times keep their precision up to here.
const MAX_RAMP_S: u32 = 1000;
/// Farthest position from 0, in steps.
const FARTHEST: i32 = 1 << 29;
/// Longest take-up, in steps.
const MAX_TAKE_UP: u32 = 1 << 20;

/// Checks a configuration, for a board that makes at most so many steps a second.
pub(crate) fn validate(configuration: &Configuration, most_steps_per_s: Option<u32>) -> Result<(), Refusal> {
    let Configuration { axes, settings, keep_outs } = configuration;
    Axis::ALL.into_iter().zip(axes).try_for_each(|(axis, p)| validate_axis(axis, p))?;
    let bad = |axis, field| Err(Refusal::BadParameter { axis, field });
    if !(1..=MAX_PULSE_US).contains(&settings.pulse_us) {
        return bad(None, Field::Pulse);
    }
    if !settings.inverted.are_among(Pins::OF_RIG) {
        return bad(None, Field::Wiring);
    }
    if !LAMP_LONGEST_S.contains(&settings.lamp_longest_s) {
        return bad(None, Field::LampTime);
    }
    // High and low, each one count of the clock more than asked for.
    let step_us = 2 * (u32::from(settings.pulse_us) + 1) + MAKING_US;
    if let Some(axis) = Axis::ALL.into_iter().find(|axis| axes[axis.index()].max_speed > 1_000_000 / step_us)
    {
        return bad(Some(axis), Field::Pulse);
    }
    let sum: u32 = axes.iter().map(|p| p.max_speed).sum();
    if most_steps_per_s.is_some_and(|most| sum > most) {
        return bad(None, Field::StepRate);
    }
    if let Some(bad) = keep_outs.iter().flatten().find(|keep_out| !keep_out::is_sensible(axes, keep_out)) {
        return Err(Refusal::BadParameter { axis: Some(bad.first), field: Field::KeepOut });
    }
    Ok(())
}

/// Checks one axis's parameters.
pub(crate) fn validate_axis(axis: Axis, parameters: &AxisParameters) -> Result<(), Refusal> {
    let bad = |field| Refusal::BadParameter { axis: Some(axis), field };
    bad_field(parameters).map_or(Ok(()), |field| Err(bad(field)))
}

fn bad_field(p: &AxisParameters) -> Option<Field> {
    let range = -FARTHEST..=FARTHEST;
    let speeds = 1..=p.max_speed;
    let checks = [
        (
            range.contains(&p.min_steps) && range.contains(&p.max_steps) && p.min_steps < p.max_steps,
            Field::Limits,
        ),
        ((1..=MAX_SPEED).contains(&p.max_speed), Field::MaxSpeed),
        (
            (1..=MAX_ACCELERATION).contains(&p.acceleration) && p.max_speed / MAX_RAMP_S <= p.acceleration,
            Field::Acceleration,
        ),
        ((1..=MAX_JERK).contains(&p.jerk), Field::Jerk),
        (p.take_up_steps <= MAX_TAKE_UP, Field::TakeUp),
        (p.full_turn_steps == 0 || turn_holds_limits(p), Field::FullTurn),
        (range.contains(&p.home_position) && switch_is_beyond_limits(p), Field::HomePosition),
        (speeds.contains(&p.home_speed) && speeds.contains(&p.home_slow_speed), Field::HomeSpeed),
        (
            p.home_travel <= FARTHEST as u32
                && p.home_back_off <= p.home_travel
                && (1..=FARTHEST as u32).contains(&p.home_switch_steps),
            Field::HomeTravel,
        ),
        (p.inverted.are_among(Pins::OF_AXIS), Field::Wiring),
    ];
    checks.into_iter().find_map(|(good, field)| (!good).then_some(field))
}

/// Every position within the limits stands for one angle, and a take-up is shorter than half a turn.
fn turn_holds_limits(p: &AxisParameters) -> bool {
    (p.max_steps.abs_diff(p.min_steps)..=FARTHEST as u32).contains(&p.full_turn_steps)
        && p.take_up_steps < p.full_turn_steps / 2
}

/// On an axis that turns round and round the switch is an index that moves do pass. On any other, a move
/// within the limits, take-up included, must not reach the switch.
fn switch_is_beyond_limits(p: &AxisParameters) -> bool {
    if p.full_turn_steps != 0 {
        return true;
    }
    match p.home_direction {
        HomeDirection::Negative => p.home_position < p.min_steps.saturating_sub_unsigned(p.take_up_steps),
        HomeDirection::Positive => p.home_position > p.max_steps,
    }
}
