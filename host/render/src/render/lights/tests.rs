//! The GPU against its twin, both against the path tracer.

use std::sync::Arc;

use glam::{Affine3A, Vec2, Vec3};

use super::*;
use crate::render::compare::{compare, relative_rmse_by};
use crate::render::{extended_check, plain_check, reference};
use crate::scene::{Background, Light, Mask, Material, Object, Reflectance, shapes, showcase};
use lobelia_reflectance::{Lobe, LobeBrdf, Microfacet, Rgb};

/// The showcase with a third light and a rectangular one, without its environment.
fn lit(width: u32, height: u32) -> Scene {
    let mut scene = showcase::published(width, height);
    scene.environment = None;
    scene.background = Background::Colour(Vec3::new(0.1, 0.2, 0.3));
    scene.lights.push(Light::Directional { toward: Vec3::NEG_X, irradiance: Vec3::splat(0.4) });
    scene.lights.push(Light::Rectangle {
        centre: Vec3::new(0.3, 1.5, 0.4),
        edges: [Vec3::X * 0.5, Vec3::Z * 0.4],
        radiance: Vec3::splat(2.0),
    });
    scene
}

/// A check of gloss and of brushed satin, far smaller than a pixel toward the horizon of a floor; a cut-out
/// leaf above it.
fn floor(width: u32, height: u32) -> Scene {
    let brdf = |rho_d: f32, c: Vec3, n: f32| {
        let lobe = Lobe::new(Rgb::new(0.5, 0.4, 0.3), c, n);
        LobeBrdf { rho_d: Rgb::splat(rho_d), lobes: vec![lobe], ..LobeBrdf::default() }
    };
    let (gloss, satin) =
        (brdf(0.05, Vec3::new(-1.0, -1.0, 1.0), 60.0), brdf(0.2, Vec3::new(-1.1, -0.7, 0.8), 9.0));
    let map = showcase::check(&gloss, &satin.rotated(0.5), 3, 5);
    let mut scene = lit(width, height);
    let object = |name: &str, transform: Affine3A, material| Object {
        name: name.into(),
        mesh: Arc::new(shapes::plane(4)),
        transform,
        material,
    };
    let mut leaf = Material::uniform(satin.clone());
    leaf.mask = Some(Mask::from_alpha(5, 3, (0..15).map(|k| (k % 2) as f32)).into());
    leaf.tiling = Vec2::new(2.0, 3.0);
    let floor = Material::map(map.into(), Vec2::splat(10.0));
    let above = Affine3A::from_scale_rotation_translation(
        Vec3::splat(0.6),
        glam::Quat::from_rotation_x(0.9),
        Vec3::new(0.2, 0.9, 0.6),
    );
    scene.objects =
        vec![object("floor", Affine3A::from_scale(Vec3::splat(3.0)), floor), object("leaf", above, leaf)];
    scene
}

/// Relative differences between GPU and twin where both cover, at the parts given of all; `None` without a
/// GPU.
fn differences<const N: usize>(scene: &Scene, settings: Settings, parts: [f32; N]) -> Option<[f32; N]> {
    let settings = Settings { samples: 1, ..settings };
    let rendering = match settings.render(scene, &scene.camera) {
        Ok(rendering) => rendering,
        Err(error) if error.to_string().contains("no adapter") => {
            println!("skipped: {error}");
            return None;
        }
        Err(error) => panic!("{error}"),
    };
    let twin = cpu::render(scene, &settings).unwrap();
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
    println!("coverage differs at {coverage} of {} pixels", twin.pixels.len());
    assert!(coverage * 1000 <= twin.pixels.len(), "{coverage} pixels are covered in one only");
    let found = parts.map(|part| errors[((errors.len() - 1) as f32 * part) as usize]);
    println!("{settings:?}: relative differences {found:?}");
    Some(found)
}

#[test]
fn the_gpu_agrees_with_its_twin_on_the_cpu() {
    for shadows in [true, false] {
        // Small triangles: a rasteriser's rounding of their corners changes footprints by per cents.
        let settings = Settings { shadows, filtering: Filtering::Finest, ..Settings::default() };
        // A few pixels lie on an edge of the mesh or of a shadow, where the two may see different triangles.
        if let Some([median, most]) = differences(&lit(160, 120), settings, [0.5, 0.99]) {
            assert!(median < 1e-5 && most < 1e-3, "{median} {most}");
        }
    }
}

