//! What a fit costs against how right it is: methods by noise, models by material, cost by the amount of
//! data, the direction of anisotropy by blur.

use std::time::Instant;

use glam::Vec3;

use super::unposed;
use super::{Axis, Chart, Plot, Section, Series, Table};
use crate::error::{Error, Result};
use crate::fit::{self, FitOptions, MOST_LOBES, Method, Residual};
use crate::progress;
use crate::random::Random;
use crate::reflectance::{Brdf, Lobe, LobeBrdf, Rgb};
use crate::synth::{self, Options};

/// Noise on the samples, sr⁻¹.
const NOISES: [f64; 4] = [0.0, 1e-4, 1e-3, 1e-2];
/// Edge of the samples on which methods are compared, texels.
const SIDE: usize = 12;
/// Poses of those.
const POSES: usize = 200;
/// Edges of the samples by which the cost is followed, texels of 456 poses: the last has 10⁷ samples.
const SIDES: [usize; 4] = [16, 37, 74, 148];
/// Registration blur, standard deviation in texels.
const BLURS: [f64; 4] = [0.0, 0.5, 1.0, 2.0];

/// Fits synthetic samples with every method, on one thread.
///
/// # Errors
/// When no thread can be started.
pub fn chart(seed: u64) -> Result<Chart> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .map_err(|error| Error::failure(format!("a thread cannot be started: {error}")).caused_by(error))?;
    let mut sections = pool.install(|| -> Result<Vec<Section>> {
        Ok(vec![
            methods(seed)?,
            super::residual::section(seed)?,
            super::models::section(seed)?,
            amounts(seed)?,
            weave(seed)?,
        ])
    })?;
    sections.push(super::device::section(seed)?);
    Ok(Chart {
        name: "fit".into(),
        title: "What a fit costs".into(),
        lead: "Synthetic samples of known materials, fitted texel by texel on one thread but where CPU and \
             GPU are compared; time is that of the fit alone."
            .into(),
        sections,
    })
}

/// The methods that are compared.
fn candidates() -> Vec<(String, FitOptions)> {
    let one = |method: Method, lobes, choose| FitOptions {
        method,
        lobes,
        choose,
        isotropic: true,
        residual: Residual::Linear,
        ..FitOptions::default()
    };
    let mut candidates = vec![
        ("line search, 1 lobe".to_string(), one(Method::LineSearch, 1, false)),
        ("scaled line search, 1 lobe".to_string(), one(Method::LineSearchScaled, 1, false)),
    ];
    for (method, most) in [(Method::Ratio, 2), (Method::Lm, 3), (Method::Separable, MOST_LOBES)] {
        for lobes in 0..=most {
            let plural = if lobes == 1 { "lobe" } else { "lobes" };
            candidates.push((format!("{}, {lobes} {plural}", method.name()), one(method, lobes, false)));
        }
    }
    candidates.push(("separable, auto".into(), one(Method::Separable, MOST_LOBES, true)));
    candidates
}

