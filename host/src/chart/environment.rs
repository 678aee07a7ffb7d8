//! Prefiltered environments: their maps against quadrature by exponent, and pictures by them against the path
//! tracer by exponent and by angle (stability case G13: wide lobes near the horizon).

use std::sync::Arc;
use std::time::Instant;

use glam::{Affine3A, Vec3};

use super::{Axis, Chart, Picture, Plot, Section, Series, Table};
use crate::error::Result;
use crate::progress;
use crate::reflectance::{Lobe, LobeBrdf, Rgb};
use crate::render::choose;
use crate::render::compare::relative_rmse_by;
use crate::render::environment::quadrature::{DIRECTIONS, MAP_EXPONENTS, Truth};
use crate::render::environment::{Encoding, Prefiltered, Settings};
use crate::render::{self, Renderer, reference};
use crate::scene::{Background, Camera, Environment, Material, Object, Scene, shapes};

/// Exponents of the ball's lobe.
const EXPONENTS: [f32; 13] = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 20.0, 50.0, 100.0];
/// Those that are shown by angle.
const BY_ANGLE: [f32; 4] = [1.0, 3.0, 10.0, 50.0];
/// Samples a pixel of each of the pictures that judge.
const SAMPLES: u32 = 128;
/// That of the pictures.
const SHOWN: f32 = 3.0;
/// Widths of the classes of angles, degrees.
const CLASS_DEG: f32 = 10.0;

/// Judges the maps and the pictures of environments at a relative error of the maps, with pictures of so many
/// pixels a row.
///
/// # Errors
/// Input errors for settings out of range.
pub fn chart(environments: &[(String, Environment)], map_error: f32, width: u32, seed: u64) -> Result<Chart> {
    let settings = Settings { map_error, seed, ..Settings::default() };
    let pictures = environments.len() * EXPONENTS.len();
    let bar = progress::bar("environment", (3 * environments.len() + pictures) as u64, "steps");
    let mut sections = vec![maps(environments, &settings, &bar)?];
    for (name, environment) in environments {
        sections.push(images(name, environment, &settings, width, &bar)?);
    }
    Ok(Chart {
        name: "environment".into(),
        title: "Prefiltered environments".into(),
        lead: format!(
            "Errors are relative, the difference over √(b² + ε²), b the truth and ε a tenth of its mean. \
             Maps are made for an error of {} %.",
            100.0 * map_error
        ),
        sections,
    })
}

/// The maps by exponent.
fn maps(environments: &[(String, Environment)], settings: &Settings, bar: &progress::Bar) -> Result<Section> {
    let mut table =
        Table::new(["environment", "encoding", "maps", "MB", "seconds", "RMS, worst n", "largest"]);
    let mut plots = Vec::new();
    let mut truths = Vec::new();
    for (_, environment) in environments {
        truths.push(MAP_EXPONENTS.map(|n| Truth::new(environment, n, DIRECTIONS)));
        bar.advance(1);
    }
    for (encoding, name) in [(Encoding::Slices, "slices"), (Encoding::Mips, "MIP levels")] {
        let mut series = Vec::new();
        for ((place, environment), truths) in environments.iter().zip(&truths) {
            let start = Instant::now();
            let maps = Prefiltered::on_cpu(environment, (1.0, 1000.0), encoding, settings.map_error)?;
            let seconds = start.elapsed().as_secs_f64();
            let errors = truths.each_ref().map(|truth| truth.error(&maps));
            let most = |values: [f64; 12]| values.into_iter().fold(0.0, f64::max);
            table.row([
                place.as_str().into(),
                name.into(),
                maps.exponents().count().into(),
                (maps.bytes() as f64 / 1e6).into(),
                seconds.into(),
                most(errors.map(|error| error.rms)).into(),
                most(errors.map(|error| error.largest)).into(),
            ]);
            let points = MAP_EXPONENTS.iter().zip(errors).map(|(&n, error)| [f64::from(n), error.rms]);
            series.push(Series::new(place.as_str(), points.collect()));
            bar.advance(1);
        }
        plots.push(Plot {
            title: format!("Error of the maps by exponent: {name}"),
            x: Axis::log("exponent n"),
            y: Axis::log("relative RMS error"),
            series,
        });
    }
    Ok(Section {
        title: "Maps against quadrature".into(),
        text: format!(
            "S(ω, n) from the maps for n from 1 to 1000, against midpoint quadrature of the bilinear image \
             in {DIRECTIONS} directions, half of them anywhere and half about the brightest light. Memory \
             and time are those of all maps, D(N) included."
        ),
        plots,
        tables: vec![table],
        ..Section::default()
    })
}

