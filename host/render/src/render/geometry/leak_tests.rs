//! Rays that leave surfaces of closed meshes: none that goes outwards meets the mesh again, and none that
//! goes inwards gets out.

use std::sync::Arc;

use glam::{Affine3A, Quat, Vec3};

use super::Geometry;
use crate::render::sampler::hash;
use crate::scene::shapes::solids;
use crate::scene::{Material, Mesh, Object, Scene, shapes, showcase};
use lobelia_reflectance::{LobeBrdf, Rgb};

/// What was counted of so many rays.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Faults {
    rays: u32,
    /// Of rays outwards, those that met the mesh that they left.
    shadowed: u32,
    /// Of paths inside, those that got out; of rays at the mesh from afar, those that passed through it.
    leaked: u32,
}

fn unit(seed: &mut u32) -> f32 {
    *seed = seed.wrapping_add(1);
    hash(*seed) as f32 / u32::MAX as f32
}

fn on_sphere(seed: &mut u32) -> Vec3 {
    let (z, azimuth) = (2.0 * unit(seed) - 1.0, std::f32::consts::TAU * unit(seed));
    let radius = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(radius * azimuth.cos(), radius * azimuth.sin(), z)
}

/// A direction on the side of a normal, at least `least` above the surface.
fn leaving(normal: Vec3, least: f32, seed: &mut u32) -> Vec3 {
    loop {
        let direction = on_sphere(seed);
        let direction = if direction.dot(normal) < 0.0 { -direction } else { direction };
        // Every third is flattened to the surface.
        let lift = if seed.is_multiple_of(3) { 0.01 } else { 1.0 };
        let cosine = direction.dot(normal);
        let direction = (direction - normal * (cosine * (1.0 - lift))).normalize_or_zero();
        if direction.dot(normal) > least {
            return direction;
        }
    }
}

fn scene(meshes: Vec<(Mesh, Affine3A)>) -> Scene {
    let mut scene = showcase::published(8, 8);
    scene.lights.clear();
    scene.objects = meshes
        .into_iter()
        .map(|(mesh, transform)| Object {
            name: String::new(),
            mesh: Arc::new(mesh),
            transform,
            material: Material::uniform(LobeBrdf::diffuse(Rgb::ONE)),
        })
        .collect();
    scene
}

/// Counts faults of a convex mesh of about size 1 about its own origin, first of the scene; `half` are half
/// the sides of a box within it.
fn faults(geometry: &Geometry, transform: &Affine3A, half: Vec3, least: f32) -> Faults {
    let mut faults = Faults::default();
    let seed = &mut 1;
    let inside = |seed: &mut u32| {
        let place = Vec3::new(unit(seed), unit(seed), unit(seed)) * 2.0 - 1.0;
        transform.transform_point3(place * half)
    };
    for _ in 0..3000 {
        let origin = transform.transform_point3(on_sphere(seed) * 3.0);
        let direction = (inside(seed) - origin).normalize();
        faults.rays += 1;
        let Some(hit) = geometry.nearest(origin, direction) else {
            faults.leaked += 1;
            continue;
        };
        if geometry.object(&hit) == 0 {
            let surface = geometry.surface(&hit, direction);
            for _ in 0..8 {
                let direction = leaving(surface.geometric, least, seed);
                faults.rays += 1;
                // What else is in the scene lies farther away.
                let reach = 2.0 * transform.transform_vector3(Vec3::X).length();
                faults.shadowed += u32::from(geometry.occluded(&surface, direction, reach));
            }
        }
        let (mut origin, mut direction) = (inside(seed), on_sphere(seed));
        for _ in 0..8 {
            faults.rays += 1;
            let Some(hit) = geometry.nearest(origin, direction).filter(|hit| geometry.object(hit) == 0)
            else {
                faults.leaked += 1;
                break;
            };
            let surface = geometry.surface(&hit, direction);
            (origin, direction) = (geometry.leaving(&surface), leaving(surface.geometric, 0.0, seed));
        }
    }
    faults
}

