//! The controller's board on an LM3S6965 (Cortex-M3 at 50 MHz): registers, pins, interrupts, what a crash
//! does.
//!
//! QEMU models this chip whole (`-M lm3s6965evb`), so it is the one that the tests run. Its feature `qemu`
//! puts the modelled rig of `lobelia_board_support::model` in place of home switches and photodiode.
#![no_std]

#[path = "../../shared/crash.rs"]
mod crash;
#[cfg(feature = "qemu")]
#[path = "../../shared/emulation.rs"]
pub mod emulation;
#[cfg(not(feature = "qemu"))]
mod flash;
mod interrupt;
#[path = "../../shared/kept.rs"]
mod kept;
mod pins;
mod register;
#[path = "../../shared/steps.rs"]
mod steps;
#[path = "../../shared/vitals.rs"]
pub mod vitals;
mod watchdog;

use lobelia_board_support::link::{Received, RingLink, ToSend};
#[cfg(feature = "qemu")]
use lobelia_board_support::model;
use lobelia_firmware::storage::Storage;
use lobelia_firmware::{AxisPins, Board, Options, Peripherals, Vitals};

pub use interrupt::{CLOCK_RELOAD, now_us, serve_steps, sleep_until, wake_steps};
use pins::{LampLevel, map};
pub use pins::{Pin, after_poll};
use register::{system, timer, uart};

/// The board's types.
#[derive(Debug)]
pub struct Lm3s6965;

pub(crate) use Lm3s6965 as ThisBoard;

#[cfg(not(feature = "qemu"))]
impl Board for Lm3s6965 {
    type Output = Pin;
    type StepPort = pins::StepPort;
    type Pulses = steps::Steps;
    type Input = Pin;
    type LampLevel = LampLevel;
    type Photodiode = pins::Photodiode;
    type Link = RingLink;
}

#[cfg(feature = "qemu")]
impl Board for Lm3s6965 {
    type Output = model::Output<Pin>;
    type StepPort = model::StepPort<pins::StepPort>;
    type Pulses = steps::Steps;
    type Input = model::Input<Pin>;
    type LampLevel = model::Dimmer<LampLevel>;
    type Photodiode = model::Photodiode;
    type Link = RingLink;
}

/// The link's rings, for whoever takes the UART's place.
pub fn rings() -> (&'static Received, &'static ToSend) {
    (&interrupt::RECEIVED, &interrupt::TO_SEND)
}

/// Sends a byte without the interrupt, waiting for room.
pub fn send_directly(byte: u8) {
    while uart::FR.read() & uart::SEND_FULL != 0 {}
    uart::DR.write(u32::from(byte));
}

/// Lets interrupts other than the clock's come.
pub fn start_interrupts() {
    interrupt::unmask();
}

/// Sets the whole board up; interrupts other than the clock's stay off. `None` at a second call.
pub fn set_up() -> Option<Peripherals<Lm3s6965>> {
    let mut core = cortex_m::Peripherals::take()?;
    start_system_clock();
    system::RCGC0.set_bits(1 << 3 | 1 << 16 | 1 << 20);
    system::RCGC1.set_bits(1 << 0 | 1 << 16 | 1 << 17);
    system::RCGC2.set_bits(0x3F);
    // Three cycles until a unit whose clock was just started may be touched.
    cortex_m::asm::delay(8);
    pins::set_up();
    set_up_uart();
    set_up_timers();
    interrupt::set_priorities(&mut core.NVIC, &mut core.SCB);
    interrupt::start_clock(&mut core.SYST);
    Some(peripherals())
}

/// Half of what it can make with nothing else to do, over all axes.
const MOST_STEPS_PER_S: u32 = 30_000;

/// What the board has besides: the emergency stop's interrupt, the watchdog, memory for parameters, and the
/// record of the last crash. To be called once.
pub fn options() -> Options<Lm3s6965> {
    let watchdog = cortex_m::singleton!(: watchdog::Watchdog = watchdog::Watchdog);
    let reset = watchdog::take_reset();
    Options {
        storage: storage(),
        emergency_stop: Some(&pins::EMERGENCY_STOP),
        watchdog: watchdog.map(|watchdog| watchdog as _),
        crash: kept::take_crash().or(reset),
        most_steps_per_s: Some(MOST_STEPS_PER_S),
        vitals: cortex_m::singleton!(: BoardVitals = BoardVitals).map(|vitals| vitals as _),
        ..Options::default()
    }
}

/// What the board can tell of itself; its supply it can't measure.
#[derive(Debug)]
struct BoardVitals;

