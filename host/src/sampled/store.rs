//! The Zarr v3 store of a sampled SBRDF.
