//! The `environment` renderer: light from afar by prefiltered maps (6.13)–(6.18), for any number of lobes a texel,
//!
//! L(ω_r) ≈ ρ_d D(N) + Σ_j ρ_s,j |p_j|^n_j S(p_j / |p_j|, n_j) H,  p_j = C'_j ω_r
//!
//! with H the cosine at the lobe's peak (6.18), or corrected for the horizon. No shadows and no
//! interreflection. Lights without extent are added as in `lights`.

mod gpu;
mod harmonics;
mod horizon;
mod prefilter;
#[cfg(test)]
mod tests;

use std::time::Instant;

use glam::{Vec3, Vec4};
use rayon::prelude::*;

pub use prefilter::Encoding;

use super::geometry::{Geometry, Surface};
use super::image::Picture;
use super::materials::{Materials, Shader};
use super::sampler::{self, hash};
use super::shading::{self, Lamp, Rays};
use super::{Cost, Prepared, Renderer, Rendering, math};
use crate::error::{Error, Result};
use crate::reflectance::Rgb;
use crate::scene::{Camera, Scene};
use harmonics::Harmonics;
use horizon::{Clipped, Horizon};
use prefilter::Prefiltered;

/// How to prefilter and to draw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    /// How exponents are encoded.
    pub encoding: Encoding,
    /// Whether the maps are computed on the GPU.
    pub gpu: bool,
    /// Whether lobes near the horizon are corrected.
    pub horizon: bool,
    /// Whether the diffuse term takes nine spherical harmonics instead of a map.
    pub harmonics: bool,
    /// Samples a pixel, for edges and textures; powers of two are spread best.
    pub samples: u32,
    /// Seed of the samples.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { encoding: Encoding::Slices, gpu: false, horizon: true, harmonics: false, samples: 16, seed: 0 }
    }
}

impl Renderer for Settings {
    fn prepare<'a>(&self, scene: &'a Scene) -> Result<Box<dyn Prepared + 'a>> {
        scene.check()?;
        super::lobes_only(scene, "environment")?;
        if self.samples == 0 {
            return Err(Error::input("samples is 0; use 1 or more"));
        }
        let start = Instant::now();
        let materials = Materials::new(scene);
        let prefilter = self.gpu.then(gpu::Prefilter::new).transpose()?;
        let light = scene.environment.as_ref().map(|environment| {
            let exponents: Vec<f32> = materials.lobes.iter().map(|lobe| lobe.n).collect();
            let maps = match &prefilter {
                Some(gpu) => Prefiltered::new(environment, &exponents, self.encoding, |e, n, rows| {
                    gpu.slice(e, n, rows)
                }),
                None => Prefiltered::on_cpu(environment, &exponents, self.encoding),
            };
            Ok(Light {
                maps: maps?,
                harmonics: self.harmonics.then(|| Harmonics::new(environment)),
                horizon: self.horizon.then(Horizon::table),
            })
        });
        Ok(Box::new(Ready {
            scene,
            settings: *self,
            geometry: Geometry::new(scene),
            lamps: shading::lamps(&scene.lights, super::lights::POINTS_ACROSS),
            materials,
            light: light.transpose()?,
            adapter: prefilter.map(|gpu| gpu.name()),
            prepare_seconds: start.elapsed().as_secs_f64(),
        }))
    }
}

/// An environment ready to shade by.
struct Light {
    maps: Prefiltered,
    harmonics: Option<Harmonics>,
    horizon: Option<&'static Horizon>,
}

impl Light {
    /// Radiance of the environment that a surface reflects.
    fn reflected(&self, surface: &Surface, shader: &Shader) -> Rgb {
        let normal = surface.frame[2];
        let irradiance = match &self.harmonics {
            Some(harmonics) => harmonics.irradiance(normal),
            None => self.maps.irradiance(normal),
        };
        let mut radiance = shader.rho_d * irradiance;
        for lobe in &shader.lobes {
            let length = lobe.peak.length();
            let peak = lobe.peak / length;
            let Clipped { factor, turn } = match self.horizon {
                Some(horizon) => horizon.at(peak.z, lobe.n),
                None => Clipped { factor: peak.z.max(0.0), turn: 0.0 },
            };
            if factor > 0.0 {
                let light = self.maps.lobe(surface.to_world(turned(peak, turn)), lobe.n);
                radiance += lobe.rho_s * light * (math::powf(length, lobe.n) * factor);
            }
        }
        radiance
    }
}

/// A direction turned towards +z.
fn turned(direction: Vec3, angle: f32) -> Vec3 {
    let flat = Vec3::new(direction.x, direction.y, 0.0);
    let length = flat.length();
    if length < 1e-6 {
        return direction;
    }
    let up = (Vec3::Z - direction * direction.z) / length;
    let (sin, cos) = angle.sin_cos();
    direction * cos + up * sin
}

/// A scene with its maps.
struct Ready<'a> {
    scene: &'a Scene,
    settings: Settings,
    geometry: Geometry,
    materials: Materials,
    lamps: Vec<Lamp>,
    light: Option<Light>,
    /// The GPU that made the maps.
    adapter: Option<String>,
    prepare_seconds: f64,
}

impl Ready<'_> {
    /// Radiance along a camera ray, and coverage.
    fn shade(&self, origin: Vec3, direction: Vec3, choice: [f32; 2], shader: &mut Shader) -> Vec4 {
        let Some(hit) = self.geometry.nearest(origin, direction) else {
            return shading::background(self.scene, direction).extend(0.0);
        };
        let object = self.geometry.object(&hit);
        if let Some(emission) = self.materials.emission(object) {
            let shines = self.geometry.front(&hit, direction);
            return if shines { emission } else { Rgb::ZERO }.extend(1.0);
        }
        let surface = self.geometry.surface(&hit, origin, direction);
        let texel = self.materials.choose(object, surface.uv, choice);
        shader.aim(&self.materials, texel, surface.to_local(-direction), false);
        let mut radiance = shading::reflect_lights(&self.lamps, &surface, shader, |_| true);
        if let Some(light) = &self.light {
            radiance += light.reflected(&surface, shader);
        }
        radiance.extend(1.0)
    }
}

impl Prepared for Ready<'_> {
    fn view(&self, camera: &Camera) -> Result<Rendering> {
        camera.check()?;
        let start = Instant::now();
        let (width, height) = (camera.width as usize, camera.height as usize);
        let (rays, samples) = (Rays::new(camera), self.settings.samples);
        let mut pixels = vec![Vec4::ZERO; width * height];
        pixels.par_iter_mut().enumerate().for_each_init(Shader::new, |shader, (index, pixel)| {
            let seed = hash(self.settings.seed as u32 ^ hash(index as u32));
            for sample in 0..samples {
                let [x, y] = sampler::point(seed, sample, 0);
                let direction = rays.direction((index % width) as f32 + x, (index / width) as f32 + y);
                *pixel += self.shade(rays.origin, direction, sampler::point(seed, sample, 1), shader);
            }
            *pixel /= samples as f32;
        });
        let maps = self.light.as_ref().map_or(0, |light| light.maps.bytes());
        let memory = self.geometry.bytes() + self.materials.bytes() + maps + size_of_val(&pixels[..]);
        let cost = Cost {
            prepare_seconds: self.prepare_seconds,
            render_seconds: start.elapsed().as_secs_f64(),
            memory_bytes: memory as u64,
            samples,
            rays: pixels.len() as u64 * u64::from(samples),
            draws: 0,
        };
        Ok(Rendering {
            picture: Picture { width, height, pixels },
            variance: None,
            cost,
            adapter: self.adapter.clone(),
        })
    }
}
