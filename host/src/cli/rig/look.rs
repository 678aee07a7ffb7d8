//! `lobelia rig status`, `monitor` and `params`.

use std::io::{IsTerminal, Write};
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use lobelia_protocol::{Axis, AxisParameters, Configuration, DriverParameters, KeepOut, Pin, Pins, Settings};

use super::{Connection, Session};
use crate::cli::{Context, seconds_of};
use crate::error::Result;
use crate::interrupt;
use crate::rig::config::RigConfig;
use crate::rig::{RigClient, monitor, status};

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
    print!("{}", table(&config)?);
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
    let differences = differences(&ours, &theirs);
    context.report.figure("differences", differences.len());
    for difference in &differences {
        println!("{difference}");
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

/// A line for each parameter that the controller has otherwise.
pub(super) fn differences(ours: &Configuration, theirs: &Configuration) -> Vec<String> {
    let mut lines = Vec::new();
    let mut compare = |name: String, unit: &str, ours: String, theirs: String| {
        if ours != theirs {
            lines.push(format!("differs: {name} is {theirs} {unit} in the controller, {ours} here"));
        }
    };
    for axis in Axis::ALL {
        let [ours, theirs] = [ours, theirs].map(|all| &all.axes[axis.index()]);
        for (name, unit, number) in ROWS {
            let name = format!("{} {name}", axis.name());
            compare(name, unit, number(ours).to_string(), number(theirs).to_string());
        }
        compare(
            format!("{} home_direction", axis.name()),
            "end",
            format!("{:?}", ours.home_direction),
            format!("{:?}", theirs.home_direction),
        );
        let alarm = |axis: &AxisParameters| format!("{:?}", axis.alarm);
        compare(format!("{} alarm", axis.name()), "", alarm(ours), alarm(theirs));
        compare(format!("{} inverted", axis.name()), "", pins(ours.inverted), pins(theirs.inverted));
    }
    for (ours, theirs) in ours.keep_outs.into_iter().zip(theirs.keep_outs) {
        compare("keep_out".to_owned(), "", keep_out(ours), keep_out(theirs));
    }
    for (ours, theirs) in settings(&ours.settings).into_iter().zip(settings(&theirs.settings)) {
        compare(ours.0.to_owned(), ours.1, ours.2, theirs.2);
    }
    lines
}

/// Names of pins.
fn pins(pins: Pins) -> String {
    let names: Vec<_> =
        Pin::ALL.into_iter().filter(|&pin| pins.contains(pin)).map(|pin| format!("{pin:?}")).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(" ") }
}

/// A keep-out in words.
fn keep_out(keep_out: Option<KeepOut>) -> String {
    keep_out.map_or("none".to_owned(), |k| {
        let part = |axis: Axis, [from, to]: [i32; 2]| format!("{} {from} to {to}", axis.name());
        format!("{} with {}", part(k.first, k.first_steps), part(k.second, k.second_steps))
    })
}

/// A row: what it is, its unit, and the number of an axis.
type Row = (&'static str, &'static str, fn(&AxisParameters) -> i64);

/// What the controller is told of each axis.
const ROWS: [Row; 19] = [
    ("min", "steps", |axis| axis.min_steps.into()),
    ("max", "steps", |axis| axis.max_steps.into()),
    ("max_speed", "steps/s", |axis| axis.max_speed.into()),
    ("acceleration", "steps/s²", |axis| axis.acceleration.into()),
    ("jerk", "steps/s³", |axis| axis.jerk.into()),
    ("full_turn", "steps", |axis| axis.full_turn_steps.into()),
    ("take_up", "steps", |axis| axis.take_up_steps.into()),
    ("settle", "ms", |axis| axis.settle_ms.into()),
    ("home_position", "steps", |axis| axis.home_position.into()),
    ("home_speed", "steps/s", |axis| axis.home_speed.into()),
    ("home_slow_speed", "steps/s", |axis| axis.home_slow_speed.into()),
    ("home_back_off", "steps", |axis| axis.home_back_off.into()),
    ("home_switch", "steps", |axis| axis.home_switch_steps.into()),
    ("home_order", "", |axis| axis.home_order.into()),
    ("home_travel", "steps", |axis| axis.home_travel.into()),
    ("home_debounce", "µs", |axis| axis.home_debounce_us.into()),
    ("index_tolerance", "steps", |axis| axis.index_tolerance.into()),
    ("alarm_debounce", "µs", |axis| axis.alarm_debounce_us.into()),
    ("most_turns", "turns", |axis| axis.most_turns.into()),
];

