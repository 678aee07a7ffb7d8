//! The client against the real firmware on the simulated rig.
#![allow(clippy::unwrap_used)]

use lobelia_hil_sim::{FaultRates, FaultyLink, MechanicsConfig, SimulatedRig};
use lobelia_protocol::{Axis, Fault, schema};
use proptest::prelude::*;

use super::*;
use crate::rig::testing::Bent;
use lobelia_base::error::Kind;

fn connected(config: &MechanicsConfig) -> (SimulatedRig, RigClient) {
    let rig = SimulatedRig::new(config);
    let mut client = RigClient::connect(Box::new(rig.link())).unwrap();
    client.configure(&config.configuration()).unwrap();
    (rig, client)
}

fn homed() -> (SimulatedRig, RigClient) {
    let (rig, mut client) = connected(&MechanicsConfig::ideal());
    client.home().unwrap();
    (rig, client)
}

#[test]
fn homed_rig_moves_to_the_angles_asked_for() {
    let config = MechanicsConfig::ideal();
    let (rig, mut client) = homed();
    let degrees = [30.0, -12.5, 91.0, 77.0];
    let steps: [i32; 4] = std::array::from_fn(|axis| config.axes()[axis].steps(degrees[axis]));
    assert_eq!(client.move_to(steps).unwrap(), steps);
    for (axis, angle) in rig.angles_rad().into_iter().enumerate() {
        let half_step = config.axes()[axis].degrees_per_step / 2.0;
        assert!((angle.to_degrees() - degrees[axis]).abs() <= half_step * 1.001, "{axis}: {angle}");
    }
}

#[test]
fn controller_of_another_schema_is_bad_input_that_names_both_versions() {
    let rig = SimulatedRig::new(&MechanicsConfig::ideal());
    let other = Hello { schema: 7, version: 41, session: 1 };
    let error = RigClient::connect_with(Box::new(rig.link()), other).unwrap_err();
    assert_eq!(error.kind(), Kind::Input);
    let sentence = error.to_string();
    assert!(sentence.contains(&format!("{:016x}", schema::IDENTITY)), "{sentence}");
    assert!(Axis::ALL.into_iter().all(|axis| rig.steps_received(axis) == 0));
}

#[test]
fn exposure_needs_a_warm_lamp_and_reads_its_reference() {
    let (rig, mut client) = homed();
    assert!(client.expose(10_000, true).unwrap_err().to_string().contains("off"));
    client.lamp(true, 1.0).unwrap();
    assert!(client.expose(10_000, true).unwrap_err().to_string().contains("wait another 900 s"));
    client.wait_until_warm(|_| {}).unwrap();
    let exposure = client.expose(500_000, true).unwrap();
    let truth = rig.last_exposure().unwrap();
    assert_eq!((exposure.start_us, exposure.open_us), (truth.start_us, 500_000));
    let reference = f64::from(exposure.reference_q8) / 256.0 / 3000.0;
    assert!((reference / truth.lamp_relative - 1.0).abs() < 1e-3, "{reference} {truth:?}");
}

#[test]
fn dark_frame_needs_no_lamp() {
    let (rig, mut client) = homed();
    assert_eq!(client.expose(1000, false).unwrap().reference_q8, 0);
    assert_eq!(rig.last_exposure().unwrap().lamp_relative, 0.0);
}

#[test]
fn exposure_is_asked_for_once_and_nothing_is_sent_while_the_shutter_is_open() {
    let rig = SimulatedRig::new(&MechanicsConfig::ideal());
    let sent = Arc::new(Mutex::new((0, Vec::new())));
    let (counted, clock) = (Arc::clone(&sent), rig.clone());
    let count = move |packet: &mut ToController| {
        let (asked, times) = &mut *counted.lock().unwrap();
        if let ToController::Request(request) = packet {
            *asked += usize::from(matches!(request.command, Command::Expose { .. }));
            times.push(clock.now_us());
        }
    };
    let mut client = RigClient::connect(Box::new(Bent::new(rig.link(), count, |_| {}))).unwrap();
    client.configure(&MechanicsConfig::ideal().configuration()).unwrap();
    client.home().unwrap();
    // Longer than the lease of 2 s.
    let exposure = client.expose(5_000_000, false).unwrap();
    let open = exposure.start_us..exposure.start_us + 5_000_000;
    let (asked, times) = &*sent.lock().unwrap();
    assert_eq!(*asked, 1);
    assert!(times.iter().all(|time| !open.contains(time)));
}

