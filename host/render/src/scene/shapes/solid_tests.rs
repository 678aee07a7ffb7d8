//! Shapes to a tolerance against closed forms.

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3, Vec3};

use super::height_field::{Heights, height_field};
use super::solids::{ball, cuboid, cylinder, lathe, torus};
use crate::scene::mesh::Mesh;

fn corners(mesh: &Mesh) -> impl Iterator<Item = [DVec3; 3]> {
    mesh.triangles.iter().map(|triangle| triangle.map(|i| mesh.vertices[i as usize].position.as_dvec3()))
}

pub(in crate::scene) fn area(mesh: &Mesh) -> f64 {
    corners(mesh).map(|[a, b, c]| (b - a).cross(c - a).length() / 2.0).sum()
}

pub(in crate::scene) fn volume(mesh: &Mesh) -> f64 {
    corners(mesh).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
}

/// Edges, by places, that are not passed as often one way as the other.
pub(in crate::scene) fn open_edges(mesh: &Mesh) -> Vec<[Vec3; 2]> {
    let mut passed: HashMap<[[u32; 3]; 2], i32> = HashMap::new();
    let bits = |p: DVec3| (p.as_vec3() + 0.0).to_array().map(f32::to_bits);
    for [a, b, c] in corners(mesh) {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            let (from, to) = (bits(from), bits(to));
            let (edge, way) = if from < to { ([from, to], 1) } else { ([to, from], -1) };
            *passed.entry(edge).or_default() += way;
        }
    }
    let open = passed.into_iter().filter(|(_, passed)| *passed != 0);
    open.map(|(edge, _)| edge.map(|place| Vec3::from_array(place.map(f32::from_bits)))).collect()
}

/// Orthonormal frames, triangles that face along them, texture that is not mirrored and grows along the
/// tangents.
pub(in crate::scene) fn frames_fit(mesh: &Mesh) {
    for vertex in &mesh.vertices {
        assert!((vertex.normal.length() - 1.0).abs() < 1e-5 && vertex.position.is_finite(), "{vertex:?}");
        assert!((vertex.tangent.length() - 1.0).abs() < 1e-5, "{vertex:?}");
        assert!(vertex.normal.dot(vertex.tangent).abs() < 1e-5 && vertex.handedness == 1.0, "{vertex:?}");
        let in_square = |x: f32| (0.0..=1.0).contains(&x);
        assert!(in_square(vertex.uv.x) && in_square(vertex.uv.y), "{vertex:?}");
    }
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|i| mesh.vertices[i as usize]);
        let face = (b.position - a.position).cross(c.position - a.position);
        for vertex in [a, b, c] {
            assert!(face.normalize().dot(vertex.normal) > 0.3, "{vertex:?} of {triangle:?}");
        }
        let (to_b, to_c) = ((b.uv - a.uv).as_dvec2(), (c.uv - a.uv).as_dvec2());
        let mirrored = to_b.perp_dot(to_c);
        assert!(mirrored < 0.0, "{a:?} {b:?} {c:?}");
        let edges = [b, c].map(|vertex| (vertex.position - a.position).as_dvec3());
        let along_u = (edges[0] * to_c.y - edges[1] * to_b.y) / mirrored;
        let tangent = (a.tangent + b.tangent + c.tangent).as_dvec3().normalize();
        assert!(along_u.normalize().dot(tangent) > 0.7, "{a:?} {b:?} {c:?}");
    }
}

/// Largest distance of points all over the triangles by a function that tells a point's distance from the
/// true surface.
fn farthest(mesh: &Mesh, distance: impl Fn(DVec3) -> f64) -> f64 {
    const STEPS: usize = 6;
    let mut worst = 0.0f64;
    for [a, b, c] in corners(mesh) {
        for (i, j) in (0..=STEPS).flat_map(|i| (0..=STEPS - i).map(move |j| (i, j))) {
            let [wb, wc] = [i, j].map(|k| k as f64 / STEPS as f64);
            worst = worst.max(distance(a + (b - a) * wb + (c - a) * wc).abs());
        }
    }
    worst
}

