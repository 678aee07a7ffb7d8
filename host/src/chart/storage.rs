//! What a map loses when its coefficients are stored in fewer bits (stability case G15): f16 and 8 bits
//! against f32.
//!
//! A lobe's value goes as the n-th power of its base, so an error of C counts n times: what is exact enough
//! for a colour is not for C of a sharp lobe.

use std::path::Path;

use glam::{Affine3A, Quat, Vec2, Vec3};

use super::{Axis, Chart, Picture, Plot, Section, Series, Table};
use crate::edit::pairs::Pairs;
use crate::error::Result;
use crate::random::Random;
use crate::reflectance::{Brdf, Lobe, LobeBrdf, Rgb, SbrdfMap, materials};
use crate::render::compare::compare;
use crate::render::lights::{self, Filtering, cpu};
use crate::render::storage::{Storage, brightest};
use crate::scene::{Camera, Light, Material, Mesh, Object, Scene, shapes};

/// Exponents of the test lobes.
const EXPONENTS: [f32; 12] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0, 512.0, 1024.0, 2048.0];
/// Lobes an exponent.
const LOBES: usize = 48;
/// Pairs of directions that an error is taken over.
const PAIRS: usize = 512;

/// ‖f̂ − f‖ / ‖f‖ of a stored BRDF, weighted by cosθ_i cosθ_o.
fn relative_error(storage: Storage, brdf: &LobeBrdf, pairs: &Pairs) -> f64 {
    let stored = storage.stored(brdf, brightest(brdf));
    pairs.distance(&stored, brdf) / pairs.distance(brdf, &LobeBrdf::default())
}

/// A test lobe over a diffuse term, with a peak of 0.9 sr⁻¹ at θ_i = 45° that changes by less than e^1.5
/// toward grazing and normal incidence, as those of materials do.
fn test_lobe(n: f32, random: &mut Random) -> LobeBrdf {
    let most = f64::from((3.0 / n).min(0.15));
    let off = (0.5 * random.uniform(-most, most)) as f32;
    let (across, up) = (off.exp(), (-off).exp());
    let c = Vec3::new(-across, -across, up) / (0.5 * (across + up));
    let lobe = Lobe::new(Rgb::splat(0.9), c, n);
    LobeBrdf {
        rho_d: Rgb::splat(random.uniform(0.02, 0.2) as f32),
        beta: 0.0,
        lobes: vec![lobe],
        ..LobeBrdf::default()
    }
}

/// The chart.
///
/// # Errors
/// Those of the renderer.
pub fn chart(seed: u64) -> Result<Chart> {
    Ok(Chart {
        name: "storage".into(),
        title: "Storage of coefficients".into(),
        lead: "What reflectance loses when C, n and the albedos are stored in fewer bits.".into(),
        sections: vec![by_exponent(seed), published(), grazing(), banding(), pictures()?],
    })
}

fn by_exponent(seed: u64) -> Section {
    let mut table = Table::new(["storage", "bytes a texel", "n = 8", "n = 64", "n = 512"]);
    let mut series = Vec::new();
    let errors_of = |storage: Storage, n: f32| {
        let mut random = Random::new(seed);
        let square = |_| {
            let lobe = test_lobe(n, &mut random);
            relative_error(storage, &lobe, &Pairs::over([&lobe], PAIRS)).powi(2)
        };
        ((0..LOBES).map(square).sum::<f64>() / LOBES as f64).sqrt()
    };
    for storage in Storage::ALL.into_iter().skip(1) {
        let points: Vec<[f64; 2]> = EXPONENTS.map(|n| [f64::from(n), errors_of(storage, n)]).to_vec();
        let at = |n: f64| points.iter().find(|point| point[0] == n).map_or(f64::NAN, |point| point[1]);
        table.row([
            storage.name().into(),
            storage.bytes().into(),
            at(8.0).into(),
            at(64.0).into(),
            at(512.0).into(),
        ]);
        series.push(Series::new(storage.name(), points));
    }
    Section {
        title: "Error by exponent".into(),
        text: format!(
            "Relative L2 error against f32 over all pairs of directions, weighted by cosθ_i cosθ_o; root of \
             the mean square over {LOBES} lobes at random, each over a diffuse term. An error of C counts n \
             times; the published 8 bits end at n = 255."
        ),
        plots: vec![Plot {
            title: "Error by exponent".into(),
            x: Axis::log("exponent n"),
            y: Axis::log("relative L2 error"),
            series,
        }],
        tables: vec![table],
        ..Section::default()
    }
}

fn published() -> Section {
    let lossy: [Storage; 4] = std::array::from_fn(|k| Storage::ALL[k + 1]);
    let [a, b, c, d] = lossy.map(Storage::name);
    let mut table = Table::new(["material", a, b, c, d]);
    for (name, brdf) in materials::NAMES.iter().filter_map(|name| Some((*name, materials::published(name)?)))
    {
        let pairs = Pairs::over([&brdf], PAIRS);
        let [a, b, c, d] = lossy.map(|storage| relative_error(storage, &brdf, &pairs).into());
        table.row([name.into(), a, b, c, d]);
    }
    Section {
        title: "Published materials".into(),
        text: "The same error of the six materials that Lafortune et al. published. Their C reaches −2.7, \
             which −1..1 cuts off; scaled, ρ_s is each lobe's peak."
            .into(),
        tables: vec![table],
        ..Section::default()
    }
}

