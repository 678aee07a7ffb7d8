//! The demo: a simulated measurement through the same firmware, link and host code that a real rig uses, and
//! its errors against the simulator's truth.

use std::path::{Path, PathBuf};

use lobelia_hil_sim::optics::SampleLayout;

use crate::acquire::recipe::Recipe;
use crate::acquire::{self, RunFolder, simulated};
use crate::by_angle::Cone;
use crate::develop::{self, Developed};
use crate::error::{Error, Result};
use crate::figures::ErrorFigure;
use crate::fit::FitOptions;
use crate::plan::{self, Extent};
use crate::report::Report;
use crate::rig::config::Carrier;
use crate::sampled::attributes_of;

pub mod fits;
pub mod page;
pub mod pictures;
pub mod truth;

use fits::Fits;
pub use lobelia_sim::sample;
pub use lobelia_sim::size::Size;

/// What to measure and how to fit it.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// How much to measure.
    pub size: Size,
    /// Poses, instead of the size's.
    pub poses: Option<usize>,
    /// What lies on the carrier, instead of the demo's brocade.
    pub recipe: Option<PathBuf>,
    /// Lobes of the result.
    pub lobes: usize,
    /// Whether every channel of the result has lobes of its own.
    pub separate_channels: bool,
    /// Whether the result's lobes may be anisotropic; poses are then chosen for it too.
    pub anisotropic: bool,
    /// Seed of every random choice.
    pub seed: u64,
}

impl Settings {
    /// The demo as it comes, at a size.
    pub fn new(size: Size, seed: u64) -> Self {
        Self { size, poses: None, recipe: None, lobes: 2, separate_channels: false, anisotropic: false, seed }
    }

    /// How the result is fitted.
    fn result(&self) -> FitOptions {
        FitOptions {
            lobes: self.lobes,
            separate_channels: self.separate_channels,
            isotropic: !self.anisotropic,
            ..FitOptions::default()
        }
    }

    /// Checks all that can be checked before anything is measured.
    ///
    /// # Errors
    /// When the settings ask for what cannot be fitted, or the recipe is wrong.
    pub fn check(&self) -> Result<()> {
        self.result().check()?;
        self.layout(&self.size.rig(self.seed).carrier).map(|_| ())
    }

    /// The sample that lies on the carrier.
    fn layout(&self, carrier: &Carrier) -> Result<SampleLayout> {
        match &self.recipe {
            Some(path) => Recipe::read(path, carrier),
            None => sample::layout(carrier),
        }
    }
}

/// All that the demo made.
pub struct DemoOutcome {
    /// The run.
    pub run: RunFolder,
    /// The reflectance and the registrations.
    pub developed: Developed,
    /// The bench, which knows the truth.
    pub bench: lobelia_hil_sim::optics::OpticalBench,
    /// The fits.
    pub fits: Fits,
    /// Where poses looked.
    pub cone: Cone,
    /// RMS registration error of each registered pose against the truth, texels.
    pub registration_texels: Vec<f64>,
}

/// Runs the chain into `folder` and notes stages, errors and figures in `report`.
///
/// # Errors
/// When the settings ask for what cannot be fitted, the recipe is wrong, the folder holds a run already, or
/// the disk refuses.
pub fn run(folder: &Path, settings: &Settings, report: &mut Report) -> Result<DemoOutcome> {
    settings.check()?;
    let rig = settings.size.rig(settings.seed);
    let bench = simulated::bench(&rig, settings.layout(&rig.carrier)?);
    let poses = settings.poses.unwrap_or(settings.size.numbers().1);
    let extent = Extent::Budget(poses);
    let plan = report.stage("plan", || plan::make(&rig, extent, !settings.anisotropic, settings.seed))?;

    let run_folder = folder.join("run");
    report.stage("acquire", || -> Result<()> {
        let (run, mut journal) = RunFolder::create(&run_folder, &plan, &rig)?;
        let mut station = simulated::station(&rig, settings.layout(&rig.carrier)?)?;
        acquire::run(&run, &mut journal, &mut station).map(|_| ())
    })?;
    let run = RunFolder::open(&run_folder)?;

    let made = attributes_of(report.provenance());
    let developed = report.stage("develop", || -> Result<Developed> {
        let developed = develop::run(&run_folder)?;
        let mut attributes = developed.attributes();
        attributes.extend(made);
        developed.sampled.write_zarr_with(&folder.join("sampled.zarr"), &attributes)?;
        Ok(developed)
    })?;

    let cone = Cone::of_poses(&developed.sampled.poses, &run.plan);
    let mut fits = Fits::make(&developed.sampled, settings, (&bench, &cone), report)?;
    let path = folder.join("material.exr");
    fits.result.map.attributes.extend(report.provenance());
    fits.result.map.write_exr(&path).map_err(|error| Error::writing(&path, error))?;

    let axes = simulated::read_truth(&run_folder, run.plan.poses.len())?;
    let registered = developed.registrations.iter().zip(&axes).filter_map(|(found, &axes)| {
        found.as_ref().ok().map(|found| truth::registration_error_texels(&rig, &bench, axes, found))
    });
    let registration_texels: Vec<f64> = registered.collect();
    let outcome = DemoOutcome { run, developed, bench, fits, cone, registration_texels };
    note_figures(&outcome, report);
    Ok(outcome)
}

/// The errors and counts that the README quotes.
fn note_figures(outcome: &DemoOutcome, report: &mut Report) {
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
