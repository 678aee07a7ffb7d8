//! Counts instructions a step in QEMU, where with `-icount` each instruction takes the same time, and prints them.
#![no_std]
#![no_main]

use cortex_m::peripheral::SYST;
use lobelia_board_support::rates::{Counter, report};
use lobelia_lm3s6965::{CLOCK_RELOAD, arm, now_us, rings, send_directly, set_up};

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some(peripherals) = set_up() else { panic!("set up twice") };
    let beside = |next: u64| arm(next.saturating_sub(now_us()) as u32);
    let counter = Counter::new(SYST::get_current, CLOCK_RELOAD);
    report(peripherals, rings(), counter, cortex_m::asm::delay, beside, send_directly);
    loop {
        cortex_m::asm::wfi();
    }
}
