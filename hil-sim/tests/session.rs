//! The simulated rig's promises: truth depends on what was commanded and when, and on nothing else.
#![allow(clippy::unwrap_used)]

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::Duration;

use lobelia_hil_sim::{ExposureTruth, MechanicsConfig, SimulatedLink, SimulatedRig, Wiring, serve_tcp};
use lobelia_protocol::{
    AXES, Alarm, Answer, Axis, Command, Configuration, DriverParameters, DriverTrouble, Fault, FrameDecoder,
    Hello, Outcome, Pin, Pins, Refusal, Request, ToController, ToHost,
};
use proptest::prelude::*;

/// A host without retries.
struct Host {
    link: SimulatedLink,
    decoder: FrameDecoder,
    next_id: u32,
}

impl Host {
    fn ask(&mut self, command: Command) -> Outcome {
        let id = self.next_id;
        self.next_id += 1;
        self.send(&ToController::Request(Request { session: 1, id, seen: id - 1, command }));
        loop {
            if let ToHost::Response(response) = self.receive()
                && response.id == id
                && response.outcome != Outcome::Running
            {
                return response.outcome;
            }
        }
    }

    /// Sets a configuration and gives the outcome of the last of its requests.
    fn configure(&mut self, configuration: &Configuration) -> Outcome {
        configuration.commands().map(|command| self.ask(command))[AXES + 1]
    }

    fn send(&mut self, packet: &ToController) {
        self.link.write_all(&packet.encode().unwrap()).unwrap();
    }

    fn receive(&mut self) -> ToHost {
        loop {
            let mut byte = [0];
            match self.link.read(&mut byte) {
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::TimedOut => continue,
                Err(error) => panic!("{error}"),
            }
            if let Some(Ok(payload)) = self.decoder.push(byte[0]) {
                return ToHost::decode(payload).unwrap();
            }
        }
    }
}

/// The rig's configuration without leases: this host asks nothing while it waits for an answer.
fn configuration(config: &MechanicsConfig) -> Configuration {
    let mut configuration = config.configuration();
    (configuration.settings.lease_ms, configuration.settings.lamp_lease_ms) = (0, 0);
    configuration
}

fn start(config: &MechanicsConfig) -> (SimulatedRig, Host) {
    let rig = SimulatedRig::new(config);
    let mut host = Host { link: rig.link(), decoder: FrameDecoder::new(), next_id: 1 };
    host.send(&ToController::Hello(Hello::new(1)));
    host.receive();
    let configuration = configuration(config);
    let rest = [Command::Home, Command::Lamp { on: true, level: 65535 }];
    for command in configuration.commands().into_iter().chain(rest) {
        assert!(matches!(host.ask(command), Outcome::Done(_)));
    }
    (rig, host)
}

fn expose(rig: &SimulatedRig, host: &mut Host, steps: [i32; 4], at_us: u64) -> ExposureTruth {
    assert_eq!(host.ask(Command::MoveTo(steps)), Outcome::Done(Answer::At(steps)));
    rig.idle_until_us(at_us);
    assert!(matches!(host.ask(Command::Expose { duration_us: 20_000, warm_lamp: true }), Outcome::Done(_)));
    rig.last_exposure().unwrap()
}

fn poses() -> impl Strategy<Value = Vec<[i32; 4]>> {
    let pose = (-6900..6900i32, -6900..6900i32, -6900..6900i32, 10_000..90_000i32);
    proptest::collection::vec(pose.prop_map(|(pan, tilt, roll, light)| [pan, tilt, roll, light]), 1..6)
}

