//! Counts the instructions of a step: the whole controller, with real pins, is led through moves of one to four axes on
//! a virtual clock that jumps from event to event, while a counter counts.
//!
//! The axes run at different speeds, so their steps seldom fall on the same moment and share little. What is
//! counted is all that [`Controller::poll`] and [`Controller::next_event_us`] do, pulse ends included, and what the board's
//! own loop does beside them. The interrupt's entry and exit are not: they are no instructions.

use lobelia_firmware::{Board, Controller, Peripherals};
use lobelia_protocol::{
    AXES, AxisParameters, Command, Configuration, FrameDecoder, Hello, HomeDirection, Outcome, Request,
    Settings, ToController, ToHost,
};

use crate::link::{Received, ToSend};

/// Highest speed of the first axis in steps/s; each further one goes a little slower.
const SPEED: u32 = 20_000;
/// Steps of the first axis's move; the others' moves take as long.
const STEPS: u32 = 4000;

/// Where all axes are before the first move, in steps.
const START: i32 = 100;

/// What a move cost.
#[derive(Debug, Clone, Copy)]
pub struct Cost {
    /// Axes moved.
    pub axes: usize,
    /// Steps made by all axes.
    pub steps: u32,
    /// Calls of the controller.
    pub polls: u32,
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

    /// Has a command done; gives polls made and counts taken, or `None` if it was refused.
    fn request(
        &mut self,
        command: Command,
        counter: &mut impl FnMut() -> u32,
        beside: impl FnMut(u64),
    ) -> Option<(u32, u64)> {
        self.last_id += 1;
        self.send(&ToController::Request(Request {
            session: 1,
            id: self.last_id,
            seen: self.last_id - 1,
            command,
        }));
        let cost = self.run(counter, beside);
        self.done().then_some(cost)
    }

    /// Runs until the controller has nothing to do; gives polls made and counts taken.
    fn run(&mut self, counter: &mut impl FnMut() -> u32, mut beside: impl FnMut(u64)) -> (u32, u64) {
        self.controller.poll(self.now_us);
        let (mut polls, mut counts) = (0, 0);
        let mut last = counter();
        loop {
            let next = self.controller.next_event_us();
            if next == u64::MAX {
                return (polls, counts);
            }
            self.now_us = next.max(self.now_us);
            self.controller.poll(self.now_us);
            beside(next);
            let now = counter();
            counts += u64::from(now.wrapping_sub(last));
            last = now;
            polls += 1;
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

/// Acceleration in steps/s²: the ramp is a tenth of the move.
const ACCELERATION: u32 = SPEED * SPEED / STEPS * 10;

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
        // A tenth of the time of a ramp to build the acceleration up.
        jerk: (10 * (ACCELERATION as u64) * (ACCELERATION as u64) / (SPEED as u64)) as u32,
        full_turn_steps: 0,
        take_up_steps: 20,
        settle_ms: 0,
        home_direction: HomeDirection::Negative,
        home_position: -100,
        home_speed: 5000,
        home_slow_speed: 500,
        home_back_off: 20,
        home_travel: 5000,
        home_debounce_us: 0,
        index_tolerance: 4,
    });
    Configuration {
        axes,
        settings: Settings {
            lamp_warm_up_s: 0,
            lamp_least_reading: 0,
            lease_ms: 0,
            lamp_lease_ms: 0,
            lamp_safe_level: 0,
            camera_wait_ms: 0,
            coordinated: false,
        },
    }
}

/// Moves one to four axes and tells `report` what each move cost. `counter` counts upward and wraps at 32 bits;
/// `beside` does what the board's loop does for each poll. False if the controller refused something.
///
/// The board's link interrupt has to be off: `received` and `to_send` are its rings, whose other ends are here.
pub fn measure<B: Board>(
    peripherals: Peripherals<B>,
    (received, to_send): (&'static Received, &'static ToSend),
    mut counter: impl FnMut() -> u32,
    mut beside: impl FnMut(u64),
    mut report: impl FnMut(Cost),
) -> bool {
    let controller = Controller::new(peripherals);
    let mut session = Session { controller, received, to_send, now_us: 0, last_id: 0 };
    session.send(&ToController::Hello(Hello::new(1)));
    session.run(&mut counter, |_| {});
    let mut at = [START; AXES];
    for command in configuration().commands().into_iter().chain([Command::Home, Command::MoveTo(at)]) {
        if session.request(command, &mut counter, |_| {}).is_none() {
            return false;
        }
    }
    for axes in 1..=AXES {
        let mut steps = 0;
        for (axis, at) in at.iter_mut().enumerate().take(axes) {
            let by = STEPS * (speed(axis) / 100) / (SPEED / 100);
            *at += by as i32;
            steps += by;
        }
        let Some((polls, counts)) = session.request(Command::MoveTo(at), &mut counter, &mut beside) else {
            return false;
        };
        report(Cost { axes, steps, polls, counts });
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
    /// From the function that reads the counter, and the value that it starts from again after 0. It has to be read at
    /// least once each time round.
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

/// Measures and prints a line `rate axes=A steps=S polls=P instructions=I` for each number of axes, then `end`; or
/// `refused`. `spend` runs as many instructions as it is told, and a few more, always the same number.
pub fn report<B: Board>(
    peripherals: Peripherals<B>,
    rings: (&'static Received, &'static ToSend),
    mut counter: Counter,
    spend: fn(u32),
    beside: impl FnMut(u64),
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
        beside,
        |cost| {
            text("rate axes=");
            decimal(cost.axes as u64, send);
            text(" steps=");
            decimal(cost.steps.into(), send);
            text(" polls=");
            decimal(cost.polls.into(), send);
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
