//! Distant radiance over the sphere as an equirectangular image, read from a file or computed.
//!
//! Row 0 is +y; the middle of the image is −z (where a camera looks without rotation) and u grows toward +x.

use std::f32::consts::{PI, TAU};
use std::sync::Arc;

use glam::{Vec2, Vec3};

use lobelia_base::error::{Error, Result};
use lobelia_reflectance::Rgb;

/// Equirectangular radiance, turned about +y.
#[derive(Debug, Clone, PartialEq)]
pub struct Environment {
    /// Pixels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Radiance a pixel, row by row from +y.
    pub pixels: Arc<[Rgb]>,
    /// Turn about +y by the right hand, radians.
    pub rotation: f32,
}

impl Environment {
    /// An environment from its pixels.
    ///
    /// # Errors
    /// Input errors for a wrong number of pixels, or a radiance that is negative or not finite (which pixel
    /// is named).
    pub fn new(width: usize, height: usize, pixels: Vec<Rgb>) -> Result<Self> {
        if width == 0 || height == 0 || pixels.len() != width * height {
            return Err(Error::input(format!(
                "an environment of {width} × {height} pixels needs as many values, not {}",
                pixels.len()
            )));
        }
        if let Some(i) = pixels.iter().position(|p| !(p.is_finite() && p.min_element() >= 0.0)) {
            let (x, y) = (i % width, i / width);
            return Err(Error::input(format!(
                "pixel ({x}, {y}) has the radiance {}, which is negative or not finite",
                pixels[i]
            )));
        }
        Ok(Self { width, height, pixels: pixels.into(), rotation: 0.0 })
    }

    /// The same radiance from everywhere.
    pub fn uniform(radiance: Rgb) -> Self {
        Self { width: 2, height: 1, pixels: vec![radiance; 2].into(), rotation: 0.0 }
    }

    /// An environment whose pixels are averages of `radiance` over 2 × 2 directions each.
    pub fn from_function(width: usize, height: usize, radiance: impl Fn(Vec3) -> Rgb) -> Self {
        let pixel = |index: usize| {
            let (x, y) = ((index % width) as f32, (index / width) as f32);
            let at = |dx: f32, dy: f32| {
                radiance(direction_of(Vec2::new((x + dx) / width as f32, (y + dy) / height as f32)))
            };
            (at(0.25, 0.25) + at(0.75, 0.25) + at(0.25, 0.75) + at(0.75, 0.75)) / 4.0
        };
        Self { width, height, pixels: (0..width * height).map(pixel).collect(), rotation: 0.0 }
    }

    /// The environment turned further about +y, radians.
    pub fn rotated(mut self, angle: f32) -> Self {
        self.rotation += angle;
        self
    }

    /// From a world direction to the image's own frame.
    pub fn into_image_frame(&self, world: Vec3) -> Vec3 {
        glam::Quat::from_rotation_y(-self.rotation) * world
    }

    /// Radiance from a world direction, bilinear between pixel centres.
    pub fn radiance(&self, world: Vec3) -> Rgb {
        self.radiance_at(texture_of(self.into_image_frame(world)))
    }

    /// Radiance at texture coordinates 0..1, bilinear between pixel centres; u wraps around.
    pub fn radiance_at(&self, uv: Vec2) -> Rgb {
        let x = uv.x * self.width as f32 - 0.5;
        let y = (uv.y * self.height as f32 - 0.5).clamp(0.0, (self.height - 1) as f32);
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let columns = self.width as i64;
        let left = (x0 as i64).rem_euclid(columns) as usize;
        let right = if left + 1 == self.width { 0 } else { left + 1 };
        let top = y0 as usize * self.width;
        let bottom = (y0 as usize + 1).min(self.height - 1) * self.width;
        let mix = |row: usize| self.pixels[row + left].lerp(self.pixels[row + right], fx);
        mix(top).lerp(mix(bottom), fy)
    }

    /// A photographer's studio: two large softboxes, a strip light, an overhead and a dim grey room.
    pub fn studio() -> Self {
        let boxes = [
            // azimuth from −z toward +x, elevation, half width, half height (tangents), colour, radiance
            softbox(140.0, 38.0, 0.42, 0.55, Rgb::new(1.0, 0.95, 0.88), 11.0),
            softbox(-122.0, 22.0, 0.30, 0.75, Rgb::new(0.80, 0.90, 1.0), 4.2),
            softbox(-20.0, 48.0, 0.60, 0.16, Rgb::new(1.0, 0.98, 0.95), 8.0),
            softbox(75.0, 16.0, 0.09, 0.70, Rgb::new(1.0, 0.97, 0.92), 5.0),
        ];
        Self::from_function(512, 256, |direction| {
            let height = direction.y;
            let wall = Rgb::new(0.30, 0.31, 0.33) * (0.55 + 0.45 * height.max(0.0));
            let floor = Rgb::new(0.16, 0.15, 0.14);
            let room = floor.lerp(wall, ((height + 0.15) / 0.3).clamp(0.0, 1.0));
            room + boxes.iter().map(|lamp| lamp(direction)).sum::<Rgb>()
        })
    }

