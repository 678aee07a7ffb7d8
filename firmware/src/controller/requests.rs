//! The part of the controller that has to do with requests: whose turn it is, what is run at once, and what
//! is answered.

use core::array;

use lobelia_protocol::{
    AXES, Answer, Command, Configuration, Fault, Happening, KEEP_OUTS, Outcome, Refusal, Request, Response,
    Settings, ToHost,
};

use super::{Controller, Running, Task, Trouble};
use crate::board::Board;
use crate::homing::Purpose;
use crate::link::Admission;
use crate::motion::parameters;
use crate::motion::pulses::PulsesCell;
use crate::storage;

/// Every axis.
const ALL: [bool; AXES] = [true; AXES];

impl<B: Board> Controller<B> {
    /// Takes a request if its turn to be taken has come, and those that were held for it.
    pub(super) fn receive(&mut self, now_us: u64, request: &Request) {
        if self.link.in_session(request) {
            self.heard_us = now_us;
        }
        self.admit(now_us, request);
        self.take_held(now_us);
    }

    fn take_held(&mut self, now_us: u64) {
        while let Some(held) = self.link.next_held(!self.waiting.is_full()) {
            self.admit(now_us, &held);
        }
    }

    fn admit(&mut self, now_us: u64, request: &Request) {
        let running = self.running.as_ref().and_then(|running| running.request);
        let pending = |id| running == Some(id) || self.waiting.iter().any(|waiting| waiting.id == id);
        match self.link.admit(request, !self.waiting.is_full(), pending) {
            Admission::Answer(outcome) => self.send(request, outcome),
            Admission::Take
                if request.command.waits() && (self.running.is_some() || !self.waiting.is_empty()) =>
            {
                // There is room, or it would not have been taken.
                let _ = self.waiting.push_back(*request);
                self.send(request, Outcome::Running);
            }
            Admission::Take => self.run(now_us, request),
        }
    }

    /// Says something about a request that isn't its final answer, or is it once more.
    fn send(&mut self, request: &Request, outcome: Outcome) {
        let response = Response { session: request.session, id: request.id, outcome };
        self.link.send(&ToHost::Response(response));
    }

    /// Begins what waits, one after the other, unless something is being run.
    pub(super) fn take_turns(&mut self, now_us: u64) {
        while self.running.is_none()
            && let Some(request) = self.waiting.pop_front()
        {
            self.run(now_us, &request);
            self.take_held(now_us);
        }
    }

    /// Refuses what waits.
    pub(super) fn refuse_waiting(&mut self, now_us: u64, refusal: Refusal) {
        while let Some(request) = self.waiting.pop_front() {
            self.answer(now_us, request.id, Outcome::Refused(refusal));
        }
    }

    fn run(&mut self, now_us: u64, request: &Request) {
        let outcome = match self.begin(now_us, request) {
            Ok(Some(answer)) => Outcome::Done(answer),
            Ok(None) => {
                self.note(now_us, Happening::Began { id: request.id });
                return self.send(request, Outcome::Running);
            }
            Err(Trouble::Refusal(refusal)) => {
                // What was asked for without knowing of this refusal must not be run.
                if request.command.acts() {
                    self.refused = request.id;
                }
                Outcome::Refused(refusal)
            }
            Err(Trouble::Pin) => {
                self.raise(now_us, Fault::Hardware, None);
                self.refused = request.id;
                Outcome::Refused(Refusal::Faulted(self.safety.faults()))
            }
        };
        match request.command.acts() {
            true => self.answer(now_us, request.id, outcome),
            // Questions would fill the log.
            false => self.link.answer(request.id, outcome),
        }
    }

    /// Answers the request of what has ended.
    pub(super) fn finish(&mut self, now_us: u64, running: &Running, outcome: Outcome) {
        let Some(id) = running.request else { return };
        // What follows a stop was asked for knowing of it.
        if matches!(outcome, Outcome::Refused(_)) && !matches!(running.task, Task::Stop) {
            self.refused = id;
        }
        self.answer(now_us, id, outcome);
    }

    fn answer(&mut self, now_us: u64, id: u32, outcome: Outcome) {
        self.link.answer(id, outcome);
        self.note(now_us, Happening::Ended { id, done: matches!(outcome, Outcome::Done(_)) });
    }

