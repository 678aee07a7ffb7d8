//! S by direct quadrature: what prefiltered maps are judged by.

use std::f64::consts::{PI, TAU};

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::accuracy::Judge;
use super::prefilter::Prefiltered;
use crate::scene::Environment;
use lobelia_reflectance::Rgb;

/// Exponents at which maps are judged: powers of two and what lies between them.
pub const MAP_EXPONENTS: [f32; 12] =
    [1.0, 1.4, 2.8, 5.5, 11.0, 22.0, 45.0, 88.0, 170.0, 350.0, 700.0, 1000.0];
/// Directions in which they are.
pub const DIRECTIONS: usize = 128;

/// Lobes count down to this part of their peak.
const CUT: f64 = 1e-9;

/// S(ω_p, n) of an environment without rotation: midpoints of parts of pixels, over which radiance is
/// bilinear and the lobe nearly even.
pub fn light(environment: &Environment, toward: Vec3, n: f32) -> Rgb {
    let n = f64::from(n);
    let pixel = PI / environment.height as f64;
    let parts = ((pixel * (n / 0.002).sqrt() / 2.0).ceil() as usize).max(1) * 2;
    let (width, height) = (environment.width * parts, environment.height * parts);
    let toward = toward.as_dvec3();
    let least = if n > 0.0 { CUT.powf(1.0 / n) } else { 0.0 };
    let angle = |column: usize| ((column as f64 + 0.5) / width as f64 - 0.5) * TAU;
    // ω_p·ω = y cosθ + sinθ (x sinφ − z cosφ).
    let flat: Vec<f64> =
        (0..width).map(|column| toward.x * angle(column).sin() - toward.z * angle(column).cos()).collect();
    let (polar, reach) = (toward.y.clamp(-1.0, 1.0).acos(), least.acos());
    let mut sum = DVec3::ZERO;
    for row in 0..height {
        let v = (row as f64 + 0.5) / height as f64;
        if (v * PI - polar).abs() > reach {
            continue;
        }
        let (sin, cos) = (v * PI).sin_cos();
        let mut row_sum = DVec3::ZERO;
        for (column, flat) in flat.iter().enumerate() {
            let base = toward.y * cos + sin * flat;
            if base > least {
                let u = (column as f64 + 0.5) / width as f64;
                row_sum += environment.radiance_at(Vec2::new(u as f32, v as f32)).as_dvec3() * base.powf(n);
            }
        }
        sum += row_sum * sin;
    }
    (sum * (PI / height as f64 * TAU / width as f64)).as_vec3()
}

/// How far maps are from quadrature at one exponent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapError {
    /// Root mean square over directions, as `accuracy` has it.
    pub rms: f64,
    /// The largest.
    pub largest: f64,
}

/// S of one exponent in some directions.
pub struct Truth {
    judge: Judge,
    n: f32,
    rotation: f32,
    /// Directions in the image's frame, and S.
    light: Vec<(Vec3, Rgb)>,
}

impl Truth {
    /// By quadrature in `count` directions.
    pub fn new(environment: &Environment, n: f32, count: usize) -> Self {
        let image = Environment { rotation: 0.0, ..environment.clone() };
        let judge = Judge::new(&image);
        let toward = judge.directions(n, count, 0.37).into_par_iter();
        let light = toward.map(|toward| (toward, light(&image, toward, n))).collect();
        Self { judge, n, rotation: environment.rotation, light }
    }

    /// The error of maps.
    pub fn error(&self, maps: &Prefiltered) -> MapError {
        let turn = glam::Quat::from_rotation_y(self.rotation);
        let error = |&(toward, light): &(Vec3, Rgb)| {
            f64::from(self.judge.relative(maps.lobe(turn * toward, self.n), light, self.n))
        };
        let errors: Vec<f64> = self.light.iter().map(error).collect();
        let squares: f64 = errors.iter().map(|error| error * error).sum();
        let largest = errors.iter().copied().fold(0.0, f64::max);
        MapError { rms: (squares / errors.len() as f64).sqrt(), largest }
    }
}
