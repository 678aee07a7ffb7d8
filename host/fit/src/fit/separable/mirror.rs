//! Mirror terms: peaks so narrow that the poses cannot tell their width (stability case G7). A lobe fitted to
//! one would have an exponent and an albedo that nothing supports; the peak is reported and the poses that
//! met it are left out of the fit.
//!
//! Few poses stand out by far, all near the mirror direction. The narrowness of a lobe through them has a
//! lower bound from what the next poses see, and one from energy: with f ∝ cosⁿ of the angle to the mirror
//! direction, 2δ for a half vector at δ from the normal, the albedo is about 2π f / (n + 2). Where energy
//! asks for a narrower lobe than the poses do, or the poses for one of n ≥ 1000 (at half its peak 2.1° from
//! the mirror direction), they do not resolve it.

use super::data::Data;
use lobelia_reflectance::colour;

/// Most poses that a peak has to be met by for not being resolved.
const MOST_POSES: usize = 3;
/// How many times the next brightest pose they exceed at least.
const STANDS_OUT: f64 = 30.0;
/// And how many times the median of all.
const OVER_MEDIAN: f64 = 100.0;
/// Largest angle of their half vectors from the normal, radians: half a degree or two of registration and of
/// the light's size.
const MOST_OFF: f64 = 0.05;

/// Least exponent of a lobe that so few poses meet for being no lobe.
const NO_LOBE: f64 = 1000.0;

/// A mirror term of a texel.
#[derive(Debug, Clone, PartialEq)]
pub struct Mirror {
    /// Poses that met it.
    pub poses: Vec<usize>,
    /// Their largest f cosθ_i a channel, sr⁻¹. Times the solid angle dω_i of the light (3.10) it is ρ_m of
    /// L_r = ρ_m L_i, or a lower bound of it where no pose saw the light's whole image.
    pub value: [f64; 3],
}

impl Mirror {
    /// The mirror term of samples that were read.
    pub fn of(data: &Data) -> Option<Self> {
        let [red, green, blue] = colour::LUMINANCE.as_dvec3().to_array();
        let bright = |k: usize| red * data.rgb[0][k] + green * data.rgb[1][k] + blue * data.rgb[2][k];
        let brightest = brightest(data.len(), bright);
        let count = (1..=MOST_POSES).rev().find(|&count| {
            let [(_, last), (_, next)] = [brightest[count - 1], brightest[count]];
            last > 0.0 && last > STANDS_OUT * next
        })?;
        let poses: Vec<usize> = brightest[..count].iter().map(|(pose, _)| *pose).collect();
        // All of this is met by few texels but those with a mirror.
        let mut values: Vec<f64> = (0..data.len()).filter(|&k| data.weight[k] > 0.0).map(bright).collect();
        let middle = values.len() / 2;
        let median = *values.select_nth_unstable_by(middle, f64::total_cmp).1;
        let off = |k: usize| half_angle(data, k);
        let farthest = poses.iter().map(|&k| off(k)).fold(0.0, f64::max);
        if values.len() <= 2 * count || brightest[0].1 < OVER_MEDIAN * median || farthest > MOST_OFF {
            return None;
        }
        let faintest = brightest[count - 1].1;
        let by_poses = (0..data.len())
            .filter(|k| data.weight[*k] > 0.0 && !poses.contains(k) && off(*k) > farthest)
            .map(|k| {
                (faintest / bright(k).max(1e-3 * faintest)).ln() / (2.0 * (off(k).powi(2) - farthest.powi(2)))
            })
            .fold(0.0, f64::max);
        let by_energy = std::f64::consts::TAU * brightest[0].1 - 2.0;
        let peak = |channel: usize| {
            let values = poses.iter().map(|&k| data.rgb[channel][k] * data.products.cos[0][k]);
            values.fold(0.0, f64::max)
        };
        let resolved = by_energy <= by_poses && by_poses < NO_LOBE;
        let value = [peak(0), peak(1), peak(2)];
        (!resolved).then_some(Self { poses, value })
    }
}

/// The brightest poses, one more than a mirror may be met by, and their values in falling order.
fn brightest(count: usize, bright: impl Fn(usize) -> f64) -> [(usize, f64); MOST_POSES + 1] {
    let mut found = [(0, 0.0); MOST_POSES + 1];
    for k in 0..count {
        let value = bright(k);
        if value > found[MOST_POSES].1 {
            let place = found.iter().position(|(_, other)| value > *other).unwrap_or(MOST_POSES);
            found[place..].rotate_right(1);
            found[place] = (k, value);
        }
    }
    found
}

