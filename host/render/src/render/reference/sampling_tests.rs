//! Chi-square tests of every sampler against the density that it claims. Significance 0.01 over all tests of
//! a kind (Šidák's correction).

use std::f32::consts::{PI, TAU};

use glam::Vec3;

use super::emitters::{Emitter, Emitters};
use super::environment::Sampled;
use super::lobes;
use super::rectangle::Rectangle;
use super::triangle::Triangle;
use crate::render::materials::{Materials, Shader};
use crate::render::sampler::hash;
use crate::scene::{Environment, Material, showcase};
use lobelia_reflectance::{AshikhminShirley, Lobe, LobeBrdf, Microfacet, Rgb, materials};

const SAMPLES: u32 = 100_000;

/// Independent numbers in 0..1, four an index; a low-discrepancy sequence would fit its cells too well.
fn numbers(index: u32) -> [f32; 4] {
    std::array::from_fn(|k| (hash(index.wrapping_mul(4) + k as u32 + 0x1234_5678) >> 8) as f32 / 16_777_216.0)
}

/// Statistics of one test: chi-square as a standard normal deviate (Wilson and Hilferty 1931). Cells that
/// expect fewer than ten samples are taken together.
fn deviate(counts: &[f64], expected: &[f64]) -> f64 {
    let (mut chi, mut cells, mut rest) = (0.0, 0, (0.0, 0.0));
    for (&count, &expected) in counts.iter().zip(expected) {
        if expected < 10.0 {
            rest = (rest.0 + count, rest.1 + expected);
        } else {
            chi += (count - expected) * (count - expected) / expected;
            cells += 1;
        }
    }
    if rest.1 >= 10.0 {
        chi += (rest.0 - rest.1) * (rest.0 - rest.1) / rest.1;
        cells += 1;
    } else {
        assert!(rest.0 < 40.0, "{} samples where {} are expected", rest.0, rest.1);
    }
    let degrees = f64::from(cells - 1).max(1.0);
    let spread = 2.0 / (9.0 * degrees);
    ((chi / degrees).cbrt() - (1.0 - spread)) / spread.sqrt()
}

/// The deviate that all of `tests` stay below with probability 0.99.
fn limit(tests: usize) -> f64 {
    // Quantiles of the normal distribution at about 0.01 / tests.
    match tests {
        0..=1 => 2.326,
        2..=4 => 2.806,
        5..=10 => 3.090,
        11..=20 => 3.291,
        21..=40 => 3.481,
        _ => 3.719,
    }
}

/// Cells of the upper hemisphere, even in cosine and azimuth, and one for all below.
const CELLS: (usize, usize) = (16, 32);

fn cell_of(direction: Vec3) -> usize {
    if direction.z <= 0.0 {
        return CELLS.0 * CELLS.1;
    }
    let azimuth = (direction.y.atan2(direction.x) / TAU + 1.0).fract();
    let (i, j) = ((direction.z * CELLS.0 as f32) as usize, (azimuth * CELLS.1 as f32) as usize);
    i.min(CELLS.0 - 1) * CELLS.1 + j.min(CELLS.1 - 1)
}

/// Integrals of the mixture's density over the cells.
fn expected(shader: &Shader) -> Vec<f64> {
    const PARTS: usize = 16;
    let mut cells = vec![0.0; CELLS.0 * CELLS.1 + 1];
    let (rows, columns) = (CELLS.0 * PARTS, CELLS.1 * PARTS);
    let measure = f64::from(TAU) / (rows * columns) as f64;
    for i in 0..rows {
        let z = (i as f32 + 0.5) / rows as f32;
        let radius = (1.0 - z * z).sqrt();
        for j in 0..columns {
            let (sin, cos) = ((j as f32 + 0.5) / columns as f32 * TAU).sin_cos();
            let direction = Vec3::new(radius * cos, radius * sin, z);
            cells[cell_of(direction)] += f64::from(shader.eval_and_density(direction).1) * measure;
        }
    }
    let above: f64 = cells.iter().sum();
    cells[CELLS.0 * CELLS.1] = 1.0 - above;
    cells
}

