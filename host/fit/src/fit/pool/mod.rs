//! Pooled fits (3.5, 4.6): one BRDF a region of texels from the samples of all of them, each at its own
//! directions.
//!
//! A light and a camera that stand near see every texel from other directions, so that a few photographs of a
//! region hold many pairs of directions of its material. The lobes are the region's; ρ_d is the region's as
//! well, or each texel's own ([`RhoD`]). The fit is the separable one over all samples at once, of texels
//! chosen at random where there are too many.
//!
//! [`regions`] reads which texel is of which region, `choose` which of them are fitted, `region` fits one
//! region, `texels` gives every texel its coefficients and errors.

mod choose;
mod level;
mod region;
pub mod regions;
#[cfg(test)]
mod tests;
mod texels;

use rayon::prelude::*;

use super::samples::{self, Sample};
use super::separable;
use super::texel::TexelFit;
use super::weights::Weights;
use super::{Device, Diffuse, FitOptions, Method, chunks, has_samples, planes};
use lobelia_base::error::{Error, Result};
use lobelia_base::progress;
use lobelia_reflectance::SbrdfMap;
use lobelia_reflectance::sampled::{PoseGeometry, SampledSbrdf, SampledStore, Window};
use lobelia_reflectance::warning::samples::Tally;
use region::RegionFit;
use regions::Regions;
use texels::Totals;

/// Samples to which a region is fitted, unless another number is asked for.
pub const MOST_SAMPLES: usize = 32_768;
/// Samples that are in memory at once, of as many regions as that allows.
const IN_MEMORY: usize = 2_000_000;

/// Whose ρ_d is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum RhoD {
    /// One a region.
    #[default]
    Region,
    /// One a texel, beside the region's lobes.
    Texel,
}

impl RhoD {
    /// The name on the command line and in maps.
    pub fn name(self) -> &'static str {
        match self {
            Self::Region => "region",
            Self::Texel => "texel",
        }
    }
}

/// How texels are pooled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PoolOptions {
    /// Whose ρ_d is.
    pub rho_d: RhoD,
    /// Most samples to which a region is fitted. Beyond it, those of whole texels, drawn among the texels
    /// that have any, are taken.
    pub most_samples: usize,
    /// Seed of that choice.
    pub seed: u64,
}

impl Default for PoolOptions {
    fn default() -> Self {
        Self { rho_d: RhoD::Region, most_samples: MOST_SAMPLES, seed: 1 }
    }
}

/// The map of a pooled fit, and what came of its regions.
#[derive(Debug, Clone, PartialEq)]
pub struct Pooled {
    /// Every texel of a region has its lobes; texels outside are black. Beside the planes of
    /// [`super::fit_sbrdf`] there is `region`: its number from 1, 0 outside.
    pub map: SbrdfMap,
    /// In the order of their numbers.
    pub regions: Vec<RegionReport>,
}

/// What came of a region.
#[derive(Debug, Clone, PartialEq)]
pub struct RegionReport {
    /// Number and colour.
    pub name: String,
    /// Texels.
    pub texels: usize,
    /// Valid samples of all its texels.
    pub samples: usize,
    /// Those to which the lobes were fitted.
    pub fitted: usize,
    /// Lobes.
    pub lobes: usize,
    /// RMS of the residual over all samples and channels, sr⁻¹.
    pub rms: f64,
    /// The same over the RMS of the samples; 0 for black ones.
    pub relative: f64,
    /// Texels that were changed so that they make no light.
    pub bounded: usize,
}

/// Refuses what a pooled fit cannot do.
///
/// # Errors
/// As [`FitOptions::check`]; another method than the separable one, the GPU, and with a ρ_d a texel a
/// percentile or a robust fit.
pub fn check(options: &FitOptions, pool: &PoolOptions) -> Result<()> {
    options.check()?;
    let refused = |message: &str| Err(Error::input(message));
    if options.method != Method::Separable {
        return refused(
            "a pooled fit is made by the separable method alone; leave --method and --residual out",
        );
    }
    if options.device == Device::Gpu {
        return refused("a pooled fit is made on the CPU alone; use --device cpu");
    }
    if pool.most_samples == 0 {
        return refused("a region cannot be fitted to 0 samples");
    }
    if pool.rho_d == RhoD::Texel && matches!(options.diffuse, Diffuse::Percentile(_)) {
        return refused("a ρ_d a texel is fitted beside the lobes; it cannot be a percentile as well");
    }
    if pool.rho_d == RhoD::Texel && options.robust {
        return refused(
            "a robust pooled fit needs --pool-rho-d region: a texel's own ρ_d would follow its outliers",
        );
    }
    Ok(())
}

/// Fits the regions of a store, of which a few blocks are in memory at a time.
///
/// # Errors
/// As [`check`]; regions of another size than the store; no valid sample; a chunk that cannot be read.
pub fn fit_store(
    store: &SampledStore,
    regions: &Regions,
    options: &FitOptions,
    pool: &PoolOptions,
) -> Result<Pooled> {
    fit_store_counted(store, regions, options, pool, &Tally::default())
}

