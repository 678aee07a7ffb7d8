//! Sample points: Sobol's first two dimensions, shuffled and scrambled anew by hashing for every pixel and
//! purpose (Burley 2020, "Practical hash-based Owen scrambling"), so that a picture depends on its seed
//! alone.

/// Point `index` of the pixel's sequence for one purpose, both coordinates in 0..1. Every aligned run of 2ᵏ
/// points is stratified.
pub(crate) fn point(pixel: u32, index: u32, purpose: u32) -> [f32; 2] {
    let seed = hash(pixel ^ hash(purpose));
    let shuffled = scramble(index.reverse_bits(), seed).reverse_bits();
    // The first dimension, an index read backwards, and the second, both backwards once more.
    let first = scramble(shuffled, hash(seed ^ 0x9e37_79b9));
    let second = scramble(sobol_second(shuffled), hash(seed ^ 0x85eb_ca6b));
    // Both are turned round at once.
    let both = (u64::from(second) << 32 | u64::from(first)).reverse_bits();
    [unit((both >> 32) as u32), unit(both as u32)]
}

/// Sobol's second dimension: Pascal's triangle modulo 2, which is a power of a 2 × 2 block, applied to the
/// bits, with the lowest bit as the most significant.
fn sobol_second(index: u32) -> u32 {
    let mut x = index;
    for (shift, mask) in
        [(1, 0x5555_5555), (2, 0x3333_3333), (4, 0x0f0f_0f0f), (8, 0x00ff_00ff), (16, 0x0000_ffff)]
    {
        x ^= (x >> shift) & mask;
    }
    x
}

/// A well-mixed function of a 32-bit number (the "lowbias32" permutation).
pub(crate) fn hash(mut x: u32) -> u32 {
    x ^= x >> 16;
    x = x.wrapping_mul(0x7feb_352d);
    x ^= x >> 15;
    x = x.wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// Owen scrambling by hashing of a number whose lowest bit is the most significant: every bit is flipped as
/// those below say.
fn scramble(mut x: u32, seed: u32) -> u32 {
    x = x.wrapping_add(seed);
    x ^= x.wrapping_mul(0x6c50_b47c);
    x ^= x.wrapping_mul(0xb82f_1e52);
    x ^= x.wrapping_mul(0xc7af_e638);
    x ^= x.wrapping_mul(0x8d22_f6e6);
    x
}

/// The top 24 bits as a number in 0..1.
fn unit(x: u32) -> f32 {
    (x >> 8) as f32 * (1.0 / 16_777_216.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_aligned_run_of_points_is_stratified_in_both_coordinates() {
        for (pixel, purpose, start) in [(1, 0, 0), (77, 3, 64), (12345, 4, 960)] {
            let mut cells = [[0; 64]; 3];
            for index in start..start + 64 {
                let [x, y] = point(pixel, index, purpose);
                cells[0][(x * 64.0) as usize] += 1;
                cells[1][(y * 64.0) as usize] += 1;
                cells[2][(x * 8.0) as usize * 8 + (y * 8.0) as usize] += 1;
            }
            assert!(cells.iter().flatten().all(|&count| count == 1), "{pixel} {purpose}");
        }
    }

    #[test]
    fn the_second_dimension_follows_its_direction_numbers() {
        for index in [0u32, 1, 2, 3, 5, 100, 4095, 0xdead_beef] {
            let (mut direction, mut bits, mut value) = (1u32 << 31, index, 0);
            while bits != 0 {
                value ^= if bits & 1 == 1 { direction } else { 0 };
                bits >>= 1;
                direction ^= direction >> 1;
            }
            assert_eq!(sobol_second(index).reverse_bits(), value, "{index}");
        }
    }
}
