//! A link through two rings, which the port's interrupt fills and empties.

use lobelia_firmware::ByteLink;

use crate::ring::Ring;

/// Room for bytes received: more than the longest frame, since a request is only looked at between two steps.
pub type Received = Ring<512>;
/// Room for bytes to send.
pub type ToSend = Ring<512>;

/// A link whose interrupt does the carrying.
#[derive(Debug)]
pub struct RingLink {
    /// What the interrupt received.
    pub received: &'static Received,
    /// What the interrupt has to send.
    pub to_send: &'static ToSend,
    /// Makes the interrupt run, so that it starts sending or receiving again.
    pub wake: fn(),
}

impl ByteLink for RingLink {
    fn read(&mut self) -> Option<u8> {
        let was_full = self.received.is_full();
        let byte = self.received.pop();
        if was_full {
            (self.wake)();
        }
        byte
    }

    fn write(&mut self, byte: u8) -> bool {
        let done = self.to_send.push(byte);
        // While others wait before it the interrupt comes anyway.
        if self.to_send.len() <= 1 {
            (self.wake)();
        }
        done
    }

    fn is_idle(&self) -> bool {
        self.to_send.is_empty()
    }
}
