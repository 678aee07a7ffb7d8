//! The world: the controller, the bench and the virtual clock that jumps from one event to the next.

use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use lobelia_firmware::Controller;

use crate::bench::Bench;
use crate::config::MechanicsConfig;
use crate::pins::{self, SimulatedBoard};
use crate::truth::{ExposureTruth, Step};

/// The firmware on a bench, at a virtual time.
pub(crate) struct World {
    controller: Controller<SimulatedBoard>,
    pub(crate) bench: Arc<Bench>,
    seed: u64,
    shutter_opened_us: Option<u64>,
    exposures: u64,
    pub(crate) last_exposure: Option<ExposureTruth>,
    /// Since somebody last took them.
    pub(crate) new_exposures: Vec<ExposureTruth>,
    pub(crate) unplugged: bool,
}

impl World {
    pub(crate) fn new(config: &MechanicsConfig) -> Self {
        let bench = Arc::new(Bench::new(config));
        Self {
            controller: Controller::with_options(pins::peripherals(&bench), pins::options(&bench)),
            bench,
            seed: config.seed,
            shutter_opened_us: None,
            exposures: 0,
            last_exposure: None,
            new_exposures: Vec::new(),
            unplugged: false,
        }
    }

    /// Switches the controller off and on: it forgets all, the mechanics stay as they are.
    pub(crate) fn reset_controller(&mut self) {
        self.bench.to_controller.clear();
        self.bench.to_host.clear();
        self.bench.axes.iter().for_each(|axis| axis.enabled.store(false, Relaxed));
        self.bench.shutter_open.store(false, Relaxed);
        self.bench.lamp().switch(self.bench.now_us(), false);
        let (pins, options) = (pins::peripherals(&self.bench), pins::options(&self.bench));
        self.controller = Controller::with_options(pins, options);
        self.watch_shutter();
    }

    /// Lets the controller see what has changed, without time passing.
    pub(crate) fn poll(&mut self) {
        self.controller.poll(self.bench.now_us());
        self.watch_shutter();
    }

    /// Renews the host's lease.
    pub(crate) fn keep_alive(&mut self) {
        self.controller.keep_alive(self.bench.now_us());
    }

    /// Lets time pass until `deadline_us`, or with `for_output` until the host has something to read.
    pub(crate) fn run_until(&mut self, deadline_us: u64, for_output: bool) {
        while !for_output || self.bench.to_host.next_us() > self.bench.now_us() {
            let now = self.bench.now_us();
            let next = self.next_event_us(now).max(now).min(deadline_us.max(now));
            if next == now && now >= deadline_us {
                return;
            }
            self.bench.now_us.store(next, Relaxed);
            if self.bench.to_controller.next_us() <= next {
                self.controller.poll(next);
            } else {
                self.controller.tick(next);
            }
            self.watch_shutter();
        }
    }

    /// When something happens next that the controller or the host has to see.
    fn next_event_us(&self, now: u64) -> u64 {
        let Bench { to_controller, to_host, .. } = &*self.bench;
        // A line that falls free lets an event go.
        let free = Some(to_host.free_us()).filter(|&us| us > now).unwrap_or(u64::MAX);
        let arrives = to_host.next_us();
        let arrives = if arrives > now { arrives } else { u64::MAX };
        self.controller.next_event_us().min(to_controller.next_us()).min(arrives).min(free)
    }

    /// Steps since this was last asked; they are traced from the first time on.
    pub(crate) fn take_steps(&self) -> Vec<Step> {
        self.bench.traced.store(true, Relaxed);
        self.bench.take_trace()
    }

    /// Notes the truth of an exposure when the shutter closes.
    fn watch_shutter(&mut self) {
        let open = self.bench.is_shutter_open();
        let now = self.bench.now_us();
        match self.shutter_opened_us {
            None if open => self.shutter_opened_us = Some(now),
            Some(start_us) if !open => {
                self.shutter_opened_us = None;
                self.exposures += 1;
                self.new_exposures.push(ExposureTruth {
                    sequence: self.exposures,
                    start_us,
                    open_s: (now - start_us) as f64 * 1e-6,
                    axes_rad: self.angles_rad(),
                    lamp_relative: self.bench.lamp().mean_relative(start_us, now),
                });
                self.last_exposure = self.new_exposures.last().copied();
            }
            _ => {}
        }
    }

    /// The true angles, errors included.
    pub(crate) fn angles_rad(&self) -> [f64; 4] {
        std::array::from_fn(|axis| self.bench.axes[axis].angle_rad(self.seed, axis))
    }
}
