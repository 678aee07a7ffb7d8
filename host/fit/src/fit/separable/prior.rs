//! What the poses do not tell is taken from a prior: a lobe that hardly any pose met has no exponent of its
//! own, and poses in one plane cannot tell Cx from Cy.
//!
//! In units of the prior's widths and of the noise's variance, a combination of the shapes' unknowns of which
//! the information matrix has an eigenvalue below 1 is known less well than the prior knows it. Along those
//! combinations, and along no others, (θ − θ₀)² is added to the cost and the shapes are optimised again, as
//! long as the cost rises by no more than the variance of the noise. A texel without such a combination stays
//! as it is.

use super::super::linear;
use super::super::lm::tangents;
use super::super::model::{Model, ModelLobe};
use super::layout::{Family, Layout, UNKNOWNS};
use super::normal;
use super::shape;
use super::solver::Solver;
use super::task::Task;
use super::uncertainty;
use glam::DVec3;

/// Widths of the prior: of ln n, of C's direction and of β, radians.
const WIDTH_LN_N: f64 = 2.0;
const WIDTH_C: f64 = 0.5;
const WIDTH_BETA: f64 = std::f64::consts::FRAC_PI_4;
/// The prior's exponent where no neighbour has one: that of the source's starts.
const EXPONENT: f64 = 10.0;
/// Steps at most, and halvings of each.
const STEPS: usize = 12;
const HALVINGS: usize = 5;
/// Noise below this share of the samples counts as this much: samples are single-precision numbers.
const ROUNDING: f64 = 1e-7;

type Unknowns = [f64; UNKNOWNS];

/// Ties what the samples in the solver do not tell of a model to that of a neighbour, or else to Phong's or
/// the retro-reflecting lobe of exponent 10, and returns how many combinations of unknowns that decides.
pub fn tie(solver: &mut Solver, task: Task, model: &mut Model, near: Option<&Model>) -> usize {
    if model.lobes.is_empty() {
        return 0;
    }
    let at = solver.evaluate(task.family, task.diffuse, model);
    let layout = solver.layout(task.family, task.diffuse, model);
    if !layout.extension.is_none() {
        // The prior knows plain lobes only.
        return 0;
    }
    let normal = normal::normal(&solver.gram, layout, &at);
    let rounding =
        solver.data.goal.iter().take(layout.channels).flatten().map(|goal| goal * goal).sum::<f64>()
            / (solver.data.valid * layout.channels).max(1) as f64;
    let variance = uncertainty::variance(solver, layout, &at).max(ROUNDING * ROUNDING * rounding);
    if variance <= 0.0 {
        return 0;
    }
    let size = normal.size;
    let widths = widths(layout);
    let black = |lobe: usize| at.x.iter().take(layout.channels).all(|x| x[1 + lobe] <= 0.0);
    let mut information = vec![0.0; size * size];
    for i in 0..size {
        for j in 0..size {
            information[i * size + j] = normal.matrix[i * size + j] * widths[i] * widths[j] / variance;
        }
    }
    // A lobe that is not there needs no shape.
    for lobe in (0..layout.lobes).filter(|&lobe| black(lobe)) {
        for column in 0..layout.family.derivatives().min(3) {
            information[layout.family.unknown(lobe, column, layout.lobes) * (size + 1)] = 2.0;
        }
    }
    let mut excess = information.clone();
    (0..size).for_each(|i| excess[i * (size + 1)] -= 1.0);
    if linear::factor(&mut excess, size) {
        // All eigenvalues are above 1.
        return 0;
    }
    let mut axes = vec![0.0; size * size];
    linear::eigen(&mut information, &mut axes, size);
    let untold: Vec<usize> = (0..size).filter(|&k| information[k * (size + 1)] < 1.0).collect();
    let mut penalty = Penalty { matrix: vec![0.0; size * size], size, prior: Prior::new(model, near) };
    for i in 0..size {
        for j in 0..size {
            let products = untold.iter().map(|&k| axes[i * size + k] * axes[j * size + k]);
            penalty.matrix[i * size + j] = variance * products.sum::<f64>() / (widths[i] * widths[j]);
        }
    }
    penalty.minimise(solver, task, layout, model, at.cost + variance);
    untold.len()
}

