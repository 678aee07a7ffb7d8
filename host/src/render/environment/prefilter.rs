//! Prefiltered environments (6.13)–(6.18): S(ω_p, n) = ∫ (ω_p·ω_i)ⁿ L_i dω_i over all peak directions for a few exponents,
//! and D(N), which is S(N, 1). One set of maps serves all BRDFs.
//!
//! Maps are equirectangular and hold log₂ S, since highlights of small lights are smooth in the logarithm. Sizes and the
//! spacing of exponents follow from the error that each step may add; the RMS over directions is less than half of it:
//!
//! | step | worst relative error, for a point of light | bound |
//! |---|---|---|
//! | bilinear lookup at angular spacing h | n h² / 4 | 1 % |
//! | light gathered into points at spacing p | n p² / 6 | 0.83 % |
//! | lobe cut off where it is below [`CUT`] | [`CUT`] | 0.1 % |

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::error::Result;
use crate::reflectance::{Rgb, colour};
use crate::render::math;
use crate::scene::{Environment, environment::direction_of, environment::texture_of};

/// Lobes end where they fall below this part of their peak.
const CUT: f32 = 1e-3;
/// Points that are added at once.
const LANES: usize = 8;
/// log₂ of nothing.
const DARK: f32 = -100.0;

/// How the exponent is encoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, clap::ValueEnum)]
pub enum Encoding {
    /// MIP levels: every level has a quarter of the exponent and half of the size; two levels blend.
    Mips,
    /// Slices at the scene's own exponents, or at powers of two when it has many; three blend, exact for a point of light and
    /// for even light.
    Slices,
}

/// An environment as points of light on a grid of equal angles.
pub(super) struct Source {
    pub(super) width: usize,
    pub(super) height: usize,
    /// x, y, z of the unit directions, and r, g, b of radiance times solid angle, each in one run for vector units.
    points: [Vec<f32>; 6],
}

impl Source {
    /// Points at most `spacing` apart where the environment can be gathered, finer than its pixels where it must be: between
    /// them its radiance is bilinear. A point stands at the centroid of the light that it gathers.
    pub(super) fn new(environment: &Environment, spacing: f32) -> Self {
        let pixel = PI / environment.height as f32;
        let parts = (pixel / spacing).ceil().max(1.0) as usize;
        let group = ((spacing / pixel) as usize).max(1);
        let (fine_width, fine_height) = (environment.width * parts, environment.height * parts);
        let (width, height) = (fine_width.div_ceil(group), fine_height.div_ceil(group));
        let edge = |row: usize| (PI * row as f32 / fine_height as f32).cos();
        let points = (0..width * height).into_par_iter().map(|index| {
            let (x, y) = (index % width * group, index / width * group);
            let (mut flux, mut towards) = (Rgb::ZERO, Vec3::ZERO);
            for row in y..(y + group).min(fine_height) {
                let solid_angle = TAU / fine_width as f32 * (edge(row) - edge(row + 1));
                for column in x..(x + group).min(fine_width) {
                    let uv = Vec2::new(
                        (column as f32 + 0.5) / fine_width as f32,
                        (row as f32 + 0.5) / fine_height as f32,
                    );
                    let light = environment.radiance_at(uv) * solid_angle;
                    flux += light;
                    // A little for the dark too, so that every point has a direction.
                    towards += direction_of(uv) * (colour::luminance(light) + 1e-12 * solid_angle);
                }
            }
            (towards.normalize_or(Vec3::Y), flux)
        });
        let points: Vec<(Vec3, Rgb)> = points.collect();
        let plane = |of: fn(&(Vec3, Rgb)) -> f32| points.iter().map(of).collect();
        let planes = [
            plane(|p| p.0.x),
            plane(|p| p.0.y),
            plane(|p| p.0.z),
            plane(|p| p.1.x),
            plane(|p| p.1.y),
            plane(|p| p.1.z),
        ];
        Self { width, height, points: planes }
    }

