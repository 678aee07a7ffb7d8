//! G12: materials that sharpen or brighten toward grazing, and retro-reflecting ones: what one, two and three
//! lobes leave.

use glam::Vec3;

use super::{percent, quantile};
use crate::chart::{Section, Table};
use crate::error::Result;
use crate::fit::extensions::{Extensions, Microfacets};
use crate::fit::{self, FitOptions};
use crate::progress;
use crate::random::Random;
use crate::reflectance::{Brdf, Lobe, LobeBrdf, Microfacet, Rgb, SbrdfMap};
use crate::sampled::SampledSbrdf;
use crate::synth::{self, Options};

/// Edge of a sample, texels of a random material each.
const SIDE: usize = 5;
/// Poses.
const POSES: usize = 300;
/// Noise, sr⁻¹, and as a share of the value.
const NOISE: [f64; 2] = [1e-3, 0.005];
/// A texel whose mean squared residual is above this many times its noise's is not explained.
const EXPLAINED: f64 = 1.3;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Sharpening,
    Fresnel,
    Retro,
    Both,
    Sheet,
}

const KINDS: [(Kind, &str); 5] = [
    (Kind::Sharpening, "sharpens: n₀ = 2 n₁ to 5 n₁"),
    (Kind::Fresnel, "brightens: GGX, f0 0.05"),
    (Kind::Retro, "retro-reflects: n 10 to 100"),
    (Kind::Both, "retro-reflects and shines"),
    (Kind::Sheet, "retro sheet: n 400 under a smooth front"),
];

const PLAIN: Extensions = Extensions { normals: false, sharpening: false, microfacets: Microfacets::Never };
const BEYOND: Extensions = Extensions { normals: false, sharpening: true, microfacets: Microfacets::Choose };

/// Lobes, whether their number is a choice, what beyond lobes is fitted, the name.
const FITS: [(usize, bool, Extensions, &str); 5] = [
    (1, false, PLAIN, "1 lobe"),
    (2, false, PLAIN, "2 lobes"),
    (3, false, PLAIN, "3 lobes"),
    (fit::MOST_LOBES, true, PLAIN, "auto"),
    (3, true, BEYOND, "auto, sharpening and GGX"),
];

/// What a fit leaves.
#[derive(Debug, Clone, Copy)]
struct Left {
    /// Median over the texels of the mean squared residual over the noise's.
    chi_square: f64,
    /// Percent of the texels that their noise does not explain.
    unexplained: f64,
    /// Median and 95 % of ‖f̂ − f‖ / ‖f‖ on unposed directions.
    error: [f64; 2],
    /// Percent of the texels with something tied by a prior.
    tied: f64,
}

/// What lobes leave of each kind.
///
/// # Errors
/// As [`fit::fit_sbrdf`].
pub(super) fn section(seed: u64) -> Result<Section> {
    let bar = progress::bar("materials", (KINDS.len() * FITS.len()) as u64, "fits");
    let mut table = Table::new([
        "material",
        "fit",
        "mean square / noise",
        "not explained, %",
        "median error, %",
        "95 % below",
        "tied, %",
    ]);
    let mut sentences = String::new();
    for (kind, name) in KINDS {
        let left = judged(kind, SIDE, seed, || bar.advance(1))?;
        for (&(_, _, _, fit), left) in FITS.iter().zip(&left) {
            table.row([
                name.into(),
                fit.into(),
                left.chi_square.into(),
                left.unexplained.into(),
                (100.0 * left.error[0]).into(),
                (100.0 * left.error[1]).into(),
                left.tied.into(),
            ]);
        }
        let [one, two, three] = [0, 1, 2].map(|fit| 100.0 * left[fit].error[0]);
        sentences += &format!("{name}: one, two, three lobes leave {one:.2}, {two:.2}, {three:.2} %. ");
    }
    Ok(Section {
        title: "Sharpening, Fresnel and retro-reflecting materials (G12)".into(),
        text: format!(
            "{} random materials a kind with a diffuse term, none of which makes light, {POSES} random \
             poses, noise {:e} 1/sr and {} %, the default residual, isotropic. Error: ‖f̂ − f‖ / ‖f‖ on 300 \
             unposed direction pairs. {sentences}Wherever lobes are the wrong model the residual stands \
             above the noise: texels with a mean square above {EXPLAINED} times the noise's are counted. The \
             map has that residual, `error.rms`, and where the store has its noise `fit` tells such texels \
             (`unexplained_texels`); `auto` does not add lobes that predict nothing better, and so leaves \
             it. Lobes beyond what the material has are said to be tied.",
            SIDE * SIDE,
            NOISE[0],
            100.0 * NOISE[1]
        ),
        tables: vec![table],
        ..Section::default()
    })
}

