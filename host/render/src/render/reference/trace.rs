//! Paths: emitted light found by the lobes' own samples and by samples of the emitters, joined by the power heuristic
//! (Veach and Guibas 1995); lights without extent by shadow rays; Russian roulette; several branches from the first surface, see
//! [`super::branches`].

use glam::Vec3;

use super::environment::{Arriving, Sampled};
use super::lobes;
use super::rectangle::{Rectangle, Seen};
use crate::render::geometry::{Geometry, Surface};
use crate::render::materials::{Materials, Shader};
use crate::render::sampler;
use crate::render::shading;
use crate::render::stage::Changes;
use crate::scene::{Light, Scene};
use lobelia_gpu::lights::Lamp;
use lobelia_reflectance::Rgb;

/// Throughput below which roulette decides whether a path goes on: light that takes many bounces is where much of the
/// noise is, so that paths are better kept than ended as soon as they carry less than the first.
const ROULETTE_BELOW: f32 = 1.0 / 3.0;
/// Probability at most with which a path goes on, however much it carries.
const MOST_SURVIVAL: f32 = 0.95;

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

/// What is told apart of a path: light that its first surface reflects, found by samples of emitters, and all that the rays that leave
/// that surface find.
pub(super) const PARTS: usize = 2;

/// What one sample of a pixel found.
pub(super) struct Traced {
    /// Radiance along the camera ray, by part.
    pub(super) parts: [Rgb; PARTS],
    /// 1 where the ray meets an object.
    pub(super) coverage: f32,
}

impl Traced {
    /// A ray that ends where radiance comes from.
    fn ended(radiance: Rgb, coverage: f32) -> Self {
        Self { parts: [radiance, Rgb::ZERO], coverage }
    }
}

/// Reflectances of the first surface and of those that follow, kept to save their allocations.
pub(super) struct Shaders {
    first: Shader,
    next: Shader,
}

