//! A rig on which the steps' interrupt runs by a timer of its own and breaks into the controller's polls
//! anywhere.
//!
//! Time passes in ns with everything that is done: each access to a pin, each look at the steps, each read of
//! the timer. Wherever the controller is not inside its critical section the interrupt runs when it is due,
//! late by a random time; polls last as long as they are told to. The controller's clock is the step timer's,
//! or one that drifts and skips against it.
#![allow(clippy::unwrap_used)]

use std::cell::{Cell, RefCell};
use std::collections::{HashMap, VecDeque};
use std::rc::Rc;

use lobelia_firmware::safety::alarm::Alarms;
use lobelia_firmware::{AxisPins, Controller, Options, Peripherals, Pulses, PulsesCell};
use lobelia_protocol::{
    self as protocol, Answer, Command, Configuration, FrameDecoder, Hello, Outcome, Request, Status,
    ToController, ToHost,
};

use crate::pins::{Dimmer, Diode, Pin, Role, TwoClocks, Wire};

/// Motor position at which each home switch is closed, and below.
pub(crate) const SWITCH_AT: i64 = -700;
const SESSION: u32 = 7;
/// An answer that takes longer never comes, ns.
const PATIENCE_NS: u64 = 120_000_000_000;

/// A step that a driver saw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Step {
    pub(crate) at_ns: u64,
    pub(crate) up: bool,
}

/// How long things take; each time is between nothing and this, ns.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Costs {
    /// From when the interrupt is due until it runs.
    pub(crate) latency_ns: u64,
    /// A look at the steps, in the main loop: planning a burst or two.
    pub(crate) look_ns: u64,
    /// Each poll besides.
    pub(crate) poll_ns: u64,
    /// One poll in so many lasts `long_ns` besides; 0 for none.
    pub(crate) long_every: u64,
    pub(crate) long_ns: u64,
}

impl Costs {
    /// A board that has nothing else to do.
    pub(crate) const LIGHT: Self =
        Self { latency_ns: 2000, look_ns: 2000, poll_ns: 50_000, long_every: 0, long_ns: 0 };
}

/// What the pins did and see.
pub(crate) struct World {
    pub(crate) ns: u64,
    pub(crate) costs: Costs,
    state: u64,
    /// When the interrupt is due, as the step timer counts; and whether it was made to run.
    due: Option<u32>,
    pended: bool,
    pub(crate) motors: [i64; 4],
    pub(crate) up: [bool; 4],
    pub(crate) turned_ns: [u64; 4],
    level: [bool; 4],
    edge_ns: [u64; 4],
    pub(crate) enabled: [bool; 4],
    pub(crate) steps: [Vec<Step>; 4],
    /// Of all pulses, of all pauses between pulses, and from a change of direction to the next step.
    pub(crate) shortest_high_ns: u64,
    pub(crate) shortest_low_ns: u64,
    pub(crate) shortest_setup_ns: u64,
    /// What a switch reads as, whatever it is.
    pub(crate) stuck: [Option<bool>; 4],
    /// From when to when an axis's switch reads as it is not.
    pub(crate) glitch: Option<(usize, u64, u64)>,
    /// One look at a switch in so many is wrong; 0 for none.
    pub(crate) noise_every: u64,
    pub(crate) lamp: bool,
    pub(crate) dimmer_broken: bool,
    pub(crate) level_set: u16,
    pub(crate) stop_pressed: bool,
    /// Whether every pin of every axis is wired the other way round.
    pub(crate) inverted: bool,
    /// Of which axis, and from when to when, an alarm input is active: in order, one after the other.
    pub(crate) alarms: VecDeque<(usize, u64, u64)>,
    /// When the alarms' interrupt is due next.
    alarm_due_ns: Option<(usize, u64)>,
    pub(crate) to_controller: VecDeque<u8>,
    pub(crate) to_host: Vec<u8>,
}

impl World {
    /// A number below another.
    fn random(&mut self, below: u64) -> u64 {
        self.state ^= self.state << 13;
        self.state ^= self.state >> 7;
        self.state ^= self.state << 17;
        ((u128::from(self.state) * u128::from(below)) >> 64) as u64
    }

    pub(crate) fn spend(&mut self, most_ns: u64) {
        self.ns += self.random(most_ns + 1);
    }

    fn timer(&self) -> u32 {
        (self.ns / 1000) as u32
    }

    fn is_due(&self) -> bool {
        self.pended || self.due.is_some_and(|due| due.wrapping_sub(self.timer()) as i32 <= 0)
    }

    /// When the interrupt is due, ns.
    fn due_ns(&self) -> Option<u64> {
        let wait = |due: u32| u64::from((due.wrapping_sub(self.timer()) as i32).max(0) as u32);
        self.due.map(|due| if wait(due) == 0 { self.ns } else { (self.ns / 1000 + wait(due)) * 1000 })
    }