/// As [`fit_store`]; the samples of the whole store are counted.
///
/// # Errors
/// As there.
pub fn fit_store_counted(
    store: &SampledStore,
    regions: &Regions,
    options: &FitOptions,
    pool: &PoolOptions,
    tally: &Tally,
) -> Result<Pooled> {
    let sigma = options.weights == Weights::Sigma;
    if sigma && !store.has_sigma() {
        return Err(super::no_sigma());
    }
    let source = Source {
        size: [store.width, store.height],
        texel_mm: store.texel_mm,
        poses: weighing(&store.poses),
        blocks: store.blocks(),
    };
    let read = |window: &Window| -> Result<SampledSbrdf> { store.read(window, sigma) };
    fit(&source, read, |block: &SampledSbrdf| tally.count(block), regions, options, pool)
}

/// Fits the regions of a sampled SBRDF in memory.
///
/// # Errors
/// As [`fit_store`].
pub fn fit_sbrdf(
    sampled: &SampledSbrdf,
    regions: &Regions,
    options: &FitOptions,
    pool: &PoolOptions,
) -> Result<Pooled> {
    if options.weights == Weights::Sigma && sampled.sigma.is_none() {
        return Err(super::no_sigma());
    }
    let source = Source {
        size: [sampled.width, sampled.height],
        texel_mm: sampled.texel_mm,
        poses: weighing(&sampled.poses),
        blocks: vec![Window { x: 0..sampled.width, y: 0..sampled.height }],
    };
    let read = |_: &Window| -> Result<SampledSbrdf> { Ok(sampled.clone()) };
    fit(&source, read, |_: &SampledSbrdf| (), regions, options, pool)
}

/// Where samples come from.
struct Source {
    size: [usize; 2],
    texel_mm: f64,
    /// Poses of some weight.
    poses: usize,
    blocks: Vec<Window>,
}

fn weighing(poses: &[PoseGeometry]) -> usize {
    poses.iter().filter(|pose| pose.weight > 0.0).count()
}

/// The samples of some texels of a region.
#[derive(Debug, Clone, Default)]
struct Gathered {
    /// Texel after texel.
    samples: Vec<Sample>,
    /// Where each texel begins and the last ends.
    starts: Vec<usize>,
}

impl Gathered {
    /// The samples of each texel.
    fn texels(&self) -> impl Iterator<Item = &[Sample]> {
        self.starts.windows(2).map(|ends| &self.samples[ends[0]..ends[1]])
    }
}

/// `seen` is called once with each block of samples.
fn fit(
    source: &Source,
    read: impl Fn(&Window) -> Result<SampledSbrdf> + Sync,
    seen: impl Fn(&SampledSbrdf) + Sync,
    regions: &Regions,
    options: &FitOptions,
    pool: &PoolOptions,
) -> Result<Pooled> {
    check(options, pool)?;
    if [regions.width, regions.height] != source.size {
        return Err(Error::input("the regions are not those of a sample of this size"));
    }
    let chosen = choose::texels(source, &read, regions, options.weights, pool)?;
    let bar = progress::bar("fitting", regions.colours.len() as u64, "regions");
    let mut fits: Vec<RegionFit> = Vec::with_capacity(chosen.len());
    for batch in batches(&chosen, source.poses) {
        let gathered = gather(source, &read, regions, &chosen[batch.clone()], batch.start, options.weights)?;
        let found: Vec<RegionFit> = (gathered.par_iter())
            .map_init(separable::texel::Workspace::default, |workspace, gathered| {
                let fit = region::fit(workspace, gathered, options, pool.rho_d);
                bar.advance(1);
                fit
            })
            .collect();
        fits.extend(found);
    }
    drop(bar);
    let read_once = |window: &Window| -> Result<SampledSbrdf> {
        let sampled = read(window)?;
        seen(&sampled);
        Ok(sampled)
    };
    let (map, totals) = texel_map(source, &read_once, regions, &fits, options, pool)?;
    has_samples(&map)?;
    let report = |(region, (fit, totals)): (usize, (&RegionFit, &Totals))| RegionReport {
        name: regions.name(region),
        texels: totals.texels,
        samples: totals.samples,
        fitted: fit.fitted,
        lobes: fit.fit.brdf.lobes.len(),
        rms: (totals.error / (3 * totals.samples).max(1) as f64).sqrt(),
        relative: if totals.whole > 0.0 { (totals.error / totals.whole).sqrt() } else { 0.0 },
        bounded: totals.bounded,
    };
    Ok(Pooled { map, regions: fits.iter().zip(&totals).enumerate().map(report).collect() })
}

