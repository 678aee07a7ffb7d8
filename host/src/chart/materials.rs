//! Fits of nine materials in the shape of table 3.4 of the specification: seconds, mean and largest RMS,
//! sizes.

use std::path::Path;
use std::time::Instant;

use super::compared::{COMPARED, Compared};
use super::{Axis, Cell, Chart, Plot, Section, Series, Table};
use crate::acquire::recipe::Recipe;
use crate::error::{Error, Result};
use crate::fit::{self, FitOptions, Residual};
use crate::page::numbers;
use crate::progress;
use crate::reflectance::{Brdf, SbrdfMap};
use crate::rig::config::{Carrier, RigConfig};
use crate::sampled::{PoseGeometry, SampledSbrdf};
use crate::synth::{self, Options};
use crate::toml_file;

/// Edge of a texel, mm.
const TEXEL_MM: f64 = 0.5;
/// Noise, sr⁻¹, and as a share of the value.
const NOISE: [f64; 2] = [1e-3, 0.005];
/// One pose in so many is aimed at the highlight.
const AIMED: usize = 4;

/// A material: its recipe under `examples/materials`, and how much of it is sampled.
struct Material {
    name: &'static str,
    recipe: &'static str,
    /// Texels across and down.
    size: [usize; 2],
    poses: usize,
}

/// A material by its name in the table, that of its recipe's file, its texels and poses.
macro_rules! material {
    ($name:literal, $file:literal, $size:expr, $poses:literal) => {
        Material {
            name: $name,
            recipe: include_str!(concat!("../../../examples/materials/", $file, ".toml")),
            size: $size,
            poses: $poses,
        }
    };
}

/// In the order of the table.
const MATERIALS: [Material; 9] = [
    material!("blue fabric", "blue-fabric", [48, 48], 150),
    material!("gift wrap", "gift-wrap", [32, 32], 120),
    material!("gold fabric", "gold-fabric", [48, 48], 300),
    material!("gold paper (with its mirror)", "gold-paper", [48, 48], 140),
    material!("long leaf", "long-leaf", [96, 24], 120),
    material!("test pattern", "test-pattern", [64, 32], 280),
    material!("tan fabric", "tan-fabric", [48, 48], 130),
    material!("wall paper", "wall-paper", [48, 48], 130),
    material!("white fabric", "white-fabric", [32, 32], 600),
];

/// One fit of one material.
#[derive(Debug, Clone, Copy)]
struct Found {
    time_s: f64,
    /// Mean and largest RMS over the texels, sr⁻¹.
    rms: [f64; 2],
    /// Median of ‖f̂ − f‖ / ‖f‖ over directions that were not posed.
    error: f64,
    /// Size of the map, MB.
    map_mb: f64,
}

