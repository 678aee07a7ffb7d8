//! The controller: takes packets from the link, runs one long command at a time, and stops everything on a
//! fault.

mod drivers;
mod lease;
mod light;
mod moves;
mod requests;
mod safe;
mod watch;
mod wiring;

use core::array;

use heapless::Deque;
use lobelia_protocol::{
    AXES, Answer, Axis, AxisParameters, Configuration, Event, Fault, FaultReport, KEEP_OUTS, KeepOut,
    Outcome, Refusal, Request, Status, ToController,
};

use crate::board::{AxisPins, Board, Options, Peripherals};
use crate::homing::{Homing, Purpose};
use crate::lamp::Lamp;
use crate::link::Link;
use crate::motion::axis::AxisDrive;
use crate::motion::changes::Changes;
use crate::motion::keep_out::Sweep;
use crate::motion::pulses::{Pulses, PulsesCell};
use crate::pin::{Line, PinFailure, set};
use crate::safety::alarm::Alarms;
use crate::safety::{EmergencyStop, Safety};
use crate::shutter::Shutter;
use watch::Watch;
use wiring::{Lines, Wiring};

/// A loop that comes this much too late, in µs, doesn't feed the watchdog.
const LATE_US: u64 = 1000;

/// By then the supply has risen for good after power-up, µs.
const SUPPLY_RISEN_US: u64 = 1_000_000;

/// A command that takes time, being run.
#[derive(Debug)]
enum Task {
    /// Axes run to their targets; then they settle for `settle_ms`.
    Move { settle_ms: u16 },
    /// Axes brake, or go on to new targets; then all move to them.
    Turn { targets: [i32; AXES] },
    /// Drivers are set up; then axes search for their switches.
    BeginHoming(Purpose, [bool; AXES]),
    /// Axes search for their switches: those that were chosen, one group of the order after the other.
    Home(Purpose, [bool; AXES], [Option<Homing>; AXES]),
    /// Axes have come to rest, after a move or else after a search that found something, and settle.
    Settle { until_us: u64, found: Option<Answer> },
    /// The shutter rests, or the camera isn't ready yet; is looked at again at `look_us`.
    AwaitCamera { look_us: u64, until_us: u64, duration_us: u32, warm_lamp: bool },
    /// The shutter is open; with `lit` the lamp must be seen.
    Expose { lit: bool },
    /// Axes come to rest because of a stop.
    Stop,
}

/// The task, and the request to answer at its end unless its session is over.
#[derive(Debug)]
struct Running {
    task: Task,
    request: Option<u32>,
}

/// Requests that may wait for their turn.
const WAITING: usize = 4;

/// Why a command was not begun.
enum Trouble {
    Refusal(Refusal),
    Pin,
}

impl From<Refusal> for Trouble {
    fn from(refusal: Refusal) -> Self {
        Self::Refusal(refusal)
    }
}

impl From<PinFailure> for Trouble {
    fn from(_: PinFailure) -> Self {
        Self::Pin
    }
}

/// While axes move the controller does more than steps at least this often, in µs.
const POLL_EVERY_US: u64 = 500;
/// While no axis moves and a homing waits for its switch to be steady, it looks this often, in µs.
const LOOK_EVERY_US: u64 = 100;

