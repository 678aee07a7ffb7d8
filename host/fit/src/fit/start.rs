//! Starts for the optimiser: a deterministic search through a bank of lobe shapes, and random ones to compare
//! it with.
//!
//! The bank holds shapes for directions of C all round the (Cxy, Cz) circle and n = 1, 2, 4, … (`Bank`; one
//! squaring takes a shape to the next exponent). The amplitudes that go best with a set of shapes follow in
//! closed form (non-negative least squares). The search adds lobes one after the other: every set of the beam
//! is joined by the shapes that are local maxima of explained variance over the bank, the best sets are
//! optimised for a few steps, and the best of those go on. The last beam is optimised to convergence and the
//! cheapest wins. One procedure, no chance in it.

use super::coat::Coat;
use super::lm::{Descent, Freedom, Limits, Optimiser};
use super::model::{Model, ModelLobe, Turned, isotropic_c};
use super::samples::{Samples, Target};
use super::{linear, lm};
use lobelia_base::random::Random;

/// Exponents 1, 2, 4, … 2^(EXPONENTS − 1).
const EXPONENTS: usize = 12;
/// Widths from which a microfacet term is optimised.
const COAT_WIDTHS: [f64; 8] = [0.003, 0.006, 0.012, 0.025, 0.05, 0.1, 0.2, 0.5];
/// Rows of the bank a direction.
const ROWS: usize = EXPONENTS + 1;

/// How far the search goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Effort {
    /// Directions of C round the circle in the bank.
    pub directions: usize,
    /// Powers of the residual's linearised weights under which extensions are looked for: 1 is the residual
    /// itself, to first order; 0 sees the peaks that a logarithmic residual hardly weighs.
    pub powers: &'static [f64],
    /// Sets kept after each added lobe.
    pub beam: usize,
    /// Optimiser steps for a set before it's compared with the others.
    pub trial_steps: usize,
    /// When the last sets count as converged.
    pub limits: Limits,
}

impl Effort {
    /// For one of thousands of texels.
    pub const TEXEL: Self = Self {
        directions: 36,
        powers: &[1.0],
        beam: 2,
        trial_steps: 6,
        limits: Limits { iterations: 60, tolerance: 1e-7 },
    };
    /// For one table, where a second is nothing.
    pub const TABLE: Self = Self {
        directions: 144,
        powers: &[1.0, 0.5, 0.0],
        beam: 8,
        trial_steps: 20,
        limits: Limits { iterations: 400, tolerance: 1e-9 },
    };
}

/// The shapes of the bank at the samples' directions.
#[derive(Debug, Clone, Default)]
struct Bank {
    /// [direction][exponent][sample], with one exponent more than are candidates: the square of the last.
    shapes: Vec<f32>,
    /// Whether the base of a direction is positive anywhere.
    seen: Vec<bool>,
    directions: usize,
}

impl Bank {
    fn angle(&self, direction: usize) -> f64 {
        (direction as f64 + 0.5) / self.directions as f64 * std::f64::consts::TAU
    }

    fn fill(&mut self, samples: &Samples, directions: usize) {
        self.directions = directions;
        let count = samples.len();
        self.shapes.resize(directions * ROWS * count, 0.0);
        self.seen.resize(directions, false);
        for direction in 0..directions {
            let lobe = ModelLobe::over(samples, isotropic_c(self.angle(direction)), 1.0);
            self.seen[direction] = lobe.is_some();
            let Some(lobe) = lobe else { continue };
            let scale = lobe.c / lobe.reference;
            let block = &mut self.shapes[direction * ROWS * count..(direction + 1) * ROWS * count];
            for (k, base) in block[..count].iter_mut().enumerate() {
                let value = scale.x * (samples.xx[k] + samples.yy[k]) + scale.z * samples.zz[k];
                *base = value.max(0.0) as f32;
            }
            for row in 1..ROWS {
                let (done, rest) = block.split_at_mut(row * count);
                for (power, &root) in rest[..count].iter_mut().zip(&done[(row - 1) * count..]) {
                    // Without denormal numbers, which are slow.
                    *power = if root < 1e-15 { 0.0 } else { root * root };
                }
            }
        }
    }

