//! Measures how long it takes to simulate a session: 200 poses, each with moves of up to 90° on all axes.
//!
//! `cargo run --release -p lobelia-hil-sim --example session_speed`

use std::io::{ErrorKind, Read, Write};
use std::time::Instant;

use lobelia_hil_sim::{MechanicsConfig, SimulatedLink, SimulatedRig};
use lobelia_protocol::{
    Axis, Command, FrameDecoder, Hello, Outcome, Request, Response, ToController, ToHost,
};

const POSES: u32 = 200;

fn main() -> std::io::Result<()> {
    let config = MechanicsConfig::default();
    let rig = SimulatedRig::new(&config);
    let mut link = rig.link();
    let began = Instant::now();
    exchange(&mut link, &ToController::Hello(Hello::new(1)))?;
    // This host asks nothing while it waits for an answer.
    let mut configuration = config.configuration();
    (configuration.settings.lease_ms, configuration.settings.lamp_lease_ms) = (0, 0);
    let mut commands = configuration.commands().to_vec();
    commands.push(Command::Home);
    for pose in 0..POSES {
        // Golden-ratio sequences fill 90° on each axis.
        let turn = |axis: u32| (f64::from(pose) * 0.618_034 * f64::from(axis + 1)).fract() * 90.0;
        let degrees = [turn(0) - 45.0, turn(1) - 45.0, turn(2) - 45.0, turn(3) + 45.0];
        commands.push(Command::MoveTo(std::array::from_fn(|axis| config.axes()[axis].steps(degrees[axis]))));
        commands.push(Command::Expose { duration_us: 100_000, warm_lamp: false });
    }
    for (id, command) in (1..).zip(commands) {
        exchange(&mut link, &ToController::Request(Request { session: 1, id, seen: id - 1, command }))?;
    }
    let steps: u64 = Axis::ALL.iter().map(|&axis| rig.steps_received(axis)).sum();
    let took = began.elapsed().as_secs_f64();
    println!(
        "{POSES} poses, {steps} steps, {:.0} s of virtual time: {took:.2} s, {:.0} ns a step",
        rig.now_us() as f64 * 1e-6,
        took / steps as f64 * 1e9
    );
    Ok(())
}

/// Sends a packet and waits for what answers it.
fn exchange(link: &mut SimulatedLink, packet: &ToController) -> std::io::Result<ToHost> {
    let frame = packet.encode().map_err(|error| std::io::Error::other(format!("{error:?}")))?;
    link.write_all(&frame)?;
    let mut decoder = FrameDecoder::new();
    loop {
        let mut buffer = [0; 256];
        let count = match link.read(&mut buffer) {
            Err(error) if error.kind() == ErrorKind::TimedOut => continue,
            other => other?,
        };
        for &byte in &buffer[..count] {
            let Some(Ok(payload)) = decoder.push(byte) else { continue };
            let packet =
                ToHost::decode(payload).map_err(|error| std::io::Error::other(format!("{error:?}")))?;
            if !matches!(packet, ToHost::Response(Response { outcome: Outcome::Running, .. })) {
                return Ok(packet);
            }
        }
    }
}
