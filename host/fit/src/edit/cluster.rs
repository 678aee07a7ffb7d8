//! Clusters a map's texels into a palette of BRDFs (section 4.6) by k-means on reflectance.
//!
//! Texels are compared by the cube roots of their reflectance ([`Pairs::features`]). A palette's BRDF is the
//! mean reflectance of its texels, fitted again; docs/edit.md says what that leaves of the demo's brocade,
//! and what the texel nearest to the cluster's middle would leave in its place.

use rayon::prelude::*;

use super::blend::blend;
use super::pairs::{Pairs, squared_distance};
use crate::fit::texel::Workspace;
use lobelia_base::error::{Error, Result};
use lobelia_base::progress;
use lobelia_base::random::Random;
use lobelia_reflectance::{LobeBrdf, SbrdfMap};

/// Most BRDFs of a palette: an index is a byte.
pub const MOST: usize = 256;

/// Pairs of directions at which texels are compared.
const PAIRS: usize = 256;

/// Most texels that the centres are found from; the others are only assigned.
const SEEN: usize = 1 << 15;

/// Most rounds of assignment.
const ROUNDS: usize = 60;

/// A palette and which of its BRDFs each texel takes.
#[derive(Debug, Clone, PartialEq)]
pub struct Clusters {
    /// The BRDFs, those of most texels first.
    pub palette: Vec<LobeBrdf>,
    /// Texels a BRDF.
    pub count: Vec<usize>,
    /// Index into the palette, row by row.
    pub index: Vec<u8>,
    /// ‖f̂ − f‖ / ‖f‖ over all texels and pairs of directions, weighted by cosθ_i cosθ_o; NaN beyond single
    /// precision.
    pub relative: f64,
    /// The same with the texel nearest to each cluster's middle in place of the palette's BRDF.
    pub relative_of_texels: f64,
}

/// Clusters the texels into at most `count` BRDFs; fewer where the map has fewer that differ.
///
/// # Errors
/// Input errors: a count outside 1..=[`MOST`].
pub fn cluster(map: &SbrdfMap, count: usize, seed: u64) -> Result<Clusters> {
    if !(1..=MOST).contains(&count) {
        return Err(Error::input(format!(
            "a palette of {count} BRDFs was asked for; 1 to {MOST} can be had"
        )));
    }
    let texels: Vec<LobeBrdf> = (0..map.width * map.height).into_par_iter().map(|k| map.texel(k)).collect();
    let pairs = Pairs::over(&texels, PAIRS);
    let step = texels.len().div_ceil(SEEN);
    let seen: Vec<Vec<f32>> = texels.par_iter().step_by(step).map(|texel| pairs.features(texel)).collect();
    let centres = lloyd(&seen, first_centres(&seen, count, seed));
    let assigned: Vec<(usize, f32)> =
        texels.par_iter().map(|texel| nearest(&pairs.features(texel), &centres)).collect();

    let mut members: Vec<Vec<usize>> = vec![Vec::new(); centres.len()];
    assigned.iter().enumerate().for_each(|(texel, &(cluster, _))| members[cluster].push(texel));
    members.retain(|members| !members.is_empty());
    members.sort_by_key(|members| (usize::MAX - members.len(), members[0]));
    let mut index = vec![0; texels.len()];
    for (place, members) in members.iter().enumerate() {
        members.iter().for_each(|&texel| index[texel] = place as u8);
    }
    let bar = progress::bar("palette", members.len() as u64, "BRDFs");
    let palette: Vec<LobeBrdf> = members
        .par_iter()
        .map_init(Workspace::default, |workspace, members| {
            let parts: Vec<(f32, &LobeBrdf)> = members.iter().map(|&texel| (1.0, &texels[texel])).collect();
            let brdf = blend(&parts, map.lobes.len(), workspace).brdf;
            bar.advance(1);
            brdf
        })
        .collect();
    let relative = relative_error(&pairs, &texels, |texel| &palette[usize::from(index[texel])]);
    let middle = |members: &Vec<usize>| {
        let nearest = members.iter().min_by(|&&a, &&b| assigned[a].1.total_cmp(&assigned[b].1));
        nearest.copied().unwrap_or(0)
    };
    let middles: Vec<usize> = members.iter().map(middle).collect();
    let of_texel = |texel: usize| &texels[middles[usize::from(index[texel])]];
    let relative_of_texels = relative_error(&pairs, &texels, of_texel);
    Ok(Clusters {
        palette,
        count: members.iter().map(Vec::len).collect(),
        index,
        relative,
        relative_of_texels,
    })
}

/// ‖f̂ − f‖ / ‖f‖ of what stands for each texel.
fn relative_error<'a>(pairs: &Pairs, texels: &[LobeBrdf], of: impl Fn(usize) -> &'a LobeBrdf + Sync) -> f64 {
    let squares: Vec<(f64, f64)> = (texels.par_iter().enumerate())
        .map(|(k, texel)| {
            (pairs.distance(texel, of(k)).powi(2), pairs.distance(texel, &LobeBrdf::default()).powi(2))
        })
        .collect();
    let (error, whole) = squares.iter().fold((0.0, 0.0), |sum, square| (sum.0 + square.0, sum.1 + square.1));
    // A part of what is infinite is no small part.
    if whole == 0.0 { 0.0 } else { (error / whole).sqrt() + 0.0 * whole }
}

/// The nearest centre and the squared distance to it.
fn nearest(features: &[f32], centres: &[Vec<f32>]) -> (usize, f32) {
    let distances = centres.iter().map(|centre| squared_distance(features, centre)).enumerate();
    distances.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, 0.0))
}

