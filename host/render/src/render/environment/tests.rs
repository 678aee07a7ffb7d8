//! Oracles: quadrature of the reflectance equation, white light, and the two encodings beside each other.

use std::f32::consts::{PI, TAU};

use glam::Vec3;

use super::quadrature::{DIRECTIONS, MAP_EXPONENTS};
use super::*;
use crate::render::{extended_check, plain_check};
use crate::scene::{Environment, Material};
use lobelia_reflectance::{Brdf, Lobe, LobeBrdf, Microfacet, SbrdfMap};

/// Radiance reflected by a BRDF on a surface that faces +y, by quadrature; sample frame x = +x, y = −z, z
/// = +y.
fn quadrature(environment: &Environment, brdf: &LobeBrdf, view: Vec3) -> Rgb {
    let local = |d: Vec3| Vec3::new(d.x, -d.z, d.y);
    let (columns, rows) = (240, 120);
    let mut sum = glam::DVec3::ZERO;
    for i in 0..rows {
        let y = (i as f32 + 0.5) / rows as f32;
        let radius = (1.0 - y * y).sqrt();
        for j in 0..columns {
            let (sin, cos) = ((j as f32 + 0.5) / columns as f32 * TAU).sin_cos();
            let wi = Vec3::new(radius * cos, y, radius * sin);
            sum += (brdf.eval(local(wi), local(view)) * environment.radiance(wi) * y).as_dvec3();
        }
    }
    (sum * std::f64::consts::TAU / f64::from(columns * rows)).as_vec3()
}

fn phong(n: f32) -> LobeBrdf {
    let lobe = Lobe::new(Rgb::splat((n + 2.0) / TAU), Vec3::new(-1.0, -1.0, 1.0), n);
    LobeBrdf { lobes: vec![lobe], ..LobeBrdf::default() }
}

/// What the method gives on a plane that faces +y.
fn approximation(light: &Light, brdf: &LobeBrdf, view: Vec3) -> Rgb {
    let mut scene = crate::scene::showcase::published(4, 4);
    scene.objects.truncate(1);
    scene.objects[0].material = crate::scene::Material::uniform(brdf.clone());
    let materials = Materials::new(&scene);
    let surface = Surface {
        position: Vec3::ZERO,
        shadow_origin: Vec3::ZERO,
        geometric: Vec3::Y,
        frame: [Vec3::X, Vec3::NEG_Z, Vec3::Y],
        uv: glam::Vec2::ZERO,
        object: 0,
        offset: 0.0,
    };
    let mut shader = Shader::new();
    shader.aim(&materials, 0, surface.to_local(view), false);
    light.reflected(&surface, &shader)
}

/// Light for lobes of `low` to `high`, with what the horizon's correction needs beyond.
fn light(environment: &Environment, (low, high): (f32, f32), encoding: Encoding, horizon: bool) -> Light {
    let range = (low, if horizon { high.max(horizon::widest_clipped(high)) } else { high });
    Light {
        maps: Prefiltered::on_cpu(environment, range, encoding, 0.03).unwrap(),
        harmonics: None,
        horizon: horizon.then(Horizon::table),
        coats: Some(Coats::table()),
    }
}

fn view(theta_deg: f32) -> Vec3 {
    let (sin, cos) = theta_deg.to_radians().sin_cos();
    Vec3::new(-sin, cos, 0.0)
}

#[test]
fn white_light_is_reflected_as_quadrature_has_it_at_every_angle() {
    let white = Environment::from_function(64, 32, |_| Rgb::ONE);
    for n in [1.0, 8.0, 60.0] {
        let light = light(&white, (n, n), Encoding::Slices, true);
        for theta in [0.0, 45.0, 75.0, 85.0] {
            let (expected, got) =
                (quadrature(&white, &phong(n), view(theta)), approximation(&light, &phong(n), view(theta)));
            assert!((got.x / expected.x - 1.0).abs() < 0.015, "{n} {theta}: {got} {expected}");
        }
    }
}

