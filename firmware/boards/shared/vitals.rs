//! What the board tells of itself: the stack's high-water mark, and bytes that nobody took in time.
//!
//! The start-up code paints the stack. Each turn of the main loop looks at a few words of what is still
//! painted, so the mark is found a few hundred turns after it was set.

use core::sync::atomic::{AtomicU32, AtomicUsize, Ordering::Relaxed};

use cortex_m_rt::STACK_PAINT_VALUE;

unsafe extern "C" {
    static _stack_start: u32;
    static _stack_end: u32;
}

/// Words looked at in one turn.
const AT_ONCE: usize = 8;

/// Words from the stack's end that were never written, as far as is known; none is known of at the start.
static UNTOUCHED: AtomicUsize = AtomicUsize::new(usize::MAX);
/// The next word to look at.
static NEXT: AtomicUsize = AtomicUsize::new(0);
/// Bytes received and lost.
static OVERRUNS: AtomicU32 = AtomicU32::new(0);

/// Words of the whole stack.
fn words() -> usize {
    ((&raw const _stack_start).addr() - (&raw const _stack_end).addr()) / 4
}

/// Looks at some more of the stack; for the main loop.
pub fn look() {
    let untouched = UNTOUCHED.load(Relaxed).min(words());
    let from = NEXT.load(Relaxed);
    let to = (from + AT_ONCE).min(untouched);
    for word in from..to {
        // SAFETY: the word is within the stack, which is all memory; any bits are a number.
        if unsafe { (&raw const _stack_end).wrapping_add(word).read_volatile() } != STACK_PAINT_VALUE {
            UNTOUCHED.store(word, Relaxed);
            return NEXT.store(0, Relaxed);
        }
    }
    // What was found once stays; below it a deeper call may have written since.
    NEXT.store(if to < untouched { to } else { 0 }, Relaxed);
    UNTOUCHED.store(untouched, Relaxed);
}

/// Notes bytes that were lost; for the link's interrupt.
pub(crate) fn overrun() {
    // Only that interrupt writes it.
    OVERRUNS.store(OVERRUNS.load(Relaxed).wrapping_add(1), Relaxed);
}

/// Bytes of the stack used, and that there are.
pub(crate) fn stack() -> Option<[u32; 2]> {
    let of = 4 * words() as u32;
    let untouched = UNTOUCHED.load(Relaxed);
    (untouched <= words()).then(|| [of - 4 * untouched as u32, of])
}

/// Bytes lost.
pub(crate) fn overruns() -> u32 {
    OVERRUNS.load(Relaxed)
}
