//! The bench: camera, light and carrier at true axis angles, and the radiance that reaches every pixel.

use glam::{DMat3, DVec3, Vec3};
use lobelia_reflectance::Brdf;
use rayon::prelude::*;

use super::camera::{CameraModel, SensorModel, bayer_channel};
use super::cylinder::BentSheet;
use super::noise;
use super::sample::SampleLayout;
use super::tags;

/// A tag printed on the carrier.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PrintedTag {
    /// Identity in the family 36h11.
    pub id: u32,
    /// Centre in the sample's frame, mm.
    pub centre_mm: [f64; 2],
}

/// Everything about the bench that stays as it is during a run.
pub struct BenchConfig {
    /// Lens and pixel grid.
    pub camera: CameraModel,
    /// The sensor.
    pub sensor: SensorModel,
    /// From the crossing of pan and tilt to the camera's centre of projection, mm.
    pub camera_distance_mm: f64,
    /// Radius of the light's arc, mm.
    pub light_radius_mm: f64,
    /// The carrier's surface above the crossing of pan and tilt, mm.
    pub carrier_offset_mm: f64,
    /// Diameter of the light's aperture, mm; it faces the crossing of pan and tilt.
    pub aperture_diameter_mm: f64,
    /// Radiance of the nominal lamp, for R, G and B.
    pub lamp_radiance: [f64; 3],
    /// Outer edge of a tag's black border, mm.
    pub tag_size_mm: f64,
    /// Half of the carrier's edge, mm; beyond it all is black.
    pub carrier_half_mm: f64,
    /// The tags.
    pub tags: Vec<PrintedTag>,
    /// Albedos of the tags' white, the tags' black and the bare carrier, all perfect diffusers.
    pub carrier_albedo: [f64; 3],
    /// The sample.
    pub sample: SampleLayout,
    /// Radius of the cylinder that the sample is bent over, mm; `None` when it lies flat.
    pub cylinder_radius_mm: Option<f64>,
}

/// Radiance at every pixel, in the colour of the pixel's filter, for the nominal lamp.
#[derive(Debug, Clone, PartialEq)]
pub struct RadianceImage {
    /// Row by row.
    pub data: Vec<f32>,
}

/// The bench, with the rays of its camera worked out once.
pub struct OpticalBench {
    config: BenchConfig,
    /// Normalised coordinates of four points a pixel.
    rays: Vec<[[f32; 2]; POINTS]>,
    /// The sample when it is bent over a cylinder.
    bent: Option<BentSheet>,
}

/// Points a pixel, each with a point of the aperture of its own.
const POINTS: usize = 4;

/// Centres of the four quarters of a pixel, pixels from its centre.
const PIXEL_POINTS: [[f64; 2]; POINTS] = [[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25]];

/// Directions of the four aperture points; at R/√2 they have the second moments of a uniform disc of radius
/// R.
const APERTURE_POINTS: [[f64; 2]; POINTS] = [[1.0, 0.0], [0.0, 1.0], [0.0, -1.0], [-1.0, 0.0]];

/// The bench at one set of true angles, all in the sample's frame.
struct Stage {
    rotation: DMat3,
    camera: DVec3,
    light: [DVec3; POINTS],
    /// Direction in which the aperture faces.
    facing: DVec3,
}

impl OpticalBench {
    /// Sets the bench up.
    pub fn new(config: BenchConfig) -> Self {
        let camera = &config.camera;
        let rays = (0..camera.width * camera.height)
            .into_par_iter()
            .map(|index| {
                let (x, y) = ((index % camera.width) as f64, (index / camera.width) as f64);
                // Jittered within its quarter: regular points would shift every edge that lies along the
                // pixels alike.
                let jitter = |k: usize| {
                    let bits = noise::combine(&[index as u64, k as u64]);
                    ((bits >> 40) as f64 / (1u64 << 24) as f64 - 0.5) * 0.5
                };
                std::array::from_fn(|k| {
                    let [dx, dy] = PIXEL_POINTS[k];
                    let point = [x + dx + jitter(2 * k), y + dy + jitter(2 * k + 1)];
                    camera.normalised(point).map(|c| c as f32)
                })
            })
            .collect();
        let [width, height] = config.sample.size_mm();
        let bent = config.cylinder_radius_mm.map(|radius| BentSheet::new(width, height, radius));
        Self { config, rays, bent }
    }

