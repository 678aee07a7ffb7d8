//! The mean of max(0, cosθ_o) over directions spread as cosⁿγ about a peak: the part of a cosine lobe above
//! the horizon, times its cosine.
//!
//! With u = cosⁿ⁺¹γ even in 0..1 and the azimuth about the peak in closed form one sum over u is left. It
//! depends on n and on the cosine of the peak's polar angle alone, so a table of its logarithm, made once,
//! serves all lobes.

use std::f64::consts::PI;
use std::sync::LazyLock;

/// Parts of the sum over u.
const PARTS: usize = 128;
/// Places of the table along asinh(up √(n + 1)), from one pole to the other, and along ln(n + 1).
const ACROSS: usize = 401;
const ALONG: usize = 128;
/// Exponents beyond this are summed.
const MOST_EXPONENT: f64 = 5000.0;
/// Logarithm of what counts as nothing.
const NOTHING: f64 = -80.0;

/// Logarithms of the mean, `[along][across]`.
static TABLE: LazyLock<Vec<f32>> = LazyLock::new(|| {
    let last = (MOST_EXPONENT + 1.0).ln();
    let mut table = Vec::with_capacity(ALONG * ACROSS);
    for along in 0..ALONG {
        let n = (along as f64 / (ALONG - 1) as f64 * last).exp() - 1.0;
        let root = (n + 1.0).sqrt();
        let up = |k: usize| ((2.0 * k as f64 / (ACROSS - 1) as f64 - 1.0) * root.asinh()).sinh() / root;
        let angles = angles(n);
        let mut row: Vec<f64> = (0..ACROSS).map(|k| sum_of(&angles, up(k)).ln().max(NOTHING)).collect();
        // At the lower pole nothing is above the horizon; its logarithm goes on as it came.
        row[0] = (2.0 * row[1] - row[2]).max(NOTHING);
        table.extend(row.into_iter().map(|log| log as f32));
    }
    table
});

/// The mean for a peak whose polar angle has the cosine `up`, −1..1, and an exponent n ≥ 0; errors below 2 %
/// where it is above 1e-4, 1 % above 1e-2.
pub(super) fn mean_cosine(up: f64, n: f64) -> f64 {
    if !(0.0..=MOST_EXPONENT).contains(&n) {
        return summed(up, n);
    }
    let root = (n + 1.0).sqrt();
    let across = 0.5 * ((up.clamp(-1.0, 1.0) * root).asinh() / root.asinh() + 1.0) * (ACROSS - 1) as f64;
    let along = (n + 1.0).ln() / (MOST_EXPONENT + 1.0).ln() * (ALONG - 1) as f64;
    let (i, j) = ((along as usize).min(ALONG - 2), (across as usize).min(ACROSS - 2));
    let (s, t) = (along - i as f64, across - j as f64);
    let row = |i: usize| {
        let at = |j: usize| f64::from(TABLE[i * ACROSS + j]);
        at(j) + t * (at(j + 1) - at(j))
    };
    (row(i) + s * (row(i + 1) - row(i))).exp()
}

/// The sum over u, by the midpoint rule.
fn summed(up: f64, n: f64) -> f64 {
    sum_of(&angles(n), up)
}

/// Cosine and sine of γ in the middle of each part.
fn angles(n: f64) -> [[f64; 2]; PARTS] {
    std::array::from_fn(|part| {
        let cos = ((part as f64 + 0.5) / PARTS as f64).powf(1.0 / (n + 1.0));
        [cos, (1.0 - cos * cos).max(0.0).sqrt()]
    })
}

/// The mean over the parts for a peak whose polar angle has the cosine `up`.
fn sum_of(angles: &[[f64; 2]; PARTS], up: f64) -> f64 {
    let across = (1.0 - up * up).max(0.0).sqrt();
    let mut sum = 0.0;
    for [cos, sin] in angles {
        // The mean of max(0, a + b cosφ) over φ.
        let (a, b) = (up * cos, across * sin);
        sum += if a >= b {
            a
        } else if a > -b {
            let edge = (-a / b).acos();
            (a * edge + b * edge.sin()) / PI
        } else {
            0.0
        };
    }
    sum / PARTS as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_agrees_with_the_sum() {
        let mut worst = [0.0f64; 2];
        for step in 0..3000 {
            let n = 5000f64.powf((f64::from(step) * 0.618).fract()) - 0.5;
            let up = 2.0 * (f64::from(step) * 0.7549).fract() - 1.0;
            // Peaks close to the horizon matter most.
            let up = if step % 2 == 0 { up } else { 3.0 * up / (n + 1.0).sqrt() }.clamp(-1.0, 1.0);
            let (found, sum) = (mean_cosine(up, n), summed(up, n));
            if sum > 1e-4 {
                let worst = &mut worst[usize::from(sum > 1e-2)];
                *worst = worst.max((found / sum - 1.0).abs());
            } else {
                assert!(found < 2e-4, "{up} {n}: {found} {sum}");
            }
        }
        assert!(worst[0] < 2e-2 && worst[1] < 1e-2, "{worst:?}");
    }

    #[test]
    fn a_peak_along_the_normal_has_the_closed_form() {
        for n in [0.0, 1.0, 7.0, 60.0, 900.0, 5000.0] {
            let expected = (n + 1.0) / (n + 2.0);
            assert!((mean_cosine(1.0, n) / expected - 1.0).abs() < 1e-3, "{n}");
        }
    }
}
