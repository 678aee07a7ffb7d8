//! The interrupts: the emergency stop, before which all others give way, and next to it the drivers' alarms;
//! USART 2 carries bytes between its registers and the link's rings, TIM5 counts the time and makes the
//! steps, SysTick ends the main loop's sleep.
//!
//! There is one clock. A processor that waits for its flash misses SysTick's interrupts, but TIM5 counts on;
//! so the controller's time is TIM5's. Only under emulation, where TIM5 does not count as the chip's does, it
//! is SysTick's, whose interrupt then makes the steps too, every [`PERIOD_US`].

use core::cell::RefCell;

use cortex_m::peripheral::scb::SystemHandler;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{NVIC, SCB, SYST};
use critical_section::Mutex;
use lobelia_board_support::clock::Clock;
#[cfg(not(feature = "qemu"))]
use lobelia_board_support::clock::Extended;
use lobelia_board_support::link::{Received, ToSend};
use stm32f4xx_hal::nb;
use stm32f4xx_hal::pac::{self, Interrupt, interrupt};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::serial::{Error, Rx, RxListen, Tx, TxListen};

/// System clock, counts a µs. QEMU's SysTick counts at this rate whatever the clocks are set to.
pub(crate) const TICKS_PER_US: u32 = 168;
/// SysTick's interrupt comes this often, in µs, and ends the main loop's sleep. Where it makes the steps,
/// they are late by as much.
const PERIOD_US: u32 = if cfg!(feature = "qemu") { 50 } else { 1000 };
/// SysTick's counter starts from this value.
const CLOCK_RELOAD: u32 = Clock::<TICKS_PER_US, PERIOD_US>::RELOAD;
/// And from this one where instructions are counted by it.
#[cfg(feature = "qemu")]
pub const COUNTER_RELOAD: u32 = 0xFF_FFFF;

#[cfg(feature = "qemu")]
static CLOCK: Clock<TICKS_PER_US, PERIOD_US> = Clock::new();
#[cfg(not(feature = "qemu"))]
static CLOCK: Extended = Extended::new();
/// Bytes received.
pub(crate) static RECEIVED: Received = Received::new();
/// Bytes to send.
pub(crate) static TO_SEND: ToSend = ToSend::new();
static PORT: Mutex<RefCell<Option<Halves>>> = Mutex::new(RefCell::new(None));

type Halves = (Tx<pac::USART2>, Rx<pac::USART2>);

/// A period's end.
#[cortex_m_rt::exception]
fn SysTick() {
    #[cfg(feature = "qemu")]
    {
        CLOCK.period_over();
        make_steps();
    }
}

/// Makes the steps that are due by SysTick's time.
#[cfg(feature = "qemu")]
fn make_steps() {
    let _ = crate::steps::make(|| now_us() as u32);
}

#[interrupt]
fn EXTI9_5() {
    crate::pins::stop_or_alarm();
}

#[interrupt]
fn EXTI15_10() {
    crate::pins::alarm();
}

#[interrupt]
fn USART2() {
    critical_section::with(|section| {
        if let Some(port) = PORT.borrow_ref_mut(section).as_mut() {
            carry(port);
        }
    });
}

/// Receives a byte if there is one and sends one if there is room. A byte for which the ring has no room is
/// lost, and the frame with it: the host repeats it.
fn carry((tx, rx): &mut Halves) {
    // Read also where no byte has come: an overrun interrupts without one, and for ever until it is cleared
    // by reading.
    match rx.read() {
        Ok(byte) if RECEIVED.push(byte) => {}
        Ok(_) | Err(nb::Error::Other(Error::Overrun)) => crate::vitals::overrun(),
        Err(_) => {}
    }
    if tx.is_tx_empty() {
        match TO_SEND.pop() {
            Some(byte) => {
                let _ = tx.write(byte);
                tx.listen();
            }
            None => tx.unlisten(),
        }
    }
}

/// Makes the USART's interrupt run soon.
pub(crate) fn wake_usart() {
    NVIC::pend(Interrupt::USART2);
}

/// Hands the port to the interrupt.
pub(crate) fn give_port(tx: Tx<pac::USART2>, mut rx: Rx<pac::USART2>) {
    rx.listen();
    critical_section::with(|section| PORT.borrow_ref_mut(section).replace((tx, rx)));
}

/// Puts the emergency stop, at 0, before all others, and alarms before the rest, so that their pulses are
/// timed.
pub(crate) fn set_priorities(nvic: &mut NVIC, scb: &mut SCB) {
    const SOON: u8 = 0x40;
    const LATER: u8 = 0x80;
    // SAFETY: no critical section relies on priorities.
    unsafe {
        nvic.set_priority(Interrupt::EXTI15_10, SOON);
        nvic.set_priority(Interrupt::USART2, LATER);
        nvic.set_priority(Interrupt::TIM5, LATER);
        scb.set_priority(SystemHandler::SysTick, LATER);
    }
}