    /// Directions and radiance times solid angle.
    pub(super) fn points(&self) -> impl Iterator<Item = (Vec3, Rgb)> {
        let vector =
            |first: usize, i: usize| Vec3::from_array(std::array::from_fn(|k| self.points[first + k][i]));
        (0..self.points[0].len()).map(move |i| (vector(0, i), vector(3, i)))
    }

    /// S in a direction for an exponent.
    fn filtered(&self, toward: Vec3, n: f32) -> Rgb {
        let cosine = least_cosine(n);
        let reach = cosine.acos();
        let mut sums = [[0.0; LANES]; 3];
        for row in self.rows(toward, reach) {
            let (first, count) = self.columns(toward, reach, row);
            // A run that passes the seam goes on at the row's start.
            let before = count.min(self.width - first);
            for (start, count) in [(first, before), (0, count - before)] {
                let start = row * self.width + start;
                self.add(start..start + count, toward, n, cosine, &mut sums);
            }
        }
        Rgb::from_array(sums.map(|lanes| lanes.iter().sum()))
    }

    /// Adds a run of points within a lobe, [`LANES`] at a time.
    fn add(
        &self,
        run: std::ops::Range<usize>,
        toward: Vec3,
        n: f32,
        cosine: f32,
        sums: &mut [[f32; LANES]; 3],
    ) {
        let power = |x: f32, y: f32, z: f32| {
            let base = x * toward.x + y * toward.y + z * toward.z;
            // The power is taken in any case, so that lanes stay together.
            let power = math::powf(base.max(1e-6), n);
            if base > cosine { power } else { 0.0 }
        };
        let planes = self.points.each_ref().map(|plane| plane[run.clone()].as_chunks::<LANES>());
        let [x, y, z, r, g, b] = planes.map(|(whole, _)| whole);
        let [mut red, mut green, mut blue] = *sums;
        for i in 0..x.len() {
            for k in 0..LANES {
                let power = power(x[i][k], y[i][k], z[i][k]);
                red[k] += r[i][k] * power;
                green[k] += g[i][k] * power;
                blue[k] += b[i][k] * power;
            }
        }
        let [x, y, z, r, g, b] = planes.map(|(_, rest)| rest);
        for i in 0..x.len() {
            let power = power(x[i], y[i], z[i]);
            red[i] += r[i] * power;
            green[i] += g[i] * power;
            blue[i] += b[i] * power;
        }
        *sums = [red, green, blue];
    }

    /// Rows that a cap touches.
    fn rows(&self, toward: Vec3, reach: f32) -> std::ops::Range<usize> {
        let polar = toward.y.clamp(-1.0, 1.0).acos();
        let row = |angle: f32| angle / PI * self.height as f32;
        let low = (row(polar - reach) - 1.0).max(0.0) as usize;
        let high = ((row(polar + reach) + 2.0) as usize).min(self.height);
        low..high
    }

    /// First column and number of columns of a row that a cap touches.
    fn columns(&self, toward: Vec3, reach: f32, row: usize) -> (usize, usize) {
        let step = PI / self.height as f32;
        // The widest azimuth over the row's height, its neighbours' half pixels included.
        let widest = (0..=4)
            .map(|k| {
                let polar = (row as f32 - 0.5 + 0.5 * k as f32) * step;
                half_azimuth(toward, reach + 0.5 * step, polar)
            })
            .fold(0.0, f32::max);
        if widest <= 0.0 {
            return (0, 0);
        }
        let half = widest / TAU * self.width as f32 + 1.0;
        if 2.0 * half + 1.0 >= self.width as f32 {
            return (0, self.width);
        }
        let middle = (0.5 + toward.x.atan2(-toward.z) / TAU) * self.width as f32;
        let first = (middle - half).floor();
        let count = (middle + half).ceil() - first;
        ((first as i64).rem_euclid(self.width as i64) as usize, count as usize)
    }
}

