//! The controller on an STM32F405.
#![no_std]
#![no_main]

use lobelia_firmware::Controller;
use lobelia_stm32f405::vitals;
use lobelia_stm32f405::{after_poll, now_us, rest_until, set_up, start_interrupts, wake_steps};

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some((peripherals, options)) = set_up() else { panic!("set up twice") };
    let mut controller = Controller::with_options(peripherals, options);
    start_interrupts();
    #[cfg(feature = "qemu")]
    lobelia_stm32f405::emulation::start();
    loop {
        controller.poll(now_us());
        wake_steps();
        after_poll();
        #[cfg(feature = "qemu")]
        lobelia_stm32f405::emulation::obey();
        vitals::look();
        controller.polled(now_us());
        rest_until(controller.next_poll_us());
    }
}