/// A foot, a stem and a bowl with an inner wall, in smooth pieces.
const GOBLET: [[f64; 2]; 13] = [
    [0.0, 1.0],
    [0.4, 1.0],
    [0.7, 1.3],
    [0.7, 2.0],
    [0.7, 2.1],
    [0.8, 2.1],
    [0.8, 2.0],
    [0.8, 0.6],
    [0.1, 1.2],
    [0.1, 0.6],
    [0.1, 0.2],
    [0.6, 0.1],
    [0.0, 0.0],
];

#[test]
fn areas_and_volumes_are_those_of_closed_forms_and_surfaces_closed_and_outside_out() {
    let (r, t) = (2.0, 1e-4);
    for (name, mesh, area_known, volume_known) in [
        ("ball", ball(r, t).unwrap(), 4.0 * PI * r * r, 4.0 / 3.0 * PI * r * r * r),
        ("torus", torus(r, 0.5, t).unwrap(), TAU * r * TAU * 0.5, TAU * r * PI * 0.25),
        ("cylinder", cylinder(r, 3.0, true, t).unwrap(), TAU * r * (3.0 + r), PI * r * r * 3.0),
        ("box", cuboid([1.0, 2.0, 3.0]).unwrap(), 22.0, 6.0),
        (
            "cone",
            lathe(&[[0.0, 3.0], [r, 0.0], [0.0, 0.0]], false, t).unwrap(),
            PI * r * (r + (r * r + 9.0f64).sqrt()),
            PI * r * r,
        ),
    ] {
        let (area, volume) = (area(&mesh), volume(&mesh));
        // A surface that is t off at most encloses t times its area less at most.
        assert!((area / area_known - 1.0).abs() < 5e-4, "{name}: area {area}, {area_known}");
        assert!(
            (volume - volume_known).abs() <= 1.1 * t * area_known + 1e-6,
            "{name}: {volume}, {volume_known}"
        );
        assert!(open_edges(&mesh).is_empty(), "{name}: {} open edges", open_edges(&mesh).len());
        frames_fit(&mesh);
    }
}

#[test]
fn triangles_keep_within_the_tolerance_and_are_not_finer_than_it_asks() {
    let tube = |p: DVec3, radius: f64| DVec2::new(p.x.hypot(p.z) - radius, p.y).length() - 0.4;
    for tolerance in [0.03, 1e-3, 5e-5] {
        for (name, mesh, distance) in [
            ("ball", ball(1.5, tolerance), &(|p: DVec3| p.length() - 1.5) as &dyn Fn(DVec3) -> f64),
            ("torus", torus(1.5, 0.4, tolerance), &|p| tube(p, 1.5)),
            ("side", cylinder(1.5, 2.0, false, tolerance), &|p: DVec3| p.x.hypot(p.z) - 1.5),
        ] {
            let off = farthest(&mesh.unwrap(), distance);
            assert!(off <= tolerance + 1e-6, "{name}: {off} at {tolerance}");
            assert!(off > 0.6 * tolerance, "{name}: {off} at {tolerance}");
        }
    }
    // Four times the triangles for a quarter of the tolerance; twice along a cylinder.
    let count = |mesh: lobelia_base::error::Result<Mesh>| mesh.unwrap().triangles.len() as f64;
    for (coarse, fine, times) in [
        (ball(1.0, 4e-4), ball(1.0, 1e-4), 4.0),
        (torus(1.0, 0.4, 4e-4), torus(1.0, 0.4, 1e-4), 4.0),
        (cylinder(1.0, 1.0, false, 4e-4), cylinder(1.0, 1.0, false, 1e-4), 2.0),
    ] {
        let ratio = count(fine) / count(coarse);
        assert!((ratio / times - 1.0).abs() < 0.1, "{ratio}, {times}");
    }
}

