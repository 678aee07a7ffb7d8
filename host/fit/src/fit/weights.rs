//! What a sample weighs: as its pose does, or by the inverse of its own variance.

use half::f16;

use lobelia_reflectance::colour;

/// What a sample's squared residual weighs beside what the residual says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Weights {
    /// The pose's weight of the sampled SBRDF.
    #[default]
    Pose,
    /// 1/σ² of the sample, where the sampled SBRDF holds standard deviations; a pose of weight 0 stays out.
    /// For the linear residual.
    Sigma,
}

impl Weights {
    /// The name on the command line and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pose => "pose",
            Self::Sigma => "sigma",
        }
    }
}

/// The weight that the channels of a sample share: the inverse square of their standard deviations' mean, in
/// which they count as in luminance. 0 where one is not known or the pose weighs nothing.
pub(super) fn by_sigma(pose: f64, sigmas: &[f16]) -> f64 {
    let Some(&[red, green, blue]) = sigmas.first_chunk() else { return 0.0 };
    let sigma = colour::LUMINANCE.as_dvec3().dot(glam::DVec3::new(red.into(), green.into(), blue.into()));
    // False for a NaN.
    if pose > 0.0 && sigma > 0.0 && sigma.is_finite() { 1.0 / (sigma * sigma) } else { 0.0 }
}
