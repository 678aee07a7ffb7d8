//! A scene's triangles in the world, with the tree that finds the one a ray hits and the frame at that point.

use std::ops::Range;
use std::sync::Arc;

use glam::{Affine3A, Mat3A, Vec2, Vec3, Vec3A, Vec4};
use obvhs::triangle::Triangle;

use super::bvh::{Bvh, Hit};
use crate::scene::{Light, Mask, Mesh, Object, Scene, Vertex, shapes};

/// The least cosine between the shading normal and the view: a normal that points away from the viewer is
/// bent to it, else the rims of smooth meshes turn black.
pub(crate) const LEAST_COSINE: f32 = 0.01;

/// All triangles of a scene.
pub(crate) struct Geometry {
    vertices: Vec<Vertex>,
    triangles: Vec<[u32; 3]>,
    /// Object a triangle; rectangular lights come after the scene's objects.
    objects: Vec<u32>,
    bvh: Bvh,
    /// What is cut out of the objects, with the repeats of the texture.
    masks: Vec<Option<(Arc<Mask>, Vec2)>>,
    /// Whether anything is.
    masked: bool,
    /// Length by which a light's own triangles may seem nearer than they are.
    nearer: f32,
}

/// A point of a surface seen from some direction; all vectors are on the viewer's side.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Surface {
    /// The point.
    pub(crate) position: Vec3,
    /// The point that shadow rays start from: lifted to the smooth surface that the triangles stand for.
    pub(crate) shadow_origin: Vec3,
    /// Normal of the triangle.
    pub(crate) geometric: Vec3,
    /// The sample's axes x, y, z in the world.
    pub(crate) frame: [Vec3; 3],
    /// Texture coordinates.
    pub(crate) uv: Vec2,
    /// Index into the scene's objects, or beyond them a rectangular light.
    pub(crate) object: u32,
    /// Length along the geometric normal by which the point may lie beside the plane that the tree tests rays
    /// against.
    pub(crate) offset: f32,
}

impl Surface {
    /// A world direction in the sample's frame.
    pub(crate) fn to_local(self, world: Vec3) -> Vec3 {
        let [x, y, z] = self.frame;
        Vec3::new(x.dot(world), y.dot(world), z.dot(world))
    }

    /// A direction of the sample's frame in the world.
    pub(crate) fn to_world(self, local: Vec3) -> Vec3 {
        let [x, y, z] = self.frame;
        x * local.x + y * local.y + z * local.z
    }
}

/// A scene's meshes in the world, then its rectangular lights, as one mesh with each one's run of triangles.
pub(crate) fn joined(scene: &Scene) -> (Mesh, Vec<Range<u32>>) {
    let mut joined = Mesh::default();
    let mut runs = Vec::new();
    let mut add = |mesh: Mesh| {
        let (first, start) = (joined.vertices.len() as u32, joined.triangles.len() as u32);
        joined.vertices.extend(mesh.vertices);
        joined.triangles.extend(mesh.triangles.iter().map(|t| t.map(|i| i + first)));
        runs.push(start..joined.triangles.len() as u32);
    };
    for object in &scene.objects {
        add(object.mesh.transformed(&object.transform));
    }
    for light in &scene.lights {
        if let Light::Rectangle { centre, edges: [u, v], .. } = *light {
            // The plane of `shapes` is −1..1 with x to the right, z towards the viewer and +y as its front.
            let matrix = Mat3A::from_cols((u / 2.0).into(), u.cross(v).into(), (-v / 2.0).into());
            add(shapes::plane(1).transformed(&Affine3A { matrix3: matrix, translation: centre.into() }));
        }
    }
    (joined, runs)
}

