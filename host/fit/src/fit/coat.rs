//! The microfacet term of a fit: values and derivatives of [`Microfacet`](lobelia_reflectance::Microfacet)
//! for one wavelength.
//!
//! f = (f0 (1 − w) + f90 w) S(α), w = (1 − cosθ_d)⁵: linear in f0 and f90, so α alone is a shape.

use super::samples::Samples;

/// Bounds of α.
pub(crate) const WIDTHS: [f64; 2] = [1e-3, 1.0];

/// A microfacet term of one value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coat {
    /// Fresnel reflectance at θ_d = 0, 0..1.
    pub f0: f64,
    /// Fresnel reflectance at θ_d = 90°, 0..1.
    pub f90: f64,
    /// Width α of the distribution of slopes.
    pub alpha: f64,
}

impl Coat {
    /// The value for sample k, sr⁻¹.
    pub fn value(&self, samples: &Samples, k: usize) -> f64 {
        let (weight, shape, _) = parts(self.alpha, cosines(samples, k));
        (self.f0 + (self.f90 - self.f0) * weight) * shape
    }

    /// Derivatives of the value for sample k by f0, f90 and ln α.
    pub fn derivatives(&self, samples: &Samples, k: usize) -> [f64; 3] {
        let (weight, shape, slope) = parts(self.alpha, cosines(samples, k));
        let fresnel = self.f0 + (self.f90 - self.f0) * weight;
        [(1.0 - weight) * shape, weight * shape, fresnel * shape * slope]
    }
}

/// cosθ_i, cosθ_o and ω_i·ω_o of sample k.
fn cosines(samples: &Samples, k: usize) -> [f64; 3] {
    let (cos_o, both) = (samples.cos_o[k], samples.zz[k]);
    [both / cos_o, cos_o, samples.xx[k] + samples.yy[k] + both]
}

/// w, S = D G / (4 cosθ_i cosθ_o) and the derivative of its logarithm by ln α, for cosθ_i, cosθ_o and
/// ω_i·ω_o.
#[inline(always)]
pub(crate) fn parts(alpha: f64, [cos_i, cos_o, dot]: [f64; 3]) -> (f64, f64, f64) {
    // |ω_i + ω_o|² and the half vector's squared cosine.
    let length2 = (2.0 * (1.0 + dot)).max(1e-12);
    let sum = cos_i + cos_o;
    let cos2 = (sum * sum / length2).min(1.0);
    let alpha2 = alpha * alpha;
    let width = 1.0 - cos2 + alpha2 * cos2;
    let distribution = alpha2 / (std::f64::consts::PI * width * width);
    // Smith's Λ and its derivative by ln α.
    let smith = |cosine: f64| {
        let square = alpha2 * (1.0 / (cosine * cosine) - 1.0).max(0.0);
        let root = (1.0 + square).sqrt();
        (0.5 * (root - 1.0), 0.5 * square / root)
    };
    let ((lambda_i, slope_i), (lambda_o, slope_o)) = (smith(cos_i), smith(cos_o));
    let shadowing = 1.0 / (1.0 + lambda_i + lambda_o);
    let slope = 2.0 - 4.0 * alpha2 * cos2 / width - shadowing * (slope_i + slope_o);
    let weight = (1.0 - 0.5 * length2.sqrt()).max(0.0).powi(5);
    (weight, distribution * shadowing / (4.0 * cos_i * cos_o), slope)
}

#[cfg(test)]
mod tests {
    use super::super::testing;
    use super::*;
    use lobelia_reflectance::{Microfacet, Rgb};

    #[test]
    fn value_and_slopes_are_those_of_the_microfacet_term() {
        let pairs = testing::directions(60, 8);
        let samples = testing::samples(&pairs, |_, _| Rgb::ONE);
        for alpha in [0.02, 0.3, 0.9] {
            let coat = Coat { f0: 0.05, f90: 0.8, alpha };
            let term = Microfacet { f0: Rgb::splat(0.05), f90: Rgb::splat(0.8), alpha: alpha as f32 };
            for (k, &(wi, wo)) in pairs.iter().enumerate() {
                let (value, expected) = (coat.value(&samples, k), f64::from(term.eval(wi, wo).x));
                assert!((value / expected - 1.0).abs() < 2e-3, "{alpha} {value} {expected}");
                let derivatives = coat.derivatives(&samples, k);
                let step = 1e-5;
                for (unknown, derivative) in derivatives.into_iter().enumerate() {
                    let moved = |by: f64| match unknown {
                        0 => Coat { f0: coat.f0 + by, ..coat },
                        1 => Coat { f90: coat.f90 + by, ..coat },
                        _ => Coat { alpha: coat.alpha * by.exp(), ..coat },
                    };
                    let numeric =
                        (moved(step).value(&samples, k) - moved(-step).value(&samples, k)) / (2.0 * step);
                    assert!(
                        (numeric - derivative).abs() < 1e-4 * value + 1e-9,
                        "{unknown} {numeric} {derivative}"
                    );
                }
            }
        }
    }
}
