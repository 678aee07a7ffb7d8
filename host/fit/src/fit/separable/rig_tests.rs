//! The fit on sampled SBRDFs that the simulated rig photographed: patterns' edges, mixed texels, all the
//! errors of a rig.

use super::super::lm::Limits;
use super::super::model::{Model, ModelLobe, isotropic_c};
use super::super::testing::{directions, material, relative_error, samples};
use super::super::weights::Weights;
use super::super::{AlbedoBound, FitOptions, Residual, fit_sbrdf};
use super::bound::Bound;
use super::data::Poses;
use super::layout::{CHANNELS, Family};
use super::solver::Solver;
use super::start;
use super::task::{Effort, Task};
use super::texel::Workspace;
use lobelia_base::random::Random;
use lobelia_measure::acquire::{self, RunFolder};
use lobelia_measure::plan::{self, Extent};
use lobelia_reflectance::sampled::SampledSbrdf;
use lobelia_reflectance::{Brdf as _, LobeBrdf, SbrdfMap, albedo};
use lobelia_sim::recipe::Recipe;
use lobelia_sim::sample;
use lobelia_sim::simulated;
use lobelia_sim::size::Size;

/// The demo's brocade, or a recipe, as the simulated rig photographs and develops it at a number of poses.
fn photographed(size: Size, poses: usize, recipe: Option<&str>) -> SampledSbrdf {
    let folder = tempfile::tempdir().unwrap();
    let rig = size.rig(1);
    let layout = || match recipe {
        Some(recipe) => {
            let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples").join(recipe);
            Recipe::read(&path, &rig.carrier).unwrap()
        }
        None => sample::layout(&rig.carrier).unwrap(),
    };
    let plan = plan::make(&rig, Extent::Budget(poses), false, 1).unwrap();
    let run = folder.path().join("run");
    let (created, mut journal) = RunFolder::create(&run, &plan, &rig).unwrap();
    let mut station = simulated::station(&rig, layout()).unwrap();
    acquire::run(&created, &mut journal, &mut station).unwrap();
    lobelia_measure::develop::run(&run).unwrap().sampled
}

/// The cost of a texel's BRDF: of its shapes with the best amplitudes.
fn cost_of(solver: &mut Solver, family: Family, brdf: &LobeBrdf) -> f64 {
    let mut model = Model::from(brdf);
    model.lobes.iter_mut().for_each(|lobe| lobe.n = lobe.n.max(0.5));
    solver.refer(&mut model);
    solver.evaluate(family, true, &model).cost
}

fn random_model(lobes: usize, isotropic: bool, random: &mut Random) -> Model {
    let lobe = |random: &mut Random| {
        let mut c = isotropic_c(random.uniform(0.0, std::f64::consts::TAU));
        if !isotropic {
            c.x *= random.uniform(0.7, 1.3);
        }
        ModelLobe::unit(c, random.uniform(0.0, 1000f64.ln()).exp())
    };
    let beta = random.uniform(0.0, std::f64::consts::PI);
    Model { beta, lobes: (0..lobes).map(|_| lobe(random)).collect(), ..Model::default() }
}

/// For one texel in `step`: the cost of the map's fit over the best of 64 random starts and that of every map
/// of `nested` fits.
struct Judged {
    over_random: Vec<f64>,
    over_nested: Vec<f64>,
}

impl Judged {
    fn within(&self, share: f64) -> f64 {
        let count = self.over_random.iter().filter(|&&ratio| ratio <= 1.0 + share).count();
        count as f64 / self.over_random.len() as f64
    }

    fn worst_over_nested(&self) -> f64 {
        self.over_nested.iter().copied().fold(0.0, f64::max)
    }
}

fn judge(
    sampled: &SampledSbrdf,
    options: &FitOptions,
    nested: &[FitOptions],
    step: usize,
    starts: usize,
) -> Judged {
    let map = fit_sbrdf(sampled, options).unwrap();
    let nested: Vec<SbrdfMap> = nested.iter().map(|options| fit_sbrdf(sampled, options).unwrap()).collect();
    let poses = Poses::new(&sampled.poses);
    let family = if options.isotropic { Family::Isotropic } else { Family::Anisotropic };
    let mut workspace = Workspace::default();
    let mut random = Random::new(4);
    let mut judged = Judged { over_random: Vec::new(), over_nested: Vec::new() };
    let bound = options.largest_albedo().map(|albedo| Bound { albedo, fixed: [0.0; CHANNELS] });
    // What is limited where no pose looked has limits of its own.
    let limited = |map: &SbrdfMap, index| map.extra.get("bounded").is_some_and(|plane| plane[index] > 0.0);
    for index in (0..sampled.texels()).step_by(step).filter(|&index| !limited(&map, index)) {
        workspace.settle(&poses, sampled, index);
        workspace.load(&poses, sampled, index, options);
        let task = workspace.aim(options, &[0, 1, 2]);
        workspace.solver.hold(bound);
        let solver = &mut workspace.solver;
        let cost = cost_of(solver, family, &map.texel(index));
        // A fit that met its limits searched anew for them, and may have found more than on the way to more
        // lobes.
        for map in nested.iter().filter(|map| !limited(map, index)) {
            judged.over_nested.push(cost / cost_of(solver, family, &map.texel(index)));
        }
        let task = Task { effort: Effort::texel(task.lobes), family, ..task };
        let limits = Limits { iterations: 100, tolerance: 1e-7 };
        let mut best = cost;
        for _ in 0..starts {
            let mut model = random_model(options.lobes, options.isotropic, &mut random);
            best = best.min(start::minimise(solver, task, limits, &mut model).0.cost);
        }
        judged.over_random.push(cost / best);
    }
    judged
}

