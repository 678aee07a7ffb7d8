//! Limits of what a tolerance may ask for.

use lobelia_base::error::{Error, Result};

/// Tolerance where none is named, in longest sides of the shape.
pub(in crate::scene) const USUAL: f64 = 1.0 / 2000.0;
/// Triangles a shape at most.
const MOST_TRIANGLES: f64 = 3e7;

/// Refuses a tolerance that is no length.
pub(in crate::scene) fn check(tolerance: f64) -> Result<()> {
    if tolerance.is_finite() && tolerance > 0.0 {
        return Ok(());
    }
    Err(Error::input(format!("key tolerance: {tolerance} is no length; use more than 0")))
}

/// Refuses more triangles than anyone can want.
pub(in crate::scene) fn check_triangles(count: f64, tolerance: f64) -> Result<()> {
    if count <= MOST_TRIANGLES {
        return Ok(());
    }
    Err(Error::input(format!(
        "key tolerance: {tolerance:e} would take {count:.1e} triangles; use a larger one \
         ({MOST_TRIANGLES:.0e} triangles at most)"
    )))
}
