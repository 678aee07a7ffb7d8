//! Fits of one noisy lobe against the Cramér–Rao bound, at random poses and at poses aimed at the highlight.

use glam::{DVec3, Vec3};

use super::POSES;
use crate::chart::{Axis, Cell, Plot, Section, Series, Table};
use crate::error::{Error, Result};
use crate::fit::linear::{factor, substitute};
use crate::fit::{self, AlbedoBound, FitOptions, Method, Residual};
use crate::progress;
use crate::reflectance::{Lobe, LobeBrdf, Rgb, SbrdfMap};
use crate::sampled::{PoseGeometry, SampledSbrdf};
use crate::synth;

/// Exponents of the lobe.
const EXPONENTS: [f64; 6] = [1.0, 4.0, 16.0, 64.0, 200.0, 500.0];
/// Noise, sr⁻¹.
const NOISES: [f64; 4] = [1e-4, 1e-3, 3e-3, 1e-2];
/// Edge of a sample, texels: so many repeats with new noise are fitted.
const SIDE: usize = 32;
/// The variance may be so many times the bound. 1,024 repeats tell it to 4.4 %.
const MOST_OVER_BOUND: f64 = 1.2;
/// The samples contain the information if the bound on the standard deviation of n is at most this share of
/// n: beyond it, no fit's errors are those of the bound, which holds to first order.
const TELLING: f64 = 0.1;
/// An exponent farther from the truth than so many of its own stated standard deviations is an outlier.
const OUTLYING: f64 = 5.0;

/// The unknowns: ρ_d and ρ_s of three channels, n, and Cz/Cx, which the scale of C leaves alone.
pub(super) const UNKNOWNS: usize = 8;
/// Place of n among them.
pub(super) const EXPONENT: usize = 6;
const RATIO: usize = 7;

/// A lobe that stands for a glossy paint: ρ_d, ρ_s, and C = (−1, −1, Cz).
fn truth(n: f64) -> LobeBrdf {
    let lobe = Lobe::new(Rgb::new(0.4, 0.35, 0.3), Vec3::new(-1.0, -1.0, 0.95), n as f32);
    LobeBrdf { rho_d: Rgb::new(0.1, 0.06, 0.03), beta: 0.0, lobes: vec![lobe], ..LobeBrdf::default() }
}

/// What a method makes of the repeats.
struct Repeats {
    /// Variance over the bound: of ρ_d (red), n, Cz/Cx.
    over_bound: [f64; 3],
    /// Texels whose exponent is an outlier by its own stated uncertainty; none where the method states none.
    outliers: Option<usize>,
    /// The exponent farthest from the truth, as a factor above 1.
    worst_factor: f64,
}

/// The fits at random poses, or where a quarter of them is aimed at the highlight.
///
/// # Errors
/// When the bound does not exist, which the poses rule out.
pub(super) fn section(seed: u64, aimed: bool) -> Result<Section> {
    let methods = [Method::Separable, Method::Lm];
    let bar = progress::bar("fitting", (EXPONENTS.len() * NOISES.len() * methods.len()) as u64, "fits");
    let columns = [
        "method",
        "n",
        "noise, 1/sr",
        "bound on σ_n, % of n",
        "ρ_d",
        "n ",
        "Cz/Cx",
        "outliers",
        "worst n, factor",
        "holds",
    ];
    let mut table = Table::new(columns);
    let mut series: Vec<Vec<Series>> = vec![Vec::new(); methods.len()];
    for noise in NOISES {
        let mut points = vec![Vec::new(); methods.len()];
        for n in EXPONENTS {
            let sampled = repeats(n, noise, seed, aimed);
            let bound = bound(&sampled, &truth(n), noise)?;
            let share = bound[EXPONENT].sqrt() / n;
            for (k, &method) in methods.iter().enumerate() {
                let outcome = judge(&sampled, method, n, &bound)?;
                points[k].push([n, outcome.over_bound[1]]);
                table.row(row(method, n, noise, share, &outcome));
                bar.advance(1);
            }
        }
        for (series, points) in series.iter_mut().zip(points) {
            series.push(Series::new(format!("noise {noise:e}"), points));
        }
    }
    let plots = methods.iter().zip(series).map(|(method, series)| Plot {
        title: format!("Variance of n over the Cramér–Rao bound: {}", method.name()),
        x: Axis::log("exponent n"),
        y: Axis::log("variance / bound"),
        series,
    });
    let (title, poses) = if aimed {
        (
            "Poses aimed at the highlight",
            "poses, a quarter of them with the camera within 6° of the mirror direction,",
        )
    } else {
        ("Random poses", "random poses")
    };
    Ok(Section {
        title: title.into(),
        text: format!(
            "One noisy lobe against the Cramér–Rao bound: {} repeats of one texel with {POSES} {poses} and \
             new normal noise each; residual: linear. The columns ρ_d, n and Cz/Cx are variances over the \
             bound. An outlier is an exponent more than {OUTLYING} of its own stated standard deviations \
             off. A row holds when there is no outlier and no variance is above {MOST_OVER_BOUND} times the \
             bound; where the bound allows n a standard deviation above {} % of n, the samples do not tell \
             the lobe, and it holds, as “untold”, when there is no outlier: the stated uncertainty says so.",
            SIDE * SIDE,
            100.0 * TELLING
        ),
        plots: plots.collect(),
        tables: vec![table],
        ..Section::default()
    })
}

