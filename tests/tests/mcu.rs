//! The boards' very programs, for their own processors, in QEMU: the host's client drives them over a serial
//! port.

#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::Duration;

use lobelia::acquire::simulated;
use lobelia::rig::trace::{self, Recorder};
use lobelia::rig::{Port, RigClient, replay};
use lobelia_hil_sim::{MechanicsConfig, SimulatedRig};
use lobelia_protocol::{
    Alarm, AxisParameters, Configuration, CrashCause, Fault, HomeDirection, Pins, Settings,
};
use lobelia_tests::qemu::{Machine, Qemu, TracedPort, program};

const LM3S6965: Machine =
    Machine { board: "lm3s6965", machine: "lm3s6965evb", ports_before: 0, shift: 5, kept: 0x2000_F800 };
const STM32F405: Machine = Machine {
    board: "stm32f405",
    machine: "olimex-stm32-h405",
    ports_before: 1,
    shift: 3,
    kept: 0x2001_F800,
};
/// QEMU's type of the LM3S6965's GPIO ports, and their numbers.
const PORT: &str = "pl061_luminary";
const PORT_B: usize = 1;
const PORT_D: usize = 3;

const TAKE_UP: i32 = 40;

/// Four axes of different speeds, whose switches are below their travel.
fn configuration() -> Configuration {
    let axes = [6000, 5500, 4000, 7000].map(|max_speed| AxisParameters {
        min_steps: -800,
        max_steps: 800,
        max_speed,
        acceleration: 40_000,
        jerk: 1_000_000,
        full_turn_steps: 0,
        take_up_steps: TAKE_UP as u32,
        settle_ms: 2,
        home_direction: HomeDirection::Negative,
        home_position: -900,
        home_speed: 2000,
        home_slow_speed: 500,
        home_back_off: 30,
        home_switch_steps: 600,
        home_order: 0,
        home_travel: 2000,
        home_debounce_us: 1000,
        index_tolerance: 4,
        driver: None,
        inverted: Pins::NONE,
        alarm: Alarm::None,
        alarm_debounce_us: 0,
        most_turns: 1,
    });
    // Without leases: emulated time runs as fast as it can, whatever the host does meanwhile.
    Configuration {
        axes,
        settings: Settings {
            lamp_warm_up_s: 1,
            lamp_least_reading: 0,
            lease_ms: 0,
            lamp_lease_ms: 0,
            lamp_safe_level: 0,
            lamp_longest_s: 172_800,
            fan_run_on_s: 300,
            camera_wait_ms: 0,
            coordinated: true,
            pulse_us: 2,
            direction_setup_us: 5,
            inverted: Pins::NONE,
        },
        keep_outs: [None; 4],
    }
}

/// Poses that go up, down, far, near and nowhere.
fn pose(index: i32) -> [i32; 4] {
    [index * 317 % 1601 - 800, 700 - index * 73, (index / 2) * 211 % 1201 - 600, index * 929 % 1501 - 750]
}

/// Steps that a move makes when it has to end upward.
fn planned_steps(from: i32, to: i32) -> u64 {
    let steps = if to < from { from - to + 2 * TAKE_UP } else { to - from };
    steps as u64
}

/// What four drivers at the pins make of the edges.
#[derive(Default)]
struct Drivers {
    up: [bool; 4],
    position: [i32; 4],
    steps: [u64; 4],
}

impl Drivers {
    /// Steps are on pins 0 to 3 of the port, directions on 4 to 7.
    fn edge(&mut self, pin: usize, high: bool) {
        match pin {
            0..4 if high => {
                self.position[pin] += if self.up[pin] { 1 } else { -1 };
                self.steps[pin] += 1;
            }
            4..8 => self.up[pin - 4] = high,
            _ => {}
        }
    }
}

