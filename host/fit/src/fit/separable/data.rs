//! One texel's samples as the solver wants them: products of directions in flat arrays, colours times the
//! roots of their weights.
//!
//! Every pose keeps its place in the arrays, whatever texel is at hand; a pose without a valid sample has
//! weight 0.

use glam::DVec3;

use super::super::Residual;
use super::super::samples::{MOST_OVER_SEEN, Samples};
use super::super::weights::Weights;
use super::levels;
use super::math::LANES;
use lobelia_reflectance::colour;
use lobelia_reflectance::sampled::{PoseGeometry, SampledSbrdf};

/// Where light and camera stood, as flat arrays filled up to a multiple of [`LANES`].
#[derive(Debug, Clone, Default)]
pub struct Poses {
    light: [Vec<f64>; 3],
    camera: [Vec<f64>; 3],
    weight: Vec<f64>,
    /// Whether products with one component along the normal are made.
    off_normal: bool,
}

impl Poses {
    /// The arrays for a list of poses.
    pub fn new(poses: &[PoseGeometry]) -> Self {
        // A direction that is no number would spoil all sums, whatever it weighs.
        let poses: Vec<PoseGeometry> = poses.iter().map(|pose| pose.known()).collect();
        let padded = poses.len().next_multiple_of(LANES);
        let list = |value: &dyn Fn(&PoseGeometry) -> f64, filling: f64| {
            let mut list: Vec<f64> = poses.iter().map(value).collect();
            list.resize(padded, filling);
            list
        };
        // What fills up stands above the texel and weighs nothing.
        let filling = [0.0, 0.0, 1.0];
        Self {
            light: std::array::from_fn(|i| list(&|pose| pose.light_mm[i], filling[i])),
            camera: std::array::from_fn(|i| list(&|pose| pose.camera_mm[i], filling[i])),
            weight: list(&|pose| pose.weight, 0.0),
            off_normal: false,
        }
    }

    /// The same for lobes about normals of their own.
    pub fn off_normal(self, off_normal: bool) -> Self {
        Self { off_normal, ..self }
    }

    /// Number of places in the arrays.
    pub fn len(&self) -> usize {
        self.weight.len()
    }

    /// Whether there are no places.
    pub fn is_empty(&self) -> bool {
        self.weight.is_empty()
    }
}

/// Products of direction components a sample; the base of every lobe is linear in them.
#[derive(Debug, Clone, Default)]
pub struct Products {
    /// ω_ix ω_ox + ω_iy ω_oy.
    pub plane: Vec<f64>,
    /// ω_ix ω_ox.
    pub xx: Vec<f64>,
    /// ω_iy ω_oy.
    pub yy: Vec<f64>,
    /// ω_iz ω_oz.
    pub zz: Vec<f64>,
    /// ω_ix ω_oy + ω_iy ω_ox.
    pub xy: Vec<f64>,
    /// ω_ix ω_oz + ω_iz ω_ox and the same of y; 0 unless asked for.
    pub off_normal: [Vec<f64>; 2],
    /// cosθ_i and cosθ_o.
    pub cos: [Vec<f64>; 2],
}

/// The samples of one texel.
#[derive(Debug, Clone, Default)]
pub struct Data {
    /// Products of directions.
    pub products: Products,
    /// Reflectance a channel, sr⁻¹; 0 where it is not valid.
    pub rgb: [Vec<f64>; 3],
    /// Standard deviations a channel, sr⁻¹, where samples weigh by them; else empty.
    pub deviation: [Vec<f64>; 3],
    /// The pose's weight, 0 without a valid sample.
    pub weight: Vec<f64>,
    /// Largest θ_i and θ_o of the valid samples, radians.
    pub cone: [f64; 2],
    /// Valid samples.
    pub valid: usize,
    /// Root of the weight that the channels share, residual's own included.
    pub root: Vec<f64>,
    /// (f − ρ_d) · `root` · `scale`, for the channels that are fitted together; ρ_d only where it is no
    /// unknown.
    pub goal: [Vec<f64>; 3],
    /// Root of each of those channels' weight against the others.
    pub scale: [f64; 3],
    /// Largest amplitude of a lobe times `scale`, see [`MOST_OVER_SEEN`].
    pub most: [f64; 3],
    /// How many channels are fitted together.
    pub channels: usize,
    /// Where the places of each texel begin and those of the last end, where texels that are fitted together
    /// have a ρ_d each ([`levels`]); else empty.
    pub texels: Vec<usize>,
}