/// Angle between half vector and normal, radians.
fn half_angle(data: &Data, k: usize) -> f64 {
    let products = &data.products;
    let along = products.cos[0][k] + products.cos[1][k];
    let length = (2.0 + 2.0 * (products.plane[k] + products.zz[k])).max(0.0).sqrt();
    (along / length.max(1e-300)).min(1.0).acos()
}

#[cfg(test)]
mod tests {
    use super::super::data::Poses;
    use super::*;
    use crate::fit::weights::Weights;
    use crate::synth::{self, Options};
    use glam::{DVec3, Vec3};
    use lobelia_reflectance::{Brdf, Lobe, LobeBrdf, Rgb, materials};

    /// Poses of which the first `met` have light and camera in mirror directions, up to 0.1° off.
    fn poses(count: usize, met: usize, seed: u64) -> Vec<lobelia_reflectance::sampled::PoseGeometry> {
        let mut poses = synth::poses(count, seed);
        for (k, pose) in poses.iter_mut().take(met).enumerate() {
            let light = pose.light_mm;
            pose.camera_mm = DVec3::new(-light.x, -light.y, light.z) + DVec3::X * k as f64;
        }
        poses
    }

    /// The image of a light of 10 mm at 1 m in a mirror of reflectance `rho`, sr⁻¹: within 0.14° of the
    /// mirror's half vector.
    fn image(rho: f32, wi: Vec3, wo: Vec3) -> f32 {
        let half = (wi + wo).normalize();
        if half.z.acos() < 0.0025 { rho / (7.85e-5 * wi.z) } else { 0.0 }
    }

    fn data(sampled: &lobelia_reflectance::sampled::SampledSbrdf, texel: usize) -> Data {
        let mut data = Data::default();
        data.load(&Poses::new(&sampled.poses), sampled, texel, Weights::Pose);
        data
    }

    fn options(poses: usize, seed: u64) -> Options {
        Options { width: 1, height: 1, texel_mm: 0.1, poses, noise: 1e-3, relative_noise: 0.01, seed }
    }

    #[test]
    fn a_mirror_is_found_with_the_poses_that_met_it_and_its_reflectance() {
        let lobe = Lobe::new(Rgb::splat(0.3), Vec3::new(-1.0, -1.0, 0.98), 20.0);
        let plain = LobeBrdf { lobes: vec![lobe], ..LobeBrdf::diffuse(Rgb::new(0.2, 0.1, 0.05)) };
        for met in 0..=3 {
            for seed in 0..10 {
                let sampled = synth::sample_at(poses(200, met, seed), &options(200, seed), |_, _, wi, wo| {
                    plain.eval(wi, wo) + Rgb::new(1.0, 0.9, 0.5) * image(0.5, wi, wo)
                });
                let found = Mirror::of(&data(&sampled, 0));
                assert_eq!(found.is_some(), met > 0, "{met} poses, seed {seed}: {found:?}");
                let Some(mut mirror) = found else { continue };
                mirror.poses.sort_unstable();
                assert_eq!(mirror.poses, (0..met).collect::<Vec<_>>());
                let rho_m = mirror.value.map(|value| value * 7.85e-5);
                // 1 % of noise, of which the largest of three is taken.
                for (found, truth) in rho_m.iter().zip([0.5, 0.45, 0.25]) {
                    assert!((found / truth - 1.0).abs() < 0.05, "{rho_m:?}");
                }
            }
        }
    }

    #[test]
    fn plain_materials_never_have_one() {
        let check = |name: &str, poses: usize, brdf: &LobeBrdf| {
            for seed in 0..25 {
                let sampled = synth::sample(&options(poses, seed), |_, _, wi, wo| brdf.eval(wi, wo));
                let found = Mirror::of(&data(&sampled, 0));
                assert!(found.is_none(), "{name}, {poses} poses, seed {seed}: {found:?}");
            }
        };
        for poses in [60, 200, 456] {
            for name in materials::NAMES {
                check(name, poses, &materials::published(name).unwrap());
            }
            // Lobes that keep 30 % of the light, whatever n.
            for n in [50.0, 200.0, 500.0] {
                let lobe = Lobe::new(
                    Rgb::splat(0.3 * (n + 2.0) / std::f32::consts::TAU),
                    Vec3::new(-1.0, -1.0, 1.0),
                    n,
                );
                check("lobe", poses, &LobeBrdf { lobes: vec![lobe], ..LobeBrdf::diffuse(Rgb::splat(0.05)) });
            }
        }
    }
}
