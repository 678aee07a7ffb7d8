//! G8: grazing poses up to 85°, and what the cut at 75° and 65° is worth.

use glam::{DVec3, Vec3};

use super::{percent, quantile, sampled};
use crate::chart::unposed::relative_error;
use crate::chart::{Axis, Cell, Plot, Section, Series, Table};
use crate::distance::{MAX_THETA_I_DEG, MAX_THETA_O_DEG};
use crate::error::Result;
use crate::fit::{self, AlbedoBound, FitOptions};
use crate::progress;
use crate::random::Random;
use crate::reflectance::{Brdf, Lobe, LobeBrdf, Microfacet, Rgb, albedo};
use crate::sampled::{PoseGeometry, SampledSbrdf};
use crate::synth::{self, DISTANCE_MM};

/// Edge of a sample, texels of a random material each.
const SIDE: usize = 8;
/// Poses.
const POSES: usize = 300;
/// Largest θ_i and θ_o of the poses, degrees.
const CUTS_DEG: [[f64; 2]; 2] = [[MAX_THETA_I_DEG, MAX_THETA_O_DEG], [85.0, 85.0]];
/// Standard deviation of the directions, degrees.
const OFF_DEG: f64 = 0.2;
/// Noise of radiance over the light's normal irradiance, sr⁻¹, and as a share of the value.
const NOISE: [f64; 2] = [1e-3, 0.005];
/// Bounds of the larger of θ_i and θ_o by which errors are told, degrees.
const ANGLES_DEG: [f64; 7] = [0.0, 30.0, 50.0, 65.0, 75.0, 80.0, 85.0];
/// Bins that the bounds make.
const BINS: usize = ANGLES_DEG.len() - 1;
/// Direction pairs a bin.
const PAIRS: usize = 200;
/// Incidence at which albedos are judged, degrees, and the largest that counts as no more than 1.
const GRAZING_DEG: f64 = 80.0;
const MOST_ALBEDO: f32 = 1.02;

/// What the materials are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    One,
    Two,
    Sharpening,
    Coated,
}

const KINDS: [(Kind, &str); 4] = [
    (Kind::One, "one lobe"),
    (Kind::Two, "two lobes"),
    (Kind::Sharpening, "a lobe that sharpens"),
    (Kind::Coated, "GGX, f0 0.05"),
];

/// The fits that are compared: lobes, whether their number is a choice, what albedos are held to.
const FITS: [(usize, bool, AlbedoBound, &str); 4] = [
    (1, false, AlbedoBound::Bounded, "1 lobe"),
    (2, false, AlbedoBound::Bounded, "2 lobes"),
    (2, false, AlbedoBound::Free, "2 lobes, albedos free"),
    (fit::MOST_LOBES, true, AlbedoBound::Bounded, "auto"),
];

/// Errors of one fit.
#[derive(Debug, Clone, Copy)]
struct Found {
    /// Median over the texels of ‖f̂ − f‖ / ‖f‖ within each bin.
    median: [f64; BINS],
    /// Percent of the texels with a directional albedo above 1 at 80°, and of those that were held to 1
    /// somewhere.
    energy: f64,
    bounded: f64,
}