impl Geometry {
    /// Places the scene's meshes in the world and builds the tree.
    pub(crate) fn new(scene: &Scene) -> Self {
        let (joined, runs) = joined(scene);
        let mut objects = Vec::with_capacity(joined.triangles.len());
        for (index, run) in (0u32..).zip(&runs) {
            objects.resize(run.end as usize, index);
        }
        let corner = |i: u32| Vec3A::from(joined.vertices[i as usize].position);
        let triangles: Vec<Triangle> = joined
            .triangles
            .iter()
            .map(|&[a, b, c]| Triangle { v0: corner(a), v1: corner(b), v2: corner(c) })
            .collect();
        let mask = |object: &Object| Some((object.material.mask.clone()?, object.material.tiling));
        let mut masks: Vec<_> = scene.objects.iter().map(mask).collect();
        masks.resize_with(runs.len(), || None);
        Self {
            nearer: NEARER * extent(&joined),
            masked: masks.iter().any(Option::is_some),
            masks,
            vertices: joined.vertices,
            triangles: joined.triangles,
            objects,
            bvh: Bvh::new(&triangles),
        }
    }

    /// Whether a triangle stops a ray at a point, and is not cut out there.
    #[inline]
    fn solid(&self, triangle: u32, point: impl FnOnce() -> Vec3) -> bool {
        if !self.masked {
            return true;
        }
        let Some((mask, tiling)) = &self.masks[self.objects[triangle as usize] as usize] else { return true };
        mask.solid(self.uv(triangle, point()) * *tiling)
    }

    /// The triangles of an object by their index.
    pub(crate) fn triangles_of(&self, object: u32) -> impl Iterator<Item = u32> {
        let first = self.objects.partition_point(|&other| other < object);
        let end = self.objects.partition_point(|&other| other <= object);
        first as u32..end as u32
    }

    /// The object of a triangle.
    pub(crate) fn object_of(&self, triangle: u32) -> u32 {
        self.objects[triangle as usize]
    }

    /// Number of triangles.
    pub(crate) fn triangles(&self) -> usize {
        self.triangles.len()
    }

    /// The corners of a triangle.
    pub(crate) fn corners(&self, triangle: u32) -> [&Vertex; 3] {
        self.triangles[triangle as usize].map(|i| &self.vertices[i as usize])
    }

    /// Texture coordinates at a point of a triangle's plane.
    pub(crate) fn uv(&self, triangle: u32, point: Vec3) -> Vec2 {
        let corners = self.corners(triangle);
        let [wb, wc] = barycentric(corners.map(|vertex| vertex.position), point);
        corners[0].uv * (1.0 - wb - wc) + corners[1].uv * wb + corners[2].uv * wc
    }

    /// Texture coordinates where another ray meets the plane of the triangle that was hit.
    pub(crate) fn uv_along(&self, hit: &Hit, origin: Vec3, direction: Vec3) -> Vec2 {
        let [a, b, c] = self.corners(hit.triangle).map(|vertex| vertex.position);
        let normal = (b - a).cross(c - a);
        let distance = (a - origin).dot(normal) / direction.dot(normal);
        self.uv(hit.triangle, origin + direction * distance)
    }

    /// The nearest triangle along a ray of unit direction.
    pub(crate) fn nearest(&self, origin: Vec3, direction: Vec3) -> Option<Hit> {
        self.nearest_at(origin, direction).map(|(hit, _)| hit)
    }

    /// The same with its distance.
    pub(crate) fn nearest_at(&self, origin: Vec3, direction: Vec3) -> Option<(Hit, f32)> {
        let solid = |triangle, distance| self.solid(triangle, || origin + direction * distance);
        self.bvh.nearest(origin, direction, solid)
    }

    /// Whether a ray of unit direction meets anything.
    pub(crate) fn meets(&self, origin: Vec3, direction: Vec3) -> bool {
        self.bvh.any(origin, direction, f32::INFINITY, |triangle, distance| {
            self.solid(triangle, || origin + direction * distance)
        })
    }

