//! Oracles of mirrors, glass, metal and shining meshes: closed forms, the furnace, images, and equal
//! pictures.

use std::f32::consts::{FRAC_1_PI, PI};
use std::sync::Arc;

use glam::{Affine3A, Quat, Vec2, Vec3};

use super::*;
use crate::scene::{
    Background, Camera, Dielectric, Environment, Filter, Light, Material, Mesh, Object, Optics, Reflectance,
    Texture, shapes,
};
use lobelia_reflectance::{LobeBrdf, Rgb, fresnel};

fn material(optics: Option<Optics>, albedo: f32) -> Material {
    let brdf = LobeBrdf::diffuse(Rgb::splat(albedo));
    Material { optics, ..Material::new(Reflectance::Uniform(brdf), Vec2::ONE, Filter::Nearest) }
}

fn shining(radiance: Rgb) -> Material {
    Material { emission: Some(Texture::Uniform(radiance)), ..material(None, 0.0) }
}

fn glass(index: f32, absorption: f32) -> Material {
    material(
        Some(Optics::Dielectric(Dielectric { index, absorption: Rgb::splat(absorption), priority: 0 })),
        0.0,
    )
}

fn mirror(rho: f32) -> Optics {
    Optics::Mirror(Texture::Uniform(Rgb::splat(rho)))
}

fn object(mesh: Mesh, transform: Affine3A, material: Material) -> Object {
    Object { name: "object".into(), mesh: Arc::new(mesh), transform, material }
}

/// Objects in a uniform environment of radiance 1, seen from `position` toward the origin.
fn scene(objects: Vec<Object>, position: Vec3) -> Scene {
    Scene {
        objects,
        lights: vec![],
        environment: Some(Environment::uniform(Rgb::ONE)),
        background: Background::Environment,
        camera: Camera { position, target: Vec3::ZERO, up: Vec3::X, fov: 0.02, width: 5, height: 5 },
        animation: None,
        parameters: vec![],
        exposure: 1.0,
    }
}

fn render(scene: &Scene, samples: u32, tree: u32) -> Picture {
    let settings = Settings { samples, tree, seed: 5, ..Settings::default() };
    settings.render(scene, &scene.camera).unwrap().picture
}

fn mean(picture: &Picture) -> Rgb {
    picture.pixels.iter().map(|pixel| pixel.truncate()).sum::<Rgb>() / picture.pixels.len() as f32
}

fn near(got: Rgb, expected: f32, tolerance: f32) -> bool {
    (got / expected - Rgb::ONE).abs().max_element() < tolerance
}

/// A wide plate between y = −thickness / 2 and thickness / 2.
fn plate(thickness: f32) -> Mesh {
    let face = |turn: f32, y: f32| {
        shapes::plane(1).transformed(&Affine3A::from_scale_rotation_translation(
            Vec3::splat(200.0),
            Quat::from_rotation_x(turn),
            Vec3::Y * y,
        ))
    };
    let (mut mesh, below) = (face(0.0, thickness / 2.0), face(PI, -thickness / 2.0));
    let first = mesh.vertices.len() as u32;
    mesh.vertices.extend(below.vertices);
    mesh.triangles.extend(below.triangles.iter().map(|triangle| triangle.map(|i| i + first)));
    mesh
}

#[test]
fn a_plate_of_glass_reflects_with_all_its_internal_bounces_and_absorbs_by_the_length() {
    for (degrees, absorption) in [(0.0f32, 0.0f32), (45.0, 0.0), (70.0, 0.0), (60.0, 0.8)] {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let (reflectance, beyond) = fresnel::dielectric(cos, 1.5);
        let left = (-absorption / beyond).exp();
        let through = (1.0 - reflectance).powi(2) * left / (1.0 - (reflectance * left).powi(2));
        let expected = [reflectance + through * reflectance * left, through];
        // Light from above is what is reflected, light from below what is transmitted.
        for (above, expected) in [(true, expected[0]), (false, expected[1])] {
            let mut lit = scene(
                vec![object(plate(1.0), Affine3A::IDENTITY, glass(1.5, absorption))],
                Vec3::new(sin, cos, 0.0) * 20.0,
            );
            lit.camera.up = Vec3::Z;
            lit.environment = Some(Environment::from_function(64, 32, |d| {
                if (d.y > 0.0) == above { Rgb::ONE } else { Rgb::ZERO }
            }));
            for tree in [0, 1, 3] {
                let got = mean(&render(&lit, if tree == 3 { 256 } else { 4096 }, tree));
                let tolerance = if tree == 3 { 5e-3 } else { 0.02 };
                assert!(near(got, expected, tolerance), "{degrees}°, {above}, {tree}: {got} {expected}");
            }
        }
    }
}

