//! Raw frames to radiance, registered on the sample and sampled.

pub mod fiducials;