fn fixed(lobes: usize, isotropic: bool) -> FitOptions {
    FitOptions { lobes, isotropic, ..FitOptions::default() }
}

/// The fits that a fit contains.
fn contained(options: &FitOptions) -> Vec<FitOptions> {
    let families: &[bool] = if options.isotropic { &[true] } else { &[true, false] };
    families
        .iter()
        .flat_map(|&isotropic| (1..=options.lobes).map(move |lobes| (lobes, isotropic)))
        .filter(|&(lobes, isotropic)| (lobes, isotropic) != (options.lobes, options.isotropic))
        .map(|(lobes, isotropic)| FitOptions { lobes, isotropic, ..*options })
        .collect()
}

/// By how much a cost may be above another for ties and rounding.
const ALIKE: f64 = 5e-3;

fn check(name: &str, sampled: &SampledSbrdf, options: &FitOptions, step: usize, least: f64) {
    let fault = fault(name, sampled, options, step, least);
    assert!(fault.is_none(), "{}", fault.unwrap());
}

/// What is wrong with a fit, if anything: fewer texels than `least`, less two standard errors, reach the best
/// of 64, or one is above a nested fit.
fn fault(
    name: &str,
    sampled: &SampledSbrdf,
    options: &FitOptions,
    step: usize,
    least: f64,
) -> Option<String> {
    let judged = judge(sampled, options, &contained(options), step, 64);
    let ratios = |share: f64| {
        let mut sorted = judged.over_random.clone();
        sorted.sort_by(f64::total_cmp);
        sorted[((sorted.len() - 1) as f64 * share) as usize]
    };
    println!(
        "{name}, {} lobes, isotropic {}: within 2 % at {:.3} of {} texels, p99 {:.3}, worst {:.3}; over \
         nested fits at most {:.4}",
        options.lobes,
        options.isotropic,
        judged.within(0.02),
        judged.over_random.len(),
        ratios(0.99),
        ratios(1.0),
        judged.worst_over_nested(),
    );
    let texels = judged.over_random.len() as f64;
    let least = least - 2.0 * (least * (1.0 - least) / texels).sqrt();
    let (within, over) = (judged.within(0.02), judged.worst_over_nested());
    (within < least || over > 1.0 + ALIKE)
        .then(|| format!("{name}, {options:?}: {within} within 2 %, over nested fits {over}"))
}

#[test]
fn on_the_small_demo_fits_reach_the_best_of_64_random_starts_and_are_never_above_nested_fits() {
    let sampled = photographed(Size::Small, 120, None);
    for (lobes, isotropic, least) in [(1, true, 0.99), (2, true, 0.97), (2, false, 0.97), (3, true, 0.97)] {
        check("demo", &sampled, &fixed(lobes, isotropic), 23, least);
    }
    let sigma = FitOptions { weights: Weights::Sigma, residual: Residual::Linear, ..fixed(2, false) };
    check("demo by sigma", &sampled, &sigma, 23, 0.97);
}

#[test]
fn without_noise_the_truth_is_found() {
    let mut random = Random::new(9);
    let mut workspace = Workspace::default();
    let mut found = [0; 2];
    for seed in 0..40 {
        let lobes = 1 + seed as usize % 2;
        let truth = material(lobes, &mut random);
        let data = samples(&directions(if lobes == 1 { 60 } else { 200 }, seed), |wi, wo| truth.eval(wi, wo));
        workspace.take(&data);
        let fit = workspace.fit(&fixed(lobes, true));
        let error = relative_error(&fit.brdf, &truth, &directions(300, 999));
        println!("{seed}: {lobes} lobes, error {error:.1e}");
        found[lobes - 1] += usize::from(error < 1e-4);
    }
    assert!(found[0] >= 19 && found[1] >= 19, "{found:?}");
}

#[test]
fn no_texel_of_the_small_demo_makes_light() {
    let sampled = photographed(Size::Small, 80, None);
    for options in [fixed(1, true), fixed(2, true), fixed(2, false), fixed(3, true)] {
        let map = fit_sbrdf(&sampled, &options).unwrap();
        let largest = (0..sampled.texels()).map(|texel| albedo::largest(&map.texel(texel)).max_element());
        let largest = largest.fold(0.0, f32::max);
        assert!(largest <= 1.02, "{options:?}: {largest}");
        let free = fit_sbrdf(&sampled, &FitOptions { bound: AlbedoBound::Free, ..options }).unwrap();
        let held = map.extra["bounded"].iter().filter(|&&held| held > 0.0).count();
        let made =
            (0..sampled.texels()).filter(|&texel| albedo::largest(&free.texel(texel)).max_element() > 1.02);
        println!("{} lobes: {held} texels held, {} free ones make light", options.lobes, made.count());
    }
}

#[test]
#[ignore = "long: cargo xtask long"]
fn on_medium_samples_fits_reach_the_best_of_64_random_starts_and_are_never_above_nested_fits() {
    let mut faults = Vec::new();
    for (poses, recipe) in
        [(100, None), (200, None), (400, None), (200, Some("cloth.toml")), (300, Some("published.toml"))]
    {
        let sampled = photographed(Size::Medium, poses, recipe);
        let name = format!("{} {poses}", recipe.unwrap_or("demo"));
        for (lobes, isotropic, least) in [
            (1, true, 0.99),
            (1, false, 0.99),
            (2, true, 0.97),
            (2, false, 0.97),
            (3, true, 0.97),
            (3, false, 0.97),
        ] {
            faults.extend(fault(&name, &sampled, &fixed(lobes, isotropic), 67, least));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}
