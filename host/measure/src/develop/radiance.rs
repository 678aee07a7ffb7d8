//! Brackets to radiance (3.4): dark signal subtracted, lamp reading divided out, exposures summed where
//! unsaturated.

use super::frame::RawFrame;
use crate::rig::config::Camera;
use lobelia_base::error::{Error, Result};

/// Share of the sensor's range above which a pixel counts as saturated.
const SATURATION: f64 = 0.97;

/// The dark signal a pixel: a level and a rate, from frames without light at two exposures.
#[derive(Debug, Clone, PartialEq)]
pub struct DarkSignal {
    /// The level after the short exposure, that exposure's dark current included.
    short: Vec<f32>,
    per_second: Vec<f32>,
    /// How many frames went into the short and into the long exposures.
    frames: [usize; 2],
    /// The short exposure, s.
    short_s: f64,
    /// Difference of the two exposures, s; 0 with one only.
    span_s: f64,
}

impl DarkSignal {
    /// Averages dark frames; with one exposure only, the rate is 0.
    ///
    /// # Errors
    /// Without frames, or with frames of other sizes.
    pub fn from_frames(camera: &Camera, frames: &[RawFrame]) -> Result<Self> {
        let pixels = camera.width * camera.height;
        if frames.is_empty() {
            return Err(Error::input("the run has no dark frame"));
        }
        if frames.iter().any(|frame| frame.values.len() != pixels) {
            return Err(Error::input("a dark frame has not the size that rig.toml gives"));
        }
        let shortest = frames.iter().map(|frame| frame.exposure_s).fold(f64::MAX, f64::min);
        let longest = frames.iter().map(|frame| frame.exposure_s).fold(0.0, f64::max);
        let middle = 0.5 * (shortest + longest);
        let (short, long): (Vec<&RawFrame>, Vec<&RawFrame>) =
            frames.iter().partition(|frame| frame.exposure_s <= middle);
        let counts = [short.len(), long.len()];
        let [short_s, long_s] = [&short, &long].map(|frames| mean_exposure(frames));
        let short = average(&short, pixels);
        let span_s = if long.is_empty() { 0.0 } else { long_s - short_s };
        let per_second = if long.is_empty() {
            vec![0.0; pixels]
        } else {
            let rate = |(long, short): (&f32, &f32)| (long - short) / span_s as f32;
            average(&long, pixels).iter().zip(&short).map(rate).collect()
        };
        Ok(Self { short, per_second, frames: counts, short_s, span_s })
    }

    /// The dark signal of pixel `index` after `seconds`.
    fn at(&self, index: usize, seconds: f64) -> f32 {
        self.short[index] + self.per_second[index] * (seconds - self.short_s) as f32
    }

    /// Variance of the sum of what [`Self::at`] gives for `exposures` of together `seconds`, for frames of a
    /// variance of `read` each.
    fn variance(&self, read: f64, exposures: usize, seconds: f64) -> f64 {
        // The sum is a share of the short frames' mean and one of the long frames'.
        let beyond = seconds - exposures as f64 * self.short_s;
        let long = if self.span_s > 0.0 { beyond / self.span_s } else { 0.0 };
        let short = exposures as f64 - long;
        let [short_frames, long_frames] = self.frames.map(|count| count.max(1) as f64);
        read * (short * short / short_frames + long * long / long_frames)
    }
}

fn mean_exposure(frames: &[&RawFrame]) -> f64 {
    frames.iter().map(|frame| frame.exposure_s).sum::<f64>() / frames.len().max(1) as f64
}

fn average(frames: &[&RawFrame], pixels: usize) -> Vec<f32> {
    (0..pixels)
        .map(|k| frames.iter().map(|frame| f32::from(frame.values[k])).sum::<f32>() / frames.len() as f32)
        .collect()
}

/// One exposure of a bracket.
pub struct BracketedFrame {
    /// The photograph.
    pub frame: RawFrame,
    /// Mean radiance of the lamp while the shutter was open, relative to nominal, from the reference reading.
    pub lamp_relative: f64,
}

/// Radiance at every pixel of the mosaic, each in its filter's colour, for the nominal lamp. NaN where every
/// exposure is saturated.
#[derive(Debug, Clone, PartialEq)]
pub struct MosaicRadiance {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row by row.
    pub data: Vec<f32>,
    /// Variance of every value by shot and read noise, those of the dark frames included; empty where that is
    /// not known.
    pub variance: Vec<f32>,
}

