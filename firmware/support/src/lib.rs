//! What the boards' binaries share and no pin or register decides: bytes between interrupt and main loop ([`ring`],
//! [`link`]), a clock from a counter that wraps ([`clock`]), home switches and a lamp for boards under emulation
//! ([`model`]), and the count of instructions a step ([`rates`]).
#![no_std]
#![forbid(unsafe_code)]

pub mod clock;
pub mod link;
pub mod model;
pub mod rates;
pub mod ring;
