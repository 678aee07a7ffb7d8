//! Error against number of poses: texels fitted one by one, and pooled, under a light and a camera that stand
//! near.

use std::time::Instant;

use super::{Axis, Chart, Plot, Section, Series, Table};
use crate::error::Result;
use crate::fit::pool::{self, PoolOptions, RhoD, regions::Regions};
use crate::fit::{self, FitOptions};
use crate::progress;
use crate::random::Random;
use crate::reflectance::{Brdf, LobeBrdf, SbrdfMap};
use crate::sampled::{PoseGeometry, SampledSbrdf};
use crate::synth::{self, Options};

/// Edge of the region, texels, and of a texel, mm.
const SIDE: usize = 16;
const TEXEL_MM: f64 = 4.0;
/// Distances of light and camera from the sample's centre, mm.
const NEAR_MM: [f64; 2] = [150.0, 200.0];
const FAR_MM: [f64; 2] = [2000.0, 2000.0];
/// Noise, sr⁻¹, and as a share of the value.
const NOISE: [f64; 2] = [1e-3, 0.01];
/// One pose in so many, the first of them all, is aimed at the highlight.
const AIMED: usize = 4;
/// Numbers of poses.
const POSES: [usize; 8] = [1, 2, 4, 8, 16, 32, 64, 128];
/// Materials, of which the median counts.
const MATERIALS: u64 = 9;

/// The fits that are compared.
const FITS: [&str; 3] = ["texel by texel", "pooled", "pooled, ρ_d a texel"];

/// What is fitted.
#[derive(Debug, Clone, Copy)]
struct Case {
    title: &'static str,
    distance_mm: [f64; 2],
    /// Whether ρ_d differs from texel to texel.
    textured: bool,
}

const CASES: [Case; 3] = [
    Case { title: "One material, light and camera near", distance_mm: NEAR_MM, textured: false },
    Case { title: "A ρ_d a texel, light and camera near", distance_mm: NEAR_MM, textured: true },
    Case { title: "One material, light and camera far", distance_mm: FAR_MM, textured: false },
];

/// Medians of one case and number of poses, by fit.
#[derive(Debug, Clone, Copy, Default)]
struct Found {
    /// ‖f̂ − f‖ / ‖f‖ on directions that were not posed: median over the texels.
    error: [f64; 3],
    time_s: [f64; 3],
}

/// Fits regions of random materials from more and more poses.
///
/// # Errors
/// As [`fit::fit_sbrdf`].
pub fn chart(seed: u64) -> Result<Chart> {
    let bar = progress::bar("fitting", (CASES.len() * POSES.len()) as u64 * MATERIALS, "regions");
    let mut table = Table::new([
        "sample",
        "poses",
        "texel by texel, %",
        "pooled, %",
        "pooled, ρ_d a texel, %",
        "s",
        "s, pooled",
        "s, pooled, ρ_d a texel",
    ]);
    let mut plots = Vec::new();
    for case in &CASES {
        let mut points: [Vec<[f64; 2]>; 3] = Default::default();
        for poses in POSES {
            let found = medians(case, SIDE, poses, 0..MATERIALS, seed, || bar.advance(1))?;
            for (points, error) in points.iter_mut().zip(found.error) {
                points.push([poses as f64, error]);
            }
            let [single, pooled, own] = found.error.map(|error| (100.0 * error).into());
            let [a, b, c] = found.time_s.map(Into::into);
            table.row([case.title.into(), poses.into(), single, pooled, own, a, b, c]);
        }
        plots.push(Plot {
            title: case.title.into(),
            x: Axis::log("poses"),
            y: Axis::log("relative error"),
            series: FITS.iter().zip(points).map(|(name, points)| Series::new(*name, points)).collect(),
        });
    }
    let section = Section {
        title: "Error by number of poses".into(),
        text: format!(
            "Regions of {SIDE} × {SIDE} texels of {TEXEL_MM} mm, each of one random material: one lobe, n 5 \
             to 150, above a ρ_d that is the region's, or 0.2 to 1.8 times that from texel to texel. Random \
             poses of which the first and every {AIMED}th from there is aimed at the highlight; noise {:e} \
             1/sr and {} %. Light and camera stand {} and {} mm from the sample's centre, or {} m. ‖f̂ − f‖ \
             / ‖f‖ over 300 direction pairs that were not posed, median over the texels, then over \
             {MATERIALS} materials. One isotropic lobe is fitted; all fits bound albedos. Seconds are those \
             of one fit at a time: texels share all threads, a region has one.",
            NOISE[0],
            100.0 * NOISE[1],
            NEAR_MM[0],
            NEAR_MM[1],
            FAR_MM[0] / 1000.0,
        ),
        plots,
        tables: vec![table],
        ..Section::default()
    };
    Ok(Chart {
        name: "pool".into(),
        title: "Few photographs, many directions".into(),
        lead: "Under a near light and camera every texel of a region is seen from other directions, so that \
             a fit of all of them together needs far fewer poses than one of each (3.5, 4.6)."
            .into(),
        sections: vec![section],
    })
}