    /// The vertices of the triangle that was hit, those of all objects counted in order, with their weights.
    pub(crate) fn blend_of(&self, hit: &Hit) -> ([u32; 3], [f32; 3]) {
        let [wb, wc] = hit.weights.map(|weight| weight.clamp(0.0, 1.0));
        (self.triangles[hit.triangle as usize], [(1.0 - wb - wc).max(0.0), wb, wc])
    }

    /// Where rays that leave a surface start.
    pub(crate) fn leaving(&self, surface: &Surface) -> Vec3 {
        surface.shadow_origin + surface.geometric * surface.offset
    }

    /// Where rays that go on through a surface start.
    pub(crate) fn beyond(&self, surface: &Surface) -> Vec3 {
        surface.position - surface.geometric * surface.offset
    }

    /// The object of a hit, or beyond the scene's objects a rectangular light.
    pub(crate) fn object(&self, hit: &Hit) -> u32 {
        self.objects[hit.triangle as usize]
    }

    /// Whether a ray meets the side of a triangle that its winding makes the front.
    pub(crate) fn front(&self, hit: &Hit, direction: Vec3) -> bool {
        let [a, b, c] = self.triangles[hit.triangle as usize].map(|i| self.vertices[i as usize].position);
        (b - a).cross(c - a).dot(direction) < 0.0
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.vertices[..])
            + size_of_val(&self.triangles[..])
            + size_of_val(&self.objects[..])
            + self.bvh.bytes()
    }

    /// Whether anything lies between a surface point and just before `distance` along a unit direction.
    pub(crate) fn occluded(&self, surface: &Surface, direction: Vec3, distance: f32) -> bool {
        let origin = self.leaving(surface);
        // Seen from where the ray starts, a near light has another direction and distance.
        let (direction, distance) = if distance.is_finite() {
            let to = surface.position + direction * distance - origin;
            let length = to.length();
            (to / length, length)
        } else {
            (direction, distance)
        };
        let finite = distance.min(f32::MAX);
        let reach = distance - finite * 1e-5 - self.nearer.min(finite * 1e-3);
        self.bvh.any(origin, direction, reach, |triangle, distance| {
            self.solid(triangle, || origin + direction * distance)
        })
    }

    /// The surface at a hit, seen along `direction`. Surfaces have two sides with the same material.
    pub(crate) fn surface(&self, hit: &Hit, direction: Vec3) -> Surface {
        let corners = self.corners(hit.triangle);
        let [a, b, c] = corners.map(|v| v.position);
        let (ab, ac) = (b - a, c - a);
        let cross = ab.cross(ac);

        let [wb, wc] = hit.weights.map(|weight| weight.clamp(0.0, 1.0));
        let weights = [(1.0 - wb - wc).max(0.0), wb, wc];
        let blend = blend(corners, weights);
        let position = a + ab * wb + ac * wc;
        let geometric = cross.normalize_or_zero() * if cross.dot(direction) <= 0.0 { 1.0 } else { -1.0 };
        // The side is told by where the viewer stands, not by the triangle's winding, which files get wrong.
        let side = |normal: Vec3| if normal.dot(geometric) < 0.0 { -1.0 } else { 1.0 };

        // Lifting to the vertices' tangent planes keeps the terminator of smooth meshes free of their facets.
        let mut lift = Vec3::ZERO;
        for (vertex, weight) in corners.into_iter().zip(weights) {
            let normal = vertex.normal * side(vertex.normal);
            lift -= normal * ((position - vertex.position).dot(normal).min(0.0) * weight);
        }
        let outward = side(blend.normal);
        Surface {
            position,
            shadow_origin: position + lift,
            geometric,
            frame: shading_frame(
                blend.normal * outward,
                blend.tangent,
                corners[0].handedness * outward,
                -direction,
            ),
            uv: blend.uv,
            object: self.objects[hit.triangle as usize],
            offset: rounding([a, ab, ac], cross),
        }
    }
}

