//! The demo's fits: the result over the whole sample, and the methods beside each other over its middle.

use lobelia_hil_sim::optics::OpticalBench;

use super::Settings;
use super::truth::{self, Judge};
use crate::by_angle::{ByAngle, Cone, PERCENTILES};
use crate::chart::compared::{COMPARED, Compared};
use crate::error::Result;
use crate::figures::ErrorFigure;
use crate::fit::{self, FitOptions};
use crate::page::scale::quantile;
use crate::reflectance::SbrdfMap;
use crate::report::Report;
use crate::sampled::{SampledSbrdf, Window};

/// The compared texels reach over half of the sample each way, or over so many.
const LEAST_COMPARED: usize = 48;

/// One fit and how wrong it is.
pub struct FitOutcome {
    /// What was fitted, and how.
    pub options: FitOptions,
    /// The texels of the sample that were fitted.
    pub window: Window,
    /// The map of those texels.
    pub map: SbrdfMap,
    /// Duration, s.
    pub seconds: f64,
    /// Relative RMS error on unposed direction pairs, a texel.
    pub errors: Vec<f32>,
    /// The same by angle, inside and outside the measured cone.
    pub by_angle: ByAngle,
    /// The number in the recipe of each texel's material.
    pub materials: Vec<usize>,
}

/// A sample's fits.
pub struct Fits {
    /// The fit of the whole sample.
    pub result: FitOutcome,
    /// Each compared method, over [`Self::window`] alone; the result stands for the one that is fitted like
    /// it.
    pub others: Vec<FitOutcome>,
    /// The texels over which methods are compared.
    pub window: Window,
}

impl FitOutcome {
    /// Microseconds a texel.
    pub fn us_a_texel(&self) -> f64 {
        1e6 * self.seconds / self.errors.len().max(1) as f64
    }

    /// The indices in its own map of a window's texels, row by row.
    pub fn indices<'a>(&self, window: &'a Window) -> impl Iterator<Item = usize> + use<'a> {
        let (left, top, width) = (self.window.x.start, self.window.y.start, self.map.width);
        let column = move |x: usize| x - left;
        window.y.clone().flat_map(move |y| window.x.clone().map(move |x| (y - top) * width + column(x)))
    }

    /// Errors over the texels of a window.
    pub fn errors_in(&self, window: &Window) -> Vec<f32> {
        self.indices(window).map(|texel| self.errors[texel]).collect()
    }

    /// Errors over the texels of each material of a window.
    pub fn errors_by_material(&self, window: &Window) -> Vec<Vec<f32>> {
        let mut errors: Vec<Vec<f32>> = Vec::new();
        for texel in self.indices(window) {
            let material = self.materials[texel];
            errors.resize(errors.len().max(material + 1), Vec::new());
            errors[material].push(self.errors[texel]);
        }
        errors
    }

    /// The report's figures: percentiles of the error over all texels, over those of each material, and by
    /// angle.
    fn figures(&self) -> Vec<ErrorFigure> {
        let FitOptions { method, lobes, choose, separate_channels, .. } = self.options;
        let lobes = if choose { "auto".into() } else { serde_json::Value::from(lobes) };
        let described = |figure: ErrorFigure| {
            figure
                .with("method", method.name())
                .with("lobes", lobes.clone())
                .with("separate_channels", separate_channels)
        };
        let all = std::iter::once(("all".into(), self.errors.clone()));
        let by_material = self.errors_by_material(&self.window).into_iter().enumerate();
        let groups = all.chain(by_material.map(|(number, errors)| (serde_json::Value::from(number), errors)));
        let mut figures = Vec::new();
        for (material, errors) in groups.filter(|(_, errors)| !errors.is_empty()) {
            let over = format!("{} texels, {} unposed direction pairs each", errors.len(), truth::PAIRS);
            for percentile in PERCENTILES {
                let error = quantile(&errors, f64::from(percentile) / 100.0);
                let figure = ErrorFigure::new("relative_rms_reflectance", error, "1", over.clone());
                figures.push(
                    described(figure).with("percentile", percentile).with("material", material.clone()),
                );
            }
        }
        let by_angle = self.by_angle.figures("random direction pairs, the same for all");
        figures.extend(by_angle.into_iter().map(described));
        figures
    }
}

impl Fits {
    /// All fits, the result last.
    pub fn all(&self) -> impl Iterator<Item = &FitOutcome> {
        self.others.iter().chain(std::iter::once(&self.result))
    }

    /// The compared fits with what tables call them, in the order of `COMPARED`; last the result, where none
    /// of them is fitted like it.
    pub fn compared(&self) -> Vec<(String, &FitOutcome)> {
        let found = |compared: &Compared| {
            let fit = self.all().find(|fit| is_like(&fit.options, compared))?;
            Some((compared.name.to_string(), fit))
        };
        let result = &self.result.options;
        let other = COMPARED.iter().all(|compared| !is_like(result, compared));
        let last = other.then(|| (short_name(result), &self.result));
        COMPARED.iter().filter_map(found).chain(last).collect()
    }

