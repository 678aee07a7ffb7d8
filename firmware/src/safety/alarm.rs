//! The axes' alarm inputs. A driver's DIAG may be active for less than the time between two polls, so an
//! interrupt at each of its changes writes down what it sees; polls look at the levels besides.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};

use lobelia_protocol::AXES;

/// The alarm inputs as an interrupt and the controller see them. One changes them at a time: the controller
/// does so within [`PulsesCell::with`](crate::PulsesCell::with), which keeps the interrupt out.
#[derive(Debug, Default)]
pub struct Alarms([Line; AXES]);

#[derive(Debug, Default)]
struct Line {
    inverted: AtomicBool,
    debounce_us: AtomicU32,
    active: AtomicBool,
    /// When it became active, in µs that wrap; and whether only a poll has seen that, whose time is that of
    /// its beginning.
    since_us: AtomicU32,
    polled: AtomicBool,
    /// Whether it was active for long enough and nobody has asked yet.
    rung: AtomicBool,
}

impl Line {
    const fn new() -> Self {
        Self {
            inverted: AtomicBool::new(false),
            debounce_us: AtomicU32::new(0),
            active: AtomicBool::new(false),
            since_us: AtomicU32::new(0),
            polled: AtomicBool::new(false),
            rung: AtomicBool::new(false),
        }
    }

    /// Takes a level down; gives how long it was active before, if it was.
    fn see(&self, high: bool, now_us: u32) -> Option<u32> {
        let active = high != self.inverted.load(Relaxed);
        let was = self.active.load(Relaxed);
        self.active.store(active, Relaxed);
        if active && !was {
            self.since_us.store(now_us, Relaxed);
        }
        let lasted = was.then(|| self.lasted(now_us));
        let debounce_us = self.debounce_us.load(Relaxed);
        if lasted.is_some_and(|lasted| lasted >= debounce_us) || active && debounce_us == 0 {
            self.rung.store(true, Relaxed);
            // No longer ago than needed, lest the difference wraps.
            self.since_us.store(now_us.wrapping_sub(debounce_us), Relaxed);
        }
        lasted
    }

    /// How long it has been active, µs; a poll's time may be before the interrupt's.
    fn lasted(&self, now_us: u32) -> u32 {
        (now_us.wrapping_sub(self.since_us.load(Relaxed)) as i32).max(0) as u32
    }
}

impl Alarms {
    /// All quiet.
    pub const fn new() -> Self {
        Self([Line::new(), Line::new(), Line::new(), Line::new()])
    }

    /// For an interrupt handler that comes at each change of an axis's pin: its level now, as the pin has it,
    /// and the time in µs, the lower half of the controller's. A pulse that is over before the handler looks
    /// counts where no debounce is asked for.
    pub fn changed(&self, axis: usize, high: bool, now_us: u32) {
        let Some(line) = self.0.get(axis) else { return };
        // What a poll saw before its interrupt could come begins now: by the poll's time it would seem longer
        // than it is.
        if line.polled.load(Relaxed) {
            line.polled.store(false, Relaxed);
            line.active.store(false, Relaxed);
        }
        let over = line.see(high, now_us).is_none() && !line.active.load(Relaxed);
        if over && line.debounce_us.load(Relaxed) == 0 {
            line.rung.store(true, Relaxed);
        }
    }

    /// Takes a level down that a poll has seen.
    pub(crate) fn look(&self, axis: usize, high: bool, now_us: u32) {
        let line = &self.0[axis];
        let was = line.active.load(Relaxed);
        if line.polled.load(Relaxed) && high == line.inverted.load(Relaxed) {
            // How long it was active after the last poll that saw it so is not known.
            line.polled.store(false, Relaxed);
            line.active.store(false, Relaxed);
            return;
        }
        line.see(high, now_us);
        if !was {
            line.polled.store(line.active.load(Relaxed), Relaxed);
        }
    }

