//! The twin of shaders/lights.wgsl in Rust: the same shading, one ray through the middle of every pixel, no shadows. It is
//! the oracle for the shader.

use glam::Vec4;
use rayon::prelude::*;

use crate::error::Result;
use crate::reflectance::Rgb;
use crate::render::geometry::{Geometry, Surface};
use crate::render::image::Picture;
use crate::render::materials::{Materials, Shader};
use crate::render::shading::{self, Rays};
use crate::scene::Scene;

/// Renders a scene's point and directional lights on the CPU, one sample a pixel.
///
/// # Errors
/// Input errors for a scene that [`Scene::check`] refuses.
pub fn render(scene: &Scene) -> Result<Picture> {
    render_with(scene, |_, _| Rgb::ZERO)
}

/// The same with other light that a texel reflects.
///
/// # Errors
/// Those of [`render`].
pub(crate) fn render_with(
    scene: &Scene,
    distant: impl Fn(&Surface, &Shader) -> Rgb + Sync,
) -> Result<Picture> {
    scene.check()?;
    let (geometry, materials, rays) = (Geometry::new(scene), Materials::new(scene), Rays::new(&scene.camera));
    let lamps = shading::lamps(&scene.lights, super::POINTS_ACROSS);
    let (width, height) = (scene.camera.width as usize, scene.camera.height as usize);
    let mut pixels = vec![Vec4::ZERO; width * height];
    pixels.par_iter_mut().enumerate().for_each_init(Shader::new, |shader, (index, pixel)| {
        let (x, y) = ((index % width) as f32 + 0.5, (index / width) as f32 + 0.5);
        let direction = rays.direction(x, y);
        let Some(hit) = geometry.nearest(rays.origin, direction) else {
            *pixel = shading::background(scene, direction).extend(0.0);
            return;
        };
        if let Some(emission) = materials.emission(geometry.object(&hit)) {
            let shines = geometry.front(&hit, direction);
            *pixel = if shines { emission } else { Rgb::ZERO }.extend(1.0);
            return;
        }
        let surface = geometry.surface(&hit, rays.origin, direction);
        let mut radiance = Rgb::ZERO;
        for (texel, weight) in materials.neighbours(surface.object, surface.uv) {
            if weight > 0.0 {
                shader.aim(&materials, texel, surface.to_local(-direction), false);
                let near = shading::reflect_lights(&lamps, &surface, shader, |_| true);
                radiance += weight * (near + distant(&surface, shader));
            }
        }
        *pixel = radiance.extend(1.0);
    });
    Ok(Picture { width, height, pixels })
}
