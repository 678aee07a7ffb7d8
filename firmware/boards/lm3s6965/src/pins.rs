//! The board's pins as the controller sees them, their safe state, and what the emergency stop does to them.
//!
//! | pins | use |
//! |---|---|
//! | PB0–PB3 | step of pan, tilt, roll, light |
//! | PB4–PB7 | direction of the same |
//! | PE0–PE3 | enable of the same |
//! | PD4–PD7 | home switch of the same |
//! | PD3 | emergency stop |
//! | PF0 | lamp level (PWM 0) |
//! | PF2, PF3 | shutter, lamp |
//! | PA0, PA1 | UART 0 receive, send |
//! | ADC0 | photodiode |
//!
//! Steps and directions share port B so that one watcher outside the emulated chip sees both.

use core::convert::Infallible;
use core::sync::atomic::{AtomicBool, Ordering::Relaxed};

use embedded_hal::digital::{ErrorType, InputPin, OutputPin};
use embedded_hal::pwm::{self, SetDutyCycle};
use lobelia_firmware::safety::EmergencyStop;

use crate::register::{self, PORT_A, PORT_B, PORT_D, PORT_E, PORT_F, Port, Register};

/// The modulator's period, in counts of the system clock: 20 kHz.
const PWM_PERIOD: u16 = 2500;

/// The pins of port B that step.
const STEPS: u32 = 0x0F;
/// The pin of port D that is the emergency stop.
const STOP: u8 = 3;

/// The emergency stop, between its interrupt and the controller.
pub(crate) static EMERGENCY_STOP: EmergencyStop = EmergencyStop::new();
/// Whether the step pins are let go, so that what is written to them reaches no driver.
static HELD: AtomicBool = AtomicBool::new(false);

/// One pin, already set up as output or input.
#[derive(Debug)]
pub struct Pin {
    data: Register,
}

impl Pin {
    pub(crate) const fn new(port: Port, bit: u8) -> Self {
        Self { data: port.data(1 << bit) }
    }
}

impl ErrorType for Pin {
    type Error = Infallible;
}

impl OutputPin for Pin {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.data.write(0);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.data.write(0xFF);
        Ok(())
    }
}

impl InputPin for Pin {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.data.read() != 0)
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(self.data.read() == 0)
    }
}

/// Sets all pins up, outputs low. The ports' clocks are running.
pub(crate) fn set_up() {
    safe_state();
    for (port, outputs, inputs) in
        [(PORT_B, 0xFF, 0), (PORT_D, 0, 0xF8), (PORT_E, 0x0F, 0), (PORT_F, 0x0C, 0)]
    {
        port.direction().write(outputs);
        port.digital().write(outputs | inputs);
    }
    // Steps stay low while the emergency stop lets them go.
    PORT_B.pull_down().write(STEPS);
    PORT_D.rising().write(1 << STOP);
    PORT_D.clear().write(1 << STOP);
    PORT_D.interrupts().write(1 << STOP);
    PORT_A.alternate().write(0x03);
    PORT_A.digital().write(0x03);
    PORT_F.alternate().write(0x01);
    PORT_F.digital().set_bits(0x01);
    // Counting down: high from the load to the comparator, low below.
    register::pwm::GENA.write(0x0000_008C);
    register::pwm::LOAD.write(u32::from(PWM_PERIOD) - 1);
    register::pwm::CMPA.write(u32::from(PWM_PERIOD) - 1);
    register::pwm::CTL.write(1);
}

/// Puts every output where nothing moves, burns or exposes: all low.
pub(crate) fn safe_state() {
    PORT_B.data(0xFF).write(0);
    PORT_E.data(0x0F).write(0);
    PORT_F.data(0x0C).write(0);
    register::pwm::ENABLE.write(0);
}

/// The emergency stop's interrupt: everything off at once, whatever the controller is about to write to the
/// step pins.
pub(crate) fn stop() {
    PORT_D.clear().write(1 << STOP);
    safe_state();
    // Low first: an input ignores what is written, and is again what it was as an output.
    PORT_B.direction().write(0xFF & !STEPS);
    HELD.store(true, Relaxed);
    EMERGENCY_STOP.trip();
}

/// Takes the step pins back once the controller has seen the stop; it steps no axis then.
pub fn after_poll() {
    if HELD.load(Relaxed) {
        cortex_m::interrupt::free(|_| {
            if !EMERGENCY_STOP.is_tripped() {
                HELD.store(false, Relaxed);
                PORT_B.direction().write(0xFF);
            }
        });
    }
}

/// The lamp's dimmer on PWM 0.
#[derive(Debug)]
pub struct LampLevel;

impl pwm::ErrorType for LampLevel {
    type Error = Infallible;
}

impl SetDutyCycle for LampLevel {
    fn max_duty_cycle(&self) -> u16 {
        PWM_PERIOD
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Infallible> {
        let duty = duty.min(PWM_PERIOD);
        register::pwm::CMPA.write(u32::from((PWM_PERIOD - duty).min(PWM_PERIOD - 1)));
        register::pwm::ENABLE.write(u32::from(duty > 0));
        Ok(())
    }
}

/// The photodiode on input 0 of the converter.
#[cfg(not(feature = "qemu"))]
#[derive(Debug)]
pub struct Photodiode;

#[cfg(not(feature = "qemu"))]
impl Photodiode {
    pub(crate) fn new() -> Self {
        use register::adc;
        adc::ACTSS.write(0);
        adc::SSMUX3.write(0);
        // One sample, which ends the sequence and sets its flag.
        adc::SSCTL3.write(0b0110);
        adc::ACTSS.write(1 << 3);
        Self
    }
}

#[cfg(not(feature = "qemu"))]
impl lobelia_firmware::AnalogInput for Photodiode {
    fn read(&mut self) -> Option<u16> {
        use register::adc;
        adc::PSSI.write(1 << 3);
        // A conversion takes 1 µs, 50 cycles.
        let done = (0..200).any(|_| adc::RIS.read() & 1 << 3 != 0);
        adc::ISC.write(1 << 3);
        done.then(|| adc::SSFIFO3.read() as u16 & 0x3FF)
    }
}

/// The step pins, written at once.
#[derive(Debug)]
pub struct StepPort;

impl lobelia_firmware::StepPins for StepPort {
    fn write(&mut self, raise: u8, lower: u8) -> bool {
        PORT_B.data(lower).write(0);
        PORT_B.data(raise).write(0xFF);
        true
    }
}

pub(crate) mod map {
    use super::{PORT_B, PORT_D, PORT_E, PORT_F, Pin};

    pub(crate) const fn direction(axis: u8) -> Pin {
        Pin::new(PORT_B, axis + 4)
    }

    pub(crate) const fn enable(axis: u8) -> Pin {
        Pin::new(PORT_E, axis)
    }

    #[cfg(not(feature = "qemu"))]
    pub(crate) const fn home(axis: u8) -> Pin {
        Pin::new(PORT_D, axis + 4)
    }

    pub(crate) const EMERGENCY_STOP: Pin = Pin::new(PORT_D, super::STOP);
    pub(crate) const SHUTTER: Pin = Pin::new(PORT_F, 2);
    pub(crate) const LAMP: Pin = Pin::new(PORT_F, 3);
}
