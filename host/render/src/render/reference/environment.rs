//! Importance sampling of an environment: pixels are drawn by luminance times solid angle, directions evenly
//! within one.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};

use crate::scene::{Environment, environment::texture_of};
use lobelia_reflectance::{Rgb, colour};

/// An environment with the cumulative distributions of its rows and of the pixels of each row.
pub(crate) struct Sampled {
    environment: Environment,
    sin: f32,
    cos: f32,
    /// Cumulative probability of the rows, `height` + 1 entries.
    rows: Vec<f32>,
    /// Cumulative probability within each row, `width` + 1 entries a row.
    columns: Vec<f32>,
    /// Probability density a pixel, sr⁻¹.
    density: Vec<f32>,
    /// Cosine of the polar angle at the rows' upper edges, `height` + 1 entries.
    edges: Vec<f32>,
}

/// A direction with the radiance that arrives from it and its probability density.
pub(crate) struct Arriving {
    /// Unit vector in the world.
    pub(crate) direction: Vec3,
    /// Radiance.
    pub(crate) radiance: Rgb,
    /// sr⁻¹.
    pub(crate) density: f32,
}

impl Sampled {
    /// Prepares an environment; `None` when it is black.
    pub(crate) fn new(environment: &Environment) -> Option<Self> {
        let (width, height) = (environment.width, environment.height);
        let edges: Vec<f64> =
            (0..=height).map(|row| (std::f64::consts::PI * row as f64 / height as f64).cos()).collect();
        let solid_angle = |row: usize| std::f64::consts::TAU / width as f64 * (edges[row] - edges[row + 1]);
        let weights = smoothed_luminance(environment);

        let mut rows = vec![0.0f64];
        let mut columns = Vec::with_capacity(height * (width + 1));
        for row in 0..height {
            let weights = &weights[row * width..(row + 1) * width];
            // Divided in double precision by the very sum that they end in: 1 from the last pixel that is not
            // black on.
            let mut sums = vec![0.0f64];
            let sum = weights.iter().fold(0.0, |sum, weight| {
                sums.push(sum + weight);
                sum + weight
            });
            columns.extend(sums.iter().map(|part| if sum > 0.0 { (part / sum) as f32 } else { 0.0 }));
            rows.push(rows[row] + sum * solid_angle(row));
        }
        let total = rows[height];
        if total.is_nan() || total <= 0.0 {
            return None;
        }
        let (sin, cos) = environment.rotation.sin_cos();
        Some(Self {
            environment: environment.clone(),
            sin,
            cos,
            rows: rows.iter().map(|sum| (sum / total) as f32).collect(),
            columns,
            density: weights.iter().map(|weight| (weight / total) as f32).collect(),
            edges: edges.iter().map(|&edge| edge as f32).collect(),
        })
    }

    /// Turns it to a rotation.
    pub(crate) fn turn(&mut self, rotation: f32) {
        self.environment.rotation = rotation;
        (self.sin, self.cos) = rotation.sin_cos();
    }

    /// Bytes held, the environment's own pixels included.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.environment.pixels[..])
            + size_of_val(&self.rows[..])
            + size_of_val(&self.columns[..])
            + size_of_val(&self.density[..])
            + size_of_val(&self.edges[..])
    }

    /// Texture coordinates of a world direction.
    fn texture(&self, world: Vec3) -> Vec2 {
        let (x, z) = (self.cos * world.x - self.sin * world.z, self.sin * world.x + self.cos * world.z);
        texture_of(Vec3::new(x, world.y, z))
    }

    /// Radiance from a world direction and the density with which [`Self::sample`] draws it.
    pub(crate) fn arriving(&self, direction: Vec3) -> Arriving {
        let uv = self.texture(direction);
        let (width, height) = (self.environment.width, self.environment.height);
        let column = ((uv.x * width as f32) as usize).min(width - 1);
        let row = ((uv.y * height as f32) as usize).min(height - 1);
        Arriving {
            direction,
            radiance: self.environment.radiance_at(uv),
            density: self.density[row * width + column],
        }
    }

    /// Draws a direction by two numbers in 0..1.
    pub(crate) fn sample(&self, [r, s]: [f32; 2]) -> Arriving {
        let width = self.environment.width;
        let (row, along) = find(&self.rows, s);
        let (column, across) = find(&self.columns[row * (width + 1)..(row + 1) * (width + 1)], r);
        let y = self.edges[row] + (self.edges[row + 1] - self.edges[row]) * along;
        let u = (column as f32 + across) / width as f32;
        let (sin_azimuth, cos_azimuth) = ((u - 0.5) * TAU).sin_cos();
        let radius = (1.0 - y * y).max(0.0).sqrt();
        let local = Vec3::new(radius * sin_azimuth, y, -radius * cos_azimuth);
        let direction =
            Vec3::new(self.cos * local.x + self.sin * local.z, y, self.cos * local.z - self.sin * local.x);
        let uv = Vec2::new(u, y.acos() / PI);
        Arriving {
            direction,
            radiance: self.environment.radiance_at(uv),
            density: self.density[row * width + column],
        }
    }
}