#[test]
fn unplugged_link_is_a_failure_that_says_what_to_do() {
    let (rig, mut client) = homed();
    rig.unplug();
    let error = client.move_to([0, 0, 0, 20_000]).unwrap_err();
    assert_eq!(error.kind(), Kind::Failure);
    assert!(error.to_string().contains("plug it in"), "{error}");
}

#[test]
fn restarted_controller_is_noticed_and_not_moved() {
    let (rig, mut client) = homed();
    rig.reset_controller();
    let before = rig.steps_received(Axis::Pan);
    let error = client.move_to([100, 0, 0, 20_000]).unwrap_err();
    assert!(error.to_string().contains("restarted"), "{error}");
    assert_eq!(rig.steps_received(Axis::Pan), before);
}

#[test]
fn emergency_stop_is_told_and_needs_release_clearing_and_homing() {
    let (rig, mut client) = homed();
    rig.press_emergency_stop();
    let error = client.move_to([0, 0, 0, 20_000]).unwrap_err().to_string();
    assert!(error.contains("emergency stop was pressed"), "{error}");
    assert!(client.faults().iter().any(|report| report.fault == Fault::EmergencyStop));
    assert!(client.clear_faults().unwrap_err().to_string().contains("still pressed"));
    rig.release_emergency_stop();
    client.clear_faults().unwrap();
    assert!(client.move_to([0, 0, 0, 20_000]).unwrap_err().to_string().contains("home the rig"));
    client.home().unwrap();
    client.move_to([0, 0, 0, 20_000]).unwrap();
}

#[test]
fn fault_names_its_axis() {
    let (rig, mut client) = connected(&MechanicsConfig::ideal());
    rig.break_home_switch(Axis::Roll);
    let error = client.home().unwrap_err().to_string();
    assert!(error.contains("the roll axis did not find its home switch"), "{error}");
}

#[test]
fn interrupt_stops_the_rig_with_positions_known() {
    let (_rig, mut client) = homed();
    client.set_interrupt(|| true);
    let error = client.move_to([5000, 0, 0, 100_000]).unwrap_err().to_string();
    assert!(error.contains("interrupted"), "{error}");
    let status = client.status().unwrap();
    assert_eq!((status.known, status.busy), ([true; 4], false));
    assert!(status.positions[3] < 100_000);
}

/// Ctrl-C was pressed, and a frame is lost somewhere on the way to rest: of the stop, of a status, of the
/// lamp.
#[test]
fn interrupted_host_puts_the_lamp_out_whichever_frame_is_lost() {
    for after in (0..120).step_by(12) {
        let (rig, mut client) = homed();
        client.lamp(true, 1.0).unwrap();
        assert!(rig.lamp_level() > 0.9);
        client.set_interrupt(|| true);
        rig.lose_bytes(lobelia_hil_sim::Way::ToController, after, 14);
        client.rest().unwrap();
        assert_eq!(rig.lamp_level(), 0.0, "{after}");
    }
}

#[test]
fn the_fault_of_the_lease_is_forgiven_with_positions_kept_and_no_other_is() {
    /// Within the limits of every axis.
    const NEAR: [i32; 4] = [10, 10, 10, 50_000];
    let (rig, mut client) = homed();
    assert!(!client.forgive_lease().unwrap(), "nothing to forgive");
    client.lamp(true, 1.0).unwrap();
    rig.abandon_until_us(rig.now_us() + 10_000_000);
    assert!(matches!(client.move_to(NEAR), Err(error) if error.to_string().contains("heard nothing")));
    assert!(client.forgive_lease().unwrap());
    client.move_to(NEAR).unwrap();
    client.lamp(true, 1.0).unwrap();
    rig.abandon_until_us(rig.now_us() + 10_000_000);
    rig.press_emergency_stop();
    assert!(!client.forgive_lease().unwrap());
}