#[test]
fn every_filter_and_storage_and_cut_outs_agree_with_the_twin() {
    let scene = floor(64, 48);
    let filters = [Filtering::Finest, Filtering::Coefficients, Filtering::Fitted, Filtering::Shaded];
    let variants = filters.map(|filtering| Settings { filtering, ..Settings::default() });
    let stored =
        Storage::ALL.map(|storage| Settings { storage, filtering: Filtering::Finest, ..Settings::default() });
    for settings in variants.into_iter().chain(stored) {
        // Where the number of samples of a footprint changes, rounding decides for one or the other.
        let Some([median, most]) = differences(&scene, settings, [0.5, 0.97]) else { return };
        assert!(median < 1e-4 && most < 5e-3, "{settings:?} {median} {most}");
    }
}

#[test]
fn shadows_and_cut_outs_are_those_of_the_path_tracer() {
    let mut scene = floor(48, 36);
    // Lights that both have without an extent, and texels that a pixel does not mix.
    scene.lights.truncate(3);
    scene.objects[0].material = Material::uniform(LobeBrdf::diffuse(Rgb::splat(0.2)));
    let error = |shadows| error_of_direct_light(&scene, &Settings { shadows, ..Settings::default() }, 16);
    let (with, without) = (error(true), error(false));
    println!("relative RMSE against the path tracer: {with} with shadows, {without} without");
    assert!(with < 0.05 && without > 0.1, "{with} {without}");
}

#[test]
fn filters_that_follow_shading_are_nearer_to_shading_all_texels() {
    // The floor fills the picture, light comes from beyond it.
    let mut scene = floor(32, 24);
    scene.objects.truncate(1);
    (scene.camera.position, scene.camera.target) = (Vec3::new(0.0, 1.0, 2.8), Vec3::new(0.0, 0.0, 1.0));
    scene.lights =
        vec![Light::Directional { toward: Vec3::new(0.1, 0.5, -0.9).normalize(), irradiance: Rgb::ONE }];
    scene.objects[0].material.tiling = Vec2::splat(40.0);
    let truth = reference::Settings { samples: 256, bounces: 1, ..Default::default() };
    let truth = truth.render(&scene, &scene.camera).unwrap().picture;
    let error = |filtering| {
        let settings = Settings { filtering, ..Settings::default() };
        compare(&cpu::render(&scene, &settings).unwrap(), &truth).unwrap().relative_rmse
    };
    let [coefficients, fitted, shaded] =
        [Filtering::Coefficients, Filtering::Fitted, Filtering::Shaded].map(error);
    println!("relative RMSE: coefficients {coefficients}, fitted {fitted}, shaded {shaded}");
    assert!(2.0 * fitted < coefficients && shaded < fitted, "{coefficients} {fitted} {shaded}");
}

#[test]
fn multisampled_edges_blend_with_the_background() {
    let mut scene = lit(64, 48);
    scene.objects.retain(|object| object.name == "ball");
    let mask = Mask::from_alpha(8, 1, (0..8).map(|k| (k % 2) as f32));
    for mask in [None, Some(Arc::new(mask))] {
        let cut = mask.is_some();
        scene.objects[0].material.mask = mask;
        let rendering = match Settings::default().render(&scene, &scene.camera) {
            Ok(rendering) => rendering,
            Err(error) if error.to_string().contains("no adapter") => return println!("skipped: {error}"),
            Err(error) => panic!("{error}"),
        };
        let pixels = &rendering.picture.pixels;
        assert!((pixels[0].truncate() - Vec3::new(0.1, 0.2, 0.3)).length() < 1e-4 && pixels[0].w == 0.0);
        let partly = pixels.iter().filter(|pixel| pixel.w > 0.0 && pixel.w < 1.0).count();
        let whole = pixels.iter().filter(|pixel| pixel.w == 1.0).count();
        assert!(partly > 10 && (cut || whole > partly), "{partly} {whole}");
        assert!(rendering.adapter.is_some() && rendering.cost.samples == 4);
    }
}

#[test]
fn no_sample_of_a_triangle_seen_edge_on_is_beyond_measure() {
    let mut scene = Scene::open(std::path::Path::new("lamps")).unwrap();
    (scene.camera.width, scene.camera.height) = (64, 48);
    match Settings::default().render(&scene, &scene.camera) {
        Ok(rendering) => assert!(rendering.picture.pixels.iter().all(|pixel| pixel.max_element() < 100.0)),
        Err(error) if error.to_string().contains("no adapter") => println!("skipped: {error}"),
        Err(error) => panic!("{error}"),
    }
}