#[test]
fn lobes_are_sampled_with_their_density() {
    let lobe = |c: [f32; 3], n: f32| Lobe::new(Rgb::splat(0.3), Vec3::from_array(c), n);
    let with =
        |lobes: Vec<Lobe>| LobeBrdf { rho_d: Rgb::splat(0.05), beta: 0.5, lobes, ..LobeBrdf::default() };
    let coated = |alpha: f32| LobeBrdf {
        microfacets: vec![Microfacet { f0: Rgb::splat(0.5), f90: Rgb::ONE, alpha }],
        ..with(vec![lobe([-1.0, -1.0, 1.0], 10.0)])
    };
    let tilted =
        LobeBrdf { normal: glam::Vec2::new(0.2, -0.25), ..with(vec![lobe([-1.0, -0.7, 0.9], 25.0)]) };
    let sharpening = |n, grazing| Lobe { n_grazing: Some(grazing), ..lobe([-1.0, -1.0, 1.0], n) };
    let brdfs = [
        tilted,
        with(vec![sharpening(10.0, 80.0)]),
        with(vec![sharpening(60.0, 8.0)]),
        LobeBrdf::diffuse(Rgb::splat(0.5)),
        with(vec![lobe([-1.0, -1.0, 1.0], 30.0)]),
        with(vec![lobe([-1.1, -0.4, 0.7], 12.0)]),
        with(vec![lobe([0.8, 0.6, 0.9], 5.0), lobe([-1.0, 0.9, 0.2], 2.0)]),
        with(vec![lobe([-1.0, -1.0, 1.0], 100.0), lobe([-1.0, -1.0, 0.3], 0.5)]),
        coated(0.15),
        coated(0.6),
        materials::published("clay").unwrap(),
        materials::published("blue-paint").unwrap(),
        materials::published("primer").unwrap(),
    ];
    let views = [Vec3::new(0.1, 0.0, 1.0), Vec3::new(-0.8, 0.3, 0.5), Vec3::new(0.9, -0.5, 0.08)];
    let mut scene = showcase::published(4, 4);
    scene.objects.truncate(1);
    let limit = limit(brdfs.len() * views.len());
    for (name, brdf) in brdfs.into_iter().enumerate() {
        scene.objects[0].material = Material::uniform(brdf);
        let packed = Materials::new(&scene);
        let mut shader = Shader::new();
        for (view, wo) in views.iter().enumerate() {
            shader.aim(&packed, 0, wo.normalize(), true);
            let mut counts = vec![0.0; CELLS.0 * CELLS.1 + 1];
            for index in 0..SAMPLES {
                let [choice, r, s, _] = numbers(index);
                let wi = lobes::sample(&shader, choice, [r, s]);
                assert!((wi.length() - 1.0).abs() < 1e-4);
                counts[cell_of(wi)] += 1.0;
            }
            let expected: Vec<f64> = expected(&shader).iter().map(|p| p * f64::from(SAMPLES)).collect();
            // No more than a lobe that lies half below the horizon loses.
            assert!(
                counts[CELLS.0 * CELLS.1] < 0.6 * f64::from(SAMPLES),
                "material {name}, view {view} wastes samples"
            );
            let deviate = deviate(&counts, &expected);
            assert!(deviate < limit, "material {name}, view {view}: {deviate} > {limit}");
        }
    }
}