#[test]
fn waiting_and_moving_for_longer_than_the_lease_keep_it() {
    let config = MechanicsConfig::ideal();
    let rig = SimulatedRig::new(&config);
    let mut client = RigClient::connect(Box::new(rig.link())).unwrap();
    let mut leased = config.configuration();
    (leased.settings.lease_ms, leased.settings.lamp_lease_ms) = (2000, 2000);
    client.configure(&leased).unwrap();
    client.home().unwrap();
    client.lamp(true, 1.0).unwrap();
    client.wait_until_warm(|_| {}).unwrap();
    assert!(rig.now_us() > 900_000_000);
    // Eight seconds at 20°/s.
    client.move_to([0, 0, 0, 8000]).unwrap();
    client.move_to([0, 0, 0, 108_000]).unwrap();
    assert!(client.status().unwrap().faults.is_empty());
    // A host that dies leaves the lamp off.
    rig.abandon_until_us(rig.now_us() + 3_000_000);
    let status = client.status().unwrap();
    assert!(status.faults.contains(Fault::LeaseExpired) && !status.lamp.on);
    assert_eq!(status.known, [true; 4]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// On a line that loses, changes and doubles bytes, every move that is reported done was made exactly
    /// once.
    #[test]
    fn bad_line_never_causes_a_wrong_or_doubled_move(
        seed in any::<u64>(), targets in proptest::collection::vec(-3000..3000i32, 1..6),
    ) {
        let config = MechanicsConfig::ideal();
        let run = |rates: FaultRates| {
            let rig = SimulatedRig::new(&config);
            let mut client = RigClient::connect(Box::new(FaultyLink::new(rig.link(), rates, seed))).unwrap();
            client.configure(&config.configuration()).unwrap();
            client.home().unwrap();
            for &target in &targets {
                let steps = [target, -target, target / 2, 20_000 + target];
                prop_assert_eq!(client.move_to(steps).unwrap(), steps);
                client.expose(1000, false).unwrap();
            }
            Ok((Axis::ALL.map(|axis| rig.steps_received(axis)), rig.angles_rad(), rig.last_exposure()))
        };
        let clean = run(FaultRates { lost: 0.0, flipped: 0.0, doubled: 0.0, ..Default::default() })?;
        let bad = run(FaultRates { lost: 0.002, flipped: 0.002, doubled: 0.001, ..Default::default() })?;
        prop_assert_eq!(bad.0, clean.0);
        prop_assert_eq!(bad.1, clean.1);
        prop_assert_eq!(bad.2.map(|truth| truth.sequence), clean.2.map(|truth| truth.sequence));
    }
}

#[test]
fn rig_served_on_tcp_homes_and_moves() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let name = format!("tcp://{}", listener.local_addr().unwrap());
    let config = MechanicsConfig::ideal();
    let rig = SimulatedRig::new(&config);
    std::thread::spawn(move || lobelia_hil_sim::serve_tcp(&listener, &rig, 1000.0));
    let mut client = RigClient::connect(crate::rig::open_port(&name).unwrap()).unwrap();
    client.configure(&config.configuration()).unwrap();
    client.home().unwrap();
    assert_eq!(client.move_to([100, -100, 0, 20_000]).unwrap(), [100, -100, 0, 20_000]);
}

#[test]
fn simulated_axis_in_a_file_keeps_its_own_defaults() {
    let config: MechanicsConfig = toml::from_str("[light]\nrepeatability_deg = 0.0\n").unwrap();
    let mut expected = MechanicsConfig::default();
    expected.light.repeatability_deg = 0.0;
    assert_eq!(config, expected);
    assert!(toml::from_str::<MechanicsConfig>("[pan]\nrepeatabillity_deg = 0.0\n").is_err());
    assert!(toml::from_str::<MechanicsConfig>("[pan]\ndegrees_per_step = 0.0\n").is_err());
    let written = toml::to_string(&expected).unwrap();
    assert_eq!(toml::from_str::<MechanicsConfig>(&written).unwrap(), expected);
}

