//! The samples of one texel or one wavelength, as the fitters want them: products of direction components in
//! flat arrays.

use glam::{DVec3, Vec3};

use super::Residual;
use super::weights::{self, Weights};
use lobelia_reflectance::sampled::SampledSbrdf;
use lobelia_reflectance::{Rgb, colour};

/// One valid sample of a texel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Index of its pose.
    pub pose: usize,
    /// Toward the light.
    pub wi: Vec3,
    /// Toward the camera.
    pub wo: Vec3,
    /// Reflectance, sr⁻¹.
    pub rgb: Rgb,
    /// Weight of its squared residual.
    pub weight: f64,
}

/// The valid samples of texel `index`: finite, of some weight, light and camera above the horizon.
pub fn of_texel(sampled: &SampledSbrdf, index: usize, weights: Weights) -> impl Iterator<Item = Sample> + '_ {
    let sigmas = sampled.sigmas(index).filter(|_| weights == Weights::Sigma);
    let finite = sampled.samples(index).enumerate().filter(|(_, rgb)| rgb.is_finite());
    let samples = finite.map(move |(pose, rgb)| {
        let (wi, wo) = sampled.directions(index, pose);
        let weight = sampled.poses[pose].weight;
        let weight = sigmas.map_or(weight, |sigmas| weights::by_sigma(weight, &sigmas[3 * pose..]));
        Sample { pose, wi, wo, rgb, weight }
    });
    samples.filter(|sample| sample.weight > 0.0 && sample.wi.z > 0.0 && sample.wo.z > 0.0)
}

/// Samples of one BRDF. The base of every lobe is linear in the four products.
#[derive(Debug, Clone, Default)]
pub struct Samples {
    /// ω_ix ω_ox.
    pub xx: Vec<f64>,
    /// ω_iy ω_oy.
    pub yy: Vec<f64>,
    /// ω_ix ω_oy + ω_iy ω_ox, for a β other than 0.
    pub xy: Vec<f64>,
    /// ω_ix ω_oz + ω_iz ω_ox and the same of y, for lobes about a normal of their own.
    pub off_normal: [Vec<f64>; 2],
    /// ω_iz ω_oz.
    pub zz: Vec<f64>,
    /// cosθ_o.
    pub cos_o: Vec<f64>,
    /// What the lobes' shapes are fitted to: luminance, or the value at one wavelength; sr⁻¹.
    pub value: Vec<f64>,
    /// Colour, sr⁻¹; empty when there is only `value`.
    pub rgb: Vec<[f64; 3]>,
    /// Weight of the sample's squared residual.
    pub weight: Vec<f64>,
    /// Cosines of the largest θ_i and θ_o of the samples.
    lowest: Option<[f64; 2]>,
}

impl Samples {
    /// Number of samples.
    pub fn len(&self) -> usize {
        self.value.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.value.is_empty()
    }

    /// Largest θ_i and θ_o of the samples, radians: the cone in which the fit interpolates.
    pub fn cone(&self) -> [f64; 2] {
        self.lowest.unwrap_or([1.0; 2]).map(f64::acos)
    }

    /// The mean of cosθ_i and cosθ_o of sample k, on which the exponent of a lobe that sharpens depends
    /// (6.19).
    pub fn mean_cosine(&self, k: usize) -> f64 {
        0.5 * (self.zz[k] / self.cos_o[k] + self.cos_o[k])
    }

    /// Forgets all samples, keeps the memory.
    pub fn clear(&mut self) {
        for list in [
            &mut self.xx,
            &mut self.yy,
            &mut self.xy,
            &mut self.zz,
            &mut self.cos_o,
            &mut self.value,
            &mut self.weight,
        ] {
            list.clear();
        }
        self.off_normal.iter_mut().for_each(Vec::clear);
        self.rgb.clear();
        self.lowest = None;
    }

    /// Some of the samples, each with a factor for its weight; the cone is that of all.
    pub fn part(&self, rows: &[(usize, f64)]) -> Self {
        let of = |list: &[f64]| rows.iter().filter_map(|&(k, _)| list.get(k).copied()).collect::<Vec<f64>>();
        Self {
            xx: of(&self.xx),
            yy: of(&self.yy),
            xy: of(&self.xy),
            off_normal: self.off_normal.each_ref().map(|list| of(list)),
            zz: of(&self.zz),
            cos_o: of(&self.cos_o),
            value: of(&self.value),
            rgb: rows.iter().filter_map(|&(k, _)| self.rgb.get(k).copied()).collect(),
            weight: rows.iter().map(|&(k, factor)| factor * self.weight[k]).collect(),
            lowest: self.lowest,
        }
    }

