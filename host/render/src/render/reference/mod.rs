//! The reference renderer: a path tracer on the CPU for every kind of light, with interreflection. The other
//! renderers are judged by it.

mod branches;
mod budget;
mod emitters;
mod environment;
mod interface;
mod layers;
mod lobes;
mod media;
#[cfg(test)]
mod optics_tests;
mod rectangle;
#[cfg(test)]
mod sampling_tests;
mod scatter;
mod shining;
mod tally;
#[cfg(test)]
mod tests;
mod trace;
mod triangle;

use std::time::Instant;

use glam::{Vec3, Vec4};
use rayon::prelude::*;

use super::bake::Baked;
use super::sampler::hash;
use super::shading::Rays;
use super::stage::{Changes, Stage};
use super::{Cost, Player, Renderer, Rendering, Variant, compare};
use crate::scene::{Camera, Scene, State};
use budget::{Clock, Deadline};
pub use layers::Layers;
use lobelia_base::error::{Error, Result};
use lobelia_base::progress;
use lobelia_reflectance::picture::Picture;
use media::Inside;
use tally::Tally;
use trace::{Numbers, PARTS, Shaders, Traced, Tracer};

/// Passes before a budget of time or error is looked at: variance needs more than one.
const LEAST_PASSES: u32 = 4;
/// Samples a pixel of one pass when a budget decides how many there are.
const BUDGET_PASS: u32 = 16;

/// How much work to do. Rendering stops at the first of `samples`, `seconds` and `max_error` that is reached.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Samples a pixel at most, rounded up to whole passes; powers of two are spread best.
    pub samples: u32,
    /// Seconds for a view at most, but that every pixel gets a sample; what the scene takes to be made ready
    /// is not counted. The picture then depends on the machine through the numbers of samples and passes.
    pub seconds: Option<f64>,
    /// Relative RMSE of the picture (as [`compare::Errors`] has it) to stop at; the upper estimate by its
    /// variance is used.
    pub max_error: Option<f64>,
    /// Reflections a path at most; 1 leaves interreflection out.
    pub bounces: u32,
    /// Transparent surfaces in a row, from the first on, at which both the reflected and the refracted ray
    /// are followed; beyond, and at 0, one of them by chance.
    pub tree: u32,
    /// The picture is a function of scene, samples and seed, whatever the number of threads.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { samples: 64, seconds: None, max_error: None, bounces: 64, tree: 2, seed: 0 }
    }
}

impl Settings {
    /// Samples a pixel of one pass. The spread of the passes gives the variance.
    fn pass(&self) -> u32 {
        if self.seconds.is_some() || self.max_error.is_some() {
            return BUDGET_PASS.min(self.samples);
        }
        let quarter = (self.samples / LEAST_PASSES).clamp(1, 64);
        1 << quarter.ilog2()
    }

    fn check(&self) -> Result<()> {
        if self.samples == 0 || self.bounces == 0 {
            return Err(Error::input("samples or bounces is 0; use 1 or more"));
        }
        for (name, budget) in [("seconds", self.seconds), ("max-error", self.max_error)] {
            if budget.is_some_and(|budget| budget.is_nan() || budget <= 0.0) {
                return Err(Error::input(format!("{name} is not positive")));
            }
        }
        Ok(())
    }
}

impl Renderer for Settings {
    fn name(&self) -> &'static str {
        "reference"
    }

    fn open(&self, scene: &Scene, _: &Baked) -> Result<Box<dyn Player>> {
        scene.check()?;
        self.check()?;
        let start = Instant::now();
        let stage = Stage::new(scene)?;
        let tracer = Tracer::new(&stage.now, self.bounces, self.tree);
        let prepare_seconds = start.elapsed().as_secs_f64();
        let ready = Ready { tracer, settings: *self, prepare_seconds, quiet: false };
        Ok(Box::new(Playing { stage, ready }))
    }
}

impl Settings {
    /// Renders many views of a scene, which is made ready once, several at a time: cheap ones at the speed of
    /// one that is as large as all. A limit of time is each view's own.
    ///
    /// # Errors
    /// Those of [`Renderer::open`] and [`Player::frame`].
    pub fn views(&self, scene: &Scene, cameras: &[Camera]) -> Result<Vec<Rendering>> {
        scene.check()?;
        self.check()?;
        let start = Instant::now();
        let tracer = Tracer::new(scene, self.bounces, self.tree);
        let prepare_seconds = start.elapsed().as_secs_f64();
        let ready = Ready { tracer, settings: *self, prepare_seconds, quiet: true };
        let bar = progress::bar("reference", cameras.len() as u64, "views");
        let view = |camera: &Camera| {
            let start = Instant::now();
            let rendering = ready.view_by(camera, &move || start.elapsed().as_secs_f64());
            bar.advance(1);
            rendering
        };
        cameras.par_iter().map(view).collect()
    }
}

