//! The link's memory: frames in and out, the session, and the answers given, so that a request repeated because a byte
//! was lost is answered again and not run again.

use heapless::{Deque, HistoryBuf};
use lobelia_protocol::{
    FrameDecoder, Hello, Outcome, Refusal, Request, Response, ToController, ToHost, Verdict,
};

use crate::board::ByteLink;

/// Bytes waiting to be sent.
const OUTBOX: usize = 1024;
/// Answers kept for repeated requests.
const ANSWERS: usize = 8;

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
        }
        self.send(&ToHost::Hello(reply));
        new
    }

    /// Decides whether a request is run. Ids rise, so one that isn't above all others was seen before.
    pub(crate) fn admit(&mut self, request: &Request, running: Option<u32>) -> Admission {
        if self.session != Some(request.session) {
            return Admission::Answer(Outcome::Refused(Refusal::NoSession));
        }
        if request.id > self.newest {
            self.newest = request.id;
            return Admission::Run;
        }
        if running == Some(request.id) {
            return Admission::Answer(Outcome::Running);
        }
        let kept = self.answers.oldest_ordered().find(|answer| answer.id == request.id);
        Admission::Answer(kept.map_or(Outcome::Refused(Refusal::Stale), |answer| answer.outcome))
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
        while let Some(&byte) = self.outbox.front() {
            if !self.port.write(byte) {
                return;
            }
            self.outbox.pop_front();
        }
    }
}
