//! Scatter as a function of what it scatters: hashes, uniform and normal numbers without a state.

/// Mixes keys into 64 well-spread bits (splitmix64's finaliser after each key).
pub(crate) fn hash(keys: &[u64]) -> u64 {
    keys.iter().fold(0x9e37_79b9_7f4a_7c15, |state, &key| {
        let mut z = (state ^ key).wrapping_add(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    })
}

/// Uniform in [0, 1).
pub(crate) fn unit(keys: &[u64]) -> f64 {
    (hash(keys) >> 11) as f64 / (1u64 << 53) as f64
}

/// Uniform in [−1, 1).
pub(crate) fn symmetric(keys: &[u64]) -> f64 {
    2.0 * unit(keys) - 1.0
}

/// Normal with mean 0 and standard deviation 1 (Box–Muller).
pub(crate) fn normal(keys: &[u64]) -> f64 {
    let first = hash(keys);
    let radius = (-2.0 * (1.0 - unit(&[first, 1])).ln()).sqrt();
    radius * (std::f64::consts::TAU * unit(&[first, 2])).cos()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_the_moments_of_their_distributions() {
        let count = 100_000;
        let mean = |f: &dyn Fn(u64) -> f64| (0..count).map(f).sum::<f64>() / count as f64;
        // Five standard errors of each mean.
        let five = 5.0 / (count as f64).sqrt();
        assert!(mean(&|k| symmetric(&[7, k])).abs() < five * (1.0f64 / 3.0).sqrt());
        assert!((mean(&|k| symmetric(&[7, k]).powi(2)) - 1.0 / 3.0).abs() < five * (4.0f64 / 45.0).sqrt());
        assert!(mean(&|k| normal(&[7, k])).abs() < five);
        assert!((mean(&|k| normal(&[7, k]).powi(2)) - 1.0).abs() < five * 2.0f64.sqrt());
    }
}