    /// What stays the same during a run.
    pub fn config(&self) -> &BenchConfig {
        &self.config
    }

    /// Works out the frames for true angles of pan, tilt, roll and light, radians.
    fn stage(&self, axes_rad: [f64; 4]) -> Stage {
        let [(sp, cp), (st, ct), (sr, cr), (sl, cl)] = axes_rad.map(f64::sin_cos);
        // Columns are the images of the sample's x, y and z: first roll, then tilt about x, then pan about y.
        let place = |v: DVec3| {
            let tilted = DVec3::new(v.x, ct * v.y - st * v.z, st * v.y + ct * v.z);
            DVec3::new(cp * tilted.x + sp * tilted.z, tilted.y, cp * tilted.z - sp * tilted.x)
        };
        let x = place(DVec3::new(cr, sr, 0.0));
        let y = place(DVec3::new(-sr, cr, 0.0));
        let z = place(DVec3::Z);
        let rotation = DMat3::from_cols(x, y, z);
        let centre = z * self.config.carrier_offset_mm;
        let local = |bench: DVec3| rotation.transpose() * (bench - centre);
        let outward = DVec3::new(sl, 0.0, cl);
        let (u, v) = (DVec3::new(cl, 0.0, -sl), DVec3::Y);
        let radius = self.config.aperture_diameter_mm / 2.0 * std::f64::consts::FRAC_1_SQRT_2;
        Stage {
            rotation,
            camera: local(DVec3::new(0.0, 0.0, self.config.camera_distance_mm)),
            light: APERTURE_POINTS
                .map(|[a, b]| local(outward * self.config.light_radius_mm + (u * a + v * b) * radius)),
            facing: rotation.transpose() * -outward,
        }
    }

    /// The radiance at every pixel for true axis angles (pan, tilt, roll, light), radians.
    pub fn radiance(&self, axes_rad: [f64; 4]) -> RadianceImage {
        let stage = self.stage(axes_rad);
        let width = self.config.camera.width;
        let mut data = vec![0.0f32; self.rays.len()];
        data.par_chunks_mut(width).zip(self.rays.par_chunks(width)).enumerate().for_each(
            |(y, (row, rays))| {
                for (x, (pixel, points)) in row.iter_mut().zip(rays).enumerate() {
                    let channel = bayer_channel(x, y);
                    let sum: f64 = (0..POINTS)
                        .map(|k| self.point_radiance(&stage, points[k], stage.light[k], channel))
                        .sum();
                    *pixel = (sum / POINTS as f64) as f32;
                }
            },
        );
        RadianceImage { data }
    }

    /// Radiance toward the camera along one ray, lit from one point of the aperture.
    fn point_radiance(&self, stage: &Stage, ray: [f32; 2], light: DVec3, channel: usize) -> f64 {
        // The image's x points along the bench's x, its y downwards; the camera looks along −z.
        let bench = DVec3::new(f64::from(ray[0]), -f64::from(ray[1]), -1.0);
        let direction = stage.rotation.transpose() * bench;
        if direction.z >= 0.0 || stage.camera.z <= 0.0 || light.z <= 0.0 {
            return 0.0;
        }
        let wo = -direction.normalize();
        if let Some(struck) = self.bent.and_then(|sheet| sheet.strike(stage.camera, direction)) {
            let (wi, irradiance) = self.irradiance(stage, struck.point, struck.normal, light, channel);
            if !struck.outside || irradiance <= 0.0 {
                return 0.0;
            }
            let [along, y] = struck.sheet_mm;
            let [wi, wo] = [wi, wo].map(|w| struck.local(w).as_vec3());
            return irradiance * f64::from(self.config.sample.at(along, y).eval_channel(wi, wo, channel));
        }
        let hit = stage.camera - direction * (stage.camera.z / direction.z);
        if hit.x.abs().max(hit.y.abs()) > self.config.carrier_half_mm {
            return 0.0;
        }
        let (wi, irradiance) = self.irradiance(stage, hit, DVec3::Z, light, channel);
        if self.bent.is_some_and(|sheet| sheet.strike(hit, wi).is_some()) {
            return 0.0;
        }
        irradiance * self.reflectance(hit, wi.as_vec3(), wo.as_vec3(), channel)
    }

