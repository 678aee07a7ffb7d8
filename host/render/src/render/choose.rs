//! The cheapest renderer that meets an error bound, by a model that is measured on the scene itself.
//!
//! A small view of the scene is rendered with every setting and judged by three pictures of the reference
//! with seeds of their own, whose noise cancels (`compare::relative_rmse_by`). A raster keeps its error in a
//! larger picture and takes a time of its own, for triangles and texels, and time by the pixel, told apart by
//! a second view; the path tracer's error falls with the root of its samples. What is predicted to meet the
//! bound is tried, cheapest first, on the view itself and judged in the same way until it meets or misses the
//! bound beyond doubt; what is left at the end is the reference with as many samples as its own variance asks
//! for. Errors are relative RMSE ([`compare::Errors`]).

#[cfg(test)]
mod tests;
mod verdict;

use std::cell::RefCell;
use std::path::Path;
use std::rc::Rc;

use super::bake::Baked;
use super::{
    Chosen, METHODS, Method, Picture, Player, REFERENCE, Renderer, Rendering, Settings, Uses, Variant,
    compare, reference,
};
use crate::scene::{Camera, Scene, State};
use lobelia_base::error::{Error, Result};
use lobelia_base::page::numbers;
use lobelia_base::progress;
use verdict::Judges;

/// Pixels a row of the small view at most.
const SMALL_WIDTH: u32 = 64;
/// Pixels a row of the second view, as a multiple of the small one's.
const LARGER: u32 = 2;
/// Samples a pixel of the pictures that judge the small view.
const SMALL_SAMPLES: u32 = 64;
/// Samples a pixel at least: with fewer, caustics are missed by the view that foretells them and by the one
/// that verifies.
const LEAST_SAMPLES: u32 = 16;
/// Passes that the path tracer's variance is told from; samples a pixel are a multiple of it.
const PASSES: u32 = 4;
/// Samples in excess of those that the model asks for, so that most pictures meet the bound at once.
const RESERVE: f64 = 1.5;

/// What the choice is for.
#[derive(Debug, Clone, Copy)]
pub struct Work<'a> {
    /// How often what is prepared will be used.
    pub uses: Uses,
    /// The frames, or some of them: methods that cannot vary what they vary are left out, and a change of
    /// light is measured by theirs.
    pub frames: &'a [State],
    /// The least error that will be asked for: a method whose baking alone would outlast the path tracer is
    /// then not tried.
    pub max_error: Option<f64>,
    /// What was baked before.
    pub baked: Option<&'a Path>,
}

impl Work<'_> {
    /// One view of a scene.
    pub const ONCE: Self = Self { uses: Uses::ONCE, frames: &[], max_error: None, baked: None };
}

/// What is foreseen of a setting, s.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Foreseen {
    /// Baking; 0 for what was baked before.
    pub bake: f64,
    /// Making ready.
    pub prepare: f64,
    /// A change of the light.
    pub light: f64,
    /// A frame.
    pub frame: f64,
}

impl Foreseen {
    /// All of it, used so often.
    pub fn whole(&self, uses: Uses) -> f64 {
        let (frames, changes) = (f64::from(uses.frames), f64::from(uses.light_changes));
        self.bake + self.prepare + changes * self.light + frames * self.frame
    }
}

/// What was measured of one setting.
struct Candidate {
    method: &'static Method,
    name: String,
    /// For a renderer without noise.
    player: Option<Shared>,
    /// For the path tracer.
    paths: reference::Settings,
    bake_seconds: f64,
    prepare_seconds: f64,
    /// Seconds a change of the light.
    light_seconds: f64,
    /// Seconds a view whatever its size.
    view_seconds: f64,
    /// Seconds a pixel, and sample of the path tracer.
    seconds: f64,
    /// Error that more samples do not lower.
    bias: f64,
    /// Error of one sample a pixel by noise alone.
    noise: f64,
}

/// A player that is used again.
#[derive(Clone)]
pub struct Shared(Rc<RefCell<Box<dyn Player>>>);

impl Player for Shared {
    fn frame(&mut self, state: &State) -> Result<Rendering> {
        self.0.borrow_mut().frame(state)
    }
}

/// Times and errors of every setting on a scene.
pub struct Model<'a> {
    scene: &'a Scene,
    uses: Uses,
    base: reference::Settings,
    candidates: Vec<Candidate>,
    /// What failed or cannot draw the scene, and why.
    refused: Vec<(&'static Method, String, Error)>,
}

