//! The arithmetic of a converter that writes into a ring by itself: which readings are new, and which are of
//! the time that was asked for.

use core::ops::Range;

/// Readings into a ring of `SIZE`, `TAKE` of them every `US` µs. Readings are counted from 0, and the ring
/// has the number modulo its size.
#[derive(Debug, Clone, Copy, Default)]
pub struct Meter<const SIZE: u32, const TAKE: u32, const US: u32> {
    given: u64,
    limit: u64,
}

impl<const SIZE: u32, const TAKE: u32, const US: u32> Meter<SIZE, TAKE, US> {
    /// How many readings are made in so many µs.
    const fn within(us: u64) -> u64 {
        us * TAKE as u64 / US as u64
    }

    /// Those of so many µs from now on.
    pub const fn begin(duration_us: u32) -> Self {
        Self { given: 0, limit: Self::within(duration_us as u64) }
    }

    /// Readings not given yet, once so many µs have passed and the next is written at a place in the ring;
    /// what was overwritten is left out.
    pub fn take(&mut self, elapsed_us: u64, place: u32) -> Range<u64> {
        // The clock tells the number to some readings, the ring just which.
        let about = Self::within(elapsed_us);
        let off = (i64::from(place) - (about % u64::from(SIZE)) as i64).rem_euclid(SIZE.into());
        let off = if off > i64::from(SIZE / 2) { off - i64::from(SIZE) } else { off };
        let made = about.saturating_add_signed(off);
        let from = self.given.max(made.saturating_sub(u64::from(SIZE)));
        let to = made.min(self.limit).max(from);
        self.given = self.given.max(to);
        from..to
    }

    /// Whether all of them were given.
    pub const fn is_over(&self) -> bool {
        self.given >= self.limit
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use super::*;

    /// 7 readings every 32 µs.
    type Small = Meter<64, 7, 32>;

    #[test]
    fn each_reading_of_the_time_is_given_once_however_the_polls_fall() {
        let mut meter = Small::begin(3200);
        let mut given = Vec::new();
        for elapsed_us in [
            3, 100, 101, 330, 600, 870, 1100, 1390, 1600, 1880, 2100, 2390, 2600, 2880, 3100, 3200, 3300,
            9000,
        ] {
            // The converter began a little earlier or later than the clock says.
            let made = elapsed_us * 7 / 32 + 1;
            given.extend(meter.take(elapsed_us, (made % 64) as u32));
        }
        assert_eq!(given, (0..700).collect::<Vec<_>>());
        assert!(meter.is_over());
    }

    #[test]
    fn what_was_overwritten_before_a_late_poll_is_left_out() {
        let mut meter = Small::begin(32_000);
        assert_eq!(meter.take(32, 7), 0..7);
        let made = 3200 * 7 / 32;
        assert_eq!(meter.take(3200, made as u32 % 64), made - 64..made);
        assert_eq!(meter.take(3200, made as u32 % 64), made..made);
    }
}
