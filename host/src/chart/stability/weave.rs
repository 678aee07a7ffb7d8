//! The direction of anisotropy β on a simulated weave, measured by the whole chain, by registration blur.
//!
//! Errors of registration blur in two ways. Where every photograph is off by another distance, a texel's
//! samples come from places spread over its neighbours, other ones at every pose, and from both threads where
//! one ends: samples contradict each other. Where the photographs themselves are blurred, every sample is the
//! same mixture of neighbours. Both are measured: the standard deviation of the distances along x and along
//! y, and that of a normal distribution with which the reflectance of every pose is spread over texels.

use std::path::Path;

use glam::DVec2;
use lobelia_hil_sim::optics::{Material, SampleLayout};
use rayon::prelude::*;

use crate::acquire::recipe::{PatternRecipe, Recipe};
use crate::acquire::{self, RunFolder, simulated};
use crate::chart::{Axis, Plot, Section, Series, Table};
use crate::demo::Size;
use crate::develop::{self, Photographed, Photographs};
use crate::error::{Error, Result};
use crate::fit::{self, FitOptions};
use crate::plan::{self, Extent};
use crate::progress;
use crate::random::Random;
use crate::reflectance::SbrdfMap;
use crate::rig::config::{Carrier, RigConfig};
use crate::sampled::{SampledSbrdf, texel_position_mm};
use crate::toml_file;

/// The cloth.
const CLOTH: &str = include_str!("../../../../examples/cloth.toml");
/// Direction in which its warp is brightest.
const BETA_DEG: f32 = 17.0;
/// Texels a thread.
const THREAD: usize = 4;
/// Registration blur, standard deviation in texels.
const BLURS: [f64; 4] = [0.0, 0.5, 1.0, 2.0];

/// How much is measured.
struct Extents {
    texels: usize,
    poses: usize,
}

/// How registration errs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    /// Every photograph is off by a random distance.
    Misplaced,
    /// The reflectance of every pose is spread over neighbouring texels.
    Blurred,
}

impl Fault {
    const ALL: [Self; 2] = [Self::Blurred, Self::Misplaced];

    fn name(self) -> &'static str {
        match self {
            Self::Misplaced => "misplaced",
            Self::Blurred => "blurred",
        }
    }
}

/// Measures the weave with the simulated rig, develops it with each error of registration and fits it.
///
/// # Errors
/// When the disk has no room for the run.
pub(super) fn section(seed: u64) -> Result<Section> {
    let extents = Extents { texels: 32, poses: 160 };
    let weave = Weave::measured(&extents, seed)?;
    let mut table = Table::new([
        "photographs",
        "blur, texels",
        "lobes",
        "warp, median error, °",
        "warp, 95 % below, °",
        "warp, right way, %",
        "weft, median error, °",
        "weft, 95 % below, °",
        "weft, right way, %",
    ]);
    let mut plots = Vec::new();
    for fault in Fault::ALL {
        let mut series = Vec::new();
        for lobes in 1..=2 {
            let mut points = [Vec::new(), Vec::new()];
            for blur in BLURS {
                let map = fitted(&weave.sampled(fault, blur, seed), lobes)?;
                let found = Thread::ALL.map(|thread| weave.errors(&map, thread));
                for (points, found) in points.iter_mut().zip(&found) {
                    points.push([blur, found.median_deg]);
                }
                let [warp, weft] = &found;
                table.row([
                    fault.name().into(),
                    blur.into(),
                    lobes.into(),
                    warp.median_deg.into(),
                    warp.most_deg.into(),
                    (100.0 * warp.right).into(),
                    weft.median_deg.into(),
                    weft.most_deg.into(),
                    (100.0 * weft.right).into(),
                ]);
            }
            let plural = if lobes == 1 { "lobe" } else { "lobes" };
            for (thread, points) in Thread::ALL.into_iter().zip(points) {
                series.push(Series::new(format!("{}, {lobes} {plural}", thread.name()), points));
            }
        }
        plots.push(Plot {
            title: format!("Photographs {}: median error of β", fault.name()),
            x: Axis::linear("registration blur, texels"),
            y: Axis::log("median error, °"),
            series,
        });
    }
    Ok(Section {
        title: "Direction of anisotropy on a measured weave by registration blur".into(),
        text: format!(
            "The cloth of examples/cloth.toml, its threads {THREAD} texels wide and brightest at {BETA_DEG}° \
             and at a right angle to that, {0} × {0} texels, planned, photographed at {1} poses, developed \
             and fitted by the simulated rig with all its faults. Photographs are blurred, every pose alike, \
             or misplaced, each by another normally distributed distance along x and along y; blur is the \
             standard deviation. Error: that of β modulo 90° against the simulator's truth, median over the \
             texels of a thread. A thread is seen the right way where the stronger axis of its brightest \
             lobe lies within 45° of the truth.",
            extents.texels, extents.poses
        ),
        plots,
        tables: vec![table],
        ..Section::default()
    })
}

