//! Coming to rest from the middle of a run, as fast as acceleration and jerk allow: three segments from any
//! speed v and acceleration a.
//!
//! The acceleration goes from a to −b with the full jerk J, stays, and goes to 0. b = min(A, √(J·v + a²/2)),
//! from which the times follow: (a + b)/J, (v + a²/2J − b²/J)/b and b/J. The same holds for an a below 0,
//! when the run was braking already.

use crate::motion::fixed::{Cubic, TICKS_PER_S, divide, last_step_to};
use crate::motion::profile::{Limits, State, Stretch};

/// [`TICKS_PER_S`] is an odd number times a power of two, by which it is divided fast.
const TICKS_SHIFT: u32 = TICKS_PER_S.trailing_zeros();
const TICKS_ODD: u32 = (TICKS_PER_S >> TICKS_SHIFT) as u32;

/// The segments of a braking.
#[derive(Debug, Clone, Default)]
pub(crate) struct Brake {
    segments: [Cubic; 3],
    current: usize,
    started: u64,
    guess: u32,
}

impl Brake {
    /// Brakes from a state whose position counts from the last step made.
    pub(crate) fn new(from: State, limits: Limits) -> Self {
        let jerk = u128::from(limits.jerk);
        let a = i128::from(from.acceleration).clamp(-(1 << 57), 1 << 57);
        // In 2⁻⁶⁴ (steps/s²)².
        let drop = ((jerk * u128::from(from.speed)) << 32) + (a * a / 2) as u128;
        let most = u128::from(limits.acceleration) << 32;
        // A little less only makes it hold for a little longer. A root of 64 bits is much cheaper.
        let halves = drop.checked_ilog2().map_or(0, |bits| bits.saturating_sub(62).div_ceil(2));
        let root = u128::from(((drop >> (2 * halves)) as u64).isqrt()) << halves;
        let b = root.min(most).max(u128::from((-a).max(1) as u64));
        let ticks = |rate: u128| divide((rate * u128::from(TICKS_PER_S)) >> 32, limits.jerk) as u64;
        let onset = ticks((a + b as i128).max(0) as u128);
        // The speed to lose at −b, in 2⁻⁶⁴ steps/s: below 2⁸⁴.
        let held = divide(drop.saturating_sub(b * b), limits.jerk);
        let hold = ((held * u128::from(TICKS_PER_S) / b) >> 32) as u64;
        let release = ticks(b);
        let mut state = from;
        let segments = [(onset, -1), (hold, 0), (release, 1)].map(|(ticks, sign)| {
            let (cubic, next) = segment(state, ticks, sign * i128::from(limits.jerk));
            state = next;
            cubic
        });
        Self { segments, current: 0, started: 0, guess: 0 }
    }

    /// The stretch that a position in 2⁻³² steps from the last step made before braking lies in; `None` when
    /// at rest before. Positions asked for never go back to a stretch before.
    pub(crate) fn stretch(&mut self, position: i64) -> Option<Stretch> {
        loop {
            let segment = self.segments.get(self.current)?;
            let end = segment.at(u32::MAX);
            if position <= end && position >= segment.c[0] {
                return Some(Stretch { last: last_step_to(end), pace: None });
            }
            self.started += segment.ticks;
            self.current += 1;
            self.guess = 0;
        }
    }

    /// The time in ticks at which a position within the present stretch is passed.
    pub(crate) fn time_at(&mut self, position: i64) -> u64 {
        self.segments
            .get(self.current)
            .map_or(0, |segment| self.started + segment.solve(position, &mut self.guess))
    }

    /// The whole time in ticks.
    pub(crate) fn total(&self) -> u64 {
        self.segments.iter().map(|segment| segment.ticks).sum()
    }
}

/// The segment of `ticks` with a jerk in steps/s³, and the state at its end.
fn segment(from: State, ticks: u64, jerk: i128) -> (Cubic, State) {
    let per = |value: i128| {
        let size = divide((value.unsigned_abs() * u128::from(ticks)) >> TICKS_SHIFT, TICKS_ODD) as i128;
        if value < 0 { -size } else { size }
    };
    let (v, a) = (i128::from(from.speed), i128::from(from.acceleration));
    let change = per(jerk << 32);
    let [c1, c2, c3] = [per(v), per(per(a)) / 2, per(per(change)) / 6].map(|c| c as i64);
    let cubic = Cubic { c: [from.position, c1, c2, c3], ticks };
    let speed = v + per(a) + per(change) / 2;
    let next = State { position: cubic.end(), speed: speed.max(0) as u64, acceleration: (a + change) as i64 };
    (cubic, next)
}
