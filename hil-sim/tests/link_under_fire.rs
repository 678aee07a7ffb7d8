//! The link under fire: a host with several requests in flight, on a line that loses, changes, doubles,
//! delays, swaps and invents bytes, is cut and mended, on a rig that faults and whose controller is reset in
//! mid-move. What the rig truly did is compared with what the host was told: nothing that was not asked for,
//! nothing twice, and every fault is told.
#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::collections::{BTreeMap, HashMap};
use std::io::{ErrorKind, Read, Write};
use std::time::Duration;

use lobelia_hil_sim::{
    AxisMechanics, FaultRates, LampConfig, LineConfig, MechanicsConfig, SimulatedLink, SimulatedRig, Way,
};
use lobelia_protocol::{
    Answer, Axis, Command, Configuration, Fault, FrameDecoder, Hello, Outcome, Refusal, Request,
    ToController, ToHost, Verdict,
};

const BAUD: u32 = 2_000_000;
/// The host sends again what was not answered for this long.
const PATIENCE: Duration = Duration::from_millis(3);
/// Requests that the host has in flight at most.
const IN_FLIGHT: usize = 6;
/// A frame from long ago turns up again so often, as from a buffer somewhere on the way.
const GHOSTS_PER_ROUND: f64 = 0.05;

/// Numbers from a seed (splitmix64).
struct Random(u64);

impl Random {
    fn below(&mut self, bound: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) % bound
    }

    fn falls(&mut self, chance: f64) -> bool {
        (self.below(1 << 32) as f64) < chance * (1u64 << 32) as f64
    }
}

/// A rig whose moves take few steps, so that the link is what takes the time.
fn mechanics() -> MechanicsConfig {
    let axis = AxisMechanics {
        degrees_per_step: 1.0,
        repeatability_deg: 0.0,
        backlash_deg: 0.0,
        limits_deg: [-30.0, 30.0],
        home_switch_deg: -45.0,
        stops_deg: [-60.0, 60.0],
        start_deg: -20.0,
        max_speed_deg_s: 4000.0,
        acceleration_deg_s2: 200_000.0,
        jerk_deg_s3: 2e7,
        ..AxisMechanics::pan()
    };
    let [pan, tilt, roll, light] = [(); 4].map(|()| axis.clone());
    // A lamp that is warm at once shines as it is told to.
    let lamp = LampConfig {
        warm_up_time_constant_s: 0.0,
        warm_up_s: 0,
        drift_amplitude: 0.0,
        photodiode_noise: 0.0,
        ..LampConfig::default()
    };
    MechanicsConfig { seed: 1, pan, tilt, roll, light, lamp, ..MechanicsConfig::default() }
}

fn configuration() -> Configuration {
    let mut configuration = mechanics().configuration();
    for axis in &mut configuration.axes {
        (axis.settle_ms, axis.home_debounce_us, axis.home_back_off) = (1, 50, 4);
        axis.home_slow_speed = axis.home_speed;
        // From the switch at -45° to the stop at -60°, and some steps.
        axis.home_switch_steps = 20;
    }
    configuration
}

/// Steps of a move that ends upward, counted apart from the firmware.
fn steps(from: i32, to: i32, take_up: u32) -> u64 {
    if to < from {
        u64::from(from.abs_diff(to)) + 2 * u64::from(take_up)
    } else {
        u64::from(from.abs_diff(to))
    }
}

/// What the host believes the rig to be like: what it asked for and was told is done.
struct Belief {
    positions: [i32; 4],
    level: u16,
    /// Steps that the axes' drivers have received by now.
    received: [u64; 4],
}

