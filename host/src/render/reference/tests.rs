//! Oracles: closed forms, the furnace, quadrature, and independence of threads.

use std::f32::consts::{FRAC_1_PI, PI};
use std::sync::Arc;

use glam::{Affine3A, Vec3};

use super::*;
use crate::reflectance::{Brdf, Lobe, LobeBrdf, materials};
use crate::scene::{Background, Camera, Environment, Light, Material, Mesh, Object, shapes};

/// One object in black space, seen from `position`.
fn scene(mesh: Mesh, brdf: LobeBrdf, position: Vec3) -> Scene {
    Scene {
        objects: vec![Object {
            name: "object".into(),
            mesh: Arc::new(mesh),
            transform: Affine3A::IDENTITY,
            material: Material::uniform(brdf),
        }],
        lights: vec![],
        environment: None,
        background: Background::Colour(Rgb::ZERO),
        camera: Camera { position, target: Vec3::ZERO, up: Vec3::X, fov: 0.02, width: 5, height: 5 },
        exposure: 1.0,
    }
}

fn phong(n: f32) -> LobeBrdf {
    let lobe = Lobe { rho_s: Rgb::new(0.4, 0.3, 0.2), c: Vec3::new(-1.0, -1.0, 1.0), n };
    LobeBrdf { rho_d: Rgb::splat(0.05), beta: 0.0, lobes: vec![lobe] }
}

fn render_with(scene: &Scene, samples: u32) -> Picture {
    render(scene, &Settings { samples, seed: 3 }).unwrap().picture
}

/// The mean over all pixels.
fn mean(picture: &Picture) -> Vec4 {
    picture.pixels.iter().sum::<Vec4>() / picture.pixels.len() as f32
}

#[test]
fn a_white_convex_object_vanishes_in_a_white_furnace() {
    let mut furnace = scene(shapes::sphere(96, 48), LobeBrdf::diffuse(Rgb::ONE), Vec3::new(1.0, 0.5, 4.0));
    furnace.environment = Some(Environment::uniform(Rgb::ONE));
    furnace.background = Background::Environment;
    furnace.camera = Camera { fov: 0.6, width: 16, height: 16, ..furnace.camera };
    let picture = render_with(&furnace, 256);
    for (i, pixel) in picture.pixels.iter().enumerate() {
        assert!((pixel.truncate() - Rgb::ONE).abs().max_element() < 0.04, "pixel {i}: {pixel}");
    }
    assert!((mean(&picture).x - 1.0).abs() < 0.004, "{}", mean(&picture));
    assert!(picture.pixels[0].w < 0.5 && picture.pixels[8 * 16 + 8].w == 1.0);
}

#[test]
fn a_point_light_on_a_diffuse_plane_follows_the_closed_form() {
    let albedo = Rgb::new(0.8, 0.5, 0.2);
    let mut lit = scene(shapes::plane(2), LobeBrdf::diffuse(albedo), Vec3::new(0.4, 5.0, 0.3));
    let (position, intensity) = (Vec3::new(0.3, 0.8, -0.4), Rgb::new(2.0, 3.0, 4.0));
    lit.lights.push(Light::Point { position, intensity });
    let square = position.length_squared();
    let expected = albedo * FRAC_1_PI * intensity / square * (position.y / square.sqrt());
    let got = render_with(&lit, 16).rgb(2, 2);
    assert!((got / expected - Rgb::ONE).abs().max_element() < 2e-3, "{got} {expected}");
}

#[test]
fn directional_light_on_a_lobe_follows_the_closed_form() {
    let view = Vec3::new(-0.5, 0.9, 0.1);
    let toward = Vec3::new(0.45, 0.9, 0.0).normalize();
    let mut lit = scene(shapes::plane(2), phong(30.0), view * 4.0);
    lit.lights.push(Light::Directional { toward, irradiance: Rgb::splat(3.0) });
    // The plane's sample frame: x = +x, y = −z, z = +y.
    let local = |d: Vec3| Vec3::new(d.x, -d.z, d.y);
    let expected = phong(30.0).eval(local(toward), local(view.normalize())) * 3.0 * toward.y;
    let got = render_with(&lit, 16).rgb(2, 2);
    assert!((got / expected - Rgb::ONE).abs().max_element() < 5e-3, "{got} {expected}");
}

