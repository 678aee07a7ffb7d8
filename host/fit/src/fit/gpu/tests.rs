//! The GPU's fits against the CPU's. Without an adapter the tests say that they are skipped.

use glam::Vec3;

use super::*;
use crate::fit::testing::directions;
use crate::fit::{Diffuse, Residual, fit_sbrdf};
use crate::synth;
use lobelia_base::random::Random;
use lobelia_reflectance::{Brdf, LobeBrdf, SbrdfMap};

/// Whether there is a GPU; says so where there is none.
fn is_there() -> bool {
    match shared() {
        Ok(_) => true,
        Err(error) if error.to_string().contains("no adapter") => {
            println!("skipped: {error}");
            false
        }
        Err(error) => panic!("{error}"),
    }
}

/// Random materials of `lobes` lobes, one for each of 6 × 6 texels.
fn sampled(lobes: usize, anisotropic: bool) -> SampledSbrdf {
    let mut random = Random::new(7);
    let mut material = || {
        let mut brdf = synth::material(lobes, &mut random);
        if anisotropic {
            brdf.beta = random.uniform(-0.7, 0.7) as f32;
            brdf.lobes.iter_mut().for_each(|lobe| lobe.c.y *= 0.75);
        }
        brdf
    };
    let materials: Vec<LobeBrdf> = (0..36).map(|_| material()).collect();
    let options = synth::Options {
        width: 6,
        height: 6,
        texel_mm: 0.5,
        poses: 150,
        noise: 1e-3,
        relative_noise: 0.0,
        seed: 3,
    };
    synth::sample(&options, |index, _, wi, wo| materials[index].eval(wi, wo))
}

/// The maps of CPU and GPU.
fn both(sampled: &SampledSbrdf, options: &FitOptions) -> [SbrdfMap; 2] {
    [Device::Cpu, Device::Gpu].map(|device| fit_sbrdf(sampled, &FitOptions { device, ..*options }).unwrap())
}

/// The texels that the poses tell: the others are tied to their neighbours by the CPU, which alone fits them
/// in order.
fn told(map: &SbrdfMap) -> Vec<usize> {
    let tied = |texel: usize| map.extra.get("tied").is_some_and(|tied| tied[texel] > 0.0);
    (0..map.width * map.height).filter(|&texel| !tied(texel)).collect()
}

/// ‖a − b‖ / ‖a‖ over directions that were not posed, a texel that the poses tell, sorted.
fn differences([a, b]: &[SbrdfMap; 2]) -> Vec<f64> {
    let pairs: Vec<(Vec3, Vec3)> = directions(100, 99);
    let difference = |texel: usize| {
        let (mut off, mut all) = (0.0f64, 0.0f64);
        for &(wi, wo) in &pairs {
            let (a, b) = (a.eval(texel, wi, wo), b.eval(texel, wi, wo));
            off += f64::from((a - b).length_squared());
            all += f64::from(a.length_squared());
        }
        (off / all).sqrt()
    };
    let mut differences: Vec<f64> = told(a).into_iter().map(difference).collect();
    differences.sort_by(f64::total_cmp);
    differences
}

/// |GPU's cost over CPU's − 1| a texel that the poses tell, sorted. The residual is linear, so that
/// `error.rms` is the root of the cost.
fn cost_differences([cpu, gpu]: &[SbrdfMap; 2]) -> Vec<f64> {
    let rms = |map: &SbrdfMap, texel: usize| f64::from(map.extra["error.rms"][texel]);
    let difference = |texel| ((rms(gpu, texel) / rms(cpu, texel)).powi(2) - 1.0).abs();
    let mut differences: Vec<f64> = told(cpu).into_iter().map(difference).collect();
    differences.sort_by(f64::total_cmp);
    differences
}