#[test]
fn step_edges_seen_outside_the_chip_are_the_steps_commanded() {
    let Some(program) = program(LM3S6965.board) else { return };
    let mut qemu = Qemu::load(LM3S6965, &program);
    let steps = qemu.device(PORT, PORT_B);
    qemu.watch_port(&steps);
    qemu.start();
    let mut drivers = Drivers::default();
    let mut client = RigClient::connect(Box::new(qemu.port())).unwrap();
    client.configure(&configuration()).unwrap();
    let mut at = client.home().unwrap();
    qemu.edges(|pin, high| drivers.edge(pin, high));
    let home: [i32; 4] = std::array::from_fn(|axis| drivers.position[axis] - at[axis]);
    assert!(drivers.steps.iter().all(|&steps| steps > 300), "{:?}", drivers.steps);
    client.lamp(true, 0.5).unwrap();
    for index in 0..20 {
        let to = pose(index);
        let before = drivers.steps;
        assert_eq!(client.move_to(to).unwrap(), to);
        qemu.edges(|pin, high| drivers.edge(pin, high));
        for axis in 0..4 {
            assert_eq!(drivers.position[axis] - home[axis], to[axis], "pose {index}, axis {axis}");
            let made = drivers.steps[axis] - before[axis];
            assert_eq!(made, planned_steps(at[axis], to[axis]), "pose {index}, axis {axis}");
        }
        at = to;
        let exposure = client.expose(2000, false).unwrap();
        assert!(exposure.readings >= 16 && (2000..3000).contains(&exposure.open_us), "{exposure:?}");
        // Half of the modelled photodiode's 3000, in 1/256.
        assert!(exposure.reference_q8.abs_diff(1500 << 8) <= 2 << 8, "{exposure:?}");
    }
    let status = client.status().unwrap();
    assert_eq!((status.positions, status.known, status.busy), (at, [true; 4], false));
    assert!(status.faults.is_empty());
    assert_room_for_stack(&mut qemu, &mut client);
}

/// The stack is at the beginning of RAM, and painted at the start; the controller tells how much of it was
/// used.
fn assert_room_for_stack(qemu: &mut Qemu, client: &mut RigClient) {
    const STACK: usize = 28 * 1024;
    let untouched = qemu.memory(0x2000_0000, STACK).into_iter().take_while(|&byte| byte == 0xCC).count();
    println!("worst stack of the session: {} bytes of {STACK}", STACK - untouched);
    assert!(untouched > STACK / 8, "the stack took {} bytes of {STACK}", STACK - untouched);
    // The mark is found some hundred turns of the main loop later.
    let told = client.health().unwrap().stack.unwrap();
    assert_eq!(told[1] as usize, STACK);
    assert!(told[0] as usize <= STACK - untouched && told[0] as usize > STACK / 4, "{told:?}");
}

/// At the boards' own speeds no step is late by more than a motor bears, whatever is planned: homings, moves,
/// stops and new targets of all axes.
fn steps_are_in_time(machine: Machine) {
    let Some(program) = program(machine.board) else { return };
    let mut qemu = Qemu::load(machine, &program);
    qemu.start();
    let mut client = RigClient::connect(Box::new(qemu.port())).unwrap();
    client.configure(&configuration()).unwrap();
    let stop = Arc::new(AtomicBool::new(false));
    let asked = Arc::clone(&stop);
    client.set_interrupt(move || asked.load(Relaxed));
    for (round, steps) in [200, 900, 2500].into_iter().enumerate() {
        client.home().unwrap();
        for index in 0..5 {
            client.move_to(pose(5 * round as i32 + index)).unwrap();
        }
        client.move_to([-800; 4]).unwrap();
        // Broken off while all axes are speeding up, at speed, or slowing down.
        let before = qemu.step_count();
        let moving = std::thread::spawn(move || {
            let moved = client.move_to([800; 4]);
            (client, moved)
        });
        while qemu.step_count().wrapping_sub(before) < steps {
            std::thread::sleep(Duration::from_micros(200));
        }
        qemu.pause();
        stop.store(true, Relaxed);
        std::thread::sleep(Duration::from_millis(400));
        qemu.start();
        let moved;
        (client, moved) = moving.join().unwrap();
        stop.store(false, Relaxed);
        assert!(moved.unwrap_err().to_string().contains("interrupted"));
        assert_eq!(client.status().unwrap().known, [true; 4]);
    }
    let health = client.health().unwrap();
    let [used, of] = health.stack.unwrap();
    println!(
        "{}: latest step {} µs, longest turn {:.1} ms, stack {used} of {of} bytes",
        machine.board,
        health.worst_late_us,
        f64::from(health.longest_poll_us) / 1000.0
    );
    assert!(health.worst_late_us < 100, "{health:?}");
    assert!((1..6000).contains(&health.longest_poll_us) && health.overruns == 0, "{health:?}");
    assert!(client.status().unwrap().faults.is_empty());
}

