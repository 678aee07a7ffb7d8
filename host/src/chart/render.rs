//! Time against error of every renderer and its settings, scene by scene, judged by the reference.

use super::{Axis, Cell, Chart, Picture, Plot, Section, Series, Table};
use crate::error::{Error, Kind, Result};
use crate::progress;
use crate::render::choose::{Model, Tried, Work, taken};
use crate::render::compare::{Errors, compare};
use crate::render::{self, METHODS, Method, Player, Renderer, Rendering, environment, reference};
use crate::scene::Scene;

/// Errors that a picture is chosen for.
const BOUNDS: [f64; 3] = [0.3, 0.1, 0.03];
/// Relative RMSE at which the reference that judges has samples enough.
const TRUTH_NOISE: f64 = 0.01;

/// One way to render a scene's view.
struct Setting<'a> {
    method: &'static str,
    name: String,
    render: Box<dyn FnMut() -> Result<Rendering> + 'a>,
}

/// The settings of one method.
#[derive(Default)]
struct Measured {
    method: &'static str,
    /// Seconds of rendering, relative RMSE and FLIP.
    values: Vec<[f64; 3]>,
    names: Vec<String>,
    /// The picture with the least error.
    best: Option<(f64, Picture)>,
}

/// What came of one scene's settings.
struct Measurements {
    table: Table,
    methods: Vec<Measured>,
    /// Why settings were left out, a sentence each.
    reasons: Vec<String>,
}

/// What one scene adds to the page.
struct OfScene {
    section: Section,
    /// Rows of the table of choices, without the scene's name.
    choices: Vec<[Cell; 8]>,
    /// Predicted and actual error, predicted and actual seconds.
    outcomes: Vec<[f64; 4]>,
}

/// Every method with the settings that trade its time for error; what the model has made ready is not made
/// again.
fn settings<'a>(scene: &'a Scene, model: &Model<'a>, base: &render::Settings) -> Vec<Setting<'a>> {
    let mut all = Vec::new();
    for method in &METHODS {
        for variant in (method.variants)(scene, base).into_iter().filter(|variant| !variant.weighed) {
            let render = Box::new(move || variant.renderer.render(scene, &scene.camera));
            all.push(Setting { method: variant.series, name: variant.name, render });
        }
        for (_, name, mut player) in model.ready().filter(|(of, ..)| *of == method) {
            let render = Box::new(move || player.frame(&scene.state()));
            all.push(Setting { method: method.name, name: name.into(), render });
        }
    }
    all
}

/// Renders every scene with every renderer and setting, and compares with the reference at `truth` samples a
/// pixel at most.
///
/// # Errors
/// Those of the scenes and of the path tracer. Another renderer that fails, or refuses a scene, is left out.
pub fn chart(scenes: &[(String, Scene)], truth: u32, seed: u64) -> Result<Chart> {
    let of_scene = |(name, scene): &(String, Scene)| section(name, scene, truth, seed);
    let scenes_charted = scenes.iter().map(of_scene).collect::<Result<Vec<_>>>()?;
    let mut sections = vec![choices(scenes, &scenes_charted)];
    sections.extend(scenes_charted.into_iter().map(|scene| scene.section));
    Ok(Chart {
        name: "render".into(),
        title: "Time against error of the renderers".into(),
        lead: format!(
            "Every scene was rendered with every renderer and setting and compared with the path tracer with \
             another seed, at {truth} samples a pixel or where its own noise is {} % relative RMSE. Relative \
             RMSE: root of the mean of (a − b)² / (b² + ε²), b the reference, ε a tenth of its mean. FLIP: \
             mean HDR-FLIP, 67 pixels a degree. Times are of one view of a scene that is ready; getting it \
             ready is listed beside.",
            100.0 * TRUTH_NOISE
        ),
        sections,
    })
}