/// How far a point of a triangle, computed from its weights and lifted by this much, may be beside the plane
/// that the tree tests rays against, at most: with the unit roundoff ε, ε Σ |n| 8 |a| for the point's
/// coordinates, and, since the test's normal N = e₁ × e₂ is rounded too, ε Σ Â 16 (|ab| + |ac|), where Â =
/// (|e₁| × |e₂| with all terms positive) / |N|. Twice what a triangle needs by itself, for those beside it in
/// the same plane (as in Pharr, Jakob and Humphreys 2023, section 6.8).
fn rounding([a, ab, ac]: [Vec3; 3], cross: Vec3) -> f32 {
    const ROUNDOFF: f32 = f32::EPSILON / 2.0;
    let (ab, ac, length) = (ab.abs(), ac.abs(), cross.length());
    if length == 0.0 {
        return 0.0;
    }
    let product = |i: usize, j: usize| ab[i] * ac[j] + ab[j] * ac[i];
    let spread = Vec3::new(product(1, 2), product(2, 0), product(0, 1));
    ROUNDOFF * (8.0 * cross.abs().dot(a.abs()) + 16.0 * spread.dot(ab + ac)) / length
}

/// The weighted sum of vertices, four numbers at a time.
fn blend(corners: [&Vertex; 3], weights: [f32; 3]) -> Vertex {
    let rows = |vertex: &Vertex| bytemuck::cast::<Vertex, [[f32; 4]; 3]>(*vertex).map(Vec4::from_array);
    let [a, b, c] = corners.map(rows);
    let row = |i: usize| (a[i] * weights[0] + b[i] * weights[1] + c[i] * weights[2]).to_array();
    bytemuck::cast([row(0), row(1), row(2)])
}

/// What of the largest coordinate a light's triangles may seem nearer by.
const NEARER: f32 = 2e-6;

/// The largest coordinate of a mesh.
fn extent(mesh: &Mesh) -> f32 {
    let (low, high) = mesh.bounds();
    let extent = if mesh.vertices.is_empty() { 0.0 } else { low.abs().max(high.abs()).max_element() };
    extent.max(f32::MIN_POSITIVE)
}

/// Length by which rays of the raster, and those of transfer, are kept off the surfaces of a mesh.
pub(crate) fn offset(mesh: &Mesh) -> f32 {
    extent(mesh) * 2e-5
}

/// The second and the third barycentric coordinate of a point of a triangle's plane.
fn barycentric([a, b, c]: [Vec3; 3], point: Vec3) -> [f32; 2] {
    let (ab, ac, to) = (b - a, c - a, point - a);
    let cross = ab.cross(ac);
    let area = cross.length_squared().max(f32::MIN_POSITIVE);
    [to.cross(ac).dot(cross) / area, ab.cross(to).dot(cross) / area]
}

/// The sample's axes from interpolated vectors: normal (on the viewer's side), tangent, and the sign of y.
/// The shader in shaders/lights.wgsl does the same.
pub(crate) fn shading_frame(normal: Vec3, tangent: Vec3, handedness: f32, view: Vec3) -> [Vec3; 3] {
    let mut z = normal.normalize_or(view);
    let cosine = z.dot(view);
    if cosine < LEAST_COSINE {
        z = (z + view * (LEAST_COSINE - cosine)).normalize();
    }
    let flat = tangent - z * z.dot(tangent);
    let x = flat.try_normalize().unwrap_or_else(|| z.any_orthonormal_vector());
    [x, z.cross(x) * handedness, z]
}