/// Errors by angle, material, cut and fit.
///
/// # Errors
/// As [`fit::fit_sbrdf`].
pub(super) fn section(seed: u64) -> Result<Section> {
    let bar = progress::bar("grazing", (KINDS.len() * CUTS_DEG.len() * FITS.len()) as u64, "fits");
    let mut table = Table::new([
        "material",
        "poses up to θ_i, θ_o",
        "fit",
        "error, %: 0–30°",
        "30–50°",
        "50–65°",
        "65–75°",
        "75–80°",
        "80–85°",
        "albedo above 1 at 80°, %",
        "bounded, %",
    ]);
    let (mut plots, mut sentences) = (Vec::new(), String::new());
    for (kind, name) in KINDS {
        let mut series = Vec::new();
        let mut worst = [[0.0; 2]; 2];
        for (cut, limits) in CUTS_DEG.iter().enumerate() {
            let found = judged(kind, *limits, SIDE, seed, || bar.advance(1))?;
            for (&(_, _, _, fit), found) in FITS.iter().zip(&found) {
                let mut row: Vec<Cell> =
                    vec![name.into(), format!("{}°, {}°", limits[0], limits[1]).into(), fit.into()];
                row.extend(found.median.iter().map(|error| Cell::from(100.0 * error)));
                row.extend([found.energy.into(), found.bounded.into()]);
                table.rows.push(row);
            }
            let points = |found: &Found| {
                (0..BINS)
                    .map(|bin| [0.5 * (ANGLES_DEG[bin] + ANGLES_DEG[bin + 1]), 100.0 * found.median[bin]])
                    .collect()
            };
            for fit in [0, 3] {
                series.push(Series::new(format!("{}, to {}°", FITS[fit].3, limits[0]), points(&found[fit])));
            }
            worst[cut] = [100.0 * found[3].median[2], 100.0 * found[3].median[BINS - 1]];
        }
        let [[cut_inside, cut_beyond], [all_inside, all_beyond]] = worst;
        sentences += &format!(
            "{name}, auto: {cut_inside:.2} % at 50° to 65° and {cut_beyond:.2} % at 80° to 85° with the cut, \
             {all_inside:.2} and {all_beyond:.2} % without. "
        );
        plots.push(Plot {
            title: format!("Error by angle: {name}"),
            x: Axis::linear("larger of θ_i and θ_o, °"),
            y: Axis::log("median error, %"),
            series,
        });
    }
    Ok(Section {
        title: "Grazing poses and the cut at 75° and 65° (G8)".into(),
        text: format!(
            "{} random materials a kind, none of which makes light, {POSES} random poses up to the polar \
             angles named, directions off by {OFF_DEG}° (as a pose's own error would put them), irradiance \
             reckoned with the wrong cosine, noise {:e} 1/sr of radiance, which 1/cosθ_i blows up, and {} %; \
             the default residual. Error: median over the texels of ‖f̂ − f‖ / ‖f‖ over {PAIRS} direction \
             pairs whose larger polar angle lies in the bin. {sentences}The cut keeps noisy grazing samples \
             out, at the price that nothing was measured beyond it: the error there is the model's own \
             guess. No warning tells a guess from a measurement but one: `bounded` marks texels whose albedo \
             had to be held to 1, and without that bound the last column but one counts those above it at \
             {GRAZING_DEG}°.",
            SIDE * SIDE,
            NOISE[0],
            100.0 * NOISE[1]
        ),
        plots,
        tables: vec![table],
        ..Section::default()
    })
}

fn material(kind: Kind, random: &mut Random) -> LobeBrdf {
    match kind {
        Kind::One => synth::material(1, random),
        Kind::Two => synth::material(2, random),
        Kind::Sharpening => {
            let mut brdf = synth::material(1, random);
            let lobe = Lobe { n_grazing: None, ..brdf.lobes[0] }.normalised();
            let n = random.uniform(8f64.ln(), 60f64.ln()).exp() as f32;
            let c = Vec3::new(-0.95, -0.95, 1.0);
            let sharper = Some(n * random.uniform(2.0, 5.0) as f32);
            brdf.lobes[0] = Lobe { c, n, n_grazing: sharper, ..lobe };
            brdf
        }
        Kind::Coated => {
            let mut number = |low: f64, high: f64| random.uniform(low, high) as f32;
            let mut brdf = LobeBrdf::diffuse(Rgb::new(number(0.1, 0.5), number(0.1, 0.5), number(0.1, 0.5)));
            let alpha = number(0.1, 0.4);
            brdf.microfacets.push(Microfacet { f0: Rgb::splat(0.05), f90: Rgb::ONE, alpha });
            brdf
        }
    }
}

/// A random direction, uniform in solid angle up to a polar angle.
fn direction(most_deg: f64, random: &mut Random) -> DVec3 {
    let z = random.uniform(most_deg.to_radians().cos(), 1.0);
    at(z, random)
}

/// A random direction of a polar angle's cosine.
fn at(z: f64, random: &mut Random) -> DVec3 {
    let (sin, cos) = random.uniform(0.0, std::f64::consts::TAU).sin_cos();
    let r = (1.0 - z * z).sqrt();
    DVec3::new(r * cos, r * sin, z)
}