/// The medians over some materials, one after the other, so that times are those of a fit alone; `done` is
/// called a material.
fn medians(
    case: &Case,
    side: usize,
    poses: usize,
    materials: std::ops::Range<u64>,
    seed: u64,
    done: impl Fn(),
) -> Result<Found> {
    let found = materials.map(|material| {
        let found = measured(case, side, poses, seed.wrapping_add(1000 * material));
        done();
        found
    });
    let found: Vec<Found> = found.collect::<Result<_>>()?;
    let median = |of: &dyn Fn(&Found) -> f64| {
        let mut values: Vec<f64> = found.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    Ok(Found {
        error: [0, 1, 2].map(|fit| median(&|found| found.error[fit])),
        time_s: [0, 1, 2].map(|fit| median(&|found| found.time_s[fit])),
    })
}

/// A sample of one material at a number of poses, and its truth texel by texel.
fn sampled(case: &Case, side: usize, poses: usize, seed: u64) -> (SampledSbrdf, Vec<LobeBrdf>) {
    let mut random = Random::new(seed ^ 0x6d61_7465);
    let material = synth::material(1, &mut random);
    let mut texel = || {
        let share = if case.textured { random.uniform(0.2, 1.8) as f32 } else { 1.0 };
        LobeBrdf { rho_d: share * material.rho_d, ..material.clone() }
    };
    let truth: Vec<LobeBrdf> = (0..side * side).map(|_| texel()).collect();
    let mut poses = synth::poses(poses, seed);
    for pose in poses.iter_mut().step_by(AIMED) {
        pose.aim_at_highlight();
    }
    for PoseGeometry { light_mm, camera_mm, .. } in &mut poses {
        *light_mm = case.distance_mm[0] * light_mm.normalize();
        *camera_mm = case.distance_mm[1] * camera_mm.normalize();
    }
    let options = Options {
        width: side,
        height: side,
        texel_mm: TEXEL_MM,
        poses: poses.len(),
        noise: NOISE[0],
        relative_noise: NOISE[1],
        seed,
    };
    let sampled = synth::sample_at(poses, &options, |index, _, wi, wo| truth[index].eval(wi, wo));
    (sampled, truth)
}

/// Errors and times of the fits of one material.
fn measured(case: &Case, side: usize, poses: usize, seed: u64) -> Result<Found> {
    let (sampled, truth) = sampled(case, side, poses, seed);
    let options = FitOptions::default();
    let whole = Regions { width: side, height: side, of: vec![Some(0); side * side], colours: vec![[0; 3]] };
    let pooled = |rho_d: RhoD| -> Result<SbrdfMap> {
        let pooling = PoolOptions { rho_d, ..PoolOptions::default() };
        Ok(pool::fit_sbrdf(&sampled, &whole, &options, &pooling)?.map)
    };
    let fits: [&dyn Fn() -> Result<SbrdfMap>; 3] =
        [&|| fit::fit_sbrdf(&sampled, &options), &|| pooled(RhoD::Region), &|| pooled(RhoD::Texel)];
    let mut found = Found::default();
    for (place, fit) in fits.iter().enumerate() {
        let start = Instant::now();
        let map = fit()?;
        found.time_s[place] = start.elapsed().as_secs_f64();
        let errors = super::unposed::errors(&map, &truth, seed);
        found.error[place] = errors[errors.len() / 2];
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pooled_fits_need_fewer_poses_than_texels_do_and_a_textured_sample_needs_a_rho_d_a_texel() {
        let of = |case: usize, poses| medians(&CASES[case], 8, poses, 0..3, 1, || ()).unwrap().error;
        let (few, textured) = (of(0, 4), of(1, 8));
        println!("{few:?} {textured:?}");
        assert!(few[1] < 0.1 * few[0] && few[1] < 0.02, "{few:?}");
        assert!(textured[2] < 0.2 * textured[1] && textured[2] < 0.05, "{textured:?}");
    }
}
