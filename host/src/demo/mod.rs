//! The demo: a simulated measurement through the same firmware, link and host code that a real rig uses, and its errors
//! against the simulator's truth.

use std::path::{Path, PathBuf};

use crate::acquire::{self, RunFolder, simulated};
use crate::develop::{self, Developed};
use crate::error::{Error, Result};
use crate::fit::figures::ErrorFigure;
use crate::fit::{self, FitOptions, Method};
use crate::plan::{self, Extent};
use crate::reflectance::SbrdfMap;
use crate::report::Report;
use crate::rig::config::RigConfig;

pub mod page;
pub mod pictures;
pub mod sample;
pub mod truth;

/// How much to measure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Size {
    /// 48 × 48 texels, 80 poses: seconds
    Small,
    /// 128 × 128 texels, 200 poses: about a minute
    Medium,
    /// 256 × 256 texels, 400 poses: many minutes
    Full,
}

impl Size {
    /// Texels across, poses, and the sensor's size relative to the default.
    fn numbers(self) -> (usize, usize, f64) {
        match self {
            Self::Small => (48, 80, 0.6),
            Self::Medium => (128, 200, 1.0),
            Self::Full => (256, 400, 2.0),
        }
    }

    /// Pixels and samples a pixel of the rendered pictures.
    pub fn picture(self) -> (u32, u32, u32) {
        match self {
            Self::Small => (400, 300, 16),
            Self::Medium => (640, 480, 32),
            Self::Full => (1280, 960, 64),
        }
    }

    /// The rig at this size.
    pub fn rig(self, seed: u64) -> RigConfig {
        let (texels, _, scale) = self.numbers();
        let mut rig = RigConfig::default();
        rig.carrier.texels_across = texels;
        let camera = &mut rig.camera;
        camera.width = (camera.width as f64 * scale) as usize;
        camera.height = (camera.height as f64 * scale) as usize;
        camera.focal_px = camera.focal_px.map(|f| f * scale);
        camera.principal_px = camera.principal_px.map(|c| (c + 0.5) * scale - 0.5);
        rig.simulator.seed = seed;
        rig
    }
}

/// One fit and how wrong it is.
pub struct FitOutcome {
    /// Method.
    pub method: Method,
    /// Lobes.
    pub lobes: usize,
    /// The map.
    pub map: SbrdfMap,
    /// Duration, s.
    pub seconds: f64,
    /// Relative RMS error on unposed direction pairs, a texel.
    pub errors: Vec<f32>,
}

/// All that the demo made.
pub struct DemoOutcome {
    /// The run.
    pub run: RunFolder,
    /// The reflectance and the registrations.
    pub developed: Developed,
    /// The bench, which knows the truth.
    pub bench: lobelia_hil_sim::optics::OpticalBench,
    /// The fits that were compared; the last one is the result.
    pub fits: Vec<FitOutcome>,
    /// RMS registration error of each registered pose against the truth, texels.
    pub registration_texels: Vec<f64>,
}

/// Runs the chain into `folder` and notes stages, errors and figures in `report`.
///
/// # Errors
/// When the folder holds a run already, or the disk refuses.
pub fn run(folder: &Path, size: Size, seed: u64, report: &mut Report) -> Result<DemoOutcome> {
    let rig = size.rig(seed);
    let (_, poses, _) = size.numbers();
    let plan = report.stage("plan", || plan::make(&rig, Extent::Budget(poses), true, seed))?;

    let run_folder = folder.join("run");
    let layout = || sample::layout(&rig.carrier);
    report.stage("acquire", || -> Result<()> {
        let (run, mut journal) = RunFolder::create(&run_folder, &plan, &rig)?;
        let mut station = simulated::station(&rig, layout()?)?;
        acquire::run(&run, &mut journal, &mut station).map(|_| ())
    })?;
    let run = RunFolder::open(&run_folder)?;

    let developed = report.stage("develop", || -> Result<Developed> {
        let developed = develop::run(&run_folder)?;
        developed.sampled.write_zarr(&folder.join("sampled.zarr"))?;
        Ok(developed)
    })?;

    let bench = simulated::bench(&rig, layout()?);
    let pairs = truth::unposed_pairs(seed);
    let mut fits = Vec::new();
    for (method, lobes) in [(Method::LineSearch, 1), (Method::Lm, 1), (Method::Lm, 2)] {
        let options = FitOptions { lobes, method, ..FitOptions::default() };
        let name = format!("fit {} {lobes}", method.name());
        let map = report.stage(&name, || fit::fit_sbrdf(&developed.sampled, &options))?;
        let seconds = report.stages.last().map_or(0.0, |stage| stage.seconds);
        let errors = truth::reflectance_errors(&rig, &bench, &map, &pairs);
        fits.push(FitOutcome { method, lobes, map, seconds, errors });
    }
    if let Some(result) = fits.last() {
        let path = folder.join("material.exr");
        result.map.write_exr(&path).map_err(|error| Error::writing(&path, error))?;
    }

    let axes = simulated::read_truth(&run_folder, run.plan.poses.len())?;
    let registered = developed.registrations.iter().zip(&axes).filter_map(|(found, &axes)| {
        found.as_ref().ok().map(|found| truth::registration_error_texels(&rig, &bench, axes, found))
    });
    let registration_texels: Vec<f64> = registered.collect();
    let outcome = DemoOutcome { run, developed, bench, fits, registration_texels };
    note_figures(&outcome, report);
    Ok(outcome)
}

/// The errors and counts that the README quotes.
fn note_figures(outcome: &DemoOutcome, report: &mut Report) {
    for fit in &outcome.fits {
        let over = format!("median over texels, {} unposed direction pairs each", truth::PAIRS);
        report.errors.push(
            ErrorFigure::new("relative_rms_reflectance", truth::median(&fit.errors), "1", over)
                .with("method", fit.method.name())
                .with("lobes", fit.lobes),
        );
    }
    let count = outcome.registration_texels.len();
    let squares: f64 = outcome.registration_texels.iter().map(|e| e * e).sum();
    let rms = (squares / count.max(1) as f64).sqrt();
    let over = format!("81 points of the sample in {count} poses, against the simulator's truth");
    report.errors.push(ErrorFigure::new("registration_rms", rms, "texel", over));
    let sampled = &outcome.developed.sampled;
    report.figure("texels", sampled.texels());
    report.figure("poses", sampled.poses.len());
    report.figure("poses_registered", count);
    let camera = &outcome.run.rig.camera;
    report.figure("sensor_px", vec![camera.width, camera.height]);
}

/// Where the demo writes when no folder is named.
pub fn default_folder() -> PathBuf {
    PathBuf::from("demo-out")
}
