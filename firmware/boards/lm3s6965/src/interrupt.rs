//! The interrupts: the emergency stop and the watchdog, before which all others give way; UART 0 carries
//! bytes between its FIFOs and the link's rings, timer 0 wakes the main loop, timer 1 makes the steps,
//! SysTick counts periods of the clock.

use cortex_m::interrupt::InterruptNumber;
use cortex_m::peripheral::scb::SystemHandler;
use cortex_m::peripheral::{NVIC, SCB, SYST};
use lobelia_board_support::clock::Clock;
use lobelia_board_support::link::{Received, ToSend};

use crate::register::{timer, uart};

/// System clock, counts a µs.
pub(crate) const TICKS_PER_US: u32 = 50;

/// The clock's counter starts from this value.
pub const CLOCK_RELOAD: u32 = Clock::<TICKS_PER_US, 100_000>::RELOAD;

static CLOCK: Clock<TICKS_PER_US, 100_000> = Clock::new();
/// Bytes received.
pub(crate) static RECEIVED: Received = Received::new();
/// Bytes to send.
pub(crate) static TO_SEND: ToSend = ToSend::new();

/// The interrupts used.
#[derive(Debug, Clone, Copy)]
#[repr(u16)]
pub(crate) enum Interrupt {
    GpioD = 3,
    Uart0 = 5,
    Watchdog = 18,
    Timer0A = 19,
    Timer1A = 21,
}

// SAFETY: the numbers are those of the data sheet, and no two are alike.
unsafe impl InterruptNumber for Interrupt {
    fn number(self) -> u16 {
        self as u16
    }
}

/// An entry of the vector table.
#[repr(C)]
union Vector {
    handler: unsafe extern "C" fn(),
    reserved: usize,
}

unsafe extern "C" {
    fn GPIOD();
    fn UART0();
    fn WATCHDOG();
    fn TIMER0A();
    fn TIMER1A();
}

const VECTORS: usize = 44;

const fn vectors() -> [Vector; VECTORS] {
    let mut vectors = [const { Vector { reserved: 0 } }; VECTORS];
    vectors[Interrupt::GpioD as usize] = Vector { handler: GPIOD };
    vectors[Interrupt::Watchdog as usize] = Vector { handler: WATCHDOG };
    vectors[Interrupt::Uart0 as usize] = Vector { handler: UART0 };
    vectors[Interrupt::Timer0A as usize] = Vector { handler: TIMER0A };
    vectors[Interrupt::Timer1A as usize] = Vector { handler: TIMER1A };
    vectors
}

// SAFETY: cortex-m-rt's linker script wants the device's vectors in this section; the table has its layout.
#[unsafe(link_section = ".vector_table.interrupts")]
// SAFETY: cortex-m-rt asks for this name, and nothing else bears it.
#[unsafe(no_mangle)]
static __INTERRUPTS: [Vector; VECTORS] = vectors();

/// Clock period's end.
#[cortex_m_rt::exception]
fn SysTick() {
    CLOCK.period_over();
}

mod handlers {
    //! The handlers under the names that the vector table links to.

    // SAFETY: the vector table asks for this name, and nothing else bears it.
    #[unsafe(no_mangle)]
    extern "C" fn GPIOD() {
        crate::pins::stop();
    }

    // SAFETY: as for `GPIOD`.
    #[unsafe(no_mangle)]
    extern "C" fn UART0() {
        super::carry();
    }

    // SAFETY: as for `GPIOD`.
    #[unsafe(no_mangle)]
    extern "C" fn TIMER0A() {
        super::timer::SLEEP.clear().write(1);
    }

    // SAFETY: as for `GPIOD`.
    #[unsafe(no_mangle)]
    extern "C" fn TIMER1A() {
        let _ = super::serve_steps(|now| now);
    }
}