    /// What an axis's input is like.
    pub(crate) fn set(&self, axis: usize, inverted: bool, debounce_us: u16) {
        let line = &self.0[axis];
        line.inverted.store(inverted, Relaxed);
        line.debounce_us.store(debounce_us.into(), Relaxed);
        line.active.store(false, Relaxed);
        line.rung.store(false, Relaxed);
    }

    /// Whether an axis's input was active for long enough since this was last asked.
    pub(crate) fn take(&self, axis: usize) -> bool {
        let rung = self.0[axis].rung.load(Relaxed);
        self.0[axis].rung.store(false, Relaxed);
        rung
    }

    /// Whether an axis's input is active.
    pub(crate) fn is_active(&self, axis: usize) -> bool {
        self.0[axis].active.load(Relaxed)
    }

    /// How much longer an input that is active has to be so until it counts, µs; `None` for one that is not,
    /// or counts already.
    pub(crate) fn left_us(&self, axis: usize, now_us: u32) -> Option<u32> {
        let line = &self.0[axis];
        let left = line.debounce_us.load(Relaxed).saturating_sub(line.lasted(now_us));
        (line.active.load(Relaxed) && left > 0).then_some(left)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An input that is active when high, debounced by 20 µs.
    fn alarms() -> Alarms {
        let alarms = Alarms::new();
        alarms.set(1, false, 20);
        alarms
    }

    #[test]
    fn pulse_between_two_polls_counts_if_it_is_long_enough_and_once() {
        for (lasts_us, counts) in [(19, false), (20, true), (400, true)] {
            let alarms = alarms();
            alarms.look(1, false, 0);
            alarms.changed(1, true, 100);
            alarms.changed(1, false, 100 + lasts_us);
            alarms.look(1, false, 500);
            assert_eq!((alarms.take(1), alarms.take(1)), (counts, false), "{lasts_us} µs");
        }
    }

    #[test]
    fn pulse_that_is_over_before_the_handler_looks_counts_without_debounce_only() {
        for (debounce_us, counts) in [(0, true), (1, false)] {
            let alarms = Alarms::new();
            alarms.set(3, false, debounce_us);
            alarms.changed(3, false, 100);
            assert_eq!(alarms.take(3), counts);
        }
    }

    #[test]
    fn level_counts_while_it_lasts_over_the_clocks_wrap_and_inverted() {
        let alarms = Alarms::new();
        alarms.set(0, true, 1000);
        alarms.look(0, true, u32::MAX - 600);
        assert!(!alarms.is_active(0));
        alarms.look(0, false, u32::MAX - 499);
        assert_eq!((alarms.is_active(0), alarms.left_us(0, u32::MAX - 499)), (true, Some(1000)));
        alarms.look(0, false, 499);
        assert!(!alarms.take(0));
        alarms.look(0, false, 500);
        assert!(alarms.take(0) && alarms.left_us(0, 500).is_none());
        alarms.look(0, false, 501);
        assert!(alarms.take(0), "as long as it lasts");
    }

    #[test]
    fn glitch_that_one_poll_alone_sees_counts_without_debounce_only() {
        for (debounce_us, counts) in [(0, true), (20, false)] {
            let alarms = Alarms::new();
            alarms.set(2, false, debounce_us);
            for (high, now_us) in [(false, 0), (true, 500), (false, 1000), (false, 1500)] {
                alarms.look(2, high, now_us);
            }
            assert_eq!(alarms.take(2), counts, "{debounce_us} µs");
        }
    }

    #[test]
    fn pulse_that_a_poll_sees_first_is_no_longer_for_that() {
        let alarms = alarms();
        // The polls began 300 µs ago, before and after their interrupt.
        alarms.look(1, true, 700);
        alarms.changed(1, true, 1000);
        alarms.changed(1, false, 1019);
        assert!(!alarms.take(1));
        alarms.changed(1, true, 1400);
        alarms.look(1, true, 1300);
        alarms.changed(1, false, 1419);
        assert!(!alarms.take(1));
        alarms.look(1, true, 1700);
        alarms.changed(1, false, 2000);
        assert!(!alarms.take(1), "over before its interrupt came");
    }
}
