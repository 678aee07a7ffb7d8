//! Memory that a reset leaves as it is: no section of the program lies in it, so nothing loads or clears it.
//!
//! | word | what |
//! |---|---|
//! | 0–2 | the last crash's record |
//! | 3 | under emulation: the crash that a test asks for |
//! | 4 | under emulation: where the trace of steps is |
//! | 64–383 | under emulation: parameters, in two slots of 640 bytes |

use lobelia_board_support::crash::{self, CrashRecord};

#[cfg(feature = "qemu")]
pub(crate) const TRIGGER: usize = 3;
#[cfg(feature = "qemu")]
pub(crate) const TRACE: usize = 4;
#[cfg(feature = "qemu")]
const SLOTS: usize = 64;

unsafe extern "C" {
    /// Where the memory begins; the linker script has its 2 kB.
    static _kept: u32;
}

fn word(index: usize) -> *mut u32 {
    (&raw const _kept).cast_mut().wrapping_add(index)
}

pub(crate) fn read(index: usize) -> u32 {
    // SAFETY: every index is one of the table above, so in the memory, and nothing else refers to it.
    unsafe { word(index).read_volatile() }
}

pub(crate) fn write(index: usize, value: u32) {
    // SAFETY: as in `read`.
    unsafe { word(index).write_volatile(value) }
}

/// Keeps a crash's record.
pub(crate) fn write_crash(record: &CrashRecord) {
    crash::write(record).into_iter().enumerate().for_each(|(index, word)| write(index, word));
}

/// The last crash's record, once.
pub(crate) fn take_crash() -> Option<CrashRecord> {
    let record = crash::read([0, 1, 2].map(read));
    crash::NONE.into_iter().enumerate().for_each(|(index, word)| write(index, word));
    record
}

/// Parameters in kept memory, for emulation, which models no flash that can be written. They outlive a reset,
/// not a power cut.
#[cfg(feature = "qemu")]
#[derive(Debug)]
pub(crate) struct KeptSlots;

#[cfg(feature = "qemu")]
impl KeptSlots {
    const WORDS: usize = lobelia_firmware::storage::SLOT_BYTES / 4;

    fn first(slot: usize) -> usize {
        SLOTS + slot * Self::WORDS
    }
}

#[cfg(feature = "qemu")]
impl lobelia_firmware::storage::Storage for KeptSlots {
    fn read(&mut self, slot: usize, into: &mut [u8]) -> bool {
        for (index, bytes) in into.chunks_mut(4).enumerate().take(Self::WORDS) {
            let word = read(Self::first(slot) + index).to_le_bytes();
            bytes.copy_from_slice(&word[..bytes.len()]);
        }
        true
    }

    fn erase(&mut self, slot: usize) -> bool {
        (0..Self::WORDS).for_each(|index| write(Self::first(slot) + index, u32::MAX));
        true
    }

    fn write(&mut self, slot: usize, bytes: &[u8]) -> bool {
        for (index, bytes) in bytes.chunks(4).enumerate() {
            let mut word = [0xFF; 4];
            word[..bytes.len()].copy_from_slice(bytes);
            write(Self::first(slot) + index, u32::from_le_bytes(word));
        }
        bytes.len() <= 4 * Self::WORDS
    }
}
