//! Photographs to reflectance: brackets to radiance, registration by fiducials, resampling to texels, (3.9)
//! and (3.10).

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use glam::{DVec2, DVec3, Vec3Swizzles};
use half::f16;
use rayon::prelude::*;

use crate::rig::config::RigConfig;
use crate::rig::geometry::pose_geometry;
use crate::run::RunFolder;
use crate::run::journal::{ExposureRecord, Record};
use lobelia_base::error::{Error, Result};
use lobelia_base::memory;
use lobelia_base::progress;
use lobelia_reflectance::sampled::{
    APERTURE_KEY, Attributes, CLIPPED_KEY, PoseGeometry, SampledSbrdf, Window, texel_position_mm,
};
use lobelia_reflectance::warning::samples::PoseSamples;

pub mod camera;
pub(crate) mod dark;
pub mod fiducials;
pub mod frame;
pub mod homography;
mod mosaic;
pub mod pose;
pub mod radiance;
pub mod reflectance;
pub mod registration;
pub mod resample;
pub mod seen;
mod shifted;

pub use shifted::explain;

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
    /// How the samples of each registered pose fared.
    pub samples: Vec<(usize, PoseSamples)>,
    /// What the rejected poses have in common, if that tells what went wrong.
    pub common_fault: Option<String>,
    /// Frames that were left out because they are damaged, and why.
    pub left_out: Vec<String>,
    /// Area of the lamp's aperture, mm².
    pub lamp_aperture_mm2: f64,
}

/// One developed pose: its geometry, its registration and its texels.
pub type DevelopedPose = (PoseGeometry, std::result::Result<Registration, Unregistered>, PoseTexels);

/// What one pose says of every texel, [y, x, rgb].
pub struct PoseTexels {
    /// Reflectance, sr⁻¹.
    reflectance: Vec<f32>,
    /// Its standard deviation by shot and read noise, sr⁻¹.
    sigma: Vec<f16>,
    /// How the samples fared.
    counts: PoseSamples,
}

/// What to develop otherwise than a run's own files say.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// The rig to develop by, instead of the run's own.
    pub rig: Option<RigConfig>,
    /// Develops what is there of a run that is not finished, and leaves damaged frames out.
    pub partial: bool,
    /// Poses to leave out.
    pub skip: BTreeSet<usize>,
    /// The texels to develop, instead of all.
    pub region: Option<Window>,
}

/// Develops a complete run. Poses whose photographs cannot be registered get weight 0 and no samples.
///
/// # Errors
/// Input errors for missing, truncated or mismatched frames, naming pose and file; for an unfinished run; and
/// when no pose at all can be registered.
pub fn run(folder: &Path) -> Result<Developed> {
    run_with(folder, &Options::default())
}

/// Develops a run otherwise than its own files say. Poses that are left out get weight 0 and no samples, so
/// that all keep their numbers.
///
/// # Errors
/// As [`run`], but for what the options allow.
#[expect(clippy::result_large_err, reason = "as large as a registration, of which a pose has one")]
pub fn run_with(folder: &Path, options: &Options) -> Result<Developed> {
    let photographs = Photographs::open_with(folder, options)?;
    let config = &photographs.run.rig;
    if config.carrier.cylinder_radius_mm.is_some() {
        let message = "the sample is bent over a cylinder (rig.toml: carrier.cylinder_radius_mm), only a \
             flat one can be developed";
        return Err(Error::input(format!("{}: {message}", folder.display())));
    }

    // Values and their deviations a channel, by pose and by texel.
    let values = photographs.texels.texels() as u128 * photographs.poses() as u128 * 3;
    let what = format!("a sample of {} texels × {} poses", photographs.texels.texels(), photographs.poses());
    memory::check(2 * values * (4 + 2), &what, "develop a part of it by --region")?;
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

    let sampled = assembled_part(config, &photographs.texels, &developed);
    let registered = developed.iter().enumerate().filter(|(_, (_, registration, _))| registration.is_ok());
    let samples = registered.map(|(pose, (_, _, texels))| (pose, texels.counts)).collect();
    let mut registrations: Vec<_> = developed.into_iter().map(|(_, registration, _)| registration).collect();
    let common_fault = shifted::explain(&photographs.run, &mut registrations)?;
    if registrations.iter().all(|found| found.is_err()) {
        // Why the first one was not that should have been.
        let tried = registrations.iter().enumerate().find(|(pose, _)| !options.skip.contains(pose));
        return Err(Error::input(match tried {
            Some((pose, Err(unregistered))) => {
                format!("no pose could be registered; pose {pose}: {unregistered}")
            }
            _ => "all poses are left out, so there is nothing to develop".to_string(),
        }));
    }
    let lamp_aperture_mm2 = photographs.run.rig.lamp.aperture_mm2();
    let left_out = photographs.left_out();
    Ok(Developed { sampled, registrations, samples, common_fault, left_out, lamp_aperture_mm2 })
}

