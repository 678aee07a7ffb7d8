//! The `lights` renderer: a raster on the GPU with point and directional lights (6.9), any number of lobes and lights in one
//! pass. No shadows, and an environment is seen but lights nothing: scenes that need those go to the reference.

pub mod cpu;
mod pipeline;

use std::time::Instant;

use bytemuck::{Pod, Zeroable};
use glam::{Mat4, Vec3, Vec4};

use super::gpu::Gpu;
use super::image::Picture;
use super::materials::Materials;
use super::shading::{self, Rays};
use super::{Cost, Rendering};
use crate::error::{Error, Result};
use crate::scene::{Light, Mesh, Scene};

/// How to draw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    /// Samples a pixel at edges: 4 where the adapter can, or 1.
    pub samples: u32,
}

impl Default for Settings {
    fn default() -> Self {
        Self { samples: 4 }
    }
}

/// Uniforms of the shader.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct View {
    projection: Mat4,
    eye: Vec4,
}

/// A light as the shader has it.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct PackedLight {
    place: Vec4,
    colour: Vec4,
}

/// Everything that is uploaded for a scene.
struct Uploads {
    view: View,
    lights: Vec<PackedLight>,
    materials: Materials,
    mesh: Mesh,
    /// The run of indices of every object.
    runs: Vec<std::ops::Range<u32>>,
}

impl Uploads {
    fn new(scene: &Scene) -> Self {
        let mut mesh = Mesh::default();
        let mut runs = Vec::with_capacity(scene.objects.len());
        for object in &scene.objects {
            let placed = object.mesh.transformed(&object.transform);
            let first = mesh.vertices.len() as u32;
            let start = mesh.triangles.len() as u32 * 3;
            mesh.vertices.extend(placed.vertices);
            mesh.triangles.extend(placed.triangles.iter().map(|t| t.map(|i| i + first)));
            runs.push(start..mesh.triangles.len() as u32 * 3);
        }
        let lights = scene.lights.iter().map(|light| match *light {
            Light::Directional { toward, irradiance } => {
                PackedLight { place: toward.extend(0.0), colour: irradiance.extend(0.0) }
            }
            Light::Point { position, intensity } => {
                PackedLight { place: position.extend(1.0), colour: intensity.extend(0.0) }
            }
        });
        Self {
            view: View {
                projection: projection(scene),
                eye: scene.camera.position.extend(scene.lights.len() as f32),
            },
            lights: lights.collect(),
            materials: Materials::new(scene),
            mesh,
            runs,
        }
    }
}

/// World to clip space with reversed depth: 1 at the near plane, 0 at infinity.
fn projection(scene: &Scene) -> Mat4 {
    let camera = &scene.camera;
    let [right, up, forward] = camera.basis();
    let scale_y = 1.0 / (camera.fov / 2.0).tan();
    let scale_x = scale_y * camera.height as f32 / camera.width as f32;
    let near = 1e-3 * camera.position.distance(camera.target);
    let row = |axis: Vec3, offset: f32| axis.extend(offset - axis.dot(camera.position));
    let rows = [
        row(right, 0.0) * scale_x,
        row(up, 0.0) * scale_y,
        Vec4::new(0.0, 0.0, 0.0, near),
        row(forward, 0.0),
    ];
    Mat4::from_cols(rows[0], rows[1], rows[2], rows[3]).transpose()
}