/// Samples a pixel that charts show, with all bounces and with one.
pub(super) fn variants(base: &Settings) -> Vec<Variant> {
    let one = Settings { bounces: 1, ..*base };
    let of = |series: &'static str, paths: Settings| {
        [1, 4, 16, 64].map(move |samples| Variant {
            series,
            name: format!("{samples} samples"),
            weighed: false,
            renderer: Box::new(Settings { samples, seconds: None, max_error: None, ..paths }),
        })
    };
    of("reference", *base).into_iter().chain(of("reference, one bounce", one)).collect()
}

/// A scene ready to be traced.
struct Ready {
    tracer: Tracer,
    settings: Settings,
    prepare_seconds: f64,
    /// Whether a view shows no progress of its own.
    quiet: bool,
}

/// The same from frame to frame.
struct Playing {
    stage: Stage,
    ready: Ready,
}

/// What is known of a pixel after some passes.
#[derive(Clone, Copy, Default)]
struct Pixel {
    mean: Vec4,
    /// Sum of squared deviations of the passes' means.
    spread: Vec3,
}

impl Player for Playing {
    fn frame(&mut self, state: &State) -> Result<Rendering> {
        let start = Instant::now();
        let changes = self.stage.go(state)?;
        if changes != Changes::default() {
            self.ready.tracer.go_to(&self.stage.now, changes);
        }
        let light_seconds = changes.seconds_since(start);
        let start = Instant::now();
        let mut rendering = self.ready.view_by(&state.camera, &move || start.elapsed().as_secs_f64())?;
        rendering.cost.light_seconds = light_seconds;
        rendering.redone = changes.redone();
        Ok(rendering)
    }
}

impl Ready {
    /// Renders a view by a clock.
    fn view_by(&self, camera: &Camera, clock: &Clock<'_>) -> Result<Rendering> {
        let start = clock();
        let settings = &self.settings;
        let (width, height) = (camera.width as usize, camera.height as usize);
        let seed = hash(settings.seed as u32 ^ hash((settings.seed >> 32) as u32 ^ 0x5bd1_e995));
        let branches = vec![1; width * height];
        let pass = settings.pass();
        let mut view = View::new(&self.tracer, camera, seed, pass, branches);

        let mut pixels = vec![Pixel::default(); width * height];
        let mut cost = Cost { prepare_seconds: self.prepare_seconds, ..Cost::default() };
        let deadline = settings.seconds.map(|seconds| Deadline::new(clock, seconds));
        let mut may_look = true;
        if let Some(deadline) = &deadline {
            let sample_seconds = view.sample_seconds(clock, &mut cost.rays);
            view.pass = budget::pass(deadline.left(), sample_seconds, settings.samples);
            may_look = budget::may_look(deadline.left(), sample_seconds);
        }
        if let Some(look) = may_look.then(|| branches::look(&view, settings.samples)).flatten() {
            cost.rays += look.rays;
            view.branches = look.branches();
        }
        let passes = settings.samples.div_ceil(view.pass);
        let bar = (!self.quiet).then(|| match settings.seconds {
            Some(seconds) => progress::bar("reference", (1e3 * seconds) as u64, "ms"),
            None => progress::bar("reference", u64::from(passes) * height as u64, "rows"),
        });
        let advance = |items: u64| bar.iter().for_each(|bar| bar.advance(items));
        let mut done = 0;
        while done < passes {
            let before = clock();
            // The first pass is made whole, the others are dropped where the time is up before their end.
            let deadline = deadline.filter(|_| done > 0);
            let kept = deadline.map(|_| pixels.clone());
            let rays = view.add(&mut pixels, done + 1, deadline.as_ref(), |rows| {
                if settings.seconds.is_none() {
                    advance(rows);
                }
            });
            if settings.seconds.is_some() {
                advance((1e3 * (clock() - before)) as u64);
            }
            let Some(rays) = rays else {
                pixels = kept.unwrap_or(pixels);
                break;
            };
            cost.rays += rays;
            done += 1;
            let late = deadline.is_some_and(|deadline| deadline.is_over());
            if late || done >= LEAST_PASSES && self.is_exact(&pixels, done) {
                break;
            }
        }
        cost.samples = done * view.pass;
        cost.render_seconds = clock() - start;
        cost.memory_bytes = (self.tracer.bytes() + size_of_val(&pixels[..])) as u64;
        let picture = Picture { width, height, pixels: pixels.iter().map(|pixel| pixel.mean).collect() };
        let variance = (done > 1).then(|| variance(&pixels, done));
        Ok(Rendering {
            picture,
            variance,
            cost,
            redone: vec![],
            adapter: None,
            note: self.tracer.unsampled(),
        })
    }
}

impl Ready {
    /// Whether the error is as small as it shall be.
    fn is_exact(&self, pixels: &[Pixel], passes: u32) -> bool {
        self.settings.max_error.is_some_and(|error| {
            let means = pixels.iter().map(|pixel| pixel.mean.truncate());
            compare::expected_relative_rmse(means, &variance(pixels, passes)) <= error
        })
    }
}