impl Developed {
    /// What the store of the samples says of them: the share that is clipped, a pose, and the lamp's
    /// aperture.
    pub fn attributes(&self) -> Attributes {
        let mut shares = vec![0.0; self.sampled.poses.len()];
        for (pose, samples) in &self.samples {
            shares[*pose] = samples.clipped_share();
        }
        Attributes::from([
            (CLIPPED_KEY.to_string(), shares.into()),
            (APERTURE_KEY.to_string(), self.lamp_aperture_mm2.into()),
        ])
    }
}

/// The poses as a sampled SBRDF.
pub fn assembled(config: &RigConfig, poses: &[DevelopedPose]) -> SampledSbrdf {
    assembled_part(config, &whole(config), poses)
}

/// All texels of a sample.
fn whole(config: &RigConfig) -> Window {
    Window { x: 0..config.carrier.texels_across, y: 0..config.carrier.texels_down() }
}

/// The poses, of which some texels were developed, as a sampled SBRDF.
fn assembled_part(config: &RigConfig, texels: &Window, poses: &[DevelopedPose]) -> SampledSbrdf {
    let (width, height) = (texels.x.len(), texels.y.len());
    let geometries = poses.iter().map(|(geometry, _, _)| *geometry).collect();
    let mut sampled = SampledSbrdf::empty(width, height, config.carrier.texel_mm(), geometries);
    sampled.offset_texels = texels.offset([config.carrier.texels_across, config.carrier.texels_down()]);
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

/// The photographs of a run.
pub struct Photographs {
    /// The run.
    pub run: RunFolder,
    dark: DarkSignal,
    /// The exposures of every pose, or why it is left out.
    exposures: Vec<std::result::Result<Vec<ExposureRecord>, String>>,
    /// The texels to develop.
    texels: Window,
    partial: bool,
    /// Damaged frames, and why each is left out.
    damaged: Mutex<Vec<String>>,
}

/// What a pose's photographs show, and how they lie on the sample or why that can't be told.
pub type Photographed = (MosaicRadiance, std::result::Result<Registration, Unregistered>);

impl Photographs {
    /// Opens a complete run.
    ///
    /// # Errors
    /// As [`run`], but for the frames of poses.
    pub fn open(folder: &Path) -> Result<Self> {
        Self::open_with(folder, &Options::default())
    }

    /// Opens a run to develop it otherwise than its own files say.
    ///
    /// # Errors
    /// As [`run_with`], but for the frames of poses.
    pub fn open_with(folder: &Path, options: &Options) -> Result<Self> {
        let run = match &options.rig {
            Some(rig) => RunFolder::open_by(folder, rig.clone())?,
            None => RunFolder::open(folder)?,
        };
        let texels = options.region.clone().unwrap_or_else(|| whole(&run.rig));
        let all = whole(&run.rig);
        let wrong =
            |what: &str| Error::input(format!("the region {what} {} × {} texels", all.x.end, all.y.end));
        if texels.texels() == 0 {
            return Err(wrong("is empty; the sample has"));
        }
        if texels.x.end > all.x.end || texels.y.end > all.y.end {
            return Err(wrong("goes beyond the sample's"));
        }
        let (dark, damaged) = dark_signal(&run, options.partial)?;
        let exposures = recorded_poses(&run, options)?;
        Ok(Self { run, dark, exposures, texels, partial: options.partial, damaged: Mutex::new(damaged) })
    }

    /// Damaged frames so far, and why each is left out, in order.
    pub fn left_out(&self) -> Vec<String> {
        let mut sentences = self.damaged.lock().unwrap_or_else(PoisonError::into_inner).clone();
        sentences.sort();
        sentences
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
        let exposures = match &self.exposures[index] {
            Ok(exposures) => exposures,
            Err(why) => return Ok(nothing(why.clone())),
        };
        let at = |error: Error| error.at(format!("pose {index}"));
        let (exposures, bracket) = self.bracket(index, exposures)?;
        if bracket.is_empty() && self.partial {
            return Ok(nothing("none of its frames can be read".into()));
        }
        let camera = &self.run.rig.camera;
        let angles = self.run.plan.angles(index);
        let mosaic = radiance::merge(camera, &self.dark, &bracket).map_err(at)?;
        let registration = match radiance::contradiction(camera, &self.dark, &bracket) {
            Some((first, second)) => {
                let why = format!(
                    "{} and {} do not show the same, so one of them is another pose's or has another \
                     exposure than it says",
                    exposures[first].file, exposures[second].file
                );
                let shown = bracket.iter().map(|one| registration::shown(&self.run.rig, &one.frame, &angles));
                Err(Unregistered { why, elsewhere: None, contradictory: shown.collect() })
            }
            None => registration::register(&self.run.rig, &mosaic, &angles),
        };
        Ok((mosaic, registration))
    }

    /// The frames of a pose that can be read, which are all or else, where that is allowed, the others.
    fn bracket<'a>(
        &self,
        index: usize,
        exposures: &'a [ExposureRecord],
    ) -> Result<(Vec<&'a ExposureRecord>, Vec<BracketedFrame>)> {
        let (mut read, mut bracket) = (Vec::new(), Vec::new());
        for exposure in exposures {
            match read_frame(&self.run, exposure).map_err(|error| error.at(format!("pose {index}"))) {
                Ok(frame) => {
                    let lamp_relative = exposure.lamp_reading / self.run.rig.lamp.reference_reading;
                    read.push(exposure);
                    bracket.push(BracketedFrame { frame, lamp_relative });
                }
                Err(error) if self.partial => {
                    self.damaged.lock().unwrap_or_else(PoisonError::into_inner).push(error.to_string());
                }
                Err(error) => {
                    return Err(error.hint(format!(
                        "--skip-pose {index} leaves the pose out, --partial every frame that is damaged"
                    )));
                }
            }
        }
        Ok((read, bracket))
    }

    /// The reflectance that a pose's photographs show, resampled `off_mm` beside where they were registered.
    pub fn developed(
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
                let texels = texel_reflectance(config, &self.texels, mosaic, &registration, &geometry);
                (geometry, Ok(registration), texels)
            }
            Err(why) => {
                let geometry =
                    pose_geometry(config, &registration::from_motors(config, &angles), angles.light);
                let texels = self.texels.texels();
                let unknown = PoseTexels {
                    reflectance: vec![f32::NAN; 3 * texels],
                    sigma: vec![f16::NAN; 3 * texels],
                    counts: PoseSamples::default(),
                };
                (PoseGeometry { weight: 0.0, ..geometry }, Err(why), unknown)
            }
        }
    }
}

