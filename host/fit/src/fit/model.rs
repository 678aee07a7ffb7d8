//! The model f = ρ_d + Σ A_j (b_j / r_j)ⁿ (4.1), (4.2) of one value, and a microfacet term where one is
//! fitted, in the form that the optimiser likes.
//!
//! C and ρ_s share a scale. Here C has length 1 and the amplitude A is the lobe's value where its base b
//! equals the reference r, which is kept at the largest base within the cone of the samples: A is then the
//! peak reflectance there, hardly correlated with n, and powers do not overflow whatever n is.

use glam::{DVec2, DVec3};

use super::coat::Coat;
use super::samples::Samples;
use lobelia_reflectance::{Lobe, LobeBrdf, Rgb};

/// Exponents are kept within these bounds.
pub const EXPONENTS: [f64; 2] = [0.5, 5000.0];

/// A lobe whose base stays below this within the cone of the samples is not seen.
pub const LEAST_REFERENCE: f64 = 1e-3;

/// One lobe of the model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModelLobe {
    /// Value where the base equals `reference`, sr⁻¹.
    pub amplitude: f64,
    /// Diagonal of C, scaled to length 1.
    pub c: DVec3,
    /// Exponent.
    pub n: f64,
    /// Base at which the shape is 1.
    pub reference: f64,
    /// Exponent toward grazing, where the lobe sharpens (6.19); the length of C is then what the reference
    /// makes it.
    pub n_grazing: Option<f64>,
}

/// A diffuse term and lobes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Model {
    /// ρ_d, sr⁻¹.
    pub diffuse: f64,
    /// Direction of anisotropy β, radians, any.
    pub beta: f64,
    /// x and y of the normal about which the lobes stand, where that is an unknown.
    pub normal: Option<DVec2>,
    /// The lobes.
    pub lobes: Vec<ModelLobe>,
    /// A microfacet term besides. In fits of texels only its α counts: the rest is an amplitude a channel.
    pub coat: Option<Coat>,
}

/// The products of a sample in the lobes' frame: ω_ix ω_ox and ω_iy ω_oy there, and the derivative of the
/// first by β (that of the second is its negative).
pub(super) struct Turned {
    cos2: f64,
    sin2: f64,
    cross: f64,
    double: f64,
}

impl Turned {
    pub(super) fn new(beta: f64) -> Self {
        let (sin, cos) = beta.sin_cos();
        Self { cos2: cos * cos, sin2: sin * sin, cross: sin * cos, double: cos * cos - sin * sin }
    }

    /// x and y products of sample k.
    pub(super) fn products(&self, samples: &Samples, k: usize) -> DVec3 {
        let (xx, yy, xy) = (samples.xx[k], samples.yy[k], self.cross * samples.xy[k]);
        DVec3::new(self.cos2 * xx + self.sin2 * yy + xy, self.sin2 * xx + self.cos2 * yy - xy, samples.zz[k])
    }

    /// d(x product)/dβ of sample k.
    pub(super) fn slope(&self, samples: &Samples, k: usize) -> f64 {
        2.0 * self.cross * (samples.yy[k] - samples.xx[k]) + self.double * samples.xy[k]
    }
}

impl ModelLobe {
    /// A lobe of amplitude 1 with its reference at the largest base within the cone of the samples; none if
    /// it is not positive.
    pub fn over(samples: &Samples, c: DVec3, n: f64) -> Option<Self> {
        let lobe = Self::unit(c, n).within(samples.cone());
        (lobe.reference > LEAST_REFERENCE).then_some(lobe)
    }

    /// A lobe of amplitude 1 with the reference 1.
    pub fn unit(c: DVec3, n: f64) -> Self {
        Self { amplitude: 1.0, c: c.normalize(), n, reference: 1.0, n_grazing: None }
    }

    /// The same shape with the largest base within a cone as its reference, or [`LEAST_REFERENCE`] where that
    /// is less.
    pub fn within(&self, cone: [f64; 2]) -> Self {
        Self { reference: largest_base(self.c, cone).max(LEAST_REFERENCE), ..*self }
    }

