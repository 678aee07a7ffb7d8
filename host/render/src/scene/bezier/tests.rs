use glam::{DVec3, Vec3};

use super::*;
use crate::scene::mesh::Vertex;
use crate::scene::shapes::solid_tests::{area, frames_fit, open_edges, volume};

/// Numbers in 0..1 that look drawn.
fn unit(k: u32) -> f64 {
    (f64::from(k + 1) * 0.618_033_988_749_895 * f64::from(k % 7 + 3)).fract()
}

fn crooked() -> Patch {
    let part = |k: usize| 0.5 * unit(k as u32) - 0.25;
    Patch(std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            let k = 3 * (4 * i + j);
            DVec3::new(i as f64 + part(k), j as f64 + part(k + 1), 2.0 * part(k + 2))
        })
    }))
}

#[test]
fn derivatives_of_a_patch_are_its_differences() {
    let (patch, step) = (crooked(), 1e-4);
    for (u, v) in [(0.0, 0.0), (0.2, 0.7), (0.5, 0.5), (1.0, 0.3), (1.0, 1.0)] {
        let at = |du: f64, dv: f64| patch.at(u + du * step, v + dv * step);
        let difference = |du: f64, dv: f64, of: &dyn Fn(Point) -> DVec3| {
            (of(at(du, dv)) - of(at(-du, -dv))) / (2.0 * step)
        };
        let Point { first, second, .. } = patch.at(u, v);
        for (known, found) in [
            (difference(1.0, 0.0, &|p| p.position), first[0]),
            (difference(0.0, 1.0, &|p| p.position), first[1]),
            (difference(1.0, 0.0, &|p| p.first[0]), second[0]),
            (difference(0.0, 1.0, &|p| p.first[0]), second[1]),
            (difference(1.0, 0.0, &|p| p.first[1]), second[1]),
            (difference(0.0, 1.0, &|p| p.first[1]), second[2]),
        ] {
            assert!((known - found).length() < 1e-6, "{known} {found}");
        }
    }
    assert_eq!(patch.at(0.0, 1.0).position, patch.0[0][3]);
}

#[test]
fn normals_and_tangents_at_degenerate_edges_are_the_limits_from_within() {
    let teapot = Patches::teapot(true).unwrap();
    assert!(!teapot.outward);
    for (patches, outside) in [(20..24, DVec3::Y), (28..32, DVec3::NEG_Y)] {
        for (index, v) in patches.flat_map(|index| [0.0, 0.3, 0.5, 1.0].map(|v| (index, v))) {
            let patch = teapot.patch(index);
            assert!(patch.at(0.0, v).first[1].length() < 1e-12, "patch {index} is not degenerate");
            let (normal, tangent) = (patch.normal(0.0, v), patch.along_v(0.0, v));
            assert!((normal + outside).length() < 1e-9, "patch {index}: {normal}");
            let mut before = f64::INFINITY;
            for u in [1e-2, 1e-3, 1e-4] {
                let Point { first: [du, dv], .. } = patch.at(u, v);
                let off = (du.cross(dv).normalize() - normal).length() + (dv.normalize() - tangent).length();
                assert!(off < before && off < 10.0 * u, "patch {index} at {v}: {off} at {u}");
                before = off.max(1e-12);
            }
        }
    }
    // The same on the other side of a patch, and on its other axis.
    let lid = teapot.patch(20);
    let turned = Patch(std::array::from_fn(|i| lid.0[3 - i]));
    assert!((turned.normal(1.0, 0.4) + lid.normal(0.0, 0.4)).length() < 1e-9);
    assert!((turned.along_v(1.0, 0.4) - lid.along_v(0.0, 0.4)).length() < 1e-9);
    let across = Patch(std::array::from_fn(|i| std::array::from_fn(|j| lid.0[j][i])));
    assert!((across.normal(0.4, 0.0) + lid.normal(0.0, 0.4)).length() < 1e-9);
}

/// Edges of patches that one patch alone has, as numbers of patches.
fn open_patches(patches: &Patches) -> Vec<usize> {
    let sides = [[0, 1, 2, 3], [12, 13, 14, 15], [0, 4, 8, 12], [3, 7, 11, 15]];
    let edge = |index: usize, side: [usize; 4]| {
        let mut ends = side.map(|k| patches.patches[index][k]);
        ends.sort_unstable();
        ends
    };
    let all: Vec<_> =
        (0..patches.patches.len()).flat_map(|index| sides.map(|side| (index, edge(index, side)))).collect();
    let alone = |(_, edge): &&(usize, [u32; 4])| {
        edge[0] != edge[3] && all.iter().filter(|(_, other)| other == edge).count() == 1
    };
    all.iter().filter(alone).map(|(index, _)| *index).collect()
}

