//! One way of the simulated link: bytes on their way, how long each takes, and what the line does to them.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::faults::{Disturbance, FaultRates, LineCounts};

/// Bits of a byte on a serial line, start and stop included.
const BITS: u64 = 10;

/// What the simulated link is like.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LineConfig {
    /// Bits a second; `None` takes no time.
    pub baud: Option<u32>,
    /// What happens to bytes, both ways.
    pub faults: FaultRates,
    /// Decides which.
    pub seed: u64,
}

#[derive(Debug, Default)]
struct Line {
    /// When a byte arrives, µs, and which.
    coming: VecDeque<(u64, u8)>,
    byte_ns: u64,
    /// When the line has carried what it was given.
    free_ns: u64,
    disturbance: Option<Disturbance>,
    /// So many bytes pass, and then so many are lost.
    passing: u64,
    losing: u64,
}

/// One way of the link. When the next byte arrives is kept beside, since it is asked for at every step of a
/// motor.
#[derive(Debug)]
pub(crate) struct Wire {
    line: Mutex<Line>,
    next_us: AtomicU64,
    free_us: AtomicU64,
}

impl Default for Wire {
    fn default() -> Self {
        Self { line: Mutex::default(), next_us: AtomicU64::new(u64::MAX), free_us: AtomicU64::new(0) }
    }
}

impl Wire {
    fn lock(&self) -> MutexGuard<'_, Line> {
        self.line.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn note(&self, line: &Line) {
        self.next_us.store(line.coming.front().map_or(u64::MAX, |&(us, _)| us), Relaxed);
        self.free_us.store(line.free_ns.div_ceil(1000), Relaxed);
    }

    /// Makes it another line; what is on its way arrives as it would have.
    pub(crate) fn set(&self, config: &LineConfig, way: u64) {
        let mut line = self.lock();
        line.byte_ns = config.baud.map_or(0, |baud| BITS * 1_000_000_000 / u64::from(baud.max(1)));
        line.disturbance = (config.faults != FaultRates::default())
            .then(|| Disturbance::new(config.faults, crate::noise::hash(&[config.seed, way])));
    }

    /// Loses `count` bytes once `passing` more have passed.
    pub(crate) fn lose(&self, passing: u64, count: u64) {
        let mut line = self.lock();
        (line.passing, line.losing) = (passing, count);
    }

    pub(crate) fn counts(&self) -> LineCounts {
        self.lock().disturbance.as_ref().map_or(LineCounts::default(), |disturbance| disturbance.counts)
    }

    /// When the next byte arrives, µs; `u64::MAX` when none is on its way.
    pub(crate) fn next_us(&self) -> u64 {
        self.next_us.load(Relaxed)
    }

    /// When all that it was given has left, µs.
    pub(crate) fn free_us(&self) -> u64 {
        self.free_us.load(Relaxed)
    }

    pub(crate) fn push(&self, now_us: u64, bytes: &[u8]) {
        let line = &mut *self.lock();
        for &byte in bytes {
            line.free_ns = line.free_ns.max(now_us * 1000) + line.byte_ns;
            if line.passing == 0 && line.losing > 0 {
                line.losing -= 1;
                continue;
            }
            line.passing = line.passing.saturating_sub(1);
            let (coming, free_ns) = (&mut line.coming, &mut line.free_ns);
            let mut arrive = |byte, late_us| {
                *free_ns += 1000 * late_us;
                coming.push_back((free_ns.div_ceil(1000), byte));
            };
            match &mut line.disturbance {
                Some(disturbance) => disturbance.pass(byte, arrive),
                None => arrive(byte, 0),
            }
        }
        self.note(line);
    }

    /// Takes as many as have arrived and fit.
    pub(crate) fn take(&self, now_us: u64, into: &mut [u8]) -> usize {
        if self.next_us() > now_us {
            return 0;
        }
        let mut line = self.lock();
        let mut count = 0;
        while count < into.len()
            && let Some(&(_, byte)) = line.coming.front().filter(|(us, _)| *us <= now_us)
        {
            into[count] = byte;
            count += 1;
            line.coming.pop_front();
        }
        self.note(&line);
        count
    }

    /// Forgets what is on its way.
    pub(crate) fn clear(&self) {
        let mut line = self.lock();
        line.coming.clear();
        self.note(&line);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_take_their_time_one_after_the_other() {
        let wire = Wire::default();
        wire.set(&LineConfig { baud: Some(1_000_000), ..Default::default() }, 0);
        wire.push(100, &[1, 2, 3]);
        wire.push(110, &[4]);
        let mut into = [0; 8];
        assert_eq!((wire.next_us(), wire.take(109, &mut into)), (110, 0));
        assert_eq!((wire.take(125, &mut into), into[0], into[1]), (2, 1, 2));
        assert_eq!((wire.next_us(), wire.free_us()), (130, 140));
        assert_eq!((wire.take(500, &mut into), into[1], wire.next_us()), (2, 4, u64::MAX));
    }

    #[test]
    fn a_line_is_cut_at_the_byte_asked_for() {
        let wire = Wire::default();
        wire.lose(2, 3);
        wire.push(0, &[1, 2, 3, 4, 5, 6]);
        let mut into = [0; 8];
        assert_eq!(wire.take(0, &mut into), 3);
        assert_eq!(into[..3], [1, 2, 6]);
    }
}
