//! Pooled fits against known materials, against least squares with all ρ_d at once, and against their own
//! bounds.

use glam::Vec3;

use super::super::extensions::{Extensions, Microfacets};
use super::super::{self as fit, AlbedoBound, Residual, linear};
use super::*;
use crate::synth::{self, Options};
use lobelia_reflectance::{Brdf, Lobe, LobeBrdf, Microfacet, Rgb, albedo};

const SIDE: usize = 12;

/// One forward lobe above a ρ_d.
fn material(rho_d: Rgb, n: f32) -> LobeBrdf {
    let lobe = Lobe::new(Rgb::new(0.5, 0.4, 0.3), Vec3::new(-1.0, -1.0, 0.95), n);
    LobeBrdf { rho_d, lobes: vec![lobe], ..LobeBrdf::default() }
}

/// 12 × 12 texels of 5 mm under a light 120 mm and a camera 160 mm away, every second pose at the highlight.
fn sampled(poses: usize, noise: f64, truth: impl Fn(usize) -> LobeBrdf + Sync) -> SampledSbrdf {
    let options =
        Options { width: SIDE, height: SIDE, texel_mm: 5.0, poses, noise, relative_noise: 0.0, seed: 11 };
    let mut poses = synth::poses(poses, 4);
    poses.iter_mut().step_by(2).for_each(PoseGeometry::aim_at_highlight);
    for pose in &mut poses {
        pose.light_mm = 120.0 * pose.light_mm.normalize();
        pose.camera_mm = 160.0 * pose.camera_mm.normalize();
    }
    let truth: Vec<LobeBrdf> = (0..SIDE * SIDE).map(truth).collect();
    let mut sampled = synth::sample_at(poses, &options, |index, _, wi, wo| truth[index].eval(wi, wo));
    sampled.sigma = None;
    sampled
}

/// Two regions, the left half and the right one, and a last row that is of none.
fn halves() -> Regions {
    let of = |texel: usize| (texel / SIDE < SIDE - 1).then(|| usize::from(texel % SIDE >= SIDE / 2));
    Regions {
        width: SIDE,
        height: SIDE,
        of: (0..SIDE * SIDE).map(of).collect(),
        colours: vec![[1, 2, 3], [4, 5, 6]],
    }
}

fn one() -> Regions {
    Regions { width: SIDE, height: SIDE, of: vec![Some(0); SIDE * SIDE], colours: vec![[0; 3]] }
}

fn own() -> PoolOptions {
    PoolOptions { rho_d: RhoD::Texel, ..PoolOptions::default() }
}

/// ρ_d of a texel, no two alike.
fn texture(texel: usize) -> Rgb {
    let share = 0.2 + 0.8 * ((texel * 37) % 101) as f32 / 101.0;
    share * Rgb::new(0.25, 0.2, 0.15)
}

#[test]
fn a_region_seen_from_three_poses_tells_the_exponent_that_no_texel_of_it_can() {
    let exponents = [20.0f32, 60.0];
    let half = |texel: usize| usize::from(texel % SIDE >= SIDE / 2);
    let rho_d = [Rgb::splat(0.1), Rgb::splat(0.2)];
    let sampled = sampled(3, 1e-3, |texel| material(rho_d[half(texel)], exponents[half(texel)]));
    let options = FitOptions::default();
    let pooled = fit_sbrdf(&sampled, &halves(), &options, &PoolOptions::default()).unwrap();
    for (region, report) in pooled.regions.iter().enumerate() {
        let texel = if region == 0 { 0 } else { SIDE - 1 };
        let n = pooled.map.lobes[0].n[texel];
        println!("{report:?}, n {n}");
        assert!((n / exponents[region] - 1.0).abs() < 0.03, "n = {n}");
        assert!((pooled.map.rho_d[texel].x - rho_d[region].x).abs() < 2e-3);
        assert_eq!((report.texels, report.samples, report.lobes), (66, 198, 1));
        assert!((report.rms / 1e-3 - 1.0).abs() < 0.1, "{report:?}");
        assert_eq!(pooled.map.extra["region"][texel], region as f32 + 1.0);
    }
    // One BRDF a region, and nothing outside.
    assert_eq!(pooled.map.texel(0), pooled.map.texel(SIDE));
    let outside = SIDE * SIDE - 1;
    assert_eq!((pooled.map.texel(outside).rho_d, pooled.map.extra["samples"][outside]), (Rgb::ZERO, 0.0));
    assert_eq!(pooled.map.extra["region"][outside], 0.0);
    let single = fit::fit_sbrdf(&sampled, &options).unwrap();
    let told = |texel: &usize| (single.lobes[0].n[*texel] / exponents[half(*texel)] - 1.0).abs() < 0.1;
    assert!((0..SIDE * SIDE).filter(told).count() < SIDE);
}

