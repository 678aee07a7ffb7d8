//! A fitted map against the photographs that it came from (section 4.4.1): every pose rendered with the rig's
//! own camera and light, pixel by pixel of the mosaic, and how far the two pictures are apart.
//!
//! Both are judged in the same interpolation, inside the sample's outline. Colours are relative to a perfect
//! diffuser at the same point under the same light, so that neither the lamp's colour nor its distance
//! counts. The sample may lie flat, as it did when it was measured, or be bent over a cylinder.

mod angles;
mod page;
mod surface;

use std::f64::consts::PI;
use std::ops::Range;
use std::path::Path;

use glam::{DVec2, DVec3};
use palette::color_difference::Ciede2000;
use palette::{IntoColor, Lab, LinSrgb};
use rayon::prelude::*;

use crate::acquire::RunFolder;
use crate::by_angle::{ByAngle, Cone};
use crate::chart::Chart;
use crate::develop::radiance::{MosaicRadiance, bayer_channel};
use crate::develop::registration::{Registration, Unregistered};
use crate::develop::resample::BayerPlanes;
use crate::develop::{self, Photographs, camera, reflectance};
use crate::error::{Error, Result};
use crate::fit::held_out;
use crate::page::colour_map::ColourMap;
use crate::page::html::Raster;
use crate::page::scale::Scale;
use crate::progress;
use crate::reflectance::{Rgb, SbrdfMap, colour};
use crate::rig::config::RigConfig;
use crate::rig::geometry::{camera_position, pose_geometry};
use crate::sampled::PoseGeometry;
use angles::{Lattice, Seen};
use surface::SurfacePoint;

/// The colour difference at the bright end of the pictures of differences.
const BRIGHTEST_DELTA_E: f64 = 10.0;

/// How far the rendering of a pose is from its photograph, over the sample's pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Difference {
    /// ‖rendered − photographed radiance‖ / ‖photographed‖ over the mosaic's pixels.
    pub relative_rms: f64,
    /// Peak signal-to-noise ratio, dB, of the pictures in sRGB, where a perfect diffuser is white and what is
    /// brighter is clipped.
    pub psnr_db: f64,
    /// CIEDE2000 of the same pictures: mean and 95th percentile.
    pub delta_e: [f64; 2],
}

/// A pose that was compared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ComparedPose {
    /// Index of the pose in the plan.
    pub pose: usize,
    /// Angle between the half vector and the normal at the sample's centre, degrees: 0 looks into the mirror
    /// direction.
    pub half_deg: f64,
    /// The difference.
    pub difference: Difference,
}

/// The colours of one pixel of both pictures, linear, 1 for a perfect diffuser.
struct Pixel {
    photographed: Rgb,
    rendered: Rgb,
}

/// A comparison of poses.
pub struct Comparison {
    /// The poses, in their order.
    pub poses: Vec<ComparedPose>,
    /// Errors of reflectance by the angles at each texel, over all the photographs compared.
    pub by_angle: ByAngle,
    /// The poses that the map was fitted from, where they are known.
    pub cone: Option<Cone>,
    /// Poses that were asked for and could not be registered, and why.
    pub left_out: Vec<(usize, String)>,
    /// Frames that were left out because they are damaged, and what the poses that were left out have in
    /// common.
    pub notes: Vec<String>,
}

/// The texel of the lattice that a pixel of the mosaic sees, and the irradiance of its channel there.
struct Place {
    texel: Option<u32>,
    irradiance: f32,
}

/// A pose's two pictures at half the mosaic's size, cut to the sample's surroundings.
struct Pictures {
    columns: usize,
    /// `None` outside of the sample and where the photograph is saturated.
    pixels: Vec<Option<Pixel>>,
    relative_rms: f64,
}

/// One pose, compared.
struct Shot {
    geometry: PoseGeometry,
    pictures: Pictures,
    seen: Vec<Seen>,
}