/// The controller of a rig.
pub struct Controller<B: Board> {
    axes: [AxisDrive<B>; AXES],
    pulses: B::Pulses,
    /// The time when the controller was last called, and when the next step is due.
    now_us: u64,
    step_us: Option<u32>,
    /// While axes move: when [`Self::poll`] is due.
    poll_us: Option<u64>,
    changes: Changes,
    options: Options<B>,
    lines: Lines<B>,
    /// How the pins were told that they are wired; nothing while no output may be driven.
    wiring: Option<Wiring>,
    /// What the alarm inputs are written down in where no interrupt does so; axes whose alarm was told.
    own_alarms: Alarms,
    alarmed: u8,
    lamp: Lamp<Line<B::Output>, B::LampLevel>,
    shutter: Shutter<Line<B::Output>>,
    photodiode: B::Photodiode,
    safety: Safety<B::Input>,
    link: Link<B::Link>,
    configuration: Option<Configuration>,
    /// Whether it was polled before, and has looked for stored parameters.
    started: bool,
    running: Option<Running>,
    /// Requests that wait for their turn, in order.
    waiting: Deque<Request, WAITING>,
    /// The last request that was refused, 0 for none in this session.
    refused: u32,
    /// Axis parameters, and keep-outs, for the next configuration.
    prepared: [Option<AxisParameters>; AXES],
    prepared_keep_outs: Option<[Option<KeepOut>; KEEP_OUTS]>,
    /// The positions that the present move passes.
    swept: [Sweep; AXES],
    /// What the parameters were saved as, until that is told, if by an older program.
    migrated: Option<u32>,
    /// Whether axes moved when the controller was last polled, and how long the longest of such polls took,
    /// µs.
    moved: bool,
    longest_poll_us: u32,
    watch: Watch,
    /// What the fan and the heartbeat were told last.
    fan_runs: bool,
    beat: bool,
    /// When the last request or hello came.
    heard_us: u64,
}

impl<B: Board> Controller<B> {
    /// A controller just switched on: nothing moves, the lamp is off, positions are unknown.
    pub fn new(peripherals: Peripherals<B>) -> Self {
        Self::with_options(peripherals, Options::default())
    }

    /// The same, on a board that has more than it needs.
    pub fn with_options(peripherals: Peripherals<B>, options: Options<B>) -> Self {
        let mut options = options;
        let lines = Lines::of(&mut options);
        let timed_shutter = options.timed_shutter.take();
        let Peripherals { axes, steps, shutter, lamp, lamp_level, photodiode, emergency_stop, link } =
            peripherals;
        let mut number = 0..;
        let [pan, tilt, roll, light] = axes.map(|AxisPins { direction, enable, home }| {
            (AxisDrive::new(number.next().unwrap_or(0), direction, enable), home)
        });
        let mut pulses = Pulses::new(steps, [pan.1, tilt.1, roll.1, light.1]);
        pulses.trains.set_bearable(options.bearable_late_us.min(1_000_000));
        Self {
            axes: [pan.0, tilt.0, roll.0, light.0],
            pulses: B::Pulses::keep(pulses),
            now_us: 0,
            step_us: None,
            poll_us: None,
            changes: Changes::default(),
            options,
            lines,
            wiring: None,
            own_alarms: Alarms::new(),
            alarmed: 0,
            lamp: Lamp::new(Line::new(lamp), lamp_level),
            shutter: Shutter::new(Line::new(shutter), timed_shutter),
            photodiode,
            safety: Safety::new(emergency_stop),
            link: Link::new(link),
            configuration: None,
            started: false,
            running: None,
            waiting: Deque::new(),
            refused: 0,
            prepared: [None; AXES],
            prepared_keep_outs: None,
            swept: [[0; 2]; AXES],
            migrated: None,
            moved: false,
            longest_poll_us: 0,
            watch: Watch::default(),
            fan_runs: false,
            beat: false,
            heard_us: 0,
        }
    }

    /// When [`Self::tick`] has to be called next, unless a byte or the emergency stop comes first; in µs, and
    /// `u64::MAX` when nothing is under way.
    pub fn next_event_us(&self) -> u64 {
        let wait = |next: u32| (next.wrapping_sub(self.now_us as u32) as i32).max(0) as u32;
        let step_us = self.step_us.map_or(u64::MAX, |next| self.now_us + u64::from(wait(next)));
        step_us.min(self.next_poll_us())
    }

    /// When [`Self::poll`] has to be called next where an interrupt makes the steps, as
    /// [`Self::next_event_us`] where none does.
    pub fn next_poll_us(&self) -> u64 {
        let idle = || self.task_us().min(self.lease_end_us()).min(self.watch.next_us());
        self.poll_us.unwrap_or_else(idle).min(self.lamp_us()).min(self.alarm_us())
    }

