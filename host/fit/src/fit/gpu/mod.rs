//! The separable fit on the GPU (WGSL, `shaders/fit.wgsl`): the CPU weights the samples, the GPU searches the
//! shapes of a batch of texels at once in f32, the CPU finishes each texel in f64: amplitudes, the last step
//! where the GPU stopped short of the tolerance, and uncertainties. The search is that of
//! [`start`](super::separable::start), step for step, but that a texel's bank of shapes is made for its own
//! directions.
//!
//! What differs from the CPU is which of two sets of shapes of nearly the same cost goes on, and where within
//! the tolerance the optimiser stops.

mod kernels;
mod search;
#[cfg(test)]
mod tests;

use std::sync::OnceLock;
use std::time::Instant;

use glam::{Vec3, Vec4};
use rayon::prelude::*;

use super::model::Model;
use super::separable::choice::Ascent;
use super::separable::data::Poses;
use super::separable::layout::Family;
use super::separable::start::{Found, minimise};
use super::separable::task::Task;
use super::separable::texel::{Workspace, channel_groups};
use super::texel::TexelFit;
use super::weights::Weights;
use super::{Device, FitOptions, Method};
use kernels::{Kernels, Samples, Uploaded};
use lobelia_base::error::{Error, Result};
use lobelia_gpu::fit::{Fit, Texel};
use lobelia_reflectance::sampled::{SampledSbrdf, SampledStore};
use search::Beam;

/// Fewer texels are fitted before a GPU is opened and its pipelines are built.
const LEAST_TEXELS: usize = 1 << 14;

/// The GPU, opened when it is first asked for.
fn shared() -> Result<&'static Kernels> {
    static KERNELS: OnceLock<std::result::Result<Kernels, String>> = OnceLock::new();
    let opened = KERNELS.get_or_init(|| Kernels::open().map_err(|error| error.to_string()));
    opened.as_ref().map_err(|message| Error::failure(message.as_str()))
}

/// Name and driver of the GPU.
///
/// # Errors
/// A failure when there is none.
pub fn name() -> Result<String> {
    Ok(shared()?.gpu.name())
}

/// The device that fits a store faster: the GPU where the store is large and there is a GPU that is no
/// software and fits a chunk of the store in less time than the CPU.
///
/// # Errors
/// When that chunk cannot be read.
pub fn faster(store: &SampledStore, options: &FitOptions) -> Result<Device> {
    let large = store.width * store.height >= LEAST_TEXELS;
    let worthwhile = large && options.method == Method::Separable && options.lobes > 0 && !options.robust;
    let worthwhile = worthwhile && options.extensions.is_none();
    let hardware = worthwhile && shared().is_ok_and(|kernels| !kernels.gpu.is_software());
    if !hardware {
        return Ok(Device::Cpu);
    }
    let windows = store.blocks();
    let chunk = store.read(&windows[windows.len() / 2], options.weights == Weights::Sigma)?;
    let time = |device: Device| {
        let start = Instant::now();
        super::fit_window(&chunk, &FitOptions { device, ..*options }, || ()).map(|_| start.elapsed())
    };
    // The first fit builds the pipelines.
    let gpu = time(Device::Gpu).and_then(|_| time(Device::Gpu));
    Ok(match (gpu, time(Device::Cpu)) {
        (Ok(gpu), Ok(cpu)) if gpu < cpu => Device::Gpu,
        _ => Device::Cpu,
    })
}

/// Fits every texel; `done` is called a texel.
///
/// # Errors
/// A failure when there is no GPU or the driver refuses.
pub(super) fn fit(
    sampled: &SampledSbrdf,
    options: &FitOptions,
    done: &(impl Fn() + Sync),
) -> Result<Vec<TexelFit>> {
    let kernels = shared()?;
    let poses = Poses::new(&sampled.poses);
    let batch = kernels.batch(poses.len());
    let mut fits = Vec::with_capacity(sampled.texels());
    for first in (0..sampled.texels()).step_by(batch) {
        let texels: Vec<usize> = (first..sampled.texels().min(first + batch)).collect();
        let batch = Batch { kernels, poses: &poses, sampled, options, texels };
        fits.extend(batch.fit(done)?);
    }
    Ok(fits)
}

/// Texels that are fitted together.
struct Batch<'a> {
    kernels: &'a Kernels,
    poses: &'a Poses,
    sampled: &'a SampledSbrdf,
    options: &'a FitOptions,
    texels: Vec<usize>,
}

/// A model with the task that it belongs to.
type Solution = (Task, Model);