/// In the mirror direction, where a lobe with |Cx| > 1 grows toward grazing angles and a clamped one does
/// not.
fn grazing() -> Section {
    let lobe = Lobe::new(Rgb::splat(0.3), Vec3::new(-1.04, -1.04, 0.94), 40.0);
    let brdf = LobeBrdf { rho_d: Rgb::splat(0.05), beta: 0.0, lobes: vec![lobe], ..LobeBrdf::default() };
    let angles: Vec<f32> = (0..=44).map(|k| 2.0 * k as f32).collect();
    let curve = |storage: Storage| {
        let stored = storage.stored(&brdf, brightest(&brdf));
        let at = |theta_deg: &f32| {
            let (sin, cos) = theta_deg.to_radians().sin_cos();
            let f = stored.eval(Vec3::new(sin, 0.0, cos), Vec3::new(-sin, 0.0, cos)).x;
            [f64::from(*theta_deg), f64::from(f)]
        };
        Series::new(storage.name(), angles.iter().map(at).collect())
    };
    let series: Vec<Series> = Storage::ALL.map(curve).to_vec();
    let mut table = Table::new(["storage", "sr⁻¹ at 0°", "sr⁻¹ at 60°", "sr⁻¹ at 88°"]);
    for one in &series {
        table.row([
            one.name.as_str().into(),
            one.points[0][1].into(),
            one.points[30][1].into(),
            one.points[44][1].into(),
        ]);
    }
    Section {
        title: "Grazing angles".into(),
        text: "A lobe of C = (−1.04, −1.04, 0.94), n = 40 in the mirror direction. Where C is clamped at ±1 \
             the brightness at grazing angles is lost."
            .into(),
        plots: vec![Plot {
            title: "Reflectance in the mirror direction".into(),
            x: Axis::linear("angle of incidence, °"),
            y: Axis::log("reflectance, sr⁻¹"),
            series,
        }],
        tables: vec![table],
        ..Section::default()
    }
}

/// Across a map whose exponent rises slowly.
fn banding() -> Section {
    const TEXELS: usize = 256;
    let texel = |k: usize| {
        let n = 2.0 + 8.0 * k as f32 / (TEXELS - 1) as f32;
        let lobe = Lobe::new(Rgb::splat(0.3), Vec3::new(-1.0, -1.0, 1.0), n);
        LobeBrdf { rho_d: Rgb::splat(0.02), beta: 0.0, lobes: vec![lobe], ..LobeBrdf::default() }
    };
    let (wi, wo) = (Vec3::new(0.5, 0.0, 0.75f32.sqrt()), Vec3::Z);
    let mut table = Table::new(["storage", "values in 256 texels", "largest step, % of the value"]);
    let mut series = Vec::new();
    for storage in Storage::ALL {
        let values: Vec<f32> = (0..TEXELS).map(|k| storage.stored(&texel(k), 0.3).eval(wi, wo).x).collect();
        let mut distinct = values.clone();
        distinct.dedup();
        let step =
            values.windows(2).map(|pair| f64::from((pair[1] - pair[0]).abs() / pair[0])).fold(0.0, f64::max);
        table.row([storage.name().into(), distinct.len().into(), (100.0 * step).into()]);
        let point = |(k, &value): (usize, &f32)| [k as f64, f64::from(value)];
        series.push(Series::new(storage.name(), values.iter().enumerate().step_by(4).map(point).collect()));
    }
    Section {
        title: "Banding".into(),
        text: "A map of 256 texels whose exponent rises from 2 to 10, lit from 30° and seen from above: few \
             values of n make bands, which the eye sees from steps of about 1 %."
            .into(),
        plots: vec![Plot {
            title: "Reflectance along the map".into(),
            x: Axis::linear("texel"),
            y: Axis::linear("reflectance, sr⁻¹"),
            series,
        }],
        tables: vec![table],
        ..Section::default()
    }
}

