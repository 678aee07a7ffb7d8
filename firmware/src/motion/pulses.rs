//! The pulses on the step pins: what runs at each step, in 32-bit times and additions alone.
//!
//! The planner hands bursts over ahead of time ([`Pulses::push`]); [`Pulses::step`] does what is due and says when it wants
//! to be called again. A step made late shifts all that follows on its axis, so that no limit is passed whatever the caller does.
//! A pulse ends when another axis is served anyway, or halfway to the axis's next step.

use heapless::Deque;
use lobelia_protocol::AXES;

use crate::board::{Board, PinFailure, is_high, set};
use crate::motion::burst::Burst;
use crate::motion::fixed::TICK_SHIFT;

/// Shortest time that a step pin stays high, and low, in µs.
const PULSE_US: u32 = 2;
/// The same in ticks.
const PULSE: i32 = (PULSE_US << TICK_SHIFT) as i32;
/// Longest that it stays high when no other axis is served meanwhile, in ticks.
const LONG_PULSE: i32 = 16 << TICK_SHIFT;
/// Never, in ticks: more than any step is planned ahead.
const FAR: i32 = i32::MAX;
/// Bursts of an axis that may wait.
const WAITING: usize = 4;

/// What to look at when an axis has made a step.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) enum Watch {
    /// Nothing.
    #[default]
    Nothing,
    /// The home switch, which must stay open.
    Limit,
    /// The home switch, whose changes are written down.
    Switch,
}

/// What made an axis cease.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Trip {
    /// The home switch.
    Limit,
    /// The driver's stall output.
    Stall,
    /// A pin that could not be driven or read.
    Pin,
}

/// The home switch as it was last seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Sight {
    /// Whether it was closed.
    pub(crate) closed: bool,
    /// Position and time in µs of the first look since when it was.
    pub(crate) position: i32,
    pub(crate) since_us: u32,
}

/// The pins of an axis that its steps need.
pub(crate) struct StepPins<B: Board> {
    pub(crate) step: B::Output,
    pub(crate) home: B::Input,
    pub(crate) stall: Option<B::Input>,
}

/// One axis.
struct Train<B: Board> {
    /// The present burst, of the steps still to be made: time of the next one, and differences.
    at: u64,
    interval: i64,
    change: i64,
    bend: i64,
    left: u32,
    position: i32,
    /// 1 or −1.
    direction: i32,
    high: bool,
    /// Whether a step has to be followed by a look at an input.
    looks: bool,
    /// When the step pin last changed, in µs.
    edge_us: u32,
    /// Ticks by which steps were late since the run began.
    late: u32,
    waiting: Deque<Burst, WAITING>,
    pins: StepPins<B>,
    watch: Watch,
    sight: Option<Sight>,
    trip: Option<Trip>,
}

/// All axes' pulses.
pub(crate) struct Pulses<B: Board> {
    trains: [Train<B>; AXES],
    next_us: u32,
    /// Whether anything is due ever.
    busy: bool,
    tripped: bool,
}

impl<B: Board> Train<B> {
    fn new(pins: StepPins<B>) -> Self {
        Self {
            at: 0,
            interval: 0,
            change: 0,
            bend: 0,
            left: 0,
            position: 0,
            direction: -1,
            high: false,
            looks: false,
            edge_us: 0,
            late: 0,
            waiting: Deque::new(),
            pins,
            watch: Watch::Nothing,
            sight: None,
            trip: None,
        }
    }

    /// Ticks until the next step is due, below 0 when it is late.
    fn wait(&self, now: u32) -> i32 {
        if self.left == 0 { FAR } else { ((self.at >> 32) as u32).wrapping_sub(now) as i32 }
    }