const S: u64 = 1_000_000;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn same_commands_give_the_same_truth(poses in poses()) {
        let run = || {
            let (rig, mut host) = start(&MechanicsConfig::default());
            rig.idle_until_us(2000 * S);
            let truths: Vec<_> = poses.iter().map(|&pose| expose(&rig, &mut host, pose, 0)).collect();
            (truths, rig.now_us())
        };
        prop_assert_eq!(run(), run());
    }

    #[test]
    fn truth_does_not_depend_on_the_poses_before(poses in poses()) {
        let last = *poses.last().unwrap();
        let (rig, mut host) = start(&MechanicsConfig::default());
        rig.idle_until_us(2000 * S);
        for &pose in &poses[..poses.len() - 1] {
            expose(&rig, &mut host, pose, 0);
        }
        let whole = expose(&rig, &mut host, last, 3000 * S);
        // Killed and started again: homed, then on with the last pose at the same time.
        let (rig, mut host) = start(&MechanicsConfig::default());
        rig.idle_until_us(2000 * S);
        let resumed = expose(&rig, &mut host, last, 3000 * S);
        prop_assert_eq!(ExposureTruth { sequence: 0, ..whole }, ExposureTruth { sequence: 0, ..resumed });
    }

    #[test]
    fn angles_are_off_by_no_more_than_repeatability(poses in poses()) {
        let config = MechanicsConfig::default();
        let (rig, mut host) = start(&config);
        rig.idle_until_us(2000 * S);
        for pose in poses {
            let truth = expose(&rig, &mut host, pose, 0);
            for (axis, mechanics) in config.axes().into_iter().enumerate() {
                let off = truth.axes_rad[axis].to_degrees()
                    - f64::from(pose[axis]) * mechanics.degrees_per_step;
                prop_assert!(off.abs() <= mechanics.repeatability_deg + 1e-9, "axis {}: {} deg", axis, off);
            }
        }
    }
}

#[test]
fn backlash_shows_when_the_take_up_is_shorter() {
    let mut config = MechanicsConfig::ideal();
    config.pan.backlash_deg = 0.5;
    let mut configuration = config.configuration();
    configuration.axes[0].take_up_steps = 0;
    (configuration.settings.lease_ms, configuration.settings.lamp_lease_ms) = (0, 0);
    let (rig, mut host) = start(&config);
    for command in configuration.commands() {
        host.ask(command);
    }
    host.ask(Command::Home);
    let pan_deg = |host: &mut Host, steps| {
        host.ask(Command::MoveTo([steps, 0, 0, 20_000]));
        rig.angles_rad()[0].to_degrees()
    };
    let upward = pan_deg(&mut host, 0);
    pan_deg(&mut host, 1000);
    let downward = pan_deg(&mut host, 0);
    assert!((downward - upward - 0.5).abs() < 1e-3, "{upward} {downward}");
}

#[test]
fn truth_of_the_lamp_includes_its_warming_up() {
    let config = MechanicsConfig::ideal();
    let (rig, mut host) = start(&config);
    let cold = Command::Expose { duration_us: 20_000, warm_lamp: false };
    host.ask(cold);
    assert!(rig.last_exposure().unwrap().lamp_relative < 0.5);
    let warm = expose(&rig, &mut host, [0, 0, 0, 20_000], 2000 * S);
    assert!((warm.lamp_relative - 1.0).abs() < 1e-3);
}

#[test]
fn waiting_for_nothing_takes_just_the_timeout() {
    let rig = SimulatedRig::new(&MechanicsConfig::ideal());
    let mut link = rig.link();
    link.set_timeout(Duration::from_millis(70));
    assert_eq!(link.read(&mut [0; 8]).unwrap_err().kind(), ErrorKind::TimedOut);
    assert_eq!(rig.now_us(), 70_000);
}

#[test]
fn controller_that_was_reset_knows_no_session() {
    let (rig, mut host) = start(&MechanicsConfig::ideal());
    rig.reset_controller();
    assert_eq!(host.ask(Command::Home), Outcome::Refused(Refusal::NoSession));
}

#[test]
fn host_on_tcp_is_greeted() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let rig = SimulatedRig::new(&MechanicsConfig::ideal());
    std::thread::spawn(move || serve_tcp(&listener, &rig, 1000.0));
    let mut stream = TcpStream::connect(address).unwrap();
    stream.write_all(&ToController::Hello(Hello::new(4)).encode().unwrap()).unwrap();
    let mut decoder = FrameDecoder::new();
    loop {
        let mut byte = [0];
        stream.read_exact(&mut byte).unwrap();
        if let Some(Ok(payload)) = decoder.push(byte[0]) {
            assert_eq!(ToHost::decode(payload), Ok(ToHost::Hello(Hello::new(4).reply())));
            break;
        }
    }
}