/// A setting, what was predicted of it, and what came out if it was tried.
#[derive(Debug, Clone, PartialEq)]
pub struct Tried {
    /// The method.
    pub method: &'static Method,
    /// Its setting.
    pub name: String,
    /// What the prediction is made of.
    pub foreseen: Foreseen,
    /// Predicted seconds of the whole, and error.
    pub predicted: [f64; 2],
    /// Seconds of the whole by the first frame as it was drawn, and that frame's error.
    pub actual: Option<[f64; 2]>,
}

/// What met the bound.
pub struct Met {
    /// Ready for further frames.
    pub chosen: Chosen,
    /// The first frame.
    pub rendering: Rendering,
    /// All settings by predicted time of the whole; which was chosen says [`taken`].
    pub tried: Vec<Tried>,
}

/// The setting that was taken: the last that has an actual error.
pub fn taken(tried: &[Tried]) -> Option<&Tried> {
    tried.iter().rfind(|tried| tried.actual.is_some())
}

impl<'a> Model<'a> {
    /// Measures every setting on a small view. The reference's settings have its bounces, seed and limits.
    ///
    /// # Errors
    /// Those of the scene and of the path tracer. Another method that fails or cannot draw the scene is left
    /// out.
    pub fn measure(scene: &'a Scene, given: &Settings, work: &Work<'_>) -> Result<Self> {
        let of = |method: &'static Method| (method.variants)(scene, given).into_iter();
        let weighed = METHODS.iter().flat_map(|method| of(method).map(move |variant| (method, variant)));
        Self::measure_of(scene, given, work, weighed.filter(|(_, variant)| variant.weighed).collect())
    }

