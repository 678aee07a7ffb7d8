//! What the simulated board's pins act on: mechanics, lamp, shutter, memory and line, at a virtual time.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use lobelia_firmware::safety::alarm::Alarms;
use lobelia_firmware::storage::SLOT_BYTES;
use lobelia_protocol::{Axis, Pin};

use crate::config::{MechanicsConfig, Wiring};
use crate::drivers::Drivers;
use crate::lamp::Lamp;
use crate::mechanics::Mechanism;
use crate::metering::Metering;
use crate::truth::Step;
use crate::wire::Wire;

/// Memory for parameters, in two slots.
pub(crate) type Slots = [[u8; SLOT_BYTES]; 2];

/// What the pins act on.
#[derive(Debug)]
pub(crate) struct Bench {
    pub(crate) now_us: AtomicU64,
    pub(crate) axes: [Mechanism; 4],
    pub(crate) lamp: Mutex<Lamp>,
    pub(crate) shutter_open: AtomicBool,
    /// Until when a timer keeps it open, µs; never where there is none.
    pub(crate) shutter_until_us: AtomicU64,
    /// Whether the board has such a timer, and a converter that reads by itself.
    pub(crate) timed: bool,
    metering: Mutex<Metering>,
    pub(crate) wiring: Wiring,
    /// What the alarm inputs' interrupt writes down.
    pub(crate) alarms: &'static Alarms,
    pub(crate) emergency_stop: AtomicBool,
    /// Memory for parameters, which a reset leaves as it is.
    flash: Mutex<Slots>,
    /// The drivers on their wire.
    pub(crate) drivers: Arc<Mutex<Drivers>>,
    /// Whether the lamp's housing is too hot.
    pub(crate) hot: AtomicBool,
    /// Whether steps are traced.
    pub(crate) traced: AtomicBool,
    pub(crate) trace: Mutex<Vec<Step>>,
    pub(crate) to_controller: Wire,
    pub(crate) to_host: Wire,
}

impl Bench {
    pub(crate) fn new(config: &MechanicsConfig) -> Self {
        Self {
            now_us: AtomicU64::new(0),
            axes: config.axes().map(Mechanism::new),
            lamp: Mutex::new(Lamp::new(&config.lamp, config.seed)),
            shutter_open: AtomicBool::new(false),
            shutter_until_us: AtomicU64::new(u64::MAX),
            timed: config.timed_exposures,
            metering: Mutex::default(),
            wiring: config.wiring,
            alarms: Box::leak(Box::new(Alarms::new())),
            emergency_stop: AtomicBool::new(false),
            flash: Mutex::new([[0xFF; SLOT_BYTES]; 2]),
            drivers: Arc::default(),
            hot: AtomicBool::new(false),
            traced: AtomicBool::new(false),
            trace: Mutex::default(),
            to_controller: Wire::default(),
            to_host: Wire::default(),
        }
    }

    /// Whether the shutter is open now.
    pub(crate) fn is_shutter_open(&self) -> bool {
        self.shutter_open.load(Relaxed) && self.now_us() < self.shutter_until_us.load(Relaxed)
    }

    /// The level of an axis's alarm input.
    pub(crate) fn alarm_level(&self, axis: usize) -> bool {
        let stalled = self.axes[axis].blocked() && self.drivers().looks_for_stalls(axis);
        (stalled || self.axes[axis].driver_failed.load(Relaxed))
            != self.wiring.axes[axis].contains(Pin::Alarm)
    }

    /// The memory for parameters.
    pub(crate) fn flash(&self) -> MutexGuard<'_, Slots> {
        self.flash.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The drivers.
    pub(crate) fn drivers(&self) -> MutexGuard<'_, Drivers> {
        self.drivers.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn metering(&self) -> MutexGuard<'_, Metering> {
        self.metering.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn lamp(&self) -> MutexGuard<'_, Lamp> {
        self.lamp.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Steps traced since this was last asked.
    pub(crate) fn take_trace(&self) -> Vec<Step> {
        std::mem::take(&mut self.trace.lock().unwrap_or_else(PoisonError::into_inner))
    }

    pub(crate) fn note_step(&self, axis: usize) {
        if self.traced.load(Relaxed) {
            let step =
                Step { axis: Axis::ALL[axis], up: self.axes[axis].up.load(Relaxed), at_us: self.now_us() };
            self.trace.lock().unwrap_or_else(PoisonError::into_inner).push(step);
        }
    }

    pub(crate) fn now_us(&self) -> u64 {
        self.now_us.load(Relaxed)
    }
}
