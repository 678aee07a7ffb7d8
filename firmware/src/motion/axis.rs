//! One axis: step pulses on its pins, and moves that end with an approach in the positive direction.
//!
//! Gears have play. The position that a motor step count stands for is the same each time only if the same flank pushes at the end,
//! so a move that would end downward, or follow a motion that did, first goes `take_up` steps below its target.

use crate::board::{AxisPins, Board, PinFailure, is_high, set};
use crate::motion::profile::{Limits, Times};
use crate::motion::stepper::{Due, Stepper};
use lobelia_protocol::AxisParameters;

/// Shortest time that the step pin stays high, and low, in µs.
pub(crate) const PULSE_US: u64 = 2;

/// What a parameter set allows in moves.
fn limits(p: &AxisParameters) -> Limits {
    Limits { speed: p.max_speed, acceleration: p.acceleration, jerk: p.jerk }
}

/// A move planned and not begun: a run, and the approach after it where one is needed.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plan {
    first: (i32, Times),
    approach: Option<(i32, Times)>,
    limits: Limits,
}

impl Plan {
    /// How long it takes, in ticks; 0 when there is nothing to move.
    pub(crate) fn total(&self) -> u64 {
        self.first.1.total() + self.approach.map_or(0, |(_, times)| times.total())
    }

    /// The same move in `total` ticks, not fewer than it takes.
    pub(crate) fn stretched(&self, total: u64) -> Self {
        let own = self.total();
        if own == 0 {
            return *self;
        }
        let Some((target, times)) = self.approach else {
            return Self { first: (self.first.0, self.first.1.stretched(total)), ..*self };
        };
        let share = (u128::from(times.total()) * u128::from(total) / u128::from(own)) as u64;
        let share = share.max(times.total());
        Self {
            first: (self.first.0, self.first.1.stretched(total - share)),
            approach: Some((target, times.stretched(share))),
            ..*self
        }
    }
}

/// An axis's pins and where it is.
pub(crate) struct AxisDrive<B: Board> {
    pins: AxisPins<B>,
    stepper: Stepper,
    /// The approach that follows the present run.
    approach: Option<(i32, Times)>,
    /// Where to go on to, in the same direction, after braking short of it.
    onward: Option<i32>,
    limits: Limits,
    /// What the present position is called once the move has ended: a turn more or less on a full-turn axis.
    renamed: Option<i32>,
    /// Whether the last motion ended upward with the play taken up.
    taken_up: bool,
    /// Whether the present one will.
    ends_taken_up: bool,
    pulse_high: bool,
    pulse_since_us: u64,
    /// Whether the position means anything.
    pub(crate) known: bool,
}

impl<B: Board> AxisDrive<B> {
    pub(crate) fn new(pins: AxisPins<B>) -> Self {
        Self {
            pins,
            stepper: Stepper::default(),
            approach: None,
            onward: None,
            limits: Limits::default(),
            renamed: None,
            taken_up: false,
            ends_taken_up: false,
            pulse_high: false,
            pulse_since_us: 0,
            known: false,
        }
    }

    pub(crate) fn position(&self) -> i32 {
        self.stepper.position()
    }

    /// Whether the run goes toward higher steps.
    pub(crate) fn forward(&self) -> bool {
        self.stepper.forward()
    }

    /// Whether the axis is under way.
    pub(crate) fn moving(&self) -> bool {
        self.stepper.running() || self.approach.is_some() || self.pulse_high
    }

    /// Whether the home switch is closed.
    pub(crate) fn at_switch(&mut self) -> Result<bool, PinFailure> {
        is_high(&mut self.pins.home)
    }

    /// When this axis next has to be polled, in µs.
    pub(crate) fn next_us(&self) -> u64 {
        let pulse_end = self.pulse_since_us + PULSE_US;
        if self.pulse_high {
            pulse_end
        } else if self.stepper.running() {
            self.stepper.due_us().max(pulse_end)
        } else {
            u64::MAX
        }
    }

    /// Plans a move from rest. On a full-turn axis it goes the shorter way.
    pub(crate) fn plan(&self, target: i32, p: &AxisParameters) -> Plan {
        let position = self.position();
        let target = nearest_turn(position, target, p.full_turn_steps);
        let below = target.saturating_sub_unsigned(p.take_up_steps);
        let limits = limits(p);
        let times = |from: i32, to: i32| Times::shortest(to.abs_diff(from), limits);
        if self.taken_up && target == position {
            return Plan { first: (target, Times::default()), approach: None, limits };
        }
        if target < position || (!self.taken_up && below < position) {
            let approach = Some((target, times(below, target)));
            return Plan { first: (below, times(position, below)), approach, limits };
        }
        Plan { first: (target, times(position, target)), approach: None, limits }
    }

    /// Begins a planned move, at whose end the position is called `target`.
    pub(crate) fn begin(&mut self, now_us: u64, plan: &Plan, target: i32) -> Result<(), PinFailure> {
        self.taken_up = false;
        self.ends_taken_up = true;
        self.approach = plan.approach;
        self.limits = plan.limits;
        self.renamed = Some(target);
        let (first, times) = plan.first;
        self.start(now_us, first, times)
    }