    /// The shape of a direction at n = 2^row.
    fn shape(&self, direction: usize, row: usize, count: usize) -> &[f32] {
        &self.shapes[(direction * ROWS + row) * count..][..count]
    }
}

/// The search with its buffers; one a thread.
#[derive(Debug, Clone, Default)]
pub struct Search {
    bank: Bank,
    scores: Vec<f64>,
    /// Columns of the set that is extended (1 and its shapes) times the weights, [column][sample].
    columns: Vec<f32>,
    weights: Vec<f32>,
    data: Vec<f32>,
}

/// A set of shapes with what it explains or costs.
struct Candidate {
    cost: f64,
    model: Model,
}

/// Σ a b, in eight partial sums so that it vectorises.
fn dot(a: &[f32], b: &[f32]) -> f64 {
    let mut sums = [0f32; 8];
    let (a8, b8) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f32 = a8.remainder().iter().zip(b8.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in a8.zip(b8) {
        for lane in 0..8 {
            sums[lane] += x[lane] * y[lane];
        }
    }
    f64::from(sums.iter().sum::<f32>() + rest)
}

impl Search {
    /// The best fit of `lobes` lobes that the deterministic search finds.
    pub fn best(
        &mut self,
        optimiser: &mut Optimiser,
        problem: &Problem<'_>,
        lobes: usize,
        effort: Effort,
    ) -> (Model, Descent) {
        let beam = vec![Candidate { cost: f64::INFINITY, model: problem.diffuse_only() }];
        self.extend(optimiser, problem, beam, lobes, effort)
    }

    /// As [`Self::best`] with a microfacet term, which is found first, from widths all over their range.
    pub fn best_coated(
        &mut self,
        optimiser: &mut Optimiser,
        problem: &Problem<'_>,
        lobes: usize,
        effort: Effort,
    ) -> (Model, Descent) {
        let limits = Limits { iterations: effort.trial_steps, ..effort.limits };
        let mut beam: Vec<Candidate> = COAT_WIDTHS
            .iter()
            .map(|&alpha| {
                let coat = Some(Coat { f0: 0.04, f90: 1.0, alpha });
                let mut model = Model { coat, ..problem.diffuse_only() };
                let cost = problem.minimise(optimiser, limits, &mut model).cost;
                Candidate { cost, model }
            })
            .collect();
        beam.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        distinct(&mut beam, effort.beam.div_ceil(2));
        self.extend(optimiser, problem, beam, lobes, effort)
    }

    /// Adds lobes to a beam one after the other and optimises the last.
    fn extend(
        &mut self,
        optimiser: &mut Optimiser,
        problem: &Problem<'_>,
        mut beam: Vec<Candidate>,
        lobes: usize,
        effort: Effort,
    ) -> (Model, Descent) {
        if lobes > 0 {
            self.bank.fill(problem.samples, effort.directions);
        }
        for added in 1..=lobes {
            let width = if added == lobes { effort.beam } else { effort.beam.div_ceil(2) };
            let mut next = Vec::new();
            for set in &beam {
                for &power in effort.powers {
                    self.extensions(problem, &set.model, power, effort, &mut next);
                }
            }
            for candidate in &mut next {
                let limits = Limits { iterations: effort.trial_steps, ..effort.limits };
                candidate.cost = problem.minimise(optimiser, limits, &mut candidate.model).cost;
            }
            next.sort_by(|a, b| a.cost.total_cmp(&b.cost));
            distinct(&mut next, width);
            if next.is_empty() {
                break;
            }
            beam = next;
        }
        let mut best: Option<(Model, Descent)> = None;
        for mut candidate in beam {
            let outcome = problem.minimise(optimiser, effort.limits, &mut candidate.model);
            if best.as_ref().is_none_or(|(_, least)| outcome.cost < least.cost) {
                best = Some((candidate.model, outcome));
            }
        }
        best.unwrap_or_else(|| {
            (problem.diffuse_only(), Descent { cost: f64::INFINITY, iterations: 0, converged: false })
        })
    }

    /// Adds to `found` the sets that are `model` and one lobe of the bank more, for the `most` best local
    /// maxima of what the joint closed-form amplitudes explain.
    fn extensions(
        &mut self,
        problem: &Problem<'_>,
        model: &Model,
        power: f64,
        effort: Effort,
        found: &mut Vec<Candidate>,
    ) {
        let count = problem.samples.len();
        let (most, thorough) = (effort.beam, effort.powers.len() > 1);
        let mut system = self.system_of(problem, model, power);
        self.scores.clear();
        self.scores.resize(self.bank.directions * EXPONENTS, f64::NEG_INFINITY);
        for direction in (0..self.bank.directions).filter(|&direction| self.bank.seen[direction]) {
            for exponent in 0..EXPONENTS {
                let score = self.join(&mut system, direction, exponent, count);
                self.scores[direction * EXPONENTS + exponent] = score;
            }
        }
        let mut maxima: Vec<usize> = (0..self.scores.len()).filter(|&i| self.is_local_maximum(i)).collect();
        maxima.sort_by(|&a, &b| self.scores[b].total_cmp(&self.scores[a]).then(a.cmp(&b)));
        maxima.truncate(most);
        if thorough {
            // What the closed form ranks badly can still be the best once optimised: every exponent gets a
            // try.
            for exponent in 0..EXPONENTS {
                let directions = (0..self.bank.directions).map(|direction| direction * EXPONENTS + exponent);
                let best = directions.max_by(|&a, &b| self.scores[a].total_cmp(&self.scores[b]));
                maxima.extend(best.filter(|&i| self.scores[i].is_finite() && !maxima.contains(&i)));
            }
        }
        for index in maxima {
            let (direction, exponent) = (index / EXPONENTS, index % EXPONENTS);
            self.join(&mut system, direction, exponent, count);
            let mut extended = model.clone();
            let n = f64::from(1u32 << exponent);
            extended.lobes.push(lm::start_lobe(problem.samples, isotropic_c(self.bank.angle(direction)), n));
            problem.set_amplitudes(&mut extended, &system.x);
            found.push(Candidate { cost: -self.scores[index], model: extended });
        }
    }

    /// Solves for the amplitudes of the set and one shape of the bank; what they explain, or −∞ where the
    /// shape adds nothing.
    fn join(&self, system: &mut System, direction: usize, exponent: usize, count: usize) -> f64 {
        let size = system.rhs.len();
        let last = size - 1;
        let shape = self.bank.shape(direction, exponent, count);
        let data = dot(shape, &self.data);
        let mut gradient = data;
        for (i, column) in self.columns.chunks_exact(count).enumerate() {
            let cross = dot(shape, column);
            system.matrix[i * size + last] = cross;
            system.matrix[last * size + i] = cross;
            gradient -= cross * system.without[i];
        }
        if gradient <= 0.0 {
            // The optimality condition at amplitude 0 holds already.
            return f64::NEG_INFINITY;
        }
        // The square of a shape is the next one of the bank.
        system.matrix[size * size - 1] = dot(self.bank.shape(direction, exponent + 1, count), &self.weights);
        system.rhs[last] = data;
        let explained = linear::nnls(&system.matrix, &system.rhs, &mut system.x);
        if system.x[last] > 0.0 { explained } else { f64::NEG_INFINITY }
    }

    fn is_local_maximum(&self, index: usize) -> bool {
        let score = self.scores[index];
        let (direction, exponent) = (index / EXPONENTS, index % EXPONENTS);
        let directions = self.bank.directions;
        let at =
            |direction: usize, exponent: usize| self.scores[direction % directions * EXPONENTS + exponent];
        score.is_finite()
            && (exponent == 0 || score >= at(direction, exponent - 1))
            && (exponent + 1 == EXPONENTS || score > at(direction, exponent + 1))
            && score >= at(direction + directions - 1, exponent)
            && score > at(direction + 1, exponent)
    }

    /// Fills the weighted columns of a model; the linear system that they and one column more make, without
    /// that one.
    fn system_of(&mut self, problem: &Problem<'_>, model: &Model, power: f64) -> System {
        let (samples, target) = (problem.samples, problem.target);
        let count = samples.len();
        // Weights can span many powers of ten; f32 products need them near 1.
        let largest = target.linear_weight.iter().copied().fold(0.0, f64::max).max(1e-300);
        self.weights.clear();
        self.weights.extend(target.linear_weight.iter().map(|w| (w / largest).powf(power) as f32));
        let fixed = if problem.freedom.diffuse { 0.0 } else { model.diffuse };
        self.data.clear();
        let coat = |k: usize| model.coat.map_or(0.0, |coat| coat.value(samples, k));
        self.data.extend((0..count).map(|k| (target.value[k] - fixed - coat(k)) as f32 * self.weights[k]));
        let mut plain = Vec::with_capacity(count * (1 + model.lobes.len()));
        if problem.freedom.diffuse {
            plain.resize(count, 1f32);
        }
        let turned = Turned::new(model.beta);
        for lobe in &model.lobes {
            plain.extend(
                (0..count).map(|k| lobe.shape(turned.products(samples, k), samples.mean_cosine(k)) as f32),
            );
        }
        self.columns.clear();
        self.columns.extend(plain.iter().zip(self.weights.iter().cycle()).map(|(x, w)| x * w));
        let known = plain.len() / count.max(1);
        let mut system = System::new(known + 1);
        let mut gram = vec![0.0; known * known];
        for (i, a) in self.columns.chunks_exact(count.max(1)).enumerate() {
            for (j, b) in plain.chunks_exact(count.max(1)).enumerate() {
                gram[i * known + j] = dot(a, b);
                system.matrix[i * (known + 1) + j] = gram[i * known + j];
            }
        }
        for (i, a) in plain.chunks_exact(count.max(1)).enumerate() {
            system.rhs[i] = dot(a, &self.data);
        }
        linear::nnls(&gram, &system.rhs[..known], &mut system.without);
        system
    }
}

/// Normal equations of the columns of a set and one more, the last.
struct System {
    matrix: Vec<f64>,
    rhs: Vec<f64>,
    x: Vec<f64>,
    /// The solution without the last column.
    without: Vec<f64>,
}

impl System {
    fn new(size: usize) -> Self {
        let zeros = |count: usize| vec![0.0; count];
        Self { matrix: zeros(size * size), rhs: zeros(size), x: zeros(size), without: zeros(size - 1) }
    }
}

/// Keeps the `most` cheapest of a sorted list, without those that cost the same to six digits.
fn distinct(sorted: &mut Vec<Candidate>, most: usize) {
    sorted.dedup_by(|b, a| (b.cost - a.cost).abs() <= 1e-6 * a.cost);
    sorted.truncate(most);
}

/// What is fitted, and what may change.
pub struct Problem<'a> {
    /// Directions.
    pub samples: &'a Samples,
    /// Values.
    pub target: &'a Target,
    /// Unknowns.
    pub freedom: Freedom,
    /// ρ_d where it is no unknown.
    pub fixed_diffuse: f64,
}

