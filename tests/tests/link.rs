//! Rigs that misbehave on a real port: another version, a bad line, a cable pulled out.

#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::fs;
use std::path::Path;
use std::process::Stdio;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use lobelia::acquire::simulated;
use lobelia::develop;
use lobelia::plan::Plan;
use lobelia::rig::RigClient;
use lobelia::rig::config::{AXIS_NAMES, RigConfig};
use lobelia_hil_sim::optics::frame::{FrameNotes, write_tiff};
use lobelia_hil_sim::{ExposureTruth, FaultRates, SimulatedRig};
use lobelia_protocol::{Axis, Fault};
use lobelia_tests::command::{Said, lobelia, run};
use lobelia_tests::tcp::{self, ServedRig};
use lobelia_tests::{folder, small};

/// A folder with inputs and an empty `photos`. The rig's axes go exactly where they are sent, so that a move
/// can be told from another; its lamp is warm after seconds.
fn inputs(poses: usize) -> (tempfile::TempDir, RigConfig, Plan) {
    let folder = tempfile::tempdir().unwrap();
    let mut rig = small::rig(8);
    rig.simulator.repeatability = false;
    rig.lamp.warm_up_s = 20.0;
    rig.exposure.dark_frames = 1;
    rig.exposure.count = 1;
    let plan = small::plan(&rig, poses);
    small::write_inputs(folder.path(), &rig, &plan);
    fs::create_dir(folder.path().join("photos")).unwrap();
    (folder, rig, plan)
}

fn acquire(folder: &Path, port: &str, more: &[&str]) -> Said {
    let arguments = ["acquire", "-o", "run", "--camera", "watch:photos", "--port", port];
    run(folder, &[&arguments, more].concat())
}

const NEW_RUN: [&str; 3] = ["plan.toml", "--rig", "rig.toml"];

/// Asserts that photographs, after the two dark frames, were taken of the plan's poses in order, each once.
fn assert_planned(exposures: &[ExposureTruth], rig: &RigConfig, plan: &Plan) {
    let truths = exposures.get(2..).unwrap_or(&[]);
    assert!(truths.len() <= plan.poses.len(), "more photographs than poses");
    for (index, (truth, pose)) in truths.iter().zip(&plan.poses).enumerate() {
        for (axis, wanted) in pose.degrees().into_iter().enumerate() {
            let off = truth.axes_rad[axis].to_degrees() - wanted;
            // Half a step of rounding, and the home switch's edge within another step.
            let step = rig.axes.in_order()[axis].degrees_per_step;
            assert!(off.abs() <= 2.0 * step, "pose {index}: {} is off by {off}°", AXIS_NAMES[axis]);
        }
    }
}

#[test]
fn a_controller_of_another_schema_is_refused_before_anything_is_asked_of_it() {
    let (folder, _, _) = inputs(2);
    let (address, requests) = tcp::other_version();
    let before = folder::listing(folder.path());
    acquire(folder.path(), &tcp::port(address), &NEW_RUN)
        .refuses(2, &["version 99", "schema", "nothing was moved"]);
    assert_eq!(requests.load(Ordering::Relaxed), 0, "something was asked of it");
    assert_eq!(folder::listing(folder.path()), before, "a run was begun");
}

#[test]
fn a_run_over_tcp_photographs_every_pose_of_the_plan_once() {
    let (folder, rig, plan) = inputs(5);
    let served = ServedRig::start(&rig, &folder.path().join("photos"));
    let said = acquire(folder.path(), &tcp::port(served.address), &NEW_RUN);
    assert_eq!(said.code, Some(0), "{said:?}");
    let exposures = served.exposures();
    assert_eq!(exposures.len(), 2 + plan.poses.len());
    assert_planned(&exposures, &rig, &plan);
}

