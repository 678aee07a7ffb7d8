//! The cheapest renderer that meets an error bound, by a model that is measured on the scene itself.
//!
//! A small view of the scene is rendered with every setting and judged by three pictures of the reference with seeds of their
//! own, whose noise cancels (`compare::relative_rmse_by`). A raster keeps its error in
//! a larger picture and takes a time of its own, for triangles and texels, and time by the pixel, told apart by a second view; the path tracer's error falls with the root of its samples. What is
//! predicted to meet the bound is tried, cheapest first, on the view itself and judged in the same way until it meets or misses the bound
//! beyond doubt; what is left at the end is the reference with as many samples as its own variance asks for. Errors are relative RMSE ([`compare::Errors`]).

mod verdict;

use std::rc::Rc;

use super::{
    Chosen, Method, Picture, Prepared, Renderer, Rendering, Settings, compare, environment, reference,
};
use crate::scene::{Camera, Scene};
use lobelia_base::error::{Error, Result};
use lobelia_base::progress;
use verdict::Judges;

/// Pixels a row of the small view at most.
const SMALL_WIDTH: u32 = 64;
/// Pixels a row of the second view, as a multiple of the small one's.
const LARGER: u32 = 2;
/// Samples a pixel of the pictures that judge the small view.
const SMALL_SAMPLES: u32 = 64;
/// Samples a pixel at least: with fewer, caustics are missed by the view that foretells them and by the one that verifies.
const LEAST_SAMPLES: u32 = 16;
/// Passes that the path tracer's variance is told from; samples a pixel are a multiple of it.
const PASSES: u32 = 4;
/// Samples in excess of those that the model asks for, so that most pictures meet the bound at once.
const RESERVE: f64 = 1.5;

/// A renderer without noise, with one of its settings.
pub struct Setting {
    /// Never [`Method::Auto`] or [`Method::Reference`].
    pub method: Method,
    /// The setting.
    pub name: &'static str,
    /// The renderer.
    pub renderer: Box<dyn Renderer>,
}

/// The settings of the renderers without noise that a scene can be given to.
pub fn settings(scene: &Scene, base: &Settings) -> Vec<Setting> {
    let mut all: Vec<Setting> = Vec::new();
    if scene.environment.is_some() {
        let base = base.environment;
        let variants = [
            ("slices", base),
            ("slices, on the GPU", environment::Settings { gpu: true, ..base }),
            ("slices, no horizon correction", environment::Settings { horizon: false, ..base }),
            ("MIP levels", environment::Settings { encoding: environment::Encoding::Mips, ..base }),
            ("slices, spherical harmonics", environment::Settings { harmonics: true, ..base }),
        ];
        all.extend(variants.map(|(name, variant)| Setting {
            method: Method::Environment,
            name,
            renderer: Box::new(variant),
        }));
    }
    all.push(Setting {
        method: Method::Lights,
        name: base.lights.filtering.name(),
        renderer: Box::new(base.lights),
    });
    all
}

/// What was measured of one setting.
struct Candidate<'a> {
    method: Method,
    name: String,
    /// For a renderer without noise.
    prepared: Option<Rc<dyn Prepared + 'a>>,
    /// For the path tracer.
    paths: reference::Settings,
    prepare_seconds: f64,
    /// Seconds a view whatever its size.
    view_seconds: f64,
    /// Seconds a pixel, and sample of the path tracer.
    seconds: f64,
    /// Error that more samples do not lower.
    bias: f64,
    /// Error of one sample a pixel by noise alone.
    noise: f64,
}

impl Prepared for Rc<dyn Prepared + '_> {
    fn view(&self, view: &Camera) -> Result<Rendering> {
        self.as_ref().view(view)
    }
}

/// Times and errors of every setting on a scene.
pub struct Model<'a> {
    scene: &'a Scene,
    base: reference::Settings,
    candidates: Vec<Candidate<'a>>,
    /// What failed or cannot draw the scene, and why.
    refused: Vec<(Method, &'static str, Error)>,
}