/// Variance of every pixel's mean as if the passes were independent. They are parts of one stratified
/// sequence, which does better: this is an upper estimate.
fn variance(pixels: &[Pixel], passes: u32) -> Vec<Vec3> {
    let degrees = (passes * (passes - 1)) as f32;
    pixels.iter().map(|pixel| pixel.spread / degrees).collect()
}

/// A camera's view of a scene.
struct View<'a> {
    tracer: &'a Tracer,
    rays: Rays,
    /// What the camera is in.
    inside: Inside,
    seed: u32,
    /// Pixels a row.
    width: usize,
    /// Samples a pixel and pass.
    pass: u32,
    /// Rays from the first surface a sample, by pixel.
    branches: Vec<u32>,
}

impl<'a> View<'a> {
    fn new(tracer: &'a Tracer, camera: &Camera, seed: u32, pass: u32, branches: Vec<u32>) -> Self {
        let inside = tracer.inside(camera.position);
        View { tracer, rays: Rays::new(camera), inside, seed, width: camera.width as usize, pass, branches }
    }

    /// Seconds that one sample of all pixels takes, by a sample of every so many.
    fn sample_seconds(&self, clock: &Clock<'_>, rays: &mut u64) -> f64 {
        /// Pixels that one stands for, a prime so that they do not stand in columns.
        const STRIDE: usize = 61;
        let before = clock();
        let one = |shaders: &mut Shaders, place: usize| {
            let mut rays = [0; PARTS];
            let numbers = Numbers { pixel: hash(!self.seed ^ hash(place as u32)), index: 0 };
            let traced =
                self.sample([place % self.width, place / self.width], &numbers, 1, shaders, &mut rays);
            // What is not used might not be computed.
            std::hint::black_box(traced);
            rays.iter().sum::<u64>()
        };
        let count = self.branches.len();
        let places = (0..count.div_ceil(STRIDE)).into_par_iter().map(|k| k * STRIDE);
        *rays += places.map_init(Shaders::new, one).sum::<u64>();
        (clock() - before) * count as f64 / count.div_ceil(STRIDE) as f64
    }

    /// Adds a pass, the `count`-th, to all pixels; returns the number of rays, or nothing where the time was
    /// up before all pixels had it.
    fn add(
        &self,
        pixels: &mut [Pixel],
        count: u32,
        deadline: Option<&Deadline<'_>>,
        advance: impl Fn(u64) + Sync,
    ) -> Option<u64> {
        let add_row = |shaders: &mut Shaders, (y, row): (usize, &mut [Pixel])| {
            if deadline.is_some_and(Deadline::is_over) {
                return None;
            }
            let mut rays = [0; PARTS];
            for (x, pixel) in row.iter_mut().enumerate() {
                let fresh = self.mean(x, y, (count - 1) * self.pass, shaders, &mut rays);
                let difference = fresh - pixel.mean;
                pixel.mean += difference / count as f32;
                pixel.spread += (difference * (fresh - pixel.mean)).truncate();
            }
            advance(1);
            Some(rays.iter().sum::<u64>())
        };
        pixels.par_chunks_mut(self.width).enumerate().map_init(Shaders::new, add_row).sum()
    }

    /// Mean radiance and coverage of one pass's samples of a pixel.
    fn mean(&self, x: usize, y: usize, first: u32, shaders: &mut Shaders, rays: &mut [u64; PARTS]) -> Vec4 {
        let (place, branches) = (y * self.width + x, self.branches[y * self.width + x]);
        let pixel = hash(self.seed ^ hash(place as u32));
        let mut sum = Vec4::ZERO;
        for index in first..first + self.pass {
            let numbers = Numbers { pixel, index };
            let Traced { parts: [a, b], coverage } = self.sample([x, y], &numbers, branches, shaders, rays);
            sum += (a + b).extend(coverage);
        }
        sum / self.pass as f32
    }

    /// One sample of a pixel.
    fn sample(
        &self,
        place: [usize; 2],
        numbers: &Numbers,
        branches: u32,
        shaders: &mut Shaders,
        rays: &mut [u64; PARTS],
    ) -> Traced {
        self.sample_into(place, numbers, branches, shaders, &mut (), rays)
    }

    /// One sample of a pixel, and what it is made up of.
    fn sample_into(
        &self,
        [x, y]: [usize; 2],
        numbers: &Numbers,
        branches: u32,
        shaders: &mut Shaders,
        tally: &mut impl Tally,
        rays: &mut [u64; PARTS],
    ) -> Traced {
        let [dx, dy] = numbers.pixel();
        let direction = self.rays.direction(x as f32 + dx, y as f32 + dy);
        let ray = (self.rays.origin, direction, self.inside);
        self.tracer.path(numbers, ray, branches, shaders, tally, rays)
    }
}
