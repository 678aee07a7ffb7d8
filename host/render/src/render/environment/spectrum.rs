//! An environment in spherical harmonics, L = Σ L_lm Y_lm, and the light under lobes by the theorem of Funk
//! and Hecke: S(ω, n) = Σ_l K_l Σ_m L_lm Y_lm(ω), K_l = 2π ∫₀¹ tⁿ P_l(t) dt.
//!
//! The image is taken as bilinear, as [`Environment::radiance_at`] has it, and projected without error of its
//! own: exactly along rows, by Gauss–Legendre quadrature between them. A map of exponent n costs rows ×
//! band², band about 7 √n, and a Fourier transform a row. All is in f64, so that a sun does not drown the
//! sky.

use std::f64::consts::{PI, TAU};

use glam::Vec3;
use pulp::{Arch, WithSimd};
use rayon::prelude::*;
use realfft::RealFftPlanner;
use realfft::num_complex::Complex64;

use super::accuracy;
use crate::scene::Environment;
use lobelia_reflectance::Rgb;

/// Rows that are computed at once.
const LANES: usize = 8;
/// Real and imaginary part of three channels.
const PARTS: usize = 6;
/// What the left-out degrees of a lobe may sum to, of its peak.
const TAIL: f64 = 1e-10;
/// Degrees of any lobe at least, if it has as many.
const LEAST_BAND: usize = 64;

type Lanes = [f64; LANES];

/// K_l of cosⁿ. A lobe of n below about 30 never ends, since it has an edge at 90°; its degrees stop at twice
/// what its map can hold.
pub(super) fn kernel(n: f32, error: f32) -> Vec<f64> {
    let most = (2 * accuracy::map_height(n, error)).max(LEAST_BAND);
    let n = f64::from(n);
    let mut degrees = vec![TAU / (n + 1.0), TAU / (n + 2.0)];
    for l in 0..most - 1 {
        let l = l as f64;
        degrees.push(degrees[degrees.len() - 2] * (n - l) / (n + l + 3.0));
    }
    let mut tail = 0.0;
    while let Some(last) = degrees.last() {
        tail += last.abs() * (2 * degrees.len() - 1) as f64 / (2.0 * TAU);
        if tail > TAIL {
            break;
        }
        degrees.pop();
    }
    degrees
}

/// One degree of one order: how λ_lm leads to λ_{l+1,m} = up₀ cosθ λ_lm − up₁ λ_{l−1,m}, and L_lm.
struct Term {
    up: [f64; 2],
    light: [f64; PARTS],
}

/// An environment's harmonics.
pub(super) struct Spectrum {
    /// By order m ≥ 0 and l − m; Y_lm = λ_lm(θ) e^{imφ}, orthonormal.
    orders: Vec<Vec<Term>>,
    /// λ_mm / sinᵐθ.
    seeds: Vec<f64>,
    /// What the vector code is compiled for.
    arch: Arch,
}

/// A latitude at which the image is projected: its weight, and between which rows it lies.
struct Latitude {
    polar: f64,
    weight: f64,
    rows: [usize; 2],
    part: f64,
}

/// One order of the light at some latitudes.
struct Project<'a>(&'a [Latitude], &'a [[Vec<Complex64>; 3]], usize, &'a mut [Term], f64);

impl WithSimd for Project<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        project(self.0, self.1, self.2, self.3, self.4);
    }
}

/// All orders at some latitudes.
struct Rings<'a>(&'a Spectrum, &'a [f64], &'a [f64]);

impl WithSimd for Rings<'_> {
    type Output = Vec<[Lanes; PARTS]>;
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Vec<[Lanes; PARTS]> {
        self.0.rings(self.1, self.2)
    }
}