#[test]
fn the_horizon_correction_lowers_the_error_of_wide_lobes() {
    // Two lamps, one low, in a dim room over a dark floor.
    let lamp = |d: Vec3, at: Vec3| 8.0 * (40.0 * (d.dot(at.normalize()) - 1.0)).exp();
    let studio = Environment::from_function(64, 32, |d| {
        let lamps = lamp(d, Vec3::new(0.9, 0.15, 0.2)) + lamp(d, Vec3::new(0.2, 0.9, -0.5));
        Rgb::splat(if d.y > 0.0 { 0.3 } else { 0.1 } + lamps)
    });
    let error = |n: f32, horizon: bool| {
        let light = light(&studio, (n, n), Encoding::Slices, horizon);
        let squares = [0.0f32, 30.0, 60.0, 75.0, 85.0].map(|theta| {
            let expected = quadrature(&studio, &phong(n), view(theta));
            (approximation(&light, &phong(n), view(theta)) / expected - Rgb::ONE).length_squared()
        });
        (squares.iter().sum::<f32>() / squares.len() as f32).sqrt()
    };
    for n in [1.0, 4.0, 16.0] {
        let (on, off) = (error(n, true), error(n, false));
        println!("n = {n}: relative error {on:.3} with the correction, {off:.3} without");
        assert!(on < off, "{n}: {on} {off}");
    }
}

#[test]
fn both_encodings_agree_and_the_diffuse_term_equals_quadrature() {
    let sky = Environment::from_function(64, 32, |d| {
        Rgb::new(0.5 + 0.4 * d.x, 0.3 + 0.2 * d.y, 0.2 + (6.0 * (d.z - 1.0)).exp())
    });
    let [slices, mips] =
        [Encoding::Slices, Encoding::Mips].map(|encoding| light(&sky, (1.0, 30.0), encoding, true));
    for n in [1.5, 7.0, 25.0] {
        let [a, b] = [&slices, &mips].map(|light| approximation(light, &phong(n), view(40.0)));
        assert!((a / b - Rgb::ONE).abs().max_element() < 0.03, "{n}: {a} {b}");
    }
    let matt = LobeBrdf::diffuse(Rgb::ONE);
    let (expected, got) = (quadrature(&sky, &matt, Vec3::Y), approximation(&slices, &matt, Vec3::Y));
    assert!((got / expected - Rgb::ONE).abs().max_element() < 5e-3, "{got} {expected}");
    let nine = Harmonics::new(&sky).irradiance(Vec3::Y) / PI;
    // Published for nine coefficients: 9 % of the brightest at most.
    assert!((nine / expected - Rgb::ONE).abs().max_element() < 0.09, "{nine} {expected}");
}

/// The showcase's ball alone under a sky.
fn ball(material: Material) -> Scene {
    let mut scene = crate::scene::showcase::published(32, 24);
    scene.lights.clear();
    scene.objects.retain(|object| object.name == "ball");
    scene.objects[0].material = material;
    scene.environment = Some(Environment::from_function(64, 32, |d| {
        Rgb::new(0.6 + 0.4 * d.x, 0.5, 0.4 + (8.0 * (d.y - 1.0)).exp())
    }));
    scene
}

#[test]
fn normals_and_sharpening_are_those_of_the_reference_where_nothing_is_shadowed() {
    let lamp = Vec3::new(0.3, 0.8, 0.5).normalize();
    let sky =
        Environment::from_function(64, 32, |d| Rgb::splat(0.3 + 6.0 * (20.0 * (d.dot(lamp) - 1.0)).exp()));
    let with = |map: SbrdfMap| Scene {
        environment: Some(sky.clone()),
        ..ball(Material::map(map.into(), glam::Vec2::new(4.0, 2.0)))
    };
    let scene = with(extended_check());
    let truth = super::super::reference::Settings { samples: 256, ..Default::default() };
    let truth = truth.render(&scene, &scene.camera).unwrap().picture;
    let error = |map| {
        let picture = Settings::default().render(&with(map), &scene.camera).unwrap().picture;
        super::super::compare::compare(&picture, &truth).unwrap().relative_rmse
    };
    let [extended, plain] = [extended_check(), plain_check()].map(error);
    println!("relative RMSE against the reference: {extended}, without normals and sharpening {plain}");
    assert!(extended < 0.05 && plain > 2.0 * extended, "{extended} {plain}");
}

