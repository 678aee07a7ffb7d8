//! The client of the rig's controller: typed requests, repeated under the same id until they are answered.
//!
//! A request is sent again whenever nothing came for a while. The controller runs each id once and answers
//! repetitions from memory, or says that it is still at it; so a lost byte costs time and nothing else. The
//! client keeps no clock: it counts reads that timed out, so it works alike on real and virtual time. On a
//! real port a thread keeps the controller's lease while the client isn't used. It speaks in motor steps.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use lobelia_protocol::{
    AXES, Answer, Axis, Command, Configuration, CrashRecord, Event, Exposure, Fault, FaultReport, Health,
    Hello, HomingReport, Outcome, Refusal, Request, Status, ToController, ToHost, Verdict,
};

use crate::rig::config::keep_out;
use crate::rig::explain;
use crate::rig::keep_alive::{self, KeepAlive};
use crate::rig::monitor;
use crate::rig::port::Port;
use crate::rig::trace::{Recorder, Step};
use crate::rig::wire::Wire;
use lobelia_base::error::{Error, Result};

/// After this long without an answer a request is sent again. The longest exchange at 9600 baud takes 0.08 s;
/// on a line that loses a third of the frames many repetitions have to fit into the controller's lease.
const PATIENCE: Duration = Duration::from_millis(120);
/// A fault's report follows the refusal within this time.
const REPORT_PATIENCE: Duration = Duration::from_millis(100);
/// After this many repetitions without a word from the controller the link counts as dead.
const REPETITIONS: u32 = 100;
/// Events kept until someone asks for them; the oldest make room.
const EVENTS: usize = 256;

/// A session with a rig's controller.
pub struct RigClient {
    wire: Arc<Mutex<Wire>>,
    session: u32,
    last_id: u32,
    faults: Vec<FaultReport>,
    crash: Option<CrashRecord>,
    events: VecDeque<Event>,
    recorder: Option<Recorder>,
    /// The steps that the last request caused, where they are looked at and the port can tell them.
    steps: Option<Vec<Step>>,
    interrupted: Option<Box<dyn Fn() -> bool + Send>>,
    repetitions: u64,
    keep_alive: Option<KeepAlive>,
}

impl std::fmt::Debug for RigClient {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RigClient").field("session", &self.session).finish_non_exhaustive()
    }
}

impl RigClient {
    /// Opens a session. Fails, before anything can move, if the controller speaks another schema.
    pub fn connect(port: Box<dyn Port>) -> Result<Self> {
        Self::connect_with(port, Hello::new(new_session()))
    }

    fn connect_with(port: Box<dyn Port>, hello: Hello) -> Result<Self> {
        let mut client = Self {
            wire: Arc::new(Mutex::new(Wire::new(port))),
            session: hello.session,
            last_id: 0,
            faults: Vec::new(),
            crash: None,
            events: VecDeque::new(),
            recorder: None,
            steps: None,
            interrupted: None,
            repetitions: 0,
            keep_alive: None,
        };
        for repetition in 0..REPETITIONS {
            client.repetitions += u64::from(repetition > 0);
            client.wire().send(&ToController::Hello(hello))?;
            let mut patience = Patience::of(PATIENCE);
            while let Some(packet) = client.receive_patiently(&mut patience)? {
                let ToHost::Hello(reply) = packet else { continue };
                if reply.hello.session != hello.session {
                    continue;
                }
                if reply.verdict == Verdict::DifferentSchema {
                    return Err(explain::different_schema(&reply));
                }
                if client.wire().is_real_time() {
                    let wire = Arc::clone(&client.wire);
                    client.keep_alive =
                        Some(KeepAlive::start(wire, hello.session, keep_alive::PERIOD, keep_alive::LONGEST));
                }
                return Ok(client);
            }
        }
        Err(silent())
    }

    fn wire(&self) -> MutexGuard<'_, Wire> {
        self.wire.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How often something had to be sent again so far.
    pub fn repetitions(&self) -> u64 {
        self.repetitions
    }

