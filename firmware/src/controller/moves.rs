//! The part of the controller that has to do with axes: what may begin a move, how axes move together, and
//! what each step can give away.

use core::array;

use lobelia_protocol::{AXES, Answer, Axis, Configuration, Fault, Field, HomingReport, Outcome, Refusal};

use super::{Controller, Running, Task, Trouble};
use crate::board::Board;
use crate::homing::{Homing, Progress, Purpose};
use crate::motion::axis::{AxisDrive, Plan};
use crate::motion::keep_out::{self, Sweep};
use crate::motion::pulses::{PulsesCell, Trip};
use crate::pin::PinFailure;

/// How often a homing may approach its switch.
const APPROACHES: core::ops::RangeInclusive<u8> = 1..=100;

impl<B: Board> Controller<B> {
    pub(super) fn begin_homing(
        &mut self,
        now_us: u64,
        configuration: &Configuration,
        purpose: Purpose,
        axes: [bool; AXES],
    ) -> Result<Task, Trouble> {
        if axes == [false; AXES] {
            return Err(Refusal::BadParameter { axis: None, field: Field::Axes }.into());
        }
        if let Purpose::Home { approaches } = purpose
            && !APPROACHES.contains(&approaches)
        {
            return Err(Refusal::BadParameter { axis: None, field: Field::Approaches }.into());
        }
        if let Purpose::Home { .. } = purpose {
            self.check_winding(configuration, axes)?;
            let known = self.axes.each_ref().map(|axis| axis.known);
            keep_out::check_homing(configuration, axes, known, self.positions())?;
        }
        let mut searches = [const { None }; AXES];
        self.home_next(now_us, configuration, purpose, axes, &mut searches)?;
        Ok(Task::Home(purpose, axes, searches))
    }

    /// Refuses to home axes that earlier homings have wound up by over a turn more than moves may: each that
    /// finds nothing adds one.
    fn check_winding(&mut self, configuration: &Configuration, axes: [bool; AXES]) -> Result<(), Refusal> {
        let positions = self.positions();
        let too_far = |axis: &Axis| {
            let k = axis.index();
            axes[k] && self.axes[k].is_wound_beyond(positions[k], &configuration.axes[k])
        };
        Axis::ALL.into_iter().find(too_far).map_or(Ok(()), |axis| Err(Refusal::OutOfLimits(axis)))
    }

    /// Begins to home those of the chosen axes that have not begun and are first in the order; false when all
    /// have.
    pub(super) fn home_next(
        &mut self,
        now_us: u64,
        configuration: &Configuration,
        purpose: Purpose,
        axes: [bool; AXES],
        searches: &mut [Option<Homing>; AXES],
    ) -> Result<bool, PinFailure> {
        let order = |k: usize| configuration.axes[k].home_order;
        let left = |k: &usize, searches: &[Option<Homing>; AXES]| axes[*k] && searches[*k].is_none();
        let Some(first) = (0..AXES).filter(|k| left(k, searches)).map(order).min() else { return Ok(false) };
        for k in (0..AXES).filter(|&k| order(k) == first) {
            if left(&k, searches) {
                let (axis, parameters) = (&mut self.axes[k], &configuration.axes[k]);
                searches[k] = Some(Homing::start(now_us, purpose, axis, &mut self.pulses, parameters)?);
            }
        }
        Ok(true)
    }

    /// The answer to a search that has ended.
    pub(super) fn found(&mut self, purpose: Purpose, searches: &[Option<Homing>; AXES]) -> Answer {
        let of = |get: fn(&Homing) -> i32| searches.each_ref().map(|search| search.as_ref().map_or(0, get));
        match purpose {
            Purpose::Home { approaches: 1 } => Answer::At(self.positions()),
            Purpose::Home { approaches } => Answer::Homed(HomingReport {
                positions: self.positions(),
                spread_steps: of(|search| search.spread() as i32).map(i32::unsigned_abs),
                approaches,
            }),
            Purpose::Check => Answer::Checked(of(Homing::lost)),
        }
    }

    /// At rest, settled: the answer; or the fault that a check has shown, told after the answer.
    pub(super) fn settled(
        &mut self,
        now_us: u64,
        found: Option<Answer>,
    ) -> Result<Outcome, (Fault, Option<Axis>)> {
        let answer = found.unwrap_or(Answer::At(self.positions()));
        let (Answer::Checked(lost), Some(configuration)) = (answer, &self.configuration) else {
            return Ok(Outcome::Done(answer));
        };
        let off = |axis: &Axis| {
            lost[axis.index()].unsigned_abs() > configuration.axes[axis.index()].index_tolerance.into()
        };
        if let Some(axis) = Axis::ALL.into_iter().find(off) {
            self.raise(now_us, Fault::StepsLost, Some(axis));
        }
        Ok(Outcome::Done(answer))
    }

    pub(super) fn check_positions(&self) -> Result<(), Refusal> {
        match Axis::ALL.into_iter().find(|axis| !self.axes[axis.index()].known) {
            Some(axis) => Err(Refusal::PositionUnknown(axis)),
            None => Ok(()),
        }
    }

    pub(super) fn begin_move(
        &mut self,
        now_us: u64,
        configuration: &Configuration,
        targets: [i32; AXES],
    ) -> Result<Task, Trouble> {
        self.check_positions()?;
        check_limits(configuration, targets)?;
        let positions = self.positions();
        let plans = self.plans(configuration, positions, targets);
        let sweeps = array::from_fn(|k| plans[k].sweep(positions[k]));
        keep_out::check(&configuration.keep_outs, &sweeps)?;
        self.swept = sweeps;
        self.start_move(now_us, configuration, targets).map_err(Trouble::from)
    }