/// Fits every material with every method, on one thread.
///
/// # Errors
/// When no thread can be started or the disk has no room to measure the files' sizes.
pub fn chart(seed: u64) -> Result<Chart> {
    let bar = progress::bar("materials", (MATERIALS.len() * COMPARED.len()) as u64, "fits");
    let mut short = Table::new([
        "material",
        "poses",
        "size",
        "MB",
        "line search: s / mean / max",
        "scaled",
        "LM, 1 lobe",
        "LM, 2 lobes",
        "separable, 1",
        "separable, 2",
        "auto",
    ]);
    let mut long = Table::new([
        "material",
        "method",
        "s",
        "mean RMS, 1/sr",
        "largest RMS, 1/sr",
        "median error, unposed directions, %",
        "map, MB",
    ]);
    let mut points: Vec<(Vec<[f64; 2]>, Vec<String>)> = vec![Default::default(); COMPARED.len()];
    for material in &MATERIALS {
        let (sampled_mb, found) = judged(material, seed, || bar.advance(1))?;
        let [width, height] = material.size;
        let mut row: Vec<Cell> = vec![
            material.name.into(),
            material.poses.into(),
            format!("{width} × {height}").into(),
            sampled_mb.into(),
        ];
        row.extend(found.iter().map(in_short));
        short.rows.push(row);
        for ((&Compared { name, .. }, found), (points, labels)) in
            COMPARED.iter().zip(&found).zip(&mut points)
        {
            points.push([found.time_s * 1e9 / (width * height * material.poses) as f64, found.rms[0]]);
            labels.push(format!("{name}: {}", material.name));
            long.row([
                material.name.into(),
                name.into(),
                found.time_s.into(),
                found.rms[0].into(),
                found.rms[1].into(),
                (100.0 * found.error).into(),
                found.map_mb.into(),
            ]);
        }
    }
    let series = COMPARED.iter().zip(points);
    let section = Section {
        title: "Nine materials".into(),
        text: format!(
            "The recipes of examples/materials, {TEXEL_MM} mm a texel, random poses of which one in {AIMED} \
             is aimed at the highlight, noise {:e} 1/sr and {} %; anisotropic lobes, residual: linear, one \
             thread, the fit alone. The source's sizes are reduced: it had 311 to 7650 poses and 64² to 512² \
             texels. RMS of the residual over samples and channels, mean and largest over the texels; where \
             auto finds a mirror it leaves its poses out of the fit and of the RMS. Sizes are those of the \
             files: a Zarr store with standard deviations, an OpenEXR map with its planes of errors.",
            NOISE[0],
            100.0 * NOISE[1]
        ),
        plots: vec![Plot {
            title: "Mean RMS by time, a mark a material".into(),
            x: Axis::log("ns a sample"),
            y: Axis::log("mean RMS, 1/sr"),
            series: series
                .map(|(compared, (points, labels))| Series::scattered(compared.name, points, labels))
                .collect(),
        }],
        tables: vec![short, long],
        ..Section::default()
    };
    Ok(Chart {
        name: "materials".into(),
        title: "What fits of materials cost and leave".into(),
        lead: "Fabrics, wrapping papers, a leaf and a test pattern of our own, after table 3.4 of the \
             source; its samples are not to be had."
            .into(),
        sections: vec![section],
    })
}

/// Seconds, mean and largest RMS.
fn in_short(found: &Found) -> Cell {
    let [time, mean, most] = [found.time_s, found.rms[0], found.rms[1]].map(|x| numbers::significant(x, 2));
    format!("{time} / {mean} / {most}").into()
}

/// The size of the sampled material, MB, and what every fit makes of it; `done` is called a fit.
fn judged(material: &Material, seed: u64, done: impl Fn()) -> Result<(f64, Vec<Found>)> {
    let folder = tempfile::tempdir()
        .map_err(|error| Error::failure(format!("no folder for sizes: {error}")).caused_by(error))?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .map_err(|error| Error::failure(format!("a thread cannot be started: {error}")).caused_by(error))?;
    let layout = Laid::new(material)?;
    let sampled = layout.sampled(seed);
    let store = folder.path().join("sampled.zarr");
    sampled.write_zarr(&store)?;
    let fit = |compared: &Compared| {
        let options = FitOptions { isotropic: false, residual: Residual::Linear, ..compared.options() };
        let start = Instant::now();
        let map = pool.install(|| fit::fit_sbrdf(&sampled, &options))?;
        let time_s = start.elapsed().as_secs_f64();
        let rms = &map.extra["error.rms"];
        let mean = rms.iter().map(|&rms| f64::from(rms)).sum::<f64>() / rms.len() as f64;
        let most = f64::from(rms.iter().copied().fold(0.0, f32::max));
        let path = folder.path().join("map.exr");
        map.write_exr(&path).map_err(|error| Error::failure(error.to_string()).caused_by(error))?;
        done();
        Ok(Found {
            time_s,
            rms: [mean, most],
            error: layout.error(&sampled, &map, seed),
            map_mb: size_mb(&path)?,
        })
    };
    let found = COMPARED.iter().map(fit).collect::<Result<Vec<_>>>()?;
    Ok((size_mb(&store)?, found))
}

/// A material laid out on its sample.
struct Laid<'a> {
    material: &'a Material,
    layout: lobelia_hil_sim::optics::SampleLayout,
}

