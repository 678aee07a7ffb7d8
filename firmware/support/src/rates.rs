//! Counts the instructions of a step: the whole controller, with real pins, is led through moves of one to
//! four axes on a virtual clock that jumps from event to event, while a counter counts.
//!
//! The axes run at different speeds, so their steps fall on the same moment by chance only. What is counted
//! is all that the board's interrupt does at each step and at each end of a pulse, and all of
//! [`Controller::poll`]: planning, watching the inputs, asking the link. The interrupts' entries and exits
//! are no instructions: they are told by their number.

use lobelia_firmware::{Board, Controller, Peripherals};
use lobelia_protocol::{
    AXES, Alarm, AxisParameters, Command, Configuration, FrameDecoder, Hello, HomeDirection, Outcome, Pins,
    Request, Settings, ToController, ToHost,
};

use core::sync::atomic::Ordering;

use crate::link::{Received, ToSend};
use crate::model;

/// Highest speed of the first axis in steps/s; each further one goes a little slower, so that four make
/// 400,000 steps/s.
const SPEED: u32 = 120_000;
/// Steps of the first axis's move; the others' moves take about as long. A sixth of them is in the ramps.
const STEPS: u32 = 60_000;

/// Where all axes are before the first move, in steps.
const START: i32 = 100;

/// What a move cost.
#[derive(Debug, Clone, Copy)]
pub struct Cost {
    /// Axes moved.
    pub axes: usize,
    /// Steps made by all axes.
    pub steps: u32,
    /// Calls of the steps' interrupt.
    pub calls: u32,
    /// Counts of the board's counter.
    pub counts: u64,
}

/// The controller on the bench and the host's side of its link.
struct Session<B: Board> {
    controller: Controller<B>,
    received: &'static Received,
    to_send: &'static ToSend,
    now_us: u64,
    last_id: u32,
}

impl<B: Board> Session<B> {
    fn send(&mut self, packet: &ToController) {
        let Ok(frame) = packet.encode() else { return };
        for byte in frame {
            let _ = self.received.push(byte);
        }
    }

    /// Has a command done; gives calls of the steps' interrupt and counts taken, or `None` if it was refused.
    fn request(
        &mut self,
        command: Command,
        counter: &mut impl FnMut() -> u32,
        serve: &mut impl FnMut(u32) -> Option<u32>,
    ) -> Option<(u32, u64)> {
        self.last_id += 1;
        self.send(&ToController::Request(Request {
            session: 1,
            id: self.last_id,
            seen: self.last_id - 1,
            command,
        }));
        let cost = self.run(counter, serve);
        self.done().then_some(cost)
    }

    /// Runs until the controller has nothing to do; gives calls of the steps' interrupt and counts taken.
    fn run(
        &mut self,
        counter: &mut impl FnMut() -> u32,
        serve: &mut impl FnMut(u32) -> Option<u32>,
    ) -> (u32, u64) {
        self.controller.poll(self.now_us);
        let mut step = serve(self.now_us as u32);
        let (mut calls, mut counts) = (0, 0);
        let counting = timed(counter, || ());
        loop {
            let wait = |next: u32| u64::from(next.wrapping_sub(self.now_us as u32));
            let step_us = step.map_or(u64::MAX, |next| self.now_us + wait(next));
            let poll_us = self.controller.next_poll_us();
            let next = step_us.min(poll_us);
            if next == u64::MAX {
                return (calls, counts);
            }
            self.now_us = next.max(self.now_us);
            if poll_us <= step_us {
                counts += u64::from(timed(counter, || self.controller.poll(self.now_us)) - counting);
            }
            counts += u64::from(timed(counter, || step = serve(self.now_us as u32)) - counting);
            calls += 1;
        }
    }

    /// Whether the last request was answered as done.
    fn done(&mut self) -> bool {
        let mut decoder = FrameDecoder::new();
        let mut done = false;
        while let Some(byte) = self.to_send.pop() {
            if let Some(Ok(payload)) = decoder.push(byte)
                && let Ok(ToHost::Response(response)) = ToHost::decode(payload)
            {
                done = response.id == self.last_id && matches!(response.outcome, Outcome::Done(_));
            }
        }
        done
    }
}

/// Counts that some work takes, and the counting.
#[inline(never)]
fn timed(counter: &mut impl FnMut() -> u32, work: impl FnOnce()) -> u32 {
    let before = counter();
    work();
    counter().wrapping_sub(before)
}

/// Acceleration in steps/s².
const ACCELERATION: u32 = 2_000_000;
/// Jerk in steps/s³.
const JERK: u32 = 100_000_000;
/// Steps below its target that a downward move goes to before it ends upward.
const TAKE_UP: u32 = 20;

/// Speed of an axis in steps/s.
fn speed(axis: usize) -> u32 {
    SPEED - SPEED / 9 * axis as u32
}

