//! Transfer of every vertex: coefficients of V(p, ω) (n·ω)₊, with V what the scene's own objects leave open
//! (2.3). The albedo over π is applied where a picture is drawn, texel by texel, so that one channel is
//! enough. Surfaces have two sides; a closed mesh is seen from outside alone, an open one has a transfer a
//! side.
//!
//! Directions are the same for all vertices, so that neighbours err alike. Where less than half of what the
//! cosine weighs is hidden, what is hidden is taken from the closed form of the cosine, else what is open is
//! summed: with nothing hidden the lobe is exact, and nothing is left of one that sees nothing.

use std::collections::HashMap;
use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use super::harmonics::{self, COUNT};
use crate::render::geometry::{self, Geometry, joined};
use crate::scene::{Mesh, Object, Scene};

/// Where transfer is known: the front of every vertex of all objects in order, then the back of those of open
/// meshes.
pub(super) struct Receivers {
    pub(super) positions: Vec<Vec3>,
    /// Unit vectors to the side that is lit.
    pub(super) normals: Vec<Vec3>,
    /// By how much rays start aside, along the surface: off the walls that a rim may touch.
    asides: Vec<Vec3>,
    /// By how much rays start above the surface.
    pub(super) offset: f32,
    /// Largest diffuse reflectance of the object, sr⁻¹.
    pub(super) brightness: Vec<f32>,
    /// What to add to the index of a front for that of its back, by object.
    pub(super) backs: Vec<Option<usize>>,
}

impl Receivers {
    /// Those of a scene's objects.
    pub(super) fn new(scene: &Scene) -> Self {
        let bare = Scene { lights: Vec::new(), ..scene.clone() };
        let (mesh, runs) = joined(&bare);
        let asides = inward(&mesh);
        let front = mesh.vertices.len();
        let mut receivers = Self {
            positions: mesh.vertices.iter().map(|vertex| vertex.position).collect(),
            normals: mesh.vertices.iter().map(|vertex| vertex.normal).collect(),
            brightness: Vec::with_capacity(front),
            backs: Vec::with_capacity(runs.len()),
            asides,
            offset: geometry::offset(&mesh),
        };
        let mut first = 0;
        for object in &scene.objects {
            let own = first..first + object.mesh.vertices.len();
            first = own.end;
            let brightest = brightest(object);
            receivers.brightness.resize(own.end, brightest);
        }
        first = 0;
        for object in &scene.objects {
            let own = first..first + object.mesh.vertices.len();
            first = own.end;
            let closed = object.material.mask.is_none() && is_closed(&object.mesh);
            receivers.backs.push((!closed).then(|| receivers.positions.len() - own.start));
            if !closed {
                receivers.positions.extend_from_within(own.clone());
                receivers.asides.extend_from_within(own.clone());
                receivers.brightness.extend_from_within(own.clone());
                receivers.normals.extend(mesh.vertices[own].iter().map(|vertex| -vertex.normal));
            }
        }
        receivers
    }

    /// Number of vertices and sides.
    pub(super) fn len(&self) -> usize {
        self.positions.len()
    }
}

/// The largest diffuse reflectance of an object.
fn brightest(object: &Object) -> f32 {
    let all = object.material.brdfs().map(|brdf| brdf.rho_d.max_element());
    all.fold(0.0, f32::max)
}

/// From every vertex a thousandth of the way to the middle of its triangles, along the surface.
fn inward(mesh: &Mesh) -> Vec<Vec3> {
    let mut middles = vec![(Vec3::ZERO, 0.0f32); mesh.vertices.len()];
    for triangle in &mesh.triangles {
        let corners = triangle.map(|index| mesh.vertices[index as usize].position);
        for index in triangle {
            let (sum, count) = &mut middles[*index as usize];
            *sum += (corners[0] + corners[1] + corners[2]) / 3.0;
            *count += 1.0;
        }
    }
    let aside = |(vertex, (sum, count)): (&crate::scene::Vertex, (Vec3, f32))| {
        let to = if count > 0.0 { sum / count - vertex.position } else { Vec3::ZERO };
        (to - vertex.normal * vertex.normal.dot(to)) * 1e-3
    };
    mesh.vertices.iter().zip(middles).map(aside).collect()
}

