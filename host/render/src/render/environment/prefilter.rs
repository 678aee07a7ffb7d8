//! Prefiltered environments (6.13)–(6.18): S(ω_p, n) = ∫ (ω_p·ω_i)ⁿ L_i dω_i over all peak directions for a
//! few exponents, and D(N), which is S(N, 1). One set of maps serves all BRDFs.
//!
//! Maps are equirectangular and hold the root S^(1/n): for a small light that is the cosine between it and
//! the peak, which a bilinear lookup meets at every exponent. Between exponents log S is blended. Sizes of
//! maps and the spacing of exponents follow from an error ([`accuracy`]).

use glam::{Vec2, Vec3, Vec4};
use rayon::prelude::*;

use super::spectrum::{self, Spectrum};
use super::{accuracy, gpu};
use crate::render::math;
use crate::scene::{Environment, environment::texture_of};
use lobelia_base::error::{Error, Result};
use lobelia_gpu::environment::Map;
use lobelia_reflectance::Rgb;

/// log₂ of nothing.
const DARK: f32 = -100.0;
/// Least root that has a logarithm.
const TINY: f32 = 1e-37;
/// Least exponent of a map.
const LEAST: f32 = 0.25;

/// How the exponent is encoded. Of both three maps blend, exactly for a point of light and for even light.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Encoding {
    /// MIP levels: every level has a quarter of the exponent and half of the size. The published encoding:
    /// small, quick to make, and as wrong between its levels as the environment makes it
    Mips,
    /// Slices, each of the size that its exponent needs, spaced as the error asks for
    Slices,
}

impl Encoding {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Mips, Self::Slices];

    /// Name on the command line, and what it is.
    pub fn option(self) -> (&'static str, &'static str) {
        match self {
            Self::Mips => (
                "mips",
                "MIP levels: every level has a quarter of the exponent and half of the size. The published \
                 encoding: small, quick to make, and as wrong between its levels as the environment makes it",
            ),
            Self::Slices => {
                ("slices", "Slices, each of the size that its exponent needs, spaced as the error asks for")
            }
        }
    }
}

/// S^(1/n) for one exponent. The first and the last row are the poles, where a lookup would else see what
/// lies beside them.
pub(super) fn slice(spectrum: &Spectrum, n: f32, error: f32, height: usize) -> Environment {
    let width = 2 * height;
    let polar: Vec<f64> =
        (0..height).map(|y| std::f64::consts::PI * y as f64 / (height - 1) as f64).collect();
    let mut pixels = spectrum.map(&spectrum::kernel(n, error), width, &polar);
    pixels.par_iter_mut().for_each(|pixel| {
        *pixel = pixel.map(|v| if v > 0.0 { math::powf(v, 1.0 / n) } else { 0.0 });
    });
    Environment { width, height, pixels: pixels.into(), rotation: 0.0 }
}

/// log₂ S at texture coordinates of a map of [`slice`].
fn look_up((n, map): &(f32, Environment), uv: Vec2) -> Rgb {
    let rows = map.height as f32;
    let root = map.radiance_at(Vec2::new(uv.x, (uv.y * (rows - 1.0) + 0.5) / rows));
    root.map(|root| (n * math::log2(root.max(TINY))).max(DARK))
}

/// The logarithm of a channel, [`DARK`] for nothing.
pub(super) fn log2(value: Rgb) -> Rgb {
    value.map(|v| if v > 0.0 { v.log2().max(DARK) } else { DARK })
}

/// Light from three logarithms and their weights.
pub(super) fn blended(logarithms: [Rgb; 3], weights: [f32; 3]) -> Rgb {
    logarithms.into_iter().zip(weights).map(|(log, weight)| log * weight).sum::<Rgb>().map(math::exp2)
}

/// A map that is to be made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Wanted {
    /// Exponent.
    pub(super) n: f32,
    /// Rows.
    pub(super) height: usize,
    /// Whether it is that of D(N), and whether one of S.
    pub(super) roles: [bool; 2],
}

