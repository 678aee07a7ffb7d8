//! The pairs of directions at which BRDFs are compared and blended.
//!
//! The light's direction follows the cosine. The viewer's follows the cosine in one half of the pairs and one
//! of the BRDFs' own lobes in the other, so that a narrow highlight is met as well. Weights make up for that
//! choice (the balance heuristic): weighted means over the pairs are means over all pairs of directions with
//! the weight cosθ_i cosθ_o. No chance is in it: the directions come from a low-discrepancy sequence.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3, Vec4};

use lobelia_reflectance::{Brdf, Lobe, LobeBrdf, Rgb, lobe::into_lobe_frame};

/// Most lobes that the viewer's directions follow.
const MOST_LOBES: usize = 128;

/// Steps of the four-dimensional additive sequence whose steps are powers of the root of x⁵ = x + 1.
const STEPS: [f64; 4] =
    [0.856_674_883_854_502_9, 0.733_891_856_627_126, 0.628_706_721_037_810_7, 0.538_596_985_033_713_1];

/// Pairs of directions with weights that sum to 1.
#[derive(Debug, Clone)]
pub struct Pairs {
    /// Toward the light and toward the viewer.
    pub directions: Vec<(Vec3, Vec3)>,
    /// Weight a pair.
    pub weights: Vec<f32>,
}

impl Pairs {
    /// About `count` pairs for these BRDFs (those whose viewer would be below the horizon are left out).
    pub fn over<'a>(brdfs: impl IntoIterator<Item = &'a LobeBrdf>, count: usize) -> Self {
        let lobes = spread(brdfs);
        let mut pairs = Self { directions: Vec::with_capacity(count), weights: Vec::with_capacity(count) };
        for k in 0..count {
            let at = Vec4::from_array(STEPS.map(|step| (0.5 + step * (k + 1) as f64).fract() as f32));
            let wi = by_power(Vec3::Z, 1.0, at.x, at.y);
            let follows = if k % 2 == 0 { None } else { lobes.get(k / 2 % lobes.len().max(1)) };
            let wo = match follows {
                Some(lobe) => by_power(lobe.axis(wi), lobe.n, at.z, at.w),
                None => by_power(Vec3::Z, 1.0, at.z, at.w),
            };
            if wi.z > 0.0 && wo.z > 0.0 {
                let density = density(&lobes, wi, wo);
                pairs.directions.push((wi, wo));
                pairs.weights.push(wo.z / PI / density);
            }
        }
        let whole: f32 = pairs.weights.iter().sum();
        pairs.weights.iter_mut().for_each(|weight| *weight /= whole);
        pairs
    }

    /// Reflectance of a BRDF at every pair, sr⁻¹.
    pub fn reflectance(&self, brdf: &LobeBrdf) -> Vec<Rgb> {
        self.directions.iter().map(|&(wi, wo)| brdf.eval(wi, wo)).collect()
    }

    /// Root of the weighted mean square over pairs and channels, for differences or values a pair; sr⁻¹.
    pub fn rms(&self, values: impl Iterator<Item = Rgb>) -> f64 {
        let squares =
            values.zip(&self.weights).map(|(value, &weight)| f64::from(weight * value.length_squared()));
        (squares.sum::<f64>() / 3.0).sqrt()
    }

    /// Mean over all directions of light of the albedo that they see, a channel (the cosine-weighted mean
    /// reflectance times π).
    pub fn albedo(&self, brdf: &LobeBrdf) -> Rgb {
        self.reflectance(brdf).into_iter().zip(&self.weights).map(|(f, &weight)| weight * f).sum::<Rgb>() * PI
    }

    /// Cube roots of the reflectance at every pair and channel, times the root of the pair's weight. Squared
    /// differences sum to a weighted mean over all directions on a scale like the eye's: on the linear one
    /// highlights would decide alone, and dark colours that the eye tells apart would count as one.
    pub fn features(&self, brdf: &LobeBrdf) -> Vec<f32> {
        let weighted = self.reflectance(brdf).into_iter().zip(&self.weights);
        weighted.flat_map(|(f, weight)| f.to_array().map(|f| f.cbrt() * weight.sqrt())).collect()
    }

    /// RMS difference of two BRDFs over all pairs of directions, weighted by cosθ_i cosθ_o, sr⁻¹.
    pub fn distance(&self, a: &LobeBrdf, b: &LobeBrdf) -> f64 {
        self.rms(self.directions.iter().map(|&(wi, wo)| a.eval(wi, wo) - b.eval(wi, wo)))
    }
}

/// A lobe in its BRDF's frame.
struct Followed {
    lobe: Lobe,
    beta: f32,
    n: f32,
}

impl Followed {
    /// The direction of the lobe's peak for light from `wi`.
    fn axis(&self, wi: Vec3) -> Vec3 {
        let peak = self.lobe.peak(into_lobe_frame(wi, Vec2::ZERO, self.beta));
        into_lobe_frame(peak, Vec2::ZERO, -self.beta).try_normalize().unwrap_or(Vec3::Z)
    }
}

/// At most [`MOST_LOBES`] of the BRDFs' lobes, evenly taken.
fn spread<'a>(brdfs: impl IntoIterator<Item = &'a LobeBrdf>) -> Vec<Followed> {
    let of = |brdf: &'a LobeBrdf| {
        let lit = brdf.lobes.iter().filter(|lobe| lobe.rho_s != Rgb::ZERO);
        lit.map(|&lobe| Followed { lobe, beta: brdf.beta, n: lobe.n })
    };
    let mut lobes: Vec<Followed> = brdfs.into_iter().flat_map(of).collect();
    let step = lobes.len().div_ceil(MOST_LOBES).max(1);
    let mut place = 0;
    lobes.retain(|_| {
        place += 1;
        (place - 1) % step == 0
    });
    lobes
}