#[test]
fn a_smooth_lathe_keeps_within_the_tolerance_of_its_profile() {
    let on_profile: Vec<DVec2> = (0..4)
        .flat_map(|piece| (0..=2000).map(move |k| (piece, f64::from(k) / 2000.0)))
        .map(|(piece, t)| {
            let weights =
                [(1.0 - t).powi(3), 3.0 * t * (1.0 - t).powi(2), 3.0 * t * t * (1.0 - t), t.powi(3)];
            (0..4).map(|k| DVec2::from_array(GOBLET[3 * piece + k]) * weights[k]).sum()
        })
        .collect();
    let nearest = |p: DVec3| {
        let p = DVec2::new(p.x.hypot(p.z), p.y);
        on_profile.iter().map(|q| q.distance(p)).fold(f64::INFINITY, f64::min)
    };
    let tolerance = 0.01;
    let mesh = lathe(&GOBLET, true, tolerance).unwrap();
    let off = farthest(&mesh, nearest);
    assert!(off < tolerance && off > 0.5 * tolerance, "{off}");
    assert!(open_edges(&mesh).is_empty());
    frames_fit(&mesh);
    // Pappus: the volume by the profile's own integral.
    let known: f64 =
        on_profile.windows(2).map(|p| PI * ((p[0].x + p[1].x) / 2.0).powi(2) * (p[0].y - p[1].y)).sum();
    assert!((volume(&mesh) - known).abs() < tolerance * area(&mesh) && known > 0.0, "{known}");
}

#[test]
fn a_profile_makes_the_same_solid_from_either_end() {
    let turned: Vec<[f64; 2]> = GOBLET.iter().rev().copied().collect();
    let [plain, turned] = [lathe(&GOBLET, true, 0.01).unwrap(), lathe(&turned, true, 0.01).unwrap()];
    assert!(volume(&plain) > 0.1 && (volume(&plain) - volume(&turned)).abs() < 1e-6);
    assert_eq!(plain.triangles, turned.triangles);
}

#[test]
fn normals_are_those_of_the_surface_at_poles_too() {
    let ball = ball(3.0, 0.01).unwrap();
    assert!(ball.vertices.iter().all(|v| (v.normal - v.position / 3.0).length() < 1e-5));
    let ring = torus(2.0, 0.5, 0.01).unwrap();
    for v in &ring.vertices {
        let centre = Vec3::new(v.position.x, 0.0, v.position.z).normalize() * 2.0;
        assert!((v.normal - (v.position - centre) / 0.5).length() < 1e-4, "{v:?}");
    }
    // A cone's tip has the normal of the side that it ends.
    let cone = lathe(&[[0.0, 1.0], [1.0, 0.0]], false, 0.01).unwrap();
    for v in cone.vertices.iter().filter(|v| v.position.y == 1.0) {
        let azimuth = v.uv.x * std::f32::consts::TAU;
        let known = Vec3::new(azimuth.sin(), 1.0, azimuth.cos()).normalize();
        assert!((v.normal - known).length() < 1e-5, "{v:?}");
    }
}

#[test]
fn texture_coordinates_grow_around_and_along() {
    let ring = torus(2.0, 0.5, 0.01).unwrap();
    for v in &ring.vertices {
        let around = (v.uv.x * std::f32::consts::TAU).sin_cos();
        let flat = Vec3::new(v.position.x, 0.0, v.position.z).normalize();
        assert!((flat - Vec3::new(around.0, 0.0, around.1)).length() < 1e-5, "{v:?}");
        let angle = std::f32::consts::PI * (1.0 - 2.0 * v.uv.y);
        let radius = v.position.x.hypot(v.position.z);
        let off = [radius - 2.0 - 0.5 * angle.cos(), v.position.y - 0.5 * angle.sin()];
        assert!(off.iter().all(|off| off.abs() < 1e-5), "{v:?}");
    }
    let length = |v: f32| f64::from(v) * (2.0f64.sqrt() + 1.0);
    let cone = lathe(&[[0.0, 1.0], [1.0, 0.0], [0.0, 0.0]], false, 0.01).unwrap();
    for v in &cone.vertices {
        let radius = f64::from(v.position.x.hypot(v.position.z));
        let along = length(v.uv.y);
        let known = if along < 1.41422 { along / 2.0f64.sqrt() } else { 1.0 - (along - 2.0f64.sqrt()) };
        assert!((radius - known).abs() < 1e-4, "{v:?}");
    }
}

