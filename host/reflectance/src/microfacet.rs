//! A GGX microfacet term: what cosine lobes do badly, a clear coat whose highlight narrows and brightens
//! toward grazing.
//!
//! f = F D G / (4 cosθ_i cosθ_o) (Cook and Torrance 1982) with the normal distribution D of Trowbridge and
//! Reitz (GGX, Walter et al. 2007), height-correlated Smith shadowing G (Heitz 2014) and Schlick's F between
//! f0 and f90. With f90 ≤ 1 it reflects no more than arrives, whatever α is.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::Rgb;

/// An isotropic GGX term with α = roughness².
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Microfacet {
    /// Fresnel reflectance a channel at θ_d = 0; no unit, 0.04 for glass or lacquer.
    pub f0: Rgb,
    /// Fresnel reflectance a channel at θ_d = 90°; no unit, at most 1 where no energy is made.
    pub f90: Rgb,
    /// Width α of the distribution of slopes, 0 < α ≤ 1.
    pub alpha: f32,
}

/// Smith's Λ for a direction of the given cosine.
fn lambda(cosine: f32, alpha: f32) -> f32 {
    let tan2 = (1.0 - cosine * cosine).max(0.0) / (cosine * cosine);
    0.5 * ((1.0 + alpha * alpha * tan2).sqrt() - 1.0)
}

impl Microfacet {
    /// Reflectance, sr⁻¹, for two directions above the surface. D is computed from the sine of θ_h, which
    /// small α need.
    pub fn eval(&self, wi: Vec3, wo: Vec3) -> Rgb {
        let half = wi + wo;
        let length2 = half.length_squared();
        let alpha2 = self.alpha * self.alpha;
        let width = (half.x * half.x + half.y * half.y + alpha2 * half.z * half.z) / length2;
        let distribution = alpha2 / (std::f32::consts::PI * width * width);
        let shadowing = 1.0 / (1.0 + lambda(wi.z, self.alpha) + lambda(wo.z, self.alpha));
        let grazing = (1.0 - 0.5 * length2.sqrt()).max(0.0).powi(5);
        (self.f0 + (self.f90 - self.f0) * grazing) * (distribution * shadowing / (4.0 * wi.z * wo.z))
    }

    /// Density, sr⁻¹, with which [`Self::sample`] draws `wi`: D G₁ / (4 cosθ_o).
    pub fn density(&self, wi: Vec3, wo: Vec3) -> f32 {
        let half = wi + wo;
        let length2 = half.length_squared();
        let alpha2 = self.alpha * self.alpha;
        let width = (half.x * half.x + half.y * half.y + alpha2 * half.z * half.z) / length2;
        let distribution = alpha2 / (std::f32::consts::PI * width * width);
        distribution / (4.0 * wo.z * (1.0 + lambda(wo.z, self.alpha)))
    }

    /// An incident direction drawn by the normals that `wo` sees, from two numbers in 0..1 (spherical caps,
    /// Dupuy and Benyoub 2023). It can lie below the surface.
    pub fn sample(&self, wo: Vec3, [r, s]: [f32; 2]) -> Vec3 {
        let stretched = Vec3::new(self.alpha * wo.x, self.alpha * wo.y, wo.z).normalize();
        let (sin, cos) = (std::f32::consts::TAU * r).sin_cos();
        let z = (1.0 - s) * (1.0 + stretched.z) - stretched.z;
        let radius = (1.0 - z * z).max(0.0).sqrt();
        let cap = Vec3::new(radius * cos, radius * sin, z) + stretched;
        let normal = Vec3::new(self.alpha * cap.x, self.alpha * cap.y, cap.z.max(0.0)).normalize_or(Vec3::Z);
        2.0 * wo.dot(normal) * normal - wo
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{PI, TAU};

    fn white(alpha: f32) -> Microfacet {
        Microfacet { f0: Rgb::ONE, f90: Rgb::ONE, alpha }
    }

    fn view(degrees: f32) -> Vec3 {
        let (sin, cos) = degrees.to_radians().sin_cos();
        Vec3::new(sin, 0.0, cos)
    }

    /// ∫ D G₁ / (4 cosθ_o) over all normals that are seen is 1: the weak white furnace (Heitz 2014), D G₁
    /// max(0, ω_o·h) = cosθ_o. Over normals h it is a smooth integral in the slope radius, substituted so
    /// that D is even.
    #[test]
    fn the_weak_white_furnace_holds() {
        for alpha in [0.05, 0.3, 1.0] {
            for degrees in [0.0f32, 40.0, 75.0, 85.0] {
                let (facet, wo) = (white(alpha), view(degrees));
                let (rows, columns) = (400, 400);
                let mut sum = 0.0;
                for i in 0..rows {
                    // tan²θ_h = α² u / (1 − u): u is uniform under D cosθ_h.
                    let u = (f64::from(i) + 0.5) / f64::from(rows);
                    let tan2 = f64::from(alpha).powi(2) * u / (1.0 - u);
                    let cos = (1.0 / (1.0 + tan2)).sqrt();
                    let sin = (1.0 - cos * cos).sqrt();
                    for j in 0..columns {
                        let azimuth = (f64::from(j) + 0.5) / f64::from(columns) * TAU;
                        let seen = f64::from(wo.x) * sin * azimuth.cos() + f64::from(wo.z) * cos;
                        sum += seen.max(0.0) / cos / f64::from(rows * columns);
                    }
                }
                let shown = sum / (1.0 + f64::from(lambda(wo.z, facet.alpha)));
                assert!((shown / f64::from(wo.z) - 1.0).abs() < 2e-2, "α {alpha}, {degrees}°: {shown}");
            }
        }
    }

    #[test]
    fn the_published_value_at_normal_incidence_and_reciprocity() {
        // At wi = wo = n: D = 1 / (π α²), G = 1.
        let facet = Microfacet { f0: Rgb::new(0.04, 0.5, 1.0), f90: Rgb::ONE, alpha: 0.2 };
        let expected = facet.f0 / (4.0 * PI as f32 * 0.04);
        assert!((facet.eval(Vec3::Z, Vec3::Z) / expected - Rgb::ONE).abs().max_element() < 1e-5);
        let (wi, wo) = (view(70.0), Vec3::new(-0.3, 0.5, 0.4).normalize());
        assert!((facet.eval(wi, wo) / facet.eval(wo, wi) - Rgb::ONE).abs().max_element() < 1e-5);
    }

    #[test]
    fn no_more_is_reflected_than_arrives_and_samples_weigh_the_albedo() {
        for alpha in [0.02f32, 0.2, 0.7] {
            for degrees in [5.0, 50.0, 80.0] {
                let (facet, wo) = (white(alpha), view(degrees));
                // Importance sampling: f cosθ_i / density is F G / G₁, between 0 and 1.
                let count = 64;
                let mut albedo = 0.0;
                for k in 0..count * count {
                    let at = |k: i32| (k as f32 + 0.5) / count as f32;
                    let wi = facet.sample(wo, [at(k % count), at(k / count)]);
                    if wi.z > 0.0 {
                        let weight = facet.eval(wi, wo).x * wi.z / facet.density(wi, wo);
                        assert!((0.0..=1.001).contains(&weight), "{weight}");
                        albedo += weight / (count * count) as f32;
                    }
                }
                assert!(albedo < 1.001 && albedo > 0.5, "α {alpha}, {degrees}°: {albedo}");
            }
        }
    }
}