/// A host, and the rig that it drives.
struct Host {
    rig: SimulatedRig,
    link: SimulatedLink,
    decoder: FrameDecoder,
    random: Random,
    session: u32,
    last_id: u32,
    /// Sent and not finally answered.
    open: BTreeMap<u32, Command>,
    /// Sent in this round.
    round: BTreeMap<u32, Command>,
    /// A stop: what went before it and did not arrive is never run.
    stop: u32,
    /// Final answers of the session.
    answers: HashMap<u32, Outcome>,
    /// Frames sent long ago.
    ghosts: Vec<Vec<u8>>,
    /// The session is unknown to the controller.
    lost: bool,
    believed: Belief,
    /// Motor steps less named ones.
    offset: Option<[i64; 4]>,
    seen: Seen,
}

/// What a run has shown.
#[derive(Debug, Default, PartialEq)]
struct Seen {
    moves: u64,
    exposures: u64,
    stops: u64,
    faults: u64,
    resets: u64,
    cuts: u64,
}

impl Host {
    fn new(seed: u64, faults: FaultRates) -> Self {
        let rig = SimulatedRig::new(&mechanics());
        rig.set_line(&LineConfig { baud: Some(BAUD), faults, seed });
        let mut link = rig.link();
        link.set_timeout(PATIENCE);
        let mut host = Self {
            rig,
            link,
            decoder: FrameDecoder::new(),
            random: Random(seed),
            session: 0,
            last_id: 0,
            open: BTreeMap::new(),
            round: BTreeMap::new(),
            stop: 0,
            answers: HashMap::new(),
            ghosts: Vec::new(),
            lost: false,
            believed: Belief { positions: [0; 4], level: 0, received: [0; 4] },
            offset: None,
            seen: Seen::default(),
        };
        host.start();
        host
    }

    fn write(&mut self, packet: &ToController) {
        let frame = packet.encode().unwrap();
        self.link.write_all(&frame).unwrap();
        if matches!(packet, ToController::Request(_)) && self.random.falls(0.01) {
            self.ghosts.push(frame.to_vec());
        }
    }

    fn send(&mut self, id: u32) {
        let command = self.open[&id];
        let seen = self.open.keys().next().map_or(id, |oldest| *oldest) - 1;
        self.write(&ToController::Request(Request { session: self.session, id, seen, command }));
    }

    fn begin(&mut self, command: Command) -> u32 {
        self.last_id += 1;
        self.open.insert(self.last_id, command);
        self.round.insert(self.last_id, command);
        self.send(self.last_id);
        self.last_id
    }

    /// Receives what comes within a while; gives false when that is nothing.
    fn receive(&mut self) -> bool {
        let mut buffer = [0; 256];
        let count = match self.link.read(&mut buffer) {
            Ok(count) => count,
            Err(error) if error.kind() == ErrorKind::TimedOut => return false,
            Err(error) => panic!("{error}"),
        };
        for &byte in &buffer[..count] {
            let Some(Ok(payload)) = self.decoder.push(byte) else { continue };
            match ToHost::decode(payload).expect("a frame with the right checksum is a packet") {
                ToHost::Hello(reply) if reply.hello.session == self.session => {
                    assert_eq!(reply.verdict, Verdict::Accepted);
                    self.lost = false;
                }
                ToHost::Response(response) if response.session == self.session => {
                    self.note(response.id, response.outcome);
                }
                _ => {}
            }
        }
        true
    }

    fn note(&mut self, id: u32, outcome: Outcome) {
        match outcome {
            Outcome::Running | Outcome::Refused(Refusal::OutOfWindow) => {}
            Outcome::Refused(Refusal::NoSession) => self.lost = true,
            // Of a request whose answer has come before, or that a stop has overtaken.
            Outcome::Refused(Refusal::Stale) => {
                let overtaken = self.open.remove(&id).is_some();
                assert!(!overtaken || id < self.stop, "the answer to {id} is forgotten");
            }
            _ => {
                self.open.remove(&id);
                let first = *self.answers.entry(id).or_insert(outcome);
                assert_eq!(first, outcome, "two answers to {id}");
            }
        }
    }

