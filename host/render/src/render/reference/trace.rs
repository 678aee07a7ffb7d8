//! Paths: emitted light found by the lobes' own samples and by samples of the emitters, joined by the power
//! heuristic (Veach and Guibas 1995); lights without extent by shadow rays; mirrors, metal and glass by the
//! one direction that they have ([`super::interface`]); Russian roulette; several branches from the first
//! surface, see [`super::branches`].

use glam::Vec3;

use super::emitters::Emitters;
use super::environment::{Arriving, Sampled};
use super::interface::Aimed;
use super::media::{Inside, Media};
use super::scatter::{Drawn, Leg, Start};
use super::shining::Shining;
use super::tally::Tally;
use crate::render::bvh::Hit;
use crate::render::geometry::{Geometry, Surface};
use crate::render::materials::Materials;
use crate::render::sampler;
use crate::render::shading;
use crate::render::stage::Changes;
use crate::scene::{Light, Optics, Scene};
use lobelia_gpu::lights::Lamp;
use lobelia_reflectance::Rgb;

/// Surfaces within bodies of higher priority that a ray passes at most between two that are there.
const MOST_HIDDEN: usize = 64;

/// What the numbers of a path's bounce are for.
pub(super) mod purpose {
    pub(in super::super) const TEXEL: u32 = 0;
    pub(in super::super) const ENVIRONMENT: u32 = 1;
    pub(in super::super) const RECTANGLE: u32 = 2;
    pub(in super::super) const LOBE: u32 = 3;
    /// Which lobe, and roulette.
    pub(in super::super) const CHOICE: u32 = 4;
    pub(in super::super) const COUNT: u32 = 5;
    /// What a surface with a direction of its own does; beyond the numbers of all bounces.
    pub(in super::super) const OPTICS: u32 = 1 << 20;
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

    pub(super) fn at(&self, bounce: u32, purpose: u32) -> [f32; 2] {
        sampler::point(self.pixel, self.index, 1 + bounce * purpose::COUNT + purpose)
    }

    pub(super) fn optics(&self, bounce: u32) -> [f32; 2] {
        sampler::point(self.pixel, self.index, purpose::OPTICS + bounce)
    }

    /// Numbers of their own for a ray that is followed beside another.
    fn beside(&self, bounce: u32) -> Self {
        Self { pixel: sampler::hash(self.pixel ^ sampler::hash(bounce ^ 0x5137_a2c1)), index: self.index }
    }
}

/// What is told apart of a path: light that its first surface reflects, found by samples of emitters, and all
/// that the rays that leave that surface find.
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
    first: Aimed,
    next: Aimed,
}

impl Shaders {
    pub(super) fn new() -> Self {
        Self { first: Aimed::new(), next: Aimed::new() }
    }
}

/// A scene made ready.
pub(super) struct Tracer {
    pub(super) scene: Scene,
    pub(super) geometry: Geometry,
    pub(super) materials: Materials,
    environment: Option<Sampled>,
    /// Lights without extent.
    pub(super) lamps: Vec<Lamp>,
    pub(super) emitters: Emitters,
    shining: Shining,
    pub(super) media: Media,
    /// What is beyond lobes, by object.
    pub(super) optics: Vec<Option<Optics>>,
    /// Whether an object is more than lobes.
    pub(super) special: bool,
    /// Reflections at most.
    pub(super) bounces: u32,
    /// Dielectrics in a row from the first surface on at which both rays are followed.
    tree: u32,
}

impl Tracer {
    /// Builds the trees and the tables.
    pub(super) fn new(scene: &Scene, bounces: u32, tree: u32) -> Self {
        let geometry = Geometry::new(scene);
        let (emitters, shining) = Shining::new(scene, &geometry);
        Self {
            materials: Materials::new(scene),
            environment: scene.environment.as_ref().and_then(Sampled::new),
            lamps: lamps(scene),
            emitters,
            shining,
            media: Media::new(scene),
            optics: scene.objects.iter().map(|object| object.material.optics.clone()).collect(),
            special: scene.beyond_lobes().is_some(),
            geometry,
            bounces,
            tree,
            scene: scene.clone(),
        }
    }

