//! MIP levels from samples (chapter 5): each level is fitted to the reflectance averaged over its texels,
//! pose by pose, since averaged coefficients are not those of the averaged reflectance.
//!
//! Texel (x, y) of level l stands for the texels 2ˡx … 2ˡ(x+1) − 1 of its row, and so for rows; at the right
//! and lower edge for those of them that the sample has. Levels are ⌈size / 2ˡ⌉ large, down to one texel.
//! Standard deviations are those of means of independent values.

use std::path::{Path, PathBuf};

use half::f16;
use sha2::{Digest, Sha256};

use crate::sampled::{SampledSbrdf, SampledStore, Window};
use crate::{Rgb, SbrdfMap};
use lobelia_base::error::Result;

/// Columns and rows of a level of an image.
pub fn size([width, height]: [usize; 2], level: u32) -> [usize; 2] {
    [width, height].map(|edge| edge.div_ceil(1 << level))
}

/// The coarsest level, of one texel.
pub fn last(size: [usize; 2]) -> u32 {
    size[0].max(size[1]).max(1).next_power_of_two().trailing_zeros()
}

/// The file of a level beside that of the finest: `material.exr`, `material.mip1.exr`, …
pub fn path(finest: &Path, level: u32) -> PathBuf {
    finest.with_extension(format!("mip{level}.exr"))
}

/// The attribute of a level that tells whose it is: [`fingerprint`] of the finest.
pub const OF: &str = "mip.of";

