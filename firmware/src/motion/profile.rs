//! A run from rest to rest in seven segments: jerk up, hold, jerk down; cruise; and the same mirrored.
//!
//! Three times define it: t_j of a segment with jerk, t_a at constant acceleration, t_v at constant speed.
//! With X = t_j + t_a and Y = 2t_j + t_a + t_v a run over d has
//!
//! speed d/Y, acceleration d/(X·Y), jerk d/(t_j·X·Y), and takes 4t_j + 2t_a + t_v in all.
//!
//! So times rounded up to whole ticks, or stretched, keep every limit and still end exactly on target. The
//! motor steps when the profile is halfway between two steps: the first half a step after the start, the last
//! half a step before the end.

use crate::motion::fixed::{Cubic, TICKS_PER_S, cube_root_up, half_way, last_step_to, mul_div, root_up};

/// What an axis's motion may not exceed: steps/s, steps/s², steps/s³; all above 0.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Limits {
    pub(crate) speed: u32,
    pub(crate) acceleration: u32,
    pub(crate) jerk: u32,
}

/// The three times of a profile, in ticks.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Times {
    jerk: u64,
    hold: u64,
    cruise: u64,
}

impl Times {
    /// The shortest within the limits for a distance in steps, each rounded up.
    pub(crate) fn shortest(distance: u32, limits: Limits) -> Self {
        if distance == 0 {
            return Self::default();
        }
        let [d, v, a, j] = [distance, limits.speed, limits.acceleration, limits.jerk].map(u128::from);
        let s = u128::from(TICKS_PER_S);
        // To the highest speed, then the rest of the way at it.
        let reaches_acceleration = v * j >= a * a;
        let jerk = if reaches_acceleration { (a * s).div_ceil(j) } else { root_up((v * s * s).div_ceil(j)) };
        let hold = if reaches_acceleration { (v * s).div_ceil(a).saturating_sub(jerk) } else { 0 };
        if let Some(cruise) = (d * s).div_ceil(v).checked_sub(2 * jerk + hold) {
            return Self::from_wide(jerk, hold, cruise);
        }
        // d = a·x·(x + t_j) for x = t_j + t_a.
        let x = (root_up(jerk * jerk + (4 * d * s * s).div_ceil(a)) - jerk).div_ceil(2);
        if reaches_acceleration && x >= jerk {
            return Self::from_wide(jerk, x - jerk, 0);
        }
        // d = 2·j·t_j³
        Self::from_wide(cube_root_up((d * s * s * s).div_ceil(2 * j)), 0, 0)
    }

    fn from_wide(jerk: u128, hold: u128, cruise: u128) -> Self {
        Self { jerk: (jerk as u64).max(1), hold: hold as u64, cruise: cruise as u64 }
    }

    /// The whole run's time in ticks.
    pub(crate) fn total(&self) -> u64 {
        4 * self.jerk + 2 * self.hold + self.cruise
    }

    /// The same run in `total` ticks, which must not be fewer than it has.
    pub(crate) fn stretched(&self, total: u64) -> Self {
        let own = self.total();
        if own == 0 {
            return *self;
        }
        let longer = |ticks: u64| (u128::from(ticks) * u128::from(total)).div_ceil(u128::from(own)) as u64;
        let (jerk, hold) = (longer(self.jerk), longer(self.hold));
        match total.checked_sub(4 * jerk + 2 * hold) {
            Some(cruise) if cruise >= self.cruise => Self { jerk, hold, cruise },
            // Rounding up took a tick too many from a short cruise.
            _ => Self { cruise: self.cruise + (total - own), ..*self },
        }
    }

    fn ramp(&self) -> u64 {
        2 * self.jerk + self.hold
    }

    fn x(&self) -> u64 {
        self.jerk + self.hold
    }

    fn y(&self) -> u64 {
        self.ramp() + self.cruise
    }
}

/// The profile of one run.
#[derive(Debug, Clone, Default)]
pub(crate) struct Profile {
    distance: u32,
    times: Times,
    /// The three segments of the ramp up; the ramp down is their mirror image.
    ramp: [Cubic; 3],
    /// The cruising speed: so many steps in so many ticks.
    pace: (u64, u64),
    /// The time from step to step at that speed, in 2⁻³² ticks rounded down; the highest number where it is
    /// more.
    interval: u64,
}

/// Where the search for the last time ended: the next one, near it, costs little. Any order is right.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Cursor {
    segment: Option<(bool, usize)>,
    guess: u32,
}

/// A part of a course on which one formula holds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Stretch {
    /// Its last step.
    pub(crate) last: u32,
    /// The time from step to step in 2⁻³² ticks, where it is the same throughout.
    pub(crate) pace: Option<u64>,
}

/// Position, speed and acceleration at an instant: 2⁻³² steps, 2⁻³² steps/s, 2⁻³² steps/s².
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct State {
    pub(crate) position: i64,
    pub(crate) speed: u64,
    pub(crate) acceleration: i64,
}

impl Profile {
    /// The profile over a distance in steps in the times given.
    pub(crate) fn new(distance: u32, times: Times) -> Self {
        if distance == 0 {
            return Self::default();
        }
        let Times { jerk, hold, .. } = times;
        let whole = u64::from(distance) << 32;
        // d·t_j/(X·Y)·t, what the acceleration gains over a time t in a time t_j, over two.
        let over = |t: u64, again: u64| (mul_div(mul_div(whole, t, times.x()), again, times.y()) / 2) as i64;
        let [jj, jh, hh] = [over(jerk, jerk), over(jerk, hold), over(hold, hold)];
        let sixth = (mul_div(mul_div(whole, jerk, times.x()), jerk, times.y()) / 6) as i64;
        let up = Cubic { c: [0, 0, 0, sixth], ticks: jerk };
        let level = Cubic { c: [up.end(), jh, hh, 0], ticks: hold };
        let end = (mul_div(whole, times.ramp(), times.y()) / 2) as i64;
        let c1 = jj + 2 * jh;
        // Its constant makes it end exactly where the cruise begins.
        let down = Cubic { c: [end - c1 - jj + sixth, c1, jj, -sixth], ticks: jerk };
        let pace = (u64::from(distance), times.y());
        let interval = (u128::from(pace.1) << 32) / u128::from(pace.0);
        let interval = u64::try_from(interval).unwrap_or(u64::MAX);
        Self { distance, times, ramp: [up, level, down], pace, interval }
    }

