//! One photograph's registration: fiducials found, homography to the sample's plane, and the sample's pose (3.6).

use std::fmt;

use glam::DVec2;

use super::fiducials::{self, Detection, GrayImage};
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
    /// Where its tags put the sample, if they show it where the motors cannot have put it: another pose, most likely.
    pub elsewhere: Option<SeenPose>,
}

impl fmt::Display for Unregistered {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.why)
    }
}

impl From<String> for Unregistered {
    fn from(why: String) -> Self {
        Self { why, elsewhere: None }
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
/// A sentence when too few tags are seen, their corners contradict each other, or they show the sample where the motors
/// cannot have put it.
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
    let first = fit(config, &seen)?;
    add_missed_tags(config, &image, &first, &mut seen);
    let homography = fit(config, &seen)?;

    let corners = correspondences(config, &seen);
    let found = SeenPose::find(config, angles, &homography, &corners).ok_or("the tags determine no pose")?;
    let difference = found.difference(config, angles);
    if !difference.allowed {
        return Err(Unregistered { why: contradiction(angles, &difference), elsewhere: Some(found) });
    }
    let pose = pose::estimate(config, angles, &corners).ok_or("the tags contradict the motors' angles")?;
    let squares = corners.iter().map(|c| (homography.invert(c.image) - c.plane_mm).length_squared());
    let residual_mm = (squares.sum::<f64>() / corners.len() as f64).sqrt();
    Ok(Registration { homography, pose, tags: seen.len(), residual_mm })
}

/// What to say of tags that show the sample where the motors cannot have put it.
fn contradiction(angles: &MotorAngles, difference: &Difference) -> String {
    let [pan, tilt, roll, _] = angles.to_degrees();
    format!(
        "the tags show the sample turned by {:.1}° from where the motors had it (pan {pan:.1}°, tilt {tilt:.1}°, roll {roll:.1}°), \
         which is more than the axes' repeatability_deg allows",
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
pub(crate) fn tag_corners(config: &RigConfig, tag: &Tag) -> [DVec2; 4] {
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

/// Fits the homography, leaving out tags that do not lie where the others say.
fn fit(config: &RigConfig, seen: &[Detection]) -> Result<Homography, String> {
    let mut kept: Vec<Detection> = seen.to_vec();
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
            return Ok(homography);
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
