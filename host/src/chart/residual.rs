//! What the choice of residual does: the same samples fitted with each, and the error of each fit in the
//! measure of every other.

use super::{Section, Table};
use crate::error::Result;
use crate::fit::{self, FitOptions, Method, Residual};
use crate::progress;
use crate::random::Random;
use crate::reflectance::{Brdf, LobeBrdf, Microfacet, Rgb, SbrdfMap};
use crate::synth::{self, Options};

/// Edge of the sample, texels.
const SIDE: usize = 12;

/// A diffuse term and a GGX term, whose tails no lobe has: a fit has to choose where to be right.
fn glossy(random: &mut Random) -> LobeBrdf {
    let rho_d = Rgb::splat(random.uniform(0.01, 0.1) as f32);
    let alpha = random.uniform(0.1, 0.4) as f32;
    let gloss = Microfacet { f0: Rgb::splat(0.05), f90: Rgb::ONE, alpha };
    LobeBrdf { rho_d, microfacets: vec![gloss], ..LobeBrdf::default() }
}

/// Number of residuals.
const COUNT: usize = Residual::ALL.len();

/// A table for fits with one lobe and one for two.
///
/// # Errors
/// As [`fit::fit_sbrdf`].
pub(super) fn section(seed: u64) -> Result<Section> {
    let bar = progress::bar("fitting", 2 * COUNT as u64, "fits");
    let mut tables = Vec::new();
    for lobes in [1, 2] {
        let [a, b, c, d, e, f] = Residual::ALL.map(|measure| format!("in {}", measure.name()));
        let plural = if lobes == 1 { "lobe" } else { "lobes" };
        let mut table = Table::new([&format!("fitted with, {lobes} {plural}"), &a, &b, &c, &d, &e, &f]);
        for (residual, row) in Residual::ALL.iter().zip(errors(SIDE, lobes, seed, || bar.advance(1))?) {
            let [a, b, c, d, e, f] = row.map(Into::into);
            table.row([residual.name().into(), a, b, c, d, e, f]);
        }
        tables.push(table);
    }
    Ok(Section {
        title: "Choice of residual".into(),
        text: format!(
            "{} texels with a diffuse term and a GGX term (α 0.1 to 0.4, f0 0.05) each, whose tails no lobe \
             has, 200 random poses, noise 1e-3 1/sr and 1 %, fitted by LM with every residual. A column \
             gives the RMS difference in that residual's measure over 300 direction pairs that were not \
             posed, over that of the fit with that very residual, median over texels: read down a column to \
             see what the other choices cost. Below 1 the other choice predicts even this measure better.",
            SIDE * SIDE
        ),
        tables,
        ..Section::default()
    })
}

/// Errors [fitted with][measured in] of fits of `lobes` lobes, each over that of the residual's own fit,
/// median over texels; `done` is called a fit.
fn errors(side: usize, lobes: usize, seed: u64, done: impl Fn()) -> Result<[[f64; COUNT]; COUNT]> {
    let mut random = Random::new(seed);
    let truth: Vec<LobeBrdf> = (0..side * side).map(|_| glossy(&mut random)).collect();
    let options = Options {
        width: side,
        height: side,
        texel_mm: 0.5,
        poses: 200,
        noise: 1e-3,
        relative_noise: 0.01,
        seed,
    };
    let sampled = synth::sample(&options, |index, _, wi, wo| truth[index].eval(wi, wo));
    let mut fitted = Vec::with_capacity(COUNT);
    for residual in Residual::ALL {
        let options = FitOptions { method: Method::Lm, lobes, residual, ..FitOptions::default() };
        let map = fit::fit_sbrdf(&sampled, &options)?;
        let of = |index: usize| Residual::ALL.map(|measure| error(&map, index, &truth[index], measure, seed));
        fitted.push((0..side * side).map(of).collect::<Vec<_>>());
        done();
    }
    Ok(std::array::from_fn(|with| {
        std::array::from_fn(|measure| {
            let ratio = |texel: usize| fitted[with][texel][measure] / fitted[measure][texel][measure];
            let mut ratios: Vec<f64> = (0..side * side).map(ratio).collect();
            ratios.sort_by(f64::total_cmp);
            ratios[ratios.len() / 2]
        })
    }))
}

/// RMS over unposed directions and channels of the difference in a residual's measure.
fn error(map: &SbrdfMap, index: usize, truth: &LobeBrdf, measure: Residual, seed: u64) -> f64 {
    let pairs = super::unposed::pairs(seed);
    let mut sum = 0.0;
    for &(wi, wo) in &pairs {
        let (fitted, f) = (map.eval(index, wi, wo).to_array(), truth.eval(wi, wo).to_array());
        for (fitted, f) in fitted.map(f64::from).into_iter().zip(f.map(f64::from)) {
            let cos_o = f64::from(wo.z);
            let (difference, _) = measure.difference(fitted, cos_o, measure.transform(f, cos_o).0);
            sum += (measure.own_weight(f) * difference).powi(2);
        }
    }
    (sum / (3 * pairs.len()) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_and_logarithmic_fits_each_cost_the_other_and_a_cube_root_lies_between() {
        let errors = errors(5, 1, 1, || ()).unwrap();
        for (residual, row) in Residual::ALL.iter().zip(&errors) {
            println!("{:16} {row:.3?}", residual.name());
        }
        let [linear, log, root] = [Residual::Linear, Residual::Log, Residual::CubeRoot]
            .map(|wanted| Residual::ALL.iter().position(|&residual| residual == wanted).unwrap());
        assert!((0..COUNT).all(|k| errors[k][k] == 1.0), "{errors:?}");
        assert!(errors[linear][log] > 1.05 && errors[log][linear] > 1.15, "{errors:?}");
        assert!(errors[root][log] < errors[linear][log] && errors[root][linear] < errors[log][linear]);
    }
}
