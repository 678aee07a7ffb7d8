//! Bursts: runs of steps whose times follow one cubic of the step's number, so that three additions give each
//! from the last.
//!
//! The time at which a profile passes a position has no closed form that is cheap. Over a burst it is
//! replaced by the cubic through four exact times; two more, near where such a cubic is farthest off, tell
//! how good it is.

/// A fraction of a tick is kept in so many bits.
const FRACTION: u32 = 32;
/// A burst may be so many ticks off at the two probes.
const CLOSE: u64 = 40;
/// Below so many ticks off, the next burst may be longer.
const VERY_CLOSE: u64 = 7;
/// Between the probes it is off by less than this: bursts are this late, so that no step is early.
pub(crate) const MARGIN: u64 = 66;

/// Steps by forward differences, in 2⁻³² ticks.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Burst {
    /// Time of the first step; only its lowest 32 bits of whole ticks are kept.
    pub(crate) at: u64,
    /// From the first to the second.
    pub(crate) interval: i64,
    /// What the next interval has more.
    pub(crate) change: i64,
    /// What the next change has more.
    pub(crate) bend: i64,
    /// Steps.
    pub(crate) count: u32,
}

impl Burst {
    /// One step at a time in ticks.
    pub(crate) fn single(at: u64) -> Self {
        Self { at: at << FRACTION, count: 1, ..Self::default() }
    }

    /// Evenly spaced steps.
    pub(crate) fn even(at: u64, fraction: u32, interval: u64, count: u32) -> Self {
        Self { at: at << FRACTION | u64::from(fraction), interval: interval as i64, count, ..Self::default() }
    }

    /// The burst of `steps` steps, and one more at its end, through times at its start, thirds and end; these
    /// in ticks from `at`.
    pub(crate) fn through(at: u64, times: [i64; 3], steps: u32) -> Self {
        let [first, second, third] = differences(times);
        // The cubic's coefficients for single steps: a third of the burst has steps/3 of them.
        let n = i64::from(steps);
        let cubed = ((9 * third) << (FRACTION - 1)) / (n * n * n);
        let squared = ((9 * (second - third)) << (FRACTION - 1)) / (n * n);
        let linear = ((6 * first - 3 * second + 2 * third) << (FRACTION - 1)) / n;
        Self {
            at: at << FRACTION,
            interval: linear + squared + cubed,
            change: 2 * squared + 6 * cubed,
            bend: 6 * cubed,
            count: steps + 1,
        }
    }
}

/// Forward differences of 0 and three more values.
fn differences([one, two, three]: [i64; 3]) -> [i64; 3] {
    [one, two - 2 * one, three - 3 * two + 3 * one]
}

/// How far the cubic through 0 and three times at thirds is off times at one and at five sixths, in ticks.
pub(crate) fn error(times: [i64; 3], [early, late]: [i64; 2]) -> u64 {
    let [first, second, third] = differences(times);
    let at_one = (8 * first - 2 * second + third) >> 4;
    let at_five = (40 * first + 30 * second + 5 * third) >> 4;
    at_one.abs_diff(early).max(at_five.abs_diff(late))
}

/// How long to make a burst after one of a length in steps was off by so much: `Err` when that one was too
/// long. The error grows with the fourth power of the length.
pub(crate) fn next_length(length: u32, error: u64) -> Result<u32, u32> {
    if error > CLOSE {
        let excess = 64 - (error / CLOSE).leading_zeros();
        Err(length >> excess.div_ceil(4))
    } else if error <= VERY_CLOSE {
        Ok(length + length.div_ceil(2))
    } else {
        Ok(length)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn burst_is_the_cubic_through_its_times(
            steps in 1..=512u32, a in 1.0..3e5f64, b in -1e5..1e5f64, c in -1e5..1e5f64,
        ) {
            let cubic = |x: f64| a * x + b * x * x + c * x * x * x;
            let times = [1.0, 2.0, 3.0].map(|third: f64| cubic(third / 3.0).round() as i64);
            let burst = Burst::through(0, times, steps);
            let (mut at, mut interval, mut change) = (burst.at as i64, burst.interval, burst.change);
            for step in 0..burst.count {
                let ideal = cubic(f64::from(step) / f64::from(steps));
                // Times are rounded to ticks, which the cubic makes at most 1.7 times worse.
                prop_assert!((at as f64 / 4_294_967_296.0 - ideal).abs() < 1.0, "step {} of {}", step, steps);
                at += interval;
                interval += change;
                change += burst.bend;
            }
            let sixths = [1.0, 5.0].map(|sixth: f64| cubic(sixth / 6.0).round() as i64);
            prop_assert!(error(times, sixths) <= 3);
            prop_assert!(error(times, sixths.map(|time| time + 100)) >= 97);
        }
    }

    #[test]
    fn length_follows_the_error() {
        assert_eq!(next_length(100, 0), Ok(150));
        assert_eq!(next_length(100, 40), Ok(100));
        assert_eq!(next_length(100, 41), Err(50));
        assert_eq!(next_length(100, 40 * 16), Err(25));
        assert_eq!(next_length(1, u64::MAX), Err(0));
    }
}
