//! The reference renderer: rays on the CPU. Point and directional lights with shadows, the environment by importance
//! sampling of its pixels and of the lobes, both weighted by the power heuristic. Light is reflected once.

mod environment;
mod sampler;
#[cfg(test)]
mod tests;

use std::f32::consts::TAU;
use std::time::Instant;

use glam::{Vec3, Vec4};
use rayon::prelude::*;

use super::geometry::{Geometry, Surface};
use super::image::Picture;
use super::materials::{Materials, Shader};
use super::math;
use super::shading::{self, Rays};
use super::{Cost, Rendering};
use crate::error::{Error, Result};
use crate::progress;
use crate::reflectance::Rgb;
use crate::scene::Scene;
use environment::Sampled;
use sampler::{Sequence, hash};

/// How much work to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    /// Samples a pixel; powers of two are spread best.
    pub samples: u32,
    /// The picture is a function of scene, samples and seed, whatever the number of threads.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { samples: 64, seed: 0 }
    }
}

/// What the numbers of a sample are for.
mod purpose {
    pub(super) const PIXEL: u32 = 0;
    pub(super) const TEXEL: u32 = 1;
    pub(super) const ENVIRONMENT: u32 = 2;
    pub(super) const LOBE: u32 = 3;
    pub(super) const CHOICE: u32 = 4;
}

/// Renders a scene.
///
/// # Errors
/// Input errors for a scene that [`Scene::check`] refuses, or no samples.
pub fn render(scene: &Scene, settings: &Settings) -> Result<Rendering> {
    scene.check()?;
    if settings.samples == 0 {
        return Err(Error::input("samples is 0; use 1 or more"));
    }
    let start = Instant::now();
    let tracer = Tracer {
        scene,
        geometry: Geometry::new(scene),
        materials: Materials::new(scene),
        environment: scene.environment.as_ref().and_then(Sampled::new),
        rays: Rays::new(scene),
        sequence: Sequence::new(settings.samples),
        samples: settings.samples,
        seed: hash(settings.seed as u32 ^ hash((settings.seed >> 32) as u32 ^ 0x5bd1_e995)),
    };
    let prepared = start.elapsed().as_secs_f64();

    let (width, height) = (scene.camera.width as usize, scene.camera.height as usize);
    let mut pixels = vec![Vec4::ZERO; width * height];
    let bar = progress::bar("render", height as u64, "rows");
    let rays = pixels
        .par_chunks_mut(width)
        .enumerate()
        .map_init(Shader::new, |shader, (y, row)| {
            let mut rays = 0;
            for (x, pixel) in row.iter_mut().enumerate() {
                *pixel = tracer.pixel(x as u32, y as u32, shader, &mut rays);
            }
            bar.advance(1);
            rays
        })
        .sum();
    let seconds = start.elapsed().as_secs_f64();
    Ok(Rendering {
        picture: Picture { width, height, pixels },
        cost: Cost { prepare_seconds: prepared, render_seconds: seconds - prepared, rays },
        adapter: None,
    })
}

/// How an incident direction was drawn.
#[derive(Clone, Copy)]
enum By {
    Environment,
    Lobes,
}

/// A scene made ready.
struct Tracer<'a> {
    scene: &'a Scene,
    geometry: Geometry,
    materials: Materials,
    environment: Option<Sampled<'a>>,
    rays: Rays,
    sequence: Sequence,
    samples: u32,
    seed: u32,
}