    /// A clear sky (CIE type 12) of colour and a sun of 3° at 40° elevation, over a grey ground.
    pub fn sky() -> Self {
        let sun = direction_from_angles(40.0, 40.0);
        let zenith_angle = (sun.y).acos();
        let indicatrix =
            |angle: f32| 1.0 + 10.0 * ((-3.0 * angle).exp() - (-1.5 * PI).exp()) + 0.45 * angle.cos().powi(2);
        let gradation = |cos_zenith: f32| 1.0 - (-0.32 / cos_zenith.max(0.01)).exp();
        let reference = indicatrix(zenith_angle) * gradation(1.0);
        Self::from_function(1024, 512, |direction| {
            if direction.y < 0.0 {
                return Rgb::new(0.20, 0.19, 0.17);
            }
            let angle = direction.dot(sun).clamp(-1.0, 1.0).acos();
            let relative = indicatrix(angle) * gradation(direction.y) / reference;
            let blue = Rgb::new(0.35, 0.55, 1.0).lerp(Rgb::new(0.85, 0.92, 1.0), (1.0 - direction.y).powi(3));
            let disc = if angle < 1.5f32.to_radians() { 900.0 } else { 0.0 };
            blue * (0.55 * relative) + Rgb::new(1.0, 0.92, 0.80) * disc
        })
    }
}

/// A unit direction from its azimuth (from −z toward +x) and elevation, degrees.
fn direction_from_angles(azimuth_deg: f32, elevation_deg: f32) -> Vec3 {
    let (sin, cos) = azimuth_deg.to_radians().sin_cos();
    let (up, flat) = elevation_deg.to_radians().sin_cos();
    Vec3::new(flat * sin, up, -flat * cos)
}

/// A rectangle of light with soft edges, as a function of direction.
fn softbox(
    azimuth_deg: f32,
    elevation_deg: f32,
    half_width: f32,
    half_height: f32,
    colour: Rgb,
    radiance: f32,
) -> impl Fn(Vec3) -> Rgb {
    let axis = direction_from_angles(azimuth_deg, elevation_deg);
    let right = axis.cross(Vec3::Y).normalize();
    let up = right.cross(axis);
    move |direction| {
        let depth = direction.dot(axis);
        if depth <= 0.0 {
            return Rgb::ZERO;
        }
        let (x, y) = (direction.dot(right) / depth, direction.dot(up) / depth);
        let edge = |x: f32, half: f32| ((half - x.abs()) / 0.05 + 0.5).clamp(0.0, 1.0);
        // Brighter in the middle, as diffusers over a lamp are.
        let middle = 1.0 - 0.25 * ((x / half_width).powi(2) + (y / half_height).powi(2)).min(2.0);
        colour * (radiance * middle * edge(x, half_width) * edge(y, half_height))
    }
}

/// Direction in the image's frame of texture coordinates 0..1.
pub fn direction_of(uv: Vec2) -> Vec3 {
    let (sin_polar, cos_polar) = (uv.y * PI).sin_cos();
    let (sin, cos) = ((uv.x - 0.5) * TAU).sin_cos();
    Vec3::new(sin_polar * sin, cos_polar, -sin_polar * cos)
}

/// Texture coordinates 0..1 of a direction in the image's frame.
pub fn texture_of(direction: Vec3) -> Vec2 {
    let u = 0.5 + direction.x.atan2(-direction.z) / TAU;
    Vec2::new(u, direction.y.clamp(-1.0, 1.0).acos() / PI)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_and_texture_coordinates_are_inverse() {
        for i in 1..20 {
            for j in 1..20 {
                let uv = Vec2::new(i as f32 / 20.0, j as f32 / 20.0);
                assert!((texture_of(direction_of(uv)) - uv).length() < 1e-5);
            }
        }
        assert!((direction_of(Vec2::splat(0.5)) - Vec3::NEG_Z).length() < 1e-6);
        assert!((direction_of(Vec2::new(0.75, 0.5)) - Vec3::X).length() < 1e-6);
    }

    #[test]
    fn rotation_turns_by_the_right_hand_about_y() {
        let mut pixels = vec![Rgb::ZERO; 64 * 32];
        pixels[15 * 64 + 32] = Rgb::ONE;
        let environment = Environment::new(64, 32, pixels).unwrap();
        let toward = direction_of(Vec2::new(32.5 / 64.0, 15.5 / 32.0));
        assert!(environment.radiance(toward).x > 0.99);
        let turned = environment.rotated(std::f32::consts::FRAC_PI_2);
        assert!(turned.radiance(glam::Quat::from_rotation_y(std::f32::consts::FRAC_PI_2) * toward).x > 0.99);
    }

    #[test]
    fn computed_environments_are_finite_and_lit() {
        for environment in [Environment::studio(), Environment::sky()] {
            let (width, height) = (environment.width, environment.height);
            Environment::new(width, height, environment.pixels.to_vec()).unwrap();
            assert!(environment.radiance(Vec3::Y).max_element() > 0.1);
        }
    }

    #[test]
    fn a_negative_pixel_is_named() {
        let mut pixels = vec![Rgb::ONE; 8];
        pixels[5].y = -1.0;
        assert!(Environment::new(4, 2, pixels).unwrap_err().to_string().contains("(1, 1)"));
    }
}
