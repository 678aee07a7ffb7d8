//! `lobelia plan`: which poses, in which order, with which exposures.

use std::path::PathBuf;

use clap::Args;

use super::Context;
use crate::error::Result;
use crate::files;
use crate::plan::{self, Extent, Plan, lamp, order};
use crate::progress::{counted, duration};
use crate::rig::config::RigConfig;
use crate::warning::samples::{self, Step};
use crate::warning::{self, Kind, Warning, predicted};

/// Arguments of `lobelia plan`.
#[derive(Debug, Args)]
pub(super) struct PlanArgs {
    /// The rig, see `lobelia template rig`
    rig: PathBuf,
    #[command(flatten)]
    extent: ExtentArgs,
    /// Treats turns about the normal as different, for cloth, brushed metal and wood
    #[arg(long)]
    anisotropic: bool,
    /// File to write
    #[arg(short, long, default_value = "plan.toml")]
    output: PathBuf,
}

/// How many poses.
#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
struct ExtentArgs {
    /// Least angle between two poses, in degrees; 6 to 10 is usual for isotropic materials
    #[arg(long, value_name = "D")]
    density_deg: Option<f64>,
    /// Exponent of the sharpest lobe to resolve with four poses inside its highlight
    #[arg(long, value_name = "N")]
    sharpest_n: Option<f64>,
    /// Number of poses, as far apart as can be
    #[arg(long, value_name = "POSES")]
    budget: Option<usize>,
}

impl ExtentArgs {
    fn extent(&self) -> Extent {
        match (self.density_deg, self.sharpest_n, self.budget) {
            (Some(degrees), _, _) => Extent::Density(degrees),
            (_, Some(n), _) => Extent::SharpestExponent(n),
            (_, _, budget) => Extent::Budget(budget.unwrap_or(0)),
        }
    }
}

/// Runs `lobelia plan`.
pub(super) fn run(args: &PlanArgs, context: &mut Context) -> Result<()> {
    files::try_file(&args.output)?;
    let rig = RigConfig::read(&args.rig)?;
    context.report.input(&args.rig);
    // What the controller would refuse is told now, not when the plan is to be run.
    #[cfg(feature = "sim")]
    crate::acquire::simulated::accepts(&rig).map_err(|error| error.at(args.rig.display()))?;
    let seed = context.seed;
    let extent = args.extent.extent();
    let plan = context.report.stage("plan", || plan::make(&rig, extent, !args.anisotropic, seed))?;
    plan.write(&args.output)?;
    let angles: Vec<_> = (0..plan.poses.len()).map(|index| plan.angles(index)).collect();
    let travel_s = order::tour_s(&rig, &angles);
    context.report.figure("poses", plan.poses.len());
    context.report.figure("spacing_deg", plan.spacing_deg);
    context.report.figure("travel_s", travel_s);
    println!(
        "{}: {} at least {:.1}° apart, {} of travel",
        args.output.display(),
        counted(plan.poses.len() as u64, "pose", "poses"),
        plan.spacing_deg,
        duration(travel_s)
    );
    warn(&rig, &plan, context);
    Ok(())
}

/// Warns of what can be told before anything is photographed.
fn warn(rig: &RigConfig, plan: &Plan, context: &mut Context) {
    let counts = predicted::samples(rig, plan);
    context.report.figure(samples::BY_POSE, samples::by_pose(&counts));
    context.warn(samples::warnings(Step::Plan, &counts));
    context.warn(warning::of_plan(rig, plan));
    context.report.figure("lamp_s", lamp::burning_s(rig, &plan.poses));
    let too_long = lamp::too_long(rig, &plan.poses);
    context.warn(too_long.map(|why| Warning::new(Kind::LampTime, format!("{why}; {}", lamp::PLAN_LESS))));
}
