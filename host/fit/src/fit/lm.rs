//! Levenberg–Marquardt over the diffuse term and any number of lobes, with an analytic Jacobian.
//!
//! Unknowns: ρ_d, and for every lobe its amplitude A, ln n and the direction of C (one angle when isotropic,
//! two tangent coordinates else, updated on the unit sphere), of one that sharpens ln n₀; β when anisotropic;
//! f0, f90 and ln α of a microfacet term last. Amplitudes and ρ_d stay ≥ 0, amplitudes below
//! [`MOST_OVER_SEEN`](super::samples::MOST_OVER_SEEN) times the largest value: an unknown at its bound with
//! the gradient pushing outward is frozen for that step. Damping is Marquardt's (the diagonal scaled by 1 +
//! λ), λ by Nielsen's rule (1999).

use glam::DVec3;

use super::coat::WIDTHS;
use super::linear::solve_spd;
use super::model::{EXPONENTS, Model, ModelLobe, Turned};
use super::samples::{Samples, Target};

/// What a fit may change.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Freedom {
    /// Cx = Cy and no β.
    pub isotropic: bool,
    /// Whether ρ_d is an unknown.
    pub diffuse: bool,
}

/// How a fit ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Descent {
    /// Σ w (g(f̂) − g(f))².
    pub cost: f64,
    /// Steps tried.
    pub iterations: usize,
    /// Whether the cost stopped falling before the steps ran out.
    pub converged: bool,
}

/// When to stop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Most steps tried.
    pub iterations: usize,
    /// Stops after two steps running that lower the cost by less than this share of it.
    pub tolerance: f64,
}

/// exp of less than this is nothing beside any measured value.
const NEGLIGIBLE: f64 = -40.0;

/// The optimiser with its buffers; one a thread.
#[derive(Debug, Clone, Default)]
pub struct Optimiser {
    /// (b/r)ⁿ and ln(b/r), [lobe][sample], of the model that was evaluated last.
    shapes: Vec<f64>,
    logs: Vec<f64>,
    /// The model's values there.
    values: Vec<f64>,
    row: Vec<f64>,
    normal: Vec<f64>,
    gradient: Vec<f64>,
    damped: Vec<f64>,
    step: Vec<f64>,
    trial: Model,
    fixed: Vec<bool>,
}

/// Places of the unknowns.
#[derive(Clone, Copy)]
struct Layout {
    first_lobe: usize,
    per_lobe: usize,
    beta: Option<usize>,
    coat: Option<usize>,
    size: usize,
}

impl Layout {
    fn new(freedom: Freedom, model: &Model) -> Self {
        let lobes = model.lobes.len();
        let first_lobe = usize::from(freedom.diffuse);
        let sharpens = model.lobes.first().is_some_and(|lobe| lobe.n_grazing.is_some());
        let per_lobe = usize::from(sharpens) + if freedom.isotropic { 3 } else { 4 };
        let end = first_lobe + per_lobe * lobes;
        let beta = (!freedom.isotropic && lobes > 0).then_some(end);
        let end = end + usize::from(beta.is_some());
        let coat = model.coat.map(|_| end);
        Self { first_lobe, per_lobe, beta, coat, size: end + if coat.is_some() { 3 } else { 0 } }
    }
}

/// Unit tangents at C along which it may move; the second is unused when isotropic.
pub(super) fn tangents(c: DVec3, isotropic: bool) -> [DVec3; 2] {
    if isotropic {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        return [DVec3::new(half * c.z, half * c.z, -(c.x + c.y) * half), DVec3::ZERO];
    }
    let (u, v) = c.any_orthonormal_pair();
    [u, v]
}