/// Compares the given poses, or all when none is given; poses that cannot be registered are left out and
/// named. The result is in order of the poses. `cone` is that of the poses that the map was fitted from.
///
/// # Errors
/// Input errors: a map of another size than the rig's texels, a pose that isn't in the plan, damaged frames,
/// or not one registered pose.
pub fn poses(
    photographs: &Photographs,
    map: &SbrdfMap,
    wanted: &[usize],
    cone: Option<Cone>,
) -> Result<Comparison> {
    check(photographs, map, wanted)?;
    let lattice = Lattice::over(map, &photographs.run.rig.carrier);
    let all: Vec<usize> =
        if wanted.is_empty() { (0..photographs.poses()).collect() } else { wanted.to_vec() };
    let bar = progress::bar("comparing", all.len() as u64, "poses");
    type Compared = std::result::Result<(ComparedPose, Vec<Seen>), Unregistered>;
    let compared: Vec<Compared> = all
        .par_iter()
        .map(|&pose| {
            let found = shot(photographs, map, pose, (&lattice, cone.as_ref()))?;
            bar.advance(1);
            Ok(found.map(|Shot { geometry, pictures, seen }| {
                let half_deg = half_deg(&geometry);
                (ComparedPose { pose, half_deg, difference: pictures.difference() }, seen)
            }))
        })
        .collect::<Result<_>>()?;
    // By their numbers, as what they have in common is told by.
    let not_asked = (0..photographs.poses()).map(|_| Unregistered::from("it was not asked for"));
    let mut by_pose: Vec<Compared> = not_asked.map(Err).collect();
    for (&pose, found) in all.iter().zip(compared) {
        by_pose[pose] = found;
    }
    let common = develop::explain(&photographs.run, &mut by_pose)?;
    let (mut poses, mut seen, mut left_out) = (Vec::new(), Vec::new(), Vec::new());
    for (pose, found) in by_pose.into_iter().enumerate().filter(|(pose, _)| all.contains(pose)) {
        match found {
            Ok((compared, of_texels)) => {
                poses.push(compared);
                seen.push(of_texels);
            }
            Err(why) => left_out.push((pose, why.to_string())),
        }
    }
    if let (true, Some((pose, why))) = (poses.is_empty(), left_out.first()) {
        return Err(Error::input(format!("none of the poses could be registered; pose {pose}: {why}")));
    }
    let notes = photographs.left_out().into_iter().map(|why| format!("a frame is left out: {why}"));
    let notes = notes.chain(common).collect();
    Ok(Comparison { poses, by_angle: angles::together(lattice.len(), &seen), cone, left_out, notes })
}

fn check(photographs: &Photographs, map: &SbrdfMap, wanted: &[usize]) -> Result<()> {
    let carrier = &photographs.run.rig.carrier;
    let (width, height) = (carrier.texels_across, carrier.texels_down());
    if (map.width, map.height) != (width, height) {
        let message = format!(
            "the map has {} × {} texels, the run's rig {width} × {height}; name the rig that it was \
             developed by with --rig or --set; a region's map cannot be compared",
            map.width, map.height
        );
        return Err(Error::input(message));
    }
    match wanted.iter().find(|&&pose| pose >= photographs.poses()) {
        Some(pose) => {
            Err(Error::input(format!("pose {pose} is not in the plan, which has {}", photographs.poses())))
        }
        None => Ok(()),
    }
}

/// Both pictures of a pose with its geometry, or why it cannot be registered.
fn shot(
    photographs: &Photographs,
    map: &SbrdfMap,
    pose: usize,
    (lattice, cone): (&Lattice, Option<&Cone>),
) -> Result<std::result::Result<Shot, Unregistered>> {
    let (photograph, registration) = photographs.pose(pose)?;
    let registration = match registration {
        Ok(registration) => registration,
        Err(why) => return Ok(Err(why)),
    };
    let config = &photographs.run.rig;
    let geometry = pose_geometry(config, &registration.pose, photographs.run.plan.angles(pose).light);
    let seen = |x: f64, y: f64| {
        let plane = registration.homography.invert(camera::to_normalised(&config.camera, DVec2::new(x, y)));
        SurfacePoint::seen(&config.carrier, geometry.camera_mm, plane)
    };
    let (rendering, places) =
        render(config, map, &geometry, (photograph.width, photograph.height), |x, y| {
            let point = seen(x, y)?;
            Some((point, lattice.at(point.flat_mm)))
        });
    let by_texel =
        angles::of_photograph(lattice, cone, (config, &geometry), [&photograph, &rendering], &places);
    let [across, down] = surroundings(config, &registration);
    let planes = [BayerPlanes::new(&photograph), BayerPlanes::new(&rendering)];
    let pixel = |column: usize, row: usize| {
        let at = DVec2::new(2.0 * column as f64 + 0.5, 2.0 * row as f64 + 0.5);
        let white = white(config, &geometry, &seen(at.x, at.y)?);
        let [photographed, rendered] = planes.each_ref().map(|planes| {
            let radiance = planes.sample(at);
            Rgb::from_array(std::array::from_fn(|c| radiance[c] / (config.lamp.radiance[c] * white) as f32))
        });
        (photographed.is_finite() && rendered.is_finite()).then_some(Pixel { photographed, rendered })
    };
    let columns = across.len();
    let pixels = down.flat_map(|row| across.clone().map(move |column| (column, row)));
    let pixels = pixels.map(|(column, row)| pixel(column, row)).collect();
    let relative_rms = relative_rms(&photograph, &rendering);
    Ok(Ok(Shot { geometry, pictures: Pictures { columns, pixels, relative_rms }, seen: by_texel }))
}

