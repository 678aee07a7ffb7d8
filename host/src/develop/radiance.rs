//! Brackets to radiance (3.4): dark signal subtracted, lamp reading divided out, exposures summed where unsaturated.

use super::frame::RawFrame;
use crate::error::{Error, Result};
use crate::rig::config::Camera;

/// Share of the sensor's range above which a pixel counts as saturated.
const SATURATION: f64 = 0.97;

/// The dark signal a pixel: a bias and a rate, from frames without light at two exposures.
#[derive(Debug, Clone, PartialEq)]
pub struct DarkSignal {
    bias: Vec<f32>,
    per_second: Vec<f32>,
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
        let short: Vec<&RawFrame> = frames.iter().filter(|frame| frame.exposure_s <= middle).collect();
        let long: Vec<&RawFrame> = frames.iter().filter(|frame| frame.exposure_s > middle).collect();
        let bias = average(&short, pixels);
        let per_second = if long.is_empty() {
            vec![0.0; pixels]
        } else {
            let span = (longest - shortest) as f32;
            average(&long, pixels).iter().zip(&bias).map(|(long, short)| (long - short) / span).collect()
        };
        Ok(Self { bias, per_second })
    }

    /// The dark signal of pixel `index` after `seconds`.
    fn at(&self, index: usize, seconds: f64) -> f32 {
        self.bias[index] + self.per_second[index] * seconds as f32
    }
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

/// Radiance at every pixel of the mosaic, each in its filter's colour, for the nominal lamp. NaN where every exposure
/// is saturated.
#[derive(Debug, Clone, PartialEq)]
pub struct MosaicRadiance {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row by row.
    pub data: Vec<f32>,
}

/// The channel (0 red, 1 green, 2 blue) of a pixel of an RGGB mosaic.
pub fn bayer_channel(x: usize, y: usize) -> usize {
    [0, 1, 1, 2][2 * (y % 2) + x % 2]
}

/// Merges a bracket. The unsaturated exposures' values are summed and divided by their summed times, which is the
/// estimate of least variance when shot noise rules.
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
    let limit = (camera.black_level + SATURATION * camera.range()) as u16;
    let response = camera.responsivity.map(|r| 1.0 / r);
    let data = (0..pixels)
        .map(|k| {
            let (mut sum, mut time) = (0.0f64, 0.0f64);
            for BracketedFrame { frame, lamp_relative } in bracket {
                if frame.values[k] < limit {
                    sum += f64::from(f32::from(frame.values[k]) - dark.at(k, frame.exposure_s));
                    time += frame.exposure_s * lamp_relative;
                }
            }
            let channel = bayer_channel(k % camera.width, k / camera.width);
            if time > 0.0 { (sum / time * response[channel]) as f32 } else { f32::NAN }
        })
        .collect();
    Ok(MosaicRadiance { width: camera.width, height: camera.height, data })
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

    #[test]
    fn pixels_saturated_in_every_exposure_are_not_numbers() {
        let camera = camera();
        let shots = [BracketedFrame { frame: frame(&camera, 1.0, 1e3), lamp_relative: 1.0 }];
        assert!(merge(&camera, &dark(&camera), &shots).unwrap().data.iter().all(|v| v.is_nan()));
    }

    #[test]
    fn a_dark_lamp_is_refused() {
        let camera = camera();
        let shots = [BracketedFrame { frame: frame(&camera, 1.0, 0.1), lamp_relative: 0.0 }];
        assert!(merge(&camera, &dark(&camera), &shots).unwrap_err().to_string().contains("lamp"));
    }
}
