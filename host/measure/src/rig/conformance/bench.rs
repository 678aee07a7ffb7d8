//! What the checks do everything with: raw requests that can be repeated, left unanswered for a while, or
//! bent.

use std::collections::HashSet;
use std::fmt::Debug;
use std::time::Duration;

use lobelia_protocol::{
    AXES, Answer, Command, Configuration, Event, Hello, HelloReply, Outcome, Refusal, Request, Response,
    SafeCommand, SafeState, Status, ToController, ToHost,
};

use crate::rig::client::new_session;
use crate::rig::port::Port;
use crate::rig::wire::Wire;
use lobelia_base::error::Error;

/// After this long without a word a request is sent again.
const PATIENCE: Duration = Duration::from_millis(300);
/// After this many repetitions without a word an answer counts as missing.
const REPETITIONS: u32 = 10;
/// Between two looks at something that changes.
pub(super) const LOOK: Duration = Duration::from_millis(5);
/// So many looks are enough for a move to begin or an axis to come to rest.
const LOOKS: u32 = 20_000;

/// Why a check fails.
#[derive(Debug)]
pub(super) enum Trouble {
    /// The controller did something else than it should.
    Wrong(String),
    /// The port failed.
    Link(Error),
}

impl From<Error> for Trouble {
    fn from(error: Error) -> Self {
        Self::Link(error)
    }
}

pub(super) type Result<T> = std::result::Result<T, Trouble>;

/// Fails with `why` unless `holds`.
pub(super) fn ensure(holds: bool, why: impl FnOnce() -> String) -> Result<()> {
    if holds { Ok(()) } else { Err(Trouble::Wrong(why())) }
}

/// Fails unless both are the same.
pub(super) fn same<T: PartialEq + Debug>(what: &str, expected: &T, found: &T) -> Result<()> {
    ensure(expected == found, || format!("{what}: {expected:?} was expected, {found:?} came"))
}

/// The controller under test.
pub(super) struct Bench {
    wire: Wire,
    /// What the rig's file tells.
    pub(super) configuration: Configuration,
    pub(super) session: u32,
    last_id: u32,
    /// All answers up to this id have come, and these beyond it.
    seen: u32,
    answered: HashSet<u32>,
    answers: Vec<Response>,
    /// Events that came since they were last cleared.
    pub(super) events: Vec<Event>,
}

impl Bench {
    pub(super) fn new(port: Box<dyn Port>, configuration: Configuration) -> Self {
        let session = new_session();
        Self {
            wire: Wire::new(port),
            configuration,
            session,
            last_id: 0,
            seen: 0,
            answered: HashSet::new(),
            answers: Vec::new(),
            events: Vec::new(),
        }
    }

    /// Opens a new session.
    pub(super) fn open(&mut self) -> Result<HelloReply> {
        self.session = self.session.wrapping_add(1);
        (self.last_id, self.seen) = (0, 0);
        self.answered.clear();
        self.answers.clear();
        self.greet(Hello::new(self.session))
    }

    /// Sends a hello and gives the reply.
    pub(super) fn greet(&mut self, hello: Hello) -> Result<HelloReply> {
        for _ in 0..REPETITIONS {
            self.wire.send(&ToController::Hello(hello))?;
            while let Some(packet) = self.wire.receive(PATIENCE)? {
                if let ToHost::Hello(reply) = packet {
                    return Ok(reply);
                }
            }
        }
        Err(Trouble::Wrong("no reply to a hello".to_owned()))
    }

    /// Asks in the words of every version.
    pub(super) fn safe(&mut self, command: SafeCommand) -> Result<SafeState> {
        for _ in 0..REPETITIONS {
            self.wire.send(&ToController::Safe(command))?;
            while let Some(packet) = self.wire.receive(PATIENCE)? {
                match packet {
                    ToHost::Safe(state) if state.command == command => return Ok(state),
                    packet => self.keep(Some(packet)),
                }
            }
        }
        Err(Trouble::Wrong(format!("no answer to {command:?}")))
    }

    /// The next request, not sent.
    pub(super) fn request(&mut self, command: Command) -> Request {
        self.last_id += 1;
        while self.answered.remove(&(self.seen + 1)) {
            self.seen += 1;
        }
        // A forerunner that was never sent counts as seen in time.
        let seen = self.seen.max(self.last_id.saturating_sub(8));
        Request { session: self.session, id: self.last_id, seen, command }
    }

    /// Takes the last request back: its id is free again, as it never arrived.
    pub(super) fn forget(&mut self, request: &Request) {
        self.last_id = request.id - 1;
    }

    pub(super) fn send(&mut self, request: &Request) -> Result<()> {
        Ok(self.wire.send(&ToController::Request(*request))?)
    }

    pub(super) fn send_bytes(&mut self, bytes: &[u8]) -> Result<()> {
        Ok(self.wire.send_bytes(bytes)?)
    }

    /// Sends a request and doesn't wait for its answer.
    pub(super) fn begin(&mut self, command: Command) -> Result<Request> {
        let request = self.request(command);
        self.send(&request)?;
        Ok(request)
    }

    /// Receives for some time and keeps what answers come.
    pub(super) fn pause(&mut self, time: Duration) -> Result<()> {
        let slice = time.min(Duration::from_millis(10));
        for _ in 0..time.div_duration_f64(slice).ceil() as u32 {
            let packet = self.wire.receive(slice)?;
            self.keep(packet);
        }
        Ok(())
    }