#[test]
fn parameters_are_read_back_and_a_controller_without_any_says_so() {
    let config = MechanicsConfig::ideal();
    let rig = SimulatedRig::new(&config);
    let mut client = RigClient::connect(Box::new(rig.link())).unwrap();
    assert_eq!(client.read_parameters().unwrap(), None);
    client.configure(&config.configuration()).unwrap();
    assert_eq!(client.read_parameters().unwrap(), Some(config.configuration()));
}

#[test]
fn telemetry_that_never_pauses_does_not_keep_a_lost_request_from_being_repeated() {
    let (rig, mut client) = connected(&MechanicsConfig::ideal());
    client.watch(Some(Duration::from_millis(20)), true).unwrap();
    // The next request is lost on its way.
    rig.lose_bytes(lobelia_hil_sim::Way::ToController, 0, 14);
    client.home().unwrap();
    assert_eq!(client.repetitions(), 1);
    let mut told = Vec::new();
    while let Some(event) = client.listen(Duration::ZERO).unwrap() {
        told.push(event);
    }
    assert!(told.iter().any(|event| matches!(event, Event::Log(_))), "{told:?}");
    assert!(told.iter().filter(|event| matches!(event, Event::Telemetry(_))).count() > 100);
}

/// Takes everything and says nothing, as a real port does to a host that is busy.
struct Deaf(Arc<Mutex<Vec<u8>>>);

impl std::io::Read for Deaf {
    fn read(&mut self, _: &mut [u8]) -> std::io::Result<usize> {
        Err(std::io::ErrorKind::TimedOut.into())
    }
}

impl std::io::Write for Deaf {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap().extend(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl Port for Deaf {
    fn set_read_timeout(&mut self, _: Duration) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn lease_is_kept_while_nobody_speaks_and_ends_with_the_client() {
    let heard = Arc::new(Mutex::new(Vec::new()));
    let wire = Arc::new(Mutex::new(Wire::new(Box::new(Deaf(Arc::clone(&heard))))));
    let keep_alive = KeepAlive::start(Arc::clone(&wire), 7, Duration::from_millis(2), Duration::MAX);
    let renewal = Request { session: 7, id: 0, seen: 0, command: Command::Status };
    let frame = ToController::Request(renewal).encode().unwrap();
    while heard.lock().unwrap().len() < 3 * frame.len() {
        std::thread::yield_now();
    }
    drop(keep_alive);
    let bytes = heard.lock().unwrap().clone();
    assert!(bytes.chunks(frame.len()).all(|one| one == frame.as_slice()));
    assert_eq!(Arc::strong_count(&wire), 1, "the thread has ended");
}

#[test]
fn lease_of_a_host_that_hangs_is_kept_no_longer_than_a_time_and_again_once_it_speaks() {
    let heard = Arc::new(Mutex::new(Vec::new()));
    let wire = Arc::new(Mutex::new(Wire::new(Box::new(Deaf(Arc::clone(&heard))))));
    let period = Duration::from_millis(2);
    let keep_alive = KeepAlive::start(Arc::clone(&wire), 7, period, 5 * period);
    let renewal = Request { session: 7, id: 0, seen: 0, command: Command::Status };
    let frame = ToController::Request(renewal).encode().unwrap().len();
    let frames = || heard.lock().unwrap().len() / frame;
    // The first time somebody may just have spoken.
    let silent_after = |frames_before: usize| {
        while frames() < frames_before + 4 {
            std::thread::yield_now();
        }
        std::thread::sleep(50 * period);
        let spoken = frames();
        assert!(spoken <= frames_before + 6, "{spoken}");
        std::thread::sleep(50 * period);
        assert_eq!(frames(), spoken);
        spoken
    };
    let spoken = silent_after(0);
    wire.lock().unwrap().send(&ToController::Request(renewal)).unwrap();
    silent_after(spoken + 1);
    drop(keep_alive);
}