impl Optimiser {
    /// The cost of a model; leaves its shapes and values in the buffers. Infinite where it overflows.
    pub fn evaluate(&mut self, samples: &Samples, target: &Target, model: &Model) -> f64 {
        let count = samples.len();
        self.values.clear();
        self.values.resize(count, model.diffuse);
        self.shapes.resize(count * model.lobes.len(), 0.0);
        self.logs.resize(count * model.lobes.len(), 0.0);
        if let Some(coat) = model.coat {
            for (k, value) in self.values.iter_mut().enumerate() {
                *value += coat.value(samples, k);
            }
        }
        let turned = Turned::new(model.beta);
        for (j, lobe) in model.lobes.iter().enumerate() {
            let inverse = lobe.c / lobe.reference;
            let shapes = &mut self.shapes[j * count..(j + 1) * count];
            let logs = &mut self.logs[j * count..(j + 1) * count];
            for k in 0..count {
                let base = inverse.dot(turned.products(samples, k));
                (shapes[k], logs[k]) = (0.0, 0.0);
                if base > 1e-12 {
                    let log = base.ln();
                    let power = exponent(lobe, samples, k) * log;
                    if power > NEGLIGIBLE {
                        (shapes[k], logs[k]) = (power.exp(), log);
                        self.values[k] += lobe.amplitude * shapes[k];
                    }
                }
            }
        }
        let mut cost = 0.0;
        for k in 0..count {
            let (difference, _) = target.difference(self.values[k], samples.cos_o[k], k);
            cost += (target.weight[k] * difference).powi(2);
        }
        if cost.is_finite() { cost } else { f64::INFINITY }
    }

    /// JᵀJ, row by row, and the cost at a model.
    pub(super) fn information(
        &mut self,
        samples: &Samples,
        target: &Target,
        freedom: Freedom,
        model: &Model,
    ) -> (Vec<f64>, f64) {
        let cost = self.evaluate(samples, target, model);
        self.normal_equations(samples, target, model, freedom);
        (self.normal.clone(), cost)
    }

    /// Which unknowns are at a bound, whatever the gradient.
    pub(super) fn at_bound(&mut self, model: &Model, freedom: Freedom, most: f64) -> Vec<bool> {
        let mut held = vec![false; Layout::new(freedom, model).size];
        for sign in [1.0, -1.0] {
            self.gradient.clear();
            self.gradient.resize(held.len(), sign);
            self.freeze(model, freedom, most);
            held.iter_mut().zip(&self.fixed).for_each(|(held, &fixed)| *held |= fixed);
        }
        held
    }

    /// The model with one unknown moved, its lobes referred to the cone of the samples.
    pub(super) fn moved(
        &mut self,
        samples: &Samples,
        freedom: Freedom,
        model: &Model,
        unknown: usize,
        by: f64,
    ) -> Model {
        self.step.clear();
        self.step.resize(Layout::new(freedom, model).size, 0.0);
        self.step[unknown] = by;
        self.stepped(model, freedom, f64::INFINITY);
        Self::refer(&mut self.trial, samples, f64::INFINITY);
        self.trial.clone()
    }

    /// JᵀJ and Jᵀr at the model that was evaluated last.
    fn normal_equations(&mut self, samples: &Samples, target: &Target, model: &Model, freedom: Freedom) {
        let layout = Layout::new(freedom, model);
        let (size, count) = (layout.size, samples.len());
        self.normal.clear();
        self.normal.resize(size * size, 0.0);
        self.gradient.clear();
        self.gradient.resize(size, 0.0);
        self.row.resize(size, 0.0);
        for k in 0..count {
            let (difference, slope) = target.difference(self.values[k], samples.cos_o[k], k);
            let residual = target.weight[k] * difference;
            self.row.fill(0.0);
            self.derivatives(samples, model, freedom, layout, k);
            let scale = target.weight[k] * slope;
            for i in 0..size {
                let value = self.row[i] * scale;
                self.row[i] = value;
                if value != 0.0 {
                    self.gradient[i] += value * residual;
                    for j in 0..=i {
                        self.normal[i * size + j] += value * self.row[j];
                    }
                }
            }
        }
        for i in 0..size {
            for j in 0..i {
                self.normal[j * size + i] = self.normal[i * size + j];
            }
        }
    }

