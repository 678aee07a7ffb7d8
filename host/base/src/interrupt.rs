//! Ctrl-C: long work asks whether it was pressed and ends where nothing is lost.

use std::sync::atomic::{AtomicBool, Ordering};

/// Set by the first Ctrl-C, see [`catch_interrupts`].
static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// From now on Ctrl-C asks a run to end after the photograph in hand, with the rig at rest, instead of
/// killing it.
pub fn catch_interrupts() {
    // A second handler in one process is refused; the first one serves.
    let _ = ctrlc::set_handler(|| INTERRUPTED.store(true, Ordering::Relaxed));
}

/// Whether Ctrl-C was pressed since it is caught.
pub fn interrupted() -> bool {
    INTERRUPTED.load(Ordering::Relaxed)
}
