//! The failure atlas of fits: each method where it breaks, a section a numbered case of the specification
//! (section 8), and what it said then.

mod bound;
mod diffuse;
mod exponent;
mod grazing;
mod noise;
mod sharpening;
mod starts;
#[cfg(feature = "sim")]
mod weave;

use glam::Vec3;
use rayon::prelude::*;

use super::{Cell, Chart};
use crate::error::Result;
use crate::random::Random;
use crate::reflectance::{Brdf, Lobe, LobeBrdf, Rgb, SbrdfMap, albedo};
use crate::sampled::{PoseGeometry, SampledSbrdf};
use crate::synth::{self, Options};

/// Poses where their number is not the question.
const POSES: usize = 456;
/// Edge of texels so small that all have the same directions, mm.
const TINY_MM: f64 = 1e-6;
/// Largest albedo of a material that is made up.
const MOST_ALBEDO: f32 = 0.98;
/// A lobe is recovered if n is within this share of the truth …
const NEAR: f64 = 0.3;
/// … and the direction of C within this angle, degrees.
const NEAR_DEG: f64 = 5.0;

/// Runs every case.
///
/// # Errors
/// When a folder for the simulated rig's run cannot be had.
pub fn fit(seed: u64) -> Result<Chart> {
    let mut sections = noise::sections(seed)?;
    sections.push(bound::section(seed, false)?);
    sections.push(bound::section(seed, true)?);
    sections.push(exponent::section(seed)?);
    sections.push(starts::section(seed)?);
    sections.push(diffuse::section(seed)?);
    #[cfg(feature = "sim")]
    sections.push(weave::section(seed)?);
    sections.push(grazing::section(seed)?);
    sections.push(sharpening::section(seed)?);
    Ok(Chart {
        name: "stability-fit".into(),
        title: "Where fits break".into(),
        lead: format!(
            "Known materials, made harder until a method breaks: noise, sharp lobes, many lobes, a diffuse \
             term that cannot be seen, badly registered photographs, grazing poses, materials that are no \
             lobes. A lobe counts as recovered if its n is within {} % of the truth and the direction of its \
             C within {NEAR_DEG}°. No unbiased fit can have a smaller variance than the Cramér–Rao bound; \
             one that is far above it, or far off where it says that it is not, cannot be trusted.",
            100.0 * NEAR
        ),
        sections,
    })
}

/// The same texel with new normal noise (sr⁻¹) `side` × `side` times.
fn repeats(poses: Vec<PoseGeometry>, side: usize, truth: &LobeBrdf, noise: f64, seed: u64) -> SampledSbrdf {
    let options = Options {
        width: side,
        height: side,
        texel_mm: TINY_MM,
        poses: poses.len(),
        noise,
        relative_noise: 0.0,
        seed,
    };
    synth::sample_at(poses, &options, |_, _, wi, wo| truth.eval(wi, wo))
}

/// What `value` makes of texel, pose, its directions and random numbers that are the texel's own.
fn sampled(
    poses: Vec<PoseGeometry>,
    side: usize,
    texel_mm: f64,
    seed: u64,
    value: impl Fn(usize, usize, Vec3, Vec3, &mut Random) -> Rgb + Sync,
) -> SampledSbrdf {
    let mut sampled = SampledSbrdf::empty(side, side, texel_mm, poses);
    let mut values = std::mem::take(&mut sampled.reflectance);
    values.par_chunks_mut(3 * sampled.poses.len()).enumerate().for_each(|(texel, values)| {
        let mut random = Random::new(Random::new(seed).bits() ^ texel as u64);
        for (pose, rgb) in values.chunks_exact_mut(3).enumerate() {
            let (wi, wo) = sampled.directions(texel, pose);
            rgb.copy_from_slice(&value(texel, pose, wi, wo, &mut random).to_array());
        }
    });
    sampled.reflectance = values;
    sampled
}

/// The material, darkened where it would make light from some direction.
fn physical(mut brdf: LobeBrdf) -> LobeBrdf {
    let scale = (MOST_ALBEDO / albedo::largest(&brdf).max_element()).min(1.0);
    brdf.rho_d *= scale;
    brdf.lobes.iter_mut().for_each(|lobe| lobe.rho_s *= scale);
    for microfacet in &mut brdf.microfacets {
        (microfacet.f0, microfacet.f90) = (microfacet.f0 * scale, microfacet.f90 * scale);
    }
    brdf
}