#[test]
fn closed_meshes_neither_shadow_themselves_nor_leak_whatever_their_size_and_place() {
    let shapes: [(&str, Mesh, Vec3); 3] = [
        ("ball", solids::ball(1.0, 1e-3).unwrap(), Vec3::splat(0.5)),
        ("box", solids::cuboid([2.0, 2.0, 2.0]).unwrap(), Vec3::splat(0.9)),
        ("sheet", solids::cuboid([2.0, 1e-5, 2.0]).unwrap(), Vec3::new(0.9, 4e-6, 0.9)),
    ];
    let mut wrong = Vec::new();
    for (name, mesh, half) in shapes {
        for size in [1e-3, 1.0, 1e6] {
            // Distance from the origin and the size of what else there is, in sizes; rotated or not.
            for (far, around, turn) in
                [(0.0, 0.0, 0.0), (0.0, 0.0, 0.7), (1000.0, 0.0, 0.0), (0.0, 1e4, 0.7), (0.0, 1e6, 0.0)]
            {
                if name == "sheet" && (far > 0.0 || turn > 0.0) {
                    // In single precision its two sides are no longer apart there.
                    continue;
                }
                let place = Vec3::new(0.6, 0.64, -0.48) * far * size;
                let rotation = Quat::from_axis_angle(Vec3::new(0.48, 0.6, 0.64), turn);
                let transform = Affine3A::from_scale_rotation_translation(Vec3::splat(size), rotation, place);
                let mut meshes = vec![(mesh.clone(), transform)];
                if around > 0.0 {
                    let floor = Affine3A::from_scale_rotation_translation(
                        Vec3::splat(around * size),
                        Quat::IDENTITY,
                        Vec3::NEG_Y * 5.0 * size,
                    );
                    meshes.push((shapes::plane(1), floor));
                }
                let geometry = Geometry::new(&scene(meshes));
                // Far away, vertices in single precision are off the shape by so much that flat rays meet
                // real steps.
                let least = if far > 0.0 { 2e-3 } else { 1e-5 };
                let found = faults(&geometry, &transform, half, least);
                // There, too, a point may come to lie on the other side of an edge: one path in 10,000 of
                // them at most.
                let most = if far > 0.0 { found.rays / 20_000 } else { 0 };
                if found.shadowed > 0 || found.leaked > most {
                    wrong.push(format!(
                        "{name} {size:e} far {far} around {around:e} turned {turn}: {found:?}"
                    ));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn no_ray_from_afar_passes_between_the_triangles_of_a_closed_mesh() {
    let mesh = solids::ball(1.0, 1e-5).unwrap();
    let mut missed = Vec::new();
    for distance in [3.0, 100.0, 3000.0] {
        let geometry = Geometry::new(&scene(vec![(mesh.clone(), Affine3A::IDENTITY)]));
        let (seed, mut count) = (&mut 7, 0);
        for k in 0..40_000 {
            let from = on_sphere(seed) * distance;
            // At an edge or a corner that faces the ray's origin.
            let triangle = mesh.triangles[(hash(k) as usize) % mesh.triangles.len()];
            let [a, b, c] = triangle.map(|i| mesh.vertices[i as usize].position);
            let aim = if k % 2 == 0 { a } else { a + (b - a) * unit(seed) };
            let from = if from.dot(a + b + c) < 0.0 { -from } else { from };
            // Rays that pass the rim are no misses.
            if aim.dot((from - aim).normalize()) > 0.3 {
                count += u32::from(geometry.nearest(from, (aim - from).normalize()).is_none_or(|hit| {
                    let hit = geometry.surface(&hit, (aim - from).normalize());
                    hit.position.distance(aim) > 0.1
                }));
            }
        }
        if count > 0 {
            missed.push(format!("{count} from {distance}"));
        }
    }
    assert!(missed.is_empty(), "{}", missed.join(", "));
}
