//! What a microfacet term gathers of light from afar, tabulated by the exitant direction's cosine and the
//! roughness √α: its albedo, split by Schlick's F into a part of f0 and a part of f90 (Karis 2013), and two
//! cosine lobes, one for the peak and one for GGX's long tail, whose mixture is the likeliest of the
//! reflected light's directions (expectation maximisation); light is looked up under them:
//!
//! L(ω_r) ≈ (f0 A + f90 B) Σ_k w_k (n_k + 1) / 2π S(ω_k, n_k)
//!
//! It is exact for even light.

use std::sync::OnceLock;

use glam::{DVec3, Vec3, Vec4};
use rayon::prelude::*;

use lobelia_reflectance::{Microfacet, Rgb};

/// Nodes over the cosine 0..1 and over the roughness 0..1.
const SIZE: usize = 33;
/// Exponents, the sharpest for want of time: maps of sharper ones would take too long to make.
const EXPONENTS: [f64; 2] = [0.25, 4096.0];
/// What stands for a cosine and a roughness of 0.
const LEAST: f32 = 1e-3;
/// Samples along each of two axes, and rounds, of a fit.
const STEPS: u32 = 24;
const ROUNDS: u32 = 24;

/// How a term gathers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Gathered {
    /// Albedo by a unit of f0 and by one of f90.
    pub(super) albedo: [f32; 2],
    /// The lobes.
    pub(super) lobes: [Part; 2],
}

/// A cosine lobe that stands for a part of the reflected light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Part {
    /// Of all light.
    pub(super) share: f32,
    /// Angle between the normal and the lobe, on the side away from the exitant direction.
    pub(super) angle: f32,
    /// Exponent.
    pub(super) n: f32,
}

/// The table: albedos, the first lobe's share and nothing; angle and log₂ n of each lobe.
pub(super) struct Coats(Vec<[Vec4; 2]>);

impl Coats {
    /// The one table, computed when it is first asked for.
    pub(super) fn table() -> &'static Self {
        static TABLE: OnceLock<Coats> = OnceLock::new();
        TABLE.get_or_init(|| {
            let node = |k: usize| (k as f32 / (SIZE - 1) as f32).max(LEAST);
            Self((0..SIZE * SIZE).into_par_iter().map(|k| entry(node(k / SIZE), node(k % SIZE))).collect())
        })
    }

    /// Between the nodes.
    pub(super) fn at(&self, cosine: f32, alpha: f32) -> Gathered {
        let last = (SIZE - 1) as f32;
        let (x, y) = (cosine.clamp(0.0, 1.0) * last, alpha.sqrt().clamp(0.0, 1.0) * last);
        let (i, j) = ((x as usize).min(SIZE - 2), (y as usize).min(SIZE - 2));
        let node = |i: usize, j: usize, half: usize| self.0[i * SIZE + j][half];
        let row = |i: usize, half: usize| node(i, j, half).lerp(node(i, j + 1, half), y - j as f32);
        let [whole, lobes] = [0, 1].map(|half| row(i, half).lerp(row(i + 1, half), x - i as f32));
        let part = |share: f32, angle: f32, log2_n: f32| Part { share, angle, n: log2_n.exp2() };
        Gathered {
            albedo: [whole.x, whole.y],
            lobes: [part(whole.z, lobes.x, lobes.y), part(1.0 - whole.z, lobes.z, lobes.w)],
        }
    }

    /// Exponents of an α at all cosines, the least and the largest.
    pub(super) fn exponents(&self, alpha: f32) -> [f32; 2] {
        let at = |i: usize| self.at(i as f32 / (SIZE - 1) as f32, alpha).lobes;
        let all = (0..SIZE).flat_map(|i| at(i).map(|lobe| lobe.n));
        all.fold([f32::INFINITY, 0.0], |[low, high], n| [low.min(n), high.max(n)])
    }

    /// The entries as the shader has them.
    pub(super) fn packed(&self) -> &[[Vec4; 2]] {
        &self.0
    }
}

/// A direction that light comes from, and how much.
type Weighted = (DVec3, f64);

/// By samples of the normals that are seen, whose weights are G / G₁.
fn entry(cosine: f32, roughness: f32) -> [Vec4; 2] {
    let white = Microfacet { f0: Rgb::ONE, f90: Rgb::ONE, alpha: roughness * roughness };
    let wo = Vec3::new((1.0 - cosine * cosine).max(0.0).sqrt(), 0.0, cosine);
    let (mut f0, mut f90) = (0.0, 0.0);
    let mut light: Vec<Weighted> = Vec::new();
    for k in 0..STEPS * STEPS {
        let at = |k: u32| (k as f32 + 0.5) / STEPS as f32;
        let wi = white.sample(wo, [at(k % STEPS), at(k / STEPS)]);
        if wi.z > 0.0 {
            let weight = f64::from(white.eval(wi, wo).x * wi.z / white.density(wi, wo));
            let grazing = (1.0 - 0.5 * f64::from((wi + wo).length())).max(0.0).powi(5);
            f0 += weight * (1.0 - grazing);
            f90 += weight * grazing;
            light.push((wi.as_dvec3(), weight));
        }
    }
    let whole = f64::from(STEPS * STEPS);
    let [peak, tail] = mixture(&light, f0 + f90);
    let packed = |lobe: &Component| (angle(lobe.toward) as f32, lobe.n.log2() as f32);
    let ((a, m), (b, n)) = (packed(&peak), packed(&tail));
    [Vec4::new((f0 / whole) as f32, (f90 / whole) as f32, peak.share as f32, 0.0), Vec4::new(a, m, b, n)]
}

