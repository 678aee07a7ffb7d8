//! How finely an environment is prefiltered for an error E. It is relative, |Ŝ − S| / √(|S|² + ε²), S the
//! light under a lobe, Ŝ what the maps give and ε a tenth of the mean of |S| over all directions (as in
//! [`compare`](crate::render::compare)); and the root mean square over directions of which half are anywhere
//! and half are about the brightest light.
//!
//! | step | its error | chosen |
//! |---|---|---|
//! | bilinear lookup of S^(1/n) at angular spacing h | at most n h² / 4 for a point of light, whose root is a cosine | h² = [`PIXEL`] E / n |
//! | the same for n < 2, where the lobe's edge at 90° shows | h / 8 of the peak in a band of width h | [`EDGE`] for n |
//! | blended exponents | measured at probes | E / 2 |
//! | on the GPU: light gathered into points at spacing p | n p² / 24 (1 + 2 ln 1/c) for even light where the lobe is c of its peak | p² = [`GATHERED`] E / n, a quarter of [`EDGE`] for n < 2 |
//! | on the GPU: lobes end at the part c of their peak | at most 20 (n + 1) c, by what ε is at least | E / 10 |
//!
//! Blending depends on the environment: a sun outshines a dim sky down to where its lobe is as dim, and there
//! log S bends most between exponents. On the CPU the maps' own values are exact to far less than E (module
//! [`spectrum`](super::spectrum)).

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::prefilter::{blended, log2, three_weights};
use super::source::{Cap, Source};
use super::spectrum::{self, Spectrum};
use crate::scene::{Environment, environment::direction_of};
use lobelia_reflectance::{Rgb, colour};

/// See the table above.
const PIXEL: f32 = 4.0;
const GATHERED: f32 = 2.0;
/// Exponents below it are treated as it is.
const WIDEST: f32 = 4.0;
/// What stands for n below 2.
const EDGE: f32 = 48.0;
/// Slices an octave of exponents that are tried.
const STEPS: [u32; 6] = [1, 2, 3, 4, 6, 8];
/// Directions in which errors are measured.
const PROBES: usize = 96;

/// Spacing of the light's points for an exponent, radians.
fn source_spacing(n: f32, error: f32) -> f32 {
    let n = if n < 2.0 { EDGE / 4.0 } else { n.max(WIDEST) };
    (GATHERED * error / n).sqrt()
}

/// Rows of the map of an exponent.
pub(super) fn map_height(n: f32, error: f32) -> usize {
    let n = if n < 2.0 { EDGE } else { n.max(WIDEST) };
    ((PI / (PIXEL * error / n).sqrt()).ceil() as usize).max(16)
}

/// What errors are measured by.
pub(super) struct Judge {
    /// The direction of the brightest pixel, in the image's frame.
    bright: Vec3,
    /// Mean radiance.
    mean: f32,
}

impl Judge {
    /// Looks at an environment.
    pub(super) fn new(environment: &Environment) -> Self {
        let (width, height) = (environment.width, environment.height);
        let luminance = |i: &usize| colour::luminance(environment.pixels[*i]);
        let most = (0..width * height).max_by(|a, b| luminance(a).total_cmp(&luminance(b))).unwrap_or(0);
        let centre = |at: usize, size: usize| (at as f32 + 0.5) / size as f32;
        let edge = |row: usize| (f64::from(PI) * row as f64 / height as f64).cos();
        let rows = environment.pixels.chunks(width).enumerate().map(|(row, pixels)| {
            let part = (edge(row) - edge(row + 1)) / (2 * width) as f64;
            pixels.iter().map(|pixel| f64::from(pixel.length())).sum::<f64>() * part
        });
        Self {
            bright: direction_of(Vec2::new(centre(most % width, width), centre(most / width, height))),
            mean: rows.sum::<f64>() as f32,
        }
    }