    /// Changes the target of the move under way without braking; false, and nothing changed, where it can't be.
    pub(crate) fn redirect(&mut self, now_us: u64, target: i32, p: &AxisParameters) -> bool {
        let turned = nearest_turn(self.position(), target, p.full_turn_steps);
        // Only on a single upward run: then the play is taken up at the new target as it would be at the old one.
        let upward = self.stepper.forward() && self.approach.is_none() && self.ends_taken_up;
        let room = turned.saturating_sub_unsigned(p.take_up_steps) >= self.position();
        let redirected = upward && room && self.stepper.redirect(now_us, turned);
        if redirected {
            self.renamed = Some(target);
        }
        redirected
    }

    /// Starts a single run without take-up, as homing needs.
    pub(crate) fn run(
        &mut self,
        now_us: u64,
        target: i32,
        speed: u32,
        p: &AxisParameters,
    ) -> Result<(), PinFailure> {
        self.taken_up = false;
        self.ends_taken_up = false;
        self.renamed = None;
        self.limits = Limits { speed, ..limits(p) };
        let times = Times::shortest(target.abs_diff(self.position()), self.limits);
        self.start(now_us, target, times)
    }

    fn start(&mut self, now_us: u64, target: i32, times: Times) -> Result<(), PinFailure> {
        set(&mut self.pins.enable, true)?;
        let upward = target > self.position();
        set(&mut self.pins.direction, upward)?;
        self.stepper.start(now_us, target, self.limits, times);
        Ok(())
    }

    /// Ends the present run after `distance` more steps, or as soon as the ramp allows: with a halt on the way if it is still
    /// speeding up.
    pub(crate) fn shorten(&mut self, now_us: u64, distance: u32) {
        let position = self.position();
        let target = if self.forward() {
            position.saturating_add_unsigned(distance)
        } else {
            position.saturating_sub_unsigned(distance)
        };
        if !self.stepper.redirect(now_us, target) {
            self.stepper.brake(now_us);
            self.onward = Some(target);
        }
    }

    /// Comes to rest by the ramp and forgets the rest of the move.
    pub(crate) fn stop(&mut self, now_us: u64) {
        self.approach = None;
        self.onward = None;
        self.ends_taken_up = false;
        self.renamed = None;
        self.stepper.brake(now_us);
    }

    /// Ceases at once, releases the motor and forgets the position.
    pub(crate) fn cut(&mut self) -> Result<(), PinFailure> {
        self.stepper.halt();
        self.approach = None;
        self.onward = None;
        self.renamed = None;
        self.taken_up = false;
        self.ends_taken_up = false;
        self.known = false;
        self.pulse_high = false;
        let step = set(&mut self.pins.step, false);
        set(&mut self.pins.enable, false).and(step)
    }

    /// Takes the present position for `position`, reached upward with the play taken up.
    pub(crate) fn homed(&mut self, position: i32) {
        self.stepper.set_position(position);
        self.known = true;
        self.taken_up = true;
    }

    /// Forgets the position, to count from 0.
    pub(crate) fn forget(&mut self) {
        self.stepper.set_position(0);
        self.known = false;
        self.taken_up = false;
    }

    /// Does what is due; gives whether a step was made.
    pub(crate) fn poll(&mut self, now_us: u64) -> Result<bool, PinFailure> {
        if now_us < self.next_us() {
            return Ok(false);
        }
        if self.pulse_high {
            self.pulse_high = false;
            self.pulse_since_us = now_us;
            set(&mut self.pins.step, false)?;
            return Ok(false);
        }
        if self.stepper.due() == Due::End {
            self.end_run(now_us)?;
            return Ok(false);
        }
        self.pulse_since_us = now_us;
        set(&mut self.pins.step, true)?;
        self.pulse_high = true;
        self.stepper.stepped(now_us);
        Ok(true)
    }

    /// At the end of a run: begins the approach, or notes that the move is done.
    fn end_run(&mut self, now_us: u64) -> Result<(), PinFailure> {
        self.stepper.ended();
        if let Some(target) = self.onward.take()
            && target != self.position()
            && (target > self.position()) == self.forward()
        {
            let times = Times::shortest(target.abs_diff(self.position()), self.limits);
            return self.start(now_us, target, times);
        }
        if let Some((target, times)) = self.approach.take() {
            return self.start(now_us, target, times);
        }
        self.taken_up = self.ends_taken_up;
        if let Some(name) = self.renamed.take() {
            self.stepper.set_position(name);
        }
        Ok(())
    }
}

/// Of all positions that stand for the target's angle, the one nearest to `position`.
fn nearest_turn(position: i32, target: i32, full_turn: u32) -> i32 {
    if full_turn == 0 {
        return target;
    }
    let turn = i64::from(full_turn);
    let ahead = (i64::from(target) - i64::from(position)).rem_euclid(turn);
    let way = if 2 * ahead > turn { ahead - turn } else { ahead };
    (i64::from(position) + way) as i32
}
