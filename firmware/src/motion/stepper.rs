//! Plans the steps of one motor: follows a [`Profile`] or a [`Brake`] and hands the steps over in bursts,
//! ahead of their time.
//!
//! Times are in ticks of 1/256 µs. What was handed over is made: a change of plan begins after it. Bursts end
//! where a formula of the course does.

use crate::motion::brake::Brake;
use crate::motion::burst::{Burst, MARGIN, error, next_length};
use crate::motion::fixed::{STEP, TICK_SHIFT, half_way};
use crate::motion::profile::{Cursor, Limits, Profile, Stretch, Times};

/// A burst takes at most so many ticks: 4 ms.
const LONGEST: u64 = 4000 << TICK_SHIFT;
/// Length in steps that is tried where nothing is known.
const FIRST_LENGTH: u32 = 16;
/// Fewer steps than this are timed one by one, so many before a burst is tried again.
const SHORTEST: u32 = 3;
/// Most steps of a burst, so that its arithmetic keeps within 64 bits.
const MOST_STEPS: u32 = 512;

/// What a run follows.
#[derive(Debug, Clone, Default)]
enum Course {
    #[default]
    Rest,
    Run(Profile, Cursor),
    Brake(Brake),
}

impl Course {
    /// The stretch that a step lies in; `None` when there is no such step.
    fn stretch(&mut self, step: u32) -> Option<Stretch> {
        match self {
            Self::Rest => None,
            Self::Run(profile, _) => (step <= profile.distance()).then(|| profile.stretch(step)),
            Self::Brake(brake) => brake.stretch(half_way(step)),
        }
    }

    /// The time in ticks from the course's start at which a position within the present stretch is passed.
    fn time_at(&mut self, position: i64) -> u64 {
        match self {
            Self::Rest => 0,
            Self::Run(profile, cursor) => profile.time_at(position, cursor),
            Self::Brake(brake) => brake.time_at(position),
        }
    }
}

/// The first step not yet handed over, counted from the course's start.
#[derive(Debug, Clone, Copy)]
struct Next {
    step: u32,
    stretch: Stretch,
    /// Ticks from the course's start, and 2⁻³² of them.
    time: u64,
    fraction: u32,
}

/// One motor's run toward a target.
#[derive(Debug, Clone, Default)]
pub(crate) struct Stepper {
    forward: bool,
    course: Course,
    limits: Limits,
    /// Of the course, in ticks.
    origin: u64,
    next: Option<Next>,
    /// Steps handed over since the course began, and the time of the last in ticks.
    planned: u32,
    planned_until: u64,
    /// The length in steps that the next burst may have.
    length: u32,
    /// Steps to be timed one by one before a burst is tried again.
    singly: u32,
}

impl Stepper {
    /// Whether a run is under way.
    pub(crate) fn running(&self) -> bool {
        !matches!(self.course, Course::Rest)
    }

    /// Whether the run goes, or the last one went, toward higher steps.
    pub(crate) fn forward(&self) -> bool {
        self.forward
    }

    /// When the run ends, in ticks, once all its steps are handed over.
    pub(crate) fn end(&self) -> Option<u64> {
        let total = match (&self.course, &self.next) {
            (_, Some(_)) | (Course::Rest, _) => return None,
            (Course::Run(profile, _), _) => profile.total(),
            (Course::Brake(brake), _) => brake.total(),
        };
        Some(self.origin + total)
    }

    /// When the first step that was not handed over yet is due, in ticks.
    pub(crate) fn next_due(&self) -> Option<u64> {
        self.next.map(|next| self.origin + next.time)
    }

    /// Starts a run from rest over a distance, in the times given.
    pub(crate) fn start(&mut self, now: u64, forward: bool, distance: u32, limits: Limits, times: Times) {
        self.forward = forward;
        self.limits = limits;
        self.follow(Course::Run(Profile::new(distance, times), Cursor::default()), now);
    }

    /// Comes to rest as fast as the limits allow, after the steps that are handed over. It begins with the
    /// last of these, though that may be past: steps after it are due later than they were, and if those were
    /// due already, that they are late must not be lost.
    pub(crate) fn brake(&mut self) {
        let Course::Run(profile, _) = &self.course else { return };
        let from = self.origin.max(self.planned_until);
        let mut state = profile.state(from - self.origin);
        state.position -= i64::from(self.planned) << 32;
        self.follow(Course::Brake(Brake::new(state, self.limits)), from);
    }

    /// Changes the run's end to `ahead` steps after those handed over without braking first; false, and
    /// nothing changed, where that can't be done: the target is behind, or too near, or the run is braking
    /// already.
    pub(crate) fn redirect(&mut self, now: u64, ahead: i64) -> bool {
        let Course::Run(profile, cursor) = &mut self.course else { return false };
        let distance = i64::from(self.planned).checked_add(ahead).and_then(|steps| u32::try_from(steps).ok());
        let Some(distance) = distance.filter(|_| ahead > 0) else { return false };
        let from = now.max(self.planned_until).saturating_sub(self.origin);
        let Some(other) = profile.redirected(distance, from) else { return false };
        *profile = other;
        *cursor = Cursor::default();
        self.seek(self.planned + 1);
        true
    }

