//! The step pins, and the home switches, which have to be read at each step, and often enough between slow
//! ones, at times that are known: all that is done here is done by the one clock that the steps are made by,
//! whatever else the controller is doing.

use lobelia_protocol::AXES;

use crate::board::{Board, StepPins};
use crate::motion::trains::{Edges, Trains};
use crate::pin::{Line, PinFailure, is_high};

/// Switches that are watched are looked at this often, µs.
const LOOK_EVERY_US: u32 = 250;

/// What to look at when an axis has made a step.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) enum Watch {
    /// Nothing.
    #[default]
    Nothing,
    /// The home switch, which must not close for as long as a switch is debounced.
    Limit,
    /// The home switch, whose changes are written down.
    Switch,
}

/// What made an axis cease.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Trip {
    /// The home switch.
    Limit,
    /// A pin that could not be driven or read.
    Pin,
    /// A step that came too late.
    Late,
}

/// The home switch as it was last seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Sight {
    /// Whether it was closed.
    pub(crate) closed: bool,
    /// Position at the first look since when it was.
    pub(crate) position: i32,
    /// Times in µs of the first and the last look of those.
    since_us: u32,
    seen_us: u32,
}

impl Sight {
    /// How long it has been so as far as was seen, µs.
    pub(crate) fn lasted_us(&self) -> u32 {
        self.seen_us.wrapping_sub(self.since_us)
    }
}

/// Where a board keeps the steps: in the controller, which then has to make them by
/// [`Controller::tick`](crate::Controller::tick), or where an interrupt finds them too, which makes them
/// whatever the controller is doing.
pub trait PulsesCell<B: Board> {
    /// Keeps them.
    fn keep(pulses: Pulses<B>) -> Self;
    /// Does something with them, without the interrupt.
    fn with<R>(&mut self, does: impl FnOnce(&mut Pulses<B>) -> R) -> R;
}

impl<B: Board> PulsesCell<B> for Pulses<B> {
    fn keep(pulses: Pulses<B>) -> Self {
        pulses
    }

    fn with<R>(&mut self, does: impl FnOnce(&mut Pulses<B>) -> R) -> R {
        does(self)
    }
}

/// One axis's home switch.
struct Watcher<P> {
    home: Line<P>,
    watch: Watch,
    /// How long a closed switch has to stay so, in µs.
    debounce_us: u16,
    sight: Option<Sight>,
    trip: Option<Trip>,
}

/// All axes' steps with their pins.
pub struct Pulses<B: Board> {
    /// Times and positions.
    pub(crate) trains: Trains,
    pins: B::StepPort,
    /// Pins that step by falling, a bit an axis; nothing while the wiring is not known.
    inverted: Option<u8>,
    watchers: [Watcher<B::Input>; AXES],
    /// Axes each of whose steps is followed by a look at the switch, a bit an axis, and when all those were
    /// last looked at.
    looks: u8,
    looked_us: u32,
    tripped: bool,
}

impl<B: Board> Pulses<B> {
    pub(crate) fn new(pins: B::StepPort, homes: [B::Input; AXES]) -> Self {
        let watchers = homes.map(|home| Watcher {
            home: Line::new(home),
            watch: Watch::Nothing,
            debounce_us: 0,
            sight: None,
            trip: None,
        });
        Self {
            trains: Trains::default(),
            pins,
            inverted: None,
            watchers,
            looks: 0,
            looked_us: 0,
            tripped: false,
        }
    }

    /// Raises and lowers the step pins that are due, and looks at the switches; gives when this has to be
    /// called next, unless the controller is polled before. `clock` tells the time in µs, the lower half of
    /// the controller's, and is asked again once pins have changed: how long they stay counts from then.
    pub fn step(&mut self, clock: impl Fn() -> u32) -> Option<u32> {
        let now_us = clock();
        let edges = self.trains.step(now_us);
        if edges != Edges::default() {
            if !self.write(edges.raise, edges.lower) {
                self.trip(0, Trip::Pin);
            }
            self.trains.made(edges, clock());
        }
        let overdue = self.trains.take_overdue();
        if overdue != 0 {
            self.trip_late(overdue);
        }
        if self.looks != 0 {
            let all = now_us.wrapping_sub(self.looked_us) >= LOOK_EVERY_US;
            let looks = if all { self.looks } else { edges.raise & self.looks };
            if all {
                self.looked_us = now_us;
            }
            if looks != 0 {
                self.look_at(looks, now_us);
            }
        }
        self.next_us()
    }

