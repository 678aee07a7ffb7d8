//! The controller's board on an STM32F405 (Cortex-M4 at 168 MHz from an 8 MHz crystal). Pins and wiring are
//! in the README.
//!
//! With the feature `qemu` the binary runs on QEMU's `olimex-stm32-h405`: on the internal oscillator, and
//! with the modelled rig of `lobelia_board_support::model` in place of home switches, lamp level and
//! photodiode.
#![no_std]

#[cfg(not(feature = "qemu"))]
mod brown_out;
#[path = "../../shared/crash.rs"]
mod crash;
#[cfg(not(feature = "qemu"))]
mod drivers;
#[cfg(feature = "qemu")]
#[path = "../../shared/emulation.rs"]
pub mod emulation;
#[cfg(not(feature = "qemu"))]
mod flash;
mod interrupt;
#[path = "../../shared/kept.rs"]
mod kept;
#[cfg(not(feature = "qemu"))]
mod photodiode;
mod pins;
#[cfg(not(feature = "qemu"))]
mod shutter;
#[path = "../../shared/steps.rs"]
mod steps;
#[cfg(not(feature = "qemu"))]
mod supply;
#[path = "../../shared/vitals.rs"]
pub mod vitals;
#[cfg(not(feature = "qemu"))]
mod watchdog;

use lobelia_board_support::link::{Received, RingLink, ToSend};
#[cfg(feature = "qemu")]
use lobelia_board_support::model;
use lobelia_firmware::{AxisPins, Board, Options, Peripherals, Vitals};
use stm32f4xx_hal::gpio::{AnyPin, Edge, ExtiPin, Input, Pin};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::{pac, rcc, serial};

#[cfg(feature = "qemu")]
pub use interrupt::{COUNTER_RELOAD, count_far};
pub use interrupt::{now_us, rest_until, send_directly, serve_steps, start_interrupts, wake_steps};
pub use pins::{InputLine, OutputLine, StepPort, after_poll};

/// The board's types.
#[derive(Debug)]
pub struct Stm32f405;

pub(crate) use Stm32f405 as ThisBoard;

#[cfg(not(feature = "qemu"))]
pub mod parts {
    //! The real lamp level and photodiode.

    use stm32f4xx_hal::pac;
    use stm32f4xx_hal::timer::PwmChannel;

    pub use crate::photodiode::Photodiode;

    /// TIM3's channel 1.
    pub type LampLevel = PwmChannel<pac::TIM3, 0>;
}

#[cfg(not(feature = "qemu"))]
impl Board for Stm32f405 {
    type Output = OutputLine;
    type StepPort = StepPort;
    type Pulses = steps::Steps;
    type Input = InputLine;
    type LampLevel = parts::LampLevel;
    type Photodiode = parts::Photodiode;
    type Link = RingLink;
}

#[cfg(feature = "qemu")]
pub mod parts {
    //! A lamp level that drives nothing: QEMU's timers can't be set up as the HAL does it.

    use core::convert::Infallible;

    use embedded_hal::pwm::{ErrorType, SetDutyCycle};

    /// No dimmer.
    #[derive(Debug)]
    pub struct NoDimmer;

    impl ErrorType for NoDimmer {
        type Error = Infallible;
    }

    impl SetDutyCycle for NoDimmer {
        fn max_duty_cycle(&self) -> u16 {
            u16::MAX
        }

        fn set_duty_cycle(&mut self, _: u16) -> Result<(), Infallible> {
            Ok(())
        }
    }
}

#[cfg(feature = "qemu")]
impl Board for Stm32f405 {
    type Output = model::Output<OutputLine>;
    type StepPort = model::StepPort<StepPort>;
    type Pulses = steps::Steps;
    type Input = model::Input<InputLine>;
    type LampLevel = model::Dimmer<parts::NoDimmer>;
    type Photodiode = model::Photodiode;
    type Link = RingLink;
}

/// The link's rings, for whoever takes the port's place.
pub fn rings() -> (&'static Received, &'static ToSend) {
    (&interrupt::RECEIVED, &interrupt::TO_SEND)
}

fn clocks() -> rcc::Config {
    if cfg!(feature = "qemu") {
        rcc::Config::hsi()
    } else {
        rcc::Config::hse(8.MHz()).sysclk(168.MHz()).hclk(168.MHz()).pclk1(42.MHz()).pclk2(84.MHz())
    }
}

/// Half of what it can make with nothing else to do, over all axes.
const MOST_STEPS_PER_S: u32 = 128_000;

