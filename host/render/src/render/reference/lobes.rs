//! Importance sampling of the BRDF: cosine-weighted for the diffuse term, cosⁿ about the peak C'ω_o of every
//! lobe, visible normals for microfacet terms.

use std::f32::consts::TAU;

use glam::Vec3;

use crate::render::materials::Shader;
use crate::render::math;

/// Draws an incident direction of the sample's frame from the mixture of [`Shader`]. It can lie below the
/// surface, and then carries nothing; [`Shader::eval_and_density`] has its density.
pub(super) fn sample(shader: &Shader, choice: f32, [r, s]: [f32; 2]) -> Vec3 {
    let (sin, cos) = (r * TAU).sin_cos();
    let mut left = choice;
    for lobe in &shader.lobes {
        if left < lobe.share {
            let z = math::powf((1.0 - s).max(f32::MIN_POSITIVE), 1.0 / (lobe.n + 1.0)).min(1.0);
            let radius = (1.0 - z * z).sqrt();
            let axis = lobe.peak.normalize();
            let (x, y) = axis.any_orthonormal_pair();
            return x * (radius * cos) + y * (radius * sin) + axis * z;
        }
        left -= lobe.share;
    }
    for microfacet in &shader.microfacets {
        if left < microfacet.share {
            return microfacet.coat.sample(shader.wo, [r, s]);
        }
        left -= microfacet.share;
    }
    if let Some((brdf, share)) = &shader.other
        && left < *share
    {
        return brdf.sample(shader.wo, [r, s]);
    }
    let radius = s.sqrt();
    Vec3::new(radius * cos, radius * sin, (1.0 - s).max(0.0).sqrt())
}