/// A grey ball with one lobe of an exponent in an environment, before black.
fn ball(environment: &Environment, n: f32, width: u32) -> Scene {
    let lobe = Lobe::new(Rgb::splat((n + 2.0) / std::f32::consts::TAU), Vec3::new(-1.0, -1.0, 1.0), n);
    let brdf = LobeBrdf { lobes: vec![lobe], ..LobeBrdf::default() };
    Scene {
        objects: vec![Object {
            name: "ball".into(),
            mesh: Arc::new(shapes::sphere(256, 128)),
            transform: Affine3A::IDENTITY,
            material: Material::uniform(brdf),
        }],
        lights: vec![],
        environment: Some(environment.clone()),
        background: Background::Colour(Rgb::ZERO),
        camera: Camera {
            position: Vec3::new(0.0, 1.5, 6.0),
            target: Vec3::ZERO,
            up: Vec3::Y,
            fov: 0.34,
            width,
            height: width,
        },
        animation: None,
        parameters: vec![],
        exposure: 1.0,
    }
}

/// The angle between normal and view on the unit ball at every pixel's centre, degrees; none beside it.
fn angles(camera: &Camera) -> Vec<Option<f32>> {
    let [right, up, forward] = camera.basis();
    let scale = (camera.fov / 2.0).tan();
    let at = |index: u32, size: u32| ((index as f32 + 0.5) / size as f32 * 2.0 - 1.0) * scale;
    let angle = |index: u32| {
        let (x, y) = (at(index % camera.width, camera.width), at(index / camera.width, camera.height));
        let direction = (forward + right * x - up * y).normalize();
        let nearest = camera.position.dot(direction);
        let inside = nearest * nearest - camera.position.length_squared() + 1.0;
        // The cosine is that of the half chord.
        (inside > 0.0).then(|| inside.sqrt().min(1.0).acos().to_degrees())
    };
    (0..camera.width * camera.height).map(angle).collect()
}

/// Pictures of one environment by exponent and angle.
fn images(
    name: &str,
    environment: &Environment,
    settings: &Settings,
    width: u32,
    bar: &progress::Bar,
) -> Result<Section> {
    let variants = [
        ("corrected", *settings),
        ("cosine at the peak", Settings { horizon: false, ..*settings }),
        ("corrected, MIP levels", Settings { encoding: Encoding::Mips, ..*settings }),
    ];
    let mut by_exponent: [Vec<[f64; 2]>; 3] = Default::default();
    let mut by_angle = Vec::new();
    let mut exponents = Table::new(["n", "corrected", "cosine at the peak", "corrected, MIP levels"]);
    let mut pictures = Vec::new();
    for n in EXPONENTS {
        let scene = ball(environment, n, width);
        let angles = angles(&scene.camera);
        let judges = judges(&scene, settings.seed)?;
        let mut errors = [0.0; 3];
        for (k, (variant, settings)) in variants.iter().enumerate() {
            let picture = settings.render(&scene, &scene.camera)?.picture;
            let error = |low: f32, high: f32| error_between(&judges, &picture, &angles, low..high);
            errors[k] = error(0.0, 90.0);
            by_exponent[k].push([f64::from(n), errors[k]]);
            if k < 2 && BY_ANGLE.contains(&n) {
                let classes = (0..9).map(|class| CLASS_DEG * class as f32);
                let points = classes.map(|low| [f64::from(low + 5.0), error(low, low + CLASS_DEG)]);
                let short = ["corrected", "peak's cosine"][k];
                by_angle.push(Series::new(format!("n = {n}, {short}"), points.collect()));
            }
            if k < 2 && n == SHOWN {
                let truth = &judges[2];
                let exposure = 0.5 / truth.rgb(width as usize / 2, width as usize / 2).max_element();
                if k == 0 {
                    pictures.push(shown(format!("n = {n}, the path tracer"), truth, exposure)?);
                }
                pictures.push(shown(format!("n = {n}, {variant}"), &picture, exposure)?);
            }
        }
        let [corrected, peak, mips] = errors.map(Into::into);
        exponents.row([f64::from(n).into(), corrected, peak, mips]);
        bar.advance(1);
    }
    let by_exponent =
        variants.iter().zip(by_exponent).map(|((variant, _), points)| Series::new(*variant, points));
    let mut angles = Table::new(["", "5°", "15°", "25°", "35°", "45°", "55°", "65°", "75°", "85°"]);
    for Series { name, points, .. } in &by_angle {
        let error = |class: usize| points[class][1].into();
        angles.row::<10>(std::array::from_fn(|k| if k == 0 { name.as_str().into() } else { error(k - 1) }));
    }
    Ok(Section {
        title: format!("Pictures: {name}"),
        text: format!(
            "A ball with one lobe, C = (−1, −1, 1), rendered by the maps and by the path tracer: relative \
             RMSE over its pixels, estimated by three pictures of the path tracer with {SAMPLES} samples a \
             pixel, so that their noise cancels (a dash where it does not). “Cosine at the peak” is (6.18) \
             as published; “corrected” takes factor, centroid and width of the lobe above the horizon."
        ),
        plots: vec![
            Plot {
                title: "By exponent".into(),
                x: Axis::log("exponent n"),
                y: Axis::log("relative RMSE"),
                series: by_exponent.collect(),
            },
            Plot {
                title: "By angle".into(),
                x: Axis::linear("angle between view and normal, degrees"),
                y: Axis::log("relative RMSE"),
                series: by_angle,
            },
        ],
        pictures,
        tables: vec![exponents, angles],
    })
}

