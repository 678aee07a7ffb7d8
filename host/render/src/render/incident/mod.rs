//! The `incident` renderer: near lights by samples of incident radiance. Light that falls on a surface from
//! nearby differs from place to place; it is sampled in spherical harmonics where the surface needs it
//! (module `samples`), blended to every vertex, as it is foretold to err (module `second_order`), and
//! multiplied with the transfer that was baked (module `transfer`):
//!
//! L(p) = ρ_d(p) Σ_i t_i(p) l_i(p).
//!
//! Diffuse, direct light of emitters that stand beside the objects, not among them: an object hides an
//! emitter whether it is before or behind it. A change of the light takes samples; a change of the view draws
//! alone. Without emitters an environment is one sample for all, which turns with it.

mod baking;
mod distant;
mod emitters;
mod ground;
mod harmonics;
mod polygon;
mod published;
mod samples;
mod second_order;
mod study;
#[cfg(test)]
mod tests;
mod transfer;
mod tree;

use std::time::Instant;

use glam::{Vec3, Vec4};
use rayon::prelude::*;

pub use published::Oracle;
pub use study::{Outcome, Sampling, Study};

use super::bake::{Bake, Baked, MadeOf};
use super::geometry::Geometry;
use super::materials::Materials;
use super::sampler::{self, hash};
use super::shading::{self, Rays};
use super::stage::Stage;
use super::{Cost, Player, Renderer, Rendering, Variant, methods};
use crate::scene::{Camera, Light, Scene, State};
use distant::Distant;
use emitters::Emitter;
use ground::Ground;
use lobelia_base::error::{Error, Result};
use lobelia_reflectance::Rgb;
use lobelia_reflectance::picture::Picture;
use transfer::Receivers;
use tree::Tree;

/// How to bake, to sample and to draw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Degree of the spherical harmonics, 1 to 8.
    pub degree: u32,
    /// Directions over the sphere, of which a vertex casts rays in the half above it.
    pub rays: u32,
    /// Error that samples may make at a vertex, over the root mean square of the vertices' radiance.
    pub epsilon: f64,
    /// Samples of incident radiance at most.
    pub most_samples: u32,
    /// Samples a pixel, for edges and textures; powers of two are spread best.
    pub samples: u32,
    /// Seed of the pixels' samples.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { degree: 8, rays: 4096, epsilon: 0.01, most_samples: 20_000, samples: 16, seed: 0 }
    }
}

impl Settings {
    /// What is wrong with them.
    fn check(&self) -> Result<()> {
        let Self { degree, rays, epsilon, most_samples, samples, .. } = *self;
        if !(1..=harmonics::MOST as u32).contains(&degree) {
            return Err(Error::input(format!("the degree is {degree}; use 1 to {}", harmonics::MOST)));
        }
        if rays < 64 || samples == 0 || most_samples == 0 {
            return Err(Error::input("rays must be 64 or more, samples 1 or more"));
        }
        if !(epsilon.is_finite() && epsilon > 0.0) {
            return Err(Error::input(format!("epsilon is {epsilon}; use a positive number")));
        }
        Ok(())
    }
}

/// What of a scene this method cannot draw.
pub(super) fn cannot_draw(scene: &Scene) -> Vec<String> {
    let any = |is: fn(&Light) -> bool| scene.lights.iter().any(is);
    let glossy = |brdf: lobelia_reflectance::LobeBrdf| {
        let lobes = brdf.lobes.iter().any(|lobe| lobe.rho_s != Rgb::ZERO);
        lobes || brdf.microfacets.iter().any(|coat| coat.f0 != Rgb::ZERO || coat.f90 != Rgb::ZERO)
    };
    let all = [
        (any(|light| matches!(light, Light::Directional { .. })), "directional lights"),
        (any(|light| matches!(light, Light::Point { .. })), "point lights"),
        (
            scene.environment.is_some() && any(|light| matches!(light, Light::Rectangle { .. })),
            "an environment beside rectangular lights, which hide it",
        ),
        (
            scene.objects.iter().any(|object| object.material.brdfs().any(glossy)),
            "materials that are not diffuse alone",
        ),
    ];
    let named = all.into_iter().filter(|(is, _)| *is).map(|(_, what)| what.to_owned());
    named.chain(scene.beyond_lobes()).collect()
}

/// The settings given, weighed: others would be baked, or sampled, for a chart of their own.
pub(super) fn variants(scene: &Scene, base: &Settings) -> Vec<Variant> {
    if !cannot_draw(scene).is_empty() {
        return Vec::new();
    }
    let name = format!("degree {}, ε {}", base.degree, base.epsilon);
    vec![Variant { series: "incident", name, weighed: true, renderer: Box::new(*base) }]
}

