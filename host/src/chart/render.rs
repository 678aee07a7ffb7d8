//! Time against error of every renderer and its settings, scene by scene, judged by the reference.

use super::{Axis, Chart, Picture, Plot, Section, Series, Table};
use crate::error::{Kind, Result};
use crate::progress;
use crate::render::choose::{self, Model};
use crate::render::compare::{Errors, compare};
use crate::render::lights::Filtering;
use crate::render::storage::Storage;
use crate::render::{self, Method, Renderer, Rendering, environment, lights, reference};
use crate::scene::Scene;

/// Errors that a picture is chosen for.
const BOUNDS: [f64; 3] = [0.3, 0.1, 0.03];

/// One way to render.
struct Setting {
    method: &'static str,
    name: String,
    renderer: Box<dyn Renderer>,
}

/// The settings of one method.
#[derive(Default)]
struct Measured {
    method: &'static str,
    /// Seconds of rendering, relative RMSE and FLIP.
    values: Vec<[f64; 3]>,
    names: Vec<String>,
}

/// Every renderer with the settings that trade its time for error.
fn settings(scene: &Scene, seed: u64) -> Vec<Setting> {
    let mut all = Vec::new();
    let mut add =
        |method, name: String, renderer: Box<dyn Renderer>| all.push(Setting { method, name, renderer });
    let all_bounces = reference::Settings { seed, ..Default::default() };
    let one = reference::Settings { bounces: 1, ..all_bounces };
    for (method, paths) in [("reference", all_bounces), ("reference, no interreflection", one)] {
        for samples in [1, 4, 16, 64] {
            let renderer = reference::Settings { samples, ..paths };
            add(method, format!("{samples} samples"), Box::new(renderer));
        }
    }
    let environment = environment::Settings { seed, ..Default::default() };
    for setting in choose::settings(scene, &render::Settings { environment, ..Default::default() }) {
        if setting.method != Method::Lights {
            add(setting.method.name(), setting.name.into(), setting.renderer);
        }
    }
    // Of every method the last setting is shown.
    let base = lights::Settings::default();
    for storage in [Storage::Bits8, Storage::Bits8Scaled, Storage::F16] {
        let renderer = lights::Settings { storage, ..base };
        add("lights", format!("{}, {}", base.filtering.name(), storage.name()), Box::new(renderer));
    }
    for filtering in Filtering::ALL {
        let renderer = lights::Settings { filtering, ..base };
        add("lights", filtering.name().into(), Box::new(renderer));
    }
    all
}

/// Renders every scene with every renderer and setting, and compares with the reference at `truth` samples a pixel.
///
/// # Errors
/// Those of the scenes and of the renderers, but for a GPU that is missing.
pub fn chart(scenes: &[(String, Scene)], truth: u32, seed: u64) -> Result<Chart> {
    let sections = scenes.iter().map(|(name, scene)| section(name, scene, truth, seed));
    Ok(Chart {
        name: "render".into(),
        title: "Time against error of the renderers".into(),
        lead: format!(
            "Every scene was rendered with every renderer and setting and compared with the path tracer at {truth} samples a \
             pixel with another seed. Relative RMSE: root of the mean of (a − b)² / (b² + ε²), b the reference, ε a tenth of \
             its mean. FLIP: mean HDR-FLIP, 67 pixels a degree. The last table of every scene has what `lobelia render --method auto \
             --max-error E` takes for an error: what its model, measured on a view of 64 pixels, predicted; what it verified \
             itself, by few samples of the reference or the path tracer's own variance; and the error against this chart's reference."
        ),
        sections: sections.collect::<Result<_>>()?,
    })
}