    /// The largest value that the lobe takes anywhere above the surface, over that within the cone of its
    /// reference; 1 or more.
    pub fn growth(&self) -> f64 {
        let longest = self.c.z.max(self.c.x.abs()).max(self.c.y.abs());
        let n = self.n.max(self.n_grazing.unwrap_or(0.0));
        (n * (longest / self.reference).ln()).clamp(0.0, 300.0).exp()
    }

    /// The exponent where the mean of cosθ_i and cosθ_o is t (6.19).
    pub fn exponent(&self, t: f64) -> f64 {
        self.n_grazing.map_or(self.n, |grazing| self.n * t + grazing * (1.0 - t))
    }

    /// (b / r)ⁿ for the products of a sample in the lobe's frame, at that mean t.
    pub fn shape(&self, products: DVec3, t: f64) -> f64 {
        let base = self.c.dot(products) / self.reference;
        if base <= 0.0 { 0.0 } else { (self.exponent(t) * base.ln()).exp() }
    }

    /// Derivative of the reference's logarithm as C moves along a tangent.
    pub fn reference_slope(&self, tangent: DVec3, cone: [f64; 2]) -> f64 {
        let moved = |size: f64| {
            Self { c: (self.c + tangent * size).normalize(), ..*self }.within(cone).reference.ln()
        };
        (moved(1e-5) - moved(-1e-5)) / 2e-5
    }

    /// The same lobe referred to the largest base within the cone of the samples; one that sharpens changes
    /// with its reference.
    pub fn referred(&self, samples: &Samples) -> Self {
        match Self::over(samples, self.c, self.n) {
            Some(lobe) => {
                let factor = match self.n_grazing {
                    None => (self.n * (lobe.reference / self.reference).ln()).exp(),
                    Some(_) => 1.0,
                };
                Self { amplitude: self.amplitude * factor, n_grazing: self.n_grazing, ..lobe }
            }
            None => Self { amplitude: 0.0, ..*self },
        }
    }

    /// The lobe in the form of the map, with a given albedo a channel: ρ_s is the peak within the cone of the
    /// samples.
    pub fn to_lobe(&self, rho_s: Rgb) -> Lobe {
        Lobe {
            n_grazing: self.n_grazing.map(|grazing| grazing as f32),
            ..Lobe::new(rho_s, (self.c / self.reference).as_vec3(), self.n as f32)
        }
    }
}

/// The largest of a sinθ_i sinθ_o + C_z cosθ_i cosθ_o, a = max |C_x|, |C_y|, for θ_i and θ_o within a cone,
/// any azimuths.
fn largest_base(c: DVec3, cone: [f64; 2]) -> f64 {
    let across = c.x.abs().max(c.y.abs());
    // For a given θ the other angle's best is atan2(a sinθ, C_z cosθ), and the base there grows with θ
    // wherever a > C_z.
    let at = |given: f64, most: f64| {
        let (a, b) = (across * given.sin(), c.z * given.cos());
        let other = a.atan2(b).min(most);
        a * other.sin() + b * other.cos()
    };
    c.z.max(at(cone[0], cone[1])).max(at(cone[1], cone[0]))
}

impl Model {
    /// The model's value for sample k, sr⁻¹.
    pub fn value(&self, samples: &Samples, k: usize) -> f64 {
        let products = Turned::new(self.beta).products(samples, k);
        let coat = self.coat.map_or(0.0, |coat| coat.value(samples, k));
        let t = samples.mean_cosine(k);
        let lobes: f64 = self.lobes.iter().map(|lobe| lobe.amplitude * lobe.shape(products, t)).sum();
        self.diffuse + coat + lobes
    }

    /// The model as a BRDF with a colour for the diffuse term and one a lobe; β is brought into −π/4..π/4.
    pub fn to_brdf(&self, rho_d: Rgb, rho_s: &[Rgb]) -> LobeBrdf {
        let lobes = self.lobes.iter().zip(rho_s).map(|(lobe, &rho_s)| lobe.to_lobe(rho_s)).collect();
        let isotropic = self.lobes.iter().all(|lobe| lobe.c.x == lobe.c.y);
        let brdf = LobeBrdf { rho_d, beta: 0.0, lobes, ..LobeBrdf::default() };
        let brdf = if isotropic { brdf } else { brdf.rotated(self.beta as f32) };
        LobeBrdf { normal: self.normal.unwrap_or_default().as_vec2(), ..brdf }
    }
}

