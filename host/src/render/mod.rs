//! Renderers. Every one takes a [`Scene`] and gives a [`Rendering`]: a linear picture with what it cost.
//!
//! | method | light | where |
//! |---|---|---|
//! | `reference` | point, directional, environment; shadows | CPU |
//! | `lights` | point, directional (6.9); no shadows | GPU |

mod geometry;
pub mod gpu;
mod image;
pub mod lights;
mod materials;
mod math;
pub mod reference;
mod shading;

pub use image::{Picture, PictureKind, picture_kind};

use crate::error::Result;
use crate::scene::Scene;

/// A picture and its cost.
#[derive(Debug, Clone)]
pub struct Rendering {
    /// Linear radiance and coverage.
    pub picture: Picture,
    /// What it took.
    pub cost: Cost,
    /// The GPU that drew it; `None` for the CPU.
    pub adapter: Option<String>,
}

/// What a rendering took.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Cost {
    /// Seconds before the first pixel: trees, tables, uploads, pipelines.
    pub prepare_seconds: f64,
    /// Seconds for the pixels.
    pub render_seconds: f64,
    /// Rays cast; 0 for a raster.
    pub rays: u64,
}

/// The methods by their names on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Method {
    /// `lights` when there is a GPU and no environment to light the scene, else `reference`.
    Auto,
    /// Rays on the CPU.
    Reference,
    /// Raster on the GPU.
    Lights,
}

/// A rendering, the method that made it, and why another was passed over.
#[derive(Debug)]
pub struct Chosen {
    /// The picture and its cost.
    pub rendering: Rendering,
    /// Never [`Method::Auto`].
    pub method: Method,
    /// Why `auto` did not use the GPU.
    pub note: Option<String>,
}

/// Renders by the method named; `auto` falls back to the CPU and says why.
///
/// # Errors
/// Those of the method; `lights` without a GPU is a failure, `auto` is not.
pub fn render(scene: &Scene, method: Method, settings: &reference::Settings) -> Result<Chosen> {
    let reference = |note| {
        let rendering = reference::render(scene, settings)?;
        Ok(Chosen { rendering, method: Method::Reference, note })
    };
    match method {
        Method::Reference => reference(None),
        Method::Lights => {
            let rendering = lights::render(scene, &lights::Settings::default())?;
            Ok(Chosen { rendering, method: Method::Lights, note: None })
        }
        Method::Auto if scene.environment.is_some() => {
            reference(Some("the scene has an environment, which `lights` does not render".into()))
        }
        Method::Auto => match lights::render(scene, &lights::Settings::default()) {
            Ok(rendering) => Ok(Chosen { rendering, method: Method::Lights, note: None }),
            Err(error) if error.kind() == crate::error::Kind::Input => Err(error),
            Err(error) => reference(Some(error.to_string())),
        },
    }
}
