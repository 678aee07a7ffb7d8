//! The bound on albedo against finite differences, against the penalty method of
//! [`conserve`](super::super::conserve), and on known materials.

use glam::{DVec2, DVec3, Vec3};

use super::super::coat::Coat;
use super::super::extensions::{Extensions, Microfacets};
use super::super::model::{Model, ModelLobe};
use super::super::samples::{Samples, Target};
use super::super::testing::{directions, material, measured, samples};
use super::super::{AlbedoBound, FitOptions, Residual, conserve};
use super::bound::Bound;
use super::layout::{CHANNELS, Family};
use super::normal::Pressing;
use super::shape;
use super::solver::Solver;
use super::texel::Workspace;
use lobelia_base::random::Random;
use lobelia_reflectance::{Brdf, Lobe, LobeBrdf, Rgb, albedo};

const BOUND: Bound = Bound { albedo: 1.0, fixed: [0.0; CHANNELS] };

/// A material that makes light toward grazing.
fn bright(y: f32) -> LobeBrdf {
    let lobe = Lobe::new(Rgb::new(2.4, 2.0, 1.6), Vec3::new(-1.1, y, 0.9), 6.0);
    LobeBrdf { lobes: vec![lobe], ..LobeBrdf::diffuse(Rgb::new(0.2, 0.1, 0.02)) }
}

#[test]
fn the_gradient_under_the_bound_agrees_with_finite_differences() {
    let lobe =
        |c: [f64; 3], n, n_grazing| ModelLobe { n_grazing, ..ModelLobe::unit(DVec3::from_array(c), n) };
    let iso = [-1.1, -1.1, 0.9];
    let aniso = [-1.1, -0.8, 0.9];
    let cases = [
        (Family::Isotropic, vec![lobe(iso, 6.0, None)], None, None),
        (Family::Isotropic, vec![lobe(iso, 9.0, None), lobe([0.8, 0.8, 0.7], 3.0, None)], None, None),
        (Family::Anisotropic, vec![lobe(aniso, 6.0, None), lobe([0.8, 0.7, 0.7], 3.0, None)], None, None),
        (Family::Anisotropic, vec![lobe(aniso, 6.0, None)], Some(DVec2::new(0.05, -0.1)), None),
        (Family::Isotropic, vec![lobe(iso, 5.0, Some(11.0))], None, None),
        (Family::Isotropic, vec![lobe(iso, 7.0, None)], None, Some(0.3)),
    ];
    let data = samples(&directions(90, 4), |wi, wo| bright(-0.9).eval(wi, wo));
    for (case, (family, lobes, normal, coat)) in cases.into_iter().enumerate() {
        let coat = coat.map(|alpha| Coat { f0: 0.0, f90: 0.0, alpha });
        let mut model = Model { beta: 0.3, normal, lobes, coat, ..Model::default() };
        let mut solver = Solver::default();
        solver.data.take(&data);
        solver.data.aim(&[0, 1, 2], Residual::Linear, None);
        solver.begin();
        solver.hold(Some(BOUND));
        solver.refer(&mut model);
        let at = solver.evaluate(family, true, &model);
        assert!(at.pressing.iter().any(|pressing| !pressing.is_empty()), "case {case}");
        assert!(solver.excess((family, true), &model, &at, BOUND) < 1.0 + 1e-6, "case {case}");
        let normal = solver.normal(solver.layout(family, true, &model), &model, &at);
        for unknown in 0..normal.size {
            let mut moved = |by: f64| {
                let mut step = [0.0; super::layout::UNKNOWNS];
                step[unknown] = by;
                let mut model = model.clone();
                shape::advance(family, &mut model, &step);
                solver.refer(&mut model);
                solver.evaluate(family, true, &model)
            };
            let (ahead, behind) = (moved(1e-4), moved(-1e-4));
            let same = |a: &[Pressing; 3]| *a == at.pressing;
            if !same(&ahead.pressing) || !same(&behind.pressing) {
                continue;
            }
            let numeric = (ahead.cost - behind.cost) / 4e-4;
            let found = normal.gradient[unknown];
            assert!(
                (numeric - found).abs() < 2e-2 * (numeric.abs() + 1e-2 * at.cost),
                "case {case}, unknown {unknown}: {numeric} {found}"
            );
        }
    }
}