    /// Directions to measure in: every other one anywhere, on a spiral; the others about the brightest light,
    /// as far as a lobe of the exponent sees it. `turn` gives other directions of the same kind.
    pub(super) fn directions(&self, n: f32, count: usize, turn: f32) -> Vec<Vec3> {
        // At this angle a lobe is at 1e-7 of its peak.
        let reach = (2.0 * 16.0 / (n + 1.0)).sqrt().min(PI);
        let (across, along) = self.bright.any_orthonormal_pair();
        let direction = |k: usize| {
            let part = (k as f32 + 0.5) / count as f32;
            let (sin, cos) = (k as f32 * 2.399_963 + turn * TAU).sin_cos();
            if k.is_multiple_of(2) {
                let y = 1.0 - 2.0 * part;
                let radius = (1.0 - y * y).sqrt();
                return Vec3::new(radius * cos, y, radius * sin);
            }
            let (sine, cosine) = (reach * part.sqrt()).sin_cos();
            self.bright * cosine + (across * cos + along * sin) * sine
        };
        (0..count).map(direction).collect()
    }

    /// The relative error of light under lobes of an exponent.
    pub(super) fn relative(&self, found: Rgb, truth: Rgb, n: f32) -> f32 {
        // The mean of cosⁿ over all directions is 1 / (2 (n + 1)).
        let floor = 0.1 * self.mean * TAU / (n + 1.0);
        let difference = (found - truth).length();
        if difference == 0.0 { 0.0 } else { difference / truth.length().hypot(floor) }
    }
}

/// Root mean square.
fn rms(errors: impl Iterator<Item = f32>) -> f32 {
    let (sum, count) = errors.fold((0.0, 0.0), |(sum, count), error| (sum + error * error, count + 1.0));
    (sum / f32::max(count, 1.0)).sqrt()
}

/// The environment's light as points for an exponent, and the lobe as far as it counts: what the GPU gathers.
pub(super) fn gathered(environment: &Environment, n: f32, error: f32) -> (Source, Cap) {
    // Beyond the lobe's end is at most the cut times all light, and ε is 0.05 / (n + 1) of that.
    let cut = error / (200.0 * (n + 1.0));
    (Source::new(environment, source_spacing(n, error)), Cap::new(n, cut))
}

/// Slices an octave of exponents so that three of them blended stay within half of the error at the probes.
pub(super) fn steps_per_octave(
    environment: &Environment,
    spectrum: &Spectrum,
    (low, high): (f32, f32),
    error: f32,
) -> u32 {
    let judge = Judge::new(environment);
    let octaves = (high / low).log2().ceil().max(1.0) as i32;
    let mut least = 0;
    for octave in 0..octaves {
        let top = high * 0.5f32.powi(octave);
        let probes = judge.directions(top, PROBES, 0.0);
        // Lower exponents may have more degrees, by their edge.
        let band = [top, 1.0].map(|n| spectrum::kernel(n, error).len()).into_iter().fold(0, usize::max);
        let degrees: Vec<_> = probes.into_par_iter().map(|toward| spectrum.degrees(toward, band)).collect();
        let log_light = |n: f32| -> Vec<Rgb> {
            let kernel = spectrum::kernel(n, error);
            degrees.iter().map(|degrees| log2(spectrum::light(degrees, &kernel))).collect()
        };
        let first = log_light(top);
        // What is enough for one octave is where the next begins.
        while least + 1 < STEPS.len() {
            let ratio = (-1.0 / STEPS[least] as f32).exp2();
            let nodes = [top * ratio * ratio, top * ratio, top];
            let n = top * ratio.sqrt();
            let [lowest, low, between] = [nodes[0], nodes[1], n].map(log_light);
            let weights = three_weights(nodes, n);
            let errors = (0..degrees.len()).map(|i| {
                let found = blended([lowest[i], low[i], first[i]], weights);
                judge.relative(found, between[i].map(f32::exp2), n)
            });
            if rms(errors) <= error / 2.0 {
                break;
            }
            least += 1;
        }
    }
    STEPS[least]
}
