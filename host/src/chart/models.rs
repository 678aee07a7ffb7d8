//! What models beyond plain lobes are worth: materials that have tilted lobes, lobes that sharpen or a
//! microfacet term, fitted with each.

use glam::{Vec2, Vec3};

use super::{Section, Table};
use crate::error::Result;
use crate::fit::extensions::{Extensions, Microfacets};
use crate::fit::{self, FitOptions};
use crate::progress;
use crate::random::Random;
use crate::reflectance::{Brdf, Lobe, LobeBrdf, Microfacet, Rgb, SbrdfMap};
use crate::synth::{self, Options};

/// Edge of a sample, texels.
const SIDE: usize = 8;
/// Most lobes of a texel.
const LOBES: usize = 3;

/// What a material is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Plain,
    Tilted,
    Sharpening,
    Coated,
}

/// The materials with their names.
const KINDS: [(Kind, &str); 4] = [
    (Kind::Plain, "one lobe"),
    (Kind::Tilted, "one lobe, tilted by 1° to 10°"),
    (Kind::Sharpening, "one lobe, n₀ = 2 n₁ to 5 n₁"),
    (Kind::Coated, "GGX, α 0.1 to 0.4, f0 0.05"),
];

const PLAIN: Extensions = Extensions { normals: false, sharpening: false, microfacets: Microfacets::Never };

/// What may be fitted, with names.
const MODELS: [(Extensions, &str); 5] = [
    (PLAIN, "lobes"),
    (Extensions { normals: true, ..PLAIN }, "+ normals"),
    (Extensions { sharpening: true, ..PLAIN }, "+ sharpening"),
    (Extensions { microfacets: Microfacets::Choose, ..PLAIN }, "+ GGX"),
    (Extensions { normals: true, sharpening: true, microfacets: Microfacets::Choose }, "all"),
];

fn material(kind: Kind, random: &mut Random) -> LobeBrdf {
    let mut number = |low: f64, high: f64| random.uniform(low, high) as f32;
    let mut brdf = LobeBrdf::diffuse(Rgb::new(number(0.1, 0.5), number(0.1, 0.5), number(0.1, 0.5)));
    if kind == Kind::Coated {
        let alpha = number(0.1, 0.4);
        brdf.microfacets.push(Microfacet { f0: Rgb::splat(0.05), f90: Rgb::ONE, alpha });
        return brdf;
    }
    let colour = Rgb::new(number(0.3, 1.0), number(0.3, 1.0), number(0.3, 1.0));
    let across = -number(0.9, 1.0);
    let n = number(8f32.ln().into(), 60f32.ln().into()).exp();
    let mut lobe = Lobe::new(colour, Vec3::new(across, across, 1.0), n);
    match kind {
        Kind::Tilted => {
            let tilt = number(1.0, 10.0).to_radians().sin();
            brdf.normal = Vec2::from_angle(number(0.0, std::f64::consts::TAU)) * tilt;
        }
        Kind::Sharpening => lobe.n_grazing = Some(n * number(2.0, 5.0)),
        Kind::Plain | Kind::Coated => {}
    }
    brdf.lobes.push(lobe);
    brdf
}

/// Medians of the texels' errors, a row a kind and a column a model, and the share of the texels of which all
/// of what they are made of, and nothing else, was found by the last model; `done` is called a fit.
fn errors(side: usize, seed: u64, done: impl Fn()) -> Result<Vec<([f64; MODELS.len()], f64)>> {
    let mut random = Random::new(seed);
    let mut rows = Vec::new();
    for (kind, _) in KINDS {
        let truth: Vec<LobeBrdf> = (0..side * side).map(|_| material(kind, &mut random)).collect();
        let sampling = Options {
            width: side,
            height: side,
            texel_mm: 0.5,
            poses: 300,
            noise: 1e-3,
            relative_noise: 0.005,
            seed,
        };
        let sampled = synth::sample(&sampling, |index, _, wi, wo| truth[index].eval(wi, wo));
        let (mut row, mut right) = ([0.0; MODELS.len()], 0.0);
        for (error, (extensions, _)) in row.iter_mut().zip(MODELS) {
            let options = FitOptions {
                lobes: LOBES,
                choose: true,
                isotropic: false,
                extensions,
                ..FitOptions::default()
            };
            let map = fit::fit_sbrdf(&sampled, &options)?;
            let sorted = super::unposed::errors(&map, &truth, seed);
            *error = sorted[sorted.len() / 2];
            let found = (0..truth.len()).filter(|&texel| is_found(&map, texel, kind)).count();
            right = found as f64 / truth.len() as f64;
            done();
        }
        rows.push((row, right));
    }
    Ok(rows)
}

fn is_found(map: &SbrdfMap, texel: usize, kind: Kind) -> bool {
    let brdf = map.texel(texel);
    let has = (
        brdf.normal != Vec2::ZERO,
        brdf.lobes.iter().any(|lobe| lobe.n_grazing.is_some()),
        !brdf.microfacets.is_empty(),
    );
    has == (kind == Kind::Tilted, kind == Kind::Sharpening, kind == Kind::Coated)
}

/// A row a material, a column a model.
///
/// # Errors
/// As [`fit::fit_sbrdf`].
pub(super) fn section(seed: u64) -> Result<Section> {
    let bar = progress::bar("fitting", (KINDS.len() * MODELS.len()) as u64, "fits");
    let [a, b, c, d, e] = MODELS.map(|(_, name)| name);
    let mut table = Table::new(["material", a, b, c, d, e, "right with all"]);
    for ((_, name), (row, right)) in KINDS.iter().zip(errors(SIDE, seed, || bar.advance(1))?) {
        let [a, b, c, d, e] = row.map(Into::into);
        table.row([(*name).into(), a, b, c, d, e, right.into()]);
    }
    Ok(Section {
        title: "Models beyond lobes".into(),
        text: format!(
            "{} texels a material with a diffuse term and a random one of each kind (n 8 to 60), 300 random \
             poses, noise 1e-3 1/sr and 0.5 %, fitted with up to {LOBES} lobes and with what a column names, \
             each where left-out poses are predicted better with it. Median of ‖f̂ − f‖ / ‖f‖ over 300 \
             direction pairs that were not posed; last the share of the texels in which the fit with all of \
             them has what the material has and nothing else.",
            SIDE * SIDE
        ),
        tables: vec![table],
        ..Section::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_material_is_best_fitted_by_its_own_model_and_plain_ones_lose_nothing() {
        let rows = errors(3, 2, || ()).unwrap();
        for ((_, name), row) in KINDS.iter().zip(&rows) {
            println!("{name}: {row:.4?}");
        }
        let [plain, tilted, sharpening, coated] = [0, 1, 2, 3].map(|kind| rows[kind].0);
        assert!(plain.iter().all(|&error| error <= 1.05 * plain[0]), "{plain:?}");
        for (row, own) in [(tilted, 1), (sharpening, 2), (coated, 3)] {
            assert!(row[own] < 0.7 * row[0] && row[4] < 1.3 * row[own], "{row:?}");
        }
    }
}