#[test]
fn glass_mirrors_and_white_paint_under_a_mirror_vanish_in_a_white_furnace() {
    let half = material(Some(mirror(0.5)), 0.5);
    for (name, material, samples) in [
        ("glass", glass(1.5, 0.0), 64),
        ("air in glass's place", glass(0.66, 0.0), 64),
        ("mirror", material(Some(mirror(1.0)), 0.0), 16),
        ("half a mirror", half, 256),
    ] {
        let sphere = object(shapes::sphere(64, 32), Affine3A::IDENTITY, material);
        let mut furnace = scene(vec![sphere], Vec3::new(1.0, 0.5, 4.0));
        furnace.camera = Camera { fov: 0.6, width: 12, height: 12, ..furnace.camera };
        // Roulette makes noise of paths that carry little, of which a pixel at the rim has few.
        let tolerance = if samples > 16 { 0.08 } else { 1e-5 };
        let picture = render(&furnace, samples, 2);
        for pixel in &picture.pixels {
            assert!(near(pixel.truncate(), 1.0, tolerance), "{name}: {pixel}");
        }
        assert!(near(mean(&picture), 1.0, 3e-3), "{name}: {}", mean(&picture));
    }
}

#[test]
fn radiance_grows_with_the_squared_index_into_glass_and_falls_out_of_it() {
    let index = 1.5f32;
    let sphere = || object(shapes::sphere(96, 48), Affine3A::IDENTITY, glass(index, 0.0));
    let mut inside = scene(vec![sphere()], Vec3::new(0.1, 0.05, 0.02));
    inside.camera = Camera { target: Vec3::Z, fov: 1.0, ..inside.camera };
    assert!(near(mean(&render(&inside, 64, 2)), index * index, 3e-3));
    // A black lamp of radiance 1 in the middle, seen through the surface straight on: what is reflected back
    // to it is lost.
    let lamp = Affine3A::from_scale(Vec3::splat(0.2));
    let mut outside = scene(
        vec![sphere(), object(shapes::sphere(64, 32), lamp, shining(Rgb::ONE))],
        Vec3::new(0.0, 0.0, 5.0),
    );
    outside.environment = None;
    outside.camera = Camera { up: Vec3::Y, fov: 0.01, ..outside.camera };
    let expected = (1.0 - fresnel::dielectric(1.0, index).0) / (index * index);
    let got = mean(&render(&outside, 256, 2));
    assert!(near(got, expected, 5e-3), "{got} {expected}");
}

#[test]
fn metal_reflects_by_fresnel() {
    let (n, k) = (Rgb::new(0.143, 0.375, 1.442), Rgb::new(3.983, 2.386, 1.603));
    let ground =
        object(shapes::plane(1), Affine3A::IDENTITY, material(Some(Optics::Conductor { n, k }), 0.0));
    for degrees in [5.0f32, 60.0, 85.0] {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let mut lit = scene(vec![ground.clone()], Vec3::new(sin, cos, 0.0) * 4.0);
        lit.camera = Camera { up: Vec3::Z, fov: 1e-3, ..lit.camera };
        let got = mean(&render(&lit, 4, 2));
        let expected = fresnel::conductor(cos, n, k);
        assert!((got / expected - Rgb::ONE).abs().max_element() < 1e-3, "{degrees}°: {got} {expected}");
    }
}

#[test]
fn what_a_mirror_shows_is_what_the_mirrored_camera_sees() {
    let ball =
        Affine3A::from_scale_rotation_translation(Vec3::splat(0.4), Quat::IDENTITY, Vec3::new(0.1, 0.7, 0.0));
    let mut seen = scene(vec![object(shapes::sphere(96, 48), ball, material(None, 0.6))], Vec3::ZERO);
    seen.background = Background::Colour(Rgb::ZERO);
    seen.environment = None;
    seen.lights = vec![Light::Directional {
        toward: Vec3::new(0.3, 0.2, 0.9).normalize(),
        irradiance: Rgb::new(3.0, 2.0, 1.0),
    }];
    let camera = |sign: f32| Camera {
        position: Vec3::new(0.0, -1.2 * sign, 3.0),
        target: Vec3::new(0.0, 0.7 * sign, 0.0),
        up: Vec3::Y * sign,
        fov: 0.5,
        width: 16,
        height: 16,
    };
    seen.camera = camera(1.0);
    let direct = render(&seen, 64, 2);
    let ground = Affine3A::from_scale(Vec3::splat(50.0));
    seen.objects.push(object(shapes::plane(1), ground, material(Some(mirror(0.5)), 0.0)));
    seen.camera = camera(-1.0);
    let image = render(&seen, 64, 2);
    let mut lit = 0;
    for y in 0..16 {
        for x in 0..16 {
            // A view with its up turned over is mirrored from left to right.
            let (a, b) = (direct.rgb(x, y) * 0.5, image.rgb(15 - x, y));
            assert!((a - b).abs().max_element() < 0.05, "{x} {y}: {a} {b}");
            lit += usize::from(a.x > 0.1);
        }
    }
    assert!(lit > 20, "{lit}");
    assert!((mean(&direct).x * 0.5 / mean(&image).x - 1.0).abs() < 0.01);
}