    /// When something is due for the task other than motion.
    fn task_us(&self) -> u64 {
        match self.running.as_ref().map(|running| &running.task) {
            Some(Task::BeginHoming(..)) => 0,
            Some(Task::Settle { until_us, .. }) => *until_us,
            Some(Task::AwaitCamera { look_us, .. }) => *look_us,
            Some(Task::Expose { .. }) => self.shutter.next_us(),
            Some(Task::Move { .. } | Task::Turn { .. } | Task::Home(..) | Task::Stop) | None => u64::MAX,
        }
    }

    /// When the axes have to be polled; `None` while none moves or has to.
    fn motion_us(&mut self, now_us: u64) -> Option<u64> {
        let task = self.running.as_ref().map(|running| &running.task);
        let ought = matches!(task, Some(Task::Move { .. } | Task::Turn { .. } | Task::Home(..) | Task::Stop));
        if !self.axes.iter().any(AxisDrive::moving) {
            let soon = if matches!(task, Some(Task::Home(..))) { LOOK_EVERY_US } else { 1 };
            let pulses_end = self.step_us.is_some();
            return (ought || pulses_end).then_some(now_us + if ought { soon } else { POLL_EVERY_US });
        }
        let pulses = &mut self.pulses;
        let axes_us = self.axes.iter().map(|axis| axis.next_us(pulses, now_us)).min().unwrap_or(u64::MAX);
        Some(axes_us.min(self.lease_end_us()).min(self.watch.next_us()).min(now_us + POLL_EVERY_US))
    }

    /// Which axes are under way.
    pub fn moving(&self) -> [bool; AXES] {
        array::from_fn(|axis| self.axes[axis].moving())
    }

    /// Does what is due at `now_us`, which never goes back: while axes move mostly steps, which is quick.
    #[inline]
    pub fn tick(&mut self, now_us: u64) {
        self.now_us = now_us;
        // Steps before all else: what a packet takes to decode must not delay them.
        let (next, tripped) = self.pulses.with(|pulses| (pulses.step(|| now_us as u32), pulses.tripped()));
        self.step_us = next;
        if tripped || self.poll_us.is_none() || now_us >= self.next_poll_us() {
            self.poll(now_us);
        }
    }

    /// Does all there is to do at `now_us` except steps; looks for bytes too. The time never goes back, and
    /// is that of the clock by which steps are made.
    pub fn poll(&mut self, now_us: u64) {
        let in_time = now_us.saturating_sub(self.next_poll_us()) <= LATE_US;
        self.now_us = now_us;
        if !core::mem::replace(&mut self.started, true) {
            self.adopt_stored(now_us);
        }
        self.moved = self.axes.iter().any(AxisDrive::moving);
        if self.options.emergency_stop.is_some_and(EmergencyStop::take) {
            self.raise(now_us, Fault::EmergencyStop, None);
        }
        match self.safety.newly_pressed() {
            Ok(false) => {}
            Ok(true) => self.raise(now_us, Fault::EmergencyStop, None),
            Err(PinFailure) => self.raise(now_us, Fault::Hardware, None),
        }
        self.mind_temperature(now_us);
        self.mind_alarms(now_us);
        // The shutter and the axes before bytes.
        if let Some(running) = self.running.take() {
            self.go_on(now_us, running);
        }
        self.plan_ahead(now_us);
        while let Some(packet) = self.link.receive() {
            match packet {
                ToController::Hello(hello) => {
                    self.heard_us = now_us;
                    if self.link.greet(hello) {
                        self.abandon();
                    }
                    // A host of another version would not understand.
                    if self.link.is_open()
                        && let Some(crash) = self.options.crash.take()
                    {
                        self.link.events.alarm(Event::Crashed(crash));
                    }
                    if self.link.is_open()
                        && let Some(from) = self.migrated.take()
                    {
                        self.link.events.alarm(Event::Migrated { from });
                    }
                }
                ToController::Request(request) => self.receive(now_us, &request),
                ToController::Safe(command) => self.make_safe(now_us, command),
            }
        }
        self.take_turns(now_us);
        self.mind_times(now_us);
        self.mind_fan(now_us);
        self.mind_supply(now_us);
        self.tell(now_us);
        // A board whose pins fail, or that steps too late, is better off with a reset, which puts pins to
        // their safe state.
        if in_time && !self.safety.faults().contains(Fault::Hardware) {
            self.show_life();
        }
        self.link.flush();
        self.step_us = self.pulses.with(|pulses| pulses.next_us());
        self.poll_us = self.motion_us(now_us);
    }

