//! The corners of a known tag to a small part of a pixel: the whole printed pattern is fitted to the pixels.
//!
//! Fifteen unknowns (four corners, a plane each for the levels of black and of white, which follow the
//! light's falloff, and the blur) by damped least squares, then again with residuals that stand out held down
//! (Huber). All edges of the pattern bear on the corners, not the outline only, and nothing needs a module to
//! be wider than the blur, so that small and foreshortened tags have no bias.

use glam::DVec2;

use super::homography::{Sensitivity, TagMap, area, is_convex, module_width};
use super::pattern::Pattern;
use super::{Detection, Fit, GrayImage, read};
use lobelia_base::linalg::Normal;

/// Corner coordinates, three of black, three of white, the blur's variance.
const UNKNOWNS: usize = 15;
const BLACK: usize = 8;
const WHITE: usize = 11;
const BLUR: usize = 14;

/// The fit looks at this much of the quiet zone, in tag coordinates; the quiet zone is 0.125 wide.
const MARGIN: f64 = 0.08;

/// The most pixels that a fit uses; of a large tag every second, third, … row and column.
const MOST_PIXELS: f64 = 900.0;

/// The blur's variance in square pixels at the start, and its limits. A pixel alone has 1/12.
const FIRST_BLUR: f64 = 0.35;
const BLUR_LIMITS: (f64, f64) = (0.04, 9.0);

/// The part of the variance of the pixels that the pattern must explain.
const LEAST_EXPLAINED: f64 = 0.75;

/// The least contrast, (white − black) / white.
const LEAST_CONTRAST: f64 = 0.2;

/// The most that a corner may move from where it was detected or predicted, in pixels. (The acute corners of
/// a tag that is foreshortened along its diagonal are detected to 3 pixels only.)
const FARTHEST: f64 = 4.5;

/// A fit is done when no corner moves farther than this, in pixels.
const SETTLED: f64 = 0.01;

/// Shifts tried around a prediction: every half pixel up to this many steps on either axis.
const SHIFT: f64 = 0.5;
const SHIFTS: i32 = 7;

/// The least correlation of the samples with the pattern at the best shift.
const LEAST_CORRELATION: f64 = 0.5;

/// Fits a tag from corners that are right to about half a module.
pub(super) fn from_detected(image: &GrayImage, detection: &Detection) -> Option<(Detection, Fit)> {
    fit(image, detection.id, &detection.corners)
}

/// Fits a tag from corners that are right to about three pixels.
pub(super) fn from_predicted(image: &GrayImage, id: u32, predicted: &[DVec2; 4]) -> Option<(Detection, Fit)> {
    let shift = best_shift(image, &Pattern::new(id)?, &TagMap::to_quad(predicted)?)?;
    let (found, quality) = fit(image, id, &predicted.map(|corner| corner + shift))?;
    let near = moved(&found.corners, predicted) <= FARTHEST;
    near.then_some((found, quality))
}

/// The shift at which samples of the modules correlate best with the pattern.
fn best_shift(image: &GrayImage, pattern: &Pattern, map: &TagMap) -> Option<DVec2> {
    let steps = || (-SHIFTS..=SHIFTS).map(|i| f64::from(i) * SHIFT);
    let shifts = steps().flat_map(|y| steps().map(move |x| DVec2::new(x, y)));
    let scored = shifts.filter_map(|shift| {
        let score = correlation(pattern, &read::sample(image, map, shift)?);
        (score >= LEAST_CORRELATION).then_some((shift, score))
    });
    scored.max_by(|a, b| a.1.total_cmp(&b.1)).map(|best| best.0)
}

fn correlation(pattern: &Pattern, samples: &read::Samples) -> f64 {
    let (mut n, mut s, mut p, mut ss, mut pp, mut sp) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for (y, row) in samples.iter().enumerate() {
        for (x, &sample) in row.iter().enumerate() {
            let print = f64::from(u8::from(pattern.is_white(x, y)));
            (n, s, p) = (n + 1.0, s + sample, p + print);
            (ss, pp, sp) = (ss + sample * sample, pp + print * print, sp + sample * print);
        }
    }
    let (ss, pp, sp) = (ss - s * s / n, pp - p * p / n, sp - s * p / n);
    sp / (ss * pp).sqrt().max(f64::MIN_POSITIVE)
}