/// Three pictures by the path tracer whose noise cancels in [`relative_rmse_by`].
fn judges(scene: &Scene, seed: u64) -> Result<[render::Picture; 3]> {
    let picture = |k: u64| {
        let judge = reference::Settings { samples: SAMPLES, bounces: 1, seed, ..Default::default() };
        Ok(choose::judge(&judge, k, SAMPLES).render(scene, &scene.camera)?.picture)
    };
    Ok([picture(1)?, picture(2)?, picture(3)?])
}

/// The relative RMSE over the pixels that lie all within the ball and at an angle of a range, ε by their
/// mean; NaN where noise drowns it.
fn error_between(
    judges: &[render::Picture; 3],
    picture: &render::Picture,
    angles: &[Option<f32>],
    range: std::ops::Range<f32>,
) -> f64 {
    let inside = |&index: &usize| {
        let whole = |picture: &render::Picture| picture.pixels[index].w > 0.99;
        angles[index].is_some_and(|angle| range.contains(&angle))
            && whole(picture)
            && judges.iter().all(whole)
    };
    let kept: Vec<usize> = (0..angles.len()).filter(inside).collect();
    let part = |picture: &render::Picture| {
        let pixels: Vec<_> = kept.iter().map(|&index| picture.pixels[index]).collect();
        render::Picture { width: pixels.len(), height: 1, pixels }
    };
    let error = relative_rmse_by(&judges.each_ref().map(part), &part(picture));
    if error > 0.0 { error } else { f64::NAN }
}

fn shown(title: String, picture: &render::Picture, exposure: f32) -> Result<Picture> {
    Ok(Picture { title, png: picture.png(exposure)? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_centre_of_the_ball_is_seen_at_no_angle_and_its_rim_at_ninety_degrees() {
        let environment = Environment::uniform(Rgb::ONE);
        let camera = ball(&environment, 1.0, 65).camera;
        let angles = angles(&camera);
        assert!(angles[32 * 65 + 32].unwrap() < 0.5);
        let largest = angles.iter().flatten().copied().fold(0.0, f32::max);
        assert!(largest > 80.0 && angles[0].is_none(), "{largest}");
    }

    #[test]
    fn in_even_light_the_correction_leaves_noise_alone_and_the_peak_s_cosine_does_not() {
        let environment = Environment::uniform(Rgb::ONE);
        let settings = Settings { map_error: 0.1, ..Settings::default() };
        let scene = ball(&environment, 2.0, 16);
        let (judges, angles) = (judges(&scene, 0).unwrap(), angles(&scene.camera));
        let error = |settings: Settings| {
            let picture = settings.render(&scene, &scene.camera).unwrap().picture;
            error_between(&judges, &picture, &angles, 0.0..90.0)
        };
        let (corrected, peak) = (error(settings), error(Settings { horizon: false, ..settings }));
        // Drowned by noise is small enough.
        assert!((corrected.is_nan() || corrected < 0.03) && peak > 0.1, "{corrected} {peak}");
    }
}