/// The default rig with a TMC2209 for pan that looks for stalls.
fn with_driver(config: &MechanicsConfig) -> Configuration {
    let mut configuration = configuration(config);
    configuration.axes[0].driver = Some(DriverParameters {
        run_ma: 884,
        hold_ma: 442,
        sense_mohm: 110,
        microsteps: 16,
        stall_threshold: 60,
        stall_above_speed: 100,
    });
    configuration.axes[0].alarm = Alarm::Edge;
    configuration
}

#[test]
fn drivers_registers_are_set_over_the_wire_and_again_before_homing() {
    let config = MechanicsConfig::ideal();
    let (rig, mut host) = start(&config);
    assert_eq!(rig.driver_register(Axis::Pan, 0x40), 0, "no driver is set up unless asked for");
    assert_eq!(host.configure(&with_driver(&config)), Outcome::Done(Answer::Nothing));
    // Half of 1.77 A and a quarter; 16 microsteps, interpolated; the threshold.
    let registers = |axis| [0x10, 0x6C, 0x40].map(|register| rig.driver_register(axis, register));
    assert_eq!(registers(Axis::Pan), [7 | 15 << 8 | 8 << 16, 0x1400_0053, 60]);
    assert_eq!(registers(Axis::Tilt), [0; 3], "another address");
    let writes = rig.driver_register(Axis::Pan, 2);
    assert!(matches!(host.ask(Command::Home), Outcome::Done(Answer::At(_))));
    assert_eq!(rig.driver_register(Axis::Pan, 2), 2 * writes);

    rig.cut_driver_wire();
    let silent = Outcome::Refused(Refusal::Driver { axis: Axis::Pan, trouble: DriverTrouble::Silent });
    assert_eq!(host.ask(Command::Home), silent);
    assert_eq!(host.configure(&with_driver(&config)), silent);
}

#[test]
fn motor_that_is_blocked_is_a_stall_only_to_a_driver_that_looks_for_it() {
    let config = MechanicsConfig::ideal();
    for (configuration, fault) in
        [(configuration(&config), Fault::HomingFailed), (with_driver(&config), Fault::Stall)]
    {
        let (rig, mut host) = start(&config);
        assert_eq!(host.configure(&configuration), Outcome::Done(Answer::Nothing));
        // Without its switch homing runs into the stop.
        rig.break_home_switch(Axis::Pan);
        let Outcome::Refused(Refusal::Faulted(faults)) = host.ask(Command::Home) else {
            panic!("not refused")
        };
        assert_eq!(faults.iter().collect::<Vec<_>>(), [fault]);
    }
}

#[test]
fn broken_wire_of_a_home_switch_is_named_and_an_axis_at_its_stop_is_none() {
    let mut config = MechanicsConfig::ideal();
    // Switched on with every axis at its lower stop.
    for axis in [&mut config.pan, &mut config.tilt, &mut config.roll, &mut config.light] {
        axis.start_deg = axis.stops_deg[0];
    }
    let (rig, mut host) = start(&config);
    rig.set_home_switch_wire(Axis::Roll, true);
    let before = rig.motor_steps(Axis::Roll);
    let outcome = host.ask(Command::Home);
    assert!(
        matches!(outcome, Outcome::Refused(Refusal::Faulted(faults)) if faults.contains(Fault::SwitchStuck)),
        "{outcome:?}"
    );
    // 8° of the switch and 1° of the back-off, in steps of 0.0129°.
    assert!(rig.motor_steps(Axis::Roll) - before <= 700);
}

#[test]
fn saved_parameters_are_there_after_a_reset_and_moves_go_on_as_before() {
    let config = MechanicsConfig::ideal();
    let (rig, mut host) = start(&config);
    host.ask(Command::Lamp { on: false, level: 0 });
    assert!(matches!(host.ask(Command::SaveParameters), Outcome::Done(_)));
    rig.reset_controller();
    host.send(&ToController::Hello(Hello::new(1)));
    host.receive();
    host.next_id = 1;
    assert!(matches!(host.ask(Command::Home), Outcome::Done(_)));
    let to = [100, 100, 100, 10_000];
    assert_eq!(host.ask(Command::MoveTo(to)), Outcome::Done(Answer::At(to)));
}