/// The maps that an environment needs for lobes of some exponents, and what they are made from.
pub(super) struct Plan {
    image: Environment,
    spectrum: Spectrum,
    error: f32,
    /// That of D(N) first, then those of S by rising exponent.
    pub(super) maps: Vec<Wanted>,
}

impl Plan {
    /// For exponents from `range.0` to `range.1` and an error ([`accuracy`]).
    pub(super) fn new(environment: &Environment, range: (f32, f32), encoding: Encoding, error: f32) -> Self {
        let image = Environment { rotation: 0.0, ..environment.clone() };
        // D(N)'s edge has more degrees than any wider lobe.
        let spectrum = Spectrum::new(&image, &[1.0, range.1.max(LEAST)], error);
        let nodes = nodes(&image, &spectrum, range, encoding, error);
        let finest = nodes.last().map_or(0, |&n| accuracy::map_height(n, error));
        let levels = nodes.len() - 1;
        let diffuse = Wanted { n: 1.0, height: accuracy::map_height(1.0, error), roles: [true, false] };
        let mut maps = vec![diffuse];
        for (k, n) in nodes.into_iter().enumerate() {
            let height = match encoding {
                Encoding::Slices => accuracy::map_height(n, error),
                Encoding::Mips => (finest >> (levels - k)).max(4),
            };
            // One map may be both.
            if (n, height) == (1.0, diffuse.height) && maps.len() == 1 {
                maps[0].roles[1] = true;
            } else {
                maps.push(Wanted { n, height, roles: [false, true] });
            }
        }
        Self { image, spectrum, error, maps }
    }

    /// Makes a map, on the GPU when there is one.
    ///
    /// # Errors
    /// Failures of the GPU.
    pub(super) fn map(&self, index: usize, gpu: Option<&gpu::Prefilter<'_>>) -> Result<Environment> {
        let Wanted { n, height, .. } = self.maps[index];
        match gpu {
            Some(gpu) => {
                let (source, cap) = accuracy::gathered(&self.image, n, self.error);
                gpu.slice(&source, &cap, height)
            }
            None => Ok(slice(&self.spectrum, n, self.error, height)),
        }
    }
}

/// The maps of one environment.
pub struct Prefiltered {
    /// Turn of the environment about +y.
    pub(super) rotation: f32,
    /// D(N): n = 1.
    diffuse: (f32, Environment),
    /// Exponents in rising order, with their maps of S^(1/n).
    slices: Vec<(f32, Environment)>,
}

impl Prefiltered {
    /// Prefilters an environment for lobes of exponents from `range.0` to `range.1` and an error
    /// ([`accuracy`]), on the GPU when there is one.
    ///
    /// # Errors
    /// Failures of the GPU.
    pub(super) fn new(
        environment: &Environment,
        range: (f32, f32),
        encoding: Encoding,
        error: f32,
        gpu: Option<&gpu::Prefilter<'_>>,
    ) -> Result<Self> {
        let plan = Plan::new(environment, range, encoding, error);
        let map = |(index, wanted): (usize, &Wanted)| Ok((*wanted, plan.map(index, gpu)?));
        let maps = plan.maps.iter().enumerate().map(map).collect::<Result<Vec<_>>>()?;
        Self::of_maps(maps, environment.rotation)
    }

    /// Maps that were made, that of D(N) and those of S in the order of a [`Plan`].
    ///
    /// # Errors
    /// An input error where there is none of one kind.
    pub(super) fn of_maps(maps: Vec<(Wanted, Environment)>, rotation: f32) -> Result<Self> {
        let diffuse = maps.iter().find(|(wanted, _)| wanted.roles[0]).map(|(_, map)| (1.0, map.clone()));
        let slices: Vec<_> = maps
            .into_iter()
            .filter(|(wanted, _)| wanted.roles[1])
            .map(|(wanted, map)| (wanted.n, map))
            .collect();
        let rising = slices.windows(2).all(|pair| pair[0].0 < pair[1].0);
        match diffuse.filter(|_| rising && !slices.is_empty()) {
            Some(diffuse) => Ok(Self { rotation, diffuse, slices }),
            None => Err(Error::input("not all prefiltered maps are there, or not in their order")),
        }
    }