#[test]
fn a_picture_is_close_to_the_reference_where_nothing_is_shadowed() {
    let scene = ball(Material::uniform(phong(20.0)));
    let rendering = Settings::default().render(&scene, &scene.camera).unwrap();
    let truth = super::super::reference::Settings { samples: 256, ..Default::default() };
    let truth = truth.render(&scene, &scene.camera).unwrap();
    let errors = super::super::compare::compare(&rendering.picture, &truth.picture).unwrap();
    assert!(errors.relative_rmse < 0.1, "{errors:?}");
    assert!(rendering.cost.memory_bytes > 0 && rendering.cost.rays == 32 * 24 * 16);
}

#[test]
#[ignore = "long: cargo xtask long"]
fn prefiltering_stays_within_one_percent_of_quadrature_on_every_environment() {
    let mut all = vec![
        ("studio".to_string(), Environment::studio()),
        ("sky".to_string(), Environment::sky()),
        ("sun of 1e5".to_string(), prefilter::tests::sun(128)),
    ];
    // Others that are at hand: a folder of .exr and .hdr files.
    if let Some(folder) = std::env::var_os("LOBELIA_ENVIRONMENTS") {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            all.push((path.display().to_string(), Environment::read(&path).unwrap()));
        }
    }
    for (name, environment) in all {
        let maps = Prefiltered::on_cpu(&environment, (1.0, 1000.0), Encoding::Slices, 0.01).unwrap();
        println!("{name}: {} maps, {} bytes", maps.exponents().count(), maps.bytes());
        for n in MAP_EXPONENTS {
            let error = quadrature::Truth::new(&environment, n, DIRECTIONS).error(&maps);
            println!("  n = {n}: RMS {:.2} %, largest {:.1} %", 100.0 * error.rms, 100.0 * error.largest);
            assert!(error.rms < 0.01, "{name}, n = {n}: {error:?}");
        }
    }
}

#[test]
fn microfacet_terms_reflect_as_quadrature_has_it() {
    let lamp = |d: Vec3, at: Vec3| 8.0 * (40.0 * (d.dot(at.normalize()) - 1.0)).exp();
    let studio = Environment::from_function(64, 32, |d| {
        let lamps = lamp(d, Vec3::new(0.9, 0.5, 0.2)) + lamp(d, Vec3::new(0.2, 0.9, -0.5));
        Rgb::splat(if d.y > 0.0 { 0.3 } else { 0.1 } + lamps)
    });
    let white = Environment::from_function(64, 32, |_| Rgb::ONE);
    for alpha in [0.2, 0.6] {
        let coat = Microfacet { f0: Rgb::splat(0.04), f90: Rgb::ONE, alpha };
        let brdf = LobeBrdf { microfacets: vec![coat], ..LobeBrdf::default() };
        let [low, high] = Coats::table().exponents(alpha);
        let errors = |environment: &Environment| {
            let light = light(environment, (low, high), Encoding::Slices, true);
            [0.0f32, 30.0, 60.0, 75.0].map(|theta| {
                let expected = quadrature(environment, &brdf, view(theta)).x;
                approximation(&light, &brdf, view(theta)).x / expected - 1.0
            })
        };
        let rms = |errors: [f32; 4]| (errors.map(|e| e * e).iter().sum::<f32>() / 4.0).sqrt();
        let (even, lamps) = (errors(&white), errors(&studio));
        println!("alpha {alpha}: even light {even:.3?}, lamps {lamps:.3?}, RMS {:.3}", rms(lamps));
        assert!(rms(even) < 0.02 && rms(lamps) < 0.2, "{alpha}: {even:?} {lamps:?}");
    }
}