/// The map of anisotropic lobes.
fn fitted(sampled: &SampledSbrdf, lobes: usize) -> Result<SbrdfMap> {
    fit::fit_sbrdf(sampled, &FitOptions { lobes, isotropic: false, ..FitOptions::default() })
}

/// The two directions of threads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Thread {
    Warp,
    Weft,
}

impl Thread {
    const ALL: [Self; 2] = [Self::Warp, Self::Weft];

    fn name(self) -> &'static str {
        match self {
            Self::Warp => "warp",
            Self::Weft => "weft",
        }
    }
}

/// The photographed weave and the sample itself.
struct Weave {
    rig: RigConfig,
    photographs: Photographs,
    /// What the photographs show, and where.
    poses: Vec<Photographed>,
    truth: SampleLayout,
}

/// How far β is off.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Errors {
    median_deg: f64,
    /// 95 % of the texels are below.
    most_deg: f64,
    /// Share of the texels whose thread is seen in the right direction.
    right: f64,
}

impl Weave {
    /// Plans and photographs the weave in a folder that is removed again.
    fn measured(extents: &Extents, seed: u64) -> Result<Self> {
        let mut rig = Size::Small.rig(seed);
        rig.carrier.texels_across = extents.texels;
        let plan = plan::make(&rig, Extent::Budget(extents.poses), false, seed)?;
        let place = tempfile::tempdir()
            .map_err(|error| Error::failure(format!("no folder for the run: {error}")).caused_by(error))?;
        let folder = place.path().join("run");
        let (run, mut journal) = RunFolder::create(&folder, &plan, &rig)?;
        let mut station = simulated::station(&rig, cloth(&rig.carrier)?)?;
        acquire::run(&run, &mut journal, &mut station)?;
        let photographs = Photographs::open(&folder)?;
        let bar = progress::bar("registering", photographs.poses() as u64, "poses");
        let poses = (0..photographs.poses()).into_par_iter().map(|index| {
            let photographed = photographs.pose(index);
            bar.advance(1);
            photographed
        });
        let poses = poses.collect::<Result<Vec<Photographed>>>()?;
        let truth = cloth(&rig.carrier)?;
        Ok(Self { rig, photographs, poses, truth })
    }

    /// The reflectance of every texel at every pose with an error of registration, texels.
    fn sampled(&self, fault: Fault, texels: f64, seed: u64) -> SampledSbrdf {
        let texel_mm = self.rig.carrier.texel_mm();
        let developed = self.poses.par_iter().enumerate().map(|(index, photographed)| {
            let mut random = Random::new(seed ^ ((1 + index as u64) << 32));
            let off = DVec2::new(random.normal(), random.normal()) * texels * texel_mm;
            let off = if fault == Fault::Misplaced { off } else { DVec2::ZERO };
            self.photographs.developed(index, photographed, off)
        });
        let sampled = develop::assembled(&self.rig, &developed.collect::<Vec<_>>());
        if fault == Fault::Blurred && texels > 0.0 { spread(&sampled, texels) } else { sampled }
    }

    /// How far β of a map is off at the texels of a thread.
    fn errors(&self, map: &SbrdfMap, thread: Thread) -> Errors {
        let quarter = std::f64::consts::FRAC_PI_2;
        let mut off_deg = Vec::new();
        let mut right = 0;
        for texel in 0..map.width * map.height {
            let place = texel_position_mm(map.width, map.height, self.rig.carrier.texel_mm(), texel);
            // Even materials are the warp, odd ones the weft.
            if self.truth.index_at(place.x, place.y) % 2 != usize::from(thread == Thread::Weft) {
                continue;
            }
            let Material::Lobes(truth) = self.truth.at(place.x, place.y) else { continue };
            let [found, beta] = [map.beta[texel], truth.beta].map(f64::from);
            off_deg.push(apart(found, beta, quarter).to_degrees());
            let ways = [found + strong_axis(brightest(map, texel)), beta + strong_axis(truth.lobes[0].c)];
            right += usize::from(apart(ways[0], ways[1], 2.0 * quarter) < 0.5 * quarter);
        }
        off_deg.sort_by(f64::total_cmp);
        let at = |share: f64| off_deg[((off_deg.len() - 1) as f64 * share) as usize];
        Errors { median_deg: at(0.5), most_deg: at(0.95), right: right as f64 / off_deg.len() as f64 }
    }
}

