//! What a test does to the emulated board from outside: reads the trace of steps, and asks for a crash by a
//! number in kept memory.

use lobelia_board_support::trace::Trace;

use crate::kept;

/// The steps made.
pub(crate) static TRACE: Trace = Trace::new(crate::now_us);

/// Begins the trace and tells where it is.
pub fn start() {
    kept::write(kept::TRACE, (&raw const TRACE).addr() as u32);
    TRACE.start();
}

/// Crashes if a test has asked for it: 1 panics, 2 overflows the stack, 3 runs what is no instruction, 4
/// hangs.
pub fn obey() {
    let trigger = kept::read(kept::TRIGGER);
    if trigger == 0 {
        return;
    }
    kept::write(kept::TRIGGER, 0);
    match trigger {
        1 => panic!("as asked"),
        2 => _ = overflow(u32::MAX),
        3 => cortex_m::asm::udf(),
        _ => loop {
            cortex_m::asm::nop();
        },
    }
}

/// Takes more stack than there is.
#[inline(never)]
fn overflow(depth: u32) -> u32 {
    let frame = core::hint::black_box([depth; 16]);
    if depth == 0 { 0 } else { overflow(depth - 1) + core::hint::black_box(&frame)[0] }
}