    /// The direction from a point toward a point of the aperture, and the irradiance that the aperture gives
    /// there.
    fn irradiance(
        &self,
        stage: &Stage,
        point: DVec3,
        normal: DVec3,
        light: DVec3,
        channel: usize,
    ) -> (DVec3, f64) {
        let to_light = light - point;
        let distance2 = to_light.length_squared();
        let wi = to_light / distance2.sqrt();
        let area = std::f64::consts::PI * (self.config.aperture_diameter_mm / 2.0).powi(2);
        let projected = area * -wi.dot(stage.facing);
        (wi, self.config.lamp_radiance[channel] * wi.dot(normal) * projected / distance2)
    }

    /// Reflectance of the sample or the carrier at a point of its plane, sr⁻¹.
    fn reflectance(&self, hit: DVec3, wi: Vec3, wo: Vec3, channel: usize) -> f64 {
        let config = &self.config;
        if self.bent.is_none() && config.sample.contains(hit.x, hit.y) {
            return f64::from(config.sample.at(hit.x, hit.y).eval_channel(wi, wo, channel));
        }
        let [white, black, bare] = config.carrier_albedo;
        // A module is an eighth of the border's edge; one module of white surrounds it.
        let reach = config.tag_size_mm * (0.5 + 0.125);
        let tag = config.tags.iter().find(|tag| {
            (hit.x - tag.centre_mm[0]).abs() <= reach && (hit.y - tag.centre_mm[1]).abs() <= reach
        });
        let albedo = tag.map_or(bare, |tag| {
            let u = (hit.x - tag.centre_mm[0]) / config.tag_size_mm + 0.5;
            let v = (tag.centre_mm[1] - hit.y) / config.tag_size_mm + 0.5;
            if tags::is_white(tag.id, u, v) { white } else { black }
        });
        albedo * std::f64::consts::FRAC_1_PI
    }

    /// The mosaic that the sensor records of a radiance image, with the lamp at `lamp_relative` of nominal
    /// and the shutter open for `open_s`; `key` decides the noise.
    pub fn record(&self, image: &RadianceImage, lamp_relative: f64, open_s: f64, key: u64) -> Vec<u16> {
        let width = self.config.camera.width;
        let mut values = vec![0u16; image.data.len()];
        values.par_chunks_mut(width).zip(image.data.par_chunks(width)).enumerate().for_each(
            |(y, (row, light))| {
                for (x, (value, &radiance)) in row.iter_mut().zip(light).enumerate() {
                    let pixel_key = noise::combine(&[key, (y * width + x) as u64]);
                    let radiance = radiance * lamp_relative as f32;
                    *value = self.config.sensor.record(radiance, bayer_channel(x, y), open_s, pixel_key);
                }
            },
        );
        values
    }

    /// Where a point of the sample's plane (mm) really appears on the sensor, pixels.
    pub fn project(&self, axes_rad: [f64; 4], x_mm: f64, y_mm: f64) -> [f64; 2] {
        let stage = self.stage(axes_rad);
        let bench = stage.rotation * (DVec3::new(x_mm, y_mm, 0.0) - stage.camera);
        self.config.camera.pixel([bench.x / -bench.z, bench.y / bench.z])
    }