fn material(kind: Kind, random: &mut Random) -> LobeBrdf {
    let mut number = |low: f64, high: f64| random.uniform(low, high) as f32;
    let mut brdf = LobeBrdf::diffuse(Rgb::new(number(0.1, 0.5), number(0.1, 0.5), number(0.1, 0.5)));
    let colour = Rgb::new(number(0.3, 1.0), number(0.3, 1.0), number(0.3, 1.0));
    let forward = Vec3::new(-0.95, -0.95, 1.0);
    let mut exponent = |low: f32, high: f32| number(low.ln().into(), high.ln().into()).exp();
    match kind {
        Kind::Sharpening => {
            let n = exponent(8.0, 60.0);
            let n_grazing = Some(n * exponent(2.0, 5.0));
            brdf.lobes.push(Lobe { n_grazing, ..Lobe::new(colour, forward, n) });
        }
        Kind::Fresnel => {
            let alpha = exponent(0.1, 0.4);
            brdf.microfacets.push(Microfacet { f0: Rgb::splat(0.05), f90: Rgb::ONE, alpha });
        }
        Kind::Retro => brdf.lobes.push(Lobe::new(colour, Vec3::ONE, exponent(10.0, 100.0))),
        Kind::Both => {
            brdf.lobes.push(Lobe::new(colour, Vec3::ONE, exponent(10.0, 100.0)));
            brdf.lobes.push(Lobe::new(colour, forward, exponent(10.0, 100.0)));
        }
        Kind::Sheet => {
            brdf.lobes.push(Lobe::new(10.0 * colour, Vec3::ONE, 400.0));
            brdf.microfacets.push(Microfacet { f0: Rgb::splat(0.025), f90: Rgb::ONE, alpha: 0.1 });
        }
    }
    brdf
}

fn judged(kind: Kind, side: usize, seed: u64, done: impl Fn()) -> Result<Vec<Left>> {
    let mut random = Random::new(seed);
    let truth: Vec<LobeBrdf> =
        (0..side * side).map(|_| super::physical(material(kind, &mut random))).collect();
    let sampling = Options {
        width: side,
        height: side,
        texel_mm: 0.5,
        poses: POSES,
        noise: NOISE[0],
        relative_noise: NOISE[1],
        seed,
    };
    let sampled = synth::sample(&sampling, |texel, _, wi, wo| truth[texel].eval(wi, wo));
    let of = |&(lobes, choose, extensions, _): &(usize, bool, Extensions, &str)| {
        let options = FitOptions { lobes, choose, extensions, ..FitOptions::default() };
        let map = fit::fit_sbrdf(&sampled, &options)?;
        let squares: Vec<f64> = (0..truth.len()).map(|texel| chi_square(&sampled, &map, texel)).collect();
        let errors = crate::chart::unposed::errors(&map, &truth, seed);
        let tied = map.extra.get("tied").map_or(0.0, |plane| percent(plane.iter().map(|&tied| tied > 0.0)));
        done();
        Ok(Left {
            chi_square: quantile(&squares, 0.5),
            unexplained: percent(squares.iter().map(|&square| square > EXPLAINED)),
            error: [quantile(&errors, 0.5), quantile(&errors, 0.95)],
            tied,
        })
    };
    FITS.iter().map(of).collect()
}

/// The mean of the squared residuals over the variances of their noise, as the truth makes it.
fn chi_square(sampled: &SampledSbrdf, map: &SbrdfMap, texel: usize) -> f64 {
    let Some(sigmas) = sampled.sigmas(texel) else { return f64::NAN };
    let square = |(pose, f): (usize, Rgb)| {
        let (wi, wo) = sampled.directions(texel, pose);
        let off = (map.eval(texel, wi, wo) - f).to_array();
        (0..3)
            .map(|channel| (f64::from(off[channel]) / sigmas[3 * pose + channel].to_f64()).powi(2))
            .sum::<f64>()
    };
    let sum: f64 = sampled.samples(texel).enumerate().map(square).sum();
    sum / (3 * sampled.poses.len()) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lobes_leave_what_is_no_lobe_and_the_residual_says_so() {
        let of = |kind| judged(kind, 3, 2, || ()).unwrap();
        for kind in [Kind::Sharpening, Kind::Fresnel] {
            let left = of(kind);
            println!("{kind:?}: {left:?}");
            assert!(left[0].chi_square > 1.5 && left[4].chi_square < 1.2);
            assert!(left[4].error[0] < left[2].error[0]);
        }
        let retro = of(Kind::Retro);
        println!("{retro:?}");
        assert!(retro[0].unexplained == 0.0 && (retro[0].chi_square - 1.0).abs() < 0.1);
        let both = of(Kind::Both);
        assert!(both[0].unexplained >= 80.0 && both[1].chi_square < 1.1, "{both:?}");
    }
}