impl Spectrum {
    /// Projects an environment without rotation on all harmonics that count under lobes of some exponents and
    /// an error.
    pub(super) fn new(environment: &Environment, exponents: &[f32], error: f32) -> Self {
        let band = exponents.iter().map(|&n| kernel(n, error).len()).fold(0, usize::max);
        let arch = Arch::new();
        let rows = transformed(environment, band);
        let latitudes = latitudes(environment.height, band);
        let mut seeds = vec![(2.0 * TAU).sqrt().recip()];
        for m in 1..band {
            seeds.push(seeds[m - 1] * (1.0 + 0.5 / m as f64).sqrt());
        }
        let orders = (0..band).into_par_iter().map(|m| {
            let mut terms: Vec<Term> =
                (m..band).map(|l| Term { up: up(l, m), light: [0.0; PARTS] }).collect();
            arch.dispatch(Project(&latitudes, &rows, m, &mut terms, seeds[m]));
            terms
        });
        let orders = orders.collect();
        Self { orders, seeds, arch }
    }

    /// S for peaks at the centres of the columns of an equirectangular map of `width`, an even number, and at
    /// rows of the polar angles given.
    pub(super) fn map(&self, kernel: &[f64], width: usize, polar: &[f64]) -> Vec<Rgb> {
        let plan = RealFftPlanner::<f64>::new().plan_fft_inverse(width);
        let first_column = PI / width as f64 - PI;
        let turns: Vec<Complex64> = (0..self.orders.len().min(kernel.len()))
            .map(|m| Complex64::from_polar(1.0, m as f64 * first_column))
            .collect();
        let mut pixels = vec![Rgb::ZERO; width * polar.len()];
        let blocks = pixels.par_chunks_mut(width * LANES).zip(polar.par_chunks(LANES));
        blocks.for_each(|(pixels, polar)| {
            let rings = self.arch.dispatch(Rings(self, kernel, polar));
            let (mut spectrum, mut row) = (plan.make_input_vec(), plan.make_output_vec());
            for (lane, pixels) in pixels.chunks_mut(width).enumerate() {
                for channel in 0..3 {
                    spectrum.fill(Complex64::ZERO);
                    for (m, (ring, turn)) in rings.iter().zip(&turns).enumerate() {
                        let value = Complex64::new(ring[channel][lane], ring[channel + 3][lane]) * turn;
                        fold(&mut spectrum, m, value, width);
                    }
                    if plan.process(&mut spectrum, &mut row).is_ok() {
                        for (pixel, value) in pixels.iter_mut().zip(&row) {
                            pixel[channel] = value.max(0.0) as f32;
                        }
                    }
                }
            }
        });
        pixels
    }

    /// Every degree's part of the light from about a direction, Σ_m L_lm Y_lm(ω): S(ω, n) is their sum, each
    /// times K_l.
    pub(super) fn degrees(&self, direction: Vec3, band: usize) -> Vec<[f64; 3]> {
        let direction = direction.as_dvec3().normalize();
        let (cos, sin) = (direction.y, direction.x.hypot(direction.z));
        let azimuth = direction.x.atan2(-direction.z);
        let mut degrees = vec![[0.0; 3]; band.min(self.orders.len())];
        for (m, terms) in self.orders.iter().enumerate().take(degrees.len()) {
            // Orders below zero are the others' conjugates.
            let (turn_sin, turn_cos) = (m as f64 * azimuth).sin_cos();
            let twice = if m == 0 { 1.0 } else { 2.0 };
            let (mut before, mut here) = (0.0, twice * self.seeds[m] * sin.powi(m as i32));
            for (sums, Term { up, light }) in degrees[m..].iter_mut().zip(terms) {
                for (channel, sum) in sums.iter_mut().enumerate() {
                    *sum += here * (light[channel] * turn_cos - light[channel + 3] * turn_sin);
                }
                (before, here) = (here, up[0] * cos * here - up[1] * before);
            }
        }
        degrees
    }