fn fit(image: &GrayImage, id: u32, start: &[DVec2; 4]) -> Option<(Detection, Fit)> {
    let pixels = pixels_of(image, start)?;
    let problem = Problem { pattern: Pattern::new(id)?, pixels };
    let first = problem.levels(State::new(start))?;
    let plain = problem.descend(first, f64::INFINITY, 12)?;
    let hold = 2.0 * plain.typical_residual();
    let robust = problem.descend(plain.state, hold, 8)?;
    let state = &robust.state;
    let sound = moved(&state.corners, start) <= FARTHEST && is_convex(&state.corners, 1.0);
    let quality = robust.quality()?;
    (sound && quality.explained >= LEAST_EXPLAINED && quality.contrast >= LEAST_CONTRAST)
        .then_some((Detection { id, corners: state.corners }, quality))
}

fn moved(a: &[DVec2; 4], b: &[DVec2; 4]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
}

/// A pixel of the tag and its value.
struct Pixel {
    at: DVec2,
    value: f64,
}

/// The pixels of a tag and a margin of its quiet zone, if all of it is in the picture.
fn pixels_of(image: &GrayImage, corners: &[DVec2; 4]) -> Option<Vec<Pixel>> {
    let map = TagMap::to_quad(corners)?;
    let ring = [-MARGIN, 1.0 + MARGIN].map(|v| [-MARGIN, 1.0 + MARGIN].map(|u| map.pixel(DVec2::new(u, v))));
    let low = ring.iter().flatten().fold(DVec2::INFINITY, |a, &b| a.min(b)).ceil();
    let high = ring.iter().flatten().fold(DVec2::NEG_INFINITY, |a, &b| a.max(b)).floor();
    let last = DVec2::new(image.width as f64 - 1.0, image.height as f64 - 1.0);
    if low.cmplt(DVec2::ZERO).any() || high.cmpgt(last).any() || module_width(corners) < 0.5 {
        return None;
    }
    let step = (area(corners) / MOST_PIXELS).sqrt().ceil().max(1.0) as usize;
    let mut pixels = Vec::new();
    for y in (low.y as usize..=high.y as usize).step_by(step) {
        for x in (low.x as usize..=high.x as usize).step_by(step) {
            let at = DVec2::new(x as f64, y as f64);
            let value = f64::from(image.data[y * image.width + x]);
            let off = (map.tag(at) - 0.5).abs().max_element();
            if off <= 0.5 + MARGIN && value.is_finite() {
                pixels.push(Pixel { at, value });
            }
        }
    }
    (pixels.len() > 2 * UNKNOWNS).then_some(pixels)
}

/// The unknowns.
#[derive(Debug, Clone)]
struct State {
    corners: [DVec2; 4],
    /// Levels as planes over the tag: at its centre, and their slopes along u and v.
    black: [f64; 3],
    white: [f64; 3],
    /// Variance of the blur in square pixels.
    blur: f64,
}

impl State {
    fn new(corners: &[DVec2; 4]) -> Self {
        Self { corners: *corners, black: [0.0; 3], white: [0.0; 3], blur: FIRST_BLUR }
    }

    fn stepped(&self, step: &[f64; UNKNOWNS]) -> Self {
        let add = |level: [f64; 3], at: usize| std::array::from_fn(|i| level[i] + step[at + i]);
        // At most a doubling: far from the solution the blur's slope says little.
        let blur = (self.blur + step[BLUR]).clamp(0.5 * self.blur, 2.0 * self.blur);
        Self {
            corners: std::array::from_fn(|i| self.corners[i] + DVec2::new(step[2 * i], step[2 * i + 1])),
            black: add(self.black, BLACK),
            white: add(self.white, WHITE),
            blur: blur.clamp(BLUR_LIMITS.0, BLUR_LIMITS.1),
        }
    }
}

/// A state with its cost and the equations of the next step.
struct Evaluated {
    state: State,
    cost: f64,
    normal: Normal<UNKNOWNS>,
    residuals: Vec<f64>,
    total: f64,
}

impl Evaluated {
    /// A standard deviation from the residuals' median magnitude, as of a normal distribution.
    fn typical_residual(&self) -> f64 {
        let mut magnitudes: Vec<f64> = self.residuals.iter().map(|r| r.abs()).collect();
        let middle = magnitudes.len() / 2;
        let median = *magnitudes.select_nth_unstable_by(middle, f64::total_cmp).1;
        1.4826 * median.max(f64::MIN_POSITIVE)
    }