/// Half the range of azimuth of a cap on a circle of latitude; 0 where they do not meet.
fn half_azimuth(toward: Vec3, reach: f32, polar: f32) -> f32 {
    let (sin, cos) = polar.clamp(0.0, PI).sin_cos();
    let flat = sin * (1.0 - toward.y * toward.y).max(0.0).sqrt();
    let needed = reach.min(PI).cos() - cos * toward.y;
    if flat <= 1e-6 {
        return if needed <= 0.0 { PI } else { 0.0 };
    }
    if needed >= flat { 0.0 } else { (needed / flat).max(-1.0).acos() }
}

/// The cosine at which a lobe falls to [`CUT`].
pub(super) fn least_cosine(n: f32) -> f32 {
    if n > 0.0 { CUT.powf(1.0 / n) } else { 0.0 }
}

/// Spacing of the light's points for an exponent.
pub(super) fn source_spacing(n: f32) -> f32 {
    (0.05 / n.max(4.0)).sqrt()
}

/// Rows of the map of an exponent.
pub(super) fn map_height(n: f32) -> usize {
    ((PI / (0.04 / n.max(4.0)).sqrt()).ceil() as usize).max(16)
}

/// log₂ S for one exponent. The first and the last row are the poles, where a lookup would else see what lies beside them.
pub(super) fn slice(environment: &Environment, n: f32, height: usize) -> Environment {
    let source = Source::new(environment, source_spacing(n));
    let width = 2 * height;
    let direction = |index: usize| {
        let (x, y) = ((index % width) as f32 + 0.5, (index / width) as f32);
        direction_of(Vec2::new(x / width as f32, y / (height - 1) as f32))
    };
    let pixels: Vec<Rgb> =
        (0..width * height).into_par_iter().map(|index| log2(source.filtered(direction(index), n))).collect();
    Environment { width, height, pixels: pixels.into(), rotation: 0.0 }
}

/// The value of a map of [`slice`] at texture coordinates.
fn look_up(map: &Environment, uv: Vec2) -> Rgb {
    let rows = map.height as f32;
    map.radiance_at(Vec2::new(uv.x, (uv.y * (rows - 1.0) + 0.5) / rows))
}

/// The logarithm of a channel, [`DARK`] for nothing.
pub(super) fn log2(value: Rgb) -> Rgb {
    value.map(|v| if v > 0.0 { v.log2().max(DARK) } else { DARK })
}

/// The maps of one environment.
pub(crate) struct Prefiltered {
    encoding: Encoding,
    rotation: f32,
    /// D(N): log₂ S for n = 1.
    diffuse: Environment,
    /// Exponents in rising order, with their maps of log₂ S.
    slices: Vec<(f32, Environment)>,
}

impl Prefiltered {
    /// Prefilters an environment for lobes of the exponents given; `make` computes a slice (environment, exponent, rows).
    ///
    /// # Errors
    /// Those of `make`.
    pub(crate) fn new(
        environment: &Environment,
        exponents: &[f32],
        encoding: Encoding,
        mut make: impl FnMut(&Environment, f32, usize) -> Result<Environment>,
    ) -> Result<Self> {
        let nodes = nodes(exponents, encoding);
        let finest = nodes.last().map_or(16, |&n| map_height(n));
        let count = nodes.len();
        let sized = |(k, &n): (usize, &f32)| match encoding {
            Encoding::Slices => (n, map_height(n)),
            Encoding::Mips => (n, (finest >> (count - 1 - k)).max(4)),
        };
        let sizes: Vec<_> = nodes.iter().enumerate().map(sized).collect();
        let image = Environment { rotation: 0.0, ..environment.clone() };
        let slices = sizes.into_iter().map(|(n, height)| Ok((n, make(&image, n, height)?)));
        Ok(Self {
            encoding,
            rotation: environment.rotation,
            slices: slices.collect::<Result<_>>()?,
            diffuse: make(&image, 1.0, map_height(1.0))?,
        })
    }

