//! What is known of a fit once it is made: its errors, counts and rates, and what a person should know before
//! trusting it.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::fit::held_out::{HeldOut, HeldOutError};
use crate::fit::{FitOptions, noted};
use crate::warning::{directions, residual, texels};
use lobelia_base::error::Result;
use lobelia_base::figures::ErrorFigure;
use lobelia_base::warning::Warning;
use lobelia_reflectance::sampled::SampledStore;
use lobelia_reflectance::warning::samples::{self, Step, Tally};
use lobelia_reflectance::{SbrdfMap, albedo};

/// Directional albedo from which on a texel counts as making light: the error of a measurement's scale and of
/// sums is below.
const MAKES_LIGHT: f32 = 1.02;

/// The names of the groups of held-out poses: all, those near a fitted one, and the others.
const GROUPS: [&str; 3] = ["all", "near", "far"];

/// What was found, as reports hold it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Findings {
    /// Errors.
    pub errors: Vec<ErrorFigure>,
    /// Counts and rates.
    pub figures: BTreeMap<String, serde_json::Value>,
    /// What a person should know before the fit is trusted.
    pub warnings: Vec<Warning>,
}

impl Findings {
    /// Errors and counts of a map that was fitted to texels.
    pub fn of_map(map: &SbrdfMap, summary: &Summary) -> Self {
        let over = format!("{} texels", summary.fitted);
        let mut findings = Self::default();
        for (name, value) in
            ["residual_relative_median", "residual_relative_p95"].into_iter().zip(summary.residual)
        {
            let mut figure = ErrorFigure::new(name, value, "1", over.clone());
            for key in ["lobes", "method", "residual"] {
                let text = map.attributes.get(&format!("fit.{key}")).map_or("unknown", String::as_str);
                figure = match text.parse::<usize>() {
                    Ok(number) => figure.with(key, number),
                    Err(_) => figure.with(key, text),
                };
            }
            findings.errors.push(figure);
        }
        if let Some(prices) = &summary.bound_prices {
            let over = format!("{} texels held to the bound on albedo", prices.len());
            for (name, share) in [("bound_price_median", 0.5), ("bound_price_largest", 1.0)] {
                findings.errors.push(ErrorFigure::new(name, quantile(prices, share), "1", over.clone()));
            }
            findings.figure("texels_bounded", prices.len());
        }
        findings.figure("texels_making_light", summary.making_light.0);
        findings.figure("texels", summary.texels);
        findings.figure("texels_tied", summary.tied);
        findings.figure("texels_with_mirror", summary.mirrors);
        findings.figure("texels_without_samples", summary.texels - summary.fitted);
        findings
    }

    /// Adds a count or rate.
    pub fn figure(&mut self, name: &str, value: impl Into<serde_json::Value>) {
        self.figures.insert(name.into(), value.into());
    }

    /// Adds the errors on poses that were held out.
    pub fn add_held_out(&mut self, held: &HeldOut, errors: &[HeldOutError; 3]) {
        for (group, error) in GROUPS.iter().zip(errors).filter(|(_, error)| error.texels > 0) {
            let over =
                format!("{} texels, samples of {} poses that were not fitted", error.texels, error.poses);
            for (name, value) in [
                ("held_out_relative_rms_median", error.p50),
                ("held_out_relative_rms_p95", error.p95),
                ("held_out_relative_rms_p99", error.p99),
                ("held_out_relative_rms_largest", error.worst),
            ] {
                let mut figure = ErrorFigure::new(name, value, "1", over.clone()).with("poses", *group);
                if name.ends_with("largest") {
                    figure = figure.with("texel", error.worst_texel.to_vec());
                }
                self.errors.push(figure);
            }
        }
        self.figure("poses_held_out", held.poses.clone());
        self.figure("poses_fitted", held.fitted);
        self.figure("held_out_near_deg", held.near.to_degrees());
    }

    /// Warns of poses that are not known and of samples that are of no use.
    pub fn add_samples(&mut self, store: &SampledStore, tally: Tally) {
        let weights: Vec<f64> = store.poses.iter().map(|pose| pose.weight).collect();
        let counts = tally.counts(&weights, store.clipped.as_deref());
        self.figure(samples::BY_POSE, samples::by_pose(&counts));
        self.warnings.extend(directions::unknown_poses(&store.unknown_poses));
        self.warnings.extend(samples::warnings(Step::Fit, &counts));
    }

    /// Warns of what makes a whole map less trustworthy than it looks.
    ///
    /// # Errors
    /// When a chunk of the store cannot be read.
    pub fn add_fit(&mut self, store: &SampledStore, map: &SbrdfMap, options: &FitOptions) -> Result<()> {
        let seen = directions::of_poses(&store.poses);
        let few = directions::too_few(seen.len(), options).or_else(|| texels::few_samples(map, options));
        self.warnings.extend(few);
        self.warnings.extend(directions::shape(&seen, options.isotropic));
        self.add_texels(map);
        self.add_poses(store, map)
    }