/// What is chosen for an error, over all scenes.
fn choices(scenes: &[(String, Scene)], charted: &[OfScene]) -> Section {
    let mut table = Table::new([
        "scene",
        "E",
        "method",
        "setting",
        "predicted, s",
        "actual, s",
        "predicted relative RMSE",
        "verified",
        "actual relative RMSE",
    ]);
    let (mut errors, mut seconds) = (Vec::new(), Vec::new());
    for ((name, _), OfScene { choices, outcomes, .. }) in scenes.iter().zip(charted) {
        for row in choices {
            let cell = |k: usize| if k == 0 { name.as_str().into() } else { row[k - 1].clone() };
            table.row::<9>(std::array::from_fn(cell));
        }
        let labels = || BOUNDS.iter().map(|bound| format!("{name}, E = {bound}")).collect();
        let pairs = |at: usize| outcomes.iter().map(|outcome| [outcome[at], outcome[at + 1]]).collect();
        errors.push(Series::scattered(name.as_str(), pairs(0), labels()));
        seconds.push(Series::scattered(name.as_str(), pairs(2), labels()));
    }
    let plot = |quantity: &str, series: Vec<Series>| Plot {
        title: format!("{quantity}: predicted and actual"),
        x: Axis::log(&format!("{quantity}, predicted")),
        y: Axis::log(&format!("{quantity}, actual")),
        series,
    };
    Section {
        title: "Chosen for an error".into(),
        text: "What lobelia render --max-error E takes: what its model, measured on a view of 64 pixels, \
             predicted; what it verified itself, by few samples of the reference or the path tracer's own \
             variance; and the error against this chart's reference."
            .into(),
        plots: vec![plot("relative RMSE", errors), plot("time, s", seconds)],
        tables: vec![table],
        ..Section::default()
    }
}

/// One scene.
fn section(name: &str, scene: &Scene, truth: u32, seed: u64) -> Result<OfScene> {
    let base = base(truth, seed);
    let model = model(scene, &base)?;
    let judge = reference::Settings {
        samples: truth,
        max_error: Some(TRUTH_NOISE),
        seed: seed ^ 0x5eed,
        ..Default::default()
    };
    let truth = judge.render(scene, &scene.camera)?;
    let Measurements { table, methods, reasons } =
        measure(name, scene, &truth, settings(scene, &model, &base), model.refused())?;
    let noise = truth.estimated_error().unwrap_or_default();
    let text = format!(
        "Noise of the reference itself: at most {:.2} % relative RMSE.{}",
        100.0 * noise,
        reasons.concat()
    );
    let plots = vec![
        plot("Relative RMSE by time", "relative RMSE", &methods, 1),
        plot("FLIP by time", "FLIP", &methods, 2),
    ];
    let mut pictures = vec![picture("the reference", &truth, scene)?];
    pictures.extend(methods.into_iter().filter_map(|of| of.best).map(|(_, picture)| picture));
    let section = Section { title: name.into(), text, plots, pictures, tables: vec![table] };
    let (mut choices, mut outcomes) = (Vec::new(), Vec::new());
    for bound in BOUNDS {
        if let Some((row, outcome)) = choice(scene, &model, &truth, bound)? {
            choices.push(row);
            outcomes.push(outcome);
        }
    }
    Ok(OfScene { section, choices, outcomes })
}

/// Settings of all methods; the path tracer takes no more samples than what judges it.
fn base(truth: u32, seed: u64) -> render::Settings {
    render::Settings {
        reference: reference::Settings { samples: truth, seed, ..Default::default() },
        environment: environment::Settings { seed, ..Default::default() },
        ..Default::default()
    }
}

/// Times and errors by which a setting is chosen.
fn model<'a>(scene: &'a Scene, base: &render::Settings) -> Result<Model<'a>> {
    let least = BOUNDS.into_iter().reduce(f64::min);
    Model::measure(scene, base, &Work { max_error: least, ..Work::ONCE })
}

