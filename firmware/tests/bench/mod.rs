//! A bench for the controller: pins that write down what they are told and when.
#![allow(clippy::unwrap_used)]
#![allow(dead_code, reason = "each test uses its part")]

pub(crate) mod devices;
mod parameters;

pub(crate) use parameters::configuration;

use std::cell::RefCell;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use embedded_hal::digital::{self, InputPin, OutputPin};
use embedded_hal::pwm::{self, SetDutyCycle};
use lobelia_firmware::safety::EmergencyStop;
use lobelia_firmware::storage::Storage;
use lobelia_firmware::{
    AnalogInput, AxisPins, Board, ByteLink, Controller, Options, Peripherals, Pulses, Readings, Vitals,
    Watchdog,
};
use lobelia_protocol::{
    self as protocol, Command, Configuration, CrashCause, CrashRecord, FrameDecoder, Hello, Outcome, Pins,
    Refusal, Request, Response, ToController, ToHost,
};

/// Where the home switch closes, in motor steps from where the rig was switched on.
pub(crate) const SWITCH_AT: i64 = -700;

/// What the pins did and see.
#[derive(Default)]
pub(crate) struct Bench {
    pub(crate) now_us: u64,
    pub(crate) motors: [i64; 4],
    up: [bool; 4],
    level: [bool; 4],
    pub(crate) enabled: [bool; 4],
    /// Time and direction of each step of each axis.
    pub(crate) steps: [Vec<(u64, bool)>; 4],
    /// Motor position at which the switch is; closed below, or above with `switch_up`.
    pub(crate) switch_up: bool,
    pub(crate) shutter: Vec<(u64, bool)>,
    pub(crate) lamp: bool,
    pub(crate) fan: bool,
    /// How often the heartbeat has changed.
    pub(crate) beats: u32,
    pub(crate) stop_pressed: bool,
    pub(crate) alarm: [bool; 4],
    /// Pins that are wired the other way round, of each axis and of the rest; and how often an output was
    /// written.
    pub(crate) inverted: ([Pins; 4], Pins),
    pub(crate) writes: u32,
    pub(crate) hot: bool,
    pub(crate) diode_broken: bool,
    /// What the controller wrote has not left yet.
    pub(crate) line_busy: bool,
    /// The link takes no bytes from the controller.
    pub(crate) line_stuck: bool,
    pub(crate) lamp_level: u16,
    pub(crate) camera_ready_us: u64,
    pub(crate) devices: devices::Devices,
    /// The photodiode's readings, in turn; 1234 where there are none.
    pub(crate) readings: VecDeque<u16>,
    /// The home switches bounce, and until when they do.
    pub(crate) bouncy: bool,
    bounces_until_us: [u64; 4],
    /// How far each home switch has been moved.
    pub(crate) switch_shift: [i64; 4],
    pub(crate) pulse_too_short: bool,
    edge_us: [u64; 4],
    to_controller: VecDeque<u8>,
    to_host: Vec<u8>,
}

type Shared = Rc<RefCell<Bench>>;

#[derive(Clone, Copy)]
enum Role {
    Step(usize),
    Direction(usize),
    Enable(usize),
    Home(usize),
    Shutter,
    Lamp,
    Fan,
    Heartbeat,
    Stop,
    Alarm(usize),
    Hot,
    CameraReady,
}

pub(crate) struct Pin(Shared, Role);
pub(crate) struct Dimmer(Shared);
pub(crate) struct Diode(Shared);
pub(crate) struct Wire(Shared);
pub(crate) struct TestBoard;
struct Dog(Arc<AtomicU32>);

impl Watchdog for Dog {
    fn feed(&mut self) {
        self.0.fetch_add(1, Relaxed);
    }
}

/// What a board tells of itself.
struct Signs;

impl Vitals for Signs {
    fn stack(&mut self) -> Option<[u32; 2]> {
        Some([3000, 8000])
    }
    fn overruns(&mut self) -> u32 {
        7
    }
    fn supply_mv(&mut self) -> Option<u16> {
        Some(3300)
    }
}

impl Board for TestBoard {
    type Output = Pin;
    type StepPort = [Pin; 4];
    type Pulses = Pulses<Self>;
    type Input = Pin;
    type LampLevel = Dimmer;
    type Photodiode = Diode;
    type Link = Wire;
}

impl digital::ErrorType for Pin {
    type Error = Infallible;
}

