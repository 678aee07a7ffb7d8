//! The simulated board: the firmware's pins, each a handle to the bench that it acts on.

use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use embedded_hal::digital::{self, InputPin, OutputPin};
use embedded_hal::pwm::{self, SetDutyCycle};
use lobelia_firmware::storage::Storage;
use lobelia_firmware::{
    AnalogInput, AxisPins, Board, ByteLink, Options, Peripherals, Pulses, Readings, TimedShutter,
};
use lobelia_protocol::Pin;

use crate::bench::Bench;
use crate::config::Wiring;
use crate::drivers::DriverWire;

/// The simulated board's types.
#[derive(Debug)]
pub(crate) struct SimulatedBoard;

impl Board for SimulatedBoard {
    type Output = Output;
    type StepPort = [Output; 4];
    type Pulses = Pulses<Self>;
    type Input = Input;
    type LampLevel = Dimmer;
    type Photodiode = Photodiode;
    type Link = ControllerEnd;
}

/// All pins of a bench.
pub(crate) fn peripherals(bench: &Arc<Bench>) -> Peripherals<SimulatedBoard> {
    let output = |role| Output { bench: Arc::clone(bench), role };
    let input = |role| Input { bench: Arc::clone(bench), role };
    Peripherals {
        axes: std::array::from_fn(|axis| AxisPins {
            direction: output(OutputRole::Direction(axis)),
            enable: output(OutputRole::Enable(axis)),
            home: input(InputRole::Home(axis)),
        }),
        steps: std::array::from_fn(|axis| output(OutputRole::Step(axis))),
        shutter: output(OutputRole::Shutter),
        lamp: output(OutputRole::Lamp),
        lamp_level: Dimmer(Arc::clone(bench)),
        photodiode: Photodiode(Arc::clone(bench)),
        emergency_stop: input(InputRole::EmergencyStop),
        link: ControllerEnd(Arc::clone(bench)),
    }
}

/// What the simulated board has besides. Wire and memory are leaked, a few bytes at each start of the
/// controller: a board's lives for ever.
pub(crate) fn options(bench: &Arc<Bench>) -> Options<SimulatedBoard> {
    let input = |role| Input { bench: Arc::clone(bench), role };
    let timer = || Box::leak(Box::new(ShutterTimer(Arc::clone(bench))));
    Options {
        alarm: std::array::from_fn(|axis| Some(input(InputRole::Alarm(axis)))),
        alarms: Some(bench.alarms),
        over_temperature: Some(input(InputRole::Hot)),
        timed_shutter: bench.timed.then(timer).map(|timer| timer as _),
        drivers: Some(Box::leak(Box::new(DriverWire(Arc::clone(&bench.drivers))))),
        storage: Some(Box::leak(Box::new(Flash(Arc::clone(bench))))),
        ..Options::default()
    }
}

/// The memory for parameters.
struct Flash(Arc<Bench>);

impl Storage for Flash {
    fn read(&mut self, slot: usize, into: &mut [u8]) -> bool {
        let slots = self.0.flash();
        let bytes = slots.get(slot).and_then(|bytes| bytes.get(..into.len()));
        bytes.map(|bytes| into.copy_from_slice(bytes)).is_some()
    }

    fn erase(&mut self, slot: usize) -> bool {
        self.0.flash().get_mut(slot).map(|bytes| bytes.fill(0xFF)).is_some()
    }

    fn write(&mut self, slot: usize, bytes: &[u8]) -> bool {
        let mut slots = self.0.flash();
        let into = slots.get_mut(slot).and_then(|slot| slot.get_mut(..bytes.len()));
        into.map(|into| into.copy_from_slice(bytes)).is_some()
    }
}

/// The shutter's timer.
struct ShutterTimer(Arc<Bench>);

impl TimedShutter for ShutterTimer {
    fn open(&mut self, duration_us: u32) -> Option<u32> {
        let now_us = self.0.now_us();
        self.0.shutter_until_us.store(now_us + u64::from(duration_us), Relaxed);
        self.0.shutter_open.store(true, Relaxed);
        Some(now_us as u32)
    }

    fn close(&mut self) -> bool {
        self.0.shutter_open.store(false, Relaxed);
        true
    }

    fn is_open(&mut self) -> bool {
        self.0.is_shutter_open()
    }
}

