//! The `environment` renderer: light from afar by prefiltered maps (6.13)–(6.18), for any number of lobes a
//! texel,
//!
//! L(ω_r) ≈ ρ_d D(N) + Σ_j ρ_s,j |p_j|^n_j S(p_j / |p_j|, n_j) H,  p_j = C'_j ω_r
//!
//! with H the cosine at the lobe's peak (6.18), or corrected for the horizon (module `horizon`). No shadows
//! and no interreflection of that light; microfacet terms by module `coats`. Lights are added as in `lights`.
//! On the CPU a ray is cast a sample; on the GPU the raster of `lights` draws, with shaders/environment.wgsl
//! for the light from afar.

mod accuracy;
mod baking;
mod coats;
mod gpu;
mod harmonics;
mod horizon;
mod prefilter;
pub mod quadrature;
mod raster;
pub(super) mod source;
mod spectrum;
#[cfg(test)]
mod tests;

use std::time::Instant;

use glam::{Vec3, Vec4};
use rayon::prelude::*;

pub use prefilter::Encoding;
pub use prefilter::Prefiltered;

use super::bake::{Bake, Baked, MadeOf};
use super::geometry::{Geometry, Surface};
use super::materials::{AimedMicrofacet, Materials, Shader};
use super::sampler::{self, hash};
use super::shading::{self, Rays};
use super::stage::Stage;
use super::{Cost, Player, Renderer, Rendering, Variant, lights, math, methods};
use crate::scene::{Camera, Environment, Scene, State};
use coats::{Coats, Part};
use harmonics::Harmonics;
use horizon::{Clipped, Horizon};
use lobelia_base::error::{Error, Result};
use lobelia_gpu::Gpu;
use lobelia_gpu::lights::Lamp;
use lobelia_reflectance::Rgb;
use lobelia_reflectance::picture::Picture;
use spectrum::Spectrum;

/// How to prefilter and to draw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// How exponents are encoded.
    pub encoding: Encoding,
    /// Relative error of the prefiltered maps, RMS over directions: their resolution and number follow from
    /// it.
    pub map_error: f32,
    /// Whether the GPU computes the maps and draws.
    pub gpu: bool,
    /// Whether lobes near the horizon are corrected.
    pub horizon: bool,
    /// Whether the diffuse term takes nine spherical harmonics instead of a map.
    pub harmonics: bool,
    /// Samples a pixel, for edges and textures; powers of two are spread best. The GPU takes 4 at edges,
    /// or 1.
    pub samples: u32,
    /// Seed of the CPU's samples.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            encoding: Encoding::Slices,
            map_error: 0.01,
            gpu: false,
            horizon: true,
            harmonics: false,
            samples: 16,
            seed: 0,
        }
    }
}

impl Settings {
    /// What is wrong with them.
    fn check(&self) -> Result<()> {
        if self.samples == 0 {
            return Err(Error::input("samples is 0; use 1 or more"));
        }
        check_error(self.map_error)
    }
}

impl Renderer for Settings {
    fn name(&self) -> &'static str {
        "environment"
    }

    fn made_of(&self, scene: &Scene) -> Result<Option<MadeOf>> {
        baking::made_of(self, scene)
    }

    fn bake<'a>(&'a self, scene: &'a Scene) -> Result<Option<Box<dyn Bake + 'a>>> {
        baking::work(self, scene)
    }

    fn open(&self, scene: &Scene, baked: &Baked) -> Result<Box<dyn Player>> {
        self.made_ready(scene, Some(baked))
    }

    /// As baked in memory and opened, but that materials are packed once and maps are not written out.
    fn prepare(&self, scene: &Scene) -> Result<Box<dyn Player>> {
        self.made_ready(scene, None)
    }
}

impl Settings {
    /// Makes a scene ready, with maps that were baked or that are made now.
    fn made_ready(&self, scene: &Scene, baked: Option<&Baked>) -> Result<Box<dyn Player>> {
        scene.check()?;
        methods::check(self, scene)?;
        self.check()?;
        let start = Instant::now();
        if self.gpu {
            return raster::prepare(scene, self, baked, start);
        }
        let stage = Stage::new(scene)?;
        let materials = Materials::new(&stage.now);
        let mut cost = Cost::default();
        let light = stage.now.environment.as_ref();
        let light =
            light.map(|environment| Light::new(environment, &materials, self, None, baked, &mut cost));
        let light = light.transpose()?;
        let mut playing = Playing {
            settings: *self,
            geometry: Geometry::new(&stage.now),
            lamps: shading::lamps(&stage.now.lights),
            stage,
            materials,
            light,
            cost,
        };
        playing.cost.prepare_seconds = prepare_seconds(start, baked, &cost);
        Ok(Box::new(playing))
    }
}

/// Seconds since a scene began to be made ready, but for maps that were made since.
fn prepare_seconds(start: Instant, baked: Option<&Baked>, cost: &Cost) -> f64 {
    let made = if baked.is_some() { 0.0 } else { cost.bake_seconds };
    (start.elapsed().as_secs_f64() - made).max(0.0)
}

