//! Photographs to reflectance: brackets to radiance, registration by fiducials, resampling to texels, (3.9) and (3.10).

use std::path::Path;

use glam::{DVec2, DVec3, Vec3Swizzles};
use half::f16;
use rayon::prelude::*;

use crate::acquire::RunFolder;
use crate::acquire::journal::{ExposureRecord, Record};
use crate::error::{Error, Result};
use crate::progress;
use crate::rig::config::RigConfig;
use crate::rig::geometry::pose_geometry;
use crate::sampled::{PoseGeometry, SampledSbrdf, texel_position_mm};

pub mod camera;
pub mod fiducials;
pub mod frame;
pub mod homography;
pub mod pose;
pub mod radiance;
pub mod reflectance;
pub mod registration;
pub mod resample;
pub mod seen;
mod shifted;

use frame::RawFrame;
use radiance::{BracketedFrame, DarkSignal, MosaicRadiance};
use registration::{Registration, Unregistered};
use resample::BayerPlanes;

/// A developed run.
pub struct Developed {
    /// The reflectance of every texel at every pose.
    pub sampled: SampledSbrdf,
    /// How each pose was registered, or why it was rejected.
    pub registrations: Vec<std::result::Result<Registration, Unregistered>>,
    /// What the rejected poses have in common, if that tells what went wrong.
    pub common_fault: Option<String>,
}

/// One developed pose: its geometry, its registration and its texels.
pub(crate) type DevelopedPose = (PoseGeometry, std::result::Result<Registration, Unregistered>, PoseTexels);

/// What one pose says of every texel, [y, x, rgb].
pub(crate) struct PoseTexels {
    /// Reflectance, sr⁻¹.
    reflectance: Vec<f32>,
    /// Its standard deviation by shot and read noise, sr⁻¹.
    sigma: Vec<f16>,
}

/// Develops a complete run. Poses whose photographs cannot be registered get weight 0 and no samples.
///
/// # Errors
/// Input errors for missing, truncated or mismatched frames, naming pose and file; for an unfinished run; and when no
/// pose at all can be registered.
pub fn run(folder: &Path) -> Result<Developed> {
    let photographs = Photographs::open(folder)?;
    let config = &photographs.run.rig;
    if config.carrier.cylinder_radius_mm.is_some() {
        let message = "the sample is bent over a cylinder (rig.toml: carrier.cylinder_radius_mm), only a flat one can be developed";
        return Err(Error::input(format!("{}: {message}", folder.display())));
    }

    let bar = progress::bar("developing", photographs.poses() as u64, "poses");
    let developed = (0..photographs.poses())
        .into_par_iter()
        .map(|index| {
            let photographed = photographs.pose(index)?;
            let pose = photographs.developed(index, &photographed, DVec2::ZERO);
            bar.advance(1);
            Ok(pose)
        })
        .collect::<Result<Vec<DevelopedPose>>>()?;
    drop(bar);

    let sampled = assembled(config, &developed);
    let mut registrations: Vec<_> =
        developed.into_iter().map(|(_, registration, _)| registration).collect();
    let common_fault = shifted::explain(&photographs.run, &mut registrations)?;
    if let Some(why) = registrations.iter().all(|r| r.is_err()).then(|| registrations.first()).flatten() {
        let reason = why.as_ref().err().map_or("", |unregistered| &unregistered.why);
        return Err(Error::input(format!("no pose could be registered; pose 0: {reason}")));
    }
    Ok(Developed { sampled, registrations, common_fault })
}

/// The poses as a sampled SBRDF.
pub(crate) fn assembled(config: &RigConfig, poses: &[DevelopedPose]) -> SampledSbrdf {
    let (width, height) = (config.carrier.texels_across, config.carrier.texels_down());
    let geometries = poses.iter().map(|(geometry, _, _)| *geometry).collect();
    let mut sampled = SampledSbrdf::empty(width, height, config.carrier.texel_mm(), geometries);
    sampled.reflectance = by_texel(poses, width * height, |texels| &texels.reflectance);
    sampled.sigma = Some(by_texel(poses, width * height, |texels| &texels.sigma));
    sampled
}

