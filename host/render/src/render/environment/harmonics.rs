//! Irradiance by spherical harmonics to the second degree: nine numbers a channel (Ramamoorthi and
//! Hanrahan 2001).

use std::f32::consts::PI;

use glam::Vec3;

use super::source::Source;
use crate::scene::Environment;
use lobelia_reflectance::Rgb;

/// The coefficients of irradiance.
pub(crate) struct Harmonics {
    pub(super) coefficients: [Rgb; 9],
    pub(super) rotation: f32,
}

/// Real spherical harmonics of degree 0 to 2 in the order of Ramamoorthi and Hanrahan.
fn basis(d: Vec3) -> [f32; 9] {
    let c = [0.282_095, 0.488_603, 1.092_548, 0.315_392, 0.546_274];
    [
        c[0],
        c[1] * d.y,
        c[1] * d.z,
        c[1] * d.x,
        c[2] * d.x * d.y,
        c[2] * d.y * d.z,
        c[3] * (3.0 * d.z * d.z - 1.0),
        c[2] * d.x * d.z,
        c[4] * (d.x * d.x - d.y * d.y),
    ]
}

impl Harmonics {
    /// Projects an environment and convolves it with the clamped cosine.
    pub(crate) fn new(environment: &Environment) -> Self {
        let image = Environment { rotation: 0.0, ..environment.clone() };
        let source = Source::new(&image, 0.03);
        let mut coefficients = [Rgb::ZERO; 9];
        for (direction, flux) in source.points {
            for (coefficient, value) in coefficients.iter_mut().zip(basis(direction)) {
                *coefficient += flux * value;
            }
        }
        // The cosine's own coefficients by degree.
        let degrees = [0, 1, 1, 1, 2, 2, 2, 2, 2];
        for (coefficient, degree) in coefficients.iter_mut().zip(degrees) {
            *coefficient *= [PI, 2.0 * PI / 3.0, PI / 4.0][degree];
        }
        Self { coefficients, rotation: environment.rotation }
    }

    /// D(N), not below 0.
    pub(crate) fn irradiance(&self, normal: Vec3) -> Rgb {
        let local = glam::Quat::from_rotation_y(-self.rotation) * normal;
        self.coefficients.iter().zip(basis(local)).map(|(&c, value)| c * value).sum::<Rgb>().max(Rgb::ZERO)
    }
}