/// Sets the whole board up; interrupts other than the clock's stay off. `None` at a second call.
pub fn set_up() -> Option<(Peripherals<Stm32f405>, Options<Stm32f405>)> {
    let device = pac::Peripherals::take()?;
    let mut core = cortex_m::Peripherals::take()?;
    #[cfg(not(feature = "qemu"))]
    let reset = watchdog::take_reset(&device.RCC);
    #[cfg(feature = "qemu")]
    let reset = None;
    let mut rcc = device.RCC.freeze(clocks());
    interrupt::set_priorities(&mut core.NVIC, &mut core.SCB);
    interrupt::start_clock(&mut core.SYST);
    let a = device.GPIOA.split(&mut rcc);
    let b = device.GPIOB.split(&mut rcc);
    let c = device.GPIOC.split(&mut rcc);

    let config = serial::Config::default().baudrate(115_200.bps()).wordlength_8();
    let port: serial::Serial<pac::USART2> = device.USART2.serial((a.pa2, a.pa3), config, &mut rcc).ok()?;
    let (tx, rx) = port.split();
    interrupt::give_port(tx, rx);

    let steps = StepPort::new([low(c.pc0), low(c.pc1), low(c.pc2), low(c.pc3)]);
    let directions = [output(c.pc4), output(c.pc5), output(c.pc6), output(c.pc7)];
    let enables = [disabled(b.pb12), disabled(b.pb13), disabled(b.pb14), disabled(b.pb15)];
    let homes = [input(b.pb5), input(b.pb6), input(b.pb7), input(b.pb8)];
    let mut stop = b.pb9.into_pull_up_input();
    let (mut exti, mut syscfg) = (device.EXTI, device.SYSCFG.constrain(&mut rcc));
    stop.make_interrupt_source(&mut syscfg);
    stop.trigger_on_edge(&mut exti, Edge::Rising);
    stop.enable_interrupt(&mut exti);
    let mut alarm = [low(c.pc8), low(c.pc13), low(c.pc10), low(c.pc11)];
    for pin in &mut alarm {
        pin.make_interrupt_source(&mut syscfg);
        pin.trigger_on_edge(&mut exti, Edge::RisingFalling);
        pin.enable_interrupt(&mut exti);
    }
    #[cfg(not(feature = "qemu"))]
    let wire = device.USART3.serial((b.pb10, b.pb11), config, &mut rcc).ok().map(drivers::DriverWire)?;
    let options = Options {
        alarm: alarm.map(|pin| Some(modelled(InputLine(pin)))),
        alarms: Some(&pins::ALARMS),
        outputs: cortex_m::singleton!(: pins::AllOutputs = pins::AllOutputs).map(|outputs| outputs as _),
        over_temperature: Some(modelled(input(b.pb0))),
        fan: Some(plain(output(c.pc12))),
        heartbeat: Some(plain(output(b.pb1).driven())),
        emergency_stop: Some(&pins::EMERGENCY_STOP),
        crash: kept::take_crash().or(reset),
        most_steps_per_s: Some(MOST_STEPS_PER_S),
        vitals: cortex_m::singleton!(: BoardVitals = BoardVitals).map(|vitals| vitals as _),
        #[cfg(not(feature = "qemu"))]
        drivers: cortex_m::singleton!(: drivers::DriverWire = wire).map(|wire| wire as _),
        #[cfg(not(feature = "qemu"))]
        storage: cortex_m::singleton!(: flash::FlashSlots = flash::FlashSlots(device.FLASH))
            .map(|slots| slots as _),
        #[cfg(feature = "qemu")]
        storage: cortex_m::singleton!(: kept::KeptSlots = kept::KeptSlots).map(|slots| slots as _),
        #[cfg(not(feature = "qemu"))]
        timed_shutter: cortex_m::singleton!(: shutter::ShutterTimer = shutter::ShutterTimer)
            .map(|timer| timer as _),
        #[cfg(not(feature = "qemu"))]
        brown_out: cortex_m::singleton!(: brown_out::Level3 = brown_out::Level3).map(|level| level as _),
        #[cfg(not(feature = "qemu"))]
        watchdog: cortex_m::singleton!(: watchdog::Watchdog = watchdog::Watchdog::new(device.IWDG))
            .map(|watchdog| watchdog as _),
        ..Options::default()
    };
    let lines = Lines {
        steps,
        directions,
        enables,
        homes,
        shutter: shutter(a.pa1),
        lamp: output(a.pa5),
        stop: InputLine(stop.erase()),
    };

    #[cfg(not(feature = "qemu"))]
    {
        interrupt::start_step_timer(&device.TIM5, &mut rcc);
        use stm32f4xx_hal::adc::Adc;
        use stm32f4xx_hal::adc::config::{AdcConfig, Clock};
        use stm32f4xx_hal::rcc::Enable;
        let (_, (level, ..)) = device.TIM3.pwm_hz(20.kHz(), &mut rcc);
        let mut level = level.with(a.pa6);
        level.set_duty(0);
        level.enable();
        // 21 MHz: more than 36 MHz it must not have.
        let adc = Adc::new(device.ADC1, true, AdcConfig::default().clock(Clock::Pclk2_div_4), &mut rcc);
        supply::start();
        pac::DMA2::enable(&mut rcc);
        let ring = cortex_m::singleton!(: photodiode::Ring = [0; 2048])?;
        Some((lines.real(level, parts::Photodiode::new(adc, a.pa0.into_analog(), ring)), options))
    }
    #[cfg(feature = "qemu")]
    Some((lines.modelled(), options))
}

