//! When each step pin rises and falls: what runs at each step, in 32-bit times and additions alone, without the pins.
//!
//! The planner hands bursts over ahead of time ([`Trains::push`]); [`Trains::step`] tells which pins to change and when it
//! wants to be called again. A step made late shifts all that follows on its axis, so that no limit is passed whatever the caller
//! does. A pulse ends when another axis is served anyway, or halfway to the axis's next step.

use heapless::Deque;
use lobelia_protocol::AXES;

use crate::motion::burst::Burst;
use crate::motion::fixed::TICK_SHIFT;

/// Shortest time that a step pin stays high, and low, in µs.
const PULSE_US: u32 = 2;
/// The same in ticks.
const PULSE: i32 = (PULSE_US << TICK_SHIFT) as i32;
/// Longest that it stays high when no other axis is served meanwhile, in ticks.
const LONG_PULSE: i32 = 16 << TICK_SHIFT;
/// An axis without steps is looked at again after so many ticks, 4 s: half of what a difference of times holds.
const FAR: i32 = 1 << 30;
/// Bursts of an axis that may wait.
const WAITING: usize = 4;

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
    /// Whether it is too early for another change.
    fn is_fresh(&self, now_us: u32) -> bool {
        now_us.wrapping_sub(self.at_us) < PULSE_US
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
}

/// All axes' steps.
#[derive(Debug, Default)]
pub(crate) struct Trains {
    trains: [Train; AXES],
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
        let lower = self.lower(now_us);
        let blocked = self.high() | if self.lowered.is_fresh(now_us) { self.lowered.pins } else { 0 };
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
            wait = wait.min((self.lower_by.wrapping_sub(now) as i32).max(PULSE));
        }
        self.next_us = now_us.wrapping_add((wait as u32).div_ceil(1 << TICK_SHIFT));
        Edges { lower, raise }
    }

    /// Lowers the pins that have been high for long enough.
    #[inline(always)]
    fn lower(&mut self, now_us: u32) -> u8 {
        let mut lower = 0;
        if !self.raised.is_fresh(now_us) {
            lower = core::mem::take(&mut self.raised.pins);
        }
        // Raised at least 1 µs before the others, so never more than two kinds are fresh.
        if self.raised_before.pins != 0 && !self.raised_before.is_fresh(now_us) {
            lower |= core::mem::take(&mut self.raised_before.pins);
        }
        if lower != 0 {
            let others = if self.lowered.is_fresh(now_us) { self.lowered.pins } else { 0 };
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
        if self.raised.pins != 0 {
            self.raised_before = Change { pins: self.high(), at_us: self.raised.at_us };
        }
        self.raised = Change { pins, at_us: now_us };
    }

    /// What an axis that may not rise waits for, in ticks.
    #[cold]
    fn hinder(&mut self, axis: usize, now: u32) -> i32 {
        if self.active & 1 << axis != 0 {
            return PULSE;
        }
        self.trains[axis].park(now);
        FAR
    }

    /// Makes a step that is so many ticks late; gives the ticks until the next.
    #[inline(always)]
    fn make(&mut self, axis: usize, now_us: u32, late: u32) -> i32 {
        let train = &mut self.trains[axis];
        train.position = train.position.wrapping_add(train.direction);
        if late >= 1 << TICK_SHIFT {
            train.delay(late);
        }
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

    /// Makes an axis ready for a run from rest.
    pub(crate) fn begin(&mut self, axis: usize, forward: bool) {
        self.trains[axis].direction = if forward { 1 } else { -1 };
        self.trains[axis].late = 0;
    }

    /// Whether another burst can be handed over.
    pub(crate) fn has_room(&self, axis: usize) -> bool {
        !self.waiting[axis].is_full()
    }

    /// Ticks until an axis without room is down to its last burst but one.
    pub(crate) fn ebb(&self, axis: usize, now_us: u32) -> i32 {
        let at = self.waiting[axis].iter().nth(WAITING - 2).map_or(0, |burst| burst.at >> 32);
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
        let wait = (train.due().wrapping_sub(now_us << TICK_SHIFT) as i32).max(0) as u32;
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
        fn pulses_and_gaps_last_two_microseconds_however_fast_and_late(
            intervals_us in proptest::array::uniform4(5.0..40.0f64), start_us in any::<u32>(),
            late_us in proptest::collection::vec(0..4u32, 16),
        ) {
            const STEPS: u32 = 300;
            let mut trains = Trains::default();
            for (axis, interval_us) in intervals_us.into_iter().enumerate() {
                trains.begin(axis, true);
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
                            prop_assert!(now_us.wrapping_sub(changed_us[axis]) >= PULSE_US);
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
