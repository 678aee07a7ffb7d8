//! Fits sampled SBRDFs and measured tables with lobes; edits the maps that come of it; and makes samples of known
//! materials to try fits on.
//!
//! ```
//! use lobelia_fit::{fit, synth};
//! use lobelia_reflectance::{Brdf, materials};
//!
//! # fn main() -> lobelia_base::Result<()> {
//! // Samples of published clay at 200 poses; a measured store is read by `SampledSbrdf::read_zarr`.
//! let clay = materials::published("clay").expect("clay is published");
//! let options = synth::Options {
//!     width: 2,
//!     height: 2,
//!     texel_mm: 0.5,
//!     poses: 200,
//!     noise: 1e-3,
//!     relative_noise: 0.0,
//!     seed: 1,
//! };
//! let sampled = synth::sample(&options, |_, _, wi, wo| clay.eval(wi, wo));
//!
//! let map = fit::fit_sbrdf(&sampled, &fit::FitOptions { lobes: 2, ..fit::FitOptions::default() })?;
//! let (wi, wo) = (glam::Vec3::new(0.6, 0.0, 0.8), glam::Vec3::new(0.0, 0.6, 0.8));
//! let off = map.eval(0, wi, wo) / clay.eval(wi, wo);
//! assert!((off.x - 1.0).abs() < 0.05);
//! # Ok(())
//! # }
//! ```

pub mod edit;
pub mod findings;
pub mod fit;
pub mod synth;
pub mod warning;