/// The values of all poses, [y, x, rgb] each, as [y, x, pose, rgb].
fn by_texel<T: Copy + Send + Sync + Default>(
    poses: &[DevelopedPose],
    texels: usize,
    values: impl Fn(&PoseTexels) -> &[T] + Sync,
) -> Vec<T> {
    let mut all = vec![T::default(); texels * poses.len() * 3];
    all.par_chunks_mut(poses.len() * 3).enumerate().for_each(|(texel, samples)| {
        for (sample, (_, _, pose)) in samples.chunks_exact_mut(3).zip(poses) {
            sample.copy_from_slice(&values(pose)[3 * texel..3 * texel + 3]);
        }
    });
    all
}

/// The photographs of a complete run.
pub struct Photographs {
    /// The run.
    pub run: RunFolder,
    dark: DarkSignal,
    /// The exposures of every pose.
    exposures: Vec<Vec<ExposureRecord>>,
}

/// What a pose's photographs show, and how they lie on the sample or why that can't be told.
pub type Photographed = (MosaicRadiance, std::result::Result<Registration, Unregistered>);

impl Photographs {
    /// Opens a complete run.
    ///
    /// # Errors
    /// As [`run`], but for the frames of poses.
    pub fn open(folder: &Path) -> Result<Self> {
        let run = RunFolder::open(folder)?;
        let dark = dark_signal(&run)?;
        let exposures = recorded_poses(&run)?;
        Ok(Self { run, dark, exposures })
    }

    /// Number of poses.
    pub fn poses(&self) -> usize {
        self.exposures.len()
    }

    /// The radiance that a pose's bracket gives, and its registration.
    ///
    /// # Errors
    /// As [`run`] for the frames of this pose.
    pub fn pose(&self, index: usize) -> Result<Photographed> {
        let at = |error: Error| error.at(format!("pose {index}"));
        let exposures = &self.exposures[index];
        let bracket = read_bracket(&self.run, exposures).map_err(at)?;
        let camera = &self.run.rig.camera;
        let mosaic = radiance::merge(camera, &self.dark, &bracket).map_err(at)?;
        let registration = match radiance::contradiction(camera, &self.dark, &bracket) {
            Some((first, second)) => Err(format!(
                "{} and {} do not show the same, so one of them is another pose's or has another exposure than it says",
                exposures[first].file, exposures[second].file
            )
            .into()),
            None => registration::register(&self.run.rig, &mosaic, &self.run.plan.angles(index)),
        };
        Ok((mosaic, registration))
    }

    /// The reflectance that a pose's photographs show, resampled `off_mm` beside where they were registered.
    pub(crate) fn developed(
        &self,
        index: usize,
        (mosaic, registration): &Photographed,
        off_mm: DVec2,
    ) -> DevelopedPose {
        let config = &self.run.rig;
        let angles = self.run.plan.angles(index);
        match registration.clone() {
            Ok(mut registration) => {
                registration.homography = registration.homography.from_origin(off_mm);
                let geometry = pose_geometry(config, &registration.pose, angles.light);
                let texels = texel_reflectance(config, mosaic, &registration, &geometry);
                (geometry, Ok(registration), texels)
            }
            Err(why) => {
                let geometry =
                    pose_geometry(config, &registration::from_motors(config, &angles), angles.light);
                let texels = config.carrier.texels_across * config.carrier.texels_down();
                let unknown =
                    PoseTexels { reflectance: vec![f32::NAN; 3 * texels], sigma: vec![f16::NAN; 3 * texels] };
                (PoseGeometry { weight: 0.0, ..geometry }, Err(why), unknown)
            }
        }
    }
}