    /// df̂/d(unknown) of sample k into the row buffer.
    fn derivatives(&mut self, samples: &Samples, model: &Model, freedom: Freedom, layout: Layout, k: usize) {
        if freedom.diffuse {
            self.row[0] = 1.0;
        }
        if let (Some(coat), Some(at)) = (model.coat, layout.coat) {
            self.row[at..at + 3].copy_from_slice(&coat.derivatives(samples, k));
        }
        let turned = Turned::new(model.beta);
        for (j, lobe) in model.lobes.iter().enumerate() {
            let (shape, log) = (self.shapes[j * samples.len() + k], self.logs[j * samples.len() + k]);
            if shape == 0.0 {
                continue;
            }
            let at = layout.first_lobe + j * layout.per_lobe;
            self.row[at] = shape;
            let products = turned.products(samples, k);
            let (value, exponent) = (lobe.amplitude * shape, exponent(lobe, samples, k));
            let by_base = value * exponent / lobe.c.dot(products);
            let along = tangents(lobe.c, freedom.isotropic);
            let [mut u, mut v] = along.map(|tangent| by_base * tangent.dot(products));
            self.row[at + 1] = value * lobe.n * log;
            if let Some(grazing) = lobe.n_grazing {
                let t = samples.mean_cosine(k);
                self.row[at + 1] *= t;
                self.row[at + layout.per_lobe - 1] = value * grazing * (1.0 - t) * log;
                // The reference is part of the shape, not of the amplitude.
                let [of_u, of_v] = along.map(|tangent| lobe.reference_slope(tangent, samples.cone()));
                (u, v) = (u - value * exponent * of_u, v - value * exponent * of_v);
            }
            self.row[at + 2] = u;
            if let Some(beta) = layout.beta {
                self.row[at + 3] = v;
                self.row[beta] += by_base * (lobe.c.x - lobe.c.y) * turned.slope(samples, k);
            }
        }
    }

    /// The model after the step in the buffer.
    fn stepped(&mut self, model: &Model, freedom: Freedom, most: f64) {
        let layout = Layout::new(freedom, model);
        self.trial.clone_from(model);
        if freedom.diffuse {
            self.trial.diffuse = (model.diffuse + self.step[0]).max(0.0);
        }
        if let Some(beta) = layout.beta {
            self.trial.beta += self.step[beta].clamp(-0.3, 0.3);
        }
        if let (Some(coat), Some(at)) = (&mut self.trial.coat, layout.coat) {
            coat.f0 = (coat.f0 + self.step[at]).clamp(0.0, 1.0);
            coat.f90 = (coat.f90 + self.step[at + 1]).clamp(0.0, 1.0);
            let factor = self.step[at + 2].clamp(-1.0, 1.0).exp();
            coat.alpha = (coat.alpha * factor).clamp(WIDTHS[0], WIDTHS[1]);
        }
        for (j, lobe) in self.trial.lobes.iter_mut().enumerate() {
            let at = layout.first_lobe + j * layout.per_lobe;
            lobe.amplitude = (lobe.amplitude + self.step[at]).clamp(0.0, most);
            let factor = self.step[at + 1].clamp(-1.5, 1.5).exp();
            lobe.n = (lobe.n * factor).clamp(EXPONENTS[0], EXPONENTS[1]);
            if let Some(grazing) = &mut lobe.n_grazing {
                let factor = self.step[at + layout.per_lobe - 1].clamp(-1.5, 1.5).exp();
                *grazing = (*grazing * factor).clamp(EXPONENTS[0], EXPONENTS[1]);
            }
            let [u, v] = tangents(lobe.c, freedom.isotropic);
            let mut turn = u * self.step[at + 2];
            if layout.beta.is_some() {
                turn += v * self.step[at + 3];
            }
            lobe.c = (lobe.c + turn.clamp_length_max(0.7)).normalize();
            if freedom.isotropic {
                lobe.c.y = lobe.c.x;
            }
        }
    }

    /// Marks unknowns at a bound that the gradient pushes outward.
    fn freeze(&mut self, model: &Model, freedom: Freedom, most: f64) {
        let layout = Layout::new(freedom, model);
        self.fixed.clear();
        self.fixed.resize(layout.size, false);
        if freedom.diffuse {
            self.fixed[0] = model.diffuse <= 0.0 && self.gradient[0] > 0.0;
        }
        if let (Some(coat), Some(at)) = (model.coat, layout.coat) {
            let bounds = [(coat.f0, [0.0, 1.0]), (coat.f90, [0.0, 1.0]), (coat.alpha, WIDTHS)];
            for (k, (value, [low, high])) in bounds.into_iter().enumerate() {
                let downhill = -self.gradient[at + k];
                self.fixed[at + k] = (value <= low && downhill < 0.0) || (value >= high && downhill > 0.0);
            }
        }
        for (j, lobe) in model.lobes.iter().enumerate() {
            let at = layout.first_lobe + j * layout.per_lobe;
            self.fixed[at] = (lobe.amplitude <= 0.0 && self.gradient[at] > 0.0)
                || (lobe.amplitude >= most && self.gradient[at] < 0.0);
            let at_grazing = lobe.n_grazing.map(|grazing| (at + layout.per_lobe - 1, grazing));
            for (place, n) in [Some((at + 1, lobe.n)), at_grazing].into_iter().flatten() {
                let downhill = -self.gradient[place];
                self.fixed[place] =
                    (n <= EXPONENTS[0] && downhill < 0.0) || (n >= EXPONENTS[1] && downhill > 0.0);
            }
        }
    }

