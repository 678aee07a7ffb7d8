//! The `lights` renderer: a raster on the GPU with point, directional and rectangular lights (6.9), any
//! number of lobes, microfacet terms and lights in one pass. Rectangular lights are sampled, at places that
//! differ from pixel to pixel. Shadows are traced through a tree of the scene's triangles. Textures are
//! filtered as [`Filtering`] says, coefficients stored as [`Storage`] says. An environment is seen but lights
//! nothing.

pub mod cpu;
mod footprint;
mod pipeline;
#[cfg(test)]
mod tests;
mod upload;

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Instant;

use glam::{BVec3, Mat4, Vec3, Vec4};

use super::bake::Baked;
use super::shading::{self, Rays};
use super::stage::{Changes, Stage};
use super::storage::Storage;
use super::{Cost, Player, Renderer, Rendering, Variant, methods};
use crate::scene::{Camera, Reflectance, Scene, State};
use lobelia_base::error::{Error, Result};
use lobelia_fit::edit::levels;
use lobelia_gpu::Gpu;
use lobelia_reflectance::SbrdfMap;
use lobelia_reflectance::mip;
use lobelia_reflectance::picture::Picture;
use upload::Uploads;

/// What a pixel takes of a texture that is smaller than it should be (stability case G14).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Filtering {
    /// The texels around its middle: fast, and full of specks from afar.
    Finest,
    /// MIP levels of averaged coefficients, interpolated before they are evaluated, as texture hardware does.
    Coefficients,
    /// MIP levels fitted to the averaged reflectance; what is interpolated is reflectance. Maps without such
    /// levels (`lobelia fit --mip`) get them first.
    Fitted,
    /// Shades texels all over the pixel, then filters: right, and as slow as there are texels.
    #[default]
    Shaded,
}

impl Filtering {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Finest, Self::Coefficients, Self::Fitted, Self::Shaded];

    /// Name on the command line, and what it is.
    pub fn option(self) -> (&'static str, &'static str) {
        match self {
            Self::Finest => ("finest", "The texels around its middle: fast, and full of specks from afar"),
            Self::Coefficients => (
                "coefficients",
                "MIP levels of averaged coefficients, interpolated before they are evaluated, as texture \
                 hardware does",
            ),
            Self::Fitted => (
                "fitted",
                "MIP levels fitted to the averaged reflectance; what is interpolated is reflectance. Maps \
                 without such levels (`lobelia fit --mip`) get them first",
            ),
            Self::Shaded => (
                "shaded",
                "Shades texels all over the pixel, then filters: right, and as slow as there are texels",
            ),
        }
    }

    /// Name in charts.
    pub fn name(self) -> &'static str {
        match self {
            Self::Finest => "finest level",
            Self::Coefficients => "averaged coefficients",
            Self::Fitted => "fitted levels",
            Self::Shaded => "shade, then filter",
        }
    }
}

/// How to draw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    /// Samples a pixel at edges: as many, or the most below that the adapter can.
    pub samples: u32,
    /// Filter of textures.
    pub filtering: Filtering,
    /// Samples of a texture along an axis of the pixel at most; along the longer one with MIP levels.
    pub anisotropy: u32,
    /// How coefficients are stored.
    pub storage: Storage,
    /// Whether lights throw shadows.
    pub shadows: bool,
    /// Samples of a rectangular light at most, for a pixel that sees it large; fewer from afar.
    pub light_samples: u32,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            samples: 4,
            filtering: Filtering::default(),
            anisotropy: 16,
            storage: Storage::default(),
            shadows: true,
            light_samples: 64,
        }
    }
}

impl Settings {
    /// The scene as it is drawn: with the MIP levels that the filter takes, in the coefficients that storage
    /// leaves.
    ///
    /// # Errors
    /// Input errors for a scene that [`Scene::check`] refuses, and for counts of 0.
    fn scene(&self, scene: &Scene) -> Result<Scene> {
        scene.check()?;
        if self.samples == 0 || self.anisotropy == 0 || self.light_samples == 0 {
            return Err(Error::input("lights: samples, anisotropy and light samples must be 1 or more"));
        }
        let mut scene = scene.clone();
        // Objects often share a map.
        let mut made: HashMap<*const SbrdfMap, Vec<Arc<SbrdfMap>>> = HashMap::new();
        for material in scene.objects.iter_mut().map(|object| &mut object.material) {
            let Reflectance::Map(map) = &material.reflectance else { continue };
            let key = Arc::as_ptr(map);
            match self.filtering {
                Filtering::Finest | Filtering::Shaded => material.levels.clear(),
                Filtering::Fitted if !material.levels.is_empty() => {}
                Filtering::Fitted if !map.microfacets.is_empty() || map.extension().is_some() => {
                    let what = map.extension().unwrap_or("a microfacet term");
                    return Err(Error::input(format!(
                        "lights: MIP levels of a map with {what} cannot be fitted; use --filter shaded"
                    )));
                }
                Filtering::Fitted => {
                    let fitted = || levels::all_fitted(map).into_iter().map(Arc::new).collect();
                    material.levels = made.entry(key).or_insert_with(fitted).clone();
                }
                Filtering::Coefficients => {
                    let last = mip::last([map.width, map.height]);
                    let averaged = || (1..=last).map(|level| levels::averaged(map, level).into()).collect();
                    material.levels = made.entry(key).or_insert_with(averaged).clone();
                }
            }
        }
        Ok(self.storage.stored_scene(&scene))
    }