    /// On the CPU.
    ///
    /// # Errors
    /// None; [`Self::new`] has them.
    pub(crate) fn on_cpu(environment: &Environment, exponents: &[f32], encoding: Encoding) -> Result<Self> {
        Self::new(environment, exponents, encoding, |image, n, height| Ok(slice(image, n, height)))
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        let maps = self.slices.iter().map(|(_, map)| map).chain([&self.diffuse]);
        maps.map(|map| size_of_val(&map.pixels[..])).sum()
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

    /// S(ω_p, n) for a unit direction.
    pub(crate) fn lobe(&self, peak: Vec3, n: f32) -> Rgb {
        let uv = self.texture(peak);
        let (first, weights) = self.weights(n);
        let maps = self.slices[first..].iter();
        let blended: Rgb = maps
            .zip(weights)
            .map(|((_, map), weight)| if weight == 0.0 { Rgb::ZERO } else { look_up(map, uv) * weight })
            .sum();
        blended.map(math::exp2)
    }

    /// The first of three slices that blend for an exponent, and their weights.
    fn weights(&self, n: f32) -> (usize, [f32; 3]) {
        let last = self.slices.len() - 1;
        let n = n.clamp(self.slices[0].0, self.slices[last].0);
        let above = self.slices.partition_point(|slice| slice.0 < n).min(last);
        let below = above.saturating_sub(1);
        let node = |k: usize| self.slices[k].0;
        match self.encoding {
            Encoding::Mips => {
                if above == below {
                    return (below, [1.0, 0.0, 0.0]);
                }
                let t = (n / node(below)).ln() / (node(above) / node(below)).ln();
                (below, [1.0 - t, t, 0.0])
            }
            Encoding::Slices => {
                // The third node lies on the side where the exponent is nearer.
                let nearer_below = n * n < node(below) * node(above);
                let first =
                    if nearer_below { below.saturating_sub(1) } else { below }.min(last.saturating_sub(2));
                (first, three_weights([node(first), node(first + 1), node(first + 2)], n))
            }
        }
    }
}

/// Weights of three nodes that reproduce 1, n and ln(n + 1): log S of even light and of a point of light.
fn three_weights([n0, n1, n2]: [f32; 3], n: f32) -> [f32; 3] {
    let (a, b, x) = (n1 - n0, n2 - n0, n - n0);
    let log = |n: f32| ((n + 1.0) / (n0 + 1.0)).ln();
    let (alpha, beta, y) = (log(n1), log(n2), log(n));
    let determinant = a * beta - b * alpha;
    let (w1, w2) = ((x * beta - b * y) / determinant, (a * y - alpha * x) / determinant);
    [1.0 - w1 - w2, w1, w2]
}

/// Exponents to prefilter for lobes of the exponents given.
fn nodes(exponents: &[f32], encoding: Encoding) -> Vec<f32> {
    let mut own: Vec<f32> = exponents.iter().map(|n| n.max(0.25)).collect();
    own.sort_by(f32::total_cmp);
    own.dedup_by(|b, a| *b <= *a * 1.001);
    let (low, high) = (own.first().copied().unwrap_or(1.0), own.last().copied().unwrap_or(1.0));
    let ratio = if encoding == Encoding::Mips { 4.0f32 } else { 2.0 };
    let steps = ((high / low).ln() / ratio.ln()).ceil() as usize;
    if encoding == Encoding::Slices && own.len() <= steps + 1 {
        while own.len() < 3 {
            own.push(own.last().map_or(1.0, |n| n * ratio));
        }
        return own;
    }
    let least = if encoding == Encoding::Mips { steps } else { steps.max(2) };
    (0..=least).rev().map(|k| high / ratio.powi(k as i32)).collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use glam::DVec3;

    /// A dark sky with a sun of 10⁵ in one pixel.
    pub(in crate::render::environment) fn sun() -> Environment {
        let mut pixels = vec![Rgb::new(0.2, 0.3, 0.5); 128 * 64];
        pixels[20 * 128 + 90] = Rgb::new(1e5, 0.9e5, 0.7e5);
        Environment::new(128, 64, pixels).unwrap()
    }

    fn exact(environment: &Environment, toward: Vec3, n: f32) -> Rgb {
        // Midpoints of a fourth of a pixel: bilinear light and the lobe are smooth there.
        let (width, height) = (environment.width * 4, environment.height * 4);
        let mut sum = DVec3::ZERO;
        for row in 0..height {
            let polar = (row as f64 + 0.5) / height as f64 * std::f64::consts::PI;
            let solid_angle =
                polar.sin() * std::f64::consts::PI / height as f64 * std::f64::consts::TAU / width as f64;
            for column in 0..width {
                let uv = Vec2::new((column as f32 + 0.5) / width as f32, (row as f32 + 0.5) / height as f32);
                let base = direction_of(uv).dot(toward);
                if base > 0.0 {
                    let power = f64::from(base).powf(f64::from(n)) * solid_angle;
                    sum += environment.radiance_at(uv).as_dvec3() * power;
                }
            }
        }
        sum.as_vec3()
    }

    /// Relative RMS error over directions: half of them anywhere, half where the lobe meets the brightest light.
    pub(in crate::render::environment) fn relative_error(
        maps: &Prefiltered,
        environment: &Environment,
        brightest: Vec3,
        n: f32,
        count: usize,
    ) -> f64 {
        let spread = 1.0 / (n + 1.0).sqrt();
        let mut sums = (0.0, 0.0);
        for k in 0..count {
            let golden = k as f32 * 2.399_963;
            let z = 1.0 - (2.0 * k as f32 + 1.0) / count as f32;
            let anywhere =
                Vec3::new((1.0 - z * z).sqrt() * golden.cos(), z, (1.0 - z * z).sqrt() * golden.sin());
            let toward = if k % 2 == 0 { anywhere } else { (brightest + anywhere * spread).normalize() };
            let (expected, got) = (exact(environment, toward, n), maps.lobe(toward, n));
            sums.0 += f64::from((got - expected).length_squared());
            sums.1 += f64::from(expected.length_squared());
        }
        (sums.0 / sums.1).sqrt()
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
        let maps = Prefiltered::on_cpu(
            &even,
            &[1.0, 90.0, 11.0, 3.0, 2.0, 20.0, 50.0, 60.0, 40.0, 5.0, 77.0, 30.0],
            Encoding::Slices,
        )
        .unwrap();
        for n in [1.0f32, 2.7, 13.0, 62.0, 90.0] {
            let expected = TAU / (n + 1.0);
            let got = maps.lobe(Vec3::new(0.3, -0.8, 0.5).normalize(), n);
            assert!((got.x / expected - 1.0).abs() < 5e-3, "{n}: {got} {expected}");
        }
        assert!((maps.irradiance(Vec3::Y).x / PI - 1.0).abs() < 5e-3);
    }

    #[test]
    fn prefiltering_a_sun_stays_within_one_percent_of_quadrature_between_its_exponents() {
        let environment = sun();
        let brightest = direction_of(Vec2::new(90.5 / 128.0, 20.5 / 64.0));
        let exponents: Vec<f32> = (0..40).map(|k| 1.25f32.powi(k).min(150.0)).collect();
        let maps = Prefiltered::on_cpu(&environment, &exponents, Encoding::Slices).unwrap();
        for n in [1.0f32, 3.3, 24.0, 110.0] {
            let error = relative_error(&maps, &environment, brightest, n, 12);
            assert!(error < 0.01, "{n}: {error}");
        }
    }
}
