//! One texel: weights, start, optimisation, and the result as a BRDF.

use glam::DVec3;
use pulp::WithSimd;

use super::super::model::Model;
use super::super::samples::Samples;
use super::super::texel::{TexelFit, affordable_lobes, over_noise};
use super::super::weights::Weights;
use super::super::{Diffuse, FitOptions, Residual, diffuse};
use super::bank::Bank;
use super::bound::Bound;
use super::climb::Trail;
use super::data::{Data, Poses};
use super::layout::{CHANNELS, Family, Layout};
use super::mirror::Mirror;
use super::normal::Amplitudes;
use super::prior;
use super::robust;
use super::search::Search;
use super::solver::{Solver, UNTOLD, WILD};
use super::start;
use super::task::{Effort, Task};
use super::uncertainty::{self, Sigma};
use super::wild;
use lobelia_reflectance::sampled::SampledSbrdf;
use lobelia_reflectance::{LobeBrdf, Microfacet, Rgb};

/// What one thread needs to fit texels without allocating for each.
#[derive(Debug, Clone, Default)]
pub struct Workspace {
    /// Solver, with the texel's data.
    pub solver: Solver,
    /// Shapes for the block of texels at hand.
    pub bank: Bank,
    pub(super) search: Search,
    /// What the poses that were left out tell of a mirror.
    mirror: Option<Mirror>,
    /// What was found at the last texel of every column of the block.
    columns: Vec<Vec<Trail>>,
    /// Their shapes that the samples told, group by group of channels.
    told: Vec<Vec<Option<Solution>>>,
    /// Those of the neighbour that the texel at hand is tied to where its own samples do not tell.
    neighbour: Vec<Option<Solution>>,
    /// What was found for the channels that were fitted last.
    trail: Trail,
    /// Whether another number of lobes would have done almost as well there.
    pub(super) doubtful: bool,
    /// The ρ_d beside which lobes keep the bound on albedos, where the texels that are fitted together have
    /// one each.
    level: [f64; CHANNELS],
}

/// A model of a family.
type Solution = (Family, Model);

/// Reading a texel's samples, as vector code.
struct Load<'a>(&'a mut Data, &'a Poses, &'a SampledSbrdf, usize, Weights);

impl WithSimd for Load<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        self.0.load(self.1, self.2, self.3, self.4);
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

/// Sums of squares of the residuals, of the samples and of the weighted residuals, as vector code.
struct Squares<'a>(&'a Solver, &'a Amplitudes, &'a [usize], Layout);

impl WithSimd for Squares<'_> {
    type Output = [f64; 3];
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> [f64; 3] {
        let Self(solver, at, channels, layout) = self;
        let (data, columns) = (&solver.data, &solver.columns);
        let count = data.len();
        let root = &data.root[..count];
        let mut all = [0.0; 3];
        for (place, &channel) in channels.iter().enumerate() {
            let values = &data.rgb[channel][..count];
            let goal = &data.goal[place][..count];
            let mut sums = [[0.0; 8]; 3];
            for start in (0..count).step_by(8) {
                let mut rest = [0.0; 8];
                rest.copy_from_slice(&goal[start..start + 8]);
                for unknown in 0..=layout.terms() {
                    let x = at.x[place][unknown];
                    let column = &columns.column(layout.column(unknown))[start..start + 8];
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
                    sums[2][lane] += rest[lane] * rest[lane];
                }
            }
            all.iter_mut().zip(&sums).for_each(|(all, sum)| *all += sum.iter().sum::<f64>());
        }
        all
    }
}

/// By how much the cost of a model that was chosen under the bound may be above that of the one that was
/// chosen without it.
const CHOSEN_UNDER_BOUND: f64 = 1.02;
/// The channels that are fitted together.
pub fn channel_groups(options: &FitOptions) -> &'static [&'static [usize]] {
    if options.separate_channels { &[&[0], &[1], &[2]] } else { &[&[0, 1, 2]] }
}

impl Workspace {
    /// Makes the bank of shapes for texels near `index`.
    pub fn settle(&mut self, poses: &Poses, sampled: &SampledSbrdf, index: usize) {
        self.solver.data.look(poses, sampled.position_mm(index));
        self.bank.fill(&self.solver.data.products, self.solver.data.cone);
        self.columns.clear();
        self.told.clear();
    }

    /// Reads the samples of texel `index`. Where the number of lobes is a choice, so is a mirror term: poses
    /// that met one are left out.
    pub fn load(&mut self, poses: &Poses, sampled: &SampledSbrdf, index: usize, options: &FitOptions) {
        self.solver.arch.dispatch(Load(&mut self.solver.data, poses, sampled, index, options.weights));
        self.neighbour.clear();
        self.mirror = if options.choose { Mirror::of(&self.solver.data) } else { None };
        for &pose in self.mirror.iter().flat_map(|mirror| &mirror.poses) {
            self.solver.data.leave_out(pose);
        }
    }