    /// Goes on to another state of the same scene, of which it redoes what differs.
    pub(super) fn go_to(&mut self, scene: &Scene, changes: Changes) {
        if changes.triangles {
            self.geometry = Geometry::new(scene);
        }
        if changes.lights {
            self.materials.relight(scene);
            self.lamps = lamps(scene);
        }
        if changes.triangles || changes.lights {
            (self.emitters, self.shining) = Shining::new(scene, &self.geometry);
        }
        if let (Some(sampled), Some(environment)) = (&mut self.environment, &scene.environment) {
            sampled.turn(environment.rotation);
        }
        self.scene = scene.clone();
    }

    /// Light that no path finds, where the scene has any: what lights without extent send by way of a surface
    /// with a direction of its own.
    pub(super) fn unsampled(&self) -> Option<String> {
        let light = (self.scene.lights.iter())
            .position(|light| matches!(light, Light::Point { .. } | Light::Directional { .. }))?;
        let object = self.scene.objects.iter().find_map(|object| match &object.material.optics {
            None | Some(Optics::AshikhminShirley(_)) => None,
            Some(optics) => Some((&object.name, optics.name())),
        });
        let (name, what) = object?;
        Some(format!(
            "light {light} has no extent: what it sends by way of object \"{name}\", {what}, to other \
             surfaces is not in the picture; a rectangular light or a mesh that shines can be sampled"
        ))
    }

    /// Bytes held for the scene.
    pub(super) fn bytes(&self) -> usize {
        self.geometry.bytes()
            + self.materials.bytes()
            + self.environment.as_ref().map_or(0, Sampled::bytes)
            + self.emitters.bytes()
            + self.shining.bytes()
    }

    /// The transparent bodies that a point is in: those whose next surface along a ray is met from behind.
    pub(super) fn inside(&self, point: Vec3) -> Inside {
        let (mut inside, mut met) = (Inside::default(), Vec::new());
        if !self.media.any {
            return inside;
        }
        let (mut origin, direction) = (point, Vec3::new(0.267_261, 0.801_784, 0.534_522));
        while let Some(hit) = self.geometry.nearest(origin, direction) {
            let object = self.geometry.object(&hit);
            if self.media.of(object).is_some() && !met.contains(&object) {
                met.push(object);
                if !self.geometry.front(&hit, direction) {
                    inside = inside.across(object, true);
                }
            }
            let next = self.geometry.beyond(&self.geometry.surface(&hit, direction));
            if (next - origin).dot(direction) <= 0.0 {
                break;
            }
            origin = next;
        }
        inside
    }

    /// The first surface along a camera ray.
    pub(super) fn shown(&self, mut origin: Vec3, direction: Vec3, mut inside: Inside) -> Option<Surface> {
        let (hit, ..) = self.arrive(&mut origin, direction, &mut inside, &mut 0);
        Some(self.geometry.surface(&hit?, direction))
    }

    /// Follows a camera ray, and `branches` rays from the surface it meets; counts rays by part.
    pub(super) fn path(
        &self,
        numbers: &Numbers,
        (mut origin, direction, mut inside): (Vec3, Vec3, Inside),
        branches: u32,
        shaders: &mut Shaders,
        tally: &mut impl Tally,
        rays: &mut [u64; PARTS],
    ) -> Traced {
        let (hit, through, _) = self.arrive(&mut origin, direction, &mut inside, &mut rays[0]);
        let Some(hit) = hit else {
            let seen = through * shading::background(&self.scene, direction);
            tally.add(0, seen, Rgb::ZERO);
            return Traced::ended(seen, 0.0);
        };
        let object = self.geometry.object(&hit);
        tally.meets(object);
        if let Some(emission) = self.materials.emission(object) {
            let shines = self.geometry.front(&hit, direction);
            let seen = if shines { through * emission } else { Rgb::ZERO };
            tally.add(0, seen, Rgb::ZERO);
            return Traced::ended(seen, 1.0);
        }
        let surface = self.geometry.surface(&hit, direction);
        let Shaders { first, next } = shaders;
        self.aim(numbers, 0, &surface, direction, first);
        let [mut direct, diffuse] = self.direct(numbers, 0, &surface, first, &inside, tally, &mut rays[0]);
        if self.special {
            direct *= through;
        }
        tally.first(direct, diffuse * through);
        if let Some(emission) = self.shining.emission(&surface, self.geometry.front(&hit, direction)) {
            tally.add(0, through * emission, Rgb::ZERO);
            direct += through * emission;
        }
        let mut rest = Rgb::ZERO;
        for branch in 0..branches {
            let numbers = Numbers { pixel: numbers.pixel, index: numbers.index * branches + branch };
            let start = Start { hit, surface, inside, throughput: through, diffuse: None, tree: self.tree };
            for leg in self.leave(&numbers, 0, &start, first).into_iter().flatten() {
                rest += self.follow(&numbers, leg, 0, next, tally, &mut rays[1]);
            }
        }
        Traced { parts: [direct, rest / branches as f32], coverage: 1.0 }
    }

