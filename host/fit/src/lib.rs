//! Fits sampled SBRDFs and measured tables with lobes; edits the maps that come of it; and makes samples of known
//! materials to try fits on.

pub mod edit;
pub mod fit;
pub mod synth;
pub mod warning;
