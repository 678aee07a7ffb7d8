//! What a board does by itself in an exposure: a timer that closes the shutter, and a converter that reads the photodiode again and again.

use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use lobelia_firmware::{Readings, TimedShutter};

use crate::lamp::Lamp;
use crate::pins::Bench;

/// Between two readings, ns: no multiple of a dimmer's period.
const READING_NS: u64 = 4571;

/// The shutter's timer.
pub(crate) struct ShutterTimer(pub(crate) Arc<Bench>);

impl TimedShutter for ShutterTimer {
    fn open(&mut self, duration_us: u32) -> Option<u32> {
        let now_us = self.0.now_us();
        self.0.shutter_until_us.store(now_us + u64::from(duration_us), Relaxed);
        self.0.shutter_open.store(true, Relaxed);
        Some(now_us as u32)
    }

    fn close(&mut self) -> bool {
        self.0.shutter_open.store(false, Relaxed);
        true
    }

    fn is_open(&mut self) -> bool {
        self.0.is_shutter_open()
    }
}

/// Until when the converter reads by itself, and when what it read was last given, ns.
#[derive(Debug, Default)]
pub(crate) struct Metering {
    until_ns: u64,
    given_ns: u64,
}

impl Metering {
    pub(crate) fn begin(&mut self, now_us: u64, duration_us: u32) {
        self.given_ns = now_us * 1000;
        self.until_ns = self.given_ns + u64::from(duration_us) * 1000;
    }

    pub(crate) fn gather(&mut self, lamp: &Lamp, now_us: u64) -> Readings {
        let mut readings = Readings::default();
        while self.given_ns < self.until_ns.min(now_us * 1000) {
            readings.add(lamp.reading_ns(self.given_ns));
            self.given_ns += READING_NS;
        }
        readings
    }
}