    /// The next surface that is there along a ray, what is left of radiance from it, and whether others were
    /// passed; the ray then starts behind the last of these.
    fn arrive(
        &self,
        origin: &mut Vec3,
        direction: Vec3,
        inside: &mut Inside,
        rays: &mut u64,
    ) -> (Option<Hit>, Rgb, bool) {
        *rays += 1;
        let mut hit = self.geometry.nearest(*origin, direction);
        if !self.media.any {
            return (hit, Rgb::ONE, false);
        }
        let (mut through, mut passed) = (Rgb::ONE, false);
        for _ in 0..MOST_HIDDEN {
            let Some(met) = hit else {
                return (None, through * self.media.transmittance(inside, f32::INFINITY), passed);
            };
            let surface = self.geometry.surface(&met, direction);
            through *= self.media.transmittance(inside, surface.position.distance(*origin));
            if !self.media.hidden(inside, surface.object) {
                break;
            }
            *inside = inside.across(surface.object, self.geometry.front(&met, direction));
            *origin = self.geometry.beyond(&surface);
            *rays += 1;
            passed = true;
            hit = self.geometry.nearest(*origin, direction);
        }
        (hit, through, passed)
    }

    /// Radiance that a ray from the first surface, or from a later one, brings to the viewer.
    fn follow(
        &self,
        numbers: &Numbers,
        mut leg: Leg,
        from: u32,
        next: &mut Aimed,
        tally: &mut impl Tally,
        rays: &mut u64,
    ) -> Rgb {
        let mut radiance = Rgb::ZERO;
        for bounce in from..self.bounces {
            let Leg { direction, diffuse, mut inside, .. } = leg;
            let (hit, through, passed) = self.arrive(&mut leg.origin, direction, &mut inside, rays);
            if self.media.any {
                leg.throughput *= through;
            }
            if passed {
                // No sample of an emitter goes through what is passed.
                leg.drawn.density = f32::INFINITY;
            }
            let Leg { throughput, drawn, .. } = leg;
            let mut found = |reflections: u32, value: Rgb| {
                tally.add(reflections, value, diffuse);
                radiance += value;
            };
            let Some(hit) = hit else {
                found(bounce + 1, throughput * self.beyond(direction, &drawn));
                break;
            };
            let object = self.geometry.object(&hit);
            if let Some(emission) = self.materials.emission(object) {
                if self.geometry.front(&hit, direction) {
                    let emitter = self.shining.rectangle(object);
                    let weight = self.weight_of_emitter(emitter, &drawn, || {
                        self.geometry.surface(&hit, direction).position
                    });
                    found(bounce + 1, throughput * emission * weight);
                }
                break;
            }
            let surface = self.geometry.surface(&hit, direction);
            if let Some(emission) = self.shining.emission(&surface, self.geometry.front(&hit, direction)) {
                let emitter = self.shining.triangle(hit.triangle);
                let weight = self.weight_of_emitter(emitter, &drawn, || surface.position);
                found(bounce + 1, throughput * emission * weight);
            }
            if bounce + 1 == self.bounces {
                break;
            }
            self.aim(numbers, bounce + 1, &surface, direction, next);
            let [direct, _] = self.direct(numbers, bounce + 1, &surface, next, &inside, &mut (), rays);
            found(bounce + 2, throughput * direct);
            let start = Start { hit, surface, inside, throughput, diffuse: Some(diffuse), tree: leg.tree };
            let [one, other] = self.leave(numbers, bounce + 1, &start, next);
            if let (Some(_), Some(other)) = (one, other) {
                let numbers = numbers.beside(bounce);
                radiance += self.follow(&numbers, other, bounce + 1, next, tally, rays);
            }
            let Some(going) = one.or(other) else { break };
            leg = going;
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

    /// The weight of an emitter that a ray has met at a place.
    fn weight_of_emitter(&self, emitter: Option<u32>, drawn: &Drawn, place: impl Fn() -> Vec3) -> f32 {
        let Some(emitter) = emitter.filter(|_| drawn.density.is_finite()) else { return 1.0 };
        let to = place() - drawn.from;
        let density = self.emitters.density(emitter, drawn.from, drawn.normal, to);
        density.map_or(1.0, |density| power_heuristic(drawn.density, density))
    }

    /// Radiance of all emitters that a surface reflects once toward the viewer, by samples of the emitters;
    /// and where the tally asks for it that of the diffuse term.
    #[expect(clippy::too_many_arguments, reason = "what a surface is lit by and seen in")]
    fn direct<T: Tally>(
        &self,
        numbers: &Numbers,
        bounce: u32,
        surface: &Surface,
        aimed: &Aimed,
        inside: &Inside,
        _tally: &mut T,
        rays: &mut u64,
    ) -> [Rgb; 2] {
        let mut found = [Rgb::ZERO; 2];
        if aimed.black {
            return found;
        }
        let shader = &aimed.shader;
        let mut diffuse = Rgb::ZERO;
        found[0] = shading::reflect_lights(&self.lamps, 1, 0, surface, shader, |seen| {
            *rays += 1;
            let visible = surface.geometric.dot(seen.toward) > 0.0
                && !self.geometry.occluded(surface, seen.toward, seen.distance);
            if T::SPLITS && visible {
                let wi = surface.to_local(seen.toward);
                diffuse += shader.eval_diffuse(wi) * seen.irradiance * wi.z;
            }
            visible
        });
        found[1] = diffuse;
        let mut add = |arriving: &Arriving, distance: f32| {
            let share = self.reflected(surface, aimed, inside, arriving, distance, rays);
            found[0] += share;
            if T::SPLITS && share != Rgb::ZERO {
                let wi = surface.to_local(arriving.direction);
                found[1] += share * part_of(shader.eval_diffuse(wi), shader.eval(wi));
            }
        };
        if let Some(environment) = &self.environment {
            add(&environment.sample(numbers.at(bounce, purpose::ENVIRONMENT)), f32::INFINITY);
        }
        if !self.emitters.emitters.is_empty() {
            let [r, s] = numbers.at(bounce, purpose::RECTANGLE);
            let (point, normal) = (surface.position, surface.frame[2]);
            if let Some(chosen) = self.emitters.choose(point, normal, r)
                && let Some((to, density)) = self.emitters.sample(chosen.emitter, point, [chosen.rest, s])
            {
                let distance = to.length();
                let direction = to / distance;
                let shape = &self.emitters.emitters[chosen.emitter as usize].shape;
                let radiance = self.shining.radiance(shape, &self.geometry, point + to);
                let density = density * chosen.probability;
                add(&Arriving { direction, radiance, density }, distance);
            }
        }
        found
    }

    /// The weighted share f L cosθ / p of a sample of an emitter at some distance.
    fn reflected(
        &self,
        surface: &Surface,
        aimed: &Aimed,
        inside: &Inside,
        arriving: &Arriving,
        distance: f32,
        rays: &mut u64,
    ) -> Rgb {
        let wi = surface.to_local(arriving.direction);
        if wi.z <= 0.0 || surface.geometric.dot(arriving.direction) <= 0.0 {
            return Rgb::ZERO;
        }
        let (reflectance, density) = aimed.shader.eval_and_density(wi);
        let density = density * aimed.keep;
        let weight = power_heuristic(arriving.density, density) * wi.z / arriving.density;
        let mut share = reflectance * arriving.radiance * weight;
        if self.media.any {
            share *= self.media.transmittance(inside, distance);
        }
        if share == Rgb::ZERO {
            return Rgb::ZERO;
        }
        *rays += 1;
        if self.geometry.occluded(surface, arriving.direction, distance) { Rgb::ZERO } else { share }
    }
}

/// A scene's lights without extent.
fn lamps(scene: &Scene) -> Vec<Lamp> {
    let is_rectangle = |light: &Light| matches!(light, Light::Rectangle { .. });
    let points: Vec<Light> = scene.lights.iter().filter(|light| !is_rectangle(light)).copied().collect();
    shading::lamps(&points)
}

/// A part over the whole by channel; 0 of nothing.
pub(super) fn part_of(part: Rgb, whole: Rgb) -> Rgb {
    let channel = |k: usize| if whole[k] != 0.0 { part[k] / whole[k] } else { 0.0 };
    Rgb::new(channel(0), channel(1), channel(2))
}

/// p² / (p² + q²), by the ratio so that the squares stay in range.
fn power_heuristic(p: f32, q: f32) -> f32 {
    let ratio = q / p;
    1.0 / (1.0 + ratio * ratio)
}
