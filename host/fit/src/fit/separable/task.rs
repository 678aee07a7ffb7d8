//! What a fit is to be.

use super::super::lm::Limits;
use super::layout::Family;

/// How far the search goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Effort {
    /// Shapes tried as the next lobe of each set.
    pub tries: usize,
    /// Of them, those whose highlights pass through the largest residuals.
    pub ridge: usize,
    /// Steps for each of them.
    pub steps: usize,
    /// Sets that go on to the next lobe.
    pub beam: usize,
    /// When the last set counts as converged.
    pub limits: Limits,
}

impl Effort {
    /// For one of thousands of texels. Up to two lobes little effort finds the best start in all but a few
    /// per cent of texels; with more, sets of shapes compete that look alike for the first few steps.
    pub fn texel(lobes: usize) -> Self {
        if lobes <= 2 {
            return Self {
                tries: 5,
                ridge: 1,
                steps: 3,
                beam: 2,
                limits: Limits { iterations: 40, tolerance: 1e-5 },
            };
        }
        Self { tries: 6, ridge: 3, steps: 6, beam: 3, limits: Limits { iterations: 60, tolerance: 1e-6 } }
    }

    /// For a texel from which others start.
    pub fn thorough(lobes: usize) -> Self {
        let Self { ridge, limits, .. } = Self::texel(lobes);
        Self { tries: 6, ridge, steps: 8, beam: 6, limits }
    }
}

/// What is fitted, beside the data.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Task {
    /// Lobes.
    pub lobes: usize,
    /// Shapes.
    pub family: Family,
    /// Whether ρ_d is an unknown.
    pub diffuse: bool,
    /// Effort.
    pub effort: Effort,
    /// Whether `lobes` is the most: then as many as [`choice`](super::choice) finds supported.
    pub choose: bool,
}