/// Samples of the materials as a rig takes them whose directions are off.
fn measured(truth: &[LobeBrdf], [most_i, most_o]: [f64; 2], side: usize, seed: u64) -> SampledSbrdf {
    let mut random = Random::new(seed);
    let poses = (0..POSES).map(|_| PoseGeometry {
        light_mm: DISTANCE_MM * direction(most_i, &mut random),
        camera_mm: DISTANCE_MM * direction(most_o, &mut random),
        weight: 1.0,
    });
    sampled(poses.collect(), side, 0.5, seed, |texel, _, wi, wo, random| {
        let mut off = |direction: Vec3| {
            let mut turn = || (random.normal() * OFF_DEG.to_radians()) as f32;
            let (u, v) = direction.any_orthonormal_pair();
            (direction + u * turn() + v * turn()).normalize()
        };
        let (true_wi, true_wo) = (off(wi), off(wo));
        let radiance = truth[texel].eval(true_wi, true_wo) * true_wi.z.max(0.0);
        let mut noisy = |value: f32| {
            let share = 1.0 + NOISE[1] * random.normal();
            (f64::from(value) * share + NOISE[0] * random.normal()) as f32
        };
        Rgb::new(noisy(radiance.x), noisy(radiance.y), noisy(radiance.z)) / wi.z
    })
}

/// Pairs of directions a bin of their larger polar angle.
fn pairs(seed: u64) -> [Vec<(Vec3, Vec3)>; BINS] {
    let mut random = Random::new(seed ^ 0x6772_617a);
    std::array::from_fn(|bin| {
        let mut pair = || {
            let larger_deg = random.uniform(ANGLES_DEG[bin], ANGLES_DEG[bin + 1]);
            let larger = at(larger_deg.to_radians().cos(), &mut random).as_vec3();
            let smaller = direction(larger_deg, &mut random).as_vec3();
            if random.uniform(0.0, 1.0) < 0.5 { (larger, smaller) } else { (smaller, larger) }
        };
        (0..PAIRS).map(|_| pair()).collect()
    })
}

fn judged(kind: Kind, limits: [f64; 2], side: usize, seed: u64, done: impl Fn()) -> Result<Vec<Found>> {
    let mut random = Random::new(seed);
    let truth: Vec<LobeBrdf> =
        (0..side * side).map(|_| super::physical(material(kind, &mut random))).collect();
    let sampled = measured(&truth, limits, side, seed);
    let pairs = pairs(seed);
    let of = |&(lobes, choose, bound, _): &(usize, bool, AlbedoBound, &str)| {
        let map = fit::fit_sbrdf(&sampled, &FitOptions { lobes, choose, bound, ..FitOptions::default() })?;
        let median = std::array::from_fn(|bin| {
            let errors: Vec<f64> = truth
                .iter()
                .enumerate()
                .map(|(texel, truth)| relative_error(&map, texel, truth, &pairs[bin]))
                .collect();
            quantile(&errors, 0.5)
        });
        let (sin, cos) = (GRAZING_DEG as f32).to_radians().sin_cos();
        let above = (0..truth.len()).map(|texel| {
            albedo::directional(&map.texel(texel), Vec3::new(sin, 0.0, cos)).max_element() > MOST_ALBEDO
        });
        let bounded = map.extra.get("bounded");
        let bounded = bounded.map_or(f64::NAN, |plane| percent(plane.iter().map(|&bounded| bounded > 0.0)));
        let found = Found { median, energy: percent(above), bounded };
        done();
        Ok(found)
    };
    FITS.iter().map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_the_models_own_guess_beyond_the_cone_and_the_bound_keeps_albedos() {
        let coated = judged(Kind::Coated, CUTS_DEG[0], 4, 1, || ()).unwrap();
        println!("{coated:?}");
        // One lobe cannot be Fresnel's rise.
        assert!(coated[0].median[BINS - 1] > 2.0 * coated[0].median[1]);
        let [bounded, free] = [coated[1], coated[2]];
        assert!(bounded.energy == 0.0 && free.bounded.is_nan());
        let plain = judged(Kind::One, CUTS_DEG[0], 4, 1, || ()).unwrap();
        println!("{plain:?}");
        assert!(plain[0].median[..4].iter().all(|&error| error < 0.05));
    }

    #[test]
    fn pairs_lie_in_their_bins() {
        for (bin, pairs) in pairs(1).iter().enumerate() {
            let larger = |&(wi, wo): &(Vec3, Vec3)| f64::from(wi.z.min(wo.z)).acos().to_degrees();
            let inside = |deg: f64| deg > ANGLES_DEG[bin] - 0.01 && deg < ANGLES_DEG[bin + 1] + 0.01;
            assert!(pairs.iter().map(larger).all(inside));
        }
    }
}