#[test]
fn a_body_within_one_of_higher_priority_is_not_there() {
    let outer = object(shapes::sphere(64, 32), Affine3A::IDENTITY, glass(1.5, 0.3));
    let small = Affine3A::from_scale(Vec3::splat(0.5));
    let mut with = scene(vec![outer], Vec3::new(0.5, 0.3, 4.0));
    with.environment = Some(Environment::studio());
    with.camera = Camera { fov: 0.5, width: 12, height: 12, ..with.camera };
    let without = render(&with, 64, 2);
    let low = Dielectric { index: 1.2, absorption: Rgb::splat(3.0), priority: -1 };
    with.objects.push(object(shapes::sphere(32, 16), small, material(Some(Optics::Dielectric(low)), 0.0)));
    let hidden = render(&with, 64, 2);
    let (a, b) = (mean(&without), mean(&hidden));
    assert!((a / b - Rgb::ONE).abs().max_element() < 2e-3, "{a} {b}");
    // Of the same index it only takes light away.
    let high = Dielectric { priority: 1, index: 1.5, ..low };
    with.objects[1].material.optics = Some(Optics::Dielectric(high));
    let there = mean(&render(&with, 64, 2));
    assert!(there.x < 0.97 * a.x, "{there} {a}");
}

/// Irradiance of a square of diffuse paint at the origin by its radiance toward a camera.
fn irradiance(lamps: Vec<Object>) -> Rgb {
    let ground = object(shapes::plane(1), Affine3A::from_scale(Vec3::splat(0.05)), material(None, 1.0));
    let mut lit = scene([vec![ground], lamps].concat(), Vec3::new(0.6, 0.5, 0.1));
    lit.environment = None;
    lit.background = Background::Colour(Rgb::ZERO);
    lit.camera.fov = 1e-3;
    mean(&render(&lit, 1024, 2)) / FRAC_1_PI
}

fn placed(scale: Vec3, turn: f32, at: Vec3) -> Affine3A {
    Affine3A::from_scale_rotation_translation(scale, Quat::from_rotation_x(turn), at)
}

#[test]
fn a_shining_rectangle_and_spheres_follow_their_form_factors() {
    let (height, a, b) = (0.7f32, 1.2f32, 0.6f32);
    let (x, y) = (a / 2.0 / height, b / 2.0 / height);
    let part = |x: f32, y: f32| x / (1.0 + x * x).sqrt() * (y / (1.0 + x * x).sqrt()).atan();
    let expected = 2.0 * (part(x, y) + part(y, x));
    for cells in [1, 8] {
        let above = placed(Vec3::new(a / 2.0, 1.0, b / 2.0), PI, Vec3::Y * height);
        let got = irradiance(vec![object(shapes::plane(cells), above, shining(Rgb::ONE))]);
        assert!(near(got, expected, 5e-3), "{cells} cells: {got} {expected}");
    }
    // From behind it does not shine.
    let away = placed(Vec3::splat(0.5), 0.0, Vec3::Y * height);
    assert_eq!(irradiance(vec![object(shapes::plane(1), away, shining(Rgb::ONE))]), Rgb::ZERO);
    // E = π L r² cosθ / d² of each of many balls.
    let (mut balls, mut expected) = (vec![], 0.0);
    for k in 0..40 {
        let angle = k as f32 * 2.4;
        let at = Vec3::new(angle.cos(), 1.0 + 0.05 * k as f32, angle.sin());
        let (radius, radiance) = (0.02 + 0.001 * k as f32, 1.0 + (k % 5) as f32);
        balls.push(object(
            shapes::sphere(24, 12),
            placed(Vec3::splat(radius), 0.0, at),
            shining(Rgb::splat(radiance)),
        ));
        expected += PI * radiance * radius * radius * at.y / at.length().powi(3);
    }
    // Of a mesh of 24 × 12 the silhouette is smaller than the circle.
    let got = irradiance(balls);
    assert!(got.x < expected && near(got, expected, 0.03), "{got} {expected}");
}