    /// Samples of a rectangular light along an edge at most.
    pub(super) fn across(&self) -> u32 {
        self.light_samples.isqrt()
    }

    /// Seconds a frame of a view (of a driver in software, of CPU time), the least of `rounds` of `frames`
    /// each, without reading pictures back; and the adapter.
    ///
    /// # Errors
    /// Those of [`Renderer::prepare`] and of [`Player::frame`].
    pub fn frame_seconds(&self, scene: &Scene, rounds: u32, frames: u32) -> Result<(f64, String)> {
        let lights = Lights::new(self, scene, Gpu::open()?, None)?;
        lights.check(&scene.camera)?;
        let seconds =
            lights.gpu.guarded(|| lights.pass.frame_seconds(&lights.gpu, &scene.camera, rounds, frames));
        Ok((seconds?, lights.gpu.name()))
    }
}

/// Distance of the near plane, in sizes of the scene. Reversed depth in floating point is as fine far away as
/// near by wherever the plane is, so that it can be nearer than anything to be seen.
const NEAR: f32 = 1e-7;

/// Distance of the near plane for a scene, whatever a view looks at.
fn near(scene: &Scene) -> f32 {
    let corners = scene.objects.iter().flat_map(|object| {
        let (low, high) = object.mesh.bounds();
        let corner = move |k: usize| Vec3::select(BVec3::new(k & 1 > 0, k & 2 > 0, k & 4 > 0), high, low);
        (0..8).map(move |k| object.transform.transform_point3(corner(k)))
    });
    let (low, high) = corners.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), corner| {
        (low.min(corner), high.max(corner))
    });
    let size = (high - low).max_element();
    NEAR * if size.is_finite() && size > 0.0 { size } else { 1.0 }
}

/// World to clip space with reversed depth: 1 at the near plane, 0 at infinity.
fn projection(camera: &Camera, near: f32) -> Mat4 {
    let [right, up, forward] = camera.basis();
    let scale_y = 1.0 / (camera.fov / 2.0).tan();
    let scale_x = scale_y * camera.height as f32 / camera.width as f32;
    let row = |axis: Vec3, offset: f32| axis.extend(offset - axis.dot(camera.position));
    let rows = [
        row(right, 0.0) * scale_x,
        row(up, 0.0) * scale_y,
        Vec4::new(0.0, 0.0, 0.0, near),
        row(forward, 0.0),
    ];
    Mat4::from_cols(rows[0], rows[1], rows[2], rows[3]).transpose()
}

impl Renderer for Settings {
    fn name(&self) -> &'static str {
        "lights"
    }

    fn open(&self, scene: &Scene, _: &Baked) -> Result<Box<dyn Player>> {
        methods::check(self, scene)?;
        Ok(Box::new(Lights::new(self, scene, Gpu::open()?, None)?))
    }
}

/// What of a scene is not drawn.
pub(super) fn cannot_draw(scene: &Scene) -> Vec<String> {
    let alone = scene.lights.is_empty() && scene.environment.is_some();
    let alone = alone.then(|| "a scene that its environment alone lights".to_owned());
    alone.into_iter().chain(scene.beyond_lobes()).collect()
}

/// Storages and filters; the choice by error weighs those given.
pub(super) fn variants(base: &Settings) -> Vec<Variant> {
    let of = |name: String, weighed: bool, settings: Settings| Variant {
        series: "lights",
        name,
        weighed,
        renderer: Box::new(settings),
    };
    let storages = [Storage::Bits8, Storage::Bits8Scaled, Storage::F16].map(|storage| {
        let name = format!("{}, {}", base.filtering.name(), storage.name());
        of(name, false, Settings { storage, ..*base })
    });
    let filters = Filtering::ALL.into_iter().filter(|filtering| *filtering != base.filtering);
    let filters =
        filters.map(|filtering| of(filtering.name().into(), false, Settings { filtering, ..*base }));
    let own = of(base.filtering.name().into(), true, *base);
    storages.into_iter().chain(filters).chain([own]).collect()
}

