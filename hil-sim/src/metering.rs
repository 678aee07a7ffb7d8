//! The photodiode's converter where it reads again and again by itself.

use lobelia_firmware::Readings;

use crate::lamp::Lamp;

/// Between two readings, ns: no multiple of a dimmer's period.
const READING_NS: u64 = 4571;

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