/// Settings that trade time for error, all weighed.
pub(super) fn variants(scene: &Scene, base: &Settings) -> Vec<Variant> {
    if scene.environment.is_none() {
        return Vec::new();
    }
    let variants = [
        ("slices", *base),
        ("slices, on the GPU", Settings { gpu: true, ..*base }),
        ("slices, no horizon correction", Settings { horizon: false, ..*base }),
        ("MIP levels", Settings { encoding: Encoding::Mips, ..*base }),
        ("slices, spherical harmonics", Settings { harmonics: true, ..*base }),
    ];
    let of = |(name, settings): (&str, Settings)| Variant {
        series: "environment",
        name: name.into(),
        weighed: true,
        renderer: Box::new(settings),
    };
    variants.map(of).into()
}

/// The mean radiance under lobes of some exponents, ∫ (ω_p·ω)ⁿ L dω / ∫ (ω_p·ω)ⁿ dω, for peaks at the centres
/// of an equirectangular map's pixels; of `height` rows, or of as many as the error needs. A map is computed
/// when it is asked for.
///
/// # Errors
/// Input errors for an error out of range.
pub fn prefilter(
    environment: &Environment,
    exponents: &[f32],
    height: Option<usize>,
    error: f32,
) -> Result<impl Iterator<Item = Environment>> {
    check_error(error)?;
    let image = Environment { rotation: 0.0, ..environment.clone() };
    let rotation = environment.rotation;
    let spectrum = Spectrum::new(&image, exponents, error);
    Ok(exponents.iter().map(move |&n| {
        let height = height.unwrap_or_else(|| accuracy::map_height(n, error));
        let width = 2 * height;
        let polar: Vec<f64> =
            (0..height).map(|y| std::f64::consts::PI * (y as f64 + 0.5) / height as f64).collect();
        let mut pixels = spectrum.map(&spectrum::kernel(n, error), width, &polar);
        let even = (n + 1.0) / std::f32::consts::TAU;
        pixels.iter_mut().for_each(|pixel| *pixel *= even);
        Environment { width, height, pixels: pixels.into(), rotation }
    }))
}

/// Refuses an error that maps cannot be made for.
fn check_error(error: f32) -> Result<()> {
    if (1e-3..=0.3).contains(&error) {
        return Ok(());
    }
    Err(Error::input(format!("the error of prefiltered maps is {error}; use 0.001 to 0.3")))
}

/// An environment ready to shade by.
struct Light {
    maps: Prefiltered,
    harmonics: Option<Harmonics>,
    horizon: Option<&'static Horizon>,
    /// Where there are microfacet terms.
    coats: Option<&'static Coats>,
}

impl Light {
    /// Takes the maps that were baked, or prefilters an environment for the lobes of some materials, on the
    /// GPU when there is one in hardware; notes what the maps cost.
    ///
    /// # Errors
    /// Failures of the GPU, damage of what was baked.
    fn new(
        environment: &Environment,
        materials: &Materials,
        settings: &Settings,
        gpu: Option<&Gpu>,
        baked: Option<&Baked>,
        cost: &mut Cost,
    ) -> Result<Self> {
        let maps = match baked {
            Some(baked) => {
                (cost.bake_seconds, cost.bake_rays) = (baked.seconds, baked.rays);
                baking::maps(baked, environment.rotation)?
            }
            None => {
                let start = Instant::now();
                let Settings { encoding, map_error, .. } = *settings;
                let gpu = baking::in_hardware(gpu).map(gpu::Prefilter::new).transpose()?;
                let range = baking::range(materials, settings);
                let maps = Prefiltered::new(environment, range, encoding, map_error, gpu.as_ref())?;
                cost.bake_seconds = start.elapsed().as_secs_f64();
                maps
            }
        };
        cost.baked_bytes = maps.bytes() as u64;
        Ok(Self {
            maps,
            harmonics: settings.harmonics.then(|| Harmonics::new(environment)),
            horizon: settings.horizon.then(Horizon::table),
            coats: (!materials.microfacets.is_empty()).then(Coats::table),
        })
    }

    /// Turns to a rotation: maps and harmonics stand in the image's own frame, and a turn about +y is one of
    /// lookups.
    fn turn(&mut self, rotation: f32) {
        self.maps.rotation = rotation;
        if let Some(harmonics) = &mut self.harmonics {
            harmonics.rotation = rotation;
        }
    }