#[test]
fn a_rho_d_a_texel_comes_back_beside_the_region_s_lobe() {
    let sampled = sampled(6, 1e-3, |texel| material(texture(texel), 30.0));
    let options = FitOptions::default();
    let pooled = fit_sbrdf(&sampled, &one(), &options, &own()).unwrap();
    let n = pooled.map.lobes[0].n[0];
    assert!((n / 30.0 - 1.0).abs() < 0.02, "n = {n}");
    let (mut squares, mut stated) = (0.0, 0.0);
    for texel in 0..SIDE * SIDE {
        let off = pooled.map.rho_d[texel].x - texture(texel).x;
        assert!(off.abs() < 4e-3, "texel {texel}: {off}");
        squares += off * off;
        stated += pooled.map.extra["sigma.rho_d.R"][texel].powi(2);
    }
    assert!((squares / stated).sqrt() > 0.8 && (squares / stated).sqrt() < 1.3, "{squares} {stated}");
    let region = fit_sbrdf(&sampled, &one(), &options, &PoolOptions::default()).unwrap();
    println!("{:?} {:?}", pooled.regions, region.regions);
    assert!(pooled.regions[0].rms < 1.2e-3 && region.regions[0].rms > 0.02);
}

/// The amplitudes of given shapes and the ρ_d of all texels by one least squares problem, in the red channel.
fn all_at_once(sampled: &SampledSbrdf, fitted: &LobeBrdf) -> Vec<f64> {
    let (texels, lobes) = (sampled.texels(), fitted.lobes.len());
    let size = lobes + texels;
    let (mut gram, mut rhs) = (vec![0.0; size * size], vec![0.0; size]);
    for texel in 0..texels {
        for (pose, rgb) in sampled.samples(texel).enumerate() {
            let (wi, wo) = sampled.directions(texel, pose);
            let shape = |lobe: &Lobe| {
                let unit = Lobe { rho_s: Rgb::ONE, ..*lobe };
                let brdf = LobeBrdf { beta: fitted.beta, lobes: vec![unit], ..LobeBrdf::default() };
                f64::from(brdf.eval(wi, wo).x)
            };
            let mut row: Vec<(usize, f64)> = fitted.lobes.iter().map(shape).enumerate().collect();
            row.push((lobes + texel, 1.0));
            for &(i, a) in &row {
                rhs[i] += a * f64::from(rgb.x);
                row.iter().for_each(|&(j, b)| gram[i * size + j] += a * b);
            }
        }
    }
    assert!(linear::solve_spd(&mut gram, &mut rhs));
    rhs
}

#[test]
fn lobes_and_the_rho_d_of_all_texels_are_those_of_one_least_squares_problem() {
    let sampled = sampled(5, 5e-3, |texel| {
        let mut brdf = material(texture(texel), 12.0);
        brdf.lobes.push(Lobe::new(Rgb::splat(0.2), Vec3::new(0.9, 0.9, 0.9), 5.0));
        brdf
    });
    for isotropic in [true, false] {
        let options = FitOptions {
            lobes: 2,
            isotropic,
            residual: Residual::Linear,
            bound: AlbedoBound::Free,
            ..FitOptions::default()
        };
        let pooled = fit_sbrdf(&sampled, &one(), &options, &own()).unwrap();
        let expected = all_at_once(&sampled, &pooled.map.texel(0));
        for (lobe, amplitude) in pooled.map.texel(0).lobes.iter().zip(&expected) {
            let off = f64::from(lobe.rho_s.x) / amplitude - 1.0;
            assert!(off.abs() < 1e-4, "{} {amplitude}", lobe.rho_s.x);
        }
        for (rho_d, expected) in pooled.map.rho_d.iter().zip(&expected[2..]) {
            assert!((f64::from(rho_d.x) - expected.max(0.0)).abs() < 1e-5, "{} {expected}", rho_d.x);
        }
    }
}

