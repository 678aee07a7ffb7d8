//! Helpers of the end-to-end tests: the `lobelia` command, rigs small enough to run dozens of times, folders
//! compared byte for byte, damaged files, rigs on TCP that misbehave, and boards in QEMU.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a helper that fails is a test that fails")]

pub mod command;
pub mod folder;
pub mod mutate;
#[cfg(unix)]
pub mod qemu;
pub mod small;
pub mod tcp;