#[test]
fn environments_are_sampled_with_their_density_a_sun_of_1e5_included() {
    let (width, height) = (24, 12);
    let sun = |d: Vec3| if d.dot(Vec3::new(0.5, 0.6, 0.3).normalize()) > 0.99 { 1e5 } else { 0.0 };
    let environments = [
        Environment::uniform(Rgb::ONE),
        Environment::from_function(width, height, |d| Rgb::splat(0.5 + 0.4 * d.x)),
        Environment::from_function(width, height, |d| Rgb::new(0.2, 0.1 + d.y.abs(), sun(d))),
    ];
    for (name, environment) in environments.iter().enumerate() {
        let sampled = Sampled::new(environment).unwrap();
        let (width, height) = (environment.width, environment.height);
        let mut counts = vec![0.0; width * height];
        for index in 0..SAMPLES {
            let [r, s, ..] = numbers(index);
            let direction = sampled.sample([r, s]).direction;
            let x = (0.5 + direction.x.atan2(-direction.z) / TAU) * width as f32;
            let y = direction.y.acos() / PI * height as f32;
            counts[(y as usize).min(height - 1) * width + (x as usize).min(width - 1)] += 1.0;
        }
        let expected: Vec<f64> = (0..width * height)
            .map(|i| {
                let (x, y) = ((i % width) as f32 + 0.5, i / width);
                let edge = |row: usize| (PI * row as f32 / height as f32).cos();
                let solid_angle = TAU / width as f32 * (edge(y) - edge(y + 1));
                let (polar, azimuth) =
                    (PI * (y as f32 + 0.5) / height as f32, (x / width as f32 - 0.5) * TAU);
                let middle =
                    Vec3::new(polar.sin() * azimuth.sin(), polar.cos(), -polar.sin() * azimuth.cos());
                f64::from(sampled.arriving(middle).density * solid_angle) * f64::from(SAMPLES)
            })
            .collect();
        let deviate = deviate(&counts, &expected);
        assert!(deviate < limit(environments.len()), "environment {name}: {deviate}");
    }
}

#[test]
fn rectangles_are_sampled_evenly_over_their_solid_angle() {
    let rectangles = [
        (Vec3::new(0.0, 0.0, 1.0), [Vec3::X, Vec3::NEG_Y]),
        (Vec3::new(1.0, -0.4, 0.3), [Vec3::new(0.3, 0.0, 1.0), Vec3::new(0.0, 2.0, 0.0)]),
        (Vec3::new(0.2, 0.1, 0.05), [Vec3::X * 3.0, Vec3::NEG_Y * 0.5]),
        (Vec3::new(20.0, 0.0, 40.0), [Vec3::X * 0.5, Vec3::NEG_Y * 0.7]),
    ];
    const SIDE: usize = 12;
    const PARTS: usize = 64;
    for (name, &(centre, [u, v])) in rectangles.iter().enumerate() {
        let light = Rectangle::new(centre, [u, v]);
        let seen = light.seen(Vec3::ZERO).unwrap();
        assert!(Rectangle::new(centre, [v, u]).seen(Vec3::ZERO).is_none(), "{name} shines backwards");
        let cell = |x: f32| ((x * SIDE as f32) as usize).min(SIDE - 1);
        let mut counts = vec![0.0; SIDE * SIDE];
        for index in 0..SAMPLES {
            let [r, s, ..] = numbers(index);
            let from_corner = seen.sample([r, s]) - centre + (u + v) / 2.0;
            let (x, y) = (from_corner.dot(u) / u.length_squared(), from_corner.dot(v) / v.length_squared());
            assert!(x > -1e-3 && x < 1.001 && y > -1e-3 && y < 1.001, "{x} {y} lies outside");
            counts[cell(y) * SIDE + cell(x)] += 1.0;
        }
        let mut expected = vec![0.0; SIDE * SIDE];
        let (normal, fine) = (u.cross(v), SIDE * PARTS);
        for (i, j) in (0..fine).flat_map(|i| (0..fine).map(move |j| (i, j))) {
            let at = |k: usize| (k as f32 + 0.5) / fine as f32;
            let to = centre + u * (at(j) - 0.5) + v * (at(i) - 0.5);
            let solid_angle = normal.dot(-to) / to.length().powi(3) / (fine * fine) as f32;
            expected[cell(at(i)) * SIDE + cell(at(j))] += f64::from(solid_angle);
        }
        let total: f64 = expected.iter().sum();
        assert!((total / f64::from(seen.solid_angle()) - 1.0).abs() < 2e-3, "{total} {}", seen.solid_angle());
        expected.iter_mut().for_each(|part| *part *= f64::from(SAMPLES) / total);
        let deviate = deviate(&counts, &expected);
        assert!(deviate < limit(rectangles.len()), "rectangle {name}: {deviate}");
    }
}