    pub(crate) fn step_pin(&mut self, axis: usize, high: bool) {
        if self.level[axis] == high {
            return;
        }
        let (now, since) = (self.ns, self.ns - self.edge_ns[axis]);
        self.level[axis] = high;
        self.edge_ns[axis] = now;
        if !high {
            self.shortest_high_ns = self.shortest_high_ns.min(since);
            return;
        }
        assert!(self.enabled[axis], "a step without a holding motor is lost");
        self.shortest_low_ns = self.shortest_low_ns.min(since);
        self.shortest_setup_ns = self.shortest_setup_ns.min(now - self.turned_ns[axis]);
        self.motors[axis] += if self.up[axis] { 1 } else { -1 };
        self.steps[axis].push(Step { at_ns: now, up: self.up[axis] });
    }

    /// Whether a pin is wired the other way round.
    pub(crate) fn is_inverted(&self, role: Role) -> bool {
        let of_axis = matches!(
            role,
            Role::Step(_) | Role::Direction(_) | Role::Enable(_) | Role::Home(_) | Role::Alarm(_)
        );
        self.inverted && of_axis
    }

    /// Whether an axis's alarm input is active.
    pub(crate) fn alarm(&self, axis: usize) -> bool {
        self.alarms.iter().any(|&(of, from, to)| of == axis && (from..to).contains(&self.ns))
    }

    /// The next change of an alarm input after a time.
    fn next_alarm(&self, after_ns: u64) -> Option<(usize, u64)> {
        let edges = self.alarms.iter().flat_map(|&(axis, from, to)| [(axis, from), (axis, to)]);
        edges.filter(|&(_, at)| at > after_ns).min_by_key(|&(_, at)| at)
    }

    /// Has alarm inputs be active from now on as told: each of an axis, from when, for so long.
    pub(crate) fn ring(&mut self, alarms: impl IntoIterator<Item = (usize, u64, u64)>) {
        self.alarms = alarms.into_iter().map(|(axis, from, lasts)| (axis, from, from + lasts)).collect();
        self.alarm_due_ns = self.next_alarm(self.ns);
    }

    pub(crate) fn switch(&mut self, axis: usize) -> bool {
        let now = self.ns;
        if let Some(stuck) = self.stuck[axis] {
            return stuck;
        }
        let closed = self.motors[axis] <= SWITCH_AT;
        let glitch = self.glitch.is_some_and(|(of, from, to)| of == axis && (from..to).contains(&now));
        let noise = self.noise_every > 0 && self.random(self.noise_every) == 0;
        closed != (glitch || noise)
    }
}

pub(crate) type Shared = Rc<RefCell<World>>;

thread_local! {
    static PULSES: RefCell<Option<Pulses<TwoClocks>>> = const { RefCell::new(None) };
    static WORLD: RefCell<Option<Shared>> = const { RefCell::new(None) };
    static ALARMS: &'static Alarms = Box::leak(Box::new(Alarms::new()));
    static IN_INTERRUPT: Cell<bool> = const { Cell::new(false) };
}

fn world() -> Shared {
    WORLD.with(|world| Rc::clone(world.borrow().as_ref().unwrap()))
}

/// Runs the interrupt while it is due, unless it is running or shut out.
pub(crate) fn let_interrupt() {
    let world = world();
    if IN_INTERRUPT.get() || PULSES.with(|pulses| pulses.try_borrow_mut().is_err()) {
        return;
    }
    alarm_interrupts(&world);
    while world.borrow().is_due() {
        interrupt(&world);
    }
}

/// Runs the alarms' interrupt for each change that has come.
fn alarm_interrupts(shared: &Shared) {
    let world = &mut *shared.borrow_mut();
    while let Some((axis, at_ns)) = world.alarm_due_ns.filter(|&(_, at_ns)| at_ns <= world.ns) {
        let latency_ns = world.costs.latency_ns;
        world.spend(latency_ns);
        world.alarm_due_ns = world.next_alarm(at_ns);
        let high = world.alarm(axis) != world.is_inverted(Role::Alarm(axis));
        let count = world.timer();
        ALARMS.with(|alarms| alarms.changed(axis, high, count));
    }
}

fn interrupt(shared: &Shared) {
    IN_INTERRUPT.set(true);
    {
        let mut world = shared.borrow_mut();
        world.pended = false;
        let latency_ns = world.costs.latency_ns;
        world.spend(latency_ns);
    }
    let clock = || {
        let mut world = shared.borrow_mut();
        let count = world.timer();
        world.spend(300);
        count
    };
    let due = PULSES.with(|pulses| pulses.borrow_mut().as_mut().unwrap().step(clock));
    shared.borrow_mut().due = due;
    IN_INTERRUPT.set(false);
}