/// The widths of the unknowns' priors.
fn widths(layout: Layout) -> Unknowns {
    let mut widths = [WIDTH_C; UNKNOWNS];
    for lobe in 0..layout.lobes {
        widths[layout.family.unknown(lobe, 0, layout.lobes)] = WIDTH_LN_N;
    }
    if layout.family == Family::Anisotropic {
        widths[layout.family.unknown(0, 3, layout.lobes)] = WIDTH_BETA;
    }
    widths
}

/// The most probable shapes before any sample.
struct Prior {
    lobes: Vec<ModelLobe>,
    beta: f64,
}

impl Prior {
    /// For every lobe of a model the neighbour's that points most alike, or Phong's or the retro-reflecting
    /// one.
    fn new(model: &Model, near: Option<&Model>) -> Self {
        let known = [DVec3::new(-1.0, -1.0, 1.0), DVec3::ONE].map(|c| ModelLobe::unit(c, EXPONENT));
        let choice = near.map_or(&known[..], |near| &near.lobes);
        let alike = |lobe: &ModelLobe| {
            choice.iter().copied().max_by(|a, b| a.c.dot(lobe.c).total_cmp(&b.c.dot(lobe.c))).unwrap_or(*lobe)
        };
        Self {
            lobes: model.lobes.iter().map(alike).collect(),
            beta: near.map_or(model.beta, |near| near.beta),
        }
    }

    /// θ − θ₀ in the unknowns in which [`shape::advance`] takes steps from the model.
    fn offset(&self, layout: Layout, model: &Model) -> Unknowns {
        let mut offset = [0.0; UNKNOWNS];
        let Layout { family, lobes, .. } = layout;
        for (index, (lobe, prior)) in model.lobes.iter().zip(&self.lobes).enumerate() {
            offset[family.unknown(index, 0, lobes)] = (lobe.n / prior.n).ln();
            let cos = lobe.c.dot(prior.c).clamp(-1.0, 1.0);
            let toward = (prior.c - lobe.c * cos).normalize_or_zero() * cos.acos();
            let isotropic = family != Family::Anisotropic;
            let turns = tangents(lobe.c, isotropic).map(|tangent| -tangent.dot(toward));
            for (column, turn) in turns.into_iter().enumerate().take(if isotropic { 1 } else { 2 }) {
                offset[family.unknown(index, 1 + column, lobes)] = turn;
            }
        }
        if family == Family::Anisotropic {
            // C has the same axes after half a turn.
            let half = std::f64::consts::FRAC_PI_2;
            offset[family.unknown(0, 3, lobes)] =
                (model.beta - self.beta + half).rem_euclid(2.0 * half) - half;
        }
        offset
    }
}

/// (θ − θ₀)ᵀ P (θ − θ₀).
struct Penalty {
    matrix: Vec<f64>,
    size: usize,
    prior: Prior,
}

impl Penalty {
    /// The penalty of a model and P (θ − θ₀), half its gradient.
    fn of(&self, layout: Layout, model: &Model) -> (f64, Unknowns) {
        let offset = self.prior.offset(layout, model);
        let mut slope = [0.0; UNKNOWNS];
        for (slope, row) in slope.iter_mut().zip(self.matrix.chunks_exact(self.size)).take(self.size) {
            *slope = row.iter().zip(&offset).map(|(p, d)| p * d).sum();
        }
        (slope.iter().zip(&offset).map(|(slope, d)| slope * d).sum(), slope)
    }