    fn push_directions(&mut self, wi: DVec3, wo: DVec3, weight: f64) {
        self.xx.push(wi.x * wo.x);
        self.yy.push(wi.y * wo.y);
        self.xy.push(wi.x * wo.y + wi.y * wo.x);
        self.zz.push(wi.z * wo.z);
        let [xz, yz] = &mut self.off_normal;
        xz.push(wi.x * wo.z + wi.z * wo.x);
        yz.push(wi.y * wo.z + wi.z * wo.y);
        self.cos_o.push(wo.z);
        self.weight.push(weight);
        let lowest = self.lowest.unwrap_or([1.0; 2]);
        self.lowest = Some([lowest[0].min(wi.z), lowest[1].min(wo.z)]);
    }

    /// Adds a colour sample; one that is not finite, weighs nothing or lies below the horizon is left out.
    pub fn push_rgb(&mut self, wi: Vec3, wo: Vec3, rgb: Rgb, weight: f64) {
        if rgb.is_finite() && weight > 0.0 && wi.z > 0.0 && wo.z > 0.0 {
            self.push_directions(wi.as_dvec3(), wo.as_dvec3(), weight);
            self.value.push(f64::from(colour::luminance(rgb)));
            self.rgb.push(rgb.as_dvec3().to_array());
        }
    }

    /// Adds a sample of a single value (one wavelength); left out as in [`Self::push_rgb`].
    pub fn push_value(&mut self, wi: DVec3, wo: DVec3, value: f64, weight: f64) {
        if value.is_finite() && weight > 0.0 && wi.z > 0.0 && wo.z > 0.0 {
            self.push_directions(wi, wo, weight);
            self.value.push(value);
        }
    }
}

/// What the fit of one list of values minimises: Σ w (g(f̂) − g(f))² with g of the [`Residual`].
#[derive(Debug, Clone, Default)]
pub struct Target {
    /// Measured values, sr⁻¹.
    pub value: Vec<f64>,
    /// g of the measured values.
    pub goal: Vec<f64>,
    /// √w, times the residual's own weight where that depends on the measured value.
    pub weight: Vec<f64>,
    /// The square of the weight that makes the linear residual f̂ − f match this one to first order.
    pub linear_weight: Vec<f64>,
    /// The residual.
    pub residual: Residual,
    /// Largest amplitude that a lobe may take, sr⁻¹: [`MOST_OVER_SEEN`] times the largest measured value.
    pub most: f64,
}

/// A lobe's peak within the cone of the samples is kept below this many times the largest measured value: a
/// lobe that only its flank's samples hold up would else tower over all that was measured.
pub const MOST_OVER_SEEN: f64 = 4.0;

impl Target {
    /// What sample k's fitted value differs by, before its weight, and the derivative by the value.
    #[inline]
    pub fn difference(&self, value: f64, cos_o: f64, k: usize) -> (f64, f64) {
        self.residual.difference(value, cos_o, self.goal[k])
    }

    /// Sets the target to `values` at the directions of `samples`.
    pub fn set(&mut self, samples: &Samples, values: impl Iterator<Item = f64>, residual: Residual) {
        self.residual = residual;
        self.value.clear();
        self.value.extend(values);
        self.most = MOST_OVER_SEEN * self.value.iter().copied().fold(0.0, f64::max);
        for list in [&mut self.goal, &mut self.weight, &mut self.linear_weight] {
            list.clear();
        }
        for (k, &value) in self.value.iter().enumerate() {
            let (goal, slope) = residual.transform(value, samples.cos_o[k]);
            let weight = samples.weight[k].sqrt() * residual.own_weight(value);
            self.goal.push(goal);
            self.weight.push(weight);
            self.linear_weight.push((weight * slope).powi(2));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_without_a_value_or_below_the_horizon_are_left_out() {
        let mut samples = Samples::default();
        samples.push_rgb(Vec3::Z, Vec3::Z, Rgb::splat(f32::NAN), 1.0);
        samples.push_rgb(Vec3::Z, -Vec3::Z, Rgb::ONE, 1.0);
        samples.push_rgb(Vec3::Z, Vec3::Z, Rgb::ONE, 0.0);
        assert!(samples.is_empty());
        samples.push_rgb(Vec3::Z, Vec3::Z, Rgb::ONE, 0.5);
        assert_eq!((samples.len(), samples.zz[0], samples.weight[0]), (1, 1.0, 0.5));
    }

    #[test]
    fn every_residual_has_the_slope_that_finite_differences_give() {
        for residual in Residual::ALL {
            for value in [0.01, 0.3, 40.0] {
                let step = 1e-6 * value;
                let at = |x| residual.transform(x, 0.7).0;
                let numeric = (at(value + step) - at(value - step)) / (2.0 * step);
                let analytic = residual.transform(value, 0.7).1;
                assert!(
                    (numeric / analytic - 1.0).abs() < 1e-5,
                    "{residual:?} at {value}: {numeric} {analytic}"
                );
            }
        }
    }
}