/// Lets time pass, with the interrupt when it is due.
fn pass_until(shared: &Shared, end_ns: u64) {
    loop {
        let due_ns = shared.borrow().due_ns();
        let alarm_ns = shared.borrow().alarm_due_ns.map(|(_, at)| at).filter(|&at| at <= end_ns);
        if let Some(at) = alarm_ns
            && due_ns.is_none_or(|due_ns| at <= due_ns)
        {
            let now_ns = shared.borrow().ns;
            shared.borrow_mut().ns = at.max(now_ns);
            alarm_interrupts(shared);
            continue;
        }
        let Some(due_ns) = due_ns.filter(|&due_ns| due_ns <= end_ns) else { break };
        let now_ns = shared.borrow().ns;
        shared.borrow_mut().ns = due_ns.max(now_ns);
        interrupt(shared);
    }
    let now_ns = shared.borrow().ns;
    shared.borrow_mut().ns = end_ns.max(now_ns);
}

/// The controller's way to the steps, without the interrupt, which runs as soon as it may.
pub(crate) struct Steps(());

impl PulsesCell<TwoClocks> for Steps {
    fn keep(pulses: Pulses<TwoClocks>) -> Self {
        PULSES.with(|kept| *kept.borrow_mut() = Some(pulses));
        Self(())
    }

    fn with<R>(&mut self, does: impl FnOnce(&mut Pulses<TwoClocks>) -> R) -> R {
        let shared = world();
        let look_ns = shared.borrow().costs.look_ns;
        let lasts_ns = shared.borrow_mut().random(look_ns + 1);
        let end_ns = shared.borrow().ns + lasts_ns;
        pass_until(&shared, end_ns);
        let_interrupt();
        let result = PULSES.with(|kept| does(kept.borrow_mut().as_mut().unwrap()));
        let_interrupt();
        result
    }
}

/// The controller's clock against the step timer.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Skew {
    /// It is behind by so many µs, or ahead where negative.
    pub(crate) behind_us: i64,
    /// And loses so many µs each s.
    pub(crate) drift_ppm: i64,
}

/// A controller whose main loop runs, and a host that talks to it.
pub(crate) struct Rig {
    pub(crate) world: Shared,
    pub(crate) skew: Skew,
    controller: Controller<TwoClocks>,
    decoder: FrameDecoder,
    last_id: u32,
    /// Final answers that have come.
    answers: HashMap<u32, Outcome>,
    polls: u64,
    /// Whether the host is heard whenever it waits.
    pub(crate) heard: bool,
}

impl Rig {
    pub(crate) fn new(seed: u64, costs: Costs) -> Self {
        let world = Rc::new(RefCell::new(World {
            ns: 1_000_000,
            costs,
            state: seed.max(1).wrapping_mul(0x9e37_79b9_7f4a_7c15),
            due: None,
            pended: false,
            motors: [0; 4],
            up: [false; 4],
            turned_ns: [0; 4],
            level: [false; 4],
            edge_ns: [0; 4],
            enabled: [false; 4],
            steps: Default::default(),
            shortest_high_ns: u64::MAX,
            shortest_low_ns: u64::MAX,
            shortest_setup_ns: u64::MAX,
            stuck: [None; 4],
            glitch: None,
            noise_every: 0,
            lamp: false,
            dimmer_broken: false,
            level_set: 0,
            stop_pressed: false,
            inverted: false,
            alarms: VecDeque::new(),
            alarm_due_ns: None,
            to_controller: VecDeque::new(),
            to_host: Vec::new(),
        }));
        WORLD.with(|kept| *kept.borrow_mut() = Some(Rc::clone(&world)));
        let pin = |role| Pin(Rc::clone(&world), role);
        let options = Options {
            alarm: std::array::from_fn(|axis| Some(pin(Role::Alarm(axis)))),
            alarms: Some(ALARMS.with(|alarms| *alarms)),
            ..Options::default()
        };
        let peripherals = Peripherals {
            axes: std::array::from_fn(|axis| AxisPins {
                direction: pin(Role::Direction(axis)),
                enable: pin(Role::Enable(axis)),
                home: pin(Role::Home(axis)),
            }),
            steps: std::array::from_fn(|axis| pin(Role::Step(axis))),
            shutter: pin(Role::Shutter),
            lamp: pin(Role::Lamp),
            lamp_level: Dimmer(Rc::clone(&world)),
            photodiode: Diode,
            emergency_stop: pin(Role::Stop),
            link: Wire(Rc::clone(&world)),
        };
        let controller = Controller::with_options(peripherals, options);
        let decoder = FrameDecoder::new();
        let skew = Skew::default();
        let mut rig = Self {
            world,
            skew,
            controller,
            decoder,
            last_id: 0,
            answers: HashMap::new(),
            polls: 0,
            heard: true,
        };
        rig.send(&ToController::Hello(Hello::new(SESSION)));
        rig.turn();
        rig
    }