/// Whether every edge of a mesh lies between two triangles, wound outward as its normals say: then nothing
/// sees its inside.
fn is_closed(mesh: &Mesh) -> bool {
    let (low, high) = mesh.bounds();
    let cell = (high - low).max_element().max(f32::MIN_POSITIVE) * 1e-5;
    // Vertices of one place, split where texture coordinates or normals differ, are one corner.
    let place = |index: u32| ((mesh.vertices[index as usize].position - low) / cell).round().as_ivec3();
    let mut edges: HashMap<[glam::IVec3; 2], u32> = HashMap::new();
    let (mut volume, mut agreeing) = (0.0, 0.0);
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(place);
        if a == b || b == c || c == a {
            continue;
        }
        let corners = triangle.map(|index| (mesh.vertices[index as usize].position - low).as_dvec3());
        let face = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        volume += corners[0].dot(corners[1].cross(corners[2]));
        let normals: Vec3 = triangle.iter().map(|&index| mesh.vertices[index as usize].normal).sum();
        agreeing += face.length().copysign(face.dot(normals.as_dvec3()));
        for edge in [[a, b], [b, c], [c, a]] {
            *edges.entry(edge).or_default() += 1;
        }
    }
    let paired = |(&[a, b], &count): (&[glam::IVec3; 2], &u32)| count == 1 && edges.get(&[b, a]) == Some(&1);
    volume > 0.0 && agreeing > 0.0 && edges.iter().all(paired)
}

/// Directions all over the sphere with their harmonics, the same for all vertices.
pub(super) struct Directions {
    degree: usize,
    all: Vec<(DVec3, [f32; COUNT])>,
}

impl Directions {
    /// Some directions on a spiral of equal areas.
    pub(super) fn new(degree: usize, count: u32) -> Self {
        let one = |k: u32| {
            let z = 1.0 - f64::from(2 * k + 1) / f64::from(count);
            // The golden angle.
            let (sin, cos) = (f64::from(k) * PI * (3.0 - 5f64.sqrt())).sin_cos();
            let flat = (1.0 - z * z).sqrt();
            let direction = DVec3::new(flat * cos, flat * sin, z);
            (direction, harmonics::basis(degree, direction).map(|y| y as f32))
        };
        Self { degree, all: (0..count).map(one).collect() }
    }