#[test]
fn no_step_of_the_lm3s6965_is_late_at_its_own_speed() {
    steps_are_in_time(LM3S6965);
}

#[test]
fn no_step_of_the_f405_is_late_at_its_own_speed() {
    steps_are_in_time(STM32F405);
}

#[test]
fn f405_program_answers_hello_homes_and_tells_its_status() {
    let Some(program) = program(STM32F405.board) else { return };
    let mut qemu = Qemu::load(STM32F405, &program);
    qemu.start();
    let mut client = RigClient::connect(Box::new(qemu.port())).unwrap();
    assert!(!client.status().unwrap().configured);
    client.configure(&configuration()).unwrap();
    let homed = client.home().unwrap();
    let status = client.status().unwrap();
    assert_eq!((status.positions, status.known, status.busy), (homed, [true; 4], false));
    assert_eq!(client.move_to([10, -10, 200, -200]).unwrap(), [10, -10, 200, -200]);
}

#[test]
fn emergency_stop_ceases_steps_in_its_interrupt() {
    let Some(program) = program(LM3S6965.board) else { return };
    let mut qemu = Qemu::load(LM3S6965, &program);
    let (steps, stop) = (qemu.device(PORT, PORT_B), qemu.device(PORT, PORT_D));
    qemu.watch_port(&steps);
    qemu.start();
    let mut client = RigClient::connect(Box::new(qemu.port())).unwrap();
    client.configure(&configuration()).unwrap();
    client.home().unwrap();
    client.move_to([-800; 4]).unwrap();
    qemu.edges(|_, _| {});
    let moving = std::thread::spawn(move || {
        let moved = client.move_to([800; 4]);
        (client, moved)
    });
    let mut drivers = Drivers::default();
    while drivers.steps.iter().any(|&steps| steps < 100) {
        qemu.edges(|pin, high| drivers.edge(pin, high));
    }
    qemu.pause();
    qemu.edges(|pin, high| drivers.edge(pin, high));
    assert!(drivers.steps.iter().all(|&steps| steps < 1500), "still under way: {:?}", drivers.steps);
    const HELD: u32 = 0x0F;
    const ENABLES: u32 = 0x4002_4000 + (HELD << 2);
    assert_eq!(qemu.word(ENABLES), HELD);
    qemu.set_input(&stop, 3, true);
    qemu.start();
    let (mut client, moved) = moving.join().unwrap();
    let error = moved.unwrap_err().to_string();
    assert!(error.contains("emergency stop"), "{error}");
    let mut after = Drivers::default();
    qemu.edges(|pin, high| after.edge(pin, high));
    assert_eq!((after.steps, qemu.word(ENABLES)), ([0; 4], 0), "steps after the stop, drivers that hold");

    let status = client.status().unwrap();
    assert_eq!((status.emergency_stop, status.known), (true, [false; 4]));
    assert!(status.faults.contains(Fault::EmergencyStop));
    assert!(client.clear_faults().is_err(), "still pressed");
    assert!(client.home().is_err(), "a fault is set");
    qemu.set_input(&stop, 3, false);
    assert!(client.home().is_err(), "not yet cleared");
    client.clear_faults().unwrap();
    assert!(client.move_to([0; 4]).is_err(), "positions are unknown");
    client.home().unwrap();
    qemu.edges(|pin, high| after.edge(pin, high));
    assert!(after.steps.iter().all(|&steps| steps > 0), "steps reach the drivers again: {:?}", after.steps);
}

