//! Fixed-point arithmetic for profiles: positions in 2⁻³² steps, times in ticks of 1/256 µs, and cubics of a
//! fraction of their segment, so that every coefficient is a distance and none can overflow.
//!
//! Planning uses 128-bit integers; [`Cubic::solve`], which runs a few times a burst of steps, uses 32 ×
//! 64-bit products and one 64-bit division an iteration.

/// Ticks in a second.
pub(crate) const TICKS_PER_S: u64 = 256_000_000;
/// Ticks in a µs, as a shift.
pub(crate) const TICK_SHIFT: u32 = 8;
/// One step, in the unit of positions.
pub(crate) const STEP: i64 = 1 << 32;

/// A solution is taken when the last correction was below this many ticks: the next would be far below one.
const CLOSE_TICKS: u64 = 64;
/// Halving alone ends within this many.
const MOST_ITERATIONS: u32 = 48;

/// `a · b / c`, rounded to the nearest. The result has to fit.
pub(crate) fn mul_div(a: u64, b: u64, c: u64) -> u64 {
    let c = u128::from(c);
    ((u128::from(a) * u128::from(b) + c / 2) / c) as u64
}

/// `n / d` rounded down, digit by digit: the compiler's division of 128 bits takes thousands of instructions
/// on these processors.
pub(crate) fn divide(n: u128, d: u32) -> u128 {
    let (mut quotient, mut rest) = (0, 0);
    if let Ok(d) = u16::try_from(d) {
        // The processor's own division suffices.
        for k in (0..8).rev() {
            let part = rest << 16 | u32::from((n >> (16 * k)) as u16);
            quotient = quotient << 16 | u128::from(part / u32::from(d));
            rest = part % u32::from(d);
        }
        return quotient;
    }
    let mut rest = u64::from(rest);
    for k in (0..4).rev() {
        let part = rest << 32 | u64::from((n >> (32 * k)) as u32);
        quotient = quotient << 32 | u128::from(part / u64::from(d));
        rest = part % u64::from(d);
    }
    quotient
}

/// The smallest `x` with `x² ≥ n`.
pub(crate) fn root_up(n: u128) -> u128 {
    let root = n.isqrt();
    if root * root < n { root + 1 } else { root }
}