    /// Gauss–Newton on cost and penalty while the cost is at most `most`.
    fn minimise(&self, solver: &mut Solver, task: Task, layout: Layout, model: &mut Model, most: f64) {
        let size = self.size;
        for _ in 0..STEPS {
            let at = solver.evaluate(task.family, task.diffuse, model);
            let normal = normal::normal(&solver.gram, layout, &at);
            let (penalty, slope) = self.of(layout, model);
            let mut system = normal.matrix;
            system.iter_mut().zip(&self.matrix).for_each(|(entry, p)| *entry += p);
            let mut step: Unknowns = std::array::from_fn(|i| -normal.gradient[i] - slope[i]);
            for i in 0..size {
                system[i * (size + 1)] = system[i * (size + 1)] * (1.0 + 1e-9) + 1e-300;
            }
            if !linear::solve_spd(&mut system, &mut step[..size]) {
                return;
            }
            let total = at.cost + penalty;
            let better = (0..HALVINGS).any(|_| {
                let mut trial = model.clone();
                shape::advance(task.family, &mut trial, &step);
                solver.refer(&mut trial);
                let cost = solver.evaluate(task.family, task.diffuse, &trial).cost;
                let better =
                    cost <= most && cost + self.of(layout, &trial).0 < total - 1e-3 * (most - at.cost).abs();
                step.iter_mut().for_each(|step| *step *= 0.5);
                if better {
                    *model = trial;
                }
                better
            });
            if !better {
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::samples::Samples;
    use super::super::super::testing::{directions, measured, relative_error};
    use super::super::super::{AlbedoBound, FitOptions, Residual};
    use super::super::texel::Workspace;
    use super::*;
    use glam::Vec3;
    use lobelia_base::random::Random;
    use lobelia_reflectance::{Lobe, LobeBrdf, Rgb};

    fn truth(n: f32) -> LobeBrdf {
        let lobe = Lobe::new(Rgb::new(0.5, 0.4, 0.3), Vec3::new(-1.0, -1.0, 0.95), n);
        LobeBrdf { lobes: vec![lobe], ..LobeBrdf::diffuse(Rgb::splat(0.1)) }
    }

    /// The errors on `unposed` directions with and without ties, and how many combinations were tied.
    fn errors(
        samples: Samples,
        truth: &LobeBrdf,
        options: &FitOptions,
        unposed: &[(Vec3, Vec3)],
    ) -> ([f64; 2], usize) {
        let mut workspace = Workspace::default();
        workspace.take(&samples);
        let tied = workspace.fit(options);
        let free = workspace.untied(options);
        ([tied.brdf, free].map(|brdf| relative_error(&brdf, truth, unposed)), tied.tied)
    }

    #[test]
    fn poses_in_one_plane_do_not_tell_all_of_c_and_beta_and_unposed_directions_are_predicted_no_worse() {
        let truth = truth(20.0);
        let options = FitOptions { isotropic: false, residual: Residual::Linear, ..FitOptions::default() };
        let unposed = directions(500, 900);
        let mut sums = [0.0; 2];
        for seed in 0..80 {
            let mut random = Random::new(seed);
            // Within 0.3° of the x–z plane.
            let planar: Vec<(Vec3, Vec3)> = (0..120)
                .map(|_| {
                    let mut direction = |most: f64| {
                        let theta = random.uniform(-most, most);
                        let y = random.uniform(-0.005, 0.005);
                        DVec3::new(theta.sin(), y, theta.cos()).normalize().as_vec3()
                    };
                    (direction(1.3), direction(1.1))
                })
                .collect();
            let samples = measured(&planar, &truth, 0.05, &mut random);
            let (errors, tied) = errors(samples, &truth, &options, &unposed);
            assert!(tied >= 1, "seed {seed}: {tied}");
            (0..2).for_each(|k| sums[k] += errors[k] / 80.0);
        }
        println!("poses in a plane: {:.4} with ties, {:.4} without", sums[0], sums[1]);
        assert!(sums[0] < 1.02 * sums[1], "{sums:?}");
    }

    #[test]
    fn lobes_that_few_poses_meet_predict_unposed_directions_better_with_a_prior() {
        let unposed = directions(500, 900);
        for (n, count) in [(60.0, 25), (150.0, 80), (300.0, 80)] {
            let truth = truth(n);
            // The bound on albedo does some of what ties do.
            let bound = AlbedoBound::Free;
            let options = FitOptions { residual: Residual::Linear, bound, ..FitOptions::default() };
            let (mut sums, mut texels) = ([0.0; 2], 0);
            for seed in 0..200 {
                let samples = measured(&directions(count, seed), &truth, 0.05, &mut Random::new(seed));
                let (errors, tied) = errors(samples, &truth, &options, &unposed);
                if tied > 0 {
                    texels += 1;
                    (0..2).for_each(|k| sums[k] += errors[k]);
                }
            }
            let [with, without] = sums.map(|sum| sum / f64::from(texels));
            println!("n {n}, {count} poses: {texels} of 200 tied, error {with:.3}, without {without:.3}");
            assert!(texels > 10 && with < without, "{n}: {with} {without}");
        }
    }

    #[test]
    fn texels_that_the_poses_tell_stay_as_they_are() {
        let lobe = |x: f32, y: f32, n: f32| Lobe::new(Rgb::new(0.5, 0.4, 0.2), Vec3::new(x, y, 0.95), n);
        let cases = [
            (true, vec![lobe(-1.0, -1.0, 40.0)]),
            (false, vec![lobe(-1.0, -0.8, 25.0)]),
            (true, vec![lobe(-1.0, -1.0, 30.0), lobe(0.9, 0.9, 12.0)]),
        ];
        for (isotropic, lobes) in cases {
            let options = FitOptions { isotropic, lobes: lobes.len(), ..FitOptions::default() };
            let truth = LobeBrdf { beta: 0.3, lobes, ..LobeBrdf::diffuse(Rgb::splat(0.05)) };
            for seed in 0..6 {
                let samples = measured(&directions(300, seed), &truth, 0.02, &mut Random::new(seed));
                let mut workspace = Workspace::default();
                workspace.take(&samples);
                let fit = workspace.fit(&options);
                assert_eq!(fit.tied, 0, "{options:?} {seed}");
                assert_eq!(fit.brdf, workspace.untied(&options));
            }
        }
    }

    #[test]
    fn a_lobe_that_one_pose_meets_has_the_shape_of_its_neighbour() {
        let truth = truth(60.0);
        let off = |pair: &(Vec3, Vec3)| (pair.0 + pair.1).normalize().z.acos();
        let (near, far): (Vec<_>, Vec<_>) = directions(600, 5).into_iter().partition(|pair| off(pair) < 0.35);
        let met = near.iter().find(|pair| (0.04..0.08).contains(&off(pair))).unwrap();
        let poses: Vec<(Vec3, Vec3)> = far.into_iter().take(150).chain([*met]).collect();
        let mut workspace = Workspace::default();
        workspace.take(&measured(&poses, &truth, 0.02, &mut Random::new(2)));
        let options = FitOptions { residual: Residual::Linear, ..FitOptions::default() };
        let task = workspace.aim(&options, &[0, 1, 2]);
        let lobe = |n: f64| ModelLobe::unit(DVec3::new(-1.0, -1.0, 0.95), n);
        let neighbour = Model { lobes: vec![lobe(55.0)], ..Model::default() };
        let mut model = Model { lobes: vec![lobe(800.0)], ..Model::default() };
        workspace.solver.refer(&mut model);
        let tied = tie(&mut workspace.solver, task, &mut model, Some(&neighbour));
        assert_eq!(tied, 2);
        assert!((model.lobes[0].n / 55.0).ln().abs() < 0.5, "{model:?}");
    }
}
