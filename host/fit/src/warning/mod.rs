//! Warnings of a fit: [`directions`] looks at where light and camera stood, [`residual`] at the poses and
//! [`texels`] at the texels that a fit leaves much of.

pub mod directions;
pub mod residual;
pub mod texels;
