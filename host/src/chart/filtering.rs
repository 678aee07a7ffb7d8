//! Filters of textures that are smaller than pixels, judged by pictures (stability case G14).

use std::sync::Arc;

use glam::{Vec2, Vec3, Vec4};
use rayon::prelude::*;

use super::{Axis, Picture, Plot, Section, Series, Table};
use crate::edit::levels;
use crate::error::Result;
use crate::progress;
use crate::reflectance::{Rgb, SbrdfMap};
use crate::render::compare::compare;
use crate::render::lights::{Filtering, Settings, cpu};
use crate::render::{Renderer, reference};
use crate::scene::{Background, Camera, Light, Material, Object, Scene, shapes};

/// Texels a pixel, along the pixel's shorter axis on the texture.
const MINIFICATIONS: [f32; 7] = [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0];
/// Samples a pixel of the path tracer.
const SAMPLES: u32 = 1024;
/// Pixels a row, and rows.
const SIZE: [u32; 2] = [48, 36];
/// Between the plane's normal and the view.
const TILT: f32 = 60.0;

/// A plane of a map under a light that it is seen against from 60° and one from the side, `texels` texels a
/// pixel across and twice that along.
fn scene(map: &Arc<SbrdfMap>, fitted: &[Arc<SbrdfMap>], texels: f32) -> Scene {
    let (sin, cos) = TILT.to_radians().sin_cos();
    let (distance, fov) = (4.0, 14f32.to_radians());
    let pixel = 2.0 * distance * (fov / 2.0).tan() / SIZE[1] as f32;
    // The plane is 2 units wide before it is scaled.
    let scale = 6.0;
    let tiling = texels / pixel * 2.0 * scale / map.width as f32;
    let mut material = Material::map(map.clone(), Vec2::splat(tiling));
    material.levels = fitted.to_vec();
    Scene {
        objects: vec![Object {
            name: "plane".into(),
            mesh: shapes::plane(1).into(),
            transform: glam::Affine3A::from_scale(Vec3::splat(scale)),
            material,
        }],
        lights: [Vec3::new(0.03, cos, -sin), Vec3::new(0.8, 0.8, -0.1)]
            .map(|toward| Light::Directional { toward: toward.normalize(), irradiance: Rgb::splat(2.0) })
            .to_vec(),
        environment: None,
        background: Background::Colour(Rgb::ZERO),
        camera: Camera {
            position: distance * Vec3::new(0.0, cos, sin),
            target: Vec3::ZERO,
            up: Vec3::Y,
            fov,
            width: SIZE[0],
            height: SIZE[1],
        },
        animation: None,
        parameters: vec![],
        exposure: 1.0,
    }
}

/// The relative RMSE of every filter, and the pictures of the reference and of the filters, at one
/// minification.
fn measure(scene: &Scene) -> Result<([f64; 4], Vec<lobelia_reflectance::picture::Picture>)> {
    let judge = reference::Settings { samples: SAMPLES, bounces: 1, ..Default::default() };
    let truth = judge.render(scene, &scene.camera)?.picture;
    let mut pictures = vec![truth];
    let mut errors = [f64::NAN; 4];
    for (error, filtering) in errors.iter_mut().zip(Filtering::ALL) {
        let picture = cpu::render(scene, &Settings { filtering, ..Settings::default() })?;
        *error = compare(&picture, &pictures[0])?.relative_rmse;
        pictures.push(picture);
    }
    Ok((errors, pictures))
}

/// A section for maps by name.
///
/// # Errors
/// Those of the renderers.
pub(super) fn section(maps: &[(&str, SbrdfMap)]) -> Result<Section> {
    let [a, b, c, d] = Filtering::ALL.map(Filtering::name);
    let mut table = Table::new(["map", "texels a pixel", a, b, c, d]);
    let (mut plots, mut shown) = (vec![], vec![]);
    let bar = progress::bar("filters", (maps.len() * MINIFICATIONS.len()) as u64, "pictures");
    for (name, map) in maps {
        let fitted: Vec<Arc<SbrdfMap>> = levels::all_fitted(map).into_iter().map(Arc::new).collect();
        let map = Arc::new(map.clone());
        let mut series = Filtering::ALL.map(|filter| Series::new(filter.name(), vec![]));
        for texels in MINIFICATIONS {
            let scene = scene(&map, &fitted, texels);
            let (errors, pictures) = measure(&scene)?;
            bar.advance(1);
            let [a, b, c, d] = errors.map(Into::into);
            table.row([(*name).into(), f64::from(texels).into(), a, b, c, d]);
            for (series, error) in series.iter_mut().zip(errors) {
                series.points.push([f64::from(texels), error]);
            }
            if texels == 4.0 {
                let names = std::iter::once("reference").chain(Filtering::ALL.map(Filtering::name));
                for (picture, filter) in pictures.iter().zip(names) {
                    let png = enlarged(picture, 6).png(scene.exposure)?;
                    shown.push(Picture { title: format!("{name}, {texels} texels a pixel: {filter}"), png });
                }
            }
        }
        plots.push(Plot {
            title: (*name).into(),
            x: Axis::log("texels a pixel"),
            y: Axis::log("relative RMSE"),
            series: series.to_vec(),
        });
    }
    Ok(Section {
        title: "Pictures by filter".into(),
        text: format!(
            "The same maps on a plane seen from {TILT}°, which makes pixels twice as long as wide on it, \
             against one light and with another from the side. Relative RMSE of the renderer `lights` \
             against the path tracer with {SAMPLES} samples a pixel. Averaged coefficients and fitted levels \
             are MIP levels, with up to 16 samples along the pixel's longer axis; shade-then-filter \
             evaluates up to 16 × 16 texels of the finest level."
        ),
        plots,
        pictures: shown,
        tables: vec![table],
    })
}

/// Every pixel as a square of `times` × `times`.
fn enlarged(picture: &lobelia_reflectance::picture::Picture, times: usize) -> crate::render::Picture {
    let (width, height) = (picture.width * times, picture.height * times);
    let at = |k: usize| picture.pixels[k / width / times * picture.width + k % width / times];
    let pixels: Vec<Vec4> = (0..width * height).into_par_iter().map(at).collect();
    lobelia_reflectance::picture::Picture { width, height, pixels }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reflectance::LobeBrdf;

    #[test]
    fn a_uniform_map_needs_no_filter_and_a_check_does() {
        let brdf = |rho: f32| LobeBrdf::diffuse(Rgb::splat(rho));
        let of = |first: f32, second: f32| {
            let map = Arc::new(crate::scene::showcase::check(&brdf(first), &brdf(second), 4, 4));
            let mut scene = scene(&map, &[], 5.0);
            (scene.camera.width, scene.camera.height) = (24, 18);
            measure(&scene).unwrap().0
        };
        let same = of(0.2, 0.2);
        assert!(same.iter().all(|&error| error < 1e-4), "{same:?}");
        // Diffuse coefficients average as reflectance does.
        let [finest, coefficients, fitted, shaded] = of(0.05, 0.3);
        assert!(finest > 0.3 && coefficients < 0.15 && shaded < 0.15, "{finest} {coefficients} {shaded}");
        assert!((fitted - coefficients).abs() < 1e-3, "{fitted} {coefficients}");
    }
}
