//! Generalised cosine lobes (4.1)–(4.4) and the BRDF that is a diffuse term and a sum of them; lobes that
//! sharpen toward grazing (6.19), and lobes about a normal of their own, for which C is a full symmetric
//! matrix (section 7 of the spec).

use glam::{Vec2, Vec3};
use serde::{Deserialize, Serialize};

use crate::{Brdf, Microfacet, Rgb};

/// One lobe ρ_s (Cx ω_ix ω_ox + Cy ω_iy ω_oy + Cz ω_iz ω_oz)ⁿ (4.2). The base is clamped at 0 before the
/// power.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Lobe {
    /// Albedo factor a channel, sr⁻¹ where the base is 1.
    pub rho_s: Rgb,
    /// Diagonal of C: (−1, −1, 1) is Phong's lobe; Cx = Cy is isotropic; positive Cx, Cy are
    /// retro-reflective.
    pub c: Vec3,
    /// Exponent; of a lobe that sharpens that for light and view along the normal, n₁ of (6.19).
    pub n: f32,
    /// Exponent toward grazing, n₀ of (6.19); none for a lobe with the same exponent everywhere. The length
    /// of C then matters: scaling it is not made up for by ρ_s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub n_grazing: Option<f32>,
}

impl Lobe {
    /// A lobe with one exponent.
    pub fn new(rho_s: Rgb, c: Vec3, n: f32) -> Self {
        Self { rho_s, c, n, n_grazing: None }
    }

    /// The exponent n₁ t + n₀ (1 − t) (6.19), t the mean of cosθ_i and cosθ_o.
    pub fn exponent(&self, t: f32) -> f32 {
        self.n_grazing.map_or(self.n, |grazing| self.n * t + grazing * (1.0 - t))
    }

    /// The base of the power before clamping, for directions in the lobe's own frame.
    pub fn base(&self, wi: Vec3, wo: Vec3) -> f32 {
        (self.c * wi).dot(wo)
    }

    /// s(wi, wo) without ρ_s: 0 where the base is ≤ 0. `t` is the mean of cosθ_i and cosθ_o, about the
    /// surface's normal.
    pub fn shape(&self, wi: Vec3, wo: Vec3, t: f32) -> f32 {
        let base = self.base(wi, wo);
        if base <= 0.0 { 0.0 } else { base.powf(self.exponent(t)) }
    }

    /// The direction in which the lobe peaks for light from `wi`, and the peak's magnitude |C wi|.
    pub fn peak(&self, wi: Vec3) -> Vec3 {
        self.c * wi
    }

    /// The same lobe with the largest |C| component scaled to 1, using the freedom C ← C·s, ρ_s ← ρ_s·s⁻ⁿ,
    /// which a lobe that sharpens has not.
    pub fn normalised(&self) -> Self {
        let scale = self.c.abs().max_element();
        if scale <= 0.0 || !scale.is_finite() || self.n_grazing.is_some() {
            return *self;
        }
        let factor = (f64::from(scale)).powf(f64::from(self.n)) as f32;
        Self::new(self.rho_s * factor, self.c / scale, self.n)
    }
}

/// A BRDF of a diffuse term, lobes (4.1) and microfacet terms, turned about the normal by the direction of
/// anisotropy β (4.4).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct LobeBrdf {
    /// Diffuse reflectance ρ_d a channel, sr⁻¹ (albedo / π).
    pub rho_d: Rgb,
    /// Direction of anisotropy, radians from the sample's x axis toward y, in −π/4..π/4.
    pub beta: f32,
    /// x and y of the unit normal about which the lobes stand; 0 is the surface's own. Neither the diffuse
    /// term nor microfacet terms follow it.
    #[serde(default, skip_serializing_if = "is_plain")]
    pub normal: Vec2,
    /// The lobes.
    pub lobes: Vec<Lobe>,
    /// Isotropic GGX terms, for clear coats.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub microfacets: Vec<Microfacet>,
}

fn is_plain(normal: &Vec2) -> bool {
    *normal == Vec2::ZERO
}

