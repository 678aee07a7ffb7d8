//! Warnings that sampled reflectance itself gives rise to.

pub mod samples;