    /// Lets some time pass on the link.
    fn exchange(&mut self) {
        if self.random.falls(GHOSTS_PER_ROUND) && !self.ghosts.is_empty() {
            let place = self.random.below(self.ghosts.len() as u64) as usize;
            let ghost = self.ghosts.swap_remove(place);
            self.link.write_all(&ghost).unwrap();
        }
        if !self.receive() {
            let ids: Vec<u32> = self.open.keys().copied().collect();
            ids.into_iter().for_each(|id| self.send(id));
        }
    }

    /// Waits until all is answered, or the session is lost.
    fn settle(&mut self) {
        while !self.open.is_empty() && !self.lost {
            self.exchange();
        }
    }

    /// Asks for one thing and waits for the answer.
    fn ask(&mut self, command: Command) -> Outcome {
        let id = self.begin(command);
        self.settle();
        self.answers.get(&id).copied().unwrap_or(Outcome::Refused(Refusal::NoSession))
    }

    /// Opens a session, sets the parameters, homes and takes stock.
    fn start(&mut self) {
        loop {
            self.session += 1;
            (self.last_id, self.stop) = (0, 0);
            self.open.clear();
            self.answers.clear();
            self.lost = true;
            while self.lost {
                self.write(&ToController::Hello(Hello::new(self.session)));
                while self.lost && self.receive() {}
            }
            let commands = configuration().commands().into_iter();
            let commands =
                [Command::Stop, Command::ClearFaults].into_iter().chain(commands).chain([Command::Home]);
            let done: Vec<_> = commands.map(|command| self.ask(command)).collect();
            if done.iter().all(|outcome| matches!(outcome, Outcome::Done(_))) {
                return self.take_stock();
            }
        }
    }

    /// Looks what the rig is like after something whose outcome can't be known, and what the controller says
    /// of it.
    fn take_stock(&mut self) {
        let Outcome::Done(Answer::Status(status)) = self.ask(Command::Status) else { panic!("no status") };
        assert_eq!((status.known, status.busy, status.faults.is_empty()), ([true; 4], false, true));
        let motors = Axis::ALL.map(|axis| self.rig.motor_steps(axis));
        let offset = [0, 1, 2, 3].map(|k| motors[k] - i64::from(status.positions[k]));
        // Switches without scatter give the steps the same names after each homing.
        let expected = *self.offset.get_or_insert(offset);
        assert_eq!(offset, expected, "the controller is wrong about where its axes are");
        let level = (self.rig.lamp_level() * 65535.0).round() as u16;
        assert_eq!(level, if status.lamp.on { status.lamp.level } else { 0 });
        self.believed = Belief { positions: status.positions, level, received: self.received() };
        self.rig.take_exposures();
    }

    fn received(&self) -> [u64; 4] {
        Axis::ALL.map(|axis| self.rig.steps_received(axis))
    }

    fn motors_believed(&self) -> [i64; 4] {
        let offset = self.offset.unwrap_or_default();
        [0, 1, 2, 3].map(|k| i64::from(self.believed.positions[k]) + offset[k])
    }

    /// Stops what is under way: what was done before was done as asked for.
    fn stop(&mut self) {
        self.stop = self.last_id + 1;
        assert_eq!(self.ask(Command::Stop), Outcome::Done(Answer::Nothing));
        self.compare_exposures(|truth, asked| truth <= asked);
        while matches!(self.ask(Command::Status), Outcome::Done(Answer::Status(status)) if status.busy) {}
        self.take_stock();
        // An axis that was stopped on its way down has its play to take up: known again after a long way up.
        for position in [-20, 20] {
            assert!(matches!(self.ask(Command::MoveTo([position; 4])), Outcome::Done(_)));
        }
        self.take_stock();
        self.seen.stops += 1;
    }