/// The exposures of every pose of the plan, in the plan's order.
fn recorded_poses(run: &RunFolder) -> Result<Vec<Vec<ExposureRecord>>> {
    let mut poses: Vec<Option<Vec<ExposureRecord>>> = vec![None; run.plan.poses.len()];
    for record in &run.records {
        if let Record::Pose { index, exposures, .. } = record {
            let count = poses.len();
            let place = poses.get_mut(*index);
            *place.ok_or_else(|| {
                Error::input(format!("the journal records pose {index}, the plan has {count} poses"))
            })? = Some(exposures.clone());
        }
    }
    let missing = poses.iter().filter(|pose| pose.is_none()).count();
    if missing > 0 {
        let message =
            format!("{missing} of {} poses are not recorded; continue the run with --resume", poses.len());
        return Err(Error::input(format!("{}: {message}", run.path.display())));
    }
    Ok(poses.into_iter().flatten().collect())
}

/// The dark signal of the run's dark frames.
fn dark_signal(run: &RunFolder) -> Result<DarkSignal> {
    let mut frames = Vec::new();
    for record in &run.records {
        if let Record::Dark { exposure, .. } = record {
            if let Some(light) = run.rig.lamp.lit(exposure.lamp_reading) {
                let message = format!(
                    "{}: the lamp burnt while this dark frame was taken, at {light:.3} of its warm light by its photodiode; \
                     acquire the run again",
                    run.path.join(&exposure.file).display()
                );
                return Err(Error::input(message));
            }
            frames.push(read_frame(run, exposure)?);
        }
    }
    DarkSignal::from_frames(&run.rig.camera, &frames).map_err(|error| error.at(run.path.display()))
}

/// Reads a recorded frame; its EXIF exposure must be the controller's.
fn read_frame(run: &RunFolder, exposure: &ExposureRecord) -> Result<RawFrame> {
    let path = run.path.join(&exposure.file);
    let frame = frame::read_photograph(&path)?;
    let camera = &run.rig.camera;
    if (frame.width, frame.height) != (camera.width, camera.height) {
        let (w, h) = (frame.width, frame.height);
        let message = format!("{w} × {h} pixels, rig.toml says {} × {}", camera.width, camera.height);
        return Err(Error::input(format!("{}: {message}", path.display())));
    }
    let agrees = camera.exif.agrees(frame.notes.exposure_s, exposure.open_s);
    agrees.map_err(|why| Error::input(format!("{}: {why}", path.display())))?;
    // The controller's clock is finer than EXIF's rounded shutter speeds.
    let exposure_s = exposure.open_s;
    Ok(RawFrame { width: frame.width, height: frame.height, values: frame.values, exposure_s })
}

/// A pose's frames and what the lamp gave during each.
fn read_bracket(run: &RunFolder, exposures: &[ExposureRecord]) -> Result<Vec<BracketedFrame>> {
    let read = |exposure: &ExposureRecord| {
        let lamp_relative = exposure.lamp_reading / run.rig.lamp.reference_reading;
        Ok(BracketedFrame { frame: read_frame(run, exposure)?, lamp_relative })
    };
    exposures.iter().map(read).collect()
}

/// The reflectance of every texel under one pose and its standard deviation.
fn texel_reflectance(
    config: &RigConfig,
    mosaic: &MosaicRadiance,
    registration: &Registration,
    geometry: &PoseGeometry,
) -> PoseTexels {
    let (values, variances) = (BayerPlanes::new(mosaic), BayerPlanes::of_variance(mosaic));
    let (width, height) = (config.carrier.texels_across, config.carrier.texels_down());
    let count = 3 * width * height;
    let mut texels = PoseTexels { reflectance: Vec::with_capacity(count), sigma: Vec::with_capacity(count) };
    for texel in 0..width * height {
        let position: DVec3 = texel_position_mm(width, height, config.carrier.texel_mm(), texel);
        let pixel = registration.pixel(config, position.xy());
        let factor = reflectance::irradiance_factor(config, geometry, position);
        texels.reflectance.extend(reflectance::reflectance(config, values.sample(pixel), factor));
        let deviation = variances.variance(pixel).map(f32::sqrt);
        texels.sigma.extend(reflectance::reflectance(config, deviation, factor).map(f16::from_f32));
    }
    texels
}