/// Turns a direction from the sample's frame into that of lobes about a normal: by the shortest turn that
/// brings the normal to z, then about z by −β.
pub fn into_lobe_frame(direction: Vec3, normal: Vec2, beta: f32) -> Vec3 {
    let mut d = direction;
    if normal != Vec2::ZERO {
        let z = (1.0 - normal.length_squared()).max(0.0).sqrt();
        let along = normal.dot(d.truncate());
        let across = d.truncate() - normal * (along / (1.0 + z) + d.z);
        d = across.extend(along + z * d.z);
    }
    if beta == 0.0 {
        return d;
    }
    let (sin, cos) = beta.sin_cos();
    Vec3::new(cos * d.x + sin * d.y, cos * d.y - sin * d.x, d.z)
}

impl LobeBrdf {
    /// A perfect diffuser of the given albedo a channel.
    pub fn diffuse(albedo: Rgb) -> Self {
        Self { rho_d: albedo / std::f32::consts::PI, ..Self::default() }
    }

    /// Refuses coefficients that no reflectance has, as [`crate::SbrdfMap::check`] does.
    ///
    /// # Errors
    /// [`crate::FormatError::Invalid`] with the name that the coefficient has as a channel of a map, such as
    /// `lobe0.n`.
    pub fn check(&self) -> Result<(), crate::FormatError> {
        crate::map_exr::check_one(self)
    }

