//! Blending of BRDFs (chapter 5): coefficients do not interpolate, reflectance does. The BRDFs are evaluated
//! at pairs of directions, the values blended, and the blend fitted again.
//!
//! Where the blend is itself a sum of as few lobes as are asked for (equal shapes, one part alone), it is
//! written down as that and nothing is fitted.

use glam::DVec3;
use rayon::prelude::*;

use super::pairs::Pairs;
use crate::fit::texel::{self, Workspace};
use crate::fit::{self, FitOptions};
use lobelia_reflectance::{Brdf, Lobe, LobeBrdf, Rgb};

/// Pairs of directions that a blend is fitted to.
pub const PAIRS: usize = 768;

/// A BRDF that stands for others.
#[derive(Debug, Clone, PartialEq)]
pub struct Blend {
    /// The BRDF.
    pub brdf: LobeBrdf,
    /// RMS error against the blended reflectance over the RMS of that reflectance, weighted by cosθ_i cosθ_o;
    /// 0 where nothing was fitted, NaN where reflectance is beyond single precision.
    pub relative: f64,
}

/// A BRDF and its share of a blend.
type Part<'a> = (f64, &'a LobeBrdf);

/// The blend Σ w f / Σ w of BRDFs with weights ≥ 0, as a BRDF of at most `lobes` lobes. Black for no weight
/// at all.
pub fn blend(parts: &[(f32, &LobeBrdf)], lobes: usize, workspace: &mut Workspace) -> Blend {
    let whole: f64 = parts.iter().map(|&(weight, _)| f64::from(weight)).sum();
    let lit = parts.iter().filter(|(weight, _)| *weight > 0.0);
    let parts: Vec<Part<'_>> = lit.map(|&(weight, brdf)| (f64::from(weight) / whole, brdf)).collect();
    if let Some(brdf) = joined(&parts, lobes) {
        return Blend { brdf, relative: 0.0 };
    }
    let pairs = Pairs::over(parts.iter().map(|(_, brdf)| *brdf), PAIRS);
    let blended: Vec<Rgb> = (pairs.directions.par_iter())
        .map(|&(wi, wo)| {
            let weighted = parts.iter().map(|(weight, brdf)| *weight * brdf.eval(wi, wo).as_dvec3());
            weighted.sum::<DVec3>().as_vec3()
        })
        .collect();
    workspace.samples.clear();
    for (&(wi, wo), &value) in pairs.directions.iter().zip(&blended) {
        workspace.samples.push_rgb(wi, wo, value, 1.0);
    }
    let brdf = texel::fit(workspace, &options(&parts, lobes)).brdf;
    let fitted = pairs.reflectance(&brdf);
    let error = pairs.rms(fitted.iter().zip(&blended).map(|(fitted, blended)| fitted - blended));
    let size = pairs.rms(blended.iter().copied());
    // Infinite over infinite is no number, and a caller must see that.
    Blend { brdf, relative: if size == 0.0 { 0.0 } else { error / size + 0.0 * size } }
}

