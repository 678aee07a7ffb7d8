//! `lobelia rig status`, `monitor` and `params`.

use std::io::{IsTerminal, Write};
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;

use super::{Connection, Session};
use crate::cli::{Context, seconds_of};
use crate::error::Result;
use crate::interrupt;
use crate::rig::{RigClient, monitor, parameters, status};

/// How often the monitor looks at the status.
const LOOK: Duration = Duration::from_millis(200);

/// Telemetry comes no faster.
const LEAST_TELEMETRY_S: f64 = 0.02;

/// Arguments of `lobelia rig status`.
#[derive(Debug, Args)]
pub(super) struct StatusArgs {
    #[command(flatten)]
    session: Session,
    /// Goes on telling, every second, until Ctrl-C
    #[arg(long)]
    watch: bool,
    /// Ends watching after so many seconds of the controller's time
    #[arg(long, value_name = "S", requires = "watch")]
    for_s: Option<f64>,
}

/// Arguments of `lobelia rig monitor`.
#[derive(Debug, Args)]
pub(super) struct MonitorArgs {
    #[command(flatten)]
    session: Session,
    /// Ends after so many seconds of the controller's time; without it, at Ctrl-C
    #[arg(long, value_name = "S")]
    for_s: Option<f64>,
    /// Tells positions, photodiode and how many frames came damaged, every so many seconds, 0.02 at least
    #[arg(long, value_name = "S")]
    telemetry_s: Option<f64>,
}

/// Arguments of `lobelia rig params`.
#[derive(Debug, Args)]
pub(super) struct ParamsArgs {
    /// The controller, to read back what it has: sim, /dev/ttyACM0 or tcp://host:port
    #[arg(long)]
    port: Option<String>,
    /// The rig, see `lobelia template rig`; the simulated one when not given
    #[arg(long, value_name = "RIG.toml")]
    rig: Option<PathBuf>,
    /// Sends them, and has the controller keep them over a power cut
    #[arg(long, requires = "port")]
    save: bool,
}

/// When watching ends, by the controller's clock.
fn end_us(client: &mut RigClient, for_s: Option<f64>) -> Result<u64> {
    let Some(seconds) = for_s else { return Ok(u64::MAX) };
    let time = seconds_of("--for-s", seconds, 0.0)?;
    Ok(client.status()?.uptime_us.saturating_add(time.as_micros() as u64))
}

/// Runs `lobelia rig status`.
pub(super) fn status(args: &StatusArgs, context: &mut Context) -> Result<()> {
    let (config, mut client) = args.session.connect(context)?;
    let end_us = end_us(&mut client, args.for_s)?;
    let live = std::io::stdout().is_terminal();
    let mut lines = 0;
    loop {
        let now = client.status()?;
        let health = status::health(&client.health()?);
        let text = format!("{}{:<11}{health}\n", status::text(&now, &config), "health");
        if live && lines > 0 {
            // Back to the first line, and clear from there.
            print!("\x1b[{lines}A\x1b[J");
        }
        print!("{text}");
        let _ = std::io::stdout().flush();
        lines = text.lines().count();
        if !args.watch || interrupt::interrupted() || now.uptime_us >= end_us {
            context.report.figure("uptime_s", now.uptime_us as f64 / 1e6);
            context.report.figure("homed", now.known.iter().all(|&known| known));
            context.report.figure("faults", now.faults.iter().count());
            return Ok(());
        }
        client.listen(Duration::from_secs(1))?;
        if args.for_s.is_none() {
            args.session.connection.keep_pace(Duration::from_secs(1));
        }
        if !live {
            println!();
        }
    }
}

/// Runs `lobelia rig monitor`.
pub(super) fn monitor(args: &MonitorArgs, context: &mut Context) -> Result<()> {
    let every = args.telemetry_s.map(|seconds| seconds_of("--telemetry-s", seconds, LEAST_TELEMETRY_S));
    let telemetry = every.transpose()?;
    let (config, mut client) = args.session.connect(context)?;
    let end_us = end_us(&mut client, args.for_s)?;
    client.watch(telemetry, true)?;
    let mut before = client.status()?;
    let mut events = 0_u64;
    println!("{}", monitor::line(before.uptime_us, "connected"));
    while before.uptime_us < end_us && !interrupt::interrupted() {
        while let Some(event) = client.listen(LOOK)? {
            println!("{}", monitor::event(&event, before.uptime_us, before.known, &config));
            events += 1;
            // Telemetry may never pause for as long as one look takes.
            if monitor::time_us(&event).is_some_and(|us| us >= before.uptime_us + LOOK.as_micros() as u64) {
                break;
            }
        }
        if args.for_s.is_none() {
            args.session.connection.keep_pace(LOOK);
        }
        let now = client.status()?;
        for line in monitor::changes(&before, &now, &config) {
            println!("{line}");
            events += 1;
        }
        before = now;
    }
    context.report.figure("events", events);
    Ok(())
}

/// Runs `lobelia rig params`.
pub(super) fn params(args: &ParamsArgs, context: &mut Context) -> Result<()> {
    let config = super::rig_config(args.rig.as_deref(), context)?;
    print!("{}", parameters::table(&config.configuration()?));
    let Some(port) = &args.port else { return Ok(()) };
    let connection = Connection { port: port.clone(), rig: None };
    let mut client = RigClient::connect(connection.open(&config)?)?;
    if args.save {
        client.configure(&config.configuration()?)?;
        client.save_parameters()?;
        println!("controller: has these parameters now and keeps them");
        return Ok(());
    }
    let ours = config.configuration()?;
    let Some(theirs) = client.read_parameters()? else {
        println!("controller: has no parameters yet");
        return Ok(());
    };
    let differences = parameters::differences(&ours, &theirs);
    context.report.figure("differences", differences.len());
    for difference in &differences {
        println!("differs: {difference}");
    }
    println!(
        "controller: {}",
        match differences.len() {
            0 => "has these parameters".to_owned(),
            count => format!("has other parameters, {count} of them; --save sends these"),
        }
    );
    Ok(())
}