/// A driver's parameter: its name, its unit and its value.
type DriverRow = (&'static str, &'static str, fn(&DriverParameters) -> u32);

/// What the controller is told of drivers.
const DRIVER_ROWS: [DriverRow; 6] = [
    ("run", "mA", |driver| driver.run_ma.into()),
    ("hold", "mA", |driver| driver.hold_ma.into()),
    ("sense", "mOhm", |driver| driver.sense_mohm.into()),
    ("microsteps", "", |driver| driver.microsteps.into()),
    ("stall_threshold", "", |driver| driver.stall_threshold.into()),
    ("stall_above", "steps/s", |driver| driver.stall_above_speed),
];

/// The parameters as a table, an axis a column.
pub(super) fn table(config: &RigConfig) -> Result<String> {
    let configuration = config.configuration()?;
    let mut text = format!("{:<18}{:<10}", "parameter", "unit");
    for axis in Axis::ALL {
        text += &format!("{:>10}", axis.name());
    }
    for (name, unit, number) in ROWS {
        text += &format!("\n{name:<18}{unit:<10}");
        for axis in &configuration.axes {
            text += &format!("{:>10}", number(axis));
        }
    }
    if configuration.axes.iter().any(|axis| axis.driver.is_some()) {
        for (name, unit, number) in DRIVER_ROWS {
            text += &format!("\n{name:<18}{unit:<10}");
            for axis in &configuration.axes {
                let number = axis.driver.as_ref().map_or("-".to_owned(), |driver| number(driver).to_string());
                text += &format!("{number:>10}");
            }
        }
    }
    for axis in Axis::ALL {
        let p = &configuration.axes[axis.index()];
        text += &format!("\n{:<6}alarm {:?}, inverted {}", axis.name(), p.alarm, pins(p.inverted));
    }
    for k in configuration.keep_outs.into_iter().filter(Option::is_some) {
        text += &format!("\n{:<18}{:<10} {}", "keep_out", "steps", keep_out(k));
    }
    for (name, unit, value) in settings(&configuration.settings) {
        text += &format!("\n{name:<19}{unit:<9}{value:>10}");
    }
    Ok(text + "\n")
}

/// What the controller is told besides: name, unit and value.
fn settings(settings: &Settings) -> [(&'static str, &'static str, String); 12] {
    [
        ("lamp_warm_up", "s", settings.lamp_warm_up_s.to_string()),
        ("lamp_least_reading", "counts", settings.lamp_least_reading.to_string()),
        ("lease", "ms", settings.lease_ms.to_string()),
        ("lamp_lease", "ms", settings.lamp_lease_ms.to_string()),
        ("lamp_safe_level", "of 65535", settings.lamp_safe_level.to_string()),
        ("lamp_longest", "s", settings.lamp_longest_s.to_string()),
        ("fan_run_on", "s", settings.fan_run_on_s.to_string()),
        ("camera_wait", "ms", settings.camera_wait_ms.to_string()),
        ("coordinated", "", settings.coordinated.to_string()),
        ("pulse", "µs", settings.pulse_us.to_string()),
        ("direction_setup", "µs", settings.direction_setup_us.to_string()),
        ("inverted", "", pins(settings.inverted)),
    ]
}