impl Pin {
    /// Whether the rig has it the other way round.
    fn is_inverted(&self, (axes, rest): ([Pins; 4], Pins)) -> bool {
        match self.1 {
            Role::Step(axis) => axes[axis].contains(protocol::Pin::Step),
            Role::Direction(axis) => axes[axis].contains(protocol::Pin::Direction),
            Role::Enable(axis) => axes[axis].contains(protocol::Pin::Enable),
            Role::Home(axis) => axes[axis].contains(protocol::Pin::Home),
            Role::Alarm(axis) => axes[axis].contains(protocol::Pin::Alarm),
            Role::Shutter => rest.contains(protocol::Pin::Shutter),
            Role::Lamp => rest.contains(protocol::Pin::Lamp),
            Role::Fan => rest.contains(protocol::Pin::Fan),
            Role::Hot => rest.contains(protocol::Pin::OverTemperature),
            Role::CameraReady => rest.contains(protocol::Pin::CameraReady),
            Role::Heartbeat | Role::Stop => false,
        }
    }

    fn set(&self, high: bool) {
        let bench = &mut *self.0.borrow_mut();
        let high = high != self.is_inverted(bench.inverted);
        bench.writes += u32::from(!matches!(self.1, Role::Heartbeat));
        let now = bench.now_us;
        match self.1 {
            Role::Step(axis) if bench.level[axis] != high => {
                bench.pulse_too_short |= now < bench.edge_us[axis] + 2;
                bench.edge_us[axis] = now;
                bench.level[axis] = high;
                if high {
                    assert!(bench.enabled[axis], "a step without a holding motor is lost");
                    bench.motors[axis] += if bench.up[axis] { 1 } else { -1 };
                    let edge = if bench.up[axis] { SWITCH_AT + 1 } else { SWITCH_AT };
                    if bench.bouncy && bench.motors[axis] == edge {
                        bench.bounces_until_us[axis] = now + 1000;
                    }
                    bench.steps[axis].push((now, bench.up[axis]));
                }
            }
            Role::Direction(axis) => bench.up[axis] = high,
            Role::Enable(axis) => bench.enabled[axis] = high,
            Role::Shutter => bench.shutter.push((now, high)),
            Role::Lamp => bench.lamp = high,
            Role::Fan => bench.fan = high,
            Role::Heartbeat => bench.beats += 1,
            Role::Step(_) | Role::Home(_) | Role::Stop | Role::Alarm(_) | Role::Hot | Role::CameraReady => {}
        }
    }
}

impl OutputPin for Pin {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.set(false);
        Ok(())
    }
    fn set_high(&mut self) -> Result<(), Infallible> {
        self.set(true);
        Ok(())
    }
}

impl InputPin for Pin {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        let bench = self.0.borrow();
        let active = match self.1 {
            Role::Alarm(axis) => bench.alarm[axis],
            Role::Hot => bench.hot,
            Role::CameraReady => bench.now_us >= bench.camera_ready_us,
            // A contact bounces for 1 ms at each edge.
            Role::Home(axis) if bench.now_us < bench.bounces_until_us[axis] => {
                (bench.now_us / 64).is_multiple_of(2)
            }
            Role::Home(axis) if bench.switch_up => bench.motors[axis] >= -SWITCH_AT,
            Role::Home(axis) => bench.motors[axis] <= SWITCH_AT + bench.switch_shift[axis],
            Role::Stop => bench.stop_pressed,
            _ => false,
        };
        Ok(active != self.is_inverted(bench.inverted))
    }
    fn is_low(&mut self) -> Result<bool, Infallible> {
        self.is_high().map(|high| !high)
    }
}

impl pwm::ErrorType for Dimmer {
    type Error = Infallible;
}

impl SetDutyCycle for Dimmer {
    fn max_duty_cycle(&self) -> u16 {
        1000
    }
    fn set_duty_cycle(&mut self, level: u16) -> Result<(), Infallible> {
        self.0.borrow_mut().lamp_level = level;
        Ok(())
    }
}

impl AnalogInput for Diode {
    fn read(&mut self) -> Option<u16> {
        if self.0.borrow().diode_broken {
            return None;
        }
        let readings = &mut self.0.borrow_mut().readings;
        readings.rotate_left(usize::from(!readings.is_empty()));
        Some(readings.back().copied().unwrap_or(1234))
    }
    fn begin(&mut self, duration_us: u32) -> bool {
        let bench = &mut *self.0.borrow_mut();
        bench.devices.begin_readings(bench.now_us, duration_us)
    }
    fn gather(&mut self) -> Option<Readings> {
        let bench = &mut *self.0.borrow_mut();
        (!bench.diode_broken).then(|| bench.devices.gather(bench.now_us))
    }
}

