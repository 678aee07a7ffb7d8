//! One raw frame: the mosaic as the sensor recorded it and its colours, with what the registration made of
//! it.

use glam::DVec2;

use super::pick;
use crate::acquire::RunFolder;
use crate::acquire::journal::{ExposureRecord, Record};
use crate::demo::DemoOutcome;
use crate::develop::fiducials::{self, Detection, GrayImage};
use crate::develop::frame::{self, RawFrame};
use crate::develop::radiance::{MosaicRadiance, bayer_channel};
use crate::develop::registration::{Registration, tag_corners};
use crate::develop::resample::BayerPlanes;
use crate::error::{Error, Result};
use crate::page::html::{self, Raster};
use crate::page::numbers;
use crate::page::scale::quantile;
use crate::reflectance::{Rgb, colour};
use crate::rig::config::RigConfig;

/// Pictures wider than this are reduced.
const MOST_WIDE: usize = 800;

/// Columns and rows of the magnified piece of the mosaic.
const DETAIL: (usize, usize) = (20, 15);

/// Share of saturated pixels above which a shorter exposure is shown.
const MOST_SATURATED: f64 = 0.005;

/// The section.
pub(super) fn section(outcome: &DemoOutcome) -> Result<String> {
    let config = &outcome.run.rig;
    let Some((pose, registration)) = choose(outcome) else {
        return Err(Error::failure("no registered pose to show"));
    };
    let exposures = exposures(&outcome.run, pose);
    let (record, raw) = readable_frame(&outcome.run, exposures)?;
    let light = balanced(config, &raw);
    let seen = detected(config, &light, registration);
    let overlay = overlay(config, registration, &seen);

    let (wi, wo) = pick::central_directions(&outcome.developed.sampled, pose);
    let mosaic =
        framed(config, &mosaic_picture(config, &raw).png()?, &overlay, "raw Bayer mosaic of one photograph");
    let colours = framed(config, &colour_picture(&light).png()?, &overlay, "the same photograph in colour");
    let detail = detail(config, &raw, &light, registration)?;
    let (tags, all) = (seen.len(), config.carrier.tags.len());
    let content = format!(
        "<div class=\"two\">{}{}</div>\n{}",
        html::figure(
            &mosaic,
            &format!(
                "<code>{}</code>, the mosaic as recorded, {} × {} pixels, dark level subtracted, square root \
                 of the values. Exposure {} s, one of {} of this pose.",
                html::escape(&record.file),
                raw.width,
                raw.height,
                numbers::significant(record.open_s, 3),
                exposures.len()
            )
        ),
        html::figure(
            &colours,
            &format!(
                "Interpolated to colour and balanced to the lamp. <b class=\"key detected\">○</b> corners \
                 found in this frame ({tags} of {all} tags), <b class=\"key predicted\">□</b> tags and \
                 sample where the registration puts them; the two differ by {} pixels RMS.",
                numbers::significant(corner_rms(config, registration, &seen), 2)
            )
        ),
        detail
    );
    let lead = format!(
        "Pose {pose} of {}, counted from 0: light at θ<sub>i</sub> = {}, camera at θ<sub>o</sub> = {}. The \
         printed tags, not the motors, say where every texel lies in the photograph: the tags of this pose \
         fit one homography to {} mm RMS on the sample’s plane.",
        outcome.run.plan.poses.len(),
        numbers::degrees(pick::polar(wi)),
        numbers::degrees(pick::polar(wo)),
        numbers::significant(registration.residual_mm, 2)
    );
    Ok(html::section("frame", "One raw frame", &lead, &content))
}

/// A registered pose that shows the sample well: most tags, then oblique but not grazing.
fn choose(outcome: &DemoOutcome) -> Option<(usize, &Registration)> {
    let oblique = |pose: usize| {
        let (wi, wo) = pick::central_directions(&outcome.developed.sampled, pose);
        (pick::polar(wi).to_degrees() - 40.0).abs() + (pick::polar(wo).to_degrees() - 35.0).abs()
    };
    let registered = outcome.developed.registrations.iter().enumerate();
    registered
        .filter_map(|(pose, found)| Some((pose, found.as_ref().ok()?)))
        .min_by(|a, b| b.1.tags.cmp(&a.1.tags).then(oblique(a.0).total_cmp(&oblique(b.0))))
}

/// The photographs of a pose.
fn exposures(run: &RunFolder, pose: usize) -> &[ExposureRecord] {
    let found = run.records.iter().find_map(|record| match record {
        Record::Pose { index, exposures, .. } if *index == pose => Some(exposures.as_slice()),
        _ => None,
    });
    found.unwrap_or_default()
}