/// What cameras did to others: a shot whose photograph never comes, one that is black, one that comes with
/// the next, the previous one again instead of a new one, a JPEG beside each.
#[test]
fn a_run_with_a_camera_that_loses_delays_and_repeats_photographs_ends_with_the_right_ones() {
    let (folder, rig, plan) = inputs(5);
    let mut held = None;
    let mut last = Vec::new();
    let camera = move |shot: u64, photograph: Vec<u8>| {
        let mut files = vec![(format!("shot-{shot:04}.jpg"), b"\xff\xd8\xff\xe0\x00\x10JFIF".to_vec())];
        let mut store = |name: &str, bytes: Vec<u8>| files.push((format!("{name}-{shot:04}.tiff"), bytes));
        match shot {
            3 => {}
            5 => held = Some(photograph),
            6 => {
                store("late", held.take().unwrap());
                store("shot", photograph);
            }
            8 => store("again", last.clone()),
            _ => {
                last = photograph.clone();
                store("shot", photograph);
            }
        }
        files
    };
    let served = ServedRig::start_with(&rig, &folder.path().join("photos"), camera);
    let timeout = ["--camera-timeout-s", "3"];
    let said = acquire(folder.path(), &tcp::port(served.address), &[&NEW_RUN[..], &timeout].concat());
    assert_eq!(said.code, Some(0), "{said:?}");
    assert_eq!(served.exposures().len(), 2 + plan.poses.len() + 3, "{said:?}");
    let developed = develop::run(&folder.path().join("run")).unwrap();
    assert!(developed.registrations.iter().all(Result::is_ok), "{:?}", developed.registrations);
    let aside = fs::read_to_string(folder.path().join("run/aside/reasons.txt")).unwrap();
    assert!(aside.contains("again-0008.tiff: it is a photograph that was delivered before"), "{aside}");
    for part in ["try 1 of 3", "no photograph arrived within 3 s", "again-0008.tiff is put aside"] {
        assert!(said.stderr.contains(part), "{part}: {}", said.stderr);
    }
}

#[test]
fn a_camera_that_never_stores_a_right_photograph_ends_the_run_with_the_reason() {
    let (folder, rig, _) = inputs(2);
    let small_frames = |shot: u64, _: Vec<u8>| {
        let notes = FrameNotes { exposure_s: 0.1, f_number: 16.0, taken_s: shot };
        let mut file = std::io::Cursor::new(Vec::new());
        write_tiff(&mut file, 8, 6, &[shot as u16; 48], &notes).unwrap();
        vec![(format!("{shot}.tiff"), file.into_inner())]
    };
    let served = ServedRig::start_with(&rig, &folder.path().join("photos"), small_frames);
    let more = [&NEW_RUN[..], &["--camera-timeout-s", "1", "--quiet"]].concat();
    acquire(folder.path(), &tcp::port(served.address), &more)
        .refuses(1, &["dark-00.tiff", "3 tries", "8 × 6 pixels, rig.toml says 400 × 300"]);
    assert_eq!(served.exposures().len(), 3);
}

#[test]
fn a_line_that_spoils_bytes_costs_time_and_never_makes_a_wrong_move() {
    let (folder, rig, plan) = inputs(5);
    let served = ServedRig::start(&rig, &folder.path().join("photos"));
    let rates = FaultRates { lost: 1e-3, flipped: 2e-3, doubled: 1e-3, ..Default::default() };
    let line = tcp::bad_line(served.address, rates, 3);
    let said = acquire(folder.path(), &tcp::port(line), &NEW_RUN);
    assert_eq!(said.code, Some(0), "{said:?}");
    let exposures = served.exposures();
    assert_eq!(exposures.len(), 2 + plan.poses.len(), "a repeated request was run twice");
    assert_planned(&exposures, &rig, &plan);
}

#[test]
fn a_line_on_which_nothing_gets_through_is_a_failure_and_nothing_moves() {
    let (folder, rig, _) = inputs(2);
    let served = ServedRig::start(&rig, &folder.path().join("photos"));
    let rates = FaultRates { lost: 0.2, flipped: 0.4, doubled: 0.2, ..Default::default() };
    let line = tcp::bad_line(served.address, rates, 5);
    let before = folder::listing(folder.path());
    acquire(folder.path(), &tcp::port(line), &NEW_RUN).refuses(1, &["does not answer", "--resume"]);
    assert_eq!(folder::listing(folder.path()), before, "a run was begun");
    assert!(Axis::ALL.iter().all(|&axis| served.rig.steps_received(axis) == 0), "an axis was moved");
}

#[test]
fn a_cable_pulled_out_is_a_failure_that_a_resumed_run_makes_good() {
    let (folder, rig, plan) = inputs(5);
    let served = ServedRig::start(&rig, &folder.path().join("photos"));
    // Two dark frames and two poses.
    let line = tcp::port(tcp::breaking_line(served.address, served.has_exposed(4)));
    acquire(folder.path(), &line, &NEW_RUN).refuses(1, &["link", "was lost", "plug it in", "--resume"]);
    let photographed = served.exposures().len();
    let all = 2 + plan.poses.len();
    assert!((4..all).contains(&photographed), "{photographed} photographs before the cable came out");
    let said = acquire(folder.path(), &line, &["--resume"]);
    assert_eq!(said.code, Some(0), "{said:?}");
    let frames = folder::listing(&folder.path().join("run/frames"));
    assert_eq!(frames.len(), all, "{frames:?}");
}

