//! Pins as the controller sees them, their safe state, and what the emergency stop does to them. The README
//! has the map.

use core::convert::Infallible;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};

use embedded_hal::digital::{ErrorType, InputPin, OutputPin};
use lobelia_firmware::safety::EmergencyStop;
use lobelia_firmware::safety::alarm::Alarms;
use lobelia_firmware::{Outputs, StepPins};
use lobelia_protocol::{Pin, Pins};
use stm32f4xx_hal::gpio::{AnyPin, Input, PinExt};
use stm32f4xx_hal::pac;

/// Pins of port C that step: two bits each in its mode register.
const STEP_MODES: u32 = 0xFF;
/// The emergency stop's line.
const STOP: u32 = 1 << 9;
/// The lines of the alarm inputs of pan, tilt, roll and light, all on port C. The ninth is the stop's.
const ALARMS_AT: [u32; 4] = [8, 13, 10, 11];
/// The lamp level's pin on port A is its timer's, or a plain output.
const LEVEL_MODE: u32 = 0b11 << 12;
const LEVEL_TIMER: u32 = 0b10 << 12;
const LEVEL_OUT: u32 = 0b01 << 12;
/// Likewise the shutter's.
const SHUTTER_MODE: u32 = 0b11 << 2;
const SHUTTER_OUT: u32 = 0b01 << 2;
/// Under emulation no timer opens the shutter.
const SHUTTER_USUAL: u32 = if cfg!(feature = "qemu") { SHUTTER_OUT } else { 0b10 << 2 };

/// The emergency stop, between its interrupt and the controller.
pub(crate) static EMERGENCY_STOP: EmergencyStop = EmergencyStop::new();
/// The alarm inputs, between theirs and the controller.
pub(crate) static ALARMS: Alarms = Alarms::new();
/// Whether the step pins are let go, so that what is written to them reaches no driver.
static HELD: AtomicBool = AtomicBool::new(false);
/// Whether outputs are driven: once the wiring is known.
static WIRED: AtomicBool = AtomicBool::new(false);
/// What to write into `BSRR` of ports A, B and C so that nothing moves, burns or exposes.
static SAFE: [AtomicU32; 3] =
    [AtomicU32::new(levels(0x62, 0)), AtomicU32::new(levels(0, 0xF000)), AtomicU32::new(levels(0xFF, 0))];

/// `BSRR` for pins that become low, and others that become high.
const fn levels(low: u32, high: u32) -> u32 {
    low << 16 | high
}

/// Pins of a mask as they are off: low, or high where inverted.
const fn off(mask: u32, inverted: u32) -> u32 {
    levels(mask & !inverted, mask & inverted)
}

type Port = pac::gpioa::RegisterBlock;

/// Ports A, B and C.
fn port(number: usize) -> &'static Port {
    let ports: [*const Port; 3] = [pac::GPIOA::ptr(), pac::GPIOB::ptr().cast(), pac::GPIOC::ptr().cast()];
    // SAFETY: `BSRR` is written whole and only changes the pins named; modes and pulls are changed with the
    // interrupts off.
    unsafe { &*ports[number] }
}

fn write(number: usize, bits: u32) {
    // SAFETY: any bits only change levels.
    port(number).bsrr().write(|w| unsafe { w.bits(bits) });
}

/// Changes what a mask of a mode register has.
fn set_modes(number: usize, mask: u32, modes: u32) {
    // SAFETY: only the modes of pins that are outputs change.
    port(number).moder().modify(|r, w| unsafe { w.bits(r.bits() & !mask | modes) });
}

/// An output; drivers' enable inputs are inverted. It is left an input, to be pulled off, until the wiring is
/// known.
#[derive(Debug)]
pub struct OutputLine {
    port: usize,
    mask: u32,
    inverted: bool,
}

impl OutputLine {
    /// Takes a pin.
    pub(crate) fn new(pin: &AnyPin<Input>) -> Self {
        Self { port: pin.port_id().into(), mask: 1 << pin.pin_id(), inverted: false }
    }

    pub(crate) fn inverted(pin: &AnyPin<Input>) -> Self {
        Self { inverted: true, ..Self::new(pin) }
    }

    /// Drives it from now on, low: for an output whose wiring cannot be other.
    pub(crate) fn driven(self) -> Self {
        write(self.port, levels(self.mask, 0));
        let place = 2 * self.mask.trailing_zeros();
        set_modes(self.port, 0b11 << place, 0b01 << place);
        self
    }

    fn set(&mut self, high: bool) {
        write(self.port, if high != self.inverted { self.mask } else { self.mask << 16 });
    }
}

impl ErrorType for OutputLine {
    type Error = Infallible;
}

impl OutputPin for OutputLine {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.set(false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.set(true);
        Ok(())
    }
}

/// The step pins, PC0 to PC3, written at once.
#[derive(Debug)]
pub struct StepPort(());

impl StepPort {
    /// Takes the pins.
    pub(crate) fn new(_: [AnyPin<Input>; 4]) -> Self {
        Self(())
    }
}

impl StepPins for StepPort {
    fn write(&mut self, raise: u8, lower: u8) -> bool {
        write(2, levels(lower.into(), raise.into()));
        true
    }
}

