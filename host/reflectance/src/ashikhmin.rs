//! The anisotropic Phong model of Ashikhmin and Shirley (2000), a test BRDF of two of the sources: with the
//! half vector h,
//!
//! f_s = √((n_u + 1)(n_v + 1)) / 8π · (n·h)^((n_u h_x² + n_v h_y²) / (1 − h_z²)) · F(ω·h) / ((h·ω)
//! max(cosθ_i, cosθ_o)), f_d = 28 R_d / 23π (1 − R_s)(1 − (1 − cosθ_i / 2)⁵)(1 − (1 − cosθ_o / 2)⁵),
//!
//! and Schlick's F from R_s on.

use std::f32::consts::{FRAC_PI_2, PI, TAU};

use glam::{Vec2, Vec3};

use crate::Rgb;

/// Its parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AshikhminShirley {
    /// Diffuse reflectance R_d, no unit.
    pub diffuse: Rgb,
    /// Specular reflectance R_s at normal incidence, no unit.
    pub specular: Rgb,
    /// Exponents n_u and n_v along the axes.
    pub exponents: Vec2,
    /// The direction of n_u in the sample's plane, a unit vector.
    pub axis: Vec2,
}

impl AshikhminShirley {
    /// A direction with the x axis along that of n_u.
    fn turned(&self, v: Vec3) -> Vec3 {
        Vec3::new(self.axis.x * v.x + self.axis.y * v.y, self.axis.x * v.y - self.axis.y * v.x, v.z)
    }

    /// √((n_u + 1)(n_v + 1)) (n·h)^e for a half vector along its own axes.
    fn peak(&self, half: Vec3) -> f32 {
        let Vec2 { x: n_u, y: n_v } = self.exponents;
        // From the sine, which sharp lobes need, and which is 0 at the peak.
        let sine2 = half.x * half.x + half.y * half.y;
        let exponent = (n_u * half.x * half.x + n_v * half.y * half.y) / sine2.max(f32::MIN_POSITIVE);
        let log = 0.5 * (-sine2).ln_1p();
        ((n_u + 1.0) * (n_v + 1.0)).sqrt() * (exponent * log).exp()
    }

    /// The diffuse part, sr⁻¹, for two directions above the surface.
    pub fn diffuse(&self, wi: Vec3, wo: Vec3) -> Rgb {
        let shape = |cosine: f32| 1.0 - (1.0 - 0.5 * cosine).powi(5);
        self.diffuse * (Rgb::ONE - self.specular) * (28.0 / (23.0 * PI) * shape(wi.z) * shape(wo.z))
    }

    /// Reflectance, sr⁻¹, for two directions above the surface.
    pub fn eval(&self, wi: Vec3, wo: Vec3) -> Rgb {
        let half = self.turned((wi + wo).normalize());
        let cosine = half.dot(self.turned(wi)).max(1e-6);
        let fresnel = self.specular + (Rgb::ONE - self.specular) * (1.0 - cosine).max(0.0).powi(5);
        self.diffuse(wi, wo) + fresnel * (self.peak(half) / (4.0 * TAU * cosine * wi.z.max(wo.z)))
    }

    /// Density, sr⁻¹, with which [`Self::sample`] draws `wi`: that of h over 4 (ω_o·h).
    pub fn density(&self, wi: Vec3, wo: Vec3) -> f32 {
        let half = self.turned((wi + wo).normalize());
        self.peak(half) / (4.0 * TAU * half.dot(self.turned(wo)).max(1e-6))
    }