/// Time a texel and error on unposed directions, by method and noise.
fn methods(seed: u64) -> Result<Section> {
    let mut random = Random::new(seed);
    let truth: Vec<LobeBrdf> = (0..SIDE * SIDE).map(|_| synth::material(2, &mut random)).collect();
    let candidates = candidates();
    let bar = progress::bar("fitting", (NOISES.len() * candidates.len()) as u64, "fits");
    let mut table =
        Table::new(["noise, 1/sr", "method", "ms a texel", "median error", "95 % below", "worst"]);
    let mut plots = Vec::new();
    for noise in NOISES {
        let options = Options {
            width: SIDE,
            height: SIDE,
            texel_mm: 0.5,
            poses: POSES,
            noise,
            relative_noise: 0.0,
            seed,
        };
        let sampled = synth::sample(&options, |index, _, wi, wo| truth[index].eval(wi, wo));
        let mut series: Vec<Series> = Vec::new();
        for (name, options) in &candidates {
            let start = Instant::now();
            let map = fit::fit_sbrdf(&sampled, options)?;
            let time_ms = start.elapsed().as_secs_f64() * 1e3 / truth.len() as f64;
            let errors = unposed::errors(&map, &truth, seed);
            let at = |share: f64| errors[((errors.len() - 1) as f64 * share) as usize];
            let family = name.split(',').next().unwrap_or(name);
            if series.last().is_none_or(|last| last.name != family || options.choose) {
                let shown = if options.choose { name.as_str() } else { family };
                series.push(Series::new(shown, Vec::new()));
            }
            if let Some(last) = series.last_mut() {
                last.points.push([time_ms, at(0.5)]);
                last.labels.push(name.clone());
            }
            table.row([
                noise.into(),
                name.as_str().into(),
                time_ms.into(),
                at(0.5).into(),
                at(0.95).into(),
                at(1.0).into(),
            ]);
            bar.advance(1);
        }
        plots.push(Plot {
            title: format!("Noise {noise} 1/sr; each method with 0, 1, 2, … lobes"),
            x: Axis::log("ms a texel"),
            y: Axis::log("median error"),
            series,
        });
    }
    Ok(Section {
        title: "Speed and accuracy by method and noise".into(),
        text: format!(
            "{} texels with a random two-lobe material each (n 5 to 150, forward or retro-reflective), \
             {POSES} random poses. Error: ‖f̂ − f‖ / ‖f‖ over 300 direction pairs that were not posed. \
             Residual: linear.",
            SIDE * SIDE
        ),
        plots,
        tables: vec![table],
        ..Section::default()
    })
}

/// Time by texels × samples.
fn amounts(seed: u64) -> Result<Section> {
    let mut random = Random::new(seed);
    let materials: Vec<LobeBrdf> = (0..16).map(|_| synth::material(2, &mut random)).collect();
    let bar = progress::bar("fitting", 2 * SIDES.len() as u64, "fits");
    let mut table = Table::new(["texels", "samples", "lobes", "s", "µs a texel"]);
    let mut series = vec![Vec::new(); 2];
    for side in SIDES {
        let (texels, poses) = (side * side, 456);
        let options = Options {
            width: side,
            height: side,
            texel_mm: 0.1,
            poses,
            noise: 1e-3,
            relative_noise: 0.0,
            seed,
        };
        let sampled = synth::sample(&options, |index, _, wi, wo| materials[index % 16].eval(wi, wo));
        for lobes in 1..=2 {
            let start = Instant::now();
            fit::fit_sbrdf(&sampled, &FitOptions { lobes, ..FitOptions::default() })?;
            let time_s = start.elapsed().as_secs_f64();
            series[lobes - 1].push([(texels * poses) as f64, time_s]);
            table.row([
                texels.into(),
                (texels * poses).into(),
                lobes.into(),
                time_s.into(),
                (1e6 * time_s / texels as f64).into(),
            ]);
            bar.advance(1);
        }
    }
    let series =
        ["1 lobe", "2 lobes"].into_iter().zip(series).map(|(name, points)| Series::new(name, points));
    Ok(Section {
        title: "Cost by the amount of data".into(),
        text: "Separable fit of isotropic lobes, 456 RGB samples a texel, noise 1e-3 1/sr.".into(),
        plots: vec![Plot {
            title: "Seconds by texels × poses".into(),
            x: Axis::log("texels × poses"),
            y: Axis::log("s"),
            series: series.collect(),
        }],
        tables: vec![table],
        ..Section::default()
    })
}

/// Errors of β on a weave, by registration blur.
fn weave(seed: u64) -> Result<Section> {
    let mut table = Table::new(["blur, texels", "median error, °", "95 % below, °"]);
    let mut series = [Vec::new(), Vec::new()];
    for blur in BLURS {
        let errors = weave_errors_deg(blur, seed)?;
        let at = |share: f64| errors[((errors.len() - 1) as f64 * share) as usize];
        for (points, share) in series.iter_mut().zip([0.5, 0.95]) {
            points.push([blur, at(share)]);
        }
        table.row([blur.into(), at(0.5).into(), at(0.95).into()]);
    }
    let series =
        ["median", "95 % below"].into_iter().zip(series).map(|(name, points)| Series::new(name, points));
    Ok(Section {
        title: "Direction of anisotropy by registration blur".into(),
        text: "A plain weave of threads of 4 texels in two directions at right angles, turned by 17°, two \
             anisotropic lobes a texel, noise 1e-3 1/sr and 0.5 %. Blur is the standard deviation of the \
             reflectance's spread over neighbouring texels; the error is that of β modulo 90°."
            .into(),
        plots: vec![Plot {
            title: "Error of β by blur".into(),
            x: Axis::linear("blur, texels"),
            y: Axis::log("error, °"),
            series: series.collect(),
        }],
        tables: vec![table],
        ..Section::default()
    })
}

