//! An environment as points of light, and how far a lobe gathers them.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::scene::{Environment, environment::direction_of};
use lobelia_reflectance::{Rgb, colour};

/// (ω_p·ω)ⁿ, and the angle at which it ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cap {
    /// Exponent.
    pub(super) n: f32,
    /// Cosine at the end.
    pub(super) least_cosine: f32,
    /// Angle at the end, radians.
    pub(super) reach: f32,
}

impl Cap {
    /// The lobe down to the part `cut` of its peak.
    pub(super) fn new(n: f32, cut: f32) -> Self {
        let least_cosine = if n > 0.0 { cut.powf(1.0 / n) } else { 0.0 };
        Self { n, least_cosine, reach: least_cosine.acos() }
    }
}

/// An environment as points of light on a grid of equal angles.
pub(crate) struct Source {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Directions and radiance times solid angle, row by row.
    pub(crate) points: Vec<(Vec3, Rgb)>,
}

impl Source {
    /// Points at most `spacing` apart where the environment can be gathered, finer than its pixels where it
    /// must be: between them its radiance is bilinear. A point stands at the centroid of the light that it
    /// gathers.
    pub(crate) fn new(environment: &Environment, spacing: f32) -> Self {
        let pixel = PI / environment.height as f32;
        let parts = (pixel / spacing).ceil().max(1.0) as usize;
        let group = ((spacing / pixel) as usize).max(1);
        let (fine_width, fine_height) = (environment.width * parts, environment.height * parts);
        let (width, height) = (fine_width.div_ceil(group), fine_height.div_ceil(group));
        let edge = |row: usize| (PI * row as f32 / fine_height as f32).cos();
        let points = (0..width * height).into_par_iter().map(|index| {
            let (x, y) = (index % width * group, index / width * group);
            let (mut flux, mut towards) = (Rgb::ZERO, Vec3::ZERO);
            for row in y..(y + group).min(fine_height) {
                let solid_angle = TAU / fine_width as f32 * (edge(row) - edge(row + 1));
                for column in x..(x + group).min(fine_width) {
                    let uv = Vec2::new(
                        (column as f32 + 0.5) / fine_width as f32,
                        (row as f32 + 0.5) / fine_height as f32,
                    );
                    let light = environment.radiance_at(uv) * solid_angle;
                    flux += light;
                    // A little for the dark too, so that every point has a direction.
                    towards += direction_of(uv) * (colour::luminance(light) + 1e-12 * solid_angle);
                }
            }
            (towards.normalize_or(Vec3::Y), flux)
        });
        Self { width, height, points: points.collect() }
    }
}
