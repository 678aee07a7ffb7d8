//! One axis's mechanics: motor steps, play, hard stops and the home switch.
//!
//! The axis hangs between two flanks of the motor's gear: its position is anywhere in [motor, motor + play],
//! so going up the motor pushes it along at the lower flank. Shared between pins and world by atomics, since
//! a step has to be cheap.

use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering::Relaxed};

use crate::config::AxisMechanics;
use crate::noise;

/// Parts of a step in which the axis's position is kept.
const PARTS: f64 = 1024.0;

/// An axis.
#[derive(Debug)]
pub(crate) struct Mechanism {
    pub(crate) up: AtomicBool,
    pub(crate) step_level: AtomicBool,
    pub(crate) enabled: AtomicBool,
    motor: AtomicI64,
    load: AtomicI64,
    switch_closed: AtomicBool,
    switch_broken: AtomicBool,
    switch_wire_broken: AtomicBool,
    /// Whether the last step met a hard stop.
    blocked: AtomicBool,
    /// Whether its driver tells that it has failed.
    pub(crate) driver_failed: AtomicBool,
    steps: AtomicU64,
    stops: [i64; 2],
    play: i64,
    opens_above: i64,
    closes_below: i64,
    radians_per_step: f64,
    scatter_rad: f64,
}

impl Mechanism {
    pub(crate) fn new(config: &AxisMechanics) -> Self {
        let steps = |degrees: f64| degrees / config.degrees_per_step;
        let parts = |degrees: f64| (steps(degrees) * PARTS).round() as i64;
        let motor = steps(config.start_deg).round() as i64;
        let play = parts(config.backlash_deg);
        let load = motor * PARTS as i64 + play;
        let closes_below = parts(config.home_switch_deg - config.switch_hysteresis_deg);
        Self {
            up: AtomicBool::new(false),
            step_level: AtomicBool::new(false),
            enabled: AtomicBool::new(false),
            motor: AtomicI64::new(motor),
            load: AtomicI64::new(load),
            switch_closed: AtomicBool::new(load < closes_below),
            switch_broken: AtomicBool::new(false),
            switch_wire_broken: AtomicBool::new(false),
            blocked: AtomicBool::new(false),
            driver_failed: AtomicBool::new(false),
            steps: AtomicU64::new(0),
            stops: config.stops_deg.map(|degrees| steps(degrees).round() as i64),
            play,
            opens_above: parts(config.home_switch_deg),
            closes_below,
            radians_per_step: config.degrees_per_step.to_radians(),
            scatter_rad: config.repeatability_deg.to_radians(),
        }
    }

    /// A rising edge on the step pin.
    pub(crate) fn step(&self) {
        self.steps.fetch_add(1, Relaxed);
        if self.enabled.load(Relaxed) {
            let before = self.motor.load(Relaxed);
            self.shift(if self.up.load(Relaxed) { 1 } else { -1 });
            self.blocked.store(self.motor.load(Relaxed) == before, Relaxed);
        }
    }

    /// Turns the motor, whoever does it; the controller doesn't count this.
    pub(crate) fn shift(&self, steps: i64) {
        let motor = (self.motor.load(Relaxed) + steps).clamp(self.stops[0], self.stops[1]);
        let lower = motor * PARTS as i64;
        let load = self.load.load(Relaxed).clamp(lower, lower + self.play);
        self.motor.store(motor, Relaxed);
        self.load.store(load, Relaxed);
        if load > self.opens_above {
            self.switch_closed.store(false, Relaxed);
        } else if load < self.closes_below {
            self.switch_closed.store(true, Relaxed);
        }
    }

    /// Whether the motor was kept from making its last step.
    pub(crate) fn blocked(&self) -> bool {
        self.blocked.load(Relaxed)
    }

    /// Where the motor is.
    pub(crate) fn motor_steps(&self) -> i64 {
        self.motor.load(Relaxed)
    }

    /// Whether the controller sees the home switch closed.
    pub(crate) fn switch_closed(&self) -> bool {
        self.switch_wire_broken.load(Relaxed)
            || self.switch_closed.load(Relaxed) && !self.switch_broken.load(Relaxed)
    }

    /// Makes the switch seem closed, or mends that.
    pub(crate) fn set_switch_wire(&self, broken: bool) {
        self.switch_wire_broken.store(broken, Relaxed);
    }

    /// Makes the switch seem open for ever.
    pub(crate) fn break_switch(&self) {
        self.switch_broken.store(true, Relaxed);
    }

    /// Step pulses received so far.
    pub(crate) fn steps(&self) -> u64 {
        self.steps.load(Relaxed)
    }

    /// The true angle at rest in radians: that of the axis, plus the scatter that belongs to this motor
    /// position.
    pub(crate) fn angle_rad(&self, seed: u64, axis: usize) -> f64 {
        let motor = self.motor.load(Relaxed) as u64;
        let scatter = noise::symmetric(&[seed, 0x5ca7, axis as u64, motor]) * self.scatter_rad;
        self.load.load(Relaxed) as f64 / PARTS * self.radians_per_step + scatter
    }
}
