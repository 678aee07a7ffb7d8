//! Reflection of lights at a surface point: L = Σ_l f(ω_l, ω_o) L_l (N·ω_l) (6.9), rectangular ones by
//! samples of their surface.

use glam::{Vec3, Vec4};

use super::geometry::Surface;
use super::materials::Shader;
use super::sampler::hash;
use crate::scene::{Background, Camera, Light, Scene};
use lobelia_gpu::lights::Lamp;
use lobelia_reflectance::Rgb;

/// A scene's lights.
pub(crate) fn lamps(lights: &[Light]) -> Vec<Lamp> {
    let lamp = |place: Vec3, w: f32, power: Rgb, edges: [Vec3; 2]| Lamp {
        place: place.extend(w),
        power: power.extend(0.0),
        edges: edges.map(|edge| edge.extend(0.0)),
    };
    let none = [Vec3::ZERO; 2];
    (lights.iter())
        .map(|light| match *light {
            Light::Directional { toward, irradiance } => lamp(toward, 0.0, irradiance, none),
            Light::Point { position, intensity } => lamp(position, 1.0, intensity, none),
            Light::Rectangle { centre, edges, radiance } => lamp(centre, 2.0, radiance, edges),
        })
        .collect()
}

/// A light, or a place on it, as a point sees it.
pub(crate) struct Seen {
    /// Unit vector toward the light.
    pub(crate) toward: Vec3,
    /// How far it is.
    pub(crate) distance: f32,
    /// Irradiance on a surface that faces it.
    pub(crate) irradiance: Rgb,
}

/// Angle between samples of a rectangular light, radians.
const SAMPLE_ANGLE: f32 = 0.1;

/// Samples of a rectangle along its edges: by the angle that they span at the distance of its nearest point,
/// `across` at most.
fn grid(lamp: &Lamp, point: Vec3, across: u32) -> [u32; 2] {
    if lamp.place.w != 2.0 {
        return [1, 1];
    }
    let edges = lamp.edges.map(Vec4::truncate);
    let to = lamp.place.truncate() - point;
    let nearest = edges
        .iter()
        .fold(to, |nearest, &edge| nearest + edge * (-to.dot(edge) / edge.length_squared()).clamp(-0.5, 0.5));
    let square = nearest.length_squared().max(f32::MIN_POSITIVE);
    edges.map(|edge| {
        let angle = (edge.length_squared() / square).sqrt();
        (angle / SAMPLE_ANGLE).ceil().clamp(1.0, across as f32) as u32
    })
}

/// Direction, distance and irradiance at a point: of a rectangle's part in cell `k` of a grid, at a place in
/// the cell that the seed gives.
fn see(lamp: &Lamp, point: Vec3, [columns, rows]: [u32; 2], k: u32, seed: u32) -> Seen {
    if lamp.place.w == 0.0 {
        return Seen {
            toward: lamp.place.truncate(),
            distance: f32::INFINITY,
            irradiance: lamp.power.truncate(),
        };
    }
    let mut to = lamp.place.truncate() - point;
    let [u, v] = lamp.edges.map(Vec4::truncate);
    if lamp.place.w == 2.0 {
        let cell = |at: u32, shift: u32, count: u32| {
            (at as f32 + shift as f32 * (1.0 / 65536.0)) / count as f32 - 0.5
        };
        to += u * cell(k % columns, seed & 0xffff, columns) + v * cell(k / columns, seed >> 16, rows);
    }
    let square = to.length_squared().max(f32::MIN_POSITIVE);
    let distance = square.sqrt();
    let toward = to / distance;
    let mut irradiance = lamp.power.truncate() / square;
    if lamp.place.w == 2.0 {
        // The cross product's length is the area.
        irradiance *= (-u.cross(v).dot(toward)).max(0.0) / (columns * rows) as f32;
    }
    Seen { toward, distance, irradiance }
}

/// Radiance reflected toward the viewer from all lamps, rectangles by `across` samples along an edge at most,
/// as far as `visible` lets it through. The seed, a pixel's, moves the samples.
pub(crate) fn reflect_lights(
    lamps: &[Lamp],
    across: u32,
    seed: u32,
    surface: &Surface,
    shader: &Shader,
    mut visible: impl FnMut(&Seen) -> bool,
) -> Rgb {
    let mut radiance = Rgb::ZERO;
    for (index, lamp) in (0u32..).zip(lamps) {
        let cells = grid(lamp, surface.position, across);
        for k in 0..cells[0] * cells[1] {
            let seen = see(lamp, surface.position, cells, k, hash(seed ^ (index << 16 | k)));
            let wi = surface.to_local(seen.toward);
            if wi.z <= 0.0 {
                continue;
            }
            let reflected = shader.eval(wi) * seen.irradiance * wi.z;
            if reflected != Rgb::ZERO && visible(&seen) {
                radiance += reflected;
            }
        }
    }
    radiance
}

/// The camera as rays: the image plane's corner and steps at unit distance.
pub(crate) struct Rays {
    pub(crate) origin: Vec3,
    corner: Vec3,
    right: Vec3,
    down: Vec3,
}

impl Rays {
    /// Prepares a camera.
    pub(crate) fn new(camera: &Camera) -> Self {
        let [right, up, forward] = camera.basis();
        let half_height = (camera.fov / 2.0).tan();
        let half_width = half_height * camera.width as f32 / camera.height as f32;
        Self {
            origin: camera.position,
            corner: forward - right * half_width + up * half_height,
            right: right * (2.0 * half_width / camera.width as f32),
            down: -up * (2.0 * half_height / camera.height as f32),
        }
    }

    /// Unit direction through a point of the picture in pixels, (0, 0) the corner of the top left one.
    pub(crate) fn direction(&self, x: f32, y: f32) -> Vec3 {
        (self.corner + self.right * x + self.down * y).normalize()
    }
}

/// What is seen in a direction where no object is.
pub(crate) fn background(scene: &Scene, direction: Vec3) -> Rgb {
    match scene.background {
        Background::Colour(colour) => colour,
        Background::Environment => {
            scene.environment.as_ref().map_or(Rgb::ZERO, |environment| environment.radiance(direction))
        }
    }
}
