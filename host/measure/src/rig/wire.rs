//! The wire to a controller: packets out, packets in, over any port.

use std::collections::VecDeque;
use std::io::ErrorKind;
use std::time::{Duration, Instant};

use lobelia_protocol::{FrameDecoder, ToController, ToHost};

use crate::rig::port::Port;
use crate::rig::trace::Step;
use lobelia_base::error::{Error, Result};

/// After this many bytes without one packet among them the port counts as someone else's.
const MOST_RUBBISH: usize = 1 << 18;

/// A port with the framing on it.
pub(crate) struct Wire {
    port: Box<dyn Port>,
    decoder: FrameDecoder,
    inbox: VecDeque<u8>,
    /// Packets received before anyone asked for them.
    collected: VecDeque<ToHost>,
    rubbish: usize,
    sent: u64,
}

/// Packets that may be collected before anyone asks for them; the oldest make room.
const COLLECTED: usize = 256;

impl Wire {
    pub(crate) fn new(port: Box<dyn Port>) -> Self {
        Self {
            port,
            decoder: FrameDecoder::new(),
            inbox: VecDeque::new(),
            collected: VecDeque::new(),
            rubbish: 0,
            sent: 0,
        }
    }

    /// How many packets were sent so far.
    pub(crate) fn sent(&self) -> u64 {
        self.sent
    }

    pub(crate) fn is_real_time(&self) -> bool {
        self.port.is_real_time()
    }

    /// The steps made since this was last asked, if the port can tell.
    pub(crate) fn steps(&mut self) -> Option<Vec<Step>> {
        self.port.steps()
    }

    pub(crate) fn send(&mut self, packet: &ToController) -> Result<()> {
        let frame = packet.encode().map_err(|_| Error::failure("a request is longer than a frame may be"))?;
        self.sent += 1;
        self.send_bytes(&frame)
    }

    /// Sends bytes as they are, whether they are a frame or not.
    pub(crate) fn send_bytes(&mut self, bytes: &[u8]) -> Result<()> {
        self.port.write_all(bytes).and_then(|()| self.port.flush()).map_err(lost)
    }

    /// Receives what comes for a while, for whoever asks next. A controller that never falls silent is not
    /// listened to for longer.
    pub(crate) fn collect(&mut self, time: Duration) -> Result<()> {
        let end = Instant::now() + time;
        while let Some(left) = end.checked_duration_since(Instant::now()).filter(|left| !left.is_zero()) {
            let Some(packet) = self.receive_new(left)? else { break };
            if self.collected.len() == COLLECTED {
                self.collected.pop_front();
            }
            self.collected.push_back(packet);
        }
        Ok(())
    }

    /// The next packet, or nothing if none comes in time. What isn't a packet is passed over.
    pub(crate) fn receive(&mut self, timeout: Duration) -> Result<Option<ToHost>> {
        match self.collected.pop_front() {
            Some(packet) => Ok(Some(packet)),
            None => self.receive_new(timeout),
        }
    }

    fn receive_new(&mut self, timeout: Duration) -> Result<Option<ToHost>> {
        loop {
            while let Some(byte) = self.inbox.pop_front() {
                self.rubbish += 1;
                let Some(Ok(payload)) = self.decoder.push(byte) else { continue };
                let Ok(packet) = ToHost::decode(payload) else { continue };
                self.rubbish = 0;
                return Ok(Some(packet));
            }
            if self.rubbish > MOST_RUBBISH {
                return Err(Error::failure(
                    "the port sends bytes that no Lobelia controller sends; check that --port names the rig",
                ));
            }
            let mut buffer = [0; 512];
            self.port.set_read_timeout(timeout).map_err(lost)?;
            match self.port.read(&mut buffer) {
                Ok(0) => return Err(lost(ErrorKind::UnexpectedEof.into())),
                Ok(count) => self.inbox.extend(&buffer[..count]),
                Err(error) => match error.kind() {
                    ErrorKind::TimedOut | ErrorKind::WouldBlock => return Ok(None),
                    ErrorKind::Interrupted => {}
                    _ => return Err(lost(error)),
                },
            }
        }
    }
}

/// What to do once the link is lost.
pub(crate) const PLUG_IN: &str = "; plug it in, then start again (acquire: with --resume)";

fn lost(error: std::io::Error) -> Error {
    Error::failure(format!("the link to the rig's controller was lost ({error}){PLUG_IN}")).caused_by(error)
}

#[cfg(test)]
mod tests {
    use std::io::{self, Read, Write};

    use lobelia_protocol::{Event, Telemetry};

    use super::*;

    /// A controller that tells its telemetry without a pause.
    struct Talker(Vec<u8>);

    impl Read for Talker {
        fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
            let count = into.len().min(self.0.len());
            into[..count].copy_from_slice(&self.0[..count]);
            Ok(count)
        }
    }

    impl Write for Talker {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    impl Port for Talker {
        fn set_read_timeout(&mut self, _: Duration) -> io::Result<()> {
            Ok(())
        }
    }

    /// Whoever keeps the lease must get to speak again: this returns at all, and with what was told.
    #[test]
    fn listening_to_a_controller_that_never_falls_silent_ends() {
        let telemetry = ToHost::Event(Event::Telemetry(Telemetry::default()));
        let frame = telemetry.encode().unwrap().to_vec();
        let mut wire = Wire::new(Box::new(Talker(frame)));
        wire.collect(Duration::from_millis(20)).unwrap();
        assert!((1..=COLLECTED).contains(&wire.collected.len()));
        assert!(matches!(wire.receive(Duration::ZERO), Ok(Some(ToHost::Event(Event::Telemetry(_))))));
    }
}
