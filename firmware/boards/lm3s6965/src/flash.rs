//! Parameters in the flash's last two pages. QEMU doesn't model the flash's controller: this is for the chip
//! alone.

use lobelia_firmware::storage::Storage;

use crate::register::{self, flash};

/// The first of the two pages, and a page's size.
const FIRST: u32 = 254 * 1024;
const PAGE: u32 = 1024;
/// A word takes 50 µs to write and a page 20 ms to erase; the bus waits meanwhile, so it's seldom asked more
/// than once.
const PATIENCE: u32 = 5_000_000;

/// The two pages.
#[derive(Debug)]
pub(crate) struct FlashSlots;

impl FlashSlots {
    /// Has the controller do something; false if it doesn't end or was refused.
    fn run(command: u32) -> bool {
        flash::FCMISC.write(flash::REFUSED);
        flash::FMC.write(flash::KEY | command);
        let done = (0..PATIENCE).any(|_| flash::FMC.read() & command == 0);
        done && flash::FCRIS.read() & flash::REFUSED == 0
    }
}

impl Storage for FlashSlots {
    fn read(&mut self, slot: usize, into: &mut [u8]) -> bool {
        for (index, bytes) in into.chunks_mut(4).enumerate() {
            let word = register::flash_word(FIRST + slot as u32 * PAGE + 4 * index as u32).to_le_bytes();
            bytes.copy_from_slice(&word[..bytes.len()]);
        }
        true
    }

    fn erase(&mut self, slot: usize) -> bool {
        flash::USECRL.write(crate::interrupt::TICKS_PER_US - 1);
        flash::FMA.write(FIRST + slot as u32 * PAGE);
        Self::run(flash::ERASE)
    }

    fn write(&mut self, slot: usize, bytes: &[u8]) -> bool {
        bytes.chunks(4).enumerate().all(|(index, bytes)| {
            let mut word = [0xFF; 4];
            word[..bytes.len()].copy_from_slice(bytes);
            flash::FMA.write(FIRST + slot as u32 * PAGE + 4 * index as u32);
            flash::FMD.write(u32::from_le_bytes(word));
            Self::run(flash::WRITE)
        })
    }
}