impl<'a> Laid<'a> {
    fn new(material: &'a Material) -> Result<Self> {
        let recipe: Recipe = toml_file::parse(material.recipe, material.name)?;
        let [width, height] = material.size.map(|texels| texels as f64 * TEXEL_MM);
        let carrier =
            Carrier { sample_width_mm: width, sample_height_mm: height, ..RigConfig::default().carrier };
        Ok(Self { material, layout: recipe.layout(Path::new("."), &carrier)? })
    }

    fn sampled(&self, seed: u64) -> SampledSbrdf {
        let mut poses = synth::poses(self.material.poses, seed);
        let aimed = poses.len() / AIMED;
        poses.iter_mut().take(aimed).for_each(PoseGeometry::aim_at_highlight);
        let options = Options {
            width: self.material.size[0],
            height: self.material.size[1],
            texel_mm: TEXEL_MM,
            poses: poses.len(),
            noise: NOISE[0],
            relative_noise: NOISE[1],
            seed,
        };
        let value = |_, place: glam::DVec3, wi, wo| self.layout.at(place.x, place.y).eval(wi, wo);
        synth::sample_at(poses, &options, value)
    }

    /// Median over the texels of ‖f̂ − f‖ / ‖f‖ on directions that were not posed.
    fn error(&self, sampled: &SampledSbrdf, map: &SbrdfMap, seed: u64) -> f64 {
        let pairs = super::unposed::pairs(seed);
        let of = |texel: usize| {
            let place = sampled.position_mm(texel);
            super::unposed::relative_error(map, texel, self.layout.at(place.x, place.y), &pairs)
        };
        let mut errors: Vec<f64> = (0..sampled.texels()).map(of).collect();
        errors.sort_by(f64::total_cmp);
        errors[errors.len() / 2]
    }
}

/// The size of a file, or of all files in a folder, MB.
fn size_mb(path: &Path) -> Result<f64> {
    fn bytes(path: &Path) -> std::io::Result<u64> {
        let metadata = std::fs::metadata(path)?;
        if !metadata.is_dir() {
            return Ok(metadata.len());
        }
        std::fs::read_dir(path)?.map(|entry| bytes(&entry?.path())).sum()
    }
    bytes(path).map(|bytes| bytes as f64 / 1e6).map_err(|error| Error::reading(path, error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_recipe_is_a_sample_that_makes_no_energy_where_it_is_seen() {
        for material in &MATERIALS {
            let sampled = Laid::new(material).unwrap().sampled(1);
            assert_eq!(sampled.poses.len(), material.poses);
            let recipe: Recipe = toml_file::parse(material.recipe, material.name).unwrap();
            for built in recipe.build_materials(Path::new(".")).unwrap() {
                let lobelia_hil_sim::optics::Material::Lobes(brdf) = built else {
                    panic!("{}", material.name)
                };
                for degrees in [0f32, 30.0, 60.0, 75.0] {
                    let (sin, cos) = degrees.to_radians().sin_cos();
                    let wi = glam::Vec3::new(sin, 0.0, cos);
                    let albedo = crate::reflectance::albedo::directional(&brdf, wi).max_element();
                    assert!(albedo <= 1.0, "{} at {degrees}°: {albedo}", material.name);
                }
            }
        }
    }

    #[test]
    fn least_squares_leave_the_noise_of_a_fabric_and_the_line_search_more() {
        let material = Material { size: [8, 8], poses: 100, ..MATERIALS[0] };
        let (sampled_mb, found) = judged(&material, 1, || ()).unwrap();
        let rms = |fit: usize| found[fit].rms[0];
        println!("{sampled_mb} MB, {found:?}");
        assert!((rms(2) / 1e-3 - 1.0).abs() < 0.1 && (rms(4) / 1e-3 - 1.0).abs() < 0.1);
        assert!(rms(0) > rms(4) && found.iter().all(|found| found.rms[1] >= found.rms[0]));
        // A chunk of 16 × 16 texels × 100 poses × 3 values of 4 and 2 bytes.
        assert!(sampled_mb > 0.46 && sampled_mb < 0.5 && found[4].map_mb < sampled_mb);
    }
}
