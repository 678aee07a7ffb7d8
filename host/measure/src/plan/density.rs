//! How far apart direction pairs may lie so that p samples fall inside a highlight: (3.2) to (3.6).

use std::f64::consts::{FRAC_PI_2, TAU};

/// Level of cosⁿ that bounds a highlight.
const HIGHLIGHT_LEVEL: f64 = 0.3;

/// Samples wanted inside a highlight.
pub const SAMPLES_IN_HIGHLIGHT: f64 = 4.0;

/// Half-angle θ_r of the highlight of cosⁿ, radians: where cosⁿ θ_r = 0.3.
pub fn highlight_half_angle(n: f64) -> f64 {
    HIGHLIGHT_LEVEL.powf(1.0 / n).acos()
}

/// Number of samples m = p / g(θ_r) over the hemisphere, (3.2) and (3.3).
pub fn samples(n: f64) -> f64 {
    SAMPLES_IN_HIGHLIGHT / (1.0 - highlight_half_angle(n).cos())
}

/// Spacing θ_d in radians for directions on a hemisphere (3.4).
pub fn spacing_2d(n: f64) -> f64 {
    (highlight_solid_angle(n) / SAMPLES_IN_HIGHLIGHT).sqrt()
}

/// Spacing θ_d in radians for isotropic direction pairs (3.5).
pub fn spacing_3d(n: f64) -> f64 {
    (FRAC_PI_2 * highlight_solid_angle(n) / SAMPLES_IN_HIGHLIGHT).cbrt()
}

/// Spacing θ_d in radians for anisotropic direction pairs (3.6).
pub fn spacing_4d(n: f64) -> f64 {
    (TAU * highlight_solid_angle(n) / SAMPLES_IN_HIGHLIGHT).powf(0.25)
}

/// The largest exponent n that poses `spacing` radians apart resolve: (3.5) or (3.6) solved for n.
pub fn sharpest(spacing: f64, isotropic: bool) -> f64 {
    let solid_angle = if isotropic {
        spacing.powi(3) / FRAC_PI_2 * SAMPLES_IN_HIGHLIGHT
    } else {
        spacing.powi(4) / TAU * SAMPLES_IN_HIGHLIGHT
    };
    // cos θ_r = 1 − ζ_r/2π, and cosⁿ θ_r is the level.
    HIGHLIGHT_LEVEL.ln() / (1.0 - solid_angle / TAU).ln()
}

/// Solid angle ζ_r of the highlight, sr.
fn highlight_solid_angle(n: f64) -> f64 {
    TAU * (1.0 - highlight_half_angle(n).cos())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worked_example_of_the_source_comes_out() {
        let n = 128.0;
        assert!((highlight_half_angle(n).to_degrees() - 7.84).abs() < 0.02);
        assert!((samples(n) - 428.0).abs() < 1.0);
        assert!((spacing_2d(n).to_degrees() - 6.94).abs() < 0.02);
        assert!((spacing_3d(n).to_degrees() - 16.3).abs() < 0.05);
        assert!((spacing_4d(n).to_degrees() - 31.6).abs() < 0.1);
    }

    #[test]
    fn the_sharpest_exponent_has_the_spacing_that_it_asks_for() {
        for n in [2.0, 40.0, 900.0] {
            assert!((sharpest(spacing_3d(n), true) / n - 1.0).abs() < 1e-9);
            assert!((sharpest(spacing_4d(n), false) / n - 1.0).abs() < 1e-9);
        }
    }
}
