//! No light is made, for fits that are no variable projection: directional albedo (see [`albedo`]) at most a
//! limit at every incidence, in every channel.
//!
//! A fit that breaks it is optimised again, shapes and colours together, by Levenberg–Marquardt on its own
//! residual with penalties (√μ (ln a)₊ an incidence and channel, μ rising); what is left above the limit,
//! some thousandths, is scaled away. It works alike for texels and tables and for any residual; derivatives
//! are differences, since only fits that break the law come here.

use glam::DVec3;

use super::coat::{Coat, WIDTHS};
use super::linear::solve_spd;
use super::model::{EXPONENTS, Turned};
use super::samples::{Samples, Target};
use lobelia_reflectance::{Lobe, LobeBrdf, Microfacet, Rgb, albedo};

/// How far an albedo may pass 1: the accuracy of the sums.
pub const TOLERANCE: f32 = 1e-3;
/// Albedo that is aimed at, of the limit.
const SHORT_OF: f64 = 0.998;
/// Weights of the squared penalty against the cost of a black fit, one after the other.
const PENALTIES: [f64; 3] = [0.1, 1.0, 10.0];
/// Most steps for each of them, and the share of the cost below which one is the last.
const STEPS: usize = 40;
const LEAST_GAIN: f64 = 1e-4;
/// Polar angles of the penalties, degrees; [`albedo::largest`] looks at more in the end.
const INCIDENCES_DEG: [f64; 9] = [0.0, 20.0, 40.0, 55.0, 65.0, 75.0, 80.0, 85.0, 89.0];
/// What a black ρ_d starts from, sr⁻¹; its logarithm is the unknown.
const DARK: f64 = 1e-5;
/// Largest ρ_s of a lobe that is scaled, sr⁻¹.
const MOST_SCALED: f32 = 1e12;
/// Step of differences.
const STEP: f64 = 1e-5;

/// The BRDF with no albedo above `limit`; none where it needs no change. `targets` has one entry for each of
/// `channels`, which are those of the BRDF's colours that the samples are of.
pub fn conserve(
    brdf: &LobeBrdf,
    samples: &Samples,
    channels: &[usize],
    targets: &[Target],
    limit: f64,
) -> Option<LobeBrdf> {
    let largest = albedo::largest(brdf);
    if channels.iter().all(|&channel| largest[channel] <= limit as f32 + TOLERANCE) {
        return None;
    }
    let problem = Problem { goal: SHORT_OF * limit, ..Problem::new(brdf, samples, channels, targets) };
    let mut x = problem.start();
    let size = problem.size();
    for penalty in PENALTIES {
        problem.minimise(&mut x, (penalty * size).sqrt());
    }
    Some(scaled(problem.point(&x).to_brdf(), limit as f32))
}

/// Scales channels whose albedo is above `limit`.
fn scaled(mut brdf: LobeBrdf, limit: f32) -> LobeBrdf {
    let limit = Rgb::splat(limit);
    let factor = limit / albedo::largest(&brdf).max(limit);
    brdf.rho_d *= factor;
    brdf.lobes.iter_mut().for_each(|lobe| lobe.rho_s *= factor);
    for coat in &mut brdf.microfacets {
        (coat.f0, coat.f90) = (coat.f0 * factor, coat.f90 * factor);
    }
    brdf
}

/// Sums over samples and channels of the squared residual and of the squared samples, sr⁻².
pub fn squares(brdf: &LobeBrdf, samples: &Samples) -> (f64, f64) {
    let (point, turned) = (Point::from(brdf), Turned::new(f64::from(brdf.beta)));
    let (mut error, mut whole) = (0.0, 0.0);
    for (k, &rgb) in samples.rgb.iter().enumerate() {
        let measured = DVec3::from_array(rgb);
        error += (point.value(&turned, samples, k) - measured).length_squared();
        whole += measured.length_squared();
    }
    (error, whole)
}

/// The sum over samples and channels of the squared residual times the sample's weight.
pub fn weighted_squares(brdf: &LobeBrdf, samples: &Samples) -> f64 {
    let (point, turned) = (Point::from(brdf), Turned::new(f64::from(brdf.beta)));
    let square = |(k, &rgb): (usize, &[f64; 3])| {
        samples.weight[k] * (point.value(&turned, samples, k) - DVec3::from_array(rgb)).length_squared()
    };
    samples.rgb.iter().enumerate().map(square).sum()
}

/// A BRDF in f64, so that differences have digits.
#[derive(Default)]
struct Point {
    rho_d: DVec3,
    beta: f64,
    /// ρ_s, C and the exponents at t = 1 and t = 0 (6.19), which differ where the lobe sharpens.
    lobes: Vec<(DVec3, DVec3, [f64; 2])>,
    /// f0, f90 and α.
    coats: Vec<(DVec3, DVec3, f64)>,
}

