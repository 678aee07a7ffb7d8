//! The controller on an STM32F405.
#![no_std]
#![no_main]

use lobelia_firmware::Controller;
use lobelia_stm32f405::{now_us, rest_until, set_up, start_interrupts};

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some(peripherals) = set_up() else { panic!("set up twice") };
    let mut controller = Controller::new(peripherals);
    start_interrupts();
    loop {
        controller.tick(now_us());
        rest_until(controller.next_event_us());
    }
}