impl Renderer for Settings {
    fn name(&self) -> &'static str {
        "incident"
    }

    fn made_of(&self, scene: &Scene) -> Result<Option<MadeOf>> {
        baking::made_of(self, scene).map(Some)
    }

    fn bake<'a>(&'a self, scene: &'a Scene) -> Result<Option<Box<dyn Bake + 'a>>> {
        baking::work(self, scene).map(Some)
    }

    fn expected_bake_seconds(&self, scene: &Scene) -> Option<f64> {
        Some(baking::expected_seconds(self, scene))
    }

    fn open(&self, scene: &Scene, baked: &Baked) -> Result<Box<dyn Player>> {
        scene.check()?;
        self.check()?;
        methods::check(self, scene)?;
        let start = Instant::now();
        let stage = Stage::new(scene)?;
        let receivers = Receivers::new(&stage.now);
        let transfers = baking::transfers(baked, receivers.len(), self.degree as usize)?;
        let tree = Tree::new(&receivers.positions);
        let environment = stage.now.environment.as_ref();
        let distant = environment.map(|environment| Distant::new(environment, self.degree as usize));
        let mut playing = Playing {
            objects: Geometry::new(&Scene { lights: Vec::new(), ..stage.now.clone() }),
            lights: lit(&stage.now),
            materials: Materials::new(&stage.now),
            given: stage.now.clone(),
            settings: *self,
            stage,
            receivers,
            transfers,
            tree,
            distant,
            light: None,
            cost: Cost {
                bake_seconds: baked.seconds,
                bake_rays: baked.rays,
                baked_bytes: baked.bytes,
                ..Cost::default()
            },
        };
        playing.cost.prepare_seconds = start.elapsed().as_secs_f64();
        Ok(Box::new(playing))
    }
}

/// The rectangles of a scene, as rays meet them.
fn lit(scene: &Scene) -> Geometry {
    Geometry::new(&Scene { objects: Vec::new(), ..scene.clone() })
}

/// What a state of the lights comes to.
struct Lit {
    irradiance: Vec<Vec3>,
    bytes: usize,
    note: Option<String>,
}

/// A scene with its transfer.
struct Playing {
    stage: Stage,
    /// As it was baked.
    given: Scene,
    settings: Settings,
    objects: Geometry,
    lights: Geometry,
    materials: Materials,
    receivers: Receivers,
    transfers: Vec<f32>,
    tree: Tree,
    distant: Option<Distant>,
    /// Of the state of the last frame.
    light: Option<Lit>,
    /// What it took to be made ready.
    cost: Cost,
}

impl Player for Playing {
    fn frame(&mut self, state: &State) -> Result<Rendering> {
        let start = Instant::now();
        let changes = self.stage.go(state)?;
        let scene = &self.stage.now;
        let moved = scene.objects.iter().zip(&self.given.objects).find(|(a, b)| a.transform != b.transform);
        if let Some((object, _)) = moved {
            let message = "it is moved, and `incident` bakes what objects hide; use --method reference";
            return Err(Error::input(message).at(format!("object \"{}\"", object.name)));
        }
        if changes.triangles {
            self.lights = lit(scene);
        }
        if changes.lights {
            self.materials.relight(scene);
        }
        if changes.lights || changes.turn {
            self.light = None;
        }
        let first = self.light.is_none();
        let light = match self.light.take() {
            Some(light) => light,
            None => self.sampled(),
        };
        let light_seconds = if first { start.elapsed().as_secs_f64() } else { 0.0 };
        let mut rendering = self.draw(&state.camera, &light);
        self.light = Some(light);
        rendering.cost.light_seconds = light_seconds;
        let steps = [(changes.lights, "lights"), (changes.turn, "turn")];
        rendering.redone = steps.into_iter().filter(|(is, _)| *is).map(|(_, step)| step).collect();
        Ok(rendering)
    }
}

impl Playing {
    /// Samples incident radiance in the state it is in.
    fn sampled(&self) -> Lit {
        let Settings { degree, epsilon, most_samples, .. } = self.settings;
        let (receivers, tree, transfers) = (&self.receivers, &self.tree, &self.transfers[..]);
        let ground = Ground { receivers, tree, transfers, degree: degree as usize };
        let emitters = emitters::of_lights(&self.stage.now.lights);
        let samples = second_order::place(&ground, &emitters, epsilon, most_samples as usize);
        let mut notes = Vec::new();
        if samples.capped {
            notes.push(format!("{} samples of incident radiance do not meet epsilon", samples.taken));
        }
        notes.extend(self.among(&emitters));
        let mut irradiance = samples.irradiance(&ground);
        if let (Some(distant), Some(environment)) = (&self.distant, &self.stage.now.environment) {
            distant.add(environment.rotation, &ground, &mut irradiance);
        }
        Lit { irradiance, bytes: samples.bytes(), note: (!notes.is_empty()).then(|| notes.join("; ")) }
    }