    /// While a request that takes time is run, asks this now and then; when it says true, stops the rig and
    /// fails.
    pub fn set_interrupt(&mut self, interrupted: impl Fn() -> bool + Send + 'static) {
        self.interrupted = Some(Box::new(interrupted));
    }

    /// From now on writes every request, its outcome and every pause to a trace.
    pub fn record(&mut self, recorder: Recorder) {
        if recorder.has_steps() {
            self.look_at_steps();
        }
        self.recorder = Some(recorder);
    }

    /// From now on asks the port, if it can tell, for the steps that each request causes.
    pub(crate) fn look_at_steps(&mut self) {
        let steps = self.wire().steps();
        self.steps = steps;
    }

    /// The steps that the last request caused, where they are looked at and the port can tell them.
    pub(crate) fn last_steps(&self) -> Option<&[Step]> {
        self.steps.as_deref()
    }

    /// Sets the rig's parameters. Positions stay known if the controller had the same ones already.
    pub fn configure(&mut self, configuration: &Configuration) -> Result<()> {
        for command in configuration.commands() {
            self.call(command)?;
        }
        Ok(())
    }

    /// The parameters that the controller has; nothing when it has none.
    pub fn read_parameters(&mut self) -> Result<Option<Configuration>> {
        let settings = match self.ask(Command::ReadSettings)? {
            Outcome::Done(Answer::Settings(settings)) => settings,
            Outcome::Refused(Refusal::NotConfigured) => return Ok(None),
            Outcome::Refused(refusal) => return Err(self.refused(refusal)),
            _ => return Err(out_of_place()),
        };
        let mut axes = Vec::with_capacity(AXES);
        for axis in Axis::ALL {
            match self.call(Command::ReadAxis(axis))? {
                Answer::Axis(parameters) => axes.push(parameters),
                _ => return Err(out_of_place()),
            }
        }
        let axes = axes.try_into().map_err(|_| out_of_place())?;
        let Answer::KeepOuts(keep_outs) = self.call(Command::ReadKeepOuts)? else {
            return Err(out_of_place());
        };
        Ok(Some(Configuration { axes, settings, keep_outs }))
    }

    /// How well the controller keeps up.
    pub fn health(&mut self) -> Result<Health> {
        match self.call(Command::ReadHealth)? {
            Answer::Health(health) => Ok(health),
            _ => Err(out_of_place()),
        }
    }

    /// Moves all axes as [`Self::move_to`] does, in as many moves as keep-outs want.
    pub fn go_to(&mut self, configuration: &Configuration, steps: [i32; 4]) -> Result<[i32; 4]> {
        if configuration.keep_outs.iter().all(Option::is_none) {
            return self.move_to(steps);
        }
        let from = self.status()?.positions;
        let mut positions = from;
        for stop in keep_out::way(configuration, from, steps)? {
            positions = self.move_to(stop)?;
        }
        Ok(positions)
    }

    /// Has the controller tell events from now on, see [`Self::listen`]: telemetry so often, if at all, and
    /// log lines.
    pub fn watch(&mut self, telemetry: Option<Duration>, log: bool) -> Result<()> {
        let milliseconds = |period: Duration| period.as_millis().clamp(20, u16::MAX.into()) as u16;
        let telemetry_ms = telemetry.map_or(0, milliseconds);
        self.call(Command::Watch { telemetry_ms, log }).map(|_| ())
    }

    /// Has the controller keep the parameters set, to be there after the next power-up.
    pub fn save_parameters(&mut self) -> Result<()> {
        self.call(Command::SaveParameters).map(|_| ())
    }

    /// Homes all axes; gives their positions in steps.
    pub fn home(&mut self) -> Result<[i32; 4]> {
        self.call(Command::Home).and_then(positions)
    }

    /// Homes all axes by so many slow approaches; tells how the switches' edges scatter.
    pub fn home_repeatedly(&mut self, approaches: u8) -> Result<HomingReport> {
        self.home_by(Command::HomeRepeatedly { approaches }, approaches)
    }