#[test]
fn counts_and_levels_that_cannot_be_are_refused() {
    let base = Settings::default();
    let fitted = Settings { filtering: Filtering::Fitted, ..base };
    for (scene, settings) in [
        (coated(8, 6), Settings { anisotropy: 0, ..base }),
        (coated(8, 6), Settings { light_samples: 0, ..base }),
        (coated(8, 6), fitted),
        (checked(8, 6, extended_check()), fitted),
    ] {
        assert_eq!(cpu::render(&scene, &settings).unwrap_err().exit_code(), 2);
    }
}

/// The floor with a clear coat over its check, of another roughness on every material.
fn coated(width: u32, height: u32) -> Scene {
    let mut scene = floor(width, height);
    let coat = |alpha| Microfacet { f0: Rgb::new(0.05, 0.08, 0.3), f90: Rgb::splat(0.9), alpha };
    let with = |alpha| LobeBrdf {
        microfacets: vec![coat(alpha)],
        ..lobelia_reflectance::materials::published("clay").unwrap()
    };
    scene.objects[0].material.reflectance =
        Reflectance::Map(showcase::check(&with(0.3), &with(0.1), 3, 5).into());
    scene.objects[1].material.reflectance = Reflectance::Uniform(with(0.05));
    scene
}

#[test]
fn microfacet_terms_agree_with_the_twin_in_every_storage() {
    let scene = coated(64, 48);
    let coefficients = Settings { filtering: Filtering::Coefficients, ..Settings::default() };
    let stored = Storage::ALL.map(|storage| Settings { storage, ..Settings::default() });
    for settings in stored.into_iter().chain([coefficients]) {
        let Some([median, most]) = differences(&scene, settings, [0.5, 0.97]) else { return };
        assert!(median < 1e-4 && most < 5e-3, "{settings:?} {median} {most}");
    }
}

/// The floor with another map, which light from beyond it makes shine.
fn checked(width: u32, height: u32, map: SbrdfMap) -> Scene {
    let mut scene = floor(width, height);
    scene.lights[0] =
        Light::Directional { toward: Vec3::new(0.1, 0.35, -0.9).normalize(), irradiance: Rgb::ONE };
    scene.objects[0].material.reflectance = Reflectance::Map(map.into());
    scene
}

#[test]
fn normals_and_sharpening_agree_with_the_twin_in_every_filter_and_storage() {
    let mut scene = checked(64, 48, extended_check());
    scene.objects[1].material.reflectance = Reflectance::Uniform(extended_check().texel(0).rotated(0.9));
    let filters = [Filtering::Finest, Filtering::Coefficients]
        .map(|filtering| Settings { filtering, ..Settings::default() });
    let stored = Storage::ALL.map(|storage| Settings { storage, ..Settings::default() });
    for settings in filters.into_iter().chain(stored) {
        // Where the number of samples of a footprint changes, rounding decides for one or the other.
        let Some([median, most]) = differences(&scene, settings, [0.5, 0.97]) else { return };
        assert!(median < 1e-4 && most < 5e-3, "{settings:?} {median} {most}");
    }
}

#[test]
fn levels_alone_may_have_normals() {
    let mut scene = checked(64, 48, plain_check());
    scene.objects[0].material.levels =
        (1..=4).map(|level| levels::averaged(&extended_check(), level).into()).collect();
    let fitted = Settings { filtering: Filtering::Fitted, ..Settings::default() };
    if let Some([median, most]) = differences(&scene, fitted, [0.5, 0.97]) {
        assert!(median < 1e-4 && most < 5e-3, "{median} {most}");
    }
}

#[test]
fn normals_and_sharpening_are_those_of_the_path_tracer() {
    let scene = |map| {
        let mut scene = checked(32, 24, map);
        scene.objects.truncate(1);
        scene.lights.truncate(3);
        // Texels larger than a pixel.
        scene.objects[0].material.tiling = Vec2::splat(0.5);
        scene
    };
    let [extended, plain] = [extended_check(), plain_check()].map(scene);
    let error = error_of_direct_light(&extended, &Settings::default(), 16);
    let pictures = [&plain, &extended].map(|scene| cpu::render(scene, &Settings::default()).unwrap());
    let change = compare(&pictures[0], &pictures[1]).unwrap().relative_rmse;
    println!(
        "relative RMSE against the path tracer: {error}; without normals and sharpening {change} from it"
    );
    assert!(error < 0.05 && change > 0.2, "{error} {change}");
}