#[test]
fn a_texture_of_emission_shines_by_its_mean_and_is_seen_as_it_is() {
    let texels = [0.0f32, 4.0, 2.0, 0.0].map(Rgb::splat).to_vec();
    let texture = Texture::Texels(2, 2, texels.into());
    let lamp = Material { emission: Some(texture), ..material(None, 0.0) };
    let far = placed(Vec3::new(0.2, 1.0, 0.2), PI, Vec3::Y * 3.0);
    let got = irradiance(vec![object(shapes::plane(3), far, lamp.clone())]);
    assert!(near(got, 1.5 * 0.16 / 9.0, 0.02), "{got}");
    let mut seen = scene(vec![object(shapes::plane(1), Affine3A::IDENTITY, lamp)], Vec3::Y * 3.0);
    // The middle of the texel at x > 0, v < 0.5.
    seen.camera =
        Camera { position: Vec3::new(0.5, 3.0, -0.5), target: Vec3::new(0.5, 0.0, -0.5), ..seen.camera };
    seen.camera.fov = 1e-4;
    assert!(near(mean(&render(&seen, 4, 2)), 4.0, 1e-2));
}

#[test]
fn both_rays_of_glass_or_one_by_chance_make_the_same_picture() {
    let mut lit = scene(
        vec![
            object(shapes::sphere(64, 32), placed(Vec3::splat(0.5), 0.0, Vec3::Y * 0.6), glass(1.5, 0.5)),
            object(shapes::plane(1), Affine3A::from_scale(Vec3::splat(3.0)), material(None, 0.5)),
        ],
        Vec3::new(0.3, 1.5, 3.0),
    );
    lit.environment = Some(Environment::studio());
    lit.camera = Camera { up: Vec3::Y, fov: 0.6, width: 12, height: 12, ..lit.camera };
    let [one, two, many] = [0, 1, 5].map(|tree| mean(&render(&lit, 1024, tree)));
    for other in [two, many] {
        assert!((one / other - Rgb::ONE).abs().max_element() < 0.01, "{one} {other}");
    }
}

#[test]
fn light_that_no_path_finds_is_named() {
    let mut lit =
        scene(vec![object(shapes::sphere(16, 8), Affine3A::IDENTITY, glass(1.5, 0.0))], Vec3::Z * 4.0);
    let note = |scene: &Scene| {
        let settings = Settings { samples: 1, ..Settings::default() };
        settings.render(scene, &scene.camera).unwrap().note
    };
    lit.camera.up = Vec3::Y;
    assert_eq!(note(&lit), None);
    lit.lights.push(Light::Point { position: Vec3::Y * 3.0, intensity: Rgb::ONE });
    let text = note(&lit).unwrap();
    assert!(text.contains("light 0") && text.contains("\"object\"") && text.contains("dielectric"), "{text}");
}

/// The square of a view's relative error, the emitters chosen by the tree or by their power alone.
fn noise(scene: &Scene, by_power: bool) -> f64 {
    let settings = Settings { samples: 64, seed: 1, ..Settings::default() };
    let mut tracer = Tracer::new(scene, settings.bounces, settings.tree);
    if by_power {
        tracer.emitters = std::mem::take(&mut tracer.emitters).by_power();
    }
    let ready = Ready { tracer, settings, prepare_seconds: 0.0, quiet: true };
    ready.view_by(&scene.camera, &|| 0.0).unwrap().estimated_error().unwrap().powi(2)
}

#[test]
fn emitters_chosen_by_place_too_make_less_noise_than_by_power_alone() {
    // A thousand small ones over a wide floor, of which few light a place.
    let mut lamps = Mesh::default();
    let ball = shapes::sphere(8, 4);
    for k in 0..1000 {
        let [x, z] = [0.754_877_7, 0.569_840_3].map(|step: f32| 20.0 * (step * k as f32).fract() - 10.0);
        let ball = ball.transformed(&placed(Vec3::splat(0.02), 0.0, Vec3::new(x, 0.8, z)));
        let first = lamps.vertices.len() as u32;
        lamps.vertices.extend(ball.vertices);
        lamps.triangles.extend(ball.triangles.iter().map(|triangle| triangle.map(|i| i + first)));
    }
    let lamps = object(lamps, Affine3A::IDENTITY, shining(Rgb::splat(100.0)));
    let floor = object(shapes::plane(1), Affine3A::from_scale(Vec3::splat(10.0)), material(None, 0.5));
    let mut lit = scene(vec![floor, lamps], Vec3::new(0.3, 0.25, 0.05));
    (lit.environment, lit.background) = (None, Background::Colour(Rgb::ZERO));
    lit.camera = Camera { fov: 0.1, width: 16, height: 16, ..lit.camera };
    let [tree, power] = [false, true].map(|by_power| noise(&lit, by_power));
    assert!(tree < 0.1 * power, "{tree} {power}");
}
