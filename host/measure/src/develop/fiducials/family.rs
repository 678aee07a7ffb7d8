//! The codes of tag36h11 (Olson 2011) that a carrier uses, and the pattern that a tag of that family is.

/// How many of the family's 587 tags are known here: ids 0 to 47. A carrier has about forty.
pub const COUNT: u32 = CODES.len() as u32;

/// Modules across the black border's outer edge.
pub(super) const MODULES: usize = 8;

/// Data modules across.
const DATA: usize = 6;

/// Two tags of the family, in any rotation, differ in at least 11 modules: up to this many errors are put
/// right. With 48 codes in four rotations a random pattern passes for a tag once in 500,000.
const MAX_ERRORS: u32 = 2;

/// One bit a data module, 1 for white: bit 35 is the upright tag's top left module, then row by row, each
/// from left to right.
#[rustfmt::skip]
const CODES: [u64; 48] = [
    0xd5d628584, 0xd97f18b49, 0xdd280910e, 0xe479e9c98, 0xebcbca822, 0xf31dab3ac,
    0x056a5d085, 0x10652e1d4, 0x22b1dfead, 0x265ad0472, 0x34fe91b86, 0x3ff962cd5,
    0x43a25329a, 0x474b4385f, 0x4e9d243e9, 0x5246149ae, 0x5997f5538, 0x683bb6c4c,
    0x6be4a7211, 0x7e3158eea, 0x81da494af, 0x858339a74, 0x8cd51a5fe, 0x9f21cc2d7,
    0xa2cabc89c, 0xadc58d9eb, 0xb16e7dfb0, 0xb8c05eb3a, 0xd25ef139d, 0xd607e1962,
    0xe4aba3076, 0x2dde6a3da, 0x43d40c678, 0x5620be351, 0x64c47fa65, 0x686d7002a,
    0x6c16605ef, 0x6fbf50bb4, 0x8d06d39dc, 0x9f53856b5, 0xadf746dc9, 0xbc9b084dd,
    0xd290aa77b, 0xd9e28b305, 0xe4dd5c454, 0xfad2fe6f2, 0x181a8151a, 0x26be42c2e,
];

/// A tag's modules with the quiet zone around them, `[row][column]`, true for white.
pub(super) type Modules = [[bool; MODULES + 2]; MODULES + 2];

/// The pattern of tag `id`, or nothing when the id is not below [`COUNT`].
pub(super) fn modules(id: u32) -> Option<Modules> {
    let code = CODES.get(id as usize)?;
    let mut modules = [[false; MODULES + 2]; MODULES + 2];
    for (y, row) in modules.iter_mut().enumerate() {
        for (x, white) in row.iter_mut().enumerate() {
            *white = match (x, y) {
                (0, _) | (_, 0) | (9, _) | (_, 9) => true,
                (2..=7, 2..=7) => code >> bit(x - 2, y - 2) & 1 == 1,
                _ => false,
            };
        }
    }
    Some(modules)
}

/// What a word of data modules was decoded as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Word {
    /// The tag.
    pub(super) id: u32,
    /// Quarter turns, each of which takes the word's top left to its top right, that make it upright.
    pub(super) turns: usize,
    /// Modules that were read wrongly.
    pub(super) errors: u32,
}

/// Decodes a word of data modules, read in the codes' order from a tag in any of its four rotations.
pub(super) fn decode(word: u64) -> Option<Word> {
    let mut turned = word;
    let mut best: Option<Word> = None;
    for turns in 0..4 {
        for (id, code) in CODES.iter().enumerate() {
            let errors = (turned ^ code).count_ones();
            if errors <= MAX_ERRORS && best.is_none_or(|b| errors < b.errors) {
                best = Some(Word { id: id as u32, turns, errors });
            }
        }
        turned = turn(turned);
    }
    best
}

/// The bit of the data module in a column and row, counted from the top left.
fn bit(x: usize, y: usize) -> usize {
    DATA * DATA - 1 - (y * DATA + x)
}

/// The word of the same tag turned by a quarter, top left to top right.
fn turn(word: u64) -> u64 {
    let mut turned = 0;
    for y in 0..DATA {
        for x in 0..DATA {
            turned |= (word >> bit(y, DATA - 1 - x) & 1) << bit(x, y);
        }
    }
    turned
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_decodes_in_every_rotation_with_two_errors() {
        for (id, &code) in CODES.iter().enumerate() {
            let mut word = code;
            for turned in 0..4 {
                let errors = 1 << (id % 36) | 1 << ((id + 7 * turned + 1) % 36);
                let expected = Word { id: id as u32, turns: (4 - turned) % 4, errors: 2 };
                assert_eq!(decode(word ^ errors), Some(expected));
                word = turn(word);
            }
            assert_eq!(word, code);
        }
    }

    #[test]
    fn a_word_far_from_all_codes_is_no_tag() {
        for word in [0, (1 << 36) - 1, CODES[0] ^ 0b111] {
            assert_eq!(decode(word), None);
        }
    }
}