#[test]
fn an_object_between_surface_and_light_casts_a_shadow() {
    let mut lit = scene(shapes::plane(2), LobeBrdf::diffuse(Rgb::ONE), Vec3::new(0.4, 5.0, 0.3));
    lit.lights.push(Light::Point { position: Vec3::new(0.0, 2.0, 0.0), intensity: Rgb::ONE });
    lit.objects.push(lit.objects[0].clone());
    let high = Vec3::new(0.0, 1.5, 0.0);
    lit.objects[1].transform =
        Affine3A::from_scale_rotation_translation(Vec3::splat(0.1), glam::Quat::from_rotation_x(PI), high);
    lit.camera.position.x = 3.0;
    assert_eq!(render_with(&lit, 4).rgb(2, 2), Rgb::ZERO);
    lit.objects[1].transform.translation.y = 2.5;
    assert!(render_with(&lit, 4).rgb(2, 2).x > 0.0);
}

#[test]
fn sampled_environment_light_equals_quadrature() {
    let environment = Environment::from_function(64, 32, |d| {
        let lamp = if d.dot(Vec3::new(0.5, 0.8, 0.2).normalize()) > 0.96 { 40.0 } else { 0.0 };
        Rgb::new(0.5 + 0.4 * d.x, 0.3 + lamp, 0.2 + 0.2 * d.z)
    })
    .rotated(0.5);
    let retro = Lobe { rho_s: Rgb::splat(0.2), c: Vec3::new(0.8, 0.6, 0.9), n: 8.0 };
    for (name, mut brdf) in [
        ("phong", phong(25.0)),
        ("sharp", phong(400.0)),
        ("clay", materials::published("clay").unwrap()),
        ("retro", LobeBrdf { lobes: vec![retro], ..LobeBrdf::default() }),
    ] {
        brdf.beta = 0.3;
        let view = Vec3::new(-0.5, 0.8, -0.1).normalize();
        let mut lit = scene(shapes::plane(2), brdf.clone(), view * 4.0);
        lit.camera.fov = 1e-3;
        lit.environment = Some(environment.clone());
        let local = |d: Vec3| Vec3::new(d.x, -d.z, d.y);
        let (columns, rows) = (1024, 512);
        let mut expected = glam::DVec3::ZERO;
        for j in 0..rows {
            let y = (j as f32 + 0.5) / rows as f32;
            let radius = (1.0 - y * y).sqrt();
            for i in 0..columns {
                let (sin, cos) = ((i as f32 + 0.5) / columns as f32 * TAU).sin_cos();
                let wi = Vec3::new(radius * cos, y, radius * sin);
                let f = brdf.eval(local(wi), local(view));
                expected += (f * environment.radiance(wi) * y).as_dvec3();
            }
        }
        let expected = (expected * std::f64::consts::TAU / f64::from(columns * rows)).as_vec3();
        let got = mean(&render_with(&lit, 2048)).truncate();
        assert!((got / expected - Rgb::ONE).abs().max_element() < 0.01, "{name}: {got} {expected}");
    }
}

#[test]
fn the_picture_does_not_depend_on_the_number_of_threads_but_on_the_seed() {
    let scene = crate::scene::showcase::published(24, 18);
    let with_threads = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| render(&scene, &Settings { samples: 4, seed }).unwrap().picture)
    };
    let one = with_threads(1, 7);
    assert_eq!(one, with_threads(3, 7));
    assert_ne!(one, with_threads(1, 8));
    assert!(one.pixels.iter().all(|pixel| pixel.is_finite()));
}

#[test]
fn no_samples_and_broken_scenes_are_refused() {
    let mut broken = scene(shapes::plane(1), LobeBrdf::default(), Vec3::Y);
    assert_eq!(render(&broken, &Settings { samples: 0, seed: 0 }).unwrap_err().exit_code(), 2);
    broken.camera.width = 0;
    assert_eq!(render(&broken, &Settings::default()).unwrap_err().exit_code(), 2);
}
