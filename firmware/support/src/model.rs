//! A rig for boards under emulation, where nothing turns: home switches that follow the steps made, and a
//! photodiode that follows the lamp.
//!
//! An axis starts [`START`] steps above its lower switch, which is closed at position 0 and below; an upper
//! switch is closed from [`UPPER`] on. Both are on the one input, as two switches wired to one pin.

use core::sync::atomic::{AtomicBool, AtomicI32, AtomicU32, Ordering::Relaxed};

use embedded_hal::digital::{ErrorType, InputPin, OutputPin};
use embedded_hal::pwm::{self, SetDutyCycle};
use lobelia_firmware::{AnalogInput, StepPins};

use crate::trace::Trace;

/// Where an axis is at power-up, in steps above its lower switch.
pub const START: i32 = 300;
/// Where the upper switch closes.
pub const UPPER: i32 = 1_000_000;
/// The photodiode's reading at the lamp's full level.
pub const FULL_READING: u32 = 3000;

/// One axis of the modelled rig.
#[derive(Debug)]
pub struct Axis {
    position: AtomicI32,
    up: AtomicBool,
    /// Which axis this is, and where its steps are noted.
    index: u8,
    trace: &'static Trace,
}

impl Axis {
    /// An axis just switched on, with its number among the four.
    pub const fn new(index: u8, trace: &'static Trace) -> Self {
        Self { position: AtomicI32::new(START), up: AtomicBool::new(false), index, trace }
    }

    fn step(&self) {
        let up = self.up.load(Relaxed);
        self.trace.step(self.index, up);
        let by = if up { 1 } else { -1 };
        self.position.store(self.position.load(Relaxed) + by, Relaxed);
    }

    fn at_switch(&self) -> bool {
        !(1..UPPER).contains(&self.position.load(Relaxed))
    }
}

/// What an output does in the modelled rig, beside driving its pin.
#[derive(Debug, Clone, Copy)]
pub enum Role {
    /// Nothing.
    None,
    /// Turns an axis.
    Direction(&'static Axis),
}

/// A real output that the modelled rig listens to.
#[derive(Debug)]
pub struct Output<P> {
    /// The real pin.
    pub pin: P,
    /// What it does in the model.
    pub role: Role,
}

impl<P> Output<P> {
    fn tell(&self, high: bool) {
        match self.role {
            Role::None => {}
            Role::Direction(axis) => axis.up.store(high, Relaxed),
        }
    }
}

impl<P: ErrorType> ErrorType for Output<P> {
    type Error = P::Error;
}

impl<P: OutputPin> OutputPin for Output<P> {
    fn set_low(&mut self) -> Result<(), P::Error> {
        self.tell(false);
        self.pin.set_low()
    }

    fn set_high(&mut self) -> Result<(), P::Error> {
        self.tell(true);
        self.pin.set_high()
    }
}

/// Real step pins that the modelled axes listen to, until [`STANDS_STILL`].
#[derive(Debug)]
pub struct StepPort<P> {
    /// The real pins.
    pub pins: P,
    /// What they step.
    pub axes: &'static [Axis; 4],
}

/// Whether the modelled axes stay where they are whatever the steps, which costs no time then.
pub static STANDS_STILL: AtomicBool = AtomicBool::new(false);

impl<P: StepPins> StepPins for StepPort<P> {
    #[inline]
    fn write(&mut self, raise: u8, lower: u8) -> bool {
        if !STANDS_STILL.load(Relaxed) {
            step(self.axes, raise);
        }
        self.pins.write(raise, lower)
    }
}

#[inline(never)]
fn step(axes: &[Axis; 4], raise: u8) {
    for (_, axis) in axes.iter().enumerate().filter(|(axis, _)| raise & 1 << axis != 0) {
        axis.step();
    }
}

/// An input: a real pin, or the switch of a modelled axis.
#[derive(Debug)]
pub enum Input<P> {
    /// A real pin.
    Pin(P),
    /// The home switch of a modelled axis.
    Switch(&'static Axis),
}

impl<P: ErrorType> ErrorType for Input<P> {
    type Error = P::Error;
}

impl<P: InputPin> InputPin for Input<P> {
    fn is_high(&mut self) -> Result<bool, P::Error> {
        match self {
            Self::Pin(pin) => pin.is_high(),
            Self::Switch(axis) => Ok(axis.at_switch()),
        }
    }