#[test]
fn the_teapot_is_closed_where_its_patches_are() {
    for (bottom, count, edges_open) in [(false, 28, 20), (true, 32, 16)] {
        let teapot = Patches::teapot(bottom).unwrap();
        assert_eq!(teapot.patches.len(), count);
        assert_eq!(open_patches(&teapot).len(), edges_open);
        for tolerance in [0.05, 0.003] {
            let (mesh, origin) = teapot.mesh(tolerance).unwrap();
            assert_eq!(origin, DVec3::ZERO);
            for [a, b] in open_edges(&mesh) {
                // Lid and rim; the spout's mouth, the roots of spout and handle inside the body; the bottom
                // where there is none.
                let ring = |p: Vec3| [1.3, 1.4].iter().any(|r| (p.x.hypot(p.z) - r).abs() < 0.02);
                let in_ring = |p: Vec3| (p.y - 2.4).abs() < 1e-5 && ring(p);
                let mouth = |p: Vec3| p.x > 2.6 && (p.y - 2.4).abs() < 1e-5;
                let root = |p: Vec3| p.z.abs() < 0.67 && (p.x.abs() - 1.5).abs() < 0.6 && p.y < 2.3;
                let base = |p: Vec3| !bottom && (p.y - 0.15).abs() < 1e-5;
                let known = |p: Vec3| in_ring(p) || mouth(p) || root(p) || base(p);
                assert!(known(a) && known(b), "{bottom}: a crack between {a} and {b}");
            }
        }
    }
}

#[test]
fn the_teapots_frames_fit_and_its_outside_is_out() {
    let (mesh, _) = Patches::teapot(true).unwrap().mesh(0.004).unwrap();
    frames_fit(&mesh);
    let (low, high) = mesh.bounds();
    assert!(low.y.abs() < 1e-6 && (high.y - 3.15).abs() < 1e-6, "{low} {high}");
    // The body, below the rim and clear of the handle, faces away from the axis.
    let body = mesh.vertices.iter().filter(|v| v.position.z.abs() > 1.2 && v.position.y < 2.0);
    assert!(body.clone().count() > 100);
    for v in body {
        assert!(v.normal.dot(Vec3::new(v.position.x, 0.0, v.position.z)) > 0.0, "{v:?}");
    }
}

/// A ring of 4 × 4 patches whose circles are the usual cubics, off by 2.7e-4 of their radius.
fn ring(turn_over: bool) -> Patches {
    const KAPPA: f64 = 0.552_284_749_830_793_4;
    let circle = |k: usize, radius: f64| {
        let [x, y] = [[1.0, 0.0], [1.0, KAPPA], [KAPPA, 1.0], [0.0, 1.0]][k % 3];
        let [x, y] = [[x, y], [-y, x], [-x, -y], [y, -x]][k / 3 % 4];
        [x * radius, y * radius]
    };
    let point = |i: usize, j: usize| {
        let [out, up] = circle(i, 0.5);
        let [x, z] = circle(j, 1.0);
        DVec3::new(x * (2.0 + out), up, z * (2.0 + out))
    };
    let points: Vec<DVec3> = (0..144).map(|k| point(k / 12, k % 12)).collect();
    let patch = |k: usize| {
        let (i, j) = (k / 4 * 3, k % 4 * 3);
        let at = |row: usize, column: usize| {
            let column = if turn_over { 3 - column } else { column };
            ((i + row) % 12 * 12 + (j + column) % 12) as u32
        };
        std::array::from_fn(|k| at(k / 4, k % 4))
    };
    Patches::new(&points, &(0..16).map(patch).collect::<Vec<_>>()).unwrap()
}

#[test]
fn a_closed_ring_of_patches_has_the_area_and_volume_of_a_torus_whichever_way_its_patches_face() {
    use std::f64::consts::{PI, TAU};
    let rings = [ring(false), ring(true)];
    assert_ne!(rings[0].outward, rings[1].outward);
    for ring in rings {
        let (mesh, _) = ring.mesh(1e-4).unwrap();
        assert!(open_edges(&mesh).is_empty());
        frames_fit(&mesh);
        let (area, volume) = (area(&mesh), volume(&mesh));
        assert!((area / (TAU * 2.0 * TAU * 0.5) - 1.0).abs() < 1e-3, "{area}");
        assert!((volume / (TAU * 2.0 * PI * 0.25) - 1.0).abs() < 2e-3, "{volume}");
    }
}

/// Distance from a patch, by Newton's method from a place of it.
fn distance(patch: &Patch, from: DVec3, [mut u, mut v]: [f64; 2]) -> f64 {
    let mut least = patch.at(u, v).position.distance(from);
    for _ in 0..8 {
        let Point { position, first: [du, dv], .. } = patch.at(u, v);
        let off = from - position;
        let (a, b, c) = (du.dot(du), du.dot(dv), dv.dot(dv));
        let determinant = a * c - b * b;
        if determinant < 1e-12 * a.max(c).powi(2) {
            break;
        }
        let (p, q) = (off.dot(du), off.dot(dv));
        u = (u + (c * p - b * q) / determinant).clamp(0.0, 1.0);
        v = (v + (a * q - b * p) / determinant).clamp(0.0, 1.0);
        least = least.min(patch.at(u, v).position.distance(from));
    }
    least
}

