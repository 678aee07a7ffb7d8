//! When each step pin rises and falls: what runs at each step, in 32-bit times and additions alone, without
//! the pins.
//!
//! The planner hands bursts over ahead of time ([`Trains::push`]); [`Trains::step`] tells which pins to
//! change and when it wants to be called again. A step made late shifts all that follows on its axis, so that
//! no limit is passed whatever the caller does; one that is later than by half its interval is told
//! ([`Trains::take_overdue`]), since the motor may not follow such a gap. A pulse ends when another axis is
//! served anyway, or halfway to the axis's next step.

use heapless::Deque;
use lobelia_protocol::AXES;

use crate::board::BEARABLE_LATE_US;
use crate::motion::burst::Burst;
use crate::motion::fixed::TICK_SHIFT;

/// Longest that a pin stays high when no other axis is served meanwhile, in ticks.
const LONG_PULSE: i32 = 16 << TICK_SHIFT;
/// An axis without steps is looked at again after so many ticks, 4 s: half of what a difference of times
/// holds.
const FAR: i32 = 1 << 30;
/// Bursts of an axis that may wait.
const WAITING: usize = 12;

/// Pins to change at once, a bit an axis; the low ones first.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Edges {
    pub(crate) lower: u8,
    pub(crate) raise: u8,
}

/// Pins that changed, a bit an axis, and when the last of them did.
#[derive(Debug, Clone, Copy, Default)]
struct Change {
    pins: u8,
    at_us: u32,
}

impl Change {
    /// Whether it is too early for another change, which has to be `hold_us` after it.
    fn is_fresh(&self, now_us: u32, hold_us: u32) -> bool {
        now_us.wrapping_sub(self.at_us) < hold_us
    }
}

/// How long pins must stay as they are, in µs by a clock that counts whole ones: one more than asked for.
#[derive(Debug, Clone, Copy)]
struct Timing {
    /// A step pin, high or low.
    hold_us: u32,
    /// A direction pin before its axis's next step.
    setup_us: u32,
}

impl Timing {
    fn hold(self) -> i32 {
        (self.hold_us << TICK_SHIFT) as i32
    }
}

impl Default for Timing {
    fn default() -> Self {
        Self { hold_us: 2, setup_us: 1 }
    }
}

/// One axis's steps.
#[derive(Debug, Default)]
struct Train {
    /// The present burst, of the steps still to be made: time of the next one and differences, in 2⁻³² ticks.
    at: u64,
    interval: i64,
    change: i64,
    bend: i64,
    /// Steps of the burst still to be made.
    left: u32,
    position: i32,
    /// 1 or −1.
    direction: i32,
    /// Ticks by which steps were late since the run began.
    late: u32,
    /// When the last step was made, in ticks.
    made: u32,
}

/// How late a step may be, in ticks.
#[derive(Debug, Clone, Copy)]
struct Bearable(u32);

impl Default for Bearable {
    fn default() -> Self {
        Self(BEARABLE_LATE_US << TICK_SHIFT)
    }
}

/// All axes' steps.
#[derive(Debug, Default)]
pub(crate) struct Trains {
    trains: [Train; AXES],
    timing: Timing,
    /// How late a step may be, however soon after the last one it was due, in ticks.
    bearable: Bearable,
    /// Axes whose direction was set, until that time has been looked at; axes whose run has made no step yet;
    /// axes with a step that came too late.
    turned: u8,
    unstarted: u8,
    overdue: u8,
    /// How late the latest step was, but for the first of each run, in ticks.
    worst_late: u32,
    /// Axes with steps to make.
    active: u8,
    /// Axes whose pins were raised last, and those raised before that are still high.
    raised: Change,
    raised_before: Change,
    /// When all that are high have to fall, in ticks.
    lower_by: u32,
    /// Axes whose pins fell last.
    lowered: Change,
    next_us: u32,
    waiting: [Deque<Burst, WAITING>; AXES],
}

impl Train {
    fn due(&self) -> u32 {
        (self.at >> 32) as u32
    }

    fn take(&mut self, burst: &Burst) {
        self.at = burst.at.wrapping_add(u64::from(self.late) << 32);
        (self.interval, self.change, self.bend) = (burst.interval, burst.change, burst.bend);
        self.left = burst.count;
    }