/// Has the program crash in each way, and asks it what happened once it runs again.
fn crashes_are_told(machine: Machine, crashes: &[(u32, CrashCause)]) {
    let Some(program) = program(machine.board) else { return };
    let mut qemu = Qemu::load(machine, &program);
    qemu.start();
    let mut client = RigClient::connect(Box::new(qemu.port())).unwrap();
    client.configure(&configuration()).unwrap();
    client.save_parameters().unwrap();
    assert_eq!(client.crash(), None);
    for &(number, cause) in crashes {
        client.home().unwrap();
        qemu.crash(number);
        drop(client);
        client = RigClient::connect(Box::new(qemu.port())).unwrap();
        let status = client.status().unwrap();
        let crash = client.crash().unwrap_or_else(|| panic!("{cause:?} was not told"));
        assert_eq!(crash.cause, cause);
        assert_eq!(crash.place == 0, cause == CrashCause::StackOverflow, "{crash:?}");
        assert_eq!((status.configured, status.known, status.busy), (true, [false; 4], false), "{cause:?}");
        // Told once.
        drop(client);
        client = RigClient::connect(Box::new(qemu.port())).unwrap();
        client.status().unwrap();
        assert_eq!(client.crash(), None);
    }
}

#[test]
fn crash_resets_the_lm3s6965_and_is_told_and_parameters_are_kept() {
    let crashes = [
        (1, CrashCause::Panic),
        (2, CrashCause::StackOverflow),
        (3, CrashCause::HardFault),
        (4, CrashCause::Watchdog),
    ];
    crashes_are_told(LM3S6965, &crashes);
}

#[test]
fn crash_resets_the_f405_and_is_told_and_parameters_are_kept() {
    // QEMU does not model this chip's watchdog.
    let crashes = [(1, CrashCause::Panic), (2, CrashCause::StackOverflow), (3, CrashCause::HardFault)];
    crashes_are_told(STM32F405, &crashes);
}

#[test]
fn emergency_stop_of_the_f405_is_a_fault_by_its_interrupt_alone() {
    let Some(program) = program(STM32F405.board) else { return };
    let mut qemu = Qemu::load(STM32F405, &program);
    qemu.start();
    let mut client = RigClient::connect(Box::new(qemu.port())).unwrap();
    client.configure(&configuration()).unwrap();
    client.home().unwrap();
    // Line 9, which the pin drives; the pin's own level is not modelled and reads as released.
    qemu.set_input("/machine/soc/exti", 9, true);
    let error = client.move_to([10; 4]).unwrap_err().to_string();
    assert!(error.contains("emergency stop"), "{error}");
    assert_eq!(client.status().unwrap().known, [false; 4]);
    client.clear_faults().unwrap();
    client.home().unwrap();
}

/// The same rig as the one modelled beside the emulated chip: a step is a degree, the switch 300 steps below
/// the start.
fn simulated_rig() -> SimulatedRig {
    let mut config = MechanicsConfig::ideal();
    for axis in [&mut config.pan, &mut config.tilt, &mut config.roll, &mut config.light] {
        axis.degrees_per_step = 1.0;
        axis.home_switch_deg = 0.5;
        axis.switch_hysteresis_deg = 0.0;
        axis.stops_deg = [-1e6, 1e6];
        axis.start_deg = 300.0;
    }
    SimulatedRig::new(&config)
}

#[test]
fn session_recorded_in_qemu_is_replayed_by_the_simulator_step_by_step() {
    let Some(program) = program(LM3S6965.board) else { return };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("trace.jsonl");
    let mut qemu = Qemu::load(Machine { shift: 0, ..LM3S6965 }, &program);
    qemu.start();
    // The moves begin where the switch's scatter, of a few steps, no longer matters.
    let ready = |port: Box<dyn Port>| {
        let mut client = RigClient::connect(port).unwrap();
        client.configure(&configuration()).unwrap();
        client.home().unwrap();
        client.move_to(pose(0)).unwrap();
        client
    };
    let mut client = ready(Box::new(TracedPort::new(qemu)));
    client.record(Recorder::create(&path).unwrap().with_steps());
    for index in 1..5 {
        client.move_to(pose(index)).unwrap();
    }
    drop(client);

    let trace = trace::read(&path).unwrap();
    let mut client = ready(simulated::port(&simulated_rig()));
    let replayed = replay::run(&mut client, &trace, false, || {}).unwrap();
    println!("{} steps, times within {} µs", replayed.steps, replayed.most_us);
    assert_eq!(replayed.differences, []);
    assert!(replayed.steps > 5000, "{replayed:?}");
}
