//! Renderers. Each is a [`Renderer`]: it bakes what it stores of a [`Scene`] ([`bake`]), opens it as a
//! [`Player`], and that gives a [`Rendering`] of one [`State`] after another, a linear picture with what it
//! cost. [`compare`] tells how far a picture is from the reference's. [`METHODS`] is the table of all
//! methods, [`Job`] a rendering by any of them.

pub mod bake;
mod bvh;
pub mod choose;
pub mod compare;
mod cost;
pub mod environment;
mod flip;
mod geometry;
pub mod incident;
mod job;
pub mod lights;
mod materials;
mod math;
mod methods;
#[cfg(test)]
mod player_tests;
pub mod reference;
mod sampler;
mod shading;
mod stage;
pub mod storage;

use glam::Vec3;

pub use cost::Cost;
pub use job::{Chosen, Drawn, Job, Uses, prepare};
pub use lobelia_reflectance::picture::{Picture, PictureKind, picture_kind};
pub use methods::{METHODS, Method, REFERENCE, Settings, Variant};

use crate::scene::{Camera, Scene, State};
use bake::{Bake, Baked, MadeOf};
use lobelia_base::error::Result;

/// One way to render, with its settings.
pub trait Renderer {
    /// The name of its row in [`METHODS`].
    fn name(&self) -> &'static str;

    /// What its baking depends on for a scene, told in far less time than baking takes; nothing for a method
    /// that bakes nothing.
    ///
    /// # Errors
    /// Input errors for settings and scenes that it refuses.
    fn made_of(&self, _scene: &Scene) -> Result<Option<MadeOf>> {
        Ok(None)
    }

    /// The work of baking a scene; nothing for a method that bakes nothing.
    ///
    /// # Errors
    /// As [`Self::made_of`]; failures of the device.
    fn bake<'a>(&'a self, _scene: &'a Scene) -> Result<Option<Box<dyn Bake + 'a>>> {
        Ok(None)
    }

    /// Seconds that baking is expected to take, told without baking; nothing where that is no more than a
    /// moment.
    fn expected_bake_seconds(&self, _scene: &Scene) -> Option<f64> {
        None
    }

    /// Makes a scene ready to be played, by what was baked of it: does what is the same for every frame.
    ///
    /// # Errors
    /// Input errors for a scene that [`Scene::check`] or the method refuses, and for damage of what was
    /// baked; failures of the device.
    fn open(&self, scene: &Scene, baked: &Baked) -> Result<Box<dyn Player>>;

    /// Bakes a scene in memory and opens it.
    ///
    /// # Errors
    /// Those of [`Self::bake`] and [`Self::open`].
    fn prepare(&self, scene: &Scene) -> Result<Box<dyn Player>> {
        scene.check()?;
        self.open(scene, &Baked::in_memory(self, scene)?)
    }

    /// Renders one view of a scene as it stands.
    ///
    /// # Errors
    /// Those of [`Self::prepare`] and [`Player::frame`].
    fn render(&self, scene: &Scene, view: &Camera) -> Result<Rendering> {
        self.prepare(scene)?.frame(&scene.seen_by(view))
    }
}

/// A scene that one method has made ready.
pub trait Player {
    /// Renders the scene in a state, and redoes only what differs from the state before; the first follows
    /// the scene as it stands.
    ///
    /// # Errors
    /// Input errors for a state that [`Scene::at`] refuses; failures of the device.
    fn frame(&mut self, state: &State) -> Result<Rendering>;
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
    /// What was done again beside drawing, since the frame before ("tree", "lights", "turn").
    pub redone: Vec<&'static str>,
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
