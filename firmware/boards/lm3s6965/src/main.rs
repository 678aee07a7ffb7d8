//! The controller on an LM3S6965.
#![no_std]
#![no_main]

use lobelia_firmware::Controller;
use lobelia_lm3s6965::{now_us, set_up, sleep_until, start_interrupts};

/// The controller is called at least this often, in µs, so that the emergency stop is seen.
const LONGEST_SLEEP_US: u64 = 1000;

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some(peripherals) = set_up() else { panic!("set up twice") };
    let mut controller = Controller::new(peripherals);
    start_interrupts();
    loop {
        let now = now_us();
        controller.tick(now);
        sleep_until(controller.next_event_us().min(now + LONGEST_SLEEP_US));
    }
}
