//! A simulated rig: the firmware on a virtual clock, against simulated mechanics, lamp and optical bench.

pub mod optics;
