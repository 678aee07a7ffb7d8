//! What finds the [warnings](Warning) of a measurement and of a fit.
//!
//! [`samples`] counts, pose by pose, what is clipped, starved or missing: [`predicted`] before a run, [`frames`] during it, the developed
//! samples and those of a store after it. [`directions`] looks at where light and camera stood, [`residual`] at the poses and [`texels`] at the
//! texels that a fit leaves much of.

pub mod directions;
pub mod residual;
pub mod texels;

pub use lobelia_base::warning::{Kind, Warning};
pub use lobelia_measure::warning::{frames, predicted};
pub use lobelia_reflectance::warning::samples;