    /// Tells of emitters with objects behind them, which hide them as if they were in front.
    fn among(&self, emitters: &[Emitter]) -> Option<String> {
        let count = self.receivers.len();
        let (mut wrong, mut all) = (0usize, 0usize);
        for k in (0..64usize.min(count)).map(|k| self.tree.order[k * count / 64.min(count)] as usize) {
            let (position, normal) = (self.receivers.positions[k], self.receivers.normals[k]);
            let origin = position + normal * self.receivers.offset;
            for emitter in emitters.iter().filter(|emitter| emitter.shines_to(position.as_dvec3())) {
                let middle = emitter.middle().as_vec3();
                for place in
                    emitter.corners.iter().map(|corner| corner.as_vec3().lerp(middle, 0.1)).chain([middle])
                {
                    let to = place - origin;
                    let distance = to.length();
                    if to.dot(normal) <= 0.0 || distance == 0.0 {
                        continue;
                    }
                    all += 1;
                    let hit = self.objects.nearest_at(origin, to / distance);
                    wrong += usize::from(hit.is_some_and(|(_, at)| at > distance));
                }
            }
        }
        (wrong > 0).then(|| {
            format!(
                "lights stand among the objects: {:.0} % of the light is taken for hidden by what is behind \
                 it; use --method reference",
                (100.0 * wrong as f64 / all as f64).max(1.0)
            )
        })
    }

    /// Radiance along a camera ray, and coverage.
    fn shade(&self, [origin, direction]: [Vec3; 2], choice: [f32; 2], light: &Lit) -> Vec4 {
        let hit = self.objects.nearest_at(origin, direction);
        let lamp = self.lights.nearest_at(origin, direction);
        let beyond = |distance: f32| hit.as_ref().is_none_or(|(_, at)| distance < *at);
        if let Some((lamp, _)) = lamp.filter(|&(_, distance)| beyond(distance)) {
            let index = self.receivers.backs.len() as u32 + self.lights.object(&lamp);
            let emission = self.materials.emission(index).unwrap_or(Rgb::ZERO);
            let shines = self.lights.front(&lamp, direction);
            return if shines { emission } else { Rgb::ZERO }.extend(1.0);
        }
        let Some((hit, _)) = hit else {
            return shading::background(&self.stage.now, direction).extend(0.0);
        };
        let surface = self.objects.surface(&hit, direction);
        let (vertices, weights) = self.objects.blend_of(&hit);
        let sum = |of: &dyn Fn(usize) -> Vec3| -> Vec3 {
            vertices.iter().zip(weights).map(|(&vertex, weight)| of(vertex as usize) * weight).sum()
        };
        let normal = sum(&|vertex| self.receivers.normals[vertex]);
        // Of a closed mesh the inside is not lit from outside.
        let back = normal.dot(surface.geometric) < 0.0;
        let irradiance = match (back, self.receivers.backs[surface.object as usize]) {
            (false, _) => sum(&|vertex| light.irradiance[vertex]),
            (true, Some(beyond)) => sum(&|vertex| light.irradiance[vertex + beyond]),
            (true, None) => Vec3::ZERO,
        };
        let texel = self.materials.choose(surface.object, surface.uv, choice);
        (self.materials.rho_d(texel) * irradiance.max(Vec3::ZERO)).extend(1.0)
    }

    /// Draws a view of the state it is in.
    fn draw(&self, camera: &Camera, light: &Lit) -> Rendering {
        let start = Instant::now();
        let (width, height) = (camera.width as usize, camera.height as usize);
        let (rays, samples) = (Rays::new(camera), self.settings.samples);
        let mut pixels = vec![Vec4::ZERO; width * height];
        pixels.par_iter_mut().enumerate().for_each(|(index, pixel)| {
            let seed = hash(self.settings.seed as u32 ^ hash(index as u32));
            for sample in 0..samples {
                let [x, y] = sampler::point(seed, sample, 0);
                let direction = rays.direction((index % width) as f32 + x, (index / width) as f32 + y);
                *pixel += self.shade([rays.origin, direction], sampler::point(seed, sample, 1), light);
            }
            *pixel /= samples as f32;
        });
        let memory = self.objects.bytes()
            + self.lights.bytes()
            + self.materials.bytes()
            + self.tree.bytes()
            + size_of_val(&self.transfers[..])
            + size_of_val(&light.irradiance[..])
            + light.bytes
            + size_of_val(&pixels[..]);
        let cost = Cost {
            render_seconds: start.elapsed().as_secs_f64(),
            memory_bytes: memory as u64,
            samples,
            rays: pixels.len() as u64 * u64::from(samples),
            ..self.cost
        };
        Rendering {
            picture: Picture { width, height, pixels },
            variance: None,
            cost,
            redone: Vec::new(),
            adapter: None,
            note: light.note.clone(),
        }
    }
}