/// Renders a scene's point and directional lights on the GPU.
///
/// # Errors
/// Input errors for a scene that [`Scene::check`] refuses; failures when there is no GPU or it refuses.
pub fn render(scene: &Scene, settings: &Settings) -> Result<Rendering> {
    scene.check()?;
    let start = Instant::now();
    let gpu = Gpu::open()?;
    let limit = gpu.device.limits().max_texture_dimension_2d;
    if scene.camera.width > limit || scene.camera.height > limit {
        return Err(Error::failure(format!("GPU: a picture has at most {limit} pixels a side")));
    }
    let uploads = Uploads::new(scene);
    let drawn = gpu.guarded(|| {
        let pass = pipeline::Pass::new(&gpu, &uploads, scene, settings)?;
        let prepared = start.elapsed().as_secs_f64();
        Ok((pass.draw(&gpu, &uploads)?, prepared))
    });
    let (mut pixels, prepare_seconds) = drawn?;

    // The background shows through wherever coverage is not whole.
    let (width, height) = (scene.camera.width as usize, scene.camera.height as usize);
    let rays = Rays::new(scene);
    for (index, pixel) in pixels.iter_mut().enumerate() {
        if pixel.w < 1.0 {
            let direction = rays.direction((index % width) as f32 + 0.5, (index / width) as f32 + 0.5);
            *pixel += (shading::background(scene, direction) * (1.0 - pixel.w)).extend(0.0);
        }
    }
    let seconds = start.elapsed().as_secs_f64();
    Ok(Rendering {
        picture: Picture { width, height, pixels },
        cost: Cost { prepare_seconds, render_seconds: seconds - prepare_seconds, rays: 0 },
        adapter: Some(gpu.name()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::showcase;

    /// The showcase with a third light, without its environment.
    fn lit(width: u32, height: u32) -> Scene {
        let mut scene = showcase::published(width, height);
        scene.environment = None;
        scene.background = crate::scene::Background::Colour(Vec3::new(0.1, 0.2, 0.3));
        scene.lights.push(Light::Directional { toward: Vec3::NEG_X, irradiance: Vec3::splat(0.4) });
        scene
    }

    #[test]
    fn the_gpu_agrees_with_its_twin_on_the_cpu() {
        let scene = lit(160, 120);
        let rendering = match render(&scene, &Settings { samples: 1 }) {
            Ok(rendering) => rendering,
            Err(error) if error.to_string().contains("no adapter") => return println!("skipped: {error}"),
            Err(error) => panic!("{error}"),
        };
        let twin = cpu::render(&scene).unwrap();
        let mut errors: Vec<f32> = Vec::new();
        let mut coverage = 0;
        for (gpu, cpu) in rendering.picture.pixels.iter().zip(&twin.pixels) {
            if gpu.w != cpu.w {
                coverage += 1;
                continue;
            }
            let difference = (gpu - cpu).truncate().abs().max_element();
            errors.push(difference / cpu.truncate().max_element().max(1e-3));
        }
        errors.sort_by(f32::total_cmp);
        let at = |part: f32| errors[((errors.len() - 1) as f32 * part) as usize];
        println!("coverage differs at {coverage} of {} pixels", twin.pixels.len());
        println!("relative error: median {:e}, 99 % {:e}, largest {:e}", at(0.5), at(0.99), at(1.0));
        assert!(coverage <= 4, "{coverage} pixels are covered in one only");
        // A few pixels lie on an edge of the mesh, where the two may see different triangles.
        assert!(at(0.5) < 1e-5 && at(0.99) < 1e-3, "{} {}", at(0.5), at(0.99));
    }

    #[test]
    fn multisampled_edges_blend_with_the_background() {
        let mut scene = lit(64, 48);
        scene.objects.retain(|object| object.name == "ball");
        let rendering = match render(&scene, &Settings::default()) {
            Ok(rendering) => rendering,
            Err(error) if error.to_string().contains("no adapter") => return println!("skipped: {error}"),
            Err(error) => panic!("{error}"),
        };
        let pixels = &rendering.picture.pixels;
        assert!((pixels[0].truncate() - Vec3::new(0.1, 0.2, 0.3)).length() < 1e-4 && pixels[0].w == 0.0);
        assert!(pixels.iter().any(|pixel| pixel.w > 0.0 && pixel.w < 1.0));
        assert!(rendering.adapter.is_some());
    }
}
