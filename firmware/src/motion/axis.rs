//! One axis: step pulses on its pins, and moves that end with an approach in the positive direction.
//!
//! Gears have play. The position that a motor step count stands for is the same each time only if the same
//! flank pushes at the end, so a move that would end downward, or follow a motion that did, first goes
//! `take_up` steps below its target.

use lobelia_protocol::{AxisParameters, HomeDirection, Pin, Pins};

use crate::board::Board;
use crate::motion::changes::Changes;
use crate::motion::fixed::TICK_SHIFT;
use crate::motion::keep_out::{Sweep, hull};
use crate::motion::profile::{Limits, Times};
use crate::motion::pulses::{PulsesCell, Watch};
use crate::motion::stepper::Stepper;
use crate::pin::{Line, PinFailure, set};

/// Steps are handed over at least this long before they are due, in ticks: 6 ms.
const AHEAD: u64 = 6000 << TICK_SHIFT;
/// Bursts handed over at once.
const AT_ONCE: usize = 4;

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

    /// The positions that it passes from one on.
    pub(crate) fn sweep(&self, position: i32) -> Sweep {
        let to = |target: i32| [position.min(target), position.max(target)];
        let first = to(self.first.0);
        self.approach.map_or(first, |(target, _)| hull(first, to(target)))
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

/// Which way an axis may not meet its home switch during a move.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Guard {
    None,
    Forward(bool),
}

/// An axis's direction and enable pins, and its plan. Its steps are those of number `axis` of the [`Pulses`].
pub(crate) struct AxisDrive<B: Board> {
    axis: usize,
    direction: Line<B::Output>,
    enable: Line<B::Output>,
    stepper: Stepper,
    /// Ticks by which steps were late since the run began.
    late: u64,
    /// The approach that follows the present run.
    approach: Option<(i32, Times)>,
    /// Where to go on to, in the same direction, after braking short of it.
    onward: Option<i32>,
    /// Whether the run has yet to be changed into a braking one.
    to_brake: bool,
    limits: Limits,
    guard: Guard,
    debounce_us: u16,
    /// What the present position is called once the move has ended: a turn more or less on a full-turn axis.
    renamed: Option<i32>,
    /// Steps of a full turn, and whole turns that the axis is wound up by more than its position says.
    full_turn: u32,
    turns: i32,
    /// While it is homed anew: how far it was wound up when its position was forgotten, in steps.
    wound: Option<i64>,
    /// Whether the last motion ended upward with the play taken up.
    taken_up: bool,
    /// Whether the present one will.
    ends_taken_up: bool,
    /// Whether the position means anything.
    pub(crate) known: bool,
}

impl<B: Board> AxisDrive<B> {
    pub(crate) fn new(axis: usize, direction: B::Output, enable: B::Output) -> Self {
        Self {
            axis,
            direction: Line::new(direction),
            enable: Line::new(enable),
            stepper: Stepper::default(),
            late: 0,
            approach: None,
            onward: None,
            to_brake: false,
            limits: Limits::default(),
            guard: Guard::None,
            debounce_us: 0,
            renamed: None,
            full_turn: 0,
            turns: 0,
            wound: None,
            taken_up: false,
            ends_taken_up: false,
            known: false,
        }
    }

    /// Tells how its pins are wired, and releases the motor by it.
    pub(crate) fn wire(&mut self, inverted: Pins) -> Result<(), PinFailure> {
        self.direction.wire(inverted.contains(Pin::Direction));
        self.enable.wire(inverted.contains(Pin::Enable));
        set(&mut self.enable, false).and(set(&mut self.direction, false))
    }

    /// Number of the axis.
    pub(crate) fn axis(&self) -> usize {
        self.axis
    }

    /// Whether the axis is under way.
    pub(crate) fn moving(&self) -> bool {
        self.stepper.running() || self.approach.is_some()
    }