impl Data {
    /// Number of places in the arrays, a multiple of [`LANES`].
    pub fn len(&self) -> usize {
        self.weight.len()
    }

    /// Whether there are no places.
    pub fn is_empty(&self) -> bool {
        self.weight.is_empty()
    }

    /// Valid samples beyond those that the texels' own ρ_d take up.
    pub fn telling(&self) -> usize {
        self.valid.saturating_sub(self.texels.len().saturating_sub(1))
    }

    /// Takes from the goals what the texels' own ρ_d make up for.
    fn level(&mut self) {
        let Self { root, goal, channels, texels, .. } = self;
        goal.iter_mut().take(*channels).for_each(|goal| levels::take_off(texels, root, goal));
    }

    fn resize(&mut self, count: usize) {
        let products = &mut self.products;
        for list in
            [&mut products.plane, &mut products.xx, &mut products.yy, &mut products.zz, &mut products.xy]
        {
            list.resize(count, 0.0);
        }
        for list in products.cos.iter_mut().chain(&mut products.off_normal) {
            list.resize(count, 0.0);
        }
        for list in [&mut self.weight, &mut self.root] {
            list.resize(count, 0.0);
        }
        for list in self.rgb.iter_mut().chain(&mut self.goal) {
            list.resize(count, 0.0);
        }
    }

    /// Reads the samples of texel `index`; their standard deviations too where they are to weigh by them.
    #[inline(always)]
    pub fn load(&mut self, poses: &Poses, sampled: &SampledSbrdf, index: usize, weights: Weights) {
        let count = poses.weight.len();
        self.texels.clear();
        self.resize(count);
        self.products.set(poses, sampled.position_mm(index));
        let values = sampled.values(index);
        for channel in &mut self.rgb {
            channel[values.len() / 3..].fill(0.0);
        }
        let [red, green, blue] = &mut self.rgb;
        for (((red, green), blue), value) in red.iter_mut().zip(green).zip(blue).zip(values.chunks_exact(3)) {
            *red = f64::from(value[0]);
            *green = f64::from(value[1]);
            *blue = f64::from(value[2]);
        }
        self.deviation.iter_mut().for_each(Vec::clear);
        if let Some(sigmas) = sampled.sigmas(index).filter(|_| weights == Weights::Sigma) {
            for (channel, list) in self.deviation.iter_mut().enumerate() {
                list.extend(sigmas[channel..].iter().step_by(3).map(|sigma| f64::from(*sigma)));
                list.resize(count, 1.0);
                // A value of unknown noise is no valid sample.
                for (value, sigma) in self.rgb[channel].iter_mut().zip(list) {
                    if !(*sigma > 0.0 && sigma.is_finite()) {
                        *value = f64::NAN;
                    }
                }
            }
        }
        self.check(&poses.weight);
    }

    /// The products and the cone of all poses seen from a place of the sample, mm, without samples.
    pub fn look(&mut self, poses: &Poses, place: DVec3) {
        self.resize(poses.weight.len());
        self.products.set(poses, place);
        self.rgb.iter_mut().for_each(|channel| channel.fill(0.0));
        self.check(&poses.weight);
    }

    /// Leaves a valid pose out.
    pub fn leave_out(&mut self, pose: usize) {
        self.weight[pose] = 0.0;
        self.rgb.iter_mut().for_each(|channel| channel[pose] = 0.0);
        self.valid -= 1;
    }

    /// Takes samples of which the directions are known one by one.
    pub fn take(&mut self, samples: &Samples) {
        self.deviation.iter_mut().for_each(Vec::clear);
        self.texels.clear();
        let valid = samples.len();
        let count = valid.next_multiple_of(LANES);
        self.resize(count);
        let copy = |to: &mut Vec<f64>, from: &[f64]| {
            to[..valid].copy_from_slice(from);
            to[valid..].fill(0.0);
        };
        let products = &mut self.products;
        copy(&mut products.xx, &samples.xx);
        copy(&mut products.yy, &samples.yy);
        copy(&mut products.zz, &samples.zz);
        copy(&mut products.xy, &samples.xy);
        copy(&mut products.cos[1], &samples.cos_o);
        let cos_i: Vec<f64> = samples.zz.iter().zip(&samples.cos_o).map(|(zz, cos_o)| zz / cos_o).collect();
        copy(&mut products.cos[0], &cos_i);
        for (to, from) in products.off_normal.iter_mut().zip(&samples.off_normal) {
            copy(to, from);
        }
        copy(&mut self.weight, &samples.weight);
        for k in 0..count {
            products.plane[k] = products.xx[k] + products.yy[k];
        }
        for (channel, list) in self.rgb.iter_mut().enumerate() {
            for (k, place) in list.iter_mut().enumerate() {
                // Samples of a single value count as grey.
                let value = samples.rgb.get(k).map(|rgb| rgb[channel]);
                *place = value.or(samples.value.get(k).copied()).unwrap_or(0.0);
            }
        }
        self.cone = samples.cone();
        self.valid = valid;
    }