/// A direction whose density about an axis is (n + 1) / 2π cosⁿ.
fn by_power(axis: Vec3, n: f32, u: f32, v: f32) -> Vec3 {
    let cos = u.powf(1.0 / (n + 1.0));
    let sin = (1.0 - cos * cos).max(0.0).sqrt();
    let (across, along) = axis.any_orthonormal_pair();
    let (s, c) = (TAU * v).sin_cos();
    (across * (sin * c) + along * (sin * s) + axis * cos).normalize()
}

/// Density of the viewer's direction over the choice of its distribution, sr⁻¹.
fn density(lobes: &[Followed], wi: Vec3, wo: Vec3) -> f32 {
    let cosine = wo.z / PI;
    if lobes.is_empty() {
        return cosine;
    }
    let of = |lobe: &Followed| (lobe.n + 1.0) / TAU * lobe.axis(wi).dot(wo).max(0.0).powf(lobe.n);
    0.5 * cosine + 0.5 * lobes.iter().map(of).sum::<f32>() / lobes.len() as f32
}

/// Sum of the squared differences of two lists of features, in eight partial sums so that it vectorises.
pub fn squared_distance(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0f32; 8];
    let (a8, b8) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f32 = a8.remainder().iter().zip(b8.remainder()).map(|(a, b)| (a - b) * (a - b)).sum();
    for (a, b) in a8.zip(b8) {
        for lane in 0..8 {
            sums[lane] += (a[lane] - b[lane]) * (a[lane] - b[lane]);
        }
    }
    sums.iter().sum::<f32>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_reflectance::materials;

    /// Phong's lobe with the given exponent.
    fn phong(n: f32) -> LobeBrdf {
        LobeBrdf { lobes: vec![Lobe::new(Rgb::ONE, Vec3::new(-1.0, -1.0, 1.0), n)], ..LobeBrdf::default() }
    }

    #[test]
    fn diffuse_brdfs_differ_by_the_difference_of_their_reflectance() {
        let diffuse = |albedo| LobeBrdf::diffuse(Rgb::splat(albedo));
        let pairs = Pairs::over([&phong(40.0)], 256);
        let distance = pairs.distance(&diffuse(0.9), &diffuse(0.2));
        assert!((distance - 0.7 / std::f64::consts::PI).abs() < 1e-6, "{distance}");
        assert!((pairs.weights.iter().sum::<f32>() - 1.0).abs() < 1e-5);
        assert!((pairs.albedo(&diffuse(0.9)).x - 0.9).abs() < 1e-5);
        let features = |albedo| pairs.features(&diffuse(albedo));
        let roots = (0.9f32 / PI).cbrt() - (0.2f32 / PI).cbrt();
        assert!(
            (squared_distance(&features(0.9), &features(0.2)) / (3.0 * roots * roots) - 1.0).abs() < 1e-4
        );
    }

    /// ∫∫ f² cosθ_i cosθ_o dω_i dω_o / π² by a regular grid; f of an isotropic BRDF.
    fn mean_square(brdf: &LobeBrdf) -> f64 {
        let (steps, turns) = (180, 360);
        let angle = |k: usize| (k as f32 + 0.5) / steps as f32 * PI / 2.0;
        let mut sum = 0.0;
        for i in 0..steps {
            let wi = Vec3::new(angle(i).sin(), 0.0, angle(i).cos());
            for o in 0..steps {
                let (sin, cos) = angle(o).sin_cos();
                for turn in 0..turns {
                    let (s, c) = ((turn as f32 + 0.5) / turns as f32 * TAU).sin_cos();
                    let f = brdf.eval(wi, Vec3::new(sin * c, sin * s, cos)).x;
                    sum += f64::from(f * f * wi.x * wi.z * sin * cos);
                }
            }
        }
        let (da, dt) = (f64::from(PI) / 2.0 / steps as f64, f64::from(TAU) / turns as f64);
        sum * da * da * dt * f64::from(TAU) / f64::from(PI * PI)
    }

    #[test]
    fn the_distance_is_that_of_a_fine_quadrature_for_broad_and_for_narrow_lobes() {
        let black = LobeBrdf::default();
        let other = phong(10.0);
        for n in [3.0, 150.0] {
            let lobe = phong(n);
            let pairs = Pairs::over([&lobe, &other], 4096);
            let (found, grid) = (pairs.distance(&lobe, &black), mean_square(&lobe).sqrt());
            assert!((found / grid - 1.0).abs() < 0.03, "n {n}: {found} against {grid}");
        }
    }

    #[test]
    fn squared_differences_are_summed_over_all_values() {
        let (a, b): (Vec<f32>, Vec<f32>) = (0..21).map(|k| (k as f32, 2.0 * k as f32)).unzip();
        // The sum of k² for k to 20.
        assert_eq!(squared_distance(&a, &b), 2870.0);
    }

    #[test]
    fn every_direction_is_above_the_horizon_and_the_set_is_always_the_same() {
        let felt = materials::published("felt").unwrap();
        let (pairs, again) = (Pairs::over([&felt], 300), Pairs::over([&felt], 300));
        assert!(pairs.directions.iter().all(|(wi, wo)| wi.z > 0.0 && wo.z > 0.0 && wo.is_finite()));
        assert!(pairs.directions.len() > 150 && pairs.weights.iter().all(|&weight| weight.is_finite()));
        assert_eq!(pairs.directions, again.directions);
    }
}
