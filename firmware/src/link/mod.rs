//! The link's memory: frames in and out, the session, and the answers given, so that a request repeated
//! because a byte was lost is answered again and not run again.

mod events;

use heapless::{Deque, Vec};
use lobelia_protocol::{
    Command, FrameDecoder, Hello, Outcome, Refusal, Request, Response, ToController, ToHost, Verdict,
};

use crate::board::ByteLink;
pub(crate) use events::Events;

/// Bytes waiting to be sent.
const OUTBOX: usize = 1024;
/// Answers kept for repeated requests: those that the host has not seen.
const ANSWERS: usize = 8;
/// Requests that may wait for one before them to come.
const HELD: usize = 3;

/// What to do with a request.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Admission {
    /// It's new and its turn has come.
    Take,
    /// It isn't: answer this.
    Answer(Outcome),
}

/// One end of the link.
#[derive(Debug)]
pub(crate) struct Link<L> {
    port: L,
    decoder: FrameDecoder,
    outbox: Deque<u8, OUTBOX>,
    session: Option<u32>,
    newest: u32,
    answers: Vec<Response, ANSWERS>,
    held: Vec<Request, HELD>,
    pub(crate) events: Events,
    pub(crate) frames: u32,
    pub(crate) bad_frames: u32,
}

impl<L: ByteLink> Link<L> {
    pub(crate) fn new(port: L) -> Self {
        Self {
            port,
            decoder: FrameDecoder::new(),
            outbox: Deque::new(),
            session: None,
            newest: 0,
            answers: Vec::new(),
            held: Vec::new(),
            events: Events::default(),
            frames: 0,
            bad_frames: 0,
        }
    }

    /// The next packet received. What isn't one is dropped: the host repeats what isn't answered.
    pub(crate) fn receive(&mut self) -> Option<ToController> {
        while let Some(byte) = self.port.read() {
            let Some(frame) = self.decoder.push(byte) else { continue };
            if let Ok(Ok(packet)) = frame.map(ToController::decode) {
                self.frames = self.frames.wrapping_add(1);
                return Some(packet);
            }
            self.bad_frames = self.bad_frames.wrapping_add(1);
        }
        None
    }

    /// Replies to a hello; true when it opened a new session, so that what the last one began must end.
    pub(crate) fn greet(&mut self, hello: Hello) -> bool {
        let reply = hello.reply();
        let session = (reply.verdict == Verdict::Accepted).then_some(hello.session);
        let new = session != self.session;
        if new {
            self.session = session;
            self.newest = 0;
            self.answers.clear();
            self.held.clear();
            self.events.end_watch();
        }
        self.send(&ToHost::Hello(reply));
        new
    }

    /// Decides whether a request is taken: each once, in the order of their ids. One that comes before its
    /// turn is held until its forerunners have come, and one that has to wait is held while there is no
    /// `room` to wait. Only a stop waits for nothing: what went before it and has not come never runs.
    /// `pending` tells which requests are not answered yet.
    pub(crate) fn admit(
        &mut self,
        request: &Request,
        room: bool,
        pending: impl Fn(u32) -> bool,
    ) -> Admission {
        if !self.in_session(request) {
            return Admission::Answer(Outcome::Refused(Refusal::NoSession));
        }
        let &Request { id, seen, .. } = request;
        if id <= self.newest {
            if pending(id) {
                return Admission::Answer(Outcome::Running);
            }
            let kept = self.answers.iter().find(|answer| answer.id == id);
            return Admission::Answer(kept.map_or(Outcome::Refused(Refusal::Stale), |answer| answer.outcome));
        }
        let ahead = id - self.newest;
        if request.command == Command::Stop || ahead == 1 && in_window(id, seen) && can_take(request, room) {
            self.newest = id;
            self.held.retain(|held| held.id > id);
            self.answers.retain(|answer| answer.id > seen);
            return Admission::Take;
        }
        let known = self.held.iter().any(|held| held.id == id);
        let fits = ahead as usize <= HELD + 1 && in_window(id, seen);
        Admission::Answer(if known || fits && self.held.push(*request).is_ok() {
            Outcome::Running
        } else {
            Outcome::Refused(Refusal::OutOfWindow)
        })
    }

    /// Whether a session is open.
    pub(crate) fn is_open(&self) -> bool {
        self.session.is_some()
    }

    /// Whether a request belongs to the session that is open.
    pub(crate) fn in_session(&self, request: &Request) -> bool {
        self.session == Some(request.session)
    }

    /// The held request whose turn has come, if there is one that need not wait or `room` to wait.
    pub(crate) fn next_held(&mut self, room: bool) -> Option<Request> {
        let turn = self.newest.wrapping_add(1);
        let place = self.held.iter().position(|held| held.id == turn && can_take(held, room))?;
        Some(self.held.swap_remove(place))
    }

    /// Answers a request and remembers the answer.
    pub(crate) fn answer(&mut self, id: u32, outcome: Outcome) {
        if let Some(session) = self.session {
            let response = Response { session, id, outcome };
            // Full only when a host breaks the rule of what it may send before it has seen an answer.
            if self.answers.is_full() {
                self.answers.remove(0);
            }
            let _ = self.answers.push(response);
            self.send(&ToHost::Response(response));
        }
    }

    /// Sends a packet, whole or not at all.
    pub(crate) fn send(&mut self, packet: &ToHost) {
        let Ok(frame) = packet.encode() else { return };
        if self.outbox.capacity() - self.outbox.len() >= frame.len() {
            for byte in frame {
                let _ = self.outbox.push_back(byte);
            }
        }
    }

    /// Hands the port as many bytes as it takes; when no answer is left or on its way, events too, one at a
    /// time.
    pub(crate) fn flush(&mut self) {
        loop {
            while let Some(&byte) = self.outbox.front() {
                if !self.port.write(byte) {
                    return;
                }
                self.outbox.pop_front();
            }
            if !self.port.is_idle() {
                return;
            }
            let Some(event) = self.events.next() else { return };
            self.send(&ToHost::Event(event));
        }
    }
}

/// Whether a request's answer can be kept until the host has seen it.
fn in_window(id: u32, seen: u32) -> bool {
    id.checked_sub(seen).is_some_and(|ahead| (1..=ANSWERS as u32).contains(&ahead))
}

fn can_take(request: &Request, room: bool) -> bool {
    room || !request.command.waits()
}
