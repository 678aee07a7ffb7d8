//! A budget of time: passes small enough that several fit in, and none that goes on when the time is up.
//!
//! The number of samples of a pass follows from the time that a few pixels take. A pass whose time runs out
//! is dropped as a whole, but for the first, without which there is no picture.

use super::BUDGET_PASS;

/// Passes that should fit in a budget: the last is dropped, so that more and smaller ones use it better.
const PASSES: f64 = 8.0;
/// Part of a budget that may go into looking where the noise is.
const LOOK_SHARE: f64 = 0.15;
/// Samples a pixel that a look costs.
const LOOK_SAMPLES: f64 = 2.0;

/// Seconds since some moment. Tests have one that goes by the work.
pub(super) type Clock<'a> = dyn Fn() -> f64 + Sync + 'a;

/// The end of a budget by a clock.
#[derive(Clone, Copy)]
pub(super) struct Deadline<'a> {
    clock: &'a Clock<'a>,
    end: f64,
}

impl<'a> Deadline<'a> {
    /// So many seconds from now.
    pub(super) fn new(clock: &'a Clock<'a>, seconds: f64) -> Self {
        Self { clock, end: clock() + seconds }
    }

    /// Whether the time is up.
    pub(super) fn is_over(&self) -> bool {
        self.left() <= 0.0
    }

    /// Seconds left.
    pub(super) fn left(&self) -> f64 {
        self.end - (self.clock)()
    }
}

/// Samples a pixel of one pass, a power of two, where one sample of all pixels takes so long.
pub(super) fn pass(seconds_left: f64, sample_seconds: f64, samples: u32) -> u32 {
    let fit = seconds_left / (PASSES * sample_seconds.max(1e-12));
    let most = BUDGET_PASS.min(samples);
    // A cast keeps to the range of u32, and takes what is no number as 0.
    1 << (fit as u32).clamp(1, most).ilog2()
}

/// Whether there is time to look where the noise is.
pub(super) fn may_look(seconds_left: f64, sample_seconds: f64) -> bool {
    LOOK_SAMPLES * sample_seconds <= LOOK_SHARE * seconds_left
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passes_are_as_small_as_the_budget_asks() {
        // 5 s, and 1.6 s a sample: one at a time, and no time to look.
        assert_eq!((pass(5.0, 1.6, 1 << 20), may_look(5.0, 1.6)), (1, false));
        assert_eq!((pass(60.0, 1.6, 1 << 20), may_look(60.0, 1.6)), (4, true));
        assert_eq!(pass(60.0, 1e-3, 1 << 20), BUDGET_PASS);
        assert_eq!(pass(60.0, 1e-3, 6), 4);
        assert_eq!([pass(-1.0, 1.0, 8), pass(f64::INFINITY, 0.0, 8), pass(f64::NAN, 1.0, 8)], [1, 8, 1]);
    }
}
