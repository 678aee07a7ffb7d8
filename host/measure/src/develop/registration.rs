//! One photograph's registration: fiducials found, homography to the sample's plane, and the sample's pose
//! (3.6).

use std::fmt;

use glam::DVec2;

use super::fiducials::{self, Detection, GrayImage};
use super::frame::RawFrame;
use super::homography::{Correspondence, Homography};
use super::radiance::{MosaicRadiance, bayer_channel};
use super::seen::{Difference, SeenPose};
use super::{camera, pose};
use crate::rig::config::{RigConfig, Tag};
use crate::rig::geometry::{MotorAngles, SamplePose, sample_pose};

/// Fewest tags that register a photograph.
pub const FEWEST_TAGS: usize = 4;

/// Corners farther than this from the first fit, pixels, belong to a false or damaged detection.
const OUTLIER_PX: f64 = 2.0;

/// How a photograph lies on the sample.
#[derive(Debug, Clone)]
pub struct Registration {
    /// Sample plane (mm) to normalised image coordinates.
    pub homography: Homography,
    /// The sample on the bench.
    pub pose: SamplePose,
    /// Tags used.
    pub tags: usize,
    /// RMS distance of the corners from the homography, mm on the sample's plane.
    pub residual_mm: f64,
}

impl Registration {
    /// The pixel of a point of the sample's plane, mm.
    pub fn pixel(&self, config: &RigConfig, plane_mm: DVec2) -> DVec2 {
        camera::to_pixel(&config.camera, self.homography.apply(plane_mm))
    }
}

/// Why a photograph could not be registered.
#[derive(Debug, Clone)]
pub struct Unregistered {
    /// A sentence.
    pub why: String,
    /// Where its tags put the sample, if they show it where the motors cannot have put it: another pose, most
    /// likely.
    pub elsewhere: Option<SeenPose>,
    /// What each of its exposures shows by itself, where they do not show the same.
    pub contradictory: Vec<Shown>,
}

/// Which pose one exposure shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shown {
    /// The one that the motors had.
    Own,
    /// Another one.
    Elsewhere(SeenPose),
    /// None that its tags tell of.
    Nothing,
}

impl fmt::Display for Unregistered {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.why)
    }
}

impl From<String> for Unregistered {
    fn from(why: String) -> Self {
        Self { why, elsewhere: None, contradictory: Vec::new() }
    }
}

impl From<&str> for Unregistered {
    fn from(why: &str) -> Self {
        why.to_string().into()
    }
}

/// Registers a photograph taken with the motors at `angles`.
///
/// # Errors
/// A sentence when too few tags are seen, their corners contradict each other, or they show the sample where
/// the motors cannot have put it.
#[expect(clippy::result_large_err, reason = "as large as a registration, of which a pose has one")]
pub fn register(
    config: &RigConfig,
    mosaic: &MosaicRadiance,
    angles: &MotorAngles,
) -> Result<Registration, Unregistered> {
    let image = grey(config, mosaic);
    let mut seen = fiducials::detect(&image);
    seen.retain_mut(|detection| {
        known_tag(config, detection.id).is_some() && fiducials::refine(&image, detection).is_some()
    });
    let (homography, seen) = true_tags(config, &image, seen)?;
    let corners = correspondences(config, &seen);
    let found = SeenPose::find(config, angles, &homography, &corners).ok_or("the tags determine no pose")?;
    let difference = found.difference(config, angles);
    if !difference.allowed {
        let why = contradiction(angles, &difference);
        return Err(Unregistered { why, elsewhere: Some(found), contradictory: Vec::new() });
    }
    let pose = pose::estimate(config, angles, &corners).ok_or("the tags contradict the motors' angles")?;
    let squares = corners.iter().map(|c| (homography.invert(c.image) - c.plane_mm).length_squared());
    let residual_mm = (squares.sum::<f64>() / corners.len() as f64).sqrt();
    Ok(Registration { homography, pose, tags: seen.len(), residual_mm })
}

/// Registers one exposure, as [`register`] does, without the dark frames: their part is small where tags are
/// seen.
///
/// # Errors
/// As [`register`].
#[expect(clippy::result_large_err, reason = "as large as a registration, of which a pose has one")]
pub fn register_frame(
    config: &RigConfig,
    frame: &RawFrame,
    angles: &MotorAngles,
) -> Result<Registration, Unregistered> {
    register(config, &without_dark_frames(config, frame), angles)
}

/// What one exposure of a pose shows by itself.
pub(super) fn shown(config: &RigConfig, frame: &RawFrame, angles: &MotorAngles) -> Shown {
    match register_frame(config, frame, angles) {
        Ok(_) => Shown::Own,
        Err(Unregistered { elsewhere: Some(seen), .. }) => Shown::Elsewhere(seen),
        Err(_) => Shown::Nothing,
    }
}

/// How many of the carrier's tags a frame shows.
pub(super) fn tags_seen(config: &RigConfig, frame: &RawFrame) -> usize {
    let image = grey(config, &without_dark_frames(config, frame));
    let mut seen = fiducials::detect(&image);
    seen.retain_mut(|detection| {
        known_tag(config, detection.id).is_some() && fiducials::refine(&image, detection).is_some()
    });
    config.carrier.tags.iter().filter(|tag| seen.iter().any(|detection| detection.id == tag.id)).count()
}

