//! The same fits on the CPU and on the GPU: time against error, and how far they agree.

use std::time::Instant;

use super::{Axis, Plot, Section, Series, Table};
use crate::error::Result;
use crate::fit::{self, Device, FitOptions, Residual, gpu};
use crate::progress;
use crate::random::Random;
use crate::reflectance::{Brdf, LobeBrdf, SbrdfMap};
use crate::synth::{self, Options};

/// Edge of the sample, texels.
const SIDE: usize = 48;
/// Poses.
const POSES: usize = 200;
/// Noise, sr⁻¹.
const NOISE: f64 = 1e-3;
/// Costs that differ by less than this share count as the same.
const SAME: f64 = 0.01;

/// Fits on both devices; without a GPU a sentence that says so.
///
/// # Errors
/// When the driver refuses.
pub(super) fn section(seed: u64) -> Result<Section> {
    let title = "CPU and GPU".to_string();
    let name = match gpu::name() {
        Ok(name) => name,
        Err(error) => {
            return Ok(Section { title, text: format!("Not compared. {error}."), ..Section::default() });
        }
    };
    let mut random = Random::new(seed);
    let truth: Vec<LobeBrdf> = (0..SIDE * SIDE).map(|_| synth::material(2, &mut random)).collect();
    let options = Options {
        width: SIDE,
        height: SIDE,
        texel_mm: 0.1,
        poses: POSES,
        noise: NOISE,
        relative_noise: 0.0,
        seed,
    };
    let sampled = synth::sample(&options, |index, _, wi, wo| truth[index].eval(wi, wo));
    let kinds: Vec<(usize, bool)> =
        [true, false].into_iter().flat_map(|i| (1..=3).map(move |n| (n, i))).collect();
    let bar = progress::bar("fitting", 2 * kinds.len() as u64, "fits");
    let mut table = Table::new([
        "lobes",
        "kind",
        "CPU, µs a texel",
        "GPU, µs a texel",
        "CPU, median error",
        "GPU, median error",
        "same cost, %",
        "GPU's lower, %",
        "CPU's lower, %",
    ]);
    let mut series: Vec<Series> = Vec::new();
    for device in ["CPU", "GPU"] {
        for kind in ["isotropic", "anisotropic"] {
            series.push(Series::new(format!("{device}, {kind}"), Vec::new()));
        }
    }
    for (lobes, isotropic) in kinds {
        let kind = if isotropic { "isotropic" } else { "anisotropic" };
        let mut maps = Vec::new();
        let mut cells = [[0.0; 2]; 2];
        for (place, device) in [Device::Cpu, Device::Gpu].into_iter().enumerate() {
            let options =
                FitOptions { lobes, isotropic, device, residual: Residual::Linear, ..FitOptions::default() };
            if device == Device::Gpu {
                // The first fit builds the pipelines.
                fit::fit_sbrdf(&sampled, &options)?;
            }
            let start = Instant::now();
            let map = fit::fit_sbrdf(&sampled, &options)?;
            let time_us = start.elapsed().as_secs_f64() * 1e6 / truth.len() as f64;
            let errors = super::unposed::errors(&map, &truth, seed);
            cells[place] = [time_us, errors[errors.len() / 2]];
            let line = &mut series[2 * place + usize::from(!isotropic)];
            line.points.push(cells[place]);
            line.labels.push(format!("{lobes}"));
            maps.push(map);
            bar.advance(1);
        }
        let [same, lower, higher] = costs(&maps[0], &maps[1]);
        let [[cpu_us, cpu_error], [gpu_us, gpu_error]] = cells;
        table.row([
            lobes.into(),
            kind.into(),
            cpu_us.into(),
            gpu_us.into(),
            cpu_error.into(),
            gpu_error.into(),
            same.into(),
            lower.into(),
            higher.into(),
        ]);
    }
    Ok(Section {
        title,
        text: format!(
            "{} texels with a random two-lobe material each, {POSES} random poses, noise {NOISE} 1/sr; 1 to \
             3 lobes. CPU: {} threads. GPU: {name}. Error: ‖f̂ − f‖ / ‖f‖ over 300 direction pairs that were \
             not posed. Costs are the same when they differ by less than {:.0} %.",
            SIDE * SIDE,
            rayon::current_num_threads(),
            100.0 * SAME
        ),
        plots: vec![Plot {
            title: "Time and error of 1, 2 and 3 lobes".into(),
            x: Axis::log("µs a texel"),
            y: Axis::log("median error"),
            series,
        }],
        tables: vec![table],
        ..Section::default()
    })
}

/// The shares of texels, %, in which the costs are the same, that of `b` is lower, and that of `a`.
fn costs(a: &SbrdfMap, b: &SbrdfMap) -> [f64; 3] {
    let (a, b) = (&a.extra["error.rms"], &b.extra["error.rms"]);
    let mut shares = [0.0; 3];
    for (&a, &b) in a.iter().zip(b) {
        let ratio = f64::from(b / a).powi(2);
        let place = if (ratio - 1.0).abs() <= SAME { 0 } else { 1 + usize::from(ratio > 1.0) };
        shares[place] += 1.0;
    }
    shares.map(|count| 100.0 * count / a.len() as f64)
}