/// A scene where both artefacts show: a floor whose lobe grows toward grazing angles, seen against the light,
/// and a ball whose exponent rises from 2 to 10 around it.
fn showing_artefacts() -> Result<Scene> {
    let mut scene = Scene::open(Path::new("lamps"))?;
    let shiny = |rho_d: f32, c: [f32; 3], n: f32| LobeBrdf {
        lobes: vec![Lobe::new(Rgb::splat(0.3), c.into(), n)],
        ..LobeBrdf::diffuse(Rgb::splat(rho_d))
    };
    let texel = |k: usize| shiny(0.06, [-1.0, -1.0, 1.0], 2.0 + 8.0 * k as f32 / 255.0);
    let ramp = SbrdfMap::from_texels(256, 1, &(0..256).map(texel).collect::<Vec<_>>());
    let object = |name: &str, mesh: Mesh, transform, material| Object {
        name: name.into(),
        mesh: mesh.into(),
        transform,
        material,
    };
    let (floor, turn) = (shiny(0.15, [-1.04, -1.04, 0.94], 40.0), Quat::from_rotation_y(-1.2));
    let ball = Affine3A::from_scale_rotation_translation(Vec3::splat(0.5), turn, Vec3::new(0.0, 0.5, 0.0));
    scene.objects = vec![
        object("floor", shapes::plane(1), Affine3A::from_scale(Vec3::splat(8.0)), Material::uniform(floor)),
        object("ball", shapes::sphere(192, 96), ball, Material::map(ramp.into(), Vec2::ONE)),
    ];
    scene.lights = vec![
        Light::Directional { toward: Vec3::new(0.35, 0.28, -1.0).normalize(), irradiance: Rgb::splat(0.8) },
        Light::Directional { toward: Vec3::new(-0.6, 0.8, 0.7).normalize(), irradiance: Rgb::splat(1.6) },
    ];
    scene.camera = Camera {
        position: Vec3::new(0.0, 0.9, 3.2),
        target: Vec3::new(0.0, 0.35, 0.0),
        up: Vec3::Y,
        fov: 32f32.to_radians(),
        width: 320,
        height: 240,
    };
    Ok(scene)
}

/// The artefacts in pictures.
fn pictures() -> Result<Section> {
    let scene = showing_artefacts()?;
    let render = |storage| {
        cpu::render(&scene, &lights::Settings { storage, filtering: Filtering::Finest, ..Default::default() })
    };
    let exact = render(Storage::F32)?;
    let mut table = Table::new(["storage", "relative RMSE", "FLIP"]);
    let mut pictures = vec![];
    for storage in Storage::ALL {
        let picture = render(storage)?;
        let errors = compare(&picture, &exact)?;
        table.row([storage.name().into(), errors.relative_rmse.into(), errors.flip.into()]);
        pictures.push(Picture { title: storage.name().into(), png: picture.png(scene.exposure)? });
    }
    Ok(Section {
        title: "In pictures".into(),
        text:
            "The renderer `lights` with each storage, against f32: the floor is the lobe of the section on \
             grazing angles, seen against the light, and the ball's exponent rises from 2 to 10 around it. \
             `lobelia render --method lights --storage` does the same to any scene."
                .into(),
        pictures,
        tables: vec![table],
        ..Section::default()
    })
}

#[cfg(test)]
mod tests {
    use super::super::number;
    use super::*;
    use exr::prelude::f16;

    fn lobe(cx: f32, cz: f32, n: f32) -> LobeBrdf {
        let lobe = Lobe::new(Rgb::splat(0.3), Vec3::new(cx, cx, cz), n);
        LobeBrdf { rho_d: Rgb::splat(0.1), beta: 0.0, lobes: vec![lobe], ..LobeBrdf::default() }
    }

    #[test]
    fn an_error_of_c_counts_n_times() {
        // Straight above the base is Cz.
        let (exact, n) = (lobe(-1.0, 0.9, 500.0), 500.0);
        let shape = |brdf: &LobeBrdf| f64::from(brdf.lobes[0].base(Vec3::Z, Vec3::Z)).powf(n);
        let error = f64::from(f16::from_f32(0.9).to_f32()) / f64::from(0.9f32) - 1.0;
        let ratio = shape(&Storage::F16.stored(&exact, 1.0)) / shape(&exact);
        assert!(
            ((ratio - 1.0) / (n * error) - 1.0).abs() < 0.1 && (ratio - 1.0).abs() > 0.05,
            "{ratio} {error}"
        );
    }

    #[test]
    fn more_bits_and_a_scaled_c_lose_less() {
        let chart = chart(1).unwrap();
        let errors = |name: &str| -> Vec<f64> {
            let series = &chart.sections[0].plots[0].series;
            series
                .iter()
                .find(|series| series.name == name)
                .unwrap()
                .points
                .iter()
                .map(|point| point[1])
                .collect()
        };
        let (half, scaled) = (errors("f16"), errors("f16, C scaled"));
        let (bits, bits_scaled) = (errors("8 bits, as published"), errors("8 bits, C scaled, log n"));
        for k in 0..EXPONENTS.len() {
            assert!(half[k] < bits[k] && scaled[k] < bits_scaled[k], "n {}", EXPONENTS[k]);
        }
        // Sharp lobes: f16 loses more the sharper they are.
        assert!(half[9] > 5.0 * half[5]);
        // And so it is in pictures.
        let seen: Vec<f64> =
            chart.sections[4].tables[0].rows.iter().filter_map(|row| number(&row[1])).collect();
        let [exact, half, _, published, _] = seen[..] else { panic!("{seen:?}") };
        assert!(exact == 0.0 && half < 0.01 && published > 0.05, "{seen:?}");
    }
}
