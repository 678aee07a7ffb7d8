//! The diffuse term as a low percentile of the samples (section 4 of the spec): not the minimum, below which
//! noise dips.

/// The `percentile` (0..100) of the values, by linear interpolation between order statistics; 0 at least.
/// Reorders `values`.
pub(crate) fn percentile(values: &mut [f64], percentile: f64) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let place = (percentile / 100.0).clamp(0.0, 1.0) * (values.len() - 1) as f64;
    let below = place.floor() as usize;
    let (_, &mut low, above) = values.select_nth_unstable_by(below, f64::total_cmp);
    let high = above.iter().copied().min_by(f64::total_cmp).unwrap_or(low);
    (low + (high - low) * place.fract()).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_lie_between_order_statistics_and_are_not_negative() {
        let mut values = [5.0, 1.0, 3.0, 2.0, 4.0];
        assert_eq!(percentile(&mut values, 0.0), 1.0);
        assert_eq!(percentile(&mut values, 50.0), 3.0);
        assert!((percentile(&mut values, 10.0) - 1.4).abs() < 1e-12);
        assert_eq!(percentile(&mut values, 100.0), 5.0);
        assert_eq!(percentile(&mut [-1.0, -0.5], 50.0), 0.0);
        assert_eq!(percentile(&mut [], 10.0), 0.0);
    }
}
