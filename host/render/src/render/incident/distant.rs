//! An environment in spherical harmonics: the same incident radiance at every vertex, turned as the
//! environment is.

use glam::{DQuat, DVec3, Vec3};
use rayon::prelude::*;

use super::ground::Ground;
use super::harmonics::{self, COUNT};
use crate::render::environment::source::Source;
use crate::scene::Environment;

/// Angle between the points that an environment is summed over, radians.
const SPACING: f32 = 0.02;

/// Coefficients of an environment that is not turned, by channel.
pub(super) struct Distant {
    degree: usize,
    coefficients: [[f64; COUNT]; 3],
}

impl Distant {
    /// Projects an environment.
    pub(super) fn new(environment: &Environment, degree: usize) -> Self {
        let image = Environment { rotation: 0.0, ..environment.clone() };
        let mut coefficients = [[0.0; COUNT]; 3];
        for (direction, flux) in Source::new(&image, SPACING).points {
            let y = harmonics::basis(degree, direction.as_dvec3().normalize());
            for (channel, flux) in coefficients.iter_mut().zip(flux.to_array()) {
                channel.iter_mut().zip(y).for_each(|(sum, y)| *sum += f64::from(flux) * y);
            }
        }
        Self { degree, coefficients }
    }

    /// Adds the irradiance of every receiver under the environment turned about +y.
    pub(super) fn add(&self, rotation: f32, ground: &Ground<'_>, irradiance: &mut [Vec3]) {
        let turn = DQuat::from_rotation_y(f64::from(rotation));
        let turned = harmonics::rotated(self.degree, &self.coefficients, turn);
        let light: [DVec3; COUNT] =
            std::array::from_fn(|i| DVec3::from_array(turned.map(|channel| channel[i])));
        irradiance.par_iter_mut().enumerate().for_each(|(receiver, sum)| {
            *sum += ground.product(receiver, |i| light[i]).as_vec3();
        });
    }
}