/// The longest exposure with hardly a saturated pixel, or the shortest of all.
fn readable_frame<'a>(
    run: &RunFolder,
    exposures: &'a [ExposureRecord],
) -> Result<(&'a ExposureRecord, RawFrame)> {
    let limit = run.rig.camera.black_level + 0.97 * run.rig.camera.range();
    let mut shown = None;
    for record in exposures {
        let raw = frame::read(&run.path.join(&record.file))?;
        let saturated = raw.values.iter().filter(|&&value| f64::from(value) >= limit).count();
        if shown.is_none() || (saturated as f64) < MOST_SATURATED * raw.values.len() as f64 {
            shown = Some((record, raw));
        }
    }
    shown.ok_or_else(|| Error::failure("the journal lists no photograph of the pose to show"))
}

/// The frame with dark level, exposure, responsivity and the lamp's colour divided out; saturated pixels as
/// they are.
fn balanced(config: &RigConfig, raw: &RawFrame) -> MosaicRadiance {
    let camera = &config.camera;
    let gain: [f64; 3] =
        std::array::from_fn(|c| 1.0 / (camera.responsivity[c] * config.lamp.radiance[c] * raw.exposure_s));
    let value = |(k, &value): (usize, &u16)| {
        let channel = bayer_channel(k % raw.width, k / raw.width);
        ((f64::from(value) - camera.black_level) * gain[channel]) as f32
    };
    let data = raw.values.iter().enumerate().map(value).collect();
    MosaicRadiance { width: raw.width, height: raw.height, data, variance: Vec::new() }
}

/// The tags found in this frame alone: first without, then with the registration's prediction.
fn detected(config: &RigConfig, light: &MosaicRadiance, registration: &Registration) -> Vec<Detection> {
    let image = GrayImage { width: light.width, height: light.height, data: light.data.clone() };
    let mut seen = fiducials::detect(&image);
    let known = |id: u32| config.carrier.tags.iter().any(|tag| tag.id == id);
    seen.retain_mut(|found| known(found.id) && fiducials::refine(&image, found).is_some());
    for tag in &config.carrier.tags {
        if seen.iter().all(|found| found.id != tag.id) {
            let predicted = tag_corners(config, tag).map(|corner| registration.pixel(config, corner));
            seen.extend(fiducials::refine_predicted(&image, tag.id, &predicted));
        }
    }
    seen
}

/// RMS distance of the corners found from where the registration puts them, pixels.
fn corner_rms(config: &RigConfig, registration: &Registration, seen: &[Detection]) -> f64 {
    let tags = seen.iter().filter_map(|found| {
        let tag = config.carrier.tags.iter().find(|tag| tag.id == found.id)?;
        Some(
            tag_corners(config, tag)
                .map(|corner| registration.pixel(config, corner))
                .into_iter()
                .zip(found.corners),
        )
    });
    let squares: Vec<f64> = tags.flatten().map(|(a, b)| (a - b).length_squared()).collect();
    (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
}

/// The level that becomes white: most of the picture below it.
fn white(values: &[f32]) -> f32 {
    quantile(values, 0.985).max(1e-9) as f32
}

/// How many of the frame's pixels, each way, share a pixel of the picture.
fn reduction(width: usize) -> usize {
    width.div_ceil(MOST_WIDE).max(1)
}

/// The mosaic in grey, values as recorded, encoded by a square root.
fn mosaic_picture(config: &RigConfig, raw: &RawFrame) -> Raster {
    let step = reduction(raw.width);
    let (width, height) = (raw.width / step, raw.height / step);
    let above = |k: usize| f32::from(raw.values[k]) - config.camera.black_level as f32;
    let white = white(&(0..raw.values.len()).map(above).collect::<Vec<_>>());
    Raster::opaque(width, height, |k| {
        let (x, y) = (k % width * step, k / width * step);
        let block = (0..step * step).map(|j| above((y + j / step) * raw.width + x + j % step));
        let mean = block.sum::<f32>() / (step * step) as f32;
        [(255.0 * (mean / white).clamp(0.0, 1.0).sqrt() + 0.5) as u8; 3]
    })
}

/// The frame interpolated to colour.
fn colour_picture(light: &MosaicRadiance) -> Raster {
    let step = reduction(light.width);
    let (width, height) = (light.width / step, light.height / step);
    let planes = BayerPlanes::new(light);
    let exposure = 0.9 / white(&light.data);
    let middle = (step - 1) as f64 / 2.0;
    Raster::opaque(width, height, |k| {
        let (x, y) = ((k % width * step) as f64 + middle, (k / width * step) as f64 + middle);
        colour::to_srgb8(Rgb::from_array(planes.sample(DVec2::new(x, y))) * exposure)
    })
}

/// A picture of the whole frame under an overlay in the frame's pixels.
fn framed(config: &RigConfig, png: &[u8], overlay: &str, alt: &str) -> String {
    let (width, height) = (config.camera.width, config.camera.height);
    format!(
        "<svg class=\"frame\" role=\"img\" aria-label=\"{alt}\" viewBox=\"-0.5 -0.5 {width} \
         {height}\"><image x=\"-0.5\" y=\"-0.5\" width=\"{width}\" height=\"{height}\" \
         href=\"{}\"/>{overlay}</svg>",
        html::data_uri(png)
    )
}

/// Corners found, and outlines of tags and sample where the registration puts them.
fn overlay(config: &RigConfig, registration: &Registration, seen: &[Detection]) -> String {
    let outline = |corners: [DVec2; 4]| {
        // Straight lines of the plane bend in a distorted image: a few points a side.
        let side = |k: usize| {
            let (from, to) = (corners[k], corners[(k + 1) % 4]);
            (0..6).map(move |j| from.lerp(to, f64::from(j) / 6.0))
        };
        let points = (0..4).flat_map(side).map(|place| {
            let at = registration.pixel(config, place);
            format!("{:.1},{:.1}", at.x, at.y)
        });
        format!("<polygon class=\"predicted\" points=\"{}\"/>", points.collect::<Vec<_>>().join(" "))
    };
    let half = DVec2::new(config.carrier.sample_width_mm, config.carrier.sample_height_mm) / 2.0;
    let sample = [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)].map(|(x, y)| half * DVec2::new(x, y));
    let mut drawn = outline(sample);
    drawn.extend(config.carrier.tags.iter().map(|tag| outline(tag_corners(config, tag))));
    let radius = config.camera.width as f64 / 160.0;
    drawn.extend(seen.iter().flat_map(|tag| tag.corners).map(|corner| {
        format!(
            "<circle class=\"detected\" cx=\"{:.1}\" cy=\"{:.1}\" r=\"{radius:.1}\"/>",
            corner.x, corner.y
        )
    }));
    drawn
}