impl Problem<'_> {
    /// The diffuse term alone: its weighted mean, or the fixed one.
    fn diffuse_only(&self) -> Model {
        let diffuse = if self.freedom.diffuse {
            let weights = &self.target.linear_weight;
            let total: f64 = weights.iter().sum();
            let sum: f64 = weights.iter().zip(&self.target.value).map(|(w, y)| w * y).sum();
            if total > 0.0 { (sum / total).max(0.0) } else { 0.0 }
        } else {
            self.fixed_diffuse
        };
        Model { diffuse, ..Model::default() }
    }

    /// Optimises within the problem's freedom.
    ///
    /// The search for the shapes is isotropic. From there an anisotropic fit needs a push: with Cx = Cy the
    /// cost does not depend on β. So an isotropic optimum is followed by four pushed ones, along β = 0 and β
    /// = π/4, of which the cheapest goes on.
    pub fn minimise(&self, optimiser: &mut Optimiser, limits: Limits, model: &mut Model) -> Descent {
        let (samples, target, freedom) = (self.samples, self.target, self.freedom);
        let pushed = model.lobes.iter().any(|lobe| lobe.c.x != lobe.c.y);
        if freedom.isotropic || pushed || model.lobes.is_empty() {
            return optimiser.minimise(samples, target, freedom, limits, model);
        }
        let isotropic = Freedom { isotropic: true, ..freedom };
        optimiser.minimise(samples, target, isotropic, limits, model);
        let mut best: Option<(Model, Descent)> = None;
        for push in 0..4 {
            let mut trial = model.clone();
            trial.beta = if push < 2 { 0.0 } else { std::f64::consts::FRAC_PI_4 };
            let stretch = if push % 2 == 0 { 0.9 } else { 1.0 / 0.9 };
            for lobe in &mut trial.lobes {
                let c = glam::DVec3::new(lobe.c.x * stretch, lobe.c.y / stretch, lobe.c.z);
                lobe.c = c.normalize();
            }
            let few = Limits { iterations: limits.iterations.min(8), ..limits };
            let outcome = optimiser.minimise(samples, target, freedom, few, &mut trial);
            if best.as_ref().is_none_or(|(_, least)| outcome.cost < least.cost) {
                best = Some((trial, outcome));
            }
        }
        if let Some((trial, _)) = best {
            *model = trial;
        }
        optimiser.minimise(samples, target, freedom, limits, model)
    }

    /// The best of `starts` random starts: directions of C uniform on the circle, ln n uniform in 1..1000,
    /// amplitudes in closed form; each optimised to convergence.
    pub fn best_of_random(
        &self,
        optimiser: &mut Optimiser,
        lobes: usize,
        starts: usize,
        limits: Limits,
        random: &mut Random,
    ) -> f64 {
        let mut best = f64::INFINITY;
        for _ in 0..starts {
            let mut shape = || {
                let c = isotropic_c(random.uniform(0.0, std::f64::consts::TAU));
                (c, random.uniform(0.0, 1000f64.ln()).exp())
            };
            let shapes: Vec<_> = (0..lobes).map(|_| shape()).collect();
            best = best.min(self.from_shapes(optimiser, &shapes, limits).1.cost);
        }
        best
    }

    /// A fit from the given C and n of its lobes, with amplitudes in closed form.
    pub fn from_shapes(
        &self,
        optimiser: &mut Optimiser,
        shapes: &[(glam::DVec3, f64)],
        limits: Limits,
    ) -> (Model, Descent) {
        let mut model = self.diffuse_only();
        model.lobes.extend(shapes.iter().map(|&(c, n)| lm::start_lobe(self.samples, c, n)));
        self.closed_form_amplitudes(&mut model);
        let outcome = self.minimise(optimiser, limits, &mut model);
        (model, outcome)
    }

    /// Sets the amplitudes that minimise the linearised cost for the model's shapes.
    fn closed_form_amplitudes(&self, model: &mut Model) {
        let first = usize::from(self.freedom.diffuse);
        let size = first + model.lobes.len();
        let (mut gram, mut rhs, mut x) = (vec![0.0; size * size], vec![0.0; size], vec![0.0; size]);
        let turned = Turned::new(model.beta);
        let mut row = vec![1.0; size];
        for k in 0..self.samples.len() {
            for (place, lobe) in row[first..].iter_mut().zip(&model.lobes) {
                *place = lobe.shape(turned.products(self.samples, k), self.samples.mean_cosine(k));
            }
            let weight = self.target.linear_weight[k];
            let fixed = if self.freedom.diffuse { 0.0 } else { model.diffuse };
            for i in 0..size {
                rhs[i] += weight * row[i] * (self.target.value[k] - fixed);
                for j in 0..size {
                    gram[i * size + j] += weight * row[i] * row[j];
                }
            }
        }
        linear::nnls(&gram, &rhs, &mut x);
        self.set_amplitudes(model, &x);
    }

    /// Sets ρ_d, where it is an unknown, and the lobes' amplitudes.
    fn set_amplitudes(&self, model: &mut Model, x: &[f64]) {
        let first = usize::from(self.freedom.diffuse);
        if self.freedom.diffuse {
            model.diffuse = x[0];
        }
        for (lobe, &amplitude) in model.lobes.iter_mut().zip(&x[first..]) {
            lobe.amplitude = amplitude;
        }
    }
}
