//! Powers of f32 fast enough to be taken for every lobe of every sample, and inlined into the loops that do.

/// x^y for x > 0, y ≥ 0. Relative error about 2e-7 · y · |log₂ x| + 3e-7; 0 below 2^−126.
#[inline]
pub(crate) fn powf(x: f32, y: f32) -> f32 {
    exp2(y * log2(x))
}

/// log₂ x for a normal x > 0: exponent bits, and the series of 2 artanh(t), t = (m − 1)/(m + 1), for the
/// mantissa.
#[inline]
pub(crate) fn log2(x: f32) -> f32 {
    const SQRT_HALF_BITS: i32 = 0x3f35_04f3;
    let bits = x.to_bits() as i32;
    let exponent = (bits - SQRT_HALF_BITS) >> 23;
    let mantissa = f32::from_bits((bits - (exponent << 23)) as u32);
    let t = (mantissa - 1.0) / (mantissa + 1.0);
    let square = t * t;
    let series = 2.0 * std::f32::consts::LOG2_E
        + square * (0.961_796_7 + square * (0.577_078 + square * (0.412_198_6 + square * 0.320_598_9)));
    exponent as f32 + t * series
}

/// 2^y; 0 below −126, saturating above 127.
#[inline]
pub(crate) fn exp2(y: f32) -> f32 {
    let tiny = y < -126.0;
    let y = y.clamp(-126.0, 127.499);
    // Adding 1.5 · 2²³ leaves the nearest integer in the low bits.
    const ROUND: f32 = 12_582_912.0;
    let shifted = y + ROUND;
    let f = y - (shifted - ROUND);
    let exponent = (shifted.to_bits() as i32).wrapping_sub(ROUND.to_bits() as i32);
    let series = 1.0
        + f * (std::f32::consts::LN_2
            + f * (0.240_226_5
                + f * (0.055_504_11 + f * (0.009_618_13 + f * (0.001_333_355_8 + f * 0.000_154_035_3)))));
    let value = f32::from_bits((series.to_bits() as i32).wrapping_add(exponent << 23) as u32);
    // Chosen at the end, without a branch, so that loops over many values use vector units.
    if tiny { 0.0 } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_have_the_stated_relative_error() {
        for i in 1..2000 {
            let x = i as f32 / 1600.0;
            for y in [0.0f32, 0.5, 1.0, 2.5, 12.0, 110.0, 700.0, 2000.0] {
                let exact = f64::from(x).powf(f64::from(y));
                if !(1e-37..1e37).contains(&exact) {
                    continue;
                }
                let bound = 3e-7 + 2e-7 * f64::from(y) * f64::from(x).log2().abs();
                let error = (f64::from(powf(x, y)) / exact - 1.0).abs();
                assert!(error <= bound, "{x}^{y}: {error} > {bound}");
            }
        }
        assert_eq!(powf(1.0, 2000.0), 1.0);
        assert_eq!(powf(0.5, 500.0), 0.0);
    }
}
