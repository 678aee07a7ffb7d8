//! Sample points: Sobol's first two dimensions, shuffled and scrambled anew by hashing for every pixel and purpose
//! (Burley 2020, "Practical hash-based Owen scrambling"), so that a picture depends on its seed alone.

/// Sobol's second dimension for the first samples; shared by all pixels.
pub(crate) struct Sequence {
    second: Vec<u32>,
    mask: u32,
    samples: u32,
}

impl Sequence {
    /// A sequence long enough for `samples` points a pixel.
    pub(crate) fn new(samples: u32) -> Self {
        let length = samples.max(1).next_power_of_two();
        let second = (0..length).map(|index| {
            let mut direction = 1u32 << 31;
            let (mut bits, mut value) = (index, 0);
            while bits != 0 {
                if bits & 1 == 1 {
                    value ^= direction;
                }
                bits >>= 1;
                direction ^= direction >> 1;
            }
            value
        });
        Self { second: second.collect(), mask: length - 1, samples }
    }

    /// Points a pixel.
    pub(crate) fn len(&self) -> u32 {
        self.samples
    }

    /// Point `index` of the pixel's sequence for one purpose, both coordinates in 0..1.
    pub(crate) fn point(&self, pixel: u32, index: u32, purpose: u32) -> [f32; 2] {
        let seed = hash(pixel ^ hash(purpose));
        let shuffled = scramble(index, seed) & self.mask;
        let first = scramble(shuffled.reverse_bits(), hash(seed ^ 0x9e37_79b9));
        let second = scramble(self.second[shuffled as usize], hash(seed ^ 0x85eb_ca6b));
        [unit(first), unit(second)]
    }
}

/// A well-mixed function of a 32-bit number (the "lowbias32" permutation).
pub(crate) fn hash(mut x: u32) -> u32 {
    x ^= x >> 16;
    x = x.wrapping_mul(0x7feb_352d);
    x ^= x >> 15;
    x = x.wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// Owen scrambling by hashing: every bit is flipped as the higher bits say.
fn scramble(x: u32, seed: u32) -> u32 {
    let mut x = x.reverse_bits();
    x = x.wrapping_add(seed);
    x ^= x.wrapping_mul(0x6c50_b47c);
    x ^= x.wrapping_mul(0xb82f_1e52);
    x ^= x.wrapping_mul(0xc7af_e638);
    x ^= x.wrapping_mul(0x8d22_f6e6);
    x.reverse_bits()
}

/// The top 24 bits as a number in 0..1.
fn unit(x: u32) -> f32 {
    (x >> 8) as f32 * (1.0 / 16_777_216.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_power_of_two_of_points_is_stratified_in_both_coordinates() {
        let sequence = Sequence::new(64);
        for (pixel, purpose) in [(1, 0), (77, 3), (12345, 4)] {
            let mut cells = [[0; 64]; 3];
            for index in 0..64 {
                let [x, y] = sequence.point(pixel, index, purpose);
                cells[0][(x * 64.0) as usize] += 1;
                cells[1][(y * 64.0) as usize] += 1;
                cells[2][(x * 8.0) as usize * 8 + (y * 8.0) as usize] += 1;
            }
            assert!(cells.iter().flatten().all(|&count| count == 1), "{pixel} {purpose}");
        }
    }
}