impl Shaders {
    pub(super) fn new() -> Self {
        Self { first: Shader::new(), next: Shader::new() }
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
pub(super) struct Tracer {
    scene: Scene,
    geometry: Geometry,
    materials: Materials,
    environment: Option<Sampled>,
    /// Lights without extent.
    lamps: Vec<Lamp>,
    rectangles: Vec<(Rectangle, Rgb)>,
    /// Reflections at most.
    bounces: u32,
}

impl Tracer {
    /// Builds the tree and the tables.
    pub(super) fn new(scene: &Scene, bounces: u32) -> Self {
        let (lamps, rectangles) = emitters(scene);
        Self {
            geometry: Geometry::new(scene),
            materials: Materials::new(scene),
            environment: scene.environment.as_ref().and_then(Sampled::new),
            lamps,
            rectangles,
            bounces,
            scene: scene.clone(),
        }
    }

    /// Goes on to another state of the same scene, of which it redoes what differs.
    pub(super) fn follow(&mut self, scene: &Scene, changes: Changes) {
        if changes.triangles {
            self.geometry = Geometry::new(scene);
        }
        if changes.lights {
            self.materials.relight(scene);
            (self.lamps, self.rectangles) = emitters(scene);
        }
        if let (Some(sampled), Some(environment)) = (&mut self.environment, &scene.environment) {
            sampled.turn(environment.rotation);
        }
        self.scene = scene.clone();
    }

    /// Bytes held for the scene.
    pub(super) fn bytes(&self) -> usize {
        self.geometry.bytes() + self.materials.bytes() + self.environment.as_ref().map_or(0, Sampled::bytes)
    }

    /// Follows a camera ray, and `branches` rays from the surface it meets; counts rays by part.
    pub(super) fn path(
        &self,
        numbers: &Numbers,
        (origin, direction): (Vec3, Vec3),
        branches: u32,
        shaders: &mut Shaders,
        rays: &mut [u64; PARTS],
    ) -> Traced {
        rays[0] += 1;
        let Some(hit) = self.geometry.nearest(origin, direction) else {
            return Traced::ended(shading::background(&self.scene, direction), 0.0);
        };
        let object = self.geometry.object(&hit);
        if let Some(emission) = self.materials.emission(object) {
            let shines = self.geometry.front(&hit, direction);
            return Traced::ended(if shines { emission } else { Rgb::ZERO }, 1.0);
        }
        let surface = self.geometry.surface(&hit, direction);
        let Shaders { first, next } = shaders;
        self.aim(numbers, 0, &surface, direction, first);
        let direct = self.direct(numbers, 0, &surface, first, &mut rays[0]);
        let mut rest = Rgb::ZERO;
        for branch in 0..branches {
            let numbers = Numbers { pixel: numbers.pixel, index: numbers.index * branches + branch };
            rest += self.continued(&numbers, surface, first, next, &mut rays[1]);
        }
        Traced { parts: [direct, rest / branches as f32], coverage: 1.0 }
    }

    /// Makes the reflectance of a surface ready, as the end of a ray sees it.
    fn aim(&self, numbers: &Numbers, bounce: u32, surface: &Surface, direction: Vec3, shader: &mut Shader) {
        let texel = self.materials.only(surface.object).unwrap_or_else(|| {
            self.materials.choose(surface.object, surface.uv, numbers.at(bounce, purpose::TEXEL))
        });
        shader.aim(&self.materials, texel, surface.to_local(-direction), true);
    }

    /// Radiance that a surface reflects toward the viewer whom `first` is aimed at, but for what [`Self::direct`] finds.
    fn continued(
        &self,
        numbers: &Numbers,
        mut surface: Surface,
        first: &Shader,
        next: &mut Shader,
        rays: &mut u64,
    ) -> Rgb {
        let (mut radiance, mut throughput) = (Rgb::ZERO, Rgb::ONE);
        for bounce in 0..self.bounces {
            let shader = if bounce == 0 { first } else { &*next };
            // The first bounce of a diffuse surface has nothing to choose.
            let diffuse = shader.lobes.is_empty() && shader.microfacets.is_empty();
            let chooses = bounce > 0 || !diffuse;
            let [choice, roulette] = if chooses { numbers.at(bounce, purpose::CHOICE) } else { [0.0; 2] };
            let wi = lobes::sample(shader, choice, numbers.at(bounce, purpose::LOBE));
            let direction = surface.to_world(wi);
            if wi.z <= 0.0 || surface.geometric.dot(direction) <= 0.0 {
                break;
            }
            let (reflectance, density) = shader.eval_and_density(wi);
            throughput *= reflectance * (wi.z / density);
            if bounce > 0 {
                let survival = (throughput.max_element() / ROULETTE_BELOW).min(MOST_SURVIVAL);
                if roulette >= survival {
                    break;
                }
                throughput /= survival;
            }
            let drawn = Drawn { density, from: surface.position };
            let origin = self.geometry.leaving(&surface);
            *rays += 1;
            let Some(hit) = self.geometry.nearest(origin, direction) else {
                radiance += throughput * self.beyond(direction, &drawn);
                break;
            };
            let object = self.geometry.object(&hit);
            if let Some(emission) = self.materials.emission(object) {
                if self.geometry.front(&hit, direction) {
                    radiance += throughput * emission * self.weight_of_rectangle(object, &drawn);
                }
                break;
            }
            if bounce + 1 == self.bounces {
                break;
            }
            surface = self.geometry.surface(&hit, direction);
            self.aim(numbers, bounce + 1, &surface, direction, next);
            radiance += throughput * self.direct(numbers, bounce + 1, &surface, next, rays);
        }
        radiance
    }

    /// What a ray that meets nothing brings.
    fn beyond(&self, direction: Vec3, drawn: &Drawn) -> Rgb {
        self.environment.as_ref().map_or(Rgb::ZERO, |environment| {
            let arriving = environment.arriving(direction);
            arriving.radiance * power_heuristic(drawn.density, arriving.density)
        })
    }

    /// The weight of a rectangular light that a ray has met.
    fn weight_of_rectangle(&self, object: u32, drawn: &Drawn) -> f32 {
        let (light, _) = &self.rectangles[object as usize - self.scene.objects.len()];
        light.seen(drawn.from).map_or(1.0, |seen| power_heuristic(drawn.density, self.density_of(&seen)))
    }

    /// Density with which a rectangle's directions are drawn: one rectangle of all, evenly over its solid angle.
    fn density_of(&self, seen: &Seen<'_>) -> f32 {
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
        let mut radiance = shading::reflect_lights(&self.lamps, 1, 0, surface, shader, |seen| {
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
            let (light, emission) = &self.rectangles[place as usize];
            if let Some(seen) = light.seen(surface.position) {
                let to = seen.sample([place.fract(), s]);
                let distance = to.length();
                let (direction, density) = (to / distance, self.density_of(&seen));
                let arriving = Arriving { direction, radiance: *emission, density };
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

/// A scene's lights without extent, and its rectangles.
fn emitters(scene: &Scene) -> (Vec<Lamp>, Vec<(Rectangle, Rgb)>) {
    let is_rectangle = |light: &Light| matches!(light, Light::Rectangle { .. });
    let points: Vec<Light> = scene.lights.iter().filter(|light| !is_rectangle(light)).copied().collect();
    let rectangles = scene.lights.iter().filter_map(|light| match *light {
        Light::Rectangle { centre, edges, radiance } => Some((Rectangle::new(centre, edges), radiance)),
        _ => None,
    });
    (shading::lamps(&points), rectangles.collect())
}

/// p² / (p² + q²), by the ratio so that the squares stay in range.
fn power_heuristic(p: f32, q: f32) -> f32 {
    let ratio = q / p;
    1.0 / (1.0 + ratio * ratio)
}
