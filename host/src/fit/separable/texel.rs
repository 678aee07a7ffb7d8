//! One texel: weights, start, optimisation, and the result as a BRDF.

use pulp::WithSimd;

use super::super::model::Model;
use super::super::samples::Samples;
use super::super::texel::{TexelFit, affordable_lobes};
use super::super::{Diffuse, FitOptions, Residual, diffuse};
use super::choice;
use super::data::{Data, Poses};
use super::normal::Amplitudes;
use super::shape::Family;
use super::solver::Solver;
use super::start::{Bank, Effort, Found, Search, Task};
use super::uncertainty::{self, Sigma};
use crate::reflectance::{LobeBrdf, Rgb};
use crate::sampled::SampledSbrdf;

/// What one thread needs to fit texels without allocating for each.
#[derive(Debug, Clone, Default)]
pub struct Workspace {
    /// Solver, with the texel's data.
    pub solver: Solver,
    /// Shapes for the block of texels at hand.
    pub bank: Bank,
    search: Search,
}

/// Reading a texel's samples, as vector code.
struct Load<'a>(&'a mut Data, &'a Poses, &'a SampledSbrdf, usize);

impl WithSimd for Load<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        self.0.load(self.1, self.2, self.3);
    }
}

/// Weighting them, as vector code.
struct Aim<'a>(&'a mut Data, &'a [usize], Residual, Option<[f64; 3]>);

impl WithSimd for Aim<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        self.0.aim(self.1, self.2, self.3);
    }
}

/// Sums of squares of the residuals and of the samples, as vector code.
struct Squares<'a>(&'a Solver, &'a Amplitudes, &'a [usize], usize);

impl WithSimd for Squares<'_> {
    type Output = (f64, f64);
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> (f64, f64) {
        let Self(solver, at, channels, lobes) = self;
        let (data, columns) = (&solver.data, &solver.columns);
        let count = data.len();
        let root = &data.root[..count];
        let (mut error, mut whole) = (0.0, 0.0);
        for (place, &channel) in channels.iter().enumerate() {
            let values = &data.rgb[channel][..count];
            let goal = &data.goal[place][..count];
            let mut sums = [[0.0; 8]; 2];
            for start in (0..count).step_by(8) {
                let mut rest = [0.0; 8];
                rest.copy_from_slice(&goal[start..start + 8]);
                for unknown in 0..=lobes {
                    let x = at.x[place][unknown];
                    let index = if unknown == 0 { 0 } else { columns.place(unknown - 1) };
                    let column = &columns.column(index)[start..start + 8];
                    for lane in 0..8 {
                        rest[lane] -= x * column[lane];
                    }
                }
                for lane in 0..8 {
                    let k = start + lane;
                    let weight = root[k] * data.scale[place];
                    let weight = if weight > 0.0 { weight } else { f64::INFINITY };
                    let off = rest[lane] / weight;
                    sums[0][lane] += off * off;
                    sums[1][lane] += values[k] * values[k];
                }
            }
            error += sums[0].iter().sum::<f64>();
            whole += sums[1].iter().sum::<f64>();
        }
        (error, whole)
    }
}

/// The channels that are fitted together.
pub fn channel_groups(options: &FitOptions) -> &'static [&'static [usize]] {
    if options.separate_channels { &[&[0], &[1], &[2]] } else { &[&[0, 1, 2]] }
}

impl Task {
    /// Of the fits of both families the one to keep, with its task: isotropic unless the other is better or does with fewer lobes.
    pub fn better_family(self, anisotropic: Found, isotropic: Found) -> (Self, Model) {
        let fewer = anisotropic.model.lobes.len() < isotropic.model.lobes.len();
        let better = choice::is_better(&anisotropic.left_out, &isotropic.left_out);
        let worse = choice::is_better(&isotropic.left_out, &anisotropic.left_out);
        if better || fewer && !worse {
            (Self { family: Family::Anisotropic, ..self }, anisotropic.model)
        } else {
            (Self { family: Family::Isotropic, ..self }, isotropic.model)
        }
    }
}

impl Workspace {
    /// Makes the bank of shapes for texels near `index`.
    pub fn settle(&mut self, poses: &Poses, sampled: &SampledSbrdf, index: usize) {
        self.solver.data.look(poses, sampled.position_mm(index));
        self.bank.fill(&self.solver.data.products, self.solver.data.cone);
    }

    /// Reads the samples of texel `index`.
    pub fn load(&mut self, poses: &Poses, sampled: &SampledSbrdf, index: usize) {
        self.solver.arch.dispatch(Load(&mut self.solver.data, poses, sampled, index));
    }

