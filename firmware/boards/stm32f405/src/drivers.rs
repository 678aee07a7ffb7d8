//! The wire to the TMC2209s on USART 3: the receiver hears what the sender says, through the resistor between
//! them.

use lobelia_firmware::driver::DriverBus;
use stm32f4xx_hal::pac;
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::serial::Serial;

use crate::interrupt::now_us;

/// Longest wait for a byte, µs: a driver answers after 8 bits, and a byte takes 87 µs.
const PATIENCE_US: u64 = 2000;

/// The port.
pub(crate) struct DriverWire(pub(crate) Serial<pac::USART3>);

impl DriverWire {
    fn read(&mut self) -> Option<u8> {
        let end = now_us() + PATIENCE_US;
        while now_us() < end {
            if self.0.is_rx_not_empty() {
                return self.0.read().ok();
            }
        }
        None
    }
}

impl DriverBus for DriverWire {
    fn send(&mut self, bytes: &[u8]) -> bool {
        // What is left of an answer that came too late.
        while self.0.is_rx_not_empty() {
            let _ = self.0.read();
        }
        // Each byte's echo comes when it is sent, which paces the sending.
        bytes.iter().all(|&byte| self.0.write(byte).is_ok() && self.read() == Some(byte))
    }

    fn receive(&mut self, into: &mut [u8]) -> bool {
        into.iter_mut().all(|place| self.read().map(|byte| *place = byte).is_some())
    }
}