fn fit(data: &Samples, options: &FitOptions) -> (LobeBrdf, f64, Option<f64>) {
    let mut workspace = Workspace::default();
    workspace.take(data);
    let fit = workspace.fit(options);
    (fit.brdf, fit.rms, fit.bound_price)
}

fn targets(data: &Samples, residual: Residual) -> Vec<Target> {
    let of = |channel: usize| {
        let mut target = Target::default();
        target.set(data, data.rgb.iter().map(|rgb| rgb[channel]), residual);
        target
    };
    (0..3).map(of).collect()
}

/// The weighted squared residuals of a BRDF.
fn cost(brdf: &LobeBrdf, data: &Samples, pairs: &[(Vec3, Vec3)], targets: &[Target]) -> f64 {
    let of = |(k, &(wi, wo)): (usize, &(Vec3, Vec3))| {
        let off = brdf.eval(wi, wo).as_dvec3() - DVec3::from_array(data.rgb[k]);
        [0, 1, 2].map(|channel| (targets[channel].weight[k] * off[channel]).powi(2)).iter().sum::<f64>()
    };
    pairs.iter().enumerate().map(of).sum()
}

/// The largest albedo at incidences between those that are held.
fn largest_between(brdf: &LobeBrdf) -> f32 {
    let at = |degrees: f32, turn: f32| {
        let ((sin, cos), (y, x)) = (degrees.to_radians().sin_cos(), (turn + brdf.beta).sin_cos());
        albedo::directional(brdf, Vec3::new(sin * x, sin * y, cos)).max_element()
    };
    let turns = [0.0f32, 0.3, 0.9, 1.4, 2.2, 3.6, 5.0];
    (0..180).flat_map(|k| turns.map(|turn| at(0.5 * k as f32, turn))).fold(0.0, f32::max)
}

#[test]
fn materials_that_make_light_are_held_at_all_incidences_and_at_no_more_cost_than_by_penalties() {
    for (truth, options) in [
        (bright(-1.1), FitOptions { lobes: 1, ..FitOptions::default() }),
        (bright(-0.8), FitOptions { lobes: 1, isotropic: false, ..FitOptions::default() }),
        (bright(-1.1), FitOptions { lobes: 2, ..FitOptions::default() }),
        (bright(-1.1), FitOptions { lobes: 1, separate_channels: true, ..FitOptions::default() }),
        (bright(-1.1), FitOptions { lobes: 4, choose: true, ..FitOptions::default() }),
    ] {
        let options = FitOptions { bound: AlbedoBound::Conserved, ..options };
        let data = measured(&directions(200, 5), &truth, 0.0, &mut Random::new(4));
        let (held, rms, price) = fit(&data, &options);
        let largest = largest_between(&held);
        assert!(largest < 1.012 && price.is_some(), "{largest} {price:?} {options:?}");
        let (free, free_rms, _) = fit(&data, &FitOptions { bound: AlbedoBound::Free, ..options });
        assert!(largest_between(&free) > 1.05, "{options:?}");
        let targets = targets(&data, options.residual);
        let by_penalties = conserve::conserve(&free, &data, &[0, 1, 2], &targets, 1.0).unwrap();
        let cost = |brdf: &LobeBrdf| cost(brdf, &data, &directions(200, 5), &targets);
        let (ours, theirs) = (cost(&held), cost(&by_penalties));
        println!("{options:?}: {ours:.4} {theirs:.4}, rms {rms:.5}, free {free_rms:.5}");
        assert!(ours < 1.05 * theirs, "{ours} {theirs} {options:?}");
    }
}

#[test]
fn fits_that_make_no_light_are_the_same_with_and_without_the_bound() {
    for seed in 0..20 {
        let truth = material(1 + seed as usize % 2, &mut Random::new(seed));
        let data = measured(&directions(250, seed), &truth, 0.05, &mut Random::new(seed));
        let options = FitOptions { lobes: 2, isotropic: seed % 3 > 0, ..FitOptions::default() };
        let (bounded, _, price) = fit(&data, &options);
        let (free, _, _) = fit(&data, &FitOptions { bound: AlbedoBound::Free, ..options });
        assert!(albedo::largest(&bounded).max_element() <= 1.02);
        if price.is_none() {
            assert_eq!(bounded, free);
        }
    }
}