impl Batch<'_> {
    fn fit(&self, done: &(impl Fn() + Sync)) -> Result<Vec<TexelFit>> {
        let groups = channel_groups(self.options);
        let solutions: Vec<Vec<Solution>> =
            groups.iter().map(|channels| self.solutions(channels)).collect::<Result<_>>()?;
        let finish = |workspace: &mut Workspace, place: usize| {
            workspace.load(self.poses, self.sampled, self.texels[place], self.options);
            let fit = workspace.fit_by(self.options, |workspace, group, _| {
                let (task, mut model) = solutions[group][place].clone();
                minimise(&mut workspace.solver, task, task.effort.limits, &mut model);
                (task, model)
            });
            done();
            fit
        };
        Ok((0..self.texels.len()).into_par_iter().map_init(Workspace::default, finish).collect())
    }

    /// The best model of every texel for channels that are fitted together.
    fn solutions(&self, channels: &[usize]) -> Result<Vec<Solution>> {
        let (samples, starts) = self.prepare(channels);
        let uploaded = self.kernels.upload(&samples)?;
        let tasks: Vec<Task> = starts.iter().map(|(task, _)| *task).collect();
        let fits: Vec<Fit> = starts.into_iter().map(|(_, fit)| fit).collect();
        if !self.options.choose {
            return self.fixed(&uploaded, &tasks, &fits);
        }
        let family = if self.options.isotropic { Family::Isotropic } else { Family::Anisotropic };
        let found = self.chosen(&uploaded, channels, family, &tasks, &fits)?;
        if family == Family::Isotropic {
            return Ok(tasks.into_iter().zip(found.into_iter().map(|found| found.model)).collect());
        }
        let isotropic = self.chosen(&uploaded, channels, Family::Isotropic, &tasks, &fits)?;
        let pairs = tasks.into_iter().zip(found.into_iter().zip(isotropic));
        Ok(pairs.map(|(task, (anisotropic, isotropic))| task.better_family(anisotropic, isotropic)).collect())
    }

    /// Weights the samples; the task and the fit without lobes of every texel.
    fn prepare(&self, channels: &[usize]) -> (Samples, Vec<(Task, Fit)>) {
        let (count, poses) = (self.texels.len(), self.poses.len());
        let mut samples = Samples {
            products: vec![Vec4::ZERO; count * poses],
            aimed: vec![Vec4::ZERO; count * poses],
            texels: vec![Texel::default(); count],
            poses,
            channels: channels.len(),
            diffuse: self.options.diffuse == super::Diffuse::Joint,
        };
        let lists = samples.products.par_chunks_mut(poses).zip(samples.aimed.par_chunks_mut(poses));
        let places = lists.zip(&mut samples.texels).enumerate();
        let starts = places.map_init(Workspace::default, |workspace, (place, ((products, aimed), texel))| {
            workspace.load(self.poses, self.sampled, self.texels[place], self.options);
            let task = workspace.aim(self.options, channels);
            let at = workspace.solver.evaluate(task.family, task.diffuse, &Model::default());
            let data = &workspace.solver.data;
            let of = &data.products;
            // Places without a valid sample stay 0.
            for k in (0..poses).filter(|&k| data.root[k] > 0.0) {
                products[k] = Vec4::from_array([of.xx[k], of.yy[k], of.zz[k], of.xy[k]].map(|x| x as f32));
                aimed[k].x = data.root[k] as f32;
                for (place, goal) in data.goal.iter().enumerate().take(channels.len()) {
                    aimed[k][1 + place] = goal[k] as f32;
                }
            }
            let whole: f64 = aimed.iter().map(|a| f64::from(a.length_squared() - a.x * a.x)).sum();
            texel.most = Vec3::from_array(data.most.map(|x| x as f32)).extend(whole as f32);
            texel.cone = Vec4::new(data.cone[0] as f32, data.cone[1] as f32, 0.0, 0.0);
            (task, kernels::diffuse(place, &at))
        });
        let starts = starts.collect();
        (samples, starts)
    }

    /// The models with as many lobes as were asked for.
    fn fixed(&self, samples: &Uploaded, tasks: &[Task], starts: &[Fit]) -> Result<Vec<Solution>> {
        let Some(task) = tasks.iter().max_by_key(|task| task.lobes) else { return Ok(Vec::new()) };
        let mut beam = Beam::new(self.kernels, samples, task.family, task.effort, starts);
        for lobes in 0..task.lobes {
            let texels: Vec<usize> = (0..tasks.len()).filter(|&place| tasks[place].lobes > lobes).collect();
            beam.grow(&texels, lobes)?;
        }
        let all: Vec<usize> = (0..tasks.len()).collect();
        Ok(tasks.iter().copied().zip(beam.converged(&all)?).collect())
    }

    /// For every texel the fit with as many lobes of a family as [`choice`] finds supported.
    fn chosen(
        &self,
        samples: &Uploaded,
        channels: &[usize],
        family: Family,
        tasks: &[Task],
        starts: &[Fit],
    ) -> Result<Vec<Found>> {
        let judge = |models: Vec<(usize, Model)>| -> Vec<(usize, Found)> {
            let judged = models.into_par_iter().map_init(Workspace::default, |workspace, (place, model)| {
                workspace.load(self.poses, self.sampled, self.texels[place], self.options);
                workspace.aim(self.options, channels);
                (place, Found::of(&mut workspace.solver, Task { family, ..tasks[place] }, model))
            });
            judged.collect()
        };
        let Some(task) = tasks.iter().max_by_key(|task| task.lobes) else { return Ok(Vec::new()) };
        let mut beam = Beam::new(self.kernels, samples, family, task.effort, starts);
        let mut active: Vec<usize> = (0..tasks.len()).collect();
        let without = active.iter().map(|&place| (place, Model::default())).collect();
        let mut best: Vec<Found> = judge(without).into_iter().map(|(_, found)| found).collect();
        let mut ascents = vec![Ascent::default(); tasks.len()];
        for lobes in 0..task.lobes {
            active.retain(|&place| tasks[place].lobes > lobes);
            beam.grow(&active, lobes)?;
            let models = active.iter().copied().zip(beam.converged(&active)?).collect();
            active.clear();
            for (place, found) in judge(models) {
                let (better, further) = ascents[place].step(&found.left_out, &best[place].left_out);
                if better {
                    best[place] = found;
                }
                if further {
                    active.push(place);
                }
            }
        }
        Ok(best)
    }
}