    /// When this axis next has to be polled, in µs: at the run's end, or when more steps have to be handed
    /// over.
    pub(crate) fn next_us(&self, pulses: &mut B::Pulses, now_us: u64) -> u64 {
        if let Some(end) = self.stepper.end() {
            let end_us = (end + self.late).div_ceil(1 << TICK_SHIFT);
            // The last pulse may end a little after the run.
            if end_us <= now_us { now_us + 1 } else { end_us }
        } else if let Some(due) = self.stepper.next_due() {
            let wanted_us = (due + self.late).saturating_sub(AHEAD) >> TICK_SHIFT;
            let (has_room, ebb) = pulses.with(|pulses| {
                (pulses.trains.has_room(self.axis), pulses.trains.ebb(self.axis, now_us as u32))
            });
            let room_us = now_us.saturating_add_signed(i64::from(ebb >> TICK_SHIFT));
            wanted_us.max(if has_room { 0 } else { room_us }).max(now_us + 1)
        } else {
            u64::MAX
        }
    }

    /// When the axis runs out of steps unless more are handed over now, in ticks; `None` while it needs none.
    pub(crate) fn runs_out(&self, pulses: &mut B::Pulses, now_us: u64) -> Option<u64> {
        let due = self.stepper.next_due()? + self.late;
        let needs = due < (now_us << TICK_SHIFT) + AHEAD;
        (needs && pulses.with(|pulses| pulses.trains.has_room(self.axis))).then_some(due)
    }

