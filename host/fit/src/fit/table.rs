//! Fits one measured table, wavelength by wavelength with lobes of its own each, and says how well it
//! predicts held-out rows.
//!
//! Tables of paint are isotropic: Cx = Cy and β = 0. Beside lobes a microfacet term can be fitted, and the
//! data can choose (module `choice`).

mod choice;
pub mod judge;
mod thin;
pub mod uncertainty;

use rayon::prelude::*;

use super::lm::{Descent, Freedom, Optimiser};
use super::model::Model;
use super::samples::{Samples, Target};
use super::start::{Effort, Problem, Search};
use super::{AlbedoBound, Method, PERCENTILE, Residual, conserve, diffuse, evaluate, line_search};
use lobelia_base::error::{Error, Result};
use lobelia_base::figures::ErrorFigure;
use lobelia_base::progress;
use lobelia_base::random::Random;
use lobelia_reflectance::{LobeBrdf, MeasuredTable, Microfacet, Rgb, SbrdfMap};

/// Rows whose incidence is this near a held-out angle are left out, degrees.
pub const HOLD_OUT_WIDTH_DEG: f64 = 0.5;

/// Wavelengths that stand for blue, green and red, nm.
const WAVELENGTHS_NM: [f64; 3] = [450.0, 550.0, 650.0];

/// What a fit of a table may change.
const FREEDOM: Freedom = Freedom { isotropic: true, diffuse: true };

/// A model's size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    /// Lobes; black ones stay in the model.
    pub lobes: usize,
    /// Whether the lobes sharpen toward grazing (6.19).
    pub sharpening: bool,
    /// Whether there is a microfacet term.
    pub microfacet: bool,
}

impl std::fmt::Display for Size {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [sharpening, coat] = [(self.sharpening, " sharpening"), (self.microfacet, " + GGX")]
            .map(|(is, text)| if is { text } else { "" });
        write!(f, "{}{sharpening}{coat}", self.lobes)
    }
}

/// How a table is fitted.
#[derive(Debug, Clone, PartialEq)]
pub struct TableOptions {
    /// Method; the line search fits one lobe.
    pub method: Method,
    /// Scale of comparison.
    pub residual: Residual,
    /// Incidences that the fit does not see, degrees.
    pub hold_out_theta_deg: Vec<f64>,
    /// Random starts to compare the deterministic search with; 0 for none.
    pub random_starts: usize,
    /// Seed of the random starts.
    pub seed: u64,
    /// What directional albedos are held to.
    pub bound: AlbedoBound,
}

/// Errors over some rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Errors {
    /// See [`evaluate::log_rms`].
    pub log_rms: f64,
    /// See [`evaluate::relative_l2`].
    pub relative_l2: f64,
    /// Rows.
    pub rows: usize,
}

/// The fit of one wavelength.
#[derive(Debug, Clone, PartialEq)]
pub struct WavelengthFit {
    /// Wavelength, nm.
    pub wavelength_nm: f64,
    /// The model's size.
    pub size: Size,
    /// Whether it is the one to take for this wavelength: the one asked for, or the choice of the data.
    pub chosen: bool,
    /// The lobes.
    pub model: Model,
    /// Cost and convergence.
    pub outcome: Descent,
    /// Standard deviations of the coefficients; none where the model is no optimum: found by the line search
    /// or changed for the sake of energy.
    pub deviations: Option<uncertainty::Deviations>,
    /// Over the rows that the fit saw.
    pub training: Errors,
    /// The same before the fit was changed for the sake of energy, where it was.
    pub free: Option<Errors>,
    /// Over the rows that it did not.
    pub held_out: Option<Errors>,
    /// Cost over the best cost of the random starts.
    pub start_ratio: Option<f64>,
    /// Where the rows were too many to search with all of them.
    pub thinned: Option<Thinned>,
    /// Squared errors of the incidences, each predicted without it; empty where there is no choice.
    left_out: Vec<f64>,
}

/// A search with some of the rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thinned {
    /// Rows that were searched with.
    pub rows: usize,
    /// By what share the cost of what they led to was above that of the fit that all rows then made of it.
    pub loss: f64,
}

/// The rows of a table that a fit sees and those that it does not.
struct Split {
    training: Samples,
    held_out: Samples,
    /// Incidences of the training rows, degrees.
    theta_deg: Vec<f64>,
}