/// A setting, what was predicted of it, and what came out if it was tried.
#[derive(Debug, Clone, PartialEq)]
pub struct Tried {
    /// The method.
    pub method: Method,
    /// Its setting.
    pub name: String,
    /// Predicted seconds and error.
    pub predicted: [f64; 2],
    /// Measured seconds and error.
    pub actual: Option<[f64; 2]>,
}

/// What met the bound.
pub struct Met<'a> {
    /// Ready for further views.
    pub chosen: Chosen<'a>,
    /// The view.
    pub rendering: Rendering,
    /// All settings by predicted time; which was chosen says [`taken`].
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
    /// Those of the scene and of the path tracer. Another method that fails or cannot draw the scene is left out.
    pub fn measure(scene: &'a Scene, given: &Settings) -> Result<Self> {
        let base = reference::Settings { max_error: None, ..given.reference };
        let mut model = Self { scene, base, candidates: Vec::new(), refused: Vec::new() };
        let view = small(&scene.camera);
        let pixels = f64::from(view.width * view.height);
        let settings = settings(scene, given);
        let bar = progress::bar("measuring", settings.len() as u64 + 3, "settings");

        let whole = judge(&base, 0, SMALL_SAMPLES).render(scene, &view)?;
        let judges = model.judges(&view, SMALL_SAMPLES)?;
        bar.advance(2);
        let one_bounce = reference::Settings { bounces: 1, ..judge(&base, 4, SMALL_SAMPLES) };
        let without = one_bounce.render(scene, &view)?;
        bar.advance(1);
        let samples = f64::from(SMALL_SAMPLES);
        for (name, paths, rendering, biased) in [
            ("", base, &whole, false),
            ("no interreflection, ", reference::Settings { bounces: 1, ..base }, &without, true),
        ] {
            let noise = rendering.estimated_error().unwrap_or_default();
            let error = if biased { compare::relative_rmse_by(&judges, &rendering.picture) } else { 0.0 };
            model.candidates.push(Candidate {
                method: Method::Reference,
                name: name.into(),
                prepared: None,
                paths,
                prepare_seconds: rendering.cost.prepare_seconds,
                view_seconds: 0.0,
                seconds: rendering.cost.render_seconds / (pixels * samples),
                bias: (error * error - noise * noise).max(0.0).sqrt(),
                noise: noise * samples.sqrt(),
            });
        }
        for Setting { method, name, renderer } in settings {
            let rendered = renderer.prepare(scene).and_then(|prepared| {
                // The first view also pays for what is made once, such as a driver's compiled shaders.
                prepared.view(&view)?;
                let rendering = prepared.view(&view)?;
                let larger = Camera { width: LARGER * view.width, height: LARGER * view.height, ..view };
                let more = prepared.view(&larger)?.cost.render_seconds - rendering.cost.render_seconds;
                let seconds = more.max(0.0) / (pixels * f64::from(LARGER * LARGER - 1));
                Ok((prepared, rendering, seconds))
            });
            bar.advance(1);
            match rendered {
                Ok((prepared, rendering, seconds)) => model.candidates.push(Candidate {
                    method,
                    name: name.into(),
                    prepared: Some(prepared.into()),
                    paths: base,
                    prepare_seconds: rendering.cost.prepare_seconds,
                    view_seconds: (rendering.cost.render_seconds - seconds * pixels).max(0.0),
                    seconds,
                    bias: compare::relative_rmse_by(&judges, &rendering.picture),
                    noise: 0.0,
                }),
                Err(error) => model.refused.push((method, name, error)),
            }
        }
        Ok(model)
    }

    /// The renderers without noise that are ready for views, with their settings.
    pub fn ready(&self) -> impl Iterator<Item = (Method, &str, Rc<dyn Prepared + 'a>)> {
        let ready = |of: &'_ Candidate<'a>| of.prepared.clone();
        self.candidates.iter().filter_map(move |of| Some((of.method, of.name.as_str(), ready(of)?)))
    }

    /// The settings that failed or cannot draw the scene, and why.
    pub fn refused(&self) -> impl Iterator<Item = (Method, &str, &Error)> {
        self.refused.iter().map(|(method, name, error)| (*method, *name, error))
    }

    /// Renders the view with the cheapest setting that meets an error.
    ///
    /// # Errors
    /// An input error for an error that is not above 0, and those of the renderers.
    pub fn meet(&self, view: &Camera, max_error: f64) -> Result<Met<'a>> {
        if max_error.is_nan() || max_error <= 0.0 {
            return Err(Error::input(format!("max-error is {max_error}, must be above 0")));
        }
        let mut order: Vec<(usize, u32, Tried)> = (0..self.candidates.len())
            .map(|index| {
                let (samples, tried) = self.candidates[index].predict(view, max_error, self.base.samples);
                (index, samples, tried)
            })
            .collect();
        order.sort_by(|a, b| a.2.predicted[0].total_cmp(&b.2.predicted[0]));
        let mut judges = None;
        let mut met = None;
        for (index, samples, tried) in &mut order {
            if tried.predicted[1] > max_error {
                continue;
            }
            let Candidate { method, prepared, paths, .. } = &self.candidates[*index];
            let paths = reference::Settings { samples: *samples, ..*paths };
            let prepared: Box<dyn Prepared + 'a> = match prepared {
                Some(prepared) => Box::new(prepared.clone()),
                None => paths.prepare(self.scene)?,
            };
            let rendering = prepared.view(view)?;
            // The whole path tracer knows its own error.
            let own = rendering.estimated_error().filter(|_| paths.bounces == self.base.bounces);
            let (error, meets) = match own {
                Some(error) => (error, error <= max_error),
                None => {
                    let judges = match &mut judges {
                        Some(judges) => judges,
                        None => judges.insert(Judges::new(self.scene, self.base, *view)?),
                    };
                    judges.judge(&rendering.picture, max_error)?
                }
            };
            let seconds = rendering.cost.prepare_seconds + rendering.cost.render_seconds;
            tried.actual = Some([seconds, error]);
            if meets {
                met = Some((Chosen { prepared, method: *method, note: None }, rendering));
                break;
            }
        }
        let mut tried: Vec<Tried> = order.into_iter().map(|(.., tried)| tried).collect();
        let (mut chosen, rendering) = match met {
            Some(met) => met,
            None => {
                let paths = reference::Settings { max_error: Some(max_error), ..self.base };
                let prepared = paths.prepare(self.scene)?;
                let rendering = prepared.view(view)?;
                let seconds = rendering.cost.prepare_seconds + rendering.cost.render_seconds;
                tried.push(Tried {
                    method: Method::Reference,
                    name: "until its variance meets the error".into(),
                    predicted: [f64::NAN; 2],
                    actual: Some([seconds, rendering.estimated_error().unwrap_or(f64::NAN)]),
                });
                (Chosen { prepared, method: Method::Reference, note: None }, rendering)
            }
        };
        chosen.note = self.refused.last().map(|(.., error)| error.to_string());
        Ok(Met { chosen, rendering, tried })
    }

    /// The three pictures that judge a view; the last has twice the samples.
    fn judges(&self, view: &Camera, samples: u32) -> Result<[Picture; 3]> {
        let picture = |k, samples| Ok(judge(&self.base, k, samples).render(self.scene, view)?.picture);
        Ok([picture(1, samples)?, picture(2, samples)?, picture(3, 2 * samples)?])
    }
}

