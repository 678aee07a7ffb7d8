//! A bad line: what a seed makes of the bytes that pass it.

use std::collections::VecDeque;
use std::io::{self, Read, Write};

use crate::noise;

/// Longest time that a byte comes late, µs.
const LONGEST_DELAY_US: u64 = 3000;
/// Most bytes of garbage at one place.
const MOST_GARBAGE: u64 = 12;
/// Which of its first bytes a frame may lose; the shortest frame has more.
const LOST_AMONG: u64 = 8;

/// How often something is disturbed: probabilities, 0 to 1. Those of a byte add up to 1 at most.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FaultRates {
    /// Of a byte: of being lost.
    pub lost: f64,
    /// Of a byte: of arriving with a bit flipped.
    pub flipped: f64,
    /// Of a byte: of arriving twice.
    pub doubled: f64,
    /// Of a byte: of arriving up to 3 ms late, with all that follow it.
    pub delayed: f64,
    /// Of a byte: of arriving behind the next one.
    pub swapped: f64,
    /// Of a byte: of arriving behind 1 to 12 bytes of garbage.
    pub garbage: f64,
    /// Of a whole frame: of losing one of its bytes.
    pub frames: f64,
}

/// How many frames passed a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LineCounts {
    /// All of them.
    pub frames: u64,
    /// Those of which a byte was disturbed.
    pub disturbed: u64,
}

impl std::ops::Add for LineCounts {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { frames: self.frames + other.frames, disturbed: self.disturbed + other.disturbed }
    }
}

/// One way of a bad line.
#[derive(Debug)]
pub(crate) struct Disturbance {
    rates: FaultRates,
    seed: u64,
    bytes: u64,
    /// A byte that arrives behind the next one.
    swapped: Option<u8>,
    /// Bytes of the frame so far, delimiters left out.
    body: u64,
    /// Which of them is lost, if one is.
    victim: Option<u64>,
    touched: bool,
    pub(crate) counts: LineCounts,
}

impl Disturbance {
    pub(crate) fn new(rates: FaultRates, seed: u64) -> Self {
        Self {
            rates,
            seed,
            bytes: 0,
            swapped: None,
            body: 0,
            victim: None,
            touched: false,
            counts: LineCounts::default(),
        }
    }

    /// Calls `arrive` for what becomes of a byte, in order: with bytes and how late they are, µs.
    pub(crate) fn pass(&mut self, byte: u8, mut arrive: impl FnMut(u8, u64)) {
        self.bytes += 1;
        let hit = self.follow_frame(byte);
        let waiting = self.swapped.take();
        let draw = |what: u64| noise::hash(&[self.seed, self.bytes, what]);
        let FaultRates { lost, flipped, doubled, delayed, swapped, garbage, .. } = self.rates;
        let mut left = noise::unit(&[self.seed, self.bytes]);
        self.touched |=
            hit || waiting.is_some() || left < lost + flipped + doubled + delayed + swapped + garbage;
        let mut falls = |rate: f64| {
            left -= rate;
            left < 0.0
        };
        let lost = hit || falls(lost);
        if !lost && falls(flipped) {
            arrive(byte ^ (1 << (draw(1) % 8)), 0);
        } else if !lost && falls(doubled) {
            arrive(byte, 0);
            arrive(byte, 0);
        } else if !lost && falls(delayed) {
            arrive(byte, draw(2) % LONGEST_DELAY_US);
        } else if !lost && falls(swapped) {
            self.swapped = Some(byte);
        } else if !lost {
            if falls(garbage) {
                let count = 1 + draw(3) % MOST_GARBAGE;
                (0..count).for_each(|k| arrive(draw(4 + k) as u8, 0));
            }
            arrive(byte, 0);
        }
        if let Some(byte) = waiting {
            arrive(byte, 0);
        }
        if byte == 0 && self.body > 0 {
            self.body = 0;
            self.counts.frames += 1;
            self.counts.disturbed += u64::from(std::mem::take(&mut self.touched));
        }
    }

