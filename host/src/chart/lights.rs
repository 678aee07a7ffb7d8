//! Frames per second of `lights` by lobes, lights, pixels, filter, shadows and storage: the shape of
//! McAllister's table 6.1.

use std::sync::Arc;

use glam::Vec3;

use super::{Axis, Chart, Plot, Section, Series, Table};
use crate::error::Result;
use crate::progress;
use crate::random::Random;
use crate::reflectance::{Lobe, LobeBrdf, Rgb};
use crate::render::lights::{Filtering, Settings};
use crate::render::storage::Storage;
use crate::scene::{Light, Reflectance, Scene, showcase};

/// Times that each measurement is repeated; the least counts.
const ROUNDS: u32 = 3;
/// Most lobes and lights.
const MOST: usize = 8;
/// Frames per second of the source at 800 × 600 with two samples a pixel on a GeForce 4: a row a number of
/// lights, a column a number of lobes.
const PUBLISHED: [[f64; 3]; 3] = [[50.7, 29.5, 20.8], [29.4, 16.2, 11.1], [20.8, 11.1, 7.57]];

/// What the source's renderer did: neither shadows nor MIP levels.
const PLAIN: Settings = Settings {
    samples: 4,
    filtering: Filtering::Finest,
    anisotropy: 16,
    storage: Storage::F32,
    shadows: false,
    light_samples: 1,
};

/// The scene with a map of `lobes` lobes a texel on every object, all maps different, and with `count`
/// lights.
fn prepared(scene: &Scene, lobes: usize, count: usize) -> Scene {
    let mut scene = scene.clone();
    let mut random = Random::new(lobes as u64);
    for object in &mut scene.objects {
        let maps = [(); 2].map(|()| brdf(lobes, &mut random));
        object.material.reflectance = Reflectance::Map(showcase::check(&maps[0], &maps[1], 2, 32).into());
        object.material.filter = crate::scene::Filter::Bilinear;
        object.material.levels.clear();
    }
    let light = |k: usize| {
        let (sin, cos) = (k as f32 * 2.4).sin_cos();
        let position = Vec3::new(3.0 * sin, 2.5, 2.5 + 1.5 * cos);
        Light::Point { position, intensity: Rgb::splat(8.0 / count as f32) }
    };
    scene.lights = (0..count).map(light).collect();
    scene
}

/// A BRDF with a number of lobes.
fn brdf(lobes: usize, random: &mut Random) -> LobeBrdf {
    let mut number = |low: f64, high: f64| random.uniform(low, high) as f32;
    let lobe = |_| {
        Lobe::new(
            Rgb::new(number(0.1, 0.4), number(0.1, 0.4), number(0.1, 0.4)) / lobes as f32,
            Vec3::new(-1.0, -1.0, number(0.9, 1.0)),
            number(2.0, 60.0),
        )
    };
    let lobes = (0..lobes).map(lobe).collect();
    LobeBrdf { rho_d: Rgb::splat(0.15), lobes, ..LobeBrdf::default() }
}

/// Measures frames of a scene.
struct Meter<'a> {
    scene: &'a Scene,
    frames: u32,
    bar: progress::Bar,
    adapter: String,
}

impl Meter<'_> {
    /// Seconds a frame.
    fn seconds(&mut self, settings: Settings, scene: &Scene) -> Result<f64> {
        let (seconds, adapter) = settings.frame_seconds(scene, ROUNDS, self.frames)?;
        self.bar.advance(1);
        self.adapter = adapter;
        Ok(seconds)
    }

    /// Seconds a frame without shadows and MIP levels.
    fn plain(&mut self, lobes: usize, lights: usize) -> Result<f64> {
        let scene = prepared(self.scene, lobes, lights);
        self.seconds(PLAIN, &scene)
    }
}