    /// Warns of the poses and texels of a map that was joined of parts, as after one fit; samples are counted
    /// by the parts.
    ///
    /// # Errors
    /// When a chunk of the store cannot be read.
    pub fn add_joined(&mut self, store: Option<&SampledStore>, map: &SbrdfMap) -> Result<()> {
        let options = noted::options(map);
        let Some(store) = store else {
            self.warnings.extend(options.and_then(|options| texels::few_samples(map, &options)));
            self.add_texels(map);
            return Ok(());
        };
        self.warnings.extend(directions::unknown_poses(&store.unknown_poses));
        if let Some(options) = options {
            return self.add_fit(store, map, &options);
        }
        self.warnings.extend(directions::shape(&directions::of_poses(&store.poses), false));
        self.add_texels(map);
        self.add_poses(store, map)
    }

    /// Warns of texels with a residual that their noise does not explain.
    pub fn add_texels(&mut self, map: &SbrdfMap) {
        if let Some(flags) = texels::unexplained(map) {
            self.figure("texels_unexplained", flags.iter().filter(|&&flag| flag).count());
        }
        self.warnings.extend(texels::unexplained_warning(map));
    }

    /// Warns of poses with a residual that stands out.
    fn add_poses(&mut self, store: &SampledStore, map: &SbrdfMap) -> Result<()> {
        let residuals = residual::look(store, map)?;
        let rounded = |times: &Option<f64>| times.map(|times| (1e3 * times).round() / 1e3);
        let times: Vec<Option<f64>> = residuals.times.iter().map(rounded).collect();
        self.figure("residual_by_pose", times);
        self.warnings.extend(residuals.warning());
        Ok(())
    }
}

/// A map that was fitted to texels, in numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// Texels.
    pub texels: usize,
    /// Texels with samples.
    pub fitted: usize,
    /// Median and 95th percentile over those of the residual's RMS over the samples'.
    pub residual: [f64; 2],
    /// By how much the relative residual rose in each texel that was changed so that it makes no light,
    /// ascending; none after a free fit.
    pub bound_prices: Option<Vec<f32>>,
    /// Texels that reflect more light than they receive, and the largest albedo of those.
    pub making_light: (usize, f32),
    /// Texels with coefficients that a prior decided.
    pub tied: usize,
    /// Texels in which a mirror was met.
    pub mirrors: usize,
}

impl Summary {
    /// Of a map that a fit made.
    pub fn new(map: &SbrdfMap) -> Self {
        let mut relative: Vec<f32> = match (map.extra.get("error.relative"), map.extra.get("samples")) {
            (Some(errors), Some(samples)) => (errors.iter().zip(samples))
                .filter(|&(_, &samples)| samples > 0.0)
                .map(|(&error, _)| error)
                .collect(),
            _ => Vec::new(),
        };
        relative.sort_by(f32::total_cmp);
        Self {
            texels: map.width * map.height,
            fitted: relative.len(),
            residual: [0.5, 0.95].map(|share| quantile(&relative, share)),
            bound_prices: bound_prices(map),
            making_light: making_light(map),
            tied: above_zero(map, "tied"),
            mirrors: above_zero(map, "mirror.poses"),
        }
    }

    /// Median and largest of the prices of the bound; 0 without any.
    pub fn price(&self) -> [f64; 2] {
        let prices = self.bound_prices.as_deref().unwrap_or_default();
        [0.5, 1.0].map(|share| quantile(prices, share))
    }
}

fn above_zero(map: &SbrdfMap, plane: &str) -> usize {
    map.extra.get(plane).map_or(0, |plane| plane.iter().filter(|&&count| count > 0.0).count())
}

fn bound_prices(map: &SbrdfMap) -> Option<Vec<f32>> {
    let (prices, bounded) = (map.extra.get("error.bound_price")?, map.extra.get("bounded")?);
    let mut prices: Vec<f32> =
        prices.iter().zip(bounded).filter(|pair| *pair.1 > 0.0).map(|pair| *pair.0).collect();
    prices.sort_by(f32::total_cmp);
    Some(prices)
}

fn making_light(map: &SbrdfMap) -> (usize, f32) {
    let with = |(count, largest): (usize, f32), texel: usize| {
        let brdf = map.texel(texel);
        // Most texels need no look at every incidence.
        if albedo::at_most(&brdf).is_some_and(|most| most <= MAKES_LIGHT) {
            return (count, largest);
        }
        let albedo = albedo::largest(&brdf).max_element();
        (count + usize::from(albedo > MAKES_LIGHT), largest.max(albedo))
    };
    let texels = (0..map.width * map.height).into_par_iter();
    texels.fold(|| (0, 0.0), with).reduce(|| (0, 0.0), |a, b| (a.0 + b.0, a.1.max(b.1)))
}

/// A quantile of ascending values; 0 without any.
fn quantile(sorted: &[f32], share: f64) -> f64 {
    let place = (share * sorted.len() as f64) as usize;
    sorted.get(place.min(sorted.len().saturating_sub(1))).map_or(0.0, |&value| f64::from(value))
}
