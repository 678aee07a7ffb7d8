//! The boards' very programs, for their own processors, in QEMU: the host's client drives them over a serial port.

#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

use lobelia::rig::RigClient;
use lobelia_protocol::{AxisParameters, Configuration, HomeDirection, Settings};
use lobelia_tests::qemu::{Machine, Qemu, program};

const LM3S6965: Machine = Machine { board: "lm3s6965", machine: "lm3s6965evb", ports_before: 0, shift: 5 };
const STM32F405: Machine =
    Machine { board: "stm32f405", machine: "olimex-stm32-h405", ports_before: 1, shift: 3 };

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
        home_travel: 2000,
        home_debounce_us: 1000,
        index_tolerance: 4,
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
            camera_wait_ms: 0,
            coordinated: true,
        },
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
    qemu.watch_port("pl061_luminary", 1);
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
    assert_room_for_stack(&mut qemu);
}

/// RAM starts as zeros, statics lie at its beginning and the stack at its end; the longest run of zeros is between them.
fn assert_room_for_stack(qemu: &mut Qemu) {
    const RAM: usize = 64 * 1024;
    let memory = qemu.memory(0x2000_0000, RAM);
    let (mut longest, mut end, mut run) = (0, 0, 0);
    for (at, byte) in memory.into_iter().enumerate() {
        run = if byte == 0 { run + 1 } else { 0 };
        if run > longest {
            (longest, end) = (run, at + 1);
        }
    }
    println!("worst stack of the session: {} bytes; never touched: {longest} bytes", RAM - end);
    assert!(longest > RAM / 2, "statics and stack take {} bytes", RAM - longest);
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