    #[cold]
    fn delay(&mut self, ticks: u32) {
        self.late = self.late.wrapping_add(ticks);
        self.at = self.at.wrapping_add(u64::from(ticks) << 32);
    }

    fn park(&mut self, now: u32) {
        self.left = 0;
        self.at = u64::from(now.wrapping_add(FAR as u32)) << 32;
    }
}

impl Trains {
    /// When [`Self::step`] has to be called next, in µs that wrap; `None` when there is nothing to do.
    pub(crate) fn next_us(&self) -> Option<u32> {
        (self.active | self.high() != 0).then_some(self.next_us)
    }

    /// Axes whose pins are high.
    fn high(&self) -> u8 {
        self.raised.pins | self.raised_before.pins
    }

    /// What to do with the pins at a time in µs that wraps.
    #[inline(never)]
    pub(crate) fn step(&mut self, now_us: u32) -> Edges {
        let now = now_us << TICK_SHIFT;
        if self.turned & self.active != 0 {
            self.turn(now_us);
        }
        let lower = self.lower(now_us);
        let (hold_us, hold) = (self.timing.hold_us, self.timing.hold());
        let blocked =
            self.high() | if self.lowered.is_fresh(now_us, hold_us) { self.lowered.pins } else { 0 };
        let may_rise = self.active & !blocked;
        let mut raise = 0;
        let (mut wait, mut soonest) = (FAR, FAR);
        for axis in 0..AXES {
            let mut left = self.trains[axis].due().wrapping_sub(now) as i32;
            if left <= 0 {
                if may_rise & 1 << axis != 0 {
                    left = self.make(axis, now_us, -left as u32);
                    raise |= 1 << axis;
                    soonest = soonest.min(left);
                } else {
                    left = self.hinder(axis, now);
                }
            }
            wait = wait.min(left);
        }
        if raise != 0 {
            self.raise(raise, now_us, soonest);
        }
        if self.high() != 0 {
            wait = wait.min((self.lower_by.wrapping_sub(now) as i32).max(hold));
        }
        self.next_us = now_us.wrapping_add((wait as u32).div_ceil(1 << TICK_SHIFT));
        Edges { lower, raise }
    }

    /// The direction pins of axes about to move were set before `now_us`: no step of theirs is due before the
    /// set-up time is over.
    #[cold]
    fn turn(&mut self, now_us: u32) {
        let least = now_us.wrapping_add(self.timing.setup_us) << TICK_SHIFT;
        for axis in (0..AXES).filter(|axis| self.turned & self.active & 1 << axis != 0) {
            let early = least.wrapping_sub(self.trains[axis].due()) as i32;
            if early > 0 {
                self.trains[axis].delay(early as u32);
            }
        }
        self.turned &= !self.active;
    }

    /// The edges of the last [`Self::step`] were made before `now_us`: from then on the pins have to stay.
    #[inline(always)]
    pub(crate) fn made(&mut self, edges: Edges, now_us: u32) {
        if edges.raise != 0 {
            self.raised.at_us = now_us;
        }
        if edges.lower != 0 {
            self.lowered.at_us = now_us;
        }
    }

    /// Lowers the pins that have been high for long enough.
    #[inline(always)]
    fn lower(&mut self, now_us: u32) -> u8 {
        let hold_us = self.timing.hold_us;
        let mut lower = 0;
        if !self.raised.is_fresh(now_us, hold_us) {
            lower = core::mem::take(&mut self.raised.pins);
        }
        if self.raised_before.pins != 0 && !self.raised_before.is_fresh(now_us, hold_us) {
            lower |= core::mem::take(&mut self.raised_before.pins);
        }
        if lower != 0 {
            let others = if self.lowered.is_fresh(now_us, hold_us) { self.lowered.pins } else { 0 };
            self.lowered = Change { pins: others | lower, at_us: now_us };
        }
        lower
    }