#[test]
fn no_texel_makes_light_whatever_its_own_rho_d() {
    // A lobe of albedo up to 0.5 above a ρ_d whose albedo is 0.3 to 0.7, with noise; some texels would be
    // above 1.
    let lobe = |peak: f32| Lobe::new(Rgb::splat(peak), Vec3::new(-1.0, -1.0, 1.0), 8.0);
    let shining = |peak: f32, share: f32| LobeBrdf {
        rho_d: Rgb::splat(share / std::f32::consts::PI),
        lobes: vec![lobe(peak)],
        ..LobeBrdf::default()
    };
    let largest = albedo::largest(&LobeBrdf { lobes: vec![lobe(1.0)], ..LobeBrdf::default() }).x;
    for (peak, shares) in [(0.5 / largest, [0.3, 0.7]), (1.2 / largest, [0.1, 0.3])] {
        let sampled = sampled(6, 1e-2, |texel| shining(peak, shares[texel % 2]));
        for bound in [AlbedoBound::Bounded, AlbedoBound::Conserved, AlbedoBound::Free] {
            let options = FitOptions { bound, ..FitOptions::default() };
            let pooled = fit_sbrdf(&sampled, &one(), &options, &own()).unwrap();
            let most = (0..SIDE * SIDE).map(|texel| albedo::largest(&pooled.map.texel(texel)).max_element());
            let most = most.fold(0.0, f32::max);
            println!("{bound:?}: {most}, {:?}", pooled.regions);
            match options.largest_albedo() {
                None => assert!(most > 1.05 && !pooled.map.extra.contains_key("bounded")),
                Some(limit) => {
                    assert!(f64::from(most) < limit + 2e-3, "{bound:?}: {most}");
                    assert!(pooled.regions[0].bounded > SIDE && pooled.regions[0].relative < 0.3);
                }
            }
            let region = fit_sbrdf(&sampled, &one(), &options, &PoolOptions::default()).unwrap();
            let most = albedo::largest(&region.map.texel(0)).max_element();
            assert!(f64::from(most) < options.largest_albedo().unwrap_or(f64::INFINITY) + 2e-3);
        }
    }
}

#[test]
fn a_region_takes_as_many_lobes_as_it_has_with_one_rho_d_and_with_one_a_texel() {
    let sampled = sampled(10, 1e-3, |texel| {
        let mut brdf = material(texture(texel), 40.0);
        brdf.lobes.push(Lobe::new(Rgb::splat(0.3), Vec3::new(1.0, 1.0, 0.9), 15.0));
        brdf
    });
    let options = FitOptions { lobes: 4, choose: true, isotropic: false, ..FitOptions::default() };
    let pooled = fit_sbrdf(&sampled, &one(), &options, &own()).unwrap();
    println!("{:?} {:?}", pooled.regions, pooled.map.texel(0));
    assert_eq!((pooled.regions[0].lobes, pooled.map.extra["lobes"][5]), (2, 2.0));
    assert!(pooled.regions[0].rms < 1.2e-3);
    assert_eq!(pooled.map.attributes["fit.pool_rho_d"], "texel");
}

#[test]
fn what_is_more_than_lobes_is_a_region_s_beside_a_rho_d_a_texel() {
    let normal = glam::Vec2::new(0.08, -0.05);
    let tilted = sampled(10, 1e-3, |texel| LobeBrdf { normal, ..material(texture(texel), 25.0) });
    let extensions = Extensions { normals: true, ..Extensions::default() };
    let pooled =
        fit_sbrdf(&tilted, &one(), &FitOptions { extensions, ..FitOptions::default() }, &own()).unwrap();
    let found = pooled.map.normal[0];
    assert!((found - normal).length() < 3e-3, "{found}");

    let coat = Microfacet { f0: Rgb::splat(0.05), f90: Rgb::ONE, alpha: 0.25 };
    let coated = sampled(10, 1e-3, |texel| LobeBrdf {
        rho_d: texture(texel),
        microfacets: vec![coat],
        ..LobeBrdf::default()
    });
    let extensions = Extensions { microfacets: Microfacets::Always, ..Extensions::default() };
    let options = FitOptions { lobes: 0, extensions, ..FitOptions::default() };
    let pooled = fit_sbrdf(&coated, &one(), &options, &own()).unwrap();
    let found = pooled.map.texel(0).microfacets[0];
    println!("{found:?} {:?}", pooled.regions);
    assert!((found.alpha / coat.alpha - 1.0).abs() < 0.05 && (found.f0.x / coat.f0.x - 1.0).abs() < 0.05);
    assert!(pooled.regions[0].rms < 1.2e-3);
}

#[test]
fn without_lobes_or_with_one_pose_a_texel_has_the_mean_of_its_samples() {
    for (poses, lobes) in [(6, 0), (1, 1), (1, 0)] {
        let sampled = sampled(poses, 1e-3, |texel| LobeBrdf::diffuse(texture(texel)));
        let options = FitOptions { lobes, residual: Residual::Linear, ..FitOptions::default() };
        let pooled = fit_sbrdf(&sampled, &one(), &options, &own()).unwrap();
        for texel in 0..SIDE * SIDE {
            let brdf = pooled.map.texel(texel);
            let mean = sampled.samples(texel).map(|rgb| rgb.x).sum::<f32>() / poses as f32;
            assert!(
                (brdf.rho_d.x - mean).abs() < 1e-6 && brdf.lobes.iter().all(|lobe| lobe.rho_s == Rgb::ZERO)
            );
        }
    }
}