    /// Takes samples of which the directions are known one by one, with a bank of their own.
    pub fn take(&mut self, samples: &Samples) {
        self.mirror = None;
        self.neighbour.clear();
        self.solver.data.take(samples);
        self.bank.fill(&self.solver.data.products, self.solver.data.cone);
    }

    /// As [`Self::take`], for samples of several texels that follow each other, each with a ρ_d of its own
    /// ([`levels`](super::levels)): `starts` says where the texels begin and where the last ends. Lobes keep
    /// the bound on albedos beside a ρ_d of `level`, which is what the fit then has.
    pub fn take_texels(&mut self, samples: &Samples, starts: &[usize], level: [f64; CHANNELS]) {
        self.take(samples);
        self.solver.data.texels.extend_from_slice(starts);
        self.level = level;
    }

    /// Fits the samples that were read, of the texel that follows in the block's order, row by row; `column`
    /// is its place in the row. It starts from what was found left of it and above it, and searches where
    /// that does not lead to as good a fit.
    pub fn fit_next(&mut self, options: &FitOptions, column: usize) -> TexelFit {
        let mut columns = std::mem::take(&mut self.columns);
        let sides = [
            column.checked_sub(1).and_then(|left| columns.get(left)),
            columns.get(column),
            columns.get(column + 1),
        ];
        let near: Vec<&Vec<Trail>> = sides.into_iter().flatten().collect();
        let mut trails = Vec::new();
        let told = [column.checked_sub(1).and_then(|left| self.told.get(left)), self.told.get(column)];
        self.neighbour = told.into_iter().flatten().next().cloned().unwrap_or_default();
        let fit = self.fit_by(options, |workspace, group, task| {
            let near: Vec<&Trail> = near.iter().filter_map(|trails| trails.get(group)).collect();
            let (found, model, trail) = workspace.search(task, &near);
            workspace.trail.clone_from(&trail);
            let extended = workspace.extended(options, task, (found, model), &trail);
            trails.truncate(group);
            trails.push(trail);
            extended
        });
        columns.resize_with(columns.len().max(column + 1), Vec::new);
        columns[column] = trails;
        self.columns = columns;
        self.told.resize_with(self.columns.len(), Vec::new);
        self.told[column] = std::mem::take(&mut self.neighbour);
        fit
    }

    /// Fits the samples that were read. With fewer samples than unknowns fewer lobes are fitted, with none
    /// the texel is black.
    pub fn fit(&mut self, options: &FitOptions) -> TexelFit {
        self.fit_by(options, |workspace, _, task| {
            let (found, model, trail) = workspace.search(task, &[]);
            workspace.trail.clone_from(&trail);
            workspace.extended(options, task, (found, model), &trail)
        })
    }

    /// As [`Self::fit`] by another search: given the place of a group of channels, at which the samples are
    /// aimed, and its task.
    pub fn fit_by(
        &mut self,
        options: &FitOptions,
        search: impl FnMut(&mut Self, usize, Task) -> (Task, Model),
    ) -> TexelFit {
        self.fit_tied(options, true, search)
    }

    /// The fit of the samples that were read without any prior, for comparison.
    #[cfg(test)]
    pub(super) fn untied(&mut self, options: &FitOptions) -> LobeBrdf {
        let search = |workspace: &mut Self, _: usize, task: Task| {
            let (task, model, _) = workspace.search(task, &[]);
            (task, model)
        };
        self.fit_tied(options, false, search).brdf
    }