impl ByteLink for Wire {
    fn read(&mut self) -> Option<u8> {
        self.0.borrow_mut().to_controller.pop_front()
    }
    fn write(&mut self, byte: u8) -> bool {
        let bench = &mut *self.0.borrow_mut();
        if !bench.line_stuck {
            bench.to_host.push(byte);
        }
        !bench.line_stuck
    }
    fn is_idle(&self) -> bool {
        !self.0.borrow().line_busy
    }
}

/// A controller on its bench, and a host that talks to it.
pub(crate) struct Rig {
    pub(crate) bench: Shared,
    pub(crate) emergency_stop: &'static EmergencyStop,
    /// How often the watchdog was fed.
    pub(crate) meals: Arc<AtomicU32>,
    controller: Controller<TestBoard>,
    decoder: FrameDecoder,
    next_id: u32,
}

/// The session that [`Rig::greeted`] opens.
pub(crate) const SESSION: u32 = 77;

impl Rig {
    pub(crate) fn new() -> Self {
        Self::build(None, |_| {})
    }

    /// With memory for parameters.
    pub(crate) fn with_storage(storage: &'static mut (dyn Storage + Send)) -> Self {
        Self::build(Some(storage), |_| {})
    }

    /// With another set of what a board may have.
    pub(crate) fn with_options(change: impl FnOnce(&mut Options<TestBoard>)) -> Self {
        Self::build(None, change)
    }

    fn build(
        storage: Option<&'static mut (dyn Storage + Send)>,
        change: impl FnOnce(&mut Options<TestBoard>),
    ) -> Self {
        let bench = Shared::default();
        devices::attach(&bench);
        let pin = |role| Pin(Rc::clone(&bench), role);
        let peripherals = Peripherals {
            axes: std::array::from_fn(|axis| AxisPins {
                direction: pin(Role::Direction(axis)),
                enable: pin(Role::Enable(axis)),
                home: pin(Role::Home(axis)),
            }),
            steps: std::array::from_fn(|axis| pin(Role::Step(axis))),
            shutter: pin(Role::Shutter),
            lamp: pin(Role::Lamp),
            lamp_level: Dimmer(Rc::clone(&bench)),
            photodiode: Diode(Rc::clone(&bench)),
            emergency_stop: pin(Role::Stop),
            link: Wire(Rc::clone(&bench)),
        };
        let emergency_stop: &'static EmergencyStop = Box::leak(Box::new(EmergencyStop::new()));
        let meals = Arc::new(AtomicU32::new(0));
        let mut options = Options {
            alarm: std::array::from_fn(|axis| Some(pin(Role::Alarm(axis)))),
            alarms: None,
            over_temperature: Some(pin(Role::Hot)),
            camera_ready: Some(pin(Role::CameraReady)),
            drivers: None,
            storage,
            emergency_stop: Some(emergency_stop),
            watchdog: Some(Box::leak(Box::new(Dog(Arc::clone(&meals))))),
            fan: Some(pin(Role::Fan)),
            heartbeat: Some(pin(Role::Heartbeat)),
            timed_shutter: None,
            outputs: None,
            brown_out: None,
            most_steps_per_s: Some(30_000),
            bearable_late_us: lobelia_firmware::board::BEARABLE_LATE_US,
            vitals: Some(Box::leak(Box::new(Signs))),
            crash: Some(CrashRecord { cause: CrashCause::HardFault, place: 0x0800_1234 }),
        };
        change(&mut options);
        let controller = Controller::with_options(peripherals, options);
        Self { bench, emergency_stop, meals, controller, decoder: FrameDecoder::new(), next_id: 1 }
    }

    /// With a session, and nothing else.
    pub(crate) fn new_session() -> Self {
        let mut rig = Self::new();
        rig.open(SESSION);
        rig
    }

    /// With a session, and configured.
    pub(crate) fn greeted(configuration: Configuration) -> Self {
        Self::new().ready(configuration)
    }

    /// This one with a session, and configured.
    pub(crate) fn ready(mut self, configuration: Configuration) -> Self {
        let rig = &mut self;
        rig.open(SESSION);
        assert!(matches!(rig.configure(configuration), Outcome::Done(_)));
        rig.reopen();
        // All outputs were told to be off.
        rig.bench.borrow_mut().shutter.clear();
        self
    }