#[cfg(test)]
mod leak_tests;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Material, shapes, showcase};
    use lobelia_reflectance::{LobeBrdf, Rgb};

    fn sphere_scene() -> Scene {
        let mut scene = showcase::published(8, 8);
        let material = Material::uniform(LobeBrdf::diffuse(Rgb::ONE));
        scene.objects.truncate(1);
        scene.objects[0].mesh = std::sync::Arc::new(shapes::sphere(64, 32));
        scene.objects[0].transform = glam::Affine3A::IDENTITY;
        scene.objects[0].material = material;
        scene
    }

    #[test]
    fn rays_through_a_closed_mesh_never_miss_and_its_frames_face_the_viewer() {
        let geometry = Geometry::new(&sphere_scene());
        for i in 0..100 {
            for j in 0..100 {
                let target = Vec3::new(i as f32 / 50.0 - 1.0, j as f32 / 50.0 - 1.0, 0.0) * 0.65;
                let origin = Vec3::new(0.0, 0.0, 4.0);
                let direction = (target - origin).normalize();
                let hit = geometry.nearest(origin, direction).expect("a hole in the sphere");
                let surface = geometry.surface(&hit, direction);
                let [x, y, z] = surface.frame;
                assert!((surface.position.length() - 1.0).abs() < 0.01);
                assert!(z.dot(-direction) > 0.0 && surface.geometric.dot(-direction) > 0.0);
                assert!((x.cross(y) - z).length() < 1e-4);
                assert!(!geometry.occluded(&surface, z, f32::INFINITY), "acne at {i}, {j}");
            }
        }
    }

    #[test]
    fn the_far_side_of_a_sphere_is_shadowed_and_seen_from_inside_it_faces_inwards() {
        let geometry = Geometry::new(&sphere_scene());
        let hit = geometry.nearest(Vec3::ZERO, Vec3::X).unwrap();
        let surface = geometry.surface(&hit, Vec3::X);
        assert!(surface.frame[2].dot(Vec3::NEG_X) > 0.99);
        assert!(geometry.occluded(&surface, Vec3::NEG_X, f32::INFINITY));
        assert!(!geometry.occluded(&surface, Vec3::NEG_X, 1.5));
    }

    #[test]
    fn rays_pass_where_the_material_is_cut_out() {
        let mut scene = sphere_scene();
        // Two repeats around the sphere, the first half of each there: u = 0 at +z, growing to the east.
        let mask = Mask::from_alpha(2, 1, [1.0, 0.0]);
        (scene.objects[0].material.mask, scene.objects[0].material.tiling) =
            (Some(mask.into()), Vec2::new(2.0, 1.0));
        let geometry = Geometry::new(&scene);
        let toward = |degrees: f32| Vec3::new(degrees.to_radians().sin(), 0.0, degrees.to_radians().cos());
        for (degrees, solid) in [(45.0, true), (135.0, false), (225.0, true), (315.0, false)] {
            assert_eq!(geometry.nearest(Vec3::ZERO, toward(degrees)).is_some(), solid, "{degrees}");
        }
        // From outside at the hole at 135° the far wall at 315° is open too.
        let hit = geometry.nearest(toward(135.0) * 3.0, -toward(135.0));
        assert!(hit.is_none(), "{hit:?}");
    }

    #[test]
    fn a_light_does_not_shade_the_smooth_surfaces_below_it() {
        let mut scene = sphere_scene();
        let centre = Vec3::new(0.3, 1.3, 0.2);
        let edges = [Vec3::X, Vec3::Z];
        scene.lights = vec![crate::scene::Light::Rectangle { centre, edges, radiance: Rgb::ONE }];
        let geometry = Geometry::new(&scene);
        for k in 0..1000 {
            let (x, z) = (0.6 * (k % 40) as f32 / 40.0 - 0.3, 0.6 * (k / 40) as f32 / 25.0 - 0.3);
            let origin = Vec3::new(x, 1.2, z);
            let hit = geometry.nearest(origin, Vec3::NEG_Y).unwrap();
            let surface = geometry.surface(&hit, Vec3::NEG_Y);
            let to = centre + edges[0] * (x * 1.5) - surface.position;
            assert!(!geometry.occluded(&surface, to.normalize(), to.length()), "{x} {z}");
        }
    }
}