/// A hash of a map's size and coefficients, by which its levels know it.
pub fn fingerprint(finest: &SbrdfMap) -> String {
    let mut hash = Sha256::new();
    let mut add =
        |values: &mut dyn Iterator<Item = f32>| values.for_each(|value| hash.update(value.to_le_bytes()));
    let vectors = |plane: &[Rgb]| plane.iter().flat_map(|v| v.to_array()).collect::<Vec<_>>();
    add(&mut [finest.width as f32, finest.height as f32].into_iter());
    add(&mut vectors(&finest.rho_d).into_iter());
    add(&mut finest.beta.iter().copied());
    add(&mut finest.normal.iter().flat_map(|normal| normal.to_array()));
    for lobe in &finest.lobes {
        add(&mut vectors(&lobe.rho_s).into_iter().chain(vectors(&lobe.c)));
        add(&mut lobe.n.iter().chain(&lobe.n_grazing).copied());
    }
    for coat in &finest.microfacets {
        add(&mut vectors(&coat.f0).into_iter().chain(vectors(&coat.f90)));
        add(&mut coat.alpha.iter().copied());
    }
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The samples of a window of a level, averaged over the valid ones of its texels; read chunk by chunk, with
/// standard deviations where asked for and there.
///
/// # Errors
/// When a chunk cannot be read.
pub fn read(store: &SampledStore, level: u32, window: &Window, sigma: bool) -> Result<SampledSbrdf> {
    if level == 0 {
        return store.read(window, sigma);
    }
    let fine =
        |range: &std::ops::Range<usize>, edge: usize| (range.start << level)..(range.end << level).min(edge);
    let whole = Window { x: fine(&window.x, store.width), y: fine(&window.y, store.height) };
    let (columns, poses) = (window.x.len(), store.poses.len());
    let mut sums = vec![0f64; window.texels() * poses * 3];
    let mut counts = vec![0u32; window.texels() * poses];
    let mut variances = (sigma && store.has_sigma()).then(|| vec![0f64; sums.len()]);
    for block in store.blocks_within(&whole) {
        let samples = store.read(&block, sigma)?;
        let texels = block.y.clone().flat_map(|y| block.x.clone().map(move |x| (x, y)));
        for (index, (x, y)) in texels.enumerate() {
            let texel = ((y >> level) - window.y.start) * columns + (x >> level) - window.x.start;
            let sigmas = samples.sigmas(index);
            for (pose, rgb) in samples.samples(index).enumerate().filter(|(_, rgb)| rgb.is_finite()) {
                let place = texel * poses + pose;
                counts[place] += 1;
                for (channel, value) in rgb.to_array().into_iter().enumerate() {
                    sums[place * 3 + channel] += f64::from(value);
                    if let (Some(variances), Some(sigmas)) = (&mut variances, sigmas) {
                        variances[place * 3 + channel] += sigmas[pose * 3 + channel].to_f64().powi(2);
                    }
                }
            }
        }
    }
    let count = |k: usize| f64::from(counts[k / 3]);
    let means = sums.iter().enumerate().map(|(k, sum)| (sum / count(k)) as f32);
    let deviation = |(k, variance): (usize, f64)| f16::from_f64(variance.sqrt() / count(k));
    let sigma = variances.map(|variances| variances.into_iter().enumerate().map(deviation).collect());
    let size = size([store.width, store.height], level);
    let side = f64::from(1u32 << level);
    // The level's grid may reach beyond the sample's right and lower edge; the sample's middle stays where it
    // is.
    let middle = |range: &std::ops::Range<usize>, edge: usize| {
        (range.start + range.end) as f64 / 2.0 - edge as f64 / 2.0 / side
    };
    debug_assert!(window.x.end <= size[0] && window.y.end <= size[1]);
    Ok(SampledSbrdf {
        width: columns,
        height: window.y.len(),
        texel_mm: store.texel_mm * side,
        offset_texels: glam::DVec2::new(middle(&window.x, store.width), -middle(&window.y, store.height)),
        poses: store.poses.clone(),
        reflectance: means.collect(),
        sigma,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampled::PoseGeometry;
    use glam::DVec3;

    fn store(folder: &std::path::Path) -> (SampledSbrdf, SampledStore) {
        let pose = |k: u32| PoseGeometry {
            light_mm: DVec3::new(f64::from(k) * 10.0, 0.0, 100.0),
            camera_mm: DVec3::new(0.0, f64::from(k), 120.0),
            weight: 1.0,
        };
        let mut sampled = SampledSbrdf::empty(37, 21, 0.5, (0..4).map(pose).collect());
        for (k, value) in sampled.reflectance.iter_mut().enumerate() {
            *value = ((k * 7919) % 1009) as f32;
        }
        // One sample of texel (5, 2) and all of pose 3 in texels (0..2, 0..2) are not valid.
        sampled.reflectance[((2 * 37 + 5) * 4 + 1) * 3] = f32::NAN;
        for texel in [0, 1, 37, 38] {
            sampled.reflectance[(texel * 4 + 3) * 3..][..3].fill(f32::NAN);
        }
        sampled.sigma = Some(vec![f16::from_f64(0.5); sampled.reflectance.len()]);
        let path = folder.join("s.zarr");
        sampled.write_zarr(&path).unwrap();
        (sampled, SampledStore::open(&path).unwrap())
    }

    #[test]
    fn sizes_halve_down_to_one_texel() {
        assert_eq!((last([37, 21]), last([1, 1]), last([64, 3]), last([65, 1])), (6, 0, 6, 7));
        assert_eq!([0, 1, 2, 6].map(|level| size([37, 21], level)), [[37, 21], [19, 11], [10, 6], [1, 1]]);
    }

    #[test]
    fn samples_of_a_level_are_means_of_the_valid_ones_and_lie_in_their_middle() {
        let folder = tempfile::tempdir().unwrap();
        let (fine, store) = store(folder.path());
        let at = |x: usize, y: usize, pose: usize| fine.samples(y * 37 + x).nth(pose).unwrap();
        // A window that spans several chunks, to the lower right corner.
        let level = read(&store, 1, &Window { x: 0..19, y: 0..11 }, true).unwrap();
        let of = |x: usize, y: usize, pose: usize| level.samples(y * 19 + x).nth(pose).unwrap();
        let four = (at(20, 10, 2) + at(21, 10, 2) + at(20, 11, 2) + at(21, 11, 2)) / 4.0;
        assert!((of(10, 5, 2) - four).abs().max_element() < 1e-3);
        let three = (at(4, 2, 1) + at(4, 3, 1) + at(5, 3, 1)) / 3.0;
        assert!((of(2, 1, 1) - three).abs().max_element() < 1e-3);
        assert!(of(0, 0, 3).is_nan());
        assert_eq!(of(18, 10, 0), at(36, 20, 0));
        let middle = (fine.position_mm(10 * 37 + 20) + fine.position_mm(11 * 37 + 21)) / 2.0;
        assert!((level.position_mm(5 * 19 + 10) - middle).length() < 1e-9);
        assert_eq!(level.texel_mm, 1.0);
        // Of three valid values of 0.5 each.
        let sigmas = level.sigmas(19 + 2).unwrap();
        assert_eq!((sigmas[3], sigmas[6]), (f16::from_f64(0.5 / 3f64.sqrt()), f16::from_f64(0.25)));
    }

    #[test]
    fn a_window_of_a_coarse_level_is_that_part_of_the_level() {
        let folder = tempfile::tempdir().unwrap();
        let (_, store) = store(folder.path());
        let whole = read(&store, 2, &Window { x: 0..10, y: 0..6 }, false).unwrap();
        let part = read(&store, 2, &Window { x: 3..10, y: 4..6 }, false).unwrap();
        assert!(part.samples(7 + 1).eq(whole.samples(5 * 10 + 4)));
        assert_eq!(part.directions(8, 2), whole.directions(54, 2));
    }
}
