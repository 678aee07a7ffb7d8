//! The vocabulary of reflectance that the host and the simulator share: lobes, a microfacet term, SBRDF maps,
//! measured tables, colour, sampled SBRDFs and pictures.
//!
//! Directions are unit vectors in the sample's local frame (x, y the principal directions of anisotropy or
//! the texture axes, z the outward normal): `wi` points toward the light, `wo` toward the viewer. Reflectance
//! is in sr⁻¹ and never includes a cosine.
//!
//! ```
//! use glam::Vec3;
//! use lobelia_reflectance::{Lobe, LobeBrdf, Rgb, SbrdfMap};
//!
//! # fn main() -> Result<(), lobelia_reflectance::FormatError> {
//! # let folder = tempfile::tempdir()?;
//! # let path = folder.path().join("material.exr");
//! // A map of two texels: one matt, of albedo 0.2, one with a lobe that shines forward.
//! let matt = LobeBrdf::diffuse(Rgb::splat(0.2));
//! let lobe = Lobe::new(Rgb::splat(0.5), Vec3::new(-1.0, -1.0, 0.95), 30.0);
//! let shiny = LobeBrdf { lobes: vec![lobe], ..matt.clone() };
//! SbrdfMap::from_texels(2, 1, &[matt, shiny]).write_exr(&path)?;
//!
//! let map = SbrdfMap::read_exr(&path)?;
//! let light = Vec3::new(0.6, 0.0, 0.8);
//! let mirrored = Vec3::new(-0.6, 0.0, 0.8);
//! assert!((map.eval(0, light, mirrored).x - 0.2 / std::f32::consts::PI).abs() < 1e-3);
//! assert!(map.eval(1, light, mirrored).x > map.eval(1, light, light).x);
//! # Ok(())
//! # }
//! ```

pub mod albedo;
pub mod ashikhmin;
pub mod colour;
pub mod distance;
pub mod exr_file;
pub mod fresnel;
pub mod lobe;
pub mod map;
mod map_exr;
pub mod materials;
pub mod microfacet;
pub mod mip;
pub mod picture;
pub mod picture_file;
pub mod radiance_file;
pub mod sampled;
pub mod table;
pub mod warning;

pub use ashikhmin::AshikhminShirley;
pub use lobe::{Lobe, LobeBrdf};
pub use map::{LobePlane, MIRROR_SOLID_ANGLE, MicrofacetPlane, SbrdfMap};
pub use map_exr::MapEncoding;
pub use microfacet::Microfacet;
pub use table::{InterpolatedBrdf, MeasuredTable};

/// Linear scene-referred Rec. 709 colour, or a reflectance in sr⁻¹ a channel.
pub type Rgb = glam::Vec3;

/// A BRDF of one point: reflectance in sr⁻¹ for a pair of directions.
pub trait Brdf: Send + Sync {
    /// f_r(wi → wo), sr⁻¹ (2.4). Zero when either direction is below the surface.
    fn eval(&self, wi: glam::Vec3, wo: glam::Vec3) -> Rgb;

    /// One channel (0 red, 1 green, 2 blue) of [`Self::eval`], for cameras behind a colour filter.
    fn eval_channel(&self, wi: glam::Vec3, wo: glam::Vec3, channel: usize) -> f32 {
        self.eval(wi, wo)[channel]
    }
}

/// What can be wrong with a file of this crate's formats.
#[derive(Debug, thiserror::Error)]
pub enum FormatError {
    /// The file cannot be read or written.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// The content is not what the format says; the sentence names the line, the row or the channel.
    #[error("{0}")]
    Invalid(String),
    /// The content could not be read by what reads the format; the sentence names the file.
    #[error("{message}")]
    Unreadable {
        /// The sentence.
        message: String,
        /// What the reader said.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}
