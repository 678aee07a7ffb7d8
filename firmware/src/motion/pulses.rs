//! The step pins, and the inputs that have to be read at each step: home switches and stall outputs.

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

/// The inputs of an axis.
pub(crate) struct Inputs<P> {
    pub(crate) home: P,
    pub(crate) stall: Option<P>,
}

/// One axis's watch.
struct Watcher<P> {
    inputs: Inputs<P>,
    watch: Watch,
    sight: Option<Sight>,
    trip: Option<Trip>,
}

/// All axes' steps with their pins.
pub(crate) struct Pulses<B: Board> {
    /// Times and positions.
    pub(crate) trains: Trains,
    pins: B::Steps,
    watchers: [Watcher<B::Input>; AXES],
    /// Axes each of whose steps is followed by a look at an input, a bit an axis.
    looks: u8,
    tripped: bool,
}

impl<B: Board> Pulses<B> {
    pub(crate) fn new(pins: B::Steps, inputs: [Inputs<B::Input>; AXES]) -> Self {
        let watchers =
            inputs.map(|inputs| Watcher { inputs, watch: Watch::Nothing, sight: None, trip: None });
        Self { trains: Trains::default(), pins, watchers, looks: 0, tripped: false }
    }

    /// Raises and lowers the step pins that are due at a time in µs that wraps.
    pub(crate) fn step(&mut self, now_us: u32) {
        let edges = self.trains.step(now_us);
        if !self.pins.write(edges.raise, edges.lower) {
            self.trip(0, Trip::Pin);
        }
        let looks = edges.raise & self.looks;
        if looks != 0 {
            self.look_at(looks, now_us);
        }
    }

    #[inline(never)]
    fn look_at(&mut self, axes: u8, now_us: u32) {
        for axis in (0..AXES).filter(|axis| axes & 1 << axis != 0) {
            match self.watchers[axis].inputs.stall.as_mut().map(is_high) {
                None | Some(Ok(false)) => {}
                Some(Ok(true)) => self.trip(axis, Trip::Stall),
                Some(Err(PinFailure)) => self.trip(axis, Trip::Pin),
            }
            self.look(axis, now_us);
        }
    }

    fn look(&mut self, axis: usize, now_us: u32) {
        let watcher = &mut self.watchers[axis];
        if watcher.watch == Watch::Nothing {
            return;
        }
        match (is_high(&mut watcher.inputs.home), watcher.watch) {
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
        let looks = watch != Watch::Nothing || watcher.inputs.stall.is_some();
        self.looks = self.looks & !(1 << axis) | u8::from(looks) << axis;
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
        is_high(&mut self.watchers[axis].inputs.home)
    }

    /// The home switch, looked at again, of an axis that watches it and has made a step.
    pub(crate) fn sight(&mut self, axis: usize, now_us: u32) -> Option<Sight> {
        if self.watchers[axis].sight.is_some() {
            self.look(axis, now_us);
        }
        self.watchers[axis].sight
    }
}