    /// True unit directions toward light and camera at a point of the sample's plane (mm), in its frame.
    pub fn directions(&self, axes_rad: [f64; 4], x_mm: f64, y_mm: f64) -> (Vec3, Vec3) {
        let stage = self.stage(axes_rad);
        let point = DVec3::new(x_mm, y_mm, 0.0);
        let centre = stage.light.iter().sum::<DVec3>() / POINTS as f64;
        ((centre - point).normalize().as_vec3(), (stage.camera - point).normalize().as_vec3())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{Material, Pattern};
    use lobelia_reflectance::{LobeBrdf, Rgb};

    /// A white diffuser under a small bench.
    fn bench() -> OpticalBench {
        let white = Material::Lobes(LobeBrdf::diffuse(Rgb::ONE));
        OpticalBench::new(BenchConfig {
            camera: CameraModel {
                width: 160,
                height: 120,
                focal_px: [800.0; 2],
                principal_px: [79.5, 59.5],
                distortion: [-1.0, 3.0, 0.0, 0.0, 0.0],
            },
            sensor: SensorModel {
                responsivity: [5e6; 3],
                black_level: 512.0,
                white_level: 16383.0,
                electrons_per_value: 2.5,
                read_noise_e: 4.0,
                dark_e_s: 2.0,
            },
            camera_distance_mm: 1050.0,
            light_radius_mm: 1000.0,
            carrier_offset_mm: 25.4,
            aperture_diameter_mm: 10.0,
            lamp_radiance: [1000.0, 900.0, 800.0],
            tag_size_mm: 16.0,
            carrier_half_mm: 60.0,
            tags: vec![PrintedTag { id: 0, centre_mm: [-44.0, 44.0] }],
            carrier_albedo: [0.8, 0.04, 0.03],
            sample: SampleLayout::new(64.0, 64.0, vec![white], Pattern::Stripes { width_mm: 64.0 }),
            cylinder_radius_mm: None,
        })
    }

    #[test]
    fn a_white_diffuser_has_the_radiance_of_the_closed_form() {
        let bench = bench();
        let light = 30f64.to_radians();
        let image = bench.radiance([0.0, 0.0, 0.0, light]);
        let [x, y] = bench.project([0.0, 0.0, 0.0, light], 0.0, 0.0).map(|c| c.round() as usize);
        let centre = DVec3::new(0.0, 0.0, 25.4);
        let lamp = DVec3::new(light.sin(), 0.0, light.cos()) * 1000.0;
        let (wi, r2) = ((lamp - centre).normalize(), (lamp - centre).length_squared());
        let area = std::f64::consts::PI * 25.0;
        let radiance = [1000.0, 900.0, 800.0][bayer_channel(x, y)];
        let expected = radiance * area / r2 * wi.z / std::f64::consts::PI;
        let got = f64::from(image.data[y * 160 + x]);
        assert!((got / expected - 1.0).abs() < 1e-3, "{got} {expected}");
    }

    #[test]
    fn a_white_cylinder_is_brightest_toward_the_light_and_casts_a_shadow_on_the_carrier() {
        let OpticalBench { config, .. } = bench();
        let bench = OpticalBench::new(BenchConfig { cylinder_radius_mm: Some(22.0), ..config });
        let light = 60f64.to_radians();
        let image = bench.radiance([0.0, 0.0, 0.0, light]);
        // The sheet reaches almost half way round: R sin α to either side of the middle, R (1 − cos α) high.
        let value = |x_mm: f64| {
            let [x, y] = bench.project([0.0, 0.0, 0.0, light], x_mm, 0.0).map(|c| c.round() as usize);
            image.data[(y & !1) * 160 + (x | 1)]
        };
        // Green pixels: a diffuser's radiance goes with the cosine between normal and light.
        let cosine = |x: f64| {
            let normal = DVec3::new(x / 22.0, 0.0, (1.0 - x * x / 484.0).sqrt());
            normal.dot(DVec3::new(light.sin(), 0.0, light.cos()))
        };
        let ratio = f64::from(value(15.0) / value(5.0));
        // A pixel is 1.3 mm wide.
        assert!((ratio / (cosine(15.0) / cosine(5.0)) - 1.0).abs() < 0.08, "{ratio}");
        assert_eq!(value(-20.5), 0.0);
        // Beside the cylinder on its dark side, and on its bright side.
        assert!(value(-30.0) == 0.0 && value(30.0) > 0.0);
    }

    #[test]
    fn points_of_the_sample_appear_where_projection_says() {
        let bench = bench();
        let axes = [0.4, -0.3, 0.9, 1.2];
        let image = bench.radiance(axes);
        // Just inside and outside of the sample's edge: the white sample against the dark carrier.
        for (inside, outside) in [([31.5, 5.0], [35.5, 5.0]), ([-10.0, -31.5], [-10.0, -35.5])] {
            let value = |[x, y]: [f64; 2]| {
                let [px, py] = bench.project(axes, x, y).map(|c| c.round() as usize);
                image.data[py * 160 + px]
            };
            assert!(value(inside) > 10.0 * value(outside), "{} {}", value(inside), value(outside));
        }
    }

    #[test]
    fn the_same_key_gives_the_same_frame_and_another_key_another() {
        let bench = bench();
        let image = bench.radiance([0.1, 0.0, 0.0, 0.5]);
        let frame = bench.record(&image, 1.0, 0.01, 3);
        assert_eq!(frame, bench.record(&image, 1.0, 0.01, 3));
        assert_ne!(frame, bench.record(&image, 1.0, 0.01, 4));
    }
}
