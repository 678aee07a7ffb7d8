//! What a crash does: outputs to their safe state, a record into kept memory, and a reset.

use core::panic::{Location, PanicInfo};

use cortex_m::peripheral::SCB;
use lobelia_board_support::crash::{CrashCause, CrashRecord};

use crate::{kept, pins};

/// A fault with the stack this near to its end is taken for the stack's overflow: the frame that the
/// processor pushes, with floating-point registers, and what a function pushes at once.
const NEAR_END: usize = 256;
/// Where an exception's frame has the program counter.
const PC: usize = 6;

unsafe extern "C" {
    static _stack_start: u32;
    static _stack_end: u32;
}

/// Never returns to what went wrong.
pub(crate) fn crash(cause: CrashCause, place: u32) -> ! {
    cortex_m::interrupt::disable();
    pins::safe_state();
    kept::write_crash(&CrashRecord { cause, place });
    SCB::sys_reset()
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    crash(CrashCause::Panic, info.location().map_or(0, Location::line))
}

/// The program counter in the frame at a stack pointer; 0 where that is not in the stack.
pub(crate) fn interrupted_at(stack: *const u32) -> u32 {
    let all = (&raw const _stack_end)..(&raw const _stack_start);
    let at = stack.wrapping_add(PC);
    // SAFETY: the address is aligned, as stack pointers are, and in the stack, which is all memory; any bits
    // are a number.
    if all.contains(&at) && at.is_aligned() { unsafe { at.read_volatile() } } else { 0 }
}

/// The hard fault's handler. What failed may be the stack, so it takes the stack from its start again.
// SAFETY: cortex-m-rt asks for this name, and nothing else bears it.
#[unsafe(no_mangle)]
#[unsafe(naked)]
unsafe extern "C" fn HardFault() -> ! {
    core::arch::naked_asm!(
        "mrs r0, MSP",
        "movw r1, #:lower16:_stack_start",
        "movt r1, #:upper16:_stack_start",
        "msr MSP, r1",
        "b {hard_fault}",
        hard_fault = sym hard_fault,
    )
}

extern "C" fn hard_fault(stack: *const u32) -> ! {
    // Below the stack there is no memory: an overflow is a fault.
    if stack.addr() < (&raw const _stack_end).addr() + NEAR_END {
        crash(CrashCause::StackOverflow, 0)
    }
    crash(CrashCause::HardFault, interrupted_at(stack))
}