fn split(table: &MeasuredTable, values: &[f64], hold_out_theta_deg: &[f64]) -> Split {
    let mut split = Split { training: Samples::default(), held_out: Samples::default(), theta_deg: vec![] };
    for (row, &value) in table.rows.iter().zip(values) {
        let theta = row.theta_i.to_degrees();
        let held = hold_out_theta_deg.iter().any(|held| (held - theta).abs() <= HOLD_OUT_WIDTH_DEG);
        let side = if held { &mut split.held_out } else { &mut split.training };
        side.push_value(row.wi(), row.wo(), value, 1.0);
        if split.training.len() > split.theta_deg.len() {
            split.theta_deg.push(theta);
        }
    }
    split
}

fn errors(samples: &Samples, model: &Model) -> Errors {
    let triples =
        || (0..samples.len()).map(|k| (model.value(samples, k), samples.value[k], samples.cos_o[k]));
    Errors {
        log_rms: evaluate::log_rms(triples()),
        relative_l2: evaluate::relative_l2(triples()),
        rows: samples.len(),
    }
}

/// Which of the sizes is to be taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Take {
    /// This one.
    Size(Size),
    /// For every wavelength the one that predicts left-out incidences best.
    Choose,
}

/// Fits a table at every wavelength with every size, in parallel; sorted by wavelength as given, then by size
/// as given.
///
/// # Errors
/// Input errors: a wavelength outside the table, nothing left to fit or nothing held out at an angle that was
/// asked for.
pub fn fit(
    table: &MeasuredTable,
    wavelengths_nm: &[f64],
    sizes: &[Size],
    take: Take,
    options: &TableOptions,
) -> Result<Vec<WavelengthFit>> {
    check(table, sizes, options)?;
    let mut cases = Vec::new();
    for &wavelength_nm in wavelengths_nm {
        let values = table.at_wavelength(wavelength_nm).map_err(Error::format)?;
        cases.extend(sizes.iter().map(|&size| (wavelength_nm, values.clone(), size)));
    }
    let bar = progress::bar("fitting", cases.len() as u64, "fits");
    let mut fits: Vec<WavelengthFit> = cases
        .into_par_iter()
        .with_max_len(1)
        .map(|(wavelength_nm, values, size)| {
            let mut fit = one(table, wavelength_nm, &values, size, options, take == Take::Choose);
            fit.chosen = take == Take::Size(size);
            bar.advance(1);
            fit
        })
        .collect();
    if take == Take::Choose {
        for fits in fits.chunks_mut(sizes.len().max(1)) {
            let place = choice::chosen(&fits.iter().collect::<Vec<_>>());
            fits[place].chosen = true;
        }
    }
    Ok(fits)
}

fn check(table: &MeasuredTable, sizes: &[Size], options: &TableOptions) -> Result<()> {
    for size in sizes {
        super::FitOptions { lobes: size.lobes, method: options.method, ..Default::default() }.check()?;
        if size.microfacet && options.method.line_search().is_some() {
            return Err(Error::input("the line search fits no microfacet term; use --method lm"));
        }
        if size.sharpening && options.method.line_search().is_some() {
            return Err(Error::input("the line search fits no lobes that sharpen; use --method lm"));
        }
    }
    let near = |row: &lobelia_reflectance::table::TableRow, held: f64| {
        (row.theta_i.to_degrees() - held).abs() <= HOLD_OUT_WIDTH_DEG
    };
    for &held in &options.hold_out_theta_deg {
        if !table.rows.iter().any(|row| near(row, held)) {
            return Err(Error::input(format!(
                "no row of the table has an incidence within {HOLD_OUT_WIDTH_DEG}° of the held-out {held}°"
            )));
        }
    }
    if table.rows.iter().all(|row| options.hold_out_theta_deg.iter().any(|&held| near(row, held))) {
        return Err(Error::input("every row of the table is held out; nothing is left to fit"));
    }
    Ok(())
}