/// Triangles, and the largest distance of points all over them from their patches.
fn farthest(patches: &Patches, tolerance: f64) -> (usize, f64) {
    let (mut count, mut worst) = (0, 0.0f64);
    for (index, cells) in patches.cells(tolerance).unwrap().into_iter().enumerate() {
        let (patch, grid) = (patches.patch(index), patches.grid(index, cells, DVec3::ZERO));
        count += grid.triangles.len();
        for corners in grid.triangles.iter().map(|triangle| triangle.map(|i| grid.vertices[i as usize])) {
            for k in 0..12 {
                let [a, b] = [unit(2 * k), unit(2 * k + 1)];
                let weights = [1.0 - a.sqrt(), a.sqrt() * (1.0 - b), a.sqrt() * b];
                let sum = |of: &dyn Fn(&Vertex) -> DVec3| -> DVec3 {
                    corners.iter().zip(weights).map(|(corner, weight)| of(corner) * weight).sum()
                };
                let uv = sum(&|vertex| vertex.uv.as_dvec2().extend(0.0));
                let v = if patches.outward { uv.x } else { 1.0 - uv.x };
                worst = worst.max(distance(&patch, sum(&|vertex| vertex.position.as_dvec3()), [uv.y, v]));
            }
        }
    }
    (count, worst)
}

#[test]
fn triangles_of_patches_keep_within_the_tolerance_and_are_not_finer_than_it_asks() {
    let teapot = Patches::teapot(true).unwrap();
    let mut before = f64::NAN;
    for tolerance in [8e-3, 2e-3, 5e-4] {
        let (count, off) = farthest(&teapot, tolerance);
        let count = count as f64;
        assert!(off <= 1.02 * tolerance && off > 0.6 * tolerance, "{off} at {tolerance}");
        assert!(before.is_nan() || (2.0..4.8).contains(&(count / before)), "{before} {count}");
        before = count;
    }
    assert!(before < 110_000.0, "{before} triangles");
}

#[test]
fn patches_far_from_zero_keep_their_digits() {
    let near = ring(false);
    let far = DVec3::new(4_000_000.0, -700_000.0, 300.0);
    let moved: Vec<DVec3> = near.points.iter().map(|&point| point + far).collect();
    let moved = Patches::new(&moved, &near.patches).unwrap();
    let (near, _) = near.mesh(1e-3).unwrap();
    let (mesh, origin) = moved.mesh(1e-3).unwrap();
    assert!((origin - far).length() < 1e-6 && near.triangles == mesh.triangles);
    for (a, b) in near.vertices.iter().zip(&mesh.vertices) {
        assert!((a.position - b.position).length() < 1e-6 && (a.normal - b.normal).length() < 1e-5);
    }
}

#[test]
fn newells_list_from_0_and_from_1_and_patches_with_their_points_are_read_as_the_same() {
    let patch = crooked();
    let points: Vec<DVec3> = patch.0.iter().flatten().copied().collect();
    let lines = |separator: &str| -> String {
        points.iter().map(|p| format!("{}{separator}{}{separator}{}\n", p.x, p.y, p.z)).collect()
    };
    let list = |from: usize, separator: &str| {
        (0..16).map(|k| (k + from).to_string()).collect::<Vec<_>>().join(separator)
    };
    let from_0 = format!("# a patch\npatches 1\n{}\npoints 16\n{}", list(0, " "), lines(" "));
    let from_1 = format!("1\r\n{}\r\n16\r\n{}", list(1, ","), lines(", "));
    let alone = format!("1\n3 3\n{}", lines("\t"));
    for text in [from_0, from_1, alone] {
        let read = Patches::parse(&text).unwrap();
        assert_eq!((read.patches.len(), read.patch(0)), (1, patch), "{text}");
    }
    for (text, words) in [
        ("", "before the number of patches"),
        ("1\n0 1 2", "1 patches, but numbers for 0"),
        ("x", "line 1: \"x\" is not a number"),
        ("4000000000\n3 3\n0 0 0", "4000000000 patches, but numbers for 0"),
        ("1.5", "no whole number"),
        ("0\n0", "no patches"),
    ] {
        let message = Patches::parse(text).unwrap_err().to_string();
        assert!(message.contains(words), "\"{words}\" is not in: {message}");
    }
    let ones = "1\n".to_string() + &"7 ".repeat(16) + "\n1\n0 0 0\n";
    assert!(Patches::parse(&ones).unwrap_err().to_string().contains("beyond the 1"));
    let quadratic = format!("1\n2 2\n{}", "0 0 0\n".repeat(16));
    assert!(Patches::parse(&quadratic).unwrap_err().to_string().contains("only 3 and 3"));
}