    /// On the CPU.
    ///
    /// # Errors
    /// None: those of `new` are of the GPU.
    pub fn on_cpu(
        environment: &Environment,
        range: (f32, f32),
        encoding: Encoding,
        error: f32,
    ) -> Result<Self> {
        Self::new(environment, range, encoding, error, None)
    }

    /// The maps, that of D(N) first.
    fn maps(&self) -> impl Iterator<Item = &(f32, Environment)> {
        std::iter::once(&self.diffuse).chain(&self.slices)
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.maps().map(|(_, map)| size_of_val(&map.pixels[..])).sum()
    }

    /// Exponents of the slices, in rising order.
    pub fn exponents(&self) -> impl Iterator<Item = f32> {
        self.slices.iter().map(|slice| slice.0)
    }

    /// All maps as one run of pixels, that of D(N) first, with where each lies.
    pub(super) fn packed(&self) -> (Vec<Map>, Vec<Vec4>) {
        let (mut places, mut pixels) = (Vec::new(), Vec::new());
        for &(n, ref map) in self.maps() {
            let (width, height) = (map.width as u32, map.height as u32);
            places.push(Map { n, first: pixels.len() as u32, width, height });
            pixels.extend(map.pixels.iter().map(|pixel| pixel.extend(0.0)));
        }
        (places, pixels)
    }

    /// Texture coordinates of a world direction.
    fn texture(&self, world: Vec3) -> Vec2 {
        let (sin, cos) = self.rotation.sin_cos();
        texture_of(Vec3::new(cos * world.x - sin * world.z, world.y, sin * world.x + cos * world.z))
    }

    /// D(N).
    pub(crate) fn irradiance(&self, normal: Vec3) -> Rgb {
        look_up(&self.diffuse, self.texture(normal)).map(math::exp2)
    }

    /// The exponent of the range that is nearest to the one given.
    pub(crate) fn nearest(&self, n: f32) -> f32 {
        n.clamp(self.slices[0].0, self.slices[self.slices.len() - 1].0)
    }

    /// S(ω_p, n) for a unit direction and an exponent of the range.
    pub(crate) fn lobe(&self, peak: Vec3, n: f32) -> Rgb {
        let uv = self.texture(peak);
        let last = self.slices.len() - 1;
        if last < 2 {
            return look_up(&self.slices[0], uv).map(math::exp2);
        }
        let above = self.slices.partition_point(|slice| slice.0 < n).clamp(1, last);
        let node = |k: usize| self.slices[k].0;
        // The third slice lies on the side where the exponent is nearer.
        let lower = n * n < node(above - 1) * node(above);
        let first = if lower { above.saturating_sub(2) } else { above - 1 }.min(last - 2);
        let weights = three_weights([node(first), node(first + 1), node(first + 2)], n);
        blended([0, 1, 2].map(|k| look_up(&self.slices[first + k], uv)), weights)
    }
}

/// Weights of three nodes that reproduce 1, n and ln(n + 1): log S of even light and of a point of light.
pub(super) fn three_weights([n0, n1, n2]: [f32; 3], n: f32) -> [f32; 3] {
    let (a, b, x) = (n1 - n0, n2 - n0, n - n0);
    let log = |n: f32| ((n + 1.0) / (n0 + 1.0)).ln();
    let (alpha, beta, y) = (log(n1), log(n2), log(n));
    let determinant = a * beta - b * alpha;
    let (w1, w2) = ((x * beta - b * y) / determinant, (a * y - alpha * x) / determinant);
    [1.0 - w1 - w2, w1, w2]
}