/// k-means++ (Arthur and Vassilvitskii 2007): each further centre is a texel drawn with a probability that
/// goes with its squared distance from the centres so far. Ends early when every texel is a centre.
fn first_centres(texels: &[Vec<f32>], count: usize, seed: u64) -> Vec<Vec<f32>> {
    let mut random = Random::new(seed);
    let first = random.uniform(0.0, texels.len() as f64) as usize;
    let mut centres = vec![texels[first].clone()];
    let mut distance = vec![f32::INFINITY; texels.len()];
    while centres.len() < count {
        let newest = &centres[centres.len() - 1];
        distance
            .par_iter_mut()
            .zip(texels)
            .for_each(|(distance, texel)| *distance = distance.min(squared_distance(texel, newest)));
        let whole: f64 = distance.iter().map(|&d| f64::from(d)).sum();
        if whole <= 0.0 {
            break;
        }
        let mut left = random.uniform(0.0, whole);
        let drawn = distance.iter().position(|&d| {
            left -= f64::from(d);
            left < 0.0 && d > 0.0
        });
        let last = || distance.iter().rposition(|&d| d > 0.0).unwrap_or(0);
        centres.push(texels[drawn.unwrap_or_else(last)].clone());
    }
    centres
}

/// Lloyd's rounds of assignment and averaging until no texel changes its centre.
fn lloyd(texels: &[Vec<f32>], mut centres: Vec<Vec<f32>>) -> Vec<Vec<f32>> {
    let mut assigned = vec![usize::MAX; texels.len()];
    for _ in 0..ROUNDS {
        let next: Vec<usize> = texels.par_iter().map(|texel| nearest(texel, &centres).0).collect();
        if next == assigned {
            break;
        }
        assigned = next;
        centres.par_iter_mut().enumerate().for_each(|(cluster, centre)| {
            let mut sum = vec![0.0; centre.len()];
            let mut count = 0;
            for (texel, _) in texels.iter().zip(&assigned).filter(|(_, of)| **of == cluster) {
                sum.iter_mut().zip(texel).for_each(|(sum, &value)| *sum += f64::from(value));
                count += 1;
            }
            // A centre that lost all its texels stays where it is.
            if count > 0 {
                centre.iter_mut().zip(&sum).for_each(|(value, sum)| *value = (sum / f64::from(count)) as f32);
            }
        });
    }
    centres
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use lobelia_reflectance::{Lobe, Rgb};

    fn material(rho_d: Rgb, n: f32) -> LobeBrdf {
        let lobe = Lobe::new(Rgb::splat(0.4), Vec3::new(-1.0, -1.0, 1.0), n);
        LobeBrdf { rho_d, beta: 0.0, lobes: vec![lobe], ..LobeBrdf::default() }
    }

    /// Three materials in stripes, every texel's coefficients a little off.
    fn striped() -> (SbrdfMap, Vec<usize>) {
        let mut random = Random::new(5);
        let labels: Vec<usize> = (0..300).map(|k| [0, 1, 1, 2, 1, 2][k % 6]).collect();
        let texels: Vec<LobeBrdf> = labels
            .iter()
            .map(|&label| {
                let mut off = || 1.0 + 0.03 * random.normal() as f32;
                match label {
                    0 => material(Rgb::new(0.2, 0.02, 0.02) * off(), 60.0 * off()),
                    1 => material(Rgb::new(0.02, 0.02, 0.2) * off(), 60.0 * off()),
                    _ => material(Rgb::new(0.02, 0.02, 0.2) * off(), 6.0 * off()),
                }
            })
            .collect();
        (SbrdfMap::from_texels(30, 10, &texels), labels)
    }

    #[test]
    fn texels_of_three_materials_are_told_apart_and_the_palette_holds_the_materials() {
        let (map, labels) = striped();
        let clusters = cluster(&map, 3, 1).unwrap();
        assert_eq!(clusters.count, [150, 100, 50]);
        for (index, label) in clusters.index.iter().zip(&labels) {
            assert_eq!(*index, [2, 0, 1][*label]);
        }
        let truth = material(Rgb::new(0.02, 0.02, 0.2), 60.0);
        let pairs = Pairs::over([&truth], 512);
        let off = pairs.distance(&clusters.palette[0], &truth) / pairs.distance(&truth, &LobeBrdf::default());
        assert!(off < 0.02 && clusters.relative < 0.05, "{off} {}", clusters.relative);
        // One texel, 3 % off in each coefficient, stands less well for its cluster than the mean; here not
        // twice as badly.
        let ratio = clusters.relative_of_texels / clusters.relative;
        assert!((1.0..2.0).contains(&ratio), "{ratio}");
        assert_eq!(cluster(&map, 3, 1).unwrap(), clusters);
    }

    #[test]
    fn equal_texels_make_a_palette_of_one_and_more_entries_never_fit_worse() {
        let one = material(Rgb::splat(0.1), 20.0);
        let clusters = cluster(&SbrdfMap::from_texels(3, 2, &vec![one.clone(); 6]), 8, 1).unwrap();
        assert_eq!((clusters.palette, clusters.relative), (vec![one], 0.0));
        assert_eq!(clusters.relative_of_texels, 0.0);
        let (map, _) = striped();
        let errors: Vec<f64> = [1, 3, 40].iter().map(|&k| cluster(&map, k, 1).unwrap().relative).collect();
        assert!(errors[0] > 2.0 * errors[1] && errors[1] > errors[2], "{errors:?}");
    }

    #[test]
    fn palettes_of_nothing_and_of_too_many_are_refused() {
        let (map, _) = striped();
        for count in [0, 257] {
            assert_eq!(cluster(&map, count, 1).unwrap_err().exit_code(), 2);
        }
    }
}