#[test]
fn the_brdf_of_ashikhmin_and_shirley_is_sampled_with_its_density() {
    let brdf = |n_u: f32, n_v: f32, diffuse: f32| AshikhminShirley {
        diffuse: Rgb::splat(diffuse),
        specular: Rgb::splat(0.3),
        exponents: glam::Vec2::new(n_u, n_v),
        axis: glam::Vec2::from_angle(0.7),
    };
    let brdfs = [brdf(10.0, 100.0, 0.5), brdf(30.0, 30.0, 0.0), brdf(0.0, 5.0, 0.8)];
    let views = [Vec3::new(0.1, 0.0, 1.0), Vec3::new(-0.8, 0.3, 0.5), Vec3::new(0.9, -0.5, 0.1)];
    for (name, brdf) in brdfs.iter().enumerate() {
        for (view, wo) in views.iter().enumerate() {
            let mut shader = Shader::new();
            shader.aim_other(brdf, wo.normalize());
            let mut counts = vec![0.0; CELLS.0 * CELLS.1 + 1];
            for index in 0..SAMPLES {
                let [choice, r, s, _] = numbers(index);
                counts[cell_of(lobes::sample(&shader, choice, [r, s]))] += 1.0;
            }
            let expected: Vec<f64> = expected(&shader).iter().map(|p| p * f64::from(SAMPLES)).collect();
            let deviate = deviate(&counts, &expected);
            assert!(deviate < limit(9), "brdf {name}, view {view}: {deviate}");
        }
    }
}

#[test]
fn triangles_are_sampled_with_their_density_near_and_far() {
    let triangles = [
        [Vec3::new(-1.0, -1.0, 1.0), Vec3::new(0.0, 2.0, 1.0), Vec3::new(1.0, -1.0, 1.0)],
        [Vec3::new(0.3, 0.1, 0.05), Vec3::new(-2.0, 1.0, 0.4), Vec3::new(1.0, 3.0, 0.2)],
        [Vec3::new(5.0, 0.0, 30.0), Vec3::new(5.0, 1.0, 30.5), Vec3::new(6.0, 0.0, 30.0)],
        // From the edge of where both ways of sampling meet.
        [Vec3::new(0.0, 0.0, 20.0), Vec3::new(0.0, 1.0, 20.0), Vec3::new(1.0, 0.0, 20.0)],
    ];
    const SIDE: usize = 12;
    const PARTS: usize = 64;
    for (name, corners) in triangles.into_iter().enumerate() {
        let [a, b, c] = corners;
        let turned = Triangle::new([a, c, b]).unwrap();
        let triangle = Triangle::new(corners).unwrap();
        let (triangle, away) =
            if triangle.seen(Vec3::ZERO).is_some() { (triangle, turned) } else { (turned, triangle) };
        let seen = triangle.seen(Vec3::ZERO).unwrap();
        assert!(away.seen(Vec3::ZERO).is_none(), "{name} shines backwards");
        let square = |x: f32, y: f32| {
            let cell = |x: f32| ((x * SIDE as f32) as usize).min(SIDE - 1);
            cell(x) * SIDE + cell(y)
        };
        let mut counts = vec![0.0; SIDE * SIDE];
        for index in 0..SAMPLES {
            let [r, s, ..] = numbers(index);
            let to = seen.sample([r, s]);
            let normal = (b - a).cross(c - a);
            let x = (to - a).cross(c - a).dot(normal) / normal.length_squared();
            let y = (b - a).cross(to - a).dot(normal) / normal.length_squared();
            assert!(x > -1e-3 && y > -1e-3 && x + y < 1.001, "{name}: {x} {y} lies outside");
            counts[square(x, y)] += 1.0;
        }
        let mut expected = vec![0.0; SIDE * SIDE];
        let fine = SIDE * PARTS;
        let area = (b - a).cross(c - a);
        for (i, j) in (0..fine).flat_map(|i| (0..fine).map(move |j| (i, j))) {
            let at = |k: usize| (k as f32 + 0.5) / fine as f32;
            let (x, y) = (at(i), at(j));
            // Half of the cells on the diagonal is within.
            let share = if i + j + 1 < fine {
                1.0
            } else if i + j + 1 == fine {
                0.5
            } else {
                continue;
            };
            let to = a + (b - a) * x + (c - a) * y;
            let solid_angle = area.dot(to).abs() / to.length().powi(3) / (fine * fine) as f32;
            expected[square(x, y)] += f64::from(share * seen.density(to) * solid_angle);
        }
        let total: f64 = expected.iter().sum();
        assert!((total - 1.0).abs() < 5e-3, "{name}: the density integrates to {total}");
        expected.iter_mut().for_each(|part| *part *= f64::from(SAMPLES) / total);
        let deviate = deviate(&counts, &expected);
        assert!(deviate < limit(triangles.len()), "triangle {name}: {deviate}");
    }
}