fn one(
    table: &MeasuredTable,
    wavelength_nm: f64,
    values: &[f64],
    size: Size,
    options: &TableOptions,
    judged: bool,
) -> WavelengthFit {
    let Size { lobes, sharpening, microfacet } = size;
    let Split { training, held_out, theta_deg } = split(table, values, &options.hold_out_theta_deg);
    let mut whole = Target::default();
    whole.set(&training, training.value.iter().copied(), options.residual);
    // The search and the choice see no more rows than they need; in the end the fit sees all.
    let thin = thin::rows(&training);
    let (part, part_theta_deg) = match &thin {
        Some(rows) => (training.part(rows), rows.iter().map(|&(k, _)| theta_deg[k]).collect()),
        None => (training.clone(), theta_deg),
    };
    let mut target = Target::default();
    target.set(&part, part.value.iter().copied(), options.residual);
    let mut optimiser = Optimiser::default();
    let problem = Problem { samples: &part, target: &target, freedom: FREEDOM, fixed_diffuse: 0.0 };
    let mut start_ratio = None;
    let (mut model, mut outcome) = if let Some(variant) = options.method.line_search()
        && lobes > 0
    {
        let rho_d = diffuse::percentile(&mut part.value.clone(), PERCENTILE);
        let model = line_search::fit(&part, &target, rho_d, FREEDOM, variant);
        let cost = optimiser.evaluate(&part, &target, &model);
        (model, Descent { cost, iterations: 0, converged: true })
    } else {
        let mut search = Search::default();
        let found = if microfacet {
            search.best_coated(&mut optimiser, &problem, lobes, Effort::TABLE)
        } else {
            search.best(&mut optimiser, &problem, lobes, Effort::TABLE)
        };
        let found = if sharpening { sharpened(found, &mut optimiser, &problem) } else { found };
        if options.random_starts > 0 && !microfacet && !sharpening {
            let mut random = Random::new(options.seed);
            let limits = Effort::TABLE.limits;
            let best =
                problem.best_of_random(&mut optimiser, lobes, options.random_starts, limits, &mut random);
            start_ratio = Some(found.1.cost / best.max(f64::MIN_POSITIVE));
        }
        found
    };
    let left_out = if judged {
        choice::left_out(&part, &choice::folds(&part_theta_deg), &target, &model)
    } else {
        Vec::new()
    };
    let mut thinned = None;
    if thin.is_some() && options.method.line_search().is_none() {
        let before = optimiser.evaluate(&training, &whole, &model);
        let problem = Problem { samples: &training, target: &whole, freedom: FREEDOM, fixed_diffuse: 0.0 };
        outcome = problem.minimise(&mut optimiser, Effort::TABLE.limits, &mut model);
        thinned =
            Some(Thinned { rows: part.len(), loss: before / outcome.cost.max(f64::MIN_POSITIVE) - 1.0 });
    }
    let mut free = None;
    if let Some(limit) = options.bound.limit(options.method)
        && let Some(held) =
            conserve::conserve(&coloured(&model, Rgb::X), &training, &[0], &[whole.clone()], limit)
    {
        free = Some(errors(&training, &model));
        model = Model::from(&held);
        outcome.cost = optimiser.evaluate(&training, &whole, &model);
    }
    let fitted = free.is_none() && options.method != Method::LineSearch;
    WavelengthFit {
        wavelength_nm,
        size,
        chosen: false,
        deviations: fitted.then(|| uncertainty::deviations(&training, &whole, &model)),
        left_out,
        thinned,
        free,
        training: errors(&training, &model),
        held_out: (!held_out.is_empty()).then(|| errors(&held_out, &model)),
        model,
        outcome,
        start_ratio,
    }
}

/// The fit with lobes that sharpen, from one with lobes that do not.
fn sharpened(
    (mut model, _): (Model, Descent),
    optimiser: &mut Optimiser,
    problem: &Problem<'_>,
) -> (Model, Descent) {
    model.lobes.iter_mut().for_each(|lobe| lobe.n_grazing = Some(lobe.n));
    let outcome = problem.minimise(optimiser, Effort::TABLE.limits, &mut model);
    (model, outcome)
}

/// The BRDF of three fits for red, green and blue: every term is seen in its own channel only.
pub fn brdf(red_green_blue: [&WavelengthFit; 3]) -> LobeBrdf {
    let mut brdf = LobeBrdf::default();
    for (fit, colour) in red_green_blue.into_iter().zip([Rgb::X, Rgb::Y, Rgb::Z]) {
        let one = coloured(&fit.model, colour);
        brdf.rho_d += one.rho_d;
        brdf.lobes.extend(one.lobes);
        brdf.microfacets.extend(one.microfacets);
    }
    brdf
}

