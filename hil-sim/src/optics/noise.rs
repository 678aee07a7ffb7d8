//! Random numbers as pure functions of a key, so that a frame's noise does not depend on what was taken before it.

use crate::noise::hash;

/// One key from several.
pub fn combine(keys: &[u64]) -> u64 {
    hash(keys)
}

/// Two independent uniform numbers, the first in (0, 1], the second in [0, 1).
fn uniform_pair(key: u64) -> (f32, f32) {
    let bits = hash(&[key]);
    let scale = 1.0 / (1u64 << 24) as f32;
    (((bits >> 40) + 1) as f32 * scale, (bits & 0x00ff_ffff) as f32 * scale)
}

/// A standard normal number (Box–Muller).
pub fn normal(key: u64) -> f32 {
    let (u, v) = uniform_pair(key);
    (-2.0 * u.ln()).sqrt() * (std::f32::consts::TAU * v).cos()
}

/// A Poisson number of the given mean: by inversion below 32, where the normal limit is still skew.
pub fn poisson(key: u64, mean: f32) -> f32 {
    if mean <= 0.0 {
        return 0.0;
    }
    if mean >= 32.0 {
        return (mean + mean.sqrt() * normal(key)).max(0.0);
    }
    let (mut u, _) = uniform_pair(key);
    let mut count = 0.0;
    let mut term = (-mean).exp();
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
    fn check(mean: f32) {
        let count = 200_000u64;
        let values: Vec<f64> =
            (0..count).map(|k| f64::from(poisson(combine(&[7, mean.to_bits().into(), k]), mean))).collect();
        let average = values.iter().sum::<f64>() / count as f64;
        let variance = values.iter().map(|v| (v - average).powi(2)).sum::<f64>() / count as f64;
        let mean = f64::from(mean);
        assert!((average - mean).abs() < 5.0 * (mean / count as f64).sqrt(), "{average} {mean}");
        assert!((variance / mean - 1.0).abs() < 0.03, "{variance} {mean}");
    }

    #[test]
    fn poisson_numbers_have_mean_and_variance_of_their_law_on_both_sides_of_the_switch() {
        [0.3, 4.0, 31.0, 33.0, 1000.0].into_iter().for_each(check);
    }
}
