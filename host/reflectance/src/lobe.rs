//! Generalised cosine lobes (4.1)–(4.4) and the BRDF that is a diffuse term and a sum of them.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::{Brdf, Microfacet, Rgb};

/// One lobe ρ_s (Cx ω_ix ω_ox + Cy ω_iy ω_oy + Cz ω_iz ω_oz)ⁿ (4.2). The base is clamped at 0 before the power.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Lobe {
    /// Albedo factor a channel, sr⁻¹ where the base is 1.
    pub rho_s: Rgb,
    /// Diagonal of C: (−1, −1, 1) is Phong's lobe; Cx = Cy is isotropic; positive Cx, Cy are retro-reflective.
    pub c: Vec3,
    /// Exponent.
    pub n: f32,
}

impl Lobe {
    /// The base of the power before clamping, for directions in the lobe's own frame.
    pub fn base(&self, wi: Vec3, wo: Vec3) -> f32 {
        (self.c * wi).dot(wo)
    }

    /// s(wi, wo) without ρ_s: 0 where the base is ≤ 0.
    pub fn shape(&self, wi: Vec3, wo: Vec3) -> f32 {
        let base = self.base(wi, wo);
        if base <= 0.0 { 0.0 } else { base.powf(self.n) }
    }

    /// The direction in which the lobe peaks for light from `wi`, and the peak's magnitude |C wi|.
    pub fn peak(&self, wi: Vec3) -> Vec3 {
        self.c * wi
    }

    /// The same lobe with the largest |C| component scaled to 1, using the freedom C ← C·s, ρ_s ← ρ_s·s⁻ⁿ.
    pub fn normalised(&self) -> Self {
        let scale = self.c.abs().max_element();
        if scale <= 0.0 || !scale.is_finite() {
            return *self;
        }
        let factor = (f64::from(scale)).powf(f64::from(self.n)) as f32;
        Self { rho_s: self.rho_s * factor, c: self.c / scale, n: self.n }
    }
}

/// A BRDF of a diffuse term, lobes (4.1) and microfacet terms, turned about the normal by the direction of anisotropy β (4.4).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct LobeBrdf {
    /// Diffuse reflectance ρ_d a channel, sr⁻¹ (albedo / π).
    pub rho_d: Rgb,
    /// Direction of anisotropy, radians from the sample's x axis toward y, in −π/4..π/4.
    pub beta: f32,
    /// The lobes.
    pub lobes: Vec<Lobe>,
    /// Isotropic GGX terms, for clear coats; none in maps of texels.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub microfacets: Vec<Microfacet>,
}

/// Turns a direction about z by −β: from the sample's frame into the lobe's.
pub fn into_lobe_frame(direction: Vec3, beta: f32) -> Vec3 {
    if beta == 0.0 {
        return direction;
    }
    let (sin, cos) = beta.sin_cos();
    Vec3::new(cos * direction.x + sin * direction.y, cos * direction.y - sin * direction.x, direction.z)
}

impl LobeBrdf {
    /// A perfect diffuser of the given albedo a channel.
    pub fn diffuse(albedo: Rgb) -> Self {
        Self { rho_d: albedo / std::f32::consts::PI, ..Self::default() }
    }

    /// The same BRDF on a surface that is turned about its normal by `angle` radians, with β kept in −π/4..π/4.
    pub fn rotated(&self, angle: f32) -> Self {
        let quarter = std::f32::consts::FRAC_PI_2;
        let turns = ((self.beta + angle) / quarter).round();
        let mut turned = self.clone();
        turned.beta = self.beta + angle - turns * quarter;
        if turns as i64 % 2 != 0 {
            for lobe in &mut turned.lobes {
                lobe.c = Vec3::new(lobe.c.y, lobe.c.x, lobe.c.z);
            }
        }
        turned
    }
}

impl Brdf for LobeBrdf {
    fn eval(&self, wi: Vec3, wo: Vec3) -> Rgb {
        if wi.z <= 0.0 || wo.z <= 0.0 {
            return Rgb::ZERO;
        }
        let coats: Rgb = self.microfacets.iter().map(|coat| coat.eval(wi, wo)).sum();
        let (wi, wo) = (into_lobe_frame(wi, self.beta), into_lobe_frame(wo, self.beta));
        self.rho_d + coats + self.lobes.iter().map(|lobe| lobe.rho_s * lobe.shape(wi, wo)).sum::<Rgb>()
    }

