//! Fits sampled SBRDFs and measured tables with lobes; edits the maps that come of it; and makes samples of
//! known materials to try fits on.
//!
//! ```
//! use lobelia_fit::fit::request::{Lobes, Request};
//! use lobelia_fit::synth;
//! use lobelia_reflectance::sampled::SampledStore;
//! use lobelia_reflectance::{Brdf, MeasuredTable, materials};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let folder = tempfile::tempdir()?;
//! # let path = folder.path().join("sampled.zarr");
//! // Samples of published clay at 100 poses stand for what `lobelia develop` writes.
//! let clay = materials::published("clay").ok_or("clay is published")?;
//! let options = synth::Options {
//!     width: 2,
//!     height: 2,
//!     texel_mm: 0.5,
//!     poses: 100,
//!     noise: 1e-3,
//!     relative_noise: 0.0,
//!     seed: 1,
//! };
//! synth::sample(&options, |_, _, wi, wo| clay.eval(wi, wo)).write_zarr(&path)?;
//!
//! // A store, with all that is open decided by its samples, as `lobelia fit` does.
//! let map = Request::default().fit(&SampledStore::open(&path)?)?;
//! let (wi, wo) = (glam::Vec3::new(0.6, 0.0, 0.8), glam::Vec3::new(0.0, 0.6, 0.8));
//! let off = map.eval(0, wi, wo) / clay.eval(wi, wo);
//! assert!((off.x - 1.0).abs() < 0.05);
//!
//! // A table of one wavelength: theta_i, phi_i, theta_o, phi_o in radians, and 1/sr.
//! let rows = (0..8).flat_map(|i| (0..8).map(move |o| (0.15 * f64::from(i), 0.15 * f64::from(o))));
//! let rows: String = rows.map(|(i, o)| format!("{i} 0 {o} 1 0.2\n")).collect();
//! let table = MeasuredTable::parse(&format!("1 550\n{rows}"))?;
//! let paper = Request { lobes: Lobes::Count(0), ..Request::default() }.fit_table(&table)?;
//! assert!((paper.eval(0, wi, wo).x - 0.2).abs() < 1e-3);
//! # Ok(())
//! # }
//! ```

pub mod edit;
pub mod findings;
pub mod fit;
pub mod synth;
pub mod warning;
