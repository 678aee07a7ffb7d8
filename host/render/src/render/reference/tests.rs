//! Oracles: closed forms, the furnace, quadrature, and independence of threads.

use std::f32::consts::{FRAC_1_PI, PI, TAU};
use std::sync::Arc;

use glam::{Affine3A, Vec3};

use super::*;
use crate::scene::{Background, Camera, Environment, Light, Material, Mesh, Object, shapes};
use lobelia_reflectance::{Brdf, Lobe, LobeBrdf, Rgb, materials};

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
        animation: None,
        parameters: vec![],
        exposure: 1.0,
    }
}

fn phong(n: f32) -> LobeBrdf {
    let lobe = Lobe::new(Rgb::new(0.4, 0.3, 0.2), Vec3::new(-1.0, -1.0, 1.0), n);
    LobeBrdf { rho_d: Rgb::splat(0.05), beta: 0.0, lobes: vec![lobe], ..LobeBrdf::default() }
}

fn render_with(scene: &Scene, samples: u32) -> Picture {
    Settings { samples, seed: 3, ..Settings::default() }.render(scene, &scene.camera).unwrap().picture
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
    let retro = Lobe::new(Rgb::splat(0.2), Vec3::new(0.8, 0.6, 0.9), 8.0);
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
fn light_inside_a_closed_sphere_grows_by_the_geometric_series() {
    // A lamp of intensity I in the middle of a diffuse sphere of radius 1: every point gets I and all that
    // comes back, L = ρ/π · I / (1 − ρ).
    let albedo = Rgb::new(0.2, 0.5, 0.8);
    let mut inside = scene(shapes::sphere(128, 64), LobeBrdf::diffuse(albedo), Vec3::new(0.3, 0.2, 0.1));
    inside.lights.push(Light::Point { position: Vec3::ZERO, intensity: Rgb::ONE });
    inside.camera = Camera { target: Vec3::new(1.0, 0.4, -0.3), up: Vec3::Y, fov: 1.5, ..inside.camera };
    let expected = albedo * FRAC_1_PI / (Rgb::ONE - albedo);
    let got = mean(&render_with(&inside, 1024)).truncate();
    assert!((got / expected - Rgb::ONE).abs().max_element() < 0.01, "{got} {expected}");
}

/// A rectangle `height` above the plane, `a` by `b`, shining down.
fn ceiling(height: f32, a: f32, b: f32) -> Light {
    Light::Rectangle {
        centre: Vec3::Y * height,
        edges: [Vec3::X * a, Vec3::Z * b],
        radiance: Rgb::new(3.0, 2.0, 1.0),
    }
}

#[test]
fn a_rectangular_light_over_a_diffuse_plane_follows_the_form_factor() {
    let albedo = Rgb::new(0.8, 0.5, 0.2);
    let mut lit = scene(shapes::plane(1), LobeBrdf::diffuse(albedo), Vec3::new(4.0, 3.0, 0.3));
    lit.camera.fov = 1e-3;
    let (height, a, b) = (0.7f32, 1.2f32, 0.6f32);
    lit.lights.push(ceiling(height, a, b));
    // Four quarters, each seen from the foot of its corner.
    let (x, y) = (a / 2.0 / height, b / 2.0 / height);
    let part = |x: f32, y: f32| x / (1.0 + x * x).sqrt() * (y / (1.0 + x * x).sqrt()).atan();
    let factor = 4.0 / TAU * (part(x, y) + part(y, x));
    let expected = albedo * Rgb::new(3.0, 2.0, 1.0) * factor;
    let got = mean(&render_with(&lit, 64)).truncate();
    assert!((got / expected - Rgb::ONE).abs().max_element() < 2e-3, "{got} {expected}");
}

#[test]
fn a_rectangular_light_in_a_lobe_equals_quadrature() {
    let (height, a, b) = (0.7f32, 0.9f32, 0.6f32);
    for n in [4.0, 60.0, 900.0] {
        let view = Vec3::new(-0.5, 0.8, -0.1).normalize();
        let mut lit = scene(shapes::plane(1), phong(n), view * 4.0);
        lit.camera.fov = 1e-3;
        // Beside the line of sight.
        let radiance = Rgb::new(3.0, 2.0, 1.0);
        let centre = Vec3::new(0.6, height, 0.1);
        lit.lights.push(Light::Rectangle { centre, edges: [Vec3::X * a, Vec3::Z * b], radiance });
        let local = |d: Vec3| Vec3::new(d.x, -d.z, d.y);
        let cells = 512;
        let at = |i: i32| (i as f32 + 0.5) / cells as f32 - 0.5;
        let mut expected = glam::DVec3::ZERO;
        for (i, j) in (0..cells).flat_map(|i| (0..cells).map(move |j| (i, j))) {
            let to = centre + Vec3::new(at(i) * a, 0.0, at(j) * b);
            let wi = to.normalize();
            let f = phong(n).eval(local(wi), local(view));
            expected += (f * radiance * (wi.y * wi.y / to.length_squared())).as_dvec3();
        }
        let expected = (expected * f64::from(a * b) / f64::from(cells * cells)).as_vec3();
        let got = mean(&render_with(&lit, 1024)).truncate();
        assert!((got / expected - Rgb::ONE).abs().max_element() < 0.01, "{n}: {got} {expected}");
    }
}

#[test]
fn a_rectangular_light_is_seen_from_its_front_is_black_behind_and_casts_a_shadow() {
    let mut lit = scene(shapes::plane(1), LobeBrdf::diffuse(Rgb::ONE), Vec3::new(0.0, 1.0, 0.0));
    lit.lights.push(ceiling(2.0, 1.0, 1.0));
    lit.camera.target = Vec3::Y * 2.0;
    assert_eq!(render_with(&lit, 4).rgb(2, 2), Rgb::new(3.0, 2.0, 1.0));
    lit.camera.position.y = 3.0;
    assert_eq!(render_with(&lit, 4).rgb(2, 2), Rgb::ZERO);
    lit.camera = Camera { position: Vec3::new(3.0, 1.0, 0.0), target: Vec3::ZERO, ..lit.camera };
    let alone = render_with(&lit, 8).rgb(2, 2);
    lit.lights.push(Light::Directional { toward: Vec3::Y, irradiance: Rgb::ONE });
    assert_eq!(render_with(&lit, 8).rgb(2, 2), alone);
}

#[test]
fn light_and_viewer_can_change_places() {
    let (a, b) = (Vec3::new(0.6, 0.7, 0.2).normalize(), Vec3::new(-0.3, 0.4, 0.5).normalize());
    let mut brdf = phong(12.0);
    brdf.beta = 0.4;
    brdf.lobes[0].c = Vec3::new(-1.1, -0.6, 0.8);
    let reflectance = |toward: Vec3, view: Vec3| {
        let mut lit = scene(shapes::plane(1), brdf.clone(), view * 5.0);
        lit.camera.fov = 1e-4;
        lit.lights.push(Light::Directional { toward, irradiance: Rgb::ONE });
        render_with(&lit, 1).rgb(2, 2) / toward.y
    };
    let (forth, back) = (reflectance(a, b), reflectance(b, a));
    assert!((forth / back - Rgb::ONE).abs().max_element() < 1e-4, "{forth} {back}");
}

#[test]
fn no_published_material_that_keeps_energy_outshines_a_white_furnace() {
    for name in ["clay", "felt", "primer"] {
        let mut furnace = scene(shapes::sphere(48, 24), materials::published(name).unwrap(), Vec3::Z * 4.0);
        furnace.environment = Some(Environment::uniform(Rgb::ONE));
        furnace.camera = Camera { up: Vec3::Y, fov: 0.4, width: 8, height: 8, ..furnace.camera };
        let brightest =
            render_with(&furnace, 256).pixels.iter().map(|p| p.truncate().max_element()).fold(0.0, f32::max);
        assert!(brightest < 1.03 && brightest > 0.02, "{name}: {brightest}");
    }
}

#[test]
fn triangles_of_either_winding_give_the_same_picture() {
    let mut right = scene(shapes::sphere(24, 12), phong(20.0), Vec3::new(1.0, 0.5, 4.0));
    right.environment = Some(Environment::uniform(Rgb::ONE));
    right.camera = Camera { fov: 0.6, width: 16, height: 16, ..right.camera };
    let mut turned = right.clone();
    let mut mesh = shapes::sphere(24, 12);
    mesh.triangles.iter_mut().step_by(3).for_each(|triangle| triangle.swap(1, 2));
    turned.objects[0].mesh = Arc::new(mesh);
    let (a, b) = (render_with(&right, 4), render_with(&turned, 4));
    let differing =
        a.pixels.iter().zip(&b.pixels).filter(|(a, b)| (*a - *b).abs().max_element() > 1e-3).count();
    assert!(differing <= 2, "{differing} pixels differ");
}

#[test]
fn the_variance_bounds_the_error_and_max_error_is_met() {
    let scene = crate::scene::showcase::published(24, 18);
    let settings = Settings { max_error: Some(0.06), samples: 4096, ..Settings::default() };
    let rendering = settings.render(&scene, &scene.camera).unwrap();
    let (estimated, samples) = (rendering.estimated_error().unwrap(), rendering.cost.samples);
    assert!(estimated <= 0.06 && samples < 4096, "{estimated} after {samples} samples");
    let truth =
        Settings { samples: 512, seed: 99, ..Settings::default() }.render(&scene, &scene.camera).unwrap();
    let actual = compare::compare(&rendering.picture, &truth.picture).unwrap().relative_rmse;
    assert!(actual > estimated / 3.0 && actual < estimated * 1.2, "{actual} {estimated}");
}

#[test]
fn a_budget_of_time_ends_the_rendering() {
    let scene = crate::scene::showcase::published(16, 12);
    let settings = Settings { seconds: Some(1e-3), samples: 1 << 20, ..Settings::default() };
    let rendering = settings.render(&scene, &scene.camera).unwrap();
    assert!(rendering.cost.samples <= LEAST_PASSES * BUDGET_PASS);
    assert!(rendering.picture.pixels.iter().all(|pixel| pixel.is_finite()));
}

/// By a clock that goes on by 10 ms whenever it is looked at: twelve times a pass, once a row.
#[test]
fn a_pass_whose_time_runs_out_is_dropped_and_leaves_the_picture_of_those_before() {
    let scene = crate::scene::showcase::published(16, 12);
    let ready = |settings: Settings| Ready {
        tracer: Tracer::new(&scene, settings.bounces, settings.tree),
        settings,
        prepare_seconds: 0.0,
        quiet: false,
    };
    let looks = std::sync::atomic::AtomicU32::new(0);
    let clock = || f64::from(looks.fetch_add(1, std::sync::atomic::Ordering::Relaxed)) * 0.01;
    let settings = Settings { seconds: Some(0.9), samples: 1 << 20, ..Settings::default() };
    let within = ready(settings).view_by(&scene.camera, &clock).unwrap();
    let samples = within.cost.samples;
    assert!((4..8).contains(&samples), "{samples}");
    // The rows that were still to come looked at the clock once more.
    assert!(within.cost.render_seconds < 0.9 + 0.2, "{}", within.cost.render_seconds);
    let whole = Settings { samples, ..Settings::default() }.render(&scene, &scene.camera).unwrap();
    assert_eq!(within.picture, whole.picture);
}

#[test]
fn the_picture_does_not_depend_on_the_number_of_threads_but_on_the_seed() {
    let scene = crate::scene::showcase::published(24, 18);
    let with_threads = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let settings = Settings { samples: 16, seed, ..Settings::default() };
        pool.install(|| settings.render(&scene, &scene.camera).unwrap().picture)
    };
    let one = with_threads(1, 7);
    assert_eq!(one, with_threads(3, 7));
    assert_ne!(one, with_threads(1, 8));
    assert!(one.pixels.iter().all(|pixel| pixel.is_finite()));
}

#[test]
fn many_views_at_once_are_those_of_one_after_another() {
    let scene = crate::scene::showcase::published(12, 9);
    let settings = Settings { samples: 4, seed: 2, ..Settings::default() };
    let aside = |k: u32| Camera { position: scene.camera.position + Vec3::X * k as f32, ..scene.camera };
    let cameras: Vec<Camera> = (0..5).map(aside).collect();
    let views = settings.views(&scene, &cameras).unwrap();
    for (camera, view) in cameras.iter().zip(views) {
        assert_eq!(view.picture, settings.render(&scene, camera).unwrap().picture);
    }
}

#[test]
fn no_samples_and_broken_scenes_are_refused() {
    let mut broken = scene(shapes::plane(1), LobeBrdf::default(), Vec3::Y);
    let refused = |scene: &Scene, settings: Settings| settings.render(scene, &scene.camera).unwrap_err();
    assert_eq!(refused(&broken, Settings { samples: 0, ..Settings::default() }).exit_code(), 2);
    assert_eq!(refused(&broken, Settings { seconds: Some(f64::NAN), ..Settings::default() }).exit_code(), 2);
    broken.camera.width = 0;
    assert_eq!(refused(&broken, Settings::default()).exit_code(), 2);
}
