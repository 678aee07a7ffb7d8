//! Ready-made scenes around a material: what the demo and the README show.

use std::sync::Arc;

use glam::{Affine3A, Vec2, Vec3};

use super::{Background, Camera, Environment, Light, Material, Object, Scene, shapes};
use lobelia_reflectance::{Lobe, LobeBrdf, Rgb, SbrdfMap, materials};

/// A material on a draped cloth, another on a sphere before it, in the studio with two lights more.
pub fn showcase(cloth: Material, ball: Material, width: u32, height: u32) -> Scene {
    let place = |scale: f32, translate: Vec3, turn: f32, tilt: f32| {
        let rotation = glam::Quat::from_rotation_x(tilt) * glam::Quat::from_rotation_y(turn);
        Affine3A::from_scale_rotation_translation(Vec3::splat(scale), rotation, translate)
    };
    let object = |name: &str, mesh, transform, material| Object {
        name: name.to_string(),
        mesh: Arc::new(mesh),
        transform,
        material,
    };
    let backdrop = Material::uniform(LobeBrdf::diffuse(Rgb::new(0.115, 0.12, 0.13)));
    Scene {
        objects: vec![
            object("cloth", shapes::drape(224), place(1.0, Vec3::new(-0.30, 0.0, -0.1), 0.62, 0.0), cloth),
            object(
                "ball",
                shapes::sphere(192, 96),
                place(0.34, Vec3::new(0.98, 0.34, 0.66), 0.4, -0.5),
                ball,
            ),
            object(
                "backdrop",
                shapes::backdrop(24),
                place(6.0, Vec3::new(0.0, 0.0, 2.6), 0.0, 0.0),
                backdrop,
            ),
        ],
        lights: vec![
            Light::Directional {
                toward: Vec3::new(0.55, 0.75, 0.55).normalize(),
                irradiance: Rgb::new(1.0, 0.94, 0.85) * 1.6,
            },
            Light::Point { position: Vec3::new(-2.6, 2.2, 1.4), intensity: Rgb::new(0.75, 0.85, 1.0) * 5.0 },
        ],
        environment: Some(Environment::studio()),
        background: Background::Environment,
        camera: Camera {
            position: Vec3::new(0.45, 1.75, 4.4),
            target: Vec3::new(0.15, 0.52, 0.0),
            up: Vec3::Y,
            fov: 26f32.to_radians(),
            width,
            height,
        },
        animation: None,
        parameters: vec![],
        exposure: 0.85,
    }
}

/// A plain weave of two published materials: warp threads of one, weft of the other, rounded by a lighter
/// middle.
pub fn weave(warp: &LobeBrdf, weft: &LobeBrdf, thread: usize) -> SbrdfMap {
    let side = 2 * thread;
    let texel = |index: usize| {
        let (x, y) = (index % side, index / side);
        let over = (x / thread + y / thread).is_multiple_of(2);
        let across = if over { x % thread } else { y % thread };
        let offset = (across as f32 + 0.5) / thread as f32 * 2.0 - 1.0;
        // Threads darken toward their edges, where they dip below their neighbours.
        dimmed(if over { warp } else { weft }, 1.0 - 0.55 * offset.powi(4))
    };
    SbrdfMap::from_texels(side, side, &(0..side * side).map(texel).collect::<Vec<_>>())
}

/// The same BRDF with its reflectance scaled.
fn dimmed(brdf: &LobeBrdf, factor: f32) -> LobeBrdf {
    let scale = |lobe: &Lobe| Lobe { rho_s: lobe.rho_s * factor, ..*lobe };
    LobeBrdf {
        rho_d: brdf.rho_d * factor,
        beta: brdf.beta,
        lobes: brdf.lobes.iter().map(scale).collect(),
        ..LobeBrdf::default()
    }
}

/// A check of two BRDFs, `cells` × `cells` over the map.
pub fn check(first: &LobeBrdf, second: &LobeBrdf, cells: usize, texels_a_cell: usize) -> SbrdfMap {
    let side = cells * texels_a_cell;
    let texel = |index: usize| {
        let (x, y) = (index % side / texels_a_cell, index / side / texels_a_cell);
        if (x + y).is_multiple_of(2) { first.clone() } else { second.clone() }
    };
    SbrdfMap::from_texels(side, side, &(0..side * side).map(texel).collect::<Vec<_>>())
}

/// [`showcase`] of published materials: cloth woven of blue paint and dimmed metal, a ball checked in clay
/// and felt.
pub fn published(width: u32, height: u32) -> Scene {
    let named = |name: &str| materials::published(name).unwrap_or_default();
    let silver = dimmed(&named("brushed-metal"), 0.45);
    let cloth = weave(&named("blue-paint"), &silver, 16);
    let ball = check(&named("clay"), &named("felt"), 2, 32);
    showcase(
        Material::map(Arc::new(cloth), Vec2::splat(24.0)),
        Material::map(Arc::new(ball), Vec2::new(10.0, 5.0)),
        width,
        height,
    )
}