impl From<&LobeBrdf> for Point {
    fn from(brdf: &LobeBrdf) -> Self {
        let (lobes, coats) = (brdf.lobes.iter(), brdf.microfacets.iter());
        Self {
            rho_d: brdf.rho_d.as_dvec3(),
            beta: f64::from(brdf.beta),
            lobes: lobes
                .map(|l| {
                    (l.rho_s.as_dvec3(), l.c.as_dvec3(), [l.n, l.n_grazing.unwrap_or(l.n)].map(f64::from))
                })
                .collect(),
            coats: coats.map(|m| (m.f0.as_dvec3(), m.f90.as_dvec3(), f64::from(m.alpha))).collect(),
        }
    }
}

impl Point {
    /// Reflectance at sample k, sr⁻¹.
    fn value(&self, turned: &Turned, samples: &Samples, k: usize) -> DVec3 {
        let products = turned.products(samples, k);
        let mut value = self.rho_d;
        let t = samples.mean_cosine(k);
        for &(rho_s, c, [n, grazing]) in &self.lobes {
            let base = c.dot(products);
            if base > 0.0 {
                value += rho_s * ((n * t + grazing * (1.0 - t)) * base.ln()).exp();
            }
        }
        for &(f0, f90, alpha) in &self.coats {
            let [by_f0, by_f90, _] = Coat { f0: 1.0, f90: 1.0, alpha }.derivatives(samples, k);
            value += f0 * by_f0 + f90 * by_f90;
        }
        value
    }

    fn to_brdf(&self) -> LobeBrdf {
        let lobe = |&(rho_s, c, [n, grazing]): &(DVec3, DVec3, [f64; 2])| Lobe {
            n_grazing: (grazing != n).then_some(grazing as f32),
            ..Lobe::new(rho_s.as_vec3(), c.as_vec3(), n as f32)
        };
        let coat = |&(f0, f90, alpha): &(DVec3, DVec3, f64)| Microfacet {
            f0: f0.as_vec3(),
            f90: f90.as_vec3(),
            alpha: alpha as f32,
        };
        LobeBrdf {
            rho_d: self.rho_d.as_vec3(),
            beta: self.beta as f32,
            lobes: self.lobes.iter().map(lobe).collect(),
            microfacets: self.coats.iter().map(coat).collect(),
            ..LobeBrdf::default()
        }
    }

    /// Directional albedo for light from a direction.
    fn albedo(&self, wi: DVec3) -> DVec3 {
        let coats = LobeBrdf { microfacets: self.to_brdf().microfacets, ..LobeBrdf::default() };
        let mut sum = std::f64::consts::PI * self.rho_d;
        if !self.coats.is_empty() {
            sum += albedo::directional(&coats, wi.as_vec3()).as_dvec3();
        }
        let (sin, cos) = self.beta.sin_cos();
        let wi = DVec3::new(cos * wi.x + sin * wi.y, cos * wi.y - sin * wi.x, wi.z);
        for &(rho_s, c, exponents) in &self.lobes {
            sum += rho_s * albedo::lobe_on(c, exponents, wi, DVec3::Z);
        }
        sum
    }
}

/// Residuals and penalties as functions of the unknowns: logarithms of ρ_d, ρ_s, n, f0, f90 and α (black
/// colours of a lobe stay black), C as it is, and β.
struct Problem<'a> {
    brdf: LobeBrdf,
    isotropic: bool,
    samples: &'a Samples,
    channels: &'a [usize],
    targets: &'a [Target],
    incidences: Vec<DVec3>,
    /// Albedo that is aimed at.
    goal: f64,
}

impl<'a> Problem<'a> {
    fn new(brdf: &LobeBrdf, samples: &'a Samples, channels: &'a [usize], targets: &'a [Target]) -> Self {
        let isotropic = brdf.lobes.iter().all(|lobe| lobe.c.x == lobe.c.y);
        // The scale that C and ρ_s share: steps are about as long for all lobes where the largest |C| is 1.
        let scaled = |lobe: &Lobe| {
            // Of a lobe that sharpens the length of C counts.
            let same = if lobe.n_grazing.is_some() { *lobe } else { lobe.normalised() };
            if same.rho_s.max_element() < MOST_SCALED { same } else { *lobe }
        };
        let lobes = brdf.lobes.iter().map(scaled).collect();
        let direction = |degrees: f64, turn: f64| {
            let azimuth = f64::from(brdf.beta) + turn * std::f64::consts::PI;
            let (sin, cos) = degrees.to_radians().sin_cos();
            DVec3::new(sin * azimuth.cos(), sin * azimuth.sin(), cos)
        };
        let incidences = albedo::azimuths(isotropic)
            .iter()
            .flat_map(|&turn| INCIDENCES_DEG.map(|degrees| direction(degrees, turn)))
            .collect();
        Self {
            brdf: LobeBrdf { lobes, ..brdf.clone() },
            isotropic,
            samples,
            channels,
            targets,
            incidences,
            goal: SHORT_OF,
        }
    }

