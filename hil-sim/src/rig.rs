//! The handle by which a program owns a simulated rig: its link, its clock, the truth, and what can go wrong.

use std::fmt;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use lobelia_protocol::Axis;

use crate::config::MechanicsConfig;
use crate::faults::LineCounts;
use crate::link::SimulatedLink;
use crate::truth::{ExposureTruth, Step};
use crate::wire::LineConfig;
use crate::world::World;

/// An idle host is heard this often, µs.
const KEEP_ALIVE_US: u64 = 500_000;

/// A way of the link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Way {
    /// Requests.
    ToController,
    /// Answers and events.
    ToHost,
}

/// A simulated rig. Clones are the same rig.
#[derive(Clone)]
pub struct SimulatedRig {
    world: Arc<Mutex<World>>,
}

impl fmt::Debug for SimulatedRig {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SimulatedRig").field("now_us", &self.now_us()).finish_non_exhaustive()
    }
}

impl SimulatedRig {
    /// A rig just switched on.
    pub fn new(config: &MechanicsConfig) -> Self {
        Self { world: Arc::new(Mutex::new(World::new(config))) }
    }

    pub(crate) fn lock(&self) -> MutexGuard<'_, World> {
        self.world.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The host's end of the link.
    pub fn link(&self) -> SimulatedLink {
        SimulatedLink::new(Arc::clone(&self.world))
    }

    /// Virtual time since the rig was switched on, µs; the controller's clock too, until it is reset.
    pub fn now_us(&self) -> u64 {
        self.lock().bench.now_us()
    }

    /// Lets virtual time pass without commands, for a host that is still there: it keeps its lease. Does
    /// nothing if the time is past.
    pub fn idle_until_us(&self, time_us: u64) {
        let mut world = self.lock();
        loop {
            world.keep_alive();
            let now = world.bench.now_us();
            if now >= time_us {
                return;
            }
            world.run_until(time_us.min(now + KEEP_ALIVE_US), false);
        }
    }

    /// Lets virtual time pass as when the host has died.
    pub fn abandon_until_us(&self, time_us: u64) {
        self.lock().run_until(time_us, false);
    }

    /// The truth of the last exposure.
    pub fn last_exposure(&self) -> Option<ExposureTruth> {
        self.lock().last_exposure
    }

    /// The truths of the exposures since they were last taken, in order.
    pub fn take_exposures(&self) -> Vec<ExposureTruth> {
        std::mem::take(&mut self.lock().new_exposures)
    }

    /// The level that the lamp burns at, 0 to 1; 0 when it is off.
    pub fn lamp_level(&self) -> f64 {
        self.lock().bench.lamp().level()
    }

    /// The true angles now of pan, tilt, roll and light in radians, errors included. They mean something at
    /// rest.
    pub fn angles_rad(&self) -> [f64; 4] {
        self.lock().angles_rad()
    }

    /// Step pulses that an axis's driver has received so far.
    pub fn steps_received(&self, axis: Axis) -> u64 {
        self.lock().bench.axes[axis.index()].steps()
    }

    /// Steps that the drivers received since this was last asked, in order; they are traced from the first
    /// time on.
    pub fn take_steps(&self) -> Vec<Step> {
        self.lock().take_steps()
    }

    /// Where an axis's motor truly is, in steps.
    pub fn motor_steps(&self, axis: Axis) -> i64 {
        self.lock().bench.axes[axis.index()].motor_steps()
    }

    /// Whether the shutter is open.
    pub fn shutter_open(&self) -> bool {
        self.lock().bench.is_shutter_open()
    }

    /// Presses the emergency stop.
    pub fn press_emergency_stop(&self) {
        self.set_emergency_stop(true);
    }

    /// Releases the emergency stop.
    pub fn release_emergency_stop(&self) {
        self.set_emergency_stop(false);
    }

    fn set_emergency_stop(&self, pressed: bool) {
        let mut world = self.lock();
        world.bench.emergency_stop.store(pressed, Relaxed);
        world.poll();
    }

    /// Makes the lamp's housing too hot, or lets it cool.
    pub fn set_over_temperature(&self, hot: bool) {
        let mut world = self.lock();
        world.bench.hot.store(hot, Relaxed);
        world.poll();
    }

    /// Pulls the link's plug: reading and writing fail from now on.
    pub fn unplug(&self) {
        self.lock().unplugged = true;
    }

    /// Plugs the link in again. What was on the way is lost.
    pub fn plug_in(&self) {
        let mut world = self.lock();
        world.bench.to_host.clear();
        world.unplugged = false;
    }

    /// Makes the link another line, both ways; it begins to count frames anew.
    pub fn set_line(&self, config: &LineConfig) {
        let world = self.lock();
        world.bench.to_controller.set(config, 0);
        world.bench.to_host.set(config, 1);
    }

    /// Frames that passed a line with faults since it was set, both ways.
    pub fn line_counts(&self) -> LineCounts {
        let world = self.lock();
        world.bench.to_controller.counts() + world.bench.to_host.counts()
    }

    /// Has one way of the link lose `count` bytes once `after` more have passed: `u64::MAX` cuts it, 0 mends
    /// it.
    pub fn lose_bytes(&self, way: Way, after: u64, count: u64) {
        let world = self.lock();
        match way {
            Way::ToController => world.bench.to_controller.lose(after, count),
            Way::ToHost => world.bench.to_host.lose(after, count),
        }
    }

    /// Cuts the controller's power for a moment: it forgets configuration, positions and session.
    pub fn reset_controller(&self) {
        self.lock().reset_controller();
    }

    /// Has an axis's driver tell that it has failed, or no longer.
    pub fn set_driver_alarm(&self, axis: Axis, failed: bool) {
        let mut world = self.lock();
        let bench = &world.bench;
        bench.axes[axis.index()].driver_failed.store(failed, Relaxed);
        bench.alarms.changed(axis.index(), bench.alarm_level(axis.index()), bench.now_us() as u32);
        world.poll();
    }

    /// Has an axis's alarm input be active for so many µs, between two polls of the controller.
    pub fn pulse_alarm(&self, axis: Axis, lasts_us: u32) {
        let bench = &self.lock().bench;
        let (k, quiet, now_us) = (axis.index(), bench.alarm_level(axis.index()), bench.now_us() as u32);
        bench.alarms.changed(k, !quiet, now_us);
        bench.alarms.changed(k, quiet, now_us.wrapping_add(lasts_us));
    }

    /// Makes an axis's motor slip by some steps, as when something pushes it.
    pub fn slip(&self, axis: Axis, steps: i32) {
        self.lock().bench.axes[axis.index()].shift(i64::from(steps));
    }

    /// A register of the TMC2209 of an axis.
    pub fn driver_register(&self, axis: Axis, register: u8) -> u32 {
        self.lock().bench.drivers().register(axis.index(), register)
    }

    /// Cuts the supply of an axis's driver for a moment: it forgets its settings.
    pub fn reset_driver(&self, axis: Axis) {
        self.lock().bench.drivers().reset(axis.index());
    }

    /// Cuts the wire by which drivers answer.
    pub fn cut_driver_wire(&self) {
        self.lock().bench.drivers().cut();
    }

    /// Breaks an axis's home switch: it never closes again.
    pub fn break_home_switch(&self, axis: Axis) {
        self.lock().bench.axes[axis.index()].break_switch();
    }

    /// Breaks the wire to an axis's home switch, so that it reads as closed, or mends it.
    pub fn set_home_switch_wire(&self, axis: Axis, broken: bool) {
        self.lock().bench.axes[axis.index()].set_switch_wire(broken);
    }
}
