//! The STM32F4's brown-out level in its option bytes' register, `FLASH_OPTCR`, as RM0090 has it: level 3,
//! from 2.7 V on, is 00, and off is 11. Register descriptions that programs are generated from have it the
//! other way round.

/// `BOR_LEV`.
const LEVEL: u32 = 0b11 << 2;
const LEVEL_3: u32 = 0b00 << 2;

/// Whether the level is the highest.
pub const fn is_highest(optcr: u32) -> bool {
    optcr & LEVEL == LEVEL_3
}

/// The register with the highest level, and all else as it was.
pub const fn with_highest(optcr: u32) -> u32 {
    optcr & !LEVEL | LEVEL_3
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The register of a chip as it is delivered (RM0090, reset value), whose brown-out reset is off.
    const DELIVERED: u32 = 0x0FFF_AAED;

    #[test]
    fn chip_as_delivered_has_no_brown_out_reset_and_gets_it_with_nothing_else_changed() {
        assert!(!is_highest(DELIVERED));
        let set = with_highest(DELIVERED);
        assert_eq!(set, 0x0FFF_AAE1);
        assert!(is_highest(set));
    }

    #[test]
    fn only_the_highest_of_the_levels_counts() {
        // ST's names for the bits: OB_BOR_LEVEL3, LEVEL2, LEVEL1, OFF.
        for (bits, highest) in [(0x00, true), (0x04, false), (0x08, false), (0x0C, false)] {
            assert_eq!(is_highest(DELIVERED & !0x0C | bits), highest, "{bits:#x}");
        }
    }
}