/// The host is gone for longer than the lease: the controller stops, dims the lamp and keeps the fault until
/// someone clears it.
#[test]
fn a_run_whose_host_died_can_be_resumed_after_the_lease_and_says_what_it_cleared() {
    let (folder, rig, plan) = inputs(4);
    let served = ServedRig::start(&rig, &folder.path().join("photos"));
    let line = tcp::port(tcp::breaking_line(served.address, served.has_exposed(4)));
    acquire(folder.path(), &line, &NEW_RUN).refuses(1, &["--resume"]);
    served.wait_until_alone();
    served.rig.abandon_until_us(served.rig.now_us() + 10_000_000);
    let said = acquire(folder.path(), &line, &["--resume"]);
    assert_eq!(said.code, Some(0), "{said:?}");
    assert!(said.stderr.contains("lease") && said.stderr.contains("cleared"), "{said:?}");
    let developed = develop::run(&folder.path().join("run")).unwrap();
    assert_eq!(developed.registrations.iter().filter(|found| found.is_ok()).count(), plan.poses.len());
}

/// The lease of the rigs whose hosts are killed, and the lamp's safe level.
const LEASE_S: f64 = 2.0;
const SAFE_LEVEL: f64 = 0.25;
/// An axis at its highest speed is at rest after this: 60°/s at 120°/s² and 1200°/s³.
const BRAKING_US: u64 = 700_000;

/// Starts a run on a new rig and kills it after a time, if it has not ended; gives the rig, and how long the
/// process lived.
fn killed_after(time: Duration) -> (SimulatedRig, Duration) {
    let (folder, mut rig, plan) = inputs(3);
    (rig.motion.lease_s, rig.lamp.lease_s, rig.lamp.safe_level) = (LEASE_S, LEASE_S, SAFE_LEVEL);
    small::write_inputs(folder.path(), &rig, &plan);
    let served = ServedRig::start(&rig, &folder.path().join("photos"));
    let port = tcp::port(served.address);
    let arguments = ["acquire", "-o", "run", "--camera", "watch:photos", "--port", &port];
    let start = Instant::now();
    let mut host = lobelia(folder.path(), &[&arguments[..], &NEW_RUN].concat());
    let mut host = host.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    while start.elapsed() < time && host.try_wait().unwrap().is_none() {
        std::thread::sleep(Duration::from_millis(1));
    }
    host.kill().unwrap();
    host.wait().unwrap();
    let lived = start.elapsed();
    served.wait_until_alone();
    (served.rig, lived)
}

fn steps(rig: &SimulatedRig) -> [u64; 4] {
    Axis::ALL.map(|axis| rig.steps_received(axis))
}

/// A rig whose host has just died is safe once the lease is over, and at rest once it has braked. True if
/// there was anything to make safe by then.
fn assert_safe_within_the_lease(rig: &SimulatedRig) -> bool {
    let end_us = rig.now_us() + (LEASE_S * 1e6) as u64;
    rig.abandon_until_us(end_us - 20_000);
    let before = steps(rig);
    rig.abandon_until_us(end_us - 1);
    let endangered = rig.lamp_level() > SAFE_LEVEL || steps(rig) != before;
    rig.abandon_until_us(end_us + 1);
    assert!(rig.lamp_level() <= SAFE_LEVEL + 1e-4, "the lamp burns at {}", rig.lamp_level());
    assert!(!rig.shutter_open(), "the shutter is open");
    rig.abandon_until_us(end_us + BRAKING_US);
    let rest = steps(rig);
    rig.abandon_until_us(end_us + 60_000_000);
    assert_eq!(steps(rig), rest, "an axis still moved");
    let mut client = RigClient::connect(simulated::port(rig)).unwrap();
    let faults = client.status().unwrap().faults;
    assert!(!endangered || faults.contains(Fault::LeaseExpired), "no fault is latched");
    endangered
}

fn kill_hosts(kills: u32) {
    let (rig, whole) = killed_after(Duration::from_secs(60));
    assert_safe_within_the_lease(&rig);
    let mut endangered = 0;
    for kill in 0..kills {
        // The golden ratio spreads the instants over the run; where in a move they fall is chance.
        let part = (f64::from(kill) * 0.618_034 + 0.3).fract();
        let (rig, _) = killed_after(whole.mul_f64(part));
        endangered += u32::from(assert_safe_within_the_lease(&rig));
    }
    println!("{kills} kills over {whole:?}: {endangered} times the lease made the rig safe");
    assert!(2 * endangered > kills, "too few kills in mid-run to show anything: {endangered}");
}

#[test]
fn a_host_killed_in_mid_run_leaves_the_rig_safe_within_the_lease() {
    kill_hosts(4);
}

#[test]
#[ignore = "long: minutes: cargo xtask long"]
fn a_hundred_hosts_killed_at_random_instants_leave_the_rig_safe_within_the_lease() {
    kill_hosts(100);
}
