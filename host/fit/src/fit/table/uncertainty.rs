//! Standard deviations of a table's coefficients from the information matrix at the solution: σ² (JᵀJ)⁻¹ with
//! σ² from the fit's own cost, carried to first order to the coefficients as they are written.
//!
//! It holds for errors that are independent from row to row. What a model cannot describe is not: then it
//! says how well the rows determine the coefficients, not how near they are to a truth.

use super::super::linear;
use super::super::lm::Optimiser;
use super::super::model::Model;
use super::super::samples::{Samples, Target};
use super::FREEDOM;

/// Standard deviations; infinite where the rows do not tell, 0 at a bound.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Deviations {
    /// Of ρ_d, sr⁻¹.
    pub rho_d: f64,
    /// Of every lobe's ρ_s (sr⁻¹), Cx = Cy, Cz, n.
    pub lobes: Vec<[f64; 4]>,
    /// Of the microfacet term's f0, f90 and α.
    pub coat: Option<[f64; 3]>,
}

/// The coefficients as they are written: ρ_d, ρ_s, Cx, Cz, n a lobe, f0, f90, α.
fn written(model: &Model) -> Vec<f64> {
    let mut list = vec![model.diffuse];
    for lobe in &model.lobes {
        let c = lobe.c / lobe.reference;
        list.extend([lobe.amplitude, c.x, c.z, lobe.n]);
    }
    list.extend(model.coat.iter().flat_map(|coat| [coat.f0, coat.f90, coat.alpha]));
    list
}

/// The standard deviations of a fitted model's coefficients.
pub(super) fn deviations(samples: &Samples, target: &Target, model: &Model) -> Deviations {
    let mut optimiser = Optimiser::default();
    let (information, cost) = optimiser.information(samples, target, FREEDOM, model);
    let size = information.len().isqrt();
    let told: Vec<usize> = (0..size).filter(|&i| information[i * (size + 1)] > 0.0).collect();
    let held = optimiser.at_bound(model, FREEDOM, target.most);
    let free: Vec<usize> = told.iter().copied().filter(|&i| !held[i]).collect();
    let count = free.len();
    let scale = |i: usize| information[i * (size + 1)].sqrt();
    let mut factor: Vec<f64> = (0..count * count)
        .map(|k| (free[k / count], free[k % count]))
        .map(|(i, j)| information[i * size + j] / (scale(i) * scale(j)))
        .collect();
    let regular = linear::factor(&mut factor, count);
    let variance = cost / samples.len().saturating_sub(count).max(1) as f64;

    // Derivatives of what is written by the free unknowns, a row an unknown.
    let slopes: Vec<Vec<f64>> = (free.iter())
        .map(|&unknown| {
            let step = 1e-5;
            let mut at = |by: f64| written(&optimiser.moved(samples, FREEDOM, model, unknown, by));
            let (above, below) = (at(step), at(-step));
            let slope = above.iter().zip(&below).map(|(a, b)| (a - b) / (2.0 * step));
            slope.map(|slope| slope / scale(unknown)).collect()
        })
        .collect();
    let list: Vec<f64> = (0..written(model).len())
        .map(|k| {
            let gradient: Vec<f64> = slopes.iter().map(|slope| slope[k]).collect();
            let mut solved = gradient.clone();
            linear::substitute(&factor, &mut solved);
            let square: f64 = gradient.iter().zip(&solved).map(|(g, x)| g * x).sum();
            if regular { (variance * square).sqrt() } else { f64::INFINITY }
        })
        .collect();
    let lobes = 1 + 4 * model.lobes.len();
    Deviations {
        rho_d: list[0],
        lobes: list[1..lobes].as_chunks().0.to_vec(),
        coat: list[lobes..].first_chunk().copied(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::Residual;
    use super::super::super::coat::Coat;
    use super::super::super::lm::Limits;
    use super::super::super::model::ModelLobe;
    use super::super::super::testing::directions;
    use super::*;
    use glam::DVec3;
    use lobelia_base::random::Random;

    #[test]
    fn stated_deviations_are_the_spread_of_noisy_repeats() {
        const REPEATS: usize = 200;
        let mut samples = Samples::default();
        for (wi, wo) in directions(300, 3) {
            samples.push_value(wi.as_dvec3(), wo.as_dvec3(), 0.0, 1.0);
        }
        let mut lobe = ModelLobe::unit(DVec3::new(-1.0, -1.0, 0.9), 25.0).within(samples.cone());
        lobe.amplitude = 0.6;
        let coat = Some(Coat { f0: 0.05, f90: 0.6, alpha: 0.2 });
        for coat in [None, coat] {
            let truth = Model { diffuse: 0.1, lobes: vec![lobe], coat, ..Model::default() };
            let exact: Vec<f64> = (0..samples.len()).map(|k| truth.value(&samples, k)).collect();
            let mut random = Random::new(8);
            let (mut all, mut stated) = (Vec::new(), Deviations::default());
            for _ in 0..REPEATS {
                samples.value = exact.iter().map(|value| value + 1e-3 * random.normal()).collect();
                let mut target = Target::default();
                target.set(&samples, samples.value.iter().copied(), Residual::Linear);
                let mut model = truth.clone();
                let limits = Limits { iterations: 60, tolerance: 1e-9 };
                Optimiser::default().minimise(&samples, &target, FREEDOM, limits, &mut model);
                stated = deviations(&samples, &target, &model);
                all.push(written(&model));
            }
            let mut list = vec![stated.rho_d];
            list.extend(stated.lobes.iter().flatten().chain(stated.coat.iter().flatten()));
            assert_eq!(list.len(), all[0].len());
            for (k, stated) in list.into_iter().enumerate() {
                let mean = all.iter().map(|list| list[k]).sum::<f64>() / REPEATS as f64;
                let variance = all.iter().map(|list| (list[k] - mean).powi(2)).sum::<f64>();
                let ratio = stated / (variance / (REPEATS - 1) as f64).sqrt();
                // The spread of 200 is known to 5 %, σ of a repeat to 4 %.
                assert!((ratio - 1.0).abs() < 0.2, "{k}: {ratio}");
            }
        }
    }
}