/// Radiance of a white pixel, divided by the lamp's: that of a perfect diffuser at the point, which on a
/// cylinder faces the light, so that the cylinder's own shading is seen.
fn white(config: &RigConfig, geometry: &PoseGeometry, point: &SurfacePoint) -> f64 {
    let (toward, solid_angle) = reflectance::light_from(config, geometry, point.position_mm);
    let cosine = if config.carrier.cylinder_radius_mm.is_some() { 1.0 } else { toward.z.max(0.0) };
    cosine * solid_angle / PI
}

/// Columns and rows, in pairs of pixels, that hold the sample.
fn surroundings(config: &RigConfig, registration: &Registration) -> [Range<usize>; 2] {
    let half = DVec2::new(config.carrier.sample_width_mm, config.carrier.sample_height_mm) / 2.0;
    let camera_mm = camera_position(config);
    let pixel = |x: i32, y: f64| {
        let flat = half * DVec2::new(f64::from(x) / 4.0, y);
        let bench = registration.pose.into_bench(SurfacePoint::at(&config.carrier, flat).position_mm);
        camera::to_pixel(&config.camera, camera::project(camera_mm, bench))
    };
    // A cylinder's outline may lie between its edges.
    let outline: Vec<DVec2> = (-4..=4).flat_map(|x| [pixel(x, -1.0), pixel(x, 1.0)]).collect();
    let range = |value: fn(&DVec2) -> f64, pixels: usize| {
        let (low, high) =
            outline.iter().map(value).fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
        let pair = |value: f64| ((value / 2.0).max(0.0) as usize).min(pixels / 2);
        pair(low - 4.0)..pair(high + 4.0)
    };
    [range(|p| p.x, config.camera.width), range(|p| p.y, config.camera.height)]
}

/// The mosaic that the camera would see of the map, radiance for the nominal lamp, NaN beside the sample; and
/// what each pixel sees.
fn render(
    config: &RigConfig,
    map: &SbrdfMap,
    geometry: &PoseGeometry,
    (width, height): (usize, usize),
    seen: impl Fn(f64, f64) -> Option<(SurfacePoint, Option<usize>)>,
) -> (MosaicRadiance, Vec<Place>) {
    let value = |index: usize| {
        let (x, y) = (index % width, index / width);
        let nothing = |radiance| (radiance, Place { texel: None, irradiance: 0.0 });
        let Some((point, texel)) = seen(x as f64, y as f64) else { return nothing(f32::NAN) };
        let (toward, solid_angle) = reflectance::light_from(config, geometry, point.position_mm);
        let wi = point.local(toward);
        if wi.z <= 0.0 {
            return nothing(0.0);
        }
        let wo = point.local((geometry.camera_mm - point.position_mm).normalize()).as_vec3();
        let channel = bayer_channel(x, y);
        let irradiance = (config.lamp.radiance[channel] * wi.z * solid_angle) as f32;
        let neighbours = neighbours(map, config.carrier.texel_mm(), point.flat_mm);
        let reflected = |(texel, weight)| weight * map.eval(texel, wi.as_vec3(), wo)[channel];
        let radiance = neighbours.map(reflected).iter().sum::<f32>() * irradiance;
        (radiance, Place { texel: texel.map(|texel| texel as u32), irradiance })
    };
    let (data, places) = (0..width * height).map(value).unzip();
    (MosaicRadiance { width, height, data, variance: Vec::new() }, places)
}

/// The four texels about a place and their bilinear weights.
fn neighbours(map: &SbrdfMap, texel_mm: f64, place: DVec2) -> [(usize, f32); 4] {
    let column = place.x / texel_mm + map.width as f64 / 2.0 - 0.5;
    let row = map.height as f64 / 2.0 - place.y / texel_mm - 0.5;
    let (left, top) = (column.floor(), row.floor());
    let (right, bottom) = ((column - left) as f32, (row - top) as f32);
    let clamp = |value: f64, count: usize| (value.max(0.0) as usize).min(count - 1);
    [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)].map(|(dx, dy)| {
        let texel = clamp(top + dy, map.height) * map.width + clamp(left + dx, map.width);
        let share = |d: f64, part: f32| if d > 0.0 { part } else { 1.0 - part };
        (texel, share(dx, right) * share(dy, bottom))
    })
}