    /// The emergency stop: no step from that instant on, and the host is told.
    fn press_stop(&mut self) {
        self.rig.press_emergency_stop();
        let received = self.received();
        self.rig.release_emergency_stop();
        self.settle();
        assert_eq!(self.received(), received, "a step after the emergency stop");
        assert_eq!(self.rig.lamp_level(), 0.0);
        let Outcome::Done(Answer::Status(status)) = self.ask(Command::Status) else { panic!("no status") };
        assert!(status.faults.contains(Fault::EmergencyStop), "a fault that is not told");
        assert!(matches!(self.ask(Command::Home), Outcome::Refused(Refusal::Faulted(_))));
        for command in [Command::ClearFaults, Command::Home] {
            assert!(matches!(self.ask(command), Outcome::Done(_)));
        }
        self.take_stock();
        self.seen.faults += 1;
    }

    /// The controller loses its power for a moment: no step until the host has started anew.
    fn reset(&mut self) {
        self.rig.reset_controller();
        let received = self.received();
        while !self.lost {
            if self.open.is_empty() {
                self.begin(Command::Status);
            }
            self.exchange();
        }
        assert_eq!(self.received(), received, "a step after a reset");
        self.start();
        self.seen.resets += 1;
    }

    /// The cable is pulled at any byte, and plugged in again after a while.
    fn cut(&mut self) {
        for way in [Way::ToController, Way::ToHost] {
            self.rig.lose_bytes(way, self.random.below(60), u64::MAX);
        }
        for _ in 0..self.random.below(20) {
            self.exchange();
        }
        for way in [Way::ToController, Way::ToHost] {
            self.rig.lose_bytes(way, 0, 0);
        }
        self.seen.cuts += 1;
    }

    /// A few requests at once, of which the rig does what it does; then what it did is compared.
    fn round(&mut self) {
        self.round.clear();
        if self.random.falls(0.3) {
            let level = self.random.below(65536) as u16;
            self.begin(Command::Lamp { on: true, level });
        }
        let count = 1 + self.random.below(IN_FLIGHT as u64);
        for _ in 0..count {
            let command = match self.random.below(8) {
                0..2 => Command::MoveTo([(); 4].map(|()| self.random.below(61) as i32 - 30)),
                2..4 => {
                    Command::Expose { duration_us: 100 + self.random.below(2000) as u32, warm_lamp: false }
                }
                4 => Command::MoveTo([99, 0, 0, 0]),
                _ => Command::Status,
            };
            self.begin(command);
            while self.random.falls(0.5) && !self.lost {
                self.exchange();
            }
            while self.open.len() >= IN_FLIGHT && !self.lost {
                self.exchange();
            }
        }
        match self.random.below(40) {
            0 => return self.stop(),
            1 => return self.press_stop(),
            2 => return self.reset(),
            3 => self.cut(),
            _ => {}
        }
        self.settle();
        assert!(!self.lost, "the session was lost");
        self.compare();
    }

    /// What was answered as done must be all that the rig did, in order, each once.
    fn compare(&mut self) {
        self.compare_exposures(|_, _| false);
        let motors = Axis::ALL.map(|axis| self.rig.motor_steps(axis));
        assert_eq!(motors, self.motors_believed());
        assert_eq!(self.received(), self.believed.received, "steps that nobody asked for, or some left out");
        assert_eq!(self.rig.lamp_level(), f64::from(self.believed.level) / 65535.0);
    }

