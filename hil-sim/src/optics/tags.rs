//! The printed fiducials of the simulated carrier: AprilTags of the family tag36h11 (Olson 2011), ids 0
//! to 47.
//!
//! A tag is 8 × 8 modules: a black border one module wide around 6 × 6 data modules, with one module of white
//! paper (the quiet zone) around it. The table is written apart from the host's: the host's detector is
//! tested against it.

/// How many tags of the family can be drawn.
pub const COUNT: u32 = CODES.len() as u32;

/// Modules across the black border's outer edge.
const MODULES: f64 = 8.0;

/// The family's first codes, one bit a data module, 1 for white: bit 35 is the upright tag's top left module,
/// then row by row, each from left to right, down to bit 0 at the bottom right.
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

/// Whether the print of tag `id` is white at (u, v), both 0..1 across the black border's outer edge: u to the
/// right and v down on the upright tag. Everything outside 0..1 is white, of which the first module (1/8) is
/// the tag's quiet zone.
///
/// # Panics
///
/// If `id` is not below [`COUNT`].
pub fn is_white(id: u32, u: f64, v: f64) -> bool {
    if !(0.0..1.0).contains(&u) || !(0.0..1.0).contains(&v) {
        return true;
    }
    let (column, row) = ((u * MODULES) as u32, (v * MODULES) as u32);
    if !(1..7).contains(&column) || !(1..7).contains(&row) {
        return false;
    }
    let bit = 35 - ((row - 1) * 6 + column - 1);
    CODES[id as usize] >> bit & 1 == 1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(id: u32) -> Vec<String> {
        let centre = |i: i32| (f64::from(i) + 0.5) / MODULES;
        let module = |x, y| if is_white(id, centre(x), centre(y)) { '.' } else { '#' };
        (-1..9).map(|y| (-1..9).map(|x| module(x, y)).collect()).collect()
    }

    /// The pattern as published with the family (tag36_11_00000.png of apriltag-imgs).
    #[test]
    fn tag_zero_is_drawn_as_published() {
        let published = [
            "..........",
            ".########.",
            ".#..#.#.#.",
            ".##...#.#.",
            ".##..####.",
            ".#.#.####.",
            ".##.#..##.",
            ".####.###.",
            ".########.",
            "..........",
        ];
        assert_eq!(rows(0), published);
    }

    #[test]
    fn codes_differ_by_eleven_modules_in_every_rotation() {
        let rotated = |code: u64| {
            (0..36)
                .filter(|bit| code >> (35 - ((5 - bit % 6) * 6 + bit / 6)) & 1 == 1)
                .fold(0, |r, bit| r | 1u64 << (35 - bit))
        };
        for (i, &a) in CODES.iter().enumerate() {
            let mut turned = a;
            for _ in 0..4 {
                turned = rotated(turned);
                for (j, &b) in CODES.iter().enumerate() {
                    let itself = i == j && turned == a;
                    assert!(itself || (turned ^ b).count_ones() >= 11, "tags {i} and {j}");
                }
            }
            assert_eq!(turned, a);
        }
    }
}
