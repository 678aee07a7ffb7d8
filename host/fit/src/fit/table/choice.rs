//! As many lobes as a table supports, and a microfacet term or none: a model is judged by how well it
//! predicts whole incidences that it was not fitted to.
//!
//! Each incidence (tables with many: each band of 10°) of the rows that the fit may see is left out in turn,
//! and the optimum of all rows is optimised again without it. What counts is |ln f̂ − ln f| of f cosθ_o above
//! 1e-3 sr⁻¹, up to [`CAP`]: how far a model is off where it extrapolates says nothing. Rows of one incidence
//! err alike, so that it is incidences that count as independent: a larger model has to be better by
//! [`ERRORS`] standard errors of the difference over them.

use super::super::evaluate::LOG_FLOOR;
use super::super::lm::Optimiser;
use super::super::model::Model;
use super::super::samples::{Samples, Target};
use super::super::start::{Effort, Problem};
use super::{FREEDOM, WavelengthFit};

/// Largest error of a row that counts.
const CAP: f64 = 2.0;
/// RMS error of ln f at which lobes alone are good enough.
const ENOUGH: f64 = 0.01;
/// Standard errors by which a larger model has to be better.
const ERRORS: f64 = 2.0;
/// More incidences than this are taken together by bands.
const MOST_FOLDS: usize = 16;
/// Width of those bands, degrees.
const BAND_DEG: f64 = 10.0;
/// A table of a single incidence is left out by so many runs of its rows.
const RUNS: usize = 5;

/// The part that each row belongs to, from its incidence in degrees.
pub(super) fn folds(theta_deg: &[f64]) -> Vec<usize> {
    let places =
        |width: f64| -> Vec<i64> { theta_deg.iter().map(|theta| (theta / width).round() as i64).collect() };
    let distinct = |places: &[i64]| {
        let mut distinct = places.to_vec();
        distinct.sort_unstable();
        distinct.dedup();
        distinct
    };
    let mut places_of_rows = places(1.0);
    let mut known = distinct(&places_of_rows);
    if known.len() > MOST_FOLDS {
        places_of_rows = places(BAND_DEG);
        known = distinct(&places_of_rows);
    }
    if known.len() == 1 {
        return (0..theta_deg.len()).map(|row| row * RUNS / theta_deg.len()).collect();
    }
    places_of_rows.iter().map(|place| known.partition_point(|other| other < place)).collect()
}

/// Sums over every fold's rows of the squared errors with which `model`, optimised again without the fold,
/// predicts them; over the number of rows of all.
pub(super) fn left_out(samples: &Samples, folds: &[usize], target: &Target, model: &Model) -> Vec<f64> {
    let of_fold = |fold: usize| {
        let mut without = target.clone();
        for (weight, _) in without.weight.iter_mut().zip(folds).filter(|&(_, &of)| of == fold) {
            *weight = 0.0;
        }
        let problem = Problem { samples, target: &without, freedom: FREEDOM, fixed_diffuse: 0.0 };
        let mut refitted = model.clone();
        problem.minimise(&mut Optimiser::default(), Effort::TABLE.limits, &mut refitted);
        let loss = |k: usize| {
            let log = |f: f64| (LOG_FLOOR + f.max(0.0) * samples.cos_o[k]).ln();
            (log(refitted.value(samples, k)) - log(samples.value[k])).abs().min(CAP).powi(2)
        };
        let rows = (0..samples.len()).filter(|&k| folds[k] == fold);
        rows.map(loss).sum::<f64>() / samples.len() as f64
    };
    (0..folds.iter().max().map_or(0, |last| last + 1)).map(of_fold).collect()
}

/// The place of the fit to choose among fits of one wavelength: the best number of lobes with a microfacet
/// term, unless lobes alone are good to [`ENOUGH`] or better beyond doubt. A highlight that a table meets in
/// one row says next to nothing about which predicts it; the microfacet term has the physics of it.
pub(super) fn chosen(fits: &[&WavelengthFit]) -> usize {
    let best = |coated: bool| {
        let mut places: Vec<usize> =
            (0..fits.len()).filter(|&place| fits[place].size.microfacet == coated).collect();
        places.sort_by_key(|&place| (fits[place].size.lobes, fits[place].size.sharpening));
        places.into_iter().reduce(|best, place| {
            if is_better(&fits[place].left_out, &fits[best].left_out) { place } else { best }
        })
    };
    match (best(false), best(true)) {
        (Some(lobes), Some(coated)) => {
            let (alone, with) = (&fits[lobes].left_out, &fits[coated].left_out);
            if alone.iter().sum::<f64>().sqrt() < ENOUGH || is_better(alone, with) { lobes } else { coated }
        }
        (lobes, coated) => lobes.or(coated).unwrap_or(0),
    }
}

/// Whether incidences are predicted better with the losses `large` than with `small`, beyond doubt.
fn is_better(large: &[f64], small: &[f64]) -> bool {
    let count = large.len().max(2) as f64;
    let gains = || small.iter().zip(large).map(|(small, large)| small - large);
    let mean = gains().sum::<f64>() / count;
    let variance = gains().map(|gain| (gain - mean).powi(2)).sum::<f64>() / (count - 1.0);
    mean > ERRORS * (variance / count).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn incidences_are_folds_and_many_go_by_bands() {
        assert_eq!(folds(&[10.0, 20.01, 9.99, 80.0]), [0, 1, 0, 2]);
        let many: Vec<f64> = (0..900).map(|k| f64::from(k) / 10.0).collect();
        let bands = folds(&many);
        assert_eq!((bands[0], bands[899], *bands.iter().max().unwrap()), (0, 9, 9));
        assert!(bands.windows(2).all(|pair| pair[0] <= pair[1]));
        assert_eq!(folds(&[30.0; 10]), [0, 0, 1, 1, 2, 2, 3, 3, 4, 4]);
    }

    #[test]
    fn a_model_that_is_better_by_chance_is_not_better() {
        let small: Vec<f64> = (0..8).map(|k| 0.5 + 0.4 * (f64::from(k) * 2.4).sin()).collect();
        let chance: Vec<f64> = (0..8).map(|k| 0.49 + 0.4 * (f64::from(k) * 1.7).cos()).collect();
        let better: Vec<f64> = small.iter().map(|loss| 0.8 * loss).collect();
        assert!(!is_better(&chance, &small) && is_better(&better, &small) && !is_better(&small, &small));
        // One incidence alone that is better by any amount says nothing, however many rows it has.
        let mut one = small.clone();
        one[3] = 0.0;
        assert!(!is_better(&one, &small));
    }
}