    /// The same for some axes (pan, tilt, roll, light); the others stay where they are.
    pub fn home_axes(&mut self, axes: [bool; 4], approaches: u8) -> Result<HomingReport> {
        self.home_by(Command::HomeAxes { axes, approaches }, approaches)
    }

    fn home_by(&mut self, command: Command, approaches: u8) -> Result<HomingReport> {
        match self.call(command)? {
            Answer::Homed(report) => Ok(report),
            Answer::At(positions) => Ok(HomingReport { positions, spread_steps: [0; 4], approaches }),
            _ => Err(out_of_place()),
        }
    }

    /// Finds the home switches without forgetting the positions; gives by how many steps each position was
    /// too high.
    pub fn check_index(&mut self) -> Result<[i32; 4]> {
        match self.call(Command::CheckIndex)? {
            Answer::Checked(lost) => Ok(lost),
            _ => Err(out_of_place()),
        }
    }

    /// Moves all axes (pan, tilt, roll, light) to absolute positions in steps, and waits until they have
    /// settled.
    pub fn move_to(&mut self, steps: [i32; 4]) -> Result<[i32; 4]> {
        self.call(Command::MoveTo(steps)).and_then(positions)
    }

    /// Switches the lamp; the level is 0 to 1 of full.
    pub fn lamp(&mut self, on: bool, level: f64) -> Result<()> {
        let level = (level.clamp(0.0, 1.0) * f64::from(u16::MAX)).round() as u16;
        self.call(Command::Lamp { on, level }).map(|_| ())
    }

    /// Fires the shutter for a time in µs. With `warm_lamp` false the lamp may be off or cold, as for dark
    /// frames.
    pub fn expose(&mut self, duration_us: u32, warm_lamp: bool) -> Result<Exposure> {
        match self.call(Command::Expose { duration_us, warm_lamp })? {
            Answer::Exposed(exposure) => Ok(exposure),
            _ => Err(out_of_place()),
        }
    }

    /// Fires the shutter as [`Self::expose`] does; the inner error is by how many µs it closed too late.
    pub fn expose_or_late(
        &mut self,
        duration_us: u32,
        warm_lamp: bool,
    ) -> Result<std::result::Result<Exposure, u32>> {
        match self.ask(Command::Expose { duration_us, warm_lamp })? {
            Outcome::Done(Answer::Exposed(exposure)) => Ok(Ok(exposure)),
            Outcome::Refused(Refusal::ShutterLate { late_us }) => Ok(Err(late_us)),
            Outcome::Refused(refusal) => Err(self.refused(refusal)),
            _ => Err(out_of_place()),
        }
    }

    /// Asks how things stand.
    pub fn status(&mut self) -> Result<Status> {
        match self.call(Command::Status)? {
            Answer::Status(status) => Ok(status),
            _ => Err(out_of_place()),
        }
    }

    /// Runs some requests to their end whatever [`Self::set_interrupt`] says meanwhile: those that make the
    /// rig safe, above all.
    pub fn uninterrupted<T>(&mut self, work: impl FnOnce(&mut Self) -> T) -> T {
        let interrupted = self.interrupted.take();
        let done = work(self);
        self.interrupted = interrupted;
        done
    }

    /// Brings all axes to rest by their ramps and waits for that.
    pub fn stop(&mut self) -> Result<()> {
        self.uninterrupted(Self::stop_and_wait)
    }

    /// Axes at rest, lamp off; the lamp is put out even if the axes do not stop.
    pub fn rest(&mut self) -> Result<()> {
        self.uninterrupted(|client| {
            let stopped = client.stop_and_wait();
            client.lamp(false, 0.0).and(stopped)
        })
    }

    /// Forgets the fault that the lease's end left, if that is the only one: nothing is wrong with the rig
    /// then. Tells whether it did.
    pub fn forgive_lease(&mut self) -> Result<bool> {
        let faults = self.status()?.faults;
        let forgiven = faults.contains(Fault::LeaseExpired) && faults.iter().count() == 1;
        if forgiven {
            self.clear_faults()?;
        }
        Ok(forgiven)
    }