    /// Zeroes what is not valid, counts the rest and finds its cone.
    #[inline(always)]
    fn check(&mut self, weights: &[f64]) {
        let count = weights.len();
        let [cos_i, cos_o] = &self.products.cos;
        let (cos_i, cos_o) = (&cos_i[..count], &cos_o[..count]);
        let [red, green, blue] = &mut self.rgb;
        let (red, green, blue) = (&mut red[..count], &mut green[..count], &mut blue[..count]);
        let weight = &mut self.weight[..count];
        let mut least = [[1.0; LANES]; 2];
        let mut valid = [0.0; LANES];
        for start in (0..count).step_by(LANES) {
            for lane in 0..LANES {
                let k = start + lane;
                // A NaN or an infinity in any channel makes the sum's product with 0 something else than 0.
                let finite = (red[k] + green[k] + blue[k]) * 0.0 == 0.0;
                let seen = finite & (weights[k] > 0.0) & (cos_i[k] > 0.0) & (cos_o[k] > 0.0);
                weight[k] = if seen { weights[k] } else { 0.0 };
                red[k] = if seen { red[k] } else { 0.0 };
                green[k] = if seen { green[k] } else { 0.0 };
                blue[k] = if seen { blue[k] } else { 0.0 };
                valid[lane] += if seen { 1.0 } else { 0.0 };
                let (i, o) = (if seen { cos_i[k] } else { 1.0 }, if seen { cos_o[k] } else { 1.0 });
                least[0][lane] = if i < least[0][lane] { i } else { least[0][lane] };
                least[1][lane] = if o < least[1][lane] { o } else { least[1][lane] };
            }
        }
        self.valid = valid.iter().sum::<f64>() as usize;
        self.cone = least.map(|lanes| lanes.into_iter().fold(1.0, f64::min).acos());
    }

    /// Weights and goals for fitting `channels` together, for a residual that is linear in f. `fixed` is ρ_d
    /// a channel where that is no unknown.
    ///
    /// The channels share the weights, which for the proportional residual follow the luminance; what that
    /// gives a channel too much or too little on the whole its `scale` makes up for.
    #[inline(always)]
    pub fn aim(&mut self, channels: &[usize], residual: Residual, fixed: Option<[f64; 3]>) {
        let count = self.len();
        self.channels = channels.len();
        let luminance = colour::LUMINANCE.as_dvec3().to_array();
        let shares: [f64; 3] = match channels {
            [one] => std::array::from_fn(|channel| f64::from(u8::from(channel == *one))),
            _ => luminance,
        };
        let by_sigma = !self.deviation[0].is_empty();
        let ratios =
            if by_sigma { self.weigh_by_sigma(shares) } else { self.weigh_by_residual(shares, residual) };
        for (place, &channel) in channels.iter().enumerate() {
            let own = (by_sigma || residual == Residual::Proportional) && self.valid > 0;
            let scale = if own { (ratios[channel] / self.valid as f64).sqrt() } else { 1.0 };
            let root = &self.root[..count];
            let offset = fixed.map_or(0.0, |rgb| rgb[channel]);
            let (values, goal) = (&self.rgb[channel][..count], &mut self.goal[place][..count]);
            let mut largest = [0.0; LANES];
            for start in (0..count).step_by(LANES) {
                for (lane, largest) in largest.iter_mut().enumerate() {
                    let k = start + lane;
                    goal[k] = (values[k] - offset) * root[k] * scale;
                    *largest = if values[k] > *largest { values[k] } else { *largest };
                }
            }
            self.scale[place] = scale;
            self.most[place] = MOST_OVER_SEEN * scale * largest.into_iter().fold(0.0, f64::max);
        }
        self.level();
    }

