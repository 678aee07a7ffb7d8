//! Random numbers as pure functions of a key, so that a frame's noise does not depend on what was taken
//! before it.

use std::sync::LazyLock;

use crate::noise::hash;

/// One key from several.
pub fn combine(keys: &[u64]) -> u64 {
    hash(keys)
}

/// Quantiles of the standard normal distribution at (k + ½) / 65536: a frame draws millions of numbers, and a
/// look-up costs a fifth of Box and Muller's formula. Scaled to variance 1, which the cut tails would miss by
/// 4e-5.
static QUANTILES: LazyLock<Box<[f32; LEVELS]>> = LazyLock::new(|| {
    let raw: Vec<f64> = (0..LEVELS).map(|k| quantile((k as f64 + 0.5) / LEVELS as f64)).collect();
    let deviation = (raw.iter().map(|q| q * q).sum::<f64>() / LEVELS as f64).sqrt();
    let mut table = Box::new([0.0; LEVELS]);
    for (entry, q) in table.iter_mut().zip(raw) {
        *entry = (q / deviation) as f32;
    }
    table
});

const LEVELS: usize = 1 << 16;

/// The normal quantile by Newton's method on the error function's series; exact to rounding for |q| below 5.
fn quantile(p: f64) -> f64 {
    let mut q = 0.0f64;
    for _ in 0..60 {
        let density = (-0.5 * q * q).exp() / std::f64::consts::TAU.sqrt();
        // At most one step of ½, since Newton's method overshoots far out in the tails.
        let step = ((cumulative(q, density) - p) / density).clamp(-0.5, 0.5);
        q -= step;
        if step.abs() < 1e-12 {
            break;
        }
    }
    q
}

/// Φ(q) by the series ½ + φ(q) (q + q³/3 + q⁵/15 + …), which has no cancellation.
fn cumulative(q: f64, density: f64) -> f64 {
    let (mut term, mut sum, mut odd) = (q, q, 1.0);
    while term.abs() > 1e-17 * sum.abs() && odd < 400.0 {
        odd += 2.0;
        term *= q * q / odd;
        sum += term;
    }
    0.5 + density * sum
}

/// The 16 bits of a hash from `shift` on as an index into the quantiles.
fn level(bits: u64, shift: u32) -> usize {
    (bits >> shift) as usize & (LEVELS - 1)
}

/// The electrons that a pixel gives for a mean of `mean` electrons and read noise of `read` electrons RMS:
/// shot noise by inversion of Poisson's law below 32, where the normal limit is still skew, and one normal
/// number for both above.
pub fn electrons(key: u64, mean: f32, read: f32) -> f32 {
    let bits = hash(&[key]);
    let table = &**QUANTILES;
    if mean >= 32.0 {
        return (mean + (mean + read * read).sqrt() * table[level(bits, 0)]).max(-8.0 * read);
    }
    let uniform = ((bits >> 40) + 1) as f32 / (1u64 << 24) as f32;
    poisson_by_inversion(uniform, mean.max(0.0)) + read * table[level(bits, 0)]
}

/// The Poisson number whose cumulative probability first reaches `u`, for small means.
fn poisson_by_inversion(mut u: f32, mean: f32) -> f32 {
    let (mut count, mut term) = (0.0, (-mean).exp());
    while u > term && count < 200.0 {
        u -= term;
        count += 1.0;
        term *= mean / count;
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean and variance over 200,000 keys lie within five standard errors of the mean's.
    fn check(mean: f32, read: f32) {
        let count = 200_000u64;
        let draw = |k| f64::from(electrons(combine(&[7, mean.to_bits().into(), k]), mean, read));
        let values: Vec<f64> = (0..count).map(draw).collect();
        let average = values.iter().sum::<f64>() / count as f64;
        let variance = values.iter().map(|v| (v - average).powi(2)).sum::<f64>() / count as f64;
        let expected = f64::from(mean + read * read);
        let mean = f64::from(mean);
        assert!((average - mean).abs() < 5.0 * (expected / count as f64).sqrt(), "{average} {mean}");
        assert!((variance / expected - 1.0).abs() < 0.03, "{variance} {expected}");
    }

    #[test]
    fn electrons_have_mean_and_variance_of_shot_and_read_noise_on_both_sides_of_the_switch() {
        for mean in [0.0, 0.3, 4.0, 31.0, 33.0, 1000.0] {
            check(mean, 6.0);
        }
        check(0.3, 0.0);
    }

    #[test]
    fn quantiles_are_those_of_the_normal_law() {
        for (p, q) in [(0.5, 0.0), (0.975, 1.959_963_985), (0.001, -3.090_232_306), (0.999_99, 4.264_890_794)]
        {
            assert!((quantile(p) - q).abs() < 1e-8, "{p} {}", quantile(p));
        }
    }
}