impl Tracer<'_> {
    /// Mean radiance and coverage of a pixel.
    fn pixel(&self, x: u32, y: u32, shader: &mut Shader, rays: &mut u64) -> Vec4 {
        let pixel = hash(self.seed ^ hash(y * self.scene.camera.width + x));
        let mut sum = Vec4::ZERO;
        for index in 0..self.samples {
            let [dx, dy] = self.sequence.point(pixel, index, purpose::PIXEL);
            let direction = self.rays.direction(x as f32 + dx, y as f32 + dy);
            *rays += 1;
            sum += match self.geometry.nearest(self.rays.origin, direction) {
                None => shading::background(self.scene, direction).extend(0.0),
                Some(hit) => {
                    let surface = self.geometry.surface(&hit, self.rays.origin, direction);
                    self.reflected(&surface, -direction, pixel, index, shader, rays).extend(1.0)
                }
            };
        }
        sum / self.samples as f32
    }

    /// Radiance reflected at a surface toward the viewer.
    fn reflected(
        &self,
        surface: &Surface,
        view: Vec3,
        pixel: u32,
        index: u32,
        shader: &mut Shader,
        rays: &mut u64,
    ) -> Rgb {
        let texel = self.materials.choose(
            surface.object,
            surface.uv,
            self.sequence.point(pixel, index, purpose::TEXEL),
        );
        shader.aim(&self.materials, texel, surface.to_local(view), self.environment.is_some());
        let mut radiance = shading::reflect_lights(&self.scene.lights, surface, shader, |seen| {
            *rays += 1;
            surface.geometric.dot(seen.toward) > 0.0
                && !self.geometry.occluded(surface, seen.toward, seen.distance)
        });
        if let Some(environment) = &self.environment {
            let arriving = environment.sample(self.sequence.point(pixel, index, purpose::ENVIRONMENT));
            radiance += self.weighted(surface, shader, &arriving, By::Environment, rays);
            let [choice, _] = self.sequence.point(pixel, index, purpose::CHOICE);
            let local = sample_lobes(shader, choice, self.sequence.point(pixel, index, purpose::LOBE));
            if local.z > 0.0 {
                let arriving = environment.arriving(surface.to_world(local));
                radiance += self.weighted(surface, shader, &arriving, By::Lobes, rays);
            }
        }
        radiance
    }

    /// One sample's share under the power heuristic: f L cosθ / p, weighted by p² / (p_e² + p_l²).
    fn weighted(
        &self,
        surface: &Surface,
        shader: &Shader,
        arriving: &environment::Arriving,
        by: By,
        rays: &mut u64,
    ) -> Rgb {
        let wi = surface.to_local(arriving.direction);
        if wi.z <= 0.0 || surface.geometric.dot(arriving.direction) <= 0.0 {
            return Rgb::ZERO;
        }
        let (reflectance, density) = shader.eval_and_density(wi);
        let drawn = match by {
            By::Environment => arriving.density,
            By::Lobes => density,
        };
        // Divided by `drawn` twice, so that the squares stay in range.
        let (ratio_e, ratio_l) = (arriving.density / drawn, density / drawn);
        let weight = wi.z / (drawn * (ratio_e * ratio_e + ratio_l * ratio_l));
        let share = reflectance * arriving.radiance * weight;
        if share == Rgb::ZERO {
            return Rgb::ZERO;
        }
        *rays += 1;
        if self.geometry.occluded(surface, arriving.direction, f32::INFINITY) { Rgb::ZERO } else { share }
    }
}

/// Draws an incident direction of the sample's frame from the mixture of [`Shader`]: cosine-weighted, or cosⁿ about the
/// peak of a lobe. It can lie below the surface, and then carries nothing.
fn sample_lobes(shader: &Shader, choice: f32, [r, s]: [f32; 2]) -> Vec3 {
    let (sin, cos) = (r * TAU).sin_cos();
    let mut left = choice;
    for lobe in &shader.lobes {
        if left < lobe.share {
            let z = math::powf((1.0 - s).max(f32::MIN_POSITIVE), 1.0 / (lobe.n + 1.0)).min(1.0);
            let radius = (1.0 - z * z).sqrt();
            let axis = lobe.peak.normalize();
            let (x, y) = axis.any_orthonormal_pair();
            return x * (radius * cos) + y * (radius * sin) + axis * z;
        }
        left -= lobe.share;
    }
    let radius = s.sqrt();
    Vec3::new(radius * cos, radius * sin, (1.0 - s).max(0.0).sqrt())
}
