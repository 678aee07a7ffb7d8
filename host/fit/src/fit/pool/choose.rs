//! The texels of every region to whose samples it is fitted.

use rayon::prelude::*;

use super::super::samples;
use super::super::weights::Weights;
use super::regions::Regions;
use super::{PoolOptions, Source, indices};
use lobelia_base::error::Result;
use lobelia_base::progress;
use lobelia_base::random::Random;
use lobelia_reflectance::sampled::{SampledSbrdf, Window};

/// The texels of every region, in order. Of a region that has more than samples allow, as many are drawn
/// among those that have a sample.
///
/// # Errors
/// When a chunk cannot be read.
pub(super) fn texels(
    source: &Source,
    read: &(impl Fn(&Window) -> Result<SampledSbrdf> + Sync),
    regions: &Regions,
    weights: Weights,
    pool: &PoolOptions,
) -> Result<Vec<Vec<usize>>> {
    let most = (pool.most_samples / source.poses.max(1)).max(1);
    let mut texels = regions.texels();
    let large: Vec<bool> = texels.iter().map(|texels| texels.len() > most).collect();
    if !large.contains(&true) {
        return Ok(texels);
    }
    let wanted = |texel: usize| regions.of[texel].is_some_and(|region| large[region]);
    let sampled = with_a_sample(source, read, wanted, weights)?;
    for (region, texels) in texels.iter_mut().enumerate().filter(|(region, _)| large[*region]) {
        texels.retain(|&texel| sampled[texel]);
        let seed = Random::new(pool.seed ^ 0x706f_6f6c).bits() ^ region as u64;
        Random::new(seed).draw(texels, most);
    }
    Ok(texels)
}

/// Which of the texels that are wanted have a valid sample.
fn with_a_sample(
    source: &Source,
    read: &(impl Fn(&Window) -> Result<SampledSbrdf> + Sync),
    wanted: impl Fn(usize) -> bool + Sync,
    weights: Weights,
) -> Result<Vec<bool>> {
    let [width, height] = source.size;
    let bar = progress::bar("looking for samples", (width * height) as u64, "texels");
    let of_block = |window: &Window| -> Result<Vec<usize>> {
        let mut places: Vec<(usize, usize)> =
            indices(window, width).enumerate().filter(|&(_, texel)| wanted(texel)).collect();
        if !places.is_empty() {
            let sampled = read(window)?;
            places.retain(|&(index, _)| samples::of_texel(&sampled, index, weights).next().is_some());
        }
        bar.advance(window.texels() as u64);
        Ok(places.into_iter().map(|(_, texel)| texel).collect())
    };
    let blocks: Vec<Result<Vec<usize>>> = source.blocks.par_iter().map(of_block).collect();
    let mut sampled = vec![false; width * height];
    for block in blocks {
        block?.into_iter().for_each(|texel| sampled[texel] = true);
    }
    Ok(sampled)
}