/// Variance of rounding to whole values.
const QUANTISATION: f64 = 1.0 / 12.0;

/// The channel (0 red, 1 green, 2 blue) of a pixel of an RGGB mosaic.
pub fn bayer_channel(x: usize, y: usize) -> usize {
    [0, 1, 1, 2][2 * (y % 2) + x % 2]
}

/// Two exposures of a bracket disagree at a pixel that differs by more than this part of the brighter, noise
/// apart.
const DISAGREEMENT: f64 = 0.2;

/// A bracket is contradictory when more than this share of the pixels that can be compared disagree: edges do
/// when the rig shakes.
const MOST_DISAGREEING: f64 = 0.25;

/// Two exposures can be told to be dark and light where noise is below this part of the brighter.
const TOLD: f64 = 0.7;

/// What two exposures of one scene have in common, see [`likeness`].
const LIKE: std::ops::RangeInclusive<f64> = 0.5..=2.0;

/// Fewer pixels than this say nothing.
const LEAST_COMPARED: usize = 200;

/// The two exposures of a bracket that do not show the same thing, where there are such: one of them is the
/// photograph of another pose, or was not exposed for as long as is said.
pub fn contradiction(
    camera: &Camera,
    dark: &DarkSignal,
    bracket: &[BracketedFrame],
) -> Option<(usize, usize)> {
    let limit = saturation(camera);
    let read = read_variance(camera);
    // Radiance, lamp divided out, and its standard deviation in the sensor's values.
    let seen = |k: usize, BracketedFrame { frame, lamp_relative }: &BracketedFrame| {
        let value = frame.values[k];
        let electrons = f64::from(f32::from(value) - dark.at(k, 0.0)) * camera.electrons_per_value;
        let noise = electrons.max(0.0) / camera.electrons_per_value.powi(2) + 2.0 * read;
        let time = frame.exposure_s * lamp_relative;
        let signal = f64::from(f32::from(value) - dark.at(k, frame.exposure_s));
        (value < limit).then_some((signal / time, noise.sqrt() / time))
    };
    let contradict = |first: &BracketedFrame, second: &BracketedFrame| {
        // Where a difference of a fifth would show, and where at least darkness in one and light in the other
        // would.
        let (mut fine, mut coarse) = ([0_usize; 2], [0_usize; 2]);
        for k in 0..first.frame.values.len().min(second.frame.values.len()) {
            let (Some((a, noise_a)), Some((b, noise_b))) = (seen(k, first), seen(k, second)) else {
                continue;
            };
            let (noise, most) = (6.0 * noise_a.hypot(noise_b), DISAGREEMENT * a.max(b));
            let disagree = usize::from((a - b).abs() > noise + most);
            for (counts, told) in [(&mut fine, noise < most), (&mut coarse, noise < TOLD * a.max(b))] {
                if told {
                    counts[0] += 1;
                    counts[1] += disagree;
                }
            }
        }
        [fine, coarse].iter().any(|&[compared, disagreeing]| {
            compared >= LEAST_COMPARED && disagreeing as f64 > MOST_DISAGREEING * compared as f64
        })
    };
    let pairs = (1..bracket.len()).map(|second| (second - 1, second));
    pairs.into_iter().find(|&(first, second)| {
        let [first, second] = [&bracket[first], &bracket[second]];
        let likeness = likeness(camera, dark, first, second);
        contradict(first, second) || likeness.is_some_and(|slope| !LIKE.contains(&slope))
    })
}

/// How much of what the longer of two exposures shows is in the shorter one too: the slope of the regression
/// of the one's values on what the other predicts, 1 of one scene and 0 of darkness. Pixels that are below
/// their noise, each by itself, tell it together, and a level that is off does not matter. `None` where they
/// do not tell it.
fn likeness(
    camera: &Camera,
    dark: &DarkSignal,
    first: &BracketedFrame,
    second: &BracketedFrame,
) -> Option<f64> {
    /// The slope must be known to this.
    const KNOWN: f64 = 0.05;
    let time = |one: &BracketedFrame| one.frame.exposure_s * one.lamp_relative;
    let (short, long) = if time(first) <= time(second) { (first, second) } else { (second, first) };
    let scale = time(short) / time(long);
    let (limit, read) = (saturation(camera), read_variance(camera));
    // The sensor's value above the dark signal and its variance.
    let light = |k: usize, one: &BracketedFrame| {
        let value = one.frame.values[k];
        let signal = f64::from(f32::from(value) - dark.at(k, one.frame.exposure_s));
        (value < limit).then_some((signal, signal.max(0.0) / camera.electrons_per_value + 2.0 * read))
    };
    let (mut count, mut x, mut y, mut xx, mut xy, mut noise_x, mut noise_y) =
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for k in 0..short.frame.values.len().min(long.frame.values.len()) {
        let (Some(short), Some(long)) = (light(k, short), light(k, long)) else { continue };
        let predicted = long.0 * scale;
        count += 1.0;
        x += predicted;
        y += short.0;
        xx += predicted * predicted;
        xy += predicted * short.0;
        noise_x += long.1 * scale * scale;
        noise_y += short.1;
    }
    // What the scene makes of the spread, without what noise does.
    let spread = (xx - x * x / count - noise_x) / count;
    let known = (noise_y / count / count / spread).sqrt();
    let told = count >= LEAST_COMPARED as f64 && spread > 0.0 && known < KNOWN;
    told.then(|| (xy - x * y / count) / count / spread)
}