    /// Plans a move from rest. On a full-turn axis it goes the shorter way that its cables bear.
    pub(crate) fn plan(&self, position: i32, target: i32, p: &AxisParameters) -> Plan {
        let target = self.nearest_turn(position, target, p);
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
    pub(crate) fn begin(
        &mut self,
        pulses: &mut B::Pulses,
        now_us: u64,
        plan: &Plan,
        target: i32,
        p: &AxisParameters,
    ) -> Result<(), PinFailure> {
        self.taken_up = false;
        self.ends_taken_up = true;
        self.approach = plan.approach;
        self.limits = plan.limits;
        self.full_turn = p.full_turn_steps;
        self.renamed = Some(target);
        // An axis that turns round and round passes its index.
        self.guard = match (p.full_turn_steps, p.home_direction) {
            (0, direction) => Guard::Forward(direction == HomeDirection::Positive),
            _ => Guard::None,
        };
        self.debounce_us = p.home_debounce_us;
        let (first, times) = plan.first;
        self.start(pulses, now_us, first, times)
    }

    /// Changes the target of the move under way without braking; false, and nothing changed, where it can't
    /// be.
    pub(crate) fn redirect(
        &mut self,
        pulses: &mut B::Pulses,
        now_us: u64,
        target: i32,
        p: &AxisParameters,
    ) -> bool {
        let position = pulses.with(|pulses| pulses.trains.planned_position(self.axis));
        let turned = self.nearest_turn(position, target, p);
        // Only on a single upward run: then the play is taken up at the new target as it would be at the old
        // one.
        let upward = self.stepper.forward() && self.approach.is_none() && self.ends_taken_up;
        let room = turned.saturating_sub_unsigned(p.take_up_steps) >= position;
        let redirected = upward
            && room
            && self.stepper.redirect(self.on_time(now_us), i64::from(turned) - i64::from(position));
        if redirected {
            self.renamed = Some(target);
        }
        redirected
    }

    /// Starts a single run without take-up that writes the home switch down, as homing needs.
    pub(crate) fn run(
        &mut self,
        pulses: &mut B::Pulses,
        now_us: u64,
        target: i32,
        speed: u32,
        p: &AxisParameters,
    ) -> Result<(), PinFailure> {
        self.taken_up = false;
        self.ends_taken_up = false;
        self.renamed = None;
        self.guard = Guard::None;
        self.debounce_us = p.home_debounce_us;
        self.limits = Limits { speed, ..limits(p) };
        let times = Times::shortest(
            target.abs_diff(pulses.with(|pulses| pulses.trains.position(self.axis))),
            self.limits,
        );
        self.start(pulses, now_us, target, times)
    }

    fn start(
        &mut self,
        pulses: &mut B::Pulses,
        now_us: u64,
        target: i32,
        times: Times,
    ) -> Result<(), PinFailure> {
        let position = pulses.with(|pulses| pulses.trains.position(self.axis));
        let upward = target > position;
        set(&mut self.enable, true)?;
        set(&mut self.direction, upward)?;
        let watch = match self.guard {
            Guard::Forward(toward) if toward == upward => Watch::Limit,
            Guard::Forward(_) => Watch::Nothing,
            Guard::None if self.ends_taken_up => Watch::Nothing,
            Guard::None => Watch::Switch,
        };
        pulses.with(|pulses| pulses.begin(self.axis, upward, watch, self.debounce_us, now_us as u32));
        self.late = 0;
        // Its first steps are handed over by the next polls.
        self.stepper.start(now_us << TICK_SHIFT, upward, target.abs_diff(position), self.limits, times);
        Ok(())
    }

    /// Ends the present run after `distance` more steps, or as soon as the ramp allows: with a halt on the
    /// way if it is still speeding up.
    pub(crate) fn shorten(&mut self, pulses: &mut B::Pulses, now_us: u64, distance: u32) {
        let position = pulses.with(|pulses| pulses.trains.position(self.axis));
        let forward = self.stepper.forward();
        let target = if forward {
            position.saturating_add_unsigned(distance)
        } else {
            position.saturating_sub_unsigned(distance)
        };
        let ahead =
            i64::from(target) - i64::from(pulses.with(|pulses| pulses.trains.planned_position(self.axis)));
        let now = self.on_time(now_us);
        if !self.stepper.redirect(now, if forward { ahead } else { -ahead }) {
            self.to_brake = true;
            self.onward = Some(target);
        }
    }

    /// Comes to rest by the ramp, from the next change of plan on, and forgets the rest of the move.
    pub(crate) fn stop(&mut self) {
        self.approach = None;
        self.onward = None;
        self.ends_taken_up = false;
        self.renamed = None;
        self.to_brake = self.stepper.running();
    }

    /// Ceases at once and forgets the position; with `release` the motor no longer holds.
    pub(crate) fn cut(&mut self, pulses: &mut B::Pulses, release: bool) -> Result<(), PinFailure> {
        self.stepper.halt();
        self.approach = None;
        self.onward = None;
        self.to_brake = false;
        self.renamed = None;
        self.taken_up = false;
        self.ends_taken_up = false;
        self.known = false;
        let step = pulses.with(|pulses| pulses.halt(self.axis));
        if release { set(&mut self.enable, false).and(step) } else { step }
    }

    /// Takes the present position for `position`, reached upward with the play taken up.
    pub(crate) fn homed(&mut self, pulses: &mut B::Pulses, position: i32) {
        let gone = pulses.with(|pulses| {
            let gone = pulses.trains.position(self.axis);
            pulses.trains.set_position(self.axis, position);
            pulses.look_away(self.axis);
            gone
        });
        if let Some(wound) = self.wound.take() {
            self.turns = whole_turns(wound + i64::from(gone) - i64::from(position), self.full_turn);
        }
        self.known = true;
        self.taken_up = true;
    }

    /// Forgets the position, to count from 0; not how far it is wound up, unless a turn now has another
    /// number of steps.
    pub(crate) fn forget(&mut self, pulses: &mut B::Pulses, p: &AxisParameters) {
        let position = pulses.with(|pulses| {
            let position = pulses.trains.position(self.axis);
            pulses.trains.set_position(self.axis, 0);
            position
        });
        let same = self.full_turn != 0 && self.full_turn == p.full_turn_steps;
        let turns = i64::from(self.turns) * i64::from(self.full_turn);
        // Forgotten again before it was homed: it went on from there.
        self.wound = same.then(|| self.wound.unwrap_or(turns) + i64::from(position));
        if !same {
            self.turns = 0;
        }
        self.full_turn = p.full_turn_steps;
        self.known = false;
        self.taken_up = false;
    }

    /// Whether an axis that turns round and round is wound up by over a turn more than its cables bear in
    /// moves.
    pub(crate) fn is_wound_beyond(&self, position: i32, p: &AxisParameters) -> bool {
        let turn = i64::from(p.full_turn_steps);
        if turn == 0 || self.full_turn != p.full_turn_steps {
            return false;
        }
        let wound = self.wound.unwrap_or(i64::from(self.turns) * turn) + i64::from(position);
        let slack = (i64::from(p.most_turns) + 1) * turn;
        !(i64::from(p.min_steps) - slack..=i64::from(p.max_steps) + slack).contains(&wound)
    }

    /// Brakes where that was asked for, and goes on to what follows the run when it has ended, if the plan
    /// may be `changed`.
    pub(crate) fn poll(
        &mut self,
        pulses: &mut B::Pulses,
        now_us: u64,
        changes: &mut Changes,
    ) -> Result<(), PinFailure> {
        if !self.stepper.running() {
            self.to_brake = false;
            return Ok(());
        }
        self.late +=
            u64::from(pulses.with(|pulses| pulses.trains.late(self.axis)).wrapping_sub(self.late as u32));
        if self.to_brake && changes.take() {
            self.to_brake = false;
            self.stepper.brake();
        }
        let ended = self.stepper.end().is_some_and(|end| self.on_time(now_us) >= end);
        let ended = ended && pulses.with(|pulses| pulses.trains.resting(self.axis));
        let goes_on = self.approach.is_some() || self.onward.is_some();
        if ended && (!goes_on || changes.take()) { self.end_run(pulses, now_us) } else { Ok(()) }
    }

    /// The time in ticks at which the plan would be if no step had been late.
    fn on_time(&self, now_us: u64) -> u64 {
        (now_us << TICK_SHIFT).saturating_sub(self.late)
    }

    /// Hands steps over, some of those due within the time ahead.
    pub(crate) fn hand_over(&mut self, pulses: &mut B::Pulses, now_us: u64) {
        let before = self.on_time(now_us) + AHEAD;
        for _ in 0..AT_ONCE {
            if !pulses.with(|pulses| pulses.trains.has_room(self.axis)) {
                return;
            }
            let Some(burst) = self.stepper.next_burst(before) else { return };
            pulses.with(|pulses| pulses.trains.push(self.axis, now_us as u32, burst));
        }
    }

    /// At the end of a run: begins the approach, or notes that the move is done.
    fn end_run(&mut self, pulses: &mut B::Pulses, now_us: u64) -> Result<(), PinFailure> {
        self.stepper.halt();
        self.to_brake = false;
        let position = pulses.with(|pulses| pulses.trains.position(self.axis));
        if let Some(target) = self.onward.take()
            && target != position
            && (target > position) == self.stepper.forward()
        {
            let times = Times::shortest(target.abs_diff(position), self.limits);
            return self.start(pulses, now_us, target, times);
        }
        if let Some((target, times)) = self.approach.take() {
            return self.start(pulses, now_us, target, times);
        }
        if self.guard != Guard::None {
            pulses.with(|pulses| pulses.look_away(self.axis));
        }
        self.taken_up = self.ends_taken_up;
        if let Some(name) = self.renamed.take() {
            self.turns += whole_turns(i64::from(position) - i64::from(name), self.full_turn);
            pulses.with(|pulses| pulses.trains.set_position(self.axis, name));
        }
        Ok(())
    }

    /// Of all positions that stand for the target's angle and that the cables bear, the one nearest to
    /// `position`.
    fn nearest_turn(&self, position: i32, target: i32, p: &AxisParameters) -> i32 {
        if p.full_turn_steps == 0 {
            return target;
        }
        let turn = i64::from(p.full_turn_steps);
        let wound = i64::from(self.turns) * turn;
        let [position, target] = [position, target].map(i64::from);
        let ahead = (target - position).rem_euclid(turn);
        let nearest = position + if 2 * ahead > turn { ahead - turn } else { ahead };
        // As positions count now, without what it is wound up by.
        let slack = i64::from(p.most_turns) * turn;
        let lowest = i64::from(p.min_steps) - slack - wound;
        let highest = i64::from(p.max_steps) + slack - wound;
        let too_high = (nearest - highest).max(0);
        let too_low = (lowest - nearest).max(0);
        let back = |steps: i64| (steps + turn - 1) / turn * turn;
        (nearest - back(too_high) + back(too_low)) as i32
    }
}

/// A number of steps in whole turns, rounded to the nearest.
fn whole_turns(steps: i64, full_turn: u32) -> i32 {
    let turn = i64::from(full_turn);
    if turn == 0 { 0 } else { (2 * steps + turn).div_euclid(2 * turn) as i32 }
}