    fn fit_tied(
        &mut self,
        options: &FitOptions,
        tie: bool,
        mut search: impl FnMut(&mut Self, usize, Task) -> (Task, Model),
    ) -> TexelFit {
        let fixed = self.fixed_diffuse(options);
        let mut brdf = LobeBrdf { rho_d: fixed.map_or(Rgb::ZERO, rgb), ..LobeBrdf::default() };
        let mut sigma = Sigma::default();
        let (mut sums, mut free_error) = ([0.0; 3], 0.0);
        let (mut tied, mut bounded, mut doubtful) = (0, false, false);
        for (place, channels) in channel_groups(options).iter().enumerate() {
            let whole_task = self.aim(options, channels);
            let (mut task, mut model) = search(self, place, whole_task);
            if options.robust {
                (task, model) = self.withstand(options, channels, (task, model), |workspace, task| {
                    search(workspace, place, task)
                });
            }
            doubtful |= std::mem::take(&mut self.doubtful);
            let free = self.squares(task, &model, channels)[0];
            if let Some(bound) = self.bound(options, channels) {
                if let Some(held) = self.bounded(whole_task, (task, &model), bound) {
                    ((task, model), bounded) = (held, true);
                }
                // Whatever moves shapes from here on keeps the bound too.
                self.solver.hold(Some(bound));
                if let Some(tamed) = self.tamed(task, &model) {
                    (model, bounded) = (tamed, true);
                }
            }
            if tie {
                tied += self.tie(place, task, &mut model);
            }
            let at = self.solver.evaluate(task.family, task.diffuse, &model);
            let part = self.brdf(channels, &model, &at);
            brdf.rho_d += part.rho_d;
            brdf.beta = part.beta;
            brdf.normal = part.normal;
            brdf.lobes.extend(part.lobes);
            brdf.microfacets.extend(part.microfacets);
            let of_group = uncertainty::sigma(&self.solver, task.family, task.diffuse, &model, &at);
            sigma.take(channels, of_group, model.beta);
            let squares = self.squares(task, &model, channels);
            sums.iter_mut().zip(squares).for_each(|(sum, square)| *sum += square);
            free_error += free;
        }
        let [error, whole, weighted] = sums;
        if !options.choose && !options.separate_channels {
            sigma.lobes.resize(options.lobes, uncertainty::untold(&self.solver));
        }
        let valid = self.solver.data.valid;
        let share = |error: f64| if whole > 0.0 { (error / whole).sqrt() } else { 0.0 };
        let by_sigma = options.weights == Weights::Sigma;
        TexelFit {
            over_noise: by_sigma.then(|| over_noise(weighted, valid, &brdf, options)).flatten(),
            brdf,
            rms: (error / (3 * valid).max(1) as f64).sqrt(),
            relative: share(error),
            samples: valid,
            sigma: Some(sigma),
            mirror: self.mirror.clone(),
            tied,
            doubtful,
            bound_price: bounded.then(|| (share(error) - share(free_error)).max(0.0)),
        }
    }

    /// Sums of squares of the residuals and of the samples, sr⁻², and of the weighted residuals.
    fn squares(&mut self, task: Task, model: &Model, channels: &[usize]) -> [f64; 3] {
        let at = self.solver.evaluate(task.family, task.diffuse, model);
        let layout = self.solver.layout(task.family, task.diffuse, model);
        self.solver.arch.dispatch(Squares(&self.solver, &at, channels, layout))
    }

    /// What the directional albedos of channels are held to.
    fn bound(&self, options: &FitOptions, channels: &[usize]) -> Option<Bound> {
        let albedo = options.largest_albedo()?;
        let mut fixed = [0.0; CHANNELS];
        if let Some(rho_d) = self.fixed_diffuse(options) {
            for (fixed, &channel) in fixed.iter_mut().zip(channels) {
                *fixed = std::f64::consts::PI * rho_d[channel];
            }
        }
        Some(Bound { albedo, fixed })
    }

    /// The fit under a bound, where the free one breaks it: from the free one's shapes, and from a search of
    /// its own.
    fn bounded(&mut self, whole: Task, (task, model): (Task, &Model), bound: Bound) -> Option<(Task, Model)> {
        let at = self.solver.evaluate(task.family, task.diffuse, model);
        if self.solver.excess((task.family, task.diffuse), model, &at, bound) <= 1.0 {
            return None;
        }
        self.solver.hold(Some(bound));
        let mut near = model.clone();
        let limits = task.effort.limits;
        let from_free = start::minimise(&mut self.solver, task, limits, &mut near).1.cost;
        let data = &self.solver.data;
        if self.bank.count != data.len() {
            self.bank.fill(&data.products, data.cone);
        }
        // The texel's own free fits that the last one contains, so that it does not end above them.
        let mut trail = std::mem::take(&mut self.trail);
        if trail[0].len() == whole.lobes {
            trail[0].pop();
        }
        let own = [&trail];
        let (searched_task, searched, _) = self.search(whole, if whole.choose { &[] } else { &own });
        let from_search = self.solver.evaluate(searched_task.family, searched_task.diffuse, &searched).cost;
        // Where the number of lobes is a choice, the search has chosen it under the bound.
        let worth = if whole.choose { CHOSEN_UNDER_BOUND } else { 1.0 };
        Some(if from_search <= worth * from_free { (searched_task, searched) } else { (task, near) })
    }

