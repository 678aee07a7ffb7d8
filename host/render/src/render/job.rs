//! A rendering: which frames of a scene, by what, how right, and by what was baked before.

use std::path::Path;
use std::time::Instant;

use super::bake::{self, Baked};
use super::choose::{Model, Tried, Work};
use super::{Cost, Method, Player, REFERENCE, Rendering, Settings};
use crate::scene::{Scene, State, state};
use lobelia_base::error::{Error, Kind, Result};

/// How often what is prepared will be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Uses {
    /// Frames.
    pub frames: u32,
    /// Changes of the light between them.
    pub light_changes: u32,
}

impl Uses {
    /// One frame.
    pub const ONCE: Self = Self { frames: 1, light_changes: 0 };

    /// As often as some frames use it.
    pub fn of(frames: &[State]) -> Self {
        Self { frames: frames.len() as u32, light_changes: state::light_changes(frames) }
    }
}

/// A scene made ready, the method that did, and why another was passed over.
pub struct Chosen {
    /// Ready to render frames.
    pub player: Box<dyn Player>,
    /// The method.
    pub method: &'static Method,
    /// Why the method that would have been taken first was not.
    pub note: Option<String>,
}

/// What to render with.
#[derive(Debug, Clone, Copy)]
pub struct Job<'a> {
    /// The method; without one the cheapest by the whole that meets `max_error`, else `lights` when there is
    /// a GPU and no environment, else the reference.
    pub method: Option<&'static Method>,
    /// Settings of all methods.
    pub settings: Settings,
    /// Relative RMSE that frames may have, for the choice of a method.
    pub max_error: Option<f64>,
    /// How often what is prepared will be used; as often as there are frames when not said.
    pub uses: Option<Uses>,
    /// A folder that the method was baked into.
    pub baked: Option<&'a Path>,
}

/// What came of a job.
#[derive(Debug, Clone)]
pub struct Drawn {
    /// The method that drew the frames.
    pub method: &'static Method,
    /// Why the method that would have been taken first was not.
    pub note: Option<String>,
    /// What was tried for an error, by predicted time.
    pub tried: Vec<Tried>,
    /// Seconds of the choice beside the frame that was chosen.
    pub choose_seconds: Option<f64>,
    /// The last frame, and the cost of all.
    pub last: Rendering,
}

impl Job<'_> {
    /// Renders frames one after another; `each` takes them as they come, with their numbers.
    ///
    /// # Errors
    /// Input errors for no frames, for a scene that the method cannot draw or frames that it cannot vary, and
    /// for a folder that is of something else; failures of the device; and what `each` returns.
    pub fn run(
        &self,
        scene: &Scene,
        frames: &[State],
        mut each: impl FnMut(usize, &Rendering) -> Result<()>,
    ) -> Result<Drawn> {
        let Some(first_frame) = frames.first() else {
            return Err(Error::input("there are no frames to render"));
        };
        let named =
            self.method.or(self.baked.map(method_of).transpose()?.filter(|_| self.max_error.is_none()));
        if let Some(method) = named {
            method.varies.check(method.name, scene, frames)?;
        }
        let choosing = Instant::now();
        let (mut chosen, mut tried, mut first) = (None, Vec::new(), None);
        if let (None, Some(max_error)) = (named, self.max_error) {
            if let Some(folder) = self.baked {
                // What is of another scene is said to be, and not passed over.
                Baked::open(folder, (method_of(folder)?.renderer)(&self.settings).as_ref(), scene)?;
            }
            let uses = self.uses.unwrap_or_else(|| Uses::of(frames));
            let work = Work { uses, frames, max_error: Some(max_error), baked: self.baked };
            let met = Model::measure(scene, &self.settings, &work)?.meet(first_frame, max_error)?;
            tried = met.tried;
            first = Some(met.rendering);
            chosen = Some(met.chosen);
        }
        let mut chosen = match chosen {
            Some(chosen) => chosen,
            None => prepare(scene, named, &self.settings, self.baked)?,
        };
        // What it took beside the picture that was chosen.
        let choose_seconds =
            first.as_ref().map(|first| (choosing.elapsed().as_secs_f64() - first.cost.seconds()).max(0.0));
        let mut cost = Cost::default();
        let mut last = None;
        for (index, state) in frames.iter().enumerate() {
            let rendering = match first.take() {
                Some(rendering) => rendering,
                None => chosen.player.frame(state)?,
            };
            cost = cost.and(&rendering.cost);
            each(index, &rendering)?;
            last = Some(Rendering { cost, ..rendering });
        }
        let last = last.ok_or_else(|| Error::input("there are no frames to render"))?;
        Ok(Drawn { method: chosen.method, note: chosen.note, tried, choose_seconds, last })
    }
}

/// The method that a folder was baked for.
///
/// # Errors
/// Those of [`bake::list`]; an input error for a method that there is not.
fn method_of(folder: &Path) -> Result<&'static Method> {
    let name = bake::method_of(folder)?;
    Method::find(&name).ok_or_else(|| {
        Error::input(format!("{}: baked for `{name}`, which this version does not have", folder.display()))
    })
}

/// Makes a scene ready by a method, with what was baked of it where there is a folder; without a method by
/// `lights`, or on the CPU where that cannot be, which is then said.
///
/// # Errors
/// Those of the method; `lights` without a GPU is a failure, no method is not.
pub fn prepare(
    scene: &Scene,
    method: Option<&'static Method>,
    settings: &Settings,
    baked: Option<&Path>,
) -> Result<Chosen> {
    let by = |method: &'static Method, note| -> Result<Chosen> {
        method.check(scene)?;
        let renderer = (method.renderer)(settings);
        let player = match baked {
            Some(folder) => renderer.open(scene, &Baked::open(folder, renderer.as_ref(), scene)?)?,
            None => renderer.prepare(scene)?,
        };
        Ok(Chosen { player, method, note })
    };
    if let Some(method) = method {
        return by(method, None);
    }
    if let Some(what) = scene.beyond_lobes() {
        return by(REFERENCE, Some(format!("the scene has {what}, which `reference` alone draws")));
    }
    if scene.environment.is_some() {
        return by(REFERENCE, Some("the scene has an environment, which `lights` does not render".into()));
    }
    match Method::find("lights").map(|lights| by(lights, None)) {
        Some(Err(error)) if error.kind() == Kind::Failure => by(REFERENCE, Some(error.to_string())),
        Some(chosen) => chosen,
        None => by(REFERENCE, None),
    }
}
