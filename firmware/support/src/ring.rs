//! A ring of bytes from one writer to one reader, either of which may be an interrupt.

use core::sync::atomic::{AtomicU8, AtomicUsize, Ordering::Acquire, Ordering::Relaxed, Ordering::Release};

/// A ring that holds `N` bytes; `N` is a power of two.
#[derive(Debug)]
pub struct Ring<const N: usize> {
    bytes: [AtomicU8; N],
    /// Counts of bytes ever written and read.
    written: AtomicUsize,
    read: AtomicUsize,
}

impl<const N: usize> Ring<N> {
    /// An empty ring.
    pub const fn new() -> Self {
        assert!(N.is_power_of_two(), "the counts wrap at a power of two");
        Self {
            bytes: [const { AtomicU8::new(0) }; N],
            written: AtomicUsize::new(0),
            read: AtomicUsize::new(0),
        }
    }

    /// Puts a byte in; false when it's full. Only one context may write.
    pub fn push(&self, byte: u8) -> bool {
        let written = self.written.load(Relaxed);
        if written.wrapping_sub(self.read.load(Acquire)) == N {
            return false;
        }
        self.bytes[written % N].store(byte, Relaxed);
        self.written.store(written.wrapping_add(1), Release);
        true
    }

    /// Takes the oldest byte out. Only one context may read.
    pub fn pop(&self) -> Option<u8> {
        let read = self.read.load(Relaxed);
        if read == self.written.load(Acquire) {
            return None;
        }
        let byte = self.bytes[read % N].load(Relaxed);
        self.read.store(read.wrapping_add(1), Release);
        Some(byte)
    }

    /// Bytes in it.
    pub fn len(&self) -> usize {
        self.written.load(Acquire).wrapping_sub(self.read.load(Relaxed))
    }

    /// Whether there's nothing to read.
    pub fn is_empty(&self) -> bool {
        self.read.load(Relaxed) == self.written.load(Acquire)
    }

    /// Whether there's no room.
    pub fn is_full(&self) -> bool {
        self.written.load(Acquire).wrapping_sub(self.read.load(Acquire)) == N
    }
}

impl<const N: usize> Default for Ring<N> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use std::collections::VecDeque;
    use std::vec::Vec;

    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn ring_is_a_queue_of_its_capacity(does in proptest::collection::vec(any::<Option<u8>>(), 0..200)) {
            let ring = Ring::<8>::new();
            let mut queue = VecDeque::new();
            for what in does {
                match what {
                    Some(byte) => {
                        prop_assert_eq!(ring.push(byte), queue.len() < 8);
                        if queue.len() < 8 {
                            queue.push_back(byte);
                        }
                    }
                    None => prop_assert_eq!(ring.pop(), queue.pop_front()),
                }
                prop_assert_eq!((ring.is_empty(), ring.is_full()), (queue.is_empty(), queue.len() == 8));
            }
        }
    }

    #[test]
    fn bytes_arrive_in_order_from_another_thread() {
        static RING: Ring<16> = Ring::new();
        let writer = std::thread::spawn(|| {
            for i in 0..10_000u32 {
                while !RING.push(i as u8) {
                    std::thread::yield_now();
                }
            }
        });
        let mut got = Vec::new();
        while got.len() < 10_000 {
            match RING.pop() {
                Some(byte) => got.push(byte),
                None => std::thread::yield_now(),
            }
        }
        writer.join().unwrap();
        assert!(got.iter().enumerate().all(|(i, &byte)| byte == i as u8));
    }
}
