//! Radiance to reflectance at every texel with exact near-light geometry: (3.9) and (3.10).

use glam::DVec3;

use crate::rig::config::RigConfig;
use lobelia_reflectance::sampled::PoseGeometry;

/// Irradiance divided by the lamp's radiance at a point of the sample's plane, sr: cosθ_i dω_i with dω_i =
/// A_s / r² (3.10). Zero when the light is below the plane.
pub fn irradiance_factor(config: &RigConfig, geometry: &PoseGeometry, position_mm: DVec3) -> f64 {
    let (toward, solid_angle) = light_from(config, geometry, position_mm);
    toward.z.max(0.0) * solid_angle
}

/// Unit direction from a point of the sample toward the light, and the light's solid angle dω_i there, sr.
pub fn light_from(config: &RigConfig, geometry: &PoseGeometry, position_mm: DVec3) -> (DVec3, f64) {
    let to_light = geometry.light_mm - position_mm;
    let r2 = to_light.length_squared();
    (to_light / r2.sqrt(), config.lamp.aperture_mm2() / r2)
}

/// f_r = L_r / (L_s cosθ_i dω_i) a channel, sr⁻¹ (3.9); NaN where the radiance is or where no light falls.
pub fn reflectance(config: &RigConfig, radiance: [f32; 3], irradiance_factor: f64) -> [f32; 3] {
    std::array::from_fn(|c| {
        let irradiance = config.lamp.radiance[c] * irradiance_factor;
        if irradiance > 0.0 { (f64::from(radiance[c]) / irradiance) as f32 } else { f32::NAN }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_near_light_changes_irradiance_across_the_sample_as_the_closed_form_says() {
        let config = RigConfig::default();
        let light_mm = DVec3::new(500.0, 0.0, 866.0);
        let geometry = PoseGeometry { light_mm, camera_mm: DVec3::Z * 1000.0, weight: 1.0 };
        let [near, far] =
            [32.0, -32.0].map(|x| irradiance_factor(&config, &geometry, DVec3::new(x, 0.0, 0.0)));
        let expected = |x: f64| {
            let r2 = (500.0 - x) * (500.0 - x) + 866.0 * 866.0;
            866.0 / r2.powf(1.5)
        };
        assert!((near / far - expected(32.0) / expected(-32.0)).abs() < 1e-12);
        assert!(near / far > 1.09, "{}", near / far);
    }

    #[test]
    fn a_diffuser_of_albedo_one_has_reflectance_one_over_pi() {
        let config = RigConfig::default();
        let geometry =
            PoseGeometry { light_mm: DVec3::new(300.0, 0.0, 900.0), camera_mm: DVec3::Z, weight: 1.0 };
        let factor = irradiance_factor(&config, &geometry, DVec3::ZERO);
        let radiance = config.lamp.radiance.map(|l| (l * factor / std::f64::consts::PI) as f32);
        for f in reflectance(&config, radiance, factor) {
            assert!((f - std::f32::consts::FRAC_1_PI).abs() < 1e-6);
        }
    }
}