impl From<&LobeBrdf> for Model {
    /// The model of a BRDF's red channel.
    fn from(brdf: &LobeBrdf) -> Self {
        let lobe = |lobe: &Lobe| {
            let (c, amplitude) = (lobe.c.as_dvec3(), f64::from(lobe.rho_s.x));
            let n_grazing = lobe.n_grazing.map(f64::from);
            ModelLobe {
                amplitude,
                c: c.normalize(),
                n: f64::from(lobe.n),
                reference: 1.0 / c.length(),
                n_grazing,
            }
        };
        let coat = brdf.microfacets.first().map(|coat| Coat {
            f0: f64::from(coat.f0.x),
            f90: f64::from(coat.f90.x),
            alpha: f64::from(coat.alpha),
        });
        let (diffuse, beta) = (f64::from(brdf.rho_d.x), f64::from(brdf.beta));
        let normal = (brdf.normal != glam::Vec2::ZERO).then(|| brdf.normal.as_dvec2());
        Self { diffuse, beta, normal, lobes: brdf.lobes.iter().map(lobe).collect(), coat }
    }
}

/// The diagonal of C as a unit vector from a direction.
pub fn isotropic_c(angle: f64) -> DVec3 {
    let (sin, cos) = angle.sin_cos();
    DVec3::new(sin * std::f64::consts::FRAC_1_SQRT_2, sin * std::f64::consts::FRAC_1_SQRT_2, cos)
}

#[cfg(test)]
mod tests {
    use super::super::testing;
    use super::*;
    use lobelia_reflectance::Brdf;

    #[test]
    fn the_model_and_the_brdf_made_from_it_agree() {
        let pairs = testing::directions(50, 3);
        let samples = testing::samples(&pairs, |_, _| Rgb::ONE);
        let lobe = ModelLobe::over(&samples, DVec3::new(-0.9, -0.5, 0.7), 23.0).unwrap();
        let model = Model {
            diffuse: 0.1,
            beta: 0.6,
            lobes: vec![ModelLobe { amplitude: 2.0, ..lobe }],
            ..Model::default()
        };
        for beta in [0.6, 0.6 + std::f64::consts::FRAC_PI_2] {
            let mut model = model.clone();
            model.beta = beta;
            let brdf = model.to_brdf(Rgb::splat(0.1), &[Rgb::splat(2.0)]);
            assert!(brdf.beta.abs() <= std::f32::consts::FRAC_PI_4);
            for (k, &(wi, wo)) in pairs.iter().enumerate() {
                let (a, b) = (model.value(&samples, k), f64::from(brdf.eval(wi, wo).x));
                assert!((a - b).abs() < 2e-5 * (1.0 + a), "{a} {b}");
            }
        }
    }

    #[test]
    fn the_reference_is_the_largest_base_within_the_cone() {
        let mut random = lobelia_base::random::Random::new(3);
        for _ in 0..200 {
            let mut component = || random.uniform(-1.0, 1.0);
            let c = DVec3::new(component(), component(), component()).normalize();
            let cone = [random.uniform(0.2, 1.5), random.uniform(0.2, 1.5)];
            let reference = largest_base(c, cone);
            let mut largest = f64::NEG_INFINITY;
            for (i, o, turn) in
                (0..=60).flat_map(|i| (0..=60).flat_map(move |o| (0..4).map(move |t| (i, o, t))))
            {
                let (i, o) = (f64::from(i) / 60.0 * cone[0], f64::from(o) / 60.0 * cone[1]);
                // In the plane of x or of y, on the same side or the other.
                let sines = i.sin() * o.sin() * if turn % 2 == 0 { 1.0 } else { -1.0 };
                let across = if turn < 2 { c.x } else { c.y };
                largest = largest.max(across * sines + c.z * i.cos() * o.cos());
            }
            assert!(
                largest <= reference + 1e-12 && largest > reference - 2e-3,
                "{c} {cone:?} {largest} {reference}"
            );
        }
        let samples = testing::samples(&testing::directions(50, 3), |_, _| Rgb::ONE);
        assert!(ModelLobe::over(&samples, DVec3::new(0.0, 0.0, -1.0), 2.0).is_none());
    }
}