/// Light from afar: WGSL that is appended to shaders/lights.wgsl and defines `distant_of`, and what it reads
/// as group 1, the first a uniform, the others storage.
pub(super) struct Distant {
    pub(super) shader: &'static str,
    pub(super) buffers: [wgpu::Buffer; 5],
}

/// A scene on the GPU.
pub(super) struct Lights {
    stage: Stage,
    pub(super) gpu: Gpu,
    pass: pipeline::Pass,
    bytes: usize,
    prepare_seconds: f64,
}

impl Lights {
    /// Uploads a scene.
    ///
    /// # Errors
    /// Input errors for the scene and the settings, failures of the device.
    pub(super) fn new(
        settings: &Settings,
        scene: &Scene,
        gpu: Gpu,
        distant: Option<Distant>,
    ) -> Result<Self> {
        let start = Instant::now();
        let stage = Stage::new(scene)?;
        let uploads = Uploads::new(&settings.scene(&stage.now)?, settings);
        let more: u64 = distant.iter().flat_map(|distant| &distant.buffers).map(wgpu::Buffer::size).sum();
        let near = near(&stage.now);
        let pass = gpu.guarded(|| pipeline::Pass::new(&gpu, &uploads, near, settings, distant))?;
        let bytes = uploads.bytes() + more as usize;
        Ok(Self { stage, gpu, pass, bytes, prepare_seconds: start.elapsed().as_secs_f64() })
    }

    /// Goes to another state; `sky` gives the uniform of light from afar by the environment's rotation.
    pub(super) fn go(
        &mut self,
        state: &State,
        sky: impl Fn(&Gpu, f32) -> Result<wgpu::Buffer>,
    ) -> Result<Changes> {
        let changes = self.stage.go(state)?;
        if changes == Changes::default() {
            return Ok(changes);
        }
        let (gpu, pass, scene) = (&self.gpu, &mut self.pass, &self.stage.now);
        gpu.guarded(|| {
            let near = if changes.triangles { near(scene) } else { 0.0 };
            pass.follow(gpu, scene, changes, near)?;
            let turned = scene.environment.as_ref().filter(|_| changes.turn && pass.has_distant());
            if let Some(environment) = turned {
                pass.turn(gpu, sky(gpu, environment.rotation)?);
            }
            Ok(())
        })?;
        Ok(changes)
    }

    /// Draws a view of the state it is in.
    pub(super) fn draw(&self, camera: &Camera) -> Result<Rendering> {
        self.check(camera)?;
        let start = Instant::now();
        let mut pixels = self.gpu.guarded(|| self.pass.draw(&self.gpu, camera))?;

        // The background shows through wherever coverage is not whole.
        let (width, height) = (camera.width as usize, camera.height as usize);
        let rays = Rays::new(camera);
        for (index, pixel) in pixels.iter_mut().enumerate() {
            if pixel.w < 1.0 {
                let direction = rays.direction((index % width) as f32 + 0.5, (index / width) as f32 + 0.5);
                let behind = shading::background(&self.stage.now, direction);
                *pixel += (behind * (1.0 - pixel.w)).extend(0.0);
            }
        }
        let cost = Cost {
            prepare_seconds: self.prepare_seconds,
            render_seconds: start.elapsed().as_secs_f64(),
            memory_bytes: (self.bytes + self.pass.target_bytes(camera)) as u64,
            samples: self.pass.samples(),
            draws: self.pass.draws(),
            ..Cost::default()
        };
        let picture = Picture { width, height, pixels };
        let (adapter, note) = (Some(self.gpu.name()), self.pass.note());
        Ok(Rendering { picture, variance: None, cost, redone: vec![], adapter, note })
    }

    /// Refuses views that cannot be drawn.
    fn check(&self, camera: &Camera) -> Result<()> {
        camera.check()?;
        let limit = self.gpu.device.limits().max_texture_dimension_2d;
        if camera.width > limit || camera.height > limit {
            return Err(Error::failure(format!("GPU: a picture has at most {limit} pixels a side")));
        }
        Ok(())
    }

    /// Goes to a state and draws it.
    pub(super) fn play(
        &mut self,
        state: &State,
        sky: impl Fn(&Gpu, f32) -> Result<wgpu::Buffer>,
    ) -> Result<Rendering> {
        let start = Instant::now();
        let changes = self.go(state, sky)?;
        let light_seconds = changes.seconds_since(start);
        let mut rendering = self.draw(&state.camera)?;
        rendering.cost.light_seconds = light_seconds;
        rendering.redone = changes.redone();
        Ok(rendering)
    }
}

impl Player for Lights {
    fn frame(&mut self, state: &State) -> Result<Rendering> {
        self.play(state, |_, _| Err(Error::failure("GPU: there is no light from afar to turn")))
    }
}
