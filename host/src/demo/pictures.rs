//! The pictures of the demo: the fitted material on a cloth and a ball, by the reference and, where there is
//! a GPU, by `lights`.

use std::path::Path;
use std::sync::Arc;

use glam::Vec2;

use super::page::Rendered;
use crate::error::{Kind, Result};
use crate::reflectance::SbrdfMap;
use crate::render::{Renderer, Rendering, lights, reference};
use crate::report::Report;
use crate::scene::{Background, Material, Scene, showcase};

/// Repeats of the sample across the cloth and around the ball.
const TILING: [Vec2; 2] = [Vec2::splat(2.0), Vec2::new(2.0, 1.0)];

/// Renders `map` with `width` × `height` pixels and `samples` a pixel into `folder` (linear EXR and
/// tone-mapped PNG) and notes stages and adapter; returns the pictures for the page and, when `lights` could
/// not run, why.
///
/// # Errors
/// When a scene is refused or the disk refuses; a missing GPU is no error.
pub fn render(
    map: &SbrdfMap,
    (width, height, samples): (u32, u32, u32),
    folder: &Path,
    seed: u64,
    report: &mut Report,
) -> Result<(Vec<Rendered>, Option<String>)> {
    let map = Arc::new(map.clone());
    let [cloth, ball] = TILING.map(|tiling| Material::map(map.clone(), tiling));
    let scene = showcase::showcase(cloth, ball, width, height);
    // Without interreflection, as `lights` draws it.
    let settings = reference::Settings { samples, seed, bounces: 1, ..Default::default() };
    let rendering = report.stage("render reference", || settings.render(&scene, &scene.camera))?;
    report.figure("reference_rays_per_second", rendering.cost.rays as f64 / rendering.cost.render_seconds);
    let caption = format!(
        "The fitted material on a cloth and a ball in a studio environment with two lights: path-traced on \
         the CPU, {samples} samples a pixel, {:.1} s.",
        rendering.cost.render_seconds
    );
    let mut pictures = vec![finish("reference", caption, &rendering, &scene, folder)?];

    let scene = lights_only(scene);
    match report.stage("render lights", || lights::Settings::default().render(&scene, &scene.camera)) {
        Ok(rendering) => {
            let adapter = rendering.adapter.clone().unwrap_or_default();
            let milliseconds = 1e3 * rendering.cost.render_seconds;
            let caption = format!(
                "The same objects under the two lights alone: raster on {adapter}, {milliseconds:.0} ms."
            );
            report.machine.gpu = rendering.adapter.clone();
            pictures.push(finish("lights", caption, &rendering, &scene, folder)?);
            Ok((pictures, None))
        }
        Err(error) if error.kind() == Kind::Failure => Ok((pictures, Some(error.to_string()))),
        Err(error) => Err(error),
    }
}

/// The scene without its environment, exposed for what is left of the light.
fn lights_only(scene: Scene) -> Scene {
    let exposure = scene.exposure * 1.8;
    Scene {
        environment: None,
        background: Background::Colour(crate::reflectance::Rgb::splat(0.02)),
        exposure,
        ..scene
    }
}

fn finish(
    name: &str,
    caption: String,
    rendering: &Rendering,
    scene: &Scene,
    folder: &Path,
) -> Result<Rendered> {
    for extension in ["exr", "png"] {
        rendering.picture.write(&folder.join(format!("{name}.{extension}")), scene.exposure)?;
    }
    let png = rendering.picture.png(scene.exposure)?;
    Ok(Rendered { title: name.into(), caption, png })
}
