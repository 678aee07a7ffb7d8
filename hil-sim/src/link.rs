//! The host's end of the simulated link: reading lets virtual time pass until a byte comes or the timeout is
//! over.

use std::fmt;
use std::io::{self, ErrorKind, Read, Write};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::truth::Step;
use crate::world::World;

/// A link to a simulated rig.
#[derive(Clone)]
pub struct SimulatedLink {
    world: Arc<Mutex<World>>,
    timeout_us: u64,
}

impl SimulatedLink {
    pub(crate) fn new(world: Arc<Mutex<World>>) -> Self {
        Self { world, timeout_us: 500_000 }
    }

    fn lock(&self) -> MutexGuard<'_, World> {
        self.world.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How much virtual time a read waits for a byte.
    pub fn set_timeout(&mut self, timeout: Duration) {
        self.timeout_us = timeout.as_micros().try_into().unwrap_or(u64::MAX / 4);
    }

    /// [`crate::SimulatedRig::take_steps`] of its rig.
    pub fn take_steps(&self) -> Vec<Step> {
        self.lock().take_steps()
    }
}

impl fmt::Debug for SimulatedLink {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SimulatedLink").field("timeout_us", &self.timeout_us).finish_non_exhaustive()
    }
}

fn unplugged() -> io::Error {
    io::Error::new(ErrorKind::NotConnected, "the simulated link is unplugged")
}

impl Read for SimulatedLink {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        if into.is_empty() {
            return Ok(0);
        }
        let mut world = self.lock();
        if world.unplugged {
            return Err(unplugged());
        }
        let deadline = world.bench.now_us().saturating_add(self.timeout_us);
        world.run_until(deadline, true);
        match world.bench.to_host.take(world.bench.now_us(), into) {
            0 => Err(ErrorKind::TimedOut.into()),
            count => Ok(count),
        }
    }
}

impl Write for SimulatedLink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut world = self.lock();
        if world.unplugged {
            return Err(unplugged());
        }
        world.bench.to_controller.push(world.bench.now_us(), bytes);
        world.poll();
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
