//! What a board has to offer: pins, a lamp dimmer, a photodiode and a link.
//!
//! Pins are logical: high means stepping, forward, enabled, switch closed, shutter open, lamp burning, stop
//! pressed. What a board's pins do by themselves is in its table of pins; what a rig has otherwise is in its
//! parameters, and the controller inverts it. A home switch and the emergency stop should be wired so that a
//! broken wire reads as closed and pressed.

use embedded_hal::digital::{InputPin, OutputPin};
use embedded_hal::pwm::SetDutyCycle;
use lobelia_protocol::{AXES, CrashRecord, Pins};

use crate::driver::DriverBus;
pub use crate::motion::pulses::{Pulses, PulsesCell};
use crate::safety::EmergencyStop;
use crate::safety::alarm::Alarms;
use crate::storage::Storage;

/// A link that carries bytes and never waits.
pub trait ByteLink {
    /// The next byte received, if there is one.
    fn read(&mut self) -> Option<u8>;
    /// Sends a byte; false when there's no room for it now.
    fn write(&mut self, byte: u8) -> bool;
    /// Whether all that was written has left, or as good as. Events wait for it, so an answer never queues
    /// behind several of them; a link without a buffer need not tell.
    fn is_idle(&self) -> bool {
        true
    }
}

/// An analog input.
pub trait AnalogInput {
    /// A reading in counts; `None` when the converter fails.
    fn read(&mut self) -> Option<u16>;
    /// Begins to read again and again by itself, for so many µs from now, at a rate that is no multiple of a
    /// dimmer's; false for an input that can't. It is not asked to [`Self::read`] meanwhile.
    fn begin(&mut self, duration_us: u32) -> bool {
        let _ = duration_us;
        false
    }
    /// What was read by itself and not given yet; `None` when the converter fails. To be called each
    /// millisecond: what is overwritten before that is left out.
    fn gather(&mut self) -> Option<Readings> {
        None
    }
}

/// Readings of an analog input, summed up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Readings {
    /// How many.
    pub count: u32,
    /// Their sum.
    pub sum: u64,
    /// The sum of their squares.
    pub sum_of_squares: u64,
}

impl Readings {
    /// Adds a reading.
    pub fn add(&mut self, reading: u16) {
        let reading = u64::from(reading);
        self.count += 1;
        self.sum += reading;
        self.sum_of_squares += reading * reading;
    }
}

impl core::ops::AddAssign for Readings {
    fn add_assign(&mut self, more: Self) {
        self.count += more.count;
        self.sum += more.sum;
        self.sum_of_squares += more.sum_of_squares;
    }
}

/// A shutter that a timer opens and closes to the tick, whatever the program is doing.
pub trait TimedShutter {
    /// Opens it within 20 µs, for so many µs; gives when, in the lower half of the controller's time, or
    /// nothing when it can't.
    fn open(&mut self, duration_us: u32) -> Option<u32>;
    /// Closes it at once; false when it can't.
    fn close(&mut self) -> bool;
    /// Whether it is open, or about to be.
    fn is_open(&mut self) -> bool;
}

/// The board's outputs as a whole.
pub trait Outputs {
    /// The wiring is known, of each axis and of the rest, and every output was told to be off by it. Pins
    /// that were left to the pulls outside may be driven from now on; a crash's and the emergency stop's safe
    /// state goes by this wiring.
    fn wired(&mut self, axes: [Pins; AXES], rest: Pins);
}

/// What resets the chip when its supply sinks, before the program does what it likes.
pub trait BrownOut {
    /// Whether its level is as the board wants it.
    fn is_set(&mut self) -> bool;
    /// Sets the level, which may hold the processor up as long as writing its flash does.
    fn set(&mut self);
}

/// The step pins of all axes: a rising edge is one step.
pub trait StepPins {
    /// Raises some pins and lowers others, a bit an axis with pan the lowest; false when one could not be
    /// driven.
    fn write(&mut self, raise: u8, lower: u8) -> bool;
}

impl<P: OutputPin> StepPins for [P; AXES] {
    fn write(&mut self, raise: u8, lower: u8) -> bool {
        let mut done = true;
        for (axis, pin) in self.iter_mut().enumerate() {
            if raise & 1 << axis != 0 {
                done &= pin.set_high().is_ok();
            } else if lower & 1 << axis != 0 {
                done &= pin.set_low().is_ok();
            }
        }
        done
    }
}

/// A board's types. Output pins share one type and so do inputs: use the board's erased pins.
pub trait Board: Sized {
    /// An output pin.
    type Output: OutputPin;
    /// The step pins: `[Self::Output; 4]`, or on a board that has them on one port what writes them at once.
    type StepPort: StepPins;
    /// Where the steps are kept: `Pulses<Self>`, or where an interrupt finds them too.
    type Pulses: PulsesCell<Self>;
    /// An input pin.
    type Input: InputPin;
    /// The lamp's dimmer.
    type LampLevel: SetDutyCycle;
    /// The photodiode beside the lamp.
    type Photodiode: AnalogInput;
    /// The link to the host.
    type Link: ByteLink;
}

