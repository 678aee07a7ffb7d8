//! Normals, sharpening and microfacet terms of texels against finite differences and known materials.

use glam::{DVec2, DVec3, Vec2};

use super::super::coat::Coat;
use super::super::extensions::{Extensions, Microfacets};
use super::super::model::{Model, ModelLobe};
use super::super::testing::{self, directions, material};
use super::super::{AlbedoBound, FitOptions, Residual, fit_sbrdf};
use super::layout::{Extension, Family};
use super::normal;
use super::shape;
use super::solver::Solver;
use crate::synth::{self, Options};
use lobelia_base::random::Random;
use lobelia_reflectance::{Brdf, Lobe, LobeBrdf, Microfacet, Rgb, SbrdfMap};

fn models() -> Vec<(Family, Model)> {
    let lobe =
        |c: [f64; 3], n, n_grazing| ModelLobe { n_grazing, ..ModelLobe::unit(DVec3::from_array(c), n) };
    let of = |families: [Family; 2], normal, lobes: Vec<ModelLobe>, coat: Option<f64>| {
        let coat = coat.map(|alpha| Coat { f0: 0.0, f90: 0.0, alpha });
        families.map(|family| {
            (family, Model { beta: 0.3, normal, lobes: lobes.clone(), coat, ..Model::default() })
        })
    };
    let both = [Family::Isotropic, Family::Anisotropic];
    let (iso, aniso) = ([-1.0, -1.0, 0.8], [-1.0, -0.7, 0.8]);
    let mut all = Vec::new();
    for (family, c) in [(Family::Isotropic, iso), (Family::Anisotropic, aniso)] {
        let tilt = Some(DVec2::new(0.1, -0.06));
        let families = [family; 2];
        let retro = [0.8, 0.8, 0.6];
        all.push(of(families, tilt, vec![lobe(c, 30.0, None), lobe(retro, 4.0, None)], None)[0].clone());
        all.push(
            of(families, None, vec![lobe(c, 8.0, Some(30.0)), lobe(retro, 4.0, Some(2.0))], None)[0].clone(),
        );
        all.push(of(families, tilt, vec![lobe(c, 8.0, Some(30.0))], Some(0.25))[0].clone());
        all.push(of(families, None, vec![lobe(c, 8.0, None)], Some(0.25))[0].clone());
    }
    all.extend(of(both, None, vec![], Some(0.3)));
    all
}

/// The values of columns are those of the BRDF that a model becomes, and the gradient is that of the
/// projected cost.
#[test]
fn values_agree_with_the_brdf_and_the_gradient_with_finite_differences() {
    let truth = material(2, &mut Random::new(5));
    let pairs = directions(61, 4);
    let samples = testing::samples(&pairs, |wi, wo| truth.eval(wi, wo));
    for (case, (family, mut model)) in models().into_iter().enumerate() {
        let mut solver = Solver::default();
        solver.data.take(&samples);
        solver.data.aim(&[0, 1, 2], Residual::Linear, None);
        solver.data.most = [f64::INFINITY; 3];
        solver.begin();
        solver.refer(&mut model);
        let at = solver.evaluate(family, true, &model);
        let layout = solver.layout(family, true, &model);
        assert_eq!(layout.extension, Extension::of(&model));

        let lobes = model.lobes.len();
        let colour = |unknown: usize| Rgb::from_array(at.x.map(|x| x[unknown] as f32));
        let rho_s: Vec<Rgb> = (1..=lobes).map(colour).collect();
        let mut brdf = model.to_brdf(colour(0), &rho_s);
        brdf.microfacets.extend(model.coat.map(|coat| Microfacet {
            f0: colour(lobes + 1),
            f90: colour(lobes + 2),
            alpha: coat.alpha as f32,
        }));
        for (k, &(wi, wo)) in pairs.iter().enumerate() {
            let value: f64 =
                (0..=layout.terms()).map(|u| at.x[1][u] * solver.columns.column(layout.column(u))[k]).sum();
            let expected = f64::from(brdf.eval(wi, wo).y);
            assert!((value - expected).abs() < 1e-4 * expected + 1e-5, "{case} {k}: {value} {expected}");
        }

        let normal = normal::normal(&solver.gram, layout, &at);
        for unknown in 0..normal.size {
            let mut cost = |size: f64| {
                let mut step = [0.0; super::layout::UNKNOWNS];
                step[unknown] = size;
                let mut moved = model.clone();
                shape::advance(family, &mut moved, &step);
                solver.refer(&mut moved);
                solver.evaluate(family, true, &moved).cost
            };
            let (size, analytic) = (1e-5, 2.0 * normal.gradient[unknown]);
            let numeric = (cost(size) - cost(-size)) / (2.0 * size);
            assert!(
                (numeric - analytic).abs() < 1e-4 * analytic.abs() + 1e-6 * at.cost,
                "{case} {unknown}: {numeric} {analytic}"
            );
        }
    }
}

const NORMALS: Extensions = Extensions { normals: true, sharpening: false, microfacets: Microfacets::Never };
const SHARPENING: Extensions =
    Extensions { normals: false, sharpening: true, microfacets: Microfacets::Never };
