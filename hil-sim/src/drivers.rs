//! The axes' simulated TMC2209 on one wire: registers, addresses, checksums, and the stall output.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use lobelia_firmware::driver::DriverBus;

const SYNC: u8 = 0x05;
const WRITE: u8 = 0x80;
const MASTER: u8 = 0xFF;
const IFCNT: usize = 0x02;
const NODECONF: usize = 0x03;
const SGTHRS: usize = 0x40;
/// Of NODECONF: how long a driver waits before it replies. Below 2 is not for several on one wire: another
/// may take the reply for a request.
const LEAST_DELAY: u32 = 2 << 8;

/// Four drivers with addresses 0 to 3.
#[derive(Debug)]
pub(crate) struct Drivers {
    registers: [[u32; 128]; 4],
    to_controller: VecDeque<u8>,
    /// Whether their answers no longer arrive.
    cut: bool,
}

impl Default for Drivers {
    fn default() -> Self {
        Self { registers: [[0; 128]; 4], to_controller: VecDeque::new(), cut: false }
    }
}

/// Remainder of the message, as a polynomial whose first coefficient is the first byte's lowest bit, by x⁸ +
/// x² + x + 1.
fn checksum(bytes: &[u8]) -> u8 {
    let bits = bytes.iter().flat_map(|byte| (0..8).map(move |bit| u16::from(byte >> bit & 1)));
    let remainder = bits.chain([0; 8]).fold(0u16, |remainder, bit| {
        let shifted = remainder << 1 | bit;
        if shifted & 0x100 == 0 { shifted } else { shifted ^ 0x107 }
    });
    remainder as u8
}

impl Drivers {
    /// Whether an axis's driver looks for stalls.
    pub(crate) fn looks_for_stalls(&self, axis: usize) -> bool {
        self.registers[axis][SGTHRS] > 0
    }

    /// Cuts a driver's supply for a moment: it forgets its settings.
    pub(crate) fn reset(&mut self, axis: usize) {
        self.registers[axis] = [0; 128];
    }

    /// Cuts the wire by which they answer.
    pub(crate) fn cut(&mut self) {
        self.cut = true;
    }

    /// A register of an axis's driver.
    pub(crate) fn register(&self, axis: usize, register: u8) -> u32 {
        self.registers[axis][usize::from(register & !WRITE)]
    }

    /// A datagram; one that is damaged, or for nobody, is passed over.
    fn take(&mut self, datagram: &[u8]) {
        let Some((crc, content)) = datagram.split_last() else { return };
        if *crc != checksum(content) {
            return;
        }
        match *content {
            [SYNC, node @ 0..4, register, a, b, c, d] if register & WRITE != 0 => {
                let registers = &mut self.registers[usize::from(node)];
                registers[usize::from(register & !WRITE)] = u32::from_be_bytes([a, b, c, d]);
                registers[IFCNT] = (registers[IFCNT] + 1) & 0xFF;
            }
            [SYNC, node @ 0..4, register] if register & WRITE == 0 => {
                let value = self.registers[usize::from(node)][usize::from(register)].to_be_bytes();
                let mut reply = vec![SYNC, MASTER, register];
                reply.extend(value);
                reply.push(checksum(&reply));
                if self.registers[usize::from(node)][NODECONF] < LEAST_DELAY {
                    reply[1] ^= 0x55;
                }
                self.to_controller.extend(reply);
            }
            _ => {}
        }
    }
}

/// The controller's end of the wire.
#[derive(Debug)]
pub(crate) struct DriverWire(pub(crate) Arc<Mutex<Drivers>>);

impl DriverBus for DriverWire {
    fn send(&mut self, bytes: &[u8]) -> bool {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take(bytes);
        true
    }

    fn receive(&mut self, into: &mut [u8]) -> bool {
        let mut drivers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let enough = drivers.to_controller.len() >= into.len() && !drivers.cut;
        into.iter_mut().for_each(|byte| *byte = drivers.to_controller.pop_front().unwrap_or(0));
        enough
    }
}
