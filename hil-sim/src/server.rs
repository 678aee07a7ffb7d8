//! Serves a simulated rig on TCP, one host at a time, so that a real host process can drive it through a real
//! port.
//!
//! Virtual time then follows real time, `speed` times as fast; so truths differ from run to run, unlike in
//! one process.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use crate::rig::SimulatedRig;

/// How long the server waits for a byte before it lets virtual time pass.
const TICK: Duration = Duration::from_millis(2);
/// A host that was heard within this time keeps its lease.
const LEASE: Duration = Duration::from_secs(2);

/// Serves hosts one after the other; returns only when the listener fails.
pub fn serve_tcp(listener: &TcpListener, rig: &SimulatedRig, speed: f64) -> io::Result<()> {
    loop {
        let (stream, _) = listener.accept()?;
        // A host that goes away ends its own session, not the server.
        let _ = serve(stream, rig, speed);
    }
}

fn serve(mut stream: TcpStream, rig: &SimulatedRig, speed: f64) -> io::Result<()> {
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(TICK))?;
    let mut link = rig.link();
    let mut buffer = [0; 512];
    let mut last = Instant::now();
    let mut heard = last;
    loop {
        match stream.read(&mut buffer) {
            Ok(0) => return Ok(()),
            Ok(count) => {
                heard = Instant::now();
                link.write_all(&buffer[..count])?;
            }
            Err(error) if would_wait(&error) => {}
            Err(error) => return Err(error),
        }
        let now = Instant::now();
        let until = rig.now_us() + ((now - last).as_secs_f64() * 1e6 * speed) as u64;
        // The lease runs in the host's time, not in the rig's, which may be a thousand times as fast.
        if now - heard < LEASE {
            rig.idle_until_us(until);
        } else {
            rig.abandon_until_us(until);
        }
        last = now;
        link.set_timeout(Duration::ZERO);
        match link.read(&mut buffer) {
            Ok(count) => stream.write_all(&buffer[..count])?,
            Err(error) if would_wait(&error) => {}
            Err(error) => return Err(error),
        }
    }
}

fn would_wait(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}