    /// Solves the damped normal equations into the step buffer; false when they are singular.
    fn solve(&mut self, damping: f64) -> bool {
        let size = self.gradient.len();
        self.damped.clone_from(&self.normal);
        self.step.clear();
        self.step.extend(self.gradient.iter().map(|gradient| -gradient));
        let largest = (0..size).map(|i| self.normal[i * size + i]).fold(0.0, f64::max);
        for i in 0..size {
            if self.fixed[i] {
                for j in 0..size {
                    self.damped[i * size + j] = 0.0;
                    self.damped[j * size + i] = 0.0;
                }
                self.step[i] = 0.0;
                self.damped[i * size + i] = 1.0;
            } else {
                let diagonal = self.normal[i * size + i].max(1e-14 * largest).max(1e-300);
                self.damped[i * size + i] += damping * diagonal;
            }
        }
        solve_spd(&mut self.damped, &mut self.step)
    }

    /// Refers every lobe to the largest base within the cone; the values stay unless an amplitude passes its
    /// bound.
    fn refer(model: &mut Model, samples: &Samples, most: f64) {
        for lobe in &mut model.lobes {
            *lobe = lobe.referred(samples);
            lobe.amplitude = lobe.amplitude.min(most);
        }
    }

    /// Lowers the cost from `model` as far as the limits allow. The result is never worse than the start.
    pub fn minimise(
        &mut self,
        samples: &Samples,
        target: &Target,
        freedom: Freedom,
        limits: Limits,
        model: &mut Model,
    ) -> Descent {
        Self::refer(model, samples, target.most);
        let mut cost = self.evaluate(samples, target, model);
        self.normal_equations(samples, target, model, freedom);
        let (mut damping, mut growth, mut idle) = (1e-3, 2.0, 0);
        for iteration in 1..=limits.iterations {
            self.freeze(model, freedom, target.most);
            let mut improved = false;
            if self.solve(damping) {
                self.stepped(model, freedom, target.most);
                // The evaluation needs the buffers while it reads the trial: take it out for that long.
                let mut trial = std::mem::take(&mut self.trial);
                Self::refer(&mut trial, samples, target.most);
                let trial_cost = self.evaluate(samples, target, &trial);
                if trial_cost <= cost {
                    let gain = (cost - trial_cost) / self.predicted_gain();
                    idle = if cost - trial_cost <= limits.tolerance * cost { idle + 1 } else { 0 };
                    damping = (damping * (1.0 - (2.0 * gain - 1.0).powi(3)).clamp(0.1, 1.0)).max(1e-12);
                    (growth, improved, cost) = (2.0, true, trial_cost);
                    std::mem::swap(model, &mut trial);
                }
                self.trial = trial;
            }
            if !improved {
                damping *= growth;
                growth *= 2.0;
            }
            if idle >= 2 || damping > 1e12 || cost == 0.0 {
                return Descent { cost, iterations: iteration, converged: true };
            }
            if improved {
                self.normal_equations(samples, target, model, freedom);
            }
        }
        Descent { cost, iterations: limits.iterations, converged: false }
    }

    /// The fall in cost that the linear model promises for the step in the buffer.
    fn predicted_gain(&self) -> f64 {
        let size = self.gradient.len();
        let mut gain = 0.0;
        for i in 0..size {
            let product: f64 = (0..size).map(|j| self.normal[i * size + j] * self.step[j]).sum();
            gain -= self.step[i] * (2.0 * self.gradient[i] + product);
        }
        gain.max(1e-300)
    }
}

/// The exponent of a lobe at sample k.
fn exponent(lobe: &ModelLobe, samples: &Samples, k: usize) -> f64 {
    if lobe.n_grazing.is_some() { lobe.exponent(samples.mean_cosine(k)) } else { lobe.n }
}

/// A lobe with amplitude 1 for the given shape, or a black one where its base is nowhere positive.
pub fn start_lobe(samples: &Samples, c: DVec3, n: f64) -> ModelLobe {
    ModelLobe::over(samples, c, n).unwrap_or(ModelLobe {
        amplitude: 0.0,
        c,
        n,
        reference: 1.0,
        n_grazing: None,
    })
}

#[cfg(test)]
mod tests;