#[test]
fn a_store_is_fitted_as_the_samples_in_memory_and_by_fewer_samples_almost_as_well() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sampled.zarr");
    let options =
        Options { width: 40, height: 20, texel_mm: 2.0, poses: 8, noise: 1e-3, relative_noise: 0.0, seed: 3 };
    let mut sampled = synth::sample(&options, |_, _, wi, wo| material(Rgb::splat(0.1), 10.0).eval(wi, wo));
    sampled.reflectance[..24].fill(f32::NAN);
    sampled.write_zarr(&path).unwrap();
    let store = SampledStore::open(&path).unwrap();
    let regions = Regions { width: 40, height: 20, of: vec![Some(0); 800], colours: vec![[0; 3]] };
    for weights in [Weights::Pose, Weights::Sigma] {
        let residual = if weights == Weights::Sigma { Residual::Linear } else { Residual::Proportional };
        let options = FitOptions { weights, residual, ..FitOptions::default() };
        let memory = fit_sbrdf(&sampled, &regions, &options, &own()).unwrap();
        let stored = fit_store(&store, &regions, &options, &own()).unwrap();
        let few = PoolOptions { most_samples: 800, ..own() };
        let few = fit_store(&store, &regions, &options, &few).unwrap();
        assert_eq!((stored.regions[0].fitted, few.regions[0].fitted / 8), (6392, 100));
        assert_eq!((stored.regions[0].samples, few.regions[0].samples), (6392, 6392));
        let n = |pooled: &Pooled| pooled.map.lobes[0].n[500];
        assert!((n(&stored) / n(&memory) - 1.0).abs() < 1e-4, "{} {}", n(&stored), n(&memory));
        assert!((n(&few) / n(&stored) - 1.0).abs() < 0.05, "{} {}", n(&few), n(&stored));
        // A texel without samples has what half of the others exceed.
        assert!((stored.map.rho_d[0].x - 0.1).abs() < 1e-3 && stored.map.extra["samples"][0] == 0.0);
    }
}

#[test]
fn texels_without_a_sample_take_no_place_of_those_that_are_drawn() {
    let mut sampled = sampled(4, 1e-3, |_| material(Rgb::splat(0.1), 10.0));
    let span = 3 * sampled.poses.len();
    // Of the left half three texels have samples, of the right one none.
    let kept = [0, 2 * SIDE + 1, 5 * SIDE + 3];
    for texel in (0..SIDE * SIDE).filter(|texel| !kept.contains(texel)) {
        sampled.reflectance[texel * span..][..span].fill(f32::NAN);
    }
    let few = PoolOptions { most_samples: 2 * 4, ..PoolOptions::default() };
    let options = FitOptions { lobes: 0, ..FitOptions::default() };
    let pooled = fit_sbrdf(&sampled, &halves(), &options, &few).unwrap();
    assert_eq!(pooled.regions.iter().map(|region| region.fitted).collect::<Vec<_>>(), [8, 0]);
    assert_eq!((pooled.regions[0].samples, pooled.regions[1].samples), (12, 0));
}

#[test]
fn what_cannot_be_pooled_is_refused() {
    let sampled = sampled(3, 0.0, |_| material(Rgb::splat(0.1), 5.0));
    let refused = |options: FitOptions, pool: PoolOptions| {
        let error = fit_sbrdf(&sampled, &one(), &options, &pool).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        error.to_string()
    };
    let default = FitOptions::default();
    let lm = FitOptions { method: Method::Lm, ..default };
    assert!(refused(lm, own()).contains("separable method alone"));
    let gpu = FitOptions { device: Device::Gpu, ..default };
    assert!(refused(gpu, own()).contains("on the CPU alone"));
    let percentile = FitOptions { diffuse: Diffuse::Percentile(5.0), ..default };
    assert!(refused(percentile, own()).contains("percentile"));
    assert!(refused(FitOptions { robust: true, ..default }, own()).contains("outliers"));
    let sigma = FitOptions { weights: Weights::Sigma, residual: Residual::Linear, ..default };
    assert!(refused(sigma, own()).contains("no standard deviations"));
    let other = Regions { width: 1, height: 1, of: vec![Some(0)], colours: vec![[0; 3]] };
    assert!(fit_sbrdf(&sampled, &other, &default, &own()).is_err());
    let black = SampledSbrdf::empty(SIDE, SIDE, 1.0, sampled.poses.clone());
    let error = fit_sbrdf(&black, &one(), &default, &own()).unwrap_err().to_string();
    assert!(error.contains("no valid sample in any texel"), "{error}");
}