/// Measures `frames` frames at a time of a scene.
///
/// # Errors
/// Those of the scene, and failures of the GPU.
pub fn chart(scene: &Scene, frames: u32) -> Result<Chart> {
    let bar = progress::bar("lights", 9 + 2 + 2 + 4 + 9, "measurements");
    let mut meter = Meter { scene, frames, bar, adapter: String::new() };
    let triangles: usize = scene.objects.iter().map(|object| object.mesh.triangles.len()).sum();
    let (published, seconds) = published_shape(&mut meter)?;
    let sections = vec![published, scaling(&mut meter, &seconds)?, features(&mut meter)?];
    Ok(Chart {
        name: "lights".into(),
        title: "Speed of the lights renderer".into(),
        lead: format!(
            "{triangles} triangles in {} objects, each with a map of its own, at {} × {} pixels and four \
             samples a pixel where nothing else is said. The least of {ROUNDS} times {frames} frames, of \
             fewer where they take over a second, without reading pictures back, on {}. Of a driver in \
             software seconds are CPU time, and only ratios count.",
            scene.objects.len(),
            scene.camera.width,
            scene.camera.height,
            meter.adapter
        ),
        sections,
    })
}

/// One to three lobes by one to three lights, and the seconds of that.
fn published_shape(meter: &mut Meter<'_>) -> Result<(Section, [[f64; 3]; 3])> {
    let mut seconds = [[0.0; 3]; 3];
    for (lights, row) in seconds.iter_mut().enumerate() {
        for (lobes, cell) in row.iter_mut().enumerate() {
            *cell = meter.plain(lobes + 1, lights + 1)?;
        }
    }
    let columns = ["lights", "1 lobe", "2 lobes", "3 lobes"];
    let table = |of: &dyn Fn(usize, usize) -> f64| {
        let mut table = Table::new(columns);
        for lights in 0..3 {
            let [one, two, three] = [0, 1, 2].map(|lobes| of(lights, lobes).into());
            table.row([(lights + 1).into(), one, two, three]);
        }
        table
    };
    let section = Section {
        title: "Lobes and lights".into(),
        text:
            "Frames per second; then frames per second over those of one lobe and one light; then the same \
             ratio of the source's GeForce 4 (261,549 triangles, 800 × 600, two samples a pixel). Without \
             shadows and MIP levels, as there."
                .into(),
        tables: vec![
            table(&|lights, lobes| 1.0 / seconds[lights][lobes]),
            table(&|lights, lobes| seconds[0][0] / seconds[lights][lobes]),
            table(&|lights, lobes| PUBLISHED[lights][lobes] / PUBLISHED[0][0]),
        ],
        ..Section::default()
    };
    Ok((section, seconds))
}

/// Milliseconds a frame by lobes, lights and pixels.
fn scaling(meter: &mut Meter<'_>, known: &[[f64; 3]; 3]) -> Result<Section> {
    let milliseconds = |count: usize, seconds: f64| [count as f64, 1e3 * seconds];
    let mut lobes: Vec<_> = (0..3).map(|k| milliseconds(k + 1, known[0][k])).collect();
    let mut lights: Vec<_> = (0..3).map(|k| milliseconds(k + 1, known[k][0])).collect();
    for count in [4, MOST] {
        lobes.push(milliseconds(count, meter.plain(count, 1)?));
        lights.push(milliseconds(count, meter.plain(1, count)?));
    }
    let mut pixels = vec![];
    let mut scene = prepared(meter.scene, 2, 2);
    let [width, height] = [scene.camera.width, scene.camera.height];
    for part in [4, 2, 1] {
        (scene.camera.width, scene.camera.height) = ((width / part).max(1), (height / part).max(1));
        let count = (scene.camera.width * scene.camera.height) as usize;
        pixels.push(milliseconds(count, meter.seconds(PLAIN, &scene)?));
    }
    (scene.camera.width, scene.camera.height) = (2 * width, 2 * height);
    pixels.push(milliseconds((4 * width * height) as usize, meter.seconds(PLAIN, &scene)?));
    let mut table = Table::new(["by", "count", "ms a frame"]);
    for (name, points) in [("lobes", &lobes), ("lights", &lights), ("pixels", &pixels)] {
        points.iter().for_each(|&[count, ms]| table.row([name.into(), (count as usize).into(), ms.into()]));
    }
    let plot =
        |title: &str, x, series| Plot { title: title.into(), x, y: Axis::linear("ms a frame"), series };
    Ok(Section {
        title: "Scaling".into(),
        text:
            "By lobes with one light, by lights with one lobe, by pixels with two of each. What is left at \
             no pixels and no lights is the triangles' part."
                .into(),
        plots: vec![
            plot(
                "By lobes and lights",
                Axis::linear("lobes, lights"),
                vec![Series::new("lobes", lobes), Series::new("lights", lights)],
            ),
            plot("By pixels", Axis::linear("pixels"), vec![Series::new("two lobes, two lights", pixels)]),
        ],
        tables: vec![table],
        ..Section::default()
    })
}