/// Angle from the normal, away from the exitant direction.
fn angle(toward: DVec3) -> f64 {
    (-toward.x).atan2(toward.z)
}

/// A lobe of a mixture.
struct Component {
    share: f64,
    toward: DVec3,
    n: f64,
}

impl Component {
    /// log of the base, which may be 0.
    fn log_base(&self, direction: DVec3) -> f64 {
        direction.dot(self.toward).max(1e-6).ln()
    }
}

/// The likeliest mixture of two lobes with density (n + 1) / 2π (ω_p·ω)ⁿ for directions whose weights have
/// the sum `whole`.
fn mixture(light: &[Weighted], whole: f64) -> [Component; 2] {
    let centroid: DVec3 = light.iter().map(|&(wi, weight)| wi * weight).sum();
    let start = |factor: f64| {
        let mut lobe = Component { share: 0.5, toward: centroid.normalize(), n: 0.0 };
        let sum: f64 = light.iter().map(|&(wi, weight)| weight * lobe.log_base(wi)).sum();
        lobe.n = (-whole / sum * factor).clamp(EXPONENTS[0], EXPONENTS[1]);
        lobe
    };
    // A sharper one and a wider one than the likeliest alone.
    let mut lobes = [start(4.0), start(0.7)];
    for _ in 0..ROUNDS {
        let mut parts = [0.0; 2];
        let mut sums = [DVec3::ZERO; 2];
        let belongs: Vec<[f64; 2]> = (light.iter())
            .map(|&(wi, weight)| {
                let likely = lobes
                    .each_ref()
                    .map(|lobe| lobe.share * (lobe.n + 1.0) * (lobe.n * lobe.log_base(wi)).exp());
                likely.map(|value| weight * value / (likely[0] + likely[1]).max(f64::MIN_POSITIVE))
            })
            .collect();
        for (&(wi, _), belongs) in light.iter().zip(&belongs) {
            for k in 0..2 {
                parts[k] += belongs[k];
                sums[k] += wi * belongs[k];
            }
        }
        for (k, lobe) in lobes.iter_mut().enumerate().filter(|(k, _)| parts[*k] > 1e-9 * whole) {
            lobe.share = parts[k] / whole;
            lobe.toward = sums[k].normalize();
            let logs: f64 =
                light.iter().zip(&belongs).map(|(&(wi, _), belongs)| belongs[k] * lobe.log_base(wi)).sum();
            lobe.n = (-parts[k] / logs.min(-1e-300) - 1.0).clamp(EXPONENTS[0], EXPONENTS[1]);
        }
    }
    let all = lobes[0].share + lobes[1].share;
    lobes.iter_mut().for_each(|lobe| lobe.share /= all);
    lobes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn closed_forms_of_a_smooth_coat_and_the_split() {
        let table = Coats::table();
        for degrees in [0.0f32, 30.0, 60.0, 80.0] {
            let cosine = degrees.to_radians().cos();
            // A mirror: Schlick's F at the angle itself, light from the mirror direction.
            let mirror = table.at(cosine, 1e-4);
            let grazing = (1.0 - cosine).powi(5);
            let [f0, f90] = mirror.albedo;
            assert!((f0 - (1.0 - grazing)).abs() < 0.02 && (f90 - grazing).abs() < 0.02, "{mirror:?}");
            for lobe in mirror.lobes {
                assert!((lobe.angle - degrees.to_radians()).abs() < 0.03, "{degrees} {mirror:?}");
                assert!((lobe.n / EXPONENTS[1] as f32 - 1.0).abs() < 1e-3, "{mirror:?}");
            }
        }
        // Rougher terms reflect wider and less.
        let [smooth, rough] = [0.05, 0.5].map(|alpha| table.at(0.7, alpha));
        assert!(rough.lobes[0].n < 0.1 * smooth.lobes[0].n && rough.albedo[0] < smooth.albedo[0]);
        let [low, high] = table.exponents(0.2);
        assert!(table.at(0.5, 0.2).lobes.iter().all(|lobe| lobe.n >= low && lobe.n <= high));
    }

    #[test]
    fn a_mixture_of_two_lobes_is_found_again() {
        // Strata of cosⁿ about +z: cosines u^(1/(n + 1)).
        let lobe = |n: f64, share: f64| {
            (0..2000u32).map(move |k| {
                let z = ((f64::from(k) + 0.5) / 2000.0).powf(1.0 / (n + 1.0));
                let (sin, cos) = (f64::from(k) * 2.399_963).sin_cos();
                let radius = (1.0 - z * z).sqrt();
                (DVec3::new(radius * cos, radius * sin, z), share)
            })
        };
        let light: Vec<Weighted> = lobe(300.0, 0.7).chain(lobe(4.0, 0.3)).collect();
        let [peak, tail] = mixture(&light, 2000.0);
        assert!(
            (peak.n / 300.0 - 1.0).abs() < 0.05 && (tail.n / 4.0 - 1.0).abs() < 0.05,
            "{} {}",
            peak.n,
            tail.n
        );
        assert!((peak.share - 0.7).abs() < 0.01 && peak.toward.z > 0.9999, "{}", peak.share);
    }
}