    /// The logarithms of a colour's channels that are not black.
    fn logs(&self, colour: Rgb) -> impl Iterator<Item = f64> {
        let lit = self.channels.iter().map(move |&channel| f64::from(colour[channel]));
        lit.filter(|&value| value > 0.0).map(f64::ln)
    }

    fn start(&self) -> Vec<f64> {
        let mut x: Vec<f64> =
            self.channels.iter().map(|&channel| f64::from(self.brdf.rho_d[channel]).max(DARK).ln()).collect();
        for lobe in &self.brdf.lobes {
            x.extend(self.logs(lobe.rho_s));
            let c = lobe.c.as_dvec3();
            x.extend(if self.isotropic { vec![c.x, c.z] } else { c.to_array().to_vec() });
            x.push(f64::from(lobe.n).ln());
            x.extend(lobe.n_grazing.map(|grazing| f64::from(grazing).ln()));
        }
        for coat in &self.brdf.microfacets {
            x.extend(self.logs(coat.f0));
            x.extend(self.logs(coat.f90));
            x.push(f64::from(coat.alpha).ln());
        }
        if !self.isotropic {
            x.push(f64::from(self.brdf.beta));
        }
        x
    }

    fn point(&self, x: &[f64]) -> Point {
        let mut x = x.iter().copied();
        let mut next = || x.next().unwrap_or_default();
        let mut point = Point::default();
        for &channel in self.channels {
            point.rho_d[channel] = next().exp();
        }
        let lit = |was: Rgb, next: &mut dyn FnMut() -> f64| {
            let mut colour = DVec3::ZERO;
            for &channel in self.channels.iter().filter(|&&channel| was[channel] > 0.0) {
                colour[channel] = next().exp();
            }
            colour
        };
        for lobe in &self.brdf.lobes {
            let rho_s = lit(lobe.rho_s, &mut next);
            let cx = next();
            let cy = if self.isotropic { cx } else { next() };
            let c = DVec3::new(cx, cy, next());
            let mut exponent = || next().exp().clamp(EXPONENTS[0], EXPONENTS[1]);
            let n = exponent();
            let grazing = if lobe.n_grazing.is_some() { exponent() } else { n };
            point.lobes.push((rho_s, c, [n, grazing]));
        }
        for coat in &self.brdf.microfacets {
            let (f0, f90) = (lit(coat.f0, &mut next), lit(coat.f90, &mut next));
            let alpha = next().exp().clamp(WIDTHS[0], WIDTHS[1]);
            point.coats.push((f0.min(DVec3::ONE), f90.min(DVec3::ONE), alpha));
        }
        if !self.isotropic {
            point.beta = next();
        }
        point
    }

    /// The cost of a black fit: how much there is to explain.
    fn size(&self) -> f64 {
        let of = |target: &Target| -> f64 {
            let residual = |k: usize| target.weight[k] * target.difference(0.0, self.samples.cos_o[k], k).0;
            (0..self.samples.len()).map(|k| residual(k).powi(2)).sum()
        };
        self.targets.iter().map(of).sum()
    }

    /// Residuals of all samples and channels, then `weight` times the logarithm of what the albedos exceed
    /// the goal by.
    fn residuals(&self, x: &[f64], weight: f64) -> Vec<f64> {
        let (point, samples) = (self.point(x), self.samples);
        let turned = Turned::new(point.beta);
        let mut residuals = Vec::with_capacity(self.channels.len() * (samples.len() + self.incidences.len()));
        for k in 0..samples.len() {
            let value = point.value(&turned, samples, k);
            for (&channel, target) in self.channels.iter().zip(self.targets) {
                let difference = target.difference(value[channel], samples.cos_o[k], k).0;
                residuals.push(target.weight[k] * difference);
            }
        }
        if weight > 0.0 {
            for &wi in &self.incidences {
                let albedo = point.albedo(wi);
                residuals.extend(
                    self.channels.iter().map(|&channel| weight * (albedo[channel] / self.goal).max(1.0).ln()),
                );
            }
        }
        residuals
    }