    /// Coefficients of a receiver's transfer, and the rays cast.
    pub(super) fn transfer(
        &self,
        receivers: &Receivers,
        index: usize,
        geometry: &Geometry,
    ) -> ([f32; COUNT], u64) {
        let normal = receivers.normals[index];
        let origin = receivers.positions[index] + receivers.asides[index] + normal * receivers.offset;
        let (mut sums, mut weights) = ([[0.0f64; COUNT]; 2], [0.0; 2]);
        let mut rays = 0;
        let each = 4.0 * PI / self.all.len() as f64;
        let count = harmonics::count(self.degree);
        for (direction, y) in &self.all {
            let cosine = normal.as_dvec3().dot(*direction);
            if cosine <= 0.0 {
                continue;
            }
            rays += 1;
            let hidden = usize::from(geometry.meets(origin, direction.as_vec3()));
            weights[hidden] += cosine;
            let part = cosine * each;
            sums[hidden].iter_mut().zip(&y[..count]).for_each(|(sum, y)| *sum += part * f64::from(*y));
        }
        let [open, hidden] = sums;
        if weights[1] > weights[0] {
            return (open.map(|value| value as f32), rays);
        }
        let whole = harmonics::cosine(self.degree, normal.as_dvec3());
        (std::array::from_fn(|i| (whole[i] - hidden[i]) as f32), rays)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::incident::harmonics::MOST;
    use crate::scene::{Material, shapes, showcase};
    use lobelia_reflectance::{LobeBrdf, Rgb};

    fn scene(meshes: Vec<(Mesh, Vec3)>) -> Scene {
        let mut scene = showcase::published(8, 6);
        scene.lights.clear();
        let given = scene.objects[0].clone();
        scene.objects = meshes
            .into_iter()
            .map(|(mesh, shift)| Object {
                mesh: mesh.into(),
                transform: glam::Affine3A::from_translation(shift),
                material: Material::uniform(LobeBrdf::diffuse(Rgb::splat(0.5))),
                ..given.clone()
            })
            .collect();
        scene
    }

    fn all(scene: &Scene) -> (Receivers, Vec<[f32; COUNT]>) {
        let (receivers, geometry) = (Receivers::new(scene), Geometry::new(scene));
        let directions = Directions::new(MOST, 4096);
        let transfer = |index| directions.transfer(&receivers, index, &geometry).0;
        let transfers = (0..receivers.len()).map(transfer).collect();
        (receivers, transfers)
    }

    fn error(transfer: &[f32; COUNT], expected: &[f64; COUNT]) -> f64 {
        let differences = transfer.iter().zip(expected).map(|(a, b)| (f64::from(*a) - b).powi(2));
        differences.sum::<f64>().sqrt()
    }

    #[test]
    fn what_nothing_hides_has_the_cosine_itself_on_both_sides_of_an_open_mesh() {
        let (receivers, transfers) = all(&scene(vec![(shapes::plane(3), Vec3::ZERO)]));
        assert_eq!((receivers.len(), receivers.backs[0]), (32, Some(16)));
        for (normal, transfer) in receivers.normals.iter().zip(&transfers) {
            assert!(error(transfer, &harmonics::cosine(MOST, normal.as_dvec3())) < 1e-6, "{normal}");
        }
        let (receivers, transfers) = all(&scene(vec![(shapes::sphere(24, 12), Vec3::ZERO)]));
        assert_eq!((receivers.len(), receivers.backs[0]), (25 * 13, None));
        for (normal, transfer) in receivers.normals.iter().zip(&transfers) {
            assert!(error(transfer, &harmonics::cosine(MOST, normal.as_dvec3())) < 1e-6, "{normal}");
        }
    }

    /// The middle of a sheet within a ball; the foot of an endless wall, where half of the cosine, π/2, is
    /// left.
    #[test]
    fn an_enclosed_vertex_sees_nothing_and_one_at_the_foot_of_a_wall_half() {
        let (receivers, transfers) =
            all(&scene(vec![(shapes::plane(2), Vec3::ZERO), (shapes::sphere(24, 12), Vec3::ZERO)]));
        let centre = receivers.positions.iter().position(|position| position.length() < 1e-6).unwrap();
        assert_eq!(transfers[centre], [0.0; COUNT]);
        let mut walled = scene(vec![(shapes::plane(2), Vec3::ZERO), (shapes::plane(2), Vec3::ZERO)]);
        // A wall through the floor's rim at x = −1, from −300 to 300 along and up to 300.
        walled.objects[1].transform = glam::Affine3A::from_scale_rotation_translation(
            Vec3::splat(300.0),
            glam::Quat::from_rotation_z(-std::f32::consts::FRAC_PI_2),
            Vec3::new(-1.0, 0.0, 0.0),
        );
        let (receivers, transfers) = all(&walled);
        let foot = receivers.positions.iter().position(|p| (*p - Vec3::new(-1.0, 0.0, 0.0)).length() < 1e-6);
        let transfer = transfers[foot.unwrap()];
        // The integral over the sphere is Y_00 √4π.
        let open = f64::from(transfer[0]) * (4.0 * PI).sqrt();
        assert!((open - PI / 2.0).abs() < 0.02, "{open}");
        // Odd about the wall: of x the open side's ∫ cosθ ω_x over a quarter sphere, 2/3.
        let slope = -f64::from(transfer[3]) / (3.0 / (4.0 * PI)).sqrt();
        assert!((slope - 2.0 / 3.0).abs() < 0.01, "{slope}");
    }
}
