//! The part of the controller that has to do with how the rig is wired: which pins are inverted, and the
//! alarm inputs.
//!
//! Which level of an output is off is not known before there are parameters. Until then the controller drives
//! none, and pulls outside decide.

use core::array;

use embedded_hal::digital::InputPin;
use lobelia_protocol::{AXES, Alarm, Axis, Configuration, Fault, Field, Pin, Pins, Refusal};

use super::Controller;
use crate::board::{Board, Options};
use crate::motion::pulses::PulsesCell;
use crate::pin::{Line, PinFailure, set};

/// How the rig is wired, as it was last told to the pins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Wiring {
    axes: [Pins; AXES],
    rest: Pins,
}

impl Wiring {
    fn of(configuration: &Configuration) -> Self {
        Self { axes: configuration.axes.map(|axis| axis.inverted), rest: configuration.settings.inverted }
    }

    /// A pin of each axis, a bit an axis.
    fn bits(&self, pin: Pin) -> u8 {
        (0..AXES).map(|axis| u8::from(self.axes[axis].contains(pin)) << axis).sum()
    }
}

impl<B: Board> Controller<B> {
    /// Refuses alarms for which the board has no input.
    pub(super) fn check_alarms(&self, configuration: &Configuration) -> Result<(), Refusal> {
        let missing = |axis: &Axis| {
            let k = axis.index();
            configuration.axes[k].alarm != Alarm::None && self.lines.alarm[k].is_none()
        };
        let refused = |axis| Refusal::BadParameter { axis: Some(axis), field: Field::Alarm };
        Axis::ALL.into_iter().find(missing).map_or(Ok(()), |axis| Err(refused(axis)))
    }

    /// Tells the pins how they are wired. Where that is news all outputs are put off by it, and only then
    /// driven.
    pub(super) fn wire(&mut self, now_us: u64, configuration: &Configuration) -> Result<(), PinFailure> {
        let alarms = self.options.alarms.unwrap_or(&self.own_alarms);
        for (k, p) in configuration.axes.iter().enumerate() {
            self.pulses.with(|_| alarms.set(k, p.inverted.contains(Pin::Alarm), p.alarm_debounce_us));
        }
        let wiring = Wiring::of(configuration);
        if self.wiring == Some(wiring) {
            return Ok(());
        }
        self.wiring = Some(wiring);
        let mut done = self.pulses.with(|pulses| pulses.wire(wiring.bits(Pin::Step), wiring.bits(Pin::Home)));
        for (axis, inverted) in self.axes.iter_mut().zip(wiring.axes) {
            done = done.and(axis.wire(inverted));
        }
        self.lamp.wire(wiring.rest.contains(Pin::Lamp));
        self.shutter.wire(wiring.rest.contains(Pin::Shutter));
        done = done.and(self.lamp.put_out(now_us)).and(self.shutter.close());
        done = done.and(self.lines.wire(wiring.rest));
        self.fan_runs = false;
        if let Some(outputs) = &mut self.options.outputs {
            outputs.wired(wiring.axes, wiring.rest);
        }
        done
    }

    /// Looks at the alarm inputs of the axes that have one. A failed driver is a fault of its axis, moving or
    /// not; a stall one while it moves.
    pub(super) fn mind_alarms(&mut self, now_us: u64) {
        for axis in Axis::ALL {
            let k = axis.index();
            let meaning = self.alarm_means(k);
            let alarms = self.options.alarms.unwrap_or(&self.own_alarms);
            let Some(line) = self.lines.alarm[k].as_mut().filter(|_| meaning != Alarm::None) else {
                continue;
            };
            let rung = self.pulses.with(|_| {
                line.is_high().map(|high| alarms.look(k, high, now_us as u32)).map(|()| alarms.take(k))
            });
            match (rung, meaning) {
                (Err(_), _) => self.raise(now_us, Fault::Hardware, Some(axis)),
                (Ok(true), Alarm::Level) if self.alarmed & 1 << k == 0 => {
                    self.alarmed |= 1 << k;
                    self.raise(now_us, Fault::DriverAlarm, Some(axis));
                }
                (Ok(true), Alarm::Edge) if self.axes[k].moving() => {
                    self.raise(now_us, Fault::Stall, Some(axis));
                }
                // What an axis at rest shows is of no move to come.
                (Ok(_), _) => {}
            }
        }
    }

    /// Which alarm inputs are active, of those that mean something.
    pub(super) fn active_alarms(&self) -> [bool; AXES] {
        let alarms = self.options.alarms.unwrap_or(&self.own_alarms);
        array::from_fn(|k| self.alarm_means(k) != Alarm::None && alarms.is_active(k))
    }

    /// What an axis's alarm input means; nothing before there are parameters.
    fn alarm_means(&self, axis: usize) -> Alarm {
        self.configuration.as_ref().map_or(Alarm::None, |configuration| configuration.axes[axis].alarm)
    }

    /// When an alarm input that is active will count, in µs.
    pub(super) fn alarm_us(&self) -> u64 {
        let alarms = self.options.alarms.unwrap_or(&self.own_alarms);
        let left = (0..AXES).filter_map(|k| alarms.left_us(k, self.now_us as u32)).min();
        left.map_or(u64::MAX, |left| self.now_us + u64::from(left))
    }
}

/// Inputs and outputs that a board may have.
pub(super) struct Lines<B: Board> {
    pub(super) alarm: [Option<B::Input>; AXES],
    pub(super) over_temperature: Option<Line<B::Input>>,
    pub(super) camera_ready: Option<Line<B::Input>>,
    pub(super) fan: Option<Line<B::Output>>,
}

impl<B: Board> Lines<B> {
    /// Takes them out of a board's options.
    pub(super) fn of(options: &mut Options<B>) -> Self {
        Self {
            alarm: core::mem::replace(&mut options.alarm, [const { None }; AXES]),
            over_temperature: options.over_temperature.take().map(Line::new),
            camera_ready: options.camera_ready.take().map(Line::new),
            fan: options.fan.take().map(Line::new),
        }
    }

    fn wire(&mut self, inverted: Pins) -> Result<(), PinFailure> {
        for (line, pin) in
            [(&mut self.over_temperature, Pin::OverTemperature), (&mut self.camera_ready, Pin::CameraReady)]
        {
            if let Some(line) = line {
                line.wire(inverted.contains(pin));
            }
        }
        let Some(fan) = &mut self.fan else { return Ok(()) };
        fan.wire(inverted.contains(Pin::Fan));
        set(fan, false)
    }
}