    /// Sets the roots of the weights to the inverse of the samples' standard deviations, of which the
    /// channels have `shares`; returns the sum of what that gives each channel too much or too little.
    fn weigh_by_sigma(&mut self, shares: [f64; 3]) -> [f64; 3] {
        let mut ratios = [0.0; 3];
        for (k, root) in self.root.iter_mut().enumerate() {
            let sigmas: [f64; 3] = std::array::from_fn(|channel| self.deviation[channel][k]);
            let sigma: f64 = shares.iter().zip(sigmas).map(|(share, sigma)| share * sigma).sum();
            *root = if self.weight[k] > 0.0 { 1.0 / sigma } else { 0.0 };
            for (ratio, own) in ratios.iter_mut().zip(sigmas).filter(|_| self.weight[k] > 0.0) {
                *ratio += (sigma / own).powi(2);
            }
        }
        ratios
    }

    /// Sets the roots of the weights to those of the poses and of the residual; returns as
    /// [`Self::weigh_by_sigma`].
    #[inline(always)]
    fn weigh_by_residual(&mut self, shares: [f64; 3], residual: Residual) -> [f64; 3] {
        let count = self.len();
        let [red, green, blue] = &self.rgb;
        let (red, green, blue) = (&red[..count], &green[..count], &blue[..count]);
        let (weight, cos_o) = (&self.weight[..count], &self.products.cos[1][..count]);
        let root = &mut self.root[..count];
        let floor = Residual::NOISE_RATIO;
        let mut ratios = [[0.0; LANES]; 3];
        for start in (0..count).step_by(LANES) {
            for lane in 0..LANES {
                let k = start + lane;
                root[k] = weight[k].sqrt();
                match residual {
                    Residual::CosineWeighted => root[k] *= cos_o[k],
                    Residual::Proportional => {
                        let rgb = [red[k], green[k], blue[k]];
                        let bright = shares[0] * rgb[0] + shares[1] * rgb[1] + shares[2] * rgb[2];
                        let bright = floor + if bright > 0.0 { bright } else { 0.0 };
                        root[k] /= bright;
                        for (ratio, value) in ratios.iter_mut().zip(rgb) {
                            let own = bright / (floor + if value > 0.0 { value } else { 0.0 });
                            ratio[lane] += if weight[k] > 0.0 { own * own } else { 0.0 };
                        }
                    }
                    _ => {}
                }
            }
        }
        ratios.map(|lanes| lanes.iter().sum())
    }

    /// Multiplies the weight of every pose with a factor.
    pub fn reweigh(&mut self, factors: &[f64]) {
        let Self { root, goal, channels, .. } = self;
        for (k, factor) in factors.iter().enumerate() {
            root[k] *= factor.sqrt();
            goal.iter_mut().take(*channels).for_each(|goal| goal[k] *= factor.sqrt());
        }
        self.level();
    }
}

impl Products {
    /// The products of directions from a place of the sample, mm.
    #[inline(always)]
    fn set(&mut self, poses: &Poses, place: DVec3) {
        let count = poses.weight.len();
        let [lx, ly, lz] = [0, 1, 2].map(|i| &poses.light[i][..count]);
        let [cx, cy, cz] = [0, 1, 2].map(|i| &poses.camera[i][..count]);
        let [cos_i, cos_o] = &mut self.cos;
        let (cos_i, cos_o) = (&mut cos_i[..count], &mut cos_o[..count]);
        let (plane, xx, yy) = (&mut self.plane[..count], &mut self.xx[..count], &mut self.yy[..count]);
        let (zz, xy) = (&mut self.zz[..count], &mut self.xy[..count]);
        for k in 0..count {
            let (ix, iy, iz) = (lx[k] - place.x, ly[k] - place.y, lz[k] - place.z);
            let (ox, oy, oz) = (cx[k] - place.x, cy[k] - place.y, cz[k] - place.z);
            let far_i = (ix * ix + iy * iy + iz * iz).sqrt();
            let far_o = (ox * ox + oy * oy + oz * oz).sqrt();
            let scale = 1.0 / (far_i * far_o);
            xx[k] = ix * ox * scale;
            yy[k] = iy * oy * scale;
            zz[k] = iz * oz * scale;
            xy[k] = (ix * oy + iy * ox) * scale;
            plane[k] = xx[k] + yy[k];
            cos_i[k] = iz * far_o * scale;
            cos_o[k] = oz * far_i * scale;
        }
        if poses.off_normal {
            let [xz, yz] = &mut self.off_normal;
            let (xz, yz) = (&mut xz[..count], &mut yz[..count]);
            for k in 0..count {
                let light = (DVec3::new(lx[k], ly[k], lz[k]) - place).normalize();
                let camera = (DVec3::new(cx[k], cy[k], cz[k]) - place).normalize();
                xz[k] = light.x * camera.z + light.z * camera.x;
                yz[k] = light.y * camera.z + light.z * camera.y;
            }
        }
    }
}
