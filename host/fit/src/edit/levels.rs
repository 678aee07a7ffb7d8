//! MIP levels of a map whose samples are not at hand: fitted to the reflectance averaged over a level's
//! texels (chapter 5), or, to compare with, by averaging coefficients. [`lobelia_reflectance::mip`] says
//! which texels a level's texel stands for.

use glam::Vec3;
use rayon::prelude::*;

use super::blend::blend;
use crate::fit::texel::Workspace;
use lobelia_base::progress;
use lobelia_reflectance::mip;
use lobelia_reflectance::{Lobe, LobeBrdf, Microfacet, Rgb, SbrdfMap};

/// The texels of a map that a level's texel stands for.
pub fn beneath(map: &SbrdfMap, level: u32, texel: usize) -> Vec<LobeBrdf> {
    let [columns, _] = mip::size([map.width, map.height], level);
    let fine = |at: usize, edge: usize| (at << level)..((at + 1) << level).min(edge);
    let (xs, ys) = (fine(texel % columns, map.width), fine(texel / columns, map.height));
    ys.flat_map(|y| xs.clone().map(move |x| map.texel(y * map.width + x))).collect()
}

/// BRDFs with equal weights.
pub fn evenly(texels: &[LobeBrdf]) -> Vec<(f32, &LobeBrdf)> {
    texels.iter().map(|brdf| (1.0 / texels.len() as f32, brdf)).collect()
}

/// A level fitted to the reflectance averaged over its texels, with as many lobes as the map has; `done` is
/// told every texel.
fn fitted(map: &SbrdfMap, level: u32, done: impl Fn() + Sync) -> SbrdfMap {
    each(map, level, |texels, workspace| {
        let brdf = blend(&evenly(texels), map.lobes.len(), workspace).brdf;
        done();
        brdf
    })
}

/// All levels of a map beyond the finest, fitted.
pub fn all_fitted(map: &SbrdfMap) -> Vec<SbrdfMap> {
    let size = [map.width, map.height];
    let texels = |level| mip::size(size, level).iter().product::<usize>() as u64;
    let bar = progress::bar("MIP levels", (1..=mip::last(size)).map(texels).sum(), "texels");
    (1..=mip::last(size)).map(|level| fitted(map, level, || bar.advance(1))).collect()
}

/// A level of averaged coefficients.
pub fn averaged(map: &SbrdfMap, level: u32) -> SbrdfMap {
    each(map, level, |texels, _| average(&evenly(texels)))
}

fn each(map: &SbrdfMap, level: u32, of: impl Fn(&[LobeBrdf], &mut Workspace) -> LobeBrdf + Sync) -> SbrdfMap {
    let [width, height] = mip::size([map.width, map.height], level);
    let texel = |workspace: &mut Workspace, texel| of(&beneath(map, level, texel), workspace);
    let texels: Vec<_> = (0..width * height).into_par_iter().map_init(Workspace::default, texel).collect();
    SbrdfMap::from_texels(width, height, &texels)
}

/// Coefficients averaged one by one, as filtering hardware does; a lobe that one side lacks has its shape
/// from the other.
pub fn average(parts: &[(f32, &LobeBrdf)]) -> LobeBrdf {
    let lobes = parts.iter().map(|(_, brdf)| brdf.lobes.len()).max().unwrap_or(0);
    let mut mean = LobeBrdf::default();
    for (weight, brdf) in parts {
        mean.rho_d += *weight * brdf.rho_d;
        mean.beta += weight * brdf.beta;
        mean.normal += *weight * brdf.normal;
    }
    for place in 0..lobes {
        let have = || parts.iter().filter_map(|(weight, brdf)| Some((*weight, brdf.lobes.get(place)?)));
        let whole: f32 = have().map(|(weight, _)| weight).sum();
        let exponent = |t| have().map(|(weight, lobe)| weight * lobe.exponent(t)).sum::<f32>() / whole;
        let sharpens = have().any(|(_, lobe)| lobe.n_grazing.is_some());
        mean.lobes.push(Lobe {
            rho_s: have().map(|(weight, lobe)| weight * lobe.rho_s).sum(),
            c: have().map(|(weight, lobe)| weight * lobe.c).sum::<Vec3>() / whole,
            n: exponent(1.0),
            n_grazing: sharpens.then(|| exponent(0.0)),
        });
    }
    let coats = parts.iter().map(|(_, brdf)| brdf.microfacets.len()).max().unwrap_or(0);
    for place in 0..coats {
        let have = || parts.iter().filter_map(|(weight, brdf)| Some((*weight, brdf.microfacets.get(place)?)));
        let whole: f32 = have().map(|(weight, _)| weight).sum();
        let sum = |of: fn(&Microfacet) -> Rgb| have().map(|(weight, coat)| weight * of(coat)).sum();
        mean.microfacets.push(Microfacet {
            f0: sum(|coat| coat.f0),
            f90: sum(|coat| coat.f90),
            alpha: have().map(|(weight, coat)| weight * coat.alpha).sum::<f32>() / whole,
        });
    }
    mean
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_reflectance::Rgb;

    #[test]
    fn a_level_stands_for_its_texels_and_for_those_that_the_edge_leaves() {
        let texels: Vec<_> = (0..15).map(|k| LobeBrdf::diffuse(Rgb::splat(k as f32))).collect();
        let map = SbrdfMap::from_texels(5, 3, &texels);
        let level = averaged(&map, 1);
        assert_eq!((level.width, level.height), (3, 2));
        let mean = |of: &[usize]| of.iter().map(|&k| map.rho_d[k].x).sum::<f32>() / of.len() as f32;
        for (texel, of) in [(0, vec![0, 1, 5, 6]), (2, vec![4, 9]), (3, vec![10, 11]), (5, vec![14])] {
            assert!((level.rho_d[texel].x - mean(&of)).abs() < 1e-6, "{texel}");
        }
        let fit = fitted(&map, 1, || ());
        assert!(fit.rho_d.iter().zip(&level.rho_d).all(|(a, b)| (*a - *b).abs().max_element() < 1e-6));
    }

    #[test]
    fn normals_and_exponents_toward_grazing_are_averaged_too() {
        let lobe = |n_grazing| Lobe { n_grazing, ..Lobe::new(Rgb::ONE, Vec3::new(-1.0, -1.0, 1.0), 10.0) };
        let brdf = |x, n_grazing| LobeBrdf {
            normal: glam::Vec2::new(x, 0.1),
            lobes: vec![lobe(n_grazing)],
            ..LobeBrdf::default()
        };
        let mean = average(&[(0.25, &brdf(0.2, Some(50.0))), (0.75, &brdf(0.0, None))]);
        assert!((mean.normal - glam::Vec2::new(0.05, 0.1)).length() < 1e-6);
        assert_eq!((mean.lobes[0].n, mean.lobes[0].n_grazing), (10.0, Some(20.0)));
        assert_eq!(average(&[(1.0, &brdf(0.0, None))]).lobes[0].n_grazing, None);
    }
}
