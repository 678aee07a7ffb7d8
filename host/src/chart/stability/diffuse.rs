//! G4: the diffuse term as the minimum of the samples, as a percentile, or fitted with the lobe, with noise
//! and where registration errs.

use glam::{DVec3, Vec3};

use super::{quantile, sampled};
use crate::chart::{Axis, Plot, Section, Series, Table};
use crate::error::Result;
use crate::fit::{self, AlbedoBound, Diffuse, FitOptions, Residual};
use crate::progress;
use crate::random::Random;
use crate::reflectance::{Brdf, Lobe, LobeBrdf, Rgb};
use crate::sampled::SampledSbrdf;
use crate::synth;

/// Edge of the sample and of the squares of its board, texels.
const SIDE: usize = 24;
const SQUARE: usize = 6;
/// Poses.
const POSES: usize = 200;
/// Exponents of the glossy squares.
const EXPONENTS: [f64; 4] = [2.0, 5.0, 20.0, 60.0];
/// The true diffuse terms of the glossy squares and of the dark ones between them, sr⁻¹.
const RHO_D: [f32; 2] = [0.1, 0.02];
/// Noise, sr⁻¹, without errors of registration.
const NOISES: [f64; 4] = [0.0, 1e-4, 1e-3, 1e-2];
/// Registration errors, standard deviation along x and along y in texels, with a noise of 1e-3 sr⁻¹.
const BLURS: [f64; 3] = [0.5, 1.0, 2.0];
const BLURRED_NOISE: f64 = 1e-3;
/// Off by more than so many of its own stated standard deviations a joint ρ_d is wrong without saying so.
const OUTLYING: f64 = 5.0;

const ESTIMATORS: [(Diffuse, &str); 3] = [
    (Diffuse::Percentile(0.0), "minimum"),
    (Diffuse::Percentile(fit::PERCENTILE), "10th percentile"),
    (Diffuse::Joint, "with the lobe"),
];

/// Biases over the glossy texels, percent.
#[derive(Debug, Clone, Copy)]
struct Bias {
    /// Median of ρ_d, and 5 and 95 %.
    rho_d: [f64; 3],
    /// Median of n, and 5 and 95 %.
    n: [f64; 3],
    /// Percent of the texels whose ρ_d is off by more than the fit's own uncertainty allows.
    unsaid: f64,
}

/// ρ_d by estimator, noise and registration.
///
/// # Errors
/// As [`fit::fit_sbrdf`].
pub(super) fn section(seed: u64) -> Result<Section> {
    let settings: Vec<(f64, f64)> = NOISES
        .iter()
        .map(|&noise| (noise, 0.0))
        .chain(BLURS.iter().map(|&blur| (BLURRED_NOISE, blur)))
        .collect();
    let bar = progress::bar("diffuse", (EXPONENTS.len() * settings.len() * ESTIMATORS.len()) as u64, "fits");
    let mut table = Table::new([
        "n",
        "noise, 1/sr",
        "misplaced by, texels",
        "ρ_d is",
        "ρ_d off, %: median",
        "5 % below",
        "95 % below",
        "n off, %: median",
        "5 % below ",
        "95 % below ",
    ]);
    let mut by_noise = vec![Vec::new(); ESTIMATORS.len()];
    let mut by_blur = vec![Vec::new(); ESTIMATORS.len()];
    let mut unsaid = [0.0f64; 2];
    for n in EXPONENTS {
        for &(noise, blur) in &settings {
            let sampled = board(n, noise, blur, seed);
            for (k, &(diffuse, name)) in ESTIMATORS.iter().enumerate() {
                let bias = judged(&sampled, diffuse, n)?;
                if n == 5.0 && blur == 0.0 {
                    by_noise[k].push([noise, bias.n[0].abs()]);
                }
                if n == 5.0 && (blur > 0.0 || noise == BLURRED_NOISE) {
                    by_blur[k].push([blur, bias.rho_d[0].abs()]);
                }
                if diffuse == Diffuse::Joint {
                    let worst = &mut unsaid[usize::from(blur > 0.0)];
                    *worst = worst.max(bias.unsaid);
                }
                let ([d, d_low, d_high], [e, e_low, e_high]) = (bias.rho_d, bias.n);
                table.row([
                    n.into(),
                    noise.into(),
                    blur.into(),
                    name.into(),
                    d.into(),
                    d_low.into(),
                    d_high.into(),
                    e.into(),
                    e_low.into(),
                    e_high.into(),
                ]);
                bar.advance(1);
            }
        }
    }
    let named = |points: Vec<Vec<[f64; 2]>>| {
        ESTIMATORS
            .iter()
            .zip(points)
            .map(|((_, name), points)| Series::new(*name, points))
            .collect::<Vec<_>>()
    };
    let [still, blurred] = unsaid;
    Ok(Section {
        title: "Estimators of the diffuse term (G4)".into(),
        text: format!(
            "A board of glossy squares (ρ_d = {}, ρ_s = 0.6, C = (−1, −1, 0.95)) and dark matt ones (ρ_d = \
             {}), {SQUARE} texels wide, {POSES} random poses; in the lower rows every photograph is \
             misplaced by another normally distributed distance, so that samples near an edge are of the \
             other material. One lobe by the separable fit, residual: linear, albedos free; errors over the \
             glossy texels, off by so many percent of the truth. The minimum lies below ρ_d as soon as there \
             is noise, the percentile by part of it wherever more poses than that see nothing of the lobe, \
             and n is too low for it; both are the neighbour's value where photographs are misplaced. They \
             are taken for certain: the fit states no deviation of such a ρ_d, and warns of nothing. The \
             joint estimate is off by more than {OUTLYING} of its own stated deviations at {still:.1} % of \
             the texels at most without misplaced photographs, and at up to {blurred:.0} % with them: those \
             samples contradict each other, which a stated deviation takes for noise.",
            RHO_D[0], RHO_D[1]
        ),
        plots: vec![
            Plot {
                title: "Bias of n by noise, n = 5".into(),
                x: Axis::log("noise, 1/sr"),
                y: Axis::log("|median of n off|, %"),
                series: named(by_noise),
            },
            Plot {
                title: "Bias of ρ_d by registration error, n = 5".into(),
                x: Axis::linear("misplaced by, texels"),
                y: Axis::log("|median of ρ_d off|, %"),
                series: named(by_blur),
            },
        ],
        tables: vec![table],
        ..Section::default()
    })
}