    /// Sets the brown-out level, once and only if it is otherwise: at rest, dark, and with the supply risen.
    fn mind_supply(&mut self, now_us: u64) {
        let rests = self.running.is_none() && !self.axes.iter().any(AxisDrive::moving);
        if now_us < SUPPLY_RISEN_US || !rests || self.lamp.is_on() {
            return;
        }
        if let Some(brown_out) = self.options.brown_out.take()
            && !brown_out.is_set()
        {
            brown_out.set();
        }
    }

    /// To be told when the loop that polls has done all that it does once, by the clock of the polls: how
    /// long that took is told to the host.
    pub fn polled(&mut self, now_us: u64) {
        if self.moved {
            let took = now_us.saturating_sub(self.now_us).min(u32::MAX.into()) as u32;
            self.longest_poll_us = self.longest_poll_us.max(took);
        }
    }

    /// Feeds what takes the controller for dead otherwise: the watchdog, and what holds the lamp's supply.
    fn show_life(&mut self) {
        if let Some(watchdog) = &mut self.options.watchdog {
            watchdog.feed();
        }
        if let Some(heartbeat) = &mut self.options.heartbeat {
            self.beat = !self.beat;
            // A pulse less and the lamp goes out, which is all that could be done.
            let _ = set(heartbeat, self.beat);
        }
    }

    /// Ends what a host began that is no longer there.
    fn abandon(&mut self) {
        self.waiting.clear();
        self.refused = 0;
        self.prepared = [None; AXES];
        self.prepared_keep_outs = None;
        self.watch = Watch::default();
        if self.running.is_some() {
            let _ = self.stop();
            if let Some(running) = &mut self.running {
                running.request = None;
            }
        }
    }

    /// Brings all axes to rest by their ramps and closes the shutter.
    fn stop(&mut self) -> Result<(), PinFailure> {
        self.axes.iter_mut().for_each(|axis| axis.stop());
        if let Some(running) = &mut self.running {
            running.task = Task::Stop;
        }
        self.shutter.close()
    }

    fn status(&mut self, now_us: u64) -> Result<Status, PinFailure> {
        let mut at_switch = [false; AXES];
        for (axis, at_switch) in at_switch.iter_mut().enumerate() {
            *at_switch = self.pulses.with(|pulses| pulses.at_switch(axis))?;
        }
        Ok(Status {
            positions: self.positions(),
            known: array::from_fn(|axis| self.axes[axis].known),
            moving: self.moving(),
            at_switch,
            configured: self.configuration.is_some(),
            busy: self.running.is_some(),
            waiting: self.waiting.len() as u8,
            lamp: self.lamp_status(now_us),
            faults: self.safety.faults(),
            emergency_stop: self.safety.pressed(),
            uptime_us: now_us,
            alarms: self.active_alarms(),
        })
    }

    fn positions(&mut self) -> [i32; AXES] {
        self.pulses.with(|pulses| array::from_fn(|axis| pulses.trains.position(axis)))
    }

    /// Polls the axes or the shutter for the task, and ends it when it is done.
    fn go_on(&mut self, now_us: u64, mut running: Running) {
        match self.advance(now_us, &mut running.task) {
            Ok(None) => self.running = Some(running),
            Ok(Some(outcome)) => self.finish(now_us, &running, outcome),
            Err((fault, axis)) => {
                self.running = Some(running);
                self.raise(now_us, fault, axis);
            }
        }
    }