/// The smallest `x` with `x³ ≥ n`; `n` below 2¹²⁰.
pub(crate) fn cube_root_up(n: u128) -> u128 {
    let (mut low, mut high) = (0, 1 << 40);
    while low < high {
        let middle = u128::midpoint(low, high);
        if middle * middle * middle < n {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    low
}

/// `value · u` for a fraction `u` in 2⁻³².
fn scale(value: i64, u: u32) -> i64 {
    let low = ((value as u64 & 0xffff_ffff) * u64::from(u)) >> 32;
    (value >> 32) * i64::from(u) + low as i64
}

/// Position within one segment: c₀ + c₁u + c₂u² + c₃u³ for the fraction u of the segment's time.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Cubic {
    /// Coefficients in 2⁻³² steps, lowest order first.
    pub(crate) c: [i64; 4],
    /// Length of the segment, in ticks.
    pub(crate) ticks: u64,
}

impl Cubic {
    /// Position at a fraction of the segment's time.
    pub(crate) fn at(&self, u: u32) -> i64 {
        let [c0, c1, c2, c3] = self.c;
        scale(scale(scale(c3, u) + c2, u) + c1, u) + c0
    }

    /// Position at the segment's end.
    pub(crate) fn end(&self) -> i64 {
        self.c.iter().sum()
    }

    /// dp/du.
    pub(crate) fn slope(&self, u: u32) -> i64 {
        let [_, c1, c2, c3] = self.c;
        scale(scale(3 * c3, u) + 2 * c2, u) + c1
    }

    /// d²p/du².
    pub(crate) fn curvature(&self, u: u32) -> i64 {
        2 * self.c[2] + scale(6 * self.c[3], u)
    }

    /// The time in ticks since the segment's start at which a position is passed; the segment rises from
    /// below to above it. Newton's method, kept within a bracket; begins at the guess, a fraction of the
    /// segment, and leaves the solution there for the next one.
    pub(crate) fn solve(&self, position: i64, guess: &mut u32) -> u64 {
        let (mut low, mut high) = (0, u32::MAX);
        let mut u = *guess;
        for _ in 0..MOST_ITERATIONS {
            let off = self.at(u) - position;
            if off > 0 {
                high = u;
            } else {
                low = u;
            }
            let next = quotient(off, self.slope(u)).map(|change| i64::from(u) - change);
            let newton =
                next.and_then(|next| u32::try_from(next).ok()).filter(|next| (low..=high).contains(next));
            let next = newton.unwrap_or_else(|| u32::midpoint(low, high));
            let moved = u.abs_diff(next);
            u = next;
            if high - low <= 1 || newton.is_some() && fraction_of(self.ticks, moved) < CLOSE_TICKS {
                break;
            }
        }
        *guess = u;
        fraction_of(self.ticks, u)
    }
}

/// Where the profile is when a step is made: half a step before the step's own position.
pub(crate) fn half_way(step: u32) -> i64 {
    (i64::from(step) << 32) - STEP / 2
}

/// The last step made up to a position.
pub(crate) fn last_step_to(position: i64) -> u32 {
    ((position + STEP / 2) >> 32) as u32
}

/// A fraction of a number of ticks.
pub(crate) fn fraction_of(ticks: u64, u: u32) -> u64 {
    let low = ((ticks & 0xffff_ffff) * u64::from(u)) >> 32;
    (ticks >> 32) * u64::from(u) + low
}

/// `n / d` in 2⁻³² to about 15 bits, for `d` above 0, where it is below 2³¹; by a division of 32 bits, which
/// these processors have.
fn quotient(n: i64, d: i64) -> Option<i64> {
    let size = n.unsigned_abs();
    if d <= 0 || size >= 1 << 62 {
        return None;
    }
    if size == 0 {
        return Some(0);
    }
    // Both as 32 and 16 bits and a power of two.
    let up = size.leading_zeros();
    let down = 48 - (d as u64).leading_zeros() as i32;
    let high = ((size << up) >> 32) as u32;
    let low = if down >= 0 { d >> down } else { d << -down } as u32;
    // n = high · 2^(32 − up), d = low · 2^down.
    let shift = 64 - up as i32 - down;
    let ratio = u64::from(high / low);
    let ratio = if shift >= 47 {
        return None;
    } else if shift >= 0 {
        ratio << shift
    } else {
        ratio >> -shift.max(-63)
    };
    Some(if n < 0 { -(ratio as i64) } else { ratio as i64 })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn roots_are_the_smallest_that_reach(n in 0..1u128 << 115) {
            let root = root_up(n);
            prop_assert!(root * root >= n && (root == 0 || (root - 1) * (root - 1) < n));
            let root = cube_root_up(n);
            prop_assert!(root * root * root >= n && (root == 0 || (root - 1).pow(3) < n));
        }

        #[test]
        fn division_by_digits_is_division(n in any::<u128>(), shift in 0..128u32, d in 1..=u32::MAX,
            small in 1..=u32::from(u16::MAX)) {
            prop_assert_eq!(divide(n >> shift, d), (n >> shift) / u128::from(d));
            prop_assert_eq!(divide(n >> shift, small), (n >> shift) / u128::from(small));
        }

        #[test]
        fn cubic_in_integers_is_the_cubic_in_reals(
            c in proptest::array::uniform4(-(1i64 << 58)..1 << 58), u in any::<u32>(),
        ) {
            let cubic = Cubic { c, ticks: 1 };
            let x = f64::from(u) / 4_294_967_296.0;
            let c = c.map(|c| c as f64);
            let near = |is: i64, real: f64| (is as f64 - real).abs() <= 8.0
                + 1e3 * f64::EPSILON * (1u64 << 62) as f64;
            prop_assert!(near(cubic.at(u), c[0] + x * (c[1] + x * (c[2] + x * c[3]))));
            prop_assert!(near(cubic.slope(u), c[1] + x * (2.0 * c[2] + x * 3.0 * c[3])));
            prop_assert!(near(cubic.curvature(u), 2.0 * c[2] + 6.0 * x * c[3]));
        }

        #[test]
        fn solution_is_where_the_cubic_passes(
            rise in 1i64..1 << 28, bend in 0i64..1 << 28, ticks in 1_000_000u64..1 << 36, part in 0.0..1.0f64,
            mut guess in any::<u32>(),
        ) {
            let cubic = Cubic { c: [0, rise << 32, 0, bend << 32], ticks };
            let position = (cubic.end() as f64 * part) as i64;
            let solved = cubic.solve(position, &mut guess) as f64 / ticks as f64;
            let error = solved * (rise as f64 + solved * solved * bend as f64)
                - position as f64 / STEP as f64;
            let slope = rise as f64 + 3.0 * solved * solved * bend as f64;
            // In ticks: half a µs at most.
            prop_assert!((error / slope * ticks as f64).abs() < 64.0, "{}", error / slope * ticks as f64);
        }
    }
}
