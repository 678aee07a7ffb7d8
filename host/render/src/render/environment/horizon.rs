//! What a lobe near the horizon gathers: the cosine and the horizon within the lobe, tabulated for even
//! light.
//!
//! (6.18) takes the cosine at the lobe's peak and lets light from below the surface in. Here the factor is
//! the true H = ∫ (ω_p·ω)ⁿ (N·ω)₊ dω / ∫ (ω_p·ω)₊ⁿ dω, exact for even light, and the light is looked up under
//! a lobe of the clipped one's centroid and width: ∫ (ω_p·ω)ⁿ (N·ω)₊ L dω ≈ H (n' + 1)/(n + 1) S(ω_p', n').
//! For a lobe about the normal n' = n + 1, and the approximation is exact.

use std::f32::consts::{FRAC_PI_2, TAU};
use std::sync::OnceLock;

use glam::{DVec3, Vec3, Vec4};

/// Nodes over the peak's cosine −1..1 and over the exponent, 2^−2 to 2^12.
const SIZE: (usize, usize) = (97, 29);
const LOG2_LOW: f32 = -2.0;
const LOG2_STEP: f32 = 0.5;
/// Lobes below the horizon are sharpened no further: what is left of them is dim.
const SHARPEST: f64 = 3.0;

/// Factor and turn of a lobe.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Clipped {
    /// H.
    pub(crate) factor: f32,
    /// Angle from the peak to the clipped lobe's centroid, towards the normal, radians.
    pub(crate) turn: f32,
    /// (n' + 1) / (n + 1), n' the exponent of a whole lobe as wide as the clipped one.
    pub(crate) sharpness: f32,
}

impl Clipped {
    /// (6.18): the cosine at the peak, and the lobe as it is.
    pub(crate) fn at_peak(cosine: f32) -> Self {
        Self { factor: cosine.max(0.0), turn: 0.0, sharpness: 1.0 }
    }
}

/// The exponent that maps reach so that lobes of `n` can be sharpened. Above 64 clipping changes little but
/// near grazing view, where lobes keep the sharpest map's width instead: maps for twice the exponent would
/// take twice the work.
pub(crate) fn widest_clipped(n: f32) -> f32 {
    (2.0 * (n + 1.0)).min(64.0)
}

/// The table.
pub(crate) struct Horizon(Vec<Clipped>);

impl Horizon {
    /// The one table, computed when it is first asked for.
    pub(crate) fn table() -> &'static Self {
        static TABLE: OnceLock<Horizon> = OnceLock::new();
        TABLE.get_or_init(|| {
            let entry = |index: usize| {
                let cosine = (index % SIZE.0) as f32 / (SIZE.0 - 1) as f32 * 2.0 - 1.0;
                integrate(cosine, (LOG2_LOW + LOG2_STEP * (index / SIZE.0) as f32).exp2())
            };
            Self((0..SIZE.0 * SIZE.1).map(entry).collect())
        })
    }

    /// Factor and turn for the cosine between peak and normal, and the exponent.
    pub(crate) fn at(&self, cosine: f32, n: f32) -> Clipped {
        let x = (cosine * 0.5 + 0.5).clamp(0.0, 1.0) * (SIZE.0 - 1) as f32;
        let y = ((n.max(1e-3).log2() - LOG2_LOW) / LOG2_STEP).clamp(0.0, (SIZE.1 - 1) as f32);
        let (i, j) = ((x as usize).min(SIZE.0 - 2), (y as usize).min(SIZE.1 - 2));
        let (s, t) = (x - i as f32, y - j as f32);
        let mix = |row: usize, of: fn(&Clipped) -> f32| {
            let first = &self.0[row * SIZE.0 + i..];
            of(&first[0]) * (1.0 - s) + of(&first[1]) * s
        };
        let both = |of: fn(&Clipped) -> f32| mix(j, of) * (1.0 - t) + mix(j + 1, of) * t;
        Clipped { factor: both(|c| c.factor), turn: both(|c| c.turn), sharpness: both(|c| c.sharpness) }
    }

    /// The entries as the shader has them, cosine by cosine.
    pub(super) fn packed(&self) -> Vec<Vec4> {
        self.0.iter().map(|c| Vec4::new(c.factor, c.turn, c.sharpness, 0.0)).collect()
    }
}

/// By quadrature about the peak.
fn integrate(cosine: f32, n: f32) -> Clipped {
    const STEPS: (usize, usize) = (96, 96);
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    let normal = Vec3::new(sine, 0.0, cosine);
    let (mut factor, mut centroid) = (0.0f64, DVec3::ZERO);
    for i in 0..STEPS.0 {
        // Even in the lobe's own distribution.
        let z = ((i as f32 + 0.5) / STEPS.0 as f32).powf(1.0 / (n + 1.0));
        let radius = (1.0 - z * z).max(0.0).sqrt();
        for j in 0..STEPS.1 {
            let (sin, cos) = ((j as f32 + 0.5) / STEPS.1 as f32 * TAU).sin_cos();
            let direction = Vec3::new(radius * cos, radius * sin, z);
            let weight = f64::from(direction.dot(normal).max(0.0));
            factor += weight;
            centroid += direction.as_dvec3() * weight;
        }
    }
    if factor == 0.0 {
        return Clipped { factor: 0.0, turn: FRAC_PI_2, sharpness: 1.0 };
    }
    // A whole lobe's centroid has the length (n' + 1) / (n' + 2).
    let length = centroid.length() / factor;
    let sharpness = length / (1.0 - length).max(1e-12) / (f64::from(n) + 1.0);
    Clipped {
        factor: (factor / (STEPS.0 * STEPS.1) as f64) as f32,
        turn: centroid.x.atan2(centroid.z) as f32,
        sharpness: sharpness.clamp(1.0, SHARPEST) as f32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn closed_forms_of_the_factor() {
        let table = Horizon::table();
        // Straight up: ∫ cosⁿ⁺¹ / ∫ cosⁿ = (n + 1) / (n + 2).
        for n in [1.0f32, 4.0, 30.0, 500.0] {
            let up = table.at(1.0, n);
            assert!((up.factor - (n + 1.0) / (n + 2.0)).abs() < 1e-3 && up.turn.abs() < 1e-3, "{n} {up:?}");
            // What is left is cosⁿ⁺¹.
            assert!((up.sharpness - (n + 2.0) / (n + 1.0)).abs() < 2e-2, "{n} {up:?}");
        }
        // n = 1 in the plane of the surface: ∫ (x)₊ (z)₊ dω / π = 2/3 / π.
        assert!((table.at(0.0, 1.0).factor - 2.0 / 3.0 / std::f32::consts::PI).abs() < 1e-3);
        // A sharp lobe well above the horizon is the cosine itself.
        assert!((table.at(0.6, 2000.0).factor - 0.6).abs() < 1e-3);
        assert!(table.at(-1.0, 3.0).factor < 1e-4);
    }

    #[test]
    fn the_centroid_turns_towards_the_normal_and_ends_above_the_surface() {
        let table = Horizon::table();
        for n in [0.5, 2.0, 10.0, 200.0] {
            for k in 1..20 {
                let cosine = k as f32 / 10.0 - 1.0;
                let clipped = table.at(cosine, n);
                let angle = cosine.acos();
                assert!(clipped.turn >= -1e-3 && clipped.turn <= angle + 1e-3, "{n} {cosine} {clipped:?}");
                assert!(
                    angle - clipped.turn < FRAC_PI_2 || clipped.factor < 2e-4,
                    "{n} {cosine} {clipped:?}"
                );
            }
        }
    }
}
