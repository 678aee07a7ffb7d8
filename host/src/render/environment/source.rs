//! An environment as points of light, and their sum under a lobe.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};
use pulp::{Arch, WithSimd};
use rayon::prelude::*;

use crate::reflectance::{Rgb, colour};
use crate::render::math;
use crate::scene::{Environment, environment::direction_of};

/// Points that are added at once.
const LANES: usize = 8;

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
pub(super) struct Source {
    pub(super) width: usize,
    pub(super) height: usize,
    /// x, y, z of the unit directions, and r, g, b of radiance times solid angle, each in one run for vector units.
    points: [Vec<f32>; 6],
    /// Sine and cosine of polar angles at every half row, from half a row above the first to half a row below the last.
    half_rows: Vec<(f32, f32)>,
    /// What the vector code is compiled for.
    arch: Arch,
}

/// One sum under a lobe, as vector code.
struct Gather<'a>(&'a Source, Vec3, &'a Cap);

impl WithSimd for Gather<'_> {
    type Output = Rgb;
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Rgb {
        self.0.gather(self.1, self.2)
    }
}

impl Source {
    /// Points at most `spacing` apart where the environment can be gathered, finer than its pixels where it must be: between
    /// them its radiance is bilinear. A point stands at the centroid of the light that it gathers.
    pub(super) fn new(environment: &Environment, spacing: f32) -> Self {
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
        let points: Vec<(Vec3, Rgb)> = points.collect();
        let plane = |of: fn(&(Vec3, Rgb)) -> f32| points.iter().map(of).collect();
        let planes = [
            plane(|p| p.0.x),
            plane(|p| p.0.y),
            plane(|p| p.0.z),
            plane(|p| p.1.x),
            plane(|p| p.1.y),
            plane(|p| p.1.z),
        ];
        let half_row = |k: usize| ((k as f32 - 1.0) * 0.5 * PI / height as f32).clamp(0.0, PI).sin_cos();
        let half_rows = (0..2 * height + 3).map(half_row).collect();
        Self { width, height, points: planes, half_rows, arch: Arch::new() }
    }

    /// Directions and radiance times solid angle.
    pub(super) fn points(&self) -> impl Iterator<Item = (Vec3, Rgb)> {
        let vector =
            |first: usize, i: usize| Vec3::from_array(std::array::from_fn(|k| self.points[first + k][i]));
        (0..self.points[0].len()).map(move |i| (vector(0, i), vector(3, i)))
    }

    /// The sum under a lobe that points in a direction.
    pub(super) fn filtered(&self, toward: Vec3, cap: &Cap) -> Rgb {
        self.arch.dispatch(Gather(self, toward, cap))
    }

    #[inline(always)]
    fn gather(&self, toward: Vec3, cap: &Cap) -> Rgb {
        let mut sums = [[0.0; LANES]; 3];
        // A cap that is wider by half a row touches all rows whose points the lobe may hold.
        let least = (cap.reach + 0.5 * PI / self.height as f32).min(PI).cos();
        let middle = (0.5 + toward.x.atan2(-toward.z) / TAU) * self.width as f32;
        for row in self.rows(toward, cap.reach) {
            let (first, count) = self.columns(toward, least, middle, row);
            // A run that passes the seam goes on at the row's start.
            let before = count.min(self.width - first);
            for (start, count) in [(first, before), (0, count - before)] {
                let start = row * self.width + start;
                self.add(start..start + count, toward, cap, &mut sums);
            }
        }
        Rgb::from_array(sums.map(|lanes| lanes.iter().sum()))
    }

    /// Adds a run of points within a lobe, [`LANES`] at a time.
    #[inline(always)]
    fn add(&self, run: std::ops::Range<usize>, toward: Vec3, cap: &Cap, sums: &mut [[f32; LANES]; 3]) {
        let power = |x: f32, y: f32, z: f32| {
            let base = x * toward.x + y * toward.y + z * toward.z;
            // The power is taken in any case, so that lanes stay together.
            let power = math::powf(base.max(1e-6), cap.n);
            if base > cap.least_cosine { power } else { 0.0 }
        };
        let planes = self.points.each_ref().map(|plane| plane[run.clone()].as_chunks::<LANES>());
        let [x, y, z, r, g, b] = planes.map(|(whole, _)| whole);
        let [mut red, mut green, mut blue] = *sums;
        for i in 0..x.len() {
            for k in 0..LANES {
                let power = power(x[i][k], y[i][k], z[i][k]);
                red[k] += r[i][k] * power;
                green[k] += g[i][k] * power;
                blue[k] += b[i][k] * power;
            }
        }
        let [x, y, z, r, g, b] = planes.map(|(_, rest)| rest);
        for i in 0..x.len() {
            let power = power(x[i], y[i], z[i]);
            red[i] += r[i] * power;
            green[i] += g[i] * power;
            blue[i] += b[i] * power;
        }
        *sums = [red, green, blue];
    }

    /// Rows that a cap touches.
    fn rows(&self, toward: Vec3, reach: f32) -> std::ops::Range<usize> {
        let polar = toward.y.clamp(-1.0, 1.0).acos();
        let row = |angle: f32| angle / PI * self.height as f32;
        let low = (row(polar - reach) - 1.0).max(0.0) as usize;
        let high = ((row(polar + reach) + 2.0) as usize).min(self.height);
        low..high
    }

    /// First column and number of columns of a row that a cap of the cosine `least` touches; `middle` is the column of its axis.
    fn columns(&self, toward: Vec3, least: f32, middle: f32, row: usize) -> (usize, usize) {
        // The widest azimuth over the row's height, its neighbours' half rows included.
        let flat = (1.0 - toward.y * toward.y).max(0.0).sqrt();
        let cosines = self.half_rows[2 * row..2 * row + 5].iter().map(|&(sin, cos)| {
            let (along, needed) = (sin * flat, least - cos * toward.y);
            if along <= 1e-6 { needed.signum() } else { needed / along }
        });
        let cosine = cosines.fold(f32::INFINITY, f32::min);
        if cosine >= 1.0 {
            return (0, 0);
        }
        let half = cosine.max(-1.0).acos() / TAU * self.width as f32 + 1.0;
        if 2.0 * half + 1.0 >= self.width as f32 {
            return (0, self.width);
        }
        let first = (middle - half).floor();
        let count = (middle + half).ceil() - first;
        ((first as i64).rem_euclid(self.width as i64) as usize, count as usize)
    }
}