/// Renders a scene with every setting and compares; what fails or is refused is left out of the plots.
fn measure<'a>(
    name: &str,
    scene: &Scene,
    truth: &Rendering,
    settings: Vec<Setting<'_>>,
    refused: impl Iterator<Item = (&'static Method, &'a str, &'a Error)>,
) -> Result<Measurements> {
    let mut table = Table::new([
        "renderer",
        "setting",
        "prepare, s",
        "render, s",
        "memory, MB",
        "RMSE",
        "relative RMSE",
        "FLIP",
    ]);
    let mut methods: Vec<Measured> = Vec::new();
    let mut left_out: Vec<(&str, String, Error)> =
        refused.map(|(method, name, error)| (method.name, name.into(), error.clone())).collect();
    let bar = progress::bar(name, settings.len() as u64, "pictures");
    for Setting { method, name, mut render } in settings {
        bar.advance(1);
        let rendering = match render() {
            Ok(rendering) => rendering,
            Err(error) => {
                left_out.push((method, name, error));
                continue;
            }
        };
        let Errors { rmse, relative_rmse, flip, .. } = compare(&rendering.picture, &truth.picture)?;
        let cost = &rendering.cost;
        let memory = cost.memory_bytes as f64 / 1e6;
        let prepare = cost.bake_seconds + cost.prepare_seconds;
        let numbers = [prepare, cost.render_seconds, memory, rmse, relative_rmse, flip].map(Cell::from);
        table.row(row(method, name.clone(), numbers));
        if methods.last().is_none_or(|last| last.method != method) {
            methods.push(Measured { method, ..Measured::default() });
        }
        if let Some(last) = methods.last_mut() {
            if last.best.as_ref().is_none_or(|(error, _)| relative_rmse < *error) {
                last.best = Some((relative_rmse, picture(&format!("{method}: {name}"), &rendering, scene)?));
            }
            last.values.push([cost.render_seconds, relative_rmse, flip]);
            last.names.push(name);
        }
    }
    let mut reasons: Vec<String> = Vec::new();
    for (method, name, error) in left_out {
        let why = if error.kind() == Kind::Input { "not for this scene" } else { "failed" };
        table.row(row(method, format!("{name}: {why}"), [f64::NAN; 6].map(Cell::from)));
        let reason = format!(" `{method}`: {error}.");
        if !reasons.contains(&reason) {
            reasons.push(reason);
        }
    }
    Ok(Measurements { table, methods, reasons })
}

/// A row of the table of one scene.
fn row(method: &str, setting: String, [a, b, c, d, e, f]: [Cell; 6]) -> [Cell; 8] {
    [method.into(), setting.into(), a, b, c, d, e, f]
}

/// A value of every setting by its time; a line joins what differs in samples alone.
fn plot(title: &str, y: &str, measured: &[Measured], value: usize) -> Plot {
    let series = |of: &Measured| {
        let points = of.values.iter().map(|point| [point[0], point[value]]).collect();
        let line = of.method.starts_with("reference");
        Series { labels: of.names.clone(), line, ..Series::new(of.method, points) }
    };
    Plot {
        title: title.into(),
        x: Axis::log("render, s"),
        y: Axis::log(y),
        series: measured.iter().map(series).collect(),
    }
}

/// What is chosen for a bound, and how far prediction and verification are from what comes out.
fn choice(
    scene: &Scene,
    model: &Model<'_>,
    truth: &Rendering,
    bound: f64,
) -> Result<Option<([Cell; 8], [f64; 4])>> {
    let outcome = model.meet(&scene.state(), bound)?;
    let Some(Tried { method, name, predicted, actual: Some([seconds, verified]), .. }) =
        taken(&outcome.tried)
    else {
        return Ok(None);
    };
    let error = compare(&outcome.rendering.picture, &truth.picture)?.relative_rmse;
    let cells = [
        bound.into(),
        method.name.into(),
        name.as_str().into(),
        predicted[0].into(),
        (*seconds).into(),
        predicted[1].into(),
        (*verified).into(),
        error.into(),
    ];
    Ok(Some((cells, [predicted[1], error, predicted[0], *seconds])))
}

