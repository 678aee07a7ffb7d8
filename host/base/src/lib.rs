//! What every crate of the host stands on: errors, files, reports, progress, small linear algebra, random
//! numbers, pages.

pub mod durable;
pub mod error;
pub mod figures;
pub mod files;
pub mod hash;
pub mod interrupt;
pub mod linalg;
pub mod memory;
pub mod page;
pub mod progress;
pub mod provenance;
pub mod random;
pub mod report;
pub mod toml_file;
pub mod warning;

pub use error::{Error, Result};