    /// Fits, judges by what lies on the bench, and notes stages and errors in `report`.
    ///
    /// # Errors
    /// As [`fit::fit_sbrdf`].
    pub(super) fn make(
        sampled: &SampledSbrdf,
        settings: &Settings,
        (bench, cone): (&OpticalBench, &Cone),
        report: &mut Report,
    ) -> Result<Self> {
        let whole = Window { x: 0..sampled.width, y: 0..sampled.height };
        let window = middle(sampled);
        let mut fitted = |sampled: &SampledSbrdf, options: FitOptions, window: &Window, name: String| {
            let map = report.stage(&name, || fit::fit_sbrdf(sampled, &options))?;
            let seconds = report.stages.last().map_or(0.0, |stage| stage.seconds);
            Ok((options, window.clone(), map, seconds))
        };
        let result = settings.result();
        let name = format!("fit {}, {}", result.method.name(), lobes_title(&result));
        let mut all = vec![fitted(sampled, result, &whole, name)?];
        let part = sampled.part(&window);
        for compared in &COMPARED {
            let options = FitOptions { isotropic: !settings.anisotropic, ..compared.options() };
            if options != result {
                all.push(fitted(&part, options, &window, format!("compare {}", compared.name))?);
            }
        }
        let mut judged: Vec<FitOutcome> = report.stage("judge", || {
            let judge = Judge::new(sampled, bench, cone, settings.seed);
            let judged = all.into_iter().map(|(options, window, map, seconds)| FitOutcome {
                errors: judge.errors(&map, &window),
                by_angle: judge.by_angle(&map, &window),
                materials: judge.materials(&window),
                options,
                window,
                map,
                seconds,
            });
            judged.collect()
        });
        let fits = Self { result: judged.remove(0), others: judged, window };
        report.errors.extend(fits.all().flat_map(FitOutcome::figures));
        Ok(fits)
    }
}

/// Whether a fit stands for a compared one.
fn is_like(options: &FitOptions, compared: &Compared) -> bool {
    let FitOptions { method, lobes, choose, separate_channels, .. } = *options;
    !separate_channels && (method, lobes, choose) == (compared.method, compared.lobes, compared.choose)
}

/// What tables call a fit that is none of [`COMPARED`].
fn short_name(options: &FitOptions) -> String {
    let channel = if options.separate_channels { " a channel" } else { "" };
    format!("{}, {}{channel}", options.method.name(), lobes_title(options))
}

/// How many lobes were fitted, in words.
pub fn lobes_title(options: &FitOptions) -> String {
    match options {
        FitOptions { choose: true, .. } => "as many lobes as needed".into(),
        FitOptions { lobes: 1, .. } => "1 lobe".into(),
        FitOptions { lobes, .. } => format!("{lobes} lobes"),
    }
}

/// The middle of the sample, over which methods are compared.
fn middle(sampled: &SampledSbrdf) -> Window {
    let range = |length: usize| {
        let reach = (length / 2).max(LEAST_COMPARED).min(length);
        let start = (length - reach) / 2;
        start..start + reach
    };
    Window { x: range(sampled.width), y: range(sampled.height) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_result_that_is_fitted_like_no_compared_method_has_a_row_of_its_own_at_the_end() {
        let fitted = |options: FitOptions| FitOutcome {
            options,
            window: Window { x: 0..1, y: 0..1 },
            map: SbrdfMap::new(1, 1, 0),
            seconds: 1.0,
            errors: vec![0.1],
            by_angle: ByAngle::empty(1),
            materials: vec![0],
        };
        let names = |result: FitOptions| -> Vec<String> {
            let others = COMPARED.iter().map(Compared::options).filter(|options| *options != result);
            let fits = Fits {
                result: fitted(result),
                others: others.map(fitted).collect(),
                window: Window { x: 0..1, y: 0..1 },
            };
            fits.compared().into_iter().map(|(name, _)| name).collect()
        };
        let compared = COMPARED.map(|compared| compared.name.to_string());
        assert_eq!(names(FitOptions { lobes: 2, ..FitOptions::default() }), compared);
        for (lobes, separate_channels, name) in [
            (0, false, "separable, 0 lobes"),
            (3, false, "separable, 3 lobes"),
            (1, true, "separable, 1 lobe a channel"),
        ] {
            let result = FitOptions { lobes, separate_channels, ..FitOptions::default() };
            let found = names(result);
            assert_eq!((&found[..7], found[7..].concat().as_str()), (&compared[..], name));
        }
    }

    #[test]
    fn methods_are_compared_over_half_of_the_sample_or_all_of_a_small_one() {
        let size = |width, height| {
            let Window { x, y } = middle(&SampledSbrdf::empty(width, height, 1.0, Vec::new()));
            (x, y)
        };
        assert_eq!(size(48, 16), (0..48, 0..16));
        assert_eq!(size(128, 60), (32..96, 6..54));
        assert_eq!(size(256, 256), (64..192, 64..192));
    }
}
