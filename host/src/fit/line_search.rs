//! The published line search for one lobe: Brent's method over n; at each n the n-th root of the samples is linear in C
//! (4.8), (4.9), and the residual of that linear system is the error.
//!
//! It is fast and has no local minima in C, but the root blows small noisy values up: the exponent comes out too low on noisy samples
//! (stability case G1). Kept as published for comparison. One addition: the base is linear in the four entries of a symmetric C
//! turned about the normal, so the anisotropic search gets β from the same system.

use glam::DVec3;

use super::linear::solve_spd;
use super::lm::Freedom;
use super::model::{Model, ModelLobe};
use super::samples::{Samples, Target};

/// Range of n that is searched.
const RANGE: [f64; 2] = [0.5, 2000.0];
/// Places at which the bracket for Brent's method is looked for.
const BRACKETS: usize = 12;
/// Brent's method stops at this width in ln n.
const WIDTH: f64 = 1e-4;

/// The linear system at one n.
struct Roots<'a> {
    samples: &'a Samples,
    /// Index, ln of the residual after ρ_d, squared weight; samples at or below ρ_d have no root and are left out.
    lit: Vec<(usize, f64, f64)>,
    isotropic: bool,
}

impl Roots<'_> {
    /// Coefficients of the base in (xx, yy, zz, xy) and the mean squared residual of the system at n.
    fn solve(&self, n: f64) -> Option<([f64; 4], f64)> {
        let size = if self.isotropic { 2 } else { 4 };
        let (mut matrix, mut rhs) = (vec![0.0; size * size], vec![0.0; size]);
        let row = |k: usize| {
            let s = self.samples;
            if self.isotropic {
                [s.xx[k] + s.yy[k], s.zz[k], 0.0, 0.0]
            } else {
                [s.xx[k], s.zz[k], s.yy[k], s.xy[k]]
            }
        };
        let (mut squares, mut total) = (0.0, 0.0);
        for &(k, log, weight) in &self.lit {
            let root = (log / n).exp();
            let row = row(k);
            for i in 0..size {
                rhs[i] += weight * row[i] * root;
                for j in 0..size {
                    matrix[i * size + j] += weight * row[i] * row[j];
                }
            }
            squares += weight * root * root;
            total += weight;
        }
        for i in 0..size {
            matrix[i * size + i] *= 1.0 + 1e-12;
        }
        let right = rhs.clone();
        if !solve_spd(&mut matrix, &mut rhs) {
            return None;
        }
        let explained: f64 = rhs.iter().zip(&right).map(|(x, y)| x * y).sum();
        let c = if self.isotropic { [rhs[0], rhs[0], rhs[1], 0.0] } else { [rhs[0], rhs[2], rhs[1], rhs[3]] };
        Some((c, (squares - explained).max(0.0) / total))
    }

    fn error(&self, n: f64) -> f64 {
        self.solve(n).map_or(f64::INFINITY, |(_, error)| error)
    }
}

/// Fits one lobe to the target above a known ρ_d. Without a solution (too few samples above ρ_d) the model is diffuse.
pub fn fit(samples: &Samples, target: &Target, diffuse: f64, freedom: Freedom) -> Model {
    let mut model = Model { diffuse, ..Model::default() };
    let lit = (0..samples.len())
        .filter(|&k| target.value[k] > diffuse)
        .map(|k| (k, (target.value[k] - diffuse).ln(), samples.weight[k]))
        .collect();
    let roots = Roots { samples, lit, isotropic: freedom.isotropic };
    if roots.lit.len() < 6 {
        return model;
    }
    let n = minimise(|log| roots.error(log.exp()), RANGE[0].ln(), RANGE[1].ln()).exp();
    let Some(([xx, yy, zz, xy], _)) = roots.solve(n) else { return model };
    // Eigenvectors of [[xx, xy], [xy, yy]]: base = xx·x + yy·y + xy·(ω_ix ω_oy + ω_iy ω_ox) + zz·z.
    let beta = if xy == 0.0 { 0.0 } else { 0.5 * (2.0 * xy).atan2(xx - yy) };
    let (sin, cos) = beta.sin_cos();
    let cx = if xy == 0.0 { xx } else { xx * cos * cos + yy * sin * sin + 2.0 * xy * sin * cos };
    let cy = if xy == 0.0 { yy } else { xx * sin * sin + yy * cos * cos - 2.0 * xy * sin * cos };
    let c = DVec3::new(cx, cy, zz);
    model.beta = beta;
    if let Some(lobe) = ModelLobe::over(samples, c, n) {
        let amplitude = (n * (lobe.reference * c.length()).ln()).exp();
        model.lobes.push(ModelLobe { amplitude, ..lobe });
    }
    model
}

