//! Reflection of lights without extent at a surface point: L = Σ_l f(ω_l, ω_o) L_l (N·ω_l) (6.9).

use bytemuck::{Pod, Zeroable};
use glam::{Vec3, Vec4};

use super::geometry::Surface;
use super::materials::Shader;
use crate::reflectance::Rgb;
use crate::scene::{Background, Camera, Light, Scene};

/// A light without extent, in one layout for CPU and shader.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Lamp {
    /// Directional: unit vector toward the light, w = 0. Point: position, w = 1.
    place: Vec4,
    /// Directional: irradiance. Point: intensity.
    power: Vec4,
    /// Normal of a point's surface, whose cosine counts; zero for a light that is the same all round.
    front: Vec4,
}

/// A scene's lights without extent; a rectangle becomes `across` × `across` points of its surface.
pub(crate) fn lamps(lights: &[Light], across: u32) -> Vec<Lamp> {
    let mut lamps = Vec::new();
    for light in lights {
        match *light {
            Light::Directional { toward, irradiance } => lamps.push(Lamp {
                place: toward.extend(0.0),
                power: irradiance.extend(0.0),
                front: Vec4::ZERO,
            }),
            Light::Point { position, intensity } => lamps.push(Lamp {
                place: position.extend(1.0),
                power: intensity.extend(0.0),
                front: Vec4::ZERO,
            }),
            Light::Rectangle { centre, edges: [u, v], radiance } => {
                let cross = u.cross(v);
                let part = (across * across) as f32;
                let offset = |k: u32| (k as f32 + 0.5) / across as f32 - 0.5;
                for (i, j) in (0..across).flat_map(|i| (0..across).map(move |j| (i, j))) {
                    lamps.push(Lamp {
                        place: (centre + u * offset(i) + v * offset(j)).extend(1.0),
                        power: (radiance * (cross.length() / part)).extend(0.0),
                        front: cross.normalize().extend(0.0),
                    });
                }
            }
        }
    }
    lamps
}

/// A light as a point sees it.
pub(crate) struct Seen {
    /// Unit vector toward the light.
    pub(crate) toward: Vec3,
    /// How far it is.
    pub(crate) distance: f32,
    /// Irradiance on a surface that faces it.
    pub(crate) irradiance: Rgb,
}

/// Direction, distance and irradiance of a light at a point.
pub(crate) fn see(lamp: &Lamp, point: Vec3) -> Seen {
    if lamp.place.w == 0.0 {
        let toward = lamp.place.truncate();
        return Seen { toward, distance: f32::INFINITY, irradiance: lamp.power.truncate() };
    }
    let to = lamp.place.truncate() - point;
    let square = to.length_squared().max(f32::MIN_POSITIVE);
    let distance = square.sqrt();
    let toward = to / distance;
    let front = lamp.front.truncate();
    let cosine = if front == Vec3::ZERO { 1.0 } else { (-front.dot(toward)).max(0.0) };
    Seen { toward, distance, irradiance: lamp.power.truncate() * (cosine / square) }
}

/// Radiance reflected toward the viewer from all lamps that `visible` lets through.
pub(crate) fn reflect_lights(
    lamps: &[Lamp],
    surface: &Surface,
    shader: &Shader,
    mut visible: impl FnMut(&Seen) -> bool,
) -> Rgb {
    let mut radiance = Rgb::ZERO;
    for lamp in lamps {
        let seen = see(lamp, surface.position);
        let wi = surface.to_local(seen.toward);
        if wi.z <= 0.0 {
            continue;
        }
        let reflected = shader.eval(wi) * seen.irradiance * wi.z;
        if reflected != Rgb::ZERO && visible(&seen) {
            radiance += reflected;
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
