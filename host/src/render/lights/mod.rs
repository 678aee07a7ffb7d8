//! The `lights` renderer: a raster on the GPU with point and directional lights (6.9), any number of lobes and lights in one
//! pass; rectangular lights stand as a grid of points. No shadows, and an environment is seen but lights nothing: scenes that need those go to the reference.

pub mod cpu;
mod pipeline;

use std::time::Instant;

use bytemuck::{Pod, Zeroable};
use glam::{Mat4, Vec3, Vec4};

use super::geometry;
use super::gpu::Gpu;
use super::image::Picture;
use super::materials::Materials;
use super::shading::{self, Lamp, Rays};
use super::{Cost, Prepared, Renderer, Rendering};
use crate::error::{Error, Result};
use crate::scene::{Camera, Mesh, Scene};

/// Points along a rectangular light's edges that stand for it.
pub(super) const POINTS_ACROSS: u32 = 4;

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

/// Everything of a scene that is uploaded.
struct Uploads {
    lamps: Vec<Lamp>,
    materials: Materials,
    mesh: Mesh,
    /// The run of triangles of every object and rectangular light.
    runs: Vec<std::ops::Range<u32>>,
}

impl Uploads {
    fn new(scene: &Scene) -> Self {
        let (mesh, runs) = geometry::joined(scene);
        let lamps = shading::lamps(&scene.lights, POINTS_ACROSS);
        Self { lamps, materials: Materials::new(scene), mesh, runs }
    }

    /// Bytes on the device.
    fn bytes(&self) -> usize {
        size_of_val(&self.lamps[..])
            + self.materials.bytes()
            + size_of_val(&self.mesh.vertices[..])
            + size_of_val(&self.mesh.triangles[..])
    }
}

/// World to clip space with reversed depth: 1 at the near plane, 0 at infinity.
fn projection(camera: &Camera) -> Mat4 {
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

impl Renderer for Settings {
    fn prepare<'a>(&self, scene: &'a Scene) -> Result<Box<dyn Prepared + 'a>> {
        scene.check()?;
        let start = Instant::now();
        ready(scene, Gpu::open()?, self.samples, None, start)
    }
}

/// Light from afar: WGSL that is appended to shaders/lights.wgsl and defines `distant`, and what it reads as group 1.
pub(super) struct Distant {
    pub(super) shader: &'static str,
    pub(super) buffers: Vec<wgpu::Buffer>,
}

/// Uploads a scene; work on it began at `start`.
///
/// # Errors
/// Failures of the device.
pub(super) fn ready(
    scene: &Scene,
    gpu: Gpu,
    samples: u32,
    distant: Option<Distant>,
    start: Instant,
) -> Result<Box<dyn Prepared + '_>> {
    let uploads = Uploads::new(scene);
    let more = distant.iter().flat_map(|distant| &distant.buffers).map(wgpu::Buffer::size).sum::<u64>();
    let pass = gpu.guarded(|| pipeline::Pass::new(&gpu, &uploads, samples, distant))?;
    let bytes = uploads.bytes() + more as usize;
    Ok(Box::new(Lights { scene, gpu, pass, bytes, prepare_seconds: start.elapsed().as_secs_f64() }))
}

/// A scene on the GPU.
struct Lights<'a> {
    scene: &'a Scene,
    gpu: Gpu,
    pass: pipeline::Pass,
    bytes: usize,
    prepare_seconds: f64,
}

impl Prepared for Lights<'_> {
    fn view(&self, camera: &Camera) -> Result<Rendering> {
        camera.check()?;
        let start = Instant::now();
        let limit = self.gpu.device.limits().max_texture_dimension_2d;
        if camera.width > limit || camera.height > limit {
            return Err(Error::failure(format!("GPU: a picture has at most {limit} pixels a side")));
        }
        let mut pixels = self.gpu.guarded(|| self.pass.draw(&self.gpu, camera))?;

        // The background shows through wherever coverage is not whole.
        let (width, height) = (camera.width as usize, camera.height as usize);
        let rays = Rays::new(camera);
        for (index, pixel) in pixels.iter_mut().enumerate() {
            if pixel.w < 1.0 {
                let direction = rays.direction((index % width) as f32 + 0.5, (index / width) as f32 + 0.5);
                *pixel += (shading::background(self.scene, direction) * (1.0 - pixel.w)).extend(0.0);
            }
        }
        let cost = Cost {
            prepare_seconds: self.prepare_seconds,
            render_seconds: start.elapsed().as_secs_f64(),
            memory_bytes: (self.bytes + self.pass.target_bytes(camera)) as u64,
            samples: self.pass.samples(),
            draws: self.pass.draws(),
            rays: 0,
        };
        let picture = Picture { width, height, pixels };
        Ok(Rendering { picture, variance: None, cost, adapter: Some(self.gpu.name()) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Light, showcase};

    /// The showcase with a third light, without its environment.
    fn lit(width: u32, height: u32) -> Scene {
        let mut scene = showcase::published(width, height);
        scene.environment = None;
        scene.background = crate::scene::Background::Colour(Vec3::new(0.1, 0.2, 0.3));
        scene.lights.push(Light::Directional { toward: Vec3::NEG_X, irradiance: Vec3::splat(0.4) });
        scene.lights.push(Light::Rectangle {
            centre: Vec3::new(0.3, 1.5, 0.4),
            edges: [Vec3::X * 0.5, Vec3::Z * 0.4],
            radiance: Vec3::splat(2.0),
        });
        scene
    }

    #[test]
    fn the_gpu_agrees_with_its_twin_on_the_cpu() {
        let scene = lit(160, 120);
        let rendering = match (Settings { samples: 1 }).render(&scene, &scene.camera) {
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
        let rendering = match Settings::default().render(&scene, &scene.camera) {
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