/// Receives what there's room for and sends what there is.
fn carry() {
    // Both are raised again by the next byte received and by the FIFO's running low.
    uart::ICR.write(0x7FF);
    while !RECEIVED.is_full() && uart::FR.read() & uart::RECEIVE_EMPTY == 0 {
        let received = uart::DR.read();
        if received & uart::OVERRUN != 0 {
            crate::vitals::overrun();
        }
        RECEIVED.push(received as u8);
    }
    while uart::FR.read() & uart::SEND_FULL == 0 {
        let Some(byte) = TO_SEND.pop() else { return };
        uart::DR.write(u32::from(byte));
    }
}

/// Makes the UART's interrupt run soon.
pub(crate) fn wake_uart() {
    NVIC::pend(Interrupt::Uart0);
}

/// The time in µs since the start.
pub fn now_us() -> u64 {
    CLOCK.now_us(|| (SYST::get_current(), SCB::is_pendst_pending()))
}

fn now_wrapping_us() -> u32 {
    CLOCK.wrapping_us(|| (SYST::get_current(), SCB::is_pendst_pending()))
}

/// What the steps' interrupt does: makes the steps that are due, and sets the timer for the next.
/// `at` gives the time to take for now, from what the clock says in µs. Gives when it is to be called next.
#[inline(always)]
pub fn serve_steps(at: impl Fn(u32) -> u32) -> Option<u32> {
    timer::STEPS.clear().write(1);
    let next = crate::steps::make(|| at(now_wrapping_us()))?;
    let left = next.wrapping_sub(at(now_wrapping_us())) as i32;
    arm(timer::STEPS, left.max(1) as u32);
    Some(next)
}

/// Makes the steps' interrupt run soon, to look at what the controller has planned.
pub fn wake_steps() {
    NVIC::pend(Interrupt::Timer1A);
}

/// Starts the clock: counts of the system clock from [`CLOCK_RELOAD`] down.
pub(crate) fn start_clock(systick: &mut SYST) {
    systick.set_clock_source(cortex_m::peripheral::syst::SystClkSource::Core);
    systick.set_reload(CLOCK_RELOAD);
    systick.clear_current();
    systick.enable_counter();
    systick.enable_interrupt();
}

/// Puts the emergency stop and the watchdog, at 0, before all others.
pub(crate) fn set_priorities(nvic: &mut NVIC, scb: &mut SCB) {
    const LATER: u8 = 0x80;
    // SAFETY: no critical section relies on priorities.
    unsafe {
        nvic.set_priority(Interrupt::Uart0, LATER);
        nvic.set_priority(Interrupt::Timer0A, LATER);
        nvic.set_priority(Interrupt::Timer1A, LATER);
        scb.set_priority(SystemHandler::SysTick, LATER);
    }
}

/// Lets all interrupts come.
pub(crate) fn unmask() {
    let interrupts =
        [Interrupt::GpioD, Interrupt::Uart0, Interrupt::Watchdog, Interrupt::Timer0A, Interrupt::Timer1A];
    for interrupt in interrupts {
        // SAFETY: called once at the start; no critical section relies on these being masked.
        unsafe { NVIC::unmask(interrupt) };
    }
}

/// Sets a timer to interrupt once, after a time in µs.
fn arm(timer: timer::Timer, after_us: u32) {
    timer.control().write(0);
    timer.load().write(after_us.saturating_mul(TICKS_PER_US));
    timer.control().write(1);
}

/// Sleeps until a time in µs or until a byte comes.
pub fn sleep_until(time_us: u64) {
    let mut sleeps = true;
    while sleeps {
        cortex_m::interrupt::disable();
        // Whatever interrupts from here on ends the sleep, though its handler runs only after it.
        let left = time_us.saturating_sub(now_us());
        sleeps = left > 0 && RECEIVED.is_empty();
        if sleeps {
            arm(timer::SLEEP, left.min(1_000_000) as u32);
            cortex_m::asm::wfi();
        }
        // SAFETY: interrupts were enabled before, as always outside handlers.
        unsafe { cortex_m::interrupt::enable() };
    }
}
