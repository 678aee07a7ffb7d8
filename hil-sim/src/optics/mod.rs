//! The optical bench: what the camera's sensor records of a known material, light and pose.
//!
//! Written apart from the host's geometry and development: it is the truth that they are tested against.

pub mod bench;
pub mod camera;
mod cylinder;
pub mod frame;
pub mod noise;
pub mod sample;
pub mod tags;

pub use bench::{BenchConfig, OpticalBench, RadianceImage};
pub use camera::{CameraModel, SensorModel};
pub use sample::{Material, Pattern, SampleLayout};