    /// An incident direction drawn by the distribution of half vectors, from two numbers in 0..1. It can lie
    /// below the surface.
    pub fn sample(&self, wo: Vec3, [r, s]: [f32; 2]) -> Vec3 {
        let Vec2 { x: n_u, y: n_v } = self.exponents;
        let quadrant = (4.0 * r).floor().clamp(0.0, 3.0);
        let along = 4.0 * r - quadrant;
        // Every other quadrant backwards: the map is continuous.
        let odd = quadrant as u32 % 2 == 1;
        let (sin, cos) = (FRAC_PI_2 * if odd { 1.0 - along } else { along }).sin_cos();
        let angle = ((n_u + 1.0).sqrt() * sin).atan2((n_v + 1.0).sqrt() * cos);
        let azimuth = match quadrant as u32 {
            0 => angle,
            1 => PI - angle,
            2 => PI + angle,
            _ => TAU - angle,
        };
        let exponent = (n_u + 1.0) * (n_v + 1.0) / ((n_v + 1.0) * cos * cos + (n_u + 1.0) * sin * sin);
        let log = (1.0 - s).max(f32::MIN_POSITIVE).ln() / exponent;
        let (z, sine) = (log.exp(), (-(2.0 * log).exp_m1()).max(0.0).sqrt());
        let (x, y) = (sine * azimuth.cos(), sine * azimuth.sin());
        let half =
            Vec3::new(self.axis.x * x - self.axis.y * y, self.axis.y * x + self.axis.x * y, z).normalize();
        2.0 * wo.dot(half) * half - wo
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn source() -> AshikhminShirley {
        AshikhminShirley {
            diffuse: Rgb::splat(0.5),
            specular: Rgb::splat(0.75),
            exponents: Vec2::new(10.0, 100.0),
            axis: Vec2::from_angle(0.4),
        }
    }

    #[test]
    fn it_is_reciprocal_and_has_the_published_value_at_normal_incidence() {
        let brdf = source();
        let (wi, wo) = (Vec3::new(0.3, 0.4, 0.7).normalize(), Vec3::new(-0.6, 0.1, 0.3).normalize());
        assert!((brdf.eval(wi, wo) / brdf.eval(wo, wi) - Rgb::ONE).abs().max_element() < 1e-5);
        let diffuse = 28.0 * 0.5 / (23.0 * PI) * 0.25 * (1.0 - 0.5f32.powi(5)).powi(2);
        let expected = (11.0f32 * 101.0).sqrt() / (8.0 * PI) * 0.75 + diffuse;
        assert!((brdf.eval(Vec3::Z, Vec3::Z).x / expected - 1.0).abs() < 1e-5);
    }

    #[test]
    fn a_sample_weighs_fresnel_times_the_smaller_cosine_over_the_larger() {
        let brdf = AshikhminShirley { diffuse: Rgb::ZERO, ..source() };
        let wo = Vec3::new(-0.6, 0.1, 0.5).normalize();
        for k in 0..400 {
            let wi = brdf.sample(wo, [(k as f32 + 0.5) / 400.0, (k as f32 * 0.618).fract()]);
            if wi.z > 0.0 {
                let weight = brdf.eval(wi, wo).x * wi.z / brdf.density(wi, wo);
                let cosine = (wi + wo).normalize().dot(wo);
                let expected = (0.75 + 0.25 * (1.0 - cosine).powi(5)) * wi.z / wi.z.max(wo.z);
                assert!((weight / expected - 1.0).abs() < 1e-3, "{wi}: {weight} {expected}");
            }
        }
    }

    #[test]
    fn a_white_one_reflects_no_more_than_arrives() {
        for degrees in [5.0f32, 45.0, 80.0] {
            let (sin, cos) = degrees.to_radians().sin_cos();
            let (wo, count) = (Vec3::new(sin, 0.0, cos), 200);
            let mut albedo = 0.0;
            for (i, j) in (0..count).flat_map(|i| (0..count).map(move |j| (i, j))) {
                let at = |k: i32| (k as f32 + 0.5) / count as f32;
                let (z, azimuth) = (at(i).sqrt(), TAU * at(j));
                let radius = (1.0 - z * z).sqrt();
                let wi = Vec3::new(radius * azimuth.cos(), radius * azimuth.sin(), z);
                let white = AshikhminShirley { diffuse: Rgb::ONE, specular: Rgb::splat(0.3), ..source() };
                albedo += white.eval(wi, wo).x * PI / (count * count) as f32;
            }
            assert!(albedo < 1.01 && albedo > 0.4, "{degrees}°: {albedo}");
        }
    }
}
