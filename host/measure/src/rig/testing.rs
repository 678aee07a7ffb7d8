//! For tests: ports to a simulated controller, and to one that is wrong in a way of one's choice.
#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::collections::{HashMap, VecDeque};
use std::io::{self, Read, Write};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use lobelia_hil_sim::{FaultyLink, SimulatedLink};
use lobelia_protocol::{FrameDecoder, ToController, ToHost};

use crate::rig::port::Port;
use crate::rig::trace::Step;

impl Port for SimulatedLink {
    fn set_read_timeout(&mut self, timeout: Duration) -> io::Result<()> {
        self.set_timeout(timeout);
        Ok(())
    }

    fn steps(&mut self) -> Option<Vec<Step>> {
        let steps = self.take_steps();
        let first = steps.first().map_or(0, |step| step.at_us);
        let step = |step: lobelia_hil_sim::Step| Step {
            axis: step.axis,
            up: step.up,
            at_us: (step.at_us - first) as u32,
        };
        Some(steps.into_iter().map(step).collect())
    }

    fn is_real_time(&self) -> bool {
        false
    }
}

impl<P: Port> Port for FaultyLink<P> {
    fn set_read_timeout(&mut self, timeout: Duration) -> io::Result<()> {
        self.inner_mut().set_read_timeout(timeout)
    }

    fn is_real_time(&self) -> bool {
        self.inner().is_real_time()
    }
}

/// A port that bends packets on their way. What isn't a packet passes as it is.
pub(crate) struct Bent<P> {
    port: P,
    out: Box<dyn FnMut(&mut ToController) + Send>,
    back: Box<dyn FnMut(&mut ToHost) + Send>,
    written: Vec<u8>,
    decoder: FrameDecoder,
    ready: VecDeque<u8>,
}

impl<P: Port> Bent<P> {
    pub(crate) fn new(
        port: P,
        out: impl FnMut(&mut ToController) + Send + 'static,
        back: impl FnMut(&mut ToHost) + Send + 'static,
    ) -> Self {
        Self {
            port,
            out: Box::new(out),
            back: Box::new(back),
            written: Vec::new(),
            decoder: FrameDecoder::new(),
            ready: VecDeque::new(),
        }
    }
}

/// The packet that bytes are, if they are one and nothing else.
fn packet(bytes: &[u8]) -> Option<ToController> {
    let mut decoder = FrameDecoder::new();
    let (last, body) = bytes.split_last()?;
    if body.iter().skip(1).any(|byte| *byte == 0) {
        return None;
    }
    for byte in body {
        decoder.push(*byte);
    }
    decoder.push(*last)?.ok().and_then(|payload| ToController::decode(payload).ok())
}

impl<P: Port> Write for Bent<P> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.written.extend(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        let bytes = std::mem::take(&mut self.written);
        match packet(&bytes) {
            Some(mut packet) => {
                (self.out)(&mut packet);
                self.port.write_all(&packet.encode().unwrap())?;
            }
            None => self.port.write_all(&bytes)?,
        }
        self.port.flush()
    }
}

impl<P: Port> Read for Bent<P> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        while self.ready.is_empty() {
            let mut bytes = [0; 64];
            let count = self.port.read(&mut bytes)?;
            for byte in &bytes[..count] {
                let Some(Ok(payload)) = self.decoder.push(*byte) else { continue };
                let Ok(mut packet) = ToHost::decode(payload) else { continue };
                (self.back)(&mut packet);
                self.ready.extend(packet.encode().unwrap());
            }
        }
        let count = into.len().min(self.ready.len());
        into.iter_mut().zip(self.ready.drain(..count)).for_each(|(place, byte)| *place = byte);
        Ok(count)
    }
}

impl<P: Port> Port for Bent<P> {
    fn set_read_timeout(&mut self, timeout: Duration) -> io::Result<()> {
        self.port.set_read_timeout(timeout)
    }

    fn is_real_time(&self) -> bool {
        self.port.is_real_time()
    }
}

/// Bends that give each request that arrives a fresh id, so that the controller runs repetitions again.
pub(crate) fn fresh_ids() -> (impl FnMut(&mut ToController) + Send, impl FnMut(&mut ToHost) + Send) {
    let given = Arc::new(Mutex::new((0, HashMap::new())));
    let known = Arc::clone(&given);
    let out = move |packet: &mut ToController| {
        let (last, given) = &mut *given.lock().unwrap();
        match packet {
            ToController::Hello(_) => *last = 0,
            ToController::Request(request) => {
                *last += 1;
                given.insert((request.session, *last), request.id);
                request.id = *last;
            }
            ToController::Safe(_) => {}
        }
    };
    let back = move |packet: &mut ToHost| {
        if let ToHost::Response(response) = packet
            && let Some(id) = known.lock().unwrap().1.get(&(response.session, response.id))
        {
            response.id = *id;
        }
    };
    (out, back)
}