/// What the board can tell of itself.
#[derive(Debug)]
struct BoardVitals;

impl Vitals for BoardVitals {
    fn stack(&mut self) -> Option<[u32; 2]> {
        vitals::stack()
    }

    fn overruns(&mut self) -> u32 {
        vitals::overruns()
    }

    #[cfg(not(feature = "qemu"))]
    fn supply_mv(&mut self) -> Option<u16> {
        supply::millivolts()
    }
}

/// All lines, in the order of the axes.
struct Lines {
    steps: StepPort,
    directions: [OutputLine; 4],
    enables: [OutputLine; 4],
    homes: [InputLine; 4],
    shutter: OutputLine,
    lamp: OutputLine,
    stop: InputLine,
}

impl Lines {
    #[cfg(not(feature = "qemu"))]
    fn real(self, lamp_level: parts::LampLevel, photodiode: parts::Photodiode) -> Peripherals<Stm32f405> {
        let [d0, d1, d2, d3] = self.directions;
        let ([e0, e1, e2, e3], [h0, h1, h2, h3]) = (self.enables, self.homes);
        let axis = |direction, enable, home| AxisPins { direction, enable, home };
        Peripherals {
            axes: [axis(d0, e0, h0), axis(d1, e1, h1), axis(d2, e2, h2), axis(d3, e3, h3)],
            steps: self.steps,
            shutter: self.shutter,
            lamp: self.lamp,
            lamp_level,
            photodiode,
            emergency_stop: self.stop,
            link: link(),
        }
    }

    #[cfg(feature = "qemu")]
    fn modelled(self) -> Peripherals<Stm32f405> {
        use model::{Output as Line, Role};
        static AXES: [model::Axis; 4] = [
            model::Axis::new(0, &emulation::TRACE),
            model::Axis::new(1, &emulation::TRACE),
            model::Axis::new(2, &emulation::TRACE),
            model::Axis::new(3, &emulation::TRACE),
        ];
        static LIGHT: model::Light = model::Light::new();
        let [d0, d1, d2, d3] = self.directions;
        let [e0, e1, e2, e3] = self.enables;
        // QEMU has no level on the switches' pins.
        let _ = self.homes;
        let plain = |pin| Line { pin, role: Role::None };
        let axis = |index: usize, direction, enable| AxisPins {
            direction: Line { pin: direction, role: Role::Direction(&AXES[index]) },
            enable: plain(enable),
            home: model::Input::Switch(&AXES[index]),
        };
        Peripherals {
            axes: [axis(0, d0, e0), axis(1, d1, e1), axis(2, d2, e2), axis(3, d3, e3)],
            steps: model::StepPort { pins: self.steps, axes: &AXES },
            shutter: plain(self.shutter),
            lamp: plain(self.lamp),
            lamp_level: model::Dimmer { dimmer: parts::NoDimmer, light: &LIGHT },
            photodiode: model::Photodiode(&LIGHT),
            emergency_stop: model::Input::Pin(self.stop),
            link: link(),
        }
    }
}

/// An output that is pulled low until its wiring is known.
fn output<const P: char, const N: u8>(pin: Pin<P, N>) -> OutputLine {
    OutputLine::new(&low(pin))
}

/// A driver's inverted enable input, pulled off.
fn disabled<const P: char, const N: u8>(pin: Pin<P, N>) -> OutputLine {
    OutputLine::inverted(&pin.into_pull_up_input().erase())
}

/// The shutter's pin, of TIM5's second comparator as soon as it is driven.
fn shutter(pin: Pin<'A', 1>) -> OutputLine {
    let pin = pin.into_alternate::<2>().into_pull_down_input();
    output(pin)
}

/// An input that reads low where nothing is connected.
fn low<const P: char, const N: u8>(pin: Pin<P, N>) -> AnyPin<Input> {
    pin.into_pull_down_input().erase()
}

fn input<const P: char, const N: u8>(pin: Pin<P, N>) -> InputLine {
    let pin: AnyPin<Input> = pin.into_pull_up_input().erase();
    InputLine(pin)
}

/// A real input, also where others are modelled.
fn modelled(line: InputLine) -> <Stm32f405 as Board>::Input {
    #[cfg(feature = "qemu")]
    let line = model::Input::Pin(line);
    line
}

/// A real output, likewise.
fn plain(pin: OutputLine) -> <Stm32f405 as Board>::Output {
    #[cfg(feature = "qemu")]
    let pin = model::Output { pin, role: model::Role::None };
    pin
}

fn link() -> RingLink {
    RingLink { received: &interrupt::RECEIVED, to_send: &interrupt::TO_SEND, wake: interrupt::wake_usart }
}
