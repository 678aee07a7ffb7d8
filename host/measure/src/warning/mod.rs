//! Warnings of a measurement: its samples as they are [`predicted`] from a plan, and as its [`frames`] come
//! in.

pub mod frames;
pub mod predicted;