    fn stop_and_wait(&mut self) -> Result<()> {
        self.call(Command::Stop)?;
        while self.status()?.busy {
            self.pause(Duration::from_millis(50))?;
        }
        Ok(())
    }

    /// Forgets the faults. The rig has to be homed again.
    pub fn clear_faults(&mut self) -> Result<()> {
        self.call(Command::ClearFaults)?;
        self.faults.clear();
        Ok(())
    }

    /// Waits until the lamp, which has to be on, is warm; tells the remaining seconds now and then.
    pub fn wait_until_warm(&mut self, mut tell: impl FnMut(u16)) -> Result<()> {
        loop {
            let lamp = self.status()?.lamp;
            if !lamp.on {
                return Err(Error::failure("the lamp is off, so it does not get warm; switch it on first"));
            }
            tell(lamp.remaining_s);
            if lamp.warm {
                return Ok(());
            }
            self.pause(Duration::from_secs(u64::from(lamp.remaining_s.clamp(1, 5))))?;
            if self.is_interrupted() {
                return Err(interrupted());
            }
        }
    }

    /// Lets time pass on the rig, real or virtual. A fault reported meanwhile is an error.
    ///
    /// Asks for the status now and then, so that the controller knows that the host is still there.
    pub fn pause(&mut self, time: Duration) -> Result<()> {
        let mut left = time;
        while !left.is_zero() {
            let part = left.min(keep_alive::PERIOD);
            left -= part;
            self.note_pause(part)?;
            let mut patience = Patience::of(part);
            while let Some(packet) = self.receive(part)? {
                if let ToHost::Event(Event::Fault(report)) = packet {
                    return Err(Error::failure(explain::fault_report(&report)));
                }
                if patience.is_over(&packet) {
                    break;
                }
            }
            if !left.is_zero() {
                self.status()?;
            }
        }
        Ok(())
    }

    /// Lets time pass, less than the controller's lease, until it is over or the controller has told
    /// something; gives the oldest event not yet given.
    pub fn listen(&mut self, time: Duration) -> Result<Option<Event>> {
        if self.events.is_empty() {
            self.note_pause(time)?;
            while self.receive(time)?.is_some() && self.events.is_empty() {}
        }
        Ok(self.events.pop_front())
    }

    fn note_pause(&mut self, time: Duration) -> Result<()> {
        self.recorder.as_mut().map_or(Ok(()), |recorder| recorder.pause(time))
    }

    /// Faults reported since they were last cleared, oldest first.
    pub fn faults(&self) -> &[FaultReport] {
        &self.faults
    }

    /// What the controller reported of a crash before it was started last.
    pub fn crash(&self) -> Option<CrashRecord> {
        self.crash
    }

    fn is_interrupted(&self) -> bool {
        self.interrupted.as_ref().is_some_and(|interrupted| interrupted())
    }

    /// Has a command run once and gives its answer; a refusal is an error.
    fn call(&mut self, command: Command) -> Result<Answer> {
        match self.ask(command)? {
            Outcome::Done(answer) => Ok(answer),
            Outcome::Refused(refusal) => Err(self.refused(refusal)),
            Outcome::Running => Err(out_of_place()),
        }
    }