    /// With positions known too.
    pub(crate) fn homed() -> Self {
        Self::greeted(configuration()).at_home()
    }

    /// This one homed.
    pub(crate) fn at_home(mut self) -> Self {
        assert!(matches!(self.ask(Command::Home), Outcome::Done(_)));
        self.reopen();
        self.bench.borrow_mut().steps = Default::default();
        self
    }

    fn open(&mut self, session: u32) {
        self.send(&ToController::Hello(Hello::new(session)));
        self.received();
        self.next_id = 1;
    }

    /// Opens the session anew, so that a test's first request bears the id 1.
    fn reopen(&mut self) {
        self.open(!SESSION);
        self.open(SESSION);
    }

    pub(crate) fn send(&mut self, packet: &ToController) {
        self.bench.borrow_mut().to_controller.extend(packet.encode().unwrap());
        self.poll();
    }

    pub(crate) fn send_bytes(&mut self, bytes: &[u8]) {
        self.deliver(bytes);
        self.poll();
    }

    /// Puts bytes before the controller, which looks at them when it is polled next.
    pub(crate) fn deliver(&mut self, bytes: &[u8]) {
        self.bench.borrow_mut().to_controller.extend(bytes);
    }

    pub(crate) fn poll(&mut self) {
        let now = self.bench.borrow().now_us;
        self.controller.poll(now);
    }

    /// Sends a command under a new id; gives the id.
    pub(crate) fn begin(&mut self, command: Command) -> u32 {
        let id = self.next_id;
        self.next_id += 1;
        self.send(&ToController::Request(Request { session: SESSION, id, seen: id - 1, command }));
        id
    }

    /// Sets all parameters; gives the first refusal, or the last answer.
    pub(crate) fn configure(&mut self, configuration: Configuration) -> Outcome {
        let outcomes = configuration.commands().map(|command| self.ask(command));
        let refused = |outcome: &Outcome| matches!(outcome, Outcome::Refused(_));
        outcomes.into_iter().find(refused).unwrap_or(outcomes[outcomes.len() - 1])
    }

    /// Sends a command and lets time pass until it is answered.
    pub(crate) fn ask(&mut self, command: Command) -> Outcome {
        let id = self.begin(command);
        self.outcome(id)
    }

    /// Lets time pass until a request is answered.
    pub(crate) fn outcome(&mut self, id: u32) -> Outcome {
        loop {
            for packet in self.received() {
                if let ToHost::Response(Response { id: answered, outcome, .. }) = packet
                    && answered == id
                    && outcome != Outcome::Running
                {
                    return outcome;
                }
            }
            assert!(self.pass_event(), "request {id} is never answered");
        }
    }

    /// The outcome of a request, if it has come by now.
    pub(crate) fn answered(&mut self, id: u32) -> Option<Outcome> {
        self.received().into_iter().find_map(|packet| match packet {
            ToHost::Response(response) if response.id == id && response.outcome != Outcome::Running => {
                Some(response.outcome)
            }
            _ => None,
        })
    }

    /// Lets time pass until the next event; false when there is none.
    pub(crate) fn pass_event(&mut self) -> bool {
        let next = self.controller.next_event_us();
        if next == u64::MAX {
            return false;
        }
        let now = self.bench.borrow().now_us.max(next);
        self.bench.borrow_mut().now_us = now;
        self.controller.tick(now);
        true
    }

    /// What the controller has sent.
    pub(crate) fn received(&mut self) -> Vec<ToHost> {
        let bytes = std::mem::take(&mut self.bench.borrow_mut().to_host);
        let mut packets = Vec::new();
        for byte in bytes {
            if let Some(Ok(payload)) = self.decoder.push(byte) {
                packets.push(ToHost::decode(payload).unwrap());
            }
        }
        packets
    }

    /// When the controller wants to be polled next.
    pub(crate) fn next_event_us(&self) -> u64 {
        self.controller.next_event_us()
    }

    /// Which axes move, by asking the controller without a packet.
    pub(crate) fn moving(&self) -> [bool; 4] {
        self.controller.moving()
    }

    /// Steps made by all axes.
    pub(crate) fn step_count(&self) -> usize {
        self.bench.borrow().steps.iter().map(Vec::len).sum()
    }
}

/// The refusal that an outcome must be.
pub(crate) fn refusal(outcome: Outcome) -> Refusal {
    match outcome {
        Outcome::Refused(refusal) => refusal,
        other => panic!("not refused: {other:?}"),
    }
}