    /// Σ_l K_l L_lm λ_lm(θ) for every order and up to [`LANES`] polar angles.
    #[inline(always)]
    fn rings(&self, kernel: &[f64], polar: &[f64]) -> Vec<[Lanes; PARTS]> {
        let (sin, cos) = sines(polar.iter().copied());
        let mut rings = vec![[[0.0; LANES]; PARTS]; self.orders.len().min(kernel.len())];
        for (m, sums) in rings.iter_mut().enumerate() {
            let mut here = sin.map(|sin| self.seeds[m] * sin.powi(m as i32));
            let mut before = [0.0; LANES];
            // Too near to the poles for this order and those above it.
            if here == before {
                break;
            }
            for (Term { up, light }, weight) in self.orders[m].iter().zip(&kernel[m..]) {
                let mut weighted = here;
                for value in &mut weighted {
                    *value *= weight;
                }
                for (sum, light) in sums.iter_mut().zip(light) {
                    for lane in 0..LANES {
                        sum[lane] += light * weighted[lane];
                    }
                }
                step(up, &cos, &mut before, &mut here);
            }
        }
        rings
    }
}

/// S by the degrees of a direction and of a lobe.
pub(super) fn light(degrees: &[[f64; 3]], kernel: &[f64]) -> Rgb {
    let sum = |channel: usize| degrees.iter().zip(kernel).map(|(light, k)| light[channel] * k).sum::<f64>();
    Rgb::from_array([0, 1, 2].map(|channel| sum(channel).max(0.0) as f32))
}

/// Coefficients of the recurrence from degree l to l + 1.
fn up(l: usize, m: usize) -> [f64; 2] {
    let a = |l: usize| {
        let (l, m) = (l as f64, m as f64);
        ((4.0 * l * l - 1.0) / (l * l - m * m)).sqrt()
    };
    // λ_{m−1,m} is 0.
    [a(l + 1), if l > m { a(l + 1) / a(l) } else { 0.0 }]
}

/// Sines and cosines of up to [`LANES`] angles.
fn sines(polar: impl Iterator<Item = f64>) -> (Lanes, Lanes) {
    let (mut sin, mut cos) = ([0.0; LANES], [0.0; LANES]);
    for (lane, polar) in polar.enumerate() {
        (sin[lane], cos[lane]) = polar.sin_cos();
    }
    (sin, cos)
}

/// From λ_lm to λ_{l+1,m}.
#[inline(always)]
fn step(up: &[f64; 2], cos: &Lanes, before: &mut Lanes, here: &mut Lanes) {
    for lane in 0..LANES {
        let next = up[0] * cos[lane] * here[lane] - up[1] * before[lane];
        (before[lane], here[lane]) = (here[lane], next);
    }
}

/// Adds an order to the half spectrum of a row of `width` values; orders that a row cannot tell apart fall
/// together.
fn fold(spectrum: &mut [Complex64], m: usize, value: Complex64, width: usize) {
    let at = m % width;
    match at {
        _ if m == 0 => spectrum[0] += value.re,
        _ if at == 0 || 2 * at == width => spectrum[at] += 2.0 * value.re,
        _ if 2 * at < width => spectrum[at] += value,
        _ => spectrum[width - at] += value.conj(),
    }
}

/// ∫ L e^{−imφ} dφ of every row and channel, L piecewise linear between the pixels' centres, for m below
/// `band`.
fn transformed(environment: &Environment, band: usize) -> Vec<[Vec<Complex64>; 3]> {
    let width = environment.width;
    let plan = RealFftPlanner::<f64>::new().plan_fft_forward(width);
    let pitch = TAU / width as f64;
    let first_column = 0.5 * pitch - PI;
    let weights: Vec<Complex64> = (0..band)
        .map(|m| {
            let half = 0.5 * pitch * m as f64;
            let sinc = if m == 0 { 1.0 } else { half.sin() / half };
            Complex64::from_polar(pitch * sinc * sinc, -(m as f64) * first_column)
        })
        .collect();
    let rows = environment.pixels.par_chunks(width).map(|pixels| {
        [0, 1, 2].map(|channel| {
            let mut row: Vec<f64> = pixels.iter().map(|pixel| f64::from(pixel[channel])).collect();
            let mut spectrum = plan.make_output_vec();
            if plan.process(&mut row, &mut spectrum).is_err() {
                spectrum.fill(Complex64::ZERO);
            }
            let order = |(m, weight): (usize, &Complex64)| {
                let at = m % width;
                weight * if 2 * at <= width { spectrum[at] } else { spectrum[width - at].conj() }
            };
            weights.iter().enumerate().map(order).collect()
        })
    });
    rows.collect()
}

