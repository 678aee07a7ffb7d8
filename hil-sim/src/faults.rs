//! A bad line: wraps any link, and loses or changes bytes in both directions as a seed tells.

use std::io::{self, ErrorKind, Read, Write};

use crate::noise;

/// How often a byte is disturbed: probabilities, 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaultRates {
    /// Of being lost.
    pub lost: f64,
    /// Of arriving with a bit flipped.
    pub flipped: f64,
    /// Of arriving twice.
    pub doubled: f64,
}

/// A link that disturbs what passes it.
#[derive(Debug)]
pub struct FaultyLink<L> {
    link: L,
    rates: FaultRates,
    seed: u64,
    bytes: u64,
}

impl<L> FaultyLink<L> {
    /// Wraps a link.
    pub fn new(link: L, rates: FaultRates, seed: u64) -> Self {
        Self { link, rates, seed, bytes: 0 }
    }

    /// The link inside.
    pub fn inner_mut(&mut self) -> &mut L {
        &mut self.link
    }

    /// What becomes of some bytes.
    fn disturb(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut out = Vec::with_capacity(bytes.len() + 2);
        for &byte in bytes {
            self.bytes += 1;
            let keys = [self.seed, 0xfa01, self.bytes];
            let chance = noise::unit(&keys);
            let FaultRates { lost, flipped, doubled } = self.rates;
            if chance < lost {
                continue;
            }
            if chance < lost + flipped {
                out.push(byte ^ (1 << (noise::hash(&keys) % 8)));
            } else if chance < lost + flipped + doubled {
                out.extend([byte, byte]);
            } else {
                out.push(byte);
            }
        }
        out
    }
}

impl<L: Read> Read for FaultyLink<L> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        if into.len() < 2 {
            return Err(io::Error::new(ErrorKind::InvalidInput, "a faulty link needs room for two bytes"));
        }
        loop {
            // Half of the room, in case each byte comes twice.
            let half = into.len() / 2;
            let count = self.link.read(&mut into[..half])?;
            if count == 0 {
                return Ok(0);
            }
            let bytes = into[..count].to_vec();
            let disturbed = self.disturb(&bytes);
            if !disturbed.is_empty() {
                into[..disturbed.len()].copy_from_slice(&disturbed);
                return Ok(disturbed.len());
            }
        }
    }
}

impl<L: Write> Write for FaultyLink<L> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let disturbed = self.disturb(bytes);
        self.link.write_all(&disturbed)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.link.flush()
    }
}