    fn quality(&self) -> Option<Fit> {
        let squares: f64 = self.residuals.iter().map(|r| r * r).sum();
        let freedom = (self.residuals.len() - UNKNOWNS) as f64;
        let of_corners: f64 = self.normal.variances()?[..BLACK].iter().sum();
        Some(Fit {
            explained: 1.0 - squares / self.total.max(f64::MIN_POSITIVE),
            contrast: 1.0 - self.state.black[0] / self.state.white[0].max(f64::MIN_POSITIVE),
            blur_px: self.state.blur.sqrt(),
            corner_sigma_px: (of_corners / BLACK as f64 * squares / freedom).sqrt(),
        })
    }
}

struct Problem {
    pattern: Pattern,
    pixels: Vec<Pixel>,
}

impl Problem {
    /// Levels of black and white by linear least squares, the corners and the blur being as they are.
    fn levels(&self, mut state: State) -> Option<State> {
        let view = View::new(&state)?;
        let mut normal = Normal::<6>::new();
        for pixel in &self.pixels {
            let (_, row) = view.predict(&self.pattern, &state, pixel.at);
            normal.add(&std::array::from_fn(|i| row[BLACK + i]), pixel.value, 1.0);
        }
        let [b, bu, bv, w, wu, wv] = normal.solve(0.0)?;
        (state.black, state.white) = ([b, bu, bv], [w, wu, wv]);
        Some(state)
    }

    /// Levenberg and Marquardt's method; residuals beyond `hold` count linearly.
    fn descend(&self, state: State, hold: f64, steps: usize) -> Option<Evaluated> {
        let mut best = self.evaluate(state, hold)?;
        let mut damping = 1e-3;
        for _ in 0..steps {
            let Some(step) = best.normal.solve(damping) else { break };
            match self.evaluate(best.state.stepped(&step), hold) {
                Some(next) if next.cost <= best.cost => {
                    let settled = moved(&next.state.corners, &best.state.corners) < SETTLED;
                    best = next;
                    damping *= 0.1;
                    if settled {
                        break;
                    }
                }
                _ => damping *= 10.0,
            }
        }
        Some(best)
    }

    fn evaluate(&self, state: State, hold: f64) -> Option<Evaluated> {
        let view = View::new(&state)?;
        let (mut cost, mut normal) = (0.0, Normal::new());
        let mut residuals = Vec::with_capacity(self.pixels.len());
        for pixel in &self.pixels {
            let (value, row) = view.predict(&self.pattern, &state, pixel.at);
            let residual = pixel.value - value;
            let weight = (hold / residual.abs().max(f64::MIN_POSITIVE)).min(1.0);
            cost += weight * (2.0 - weight) * residual * residual;
            normal.add(&row, residual, weight);
            residuals.push(residual);
        }
        let mean = self.pixels.iter().map(|p| p.value).sum::<f64>() / self.pixels.len() as f64;
        let total = self.pixels.iter().map(|p| (p.value - mean).powi(2)).sum();
        cost.is_finite().then_some(Evaluated { state, cost, normal, residuals, total })
    }
}

/// The tag's plane as a state puts it in the picture.
struct View {
    map: TagMap,
    sensitivity: Sensitivity,
}

impl View {
    fn new(state: &State) -> Option<Self> {
        let map = TagMap::to_quad(&state.corners)?;
        Some(Self { map, sensitivity: TagMap::sensitivity(&state.corners)? })
    }

    /// The value of a pixel and its derivatives by the unknowns.
    fn predict(&self, pattern: &Pattern, state: &State, pixel: DVec2) -> (f64, [f64; UNKNOWNS]) {
        let tag = self.map.tag(pixel);
        let (by_x, by_y) = self.map.tag_per_pixel(pixel);
        let spread = by_x * by_x + by_y * by_y;
        let tone = pattern.tone(tag, spread * state.blur);
        let basis = [1.0, tag.x - 0.5, tag.y - 0.5];
        let level = |plane: &[f64; 3]| plane.iter().zip(basis).map(|(p, b)| p * b).sum::<f64>();
        let (black, white) = (level(&state.black), level(&state.white));

        let mut row = [0.0; UNKNOWNS];
        // The point of the tag that a pixel shows moves against the motion of the tag.
        for (entry, motion) in row.iter_mut().zip(self.sensitivity.pixel(tag)) {
            *entry = (black - white) * tone.slope.dot(by_x * motion.x + by_y * motion.y);
        }
        for i in 0..3 {
            row[BLACK + i] = (1.0 - tone.value) * basis[i];
            row[WHITE + i] = tone.value * basis[i];
        }
        row[BLUR] = (white - black) * tone.by_variance.dot(spread);
        (black + (white - black) * tone.value, row)
    }
}