    /// The way of each axis.
    fn plans(
        &self,
        configuration: &Configuration,
        positions: [i32; AXES],
        targets: [i32; AXES],
    ) -> [Plan; AXES] {
        array::from_fn(|k| self.axes[k].plan(positions[k], targets[k], &configuration.axes[k]))
    }

    /// Starts a move of all axes from rest.
    pub(super) fn start_move(
        &mut self,
        now_us: u64,
        configuration: &Configuration,
        targets: [i32; AXES],
    ) -> Result<Task, PinFailure> {
        let positions = self.positions();
        let mut plans = self.plans(configuration, positions, targets);
        if configuration.settings.coordinated {
            let slowest = plans.iter().map(Plan::total).max().unwrap_or(0);
            plans = plans.map(|plan| plan.stretched(slowest));
        }
        let mut settle_ms = 0;
        for (k, plan) in plans.iter().enumerate().filter(|(_, plan)| plan.total() > 0) {
            self.axes[k].begin(&mut self.pulses, now_us, plan, targets[k], &configuration.axes[k])?;
            settle_ms = configuration.axes[k].settle_ms.max(settle_ms);
        }
        Ok(Task::Move { settle_ms })
    }

    /// Gives the move being run, if there is one, other targets.
    pub(super) fn retarget(
        &mut self,
        now_us: u64,
        configuration: &Configuration,
        targets: [i32; AXES],
    ) -> Result<Task, Trouble> {
        let task = self.running.as_ref().map(|running| &running.task);
        let Some(Task::Move { .. } | Task::Turn { .. } | Task::Settle { found: None, .. }) = task else {
            return if task.is_some() {
                Err(Refusal::Busy.into())
            } else {
                self.begin_move(now_us, configuration, targets)
            };
        };
        self.check_positions()?;
        check_limits(configuration, targets)?;
        // Braking leads nowhere where the move would not have come, nor does what follows beyond the take-up
        // below its target.
        let sweeps: [Sweep; AXES] = array::from_fn(|k| {
            let below = targets[k].saturating_sub_unsigned(configuration.axes[k].take_up_steps);
            keep_out::hull(self.swept[k], [below, targets[k]])
        });
        keep_out::check(&configuration.keep_outs, &sweeps)?;
        self.swept = sweeps;
        if let Some(Running { request: Some(id), .. }) = self.running.take() {
            self.link.answer(id, Outcome::Refused(Refusal::Stopped));
        }
        self.refuse_waiting(now_us, Refusal::Stopped);
        // Axes that go on alone would not arrive with the others.
        for ((axis, p), target) in self.axes.iter_mut().zip(&configuration.axes).zip(targets) {
            if configuration.settings.coordinated || !axis.redirect(&mut self.pulses, now_us, target, p) {
                axis.stop();
            }
        }
        Ok(Task::Turn { targets })
    }

    /// Goes on with what the axis does, and minds what made it cease; tells whether it waits for another poll
    /// to change its plan.
    pub(super) fn advance_axis(&mut self, now_us: u64, axis: Axis, task: &mut Task) -> Result<bool, Fault> {
        let drive = &mut self.axes[axis.index()];
        let pulses = &mut self.pulses;
        match pulses.with(|pulses| pulses.take_trip(axis.index())) {
            None => {}
            Some(Trip::Limit) => return Err(Fault::LimitHit),
            Some(Trip::Pin) => return Err(Fault::Hardware),
            Some(Trip::Late) => return Err(Fault::StepsLate),
        }
        let Some(parameters) = self.configuration.as_ref().map(|all| &all.axes[axis.index()]) else {
            return Ok(false);
        };
        if let Task::Home(.., searches) = task
            && let Some(search) = &mut searches[axis.index()]
        {
            search.watch(now_us, drive, pulses, parameters);
        }
        drive.poll(pulses, now_us, &mut self.changes).map_err(|_| Fault::Hardware)?;
        if let Task::Home(.., searches) = task
            && let Some(search) = &mut searches[axis.index()]
            && !drive.moving()
        {
            if search.goes_on() && !self.changes.take() {
                return Ok(true);
            }
            let progress = search.rested(now_us, drive, pulses, parameters).map_err(|_| Fault::Hardware)?;
            match progress {
                Progress::Failed => return Err(Fault::HomingFailed),
                Progress::Stuck => return Err(Fault::SwitchStuck),
                Progress::Seeking | Progress::Measured => {}
            }
        }
        Ok(false)
    }

    /// Plans for the axis that would run out of steps first, one a poll: what that takes never adds up over
    /// all axes.
    pub(super) fn plan_ahead(&mut self, now_us: u64) {
        let pulses = &mut self.pulses;
        let runs_out = |axis: &AxisDrive<B>| axis.runs_out(pulses, now_us);
        let first = self.axes.each_ref().map(runs_out).into_iter().enumerate();
        if let Some((_, axis)) = first.filter_map(|(axis, at)| Some((at?, axis))).min() {
            self.axes[axis].hand_over(&mut self.pulses, now_us);
        }
    }
}

/// Refuses targets beyond the soft limits.
fn check_limits(configuration: &Configuration, targets: [i32; AXES]) -> Result<(), Refusal> {
    let beyond = |axis: &Axis| {
        let p = &configuration.axes[axis.index()];
        !(p.min_steps..=p.max_steps).contains(&targets[axis.index()])
    };
    Axis::ALL.into_iter().find(beyond).map_or(Ok(()), |axis| Err(Refusal::OutOfLimits(axis)))
}