    /// Radiance of the environment that a surface reflects.
    fn reflected(&self, surface: &Surface, shader: &Shader) -> Rgb {
        let normal = surface.frame[2];
        let irradiance = match &self.harmonics {
            Some(harmonics) => harmonics.irradiance(normal),
            None => self.maps.irradiance(normal),
        };
        let mut radiance = shader.rho_d * irradiance;
        for lobe in &shader.lobes {
            let length = lobe.peak.length();
            let peak = lobe.peak / length;
            let Clipped { factor, turn, sharpness } = match self.horizon {
                Some(horizon) => horizon.at(peak.z, lobe.n),
                None => Clipped::at_peak(peak.z),
            };
            if factor > 0.0 {
                let n = self.maps.nearest((lobe.n + 1.0) * sharpness - 1.0);
                let light = self.maps.lobe(surface.to_world(turned(peak, turn)), n);
                let part = factor * (n + 1.0) / (lobe.n + 1.0);
                radiance += lobe.rho_s * light * (math::powf(length, lobe.n) * part);
            }
        }
        for AimedMicrofacet { coat, .. } in &shader.microfacets {
            let gathered = self.coats.unwrap_or_else(Coats::table).at(shader.wo.z, coat.alpha);
            let away = -shader.wo.truncate().normalize_or_zero();
            let light = gathered.lobes.map(|Part { share, angle, n }| {
                let (sin, cos) = angle.sin_cos();
                let n = self.maps.nearest(n);
                let even = (n + 1.0) / std::f32::consts::TAU;
                share * even * self.maps.lobe(surface.to_world((away * sin).extend(cos)), n)
            });
            let [f0, f90] = gathered.albedo;
            radiance += (coat.f0 * f0 + coat.f90 * f90) * (light[0] + light[1]);
        }
        radiance
    }
}

/// A direction turned towards +z.
fn turned(direction: Vec3, angle: f32) -> Vec3 {
    let flat = Vec3::new(direction.x, direction.y, 0.0);
    let length = flat.length();
    if length < 1e-6 {
        return direction;
    }
    let up = (Vec3::Z - direction * direction.z) / length;
    let (sin, cos) = angle.sin_cos();
    direction * cos + up * sin
}

/// A scene with its maps.
struct Playing {
    stage: Stage,
    settings: Settings,
    geometry: Geometry,
    materials: Materials,
    lamps: Vec<Lamp>,
    light: Option<Light>,
    /// What it took to be made ready.
    cost: Cost,
}

impl Playing {
    /// Radiance along a camera ray, and coverage.
    fn shade(
        &self,
        [origin, direction]: [Vec3; 2],
        choice: [f32; 2],
        seed: u32,
        shader: &mut Shader,
    ) -> Vec4 {
        let Some(hit) = self.geometry.nearest(origin, direction) else {
            return shading::background(&self.stage.now, direction).extend(0.0);
        };
        let object = self.geometry.object(&hit);
        if let Some(emission) = self.materials.emission(object) {
            let shines = self.geometry.front(&hit, direction);
            return if shines { emission } else { Rgb::ZERO }.extend(1.0);
        }
        let surface = self.geometry.surface(&hit, direction);
        let texel = self.materials.choose(object, surface.uv, choice);
        shader.aim(&self.materials, texel, surface.to_local(-direction), false);
        let across = lights::Settings::default().across();
        let mut radiance = shading::reflect_lights(&self.lamps, across, seed, &surface, shader, |_| true);
        if let Some(light) = &self.light {
            radiance += light.reflected(&surface, shader);
        }
        radiance.extend(1.0)
    }
}

impl Player for Playing {
    fn frame(&mut self, state: &State) -> Result<Rendering> {
        let start = Instant::now();
        let changes = self.stage.go(state)?;
        let scene = &self.stage.now;
        if changes.triangles {
            self.geometry = Geometry::new(scene);
        }
        if changes.lights {
            self.materials.relight(scene);
            self.lamps = shading::lamps(&scene.lights);
        }
        if let (Some(light), Some(environment)) = (&mut self.light, &scene.environment) {
            light.turn(environment.rotation);
        }
        let light_seconds = changes.seconds_since(start);
        let mut rendering = self.draw(&state.camera);
        rendering.cost.light_seconds = light_seconds;
        rendering.redone = changes.redone();
        Ok(rendering)
    }
}

impl Playing {
    /// Draws a view of the state it is in.
    fn draw(&self, camera: &Camera) -> Rendering {
        let start = Instant::now();
        let (width, height) = (camera.width as usize, camera.height as usize);
        let (rays, samples) = (Rays::new(camera), self.settings.samples);
        let mut pixels = vec![Vec4::ZERO; width * height];
        pixels.par_iter_mut().enumerate().for_each_init(Shader::new, |shader, (index, pixel)| {
            let seed = hash(self.settings.seed as u32 ^ hash(index as u32));
            for sample in 0..samples {
                let [x, y] = sampler::point(seed, sample, 0);
                let direction = rays.direction((index % width) as f32 + x, (index / width) as f32 + y);
                let choice = sampler::point(seed, sample, 1);
                *pixel += self.shade([rays.origin, direction], choice, hash(seed ^ hash(sample)), shader);
            }
            *pixel /= samples as f32;
        });
        let maps = self.light.as_ref().map_or(0, |light| light.maps.bytes());
        let memory = self.geometry.bytes() + self.materials.bytes() + maps + size_of_val(&pixels[..]);
        let cost = Cost {
            render_seconds: start.elapsed().as_secs_f64(),
            memory_bytes: memory as u64,
            samples,
            rays: pixels.len() as u64 * u64::from(samples),
            ..self.cost
        };
        let picture = Picture { width, height, pixels };
        Rendering { picture, variance: None, cost, redone: vec![], adapter: None, note: None }
    }
}
