//! `lobelia rig lamp` and `expose`.

use std::time::Duration;

use clap::{Args, ValueEnum};

use super::{Session, drive};
use crate::cli::Context;
use crate::error::{Error, Result};
use crate::interrupt;
use crate::progress;
use crate::rig::config::check::exposures_s;

/// A held lamp's controller is spoken to this often.
const HOLD: Duration = Duration::from_secs(1);

/// Arguments of `lobelia rig lamp`.
#[derive(Debug, Args)]
pub(super) struct LampArgs {
    /// On or off
    state: Switch,
    #[command(flatten)]
    session: Session,
    /// Brightness, 0 to 1 of full
    #[arg(long, default_value_t = 1.0)]
    level: f64,
    /// Doesn't wait until the lamp is warm
    #[arg(long)]
    no_wait: bool,
    /// Keeps the lamp burning until Ctrl-C, then switches it off
    #[arg(long)]
    hold: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Switch {
    On,
    Off,
}

/// Arguments of `lobelia rig expose`.
#[derive(Debug, Args)]
pub(super) struct ExposeArgs {
    /// How long the shutter is open, 0.0001 to 60 s
    seconds: f64,
    #[command(flatten)]
    session: Session,
    /// A dark frame: the lamp may be off or cold
    #[arg(long)]
    dark: bool,
    /// Homes first if positions are unknown
    #[arg(long)]
    home: bool,
}

/// Runs `lobelia rig lamp`.
pub(super) fn lamp(args: &LampArgs, context: &mut Context) -> Result<()> {
    if !(0.0..=1.0).contains(&args.level) {
        return Err(Error::input(format!("--level {} is not between 0 and 1", args.level)));
    }
    let (config, mut client) = args.session.configure(context)?;
    if args.state == Switch::Off {
        client.lamp(false, 0.0)?;
        println!("the lamp is off");
        return Ok(());
    }
    client.lamp(true, args.level)?;
    if !args.no_wait {
        let total = client.status()?.lamp.remaining_s;
        let bar = progress::bar("lamp", total.into(), "s");
        let mut last = total;
        context.report.stage("warm-up", || {
            client.wait_until_warm(|left| {
                bar.advance(last.saturating_sub(left).into());
                last = left;
            })
        })?;
    }
    let lamp = client.status()?.lamp;
    context.report.figure("warm", lamp.warm);
    match lamp.warm {
        true => println!("the lamp is on and warm"),
        false => println!("the lamp is on, warm in {} s", lamp.remaining_s),
    }
    if args.hold {
        context.note("Ctrl-C switches it off");
        let mut held = Ok(());
        while held.is_ok() && !interrupt::interrupted() {
            held = client.pause(HOLD);
            args.session.connection.keep_pace(HOLD);
        }
        // However it ends, and even if the answer to what was asked last is lost.
        client.uninterrupted(|client| client.lamp(false, 0.0))?;
        if !interrupt::interrupted() {
            held?;
        }
    } else if config.lamp.lease_s > 0.0 {
        context.note(format!(
            "the controller dims it when it hears nothing for {} s (lamp.lease_s); --hold keeps it burning",
            config.lamp.lease_s
        ));
    }
    Ok(())
}

/// Runs `lobelia rig expose`.
pub(super) fn expose(args: &ExposeArgs, context: &mut Context) -> Result<()> {
    let duration_us = (args.seconds * 1e6).round();
    let possible = exposures_s();
    if !possible.contains(&args.seconds) {
        let (least, most) = (possible.start(), possible.end());
        return Err(Error::input(format!("{} s is not between {least} and {most} s", args.seconds)));
    }
    let (_, mut client) = args.session.configure(context)?;
    drive::home_if_unknown(&mut client, args.home, context)?;
    let exposure = context.report.stage("expose", || client.expose(duration_us as u32, !args.dark))?;
    let reference = f64::from(exposure.reference_q8) / 256.0;
    println!(
        "open for {:.6} s from {:.6} s of the controller's time; lamp {reference:.2} counts over {} \
         readings, flicker {} ppm",
        f64::from(exposure.open_us) / 1e6,
        exposure.start_us as f64 / 1e6,
        exposure.readings,
        exposure.flicker_ppm
    );
    context.report.figure("open_us", exposure.open_us);
    context.report.figure("reference_counts", reference);
    context.report.figure("flicker_ppm", exposure.flicker_ppm);
    Ok(())
}
