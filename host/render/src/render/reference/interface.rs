//! Surfaces with a direction of their own: mirrors, metal, and both directions of glass.

use glam::Vec3;

use crate::render::geometry::Surface;
use crate::render::materials::Shader;
use lobelia_reflectance::{Rgb, colour, fresnel};

/// A surface as the end of a ray sees it.
pub(super) struct Aimed {
    /// Its lobes.
    pub(super) shader: Shader,
    /// ρ_m of its mirror.
    pub(super) mirror: Rgb,
    /// Probability of the lobes' samples beside the mirror's.
    pub(super) keep: f32,
    /// Whether there are no lobes.
    pub(super) black: bool,
}

impl Aimed {
    pub(super) fn new() -> Self {
        Self { shader: Shader::new(), mirror: Rgb::ZERO, keep: 1.0, black: false }
    }

    /// Adds a mirror, with a probability by its part of about what the surface reflects.
    pub(super) fn set_mirror(&mut self, mirror: Rgb) {
        let weight = colour::luminance(mirror);
        if weight > 0.0 {
            let rest = self.shader.albedo;
            self.mirror = mirror;
            self.keep = if rest > 0.0 { (rest / (rest + weight)).clamp(0.1, 0.9) } else { 0.0 };
        }
    }
}

/// What a smooth dielectric does with a ray.
pub(super) struct Split {
    pub(super) reflected: Vec3,
    /// Has no meaning where all is reflected.
    pub(super) refracted: Vec3,
    pub(super) reflectance: f32,
}

/// The frame's z where the direction about it stays on its side of the triangle, else the triangle's normal.
fn normal_for(surface: &Surface, holds: impl Fn(Vec3) -> bool) -> Vec3 {
    let smooth = surface.frame[2];
    if holds(smooth) { smooth } else { surface.geometric }
}

/// The mirror direction of `wo`, which is in the surface's frame, in the world.
pub(super) fn mirrored(surface: &Surface, wo: Vec3) -> Vec3 {
    let out = surface.to_world(wo);
    let about = |normal: Vec3| 2.0 * out.dot(normal) * normal - out;
    about(normal_for(surface, |normal| surface.geometric.dot(about(normal)) > 0.0)).normalize()
}

/// Reflection and refraction of `wo`, which is in the surface's frame, by the index beyond over that on its
/// side; in the world.
pub(super) fn dielectric(surface: &Surface, wo: Vec3, ratio: f32) -> Split {
    let out = surface.to_world(wo);
    let about = |normal: Vec3| {
        let cosine = out.dot(normal);
        let (reflectance, beyond) = fresnel::dielectric(cosine, ratio);
        let reflected = 2.0 * cosine * normal - out;
        let refracted = (normal * cosine - out) / ratio - normal * beyond;
        Split { reflected, refracted, reflectance }
    };
    let normal = normal_for(surface, |normal| {
        let split = about(normal);
        surface.geometric.dot(split.reflected) > 0.0
            && (split.reflectance >= 1.0 || surface.geometric.dot(split.refracted) < 0.0)
    });
    let Split { reflected, refracted, reflectance } = about(normal);
    Split { reflected: reflected.normalize(), refracted: refracted.normalize_or(-normal), reflectance }
}

/// The mirror direction of `wo` and the reflectance of a metal, its index over that of what it lies in.
pub(super) fn conductor(surface: &Surface, wo: Vec3, n: Rgb, k: Rgb) -> (Vec3, Rgb) {
    let direction = mirrored(surface, wo);
    let half = (direction + surface.to_world(wo)).normalize_or(surface.frame[2]);
    (direction, fresnel::conductor(direction.dot(half), n, k))
}
