//! Directional albedo a(ω_i) = ∫ f(ω_i, ω_o) cosθ_o dω_o: the share of the light from one direction that is
//! reflected. Above 1 a material makes energy, which cosine lobes can at grazing incidence.
//!
//! About its peak p = C ω_i a lobe is |p|ⁿ cosⁿγ, of which the module `clipped` has the part above the
//! horizon.

mod clipped;

use glam::{DVec3, Vec3};

use crate::{LobeBrdf, Rgb, lobe::into_lobe_frame};

/// Parts of the sum over the angle from the peak of a lobe that sharpens.
const PARTS: usize = 64;
/// Azimuths about the peak of a lobe that sharpens, whose exponent differs round it.
const AZIMUTHS: usize = 32;
/// Largest logarithm of |p|ⁿ: beyond it a lobe is only known to make energy without bound.
const MOST_LOG: f64 = 80.0;
/// Parts along each axis for a microfacet term, whose samples weigh F G / G₁: errors below 0.5 %.
const MICROFACET_PARTS: usize = 24;

/// The polar angles, degrees, at which [`largest`] looks: close together toward grazing, where sharp lobes
/// change fast.
pub const INCIDENCES_DEG: [f64; 19] = [
    0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 58.0, 64.0, 69.0, 73.0, 76.0, 79.0, 81.5, 84.0, 86.0, 87.5, 88.5,
    89.3, 89.8,
];

/// Directional albedo of a lobe of ρ_s = 1 with its largest base at 1, for light from a direction in the
/// lobe's own frame, whose z is the surface's normal.
pub fn lobe(c: DVec3, n: f64, wi: DVec3) -> f64 {
    about(c * wi, n, DVec3::Z)
}

/// As [`lobe`], on a surface whose normal, in the lobe's own frame, is another, and with the exponents of a
/// lobe that sharpens, if it does: those of (6.19) at t = 1 and t = 0.
pub fn lobe_on(c: DVec3, [n, n_grazing]: [f64; 2], wi: DVec3, normal: DVec3) -> f64 {
    if n == n_grazing {
        about(c * wi, n, normal)
    } else {
        sharpening([n, n_grazing], c * wi, wi.dot(normal), normal)
    }
}

/// As [`lobe`], of a lobe with the peak C ω_i on a surface of a given normal.
fn about(peak: DVec3, n: f64, normal: DVec3) -> f64 {
    let length = peak.length();
    if length < 1e-9 {
        return 0.0;
    }
    let up = peak.dot(normal) / length;
    (n * length.ln()).min(MOST_LOG).exp() * std::f64::consts::TAU / (n + 1.0) * clipped::mean_cosine(up, n)
}

/// Directional albedo a channel for light from `wi`, above the surface.
pub fn directional(brdf: &LobeBrdf, wi: Vec3) -> Rgb {
    let mut albedo = std::f32::consts::PI * brdf.rho_d;
    for coat in &brdf.microfacets {
        for k in 0..MICROFACET_PARTS * MICROFACET_PARTS {
            let at = |k: usize| (k as f32 + 0.5) / MICROFACET_PARTS as f32;
            let wo = coat.sample(wi, [at(k % MICROFACET_PARTS), at(k / MICROFACET_PARTS)]);
            if wo.z > 0.0 {
                let weight = wo.z / coat.density(wo, wi) / (MICROFACET_PARTS * MICROFACET_PARTS) as f32;
                albedo += coat.eval(wo, wi) * weight;
            }
        }
    }
    let frame = |direction| into_lobe_frame(direction, brdf.normal, brdf.beta).as_dvec3();
    let (wi, normal) = (frame(wi), frame(Vec3::Z));
    for lobe in &brdf.lobes {
        let exponents = [lobe.n, lobe.n_grazing.unwrap_or(lobe.n)].map(f64::from);
        albedo += lobe.rho_s * lobe_on(lobe.c.as_dvec3(), exponents, wi, normal) as f32;
    }
    albedo
}

/// As [`about`], of a lobe that sharpens: directions are spread as the exponent at the peak would have it,
/// and weigh what the exponent in their own direction makes of them.
fn sharpening([n_normal, n_grazing]: [f64; 2], peak: DVec3, cos_i: f64, normal: DVec3) -> f64 {
    let length = peak.length();
    if length < 1e-9 {
        return 0.0;
    }
    let axis = peak / length;
    let (x, y) = axis.any_orthonormal_pair();
    let exponent = |cos_o: f64| {
        let t = 0.5 * (cos_i + cos_o.max(0.0));
        n_normal * t + n_grazing * (1.0 - t)
    };
    // The least of both ends: weights then stay bounded.
    let n = exponent(0.0).min(exponent(1.0));
    let mut sum = 0.0;
    for part in 0..PARTS {
        let cos = ((part as f64 + 0.5) / PARTS as f64).powf(1.0 / (n + 1.0));
        let sin = (1.0 - cos * cos).max(0.0).sqrt();
        for turn in 0..AZIMUTHS {
            let (s, c) = ((turn as f64 + 0.5) / AZIMUTHS as f64 * std::f64::consts::TAU).sin_cos();
            let cos_o = (axis * cos + (x * c + y * s) * sin).dot(normal);
            if cos_o > 0.0 {
                let log = exponent(cos_o) * (length * cos).ln() - n * cos.ln();
                sum += cos_o * log.min(MOST_LOG).exp();
            }
        }
    }
    std::f64::consts::TAU / (n + 1.0) * sum / (PARTS * AZIMUTHS) as f64
}

