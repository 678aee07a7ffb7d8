//! One axis: step pulses on its pins, and moves that end with an approach in the positive direction.
//!
//! Gears have play. The position that a motor step count stands for is the same each time only if the same flank pushes at the end,
//! so a move that would end downward, or follow a motion that did, first goes `take_up` steps below its target.

use crate::board::{AxisPins, Board, PinFailure, is_high, set};
use crate::motion::stepper::Stepper;
use lobelia_protocol::AxisParameters;

/// Shortest time that the step pin stays high, and low, in µs.
pub(crate) const PULSE_US: u64 = 2;

/// An axis's pins and where it is.
pub(crate) struct AxisDrive<B: Board> {
    pins: AxisPins<B>,
    stepper: Stepper,
    /// The target of the approach that follows the present run.
    approach: Option<i32>,
    /// Speed and acceleration of the present move.
    max_speed: u32,
    acceleration: u32,
    /// Whether the last motion ended upward with the play taken up.
    taken_up: bool,
    /// Whether the present one will.
    ends_taken_up: bool,
    pulse_high: bool,
    pulse_since_us: u64,
    /// Whether the position means anything.
    pub(crate) known: bool,
}

impl<B: Board> AxisDrive<B> {
    pub(crate) fn new(pins: AxisPins<B>) -> Self {
        Self {
            pins,
            stepper: Stepper::default(),
            approach: None,
            max_speed: 1,
            acceleration: 1,
            taken_up: false,
            ends_taken_up: false,
            pulse_high: false,
            pulse_since_us: 0,
            known: false,
        }
    }

    pub(crate) fn position(&self) -> i32 {
        self.stepper.position()
    }

    /// Whether the run goes toward higher steps.
    pub(crate) fn forward(&self) -> bool {
        self.stepper.forward()
    }

    /// Whether the axis is under way.
    pub(crate) fn moving(&self) -> bool {
        self.stepper.running() || self.approach.is_some() || self.pulse_high
    }

    /// Whether the home switch is closed.
    pub(crate) fn at_switch(&mut self) -> Result<bool, PinFailure> {
        is_high(&mut self.pins.home)
    }

    /// When this axis next has to be polled, in µs.
    pub(crate) fn next_us(&self) -> u64 {
        let pulse_end = self.pulse_since_us + PULSE_US;
        if self.pulse_high {
            pulse_end
        } else if self.stepper.running() {
            self.stepper.due_us().max(pulse_end)
        } else {
            u64::MAX
        }
    }

    /// Starts a move; gives whether there is anything to move.
    pub(crate) fn move_to(
        &mut self,
        now_us: u64,
        target: i32,
        parameters: &AxisParameters,
    ) -> Result<bool, PinFailure> {
        let below = target.saturating_sub_unsigned(parameters.take_up_steps);
        let position = self.position();
        if self.taken_up && target == position {
            return Ok(false);
        }
        let needs_take_up = target < position || (!self.taken_up && below < position);
        let first = if needs_take_up { below } else { target };
        self.approach = needs_take_up.then_some(target);
        self.run(now_us, first, parameters.max_speed, parameters.acceleration)?;
        self.ends_taken_up = true;
        Ok(true)
    }

    /// Starts a single run without take-up, as homing needs.
    pub(crate) fn run(
        &mut self,
        now_us: u64,
        target: i32,
        max_speed: u32,
        acceleration: u32,
    ) -> Result<(), PinFailure> {
        self.taken_up = false;
        self.ends_taken_up = false;
        (self.max_speed, self.acceleration) = (max_speed, acceleration);
        self.start(now_us, target)
    }

    fn start(&mut self, now_us: u64, target: i32) -> Result<(), PinFailure> {
        set(&mut self.pins.enable, true)?;
        let upward = target > self.position();
        set(&mut self.pins.direction, upward)?;
        self.stepper.start(now_us, target, self.max_speed, self.acceleration);
        Ok(())
    }

    /// Ends the present run after `distance` more steps, or as soon as the ramp allows.
    pub(crate) fn shorten(&mut self, distance: u32) {
        self.stepper.shorten(distance);
    }

    /// Comes to rest by the ramp and forgets the rest of the move.
    pub(crate) fn stop(&mut self) {
        self.approach = None;
        self.ends_taken_up = false;
        self.stepper.shorten(0);
    }

    /// Ceases at once, releases the motor and forgets the position.
    pub(crate) fn cut(&mut self) -> Result<(), PinFailure> {
        self.stepper.halt();
        self.approach = None;
        self.taken_up = false;
        self.ends_taken_up = false;
        self.known = false;
        self.pulse_high = false;
        let step = set(&mut self.pins.step, false);
        set(&mut self.pins.enable, false).and(step)
    }

    /// Takes the present position for `position`, reached upward with the play taken up.
    pub(crate) fn homed(&mut self, position: i32) {
        self.stepper.set_position(position);
        self.known = true;
        self.taken_up = true;
    }

    /// Forgets the position, to count from 0.
    pub(crate) fn forget(&mut self) {
        self.stepper.set_position(0);
        self.known = false;
        self.taken_up = false;
    }

    /// Does what is due; gives whether a step was made.
    pub(crate) fn poll(&mut self, now_us: u64) -> Result<bool, PinFailure> {
        if now_us < self.next_us() {
            return Ok(false);
        }
        self.pulse_since_us = now_us;
        if self.pulse_high {
            self.pulse_high = false;
            set(&mut self.pins.step, false)?;
            self.approach_if_due(now_us)?;
            return Ok(false);
        }
        set(&mut self.pins.step, true)?;
        self.pulse_high = true;
        self.stepper.stepped(now_us);
        Ok(true)
    }

    /// At the end of a run: begins the approach, or notes that it is done.
    fn approach_if_due(&mut self, now_us: u64) -> Result<(), PinFailure> {
        if self.stepper.running() {
            return Ok(());
        }
        match self.approach.take() {
            Some(target) => self.start(now_us, target),
            None => {
                self.taken_up = self.ends_taken_up;
                Ok(())
            }
        }
    }
}