#[test]
fn normals_sharpening_and_microfacet_terms_are_held_too() {
    let mut tilted = bright(-1.1);
    tilted.normal = glam::Vec2::new(0.1, -0.05);
    let mut sharpening = bright(-1.1);
    sharpening.lobes[0].n_grazing = Some(14.0);
    let coat = lobelia_reflectance::Microfacet { f0: Rgb::splat(0.6), f90: Rgb::ONE, alpha: 0.25 };
    let coated = LobeBrdf { microfacets: vec![coat], ..LobeBrdf::diffuse(Rgb::splat(0.7)) };
    let none = Extensions::default();
    for (truth, extensions) in [
        (tilted, Extensions { normals: true, ..none }),
        (sharpening, Extensions { sharpening: true, ..none }),
        (coated, Extensions { microfacets: Microfacets::Always, ..none }),
    ] {
        let options =
            FitOptions { lobes: 1, extensions, bound: AlbedoBound::Conserved, ..FitOptions::default() };
        let data = measured(&directions(250, 8), &truth, 0.0, &mut Random::new(4));
        let (held, _, price) = fit(&data, &options);
        let (free, ..) = fit(&data, &FitOptions { bound: AlbedoBound::Free, ..options });
        assert!(price.is_some(), "{} {free:?}", largest_between(&free));
        let largest = largest_between(&held);
        assert!(largest < 1.02, "{largest} {extensions:?}");
        // Darkened until it makes no light, the free fit would leave more.
        let factor = 1.0 / largest_between(&free);
        let mut darker = free.clone();
        darker.rho_d *= factor;
        darker.lobes.iter_mut().for_each(|lobe| lobe.rho_s *= factor);
        darker
            .microfacets
            .iter_mut()
            .for_each(|coat| (coat.f0, coat.f90) = (coat.f0 * factor, coat.f90 * factor));
        let targets = targets(&data, options.residual);
        let [held, free, darker] =
            [&held, &free, &darker].map(|brdf| cost(brdf, &data, &directions(250, 8), &targets));
        println!("{extensions:?}: {largest}, cost {held:.3}, free {free:.3}, darkened {darker:.3}");
        assert!(held < darker && held > free, "{extensions:?}");
    }
}

#[test]
fn a_lobe_that_only_fits_noise_says_nothing_loud_where_no_pose_looked() {
    let mut random = Random::new(6);
    let mut anywhere = || {
        let mut direction = || {
            let (z, turn) = (random.uniform(0.01, 1.0), random.uniform(0.0, std::f64::consts::TAU));
            let r = (1.0 - z * z).sqrt();
            DVec3::new(r * turn.cos(), r * turn.sin(), z).as_vec3()
        };
        (direction(), direction())
    };
    let pairs: Vec<(Vec3, Vec3)> = (0..4000).map(|_| anywhere()).collect();
    let lobe = Lobe::new(Rgb::splat(0.15), Vec3::new(-1.03, -1.03, 0.85), 8.0);
    let truth = LobeBrdf { lobes: vec![lobe], ..LobeBrdf::diffuse(Rgb::splat(0.09)) };
    let loudest =
        |brdf: &LobeBrdf| pairs.iter().map(|&(wi, wo)| brdf.eval(wi, wo).max_element()).fold(0.0, f32::max);
    let most = loudest(&truth);
    let [mut quiet, mut free_quiet] = [0; 2];
    for seed in 0..60 {
        let data = measured(&directions(134, seed), &truth, 0.1, &mut Random::new(seed));
        let options = FitOptions { lobes: 2, ..FitOptions::default() };
        let free = fit(&data, &FitOptions { bound: AlbedoBound::Free, ..options }).0;
        let [held, free] = [fit(&data, &options).0, free].map(|brdf| loudest(&brdf));
        println!("{seed}: {held:.2}, free {free:.2e} of {most:.2}");
        quiet += usize::from(held < 2.0 * most);
        free_quiet += usize::from(free < 2.0 * most);
    }
    // The rest are lobes that errors of direction tell from noise.
    assert!(quiet >= 57 && quiet > free_quiet, "{quiet} {free_quiet}");
}