impl Candidate<'_> {
    /// Samples a pixel that meet an error, at most `limit`, and what is predicted with them.
    fn predict(&self, view: &Camera, max_error: f64, limit: u32) -> (u32, Tried) {
        let pixels = f64::from(view.width) * f64::from(view.height);
        let mut tried = Tried {
            method: self.method,
            name: self.name.clone(),
            predicted: [self.prepare_seconds + self.view_seconds + self.seconds * pixels, self.bias],
            actual: None,
        };
        if self.prepared.is_some() {
            return (0, tried);
        }
        // Below a bias that is too large no number of samples helps: as many as for twice the bias are shown.
        let room =
            if self.bias < max_error { max_error.powi(2) - self.bias.powi(2) } else { self.bias.powi(2) };
        let needed = (RESERVE * self.noise * self.noise / room).ceil().max(f64::from(LEAST_SAMPLES));
        let samples = (needed.min(f64::from(limit)) as u32).next_multiple_of(PASSES);
        let count = f64::from(samples);
        tried.name += &format!("{samples} samples");
        tried.predicted = [
            self.prepare_seconds + self.seconds * pixels * count,
            (self.bias.powi(2) + self.noise * self.noise / count).sqrt(),
        ];
        (samples, tried)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Background, Light, Material, Object, shapes};
    use lobelia_reflectance::{LobeBrdf, Rgb};
    use std::sync::Arc;

    /// A grey plane under a lamp: one reflection is all there is.
    fn plane() -> Scene {
        Scene {
            objects: vec![Object {
                name: "plane".into(),
                mesh: Arc::new(shapes::plane(1)),
                transform: glam::Affine3A::IDENTITY,
                material: Material::uniform(LobeBrdf::diffuse(Rgb::splat(0.5))),
            }],
            lights: vec![Light::Point { position: glam::Vec3::Y * 2.0, intensity: Rgb::ONE }],
            environment: None,
            background: Background::Colour(Rgb::splat(0.1)),
            camera: Camera {
                position: glam::Vec3::new(0.0, 3.0, 0.5),
                target: glam::Vec3::ZERO,
                up: glam::Vec3::Z,
                fov: 0.8,
                width: 32,
                height: 24,
            },
            animation: None,
            exposure: 1.0,
        }
    }

    #[test]
    fn a_loose_bound_takes_little_a_tight_one_more_and_both_are_met() {
        let scene = plane();
        let base = reference::Settings { samples: 1 << 20, seed: 5, ..Default::default() };
        let truth = judge(&base, 9, 256).render(&scene, &scene.camera).unwrap().picture;
        for max_error in [0.3, 0.02] {
            let outcome = Model::measure(&scene, &Settings { reference: base, ..Settings::default() })
                .unwrap()
                .meet(&scene.camera, max_error)
                .unwrap();
            let error = compare::compare(&outcome.rendering.picture, &truth).unwrap().relative_rmse;
            let last = taken(&outcome.tried).unwrap();
            assert!(error < 1.1 * max_error, "{error} for {max_error}: {:?}", outcome.tried);
            assert!(last.method == outcome.chosen.method && last.actual.unwrap()[1] <= max_error);
        }
    }

    #[test]
    fn interreflection_is_left_out_only_where_the_bound_allows_it() {
        // In a white furnace one reflection less shows.
        let mut scene = plane();
        scene.objects.push(scene.objects[0].clone());
        scene.objects[1].transform = glam::Affine3A::from_rotation_x(-1.2);
        let base = reference::Settings { samples: 1 << 20, seed: 5, ..Default::default() };
        let model = Model::measure(&scene, &Settings { reference: base, ..Settings::default() }).unwrap();
        let bias = model.candidates[1].bias;
        assert!(bias > 0.02 && model.candidates[0].bias == 0.0, "{bias}");
        let outcome = model.meet(&scene.camera, 0.5 * bias).unwrap();
        assert_eq!(outcome.chosen.method, Method::Reference);
        assert!(outcome.rendering.estimated_error().unwrap() <= 0.5 * bias);
        assert!(
            outcome.tried.iter().all(|tried| tried.actual.is_none() || !tried.name.starts_with("no inter"))
        );
    }
}
