//! Renderers. Each is a [`Renderer`]: it makes a [`Scene`] ready once, then gives a [`Rendering`] of any view, a linear
//! picture with what it cost. [`compare`] tells how far a picture is from the reference's.
//!
//! | method | light | where |
//! |---|---|---|
//! | `reference` | all lights, environment, shadows, interreflection | CPU |
//! | `environment` | environment by prefiltered maps (6.13)–(6.18), lights as in `lights`, with their shadows on the GPU | CPU or GPU |
//! | `lights` | point, directional, rectangular (6.9), with shadows | GPU |

mod bvh;
pub mod choose;
pub mod compare;
pub mod environment;
mod flip;
mod geometry;
pub mod lights;
mod materials;
mod math;
pub mod reference;
mod sampler;
mod shading;
pub mod storage;

use glam::Vec3;

pub use lobelia_reflectance::picture::{Picture, PictureKind, picture_kind};

use crate::scene::{Camera, Scene};
use lobelia_base::error::{Kind, Result};

/// One way to render, with its settings.
pub trait Renderer {
    /// Does for a scene what is the same for every view: trees, tables, uploads, prefiltering.
    ///
    /// # Errors
    /// Input errors for a scene that [`Scene::check`] refuses; failures of the device.
    fn prepare<'a>(&self, scene: &'a Scene) -> Result<Box<dyn Prepared + 'a>>;

    /// Renders one view of a scene.
    ///
    /// # Errors
    /// Those of [`Self::prepare`] and [`Prepared::view`].
    fn render(&self, scene: &Scene, view: &Camera) -> Result<Rendering> {
        self.prepare(scene)?.view(view)
    }
}

/// A scene that one method has made ready.
pub trait Prepared {
    /// Renders one view.
    ///
    /// # Errors
    /// Input errors for a view that [`Camera::check`] refuses; failures of the device.
    fn view(&self, view: &Camera) -> Result<Rendering>;
}

/// A picture and its cost.
#[derive(Debug, Clone)]
pub struct Rendering {
    /// Linear radiance and coverage.
    pub picture: Picture,
    /// Variance of every pixel's mean, an upper estimate, where the method has one.
    pub variance: Option<Vec<Vec3>>,
    /// What it took.
    pub cost: Cost,
    /// The GPU that drew it; `None` for the CPU.
    pub adapter: Option<String>,
    /// What makes it worse than it should be.
    pub note: Option<String>,
}

impl Rendering {
    /// The relative RMSE ([`compare::Errors`]) that the variance lets expect, where the method estimates it.
    pub fn estimated_error(&self) -> Option<f64> {
        let means = self.picture.pixels.iter().map(|pixel| pixel.truncate());
        self.variance.as_ref().map(|variance| compare::expected_relative_rmse(means, variance))
    }
}

/// What a rendering took.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Cost {
    /// Seconds for what is the same for every view: trees, tables, uploads, pipelines.
    pub prepare_seconds: f64,
    /// Seconds for the view.
    pub render_seconds: f64,
    /// Bytes that the method holds for the scene and the view, on the CPU and the GPU.
    pub memory_bytes: u64,
    /// Samples a pixel.
    pub samples: u32,
    /// Rays cast; 0 for a raster.
    pub rays: u64,
    /// Draw calls; 0 for rays.
    pub draws: u32,
}

impl Cost {
    /// The cost of this and another view of the same scene made ready.
    #[must_use]
    pub fn and(&self, view: &Self) -> Self {
        Self {
            prepare_seconds: view.prepare_seconds,
            render_seconds: self.render_seconds + view.render_seconds,
            memory_bytes: self.memory_bytes.max(view.memory_bytes),
            samples: view.samples,
            rays: self.rays + view.rays,
            draws: self.draws + view.draws,
        }
    }
}

/// The methods by their names on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Method {
    /// The cheapest that meets --max-error; without it `lights` when there is a GPU and no environment, else `reference`.
    Auto,
    /// Path tracer on the CPU.
    Reference,
    /// Raster on the GPU.
    Lights,
    /// Prefiltered environment maps, on the CPU or the GPU.
    Environment,
}

impl Method {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Reference => "reference",
            Self::Lights => "lights",
            Self::Environment => "environment",
        }
    }
}

/// A scene made ready, the method that did, and why another was passed over.
pub struct Chosen<'a> {
    /// Ready to render views.
    pub prepared: Box<dyn Prepared + 'a>,
    /// Never [`Method::Auto`].
    pub method: Method,
    /// Why `auto` did not use the GPU.
    pub note: Option<String>,
}

/// The settings of every method.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Settings {
    /// The path tracer's.
    pub reference: reference::Settings,
    /// Those of the raster.
    pub lights: lights::Settings,
    /// Those of prefiltered environments.
    pub environment: environment::Settings,
}

/// Makes a scene ready by the method named; `auto` falls back to the CPU and says why.
///
/// # Errors
/// Those of the method; `lights` without a GPU is a failure, `auto` is not.
pub fn prepare<'a>(scene: &'a Scene, method: Method, settings: &Settings) -> Result<Chosen<'a>> {
    let reference =
        |note| Ok(Chosen { prepared: settings.reference.prepare(scene)?, method: Method::Reference, note });
    let lights = || settings.lights.prepare(scene);
    match method {
        Method::Reference => reference(None),
        Method::Environment => {
            Ok(Chosen { prepared: settings.environment.prepare(scene)?, method, note: None })
        }
        Method::Lights => Ok(Chosen { prepared: lights()?, method, note: None }),
        Method::Auto if scene.beyond_lobes().is_some() => reference(scene.beyond_lobes()),
        Method::Auto if scene.environment.is_some() => {
            reference(Some("the scene has an environment, which `lights` does not render".into()))
        }
        Method::Auto => match lights() {
            Ok(prepared) => Ok(Chosen { prepared, method: Method::Lights, note: None }),
            Err(error) if error.kind() == Kind::Input => Err(error),
            Err(error) => reference(Some(error.to_string())),
        },
    }
}

/// A check of a brushed lobe about a normal of its own and of one that sharpens toward grazing.
#[cfg(test)]
fn extended_check() -> lobelia_reflectance::SbrdfMap {
    use lobelia_reflectance::{Lobe, LobeBrdf, Rgb};
    let brdf = |c: [f32; 3], n: f32| {
        let lobe = Lobe::new(Rgb::new(0.5, 0.4, 0.3), c.into(), n);
        LobeBrdf { rho_d: Rgb::splat(0.05), lobes: vec![lobe], ..LobeBrdf::default() }
    };
    let tilted =
        LobeBrdf { normal: glam::Vec2::new(0.16, -0.08), beta: 0.5, ..brdf([-1.0, -0.7, 0.9], 16.0) };
    let mut sharpening = brdf([-0.97, -0.97, 1.0], 12.0);
    sharpening.lobes[0].n_grazing = Some(60.0);
    crate::scene::showcase::check(&tilted, &sharpening, 3, 5)
}

/// The same without normals and with `n` alone.
#[cfg(test)]
fn plain_check() -> lobelia_reflectance::SbrdfMap {
    let mut map = extended_check();
    map.normal.clear();
    map.lobes.iter_mut().for_each(|plane| plane.n_grazing.clear());
    map
}