fn configuration() -> Configuration {
    let axes = core::array::from_fn(|axis| AxisParameters {
        min_steps: 0,
        max_steps: 500_000,
        max_speed: speed(axis),
        acceleration: ACCELERATION,
        jerk: JERK,
        full_turn_steps: 0,
        take_up_steps: TAKE_UP,
        settle_ms: 0,
        home_direction: HomeDirection::Negative,
        home_position: -100,
        home_speed: 5000,
        home_slow_speed: 500,
        home_back_off: 20,
        home_switch_steps: 500,
        home_order: 0,
        home_travel: 5000,
        home_debounce_us: 0,
        index_tolerance: 4,
        driver: None,
        inverted: Pins::NONE,
        alarm: Alarm::None,
        alarm_debounce_us: 0,
        most_turns: 1,
    });
    Configuration {
        axes,
        settings: Settings {
            lamp_warm_up_s: 0,
            lamp_least_reading: 0,
            lease_ms: 0,
            lamp_lease_ms: 0,
            lamp_safe_level: 0,
            lamp_longest_s: 172_800,
            fan_run_on_s: 300,
            camera_wait_ms: 0,
            coordinated: false,
            pulse_us: 2,
            direction_setup_us: 5,
            inverted: Pins::NONE,
        },
        keep_outs: [None; 4],
    }
}

/// Moves one to four axes there and back, and tells `report` what each pair of moves cost. `counter` counts
/// upward and wraps at 32 bits; `serve` does what the board's interrupt does, at a time in µs that it is
/// told. False if the controller refused something.
///
/// The board's link interrupt has to be off: `received` and `to_send` are its rings, whose other ends are
/// here.
pub fn measure<B: Board>(
    peripherals: Peripherals<B>,
    (received, to_send): (&'static Received, &'static ToSend),
    mut counter: impl FnMut() -> u32,
    mut serve: impl FnMut(u32) -> Option<u32>,
    mut report: impl FnMut(Cost),
) -> bool {
    let controller = Controller::new(peripherals);
    let mut session = Session { controller, received, to_send, now_us: 0, last_id: 0 };
    session.send(&ToController::Hello(Hello::new(1)));
    session.run(&mut counter, &mut serve);
    let at = [START; AXES];
    for command in configuration().commands().into_iter().chain([Command::Home, Command::MoveTo(at)]) {
        if session.request(command, &mut counter, &mut serve).is_none() {
            return false;
        }
    }
    // The modelled axes would count the steps, which no real board does.
    model::STANDS_STILL.store(true, Ordering::Relaxed);
    for axes in 1..=AXES {
        let mut to = at;
        let mut steps = 0;
        for (axis, to) in to.iter_mut().enumerate().take(axes) {
            let by = STEPS / 100 * (speed(axis) / 100) / (SPEED / 100) * 100;
            *to += by as i32;
            steps += 2 * (by + TAKE_UP);
        }
        // Away from the home switch, and toward it, when it is watched.
        let mut cost = Cost { axes, steps, calls: 0, counts: 0 };
        for targets in [to, at] {
            let Some((calls, counts)) = session.request(Command::MoveTo(targets), &mut counter, &mut serve)
            else {
                return false;
            };
            cost.calls += calls;
            cost.counts += counts;
        }
        report(cost);
    }
    true
}

/// A counter that counts up and wraps at 32 bits, from one that counts down and wraps anywhere.
#[derive(Debug)]
pub struct Counter {
    read: fn() -> u32,
    reload: u32,
    last: u32,
    total: u32,
}

impl Counter {
    /// From the function that reads the counter, and the value that it starts from again after 0. It has to
    /// be read at least once each time round.
    pub fn new(read: fn() -> u32, reload: u32) -> Self {
        Self { read, reload, last: read(), total: 0 }
    }

    /// Counts since it was made.
    pub fn count(&mut self) -> u32 {
        let now = (self.read)();
        let down = if now <= self.last { self.last - now } else { self.last + self.reload + 1 - now };
        self.last = now;
        self.total = self.total.wrapping_add(down);
        self.total
    }
}

/// Instructions by which the counter is calibrated.
const CALIBRATION: u32 = 4000;

/// Measures and prints a line `rate axes=A steps=S calls=C instructions=I` for each number of axes, then
/// `end`; or `refused`. `spend` runs as many instructions as it is told, and a few more, always the same
/// number.
pub fn report<B: Board>(
    peripherals: Peripherals<B>,
    rings: (&'static Received, &'static ToSend),
    mut counter: Counter,
    spend: fn(u32),
    serve: impl FnMut(u32) -> Option<u32>,
    send: fn(u8),
) {
    let mut timed = |instructions| {
        let start = counter.count();
        spend(instructions);
        u64::from(counter.count().wrapping_sub(start))
    };
    let counts_per_calibration = (timed(2 * CALIBRATION) - timed(CALIBRATION)).max(1);
    let text = |text: &str| text.bytes().for_each(send);
    let done = measure(
        peripherals,
        rings,
        || counter.count(),
        serve,
        |cost| {
            text("rate axes=");
            decimal(cost.axes as u64, send);
            text(" steps=");
            decimal(cost.steps.into(), send);
            text(" calls=");
            decimal(cost.calls.into(), send);
            text(" instructions=");
            decimal(cost.counts * u64::from(CALIBRATION) / counts_per_calibration, send);
            text("\n");
        },
    );
    text(if done { "end\n" } else { "refused\n" });
}

/// Prints a number.
fn decimal(number: u64, send: fn(u8)) {
    if number >= 10 {
        decimal(number / 10, send);
    }
    send(b'0' + (number % 10) as u8);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counter_goes_on_past_the_wrap() {
        use core::sync::atomic::{AtomicU32, Ordering::Relaxed};
        static DOWN: AtomicU32 = AtomicU32::new(5);
        let mut counter = Counter::new(|| DOWN.load(Relaxed), 99);
        DOWN.store(2, Relaxed);
        assert_eq!(counter.count(), 3);
        DOWN.store(98, Relaxed);
        assert_eq!(counter.count(), 7);
    }
}