/// Gauss–Legendre nodes between the centres of every two rows, as many as degrees below `band` ask for.
fn latitudes(rows: usize, band: usize) -> Vec<Latitude> {
    let pitch = PI / rows as f64;
    let nodes = gauss_legendre(3 + (pitch * band as f64).ceil() as usize);
    let between = |i: usize| {
        let low = (i as f64 - 0.5).max(0.0) * pitch;
        let high = (i as f64 + 0.5).min(rows as f64) * pitch;
        let nodes = nodes.iter().map(move |&(x, weight)| {
            let polar = 0.5 * (low + high) + 0.5 * (high - low) * x;
            Latitude {
                polar,
                weight: weight * 0.5 * (high - low) * polar.sin(),
                rows: [i.saturating_sub(1), i.min(rows - 1)],
                part: polar / pitch + 0.5 - i as f64,
            }
        });
        nodes.collect::<Vec<_>>()
    };
    (0..=rows).flat_map(between).collect()
}

/// Nodes and weights on −1..1.
fn gauss_legendre(count: usize) -> Vec<(f64, f64)> {
    let node = |k: usize| {
        let mut x = (PI * (k as f64 + 0.75) / (count as f64 + 0.5)).cos();
        let mut slope = 1.0;
        for _ in 0..6 {
            let (mut before, mut here) = (1.0, x);
            for l in 1..count {
                let l = l as f64;
                (before, here) = (here, ((2.0 * l + 1.0) * x * here - l * before) / (l + 1.0));
            }
            slope = count as f64 * (before - x * here) / (1.0 - x * x);
            x -= here / slope;
        }
        (x, 2.0 / ((1.0 - x * x) * slope * slope))
    };
    (0..count).map(node).collect()
}

/// L_lm of one order: the sum of its light at all latitudes, times λ_lm.
#[inline(always)]
fn project(latitudes: &[Latitude], rows: &[[Vec<Complex64>; 3]], m: usize, terms: &mut [Term], seed: f64) {
    let mut sums = vec![[[0.0; LANES]; PARTS]; terms.len()];
    for latitudes in latitudes.chunks(LANES) {
        let (sin, cos) = sines(latitudes.iter().map(|latitude| latitude.polar));
        let mut light = [[0.0; LANES]; PARTS];
        for (lane, Latitude { weight, rows: [above, below], part, .. }) in latitudes.iter().enumerate() {
            for channel in 0..3 {
                let (above, below) = (rows[*above][channel][m], rows[*below][channel][m]);
                let value = (above + (below - above) * part) * weight;
                (light[channel][lane], light[channel + 3][lane]) = (value.re, value.im);
            }
        }
        let mut here = sin.map(|sin| seed * sin.powi(m as i32));
        let mut before = [0.0; LANES];
        if here == before {
            continue;
        }
        for (sums, Term { up, .. }) in sums.iter_mut().zip(terms.iter()) {
            for (sum, light) in sums.iter_mut().zip(&light) {
                for lane in 0..LANES {
                    sum[lane] += light[lane] * here[lane];
                }
            }
            step(up, &cos, &mut before, &mut here);
        }
    }
    for (term, sums) in terms.iter_mut().zip(&sums) {
        term.light = sums.map(|lanes| lanes.iter().sum());
    }
}