/// The radiance that one exposure shows, the dark signal taken for the black level.
fn without_dark_frames(config: &RigConfig, frame: &RawFrame) -> MosaicRadiance {
    let camera = &config.camera;
    let saturated = super::radiance::saturation(camera);
    let value = |(k, &value): (usize, &u16)| {
        let channel = bayer_channel(k % frame.width, k / frame.width);
        let light =
            (f64::from(value) - camera.black_level) / (camera.responsivity[channel] * frame.exposure_s);
        if value < saturated { light as f32 } else { f32::NAN }
    };
    let data = frame.values.iter().enumerate().map(value).collect();
    MosaicRadiance { width: frame.width, height: frame.height, data, variance: Vec::new() }
}

/// What to say of tags that show the sample where the motors cannot have put it.
fn contradiction(angles: &MotorAngles, difference: &Difference) -> String {
    let [pan, tilt, roll, _] = angles.to_degrees();
    format!(
        "the tags show the sample turned by {:.1}° from where the motors had it (pan {pan:.1}°, tilt \
         {tilt:.1}°, roll {roll:.1}°), which is more than the axes' repeatability_deg allows",
        difference.angle.to_degrees()
    )
}

/// The mosaic as a picture of the neutral tags: every colour divided by the lamp's.
fn grey(config: &RigConfig, mosaic: &MosaicRadiance) -> GrayImage {
    let brightest = mosaic.data.iter().copied().filter(|v| v.is_finite()).fold(0.0, f32::max);
    let lamp = config.lamp.radiance.map(|l| 1.0 / l as f32);
    let value = |(k, &radiance): (usize, &f32)| {
        let channel = bayer_channel(k % mosaic.width, k / mosaic.width);
        if radiance.is_finite() { radiance * lamp[channel] } else { brightest * lamp[channel] }
    };
    let data = mosaic.data.iter().enumerate().map(value).collect();
    GrayImage { width: mosaic.width, height: mosaic.height, data }
}

fn known_tag(config: &RigConfig, id: u32) -> Option<&Tag> {
    config.carrier.tags.iter().find(|tag| tag.id == id)
}

/// The corners of a tag on the sample's plane: top left, top right, bottom right, bottom left.
pub fn tag_corners(config: &RigConfig, tag: &Tag) -> [DVec2; 4] {
    let half = config.carrier.tag_size_mm / 2.0;
    [(-half, half), (half, half), (half, -half), (-half, -half)]
        .map(|(dx, dy)| DVec2::new(tag.x_mm + dx, tag.y_mm + dy))
}

fn correspondences(config: &RigConfig, seen: &[Detection]) -> Vec<Correspondence> {
    let of_tag = |detection: &Detection| {
        let tag = known_tag(config, detection.id)?;
        let images = detection.corners.map(|pixel| camera::to_normalised(&config.camera, pixel));
        let pairs = tag_corners(config, tag).into_iter().zip(images);
        Some(pairs.map(|(plane_mm, image)| Correspondence { plane_mm, image }).collect::<Vec<_>>())
    };
    seen.iter().filter_map(of_tag).flatten().collect()
}

/// The tags that lie on one plane as the carrier has them, those that were missed or found in a false place
/// among them, and the homography.
fn true_tags(
    config: &RigConfig,
    image: &GrayImage,
    seen: Vec<Detection>,
) -> Result<(Homography, Vec<Detection>), String> {
    let (first, mut kept) = fit(config, seen)?;
    add_missed_tags(config, image, &first, &mut kept);
    fit(config, kept)
}

/// Fits the homography and gives the tags that lie where it says; those that do not lie where the others say
/// are false.
fn fit(config: &RigConfig, mut kept: Vec<Detection>) -> Result<(Homography, Vec<Detection>), String> {
    loop {
        if kept.len() < FEWEST_TAGS {
            return Err(format!(
                "{} of {} tags seen, {FEWEST_TAGS} needed",
                kept.len(),
                config.carrier.tags.len()
            ));
        }
        let homography =
            Homography::fit(&correspondences(config, &kept)).ok_or("the tags determine no plane")?;
        let off = |detection: &Detection| {
            let tag = known_tag(config, detection.id).map(|tag| tag_corners(config, tag));
            let pairs = tag.into_iter().flatten().zip(detection.corners);
            let distance = |(plane, seen): (DVec2, DVec2)| {
                (camera::to_pixel(&config.camera, homography.apply(plane)) - seen).length()
            };
            pairs.map(distance).fold(0.0, f64::max)
        };
        // The worst first: one false tag pulls the others off too.
        let worst = (0..kept.len()).max_by(|&a, &b| off(&kept[a]).total_cmp(&off(&kept[b]))).unwrap_or(0);
        if off(&kept[worst]) <= OUTLIER_PX {
            return Ok((homography, kept));
        }
        kept.swap_remove(worst);
    }
}