/// Whether a fit's first exponent is near the true one.
fn near(found: &LobeBrdf, truth: &Lobe) -> bool {
    found.lobes.first().is_some_and(|lobe| f64::from((lobe.n / truth.n - 1.0).abs()) <= NEAR)
}

/// The angle between C of a fit's first lobe and the true one, degrees; 180 without a lobe.
fn off_deg(found: &LobeBrdf, truth: &Lobe) -> f64 {
    found.lobes.first().map_or(180.0, |lobe| f64::from(lobe.c.angle_between(truth.c)).to_degrees())
}

/// Whether a fit's first lobe is the true one.
fn recovered(found: &LobeBrdf, truth: &Lobe) -> bool {
    near(found, truth) && off_deg(found, truth) <= NEAR_DEG
}

/// Whether a fit itself says that a texel's first exponent cannot be trusted to 30 %: by its stated deviation
/// or because a prior decided it. Methods that state nothing never say so.
fn warned(map: &SbrdfMap, texel: usize) -> bool {
    let of = |name: &str| map.extra.get(name).map(|plane| f64::from(plane[texel]));
    let n = map.lobes.first().map_or(0.0, |lobe| f64::from(lobe.n[texel]));
    of("sigma.lobe0.n").is_some_and(|sigma| sigma > NEAR * n) || of("tied").is_some_and(|tied| tied > 0.0)
}

/// The value below which `share` of a list lies, NaN of an empty one.
fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(((sorted.len().max(1) - 1) as f64 * share).round() as usize).copied().unwrap_or(f64::NAN)
}

/// The share of a list of truths, percent; NaN of an empty one.
fn percent(truths: impl IntoIterator<Item = bool>) -> f64 {
    let (mut count, mut all) = (0.0, 0.0);
    for truth in truths {
        (count, all) = (count + f64::from(u8::from(truth)), all + 1.0);
    }
    100.0 * count / all
}

/// Percents as a cell of text, so that a dash can stand for what a method does not state.
fn percent_cell(percent: f64) -> Cell {
    if percent.is_nan() { "–".into() } else { format!("{percent:.0}").into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lobe_is_recovered_within_thirty_percent_of_n_and_five_degrees() {
        let truth = Lobe::new(Rgb::ONE, Vec3::new(-1.0, -1.0, 1.0), 10.0);
        let with =
            |c: Vec3, n: f32| LobeBrdf { lobes: vec![Lobe::new(Rgb::ONE, c, n)], ..Default::default() };
        assert!(recovered(&with(Vec3::new(-2.0, -2.0, 2.1), 12.9), &truth));
        assert!(!recovered(&with(truth.c, 6.9), &truth) && !recovered(&with(truth.c, 13.1), &truth));
        assert!(!recovered(&with(Vec3::new(-1.0, -1.0, 1.25), 10.0), &truth));
        assert!(!recovered(&LobeBrdf::default(), &truth));
    }

    #[test]
    fn a_physical_material_makes_no_light_and_a_dark_one_stays_as_it_is() {
        let with = |rho_s: f32| LobeBrdf {
            lobes: vec![Lobe::new(Rgb::splat(rho_s), Vec3::new(-1.0, -1.0, 1.0), 5.0)],
            ..LobeBrdf::diffuse(Rgb::splat(0.2))
        };
        let bright = albedo::largest(&physical(with(3.0))).max_element();
        assert!((bright - MOST_ALBEDO).abs() < 1e-3, "{bright}");
        assert_eq!(physical(with(0.1)), with(0.1));
    }

    #[test]
    fn quantiles_and_shares_of_lists() {
        let list = [3.0, 1.0, 2.0];
        assert_eq!([quantile(&list, 0.0), quantile(&list, 0.5), quantile(&list, 1.0)], [1.0, 2.0, 3.0]);
        assert!(quantile(&[], 0.5).is_nan() && percent([]).is_nan());
        assert_eq!(percent([true, false, true, true]), 75.0);
    }
}