/// A pose without photographs.
fn nothing(why: String) -> Photographed {
    (MosaicRadiance { width: 0, height: 0, data: Vec::new(), variance: Vec::new() }, Err(why.into()))
}

/// The exposures of every pose of the plan, in the plan's order, as the journal has them; none of a pose that
/// is not photographed, or not where the plan has it.
///
/// # Errors
/// Input errors for a pose that is not in the plan.
pub fn photographed(run: &RunFolder) -> Result<Vec<Option<Vec<ExposureRecord>>>> {
    let count = run.plan.poses.len();
    let mut poses: Vec<Option<Vec<ExposureRecord>>> = vec![None; count];
    for record in &run.records {
        if let Record::Pose { index, exposures, .. } = record {
            let place = poses.get_mut(*index);
            *place.ok_or_else(|| {
                Error::input(format!("the journal records pose {index}, the plan has {count} poses"))
            })? = Some(exposures.clone());
        }
        // They were photographed somewhere else than the plan has them, until they are recorded again.
        if let Record::Suspect { from, .. } = record {
            poses.iter_mut().skip(*from).for_each(|exposures| *exposures = None);
        }
    }
    Ok(poses)
}

/// The exposures of every pose of the plan, in the plan's order, or why it is left out.
fn recorded_poses(
    run: &RunFolder,
    options: &Options,
) -> Result<Vec<std::result::Result<Vec<ExposureRecord>, String>>> {
    let count = run.plan.poses.len();
    if let Some(pose) = options.skip.iter().find(|&&pose| pose >= count) {
        return Err(Error::input(format!("pose {pose} is not in the plan, which has 0 to {}", count - 1)));
    }
    let named = photographed(run)?.into_iter().enumerate().map(|(index, exposures)| match exposures {
        _ if options.skip.contains(&index) => Err("it was asked for".to_string()),
        Some(exposures) => Ok(exposures),
        None => Err("it is not photographed yet".to_string()),
    });
    let named: Vec<_> = named.collect();
    let missing = (0..count).filter(|index| named[*index].is_err() && !options.skip.contains(index)).count();
    if missing > 0 && !options.partial {
        let message = format!(
            "{missing} of {count} poses are not recorded; continue the run with --resume, or develop what is \
             there with --partial"
        );
        return Err(Error::input(format!("{}: {message}", run.path.display())));
    }
    // Where the light's arm stood no tag tells.
    if !run.finished() && !options.partial {
        let message = "every pose is recorded, but not that the run ended, before which the axes are \
             checked; continue it with --resume, or develop it as it is with --partial";
        return Err(Error::input(format!("{}: {message}", run.path.display())));
    }
    Ok(named)
}