    /// Notes pins that rise, with the ticks until the next step of any of them.
    #[inline(always)]
    fn raise(&mut self, pins: u8, now_us: u32, soonest: i32) {
        let by = (now_us << TICK_SHIFT).wrapping_add((soonest >> 1).min(LONG_PULSE) as u32);
        if self.high() == 0 || (by.wrapping_sub(self.lower_by) as i32) < 0 {
            self.lower_by = by;
        }
        self.unstarted &= !pins;
        // All that were raised earlier count as raised when the last of them was.
        if self.raised.pins != 0 {
            self.raised_before = Change { pins: self.high(), at_us: self.raised.at_us };
        }
        self.raised = Change { pins, at_us: now_us };
    }

    /// What an axis that may not rise waits for, in ticks.
    #[cold]
    fn hinder(&mut self, axis: usize, now: u32) -> i32 {
        if self.active & 1 << axis != 0 {
            return self.timing.hold();
        }
        self.trains[axis].park(now);
        FAR
    }

    /// Makes a step that is so many ticks late; gives the ticks until the next.
    #[inline(always)]
    fn make(&mut self, axis: usize, now_us: u32, late: u32) -> i32 {
        if late >= 1 << TICK_SHIFT {
            self.late_step(axis, late);
        }
        let train = &mut self.trains[axis];
        train.position = train.position.wrapping_add(train.direction);
        train.made = now_us << TICK_SHIFT;
        train.left = train.left.wrapping_sub(1);
        if train.left == 0 {
            self.next_burst(axis, now_us);
        } else {
            train.at = train.at.wrapping_add_signed(train.interval);
            train.interval = train.interval.wrapping_add(train.change);
            train.change = train.change.wrapping_add(train.bend);
        }
        self.trains[axis].due().wrapping_sub(now_us << TICK_SHIFT) as i32
    }

    /// Shifts what follows a late step, and notes one that is later than half as long as the interval before
    /// it should have been. A run may begin late.
    #[cold]
    fn late_step(&mut self, axis: usize, late: u32) {
        let train = &mut self.trains[axis];
        let interval = train.due().wrapping_sub(train.made);
        if self.unstarted & 1 << axis == 0 {
            self.worst_late = self.worst_late.max(late);
            if late > (interval / 2).max(self.bearable.0) {
                self.overdue |= 1 << axis;
            }
        }
        train.delay(late);
    }

    #[inline(never)]
    fn next_burst(&mut self, axis: usize, now_us: u32) {
        let train = &mut self.trains[axis];
        match self.waiting[axis].pop_front() {
            Some(burst) => train.take(&burst),
            None => {
                train.park(now_us << TICK_SHIFT);
                self.active &= !(1 << axis);
            }
        }
    }

    /// Position of an axis in steps.
    pub(crate) fn position(&self, axis: usize) -> i32 {
        self.trains[axis].position
    }

    /// Calls the present position by another number. Only at rest.
    pub(crate) fn set_position(&mut self, axis: usize, position: i32) {
        self.trains[axis].position = position;
    }

    /// The position after all steps handed over.
    pub(crate) fn planned_position(&self, axis: usize) -> i32 {
        let train = &self.trains[axis];
        let left = train.left + self.waiting[axis].iter().map(|burst| burst.count).sum::<u32>();
        train.position.wrapping_add(train.direction * left as i32)
    }

    /// Whether an axis has no step to make and its pin is low.
    pub(crate) fn resting(&self, axis: usize) -> bool {
        (self.active | self.high()) & 1 << axis == 0
    }

    /// Ticks by which an axis's steps were late since its run began, wrapping.
    pub(crate) fn late(&self, axis: usize) -> u32 {
        self.trains[axis].late
    }

    /// How late the latest step was, but for the first of each run, µs.
    pub(crate) fn worst_late_us(&self) -> u32 {
        self.worst_late >> TICK_SHIFT
    }

    /// Axes with a step that came too late since this was last asked, a bit an axis.
    #[inline(always)]
    pub(crate) fn take_overdue(&mut self) -> u8 {
        core::mem::take(&mut self.overdue)
    }

    /// Sets how long a step pin stays high, and low, at least, and how long before a step its direction pin
    /// is set, in µs.
    pub(crate) fn set_timing(&mut self, pulse_us: u8, direction_setup_us: u8) {
        self.timing =
            Timing { hold_us: u32::from(pulse_us) + 1, setup_us: u32::from(direction_setup_us) + 1 };
    }