/// The value from which on a pixel counts as saturated.
pub(crate) fn saturation(camera: &Camera) -> u16 {
    (camera.black_level + SATURATION * camera.range()) as u16
}

/// Variance of one value without light: read noise and rounding.
pub(crate) fn read_variance(camera: &Camera) -> f64 {
    (camera.read_noise_e / camera.electrons_per_value).powi(2) + QUANTISATION
}

/// Merges a bracket. The unsaturated exposures' values are summed and divided by their summed times, which is
/// the estimate of least variance when shot noise rules.
///
/// # Errors
/// Without frames, or with frames of another size than the camera's.
pub fn merge(camera: &Camera, dark: &DarkSignal, bracket: &[BracketedFrame]) -> Result<MosaicRadiance> {
    let pixels = camera.width * camera.height;
    for BracketedFrame { frame, lamp_relative } in bracket {
        if (frame.width, frame.height) != (camera.width, camera.height) {
            let (w, h) = (frame.width, frame.height);
            let message =
                format!("frame of {w} × {h} pixels, rig.toml says {} × {}", camera.width, camera.height);
            return Err(Error::input(message));
        }
        if lamp_relative.partial_cmp(&0.05) != Some(std::cmp::Ordering::Greater) {
            let message =
                format!("the lamp's reference reading is {lamp_relative} of nominal: was the lamp on?");
            return Err(Error::input(message));
        }
    }
    if bracket.is_empty() {
        return Err(Error::input("no exposure"));
    }
    let limit = saturation(camera);
    let response = camera.responsivity.map(|r| 1.0 / r);
    let read = read_variance(camera);
    let (data, variance) = (0..pixels)
        .map(|k| {
            let (mut sum, mut time) = (0.0f64, 0.0f64);
            let (mut exposures, mut seconds, mut electrons) = (0, 0.0, 0.0);
            for BracketedFrame { frame, lamp_relative } in bracket {
                if frame.values[k] < limit {
                    let value = f32::from(frame.values[k]);
                    sum += f64::from(value - dark.at(k, frame.exposure_s));
                    time += frame.exposure_s * lamp_relative;
                    exposures += 1;
                    seconds += frame.exposure_s;
                    electrons += f64::from(value - dark.at(k, 0.0)) * camera.electrons_per_value;
                }
            }
            if exposures == 0 {
                return (f32::NAN, f32::NAN);
            }
            // Electrons of light and dark signal arrive by Poisson's law: their variance is their number.
            let shot = electrons.max(0.0) / camera.electrons_per_value.powi(2);
            let noise = shot + exposures as f64 * read + dark.variance(read, exposures, seconds);
            let scale = response[bayer_channel(k % camera.width, k / camera.width)] / time;
            ((sum * scale) as f32, (noise * scale * scale) as f32)
        })
        .unzip();
    Ok(MosaicRadiance { width: camera.width, height: camera.height, data, variance })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera { width: 16, height: 16, responsivity: [1e4, 2e4, 1e4], ..Camera::default() }
    }

    fn frame(camera: &Camera, exposure_s: f64, radiance: f64) -> RawFrame {
        let value = |k: usize| {
            let gain = camera.responsivity[bayer_channel(k % camera.width, k / camera.width)];
            (camera.black_level + 3.0 * exposure_s + radiance * gain * exposure_s).min(camera.white_level)
                as u16
        };
        let values = (0..camera.width * camera.height).map(value).collect();
        RawFrame { width: camera.width, height: camera.height, values, exposure_s }
    }

    fn dark(camera: &Camera) -> DarkSignal {
        DarkSignal::from_frames(camera, &[frame(camera, 0.001, 0.0), frame(camera, 2.0, 0.0)]).unwrap()
    }

    #[test]
    fn a_bracket_gives_the_radiance_whichever_exposures_are_saturated() {
        let camera = camera();
        let dark = dark(&camera);
        for radiance in [0.05, 0.6, 3.0, 40.0] {
            let shots = [0.01, 0.1, 1.0]
                .map(|t| BracketedFrame { frame: frame(&camera, t, radiance * 0.8), lamp_relative: 0.8 });
            for value in merge(&camera, &dark, &shots).unwrap().data {
                assert!((f64::from(value) / radiance - 1.0).abs() < 5e-3, "{value} {radiance}");
            }
        }
    }

    /// A warm sensor: the frames are black level plus rate times exposure, whatever two exposures the dark
    /// frames had.
    #[test]
    fn the_dark_signal_is_the_black_level_and_the_dark_current_of_the_exposure_once() {
        let camera = Camera { width: 4, height: 2, ..camera() };
        let level = |exposure_s: f64| 512.0 + 400.0 * exposure_s;
        let shot = |exposure_s: f64| RawFrame {
            width: 4,
            height: 2,
            values: vec![level(exposure_s) as u16; 8],
            exposure_s,
        };
        for [short, long] in [[0.5, 2.0], [0.01, 2.0], [1.0, 3.0]] {
            let dark = DarkSignal::from_frames(&camera, &[short, short, long].map(shot)).unwrap();
            for seconds in [0.0, 0.005, short, 1.5, long, 8.0] {
                let found = f64::from(dark.at(3, seconds));
                assert!(
                    (found - level(seconds)).abs() < 1e-3,
                    "{short} s and {long} s: {found} after {seconds} s"
                );
            }
            // What a dark frame says of its own exposure is its mean: the noise of that and of nothing else.
            assert!((dark.variance(9.0, 1, short) - 9.0 / 2.0).abs() < 1e-12);
            assert!((dark.variance(9.0, 1, long) - 9.0).abs() < 1e-12);
        }
    }

    #[test]
    fn pixels_saturated_in_every_exposure_are_not_numbers() {
        let camera = camera();
        let shots = [BracketedFrame { frame: frame(&camera, 1.0, 1e3), lamp_relative: 1.0 }];
        assert!(merge(&camera, &dark(&camera), &shots).unwrap().data.iter().all(|v| v.is_nan()));
    }

    /// A scene of stripes and the same scene a few pixels on, which is what another pose shows.
    #[test]
    fn exposures_of_other_poses_or_of_other_times_contradict_each_other_and_those_of_one_do_not() {
        let camera = Camera { width: 64, height: 48, ..camera() };
        let scene = |exposure_s: f64, shift: usize, factor: f64| {
            let value = |k: usize| {
                let (x, y) = (k % camera.width, k / camera.width);
                let radiance = factor * if ((x + shift) / 8).is_multiple_of(2) { 0.5 } else { 0.1 };
                let gain = camera.responsivity[bayer_channel(x, y)];
                (camera.black_level + 3.0 * exposure_s + radiance * gain * exposure_s).min(camera.white_level)
                    as u16
            };
            let values = (0..camera.width * camera.height).map(value).collect();
            let frame = RawFrame { width: camera.width, height: camera.height, values, exposure_s };
            BracketedFrame { frame, lamp_relative: 1.0 }
        };
        let dark = dark(&camera);
        let check = |second: BracketedFrame| contradiction(&camera, &dark, &[scene(0.05, 0, 1.0), second]);
        assert_eq!(check(scene(0.5, 0, 1.0)), None);
        assert_eq!(check(scene(0.5, 0, 1.1)), None, "a lamp that flickers by a tenth is none of this");
        assert_eq!(check(scene(0.5, 5, 1.0)), Some((0, 1)), "another pose");
        assert_eq!(check(scene(0.5, 0, 0.5)), Some((0, 1)), "half as long as is said");
        assert_eq!(contradiction(&camera, &dark, &[scene(0.05, 0, 1.0)]), None);
        // A frame late: darkness in the place of the short exposure, and that in the place of the long one.
        // The exposures are those that the controller made for each place.
        let late =
            [BracketedFrame { frame: frame(&camera, 0.05, 0.0), lamp_relative: 1.0 }, scene(0.5, 0, 0.1)];
        assert_eq!(contradiction(&camera, &dark, &late), Some((0, 1)), "darkness and light");
        // So much longer a second exposure that no pixel of the first tells darkness from light by itself,
        // and a dark frame that was exposed for longer, so that its level is off.
        let [short, long] = [scene(0.02, 0, 1.0), scene(0.4, 0, 0.05)];
        let dark_frame = RawFrame { exposure_s: 0.02, ..frame(&camera, 2.0, 0.0) };
        let late = [BracketedFrame { frame: dark_frame, lamp_relative: 1.0 }, long];
        assert_eq!(contradiction(&camera, &dark, &late), Some((0, 1)), "darkness and faint light");
        assert_eq!(contradiction(&camera, &dark, &[short, scene(0.4, 0, 1.0)]), None);
    }

    #[test]
    fn a_dark_lamp_is_refused() {
        let camera = camera();
        let shots = [BracketedFrame { frame: frame(&camera, 1.0, 0.1), lamp_relative: 0.0 }];
        assert!(merge(&camera, &dark(&camera), &shots).unwrap_err().to_string().contains("lamp"));
    }

    /// Stated variances against the spread of 400 captures, each with dark frames of its own, that the
    /// simulator's sensor makes of one scene; resampled values between pixels.
    #[test]
    fn stated_variances_are_the_spread_of_repeated_captures() {
        use crate::develop::resample::BayerPlanes;
        use lobelia_hil_sim::optics::camera::SensorModel;
        use lobelia_hil_sim::optics::noise::combine;

        const REPEATS: u64 = 400;
        let camera = Camera { electrons_per_value: 2.0, read_noise_e: 5.0, ..camera() };
        let sensor = SensorModel {
            responsivity: camera.responsivity,
            black_level: camera.black_level,
            white_level: camera.white_level,
            electrons_per_value: camera.electrons_per_value,
            read_noise_e: camera.read_noise_e,
            dark_e_s: 8.0,
        };
        let shoot = |exposure_s: f64, radiance: f64, key: u64| {
            let value = |k: usize| {
                let channel = bayer_channel(k % camera.width, k / camera.width);
                sensor.record(radiance as f32, channel, exposure_s, combine(&[key, k as u64]))
            };
            let values = (0..camera.width * camera.height).map(value).collect();
            RawFrame { width: camera.width, height: camera.height, values, exposure_s }
        };
        let places = [glam::DVec2::new(6.3, 7.9), glam::DVec2::new(8.0, 9.5), glam::DVec2::new(9.1, 6.0)];
        // Read noise rules; both exposures count; the long one is saturated.
        for radiance in [0.002f64, 0.2, 8.0] {
            let (mut stated, mut sums, mut squares) = ([0.0; 9], [0.0; 9], [0.0; 9]);
            for repeat in 0..REPEATS {
                let key = |frame: u64| combine(&[radiance.to_bits(), repeat, frame]);
                let darks: Vec<RawFrame> =
                    (0..4).map(|k| shoot(if k < 2 { 0.001 } else { 2.0 }, 0.0, key(k))).collect();
                let dark = DarkSignal::from_frames(&camera, &darks).unwrap();
                let shots = [0.05f64, 1.0].map(|exposure_s| BracketedFrame {
                    frame: shoot(exposure_s, radiance * 0.9, key(exposure_s.to_bits())),
                    lamp_relative: 0.9,
                });
                let mosaic = merge(&camera, &dark, &shots).unwrap();
                let (values, variances) = (BayerPlanes::new(&mosaic), BayerPlanes::of_variance(&mosaic));
                for (place, at) in places.iter().enumerate() {
                    let (value, variance) = (values.sample(*at), variances.variance(*at));
                    for channel in 0..3 {
                        let (k, off) = (3 * place + channel, f64::from(value[channel]) - radiance);
                        sums[k] += off;
                        squares[k] += off * off;
                        stated[k] += f64::from(variance[channel]);
                    }
                }
            }
            let count = REPEATS as f64;
            let spread = |k: usize| (squares[k] - sums[k] * sums[k] / count) / (count - 1.0);
            let ratio = (0..9).map(|k| stated[k] / count / spread(k)).sum::<f64>() / 9.0;
            // Nine variances of 400 values each, hardly correlated: their mean is known to 2.4 %.
            println!("radiance {radiance}: stated variance over that of the repeats {ratio:.3}");
            assert!((ratio - 1.0).abs() < 0.08, "{radiance}: {ratio}");
        }
    }
}