/// The reflectance of every pose spread over neighbouring texels by a normal distribution; at the edges over
/// those that there are.
fn spread(sampled: &SampledSbrdf, deviation: f64) -> SampledSbrdf {
    let reach = (4.0 * deviation).ceil() as usize;
    let weight = |a: usize, b: usize| (-0.5 * (a.abs_diff(b) as f64 / deviation).powi(2)).exp() as f32;
    let near = |at: usize, edge: usize| at.saturating_sub(reach)..(at + reach + 1).min(edge);
    let span = 3 * sampled.poses.len();
    let mut out = sampled.clone();
    out.reflectance.par_chunks_mut(span).enumerate().for_each(|(texel, values)| {
        let (x, y) = (texel % sampled.width, texel / sampled.width);
        let mut weights = vec![0f32; span];
        values.fill(0.0);
        for (column, row) in
            near(y, sampled.height).flat_map(|row| near(x, sampled.width).map(move |c| (c, row)))
        {
            let weight = weight(column, x) * weight(row, y);
            let from = sampled.values(row * sampled.width + column);
            for ((value, total), from) in
                values.iter_mut().zip(&mut weights).zip(from).filter(|(_, f)| f.is_finite())
            {
                (*value, *total) = (*value + weight * from, *total + weight);
            }
        }
        // 0 / 0, not a number, where there is no sample.
        values.iter_mut().zip(weights).for_each(|(value, weight)| *value /= weight);
    });
    out
}

/// The distance of two angles modulo `period`.
fn apart(a: f64, b: f64, period: f64) -> f64 {
    let turns = ((a - b) / period).rem_euclid(1.0);
    turns.min(1.0 - turns) * period
}

/// Angle in the lobe's frame of the axis along which C is larger: 0 or a quarter turn.
fn strong_axis(c: glam::Vec3) -> f64 {
    if c.x.abs() >= c.y.abs() { 0.0 } else { std::f64::consts::FRAC_PI_2 }
}

/// C of the lobe with the largest albedo.
fn brightest(map: &SbrdfMap, texel: usize) -> glam::Vec3 {
    let by_albedo = map.lobes.iter().max_by(|a, b| {
        let of = |rho_s: &[crate::reflectance::Rgb]| rho_s[texel].element_sum();
        of(&a.rho_s).total_cmp(&of(&b.rho_s))
    });
    by_albedo.map_or(glam::Vec3::ONE, |lobe| lobe.c[texel])
}

/// The cloth on the carrier.
fn cloth(carrier: &Carrier) -> Result<SampleLayout> {
    let mut recipe: Recipe = toml_file::parse(CLOTH, "examples/cloth.toml")?;
    recipe.pattern = PatternRecipe::Weave { pitch_mm: THREAD as f64 * carrier.texel_mm() };
    recipe.materials.iter_mut().for_each(|material| material.beta_deg = BETA_DEG);
    recipe.layout(Path::new("."), carrier)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampled::PoseGeometry;

    #[test]
    fn beta_of_a_measured_weave_is_off_by_less_than_a_degree_at_half_a_texel_of_blur() {
        let weave = Weave::measured(&Extents { texels: 12, poses: 80 }, 1).unwrap();
        let map = fitted(&weave.sampled(Fault::Blurred, 0.5, 1), 2).unwrap();
        for thread in Thread::ALL {
            let errors = weave.errors(&map, thread);
            println!("{thread:?}: {errors:?}");
            assert!(errors.median_deg < 1.0, "{thread:?}: {errors:?}");
        }
    }

    #[test]
    fn a_spread_sample_keeps_its_sum_and_has_the_deviation_that_was_asked_for() {
        let pose = PoseGeometry { light_mm: glam::DVec3::Z, camera_mm: glam::DVec3::Z, weight: 1.0 };
        let mut sampled = SampledSbrdf::empty(33, 33, 1.0, vec![pose]);
        sampled.reflectance.fill(0.0);
        sampled.reflectance[3 * (16 * 33 + 16)] = 1.0;
        sampled.reflectance[3] = f32::NAN;
        let spread = spread(&sampled, 2.0);
        let red = |index: usize| f64::from(spread.reflectance[3 * index]);
        let sum: f64 = (0..33 * 33).map(red).sum();
        let squares: f64 = (0..33 * 33).map(|k| red(k) * (k as f64 % 33.0 - 16.0).powi(2)).sum();
        assert!((sum - 1.0).abs() < 1e-3 && (squares.sqrt() - 2.0).abs() < 0.01, "{sum} {squares}");
    }

    #[test]
    fn angles_are_apart_by_the_shorter_way() {
        assert!((apart(0.1, 1.5, 1.6) - 0.2).abs() < 1e-12);
        assert!((apart(-0.1, 0.2, 1.6) - 0.3).abs() < 1e-12);
    }
}