    fn keep(&mut self, packet: Option<ToHost>) {
        if let Some(ToHost::Event(event)) = packet {
            self.events.push(event);
        }
        if let Some(ToHost::Response(response)) = packet {
            let pending = [Outcome::Running, Outcome::Refused(Refusal::OutOfWindow)];
            if !pending.contains(&response.outcome) && response.session == self.session {
                self.answered.insert(response.id);
            }
            self.answers.push(response);
        }
    }

    /// Answers to a request that came so far, oldest first.
    pub(super) fn answers(&self, request: &Request) -> Vec<Outcome> {
        let own = |response: &&Response| (response.session, response.id) == (request.session, request.id);
        self.answers.iter().filter(own).map(|response| response.outcome).collect()
    }

    /// The final outcome of a request that was sent; it's sent again while there is none.
    pub(super) fn outcome(&mut self, request: &Request) -> Result<Outcome> {
        let mut silence = 0;
        loop {
            let finished = |outcome: &Outcome| *outcome != Outcome::Running;
            if let Some(outcome) = self.answers(request).into_iter().find(finished) {
                return Ok(outcome);
            }
            match self.wire.receive(PATIENCE)? {
                Some(packet) => {
                    silence = 0;
                    self.keep(Some(packet));
                }
                None if silence == REPETITIONS => {
                    return Err(Trouble::Wrong(format!("no answer to {}", name(&request.command))));
                }
                None => {
                    silence += 1;
                    self.send(request)?;
                }
            }
        }
    }

    /// Asks and waits for the outcome.
    pub(super) fn ask(&mut self, command: Command) -> Result<Outcome> {
        let request = self.begin(command)?;
        self.outcome(&request)
    }

    /// Asks for something that must be done.
    pub(super) fn done(&mut self, command: Command) -> Result<Answer> {
        match self.ask(command)? {
            Outcome::Done(answer) => Ok(answer),
            other => Err(Trouble::Wrong(format!("{} came to {other:?}", name(&command)))),
        }
    }

    /// Asks for something that must be refused, and why.
    pub(super) fn refused(&mut self, command: Command, why: Refusal) -> Result<()> {
        let outcome = self.ask(command)?;
        same(&name(&command), &Outcome::Refused(why), &outcome)
    }

    /// Sets all parameters.
    pub(super) fn configure(&mut self, configuration: &Configuration) -> Result<()> {
        for command in configuration.commands() {
            self.done(command)?;
        }
        Ok(())
    }

    pub(super) fn status(&mut self) -> Result<Status> {
        match self.done(Command::Status)? {
            Answer::Status(status) => Ok(status),
            other => Err(Trouble::Wrong(format!("Status was answered by {other:?}"))),
        }
    }

    /// Moves all axes and expects to be told that they are there.
    pub(super) fn move_to(&mut self, targets: [i32; AXES]) -> Result<()> {
        let answer = self.done(Command::MoveTo(targets))?;
        same("where a move ended", &Answer::At(targets), &answer)
    }

    /// Looks at the status until it is as wanted.
    pub(super) fn wait(&mut self, what: &str, wanted: impl Fn(&Status) -> bool) -> Result<Status> {
        for _ in 0..LOOKS {
            let status = self.status()?;
            if wanted(&status) {
                return Ok(status);
            }
            self.pause(LOOK)?;
        }
        Err(Trouble::Wrong(format!("waited in vain: {what}")))
    }

    /// Brings the controller to rest, without faults, with the rig's parameters.
    pub(super) fn settle(&mut self) -> Result<Status> {
        if self.status()?.busy {
            self.ask(Command::Stop)?;
        }
        let status = self.wait("at rest after a stop", |status| !status.busy)?;
        ensure(!status.emergency_stop, || "the emergency stop is pressed".to_owned())?;
        if !status.faults.is_empty() {
            self.done(Command::ClearFaults)?;
        }
        self.configure(&self.configuration.clone())?;
        self.status()
    }

    /// The same, with all positions known.
    pub(super) fn homed(&mut self) -> Result<Status> {
        let status = self.settle()?;
        if status.known == [true; AXES] {
            return Ok(status);
        }
        self.done(Command::Home)?;
        self.status()
    }

    /// A position of all axes: a part, 0 to 1, of the way from the lower limits to the upper ones.
    pub(super) fn part_way(&self, part: f64) -> [i32; AXES] {
        self.configuration.axes.map(|axis| {
            let span = f64::from(axis.max_steps) - f64::from(axis.min_steps);
            (f64::from(axis.min_steps) + part * span).round() as i32
        })
    }

    /// Begins a move to the upper limits from near the lower ones and waits until it is well under way.
    pub(super) fn under_way(&mut self) -> Result<(Request, Status)> {
        self.homed()?;
        self.move_to(self.part_way(0.1))?;
        let start = self.status()?;
        let request = self.begin(Command::MoveTo(self.part_way(1.0)))?;
        let gone = |status: &Status| status.positions != start.positions;
        let status = self.wait("positions change during a move", gone)?;
        Ok((request, status))
    }
}

/// The name of a command, with what it asks for unless that is long.
pub(super) fn name(command: &Command) -> String {
    match command {
        Command::Configure(_) => "Configure".to_owned(),
        Command::PrepareAxis { axis, .. } => format!("PrepareAxis {}", axis.name()),
        other => format!("{other:?}"),
    }
}