    /// What its lobes have beyond one exponent and the surface's normal, in words.
    pub fn extension(&self) -> Option<&'static str> {
        if self.normal != Vec2::ZERO {
            return Some("lobes about a normal of their own");
        }
        let sharpens = self.lobes.iter().any(|lobe| lobe.n_grazing.is_some());
        sharpens.then_some("lobes that sharpen toward grazing")
    }

    /// The same BRDF on a surface that is turned about its normal by `angle` radians, with β kept in
    /// −π/4..π/4.
    pub fn rotated(&self, angle: f32) -> Self {
        let quarter = std::f32::consts::FRAC_PI_2;
        let turns = ((self.beta + angle) / quarter).round();
        let mut turned = self.clone();
        turned.beta = self.beta + angle - turns * quarter;
        turned.normal = Vec2::from_angle(angle).rotate(self.normal);
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
        let t = 0.5 * (wi.z + wo.z);
        let [wi, wo] = [wi, wo].map(|direction| into_lobe_frame(direction, self.normal, self.beta));
        self.rho_d + coats + self.lobes.iter().map(|lobe| lobe.rho_s * lobe.shape(wi, wo, t)).sum::<Rgb>()
    }

    fn eval_channel(&self, wi: Vec3, wo: Vec3, channel: usize) -> f32 {
        if wi.z <= 0.0 || wo.z <= 0.0 {
            return 0.0;
        }
        let coats: f32 = self.microfacets.iter().map(|coat| coat.eval(wi, wo)[channel]).sum();
        let t = 0.5 * (wi.z + wo.z);
        let [wi, wo] = [wi, wo].map(|direction| into_lobe_frame(direction, self.normal, self.beta));
        let lit = self.lobes.iter().filter(|lobe| lobe.rho_s[channel] != 0.0);
        self.rho_d[channel] + coats + lit.map(|lobe| lobe.rho_s[channel] * lobe.shape(wi, wo, t)).sum::<f32>()
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
        let lobe = Lobe::new(Rgb::new(0.3, 0.2, 0.1), Vec3::new(cx, cy, cz), n);
        LobeBrdf { rho_d: Rgb::splat(0.1), beta, lobes: vec![lobe], ..LobeBrdf::default() }
    }

    #[test]
    fn phong_lobe_peaks_in_the_mirror_direction_with_value_one() {
        let lobe = Lobe::new(Rgb::ONE, Vec3::new(-1.0, -1.0, 1.0), 40.0);
        let wi = direction(0.4, 0.1);
        let mirror = Vec3::new(-wi.x, -wi.y, wi.z);
        assert!((lobe.shape(wi, mirror, 0.5) - 1.0).abs() < 1e-5);
        assert!(lobe.shape(wi, direction(0.4, 0.7), 0.5) < 1.0);
    }

    #[test]
    fn a_tilted_lobe_peaks_in_the_mirror_direction_about_its_normal() {
        let normal = Vec2::new(0.12, -0.07);
        let axis = normal.extend((1.0 - normal.length_squared()).sqrt());
        let lobe = Lobe::new(Rgb::ONE, Vec3::new(-1.0, -1.0, 1.0), 40.0);
        for beta in [0.0, 0.6] {
            let brdf = LobeBrdf { normal, beta, lobes: vec![lobe], ..LobeBrdf::default() };
            let wi = direction(0.5, 0.3);
            let mirror = 2.0 * axis.dot(wi) * axis - wi;
            assert!((brdf.eval(wi, mirror).x - 1.0).abs() < 1e-4);
            assert!((into_lobe_frame(axis, normal, beta) - Vec3::Z).length() < 1e-6);
            assert!((into_lobe_frame(wi, normal, beta).length() - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn a_lobe_that_sharpens_has_both_exponents_and_their_mean_half_way() {
        let lobe = Lobe { n_grazing: Some(90.0), ..Lobe::new(Rgb::ONE, Vec3::new(-1.0, -1.0, 1.0), 10.0) };
        assert_eq!([0.0, 0.5, 1.0].map(|t| lobe.exponent(t)), [90.0, 50.0, 10.0]);
        let (wi, wo) = (direction(0.3, 0.0), direction(0.5, 0.4));
        let plain = Lobe::new(Rgb::ONE, lobe.c, lobe.exponent(0.5 * (wi.z + wo.z)));
        let of = |lobe| LobeBrdf { lobes: vec![lobe], ..LobeBrdf::default() }.eval(wi, wo);
        assert_eq!(of(lobe), of(plain));
    }

    proptest! {
        #[test]
        fn lobes_are_reciprocal_and_not_negative(
            u in 0f32..1.0, v in 0f32..1.0, s in 0f32..1.0, t in 0f32..1.0,
            cx in -1.5f32..1.5, cy in -1.5f32..1.5, cz in -1f32..1.5, n in 0.5f32..50.0,
            beta in -0.78f32..0.78, tilt in -0.3f32..0.3,
        ) {
            let (wi, wo) = (direction(u, v), direction(s, t));
            let mut brdf = material(cx, cy, cz, n, beta);
            brdf.normal = Vec2::new(tilt, 0.5 * tilt);
            brdf.lobes[0].n_grazing = Some(2.0 * n);
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
            let lobe = Lobe::new(Rgb::ONE, Vec3::new(cx, cx, cz), n);
            let same = lobe.normalised();
            let (a, b) = (lobe.rho_s * lobe.shape(wi, wo, 0.5), same.rho_s * same.shape(wi, wo, 0.5));
            prop_assert!((a - b).abs().max_element() <= 1e-3 * a.max_element() + 1e-6);
        }

        #[test]
        fn rotating_the_surface_rotates_the_reflectance(
            u in 0f32..1.0, v in 0f32..1.0, s in 0f32..1.0, t in 0f32..1.0,
            angle in -3f32..3.0, beta in -0.7f32..0.7,
        ) {
            let (wi, wo) = (direction(u, v), direction(s, t));
            let mut brdf = material(-0.9, -0.4, 0.8, 12.0, beta);
            brdf.normal = Vec2::new(0.1, 0.05);
            let turn = |d: Vec3| glam::Quat::from_rotation_z(angle) * d;
            let (a, b) = (brdf.eval(wi, wo), brdf.rotated(angle).eval(turn(wi), turn(wo)));
            prop_assert!((a - b).abs().max_element() <= 2e-4, "{a} {b}");
            prop_assert!(brdf.rotated(angle).beta.abs() <= std::f32::consts::FRAC_PI_4 + 1e-5);
        }
    }
}