/// An input: with a pull-up and a contact to ground that opens when the switch is met, so that a broken wire
/// reads the same; or with a pull-down, for what may be left out.
#[derive(Debug)]
pub struct InputLine(pub(crate) AnyPin<Input>);

impl ErrorType for InputLine {
    type Error = Infallible;
}

impl InputPin for InputLine {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.is_high())
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.is_low())
    }
}

/// Puts every output where nothing moves, burns or exposes, whoever owns the pins. Those that are inputs yet
/// are so already.
pub(crate) fn safe_state() {
    for (number, bits) in SAFE.iter().enumerate() {
        write(number, bits.load(Relaxed));
    }
    if WIRED.load(Relaxed) {
        // Plain outputs instead of timers'.
        set_modes(0, LEVEL_MODE | SHUTTER_MODE, LEVEL_OUT | SHUTTER_OUT);
    }
}

/// The emergency stop's interrupt, which it shares with an alarm input.
pub(crate) fn stop_or_alarm() {
    // SAFETY: reading changes nothing.
    let pending = unsafe { &*pac::EXTI::ptr() }.pr().read().bits();
    // Whatever came that is no alarm is the stop.
    if pending & STOP != 0 || pending & 1 << ALARMS_AT[0] == 0 {
        stop();
    }
    alarms(pending);
}

/// The alarm inputs' interrupt.
pub(crate) fn alarm() {
    // SAFETY: reading changes nothing.
    alarms(unsafe { &*pac::EXTI::ptr() }.pr().read().bits());
}

fn alarms(pending: u32) {
    for (axis, line) in ALARMS_AT.into_iter().enumerate().filter(|(_, line)| pending & 1 << line != 0) {
        // SAFETY: writing a line's bit forgets its interrupt and does nothing else; reading the clock changes
        // nothing.
        let now_us = unsafe {
            (*pac::EXTI::ptr()).pr().write(|w| w.bits(1 << line));
            (*pac::TIM5::ptr()).cnt().read().bits()
        };
        ALARMS.changed(axis, port(2).idr().read().bits() & 1 << line != 0, now_us);
    }
}

/// Everything off at once, whatever the controller is about to write to the step pins.
fn stop() {
    // SAFETY: writing a line's bit forgets its interrupt and does nothing else.
    unsafe { (*pac::EXTI::ptr()).pr().write(|w| w.bits(STOP)) };
    safe_state();
    set_modes(2, STEP_MODES, 0);
    HELD.store(true, Relaxed);
    EMERGENCY_STOP.trip();
}

/// Takes the step pins and the timers' pins back once the controller has seen the stop; it steps no axis
/// then, its lamp is off and its shutter closed.
pub fn after_poll() {
    if HELD.load(Relaxed) {
        cortex_m::interrupt::free(|_| {
            if !EMERGENCY_STOP.is_tripped() {
                HELD.store(false, Relaxed);
                // What was written to the step pins meanwhile must not become an edge.
                safe_state();
                if WIRED.load(Relaxed) {
                    drive();
                }
            }
        });
    }
}

/// Makes all outputs outputs.
fn drive() {
    // Steps and directions, and the fan.
    set_modes(2, 0x0300_FFFF, 0x0100_5555);
    set_modes(1, 0xFF00_0000, 0x5500_0000);
    set_modes(0, LEVEL_MODE | SHUTTER_MODE | 0b11 << 10, LEVEL_TIMER | SHUTTER_USUAL | 0b01 << 10);
}

/// All outputs, which are told their wiring.
#[derive(Debug)]
pub(crate) struct AllOutputs;

impl Outputs for AllOutputs {
    fn wired(&mut self, axes: [Pins; 4], rest: Pins) {
        let bits = |pin| (0..4).filter(|&axis| axes[axis].contains(pin)).map(|axis| 1 << axis).sum::<u32>();
        let one = |pin, place: u32| u32::from(rest.contains(pin)) << place;
        let a = off(0x62, one(Pin::Shutter, 1) | one(Pin::Lamp, 5));
        // The board's own enables are inverted.
        let b = off(0xF000, !(bits(Pin::Enable) << 12));
        let c = off(0xFF, bits(Pin::Step) | bits(Pin::Direction) << 4);
        cortex_m::interrupt::free(|_| {
            for (safe, bits) in SAFE.iter().zip([a, b, c]) {
                safe.store(bits, Relaxed);
            }
            WIRED.store(true, Relaxed);
            // Steps stay off while the emergency stop lets them go: 01 pulls up, 10 down.
            let up = |axis: u32| c >> axis & 1 != 0;
            let pulls: u32 =
                (0..4).map(|axis| if up(axis) { 0b01 << (2 * axis) } else { 0b10 << (2 * axis) }).sum();
            // SAFETY: only the step pins' pulls change.
            port(2).pupdr().modify(|r, w| unsafe { w.bits(r.bits() & !STEP_MODES | pulls) });
            #[cfg(not(feature = "qemu"))]
            crate::shutter::set_up(rest.contains(Pin::Shutter));
            if !HELD.load(Relaxed) {
                drive();
            }
        });
    }
}