/// Exponents to prefilter: one for lobes that have only one, else three or more in equal ratios down from the
/// highest.
fn nodes(
    environment: &Environment,
    spectrum: &Spectrum,
    range: (f32, f32),
    encoding: Encoding,
    error: f32,
) -> Vec<f32> {
    let (low, high) = (range.0.max(LEAST), range.1.max(LEAST));
    if high <= low * 1.001 {
        return vec![high];
    }
    let octaves = match encoding {
        Encoding::Mips => 2.0,
        Encoding::Slices => {
            1.0 / accuracy::steps_per_octave(environment, spectrum, (low, high), error) as f32
        }
    };
    let steps = ((high / low).log2() / octaves).ceil().max(2.0) as i32;
    (0..=steps).rev().map(|k| high * (-octaves * k as f32).exp2()).collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::quadrature::Truth;
    use super::*;
    use std::f32::consts::{PI, TAU};

    /// A dark sky with a sun of 10⁵ in one pixel.
    pub(in crate::render::environment) fn sun(width: usize) -> Environment {
        let height = width / 2;
        let mut pixels = vec![Rgb::new(0.2, 0.3, 0.5); width * height];
        pixels[height / 3 * width + 2 * width / 3] = Rgb::new(1e5, 0.9e5, 0.7e5);
        Environment::new(width, height, pixels).unwrap()
    }

    #[test]
    fn three_nodes_reproduce_even_light_and_a_point_of_light() {
        let nodes = [8.0, 16.0, 32.0];
        for n in [8.0f32, 11.0, 16.0, 25.0, 32.0] {
            let weights = three_weights(nodes, n);
            let blend =
                |f: &dyn Fn(f32) -> f32| nodes.iter().zip(weights).map(|(&n, w)| w * f(n)).sum::<f32>();
            assert!((blend(&|n| -(n + 1.0).ln()) + (n + 1.0).ln()).abs() < 1e-4);
            assert!((blend(&|n| -0.3 * n) + 0.3 * n).abs() < 1e-3);
        }
    }

    #[test]
    fn even_light_is_filtered_to_its_closed_form() {
        let even = Environment::from_function(64, 32, |_| Rgb::ONE);
        for encoding in [Encoding::Slices, Encoding::Mips] {
            let maps = Prefiltered::on_cpu(&even, (1.0, 30.0), encoding, 0.03).unwrap();
            for n in [1.0f32, 2.7, 13.0, 30.0] {
                let expected = TAU / (n + 1.0);
                let got = maps.lobe(Vec3::new(0.3, -0.8, 0.5).normalize(), n);
                assert!((got.x / expected - 1.0).abs() < 5e-3, "{n}: {got} {expected}");
            }
            assert!((maps.irradiance(Vec3::Y).x / PI - 1.0).abs() < 5e-3);
        }
    }

    #[test]
    fn maps_of_a_sun_keep_to_the_error_asked_for_between_their_exponents() {
        let environment = sun(32).rotated(0.4);
        let maps = Prefiltered::on_cpu(&environment, (1.0, 40.0), Encoding::Slices, 0.05).unwrap();
        for n in [1.0f32, 3.3, 11.0, 36.0] {
            let error = Truth::new(&environment, n, 64).error(&maps);
            assert!(error.rms < 0.05, "{n}: {error:?}");
        }
    }

    #[test]
    fn a_smaller_error_is_kept_with_more_slices() {
        let environment = sun(32);
        let spectrum = Spectrum::new(&environment, &[1.0, 64.0], 0.003);
        let exponents = |range, encoding, error| nodes(&environment, &spectrum, range, encoding, error);
        let count = |error| exponents((1.0, 64.0), Encoding::Slices, error).len();
        assert!(count(0.1) < count(0.003), "{} {}", count(0.1), count(0.003));
        assert_eq!(exponents((64.0, 64.0), Encoding::Slices, 0.01), [64.0]);
        assert_eq!(exponents((4.0, 64.0), Encoding::Mips, 0.01), [4.0, 16.0, 64.0]);
    }
}
