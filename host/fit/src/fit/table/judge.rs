//! Judges the choice of a table's model: each pair of incidences is held out in turn, and what was chosen
//! without them predicts them beside every fixed size.

use super::{Size, TableOptions, Take, fit};
use lobelia_base::error::{Error, Result};
use lobelia_reflectance::MeasuredTable;

/// Mean errors over all pairs of incidences that are held out.
#[derive(Debug, Clone, PartialEq)]
pub struct Judged {
    /// Wavelength, nm.
    pub wavelength_nm: f64,
    /// The size; none for the choice.
    pub size: Option<Size>,
    /// Mean held-out log-RMS.
    pub log_rms: f64,
    /// Mean held-out relative L2.
    pub relative_l2: f64,
    /// Share of the pairs in which the choice's log-RMS is at most this size's.
    pub choice_as_good: f64,
}

/// The incidences of a table, degrees, ascending, to a tenth.
pub fn incidences_deg(table: &MeasuredTable) -> Vec<f64> {
    let mut tenths: Vec<i64> =
        table.rows.iter().map(|row| (row.theta_i.to_degrees() * 10.0).round() as i64).collect();
    tenths.sort_unstable();
    tenths.dedup();
    tenths.into_iter().map(|tenth| tenth as f64 / 10.0).collect()
}

/// Most incidences whose pairs are held out one by one.
const MOST_INCIDENCES: usize = 16;

/// Judges every size and the choice among them, by wavelength as given, the choice first.
///
/// # Errors
/// Input errors of [`fit`]; and where there are fewer than four incidences, or more than 16.
pub fn each_pair(
    table: &MeasuredTable,
    wavelengths_nm: &[f64],
    sizes: &[Size],
    options: &TableOptions,
) -> Result<Vec<Judged>> {
    let incidences = incidences_deg(table);
    if !(4..=MOST_INCIDENCES).contains(&incidences.len()) {
        return Err(Error::input(format!(
            "each pair of incidences can be held out of a table with 4 to {MOST_INCIDENCES} of them; this \
             one has {}",
            incidences.len()
        )));
    }
    let pairs: Vec<[f64; 2]> = (0..incidences.len())
        .flat_map(|b| (0..b).map(move |a| (a, b)))
        .map(|(a, b)| [incidences[a], incidences[b]])
        .collect();
    // Errors by wavelength, place (sizes, then the choice) and pair.
    let mut errors = vec![vec![Vec::with_capacity(pairs.len()); sizes.len() + 1]; wavelengths_nm.len()];
    for pair in &pairs {
        let options = TableOptions { hold_out_theta_deg: pair.to_vec(), random_starts: 0, ..options.clone() };
        let fits = fit(table, wavelengths_nm, sizes, Take::Choose, &options)?;
        for (fits, errors) in fits.chunks(sizes.len()).zip(&mut errors) {
            for (place, fit) in fits.iter().enumerate() {
                let held = fit.held_out.map_or([f64::NAN; 2], |held| [held.log_rms, held.relative_l2]);
                errors[place].push(held);
                if fit.chosen {
                    errors[sizes.len()].push(held);
                }
            }
        }
    }
    let mut judged = Vec::new();
    for (&wavelength_nm, errors) in wavelengths_nm.iter().zip(&errors) {
        let choice = &errors[sizes.len()];
        let of = |size: Option<Size>, list: &[[f64; 2]]| {
            let mean = |k: usize| list.iter().map(|errors| errors[k]).sum::<f64>() / list.len() as f64;
            let as_good = list.iter().zip(choice).filter(|(other, choice)| choice[0] <= other[0]).count();
            let choice_as_good = as_good as f64 / list.len() as f64;
            Judged { wavelength_nm, size, log_rms: mean(0), relative_l2: mean(1), choice_as_good }
        };
        judged.push(of(None, choice));
        judged.extend(sizes.iter().zip(errors).map(|(&size, list)| of(Some(size), list)));
    }
    Ok(judged)
}
