//! Colours once the shapes stand: ρ_d and every lobe's ρ_s a channel, non-negative, by least squares on the
//! fit's own residual.
//!
//! The source takes the mean ratio (4.10), one colour for all lobes, which is unstable where f̄ is near zero
//! ([`mean_ratio`], for comparison). Here every lobe gets its colour. A residual that is not linear in f is
//! linearised at the last solution and solved again, with halved steps where that would raise the cost
//! (Gauss–Newton).

use super::linear;
use super::model::{Model, Turned};
use super::samples::{Samples, Target};

/// Most linearisations of a residual that is not linear.
const ROUNDS: usize = 8;

/// Amplitudes of one channel: `x[0]` is ρ_d, then one a lobe. With `fixed_diffuse` ρ_d stays at that value.
pub(crate) fn solve(
    samples: &Samples,
    target: &Target,
    model: &Model,
    fixed_diffuse: Option<f64>,
) -> Vec<f64> {
    let first = usize::from(fixed_diffuse.is_none());
    let size = first + model.lobes.len();
    let offset = fixed_diffuse.unwrap_or(0.0);
    let columns = columns(samples, model, first);
    let mut x = vec![0.0; size];
    let system = System { samples, target, columns: &columns, offset };
    system.normal(&mut x, |k| (target.linear_weight[k], target.value[k] - offset));
    if !target.residual.is_linear() {
        system.refine(&mut x);
    }
    for amplitude in &mut x[first..] {
        *amplitude = amplitude.min(target.most);
    }
    if first == 0 {
        x.insert(0, offset);
    }
    x
}

/// The published colours (4.10): every lobe of the model, fitted to luminance, times the mean over the
/// samples of (f − ρ_d) / f̄, with f̄ the lobes' sum. Takes ρ_d from `x`, as [`solve`] gives it, and replaces
/// the rest; kept within the same bounds.
pub(crate) fn mean_ratio(samples: &Samples, target: &Target, model: &Model, x: &mut [f64]) {
    let lobes = Model { diffuse: 0.0, ..model.clone() };
    let (mut sum, mut count) = (0.0, 0.0);
    for (k, value) in target.value.iter().enumerate() {
        let fitted = lobes.value(samples, k);
        if fitted > 0.0 {
            sum += (value - x[0]) / fitted;
            count += 1.0;
        }
    }
    for (amplitude, lobe) in x[1..].iter_mut().zip(&model.lobes) {
        // A sum that overflows in both directions is no number; max makes it 0.
        *amplitude = (lobe.amplitude * sum / count).max(0.0).min(target.most);
    }
}

/// 1 (when ρ_d is unknown) and the shapes, [sample][column].
fn columns(samples: &Samples, model: &Model, first: usize) -> Vec<f64> {
    let turned = Turned::new(model.beta);
    let mut columns = Vec::with_capacity(samples.len() * (first + model.lobes.len()));
    for k in 0..samples.len() {
        columns.extend(std::iter::repeat_n(1.0, first));
        let products = turned.products(samples, k);
        columns.extend(model.lobes.iter().map(|lobe| lobe.shape(products, samples.mean_cosine(k))));
    }
    columns
}

struct System<'a> {
    samples: &'a Samples,
    target: &'a Target,
    columns: &'a [f64],
    offset: f64,
}

impl System<'_> {
    /// Solves the non-negative normal equations for squared weights and data a sample.
    fn normal(&self, x: &mut [f64], sample: impl Fn(usize) -> (f64, f64)) {
        let size = x.len();
        let (mut gram, mut rhs) = (vec![0.0; size * size], vec![0.0; size]);
        for k in 0..self.samples.len() {
            let (weight, data) = sample(k);
            let row = &self.columns[k * size..(k + 1) * size];
            for i in 0..size {
                rhs[i] += weight * row[i] * data;
                for j in 0..size {
                    gram[i * size + j] += weight * row[i] * row[j];
                }
            }
        }
        linear::nnls(&gram, &rhs, x);
    }

    fn value(&self, x: &[f64], k: usize) -> f64 {
        let row = &self.columns[k * x.len()..(k + 1) * x.len()];
        self.offset + row.iter().zip(x).map(|(s, x)| s * x).sum::<f64>()
    }

    fn cost(&self, x: &[f64]) -> f64 {
        let residual = |k: usize| {
            self.target.difference(self.value(x, k), self.samples.cos_o[k], k).0 * self.target.weight[k]
        };
        (0..self.samples.len()).map(|k| residual(k).powi(2)).sum()
    }

    fn refine(&self, x: &mut Vec<f64>) {
        let mut cost = self.cost(x);
        for _ in 0..ROUNDS {
            let mut next = vec![0.0; x.len()];
            self.normal(&mut next, |k| {
                let value = self.value(x, k);
                let (difference, slope) = self.target.difference(value, self.samples.cos_o[k], k);
                let data = value - difference / slope.max(1e-12);
                ((self.target.weight[k] * slope).powi(2), data - self.offset)
            });
            let mut lowered = false;
            for _ in 0..6 {
                let next_cost = self.cost(&next);
                if next_cost < cost {
                    lowered = cost - next_cost > 1e-6 * cost;
                    cost = next_cost;
                    x.clone_from(&next);
                    break;
                }
                for (new, old) in next.iter_mut().zip(x.iter()) {
                    *new = 0.5 * (*new + old);
                }
            }
            if !lowered {
                break;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::model::ModelLobe;
    use super::super::{Residual, testing};
    use super::*;
    use glam::DVec3;
    use lobelia_reflectance::Rgb;

    #[test]
    fn known_amplitudes_come_back_for_every_residual_and_a_fixed_diffuse_term_stays() {
        let samples = testing::samples(&testing::directions(120, 9), |_, _| Rgb::ONE);
        let lobe = |c, n| ModelLobe::over(&samples, c, n).unwrap();
        let lobes = vec![
            lobe(DVec3::new(-1.0, -1.0, 0.9), 12.0),
            lobe(DVec3::new(1.0, 1.0, 0.8), 5.0),
            lobe(DVec3::new(-1.0, -1.0, 1.0), 90.0),
        ];
        let model = Model { diffuse: 0.0, beta: 0.0, lobes, ..Model::default() };
        let mut truth = model.clone();
        truth.diffuse = 0.07;
        for (lobe, amplitude) in truth.lobes.iter_mut().zip([0.5, 0.0, 2.0]) {
            lobe.amplitude = amplitude;
        }
        for residual in Residual::ALL {
            let mut target = Target::default();
            target.set(&samples, (0..120).map(|k| truth.value(&samples, k)), residual);
            for fixed in [None, Some(0.07)] {
                let x = solve(&samples, &target, &model, fixed);
                for (found, known) in x.iter().zip([0.07, 0.5, 0.0, 2.0]) {
                    assert!((found - known).abs() < 2e-3, "{residual:?} {x:?}");
                }
            }
        }
    }
}