/// Lets the emergency stop and the USART interrupt.
pub fn start_interrupts() {
    for interrupt in [Interrupt::EXTI9_5, Interrupt::EXTI15_10, Interrupt::USART2, Interrupt::TIM5] {
        // SAFETY: called once at the start; the port is behind a mutex, and no critical section relies on the
        // mask.
        unsafe { NVIC::unmask(interrupt) };
    }
}

/// Sends a byte without the interrupt, waiting for room.
pub fn send_directly(byte: u8) {
    critical_section::with(|section| {
        if let Some((tx, _)) = PORT.borrow_ref_mut(section).as_mut() {
            while !tx.is_tx_empty() {}
            let _ = tx.write(byte);
        }
    });
}

/// The time in µs since the start; for the main loop.
#[cfg(feature = "qemu")]
pub fn now_us() -> u64 {
    CLOCK.now_us(|| (SYST::get_current(), SCB::is_pendst_pending()))
}

/// The time in µs since the start; for the main loop.
#[cfg(not(feature = "qemu"))]
pub fn now_us() -> u64 {
    // SAFETY: reading the count changes nothing.
    CLOCK.now_us(unsafe { &*pac::TIM5::ptr() }.cnt().read().bits())
}

/// The steps' timer counts µs from 0; its first comparator tells when to make the next steps.
#[cfg(not(feature = "qemu"))]
pub(crate) fn start_step_timer(timer: &pac::TIM5, rcc: &mut stm32f4xx_hal::rcc::Rcc) {
    use stm32f4xx_hal::rcc::Enable;
    pac::TIM5::enable(rcc);
    // Half of the system clock.
    timer.psc().write(|w| w.psc().set((TICKS_PER_US / 2 - 1) as u16));
    timer.egr().write(|w| w.ug().set_bit());
    timer.dier().write(|w| w.cc1ie().set_bit());
    timer.cr1().write(|w| w.cen().set_bit());
}

#[interrupt]
fn TIM5() {
    #[cfg(feature = "qemu")]
    make_steps();
    #[cfg(not(feature = "qemu"))]
    let _ = serve_steps(|now| now);
}

/// In `SR`: the first comparator has matched.
const STEPS_DUE: u32 = 1 << 1;

/// What the steps' interrupt does: makes the steps that are due, and sets the timer for the next. `at` gives
/// the time to take for now, from what the timer says in µs. Gives when it is to be called next.
#[inline(always)]
pub fn serve_steps(at: impl Fn(u32) -> u32) -> Option<u32> {
    // SAFETY: once the timer is started only this touches it, and any comparison is allowed.
    let timer = unsafe { &*pac::TIM5::ptr() };
    // A flag is cleared by 0; the others are the shutter's.
    // SAFETY: 1 leaves a flag as it is.
    timer.sr().write(|w| unsafe { w.bits(!STEPS_DUE) });
    while let Some(next) = crate::steps::make(|| at(timer.cnt().read().bits())) {
        // SAFETY: as above.
        unsafe { timer.ccr1().write(|w| w.bits(next)) };
        // Unless that is past: then the comparator would not tell.
        if (at(timer.cnt().read().bits()).wrapping_sub(next) as i32) < 0 {
            return Some(next);
        }
    }
    None
}

/// Makes the steps' interrupt run soon, to look at what the controller has planned.
pub fn wake_steps() {
    NVIC::pend(Interrupt::TIM5);
}

/// Starts the clock.
pub(crate) fn start_clock(systick: &mut SYST) {
    systick.set_clock_source(SystClkSource::Core);
    systick.set_reload(CLOCK_RELOAD);
    systick.clear_current();
    systick.enable_counter();
    systick.enable_interrupt();
}

/// From now on SysTick counts as far as it can and interrupts no more.
#[cfg(feature = "qemu")]
pub fn count_far() {
    // SAFETY: nothing else touches SysTick once it is started, but to read it.
    let mut systick = unsafe { cortex_m::Peripherals::steal() }.SYST;
    systick.disable_interrupt();
    systick.set_reload(COUNTER_RELOAD);
    systick.clear_current();
}

/// Rests until a time in µs or until a byte comes: awake for a millisecond at most, else asleep until the
/// next interrupt.
pub fn rest_until(time_us: u64) {
    while RECEIVED.is_empty() {
        let left = time_us.saturating_sub(now_us());
        if left > u64::from(PERIOD_US) {
            return cortex_m::asm::wfi();
        }
        if left == 0 {
            return;
        }
    }
}