/// Runs of regions whose samples are in memory together.
fn batches(chosen: &[Vec<usize>], poses: usize) -> Vec<std::ops::Range<usize>> {
    let (mut batches, mut first, mut rows) = (Vec::new(), 0, 0);
    for (region, texels) in chosen.iter().enumerate() {
        if region > first && rows + texels.len() * poses > IN_MEMORY {
            batches.push(first..region);
            (first, rows) = (region, 0);
        }
        rows += texels.len() * poses;
    }
    batches.push(first..chosen.len());
    batches
}

/// The texels of a window, row by row, as indices of the whole sample.
fn indices(window: &Window, width: usize) -> impl Iterator<Item = usize> + '_ {
    window.y.clone().flat_map(move |y| window.x.clone().map(move |x| y * width + x))
}

/// Reads the samples of the texels chosen of consecutive regions, the first of which is `first`.
fn gather(
    source: &Source,
    read: &(impl Fn(&Window) -> Result<SampledSbrdf> + Sync),
    regions: &Regions,
    chosen: &[Vec<usize>],
    first: usize,
    weights: Weights,
) -> Result<Vec<Gathered>> {
    let place = |texel: usize| {
        let region = regions.of[texel]?.checked_sub(first)?;
        chosen.get(region)?.binary_search(&texel).is_ok().then_some(region)
    };
    // Of each block the region's place and the samples of every chosen texel.
    let of_block = |window: &Window| -> Result<Vec<(usize, Vec<Sample>)>> {
        let wanted: Vec<(usize, usize)> = indices(window, source.size[0])
            .enumerate()
            .filter_map(|(index, texel)| Some((index, place(texel)?)))
            .collect();
        if wanted.is_empty() {
            return Ok(Vec::new());
        }
        let sampled = read(window)?;
        let samples = |index| samples::of_texel(&sampled, index, weights).collect::<Vec<Sample>>();
        Ok(wanted.into_iter().map(|(index, region)| (region, samples(index))).collect())
    };
    let mut gathered = vec![Gathered { starts: vec![0], ..Gathered::default() }; chosen.len()];
    for blocks in source.blocks.chunks(2 * rayon::current_num_threads()) {
        let found: Vec<Result<Vec<_>>> = blocks.par_iter().map(of_block).collect();
        for block in found {
            for (region, samples) in block?.into_iter().filter(|(_, samples)| !samples.is_empty()) {
                gathered[region].samples.extend(samples);
                let end = gathered[region].samples.len();
                gathered[region].starts.push(end);
            }
        }
    }
    Ok(gathered)
}

/// The coefficients and errors of every texel, as a map, and the sums of every region.
fn texel_map(
    source: &Source,
    read: &(impl Fn(&Window) -> Result<SampledSbrdf> + Sync),
    regions: &Regions,
    fits: &[RegionFit],
    options: &FitOptions,
    pool: &PoolOptions,
) -> Result<(SbrdfMap, Vec<Totals>)> {
    let texels = source.size[0] * source.size[1];
    let bar = progress::bar("measuring", texels as u64, "texels");
    let of_block = |window: &Window| -> Result<(SbrdfMap, Vec<Totals>)> {
        let sampled = read(window)?;
        let mut totals = vec![Totals::default(); fits.len()];
        let mut found = Vec::with_capacity(window.texels());
        let mut numbers = Vec::with_capacity(window.texels());
        for (index, texel) in indices(window, source.size[0]).enumerate() {
            let region = regions.of[texel];
            found.push(match region {
                Some(region) => {
                    let samples: Vec<Sample> = samples::of_texel(&sampled, index, options.weights).collect();
                    texels::fit(&samples, &fits[region], options, pool.rho_d, &mut totals[region])
                }
                None => TexelFit::default(),
            });
            numbers.push(region.map_or(0.0, |region| (region + 1) as f32));
        }
        // A row of texels in the block's order.
        let row = SampledSbrdf::empty(window.texels(), 1, source.texel_mm, Vec::new());
        let mut map = planes::map_of(&row, options, &found);
        map.extra.insert("region".into(), numbers);
        bar.advance(window.texels() as u64);
        Ok((map, totals))
    };
    let mut totals = vec![Totals::default(); fits.len()];
    let mut rows = Vec::with_capacity(source.blocks.len());
    let blocks: Vec<Result<(SbrdfMap, Vec<Totals>)>> = source.blocks.par_iter().map(of_block).collect();
    for block in blocks {
        let (row, of_block) = block?;
        totals.iter_mut().zip(of_block).for_each(|(totals, of_block)| totals.add(of_block));
        rows.push(row);
    }
    let mut map = chunks::laid_out(source.size, &source.blocks, &rows.iter().collect::<Vec<_>>());
    let names: Vec<String> = (0..fits.len()).map(|region| regions.name(region)).collect();
    for (key, value) in [
        ("fit.pool", names.join(", ")),
        ("fit.pool_rho_d", pool.rho_d.name().into()),
        ("fit.pool_samples", pool.most_samples.to_string()),
    ] {
        map.attributes.insert(key.into(), value);
    }
    Ok((map, totals))
}
