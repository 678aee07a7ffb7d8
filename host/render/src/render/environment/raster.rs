//! The GPU's raster: `lights` with light from afar by shaders/environment.wgsl.

use std::time::Instant;

use wgpu::BufferUsages;

use super::{Coats, Horizon, Light, Settings};
use crate::render::Prepared;
use crate::render::lights::{self, Distant, Lights};
use crate::render::materials::Materials;
use crate::scene::Scene;
use lobelia_base::error::Result;
use lobelia_gpu::Gpu;
use lobelia_gpu::environment::{SHADER, Sky};

/// Makes a scene ready on the GPU.
pub(super) fn prepare<'a>(
    scene: &'a Scene,
    settings: &Settings,
    start: Instant,
) -> Result<Box<dyn Prepared + 'a>> {
    let gpu = Gpu::open()?;
    let materials = Materials::new(scene);
    let distant = scene.environment.as_ref().map(|environment| {
        let light = Light::new(environment, &materials, settings, Some(&gpu))?;
        upload(&gpu, &light)
    });
    Ok(Box::new(Lights::new(&drawn(settings), scene, gpu, distant.transpose()?)?.since(start)))
}

/// How the raster draws.
fn drawn(settings: &Settings) -> lights::Settings {
    lights::Settings { samples: settings.samples, ..Default::default() }
}

/// Puts what the shader reads on the device.
fn upload(gpu: &Gpu, light: &Light) -> Result<Distant> {
    let (places, pixels) = light.maps.packed();
    let harmonics = light.harmonics.as_ref();
    let coefficients = harmonics.map(|light| light.coefficients.map(|coefficient| coefficient.extend(0.0)));
    let sky = Sky::new(light.maps.rotation, places.len() as u32 - 1, light.horizon.is_some(), coefficients);
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

    /// The showcase, one of its materials with a microfacet term, under a turned sky with a small bright spot, without lamps, at the
    /// edges of whose shadows the two may differ.
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
            let light = Light::new(environment, &Materials::new(scene), &settings, None).unwrap();
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
