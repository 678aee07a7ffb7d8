//! Measures what a session of 100 poses costs on bad lines, on the simulated rig's clock, and writes the
//! tables of `docs/link.md`.
//!
//! `cargo xtask link-table`, or `cargo run --release -p lobelia --example link_table [FILE.md]`; without a
//! file it prints them.

use std::fmt::Write;
use std::path::PathBuf;

use lobelia::Result;
use lobelia::acquire::simulated;
use lobelia::rig::RigClient;
use lobelia_hil_sim::{FaultRates, LineConfig, MechanicsConfig, SimulatedRig};
use lobelia_protocol::Axis;

const POSES: usize = 100;
const BAUDS: [u32; 3] = [9600, 115_200, 2_000_000];
/// Shares of the frames that lose a byte.
const FRAMES: [f64; 6] = [0.0, 0.01, 0.03, 0.1, 0.2, 0.3];
/// Shares of the bytes that are lost.
const BYTES: [f64; 6] = [0.001, 0.003, 0.01, 0.02, 0.03, 0.1];
const BEGIN: &str = "<!-- written by `cargo xtask link-table` -->\n";
const END: &str = "<!-- end -->";

/// What came of a session.
struct Session {
    /// Poses photographed where they should be, by the rig's truth.
    poses: usize,
    /// Photographs that nobody asked for, or in another pose.
    wrong: usize,
    repetitions: u64,
    /// Frames that the line carried, and those that it disturbed.
    frames: u64,
    disturbed: u64,
    seconds: f64,
}

fn session(baud: u32, faults: FaultRates, seed: u64) -> Session {
    let mut config = MechanicsConfig::ideal();
    config.lamp.warm_up_s = 30;
    let rig = SimulatedRig::new(&config);
    rig.set_line(&LineConfig { baud: Some(baud), faults, seed });
    let mut client = None;
    let mut done = 0;
    let broken_off = drive(&rig, &config, &mut client, &mut done).err();
    if let Some(error) = broken_off {
        eprintln!("{baud} baud, {faults:?}: {error}");
    }
    let truths = rig.take_exposures();
    let right = |(pose, truth): (usize, &lobelia_hil_sim::ExposureTruth)| {
        let wanted = steps(&config, pose);
        config.axes().iter().zip(truth.axes_rad).zip(wanted).all(|((axis, angle), steps)| {
            (angle.to_degrees() / axis.degrees_per_step - f64::from(steps)).abs() < 1.5
        })
    };
    let poses = truths.iter().enumerate().filter(|&(pose, truth)| right((pose, truth))).count();
    let counts = rig.line_counts();
    Session {
        poses: poses.min(done),
        wrong: truths.len() - poses,
        repetitions: client.map_or(0, |client| client.repetitions()),
        frames: counts.frames,
        disturbed: counts.disturbed,
        seconds: rig.now_us() as f64 * 1e-6,
    }
}

/// Golden-ratio sequences fill 90° on each axis.
fn steps(config: &MechanicsConfig, pose: usize) -> [i32; 4] {
    std::array::from_fn(|k| {
        let turn = (pose as f64 * 0.618_034 * (k + 1) as f64).fract() * 90.0;
        config.axes()[k].steps(turn + if k == Axis::Light.index() { 45.0 } else { -45.0 })
    })
}

fn drive(
    rig: &SimulatedRig,
    config: &MechanicsConfig,
    client: &mut Option<RigClient>,
    done: &mut usize,
) -> Result<()> {
    let client = client.insert(RigClient::connect(simulated::port(rig))?);
    client.configure(&config.configuration())?;
    client.home()?;
    client.lamp(true, 1.0)?;
    client.wait_until_warm(|_| {})?;
    for pose in 0..POSES {
        client.move_to(steps(config, pose))?;
        client.expose(100_000, true)?;
        *done += 1;
    }
    client.lamp(false, 0.0)
}

/// A row of a table: the sessions of each speed.
fn row(text: &mut String, name: &str, faults: FaultRates, seed: u64) {
    let _ = write!(text, "| {name} |");
    for baud in BAUDS {
        let session = session(baud, faults, seed);
        assert_eq!(session.wrong, 0, "a photograph in a wrong pose");
        let hit = 100.0 * session.disturbed as f64 / session.frames.max(1) as f64;
        if session.frames == 0 {
            let _ = write!(text, " none: {}, {:.0} s |", session.repetitions, session.seconds);
        } else if session.poses == POSES {
            let _ = write!(
                text,
                " {hit:.1} % of {}: {}, {:.0} s |",
                session.frames, session.repetitions, session.seconds
            );
        } else {
            let _ = write!(text, " {hit:.1} %: **broken off after {}** |", session.poses);
        }
        eprint!(".");
    }
    text.push('\n');
}

fn tables() -> String {
    let mut text = String::new();
    let mut table = |title: &str, rates: &[f64], faults: fn(f64) -> FaultRates| {
        let _ = write!(text, "\n| {title} |");
        text += &BAUDS.map(|baud| format!(" {baud} baud |")).concat();
        text.push_str("\n|---|---|---|---|\n");
        for (seed, &rate) in (1..).zip(rates) {
            row(&mut text, &format!("{} %", (rate * 1000.0).round() / 10.0), faults(rate), seed);
        }
    };
    table("frames that lose a byte", &FRAMES, |frames| FaultRates { frames, ..FaultRates::default() });
    table("bytes lost", &BYTES, |lost| FaultRates { lost, ..FaultRates::default() });
    eprintln!();
    text
}

fn main() -> std::io::Result<()> {
    let Some(path) = std::env::args_os().nth(1).map(PathBuf::from) else {
        print!("{}", tables());
        return Ok(());
    };
    let document = std::fs::read_to_string(&path)?;
    let split = document.split_once(BEGIN).and_then(|(head, rest)| Some((head, rest.split_once(END)?.1)));
    let Some((head, tail)) = split else {
        return Err(std::io::Error::other(format!("{} has no place for the tables", path.display())));
    };
    std::fs::write(&path, format!("{head}{BEGIN}{}\n{END}{tail}", tables()))
}