    /// Raises or lowers the pin if that is due; gives the ticks until the next change.
    #[inline(always)]
    fn serve(&mut self, now_us: u32, tripped: &mut bool) -> i32 {
        let now = now_us << TICK_SHIFT;
        let wait = self.wait(now);
        if self.high {
            if now_us.wrapping_sub(self.edge_us) < PULSE_US {
                return until_pulse_ends(wait);
            }
            self.edge_us = now_us;
            self.high = false;
            self.drive(false, tripped);
            return wait.max(PULSE);
        }
        if wait > 0 {
            return wait;
        }
        if now_us.wrapping_sub(self.edge_us) < PULSE_US {
            return PULSE;
        }
        self.edge_us = now_us;
        self.high = true;
        self.drive(true, tripped);
        self.position += self.direction;
        if -wait >= 1 << TICK_SHIFT {
            self.delay(-wait as u32);
        }
        self.left = self.left.wrapping_sub(1);
        if self.left == 0 {
            self.next_burst();
        } else {
            self.at = self.at.wrapping_add_signed(self.interval);
            self.interval = self.interval.wrapping_add(self.change);
            self.change = self.change.wrapping_add(self.bend);
        }
        if self.looks {
            self.look_after_step(now_us, tripped);
        }
        until_pulse_ends(self.wait(now))
    }

    #[cold]
    fn delay(&mut self, ticks: u32) {
        self.late = self.late.wrapping_add(ticks);
        self.at = self.at.wrapping_add(u64::from(ticks) << 32);
    }

    fn next_burst(&mut self) {
        if let Some(burst) = self.waiting.pop_front() {
            self.take(&burst);
        }
    }

    fn take(&mut self, burst: &Burst) {
        self.at = burst.at.wrapping_add(u64::from(self.late) << 32);
        (self.interval, self.change, self.bend) = (burst.interval, burst.change, burst.bend);
        self.left = burst.count;
    }

    fn drive(&mut self, high: bool, tripped: &mut bool) {
        if set(&mut self.pins.step, high).is_err() {
            self.cease(Trip::Pin, tripped);
        }
    }

    #[cold]
    fn cease(&mut self, trip: Trip, tripped: &mut bool) {
        self.trip = Some(trip);
        *tripped = true;
        self.left = 0;
        self.waiting.clear();
    }

    #[inline(never)]
    fn look_after_step(&mut self, now_us: u32, tripped: &mut bool) {
        match self.pins.stall.as_mut().map(is_high) {
            None | Some(Ok(false)) => {}
            Some(Ok(true)) => self.cease(Trip::Stall, tripped),
            Some(Err(PinFailure)) => self.cease(Trip::Pin, tripped),
        }
        if self.watch != Watch::Nothing {
            self.look(now_us, tripped);
        }
    }

    fn look(&mut self, now_us: u32, tripped: &mut bool) {
        match (is_high(&mut self.pins.home), self.watch) {
            (Err(PinFailure), _) => self.cease(Trip::Pin, tripped),
            (Ok(true), Watch::Limit) => self.cease(Trip::Limit, tripped),
            (Ok(closed), Watch::Switch) if self.sight.is_none_or(|sight| sight.closed != closed) => {
                self.sight = Some(Sight { closed, position: self.position, since_us: now_us });
            }
            (Ok(_), _) => {}
        }
    }

    fn resting(&self) -> bool {
        self.left == 0 && !self.high
    }
}

/// Ticks that a pin stays high unless another axis is served before, given those until the axis's next step.
fn until_pulse_ends(wait: i32) -> i32 {
    (wait >> 1).clamp(PULSE, LONG_PULSE)
}

impl<B: Board> Pulses<B> {
    pub(crate) fn new(pins: [StepPins<B>; AXES]) -> Self {
        Self { trains: pins.map(Train::new), next_us: 0, busy: false, tripped: false }
    }

    /// When [`Self::step`] has to be called next, in µs that wrap; `None` when there are no steps to make.
    pub(crate) fn next_us(&self) -> Option<u32> {
        self.busy.then_some(self.next_us)
    }

