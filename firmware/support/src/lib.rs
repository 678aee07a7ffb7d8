//! What the boards' binaries share and no pin or register decides: bytes between interrupt and main loop
//! ([`ring`], [`link`]), a clock from a counter that wraps ([`clock`]), home switches and a lamp for boards
//! under emulation ([`model`], [`trace`]), the count of instructions a step ([`rates`]), which readings of a
//! converter are new ([`meter`]), the brown-out level's bits ([`brown_out`]), and a crash's record
//! ([`crash`]).
#![no_std]
#![forbid(unsafe_code)]

pub mod brown_out;
pub mod clock;
pub mod crash;
pub mod link;
pub mod meter;
pub mod model;
pub mod rates;
pub mod ring;
pub mod trace;
