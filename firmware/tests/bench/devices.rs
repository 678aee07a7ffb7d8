//! What a board may have besides pins: a timer for the shutter, a converter that reads by itself, outputs
//! that are told their wiring, and a brown-out level. The bench of this thread's last rig has their state,
//! since what a board has lives for ever.

use std::cell::RefCell;
use std::rc::Rc;

use lobelia_firmware::{BrownOut, Outputs, Readings, TimedShutter};
use lobelia_protocol::Pins;

use super::Shared;

thread_local! {
    static BENCH: RefCell<Option<Shared>> = const { RefCell::new(None) };
}

pub(crate) fn attach(bench: &Shared) {
    BENCH.with(|attached| *attached.borrow_mut() = Some(Rc::clone(bench)));
}

fn bench() -> Shared {
    BENCH.with(|attached| Rc::clone(attached.borrow().as_ref().unwrap()))
}

/// Readings of the converter each so many ns: no multiple of the dimmer's 50 µs.
const READING_NS: u64 = 4571;

/// Their state.
#[derive(Default)]
pub(crate) struct Devices {
    /// Whether the converter reads by itself.
    pub(crate) reads_by_itself: bool,
    /// From when to when it does, and how far what it read was given, ns.
    reading_ns: (u64, u64, u64),
    /// By how much of its mean the lamp is brighter and darker, half of each of the dimmer's 50 µs, in
    /// hundredths.
    pub(crate) ripple_percent: u16,
    /// When the timer has opened the shutter, and when it closes it.
    pub(crate) timed_us: Option<(u64, u64)>,
    /// Whether the timer does not close it.
    pub(crate) jammed: bool,
    /// What the outputs were told, and how often pins had been written by then.
    pub(crate) wired: Option<([Pins; 4], Pins)>,
    pub(crate) brown_out_set: bool,
    /// How often, and when last, its level was set.
    pub(crate) brown_out_writes: Vec<u64>,
}

impl Devices {
    /// The lamp's reading at a time, ns.
    pub(crate) fn light(&self, at_ns: u64) -> u16 {
        let ripple = 10 * self.ripple_percent;
        if at_ns % 50_000 < 25_000 { 1000 + ripple } else { 1000 - ripple }
    }

    pub(crate) fn begin_readings(&mut self, now_us: u64, duration_us: u32) -> bool {
        let from = now_us * 1000;
        self.reading_ns = (from, from + u64::from(duration_us) * 1000, from);
        self.reads_by_itself
    }

    pub(crate) fn gather(&mut self, now_us: u64) -> Readings {
        let (from, end, mut given) = self.reading_ns;
        let mut readings = Readings::default();
        while given < end.min(now_us * 1000) {
            readings.add(self.light(given));
            given += READING_NS;
        }
        self.reading_ns = (from, end, given);
        readings
    }
}

pub(crate) struct ShutterTimer;

impl TimedShutter for ShutterTimer {
    fn open(&mut self, duration_us: u32) -> Option<u32> {
        let bench = bench();
        let mut bench = bench.borrow_mut();
        let from_us = bench.now_us + 3;
        bench.devices.timed_us = Some((from_us, from_us + u64::from(duration_us)));
        Some(from_us as u32)
    }
    fn close(&mut self) -> bool {
        let bench = bench();
        let mut bench = bench.borrow_mut();
        let now_us = bench.now_us;
        if let Some((_, until_us)) = &mut bench.devices.timed_us {
            *until_us = (*until_us).min(now_us);
        }
        bench.devices.jammed = false;
        true
    }
    fn is_open(&mut self) -> bool {
        let bench = bench();
        let bench = bench.borrow();
        bench.devices.timed_us.is_some_and(|(_, until_us)| bench.now_us < until_us) || bench.devices.jammed
    }
}

pub(crate) struct AllOutputs;

impl Outputs for AllOutputs {
    fn wired(&mut self, axes: [Pins; 4], rest: Pins) {
        bench().borrow_mut().devices.wired = Some((axes, rest));
    }
}

pub(crate) struct Supply;

impl BrownOut for Supply {
    fn is_set(&mut self) -> bool {
        bench().borrow().devices.brown_out_set
    }
    fn set(&mut self) {
        let bench = bench();
        let mut bench = bench.borrow_mut();
        let now_us = bench.now_us;
        bench.devices.brown_out_writes.push(now_us);
    }
}