#[test]
fn driver_that_was_reset_on_the_way_is_a_fault_at_the_end_of_the_move_and_no_wrong_position() {
    let config = MechanicsConfig::ideal();
    let (rig, mut host) = start(&config);
    assert_eq!(host.configure(&with_driver(&config)), Outcome::Done(Answer::Nothing));
    assert!(matches!(host.ask(Command::Home), Outcome::Done(_)));
    let to = [100, 100, 100, 10_000];
    assert_eq!(host.ask(Command::MoveTo(to)), Outcome::Done(Answer::At(to)));
    rig.reset_driver(Axis::Pan);
    let Outcome::Refused(Refusal::Faulted(faults)) = host.ask(Command::MoveTo([200, 100, 100, 10_000]))
    else {
        panic!("not refused")
    };
    assert_eq!(faults.iter().collect::<Vec<_>>(), [Fault::DriverLost]);
    host.ask(Command::ClearFaults);
    assert!(matches!(host.ask(Command::Home), Outcome::Done(_)));
    assert_eq!(host.ask(Command::MoveTo(to)), Outcome::Done(Answer::At(to)));
}

#[test]
fn driver_that_was_reset_at_rest_makes_its_position_unknown_before_it_is_set_up_again() {
    let config = MechanicsConfig::ideal();
    let again: [fn(&mut Host, &MechanicsConfig) -> Outcome; 3] = [
        |host, _| host.ask(Command::HomeAxes { axes: [false, true, false, false], approaches: 1 }),
        // As a host does that comes back.
        |host, config| host.configure(&with_driver(config)),
        |_, _| Outcome::Running,
    ];
    for (number, again) in again.iter().enumerate() {
        let (rig, mut host) = start(&config);
        assert_eq!(host.configure(&with_driver(&config)), Outcome::Done(Answer::Nothing));
        assert!(matches!(host.ask(Command::Home), Outcome::Done(_)));
        // Set up again without a reset, it keeps its position.
        assert_eq!(host.configure(&with_driver(&config)), Outcome::Done(Answer::Nothing));
        let to = [100, 100, 100, 10_000];
        assert_eq!(host.ask(Command::MoveTo(to)), Outcome::Done(Answer::At(to)));
        rig.reset_driver(Axis::Pan);
        again(&mut host, &config);
        let outcome = host.ask(Command::MoveTo([200, 100, 100, 10_000]));
        let lost = |outcome| {
            matches!(outcome, Outcome::Refused(Refusal::Faulted(set))
            if set.contains(Fault::DriverLost))
        };
        let unknown = outcome == Outcome::Refused(Refusal::PositionUnknown(Axis::Pan));
        assert!(if number < 2 { unknown } else { lost(outcome) }, "{number}: {outcome:?}");
    }
}

#[test]
fn parameters_that_one_driver_refuses_leave_no_position_trusted_of_those_that_have_taken_them() {
    let config = MechanicsConfig::ideal();
    let (_rig, mut host) = start(&config);
    let mut drivers = with_driver(&config);
    drivers.axes[1].driver = drivers.axes[0].driver;
    assert_eq!(host.configure(&drivers), Outcome::Done(Answer::Nothing));
    assert!(matches!(host.ask(Command::Home), Outcome::Done(_)));
    let mut other = drivers;
    for axis in &mut other.axes[..2] {
        axis.driver.as_mut().unwrap().microsteps = 32;
    }
    other.axes[1].driver.as_mut().unwrap().run_ma = 9000;
    let refused = host.configure(&other);
    let trouble = DriverTrouble::Current;
    assert_eq!(refused, Outcome::Refused(Refusal::Driver { axis: Axis::Tilt, trouble }));
    let unknown = Outcome::Refused(Refusal::PositionUnknown(Axis::Pan));
    assert_eq!(host.ask(Command::MoveTo([100; 4])), unknown);
}

#[test]
fn rig_wired_the_other_way_round_does_what_any_does_if_its_host_knows() {
    let truth = |wiring: Wiring| {
        let config = MechanicsConfig { wiring, ..MechanicsConfig::ideal() };
        let (rig, mut host) = start(&config);
        assert!(matches!(host.ask(Command::Home), Outcome::Done(_)));
        let to = [100, 100, 100, 10_000];
        assert_eq!(host.ask(Command::MoveTo(to)), Outcome::Done(Answer::At(to)));
        host.ask(Command::Lamp { on: true, level: 65535 });
        let lit = rig.lamp_level();
        let outcome = host.ask(Command::Expose { duration_us: 5000, warm_lamp: false });
        assert!(matches!(outcome, Outcome::Done(_)), "{outcome:?}");
        host.ask(Command::Lamp { on: false, level: 0 });
        (
            rig.motor_steps(Axis::Light),
            rig.last_exposure().unwrap().open_s,
            lit,
            rig.lamp_level(),
            rig.shutter_open(),
        )
    };
    let rest = [Pin::Lamp, Pin::Shutter].into_iter().collect();
    let usual = truth(Wiring::default());
    assert_eq!((usual.1, usual.2, usual.3, usual.4), (0.005, 1.0, 0.0, false));
    assert_eq!(truth(Wiring { axes: [Pins::OF_AXIS; 4], rest }), usual);
}