    /// Sets how late a step may be, in µs, however soon after the last one it was due; later ones are
    /// overdue.
    pub(crate) fn set_bearable(&mut self, late_us: u32) {
        self.bearable = Bearable(late_us << TICK_SHIFT);
    }

    /// Makes an axis ready for a run from rest, whose direction pin has just been set.
    pub(crate) fn begin(&mut self, axis: usize, forward: bool) {
        self.turned |= 1 << axis;
        self.unstarted |= 1 << axis;
        self.trains[axis].direction = if forward { 1 } else { -1 };
        self.trains[axis].late = 0;
    }

    /// Whether another burst can be handed over.
    pub(crate) fn has_room(&self, axis: usize) -> bool {
        !self.waiting[axis].is_full()
    }

    /// Ticks until half of the bursts of an axis without room are made.
    pub(crate) fn ebb(&self, axis: usize, now_us: u32) -> i32 {
        let at = self.waiting[axis].iter().nth(WAITING / 2).map_or(0, |burst| burst.at >> 32);
        (at as u32).wrapping_add(self.late(axis)).wrapping_sub(now_us << TICK_SHIFT) as i32
    }

    /// Hands a burst over. There has to be room.
    pub(crate) fn push(&mut self, axis: usize, now_us: u32, burst: Burst) {
        let train = &mut self.trains[axis];
        if self.active & 1 << axis != 0 {
            let _ = self.waiting[axis].push_back(burst);
            return;
        }
        train.take(&burst);
        // A new direction is looked at at once.
        let due = if self.turned & 1 << axis != 0 { now_us << TICK_SHIFT } else { train.due() };
        let wait = (due.wrapping_sub(now_us << TICK_SHIFT) as i32).max(0) as u32;
        let due_us = now_us.wrapping_add(wait.div_ceil(1 << TICK_SHIFT));
        if self.next_us().is_none_or(|next| (due_us.wrapping_sub(next) as i32) < 0) {
            self.next_us = due_us;
        }
        self.active |= 1 << axis;
    }

    /// Makes an axis forget the steps handed over. Its pin stays.
    pub(crate) fn cease(&mut self, axis: usize) {
        self.trains[axis].left = 0;
        self.waiting[axis].clear();
        self.active &= !(1 << axis);
    }

    /// An axis's pin was lowered, whatever it was.
    pub(crate) fn lowered(&mut self, axis: usize) {
        self.raised.pins &= !(1 << axis);
        self.raised_before.pins &= !(1 << axis);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn pulses_and_gaps_last_as_long_as_was_asked_for_however_fast_and_late(
            intervals_us in proptest::array::uniform4(5.0..40.0f64), start_us in any::<u32>(),
            late_us in proptest::collection::vec(0..4u32, 16), pulse_us in 1..9u8,
        ) {
            const STEPS: u32 = 300;
            let mut trains = Trains::default();
            trains.set_timing(pulse_us, 0);
            for (axis, interval_us) in intervals_us.into_iter().enumerate() {
                trains.begin(axis, true);
                let interval_us = interval_us.max(f64::from(2 * pulse_us + 4));
                let interval = (interval_us * 1_099_511_627_776.0) as u64;
                let at = u64::from(start_us << TICK_SHIFT) + 1000;
                trains.push(axis, start_us, Burst::even(at, 0, interval, STEPS));
            }
            let (mut high, mut changed_us) = ([false; AXES], [start_us.wrapping_sub(100); AXES]);
            for late in late_us.into_iter().cycle() {
                let Some(next_us) = trains.next_us() else { break };
                let now_us = next_us.wrapping_add(late);
                let edges = trains.step(now_us);
                for axis in 0..AXES {
                    for (pins, level) in [(edges.lower, false), (edges.raise, true)] {
                        if pins & 1 << axis != 0 {
                            prop_assert_eq!(high[axis], !level);
                            // Whole ones of a clock: one more than the time that has surely passed.
                            prop_assert!(now_us.wrapping_sub(changed_us[axis]) > u32::from(pulse_us));
                            (high[axis], changed_us[axis]) = (level, now_us);
                        }
                    }
                }
            }
            prop_assert_eq!(high, [false; AXES]);
            prop_assert_eq!([0, 1, 2, 3].map(|axis| trains.position(axis)), [STEPS as i32; AXES]);
        }
    }
}