    /// Goes through the round's requests in order, and compares each exposure with what its forerunners
    /// should have led to. With `broken_off` there may be exposures of true and asked durations (µs) that
    /// were not answered as done.
    fn compare_exposures(&mut self, broken_off: fn(u32, u32) -> bool) {
        let mut truths = self.rig.take_exposures().into_iter().peekable();
        let take_up = configuration().axes[0].take_up_steps;
        let round = std::mem::take(&mut self.round);
        let exposed = |id| matches!(self.answers.get(id), Some(Outcome::Done(Answer::Exposed(_))));
        // One that was broken off in its rest was not made at all: those answered as done must stay.
        let mut left = round.iter().filter(|(id, _)| exposed(id)).count();
        for (id, command) in round {
            match (command, self.answers.get(&id)) {
                (Command::MoveTo(targets), Some(Outcome::Done(Answer::At(at)))) => {
                    assert_eq!(*at, targets);
                    for (k, target) in targets.into_iter().enumerate() {
                        self.believed.received[k] += steps(self.believed.positions[k], target, take_up);
                    }
                    self.believed.positions = targets;
                    self.seen.moves += 1;
                }
                (Command::Lamp { level, .. }, Some(Outcome::Done(_))) => self.believed.level = level,
                (Command::Expose { duration_us, .. }, Some(Outcome::Done(Answer::Exposed(exposure)))) => {
                    let truth = truths.next().expect("an exposure was answered and not made");
                    left -= 1;
                    assert_eq!(exposure.open_us, duration_us);
                    assert_eq!((truth.open_s * 1e6).round() as u32, duration_us);
                    let level = f64::from(self.believed.level) / 65535.0;
                    assert!((truth.lamp_relative - level).abs() < 1e-9, "{truth:?}, {level}");
                    let angles = truth.axes_rad.map(|angle| angle.to_degrees().round() as i64);
                    assert_eq!(angles, self.motors_believed(), "exposed in another pose");
                    self.seen.exposures += 1;
                }
                (Command::Expose { duration_us, .. }, _)
                    if truths.len() > left
                        && truths
                            .peek()
                            .is_some_and(|t| broken_off((t.open_s * 1e6) as u32, duration_us)) =>
                {
                    truths.next();
                }
                (Command::MoveTo(targets), Some(Outcome::Refused(Refusal::OutOfLimits(Axis::Pan)))) => {
                    assert_eq!(targets[0], 99);
                }
                (_, Some(Outcome::Refused(Refusal::Skipped { after }))) => assert!(*after < id),
                (Command::Status, Some(Outcome::Done(Answer::Status(_)))) => {}
                (_, None | Some(Outcome::Refused(Refusal::Stopped))) if id < self.stop => {}
                (Command::Stop, Some(Outcome::Done(_))) if id == self.stop => {}
                other => panic!("{id}: {other:?}"),
            }
        }
        assert_eq!(truths.next(), None, "an exposure that was not asked for");
    }
}

/// Drives a rig until so many frames were disturbed; gives what was seen, and the number of frames.
fn drive(seed: u64, frames: u64) -> (Seen, u64) {
    let faults = FaultRates {
        lost: 4e-3,
        flipped: 4e-3,
        doubled: 2e-3,
        delayed: 1e-3,
        swapped: 2e-3,
        garbage: 2e-3,
        frames: 0.1,
    };
    let mut host = Host::new(seed, faults);
    while host.rig.line_counts().disturbed < frames {
        host.round();
    }
    (host.seen, host.rig.line_counts().frames)
}

/// So often did each thing happen that the test shows something.
fn assert_eventful(seen: &Seen, least: u64) {
    let Seen { moves, exposures, stops, faults, resets, cuts } = *seen;
    println!("{seen:?}");
    assert!(moves > 10 * least && exposures > 10 * least, "{seen:?}");
    assert!(stops.min(faults).min(resets).min(cuts) > least, "{seen:?}");
}

#[test]
fn nothing_wrong_and_nothing_twice_over_a_hundred_thousand_faulted_frames() {
    let (seen, frames) = drive(1, 100_000);
    println!("{frames} frames");
    assert_eventful(&seen, 20);
}

#[test]
#[ignore = "long: minutes: cargo xtask long"]
fn nothing_wrong_and_nothing_twice_over_ten_million_faulted_frames() {
    let drives = (1..=10).map(|seed| std::thread::spawn(move || drive(seed, 1_000_000)));
    for drive in drives.collect::<Vec<_>>() {
        let (seen, frames) = drive.join().unwrap();
        println!("{frames} frames");
        assert_eventful(&seen, 200);
    }
}

#[test]
fn the_same_seed_gives_the_same_run() {
    assert_eq!(drive(7, 2000), drive(7, 2000));
}