/// Relative RMSE of the mean over 4 × 4 pixels of the twin, which has one sample a pixel, by noisy pictures
/// of the path tracer's direct light.
fn error_of_direct_light(scene: &Scene, settings: &Settings, samples: u32) -> f64 {
    let (width, height) = (scene.camera.width as usize, scene.camera.height as usize);
    let judges = [1, 2, 3].map(|seed| {
        let judge = reference::Settings { samples, bounces: 1, seed, ..Default::default() };
        judge.render(scene, &scene.camera).unwrap().picture
    });
    let mut fine = scene.clone();
    (fine.camera.width, fine.camera.height) = (width as u32 * 4, height as u32 * 4);
    let fine = cpu::render(&fine, settings).unwrap();
    let mean = |index: usize| {
        let (x, y) = (index % width * 4, index / width * 4);
        (0..16).map(|k| fine.pixels[(y + k / 4) * width * 4 + x + k % 4] / 16.0).sum()
    };
    let pixels = (0..width * height).map(mean).collect();
    relative_rmse_by(&judges, &Picture { width, height, pixels })
}

#[test]
fn microfacet_terms_are_those_of_the_path_tracer() {
    let mut scene = coated(32, 24);
    scene.lights.truncate(3);
    // Texels larger than a pixel.
    scene.objects[0].material.tiling = Vec2::splat(0.5);
    let error = error_of_direct_light(&scene, &Settings::default(), 16);
    println!("relative RMSE against the path tracer: {error}");
    assert!(error < 0.05, "{error}");
}

#[test]
fn rectangular_lights_are_those_of_the_path_tracer() {
    let mut scene = Scene::open(std::path::Path::new("window")).unwrap();
    (scene.camera.width, scene.camera.height) = (32, 32);
    let error =
        |light_samples| error_of_direct_light(&scene, &Settings { light_samples, ..Settings::default() }, 32);
    let [one, many] = [1, 64].map(error);
    println!("relative RMSE against the path tracer: {one} with one sample, {many} with up to 64");
    // What is left is the edges, which 16 samples a pixel do not meet exactly.
    assert!(many < 0.05 && many < 0.5 * one, "{one} {many}");
}

#[test]
fn a_scene_that_its_environment_alone_lights_is_refused() {
    let mut scene = showcase::published(8, 8);
    scene.lights.clear();
    let error = Settings::default().prepare(&scene).map(|_| ()).unwrap_err();
    assert!(error.to_string().contains("environment alone") && error.exit_code() == 2, "{error}");
}

/// Where the camera looks decides nothing about what is in front of it.
#[test]
fn the_near_plane_is_nearer_than_anything_seen_however_far_the_target() {
    let scene = lit(8, 6);
    let near = near(&scene);
    let [eye, forward] = [scene.camera.position, scene.camera.basis()[2]];
    let depth = |target: f32, distance: f32| {
        let camera = Camera { target: eye + target * forward, ..scene.camera };
        let clip = projection(&camera, near) * (eye + distance * forward).extend(1.0);
        clip.z / clip.w
    };
    for target in [0.01, 1.0, 1e5] {
        let depths = [1e-4, 0.01, 1.0, 100.0, 1e4].map(|distance| depth(target, distance));
        assert!(depths.iter().all(|depth| (0.0..=1.0).contains(depth)), "{depths:?}");
        // Nearer is larger, by more than rounding.
        assert!(depths.windows(2).all(|pair| pair[0] > 1.5 * pair[1]), "{depths:?}");
    }
}

#[test]
fn what_stands_before_the_camera_is_drawn_with_a_target_far_behind_it() {
    let mut scene = lit(40, 30);
    let forward = scene.camera.basis()[2];
    scene.camera.target = scene.camera.position + forward * 1e5;
    match Settings::default().render(&scene, &scene.camera) {
        Ok(rendering) => {
            let covered = rendering.picture.pixels.iter().map(|pixel| pixel.w).sum::<f32>();
            let whole = rendering.picture.pixels.len() as f32;
            let settings = reference::Settings { samples: 16, bounces: 1, ..Default::default() };
            let truth = settings.render(&scene, &scene.camera).unwrap().picture;
            let expected = truth.pixels.iter().map(|pixel| pixel.w).sum::<f32>();
            assert!(
                expected > 0.2 * whole && (covered - expected).abs() < 0.02 * whole,
                "{covered} {expected}"
            );
        }
        Err(error) if error.to_string().contains("no adapter") => println!("skipped: {error}"),
        Err(error) => panic!("{error}"),
    }
}