    /// Levenberg–Marquardt; never ends at a higher cost than it began with.
    fn minimise(&self, x: &mut Vec<f64>, weight: f64) {
        let square = |residuals: &[f64]| residuals.iter().map(|r| r * r).sum::<f64>();
        let size = x.len();
        let mut residuals = self.residuals(x, weight);
        let (mut cost, mut damping) = (square(&residuals), 1e-3);
        for _ in 0..STEPS {
            let columns: Vec<Vec<f64>> = (0..size)
                .map(|unknown| {
                    let mut moved = x.clone();
                    moved[unknown] += STEP;
                    let moved = self.residuals(&moved, weight);
                    moved.iter().zip(&residuals).map(|(a, b)| (a - b) / STEP).collect()
                })
                .collect();
            let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            let gradient: Vec<f64> = columns.iter().map(|column| -product(column, &residuals)).collect();
            let normal: Vec<f64> =
                (0..size * size).map(|i| product(&columns[i / size], &columns[i % size])).collect();
            let least = 1e-9 * (0..size).map(|i| normal[i * size + i]).fold(1e-300, f64::max);
            let before = cost;
            for _ in 0..8 {
                let (mut damped, mut step) = (normal.clone(), gradient.clone());
                for i in 0..size {
                    damped[i * size + i] += damping * normal[i * size + i].max(least);
                }
                if solve_spd(&mut damped, &mut step) {
                    let trial: Vec<f64> =
                        x.iter().zip(&step).map(|(x, step)| x + step.clamp(-0.7, 0.7)).collect();
                    let trial_residuals = self.residuals(&trial, weight);
                    let trial_cost = square(&trial_residuals);
                    if trial_cost < cost {
                        (*x, residuals, cost) = (trial, trial_residuals, trial_cost);
                        damping = (0.3 * damping).max(1e-9);
                        break;
                    }
                }
                damping *= 5.0;
            }
            if before - cost <= LEAST_GAIN * before {
                break;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Residual, testing};
    use super::*;
    use lobelia_reflectance::{Brdf, materials};

    fn targets(samples: &Samples, residual: Residual) -> Vec<Target> {
        (0..3)
            .map(|channel| {
                let mut target = Target::default();
                target.set(samples, samples.rgb.iter().map(|rgb| rgb[channel]), residual);
                target
            })
            .collect()
    }

    fn relative_error(brdf: &LobeBrdf, truth: &LobeBrdf) -> f32 {
        let (mut error, mut whole) = (0.0, 0.0);
        for (wi, wo) in testing::directions(300, 77) {
            let expected = truth.eval(wi, wo);
            error += (brdf.eval(wi, wo) - expected).length_squared();
            whole += expected.length_squared();
        }
        (error / whole).sqrt()
    }

    #[test]
    fn a_material_that_makes_energy_is_held_to_1_at_less_cost_than_by_darkening() {
        let truth = materials::published("brushed-metal").unwrap();
        let samples = testing::samples(&testing::directions(150, 5), |wi, wo| truth.eval(wi, wo));
        let targets = targets(&samples, Residual::Proportional);
        let held = conserve(&truth, &samples, &[0, 1, 2], &targets, 1.0).unwrap();
        let largest = albedo::largest(&held);
        assert!(largest.max_element() <= 1.0 + TOLERANCE, "{largest}");
        let (price, darkened) =
            (relative_error(&held, &truth), relative_error(&scaled(truth.clone(), 1.0), &truth));
        assert!(price < 0.02 && darkened > 0.2, "{price} {darkened}");
    }

    #[test]
    fn a_material_that_keeps_the_law_is_left_alone_and_an_anisotropic_one_is_held_too() {
        let clay = LobeBrdf::diffuse(Rgb::splat(0.5));
        let samples = testing::samples(&testing::directions(60, 6), |wi, wo| clay.eval(wi, wo));
        let of = targets(&samples, Residual::Linear);
        assert_eq!(conserve(&clay, &samples, &[0, 1, 2], &of, 1.0), None);
        let lobe = Lobe::new(Rgb::new(2.4, 2.0, 1.6), glam::Vec3::new(-1.1, -0.8, 0.9), 6.0);
        let metal = LobeBrdf { beta: 0.4, lobes: vec![lobe], ..LobeBrdf::diffuse(Rgb::splat(0.3)) };
        let samples = testing::samples(&testing::directions(80, 6), |wi, wo| metal.eval(wi, wo));
        let of = targets(&samples, Residual::Linear);
        let held = conserve(&metal, &samples, &[0, 1, 2], &of, 1.0).unwrap();
        let (before, after) = (albedo::largest(&metal), albedo::largest(&held));
        assert!(before.x > 1.1 && after.max_element() <= 1.0 + TOLERANCE, "{before} {after}");
        assert!((held.beta - 0.4).abs() < 0.1, "{}", held.beta);
    }
}