impl Vitals for BoardVitals {
    fn stack(&mut self) -> Option<[u32; 2]> {
        vitals::stack()
    }

    fn overruns(&mut self) -> u32 {
        vitals::overruns()
    }
}

#[cfg(not(feature = "qemu"))]
fn storage() -> Option<&'static mut (dyn Storage + Send)> {
    cortex_m::singleton!(: flash::FlashSlots = flash::FlashSlots).map(|slots| slots as _)
}

#[cfg(feature = "qemu")]
fn storage() -> Option<&'static mut (dyn Storage + Send)> {
    cortex_m::singleton!(: kept::KeptSlots = kept::KeptSlots).map(|slots| slots as _)
}

/// 50 MHz from the 8 MHz crystal through the PLL.
fn start_system_clock() {
    const BYPASS: u32 = 1 << 11;
    let source = system::RCC.read() | BYPASS;
    // Not yet from the PLL and undivided.
    system::RCC.write(source & !(1 << 22));
    // Crystal 8 MHz, main oscillator on and chosen, PLL powered; system clock 200 MHz / 4.
    let source = source & !(0xF << 6 | 0b11 << 4 | 1 << 13 | 1 << 0 | 0xF << 23);
    let source = source | 0xE << 6 | 3 << 23 | 1 << 22;
    system::RCC.write(source);
    // The PLL locks within 0.5 ms; a chip whose PLL doesn't runs on without it, too slowly to talk to.
    for _ in 0..100_000 {
        if system::RIS.read() & 1 << 6 != 0 {
            break;
        }
    }
    system::RCC.write(source & !BYPASS);
}

/// 115 200 baud, 8 bits, no parity, FIFOs.
fn set_up_uart() {
    uart::CTL.write(0);
    // 50 MHz / (16 × 115 200) = 27 + 8/64.
    uart::IBRD.write(27);
    uart::FBRD.write(8);
    uart::LCRH.write(0b11 << 5 | 1 << 4);
    // Interrupts: received, received and then silence, room to send.
    uart::IM.write(1 << 4 | 1 << 5 | 1 << 6);
    uart::CTL.write(1 << 9 | 1 << 8 | 1);
}

/// 32-bit one-shot timers: 0 for the main loop's sleep, 1 for the steps.
fn set_up_timers() {
    for timer in [timer::SLEEP, timer::STEPS] {
        timer.control().write(0);
        timer.configuration().write(0);
        timer.mode().write(1);
        timer.interrupts().write(1);
    }
}

#[cfg(not(feature = "qemu"))]
fn peripherals() -> Peripherals<Lm3s6965> {
    let axes = [0, 1, 2, 3].map(|axis| AxisPins {
        direction: map::direction(axis),
        enable: map::enable(axis),
        home: map::home(axis),
    });
    Peripherals {
        axes,
        steps: pins::StepPort,
        shutter: map::SHUTTER,
        lamp: map::LAMP,
        lamp_level: LampLevel,
        photodiode: pins::Photodiode::new(),
        emergency_stop: map::EMERGENCY_STOP,
        link: link(),
    }
}

#[cfg(feature = "qemu")]
fn peripherals() -> Peripherals<Lm3s6965> {
    static AXES: [model::Axis; 4] = [
        model::Axis::new(0, &emulation::TRACE),
        model::Axis::new(1, &emulation::TRACE),
        model::Axis::new(2, &emulation::TRACE),
        model::Axis::new(3, &emulation::TRACE),
    ];
    static LIGHT: model::Light = model::Light::new();
    let output = |pin, role| model::Output { pin, role };
    let axes = [0, 1, 2, 3].map(|axis| {
        let modelled = &AXES[usize::from(axis)];
        AxisPins {
            direction: output(map::direction(axis), model::Role::Direction(modelled)),
            enable: output(map::enable(axis), model::Role::None),
            home: model::Input::Switch(modelled),
        }
    });
    Peripherals {
        axes,
        steps: model::StepPort { pins: pins::StepPort, axes: &AXES },
        shutter: output(map::SHUTTER, model::Role::None),
        lamp: output(map::LAMP, model::Role::None),
        lamp_level: model::Dimmer { dimmer: LampLevel, light: &LIGHT },
        photodiode: model::Photodiode(&LIGHT),
        emergency_stop: model::Input::Pin(map::EMERGENCY_STOP),
        link: link(),
    }
}

fn link() -> RingLink {
    RingLink { received: &interrupt::RECEIVED, to_send: &interrupt::TO_SEND, wake: interrupt::wake_uart }
}