    /// Measures the path tracer and some settings of methods without noise.
    fn measure_of(
        scene: &'a Scene,
        given: &Settings,
        work: &Work<'_>,
        variants: Vec<(&'static Method, Variant)>,
    ) -> Result<Self> {
        let base = reference::Settings { max_error: None, ..given.reference };
        let (candidates, refused) = (Vec::new(), Vec::new());
        let mut model = Self { scene, uses: work.uses, base, candidates, refused };
        let mut view = work.frames.first().cloned().unwrap_or_else(|| scene.state());
        view.camera = small(&view.camera);
        let changed = (work.uses.light_changes > 0).then(|| changed(scene, work.frames, &view));
        let pixels = f64::from(view.camera.width * view.camera.height);
        let bar = progress::bar("measuring", variants.len() as u64 + 3, "settings");

        let mut player = judge(&base, 0, SMALL_SAMPLES).prepare(scene)?;
        let whole = player.frame(&view)?;
        let light_seconds = match &changed {
            Some(changed) => player.frame(changed)?.cost.light_seconds,
            None => 0.0,
        };
        let judges = model.judges(&view, SMALL_SAMPLES)?;
        bar.advance(2);
        let one_bounce = reference::Settings { bounces: 1, ..judge(&base, 4, SMALL_SAMPLES) };
        let without = one_bounce.prepare(scene)?.frame(&view)?;
        bar.advance(1);
        let samples = f64::from(SMALL_SAMPLES);
        for (name, paths, rendering, biased) in [
            ("", base, &whole, false),
            ("no interreflection, ", reference::Settings { bounces: 1, ..base }, &without, true),
        ] {
            let noise = rendering.estimated_error().unwrap_or_default();
            let error = if biased { compare::relative_rmse_by(&judges, &rendering.picture) } else { 0.0 };
            model.candidates.push(Candidate {
                method: REFERENCE,
                name: name.into(),
                player: None,
                paths,
                bake_seconds: 0.0,
                prepare_seconds: rendering.cost.prepare_seconds,
                light_seconds,
                view_seconds: 0.0,
                seconds: rendering.cost.render_seconds / (pixels * samples),
                bias: (error * error - noise * noise).max(0.0).sqrt(),
                noise: noise * samples.sqrt(),
            });
        }
        // What the path tracer takes for all frames: no baking that takes longer pays.
        let camera = work.frames.first().map_or(scene.camera, |frame| frame.camera);
        let worth = work.max_error.map(|max_error| {
            let (_, tried) = model.candidates[0].predict(&camera, max_error, base.samples, work.uses);
            tried.predicted[0]
        });
        for (method, Variant { name, renderer, .. }) in variants {
            let measured = measured(method, renderer.as_ref(), scene, work, worth, (&view, changed.as_ref()));
            bar.advance(1);
            match measured {
                Ok((player, rendering, light_seconds, seconds)) => model.candidates.push(Candidate {
                    method,
                    name,
                    player: Some(Shared(Rc::new(RefCell::new(player)))),
                    paths: base,
                    bake_seconds: rendering.cost.bake_seconds,
                    prepare_seconds: rendering.cost.prepare_seconds,
                    light_seconds,
                    view_seconds: (rendering.cost.view_seconds + rendering.cost.render_seconds
                        - seconds * pixels)
                        .max(0.0),
                    seconds,
                    bias: compare::relative_rmse_by(&judges, &rendering.picture),
                    noise: 0.0,
                }),
                Err(error) => model.refused.push((method, name, error)),
            }
        }
        Ok(model)
    }

    /// The renderers without noise that are ready for frames, with their settings.
    pub fn ready(&self) -> impl Iterator<Item = (&'static Method, &str, Shared)> {
        self.candidates.iter().filter_map(|of| Some((of.method, of.name.as_str(), of.player.clone()?)))
    }

    /// The settings that failed or cannot draw the scene, and why.
    pub fn refused(&self) -> impl Iterator<Item = (&'static Method, &str, &Error)> {
        self.refused.iter().map(|(method, name, error)| (*method, name.as_str(), error))
    }

    /// Renders a frame with the setting that is the cheapest by the whole and meets an error.
    ///
    /// # Errors
    /// An input error for an error that is not above 0, and those of the renderers.
    pub fn meet(&self, frame: &State, max_error: f64) -> Result<Met> {
        if max_error.is_nan() || max_error <= 0.0 {
            return Err(Error::input(format!("max-error is {max_error}, must be above 0")));
        }
        let mut order = order(&self.candidates, &frame.camera, max_error, self.base.samples, self.uses);
        let mut judges = None;
        let mut met = None;
        for (index, samples, tried) in &mut order {
            if tried.predicted[1] > max_error {
                continue;
            }
            let Candidate { method, player, paths, .. } = &self.candidates[*index];
            let paths = reference::Settings { samples: *samples, ..*paths };
            let mut player: Box<dyn Player> = match player {
                Some(player) => Box::new(player.clone()),
                None => paths.prepare(self.scene)?,
            };
            let rendering = player.frame(frame)?;
            // The whole path tracer knows its own error.
            let own = rendering.estimated_error().filter(|_| paths.bounces == self.base.bounces);
            let (error, meets) = match own {
                Some(error) => (error, error <= max_error),
                None => {
                    let judges = match &mut judges {
                        Some(judges) => judges,
                        None => judges.insert(Judges::new(self.scene, self.base, frame.clone())?),
                    };
                    judges.judge(&rendering.picture, max_error)?
                }
            };
            let drawn = Foreseen {
                bake: tried.foreseen.bake,
                prepare: rendering.cost.prepare_seconds,
                light: tried.foreseen.light,
                frame: rendering.cost.view_seconds + rendering.cost.render_seconds,
            };
            tried.actual = Some([drawn.whole(self.uses), error]);
            if meets {
                met = Some((Chosen { player, method, note: None }, rendering));
                break;
            }
        }
        let mut tried: Vec<Tried> = order.into_iter().map(|(.., tried)| tried).collect();
        let (mut chosen, rendering) = match met {
            Some(met) => met,
            None => {
                let paths = reference::Settings { max_error: Some(max_error), ..self.base };
                let mut player = paths.prepare(self.scene)?;
                let rendering = player.frame(frame)?;
                let drawn = Foreseen {
                    prepare: rendering.cost.prepare_seconds,
                    light: self.candidates[0].light_seconds,
                    frame: rendering.cost.render_seconds,
                    ..Foreseen::default()
                };
                tried.push(Tried {
                    method: REFERENCE,
                    name: "until its variance meets the error".into(),
                    foreseen: Foreseen {
                        bake: f64::NAN,
                        prepare: f64::NAN,
                        light: f64::NAN,
                        frame: f64::NAN,
                    },
                    predicted: [f64::NAN; 2],
                    actual: Some([drawn.whole(self.uses), rendering.estimated_error().unwrap_or(f64::NAN)]),
                });
                (Chosen { player, method: REFERENCE, note: None }, rendering)
            }
        };
        chosen.note = self.refused.last().map(|(.., error)| error.to_string());
        Ok(Met { chosen, rendering, tried })
    }

    /// The three pictures that judge a view; the last has twice the samples.
    fn judges(&self, view: &State, samples: u32) -> Result<[Picture; 3]> {
        let picture =
            |k, samples| Ok(judge(&self.base, k, samples).prepare(self.scene)?.frame(view)?.picture);
        Ok([picture(1, samples)?, picture(2, samples)?, picture(3, 2 * samples)?])
    }
}

/// A player of one setting, its frame of the small view, seconds of a change of light, and seconds a pixel.
fn measured(
    method: &Method,
    renderer: &dyn Renderer,
    scene: &Scene,
    work: &Work<'_>,
    worth: Option<f64>,
    (view, changed): (&State, Option<&State>),
) -> Result<(Box<dyn Player>, Rendering, f64, f64)> {
    method.check(scene)?;
    method.varies.check(method.name, scene, work.frames)?;
    let baked = work.baked.and_then(|folder| Baked::open(folder, renderer, scene).ok());
    if let (None, Some(worth), Some(seconds)) = (&baked, worth, renderer.expected_bake_seconds(scene))
        && seconds > worth
    {
        return Err(Error::input(format!(
            "baking is expected to take {}, all frames by the path tracer {}",
            numbers::seconds(seconds),
            numbers::seconds(worth)
        )));
    }
    let mut player = match &baked {
        Some(baked) => renderer.open(scene, baked)?,
        None => renderer.prepare(scene)?,
    };
    // The first picture is slower: drivers compile with it.
    player.frame(view)?;
    let mut rendering = player.frame(view)?;
    if baked.is_some() {
        rendering.cost.bake_seconds = 0.0;
    }
    let mut larger = view.clone();
    larger.camera.width *= LARGER;
    larger.camera.height *= LARGER;
    let of = |rendering: &Rendering| rendering.cost.view_seconds + rendering.cost.render_seconds;
    let pixels = f64::from(view.camera.width * view.camera.height);
    let more = f64::from(larger.camera.width * larger.camera.height) - pixels;
    let seconds = (of(&player.frame(&larger)?) - of(&rendering)).max(0.0) / more;
    let light_seconds = match changed {
        Some(changed) => player.frame(changed)?.cost.light_seconds,
        None => 0.0,
    };
    Ok((player, rendering, light_seconds, seconds))
}

/// A view under another light: that of the first frame that has one, else the environment turned or a light
/// dimmed.
fn changed(scene: &Scene, frames: &[State], view: &State) -> State {
    if let Some(other) = frames.iter().find(|frame| !frame.has_light_of(view)) {
        return State { camera: view.camera, ..other.clone() };
    }
    let mut other = view.clone();
    match (scene.environment.is_some(), other.lights.first_mut()) {
        (true, _) => other.turn += 0.1,
        (false, Some(light)) => light.dim *= 0.9,
        (false, None) => {}
    }
    other
}

/// The candidates by the predicted time of the whole: index, samples a pixel of the path tracer, and what is
/// predicted.
fn order(
    candidates: &[Candidate],
    view: &Camera,
    max_error: f64,
    limit: u32,
    uses: Uses,
) -> Vec<(usize, u32, Tried)> {
    let predicted = |(index, candidate): (usize, &Candidate)| {
        let (samples, tried) = candidate.predict(view, max_error, limit, uses);
        (index, samples, tried)
    };
    let mut order: Vec<_> = candidates.iter().enumerate().map(predicted).collect();
    order.sort_by(|a, b| a.2.predicted[0].total_cmp(&b.2.predicted[0]));
    order
}

impl Candidate {
    /// Samples a pixel that meet an error, at most `limit`, and what is predicted with them.
    fn predict(&self, view: &Camera, max_error: f64, limit: u32, uses: Uses) -> (u32, Tried) {
        let pixels = f64::from(view.width) * f64::from(view.height);
        let foreseen = |samples: f64| Foreseen {
            bake: self.bake_seconds,
            prepare: self.prepare_seconds,
            light: self.light_seconds,
            frame: self.view_seconds + self.seconds * pixels * samples,
        };
        let tried = |name: String, samples: f64, error: f64| {
            let foreseen = foreseen(samples);
            let predicted = [foreseen.whole(uses), error];
            Tried { method: self.method, name, foreseen, predicted, actual: None }
        };
        if self.player.is_some() {
            return (0, tried(self.name.clone(), 1.0, self.bias));
        }
        // Below a bias that is too large no number of samples helps: as many as for twice the bias are shown.
        let room =
            if self.bias < max_error { max_error.powi(2) - self.bias.powi(2) } else { self.bias.powi(2) };
        let needed = (RESERVE * self.noise * self.noise / room).ceil().max(f64::from(LEAST_SAMPLES));
        let samples = (needed.min(f64::from(limit)) as u32).next_multiple_of(PASSES);
        let count = f64::from(samples);
        let error = (self.bias.powi(2) + self.noise * self.noise / count).sqrt();
        (samples, tried(format!("{}{samples} samples", self.name), count, error))
    }
}

/// The path tracer as a judge, with a seed of its own.
pub fn judge(base: &reference::Settings, k: u64, samples: u32) -> reference::Settings {
    let seed = base.seed ^ k.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    reference::Settings { samples, seconds: None, max_error: None, seed, ..*base }
}

/// The view in fewer pixels.
fn small(view: &Camera) -> Camera {
    let width = view.width.min(SMALL_WIDTH);
    let height = (f64::from(view.height) * f64::from(width) / f64::from(view.width)).round().max(1.0) as u32;
    Camera { width, height, ..*view }
}