/// What filters, shadows and storage cost with two lobes and two lights.
fn features(meter: &mut Meter<'_>) -> Result<Section> {
    let mut scene = prepared(meter.scene, 2, 2);
    let plain = meter.seconds(PLAIN, &scene)?;
    let mut table = Table::new(["setting", "ms a frame", "over the first"]);
    table.row(["finest level, no shadows, f32".into(), (1e3 * plain).into(), 1.0.into()]);
    let filter = |filtering| Settings { filtering, ..PLAIN };
    let store = |storage| Settings { storage, ..PLAIN };
    // Levels once for all.
    for object in &mut scene.objects {
        if let Reflectance::Map(map) = &object.material.reflectance {
            object.material.levels = crate::edit::levels::all_fitted(map).into_iter().map(Arc::new).collect();
        }
    }
    for (name, settings) in [
        ("MIP levels of averaged coefficients", filter(Filtering::Coefficients)),
        ("fitted MIP levels", filter(Filtering::Fitted)),
        ("shade, then filter", filter(Filtering::Shaded)),
        ("shadows", Settings { shadows: true, ..PLAIN }),
        ("one sample a pixel", Settings { samples: 1, ..PLAIN }),
        ("f16", store(Storage::F16)),
        ("8 bits, as published", store(Storage::Bits8)),
        ("8 bits, C scaled, log n", store(Storage::Bits8Scaled)),
    ] {
        let seconds = meter.seconds(settings, &scene)?;
        table.row([name.into(), (1e3 * seconds).into(), (seconds / plain).into()]);
    }
    Ok(Section {
        title: "What a setting costs".into(),
        text: "Two lobes, two lights; each row changes one thing of the first.".into(),
        tables: vec![table],
        ..Section::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn the_gallery_is_as_large_as_the_source_s_scene_and_has_the_lobes_and_lights_asked_for() {
        let gallery = Scene::open(Path::new("gallery")).unwrap();
        let triangles: usize = gallery.objects.iter().map(|object| object.mesh.triangles.len()).sum();
        assert!(triangles >= 250_000 && gallery.objects.len() == 12, "{triangles}");
        let scene = prepared(&gallery, 3, 2);
        assert_eq!(scene.lights.len(), 2);
        assert!(scene.objects.iter().all(|object| object.material.brdfs().all(|brdf| brdf.lobes.len() == 3)));
    }

    #[test]
    fn every_measurement_has_a_time() {
        let mut scene = Scene::open(Path::new("lamps")).unwrap();
        (scene.camera.width, scene.camera.height) = (8, 6);
        scene.objects.truncate(1);
        scene.objects[0].mesh = crate::scene::shapes::plane(2).into();
        let chart = match chart(&scene, 1) {
            Ok(chart) => chart,
            Err(error) if error.to_string().contains("no adapter") => return println!("skipped: {error}"),
            Err(error) => panic!("{error}"),
        };
        let numbers =
            |table: &Table| table.rows.iter().flatten().filter_map(super::super::number).collect::<Vec<_>>();
        for table in chart.sections.iter().flat_map(|section| &section.tables) {
            assert!(numbers(table).iter().all(|number| *number > 0.0), "{table}");
        }
        assert_eq!(numbers(&chart.sections[0].tables[1])[0], 1.0);
    }
}
