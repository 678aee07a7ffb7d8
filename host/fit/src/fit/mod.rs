//! Fits lobes (4.1)–(4.4) to sampled reflectance: texel by texel into an SBRDF map, or to one measured table.
//!
//! Five methods. [`Method::Separable`]: variable projection with the albedos of all channels in closed form
//! ([`separable`]), for residuals that are linear in f. [`Method::Lm`]: shapes by Levenberg–Marquardt on
//! luminance ([`lm`]) from a deterministic search for the start ([`start`]), then the colours by non-negative
//! least squares (`albedo`); any number of lobes up to [`MOST_LOBES`]. [`Method::Ratio`]: the same with the
//! published colours (4.10). [`Method::LineSearch`]: the published search over n for one lobe
//! ([`line_search`]), above a percentile for ρ_d (`diffuse`); [`Method::LineSearchScaled`]: a variant of it
//! that stands noise better.
//!
//! [`pool`] fits one BRDF to all texels of a region; [`held_out`] tells errors on poses that were not fitted.

pub(crate) mod albedo;
pub(crate) mod brent;
pub mod chunks;
pub(crate) mod coat;
pub mod conserve;
pub(crate) mod diffuse;
pub mod evaluate;
pub mod extensions;
pub mod gpu;
pub mod held_out;
pub mod line_search;
pub mod linear;
pub mod lm;
pub mod model;
pub(crate) mod noted;
mod options;
mod planes;
pub mod pool;
pub(crate) mod quadratic;
pub mod request;
pub mod samples;
pub mod separable;
pub mod start;
pub mod table;
#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
pub mod texel;
pub mod weights;

use rayon::prelude::*;

pub use options::{AlbedoBound, Device, Diffuse, FitOptions, MOST_LOBES, Method, PERCENTILE, Residual};

use lobelia_base::error::{Error, Result};
use lobelia_base::progress;
use lobelia_reflectance::SbrdfMap;
use lobelia_reflectance::sampled::SampledSbrdf;
use texel::{TexelFit, Workspace};
use weights::Weights;

/// Fits every texel in parallel. Beside the coefficients the map has the planes `error.rms` (sr⁻¹),
/// `error.relative` and `samples` (valid ones a texel), where any does not tell all of its shapes'
/// coefficients `tied` ([`separable::prior`]: how many were not), where lobes are chosen and a mirror was met
/// `mirror.R`, `.G`, `.B` and `mirror.poses` ([`separable::mirror`]), and after the separable fit a standard
/// deviation a coefficient, `sigma.rho_d.R` and so on. Where the number of lobes is a choice, `lobes` has it
/// and `lobes.doubtful` marks texels in which another would predict left-out poses almost as well. Where
/// samples weigh by their standard deviations, `error.over_noise` is the residual's RMS over that of the
/// noise. Unless albedos are free, `bounded` marks the texels that were changed so that they make no light
/// and `error.bound_price` says by how much `error.relative` rose for it. The result is the same byte for
/// byte whatever the number of threads.
///
/// # Errors
/// Input errors: options that no method can do, or not one valid sample in any texel.
pub fn fit_sbrdf(sampled: &SampledSbrdf, options: &FitOptions) -> Result<SbrdfMap> {
    options.check()?;
    let bar = progress::bar("fitting", sampled.texels() as u64, "texels");
    let map = fit_window(sampled, options, || bar.advance(1))?;
    has_samples(&map)?;
    Ok(map)
}

/// Refuses a map of which no texel had a valid sample.
fn has_samples(map: &SbrdfMap) -> Result<()> {
    if map.extra["samples"].iter().all(|&samples| samples == 0.0) {
        return Err(Error::input("the sampled SBRDF has no valid sample in any texel"));
    }
    Ok(())
}

/// What is wrong where samples are to weigh by standard deviations that are not there.
fn no_sigma() -> Error {
    Error::input("the sampled SBRDF has no standard deviations to weigh by (array sigma); use --weights pose")
}

/// As [`fit_sbrdf`] with options that are checked, for a window that may be without any sample; `done` is
/// called a texel.
fn fit_window(sampled: &SampledSbrdf, options: &FitOptions, done: impl Fn() + Sync) -> Result<SbrdfMap> {
    if options.weights == Weights::Sigma && sampled.sigma.is_none() {
        return Err(no_sigma());
    }
    let fits = match options.method {
        Method::Separable if options.device == Device::Gpu => gpu::fit(sampled, options, &done)?,
        Method::Separable => fit_blocks(sampled, options, &done),
        Method::Lm | Method::Ratio | Method::LineSearch | Method::LineSearchScaled => {
            fit_texels(sampled, options, &done)
        }
    };
    Ok(planes::map_of(sampled, options, &fits))
}

/// Texel by texel.
fn fit_texels(sampled: &SampledSbrdf, options: &FitOptions, done: &(impl Fn() + Sync)) -> Vec<TexelFit> {
    (0..sampled.texels())
        .into_par_iter()
        .with_min_len(16)
        .map_init(Workspace::default, |workspace, index| {
            load(&mut workspace.samples, sampled, index, options, &[]);
            let fit = texel::fit(workspace, options);
            done();
            fit
        })
        .collect()
}

/// Edge of the blocks of texels that share the directions from which the separable fit starts.
const BLOCK: usize = 16;

/// The separable fit, block by block.
fn fit_blocks(sampled: &SampledSbrdf, options: &FitOptions, done: &(impl Fn() + Sync)) -> Vec<TexelFit> {
    let poses = separable::data::Poses::new(&sampled.poses).off_normal(options.extensions.normals);
    let (width, height) = (sampled.width, sampled.height);
    let columns = width.div_ceil(BLOCK);
    let blocks: Vec<Vec<TexelFit>> = (0..columns * height.div_ceil(BLOCK))
        .into_par_iter()
        .map_init(separable::texel::Workspace::default, |workspace, block| {
            let texels = block_texels(width, height, columns, block);
            workspace.settle(&poses, sampled, texels.clone().nth(texels.clone().count() / 2).unwrap_or(0));
            let fits = texels.map(|index| {
                workspace.load(&poses, sampled, index, options);
                let fit = workspace.fit_next(options, index % width % BLOCK);
                done();
                fit
            });
            fits.collect()
        })
        .collect();
    let mut fits: Vec<Option<TexelFit>> = vec![None; sampled.texels()];
    for (block, done) in blocks.into_iter().enumerate() {
        for (index, fit) in block_texels(width, height, columns, block).zip(done) {
            fits[index] = Some(fit);
        }
    }
    fits.into_iter().flatten().collect()
}

/// The texels of a block, row by row.
fn block_texels(
    width: usize,
    height: usize,
    columns: usize,
    block: usize,
) -> impl Iterator<Item = usize> + Clone {
    let (left, top) = (block % columns * BLOCK, block / columns * BLOCK);
    let (right, bottom) = ((left + BLOCK).min(width), (top + BLOCK).min(height));
    (top..bottom).flat_map(move |y| (left..right).map(move |x| y * width + x))
}

/// The samples of texel `index` but for some poses.
fn load(
    samples: &mut samples::Samples,
    sampled: &SampledSbrdf,
    index: usize,
    options: &FitOptions,
    left_out: &[usize],
) {
    samples.clear();
    let all = samples::of_texel(sampled, index, options.weights);
    for sample in all.filter(|sample| !left_out.contains(&sample.pose)) {
        samples.push_rgb(sample.wi, sample.wo, sample.rgb, sample.weight);
    }
}