    /// The fit where the samples do not tell a lobe's shape and it would exceed all that was measured where
    /// no pose looked: there it may not. From the shapes as they are, from lobes that do not grow toward
    /// grazing, and from the fit with one lobe less and the bank.
    fn tamed(&mut self, task: Task, model: &Model) -> Option<Model> {
        let Self { solver, bank, search, trail, .. } = self;
        let of = (task.family, task.diffuse);
        let at = solver.evaluate(of.0, of.1, model);
        let wild = wild::limits(solver, of, task.choose, model, &at)?;
        let mut level = model.clone();
        for (lobe, _) in level.lobes.iter_mut().zip(wild).filter(|(_, limit)| limit.is_finite()) {
            let side = if lobe.c.x < 0.0 { -1.0 } else { 1.0 };
            lobe.c = DVec3::new(side, side, 1.0).normalize();
        }
        let mut starts = vec![(model.clone(), wild), (level, wild)];
        let plain = Layout::of(task.family, model).extension.is_none();
        let own = trail.iter().find(|known| known.len() == model.lobes.len());
        let below = model.lobes.len().checked_sub(2).and_then(|place| own?.get(place));
        if let Some(below) = below.filter(|_| plain) {
            let at = solver.evaluate(of.0, of.1, &below.model);
            let mut limits = wild::limits(solver, of, task.choose, &below.model, &at).unwrap_or(WILD);
            limits[below.model.lobes.len()] = UNTOLD;
            solver.tame(limits);
            starts.extend(search.one_more(solver, bank, task, &below.model).map(|model| (model, limits)));
        }
        let mut best: Option<(f64, Model, _)> = None;
        for (mut model, limits) in starts {
            solver.tame(limits);
            let cost = start::minimise(solver, task, task.effort.limits, &mut model).1.cost;
            if best.as_ref().is_none_or(|(least, ..)| cost < *least) {
                best = Some((cost, model, limits));
            }
        }
        let (_, model, limits) = best?;
        solver.tame(limits);
        Some(model)
    }

    /// Ties what the samples do not tell of the model of a group of channels to the neighbour's, or else to
    /// Phong's; leaves in its place what the next texel may be tied to.
    fn tie(&mut self, group: usize, task: Task, model: &mut Model) -> usize {
        self.neighbour.resize(self.neighbour.len().max(group + 1), None);
        let alike = self.neighbour[group]
            .take()
            .filter(|(family, near)| *family == task.family && !near.lobes.is_empty());
        let near = alike.as_ref().map(|(_, near)| near);
        let tied = prior::tie(&mut self.solver, task, model, near);
        // What was not told here is not handed on; what the neighbour told may be.
        self.neighbour[group] = if tied == 0 { Some((task.family, model.clone())) } else { alike };
        tied
    }

    /// The fit of samples some of which may lie far off: their weights and the fit follow each other.
    fn withstand(
        &mut self,
        options: &FitOptions,
        channels: &[usize],
        (mut task, mut model): (Task, Model),
        mut search: impl FnMut(&mut Self, Task) -> (Task, Model),
    ) -> (Task, Model) {
        let mut factors = vec![1.0; self.solver.data.len()];
        for round in 0..robust::ROUNDS {
            let at = self.solver.evaluate(task.family, task.diffuse, &model);
            let layout = self.solver.layout(task.family, task.diffuse, &model);
            factors = robust::factors(round, &self.solver, layout, &at, &factors);
            let whole = self.aim(options, channels);
            self.solver.data.reweigh(&factors);
            self.solver.begin();
            if round == 0 {
                // Outliers may have drawn a lobe to where it would not come back from.
                (task, model) = search(self, whole);
            } else {
                start::minimise(&mut self.solver, task, task.effort.limits, &mut model);
            }
        }
        (task, model)
    }

    /// Weights the samples that were read for fitting `channels` together; what is then to be done.
    pub fn aim(&mut self, options: &FitOptions, channels: &[usize]) -> Task {
        let fixed = self.fixed_diffuse(options);
        self.solver.hold(None);
        self.solver.tame(WILD);
        let arch = self.solver.arch;
        arch.dispatch(Aim(&mut self.solver.data, channels, options.residual, fixed));
        self.solver.begin();
        let lobes = affordable_lobes(self.solver.data.telling(), options);
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
            _ if !self.solver.data.texels.is_empty() => Some(self.level),
            Diffuse::Percentile(percentile) if affordable_lobes(self.solver.data.valid, options) > 0 => {
                Some(self.percentile(percentile))
            }
            _ => None,
        }
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
        let lobes = model.lobes.len();
        let rho_s: Vec<Rgb> = (1..=lobes).map(colour).collect();
        let coat = model.coat.map(|coat| Microfacet {
            f0: colour(lobes + 1),
            f90: colour(lobes + 2),
            alpha: coat.alpha as f32,
        });
        LobeBrdf { microfacets: coat.into_iter().collect(), ..model.to_brdf(colour(0), &rho_s) }
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