/// A model in a colour, without its black lobes.
pub fn coloured(model: &Model, colour: Rgb) -> LobeBrdf {
    let lobes = model.lobes.iter().filter(|lobe| lobe.amplitude > 0.0);
    let coat = model.coat.map(|coat| Microfacet {
        f0: coat.f0 as f32 * colour,
        f90: coat.f90 as f32 * colour,
        alpha: coat.alpha as f32,
    });
    LobeBrdf {
        rho_d: model.diffuse as f32 * colour,
        lobes: lobes.map(|lobe| lobe.to_lobe(lobe.amplitude as f32 * colour)).collect(),
        microfacets: coat.into_iter().collect(),
        ..LobeBrdf::default()
    }
}

/// The wavelengths to fit, nm, where none is named: the one of a table that has no other, else those of blue,
/// green and red.
pub fn wavelengths_nm(table: &MeasuredTable) -> Vec<f64> {
    match &table.wavelengths_nm[..] {
        [only] => vec![*only],
        _ => WAVELENGTHS_NM.to_vec(),
    }
}

/// A map of one texel of the fits to take: the longest wavelength as red, the shortest as blue, or a single
/// one as grey.
///
/// # Errors
/// Input errors: neither one wavelength nor three.
pub fn map(fits: &[WavelengthFit], options: &TableOptions) -> Result<SbrdfMap> {
    let mut channels: Vec<&WavelengthFit> = fits.iter().filter(|fit| fit.chosen).collect();
    channels.sort_by(|a, b| b.wavelength_nm.total_cmp(&a.wavelength_nm));
    let brdf = match channels[..] {
        [red, green, blue] => brdf([red, green, blue]),
        [grey] => coloured(&grey.model, Rgb::ONE),
        _ => return Err(no_colours(channels.len())),
    };
    let mut map = SbrdfMap::from_texels(1, 1, &[brdf]);
    let join = |text: fn(&WavelengthFit) -> String| -> String {
        channels.iter().map(|&fit| text(fit)).collect::<Vec<_>>().join(",")
    };
    for (key, value) in [
        ("fit.method", options.method.name().to_string()),
        ("fit.residual", options.residual.name().to_string()),
        ("fit.wavelengths_nm", join(|fit| fit.wavelength_nm.to_string())),
        ("fit.lobes", join(|fit| fit.size.to_string())),
    ] {
        map.attributes.insert(key.into(), value);
    }
    Ok(map)
}

/// What is wrong where a map is to be made of a number of wavelengths that are no colours.
pub fn no_colours(wavelengths: usize) -> Error {
    Error::input(format!(
        "-o writes red, green and blue, or grey: give one or three --wavelengths-nm, not {wavelengths}"
    ))
}

/// The figures of a list of fits, as reports hold them.
pub fn figures(fits: &[WavelengthFit], options: &TableOptions) -> Vec<ErrorFigure> {
    let mut figures = Vec::new();
    for fit in fits {
        let mut add = |name: &str, value: f64, over: String| {
            figures.push(
                ErrorFigure::new(name, value, "1", over)
                    .with("lobes", fit.size.lobes)
                    .with("sharpening", fit.size.sharpening)
                    .with("microfacet", fit.size.microfacet)
                    .with("chosen", fit.chosen)
                    .with("wavelength_nm", fit.wavelength_nm)
                    .with("method", options.method.name())
                    .with("residual", options.residual.name()),
            );
        };
        let over = |errors: &Errors, what: &str| format!("{} {what} rows", errors.rows);
        add("training_log_rms", fit.training.log_rms, over(&fit.training, "training"));
        add("training_relative_l2", fit.training.relative_l2, over(&fit.training, "training"));
        if let Some(free) = &fit.free {
            add("energy_free_training_log_rms", free.log_rms, over(free, "training"));
            add("energy_free_training_relative_l2", free.relative_l2, over(free, "training"));
        }
        if let Some(held_out) = &fit.held_out {
            add("held_out_log_rms", held_out.log_rms, over(held_out, "held-out"));
            add("held_out_relative_l2", held_out.relative_l2, over(held_out, "held-out"));
        }
        if let Some(thinned) = &fit.thinned {
            add("thinned_cost_loss", thinned.loss, format!("a search with {} rows", thinned.rows));
        }
        if let Some(ratio) = fit.start_ratio {
            let over = format!("best cost of {} random starts", options.random_starts);
            add("start_cost_ratio", ratio, over);
        }
    }
    figures
}

#[cfg(test)]
mod tests;