    fn is_low(&mut self) -> Result<bool, P::Error> {
        self.is_high().map(|high| !high)
    }
}

/// The lamp's level as the modelled photodiode sees it: a share of the greatest duty in 1/65536.
#[derive(Debug, Default)]
pub struct Light(AtomicU32);

impl Light {
    /// Dark.
    pub const fn new() -> Self {
        Self(AtomicU32::new(0))
    }
}

/// A real dimmer that the modelled photodiode looks at.
#[derive(Debug)]
pub struct Dimmer<D> {
    /// The real dimmer.
    pub dimmer: D,
    /// What it lights.
    pub light: &'static Light,
}

impl<D: pwm::ErrorType> pwm::ErrorType for Dimmer<D> {
    type Error = D::Error;
}

impl<D: SetDutyCycle> SetDutyCycle for Dimmer<D> {
    fn max_duty_cycle(&self) -> u16 {
        self.dimmer.max_duty_cycle()
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), D::Error> {
        let full = u32::from(self.max_duty_cycle()).max(1);
        self.light.0.store((u32::from(duty) << 16) / full, Relaxed);
        self.dimmer.set_duty_cycle(duty)
    }
}

/// The modelled photodiode.
#[derive(Debug)]
pub struct Photodiode(pub &'static Light);

impl AnalogInput for Photodiode {
    fn read(&mut self) -> Option<u16> {
        Some(((self.0.0.load(Relaxed) * FULL_READING) >> 16) as u16)
    }
}

#[cfg(test)]
mod tests {
    use core::convert::Infallible;

    use super::*;

    struct Pin(bool);

    impl ErrorType for Pin {
        type Error = Infallible;
    }

    impl OutputPin for Pin {
        fn set_low(&mut self) -> Result<(), Infallible> {
            self.0 = false;
            Ok(())
        }

        fn set_high(&mut self) -> Result<(), Infallible> {
            self.0 = true;
            Ok(())
        }
    }

    #[test]
    fn switch_closes_after_as_many_steps_down_as_the_start_is_above_it() {
        static TRACE: Trace = Trace::new(|| 0);
        static AXES: [Axis; 4] =
            [Axis::new(0, &TRACE), Axis::new(1, &TRACE), Axis::new(2, &TRACE), Axis::new(3, &TRACE)];
        let mut port = StepPort { pins: [const { Pin(false) }; 4], axes: &AXES };
        for made in 0..START {
            assert!(!AXES[2].at_switch(), "after {made}");
            assert!(port.write(0b100, 0));
            assert!(port.pins[2].0 && !port.pins[1].0);
            assert!(port.write(0, 0b100));
            assert!(!port.pins[2].0);
        }
        assert!(AXES[2].at_switch() && !AXES[1].at_switch());
    }

    #[test]
    fn photodiode_follows_the_dimmer() {
        struct Half(u16);
        impl pwm::ErrorType for Half {
            type Error = Infallible;
        }
        impl SetDutyCycle for Half {
            fn max_duty_cycle(&self) -> u16 {
                1000
            }
            fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Infallible> {
                self.0 = duty;
                Ok(())
            }
        }
        static LIGHT: Light = Light::new();
        let mut dimmer = Dimmer { dimmer: Half(0), light: &LIGHT };
        dimmer.set_duty_cycle(500).unwrap();
        assert_eq!((dimmer.dimmer.0, Photodiode(&LIGHT).read()), (500, Some(1500)));
    }
}