    /// With parameters set and positions known.
    pub(crate) fn homed(seed: u64, costs: Costs, configuration: &Configuration) -> Self {
        let mut rig = Self::new(seed, Costs::LIGHT);
        rig.world.borrow_mut().inverted = configuration.axes[0].inverted != protocol::Pins::NONE;
        rig.configure(configuration);
        let homed = rig.ask(Command::Home);
        assert!(matches!(homed, Outcome::Done(_)), "{homed:?}");
        rig.world.borrow_mut().costs = costs;
        rig
    }

    pub(crate) fn configure(&mut self, configuration: &Configuration) {
        for command in configuration.commands() {
            let outcome = self.ask(command);
            assert!(matches!(outcome, Outcome::Done(_)), "{outcome:?}");
        }
    }

    fn send(&mut self, packet: &ToController) {
        self.world.borrow_mut().to_controller.extend(packet.encode().unwrap());
    }

    pub(crate) fn ns(&self) -> u64 {
        self.world.borrow().ns
    }

    /// The time by the controller's clock, µs.
    fn main_us(&self) -> u64 {
        let us = (self.ns() / 1000) as i64;
        let drift = us / 1000 * self.skew.drift_ppm / 1000;
        (us - self.skew.behind_us - drift).max(0) as u64
    }

    /// Once round the main loop: polls, wakes the interrupt, and rests until something is due, a millisecond
    /// at most.
    pub(crate) fn turn(&mut self) {
        let now_us = self.main_us();
        self.world.borrow_mut().spend(3000);
        let_interrupt();
        self.controller.poll(now_us);
        self.polls += 1;
        let costs = self.world.borrow().costs;
        let long = costs.long_every > 0 && self.polls.is_multiple_of(costs.long_every);
        let most_ns = costs.poll_ns + if long { costs.long_ns } else { 0 };
        let lasts_ns = self.world.borrow_mut().random(most_ns + 1);
        self.stand(lasts_ns);
        self.world.borrow_mut().pended = true;
        let_interrupt();
        let left_us = self.controller.next_poll_us().saturating_sub(self.main_us()).min(1000);
        self.stand(left_us * 1000);
    }

    /// The main loop does nothing for so long; the interrupt goes on.
    pub(crate) fn stand(&mut self, ns: u64) {
        let end_ns = self.ns() + ns;
        pass_until(&self.world, end_ns);
    }

    pub(crate) fn begin(&mut self, command: Command) -> u32 {
        self.last_id += 1;
        let id = self.last_id;
        self.send(&ToController::Request(Request { session: SESSION, id, seen: id - 1, command }));
        self.turn();
        id
    }

    /// Runs for so long.
    pub(crate) fn run(&mut self, ns: u64) {
        let end_ns = self.ns() + ns;
        while self.ns() < end_ns {
            self.hear();
            self.turn();
        }
    }

    fn hear(&mut self) {
        if self.heard {
            let now_us = self.main_us();
            self.controller.keep_alive(now_us);
        }
    }

    /// Runs until a request is answered; `Running` when it never is.
    pub(crate) fn outcome(&mut self, id: u32) -> Outcome {
        let end_ns = self.ns() + PATIENCE_NS;
        while self.ns() < end_ns {
            self.receive();
            if let Some(outcome) = self.answers.get(&id) {
                return *outcome;
            }
            self.hear();
            self.turn();
        }
        Outcome::Running
    }

    fn receive(&mut self) {
        let bytes = std::mem::take(&mut self.world.borrow_mut().to_host);
        for byte in bytes {
            if let Some(Ok(payload)) = self.decoder.push(byte)
                && let ToHost::Response(response) = ToHost::decode(payload).unwrap()
                && response.outcome != Outcome::Running
            {
                self.answers.insert(response.id, response.outcome);
            }
        }
    }

    pub(crate) fn ask(&mut self, command: Command) -> Outcome {
        let id = self.begin(command);
        self.outcome(id)
    }

    pub(crate) fn status(&mut self) -> Status {
        match self.ask(Command::Status) {
            Outcome::Done(Answer::Status(status)) => status,
            other => panic!("no status: {other:?}"),
        }
    }

    /// Forgets the steps made so far.
    pub(crate) fn forget_steps(&mut self) {
        self.world.borrow_mut().steps = Default::default();
    }
}