    /// Distance in steps.
    pub(crate) fn distance(&self) -> u32 {
        self.distance
    }

    /// The whole time in ticks.
    pub(crate) fn total(&self) -> u64 {
        self.times.total()
    }

    /// Where the ramp up ends, in 2⁻³² steps.
    fn ramp_end(&self) -> i64 {
        self.ramp[2].end()
    }

    /// The stretch that a step, 1 to the distance, lies in.
    pub(crate) fn stretch(&self, step: u32) -> Stretch {
        let whole = i64::from(self.distance) << 32;
        let position = half_way(step);
        let left = whole - position;
        if position <= self.ramp_end() {
            let next = self.ramp.get(self.segment(position) + 1);
            let end = next.map_or(self.ramp_end(), |next| next.c[0] - 1);
            Stretch { last: last_step_to(end), pace: None }
        } else if left <= self.ramp_end() {
            let end = self.ramp[self.segment(left)].c[0];
            Stretch { last: last_step_to(whole - end).min(self.distance), pace: None }
        } else {
            Stretch { last: last_step_to(whole - self.ramp_end() - 1), pace: Some(self.interval) }
        }
    }

    /// The time in ticks from the start at which a position in 2⁻³² steps is passed.
    pub(crate) fn time_at(&self, position: i64, cursor: &mut Cursor) -> u64 {
        let left = (i64::from(self.distance) << 32) - position;
        if position <= self.ramp_end() {
            self.ramp_time(position, true, cursor)
        } else if left <= self.ramp_end() {
            self.total() - self.ramp_time(left, false, cursor)
        } else {
            let (steps, ticks) = self.pace;
            let into = (position - self.ramp_end()) as u64;
            self.times.ramp() + ((u128::from(into) * u128::from(ticks) / u128::from(steps)) >> 32) as u64
        }
    }

    /// The segment of the ramp in which a position lies.
    fn segment(&self, position: i64) -> usize {
        (0..2).find(|&k| position < self.ramp[k + 1].c[0]).unwrap_or(2)
    }

    fn ramp_time(&self, position: i64, up: bool, cursor: &mut Cursor) -> u64 {
        let segment = self.segment(position);
        if cursor.segment != Some((up, segment)) {
            cursor.segment = Some((up, segment));
            cursor.guess = if up && segment > 0 { 0 } else { u32::MAX };
        }
        self.segment_start(segment) + self.ramp[segment].solve(position, &mut cursor.guess)
    }

    fn segment_start(&self, segment: usize) -> u64 {
        self.ramp[..segment].iter().map(|cubic| cubic.ticks).sum()
    }

    /// The same run with another length of cruise, so that it ends `distance` steps from its start; `None` if
    /// at `now` ticks it's too late for that, or if the cruise would be shorter than nothing.
    pub(crate) fn redirected(&self, distance: u32, now: u64) -> Option<Self> {
        let (steps, ticks) = self.pace;
        let change = mul_div(u64::from(distance.abs_diff(self.distance)), ticks, steps);
        let cruise = if distance >= self.distance {
            self.times.cruise.checked_add(change)?
        } else {
            self.times.cruise.checked_sub(change)?
        };
        let brakes_at = self.times.ramp() + cruise.min(self.times.cruise);
        let times = Times { cruise, ..self.times };
        (now < brakes_at).then_some(Self { distance, times, ..self.clone() })
    }

    /// Where it is at `now` ticks after the start.
    pub(crate) fn state(&self, now: u64) -> State {
        let total = self.total();
        let whole = i64::from(self.distance) << 32;
        let ramp = self.times.ramp();
        if now >= total {
            return State { position: whole, speed: 0, acceleration: 0 };
        }
        if (ramp..=total - ramp).contains(&now) {
            let (steps, ticks) = self.pace;
            let gone = ((u128::from(now - ramp) * u128::from(steps)) << 32) / u128::from(ticks);
            let speed = ((u128::from(steps) * u128::from(TICKS_PER_S)) << 32) / u128::from(ticks);
            return State { position: self.ramp_end() + gone as i64, speed: speed as u64, acceleration: 0 };
        }
        if now < ramp {
            return self.ramp_state(now);
        }
        let mirrored = self.ramp_state(total - now);
        State { position: whole - mirrored.position, acceleration: -mirrored.acceleration, ..mirrored }
    }

    fn ramp_state(&self, now: u64) -> State {
        let segment = (0..2).rev().find(|&k| now >= self.segment_start(k + 1)).map_or(0, |k| k + 1);
        let cubic = &self.ramp[segment];
        let u = (u128::from(now - self.segment_start(segment)) << 32) / u128::from(cubic.ticks.max(1));
        let u = u.min(u128::from(u32::MAX)) as u32;
        let per_second = |value: i64| {
            (i128::from(value) * i128::from(TICKS_PER_S) / i128::from(cubic.ticks.max(1))) as i64
        };
        State {
            position: cubic.at(u),
            speed: per_second(cubic.slope(u)).max(0) as u64,
            acceleration: per_second(per_second(cubic.curvature(u))),
        }
    }
}