/// Azimuths, from the direction of anisotropy, at which the albedo is looked at: one where all are alike.
pub fn azimuths(isotropic: bool) -> &'static [f64] {
    if isotropic { &[0.0] } else { &[0.0, 0.25, 0.5, 0.75] }
}

/// The largest directional albedo a channel over [`INCIDENCES_DEG`] and, where a lobe is anisotropic, four
/// azimuths 45° apart, of lobes about a normal of their own eight.
pub fn largest(brdf: &LobeBrdf) -> Rgb {
    let isotropic = brdf.lobes.iter().all(|lobe| lobe.c.x == lobe.c.y);
    let turns = match brdf.normal == glam::Vec2::ZERO {
        true => azimuths(isotropic),
        false => &[0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75],
    };
    let mut largest = Rgb::ZERO;
    for &turn in turns {
        for degrees in INCIDENCES_DEG {
            let (sin, cos) = degrees.to_radians().sin_cos();
            let azimuth = f64::from(brdf.beta) + turn * std::f64::consts::PI;
            let wi = DVec3::new(sin * azimuth.cos(), sin * azimuth.sin(), cos).as_vec3();
            largest = largest.max(directional(brdf, wi));
        }
    }
    largest
}

/// What [`largest`] is at most in any channel, at little cost: all of every lobe above the horizon, along the
/// normal. None where a microfacet term or a lobe that sharpens is in it.
pub fn at_most(brdf: &LobeBrdf) -> Option<f32> {
    if !brdf.microfacets.is_empty() {
        return None;
    }
    let mut most = std::f32::consts::PI * brdf.rho_d;
    for lobe in &brdf.lobes {
        if lobe.n_grazing.is_some_and(|grazing| grazing != lobe.n) {
            return None;
        }
        let length = lobe.c.abs().max_element();
        most += lobe.rho_s * length.powf(lobe.n) * std::f32::consts::TAU / (lobe.n + 1.0);
    }
    Some(most.max_element())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Brdf, Lobe, Microfacet, materials};

    /// The midpoint rule over the hemisphere.
    fn brute(brdf: &LobeBrdf, wi: Vec3) -> Rgb {
        let (rows, columns) = (600, 600);
        let mut sum = glam::DVec3::ZERO;
        for i in 0..rows {
            let z = (i as f32 + 0.5) / rows as f32;
            let radius = (1.0 - z * z).sqrt();
            for j in 0..columns {
                let (sin, cos) = ((j as f32 + 0.5) / columns as f32 * std::f32::consts::TAU).sin_cos();
                sum += (brdf.eval(wi, Vec3::new(radius * cos, radius * sin, z)) * z).as_dvec3();
            }
        }
        (sum * (std::f64::consts::TAU / f64::from(rows * columns))).as_vec3()
    }

    #[test]
    fn the_sum_agrees_with_quadrature_over_the_hemisphere() {
        let lobe = Lobe::new(Rgb::splat(0.4), Vec3::new(-1.0, -0.6, 0.8), 7.0);
        let coat = Microfacet { f0: Rgb::splat(0.04), f90: Rgb::ONE, alpha: 0.4 };
        let mixed = LobeBrdf {
            beta: 0.4,
            lobes: vec![lobe],
            microfacets: vec![coat],
            ..LobeBrdf::diffuse(Rgb::splat(0.2))
        };
        let tilted = LobeBrdf { normal: glam::Vec2::new(0.15, -0.1), ..mixed.clone() };
        let mut sharpening = tilted.clone();
        sharpening.lobes[0].n_grazing = Some(60.0);
        let published = ["clay", "brushed-metal"].map(|name| materials::published(name).unwrap());
        for brdf in [mixed, tilted, sharpening].into_iter().chain(published) {
            for degrees in [0.0f32, 40.0, 80.0] {
                let (sin, cos) = degrees.to_radians().sin_cos();
                let wi = Vec3::new(sin * 0.8, sin * 0.6, cos);
                let (sum, brute) = (directional(&brdf, wi), brute(&brdf, wi));
                assert!((sum / brute - Rgb::ONE).abs().max_element() < 5e-3, "{degrees}°: {sum} {brute}");
            }
        }
    }

    #[test]
    fn the_published_brushed_metal_makes_energy_and_a_white_diffuser_does_not() {
        let metal = materials::published("brushed-metal").unwrap();
        let (sin, cos) = 80f32.to_radians().sin_cos();
        let at = directional(&metal, Vec3::new(sin, 0.0, cos));
        assert!(at.min_element() > 1.3 && at.max_element() < 1.6, "{at}");
        assert!(largest(&metal).max_element() > 1.5);
        assert!((largest(&LobeBrdf::diffuse(Rgb::ONE)) - Rgb::ONE).abs().max_element() < 1e-6);
    }

    #[test]
    fn the_limit_of_little_cost_is_never_below_the_largest_albedo() {
        for name in materials::NAMES {
            let brdf = materials::published(name).unwrap();
            let (most, largest) = (at_most(&brdf).unwrap(), largest(&brdf).max_element());
            assert!(most >= largest, "{name}: {most} {largest}");
        }
        let coat = Microfacet { f0: Rgb::splat(0.04), f90: Rgb::ONE, alpha: 0.4 };
        let coated = LobeBrdf { microfacets: vec![coat], ..LobeBrdf::diffuse(Rgb::ONE) };
        assert_eq!(at_most(&coated), None);
    }
}
