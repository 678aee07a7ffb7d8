//! A trace of steps in a board's memory, for tests that read it from outside: which axis stepped which way at
//! what time of the board's clock.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};

/// Steps that are held; older ones are overwritten.
pub const STEPS: usize = 4096;

/// The trace. Whoever reads it from outside finds the count first and then the ring.
#[derive(Debug)]
#[repr(C)]
pub struct Trace {
    /// Steps ever made.
    count: AtomicU32,
    /// Each step in the place of its number: time in µs in the upper 29 bits, then whether it went up, then
    /// the axis in 2.
    steps: [AtomicU32; STEPS],
    on: AtomicBool,
    now_us: fn() -> u64,
}

impl Trace {
    /// No step yet; takes times from a clock once it is started.
    pub const fn new(now_us: fn() -> u64) -> Self {
        Self {
            count: AtomicU32::new(0),
            steps: [const { AtomicU32::new(0) }; STEPS],
            on: AtomicBool::new(false),
            now_us,
        }
    }

    /// Holds steps from now on. Until then they cost next to nothing, which matters where instructions are
    /// counted.
    pub fn start(&self) {
        self.on.store(true, Relaxed);
    }

    /// An axis makes a step.
    pub fn step(&self, axis: u8, up: bool) {
        if self.on.load(Relaxed) {
            let count = self.count.load(Relaxed);
            let step = ((self.now_us)() as u32) << 3 | u32::from(up) << 2 | u32::from(axis & 3);
            self.steps[count as usize % STEPS].store(step, Relaxed);
            self.count.store(count.wrapping_add(1), Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_held_in_order_once_started() {
        static TRACE: Trace = Trace::new(|| 1000);
        TRACE.step(1, true);
        TRACE.start();
        TRACE.step(3, true);
        TRACE.step(2, false);
        assert_eq!(TRACE.count.load(Relaxed), 2);
        assert_eq!([0, 1].map(|k| TRACE.steps[k].load(Relaxed)), [1000 << 3 | 0b111, 1000 << 3 | 0b010]);
    }
}