    fn eval_channel(&self, wi: Vec3, wo: Vec3, channel: usize) -> f32 {
        if wi.z <= 0.0 || wo.z <= 0.0 {
            return 0.0;
        }
        let coats: f32 = self.microfacets.iter().map(|coat| coat.eval(wi, wo)[channel]).sum();
        let (wi, wo) = (into_lobe_frame(wi, self.beta), into_lobe_frame(wo, self.beta));
        let lit = self.lobes.iter().filter(|lobe| lobe.rho_s[channel] != 0.0);
        self.rho_d[channel] + coats + lit.map(|lobe| lobe.rho_s[channel] * lobe.shape(wi, wo)).sum::<f32>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn direction(u: f32, v: f32) -> Vec3 {
        let z = 0.02 + 0.97 * u;
        let r = (1.0 - z * z).sqrt();
        let (sin, cos) = (v * std::f32::consts::TAU).sin_cos();
        Vec3::new(r * cos, r * sin, z)
    }

    fn material(cx: f32, cy: f32, cz: f32, n: f32, beta: f32) -> LobeBrdf {
        let lobe = Lobe { rho_s: Rgb::new(0.3, 0.2, 0.1), c: Vec3::new(cx, cy, cz), n };
        LobeBrdf { rho_d: Rgb::splat(0.1), beta, lobes: vec![lobe], ..LobeBrdf::default() }
    }

    #[test]
    fn phong_lobe_peaks_in_the_mirror_direction_with_value_one() {
        let lobe = Lobe { rho_s: Rgb::ONE, c: Vec3::new(-1.0, -1.0, 1.0), n: 40.0 };
        let wi = direction(0.4, 0.1);
        let mirror = Vec3::new(-wi.x, -wi.y, wi.z);
        assert!((lobe.shape(wi, mirror) - 1.0).abs() < 1e-5);
        assert!(lobe.shape(wi, direction(0.4, 0.7)) < 1.0);
    }

    proptest! {
        #[test]
        fn lobes_are_reciprocal_and_not_negative(
            u in 0f32..1.0, v in 0f32..1.0, s in 0f32..1.0, t in 0f32..1.0,
            cx in -1.5f32..1.5, cy in -1.5f32..1.5, cz in -1f32..1.5, n in 0.5f32..50.0, beta in -0.78f32..0.78,
        ) {
            let (wi, wo) = (direction(u, v), direction(s, t));
            let brdf = material(cx, cy, cz, n, beta);
            let (forth, back) = (brdf.eval(wi, wo), brdf.eval(wo, wi));
            prop_assert!(forth.min_element() >= 0.0);
            prop_assert!((forth - back).abs().max_element() <= 1e-3 * forth.max_element() + 1e-6);
        }

        #[test]
        fn normalising_keeps_the_reflectance(
            u in 0f32..1.0, v in 0f32..1.0, s in 0f32..1.0, t in 0f32..1.0,
            cx in -1.2f32..1.2, cz in 0.1f32..1.2, n in 0.5f32..30.0,
        ) {
            let (wi, wo) = (direction(u, v), direction(s, t));
            let lobe = Lobe { rho_s: Rgb::ONE, c: Vec3::new(cx, cx, cz), n };
            let same = lobe.normalised();
            let (a, b) = (lobe.rho_s * lobe.shape(wi, wo), same.rho_s * same.shape(wi, wo));
            prop_assert!((a - b).abs().max_element() <= 1e-3 * a.max_element() + 1e-6);
        }

        #[test]
        fn rotating_the_surface_rotates_the_reflectance(
            u in 0f32..1.0, v in 0f32..1.0, s in 0f32..1.0, t in 0f32..1.0, angle in -3f32..3.0, beta in -0.7f32..0.7,
        ) {
            let (wi, wo) = (direction(u, v), direction(s, t));
            let brdf = material(-0.9, -0.4, 0.8, 12.0, beta);
            let turn = |d: Vec3| glam::Quat::from_rotation_z(angle) * d;
            let (a, b) = (brdf.eval(wi, wo), brdf.rotated(angle).eval(turn(wi), turn(wo)));
            prop_assert!((a - b).abs().max_element() <= 2e-4, "{a} {b}");
            prop_assert!(brdf.rotated(angle).beta.abs() <= std::f32::consts::FRAC_PI_4 + 1e-5);
        }
    }
}