/// The least place of a function: the best of a few brackets, then Brent's method (parabolas, golden section where they fail).
fn minimise(mut f: impl FnMut(f64) -> f64, low: f64, high: f64) -> f64 {
    let step = (high - low) / BRACKETS as f64;
    let values: Vec<f64> = (0..=BRACKETS).map(|i| f(low + step * i as f64)).collect();
    let best = (0..=BRACKETS).min_by(|&a, &b| values[a].total_cmp(&values[b])).unwrap_or(0);
    let (mut a, mut b) =
        (low + step * best.saturating_sub(1) as f64, low + step * (best + 1).min(BRACKETS) as f64);
    const GOLDEN: f64 = 0.381_966_011_250_105;
    let mut x = low + step * best as f64;
    let (mut w, mut v) = (x, x);
    let mut fx = values[best];
    let (mut fw, mut fv) = (fx, fx);
    let (mut d, mut e) = (0.0f64, 0.0f64);
    for _ in 0..60 {
        let middle = 0.5 * (a + b);
        if (x - middle).abs() <= 2.0 * WIDTH - 0.5 * (b - a) {
            break;
        }
        let r = (x - w) * (fx - fv);
        let q = (x - v) * (fx - fw);
        let p = (x - v) * q - (x - w) * r;
        let q = 2.0 * (q - r);
        let (p, q) = if q > 0.0 { (-p, q) } else { (p, -q) };
        if e.abs() > WIDTH && p.abs() < (0.5 * q * e).abs() && p > q * (a - x) && p < q * (b - x) {
            e = d;
            d = p / q;
        } else {
            e = if x < middle { b - x } else { a - x };
            d = GOLDEN * e;
        }
        let u = if d.abs() >= WIDTH { x + d } else { x + WIDTH.copysign(d) };
        let fu = f(u);
        if fu <= fx {
            if u < x {
                b = x
            } else {
                a = x
            }
            (v, fv, w, fw, x, fx) = (w, fw, x, fx, u, fu);
        } else {
            if u < x {
                a = u
            } else {
                b = u
            }
            if fu <= fw || w == x {
                (v, fv, w, fw) = (w, fw, u, fu);
            } else if fu <= fv || v == x || v == w {
                (v, fv) = (u, fu);
            }
        }
    }
    x
}

#[cfg(test)]
mod tests {
    use super::super::{Residual, testing};
    use super::*;
    use crate::reflectance::{Brdf, Lobe, LobeBrdf, Rgb};
    use glam::Vec3;

    fn fitted(c: Vec3, n: f32, beta: f32, isotropic: bool) -> (Model, LobeBrdf) {
        let lobe = Lobe::new(Rgb::splat(0.6), c, n);
        let truth = LobeBrdf { rho_d: Rgb::ZERO, beta, lobes: vec![lobe], ..LobeBrdf::default() };
        let samples = testing::samples(&testing::directions(200, 6), |wi, wo| truth.eval(wi, wo));
        let mut target = Target::default();
        target.set(&samples, samples.value.iter().copied(), Residual::Linear);
        (fit(&samples, &target, 0.0, Freedom { isotropic, diffuse: false }), truth)
    }

    #[test]
    fn a_wide_lobe_without_noise_is_found() {
        let (model, truth) = fitted(Vec3::new(-0.9, -0.9, 1.0), 6.0, 0.0, true);
        assert!((model.lobes[0].n / 6.0 - 1.0).abs() < 0.05, "{model:?}");
        let brdf = model.to_brdf(Rgb::ZERO, &[Rgb::splat(model.lobes[0].amplitude as f32)]);
        let error = testing::relative_error(&brdf, &truth, &testing::directions(300, 7));
        assert!(error < 0.02, "{error}");
    }

    #[test]
    fn the_direction_of_anisotropy_follows_from_the_linear_system() {
        let (model, truth) = fitted(Vec3::new(-1.0, -0.6, 0.9), 5.0, 0.35, false);
        let brdf = model.to_brdf(Rgb::ZERO, &[Rgb::splat(model.lobes[0].amplitude as f32)]);
        assert!((brdf.beta - 0.35).abs() < 0.02, "{brdf:?}");
        let error = testing::relative_error(&brdf, &truth, &testing::directions(300, 7));
        assert!(error < 0.03, "{error}");
    }

    #[test]
    fn brent_finds_the_minimum_of_a_skewed_valley() {
        let x = minimise(|x| (x - 1.234f64).powi(2) * (2.0 + x), -1.0, 8.0);
        assert!((x - 1.234).abs() < 1e-3, "{x}");
    }

    #[test]
    fn black_samples_give_a_diffuse_model() {
        let samples = testing::samples(&testing::directions(50, 6), |_, _| Rgb::ZERO);
        let mut target = Target::default();
        target.set(&samples, samples.value.iter().copied(), Residual::Linear);
        let model = fit(&samples, &target, 0.0, Freedom { isotropic: true, diffuse: false });
        assert!(model.lobes.is_empty());
    }
}