/// The dark signal of the run's dark frames, and which of them are left out, where that is allowed, and why.
fn dark_signal(run: &RunFolder, partial: bool) -> Result<(DarkSignal, Vec<String>)> {
    let (mut frames, mut damaged) = (Vec::new(), Vec::new());
    let recorded = run.records.iter().filter_map(|record| match record {
        Record::Dark { exposure, .. } => Some(exposure),
        _ => None,
    });
    let times: Vec<f64> = recorded.clone().map(|exposure| exposure.open_s).collect();
    let hint = |error: Error| error.hint("--partial leaves it out, if there are others");
    for exposure in recorded {
        match dark_frame(run, exposure) {
            Ok(frame) => frames.push((exposure, frame)),
            Err(error) if partial => damaged.push(error.to_string()),
            Err(error) => return Err(hint(error)),
        }
    }
    let lit = lit_frames(&run.rig, &frames);
    let (kept, lit): (Vec<_>, Vec<_>) = frames.into_iter().zip(lit).partition(|(_, lit)| lit.is_none());
    for ((exposure, _), why) in lit {
        let file = run.path.join(&exposure.file);
        let error = Error::input(format!("{}: {}", file.display(), why.unwrap_or_default()));
        if !partial {
            return Err(hint(error));
        }
        damaged.push(error.to_string());
    }
    let frames: Vec<RawFrame> = kept.into_iter().map(|((_, frame), _)| frame).collect();
    let span = |times: &mut dyn Iterator<Item = f64>| {
        times.fold((f64::MAX, 0.0f64), |(least, most), time| (least.min(time), most.max(time)))
    };
    if span(&mut times.iter().copied()) != span(&mut frames.iter().map(|frame| frame.exposure_s)) {
        let message = "no dark frame is left of the shortest or of the longest exposure";
        return Err(Error::input(format!("{}: {message}", run.path.display())));
    }
    let dark = DarkSignal::from_frames(&run.rig.camera, &frames);
    Ok((dark.map_err(|error| error.at(run.path.display()))?, damaged))
}

/// Why each dark frame is none, of those that are not.
fn lit_frames(config: &RigConfig, frames: &[(&ExposureRecord, RawFrame)]) -> Vec<Option<String>> {
    let camera = &config.camera;
    let with_tags: Vec<_> = frames.par_iter().map(|(_, frame)| dark::shows_tags(config, frame)).collect();
    let lit = |(k, (_, frame)): (usize, &(&ExposureRecord, RawFrame))| {
        let others = frames.iter().zip(&with_tags).enumerate();
        let mut dark = others.filter(|(other, (_, tags))| *other != k && tags.is_none());
        let darker = dark.find(|(_, ((_, other), _))| dark::outshines(camera, frame, other));
        darker.map(|(_, ((other, _), _))| format!("it shows more light than the dark frame {}", other.file))
    };
    let found: Vec<_> = frames.par_iter().enumerate().map(lit).collect();
    with_tags.into_iter().zip(found).map(|(tags, lit)| tags.or(lit)).collect()
}

/// Reads a dark frame, which the lamp must not have lit.
fn dark_frame(run: &RunFolder, exposure: &ExposureRecord) -> Result<RawFrame> {
    if let Some(light) = run.rig.lamp.lit(exposure.lamp_reading) {
        let message = format!(
            "{}: the lamp burnt while this dark frame was taken, at {light:.3} of its warm light by its \
             photodiode; acquire the run again",
            run.path.join(&exposure.file).display()
        );
        return Err(Error::input(message));
    }
    read_frame(run, exposure)
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

/// The reflectance of every texel under one pose and its standard deviation.
fn texel_reflectance(
    config: &RigConfig,
    window: &Window,
    mosaic: &MosaicRadiance,
    registration: &Registration,
    geometry: &PoseGeometry,
) -> PoseTexels {
    let (values, variances) = (BayerPlanes::new(mosaic), BayerPlanes::of_variance(mosaic));
    let (width, height) = (config.carrier.texels_across, config.carrier.texels_down());
    let count = 3 * window.texels();
    let mut texels = PoseTexels {
        reflectance: Vec::with_capacity(count),
        sigma: Vec::with_capacity(count),
        counts: PoseSamples::default(),
    };
    for texel in window.y.clone().flat_map(|y| window.x.clone().map(move |x| y * width + x)) {
        let position: DVec3 = texel_position_mm(width, height, config.carrier.texel_mm(), texel);
        let pixel = registration.pixel(config, position.xy());
        let factor = reflectance::irradiance_factor(config, geometry, position);
        let value = reflectance::reflectance(config, values.sample(pixel), factor);
        let deviation = variances.variance(pixel).map(f32::sqrt);
        let deviation = reflectance::reflectance(config, deviation, factor);
        let shown = factor > 0.0 && values.contains(pixel);
        texels.counts.add(PoseSamples::of_one(value, deviation, shown));
        texels.reflectance.extend(value);
        texels.sigma.extend(deviation.map(f16::from_f32));
    }
    texels
}