/// A tone-mapped picture of the page.
fn picture(title: &str, rendering: &Rendering, scene: &Scene) -> Result<Picture> {
    Ok(Picture { title: title.into(), png: rendering.picture.png(scene.exposure)? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reflectance::Rgb;
    use std::path::Path;

    #[test]
    fn every_renderer_has_a_row_and_more_samples_are_nearer_to_the_reference() {
        let mut scene = Scene::open(Path::new("studio-ball")).unwrap();
        (scene.camera.width, scene.camera.height) = (24, 18);
        let sphere = std::sync::Arc::new(crate::scene::shapes::sphere(32, 16));
        scene.objects[0].mesh = sphere;
        scene.objects[0].material = scene.objects[1].material.clone();
        scene.environment = Some(crate::scene::Environment::from_function(32, 16, |d| {
            Rgb::splat(0.6 + 0.3 * d.x + d.y.max(0.0))
        }));
        let base = base(128, 1);
        let model = model(&scene, &base).unwrap();
        let mut all = settings(&scene, &model, &base);
        // The raster's variants have tests of their own, and a driver in software takes seconds for each.
        all.retain(|setting| setting.method != "lights");
        let judge = reference::Settings { samples: 128, seed: 7, ..Default::default() };
        let truth = judge.render(&scene, &scene.camera).unwrap();
        let methods = measure("ball", &scene, &truth, all, model.refused()).unwrap().methods;
        let errors: Vec<f64> = methods[0].values.iter().map(|value| value[1]).collect();
        assert!(methods.iter().any(|of| of.method == "environment") && errors.len() == 4);
        assert!(errors[3] < errors[0] / 2.0, "{errors:?}");
        assert!(methods.iter().all(|of| of.best.is_some()));
        for bound in BOUNDS {
            let (_, [_, error, ..]) = choice(&scene, &model, &truth, bound).unwrap().unwrap();
            // The truth has some noise of its own.
            assert!(error < 1.5 * bound + 0.02, "{error} for {bound}");
        }
    }

    #[test]
    fn choices_of_all_scenes_stand_in_one_table() {
        let charted = OfScene {
            section: Section::default(),
            choices: vec![["0.1", "lights", "shaded", "1", "2", "0.03", "0.04", "0.05"].map(Cell::from)],
            outcomes: vec![[0.03, 0.05, 1.0, 2.0]],
        };
        let scene = Scene::open(Path::new("lamps")).unwrap();
        let section = choices(&[("lamps".into(), scene)], &[charted]);
        let table = section.tables[0].to_string();
        assert!(table.contains("lamps  0.1  lights  shaded"), "{table}");
        assert_eq!(section.plots[0].series[0].points, [[0.03, 0.05]]);
        assert_eq!(section.plots[1].series[0].points, [[1.0, 2.0]]);
    }

    #[test]
    fn a_setting_that_refuses_the_scene_is_said_to_and_does_not_stop_the_chart() {
        let mut scene = Scene::open(Path::new("lamps")).unwrap();
        (scene.camera.width, scene.camera.height) = (8, 6);
        let settings = reference::Settings { samples: 1, ..Default::default() };
        let render = || settings.render(&scene, &scene.camera);
        let refuse = || Err(Error::input("too many lamps"));
        let all = vec![
            Setting { method: "one", name: "a".into(), render: Box::new(refuse) },
            Setting { method: "two", name: "b".into(), render: Box::new(render) },
        ];
        let measured = measure("lamps", &scene, &render().unwrap(), all, std::iter::empty()).unwrap();
        let table = measured.table.to_string();
        assert!(table.contains("a: not for this scene") && measured.reasons == [" `one`: too many lamps."]);
        assert_eq!(measured.methods.len(), 1);
        assert_eq!(measured.methods[0].values[0][1], 0.0);
    }
}