    /// Takes samples of which the directions are known one by one, with a bank of their own.
    pub fn take(&mut self, samples: &Samples) {
        self.solver.data.take(samples);
        self.bank.fill(&self.solver.data.products, self.solver.data.cone);
    }

    /// Fits the samples that were read. With fewer samples than unknowns fewer lobes are fitted, with none the texel is black.
    pub fn fit(&mut self, options: &FitOptions) -> TexelFit {
        self.fit_by(options, |workspace, _, task| workspace.search(task))
    }

    /// As [`Self::fit`] by another search: given the place of a group of channels, at which the samples are aimed, and its task.
    pub fn fit_by(
        &mut self,
        options: &FitOptions,
        mut search: impl FnMut(&mut Self, usize, Task) -> (Task, Model),
    ) -> TexelFit {
        let valid = self.solver.data.valid;
        let fixed = self.fixed_diffuse(options);
        let mut brdf = LobeBrdf { rho_d: fixed.map_or(Rgb::ZERO, rgb), ..LobeBrdf::default() };
        let mut sigma = Sigma::default();
        let (mut error, mut whole) = (0.0, 0.0);
        for (place, channels) in channel_groups(options).iter().enumerate() {
            let arch = self.solver.arch;
            let task = self.aim(options, channels);
            let (task, model) = search(self, place, task);
            let at = self.solver.evaluate(task.family, task.diffuse, &model);
            let group = self.brdf(channels, &model, &at);
            brdf.rho_d += group.rho_d;
            brdf.beta = group.beta;
            brdf.lobes.extend(group.lobes);
            let of_group = uncertainty::sigma(&self.solver, task.family, task.diffuse, &model, &at);
            sigma.take(channels, of_group, model.beta);
            let squares = arch.dispatch(Squares(&self.solver, &at, channels, model.lobes.len()));
            (error, whole) = (error + squares.0, whole + squares.1);
        }
        let rms = (error / (3 * valid).max(1) as f64).sqrt();
        let relative = if whole > 0.0 { (error / whole).sqrt() } else { 0.0 };
        TexelFit { brdf, rms, relative, samples: valid, sigma: Some(sigma), held: false }
    }

    /// Weights the samples that were read for fitting `channels` together; what is then to be done.
    pub fn aim(&mut self, options: &FitOptions, channels: &[usize]) -> Task {
        let fixed = self.fixed_diffuse(options);
        let arch = self.solver.arch;
        arch.dispatch(Aim(&mut self.solver.data, channels, options.residual, fixed));
        self.solver.begin();
        let lobes = affordable_lobes(self.solver.data.valid, options);
        Task {
            lobes,
            family: if options.isotropic { Family::Isotropic } else { Family::Anisotropic },
            diffuse: fixed.is_none(),
            effort: Effort::texel(lobes),
            choose: options.choose,
        }
    }

    /// ρ_d where it is no unknown.
    fn fixed_diffuse(&self, options: &FitOptions) -> Option<[f64; 3]> {
        match options.diffuse {
            Diffuse::Percentile(percentile) if affordable_lobes(self.solver.data.valid, options) > 0 => {
                Some(self.percentile(percentile))
            }
            _ => None,
        }
    }

    /// The model that the search finds, with the task whose family it belongs to: where the number of lobes is a choice, so is isotropy.
    fn search(&mut self, task: Task) -> (Task, Model) {
        let found = self.search.best(&mut self.solver, &self.bank, task);
        if task.choose && task.family == Family::Anisotropic {
            let isotropic = Task { family: Family::Isotropic, ..task };
            let other = self.search.best(&mut self.solver, &self.bank, isotropic);
            return task.better_family(found, other);
        }
        (task, found.model)
    }

    /// The BRDF of the channels that were fitted together.
    fn brdf(&self, channels: &[usize], model: &Model, at: &Amplitudes) -> LobeBrdf {
        let colour = |unknown: usize| {
            let mut colour = Rgb::ZERO;
            for (place, &channel) in channels.iter().enumerate() {
                colour[channel] = (at.x[place][unknown] / self.solver.data.scale[place]) as f32;
            }
            colour
        };
        let rho_s: Vec<Rgb> = (1..=model.lobes.len()).map(colour).collect();
        model.to_brdf(colour(0), &rho_s)
    }

    /// The percentile of every channel.
    fn percentile(&self, percentile: f64) -> [f64; 3] {
        let data = &self.solver.data;
        std::array::from_fn(|channel| {
            let valid = data.rgb[channel].iter().zip(&data.weight).filter(|&(_, &weight)| weight > 0.0);
            let mut values: Vec<f64> = valid.map(|(&value, _)| value).collect();
            diffuse::percentile(&mut values, percentile)
        })
    }
}

fn rgb(values: [f64; 3]) -> Rgb {
    Rgb::from_array(values.map(|x| x as f32))
}