#[cfg(test)]
mod tests {
    use super::super::quadrature;
    use super::*;
    use crate::scene::environment::direction_of;
    use glam::Vec2;

    /// A dim sky with a lamp of one pixel, 10⁴ times as bright.
    fn lamp() -> Environment {
        let mut pixels: Vec<Rgb> =
            (0..24 * 12).map(|i| Rgb::new(0.2 + 0.01 * (i % 7) as f32, 0.3, 0.1)).collect();
        pixels[4 * 24 + 17] = Rgb::new(1e4, 2e3, 5e3);
        Environment::new(24, 12, pixels).unwrap()
    }

    #[test]
    fn quadrature_of_gauss_and_legendre_is_exact_for_polynomials() {
        for count in [3, 4, 7, 12] {
            let nodes = gauss_legendre(count);
            let moment = |power: i32| nodes.iter().map(|(x, w)| w * x.powi(power)).sum::<f64>();
            for power in 0..2 * count as i32 {
                let expected = if power % 2 == 0 { 2.0 / f64::from(power + 1) } else { 0.0 };
                assert!((moment(power) - expected).abs() < 1e-13, "{count} {power}: {}", moment(power));
            }
        }
    }

    #[test]
    fn a_lobe_s_degrees_are_those_of_quadrature() {
        // P_0, P_1, P_2, P_3 and P_6 over 0..1.
        type Polynomial = fn(f64) -> f64;
        let p: [(usize, Polynomial); 5] = [
            (0, |_| 1.0),
            (1, |t| t),
            (2, |t| 1.5 * t * t - 0.5),
            (3, |t| 2.5 * t.powi(3) - 1.5 * t),
            (6, |t| (231.0 * t.powi(6) - 315.0 * t.powi(4) + 105.0 * t * t - 5.0) / 16.0),
        ];
        for n in [1.0f32, 2.5, 9.0, 120.0] {
            let kernel = kernel(n, 0.03);
            for (l, p) in p {
                let term = |k: i32| {
                    let t = (f64::from(k) + 0.5) / 20_000.0;
                    t.powf(f64::from(n)) * p(t)
                };
                let expected = TAU * (0..20_000).map(term).sum::<f64>() / 20_000.0;
                let found = kernel.get(l).copied().unwrap_or_default();
                assert!((found - expected).abs() < 1e-6, "{n} {l}: {found} {expected}");
            }
        }
        // The band grows with the root of the exponent.
        let band = |n: f32| kernel(n, 0.01).len() as f64;
        assert!((band(6400.0) / band(400.0) - 4.0).abs() < 0.2);
    }

    #[test]
    fn maps_and_single_directions_are_those_of_quadrature() {
        let environment = lamp();
        let judge = accuracy::Judge::new(&environment);
        // RMS over directions; at the edge of the first the missing degrees show.
        for (n, most) in [(1.0f32, 1e-2), (2.5, 5e-4), (20.0, 5e-4), (200.0, 5e-4)] {
            let mut squares = 0.0;
            let kernel = kernel(n, 0.03);
            let spectrum = Spectrum::new(&environment, &[n], 0.03);
            let polar = [0.0, 0.4, 1.2, 1.3, 1.9, 2.6, PI];
            // So few columns that orders fall together.
            let map = spectrum.map(&kernel, 10, &polar);
            for (index, &found) in map.iter().enumerate() {
                let uv = Vec2::new((index % 10) as f32 / 10.0 + 0.05, (polar[index / 10] / PI) as f32);
                let expected = quadrature::light(&environment, direction_of(uv), n);
                let alone = light(&spectrum.degrees(direction_of(uv), kernel.len()), &kernel);
                for found in [found, alone] {
                    squares += judge.relative(found, expected, n).powi(2) / (2 * map.len()) as f32;
                }
            }
            assert!(squares.sqrt() < most, "{n}: {}", squares.sqrt());
        }
    }
}