    /// Runs a command, or begins one that takes time and is answered at its end.
    fn begin(&mut self, now_us: u64, request: &Request) -> Result<Option<Answer>, Trouble> {
        let moves = request.command.waits() || matches!(request.command, Command::Retarget(_));
        if moves && request.seen < self.refused {
            return Err(Refusal::Skipped { after: self.refused }.into());
        }
        match request.command {
            Command::Status => Ok(Some(Answer::Status(self.status(now_us)?))),
            Command::ReadAxis(axis) => Ok(Some(Answer::Axis(self.configured()?.axes[axis.index()]))),
            Command::ReadSettings => Ok(Some(Answer::Settings(self.configured()?.settings))),
            Command::ReadKeepOuts => Ok(Some(Answer::KeepOuts(self.configured()?.keep_outs))),
            Command::ReadHealth => Ok(Some(Answer::Health(self.health()))),
            Command::Watch { telemetry_ms, log } => {
                self.set_watch(now_us, telemetry_ms, log)?;
                Ok(Some(Answer::Nothing))
            }
            Command::Stop => {
                self.stop()?;
                self.refuse_waiting(now_us, Refusal::Stopped);
                Ok(Some(Answer::Nothing))
            }
            Command::Lamp { on, level } => {
                if on {
                    // Without parameters there would be no lease, and no longest time.
                    self.configured()?;
                    self.safety.check()?;
                }
                self.lamp.switch(now_us, on, level)?;
                self.note(now_us, Happening::Lamp { on, level });
                Ok(Some(Answer::Nothing))
            }
            Command::ClearFaults => {
                self.safety.clear()?;
                self.alarmed = 0;
                self.note(now_us, Happening::FaultsCleared);
                Ok(Some(Answer::Nothing))
            }
            Command::PrepareAxis { axis, parameters } => {
                parameters::validate_axis(axis, &parameters)?;
                self.prepared[axis.index()] = Some(parameters);
                Ok(Some(Answer::Nothing))
            }
            Command::PrepareKeepOuts(keep_outs) => {
                self.prepared_keep_outs = Some(keep_outs);
                Ok(Some(Answer::Nothing))
            }
            Command::Configure(settings) => {
                self.configure(now_us, settings)?;
                Ok(Some(Answer::Nothing))
            }
            Command::SaveParameters => {
                let configuration = self.configured()?;
                // Nothing is being run, but the lamp may burn: nobody could put it out while the memory is
                // written.
                if self.lamp.is_on() {
                    return Err(Refusal::NotAtRest.into());
                }
                let storage = self.options.storage.as_mut();
                let saved = storage.is_some_and(|storage| storage::save(&mut **storage, &configuration));
                if saved { Ok(Some(Answer::Nothing)) } else { Err(Refusal::NoStorage.into()) }
            }
            Command::Home
            | Command::HomeRepeatedly { .. }
            | Command::HomeAxes { .. }
            | Command::CheckIndex
            | Command::MoveTo(_)
            | Command::Retarget(_)
            | Command::Expose { .. } => {
                let task = self.begin_task(now_us, &request.command)?;
                self.running = Some(Running { task, request: Some(request.id) });
                Ok(None)
            }
        }
    }

    /// Begins what takes time.
    fn begin_task(&mut self, now_us: u64, command: &Command) -> Result<Task, Trouble> {
        let configuration = self.configured()?;
        self.safety.check()?;
        match *command {
            Command::MoveTo(targets) => self.begin_move(now_us, &configuration, targets),
            Command::Retarget(targets) => self.retarget(now_us, &configuration, targets),
            Command::Expose { duration_us, warm_lamp } => self.begin_exposure(now_us, duration_us, warm_lamp),
            Command::CheckIndex => {
                self.check_positions()?;
                self.begin_homing(now_us, &configuration, Purpose::Check, ALL)
            }
            Command::HomeRepeatedly { approaches } => {
                self.prepare_homing(now_us, &configuration, Purpose::Home { approaches }, ALL)
            }
            Command::HomeAxes { axes, approaches } => {
                self.prepare_homing(now_us, &configuration, Purpose::Home { approaches }, axes)
            }
            _ => self.prepare_homing(now_us, &configuration, Purpose::Home { approaches: 1 }, ALL),
        }
    }

    fn configured(&self) -> Result<Configuration, Refusal> {
        self.configuration.ok_or(Refusal::NotConfigured)
    }

    /// Takes the parameters that are stored, unless there are none or the board can't obey them.
    #[inline(never)]
    pub(super) fn adopt_stored(&mut self, now_us: u64) {
        let Some(storage) = &mut self.options.storage else { return };
        let Some((configuration, older)) = storage::load_any(&mut **storage) else { return };
        if parameters::validate(&configuration, self.options.most_steps_per_s).is_err()
            || self.check_alarms(&configuration).is_err()
        {
            return;
        }
        let Configuration { settings, .. } = &configuration;
        self.pulses.with(|pulses| pulses.trains.set_timing(settings.pulse_us, settings.direction_setup_us));
        if self.wire(now_us, &configuration).is_err() {
            self.raise(now_us, Fault::Hardware, None);
        }
        self.configuration = Some(configuration);
        self.migrated = older;
    }

    /// Another configuration makes positions unknown: steps may mean something else.
    fn configure(&mut self, now_us: u64, settings: Settings) -> Result<(), Trouble> {
        let set = self.configuration.as_ref().map(|configuration| configuration.axes);
        let axis = |k: usize| self.prepared[k].or(set.map(|axes| axes[k]));
        let [Some(pan), Some(tilt), Some(roll), Some(light)] = array::from_fn(axis) else {
            return Err(Refusal::NotConfigured.into());
        };
        let keep_outs = self.prepared_keep_outs.or(self.configuration.as_ref().map(|set| set.keep_outs));
        let keep_outs = keep_outs.unwrap_or([None; KEEP_OUTS]);
        let configuration = Configuration { axes: [pan, tilt, roll, light], settings, keep_outs };
        parameters::validate(&configuration, self.options.most_steps_per_s)?;
        self.check_alarms(&configuration)?;
        self.set_up_drivers(&configuration)?;
        self.wire(now_us, &configuration)?;
        self.pulses.with(|pulses| pulses.trains.set_timing(settings.pulse_us, settings.direction_setup_us));
        if self.configuration.replace(configuration) != Some(configuration) {
            for (axis, p) in self.axes.iter_mut().zip(&configuration.axes) {
                axis.forget(&mut self.pulses, p);
            }
        }
        Ok(())
    }
}