#[test]
fn drivers_alarm_stops_the_rig_and_a_stalls_pulse_a_move() {
    let config = MechanicsConfig::ideal();
    let mut with_alarms = configuration(&config);
    (with_alarms.axes[1].alarm, with_alarms.axes[1].alarm_debounce_us) = (Alarm::Level, 2000);
    (with_alarms.axes[2].alarm, with_alarms.axes[2].alarm_debounce_us) = (Alarm::Edge, 50);
    let faults = |outcome| match outcome {
        Outcome::Refused(Refusal::Faulted(faults)) => faults.iter().collect::<Vec<_>>(),
        other => panic!("not refused: {other:?}"),
    };
    let to = [100, 100, 100, 10_000];
    let begin = || {
        let (rig, mut host) = start(&config);
        assert_eq!(host.configure(&with_alarms), Outcome::Done(Answer::Nothing));
        assert!(matches!(host.ask(Command::Home), Outcome::Done(_)));
        (rig, host)
    };
    let (rig, mut host) = begin();
    rig.set_driver_alarm(Axis::Tilt, true);
    rig.idle_until_us(rig.now_us() + 10_000);
    assert_eq!(faults(host.ask(Command::MoveTo(to))), [Fault::DriverAlarm]);
    // Between two polls, too short and long enough.
    for (lasts_us, stalls) in [(49, false), (50, true)] {
        let (rig, mut host) = begin();
        let id = host.next_id;
        host.next_id += 1;
        let command = Command::MoveTo(to);
        host.send(&ToController::Request(Request { session: 1, id, seen: id - 1, command }));
        rig.idle_until_us(rig.now_us() + 100_000);
        rig.pulse_alarm(Axis::Roll, lasts_us);
        let outcome = loop {
            if let ToHost::Response(response) = host.receive()
                && response.id == id
                && response.outcome != Outcome::Running
            {
                break response.outcome;
            }
        };
        if stalls {
            assert_eq!(faults(outcome), [Fault::Stall]);
        } else {
            assert_eq!(outcome, Outcome::Done(Answer::At(to)));
        }
    }
}

#[test]
fn flicker_of_a_dimmer_shows_to_a_board_that_reads_by_itself_only() {
    let flicker = |timed_exposures: bool| {
        let mut config = MechanicsConfig { timed_exposures, ..MechanicsConfig::ideal() };
        config.lamp.ripple = 0.1;
        config.lamp.warm_up_time_constant_s = 1e-3;
        let (rig, mut host) = start(&config);
        assert!(matches!(host.ask(Command::Home), Outcome::Done(_)));
        host.ask(Command::Lamp { on: true, level: 65535 });
        rig.idle_until_us(rig.now_us() + 1_000_000);
        let Outcome::Done(Answer::Exposed(exposure)) =
            host.ask(Command::Expose { duration_us: 250_000, warm_lamp: false })
        else {
            panic!("no exposure")
        };
        assert_eq!((exposure.open_us, rig.last_exposure().unwrap().open_s), (250_000, 0.25));
        (exposure.flicker_ppm, exposure.readings, f64::from(exposure.reference_q8) / 256.0)
    };
    let (ppm, readings, mean) = flicker(true);
    assert!(
        ppm.abs_diff(100_000) < 1000 && readings > 50_000 && (mean - 3000.0).abs() < 5.0,
        "{ppm} {readings} {mean}"
    );
    // At one phase of the dimmer it is bright, or dark, and steady.
    let (ppm, readings, mean) = flicker(false);
    assert!(ppm < 100 && readings == 250 && (mean - 3000.0).abs() > 250.0, "{ppm} {readings} {mean}");
}
