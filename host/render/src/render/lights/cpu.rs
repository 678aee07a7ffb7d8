//! The twin of shaders/lights.wgsl in Rust: the same shading and filtering, one ray through the middle of
//! every pixel. It is the oracle for the shader.

use bytemuck::Zeroable;
use glam::{Vec3, Vec4};
use rayon::prelude::*;

use super::footprint::Footprint;
use super::{Filtering, Settings};
use crate::render::bvh::Hit;
use crate::render::geometry::{Geometry, Surface};
use crate::render::materials::{Materials, PackedLobe, Shader};
use crate::render::sampler::hash;
use crate::render::shading::{self, Rays, Seen};
use crate::scene::Scene;
use lobelia_base::error::Result;
use lobelia_gpu::lights::Lamp;
use lobelia_reflectance::Rgb;
use lobelia_reflectance::picture::Picture;

/// Renders a scene's lights on the CPU, one sample a pixel.
///
/// # Errors
/// Input errors for a scene that [`Scene::check`] refuses and for settings that [`Settings`] refuses.
pub fn render(scene: &Scene, settings: &Settings) -> Result<Picture> {
    render_with(scene, settings, &|_, _| Rgb::ZERO)
}

/// Light from afar that a texel reflects.
pub(crate) type Distant<'a> = dyn Fn(&Surface, &Shader) -> Rgb + Sync + 'a;

/// The same with light from afar.
///
/// # Errors
/// Those of [`render`].
pub(crate) fn render_with(scene: &Scene, settings: &Settings, distant: &Distant<'_>) -> Result<Picture> {
    let scene = settings.scene(scene)?;
    let twin = Twin {
        settings,
        geometry: Geometry::new(&scene),
        materials: Materials::with_levels(&scene),
        lamps: shading::lamps(&scene.lights),
        rays: Rays::new(&scene.camera),
        scene: &scene,
        distant,
    };
    let (width, height) = (scene.camera.width as usize, scene.camera.height as usize);
    let mut pixels = vec![Vec4::ZERO; width * height];
    pixels.par_iter_mut().enumerate().for_each_init(Shader::new, |shader, (index, pixel)| {
        *pixel = twin.pixel([index % width, index / width], shader);
    });
    Ok(Picture { width, height, pixels })
}

/// A scene made ready.
struct Twin<'a> {
    settings: &'a Settings,
    scene: &'a Scene,
    geometry: Geometry,
    materials: Materials,
    lamps: Vec<Lamp>,
    rays: Rays,
    distant: &'a Distant<'a>,
}

impl Twin<'_> {
    /// Direction through the middle of a pixel.
    fn direction(&self, [x, y]: [usize; 2]) -> Vec3 {
        self.rays.direction(x as f32 + 0.5, y as f32 + 0.5)
    }

    /// Radiance and coverage of a pixel.
    fn pixel(&self, at: [usize; 2], shader: &mut Shader) -> Vec4 {
        let direction = self.direction(at);
        let Some(hit) = self.geometry.nearest(self.rays.origin, direction) else {
            return shading::background(self.scene, direction).extend(0.0);
        };
        if let Some(emission) = self.materials.emission(self.geometry.object(&hit)) {
            let shines = self.geometry.front(&hit, direction);
            return if shines { emission } else { Rgb::ZERO }.extend(1.0);
        }
        let surface = self.geometry.surface(&hit, direction);
        let material = &self.materials.materials[surface.object as usize];
        let footprint = Footprint::new(self.settings, material, surface.uv, self.differences(&hit, at));
        let mut taps = vec![];
        footprint.taps(material, |texel, weight| taps.push((texel, weight)));
        let wo = surface.to_local(-direction);
        let seed = hash(at[0] as u32 | (at[1] as u32) << 16);
        let mut radiance = Rgb::ZERO;
        if self.settings.filtering == Filtering::Coefficients {
            let (rho_d, lobes) = self.interpolated(&taps);
            shader.aim_lobes(rho_d, &lobes, wo);
            radiance += self.reflect(&surface, shader, seed);
            for &(texel, weight) in taps.iter().filter(|_| !self.materials.microfacets.is_empty()) {
                shader.aim_coats(&self.materials, texel, wo);
                radiance += weight * self.reflect(&surface, shader, seed);
            }
        } else {
            for (texel, weight) in taps {
                shader.aim(&self.materials, texel, wo, false);
                radiance += weight * self.reflect(&surface, shader, seed);
            }
        }
        radiance.extend(1.0)
    }

    /// How texture coordinates change from pixel to pixel, as the GPU tells it: by the differences within a
    /// block of 2 × 2.
    fn differences(&self, hit: &Hit, [x, y]: [usize; 2]) -> [glam::Vec2; 2] {
        let uv = |at| self.geometry.uv_along(hit, self.rays.origin, self.direction(at));
        [uv([x | 1, y]) - uv([x & !1, y]), uv([x, y | 1]) - uv([x, y & !1])]
    }

    /// Coefficients interpolated one by one; a lobe that one texel lacks has its shape from the others.
    fn interpolated(&self, taps: &[(u32, f32)]) -> (Rgb, Vec<PackedLobe>) {
        let rho_d = taps.iter().map(|&(texel, weight)| weight * self.materials.rho_d(texel)).sum();
        let mut sums: Vec<(PackedLobe, f32)> = vec![];
        for &(texel, weight) in taps {
            for (place, lobe) in self.materials.lobes_of(texel).iter().enumerate() {
                if place == sums.len() {
                    sums.push((PackedLobe::zeroed(), 0.0));
                }
                let (sum, whole) = &mut sums[place];
                sum.c.iter_mut().zip(lobe.c).for_each(|(sum, c)| *sum += weight * c);
                sum.rho_s.iter_mut().zip(lobe.rho_s).for_each(|(sum, rho)| *sum += weight * rho);
                sum.n += weight * lobe.n;
                sum.n_grazing += weight * lobe.n_grazing;
                *whole += weight;
            }
        }
        let mean = |(sum, whole): (PackedLobe, f32)| PackedLobe {
            c: sum.c.map(|c| c / whole),
            n: sum.n / whole,
            n_grazing: sum.n_grazing / whole,
            ..sum
        };
        (rho_d, sums.into_iter().map(mean).collect())
    }

    /// Radiance reflected from all lights.
    fn reflect(&self, surface: &Surface, shader: &Shader, seed: u32) -> Rgb {
        let across = self.settings.across();
        let near = shading::reflect_lights(&self.lamps, across, seed, surface, shader, |seen: &Seen| {
            !self.settings.shadows
                || surface.geometric.dot(seen.toward) > 0.0
                    && !self.geometry.occluded(surface, seen.toward, seen.distance)
        });
        near + (self.distant)(surface, shader)
    }
}