    /// Raises and lowers the step pins that are due at a time in µs that wraps.
    pub(crate) fn step(&mut self, now_us: u32) {
        if (now_us.wrapping_sub(self.next_us) as i32) < 0 {
            return;
        }
        let mut wait = FAR;
        for train in &mut self.trains {
            wait = wait.min(train.serve(now_us, &mut self.tripped));
        }
        self.next_us = now_us.wrapping_add((wait as u32).div_ceil(1 << TICK_SHIFT));
        self.busy = wait < FAR;
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
        let left = train.left + train.waiting.iter().map(|burst| burst.count).sum::<u32>();
        train.position.wrapping_add(train.direction * left as i32)
    }

    /// Whether an axis has no step to make and its pin is low.
    pub(crate) fn resting(&self, axis: usize) -> bool {
        self.trains[axis].resting()
    }

    /// Ticks by which an axis's steps were late since its run began, wrapping.
    pub(crate) fn late(&self, axis: usize) -> u32 {
        self.trains[axis].late
    }

    /// Makes an axis ready for a run from rest.
    pub(crate) fn begin(&mut self, axis: usize, forward: bool, watch: Watch) {
        let train = &mut self.trains[axis];
        train.direction = if forward { 1 } else { -1 };
        train.late = 0;
        train.watch = watch;
        train.sight = None;
        train.looks = watch != Watch::Nothing || train.pins.stall.is_some();
    }

    /// Whether another burst can be handed over.
    pub(crate) fn has_room(&self, axis: usize) -> bool {
        !self.trains[axis].waiting.is_full()
    }

    /// Ticks until an axis without room is down to its last burst but one.
    pub(crate) fn ebb(&self, axis: usize, now_us: u32) -> i32 {
        let train = &self.trains[axis];
        let burst = train.waiting.iter().nth(WAITING - 2);
        let at = burst.map_or(train.at, |burst| burst.at) >> 32;
        (at as u32).wrapping_add(train.late).wrapping_sub(now_us << TICK_SHIFT) as i32
    }

    /// Hands a burst over. There has to be room.
    pub(crate) fn push(&mut self, axis: usize, now_us: u32, burst: Burst) {
        let train = &mut self.trains[axis];
        if train.left > 0 {
            let _ = train.waiting.push_back(burst);
            return;
        }
        train.take(&burst);
        let wait = train.wait(now_us << TICK_SHIFT).max(0) as u32;
        let due_us = now_us.wrapping_add(wait.div_ceil(1 << TICK_SHIFT));
        if !self.busy || (due_us.wrapping_sub(self.next_us) as i32) < 0 {
            self.next_us = due_us;
        }
        self.busy = true;
    }

    /// Makes an axis cease at once and forget the steps handed over.
    pub(crate) fn halt(&mut self, axis: usize) -> Result<(), PinFailure> {
        let train = &mut self.trains[axis];
        train.left = 0;
        train.waiting.clear();
        train.trip = None;
        train.high = false;
        let set_low = set(&mut train.pins.step, false);
        self.busy = !self.trains.iter().all(Train::resting);
        set_low
    }

    /// Whether something made an axis cease, until all were asked what.
    pub(crate) fn tripped(&self) -> bool {
        self.tripped
    }

    /// What made an axis cease.
    pub(crate) fn take_trip(&mut self, axis: usize) -> Option<Trip> {
        self.tripped = false;
        self.trains[axis].trip.take()
    }

    /// Whether an axis's home switch is closed.
    pub(crate) fn at_switch(&mut self, axis: usize) -> Result<bool, PinFailure> {
        is_high(&mut self.trains[axis].pins.home)
    }

    /// The home switch, looked at again, of an axis that watches it and has made a step.
    pub(crate) fn sight(&mut self, axis: usize, now_us: u32) -> Option<Sight> {
        let train = &mut self.trains[axis];
        if train.sight.is_some() {
            train.look(now_us, &mut self.tripped);
        }
        train.sight
    }
}