    fn advance(&mut self, now_us: u64, task: &mut Task) -> Result<Option<Outcome>, (Fault, Option<Axis>)> {
        match task {
            Task::BeginHoming(purpose, axes) => {
                let (purpose, axes) = (*purpose, *axes);
                return self.home_on(now_us, task, purpose, axes);
            }
            Task::AwaitCamera { look_us, until_us, duration_us, warm_lamp } => {
                let awaited = (*until_us, *duration_us, *warm_lamp);
                if now_us < *look_us {
                    return Ok(None);
                }
                return match self.open_when_ready(now_us, awaited).map_err(|_| (Fault::Hardware, None))? {
                    Some(next) => {
                        *task = next;
                        Ok(None)
                    }
                    None => Ok(Some(Outcome::Refused(Refusal::CameraNotReady))),
                };
            }
            Task::Expose { lit } => {
                let lit = *lit;
                return self.expose_on(now_us, lit).map_err(|fault| (fault, None));
            }
            Task::Settle { until_us, found } => {
                if now_us < *until_us {
                    return Ok(None);
                }
                return self.settled(now_us, *found).map(Some);
            }
            Task::Move { .. } | Task::Turn { .. } | Task::Home(..) | Task::Stop => {}
        }
        let pulses = &mut self.pulses;
        self.changes.begin(self.axes.iter().any(|axis| axis.runs_out(pulses, now_us).is_some()));
        let mut resting = true;
        for axis in Axis::ALL {
            let waits = self.advance_axis(now_us, axis, task).map_err(|fault| (fault, Some(axis)))?;
            resting &= !waits && !self.axes[axis.index()].moving();
        }
        if !resting {
            return Ok(None);
        }
        Ok(match task {
            Task::Turn { targets } => {
                let (Some(configuration), targets) = (self.configuration, *targets) else { return Ok(None) };
                *task =
                    self.start_move(now_us, &configuration, targets).map_err(|_| (Fault::Hardware, None))?;
                None
            }
            Task::Stop => {
                // A homing that was stopped still watches its switches.
                self.pulses.with(|pulses| (0..AXES).for_each(|axis| pulses.look_away(axis)));
                Some(Outcome::Refused(self.safety.check().err().unwrap_or(Refusal::Stopped)))
            }
            Task::Move { settle_ms } => {
                if let Some(axis) = self.lost_driver() {
                    return Err((Fault::DriverLost, Some(axis)));
                }
                *task = Task::Settle { until_us: now_us + u64::from(*settle_ms) * 1000, found: None };
                None
            }
            Task::Home(purpose, axes, searches) => {
                let Some(configuration) = self.configuration else { return Ok(None) };
                let begun = self.home_next(now_us, &configuration, *purpose, *axes, searches);
                if begun.map_err(|_| (Fault::Hardware, None))? {
                    return Ok(None);
                }
                let found = Some(self.found(*purpose, searches));
                *task = Task::Settle { until_us: now_us + self.longest_settling_us(), found };
                None
            }
            Task::BeginHoming(..) | Task::Settle { .. } | Task::AwaitCamera { .. } | Task::Expose { .. } => {
                None
            }
        })
    }

    fn longest_settling_us(&self) -> u64 {
        let axes = self.configuration.iter().flat_map(|configuration| &configuration.axes);
        axes.map(|p| u64::from(p.settle_ms) * 1000).max().unwrap_or(0)
    }

    /// Ceases everything at once and remembers why. The lamp, which takes long to warm, goes out only where
    /// it may be the danger, or where pins can't be trusted.
    fn raise(&mut self, now_us: u64, fault: Fault, axis: Option<Axis>) {
        let mut safe = true;
        // An arm whose motor is released falls: only where somebody may be caught, or pins do what they like.
        let release = matches!(fault, Fault::EmergencyStop | Fault::Hardware);
        let dark = release || fault == Fault::OverTemperature;
        for drive in &mut self.axes {
            safe &= drive.cut(&mut self.pulses, release).is_ok();
        }
        safe &= self.shutter.close().is_ok();
        if dark {
            safe &= self.lamp.put_out(now_us).is_ok();
        }
        // Each axis's alarm is told, not only the first.
        if self.safety.latch(fault) || fault == Fault::DriverAlarm {
            self.link.events.alarm(Event::Fault(FaultReport { fault, axis, at_us: now_us }));
        }
        if !safe {
            self.safety.latch(Fault::Hardware);
            let _ = self.lamp.put_out(now_us);
        }
        let refusal = Refusal::Faulted(self.safety.faults());
        if let Some(running) = self.running.take() {
            self.finish(now_us, &running, Outcome::Refused(refusal));
        }
        self.refuse_waiting(now_us, refusal);
    }
}
