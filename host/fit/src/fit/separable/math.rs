//! ln and exp that compilers turn into vector code: no branches, no tables, no calls.
//!
//! Without fused multiply-add, so that every machine gives the same bits.

/// ln x of a positive normal number; relative error below 1e-12 or absolute error below 1e-13, whichever is
/// larger.
#[inline(always)]
pub fn ln(x: f64) -> f64 {
    const ONE: u64 = 0x3ff0_0000_0000_0000;
    const ROOT_HALF: u64 = 0x3fe6_a09e_667f_3bcd;
    const TWO_52: u64 = 0x4330_0000_0000_0000;
    let bits = x.to_bits();
    // x = 2^e m with √½ ≤ m < √2; e + 1023 becomes the mantissa of 2⁵² + e + 1023.
    let biased = bits.wrapping_add(ONE - ROOT_HALF) >> 52;
    let m = f64::from_bits(bits.wrapping_sub(biased.wrapping_sub(1023) << 52));
    let e = f64::from_bits(biased | TWO_52) - (4_503_599_627_370_496.0 + 1023.0);
    // ln m = 2 artanh s, |s| < 0.172.
    let s = (m - 1.0) / (m + 1.0);
    let z = s * s;
    let series = 1.0 / 15.0;
    let series = series * z + 1.0 / 13.0;
    let series = series * z + 1.0 / 11.0;
    let series = series * z + 1.0 / 9.0;
    let series = series * z + 1.0 / 7.0;
    let series = series * z + 1.0 / 5.0;
    let series = series * z + 1.0 / 3.0;
    let series = series * z + 1.0;
    e * std::f64::consts::LN_2 + 2.0 * s * series
}

/// eˣ for −700 ≤ x ≤ 700; relative error below 1e-12.
#[inline(always)]
pub fn exp(x: f64) -> f64 {
    // 1.5 · 2⁵²: a sum with it has the nearest integer in its lowest bits.
    const MAGIC: f64 = 6_755_399_441_055_744.0;
    const LN_2_HIGH: f64 = 6.931_471_803_691_238e-1;
    const LN_2_LOW: f64 = 1.908_214_929_270_587_7e-10;
    let shifted = x * std::f64::consts::LOG2_E + MAGIC;
    let k = shifted - MAGIC;
    // |r| < 0.347
    let r = x - k * LN_2_HIGH - k * LN_2_LOW;
    let series = 1.0 / 3_628_800.0;
    let series = series * r + 1.0 / 362_880.0;
    let series = series * r + 1.0 / 40_320.0;
    let series = series * r + 1.0 / 5_040.0;
    let series = series * r + 1.0 / 720.0;
    let series = series * r + 1.0 / 120.0;
    let series = series * r + 1.0 / 24.0;
    let series = series * r + 1.0 / 6.0;
    let series = series * r + 0.5;
    let series = series * r + 1.0;
    let series = series * r + 1.0;
    let power = f64::from_bits(shifted.to_bits().wrapping_add(1023) << 52);
    series * power
}

/// Σ a b of two lists with each of three, in [`LANES`] partial sums; the lists' common length is a multiple
/// of [`LANES`].
///
/// Every value that is read goes into two or three sums, as many as processors with 16 vector registers have
/// room for.
#[inline(always)]
pub fn dots(a: [&[f64]; 2], b: [&[f64]; 3]) -> [[f64; 3]; 2] {
    let [a0, a1] = a.map(|list| list.as_chunks::<LANES>().0.iter());
    let [b0, b1, b2] = b.map(|list| list.as_chunks::<LANES>().0.iter());
    // Six lists by name: a compiler keeps these in registers, and an array of them in memory.
    let [mut s00, mut s01, mut s02, mut s10, mut s11, mut s12] = [[0.0; LANES]; 6];
    for ((((a0, a1), b0), b1), b2) in a0.zip(a1).zip(b0).zip(b1).zip(b2) {
        let (a0, a1, b0, b1, b2) = (*a0, *a1, *b0, *b1, *b2);
        for lane in 0..LANES {
            s00[lane] += a0[lane] * b0[lane];
            s01[lane] += a0[lane] * b1[lane];
            s02[lane] += a0[lane] * b2[lane];
            s10[lane] += a1[lane] * b0[lane];
            s11[lane] += a1[lane] * b1[lane];
            s12[lane] += a1[lane] * b2[lane];
        }
    }
    let [t00, t01, t02, t10, t11, t12] = totals(&[s00, s01, s02, s10, s11, s12]);
    [[t00, t01, t02], [t10, t11, t12]]
}

/// The sums of all lanes of each list. Not inlined: beside these sums, compilers make no vector code of the
/// loop before them.
#[inline(never)]
fn totals(lists: &[[f64; LANES]; 6]) -> [f64; 6] {
    let mut totals = [0.0; 6];
    for (total, s) in totals.iter_mut().zip(lists) {
        *total = ((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7]));
    }
    totals
}

/// Sample lists are filled up to a multiple of this many with samples of weight 0.
pub const LANES: usize = 8;

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_base::random::Random;

    #[test]
    fn ln_and_exp_keep_their_stated_errors() {
        let mut random = Random::new(1);
        for _ in 0..200_000 {
            let x = random.uniform(-30.0, 5.0).exp();
            let error = (ln(x) - x.ln()).abs();
            assert!(error < 1e-12 * x.ln().abs() || error < 1e-13, "ln {x:e}: {error:e}");
            let near = random.uniform(0.99, 1.01);
            assert!((ln(near) - near.ln()).abs() < 1e-12 * near.ln().abs() + 1e-18, "ln {near}");
            let y = random.uniform(-700.0, 700.0);
            assert!((exp(y) / y.exp() - 1.0).abs() < 1e-12, "exp {y}: {:e}", exp(y) / y.exp() - 1.0);
        }
        assert_eq!((ln(1.0), exp(0.0)), (0.0, 1.0));
    }

    #[test]
    fn dots_of_any_length_agree_with_plain_sums() {
        for count in [0, 8, 16, 24, 456] {
            let list = |slope: f64| -> Vec<f64> { (0..count).map(|k| slope * f64::from(k) - 3.5).collect() };
            let lists: [Vec<f64>; 5] = std::array::from_fn(|i| list(0.5 + i as f64));
            let [a0, a1, b0, b1, b2] = lists.each_ref().map(Vec::as_slice);
            let found = dots([a0, a1], [b0, b1, b2]);
            for (i, a) in [a0, a1].into_iter().enumerate() {
                for (j, b) in [b0, b1, b2].into_iter().enumerate() {
                    let plain: f64 = a.iter().zip(b).map(|(x, y)| x * y).sum();
                    assert!((found[i][j] - plain).abs() <= 1e-12 * plain.abs());
                }
            }
        }
    }
}
