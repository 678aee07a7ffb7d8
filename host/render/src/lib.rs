//! Scenes of SBRDF materials, and the renderers that draw them.
//!
//! A [`scene::Scene`] is read from TOML or built in memory. A [`render::Job`] draws its frames by a method of
//! the table [`render::METHODS`], or by the one that is the cheapest for an error:
//!
//! ```
//! use lobelia_render::render::{Job, Method, Settings, reference};
//! use lobelia_render::scene::Scene;
//!
//! # fn main() -> lobelia_base::Result<()> {
//! let mut scene = Scene::open("lamps".as_ref())?;
//! (scene.camera.width, scene.camera.height) = (32, 24);
//! // The scene as it stands, then with its first light at a half.
//! let (first, mut second) = (scene.state(), scene.state());
//! second.lights[0].dim = 0.5;
//!
//! let reference = reference::Settings { samples: 4, ..Default::default() };
//! let job = Job {
//!     method: Method::find("reference"),
//!     settings: Settings { reference, ..Settings::default() },
//!     max_error: None,
//!     uses: None,
//!     baked: None,
//! };
//! let mut means = Vec::new();
//! job.run(&scene, &[first, second], |_, rendering| {
//!     let pixels = &rendering.picture.pixels;
//!     means.push(pixels.iter().map(|pixel| pixel.x).sum::<f32>() / pixels.len() as f32);
//!     Ok(())
//! })?;
//! assert!(means[1] < means[0] && means[1] > 0.0);
//! # Ok(())
//! # }
//! ```
//!
//! A method that prepares for long stores what it prepares: [`render::bake::bake`] writes a folder,
//! [`render::Job`]'s `baked` opens it. A single view of a scene as it stands is [`render::Renderer::render`]
//! of a method's settings.

pub mod render;
pub mod scene;
