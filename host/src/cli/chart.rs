//! `lobelia chart`: what methods cost against how right they are.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::Context;
use crate::chart;
use crate::error::Result;
use crate::files;
use crate::rig::config::RigConfig;
use crate::scene::{Scene, shipped};

/// Arguments of `lobelia chart`.
#[derive(Debug, Args)]
pub(super) struct ChartArgs {
    #[command(subcommand)]
    what: What,
    /// Folder for NAME.html, NAME.json and the plots as SVG
    #[arg(short, long, global = true, default_value = "charts")]
    output: PathBuf,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Time and error of fits by method, number of lobes and noise; models beyond lobes by material; cost by
    /// the amount of data; direction of anisotropy by blur; CPU and GPU
    Fit,
    /// Seconds, RMS and sizes of nine materials by method, after table 3.4 of the source
    #[cfg(feature = "sim")]
    Materials,
    /// Poses and travel of plans by their density
    Plan {
        /// The rig; the default one when not given
        rig: Option<PathBuf>,
    },
    /// Error by number of poses, texels fitted one by one and pooled, under a near and a far light and camera
    Pool,
    /// Coefficients in fewer bits: f16 and 8 bits against f32
    Storage,
    /// Interpolated coefficients against interpolated reflectance, between texels and in MIP levels; filters
    /// of textures in pictures
    Interpolation,
    /// Prefiltered environments: maps against quadrature by exponent, pictures against the path tracer by
    /// exponent and angle
    Environment {
        /// Environments, .exr or .hdr files or shipped ones; the shipped ones, studio and sky, when none is
        /// named
        environments: Vec<PathBuf>,
        /// Relative error of the prefiltered maps
        #[arg(long, value_name = "E", default_value_t = 0.01)]
        map_error: f32,
        /// Pixels a row of the pictures
        #[arg(long, default_value_t = 128, value_parser = clap::value_parser!(u32).range(16..=4096))]
        width: u32,
    },
    /// Samples of incident radiance near lights, and their error, by the ways to place them
    Incident {
        /// Scenes, files or shipped ones
        #[arg(default_value = "panels")]
        scenes: Vec<PathBuf>,
        /// Degree of the spherical harmonics; the source's is 3
        #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=8))]
        degree: u32,
    },
    /// Frames per second of `lights` by lobes, lights, pixels, filter and storage; needs a GPU
    Lights {
        /// The scene, a file or a shipped one; its materials and lights are replaced
        #[arg(default_value = "gallery")]
        scene: PathBuf,
        /// Frames a measurement
        #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=10_000))]
        frames: u32,
    },
    /// Time against error of every renderer and setting, judged by the reference
    Render {
        /// Scenes, files or shipped ones; all shipped ones when none is named
        scenes: Vec<PathBuf>,
        /// Samples a pixel of the reference that judges, at most
        #[arg(long, default_value_t = 1024, value_parser = clap::value_parser!(u32).range(16..=1_048_576))]
        samples: u32,
        /// Pixels a row of the pictures; rows follow from the scene's own shape
        #[arg(long, default_value_t = 120, value_parser = clap::value_parser!(u32).range(16..=4096))]
        width: u32,
    },
}

/// Runs `lobelia chart`.
pub(super) fn run(args: &ChartArgs, context: &mut Context) -> Result<()> {
    files::try_folder(&args.output)?;
    let seed = context.seed;
    let chart = match &args.what {
        What::Fit => context.report.stage("chart", || chart::fit::chart(seed))?,
        #[cfg(feature = "sim")]
        What::Materials => context.report.stage("chart", || chart::materials::chart(seed))?,
        What::Plan { rig } => {
            let config = match rig {
                Some(path) => {
                    context.report.input(path);
                    RigConfig::read(path)?
                }
                None => RigConfig::default(),
            };
            context.report.stage("chart", || chart::plan::chart(&config, seed))?
        }
        What::Pool => context.report.stage("chart", || chart::pool::chart(seed))?,
        What::Storage => context.report.stage("chart", || chart::storage::chart(seed))?,
        What::Interpolation => context.report.stage("chart", chart::interpolation::chart)?,
        What::Environment { environments, map_error, width } => {
            for path in environments.iter().filter(|path| path.exists()) {
                context.report.input(path);
            }
            let shipped = ["studio", "sky"].map(PathBuf::from).to_vec();
            let names = if environments.is_empty() { &shipped } else { environments };
            let open = |name: &PathBuf| {
                let stem = name.file_stem().unwrap_or_default().to_string_lossy().into_owned();
                Ok((stem, super::environment::open(name)?))
            };
            let named = names.iter().map(open).collect::<Result<Vec<_>>>()?;
            context.report.stage("chart", || chart::environment::chart(&named, *map_error, *width, seed))?
        }
        What::Incident { scenes, degree } => {
            let named = |name: &PathBuf| Ok((name.display().to_string(), Scene::open(name)?));
            let scenes = scenes.iter().map(named).collect::<Result<Vec<_>>>()?;
            context.report.stage("chart", || chart::incident::chart(&scenes, *degree))?
        }
        What::Lights { scene, frames } => {
            let scene = Scene::open(scene)?;
            context.report.stage("chart", || chart::lights::chart(&scene, *frames))?
        }
        What::Render { scenes, samples, width } => {
            let scenes = open(scenes, *width)?;
            context.report.stage("chart", || chart::render::chart(&scenes, *samples, seed))?
        }
    };
    let page = chart.write(&args.output)?;
    print!("{chart}");
    println!("{}", page.display());
    Ok(())
}

/// The scenes named, or all that are shipped and that every method draws, at a width of pictures.
///
/// # Errors
/// Input errors for a scene that cannot be read.
fn open(names: &[PathBuf], width: u32) -> Result<Vec<(String, Scene)>> {
    let shipped: Vec<PathBuf> = shipped::SCENES.iter().map(|scene| scene.0.into()).collect();
    let given = if names.is_empty() { &shipped } else { names };
    let scenes = given.iter().map(|name| Ok((name, Scene::open(name)?)));
    let drawn = |opened: &Result<(&PathBuf, Scene)>| {
        !names.is_empty() || opened.as_ref().map_or(true, |(_, scene)| scene.beyond_lobes().is_none())
    };
    let scenes = scenes.filter(drawn).map(|opened| {
        let (name, mut scene) = opened?;
        let camera = &mut scene.camera;
        camera.height = (width * camera.height / camera.width).max(1);
        camera.width = width;
        Ok((name.display().to_string(), scene))
    });
    scenes.collect()
}
