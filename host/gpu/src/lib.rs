//! The GPU: finding one and giving it work; and the shaders, each with the structures that Rust and WGSL
//! share.

mod device;
pub mod environment;
pub mod fit;
pub mod lights;
#[cfg(unix)]
mod noise;
#[cfg(test)]
mod tests;

pub use device::Gpu;
