//! Errors of a fit, under the names that reports use.

use super::model::{Model, Turned};
use super::samples::Samples;

/// Added before the logarithm of [`log_rms`], sr⁻¹: below it values count as equally dark.
pub const LOG_FLOOR: f64 = 1e-3;

/// RMS of ln(1e-3 + f̂ cosθ_o) − ln(1e-3 + f cosθ_o) over samples of (f̂, f, cosθ_o); negative measured
/// values count as 0.
pub fn log_rms(samples: impl Iterator<Item = (f64, f64, f64)>) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for (fitted, measured, cos_o) in samples {
        let log = |f: f64| (LOG_FLOOR + f.max(0.0) * cos_o).ln();
        sum += (log(fitted) - log(measured)).powi(2);
        count += 1;
    }
    (sum / f64::from(count.max(1))).sqrt()
}

/// ‖(f̂ − f) cosθ_o‖ / ‖f cosθ_o‖ over samples of (f̂, f, cosθ_o); 0 for black samples.
pub fn relative_l2(samples: impl Iterator<Item = (f64, f64, f64)>) -> f64 {
    let (mut error, mut whole) = (0.0, 0.0);
    for (fitted, measured, cos_o) in samples {
        error += ((fitted - measured) * cos_o).powi(2);
        whole += (measured * cos_o).powi(2);
    }
    if whole > 0.0 { (error / whole).sqrt() } else { 0.0 }
}

/// Sums over samples and channels of the squared residual and of the squared samples, sr⁻². `amplitudes`
/// holds, for each of the `channels`, ρ_d and the lobes' amplitudes.
pub fn squares(samples: &Samples, model: &Model, channels: &[usize], amplitudes: &[Vec<f64>]) -> (f64, f64) {
    let turned = Turned::new(model.beta);
    let (mut error, mut whole) = (0.0, 0.0);
    let mut shapes = vec![0.0; model.lobes.len()];
    for (k, rgb) in samples.rgb.iter().enumerate() {
        let products = turned.products(samples, k);
        for (shape, lobe) in shapes.iter_mut().zip(&model.lobes) {
            *shape = lobe.shape(products, samples.mean_cosine(k));
        }
        for (&channel, amplitudes) in channels.iter().zip(amplitudes) {
            let measured = rgb[channel];
            let lobes: f64 = shapes.iter().zip(&amplitudes[1..]).map(|(s, a)| s * a).sum();
            error += (amplitudes[0] + lobes - measured).powi(2);
            whole += measured * measured;
        }
    }
    (error, whole)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_two_errors_follow_their_definitions() {
        let samples = [(2.0, 1.0, 0.5), (0.0, -0.1, 1.0)];
        let log = ((1.001f64 / 0.501).ln().powi(2) / 2.0).sqrt();
        assert!((log_rms(samples.into_iter()) - log).abs() < 1e-12);
        let relative = ((0.25f64 + 0.01) / (0.25 + 0.01)).sqrt();
        assert!((relative_l2(samples.into_iter()) - relative).abs() < 1e-12);
        assert_eq!(relative_l2([(1.0, 0.0, 1.0)].into_iter()), 0.0);
    }
}