    /// Has a command run once, however often it has to be sent; gives what came of it, be it a refusal.
    pub fn ask(&mut self, command: Command) -> Result<Outcome> {
        self.last_id += 1;
        let id = self.last_id;
        let packet = ToController::Request(Request { session: self.session, id, seen: id - 1, command });
        let mut silence = 0;
        // Whether the last time that it was sent nothing was said about it: it is a lost frame then, and no
        // mere question.
        let mut unheard = false;
        while silence < REPETITIONS {
            self.wire().send(&packet)?;
            self.repetitions += u64::from(unheard);
            unheard = true;
            silence += 1;
            let mut patience = Patience::of(PATIENCE);
            let mut quiet = Duration::ZERO;
            loop {
                let Some(received) = self.receive_patiently(&mut patience)? else {
                    // While the shutter is open nothing is sent, lest it closes late.
                    quiet = quiet.saturating_sub(PATIENCE);
                    if quiet.is_zero() || self.is_interrupted() {
                        break;
                    }
                    patience = Patience::of(PATIENCE);
                    continue;
                };
                silence = 0;
                let ToHost::Response(response) = received else { continue };
                if (response.session, response.id) != (self.session, id) {
                    continue;
                }
                unheard = false;
                if response.outcome == Outcome::Running {
                    if let Command::Expose { duration_us, .. } = command {
                        quiet = Duration::from_micros(duration_us.into()) + PATIENCE;
                    }
                    continue;
                }
                if self.steps.is_some() {
                    self.look_at_steps();
                }
                if let Some(recorder) = &mut self.recorder {
                    recorder.exchange(&command, &response.outcome)?;
                    recorder.steps(self.steps.clone().unwrap_or_default())?;
                }
                return Ok(response.outcome);
            }
            if self.is_interrupted() {
                self.stop()?;
                return Err(interrupted());
            }
        }
        Err(silent())
    }

    /// The sentence for a refusal; of a fault that of its report, which names the axis.
    fn refused(&mut self, refusal: Refusal) -> Error {
        // Reports come after answers.
        while self.faults.is_empty() && matches!(refusal, Refusal::Faulted(_)) {
            if !matches!(self.receive(REPORT_PATIENCE), Ok(Some(_))) {
                break;
            }
        }
        match (refusal, self.faults.last()) {
            (Refusal::Faulted(set), Some(report)) if report.axis.is_some() => explain::faulted(set, report),
            _ => explain::refusal(refusal),
        }
    }

    /// The next packet in answer to something sent, or nothing once that should be sent again.
    fn receive_patiently(&mut self, patience: &mut Patience) -> Result<Option<ToHost>> {
        let packet = self.receive(PATIENCE)?;
        Ok(packet.filter(|packet| !patience.is_over(packet)))
    }

    /// The next packet, or nothing if none comes in time; events are kept.
    fn receive(&mut self, timeout: Duration) -> Result<Option<ToHost>> {
        let packet = self.wire().receive(timeout)?;
        if let Some(ToHost::Event(event)) = packet {
            match event {
                Event::Fault(report) => self.faults.push(report),
                Event::Crashed(record) => self.crash = Some(record),
                Event::Telemetry(_) | Event::Log(_) | Event::Migrated { .. } => {}
            }
            if self.events.len() == EVENTS {
                self.events.pop_front();
            }
            self.events.push_back(event);
        }
        Ok(packet)
    }
}

/// Tells by the events that come that a time is over, since while they come no wait for a packet ends.
struct Patience {
    limit: Duration,
    /// Controller's time of the first event.
    since_us: Option<u64>,
}

impl Patience {
    fn of(limit: Duration) -> Self {
        Self { limit, since_us: None }
    }

    fn is_over(&mut self, packet: &ToHost) -> bool {
        let ToHost::Event(event) = packet else { return false };
        let Some(at_us) = monitor::time_us(event) else { return false };
        at_us.saturating_sub(*self.since_us.get_or_insert(at_us)) > self.limit.as_micros() as u64
    }
}

/// Another number for each session; it has no effect but to tell sessions apart.
pub(crate) fn new_session() -> u32 {
    let time = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    (time.as_secs() as u32).rotate_left(16) ^ time.subsec_nanos() ^ std::process::id().rotate_left(8)
}

fn positions(answer: Answer) -> Result<[i32; 4]> {
    match answer {
        Answer::At(steps) => Ok(steps),
        _ => Err(out_of_place()),
    }
}

fn out_of_place() -> Error {
    Error::failure("the rig's controller gave an answer to another question; update its firmware")
}

pub(crate) fn silent() -> Error {
    Error::failure(
        "the rig's controller does not answer; check its power and cable and that --port names it, \
         then start again (acquire: with --resume)",
    )
}

fn interrupted() -> Error {
    Error::failure("interrupted; the rig was stopped")
}

#[cfg(test)]
mod tests;