/// ‖rendered − photographed‖ / ‖photographed‖ where both are numbers.
fn relative_rms(photograph: &MosaicRadiance, rendering: &MosaicRadiance) -> f64 {
    let pairs = photograph.data.iter().zip(&rendering.data).map(|(&p, &r)| (f64::from(p), f64::from(r)));
    let pairs = pairs.filter(|(p, r)| p.is_finite() && r.is_finite());
    let (off, all) = pairs.fold((0.0, 0.0), |(off, all), (p, r)| (off + (r - p).powi(2), all + p * p));
    (off / all).sqrt()
}

/// The angle between half vector and normal at the sample's centre, degrees.
fn half_deg(geometry: &PoseGeometry) -> f64 {
    let half = geometry.light_mm.normalize() + geometry.camera_mm.normalize();
    half.angle_between(DVec3::Z).to_degrees()
}

impl Pixel {
    fn lab(colour: Rgb) -> Lab<palette::white_point::D65, f32> {
        let [r, g, b] = colour.clamp(Rgb::ZERO, Rgb::ONE).to_array();
        LinSrgb::new(r, g, b).into_color()
    }

    fn delta_e(&self) -> f32 {
        Self::lab(self.photographed).difference(Self::lab(self.rendered))
    }

    /// Mean square difference of the three channels in sRGB.
    fn square(&self) -> f64 {
        let [a, b] = [self.photographed, self.rendered].map(|c| c.to_array().map(colour::srgb_encode));
        (0..3).map(|c| f64::from(a[c] - b[c]).powi(2)).sum::<f64>() / 3.0
    }
}

impl Pictures {
    fn difference(&self) -> Difference {
        let seen: Vec<&Pixel> = self.pixels.iter().flatten().collect();
        let count = seen.len() as f64;
        let mean_square = seen.iter().map(|pixel| pixel.square()).sum::<f64>() / count;
        let mut delta_e: Vec<f32> = seen.iter().map(|pixel| pixel.delta_e()).collect();
        delta_e.sort_by(f32::total_cmp);
        let mean = delta_e.iter().map(|&e| f64::from(e)).sum::<f64>() / count;
        let most = delta_e.get(delta_e.len() * 95 / 100).copied().map_or(f64::NAN, f64::from);
        Difference {
            relative_rms: self.relative_rms,
            psnr_db: -10.0 * mean_square.log10(),
            delta_e: [mean, most],
        }
    }

    /// Photograph, rendering, difference; transparent beside the sample.
    fn rasters(&self) -> [Raster; 3] {
        let scale = Scale::linear(0.0, BRIGHTEST_DELTA_E);
        let raster = |colour: &dyn Fn(&Pixel) -> [u8; 3]| {
            let opaque = |pixel: &Pixel| {
                let [r, g, b] = colour(pixel);
                [r, g, b, 255]
            };
            let pixels: Vec<[u8; 4]> =
                self.pixels.iter().map(|pixel| pixel.as_ref().map_or([0; 4], opaque)).collect();
            Raster { width: self.columns, height: pixels.len() / self.columns.max(1), pixels }
        };
        [
            raster(&|pixel| colour::to_srgb8(pixel.photographed)),
            raster(&|pixel| colour::to_srgb8(pixel.rendered)),
            raster(&|pixel| ColourMap::Viridis.at(scale.place(f64::from(pixel.delta_e())))),
        ]
    }
}

/// Opens the run and compares. `rig` is another rig to compare by than the run's own, as when it was
/// developed by one. `measured_in` is the run that the map was fitted from; without it that is the compared
/// run itself, where the sample lies flat in it.
///
/// # Errors
/// As [`poses`] and [`Photographs::open`].
pub fn run(
    folder: &Path,
    map: &SbrdfMap,
    wanted: &[usize],
    rig: Option<RigConfig>,
    measured_in: Option<&Path>,
) -> Result<(Comparison, Chart)> {
    // What is there is compared; what is damaged or not there yet is named.
    let options = develop::Options { partial: true, rig, ..develop::Options::default() };
    let photographs = Photographs::open_with(folder, &options)?;
    let other = measured_in.map(RunFolder::open).transpose()?;
    let own = Some(&photographs.run).filter(|run| run.rig.carrier.cylinder_radius_mm.is_none());
    let cone = other.as_ref().or(own).map(|run| measured(run, map)).transpose()?;
    let comparison = poses(&photographs, map, wanted, cone)?;
    let chart = page::chart(&photographs, map, &comparison)?;
    Ok((comparison, chart))
}