    /// Whether the frame that this byte belongs to loses it.
    fn follow_frame(&mut self, byte: u8) -> bool {
        if byte == 0 {
            return false;
        }
        if self.body == 0 {
            let keys = [self.seed, self.bytes, 0xf4a3e];
            self.victim = (noise::unit(&keys) < self.rates.frames).then(|| noise::hash(&keys) % LOST_AMONG);
        }
        self.body += 1;
        self.victim == Some(self.body - 1)
    }
}

/// A real link that disturbs what passes it. There is no telling its time, so nothing is delayed.
#[derive(Debug)]
pub struct FaultyLink<L> {
    link: L,
    out: Disturbance,
    back: Disturbance,
    arrived: VecDeque<u8>,
}

impl<L> FaultyLink<L> {
    /// Wraps a link.
    pub fn new(link: L, rates: FaultRates, seed: u64) -> Self {
        let way = |way: u64| Disturbance::new(rates, noise::hash(&[seed, way]));
        Self { link, out: way(0), back: way(1), arrived: VecDeque::new() }
    }

    /// The link inside.
    pub fn inner(&self) -> &L {
        &self.link
    }

    /// The link inside, to change.
    pub fn inner_mut(&mut self) -> &mut L {
        &mut self.link
    }
}

impl<L: Read> Read for FaultyLink<L> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        while self.arrived.is_empty() {
            let mut buffer = [0; 256];
            let count = self.link.read(&mut buffer)?;
            if count == 0 {
                return Ok(0);
            }
            for &byte in &buffer[..count] {
                self.back.pass(byte, |byte, _| self.arrived.push_back(byte));
            }
        }
        self.arrived.read(into)
    }
}

impl<L: Write> Write for FaultyLink<L> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut arrived = Vec::with_capacity(bytes.len() + 2);
        for &byte in bytes {
            self.out.pass(byte, |byte, _| arrived.push(byte));
        }
        self.link.write_all(&arrived)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.link.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn passed(rates: FaultRates, seed: u64, bytes: &[u8]) -> (Vec<u8>, LineCounts) {
        let mut line = Disturbance::new(rates, seed);
        let mut arrived = Vec::new();
        bytes.iter().for_each(|&byte| line.pass(byte, |byte, _| arrived.push(byte)));
        (arrived, line.counts)
    }

    #[test]
    fn each_fault_does_what_it_says() {
        let bytes: Vec<u8> = (1..=200).collect();
        let always = |rates: FaultRates| passed(rates, 3, &bytes).0;
        assert_eq!(always(FaultRates::default()), bytes);
        assert_eq!(always(FaultRates { lost: 1.0, ..Default::default() }), [0u8; 0]);
        let doubled = always(FaultRates { doubled: 1.0, ..Default::default() });
        assert_eq!(doubled, bytes.iter().flat_map(|&byte| [byte, byte]).collect::<Vec<_>>());
        let flipped = always(FaultRates { flipped: 1.0, ..Default::default() });
        assert!(flipped.iter().zip(&bytes).all(|(a, b)| (a ^ b).count_ones() == 1));
        let swapped = always(FaultRates { swapped: 0.2, ..Default::default() });
        assert!(swapped != bytes && swapped.iter().zip(&bytes).filter(|(a, b)| a != b).count() < 150);
        let mut sorted = swapped.clone();
        sorted.sort_unstable();
        assert!(sorted.windows(2).all(|pair| pair[1] == pair[0] + 1), "{swapped:?}");
        let garbage = always(FaultRates { garbage: 0.5, ..Default::default() });
        assert!(garbage.len() > 400, "{}", garbage.len());
    }

    #[test]
    fn a_share_of_the_frames_loses_a_byte_and_is_counted() {
        let frame = [0, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0];
        let bytes = frame.repeat(10_000);
        let (arrived, counts) = passed(FaultRates { frames: 0.3, ..Default::default() }, 5, &bytes);
        assert_eq!(counts.frames, 10_000);
        assert_eq!(bytes.len() - arrived.len(), counts.disturbed as usize);
        // Six standard deviations.
        assert!(counts.disturbed.abs_diff(3000) < 275, "{counts:?}");
    }
}
