//! Counts instructions a step in QEMU, where with `-icount` each instruction takes the same time, and prints
//! them.
#![no_std]
#![no_main]

use cortex_m::peripheral::SYST;
use lobelia_board_support::rates::{Counter, report};
use lobelia_stm32f405::{COUNTER_RELOAD, count_far, rings, send_directly, serve_steps, set_up};

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some((peripherals, _)) = set_up() else { panic!("set up twice") };
    count_far();
    let counter = Counter::new(SYST::get_current, COUNTER_RELOAD);
    let serve = |now| serve_steps(|_| now);
    report(peripherals, rings(), counter, spend, serve, send_directly);
    loop {
        cortex_m::asm::wfi();
    }
}

/// Runs a number of instructions, rounded down to even, and a few more.
fn spend(instructions: u32) {
    // SAFETY: touches nothing but one register of its own and the flags; the count is above 0, so that the
    // loop ends.
    unsafe {
        core::arch::asm!("2: subs {0}, #1", "bne 2b", inout(reg) (instructions / 2).max(1) => _,
            options(nomem, nostack));
    }
}