/// Looks for the carrier's other tags where the homography says that they are.
fn add_missed_tags(
    config: &RigConfig,
    image: &GrayImage,
    homography: &Homography,
    seen: &mut Vec<Detection>,
) {
    let missed: Vec<&Tag> =
        config.carrier.tags.iter().filter(|tag| seen.iter().all(|d| d.id != tag.id)).collect();
    for tag in missed {
        let predicted =
            tag_corners(config, tag).map(|corner| camera::to_pixel(&config.camera, homography.apply(corner)));
        seen.extend(fiducials::refine_predicted(image, tag.id, &predicted));
    }
}

/// The registration that the motors alone give, for comparison and for tests.
pub fn from_motors(config: &RigConfig, angles: &MotorAngles) -> SamplePose {
    sample_pose(config, angles, glam::DVec3::ZERO)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use lobelia_sim::{sample, simulated};

    const STAND: [f64; 4] = [20.0, -15.0, 40.0, 50.0];

    /// The simulator's photograph of the default carrier.
    fn photograph(config: &RigConfig) -> MosaicRadiance {
        let layout = sample::recipe().layout(Path::new("."), &Default::default()).unwrap();
        let bench = simulated::bench(&Default::default(), layout);
        let values = bench.record(&bench.radiance(STAND.map(f64::to_radians)), 1.0, 0.2, 1);
        let data = values.iter().map(|&value| f32::from(value) - config.camera.black_level as f32).collect();
        MosaicRadiance {
            width: config.camera.width,
            height: config.camera.height,
            data,
            variance: Vec::new(),
        }
    }

    /// Copies the piece of a photograph around `from` to around `to`; both even, so that the filters' colours
    /// stay.
    fn copied(mosaic: &MosaicRadiance, from: DVec2, to: DVec2) -> MosaicRadiance {
        const REACH: i64 = 44;
        let mut copy = mosaic.clone();
        let even = |at: DVec2| (at / 2.0).round().as_i64vec2() * 2;
        let (from, to) = (even(from), even(to));
        let index = |x: i64, y: i64| y as usize * mosaic.width + x as usize;
        for (dx, dy) in (-REACH..REACH).flat_map(|y| (-REACH..REACH).map(move |x| (x, y))) {
            copy.data[index(to.x + dx, to.y + dy)] = mosaic.data[index(from.x + dx, from.y + dy)];
        }
        copy
    }

    fn middle(config: &RigConfig, registration: &Registration, id: u32) -> DVec2 {
        let tag = known_tag(config, id).unwrap();
        registration.pixel(config, DVec2::new(tag.x_mm, tag.y_mm))
    }

    /// A second print of a tag, right by itself, lies where the carrier has none: the registration must be
    /// that of the photograph without it.
    #[test]
    fn a_false_tag_moves_neither_the_homography_nor_the_pose_nor_the_residual() {
        let config = RigConfig::default();
        let angles = MotorAngles::from_degrees(STAND);
        let clean = photograph(&config);
        let expected = register(&config, &clean, &angles).unwrap();
        assert!(expected.tags >= 14);
        let sample = expected.pixel(&config, DVec2::ZERO);
        let spoiled = copied(&clean, middle(&config, &expected, 2), sample);
        let seen = fiducials::detect(&grey(&config, &spoiled));
        assert_eq!(seen.iter().filter(|found| found.id == 2).count(), 2, "the test's false tag is seen");
        let found = register(&config, &spoiled, &angles).unwrap();
        assert_eq!(found.tags, expected.tags);
        let off = |at: DVec2| (found.pixel(&config, at) - expected.pixel(&config, at)).length();
        assert!(off(DVec2::ZERO) < 0.01 && off(DVec2::splat(30.0)) < 0.01);
        assert!((found.residual_mm - expected.residual_mm).abs() < 0.1 * expected.residual_mm);
        assert!((found.pose.translation - expected.pose.translation).length() < 0.01);
        let turned = found.pose.rotation.transpose() * expected.pose.rotation - glam::DMat3::IDENTITY;
        assert!(turned.to_cols_array().iter().all(|entry| entry.abs() < 1e-4));
    }

    #[test]
    fn a_tag_that_was_found_in_a_false_place_is_looked_for_again_in_its_own() {
        let config = RigConfig::default();
        let image = grey(&config, &photograph(&config));
        let mut seen = fiducials::detect(&image);
        seen.retain_mut(|found| fiducials::refine(&image, found).is_some());
        let (_, right) = true_tags(&config, &image, seen.clone()).unwrap();
        let place =
            |tags: &[Detection], id: u32| tags.iter().find(|found| found.id == id).map(|found| found.corners);
        let own = place(&right, 2).unwrap();
        let wrong = seen.iter_mut().find(|found| found.id == 2).unwrap();
        wrong.corners = wrong.corners.map(|corner| corner + DVec2::new(9.0, 5.0));
        let (_, found) = true_tags(&config, &image, seen).unwrap();
        assert_eq!(found.len(), right.len());
        let again = place(&found, 2).unwrap();
        assert!(own.iter().zip(again).all(|(a, b)| a.distance(b) < 0.4), "{own:?} {again:?}");
    }
}
