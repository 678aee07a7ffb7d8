//! `lobelia rig home`, `move` and `clear`.

use clap::Args;
use lobelia_protocol::{AXES, Axis};

use super::Session;
use crate::cli::Context;
use crate::error::{Error, Result};
use crate::progress::counted;
use crate::rig::RigClient;
use crate::rig::config::{AXIS_NAMES, RigConfig};
use crate::rig::status::degrees;

/// Arguments of `lobelia rig home`.
#[derive(Debug, Args)]
pub(super) struct HomeArgs {
    #[command(flatten)]
    session: Session,
    /// Approaches each switch so often, 1 to 100, and tells how its edge scatters
    #[arg(long, default_value_t = 1, value_name = "N")]
    approaches: u8,
    /// Homes this axis alone: pan, tilt, roll or light; can be given several times
    #[arg(long = "axis", value_name = "AXIS", value_parser = AXIS_NAMES)]
    axes: Vec<String>,
}

/// Arguments of `lobelia rig move`.
#[derive(Debug, Args)]
#[group(
    id = "angles",
    required = true,
    multiple = true,
    args = ["pan_deg", "tilt_deg", "roll_deg", "light_deg"]
)]
pub(super) struct MoveArgs {
    #[command(flatten)]
    session: Session,
    /// Where to turn pan, °
    #[arg(long, allow_negative_numbers = true)]
    pan_deg: Option<f64>,
    /// Where to turn tilt, °
    #[arg(long, allow_negative_numbers = true)]
    tilt_deg: Option<f64>,
    /// Where to turn roll, °
    #[arg(long, allow_negative_numbers = true)]
    roll_deg: Option<f64>,
    /// Where to move the light, ° from the camera
    #[arg(long, allow_negative_numbers = true)]
    light_deg: Option<f64>,
    /// Homes first if positions are unknown
    #[arg(long)]
    home: bool,
}

/// Arguments of `lobelia rig clear`.
#[derive(Debug, Args)]
pub(super) struct ClearArgs {
    #[command(flatten)]
    session: Session,
}

/// Runs `lobelia rig home`.
pub(super) fn home(args: &HomeArgs, context: &mut Context) -> Result<()> {
    let (config, mut client) = args.session.configure(context)?;
    let chosen = AXIS_NAMES.map(|name| args.axes.is_empty() || args.axes.iter().any(|axis| axis == name));
    let report = context.report.stage("home", || match args.axes.is_empty() {
        true => client.home_repeatedly(args.approaches),
        false => client.home_axes(chosen, args.approaches),
    })?;
    let of_chosen = |axis: &Axis| chosen[axis.index()];
    print_angles(&config, report.positions, of_chosen);
    if report.approaches > 1 {
        for axis in Axis::ALL.into_iter().filter(of_chosen) {
            let (name, steps) = (axis.name(), report.spread_steps[axis.index()]);
            let within = counted(steps, "step", "steps");
            println!("{name} switch within {within} over {} approaches", report.approaches);
            context.report.figure(&format!("{name}_spread_steps"), steps);
        }
    }
    Ok(())
}

/// Homes the rig when its positions are unknown; without `allowed` the controller's refusal tells the user.
pub(super) fn home_if_unknown(client: &mut RigClient, allowed: bool, context: &mut Context) -> Result<()> {
    if allowed && client.status()?.known != [true; AXES] {
        context.note("homing first");
        context.report.stage("home", || client.home())?;
    }
    Ok(())
}

/// Runs `lobelia rig move`.
pub(super) fn move_axes(args: &MoveArgs, context: &mut Context) -> Result<()> {
    let wanted = [args.pan_deg, args.tilt_deg, args.roll_deg, args.light_deg];
    let (config, mut client) = {
        // Angles are looked at before anything is asked of the rig.
        let config = super::rig_config(args.session.connection.rig.as_deref(), context)?;
        check_limits(&config, wanted)?;
        args.session.configure(context)?
    };
    home_if_unknown(&mut client, args.home, context)?;
    let now = client.status()?.positions;
    let targets = targets(&config, wanted, now)?;
    let positions = context.report.stage("move", || client.go_to(&config.configuration()?, targets))?;
    print_angles(&config, positions, |_| true);
    for (axis, steps) in Axis::ALL.into_iter().zip(positions) {
        context.report.figure(&format!("{}_deg", axis.name()), degrees(&config, axis, steps));
    }
    Ok(())
}

/// Refuses angles beyond the limits of the rig's file.
fn check_limits(config: &RigConfig, wanted: [Option<f64>; AXES]) -> Result<()> {
    for ((name, axis), angle) in AXIS_NAMES.iter().zip(config.axes.in_order()).zip(wanted) {
        if let Some(angle) = angle
            && !(axis.min_deg..=axis.max_deg).contains(&angle)
        {
            return Err(Error::input(format!(
                "--{name}-deg {angle} is beyond the limits of {name}, {}° to {}°",
                axis.min_deg, axis.max_deg
            )));
        }
    }
    Ok(())
}

/// The steps to move to: those of the angles wanted, and else where the axis is, or the limit next to that:
/// after homing axes stand beyond it, at their switches.
pub(super) fn targets(
    config: &RigConfig,
    wanted: [Option<f64>; AXES],
    now: [i32; AXES],
) -> Result<[i32; AXES]> {
    let limits = config.configuration()?.axes;
    let asked = config.steps(wanted.map(|angle| angle.unwrap_or(0.0)));
    Ok(std::array::from_fn(|k| {
        let steps = if wanted[k].is_some() { asked[k] } else { now[k] };
        steps.clamp(limits[k].min_steps, limits[k].max_steps)
    }))
}

fn print_angles(config: &RigConfig, positions: [i32; AXES], of: impl Fn(&Axis) -> bool) {
    for axis in Axis::ALL.into_iter().filter(of) {
        println!("{:<6}{:>10.3}°", axis.name(), degrees(config, axis, positions[axis.index()]));
    }
}

/// Runs `lobelia rig clear`.
pub(super) fn clear(args: &ClearArgs, context: &mut Context) -> Result<()> {
    let (_, mut client) = args.session.connect(context)?;
    let faults: Vec<_> = client.status()?.faults.iter().map(crate::rig::status::fault_name).collect();
    client.clear_faults()?;
    context.report.figure("cleared", faults.len());
    match faults.is_empty() {
        true => println!("there were no faults"),
        false => println!("cleared: {}", faults.join(", ")),
    }
    Ok(())
}