/// The cone of the poses of a run that a map was fitted from: without those that were not photographed, and
/// those that the map says were skipped, not registered or held out.
fn measured(run: &RunFolder, map: &SbrdfMap) -> Result<Cone> {
    let photographed = develop::photographed(run)?;
    let mut left_out = held_out::noted(map);
    left_out.extend((0..photographed.len()).filter(|&pose| photographed[pose].is_none()));
    Ok(Cone::of_plan(&run.plan, &run.rig).without(&left_out))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::acquire::journal::Record;
    use crate::by_angle::Side;
    use crate::plan::{self, Extent};
    use crate::reflectance::LobeBrdf;
    use crate::rig::geometry::directions;

    #[test]
    fn poses_that_were_not_photographed_registered_or_fitted_are_not_measured() {
        let rig = RigConfig::default();
        let mut plan = plan::make(&rig, Extent::Budget(6), true, 1).unwrap();
        // So near that a pose is in its own cone alone.
        plan.spacing_deg = 0.5;
        let pairs: Vec<_> = (0..6).map(|pose| directions(&rig, &plan.angles(pose))).collect();
        let pose = |index| Record::Pose { index, exposures: Vec::new(), controller_us: 1 };
        let suspect = Record::Suspect { from: 4, lost_steps: [9, 0, 0, 0], controller_us: 2 };
        let mut records: Vec<Record> = [0, 2, 3, 4, 5].map(pose).into();
        records.extend([suspect, pose(4)]);
        let run = RunFolder { path: "run".into(), plan, rig, records };
        let mut map = SbrdfMap::new(1, 1, 1);
        map.attributes.insert("fit.left_out_poses".into(), "2".into());
        map.attributes.insert("fit.held_out_poses".into(), "3".into());
        let cone = measured(&run, &map).unwrap();
        let inside: Vec<bool> = (pairs.iter())
            .map(|(wi, wo)| cone.zone(wi.as_vec3(), wo.as_vec3(), &mut 0).side == Side::Inside)
            .collect();
        assert_eq!(inside, [true, false, false, false, true, false]);
    }

    #[test]
    fn bilinear_weights_sum_to_one_and_centres_take_their_own_texel() {
        let map = SbrdfMap::from_texels(4, 2, &vec![LobeBrdf::default(); 8]);
        for (place, own) in
            [((-0.75, 0.25), Some(0)), ((0.75, -0.25), Some(7)), ((0.1, 0.1), None), ((-1.0, 0.5), Some(0))]
        {
            let weights = neighbours(&map, 0.5, DVec2::new(place.0, place.1));
            assert!((weights.iter().map(|w| w.1).sum::<f32>() - 1.0).abs() < 1e-6);
            if let Some(own) = own {
                let share: f32 = weights.iter().filter(|w| w.0 == own).map(|w| w.1).sum();
                assert!((share - 1.0).abs() < 1e-6, "{place:?}");
            }
        }
    }

    #[test]
    fn colour_difference_and_noise_ratio_are_those_of_known_pixels() {
        // Two greys of L* 50 and 60: CIEDE2000 between greys is ΔL/S_L = 10 / (1 + 0.015·25/√45).
        let grey = |l: f32| Rgb::splat(((l + 16.0) / 116.0).powi(3));
        let pixel = || Some(Pixel { photographed: grey(50.0), rendered: grey(60.0) });
        let pictures =
            Pictures { columns: 2, pixels: vec![pixel(), pixel(), None, pixel()], relative_rms: 0.1 };
        let found = pictures.difference();
        let expected = 10.0 / (1.0 + 0.015 * 25.0 / 45f64.sqrt());
        assert!((found.delta_e[0] - expected).abs() < 0.01, "{found:?} {expected}");
        let step = f64::from(colour::srgb_encode(grey(60.0).x) - colour::srgb_encode(grey(50.0).x));
        assert!((found.psnr_db + 20.0 * step.log10()).abs() < 1e-3);
        let rasters = pictures.rasters();
        assert_eq!((rasters[0].width, rasters[0].height, rasters[0].pixels[2][3]), (2, 2, 0));
    }
}