    /// Begins and ends pulses; until the wiring is known nothing is driven.
    #[inline(always)]
    fn write(&mut self, begin: u8, end: u8) -> bool {
        let Some(inverted) = self.inverted else { return true };
        self.pins.write(begin & !inverted | end & inverted, end & !inverted | begin & inverted)
    }

    /// Tells how the step pins and the home switches are wired, a bit an axis, and ends all pulses by it.
    pub(crate) fn wire(&mut self, steps: u8, homes: u8) -> Result<(), PinFailure> {
        self.inverted = Some(steps);
        for (axis, watcher) in self.watchers.iter_mut().enumerate() {
            watcher.home.wire(homes & 1 << axis != 0);
        }
        if self.write(0, 0xF) { Ok(()) } else { Err(PinFailure) }
    }

    /// When [`Self::step`] has to be called next, in µs that wrap; `None` when there is nothing to do.
    pub(crate) fn next_us(&self) -> Option<u32> {
        let step = self.trains.next_us();
        if self.looks == 0 {
            return step;
        }
        let look = self.looked_us.wrapping_add(LOOK_EVERY_US);
        Some(step.filter(|step| (step.wrapping_sub(look) as i32) < 0).unwrap_or(look))
    }

    #[inline(never)]
    fn look_at(&mut self, axes: u8, now_us: u32) {
        for axis in (0..AXES).filter(|axis| axes & 1 << axis != 0) {
            self.look(axis, now_us);
        }
    }

    fn look(&mut self, axis: usize, now_us: u32) {
        let watcher = &mut self.watchers[axis];
        let Ok(closed) = is_high(&mut watcher.home) else { return self.trip(axis, Trip::Pin) };
        let sight = match watcher.sight {
            Some(sight) if sight.closed == closed => Sight { seen_us: now_us, ..sight },
            _ => {
                let position = self.trains.position(axis);
                Sight { closed, position, since_us: now_us, seen_us: now_us }
            }
        };
        watcher.sight = Some(sight);
        let debounce_us = watcher.debounce_us.into();
        if watcher.watch == Watch::Limit && closed && sight.lasted_us() >= debounce_us {
            self.trip(axis, Trip::Limit);
        }
    }

    #[cold]
    fn trip_late(&mut self, axes: u8) {
        for axis in (0..AXES).filter(|axis| axes & 1 << axis != 0) {
            self.trip(axis, Trip::Late);
        }
    }

    #[cold]
    fn trip(&mut self, axis: usize, trip: Trip) {
        self.watchers[axis].trip = Some(trip);
        self.tripped = true;
        self.trains.cease(axis);
        self.looks &= !(1 << axis);
    }

    /// Makes an axis ready for a run from rest, whose direction pin has just been set. `debounce_us` is how
    /// long its switch has to be closed in order to count.
    pub(crate) fn begin(&mut self, axis: usize, forward: bool, watch: Watch, debounce_us: u16, now_us: u32) {
        self.trains.begin(axis, forward);
        if self.looks == 0 {
            self.looked_us = now_us;
        }
        let watcher = &mut self.watchers[axis];
        watcher.watch = watch;
        watcher.debounce_us = debounce_us;
        watcher.sight = None;
        self.looks = self.looks & !(1 << axis) | u8::from(watch != Watch::Nothing) << axis;
    }

    /// Looks no longer at an axis's switch.
    pub(crate) fn look_away(&mut self, axis: usize) {
        self.looks &= !(1 << axis);
        self.watchers[axis].sight = None;
    }

    /// Makes an axis cease at once and forget the steps handed over.
    pub(crate) fn halt(&mut self, axis: usize) -> Result<(), PinFailure> {
        self.trains.cease(axis);
        self.trains.lowered(axis);
        self.look_away(axis);
        self.watchers[axis].trip = None;
        if self.write(0, 1 << axis) { Ok(()) } else { Err(PinFailure) }
    }

    /// Whether something made an axis cease, until all were asked what.
    pub(crate) fn tripped(&self) -> bool {
        self.tripped
    }

    /// What made an axis cease.
    pub(crate) fn take_trip(&mut self, axis: usize) -> Option<Trip> {
        self.tripped = false;
        self.watchers[axis].trip.take()
    }

    /// Whether an axis's home switch is closed.
    pub(crate) fn at_switch(&mut self, axis: usize) -> Result<bool, PinFailure> {
        is_high(&mut self.watchers[axis].home)
    }

    /// What was last seen of the home switch of an axis that watches it.
    pub(crate) fn sight(&self, axis: usize) -> Option<Sight> {
        self.watchers[axis].sight
    }
}
