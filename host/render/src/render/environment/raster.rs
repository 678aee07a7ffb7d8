//! The GPU's raster: `lights` with light from afar by shaders/environment.wgsl.

use std::time::Instant;

use glam::Vec4;
use wgpu::BufferUsages;

use super::{Coats, Horizon, Light, Settings, prepare_seconds};
use crate::render::bake::Baked;
use crate::render::lights::{self, Distant, Lights};
use crate::render::materials::Materials;
use crate::render::stage::Stage;
use crate::render::{Cost, Player, Rendering};
use crate::scene::{Scene, State};
use lobelia_base::error::Result;
use lobelia_gpu::Gpu;
use lobelia_gpu::environment::{SHADER, Sky};

/// A scene on the GPU, and what its light from afar is told but for its turn.
struct Playing {
    lights: Lights,
    maps: u32,
    horizon: bool,
    coefficients: Option<[Vec4; 9]>,
    /// What it took to be made ready.
    cost: Cost,
}

/// Makes a scene ready on the GPU.
pub(super) fn prepare(
    scene: &Scene,
    settings: &Settings,
    baked: Option<&Baked>,
    start: Instant,
) -> Result<Box<dyn Player>> {
    let gpu = Gpu::open()?;
    let now = Stage::new(scene)?.now;
    let mut cost = Cost::default();
    let environment = now.environment.as_ref();
    let light = environment.map(|environment| {
        Light::new(environment, &Materials::new(&now), settings, Some(&gpu), baked, &mut cost)
    });
    let light = light.transpose()?;
    let distant = light.as_ref().map(|light| upload(&gpu, light)).transpose()?;
    let lights = Lights::new(&drawn(settings), scene, gpu, distant)?;
    cost.prepare_seconds = prepare_seconds(start, baked, &cost);
    let (maps, horizon, coefficients) = light.as_ref().map_or((0, false, None), sky);
    Ok(Box::new(Playing { lights, maps, horizon, coefficients, cost }))
}

impl Player for Playing {
    fn frame(&mut self, state: &State) -> Result<Rendering> {
        let Self { maps, horizon, coefficients, .. } = *self;
        let mut rendering = self.lights.play(state, |gpu, rotation| {
            gpu.buffer("sky", &[Sky::new(rotation, maps, horizon, coefficients)], BufferUsages::UNIFORM)
        })?;
        let Cost { bake_seconds, bake_rays, baked_bytes, prepare_seconds, .. } = self.cost;
        rendering.cost = Cost { bake_seconds, bake_rays, baked_bytes, prepare_seconds, ..rendering.cost };
        Ok(rendering)
    }
}

/// Number of maps of S, whether lobes are corrected near the horizon, and harmonics.
fn sky(light: &Light) -> (u32, bool, Option<[Vec4; 9]>) {
    let harmonics = light.harmonics.as_ref();
    let coefficients = harmonics.map(|light| light.coefficients.map(|coefficient| coefficient.extend(0.0)));
    (light.maps.exponents().count() as u32, light.horizon.is_some(), coefficients)
}

/// How the raster draws.
fn drawn(settings: &Settings) -> lights::Settings {
    lights::Settings { samples: settings.samples, ..Default::default() }
}

/// Puts what the shader reads on the device.
fn upload(gpu: &Gpu, light: &Light) -> Result<Distant> {
    let (places, pixels) = light.maps.packed();
    let (maps, horizon, coefficients) = sky(light);
    let sky = Sky::new(light.maps.rotation, maps, horizon, coefficients);
    let clipped = light.horizon.map_or_else(Vec::new, Horizon::packed);
    let buffers = [
        gpu.buffer("sky", &[sky], BufferUsages::UNIFORM)?,
        gpu.buffer("maps", &places, BufferUsages::STORAGE)?,
        gpu.buffer("pixels", &pixels, BufferUsages::STORAGE)?,
        gpu.buffer("clipped", &clipped, BufferUsages::STORAGE)?,
        gpu.buffer("coats", light.coats.map_or(&[][..], Coats::packed), BufferUsages::STORAGE)?,
    ];
    Ok(Distant { shader: SHADER, buffers })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::environment::Encoding;
    use crate::render::lights::cpu;
    use crate::render::{Renderer, extended_check};
    use crate::scene::{Material, showcase};
    use lobelia_reflectance::{LobeBrdf, Microfacet, Rgb};

    /// The showcase, one of its materials with a microfacet term, under a turned sky with a small bright
    /// spot, without lamps, at the edges of whose shadows the two may differ.
    fn scene() -> Scene {
        let mut scene = showcase::published(120, 90);
        let sky = crate::scene::Environment::from_function(64, 32, |d| {
            let lamp = if d.dot(glam::Vec3::new(0.3, 0.8, 0.52)) > 0.98 { 300.0 } else { 0.0 };
            glam::Vec3::new(0.5 + 0.4 * d.x, 0.4 + lamp, 0.3 + 0.2 * d.y)
        });
        scene.environment = Some(sky.rotated(0.7));
        scene.lights.clear();
        let coat = Microfacet { f0: Rgb::new(0.1, 0.2, 0.3), f90: Rgb::ONE, alpha: 0.3 };
        let brdf = LobeBrdf { microfacets: vec![coat], ..LobeBrdf::diffuse(Rgb::splat(0.1)) };
        scene.objects[0].material = Material::uniform(brdf);
        scene
    }

    #[test]
    fn the_gpu_agrees_with_its_twin_on_the_cpu_in_every_setting() {
        let plain = scene();
        let mut extended = scene();
        extended.objects[1].material = Material::map(extended_check().into(), glam::Vec2::splat(4.0));
        let base = Settings { samples: 1, map_error: 0.3, gpu: true, ..Settings::default() };
        let variants = [
            (&plain, base),
            (&plain, Settings { encoding: Encoding::Mips, horizon: false, ..base }),
            (&plain, Settings { harmonics: true, ..base }),
            (&extended, base),
        ];
        for (scene, settings) in variants {
            let rendering = match settings.render(scene, &scene.camera) {
                Ok(rendering) => rendering,
                Err(error) if error.to_string().contains("no adapter") => {
                    return println!("skipped: {error}");
                }
                Err(error) => panic!("{error}"),
            };
            let environment = scene.environment.as_ref().unwrap();
            let materials = Materials::new(scene);
            let mut cost = Cost::default();
            let light = Light::new(environment, &materials, &settings, None, None, &mut cost).unwrap();
            let distant = |surface: &_, shader: &_| light.reflected(surface, shader);
            let twin = cpu::render_with(scene, &drawn(&settings), &distant).unwrap();
            let pixels = rendering.picture.pixels.iter().zip(&twin.pixels);
            let mut errors: Vec<f32> = pixels
                .filter(|(gpu, cpu)| gpu.w == cpu.w)
                .map(|(gpu, cpu)| (gpu - cpu).truncate().length() / cpu.truncate().length().max(1e-3))
                .collect();
            let uncovered = twin.pixels.len() - errors.len();
            errors.sort_by(f32::total_cmp);
            let at = |part: f32| errors[((errors.len() - 1) as f32 * part) as usize];
            println!("{settings:?}: median {:e}, 99 % {:e}, largest {:e}", at(0.5), at(0.99), at(1.0));
            assert!(uncovered <= 4, "{uncovered} pixels are covered in one only");
            // A few pixels lie on an edge of the mesh, where the two may see different triangles.
            assert!(at(0.5) < 1e-4 && at(0.99) < 2e-3, "{settings:?}: {} {}", at(0.5), at(0.99));
        }
    }
}