/// Errors of β modulo 90° at every texel of a weave, degrees, sorted.
fn weave_errors_deg(blur: f64, seed: u64) -> Result<Vec<f64>> {
    const THREAD: usize = 4;
    let side = 4 * THREAD;
    let beta = 17f32.to_radians();
    let lobe = Lobe::new(Rgb::new(0.5, 0.35, 0.15), Vec3::new(-1.0, -0.75, 0.95), 20.0);
    let warp = LobeBrdf { rho_d: Rgb::new(0.06, 0.04, 0.02), beta, lobes: vec![lobe], ..LobeBrdf::default() };
    let weft =
        LobeBrdf { rho_d: Rgb::new(0.02, 0.04, 0.08), ..warp.clone() }.rotated(std::f32::consts::FRAC_PI_2);
    let shares: Vec<f32> =
        (0..side * side).map(|index| share(index % side, index / side, THREAD, blur)).collect();
    let options = Options {
        width: side,
        height: side,
        texel_mm: 0.25,
        poses: 300,
        noise: 1e-3,
        relative_noise: 0.005,
        seed,
    };
    let sampled = synth::sample(&options, |index, _, wi, wo| {
        warp.eval(wi, wo) * shares[index] + weft.eval(wi, wo) * (1.0 - shares[index])
    });
    let map = fit::fit_sbrdf(&sampled, &FitOptions { lobes: 2, isotropic: false, ..FitOptions::default() })?;
    let quarter = f64::from(std::f32::consts::FRAC_PI_2);
    let error = |found: &f32| {
        let off = (f64::from(found - beta) / quarter).rem_euclid(1.0);
        (off.min(1.0 - off) * quarter).to_degrees()
    };
    let mut errors: Vec<f64> = map.beta.iter().map(error).collect();
    errors.sort_by(f64::total_cmp);
    Ok(errors)
}

/// The warp's share of a texel of a plain weave that is blurred by a normal distribution, repeating at the
/// edges.
fn share(x: usize, y: usize, thread: usize, blur: f64) -> f32 {
    let reach = (4.0 * blur).ceil() as i64;
    let weight = |d: i64| if blur > 0.0 { (-0.5 * (d as f64 / blur).powi(2)).exp() } else { 1.0 };
    let (mut warp, mut all) = (0.0, 0.0);
    for (dx, dy) in (-reach..=reach).flat_map(|dx| (-reach..=reach).map(move |dy| (dx, dy))) {
        let cell = |at: usize, d: i64| (at as i64 + d).div_euclid(thread as i64);
        let w = weight(dx) * weight(dy);
        all += w;
        if (cell(x, dx) + cell(y, dy)).rem_euclid(2) == 0 {
            warp += w;
        }
    }
    (warp / all) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beta_on_a_weave_is_off_by_less_than_a_degree_at_half_a_texel_of_blur() {
        for blur in [0.0, 0.5] {
            let errors = weave_errors_deg(blur, 3).unwrap();
            println!("blur {blur}: median {:.3}°", errors[errors.len() / 2]);
            assert!(errors[errors.len() / 2] < 1.0, "{errors:?}");
        }
    }

    #[test]
    fn blur_mixes_threads_evenly_when_it_is_wide() {
        assert_eq!((share(1, 1, 4, 0.0), share(5, 1, 4, 0.0)), (1.0, 0.0));
        assert!((share(3, 1, 4, 20.0) - 0.5).abs() < 0.05);
        assert!(share(1, 1, 4, 0.5) > 0.9);
    }
}
