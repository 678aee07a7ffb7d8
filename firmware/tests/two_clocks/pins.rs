//! The pins of the rig of [`super::rig`]: each access takes time, and the interrupt may come after it.

use embedded_hal::digital::{self, InputPin, OutputPin};
use embedded_hal::pwm::{self, SetDutyCycle};
use lobelia_firmware::{AnalogInput, Board, ByteLink};

use crate::rig::{Shared, Steps, let_interrupt};

#[derive(Clone, Copy)]
pub(crate) enum Role {
    Step(usize),
    Direction(usize),
    Enable(usize),
    Home(usize),
    Shutter,
    Lamp,
    Stop,
    Alarm(usize),
}

#[derive(Debug)]
pub(crate) struct Broken;
pub(crate) struct Pin(pub(crate) Shared, pub(crate) Role);
pub(crate) struct Dimmer(pub(crate) Shared);
pub(crate) struct Diode;
pub(crate) struct Wire(pub(crate) Shared);
pub(crate) struct TwoClocks;

impl Board for TwoClocks {
    type Output = Pin;
    type StepPort = [Pin; 4];
    type Pulses = Steps;
    type Input = Pin;
    type LampLevel = Dimmer;
    type Photodiode = Diode;
    type Link = Wire;
}

impl digital::Error for Broken {
    fn kind(&self) -> digital::ErrorKind {
        digital::ErrorKind::Other
    }
}

impl pwm::Error for Broken {
    fn kind(&self) -> pwm::ErrorKind {
        pwm::ErrorKind::Other
    }
}

impl digital::ErrorType for Pin {
    type Error = Broken;
}

impl Pin {
    fn set(&self, high: bool) {
        {
            let world = &mut *self.0.borrow_mut();
            world.spend(200);
            let high = high != world.is_inverted(self.1);
            match self.1 {
                Role::Step(axis) => world.step_pin(axis, high),
                Role::Direction(axis) if world.up[axis] != high => {
                    world.up[axis] = high;
                    world.turned_ns[axis] = world.ns;
                }
                Role::Enable(axis) => world.enabled[axis] = high,
                Role::Lamp => world.lamp = high,
                Role::Direction(_) | Role::Home(_) | Role::Shutter | Role::Stop | Role::Alarm(_) => {}
            }
        }
        let_interrupt();
    }
}

impl OutputPin for Pin {
    fn set_low(&mut self) -> Result<(), Broken> {
        self.set(false);
        Ok(())
    }
    fn set_high(&mut self) -> Result<(), Broken> {
        self.set(true);
        Ok(())
    }
}

impl InputPin for Pin {
    fn is_high(&mut self) -> Result<bool, Broken> {
        let mut world = self.0.borrow_mut();
        world.spend(200);
        let active = match self.1 {
            Role::Home(axis) => world.switch(axis),
            Role::Alarm(axis) => world.alarm(axis),
            Role::Stop => world.stop_pressed,
            _ => false,
        };
        Ok(active != world.is_inverted(self.1))
    }
    fn is_low(&mut self) -> Result<bool, Broken> {
        self.is_high().map(|high| !high)
    }
}

impl pwm::ErrorType for Dimmer {
    type Error = Broken;
}

impl SetDutyCycle for Dimmer {
    fn max_duty_cycle(&self) -> u16 {
        1000
    }
    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Broken> {
        let mut world = self.0.borrow_mut();
        if world.dimmer_broken {
            return Err(Broken);
        }
        world.level_set = duty;
        Ok(())
    }
}

impl AnalogInput for Diode {
    fn read(&mut self) -> Option<u16> {
        Some(1234)
    }
}

impl ByteLink for Wire {
    fn read(&mut self) -> Option<u8> {
        self.0.borrow_mut().spend(500);
        let_interrupt();
        self.0.borrow_mut().to_controller.pop_front()
    }
    fn write(&mut self, byte: u8) -> bool {
        self.0.borrow_mut().to_host.push(byte);
        true
    }
}