#[test]
fn the_tree_of_emitters_chooses_with_the_probabilities_that_it_tells() {
    let random = |k: u32| numbers(k).map(|x| 2.0 * x - 1.0);
    let mut emitters: Vec<Emitter> = (0..200)
        .filter_map(|k| {
            let [x, y, z, power] = random(3 * k);
            let [a, b, c, d] = random(3 * k + 1);
            let at = Vec3::new(x, y, z) * 3.0;
            let corners = [at, at + Vec3::new(a, b, c) * 0.3, at + Vec3::new(c, d, a) * 0.3];
            Emitter::triangle(corners, k, Rgb::splat(power.abs()))
        })
        .collect();
    let (centre, edges) = (Vec3::Y * 4.0, [Vec3::X, Vec3::Z]);
    let [u, v] = edges;
    emitters.push(Emitter::rectangle(Rectangle::new(centre, edges), [centre, u, v], Rgb::ONE));
    let tree = Emitters::new(emitters);
    for (point, normal) in [
        (Vec3::ZERO, Vec3::Y),
        (Vec3::new(1.0, -2.0, 0.5), Vec3::new(0.3, 0.4, -0.8).normalize()),
        (Vec3::new(-20.0, 3.0, 1.0), Vec3::X),
    ] {
        // The last one is for none: a bound of two halves is wider than either's.
        let mut counts = vec![0.0; tree.emitters.len() + 1];
        for index in 0..SAMPLES {
            let [number, ..] = numbers(index);
            let Some(chosen) = tree.choose(point, normal, number) else {
                counts[tree.emitters.len()] += 1.0;
                continue;
            };
            let told = tree.probability(chosen.emitter, point, normal);
            assert!((chosen.probability / told - 1.0).abs() < 1e-4 && (0.0..1.0).contains(&chosen.rest));
            counts[chosen.emitter as usize] += 1.0;
        }
        let emitters = 0..tree.emitters.len() as u32;
        let mut probabilities: Vec<f64> =
            emitters.map(|k| f64::from(tree.probability(k, point, normal))).collect();
        let sum: f64 = probabilities.iter().sum();
        assert!((0.7..1.0 + 1e-4).contains(&sum), "{point}: {sum}");
        probabilities.push(1.0 - sum);
        let expected: Vec<f64> = probabilities.iter().map(|p| p * f64::from(SAMPLES)).collect();
        let deviate = deviate(&counts, &expected);
        assert!(deviate < limit(3), "{point}: {deviate}");
    }
}
