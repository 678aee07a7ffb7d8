//! Paths: emitted light found by the lobes' own samples and by samples of the emitters, joined by the power heuristic
//! (Veach and Guibas 1995); lights without extent by shadow rays; Russian roulette.

use glam::{Vec3, Vec4};

use super::environment::{Arriving, Sampled};
use super::lobes;
use super::rectangle;
use crate::reflectance::Rgb;
use crate::render::geometry::{Geometry, Surface};
use crate::render::materials::{Materials, Shader};
use crate::render::sampler;
use crate::render::shading::{self, Lamp};
use crate::scene::{Light, Scene};

/// Reflections after which roulette decides whether a path goes on.
const CERTAIN_BOUNCES: u32 = 2;

/// What the numbers of a path's bounce are for.
mod purpose {
    pub(super) const TEXEL: u32 = 0;
    pub(super) const ENVIRONMENT: u32 = 1;
    pub(super) const RECTANGLE: u32 = 2;
    pub(super) const LOBE: u32 = 3;
    /// Which lobe, and roulette.
    pub(super) const CHOICE: u32 = 4;
    pub(super) const COUNT: u32 = 5;
}

/// The numbers of one path.
pub(super) struct Numbers {
    pub(super) pixel: u32,
    pub(super) index: u32,
}

impl Numbers {
    /// Where in the pixel the path starts.
    pub(super) fn pixel(&self) -> [f32; 2] {
        sampler::point(self.pixel, self.index, 0)
    }

    fn at(&self, bounce: u32, purpose: u32) -> [f32; 2] {
        sampler::point(self.pixel, self.index, 1 + bounce * purpose::COUNT + purpose)
    }
}

/// How a ray's direction was drawn.
struct Drawn {
    /// Density by the lobes, sr⁻¹.
    density: f32,
    /// The point it was drawn at.
    from: Vec3,
}

/// A scene made ready.
pub(super) struct Tracer<'a> {
    scene: &'a Scene,
    geometry: Geometry,
    materials: Materials,
    environment: Option<Sampled<'a>>,
    /// Lights without extent.
    lamps: Vec<Lamp>,
    rectangles: Vec<(Vec3, [Vec3; 2], Rgb)>,
    /// Reflections at most.
    bounces: u32,
}

impl<'a> Tracer<'a> {
    /// Builds the tree and the tables.
    pub(super) fn new(scene: &'a Scene, bounces: u32) -> Self {
        let is_rectangle = |light: &Light| matches!(light, Light::Rectangle { .. });
        let points: Vec<Light> = scene.lights.iter().filter(|light| !is_rectangle(light)).copied().collect();
        let rectangles = scene.lights.iter().filter_map(|light| match *light {
            Light::Rectangle { centre, edges, radiance } => Some((centre, edges, radiance)),
            _ => None,
        });
        Self {
            scene,
            geometry: Geometry::new(scene),
            materials: Materials::new(scene),
            environment: scene.environment.as_ref().and_then(Sampled::new),
            lamps: shading::lamps(&points, 1),
            rectangles: rectangles.collect(),
            bounces,
        }
    }

    /// Bytes held for the scene.
    pub(super) fn bytes(&self) -> usize {
        self.geometry.bytes() + self.materials.bytes() + self.environment.as_ref().map_or(0, Sampled::bytes)
    }

    /// Radiance along a camera ray, and 1 where it meets an object.
    pub(super) fn path(
        &self,
        numbers: &Numbers,
        (mut origin, mut direction): (Vec3, Vec3),
        shader: &mut Shader,
        rays: &mut u64,
    ) -> Vec4 {
        let (mut radiance, mut throughput, mut coverage) = (Rgb::ZERO, Rgb::ONE, 0.0);
        // The camera's ray is certain.
        let mut drawn: Option<Drawn> = None;
        for bounce in 0..=self.bounces {
            *rays += 1;
            let Some(hit) = self.geometry.nearest(origin, direction) else {
                radiance += throughput * self.beyond(direction, drawn);
                break;
            };
            if bounce == 0 {
                coverage = 1.0;
            }
            let object = self.geometry.object(&hit);
            if let Some(emission) = self.materials.emission(object) {
                if self.geometry.front(&hit, direction) {
                    radiance += throughput * emission * self.weight_of_rectangle(object, drawn);
                }
                break;
            }
            if bounce == self.bounces {
                break;
            }
            let surface = self.geometry.surface(&hit, origin, direction);
            let texel = self.materials.choose(object, surface.uv, numbers.at(bounce, purpose::TEXEL));
            shader.aim(&self.materials, texel, surface.to_local(-direction), true);
            radiance += throughput * self.direct(numbers, bounce, &surface, shader, rays);

            let [choice, roulette] = numbers.at(bounce, purpose::CHOICE);
            let wi = lobes::sample(shader, choice, numbers.at(bounce, purpose::LOBE));
            direction = surface.to_world(wi);
            if wi.z <= 0.0 || surface.geometric.dot(direction) <= 0.0 {
                break;
            }
            let (reflectance, density) = shader.eval_and_density(wi);
            throughput *= reflectance * (wi.z / density);
            if bounce >= CERTAIN_BOUNCES {
                let survival = throughput.max_element().min(0.95);
                if roulette >= survival {
                    break;
                }
                throughput /= survival;
            }
            drawn = Some(Drawn { density, from: surface.position });
            origin = self.geometry.leaving(&surface);
        }
        radiance.extend(coverage)
    }