/// A magnified piece at a corner of the sample: in grey as recorded, in the filters' colours, and
/// interpolated.
fn detail(
    config: &RigConfig,
    raw: &RawFrame,
    light: &MosaicRadiance,
    registration: &Registration,
) -> Result<String> {
    let (width, height) = DETAIL;
    let corner = DVec2::new(-config.carrier.sample_width_mm, config.carrier.sample_height_mm) / 2.0;
    let centre = registration.pixel(config, corner);
    let start = |centre: f64, length: usize, all: usize| {
        // Even, so that the piece begins with a red filter.
        (centre.round() as i64 - length as i64 / 2).clamp(0, (all - length) as i64) as usize / 2 * 2
    };
    let (left, top) = (start(centre.x, width, raw.width), start(centre.y, height, raw.height));
    let at = |k: usize| (left + k % width, top + k / width);
    let values: Vec<f32> = (0..width * height).map(at).map(|(x, y)| light.data[y * raw.width + x]).collect();
    let exposure = 0.9 / quantile(&values, 0.98).max(1e-9) as f32;
    let planes = BayerPlanes::new(light);
    let grey = Raster::opaque(width, height, |k| colour::to_srgb8(Rgb::splat(values[k] * exposure)));
    let filters = Raster::opaque(width, height, |k| {
        let (x, y) = at(k);
        let mut seen = Rgb::ZERO;
        seen[bayer_channel(x, y)] = values[k] * exposure;
        colour::to_srgb8(seen)
    });
    let colours = Raster::opaque(width, height, |k| {
        let (x, y) = at(k);
        colour::to_srgb8(Rgb::from_array(planes.sample(DVec2::new(x as f64, y as f64))) * exposure)
    });
    let figures = [
        (grey, "magnified mosaic in grey", "A corner of the sample, magnified: one value a pixel"),
        (
            filters,
            "magnified mosaic in the filters' colours",
            "Each pixel saw the sample through a red, green or blue filter",
        ),
        (colours, "magnified picture in colour", "Interpolated to three colours a pixel"),
    ];
    let drawn = figures
        .iter()
        .map(|(raster, alt, caption)| {
            Ok(html::figure(&html::picture(&raster.png()?, alt, "texels"), caption))
        })
        .collect::<Result<String>>()?;
    Ok(format!("<div class=\"three\">{drawn}</div>\n"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_of_large_sensors_are_halved_and_keep_their_brightness() {
        let config = RigConfig::default();
        let level = config.camera.black_level as u16 + 1000;
        let raw = RawFrame { width: 1600, height: 20, values: vec![level; 1600 * 20], exposure_s: 0.1 };
        let mosaic = mosaic_picture(&config, &raw);
        assert_eq!((mosaic.width, mosaic.height, mosaic.pixels[805]), (800, 10, [255; 4]));
        let colours = colour_picture(&balanced(&config, &raw));
        assert_eq!((colours.width, colours.height), (800, 10));
        assert!(colours.pixels[5 * 800 + 400].iter().all(|&channel| channel > 0));
    }
}