fn glossy(n: f64) -> LobeBrdf {
    let lobe = Lobe::new(Rgb::splat(0.6), Vec3::new(-1.0, -1.0, 0.95), n as f32);
    LobeBrdf { rho_d: Rgb::splat(RHO_D[0]), lobes: vec![lobe], ..LobeBrdf::default() }
}

/// Whether a place, in texels from the sample's corner, is on a glossy square.
fn is_glossy(x: f64, y: f64) -> bool {
    let square = |at: f64| (at / SQUARE as f64).floor() as i64;
    (square(x) + square(y)).rem_euclid(2) == 0
}

/// The board with noise, every pose misplaced by another distance.
fn board(n: f64, noise: f64, blur: f64, seed: u64) -> SampledSbrdf {
    let glossy = glossy(n);
    let offset = |pose: usize| {
        let mut random = Random::new(seed ^ ((1 + pose as u64) << 32));
        DVec3::new(random.normal(), random.normal(), 0.0) * blur
    };
    let offsets: Vec<DVec3> = (0..POSES).map(offset).collect();
    sampled(synth::poses(POSES, seed), SIDE, 0.5, seed, |texel, pose, wi, wo, random| {
        let (x, y) =
            ((texel % SIDE) as f64 + 0.5 + offsets[pose].x, (texel / SIDE) as f64 + 0.5 + offsets[pose].y);
        let f = if is_glossy(x, y) { glossy.eval(wi, wo) } else { Rgb::splat(RHO_D[1]) };
        let mut noise = || (noise * random.normal()) as f32;
        f + Rgb::new(noise(), noise(), noise())
    })
}

fn judged(sampled: &SampledSbrdf, diffuse: Diffuse, n: f64) -> Result<Bias> {
    let map = fit::fit_sbrdf(
        sampled,
        &FitOptions {
            diffuse,
            residual: Residual::Linear,
            bound: AlbedoBound::Free,
            ..FitOptions::default()
        },
    )?;
    let texels: Vec<usize> = (0..sampled.texels())
        .filter(|texel| is_glossy((texel % SIDE) as f64 + 0.5, (texel / SIDE) as f64 + 0.5))
        .collect();
    let off = |found: f32, truth: f64| 100.0 * (f64::from(found) / truth - 1.0);
    let rho_d: Vec<f64> = texels.iter().map(|&texel| off(map.rho_d[texel].y, f64::from(RHO_D[0]))).collect();
    let exponents: Vec<f64> = texels.iter().map(|&texel| off(map.lobes[0].n[texel], n)).collect();
    let spread = |values: &[f64]| [0.5, 0.05, 0.95].map(|share| quantile(values, share));
    let unsaid = texels.iter().filter(|&&texel| {
        let sigma = f64::from(map.extra["sigma.rho_d.G"][texel]);
        // A deviation of 0 with an error of rounding is no claim that was broken.
        f64::from((map.rho_d[texel].y - RHO_D[0]).abs()) > OUTLYING * sigma.max(1e-6)
    });
    let unsaid = 100.0 * unsaid.count() as f64 / texels.len() as f64;
    Ok(Bias { rho_d: spread(&rho_d), n: spread(&exponents), unsaid })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn minimum_and_percentile_are_biased_where_the_joint_estimate_is_not() {
        let bias = |n, noise, blur| {
            ESTIMATORS.map(|(diffuse, _)| judged(&board(n, noise, blur, 1), diffuse, n).unwrap())
        };
        let [minimum, percentile, joint] = bias(20.0, 1e-2, 0.0);
        println!("noise: {minimum:?} {percentile:?} {joint:?}");
        assert!(minimum.rho_d[0] < -10.0 && joint.rho_d[0].abs() < 1.0 && joint.n[0].abs() < 2.0);
        assert!(percentile.rho_d[0] < 0.0 && percentile.rho_d[0] > minimum.rho_d[0]);
        assert!(joint.unsaid < 1.0);
        let [minimum, _, joint] = bias(20.0, 1e-3, 2.0);
        println!("misplaced: {minimum:?} {joint:?}");
        // The dark neighbour's value.
        assert!((minimum.rho_d[0] + 80.0).abs() < 5.0 && joint.rho_d[0] > -60.0);
        let [_, percentile, joint] = bias(2.0, 0.0, 0.0);
        assert!(joint.rho_d[0].abs() < 0.1 && joint.n[0].abs() < 0.1, "{percentile:?} {joint:?}");
    }
}
