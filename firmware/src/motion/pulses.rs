//! The step pins, and the home switches, which have to be read at each step.

use lobelia_protocol::AXES;

use crate::board::{Board, PinFailure, StepPins, is_high};
use crate::motion::trains::Trains;

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

/// Where a board keeps the steps: in the controller, which then has to make them by [`Controller::tick`](crate::Controller::tick),
/// or where an interrupt finds them too, which makes them whatever the controller is doing.
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
    home: P,
    watch: Watch,
    sight: Option<Sight>,
    trip: Option<Trip>,
}

/// All axes' steps with their pins.
pub struct Pulses<B: Board> {
    /// Times and positions.
    pub(crate) trains: Trains,
    pins: B::StepPort,
    watchers: [Watcher<B::Input>; AXES],
    /// Axes each of whose steps is followed by a look at the switch, a bit an axis.
    looks: u8,
    tripped: bool,
}

impl<B: Board> Pulses<B> {
    pub(crate) fn new(pins: B::StepPort, homes: [B::Input; AXES]) -> Self {
        let watchers = homes.map(|home| Watcher { home, watch: Watch::Nothing, sight: None, trip: None });
        Self { trains: Trains::default(), pins, watchers, looks: 0, tripped: false }
    }

    /// Raises and lowers the step pins that are due at a time in µs, the lower half of the controller's; gives when this has to
    /// be called next, unless the controller is polled before.
    pub fn step(&mut self, now_us: u32) -> Option<u32> {
        let edges = self.trains.step(now_us);
        if !self.pins.write(edges.raise, edges.lower) {
            self.trip(0, Trip::Pin);
        }
        let looks = edges.raise & self.looks;
        if looks != 0 {
            self.look_at(looks, now_us);
        }
        self.trains.next_us()
    }

    #[inline(never)]
    fn look_at(&mut self, axes: u8, now_us: u32) {
        for axis in (0..AXES).filter(|axis| axes & 1 << axis != 0) {
            self.look(axis, now_us);
        }
    }

    fn look(&mut self, axis: usize, now_us: u32) {
        let watcher = &mut self.watchers[axis];
        if watcher.watch == Watch::Nothing {
            return;
        }
        match (is_high(&mut watcher.home), watcher.watch) {
            (Err(PinFailure), _) => self.trip(axis, Trip::Pin),
            (Ok(true), Watch::Limit) => self.trip(axis, Trip::Limit),
            (Ok(closed), Watch::Switch) if watcher.sight.is_none_or(|sight| sight.closed != closed) => {
                let position = self.trains.position(axis);
                watcher.sight = Some(Sight { closed, position, since_us: now_us });
            }
            (Ok(_), _) => {}
        }
    }

    #[cold]
    fn trip(&mut self, axis: usize, trip: Trip) {
        self.watchers[axis].trip = Some(trip);
        self.tripped = true;
        self.trains.cease(axis);
    }

    /// Makes an axis ready for a run from rest.
    pub(crate) fn begin(&mut self, axis: usize, forward: bool, watch: Watch) {
        self.trains.begin(axis, forward);
        let watcher = &mut self.watchers[axis];
        watcher.watch = watch;
        watcher.sight = None;
        self.looks = self.looks & !(1 << axis) | u8::from(watch != Watch::Nothing) << axis;
    }

    /// Makes an axis cease at once and forget the steps handed over.
    pub(crate) fn halt(&mut self, axis: usize) -> Result<(), PinFailure> {
        self.trains.cease(axis);
        self.trains.lowered(axis);
        self.watchers[axis].trip = None;
        if self.pins.write(0, 1 << axis) { Ok(()) } else { Err(PinFailure) }
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

    /// The home switch, looked at again, of an axis that watches it and has made a step.
    pub(crate) fn sight(&mut self, axis: usize, now_us: u32) -> Option<Sight> {
        if self.watchers[axis].sight.is_some() {
            self.look(axis, now_us);
        }
        self.watchers[axis].sight
    }
}
