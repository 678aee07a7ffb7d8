//! When to make each step: follows a [`Profile`] or a [`Brake`], counts the steps, and never makes one early.
//!
//! Times are in ticks of 1/256 µs; a step is due at the first whole µs after its time on the profile. A step made late
//! shifts all that follows, so that no limit is passed whatever the caller does.

use crate::motion::brake::Brake;
use crate::motion::fixed::TICK_SHIFT;
use crate::motion::profile::{Cursor, Limits, Profile, Times};

/// What a run follows.
#[derive(Debug, Clone, Default)]
enum Course {
    #[default]
    Rest,
    Run(Profile, Cursor),
    Brake(Brake),
}

/// What is due next.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) enum Due {
    /// A step.
    Step,
    /// The end of the run: the motor is at rest.
    #[default]
    End,
}

/// One motor's position and its run toward a target.
#[derive(Debug, Clone, Default)]
pub(crate) struct Stepper {
    position: i32,
    forward: bool,
    course: Course,
    limits: Limits,
    /// Of the course, in ticks.
    origin: u64,
    /// Steps made since the course began.
    made: u32,
    due: (Due, u64),
}

impl Stepper {
    /// Position in steps.
    pub(crate) fn position(&self) -> i32 {
        self.position
    }

    /// Calls the present position by another number. Only at rest.
    pub(crate) fn set_position(&mut self, position: i32) {
        self.position = position;
    }

    /// Whether a run is under way.
    pub(crate) fn running(&self) -> bool {
        !matches!(self.course, Course::Rest)
    }

    /// Whether the run goes, or the last one went, toward higher steps.
    pub(crate) fn forward(&self) -> bool {
        self.forward
    }

    /// When the next step, or the run's end, is due, in whole µs; never if not running.
    pub(crate) fn due_us(&self) -> u64 {
        if self.running() { self.due.1.div_ceil(1 << TICK_SHIFT) } else { u64::MAX }
    }

    /// What is due then.
    pub(crate) fn due(&self) -> Due {
        self.due.0
    }

    /// Starts a run from rest, in the times given.
    pub(crate) fn start(&mut self, now_us: u64, target: i32, limits: Limits, times: Times) {
        self.forward = target > self.position;
        self.limits = limits;
        self.course = Course::Run(Profile::new(target.abs_diff(self.position), times), Cursor::default());
        self.origin = now_us << TICK_SHIFT;
        self.made = 0;
        self.schedule();
    }

    /// Counts the step that was just made and plans the next.
    pub(crate) fn stepped(&mut self, now_us: u64) {
        self.position += if self.forward { 1 } else { -1 };
        self.made += 1;
        let late = (now_us << TICK_SHIFT).saturating_sub(self.due.1);
        if late >= 1 << TICK_SHIFT {
            self.origin += late;
        }
        self.schedule();
    }

    /// Comes to rest as fast as the limits allow.
    pub(crate) fn brake(&mut self, now_us: u64) {
        let Course::Run(profile, _) = &self.course else { return };
        let now = (now_us << TICK_SHIFT).max(self.origin);
        let mut state = profile.state(now - self.origin);
        state.position -= i64::from(self.made) << 32;
        self.course = Course::Brake(Brake::new(state, self.limits));
        self.origin = now;
        self.made = 0;
        self.schedule();
    }

    /// Changes the run's end to `target` without braking first; false, and nothing changed, where that can't be done:
    /// the target is behind, or too near, or the run is braking already.
    pub(crate) fn redirect(&mut self, now_us: u64, target: i32) -> bool {
        let Course::Run(profile, cursor) = &mut self.course else { return false };
        let ahead =
            if self.forward { target.checked_sub(self.position) } else { self.position.checked_sub(target) };
        let Some(ahead) = ahead.and_then(|ahead| u32::try_from(ahead).ok()).filter(|&ahead| ahead > 0) else {
            return false;
        };
        let now = (now_us << TICK_SHIFT).saturating_sub(self.origin);
        let Some(other) = profile.redirected(self.made + ahead, now) else { return false };
        *profile = other;
        *cursor = Cursor::default();
        self.schedule();
        true
    }

    /// Ceases at once, without a ramp.
    pub(crate) fn halt(&mut self) {
        self.course = Course::Rest;
    }

    /// The run's end has come.
    pub(crate) fn ended(&mut self) {
        self.course = Course::Rest;
    }

    fn schedule(&mut self) {
        let (step, total) = match &mut self.course {
            Course::Rest => return,
            Course::Run(profile, cursor) => {
                let step = self.made + 1;
                ((step <= profile.distance()).then(|| profile.step_time(step, cursor)), profile.total())
            }
            Course::Brake(brake) => (brake.step_time(self.made + 1), brake.total()),
        };
        self.due = match step {
            Some(time) => (Due::Step, self.origin + time),
            None => (Due::End, self.origin + total),
        };
    }
}

#[cfg(test)]
mod tests;
