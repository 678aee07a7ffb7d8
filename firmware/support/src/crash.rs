//! A crash's record as words of memory that outlives a reset, where anything may stand after a power-up.

pub use lobelia_protocol::{CrashCause, CrashRecord};

use lobelia_protocol::packet::checksum;

/// What a record takes.
pub type Words = [u32; 3];

/// Nothing to tell.
pub const NONE: Words = [0; 3];

const CAUSES: [CrashCause; 4] =
    [CrashCause::Panic, CrashCause::StackOverflow, CrashCause::HardFault, CrashCause::Watchdog];

/// A record, and its checksum behind it.
pub fn write(record: &CrashRecord) -> Words {
    let cause = record.cause as u32;
    [cause, record.place, check(cause, record.place)]
}

/// The record in the words, if it is whole.
pub fn read([cause, place, checked]: Words) -> Option<CrashRecord> {
    let known = CAUSES.into_iter().find(|known| *known as u32 == cause)?;
    (checked == check(cause, place)).then_some(CrashRecord { cause: known, place })
}

fn check(cause: u32, place: u32) -> u32 {
    checksum(&(u64::from(cause) << 32 | u64::from(place)).to_le_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn record_is_read_back_and_none_with_a_bit_flipped() {
        for cause in CAUSES {
            let record = CrashRecord { cause, place: 0x2345 };
            let words = write(&record);
            assert_eq!(read(words), Some(record));
            for bit in 0..96 {
                let mut bad = words;
                bad[bit / 32] ^= 1 << (bit % 32);
                assert_eq!(read(bad), None, "bit {bit}");
            }
        }
    }

    #[test]
    fn memory_of_zeros_or_ones_holds_no_record() {
        assert_eq!((read(NONE), read([u32::MAX; 3])), (None, None));
    }
}