/// One axis's pins.
pub struct AxisPins<B: Board> {
    /// High: steps count up.
    pub direction: B::Output,
    /// High: the motor holds.
    pub enable: B::Output,
    /// High: the home switch is closed.
    pub home: B::Input,
}

/// All that the controller drives.
pub struct Peripherals<B: Board> {
    /// Pan, tilt, roll, light.
    pub axes: [AxisPins<B>; AXES],
    /// Of the same.
    pub steps: B::StepPort,
    /// High: open.
    pub shutter: B::Output,
    /// High: the lamp burns.
    pub lamp: B::Output,
    /// The lamp's level.
    pub lamp_level: B::LampLevel,
    /// The lamp's reference reading.
    pub photodiode: B::Photodiode,
    /// High: pressed.
    pub emergency_stop: B::Input,
    /// The host.
    pub link: B::Link,
}

/// How late a step may be, however soon after the last one it was due, unless a board says otherwise.
pub const BEARABLE_LATE_US: u32 = 100;

/// What a board may have besides.
pub struct Options<B: Board> {
    /// Of each axis: high while its driver tells an alarm, or a stall.
    pub alarm: [Option<B::Input>; AXES],
    /// What an interrupt at each change of the alarm inputs writes down; without one they are seen at polls
    /// only.
    pub alarms: Option<&'static Alarms>,
    /// High: lamp or drivers are too hot.
    pub over_temperature: Option<B::Input>,
    /// High: the camera can take a photograph.
    pub camera_ready: Option<B::Input>,
    /// The wire to the axes' drivers, TMC2209 with the axes' numbers as addresses.
    pub drivers: Option<&'static mut (dyn DriverBus + Send)>,
    /// Memory for parameters.
    pub storage: Option<&'static mut (dyn Storage + Send)>,
    /// Tripped by an interrupt.
    pub emergency_stop: Option<&'static EmergencyStop>,
    /// Resets the board when it isn't fed.
    pub watchdog: Option<&'static mut (dyn Watchdog + Send)>,
    /// What the last crash left behind.
    pub crash: Option<CrashRecord>,
    /// High: the lamp's fan runs.
    pub fan: Option<B::Output>,
    /// Takes the shutter pin's place.
    pub timed_shutter: Option<&'static mut (dyn TimedShutter + Send)>,
    /// Told when outputs may be driven.
    pub outputs: Option<&'static mut (dyn Outputs + Send)>,
    /// Set once, if it is otherwise, at rest and with the lamp dark.
    pub brown_out: Option<&'static mut (dyn BrownOut + Send)>,
    /// Changes at each poll, every millisecond at least, while the controller is well: it feeds a
    /// retriggerable monostable whose output lets the lamp's relay close, so that the lamp goes out when the
    /// program hangs, however it hangs.
    pub heartbeat: Option<B::Output>,
    /// Steps a second that the board makes in time, all axes together; parameters that ask for more are
    /// refused. Nothing where steps cost no time.
    pub most_steps_per_s: Option<u32>,
    /// A step that is later than this and than half its interval is a fault
    /// ([`Fault::StepsLate`](lobelia_protocol::Fault)), at most a second. An emulator's time is no measure of
    /// the program's, so there it may be long.
    pub bearable_late_us: u32,
    /// What the board can tell of itself.
    pub vitals: Option<&'static mut (dyn Vitals + Send)>,
}

/// What a board can tell of itself, for [`Health`](lobelia_protocol::Health). It is asked at each telemetry,
/// so an answer must be at hand.
pub trait Vitals {
    /// Bytes of the stack that were ever used, and that there are.
    fn stack(&mut self) -> Option<[u32; 2]> {
        None
    }
    /// Bytes received that were lost, because nobody took them in time, since the start.
    fn overruns(&mut self) -> u32 {
        0
    }
    /// The processor's supply, mV.
    fn supply_mv(&mut self) -> Option<u16> {
        None
    }
}

/// A timer that resets the board unless it is fed in time.
pub trait Watchdog {
    /// Starts the time anew.
    fn feed(&mut self);
}

impl<B: Board> Default for Options<B> {
    fn default() -> Self {
        Self {
            alarm: [const { None }; AXES],
            alarms: None,
            over_temperature: None,
            camera_ready: None,
            drivers: None,
            storage: None,
            emergency_stop: None,
            watchdog: None,
            crash: None,
            fan: None,
            timed_shutter: None,
            outputs: None,
            brown_out: None,
            heartbeat: None,
            most_steps_per_s: None,
            bearable_late_us: BEARABLE_LATE_US,
            vitals: None,
        }
    }
}