const GGX: Extensions = Extensions { normals: false, sharpening: false, microfacets: Microfacets::Always };

/// Fits noisy samples of some materials, a texel each.
fn fitted(truth: &[LobeBrdf], noise: f64, relative_noise: f64, options: FitOptions) -> SbrdfMap {
    let sampling =
        Options { width: truth.len(), height: 1, texel_mm: 0.5, poses: 300, noise, relative_noise, seed: 3 };
    let sampled = synth::sample(&sampling, |index, _, wi, wo| truth[index].eval(wi, wo));
    fit_sbrdf(&sampled, &options).unwrap()
}

fn choice(extensions: Extensions) -> FitOptions {
    FitOptions { lobes: 3, choose: true, isotropic: false, extensions, ..FitOptions::default() }
}

fn fixed(lobes: usize, extensions: Extensions) -> FitOptions {
    FitOptions { lobes, isotropic: true, extensions, ..FitOptions::default() }
}

/// Shares of (value − truth) / σ beyond 4, over lists of values.
fn beyond(list: impl Iterator<Item = (f64, f64, f64)>) -> (usize, usize) {
    let off: Vec<f64> = list.map(|(value, truth, sigma)| (value - truth).abs() / sigma).collect();
    println!("{off:.2?}");
    (off.iter().filter(|&&off| off > 4.0).count(), off.len())
}

fn lobe(n: f32) -> Lobe {
    Lobe::new(Rgb::new(0.9, 0.7, 0.4), glam::Vec3::new(-0.95, -0.95, 1.0), n)
}

#[test]
fn a_known_tilt_is_found_within_its_stated_uncertainty() {
    let truth: Vec<LobeBrdf> = (0..24)
        .map(|k| {
            let (sin, cos) = (k as f32 * 2.4).sin_cos();
            let tilt = (10.0 * (k as f32 / 23.0)).to_radians().sin();
            let n = [6.0, 25.0, 90.0][k % 3];
            LobeBrdf {
                normal: tilt * Vec2::new(cos, sin),
                lobes: vec![lobe(n)],
                ..LobeBrdf::diffuse(Rgb::splat(0.2))
            }
        })
        .collect();
    let map = fitted(&truth, 1e-3, 0.005, fixed(1, NORMALS));
    let sigma = |axis: usize, k: usize| f64::from(map.extra[["sigma.normal.x", "sigma.normal.y"][axis]][k]);
    let both = (0..truth.len()).flat_map(|k| [0, 1].map(|axis| (k, axis)));
    let each = both
        .map(|(k, axis)| (f64::from(map.normal[k][axis]), f64::from(truth[k].normal[axis]), sigma(axis, k)));
    let (far, count) = beyond(each.clone());
    assert!(far == 0, "{far} of {count}");
    let worst = each.map(|(_, _, sigma)| sigma).fold(0.0, f64::max);
    assert!(worst < 0.03, "{worst}");
}

#[test]
fn known_sharpening_is_found_within_its_stated_uncertainty() {
    let truth: Vec<LobeBrdf> = (0..12)
        .map(|k| {
            let n = [8.0, 20.0, 40.0][k % 3];
            let n_grazing = Some(n * [0.5, 1.0, 2.0, 4.0][k / 3]);
            LobeBrdf { lobes: vec![Lobe { n_grazing, ..lobe(n) }], ..LobeBrdf::diffuse(Rgb::splat(0.2)) }
        })
        .collect();
    let map = fitted(&truth, 1e-3, 0.005, fixed(1, SHARPENING));
    let (plane, sigma) = (&map.lobes[0], &map.extra["sigma.lobe0.n_grazing"]);
    let each = (0..truth.len()).map(|k| {
        let expected = truth[k].lobes[0].n_grazing.unwrap();
        (f64::from(plane.n_grazing[k]), f64::from(expected), f64::from(sigma[k]))
    });
    let (far, count) = beyond(each.clone());
    assert!(far == 0, "{far} of {count}");
    assert!(each.clone().all(|(_, truth, sigma)| sigma < 0.15 * truth), "{:?}", each.collect::<Vec<_>>());
}

#[test]
fn a_known_microfacet_term_is_found_within_its_stated_uncertainty() {
    let truth: Vec<LobeBrdf> = (0..8)
        .map(|k| {
            let alpha = [0.1, 0.2, 0.35, 0.6][k % 4];
            let coat = Microfacet { f0: Rgb::new(0.3, 0.2, 0.08), f90: Rgb::splat(0.9), alpha };
            let lobes = if k < 4 { vec![] } else { vec![lobe(5.0)] };
            LobeBrdf { lobes, microfacets: vec![coat], ..LobeBrdf::diffuse(Rgb::splat(0.2)) }
        })
        .collect();
    for (range, lobes) in [(0..4, 0), (4..8, 1)] {
        // Some of them reflect more than they receive.
        let options = FitOptions { bound: AlbedoBound::Free, ..fixed(lobes, GGX) };
        let map = fitted(&truth[range.clone()], 1e-3, 0.005, options);
        let plane = &map.microfacets[0];
        let each = range.clone().enumerate().flat_map(|(place, k)| {
            let of = |name: &str| f64::from(map.extra[&format!("sigma.ggx0.{name}")][place]);
            let term = truth[k].microfacets[0];
            [
                (plane.alpha[place], term.alpha, of("alpha")),
                (plane.f0[place].x, term.f0.x, of("f0.R")),
                (plane.f90[place].y, term.f90.y, of("f90.G")),
            ]
            .map(|(value, truth, sigma)| (f64::from(value), f64::from(truth), sigma))
        });
        let (far, count) = beyond(each.clone());
        assert!(far == 0, "{lobes}: {far} of {count}");
    }
}

