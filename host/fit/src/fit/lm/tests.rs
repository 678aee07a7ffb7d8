//! The optimiser beside derivatives by differences and models that are known.

use super::super::{Residual, testing};
use super::*;
use glam::Vec3;
use lobelia_reflectance::{Brdf, Lobe, LobeBrdf, Rgb};

const EXACT: Limits = Limits { iterations: 200, tolerance: 1e-14 };

fn model(samples: &Samples) -> Model {
    let lobe = |c: DVec3, n, amplitude| ModelLobe { amplitude, ..ModelLobe::over(samples, c, n).unwrap() };
    let lobes = vec![lobe(DVec3::new(-1.0, -0.7, 0.8), 30.0, 1.3), lobe(DVec3::new(0.8, 0.9, 0.6), 4.0, 0.4)];
    Model { diffuse: 0.2, beta: 0.3, lobes, ..Model::default() }
}

/// The step of one unknown by `size`, through the optimiser's own update.
fn moved(optimiser: &mut Optimiser, model: &Model, freedom: Freedom, unknown: usize, size: f64) -> Model {
    let count = Layout::new(freedom, model).size;
    optimiser.step = vec![0.0; count];
    optimiser.step[unknown] = size;
    optimiser.stepped(model, freedom, 1e9);
    optimiser.trial.clone()
}

#[test]
fn the_gradient_agrees_with_finite_differences_of_the_cost() {
    let truth = testing::material(2, &mut lobelia_base::random::Random::new(5));
    let samples = testing::samples(&testing::directions(60, 4), |wi, wo| truth.eval(wi, wo));
    let mut optimiser = Optimiser::default();
    for residual in Residual::ALL {
        for (isotropic, sharpens) in [(false, false), (true, false), (false, true), (true, true)] {
            let freedom = Freedom { isotropic, diffuse: true };
            let mut model = model(&samples);
            if sharpens {
                model.lobes.iter_mut().for_each(|lobe| lobe.n_grazing = Some(2.5 * lobe.n));
            }
            if isotropic {
                model.beta = 0.0;
                for lobe in &mut model.lobes {
                    lobe.c = DVec3::new(lobe.c.x, lobe.c.x, lobe.c.z).normalize();
                }
            }
            let mut target = Target::default();
            target.set(&samples, samples.value.iter().copied(), residual);
            Optimiser::refer(&mut model, &samples, 1e9);
            optimiser.evaluate(&samples, &target, &model);
            optimiser.normal_equations(&samples, &target, &model, freedom);
            let gradient = optimiser.gradient.clone();
            for (unknown, &analytic) in gradient.iter().enumerate() {
                let mut at = |size| {
                    let mut model = moved(&mut optimiser, &model, freedom, unknown, size);
                    Optimiser::refer(&mut model, &samples, 1e9);
                    optimiser.evaluate(&samples, &target, &model)
                };
                let step = 1e-5;
                let numeric = (at(step) - at(-step)) / (4.0 * step);
                let tolerance = 1e-5 * analytic.abs() + 1e-6;
                assert!(
                    (numeric - analytic).abs() < tolerance,
                    "{residual:?} {unknown}: {numeric} {analytic}"
                );
            }
        }
    }
}

#[test]
fn an_anisotropic_lobe_without_noise_is_recovered_with_its_direction() {
    let lobe = Lobe::new(Rgb::splat(0.7), Vec3::new(-0.95, -0.6, 0.9), 20.0);
    let truth = LobeBrdf { rho_d: Rgb::splat(0.05), beta: 0.4, lobes: vec![lobe], ..LobeBrdf::default() };
    let samples = testing::samples(&testing::directions(200, 8), |wi, wo| truth.eval(wi, wo));
    let mut target = Target::default();
    target.set(&samples, samples.value.iter().copied(), Residual::Linear);
    let mut model = Model {
        diffuse: 0.1,
        beta: 0.0,
        lobes: vec![start_lobe(&samples, DVec3::new(-1.0, -0.8, 1.0), 8.0)],
        ..Model::default()
    };
    let freedom = Freedom { isotropic: false, diffuse: true };
    let outcome = Optimiser::default().minimise(&samples, &target, freedom, EXACT, &mut model);
    assert!(outcome.converged);
    let fitted = model.to_brdf(Rgb::splat(0.05), &[Rgb::splat(model.lobes[0].amplitude as f32)]);
    assert!((fitted.beta - 0.4).abs() < 1e-3, "{fitted:?}");
    assert!((fitted.lobes[0].n - 20.0).abs() < 1e-2, "{fitted:?}");
    assert!((model.diffuse - 0.05).abs() < 1e-5);
}

#[test]
fn an_exponent_of_thousands_neither_overflows_nor_turns_into_nan() {
    let samples = testing::samples(&testing::directions(100, 2), |_, _| Rgb::ONE);
    let mut target = Target::default();
    target.set(&samples, samples.value.iter().copied(), Residual::Linear);
    for n in EXPONENTS {
        let lobe = start_lobe(&samples, DVec3::new(-1.0, -1.0, 1.0), n);
        let mut model = Model { diffuse: 0.0, beta: 0.0, lobes: vec![lobe], ..Model::default() };
        let freedom = Freedom { isotropic: true, diffuse: true };
        let outcome = Optimiser::default().minimise(&samples, &target, freedom, EXACT, &mut model);
        assert!(outcome.cost < 1e-6, "{outcome:?} {model:?}");
        assert!(model.diffuse.is_finite() && model.lobes[0].n.is_finite());
    }
}
