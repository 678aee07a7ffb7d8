//! The controller on an LM3S6965.
#![no_std]
#![no_main]

use lobelia_firmware::Controller;
use lobelia_lm3s6965::vitals;
use lobelia_lm3s6965::{after_poll, now_us, options, set_up, sleep_until, start_interrupts, wake_steps};

/// The controller is called at least this often, in µs, so that the emergency stop is seen.
const LONGEST_SLEEP_US: u64 = 1000;

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some(peripherals) = set_up() else { panic!("set up twice") };
    let mut controller = Controller::with_options(peripherals, options());
    start_interrupts();
    #[cfg(feature = "qemu")]
    lobelia_lm3s6965::emulation::start();
    loop {
        let now = now_us();
        controller.poll(now);
        wake_steps();
        after_poll();
        #[cfg(feature = "qemu")]
        lobelia_lm3s6965::emulation::obey();
        vitals::look();
        controller.polled(now_us());
        sleep_until(controller.next_poll_us().min(now + LONGEST_SLEEP_US));
    }
}