#[derive(Debug, Clone, Copy)]
enum OutputRole {
    Step(usize),
    Direction(usize),
    Enable(usize),
    Shutter,
    Lamp,
}

/// An output pin.
#[derive(Debug)]
pub(crate) struct Output {
    bench: Arc<Bench>,
    role: OutputRole,
}

impl Output {
    fn set(&self, high: bool) {
        let bench = &self.bench;
        let Wiring { axes, rest } = &bench.wiring;
        let inverted = match self.role {
            OutputRole::Step(axis) => axes[axis].contains(Pin::Step),
            OutputRole::Direction(axis) => axes[axis].contains(Pin::Direction),
            OutputRole::Enable(axis) => axes[axis].contains(Pin::Enable),
            OutputRole::Shutter => rest.contains(Pin::Shutter),
            OutputRole::Lamp => rest.contains(Pin::Lamp),
        };
        let high = high != inverted;
        match self.role {
            OutputRole::Step(axis) => {
                let mechanism = &bench.axes[axis];
                let rises = high && !mechanism.step_level.load(Relaxed);
                mechanism.step_level.store(high, Relaxed);
                if rises {
                    mechanism.step();
                    bench.note_step(axis);
                }
            }
            OutputRole::Direction(axis) => bench.axes[axis].up.store(high, Relaxed),
            OutputRole::Enable(axis) => bench.axes[axis].enabled.store(high, Relaxed),
            OutputRole::Shutter => bench.shutter_open.store(high, Relaxed),
            OutputRole::Lamp => bench.lamp().switch(bench.now_us(), high),
        }
    }
}

impl digital::ErrorType for Output {
    type Error = Infallible;
}

impl OutputPin for Output {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.set(false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.set(true);
        Ok(())
    }
}

#[derive(Debug, Clone, Copy)]
enum InputRole {
    Home(usize),
    Alarm(usize),
    EmergencyStop,
    Hot,
}

/// An input pin.
#[derive(Debug)]
pub(crate) struct Input {
    bench: Arc<Bench>,
    role: InputRole,
}

impl digital::ErrorType for Input {
    type Error = Infallible;
}

impl InputPin for Input {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(match self.role {
            InputRole::Home(axis) => {
                self.bench.axes[axis].switch_closed() != self.bench.wiring.axes[axis].contains(Pin::Home)
            }
            InputRole::Alarm(axis) => self.bench.alarm_level(axis),
            InputRole::EmergencyStop => self.bench.emergency_stop.load(Relaxed),
            InputRole::Hot => {
                self.bench.hot.load(Relaxed) != self.bench.wiring.rest.contains(Pin::OverTemperature)
            }
        })
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        self.is_high().map(|high| !high)
    }
}

/// The lamp's dimmer.
#[derive(Debug)]
pub(crate) struct Dimmer(Arc<Bench>);

impl pwm::ErrorType for Dimmer {
    type Error = Infallible;
}

impl SetDutyCycle for Dimmer {
    fn max_duty_cycle(&self) -> u16 {
        u16::MAX
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Infallible> {
        self.0.lamp().dim(f64::from(duty) / f64::from(u16::MAX));
        Ok(())
    }
}

/// The lamp's photodiode.
#[derive(Debug)]
pub(crate) struct Photodiode(Arc<Bench>);

impl AnalogInput for Photodiode {
    fn read(&mut self) -> Option<u16> {
        Some(self.0.lamp().reading(self.0.now_us()))
    }

    fn begin(&mut self, duration_us: u32) -> bool {
        self.0.metering().begin(self.0.now_us(), duration_us);
        self.0.timed
    }

    fn gather(&mut self) -> Option<Readings> {
        Some(self.0.metering().gather(&self.0.lamp(), self.0.now_us()))
    }
}

/// The controller's end of the link.
#[derive(Debug)]
pub(crate) struct ControllerEnd(Arc<Bench>);

impl ByteLink for ControllerEnd {
    fn read(&mut self) -> Option<u8> {
        let mut byte = [0];
        (self.0.to_controller.take(self.0.now_us(), &mut byte) == 1).then_some(byte[0])
    }

    fn write(&mut self, byte: u8) -> bool {
        self.0.to_host.push(self.0.now_us(), &[byte]);
        true
    }

    fn is_idle(&self) -> bool {
        self.0.to_host.free_us() <= self.0.now_us()
    }
}