#[test]
fn stated_standard_deviations_are_those_of_100_noisy_repeats() {
    let base = |lobe: Lobe| LobeBrdf { lobes: vec![lobe], ..LobeBrdf::diffuse(Rgb::splat(0.2)) };
    let coat = Microfacet { f0: Rgb::splat(0.1), f90: Rgb::splat(0.9), alpha: 0.25 };
    let cases = [
        (LobeBrdf { normal: Vec2::new(0.08, -0.05), ..base(lobe(25.0)) }, 1, NORMALS),
        (base(Lobe { n_grazing: Some(60.0), ..lobe(12.0) }), 1, SHARPENING),
        (LobeBrdf { microfacets: vec![coat], ..LobeBrdf::diffuse(Rgb::splat(0.2)) }, 0, GGX),
    ];
    for (truth, lobes, extensions) in cases {
        let options = FitOptions { residual: Residual::Linear, ..fixed(lobes, extensions) };
        let map = fitted(&vec![truth; 100], 2e-3, 0.0, options);
        let normal = |axis: usize| map.normal.iter().map(|normal| normal[axis]).collect::<Vec<f32>>();
        let planes = match extensions {
            NORMALS => vec![("normal.x", normal(0)), ("normal.y", normal(1))],
            SHARPENING => {
                vec![("lobe0.n_grazing", map.lobes[0].n_grazing.clone()), ("lobe0.n", map.lobes[0].n.clone())]
            }
            _ => {
                let plane = &map.microfacets[0];
                let f90 = plane.f90.iter().map(|f90| f90.y).collect();
                vec![("ggx0.alpha", plane.alpha.clone()), ("ggx0.f90.G", f90)]
            }
        };
        for (name, values) in planes {
            let mean = |of: &dyn Fn(usize) -> f64| (0..100).map(of).sum::<f64>() / 100.0;
            let middle = mean(&|k| f64::from(values[k]));
            let spread = mean(&|k| (f64::from(values[k]) - middle).powi(2)).sqrt();
            let stated = mean(&|k| f64::from(map.extra[&format!("sigma.{name}")][k]));
            println!("{name}: {middle} ± {spread}, stated {stated}: {:.2}", spread / stated);
            // The spread of 100 values is known to 7 %.
            assert!((0.78..1.25).contains(&(spread / stated)), "{name}: {spread} {stated}");
        }
    }
}

#[test]
fn plain_texels_stay_plain_and_others_are_told_from_them() {
    let all = Extensions { normals: true, sharpening: true, microfacets: Microfacets::Choose };
    let plain: Vec<LobeBrdf> =
        (0..100).map(|seed| material(1 + seed % 2, &mut Random::new(seed as u64))).collect();
    let map = fitted(&plain, 2e-3, 0.005, choice(all));
    let odd = (0..plain.len())
        .filter(|&k| map.texel(k).extension().is_some() || !map.texel(k).microfacets.is_empty());
    let odd: Vec<usize> = odd.collect();
    assert!(odd.is_empty(), "{odd:?}");
    let base = |lobe: Lobe| LobeBrdf { lobes: vec![lobe], ..LobeBrdf::diffuse(Rgb::splat(0.2)) };
    let tilted = LobeBrdf { normal: Vec2::new(0.08, -0.05), ..base(lobe(25.0)) };
    let sharpening = base(Lobe { n_grazing: Some(60.0), ..lobe(12.0) });
    let coat = Microfacet { f0: Rgb::splat(0.1), f90: Rgb::ONE, alpha: 0.2 };
    let coated = LobeBrdf { microfacets: vec![coat], ..LobeBrdf::diffuse(Rgb::splat(0.2)) };
    let map = fitted(&[tilted, sharpening, coated], 1e-3, 0.005, choice(all));
    let [tilted, sharpening, coated] = [0, 1, 2].map(|k| map.texel(k));
    assert!(
        (tilted.normal - Vec2::new(0.08, -0.05)).length() < 5e-3 && tilted.lobes.len() == 1,
        "{tilted:?}"
    );
    assert!(sharpening.lobes[0].n_grazing.is_some_and(|n| (n - 60.0).abs() < 10.0), "{sharpening:?}");
    assert!(coated.lobes.is_empty() && (coated.microfacets[0].alpha - 0.2).abs() < 5e-3, "{coated:?}");
}