/// The interval of a cumulative distribution from 0 to 1 that `x` falls into, never one of probability 0, and
/// how far along it.
fn find(cumulative: &[f32], x: f32) -> (usize, f32) {
    let x = x.clamp(0.0, 1.0f32.next_down());
    let after = cumulative.partition_point(|&edge| edge <= x).clamp(1, cumulative.len() - 1);
    let (low, high) = (cumulative[after - 1], cumulative[after]);
    let along = if high > low { ((x - low) / (high - low)).clamp(0.0, 1.0) } else { 0.5 };
    (after - 1, along)
}

/// Luminance a pixel, averaged with its neighbours so that it is positive wherever the bilinear lookup is.
fn smoothed_luminance(environment: &Environment) -> Vec<f64> {
    let (width, height) = (environment.width, environment.height);
    let at = |x: usize, y: usize| {
        // The largest channel counts too: a saturated blue has little luminance.
        let pixel = environment.pixels[y * width + x];
        f64::from(0.9 * colour::luminance(pixel) + 0.1 * pixel.max_element())
    };
    let mut weights = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            let mut sum = 0.0;
            for (row, weight_y) in [(y.saturating_sub(1), 1.0), (y, 2.0), ((y + 1).min(height - 1), 1.0)] {
                let neighbours = [((x + width - 1) % width, 1.0), (x, 2.0), ((x + 1) % width, 1.0)];
                for (column, weight_x) in neighbours {
                    sum += weight_x * weight_y * at(column, row);
                }
            }
            weights.push(sum / 16.0);
        }
    }
    weights
}

#[cfg(test)]
mod tests {
    use super::*;

    fn uneven() -> Environment {
        Environment::from_function(32, 16, |d| {
            Rgb::new((3.0 * d.x).exp(), 0.2 + d.y.abs(), if d.z > 0.9 { 80.0 } else { 0.0 })
        })
        .rotated(0.7)
    }

    #[test]
    fn the_density_integrates_to_one_over_the_sphere() {
        for environment in [uneven(), Environment::studio(), Environment::uniform(Rgb::ONE)] {
            let sampled = Sampled::new(&environment).unwrap();
            let (columns, rows) = (512, 1024);
            let mut integral = 0.0f64;
            for j in 0..rows {
                let y = 1.0 - (j as f32 + 0.5) / rows as f32 * 2.0;
                let radius = (1.0 - y * y).sqrt();
                for i in 0..columns {
                    let (sin, cos) = ((i as f32 + 0.5) / columns as f32 * TAU).sin_cos();
                    let density = sampled.arriving(Vec3::new(radius * sin, y, radius * cos)).density;
                    integral += f64::from(density);
                }
            }
            integral *= 4.0 * std::f64::consts::PI / f64::from(columns * rows);
            assert!((integral - 1.0).abs() < 0.01, "{integral}");
        }
    }

    #[test]
    fn samples_carry_the_density_and_the_radiance_of_their_direction() {
        let environment = uneven();
        let sampled = Sampled::new(&environment).unwrap();
        let mut agreeing = 0;
        let mut mean = 0.0f64;
        for index in 0..4096 {
            let sample = sampled.sample(crate::render::sampler::point(5, index, 0));
            let looked_up = sampled.arriving(sample.direction);
            assert!((sample.direction.length() - 1.0).abs() < 1e-5);
            let radiance_agrees =
                (looked_up.radiance - environment.radiance(sample.direction)).length() < 1e-2;
            agreeing += usize::from(looked_up.density == sample.density && radiance_agrees);
            mean += f64::from(1.0 / sample.density) / 4096.0;
        }
        // Rounding moves a few over a pixel's edge.
        assert!(agreeing > 4050, "{agreeing}");
        // The mean of the inverse density is the measure of the sphere.
        assert!((mean / (4.0 * std::f64::consts::PI) - 1.0).abs() < 0.02, "{mean}");
    }

    #[test]
    fn nothing_is_drawn_from_black_pixels_whatever_the_numbers() {
        // Rows that are lit by many small pixels at their begin and black at their end, as a lamp on black
        // leaves them.
        let mut pixels = vec![Rgb::ZERO; 200 * 9];
        for (k, pixel) in pixels.iter_mut().enumerate().filter(|(k, _)| k % 200 < 77 && k / 200 % 4 != 3) {
            *pixel = Rgb::splat(0.1 + 1e-3 * (k % 13) as f32);
        }
        let environment = Environment::new(200, 9, pixels).unwrap();
        let sampled = Sampled::new(&environment).unwrap();
        let ends = [0.0, f32::MIN_POSITIVE, 0.5, 1.0f32.next_down(), 1.0];
        for r in ends.into_iter().chain((0..1000).map(|k| 1.0 - k as f32 * 1e-7)) {
            for s in ends.into_iter().chain((0..50).map(|k| k as f32 / 50.0)) {
                let sample = sampled.sample([r, s]);
                assert!(sample.density > 0.0 && sample.density.is_finite(), "{r} {s}: {}", sample.density);
            }
        }
        let width = environment.width + 1;
        for row in sampled.columns.chunks(width) {
            assert!(row[width - 1] == 1.0 || row[width - 1] == 0.0);
        }
    }

    #[test]
    fn a_black_environment_has_nothing_to_sample() {
        assert!(Sampled::new(&Environment::uniform(Rgb::ZERO)).is_none());
    }
}