    /// Ceases at once, without a ramp, or notes that the run's end has come.
    pub(crate) fn halt(&mut self) {
        self.course = Course::Rest;
        self.next = None;
    }

    /// The next burst, if its first step is due before a time in ticks.
    pub(crate) fn next_burst(&mut self, before: u64) -> Option<Burst> {
        let next = self.next.filter(|next| self.origin + next.time < before)?;
        let at = self.origin + next.time + MARGIN;
        let left = next.stretch.last - next.step;
        let burst = match next.stretch.pace {
            Some(interval) if interval >> 32 < LONGEST / 2 => {
                let count = ((LONGEST << 32) / interval).min((left + 1).into()) as u32;
                let after = (interval * u64::from(count - 1)) + u64::from(next.fraction);
                self.planned_until = self.origin + next.time + (after >> 32);
                if count <= left {
                    let after = after + interval;
                    let (time, fraction) = (next.time + (after >> 32), after as u32);
                    self.next = Some(Next { step: next.step + count, time, fraction, ..next });
                }
                Burst::even(at, next.fraction, interval, count)
            }
            None if left >= SHORTEST && self.singly == 0 => self.curve(next, at, left),
            _ => self.single(next, at),
        };
        self.planned += burst.count;
        if self.planned == next.stretch.last {
            self.seek(self.planned + 1);
        }
        Some(burst)
    }

    fn single(&mut self, next: Next, at: u64) -> Burst {
        self.planned_until = self.origin + next.time;
        self.singly = self.singly.saturating_sub(1);
        if next.step < next.stretch.last {
            self.advance(next, next.step + 1);
        }
        Burst::single(at)
    }

    /// The longest burst from a step on that keeps close enough to the course.
    fn curve(&mut self, next: Next, at: u64, left: u32) -> Burst {
        let start = half_way(next.step);
        loop {
            let steps =
                if self.length < left && left < 2 * self.length { left.div_ceil(2) } else { self.length };
            let steps = steps.min(left).min(MOST_STEPS);
            if steps < SHORTEST {
                (self.length, self.singly) = (SHORTEST, SHORTEST);
                return self.single(next, at);
            }
            let sixth = i64::from(steps) * STEP / 6;
            let first = self.since(next, start + 2 * sixth);
            if first as u64 > LONGEST {
                self.length = within_longest(steps / 3, first);
                continue;
            }
            let early = self.since(next, start + sixth);
            let second = self.since(next, start + 4 * sixth);
            let late = self.since(next, start + 5 * sixth);
            let third = self.since(next, start + i64::from(steps) * STEP);
            let times = [first, second, third];
            match next_length(steps, error(times, [early, late])) {
                Err(shorter) => self.length = shorter,
                Ok(_) if third as u64 > LONGEST => self.length = within_longest(steps, third).min(steps - 1),
                Ok(length) => {
                    self.length = length.min(within_longest(steps, third));
                    let mut burst = Burst::through(at, times, steps);
                    let end = next.step + steps;
                    let time = next.time + third as u64;
                    self.planned_until = self.origin + time;
                    if end < next.stretch.last {
                        // Between the last step of this burst and the first of the next one.
                        self.planned_until -= (third - second) as u64 / u64::from(steps);
                        burst.count = steps;
                        self.next = Some(Next { step: end, time, fraction: 0, ..next });
                    }
                    return burst;
                }
            }
        }
    }

    /// Ticks from the next step until a position is passed.
    fn since(&mut self, next: Next, position: i64) -> i64 {
        self.course.time_at(position).saturating_sub(next.time) as i64
    }

    /// Makes a step of the same stretch the next one.
    fn advance(&mut self, next: Next, step: u32) {
        self.next = Some(Next { step, time: self.course.time_at(half_way(step)), fraction: 0, ..next });
    }

    fn follow(&mut self, course: Course, origin: u64) {
        self.course = course;
        self.origin = origin;
        self.planned = 0;
        self.planned_until = origin;
        (self.length, self.singly) = (FIRST_LENGTH, 0);
        self.seek(1);
    }

    /// Looks for a step on the course and makes it the next one.
    fn seek(&mut self, step: u32) {
        self.next = self.course.stretch(step).map(|stretch| {
            let time = self.course.time_at(half_way(step));
            Next { step, stretch, time, fraction: 0 }
        });
    }
}

/// Of steps that take so many ticks, about as many as a burst may last.
fn within_longest(steps: u32, ticks: i64) -> u32 {
    let most = (LONGEST >> TICK_SHIFT) as u32;
    let each = (ticks >> TICK_SHIFT) as u32 / steps.max(1);
    most / each.max(1)
}

#[cfg(test)]
mod tests;