    /// What a ray that meets nothing brings.
    fn beyond(&self, direction: Vec3, drawn: Option<Drawn>) -> Rgb {
        let Some(drawn) = drawn else { return shading::background(self.scene, direction) };
        self.environment.as_ref().map_or(Rgb::ZERO, |environment| {
            let arriving = environment.arriving(direction);
            arriving.radiance * power_heuristic(drawn.density, arriving.density)
        })
    }

    /// The weight of a rectangular light that a ray has met.
    fn weight_of_rectangle(&self, object: u32, drawn: Option<Drawn>) -> f32 {
        let Some(drawn) = drawn else { return 1.0 };
        let (centre, edges, _) = self.rectangles[object as usize - self.scene.objects.len()];
        rectangle::Seen::new(centre, edges, drawn.from)
            .map_or(1.0, |seen| power_heuristic(drawn.density, self.density_of(&seen)))
    }

    /// Density with which a rectangle's directions are drawn: one rectangle of all, evenly over its solid angle.
    fn density_of(&self, seen: &rectangle::Seen) -> f32 {
        1.0 / (seen.solid_angle() * self.rectangles.len() as f32)
    }

    /// Radiance of all emitters that a surface reflects once toward the viewer, by samples of the emitters.
    fn direct(
        &self,
        numbers: &Numbers,
        bounce: u32,
        surface: &Surface,
        shader: &Shader,
        rays: &mut u64,
    ) -> Rgb {
        let mut radiance = shading::reflect_lights(&self.lamps, surface, shader, |seen| {
            *rays += 1;
            surface.geometric.dot(seen.toward) > 0.0
                && !self.geometry.occluded(surface, seen.toward, seen.distance)
        });
        if let Some(environment) = &self.environment {
            let arriving = environment.sample(numbers.at(bounce, purpose::ENVIRONMENT));
            radiance += self.reflected(surface, shader, &arriving, f32::INFINITY, rays);
        }
        if !self.rectangles.is_empty() {
            let [r, s] = numbers.at(bounce, purpose::RECTANGLE);
            let place = r * self.rectangles.len() as f32;
            let (centre, edges, emission) = self.rectangles[place as usize];
            if let Some(seen) = rectangle::Seen::new(centre, edges, surface.position) {
                let to = seen.sample([place.fract(), s]);
                let distance = to.length();
                let (direction, density) = (to / distance, self.density_of(&seen));
                let arriving = Arriving { direction, radiance: emission, density };
                radiance += self.reflected(surface, shader, &arriving, distance, rays);
            }
        }
        radiance
    }

    /// The weighted share f L cosθ / p of a sample of an emitter at some distance.
    fn reflected(
        &self,
        surface: &Surface,
        shader: &Shader,
        arriving: &Arriving,
        distance: f32,
        rays: &mut u64,
    ) -> Rgb {
        let wi = surface.to_local(arriving.direction);
        if wi.z <= 0.0 || surface.geometric.dot(arriving.direction) <= 0.0 {
            return Rgb::ZERO;
        }
        let (reflectance, density) = shader.eval_and_density(wi);
        let weight = power_heuristic(arriving.density, density) * wi.z / arriving.density;
        let share = reflectance * arriving.radiance * weight;
        if share == Rgb::ZERO {
            return Rgb::ZERO;
        }
        *rays += 1;
        if self.geometry.occluded(surface, arriving.direction, distance) { Rgb::ZERO } else { share }
    }
}

/// p² / (p² + q²), by the ratio so that the squares stay in range.
fn power_heuristic(p: f32, q: f32) -> f32 {
    let ratio = q / p;
    1.0 / (1.0 + ratio * ratio)
}
