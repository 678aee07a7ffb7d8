//! The link's memory: frames in and out, the session, and the answers given, so that a request repeated because a byte
//! was lost is answered again and not run again.

use heapless::{Deque, HistoryBuf, Vec};
use lobelia_protocol::{
    Command, Event, FrameDecoder, Hello, Outcome, Refusal, Request, Response, ToController, ToHost, Verdict,
};

use crate::board::ByteLink;

/// Bytes waiting to be sent.
const OUTBOX: usize = 1024;
/// Answers kept for repeated requests.
const ANSWERS: usize = 8;

/// Requests that may wait for one before them.
const HELD: usize = 3;
/// Events waiting to be sent.
const EVENTS: usize = 8;

/// What to do with a request.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Admission {
    /// It's new: run it.
    Run,
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
    answers: HistoryBuf<Response, ANSWERS>,
    held: Vec<Request, HELD>,
    events: Deque<Event, EVENTS>,
}

impl<L: ByteLink> Link<L> {
    pub(crate) fn new(port: L) -> Self {
        Self {
            port,
            decoder: FrameDecoder::new(),
            outbox: Deque::new(),
            session: None,
            newest: 0,
            answers: HistoryBuf::new(),
            held: Vec::new(),
            events: Deque::new(),
        }
    }

    /// The next packet received. What isn't one is dropped: the host repeats what isn't answered.
    pub(crate) fn receive(&mut self) -> Option<ToController> {
        while let Some(byte) = self.port.read() {
            if let Some(Ok(payload)) = self.decoder.push(byte)
                && let Ok(packet) = ToController::decode(payload)
            {
                return Some(packet);
            }
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
        }
        self.send(&ToHost::Hello(reply));
        new
    }

    /// Decides whether a request is run: each once, in the order of their ids. One that comes before its turn is held until
    /// its forerunners have come. Only a stop doesn't wait: it runs at once, and what went before it never does.
    pub(crate) fn admit(&mut self, request: &Request, running: Option<u32>) -> Admission {
        if self.session != Some(request.session) {
            return Admission::Answer(Outcome::Refused(Refusal::NoSession));
        }
        if request.id > self.newest {
            let ahead = request.id - self.newest;
            if ahead == 1 || request.command == Command::Stop {
                self.newest = request.id;
                self.held.retain(|held| held.id > request.id);
                return Admission::Run;
            }
            let known = self.held.iter().any(|held| held.id == request.id);
            return Admission::Answer(
                if known || ahead as usize <= HELD + 1 && self.held.push(*request).is_ok() {
                    Outcome::Running
                } else {
                    Outcome::Refused(Refusal::OutOfWindow)
                },
            );
        }
        if running == Some(request.id) {
            return Admission::Answer(Outcome::Running);
        }
        let kept = self.answers.oldest_ordered().find(|answer| answer.id == request.id);
        Admission::Answer(kept.map_or(Outcome::Refused(Refusal::Stale), |answer| answer.outcome))
    }

    /// Whether a session is open.
    pub(crate) fn is_open(&self) -> bool {
        self.session.is_some()
    }

    /// Whether a request belongs to the session that is open.
    pub(crate) fn in_session(&self, request: &Request) -> bool {
        self.session == Some(request.session)
    }

    /// The held request whose turn has come.
    pub(crate) fn next_held(&mut self) -> Option<Request> {
        let turn = self.newest.wrapping_add(1);
        let place = self.held.iter().position(|held| held.id == turn)?;
        Some(self.held.swap_remove(place))
    }

    /// Tells something unasked, once no answer waits to be sent. When too much waits the newest is left out: a fault is in each
    /// status too.
    pub(crate) fn tell(&mut self, event: Event) {
        let _ = self.events.push_back(event);
    }

    /// Answers a request and remembers the answer.
    pub(crate) fn answer(&mut self, id: u32, outcome: Outcome) {
        if let Some(session) = self.session {
            let response = Response { session, id, outcome };
            self.answers.write(response);
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

    /// Hands the port as many bytes as it takes.
    pub(crate) fn flush(&mut self) {
        if self.outbox.is_empty()
            && let Some(event) = self.events.pop_front()
        {
            self.send(&ToHost::Event(event));
        }
        while let Some(&byte) = self.outbox.front() {
            if !self.port.write(byte) {
                return;
            }
            self.outbox.pop_front();
            if self.outbox.is_empty()
                && let Some(event) = self.events.pop_front()
            {
                self.send(&ToHost::Event(event));
            }
        }
    }
}
