//! Reflection of point and directional lights at a surface point: L = Σ_l f(ω_l, ω_o) L_l (N·ω_l) (6.9).

use glam::Vec3;

use super::geometry::Surface;
use super::materials::Shader;
use crate::reflectance::Rgb;
use crate::scene::{Background, Light, Scene};

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
pub(crate) fn see(light: &Light, point: Vec3) -> Seen {
    match *light {
        Light::Directional { toward, irradiance } => Seen { toward, distance: f32::INFINITY, irradiance },
        Light::Point { position, intensity } => {
            let to = position - point;
            let square = to.length_squared().max(f32::MIN_POSITIVE);
            let distance = square.sqrt();
            Seen { toward: to / distance, distance, irradiance: intensity / square }
        }
    }
}

/// Radiance reflected toward the viewer from all lights that `visible` lets through.
pub(crate) fn reflect_lights(
    lights: &[Light],
    surface: &Surface,
    shader: &Shader,
    mut visible: impl FnMut(&Seen) -> bool,
) -> Rgb {
    let mut radiance = Rgb::ZERO;
    for light in lights {
        let seen = see(light, surface.position);
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
    /// Prepares a scene's camera.
    pub(crate) fn new(scene: &Scene) -> Self {
        let camera = &scene.camera;
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