/// Hills as a function of u and v in 0..1.
fn hills(u: f64, v: f64) -> f64 {
    0.3 * (7.0 * u).sin() * (5.0 * v).cos() + 0.2 * (-40.0 * ((u - 0.3).powi(2) + (v - 0.6).powi(2))).exp()
}

fn sampled(columns: usize, rows: usize, height: impl Fn(f64, f64) -> f64) -> Vec<f64> {
    let place =
        |k: usize| ((k % columns) as f64 / (columns - 1) as f64, (k / columns) as f64 / (rows - 1) as f64);
    (0..columns * rows).map(|k| height(place(k).0, place(k).1)).collect()
}

#[test]
fn a_height_field_keeps_within_the_tolerance_of_the_heights_has_no_cracks_and_is_coarse_where_it_is_flat() {
    let samples = sampled(120, 90, hills);
    let heights = Heights { columns: 120, samples: &samples };
    let (size, tolerance) = ([4.0, 3.0], 4e-3);
    let mesh = height_field(&heights, size, tolerance).unwrap();
    // Interpolation of so dense samples is off by far less than the tolerance.
    let off = farthest(&mesh, |p| p.y - hills(p.x / size[0] + 0.5, p.z / size[1] + 0.5));
    assert!(off <= tolerance + 2e-4 && off > 0.5 * tolerance, "{off}");
    frames_fit(&mesh);
    for [a, b] in open_edges(&mesh) {
        let at_side = |p: Vec3| (p.x.abs() - 2.0).abs() < 1e-6 || (p.z.abs() - 1.5).abs() < 1e-6;
        assert!(at_side(a) && at_side(b), "a crack between {a} and {b}");
    }
    assert!(mesh.triangles.len() < 6000, "{} triangles", mesh.triangles.len());
    for v in &mesh.vertices {
        let [u, w] = [v.uv.x, v.uv.y].map(f64::from);
        let step = 1e-5;
        let slope = |du: f64, dv: f64| (hills(u + du, w + dv) - hills(u - du, w - dv)) / (2.0 * step);
        let known = DVec3::new(-slope(step, 0.0) / size[0], 1.0, -slope(0.0, step) / size[1]).normalize();
        assert!((v.normal.as_dvec3() - known).length() < 0.02, "{v:?}: {known}");
    }
    // A slope is two triangles.
    let slope = sampled(9, 5, |u, v| u - 2.0 * v);
    let flat = height_field(&Heights { columns: 9, samples: &slope }, [1.0, 1.0], 1e-6).unwrap();
    assert_eq!(flat.triangles.len(), 2);
    assert!((area(&flat) - 6.0f64.sqrt()).abs() < 1e-6, "{}", area(&flat));
}

#[test]
fn sizes_that_are_none_and_tolerances_that_cannot_be_are_refused_by_their_key() {
    let heights = Heights { columns: 2, samples: &[0.0; 4] };
    for (result, words) in [
        (ball(0.0, 0.1), "key radius"),
        (ball(1.0, -0.1), "key tolerance"),
        (ball(1.0, 1e-9), "triangles"),
        (ball(f64::NAN, 0.1), "key radius"),
        (torus(1.0, 1.0, 0.1), "key tube"),
        (cylinder(1.0, f64::INFINITY, true, 0.1), "key height"),
        (cuboid([1.0, 0.0, 1.0]), "key size"),
        (lathe(&[[0.0, 1.0]], false, 0.1), "two points"),
        (lathe(&[[0.0, 1.0], [-1.0, 0.0]], false, 0.1), "radius below 0"),
        (lathe(&[[0.0, 1.0], [0.0, 1.0]], false, 0.1), "without length"),
        (lathe(&[[0.0, 1.0]; 5], true, 0.1), "three a piece"),
        (lathe(&[[0.0, f64::NAN], [1.0, 0.0]], false, 0.1), "finite"),
        (height_field(&heights, [1.0, 0.0], 0.1), "key size"),
        (height_field(&Heights { columns: 3, ..heights }, [1.0, 1.0], 0.1), "two rows"),
    ] {
        let message = result.unwrap_err().to_string();
        assert!(message.contains(words), "\"{words}\" is not in: {message}");
    }
}