/// How the blend of these BRDFs is fitted: as they are themselves.
fn options(parts: &[Part<'_>], lobes: usize) -> FitOptions {
    let all = |is: fn(&Lobe) -> bool| parts.iter().all(|(_, brdf)| brdf.lobes.iter().all(is));
    let isotropic = all(|lobe| lobe.c.x == lobe.c.y);
    let one_channel = all(|lobe| lobe.rho_s.to_array().iter().filter(|&&rho| rho != 0.0).count() == 1);
    let separate_channels = isotropic && one_channel && lobes >= 3;
    let lobes = if separate_channels { lobes.div_ceil(3) } else { lobes };
    FitOptions { lobes: lobes.min(fit::MOST_LOBES), isotropic, separate_channels, ..FitOptions::default() }
}

/// The blend as the sum of its parts' lobes, those of one shape together; none where these are too many or
/// where the parts differ in β.
fn joined(parts: &[Part<'_>], most: usize) -> Option<LobeBrdf> {
    let mut rho_d = DVec3::ZERO;
    let mut lobes: Vec<(Lobe, DVec3)> = Vec::new();
    let mut beta = None;
    for &(weight, brdf) in parts {
        rho_d += weight * brdf.rho_d.as_dvec3();
        for lobe in brdf.lobes.iter().filter(|lobe| lobe.rho_s != Rgb::ZERO) {
            if lobe.c.x != lobe.c.y && *beta.get_or_insert(brdf.beta) != brdf.beta {
                return None;
            }
            let rho_s = weight * lobe.rho_s.as_dvec3();
            match lobes.iter_mut().find(|(known, _)| known.c == lobe.c && known.n == lobe.n) {
                Some((_, sum)) => *sum += rho_s,
                None => lobes.push((*lobe, rho_s)),
            }
        }
        if lobes.len() > most {
            return None;
        }
    }
    let lobes = lobes.into_iter().map(|(lobe, rho_s)| Lobe { rho_s: rho_s.as_vec3(), ..lobe });
    Some(LobeBrdf {
        rho_d: rho_d.as_vec3(),
        beta: beta.unwrap_or_default(),
        lobes: lobes.collect(),
        ..LobeBrdf::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn shiny(rho_d: f32, cz: f32, n: f32) -> LobeBrdf {
        let lobe = Lobe::new(Rgb::new(0.9, 0.6, 0.2), Vec3::new(-1.0, -1.0, cz), n);
        LobeBrdf { rho_d: Rgb::splat(rho_d), beta: 0.0, lobes: vec![lobe], ..LobeBrdf::default() }
    }

    #[test]
    fn a_blend_of_equal_shapes_is_exact_and_one_part_comes_back_as_it_is() {
        let (dark, light) = (shiny(0.1, 1.0, 30.0), shiny(0.3, 1.0, 30.0));
        let half = blend(&[(1.0, &dark), (1.0, &light)], 1, &mut Workspace::default());
        assert_eq!((half.brdf.lobes.len(), half.relative), (1, 0.0));
        assert!((half.brdf.rho_d.x - 0.2).abs() < 1e-6 && half.brdf.lobes[0].rho_s == dark.lobes[0].rho_s);
        let alone = blend(&[(0.3, &dark), (0.0, &light)], 1, &mut Workspace::default());
        assert_eq!(alone.brdf, dark);
    }

    #[test]
    fn two_lobes_meet_the_blend_of_two_unlike_brdfs_and_one_lobe_comes_near() {
        let (gloss, satin) = (shiny(0.05, 1.0, 80.0), shiny(0.2, 0.8, 6.0));
        let parts = [(0.25, &gloss), (0.75, &satin)];
        let two = blend(&parts, 2, &mut Workspace::default());
        assert_eq!(two.relative, 0.0);
        let (wi, wo) = (Vec3::new(0.3, 0.2, 0.8).normalize(), Vec3::new(-0.4, -0.1, 0.7).normalize());
        let sum = 0.25 * gloss.eval(wi, wo) + 0.75 * satin.eval(wi, wo);
        assert!((two.brdf.eval(wi, wo) - sum).abs().max_element() < 1e-5);
        let one = blend(&parts, 1, &mut Workspace::default());
        assert!(one.brdf.lobes.len() == 1 && one.relative > 0.01 && one.relative < 0.4, "{one:?}");
    }

    #[test]
    fn a_fitted_blend_meets_a_sum_that_as_many_lobes_can_express() {
        // Three parts of which two have nearly one shape: two lobes nearly express them, and joining three is
        // refused.
        let parts = [shiny(0.05, 1.0, 80.0), shiny(0.2, 0.8, 6.0), shiny(0.1, 0.8, 6.1)];
        let parts: Vec<(f32, &LobeBrdf)> = parts.iter().map(|part| (1.0, part)).collect();
        let found = blend(&parts, 2, &mut Workspace::default());
        assert!(found.relative > 0.0 && found.relative < 5e-3, "{}", found.relative);
    }

    #[test]
    fn brushed_parts_of_different_directions_are_fitted_not_joined() {
        let brushed = |beta| {
            let lobe = Lobe::new(Rgb::ONE, Vec3::new(-1.0, -0.7, 0.95), 20.0);
            LobeBrdf { rho_d: Rgb::splat(0.1), beta, lobes: vec![lobe], ..LobeBrdf::default() }
        };
        let (a, b) = (brushed(0.2), brushed(0.21));
        assert!(joined(&[(0.5, &a), (0.5, &b)], 4).is_none());
        let between = blend(&[(0.5, &a), (0.5, &b)], 1, &mut Workspace::default());
        assert!((between.brdf.beta - 0.205).abs() < 0.01 && between.relative < 0.02, "{between:?}");
    }
}