/// A row of the table.
fn row(method: Method, n: f64, noise: f64, share: f64, outcome: &Repeats) -> [Cell; 10] {
    let verdict = match outcome.outliers {
        Some(count) if count > 0 => "no",
        None if share > TELLING => "untold, not stated",
        _ if share > TELLING => "untold",
        _ if outcome.over_bound.iter().all(|&ratio| ratio <= MOST_OVER_BOUND) => "yes",
        _ => "no",
    };
    let [rho_d, exponent, ratio] = outcome.over_bound.map(Into::into);
    [
        method.name().into(),
        n.into(),
        noise.into(),
        (100.0 * share).into(),
        rho_d,
        exponent,
        ratio,
        outcome.outliers.map_or("not stated".into(), |count| count.to_string().into()),
        outcome.worst_factor.into(),
        verdict.into(),
    ]
}

/// The same texel with new noise, over and over.
fn repeats(n: f64, noise: f64, seed: u64, aimed: bool) -> SampledSbrdf {
    let mut poses = synth::poses(POSES, seed);
    poses.iter_mut().take(if aimed { POSES / 4 } else { 0 }).for_each(PoseGeometry::aim_at_highlight);
    super::repeats(poses, SIDE, &truth(n), noise, seed)
}

/// The Cramér–Rao bound of one isotropic lobe C = (−1, −1, Cz) and ρ_d with noise of σ in every channel: the
/// inverse of the Fisher information JᵀJ/σ², its diagonal.
///
/// # Errors
/// When the poses do not determine the lobe.
pub(super) fn bound(sampled: &SampledSbrdf, truth: &LobeBrdf, noise: f64) -> Result<[f64; UNKNOWNS]> {
    let lobe = truth.lobes[0];
    let (ratio, n) = (f64::from(lobe.c.z), f64::from(lobe.n));
    let mut information = [0.0; UNKNOWNS * UNKNOWNS];
    for pose in 0..sampled.poses.len() {
        let (wi, wo) = sampled.directions(0, pose);
        let products: DVec3 = wi.as_dvec3() * wo.as_dvec3();
        let base = ratio * products.z - products.x - products.y;
        let shape = if base > 0.0 { base.powf(n) } else { 0.0 };
        for channel in 0..3 {
            let rho_s = f64::from(lobe.rho_s[channel]);
            let mut slopes = [0.0; UNKNOWNS];
            slopes[channel] = 1.0;
            slopes[3 + channel] = shape;
            if base > 0.0 {
                slopes[EXPONENT] = rho_s * shape * base.ln();
                slopes[RATIO] = rho_s * n * shape / base * products.z;
            }
            for i in 0..UNKNOWNS {
                for j in 0..UNKNOWNS {
                    information[i * UNKNOWNS + j] += slopes[i] * slopes[j] / (noise * noise);
                }
            }
        }
    }
    // Scaled to ones on the diagonal: exponents and albedos differ by orders of magnitude.
    let scale: [f64; UNKNOWNS] = std::array::from_fn(|i| information[i * UNKNOWNS + i].sqrt());
    for i in 0..UNKNOWNS {
        for j in 0..UNKNOWNS {
            information[i * UNKNOWNS + j] /= scale[i] * scale[j];
        }
    }
    if !factor(&mut information, UNKNOWNS) {
        return Err(Error::failure(format!("the poses do not determine a lobe of n = {n}")));
    }
    Ok(std::array::from_fn(|i| {
        let mut column = [0.0; UNKNOWNS];
        column[i] = 1.0;
        substitute(&information, &mut column);
        column[i] / (scale[i] * scale[i])
    }))
}