/// Where two sets of shapes explain a texel almost equally well, CPU and GPU may settle for different ones: a
/// few texels in a hundred.
#[test]
fn the_gpu_comes_to_the_cost_and_the_reflectance_of_the_cpu() {
    if !is_there() {
        return;
    }
    // Two anisotropic lobes lie in long valleys, along which the tolerance stops both at different places;
    // the CPU has starts from neighbours and from the largest residuals besides.
    for (lobes, isotropic, cost, reflectance) in [(1, true, 1e-4, 1e-3), (2, false, 5e-2, 1e-2)] {
        let options = FitOptions { lobes, isotropic, residual: Residual::Linear, ..FitOptions::default() };
        let maps = both(&sampled(lobes, !isotropic), &options);
        let (costs, differences) = (cost_differences(&maps), differences(&maps));
        assert!(costs.len() >= 24, "{}", costs.len());
        let (half, most) = (costs.len() / 2, costs.len() * 9 / 10);
        println!(
            "{lobes} lobes: cost {:.1e} {:.1e}, reflectance {:.1e} {:.1e}",
            costs[half], costs[most], differences[half], differences[most]
        );
        assert!(costs[half] < 1e-4 && costs[most] < cost, "{lobes} lobes: {costs:?}");
        assert!(
            differences[half] < 2e-4 && differences[most] < reflectance,
            "{lobes} lobes: {differences:?}"
        );
    }
}

#[test]
fn channels_of_their_own_a_given_diffuse_term_missing_samples_and_the_choice_of_lobes_work_too() {
    if !is_there() {
        return;
    }
    let mut sampled = sampled(1, false);
    // One texel without samples, one with too few for a lobe, one with a gap.
    let span = 3 * sampled.poses.len();
    sampled.reflectance[..span].fill(f32::NAN);
    sampled.reflectance[span..2 * span - 6].fill(f32::NAN);
    sampled.reflectance[2 * span..2 * span + 9].fill(f32::NAN);
    let linear = FitOptions { residual: Residual::Linear, ..FitOptions::default() };
    for options in [
        FitOptions { separate_channels: true, ..linear },
        FitOptions { diffuse: Diffuse::Percentile(10.0), ..linear },
        FitOptions { choose: true, lobes: 1, ..FitOptions::default() },
        FitOptions { weights: Weights::Sigma, ..linear },
    ] {
        let maps = both(&sampled, &options);
        let [cpu, gpu] = &maps;
        for plane in ["samples", "lobes"].into_iter().filter(|&plane| cpu.extra.contains_key(plane)) {
            assert_eq!(cpu.extra[plane], gpu.extra[plane]);
        }
        assert_eq!(cpu.rho_d[0], gpu.rho_d[0]);
        assert_eq!(gpu.attributes["fit.device"], "gpu");
        let (first, rest) = (cpu.lobes[0].rho_s[1], gpu.lobes[0].rho_s[1]);
        assert!(first == rest && first.max_element() == 0.0);
        // The first texel, black in both, has no relative difference.
        let differences = differences(&maps);
        assert!(differences[differences.len() * 9 / 10] < 1e-3, "{options:?} {differences:?}");
    }
}

#[test]
fn a_gpu_in_software_is_never_chosen_and_other_methods_are_refused() {
    let options = FitOptions { device: Device::Gpu, method: Method::Lm, ..FitOptions::default() };
    let error = options.check().unwrap_err();
    assert!(error.exit_code() == 2 && error.to_string().contains("--device cpu"), "{error}");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("s.zarr");
    let poses = synth::poses(4, 1);
    SampledSbrdf::empty(128, 128, 1.0, poses).write_zarr(&path).unwrap();
    let store = SampledStore::open(&path).unwrap();
    let chosen = faster(&store, &FitOptions::default()).unwrap();
    if shared().map_or(true, |kernels| kernels.gpu.is_software()) {
        assert_eq!(chosen, Device::Cpu);
    }
    assert_eq!(
        faster(&store, &FitOptions { method: Method::Lm, ..FitOptions::default() }).unwrap(),
        Device::Cpu
    );
}