/// One scene.
fn section(name: &str, scene: &Scene, truth: u32, seed: u64) -> Result<Section> {
    let settings = settings(scene, seed);
    let bar = progress::bar(name, settings.len() as u64 + 1, "pictures");
    let judge = reference::Settings { samples: truth, seed: seed ^ 0x5eed, ..Default::default() };
    let truth = judge.render(scene, &scene.camera)?;
    bar.advance(1);
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
    let mut measured: Vec<Measured> = Vec::new();
    let mut pictures = vec![picture("the reference", &truth, scene)?];
    let mut left_out = String::new();
    for Setting { method, name, renderer } in settings {
        let rendering = match renderer.render(scene, &scene.camera) {
            Ok(rendering) => rendering,
            Err(error) if error.kind() == Kind::Failure => {
                left_out = format!(" `{method}` was left out: {error}.");
                continue;
            }
            Err(error) => return Err(error),
        };
        bar.advance(1);
        let errors = compare(&rendering.picture, &truth.picture)?;
        let Errors { rmse, relative_rmse, flip, .. } = errors;
        let cost = &rendering.cost;
        table.row([
            method.into(),
            name.as_str().into(),
            cost.prepare_seconds.into(),
            cost.render_seconds.into(),
            (cost.memory_bytes as f64 / 1e6).into(),
            rmse.into(),
            relative_rmse.into(),
            flip.into(),
        ]);
        let shown = picture(&format!("{method}: {name}"), &rendering, scene)?;
        if measured.last().is_some_and(|last| last.method == method) {
            // Of every method the last setting is shown.
            pictures.pop();
        } else {
            measured.push(Measured { method, ..Measured::default() });
        }
        pictures.push(shown);
        if let Some(last) = measured.last_mut() {
            last.values.push([cost.render_seconds, relative_rmse, flip]);
            last.names.push(name);
        }
    }
    let plot = |title: &str, y: &str, value: usize| Plot {
        title: title.into(),
        x: Axis::log("render, s"),
        y: Axis::log(y),
        series: measured
            .iter()
            .map(|of| {
                let points = of.values.iter().map(|point| [point[0], point[value]]).collect();
                Series { labels: of.names.clone(), ..Series::new(of.method, points) }
            })
            .collect(),
    };
    let noise = truth.estimated_error().unwrap_or_default();
    Ok(Section {
        title: name.into(),
        text: format!(
            "Noise of the reference itself: at most {:.2} % relative RMSE.{left_out}",
            100.0 * noise
        ),
        plots: vec![plot("Relative RMSE by time", "relative RMSE", 1), plot("FLIP by time", "FLIP", 2)],
        pictures,
        tables: vec![table, choices(scene, &truth, seed)?],
    })
}

/// What is chosen for every bound, and how far prediction and verification are from what comes out.
fn choices(scene: &Scene, truth: &Rendering, seed: u64) -> Result<Table> {
    let mut table = Table::new([
        "E",
        "method",
        "setting",
        "predicted, s",
        "actual, s",
        "predicted relative RMSE",
        "verified",
        "actual relative RMSE",
    ]);
    for bound in BOUNDS {
        let settings = render::Settings {
            reference: reference::Settings { samples: 1 << 20, seed, ..Default::default() },
            environment: environment::Settings { seed, ..Default::default() },
            ..Default::default()
        };
        let outcome = Model::measure(scene, &settings)?.meet(&scene.camera, bound)?;
        let Some(taken) = outcome.tried.iter().rfind(|tried| tried.actual.is_some()) else { continue };
        let [seconds, verified] = taken.actual.unwrap_or([f64::NAN; 2]);
        table.row([
            bound.into(),
            taken.method.name().into(),
            taken.name.as_str().into(),
            taken.predicted[0].into(),
            seconds.into(),
            taken.predicted[1].into(),
            verified.into(),
            compare(&outcome.rendering.picture, &truth.picture)?.relative_rmse.into(),
        ]);
    }
    Ok(table)
}

/// A tone-mapped picture of the page.
fn picture(title: &str, rendering: &Rendering, scene: &Scene) -> Result<Picture> {
    Ok(Picture { title: title.into(), png: rendering.picture.png(scene.exposure)? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn every_renderer_has_a_row_and_more_samples_are_nearer_to_the_reference() {
        let mut scene = Scene::open(Path::new("studio-ball")).unwrap();
        (scene.camera.width, scene.camera.height) = (24, 18);
        let sphere = std::sync::Arc::new(crate::scene::shapes::sphere(32, 16));
        scene.objects[0].mesh = sphere;
        scene.objects[0].material = scene.objects[1].material.clone();
        scene.environment = Some(crate::scene::Environment::from_function(32, 16, |d| {
            crate::reflectance::Rgb::splat(0.6 + 0.3 * d.x + d.y.max(0.0))
        }));
        let chart = chart(&[("ball".into(), scene)], 128, 1).unwrap();
        let series = &chart.sections[0].plots[0].series;
        let errors: Vec<f64> = series[0].points.iter().map(|point| point[1]).collect();
        assert!(series.iter().any(|s| s.name == "environment") && errors.len() == 4);
        assert!(errors[3] < errors[0] / 2.0, "{errors:?}");
        assert_eq!(chart.sections[0].pictures.len(), 1 + series.len());
    }
}