/// Fits the repeats and compares.
fn judge(sampled: &SampledSbrdf, method: Method, n: f64, bound: &[f64; UNKNOWNS]) -> Result<Repeats> {
    let options =
        FitOptions { method, residual: Residual::Linear, bound: AlbedoBound::Free, ..FitOptions::default() };
    let map = fit::fit_sbrdf(sampled, &options)?;
    let lobe = &map.lobes[0];
    let exponents: Vec<f64> = lobe.n.iter().map(|&n| f64::from(n)).collect();
    let rho_d: Vec<f64> = map.rho_d.iter().map(|rgb| f64::from(rgb.x)).collect();
    let ratios: Vec<f64> = lobe.c.iter().map(|c| -f64::from(c.z) / f64::from(c.x)).collect();
    let true_ratio = f64::from(truth(n).lobes[0].c.z);
    Ok(Repeats {
        over_bound: [
            mean_square(&rho_d, f64::from(truth(n).rho_d.x)) / bound[0],
            mean_square(&exponents, n) / bound[EXPONENT],
            mean_square(&ratios, true_ratio) / bound[RATIO],
        ],
        outliers: outliers(&map, &exponents, n),
        worst_factor: exponents.iter().map(|found| (found / n).max(n / found)).fold(1.0, f64::max),
    })
}

/// The variance about the truth.
fn mean_square(values: &[f64], truth: f64) -> f64 {
    values.iter().map(|value| (value - truth).powi(2)).sum::<f64>() / values.len() as f64
}

/// Exponents that are off by more than their stated uncertainty allows.
fn outliers(map: &SbrdfMap, exponents: &[f64], n: f64) -> Option<usize> {
    let sigma = map.extra.get("sigma.lobe0.n")?;
    let outlying = |(found, sigma): (&f64, &f32)| (found - n).abs() > OUTLYING * f64::from(*sigma);
    Some(exponents.iter().zip(sigma).filter(|&pair| outlying(pair)).count())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn separable_fit_reaches_the_bound_where_the_samples_tell_and_no_exponent_is_an_outlier() {
        let cases = [
            (4.0, 1e-3, false),
            (64.0, 1e-2, false),
            (200.0, 1e-3, false),
            (500.0, 3e-3, true),
            (500.0, 1e-3, false),
        ];
        for (n, noise, aimed) in cases {
            let sampled = repeats(n, noise, 1, aimed);
            let bound = bound(&sampled, &truth(n), noise).unwrap();
            let outcome = judge(&sampled, Method::Separable, n, &bound).unwrap();
            println!("n {n}, noise {noise}: {:?}, {:?}", outcome.over_bound, outcome.outliers);
            assert_eq!(outcome.outliers, Some(0));
            // Random poses miss the sharpest highlight.
            let tells = bound[EXPONENT].sqrt() <= TELLING * n;
            assert_eq!(tells, n < 500.0 || aimed);
            // Below the bound lies only what 1,024 repeats can't tell.
            let at_bound = outcome.over_bound.iter().all(|ratio| (0.8..MOST_OVER_BOUND).contains(ratio));
            assert!(!tells || at_bound);
        }
    }
}
