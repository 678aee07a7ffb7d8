//! Options of `lobelia fit`, and what it says and writes.

use super::*;
use crate::figures::ErrorFigure;
use crate::sampled::SampledSbrdf;
use crate::warning::{Kind, Warning};
use clap::Parser;
use std::fmt::Write as _;

#[derive(Parser)]
struct Command {
    #[command(flatten)]
    args: FitArgs,
}

fn parsed(arguments: &[&str]) -> FitArgs {
    Command::try_parse_from(std::iter::once(&"fit").chain(arguments)).unwrap().args
}

fn run_on(text: &str, arguments: &[&str]) -> (tempfile::TempDir, Result<Findings>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("paint.brdf");
    std::fs::write(&path, text).unwrap();
    let mut all = vec![path.to_str().unwrap()];
    all.extend(arguments);
    let outcome = fit_input(&parsed(&all), 1);
    (folder, outcome)
}

/// A wide table of a white lobe.
fn table_text() -> String {
    let mut text = String::from("3 450 550 650\n");
    for (i, o, p) in (1..8).flat_map(|i| (0..8).flat_map(move |o| (0..7).map(move |p| (i, o, p)))) {
        let (i, o, p) = (f64::from(i) * 0.17, f64::from(o) * 0.17, f64::from(p) * 0.52);
        let base = -0.95 * i.sin() * o.sin() * p.cos() + 0.9 * i.cos() * o.cos();
        let f = 0.05 + base.max(0.0).powi(20);
        writeln!(text, "{i} 0 {o} {p} {f} {f} {f}").unwrap();
    }
    text
}

#[test]
fn a_table_is_fitted_reported_and_written_as_a_map_of_one_texel() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("paint.exr");
    let held = (3.0f64 * 0.17).to_degrees().to_string();
    let arguments = [
        "--hold-out-theta-deg",
        &held,
        "--lobes",
        "1",
        "-o",
        output.to_str().unwrap(),
        "--random-starts",
        "2",
    ];
    let (_input, outcome) = run_on(&table_text(), &arguments);
    let errors = outcome.unwrap().errors;
    let one = errors.iter().find(|e| e.name == "held_out_relative_l2" && e.depends["lobes"] == 1).unwrap();
    assert!(one.value < 1e-2 && one.depends["wavelength_nm"] == 450.0, "{one:?}");
    assert_eq!(errors.iter().filter(|e| e.name == "start_cost_ratio").count(), 9);
    let map = SbrdfMap::read_exr(&output).unwrap();
    assert_eq!((map.width, map.height, map.lobes.len()), (1, 1, 3));
    assert!((map.rho_d[0].x - 0.05).abs() < 1e-3);
    assert_eq!(map.attributes["fit.wavelengths_nm"], "650,550,450");
}

#[test]
fn a_coated_table_of_one_value_in_alta_s_format_becomes_a_grey_map_with_its_term() {
    let folder = tempfile::tempdir().unwrap();
    let (input, output) = (folder.path().join("coat.dat"), folder.path().join("coat.exr"));
    let mut text = String::from("#DIM 4 1\n#PARAM_IN SPHERICAL_TL_PL_TV_PV\n#PARAM_OUT INV_STERADIAN\n");
    let coat = crate::reflectance::Microfacet {
        f0: crate::reflectance::Rgb::splat(0.05),
        f90: crate::reflectance::Rgb::ONE,
        alpha: 0.2,
    };
    for (i, o, p) in (1..8).flat_map(|i| (0..8).flat_map(move |o| (0..7).map(move |p| (i, o, p)))) {
        let (i, o, p) = (f64::from(i) * 0.17, f64::from(o) * 0.17, f64::from(p) * 0.52);
        let at = |theta: f64, phi: f64| {
            glam::DVec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()).as_vec3()
        };
        writeln!(text, "{i} 0 {o} {p} {}", 0.1 + coat.eval(at(i, 0.0), at(o, p)).x).unwrap();
    }
    std::fs::write(&input, text).unwrap();
    let arguments =
        [input.to_str().unwrap(), "-o", output.to_str().unwrap(), "--model", "ggx", "--lobes", "0"];
    let outcome = fit_input(&parsed(&arguments), 1).unwrap();
    assert!(outcome.errors.iter().all(|error| error.depends["microfacet"] == true));
    let map = SbrdfMap::read_exr(&output).unwrap();
    assert!((map.rho_d[0].y - 0.1).abs() < 1e-4 && map.rho_d[0].x == map.rho_d[0].z);
    assert!((map.microfacets[0].alpha[0] - 0.2).abs() < 1e-3, "{:?}", map.microfacets);
}

#[test]
fn wrong_inputs_end_with_a_sentence_and_exit_code_2() {
    let refused = |text: &str, arguments: &[&str]| {
        let error = run_on(text, arguments).1.unwrap_err();
        assert_eq!(error.exit_code(), 2);
        error.to_string()
    };
    assert!(refused("1 500 0.1 0 0.1 0 nan", &[]).contains("paint.brdf: line 1: row 1: the value at 500 nm"));
    assert!(refused("1 500 0.1 0 0.1 0 1", &["--wavelengths-nm", "450"]).contains("450 nm lies outside"));
    let two = ["--wavelengths-nm", "450,550", "-o", "x.exr"];
    assert!(refused(&table_text(), &two).contains("one or three --wavelengths-nm"));
    assert!(refused(&table_text(), &["--method", "line-search", "--lobes", "2"]).contains("one lobe"));
    assert!(refused(&table_text(), &["--hold-out-theta-deg", "45"]).contains("held-out 45°"));
    assert!(
        refused(&table_text(), &["--model", "ggx", "--method", "line-search", "--lobes", "1"])
            .contains("no microfacet term")
    );
    assert!(refused(&table_text(), &["--normals"]).contains("tables are isotropic"));
    for (with, says) in [("--method=lm", "separable"), ("--device=gpu", "CPU")] {
        let arguments = ["a.zarr", "-o", "a.exr", "--normals", "--residual=linear", with];
        let texels = fit_input(&parsed(&arguments), 1).unwrap_err();
        assert!(texels.exit_code() == 2 && texels.to_string().contains(says), "{texels}");
    }
    let unknown = fit_input(&parsed(&["paint.csv"]), 1).unwrap_err();
    assert!(unknown.exit_code() == 2 && unknown.to_string().contains("paint.csv"));
    let no_output = fit_input(&parsed(&["a.zarr"]), 1).unwrap_err();
    assert!(no_output.to_string().contains("-o FILE.exr"));
}

#[test]
fn brushed_metal_is_held_to_what_arrives_and_the_price_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let (input, output) = (folder.path().join("s.zarr"), folder.path().join("m.exr"));
    let metal = crate::reflectance::materials::published("brushed-metal").unwrap();
    let options = crate::synth::Options {
        width: 2,
        height: 1,
        texel_mm: 0.5,
        poses: 150,
        noise: 0.0,
        relative_noise: 0.0,
        seed: 3,
    };
    let eval = |wi, wo| crate::reflectance::Brdf::eval(&metal, wi, wo);
    crate::synth::sample(&options, |_, _, wi, wo| eval(wi, wo)).write_zarr(&input).unwrap();
    let arguments =
        [input.to_str().unwrap(), "-o", output.to_str().unwrap(), "--lobes", "3", "--separate-channels"];
    let albedo = || {
        let map = SbrdfMap::read_exr(&output).unwrap();
        crate::reflectance::albedo::largest(&map.texel(1)).max_element()
    };
    let free = fit_input(&parsed(&[&arguments[..], &["--no-bound"]].concat()), 1).unwrap();
    assert!(albedo() > 1.1, "{}", albedo());
    assert_eq!(free.figures["texels_making_light"], 2);
    fit_input(&parsed(&arguments), 1).unwrap();
    assert!(albedo() <= 1.02, "{}", albedo());
    let outcome = fit_input(&parsed(&[&arguments[..], &["--conserve-energy"]].concat()), 1).unwrap();
    assert!(albedo() <= 1.0 + crate::fit::conserve::TOLERANCE, "{}", albedo());
    let price = outcome.errors.iter().find(|error| error.name == "bound_price_median").unwrap();
    assert!(price.value > 0.0 && price.value < 0.5, "{price:?}");
    assert!(outcome.figures["texels_bounded"].as_u64().unwrap() >= 1);
}

#[test]
fn texels_get_the_normals_the_sharpening_and_the_microfacet_terms_that_they_have() {
    let folder = tempfile::tempdir().unwrap();
    let (input, output) = (folder.path().join("s.zarr"), folder.path().join("m.exr"));
    let recipe: crate::acquire::recipe::Recipe =
        crate::toml_file::parse(include_str!("../../../../examples/beyond.toml"), "beyond.toml").unwrap();
    let materials = recipe.build_materials(Path::new(".")).unwrap();
    let options = crate::synth::Options {
        width: 4,
        height: 1,
        texel_mm: 0.5,
        poses: 300,
        noise: 1e-3,
        relative_noise: 0.0,
        seed: 3,
    };
    let eval = |k: usize, wi, wo| crate::reflectance::Brdf::eval(&materials[k], wi, wo);
    crate::synth::sample(&options, |k, _, wi, wo| eval(k, wi, wo)).write_zarr(&input).unwrap();
    let files = [input.to_str().unwrap(), "-o", output.to_str().unwrap()];
    let beyond = ["--normals", "--sharpening", "--model", "auto"];
    fit_input(&parsed(&[&files[..], &beyond[..]].concat()), 1).unwrap();
    let map = SbrdfMap::read_exr(&output).unwrap();
    let tilts = [[0.1, 0.05], [-0.1, 0.05], [0.0; 2], [0.0; 2]].map(glam::Vec2::from_array);
    assert!(
        map.normal.iter().zip(tilts).all(|(found, truth)| (*found - truth).length() < 5e-3),
        "{:?}",
        map.normal
    );
    let found: Vec<_> = (0..4).map(|k| map.texel(k)).collect();
    assert!((found[2].lobes[0].n_grazing.unwrap() - 60.0).abs() < 6.0, "{:?}", found[2]);
    assert!((found[3].microfacets[0].alpha - 0.2).abs() < 5e-3 && found[0].microfacets.is_empty());
    for name in ["sigma.normal.x", "sigma.ggx0.alpha", "sigma.lobe0.n_grazing"] {
        assert!(map.extra[name].iter().any(|&sigma| sigma > 0.0), "{name}");
    }
    // Plain lobes have none of these channels.
    fit_input(&parsed(&files), 1).unwrap();
    let map = SbrdfMap::read_exr(&output).unwrap();
    assert!(map.normal.is_empty() && map.microfacets.is_empty() && map.extension().is_none());
    assert!(map.extra.keys().all(|name| !name.contains("normal") && !name.contains("ggx")));
}

#[test]
fn the_zarr_path_goes_from_a_store_to_a_map() {
    let folder = tempfile::tempdir().unwrap();
    let (input, output) = (folder.path().join("s.zarr"), folder.path().join("m.exr"));
    let pose = |x: f64| crate::sampled::PoseGeometry {
        light_mm: glam::DVec3::new(x, 100.0, 900.0),
        camera_mm: glam::DVec3::new(-x, 0.0, 900.0),
        weight: 1.0,
    };
    let poses: Vec<_> = (0..30).map(|k| pose(f64::from(k) * 40.0)).collect();
    let mut sampled = SampledSbrdf::empty(3, 2, 1.0, poses);
    sampled.reflectance.fill(0.25);
    sampled.write_zarr(&input).unwrap();
    let arguments = [input.to_str().unwrap(), "-o", output.to_str().unwrap(), "--lobes", "1", "--mip"];
    let outcome = fit_input(&parsed(&arguments), 1).unwrap();
    assert!(outcome.errors[0].value < 1e-3, "{outcome:?}");
    let map = SbrdfMap::read_exr(&output).unwrap();
    assert_eq!((map.width, map.height), (3, 2));
    for (level, size) in [(1, (2, 1)), (2, (1, 1))] {
        let map = SbrdfMap::read_exr(&folder.path().join(format!("m.mip{level}.exr"))).unwrap();
        assert_eq!((map.width, map.height), size);
    }
    assert!(!folder.path().join("m.mip3.exr").exists());
}

/// 12 × 10 texels of one material at 40 poses, written beside an index image of two regions.
fn store_and_index(folder: &std::path::Path) -> (String, String) {
    let options = crate::synth::Options {
        width: 12,
        height: 10,
        texel_mm: 2.0,
        poses: 40,
        noise: 1e-3,
        relative_noise: 0.0,
        seed: 2,
    };
    let clay = crate::reflectance::materials::published("clay").unwrap();
    let sampled =
        crate::synth::sample(&options, |_, _, wi, wo| crate::reflectance::Brdf::eval(&clay, wi, wo));
    let (store, index) = (folder.join("sampled.zarr"), folder.join("index.png"));
    sampled.write_zarr(&store).unwrap();
    image::GrayImage::from_fn(12, 10, |x, _| image::Luma([if x < 4 { 255 } else { 3 }]))
        .save(&index)
        .unwrap();
    (store.to_str().unwrap().into(), index.to_str().unwrap().into())
}

#[test]
fn a_pooled_fit_writes_a_map_of_regions_and_reports_each() {
    let folder = tempfile::tempdir().unwrap();
    let (store, index) = store_and_index(folder.path());
    let output = folder.path().join("pooled.exr");
    let mut arguments = vec![&store[..], "--pool", &index, "--lobes", "1", "--isotropic", "-o"];
    arguments.push(output.to_str().unwrap());
    let outcome = fit_input(&parsed(&arguments), 1).unwrap();
    let regions = outcome.figures["regions"].as_array().unwrap();
    assert_eq!((regions.len(), &regions[0]["texels"], &regions[1]["samples"]), (2, &40.into(), &3200.into()));
    assert_eq!(regions[0]["region"], "1 #ffffff");
    assert!(regions[0]["rms_per_sr"].as_f64().unwrap() > 0.0);
    let map = SbrdfMap::read_exr(&output).unwrap();
    assert_eq!((map.texel(0), map.extra["region"][11]), (map.texel(3), 2.0));

    let with = |more: &[&'static str]| {
        let arguments: Vec<&str> = arguments.iter().copied().chain(more.iter().copied()).collect();
        fit_input(&parsed(&arguments), 1)
    };
    let outcome =
        with(&["--pool-outside", "255", "--pool-rho-d", "texel", "--hold-out-poses", "0.2"]).unwrap();
    assert_eq!(outcome.figures["texels_outside_regions"], 40);
    let held = outcome.errors.iter().find(|error| error.name == "held_out_relative_rms_median").unwrap();
    assert!(held.over.starts_with("80 texels, samples of 8 poses") && held.value < 0.05, "{held:?}");

    image::GrayImage::new(12, 9).save(&index).unwrap();
    let error = with(&[]).unwrap_err();
    assert!(error.exit_code() == 2 && error.to_string().contains("12 × 9 pixels do not fit 12 × 10 texels"));
    let error = with(&["--method", "lm"]).unwrap_err();
    assert!(error.exit_code() == 2 && error.to_string().contains("separable method alone"), "{error}");
    for wrong in [&["--chunks", "1/2"][..], &["--mip"], &["--pool-outside", "#12345"]] {
        let all = std::iter::once(&"fit").chain(&arguments).chain(wrong);
        assert!(Command::try_parse_from(all).is_err(), "{wrong:?}");
    }
}

#[test]
fn parts_that_are_joined_with_their_samples_tell_of_poses_as_one_fit_does() {
    let folder = tempfile::tempdir().unwrap();
    let (store, _) = store_and_index(folder.path());
    let mut sampled = SampledSbrdf::read_zarr(Path::new(&store)).unwrap();
    sampled.poses.iter_mut().for_each(|pose| pose.camera_mm = glam::DVec3::Z * 1000.0);
    sampled.poses[9].light_mm.x = f64::NAN;
    sampled.write_zarr(Path::new(&store)).unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let (whole, part, merged) = (path("whole.exr"), path("part.exr"), path("merged.exr"));
    let run = |more: &[&str]| fit_input(&parsed(&[&[&store[..]], more].concat()), 1).unwrap().warnings;
    let told = |warnings: &[Warning]| -> Vec<String> {
        let kinds = [Kind::UnknownPose, Kind::Shape, Kind::FewPoses];
        let of_poses = |warning: &&Warning| kinds.contains(&warning.kind);
        warnings.iter().filter(of_poses).map(|warning| warning.text.clone()).collect()
    };
    let at_once = told(&run(&["--lobes", "1", "--isotropic", "-o", &whole]));
    assert!(at_once.len() == 2 && at_once[0].starts_with("pose 9 is left out"), "{at_once:?}");
    run(&["--lobes", "1", "--isotropic", "--chunks", "1/1", "-o", &part]);
    assert_eq!(told(&run(&["-o", &merged, "--merge", &part])), at_once);
}

#[test]
fn too_few_poses_are_told_by_a_merge_as_by_one_fit() {
    let folder = tempfile::tempdir().unwrap();
    let (store, _) = store_and_index(folder.path());
    let mut sampled = SampledSbrdf::read_zarr(Path::new(&store)).unwrap();
    sampled.poses[5..].iter_mut().for_each(|pose| pose.weight = 0.0);
    sampled.write_zarr(Path::new(&store)).unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let (whole, part, merged) = (path("whole.exr"), path("part.exr"), path("merged.exr"));
    let told = |arguments: &[&str]| -> Vec<String> {
        let warnings = fit_input(&parsed(arguments), 1).unwrap().warnings;
        let few = warnings.into_iter().filter(|warning| warning.kind == Kind::FewPoses);
        few.map(|warning| warning.text).collect()
    };
    let fixed = ["--lobes", "2", "--isotropic"];
    let at_once = told(&[&[&store[..]], &fixed[..], &["-o", &whole]].concat());
    assert!(at_once.len() == 1 && at_once[0].starts_with("5 poses for the 7 unknowns"), "{at_once:?}");
    told(&[&[&store[..]], &fixed[..], &["--chunks", "1/1", "-o", &part]].concat());
    assert_eq!(told(&[&store, "-o", &merged, "--merge", &part]), at_once);
    // Without the samples the poses are not known, but how many each texel had.
    let blind = told(&["-o", &merged, "--merge", &part]);
    assert!(blind.len() == 1 && blind[0].starts_with("120 of 120 texels"), "{blind:?}");
}

#[test]
fn options_that_a_merge_does_not_look_at_are_refused_by_name() {
    let refused = |more: &[&str]| {
        let error =
            fit_input(&parsed(&[more, &["-o", "m.exr", "--merge", "a.exr"]].concat()), 1).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        error.to_string()
    };
    assert!(refused(&["--lobes", "2"]).contains("without --lobes: give that to each part"));
    let three = refused(&["--no-bound", "--robust", "--normals"]);
    assert!(three.contains("--normals, --robust and --no-bound"), "{three}");
    for option in [
        "--lobes=auto:2",
        "--model=ggx",
        "--sharpening",
        "--method=lm",
        "--residual=linear",
        "--weights=pose",
        "--device=gpu",
        "--isotropic",
        "--separate-channels",
        "--diffuse-percentile=5",
        "--conserve-energy",
        "--wavelengths-nm=550",
        "--hold-out-theta-deg=30",
        "--hold-out-each-pair",
        "--random-starts=3",
    ] {
        let name = option.split('=').next().unwrap();
        assert!(refused(&[option]).contains(name), "{option}");
        // Beside the samples too, where no levels are fitted.
        assert!(refused(&["s.zarr", option]).contains(name), "{option}");
    }
    // What it does look at is looked for.
    assert!(refused(&["--scanlines"]).contains("a.exr: cannot be read"));
    assert!(refused(&["--lobes", "2", "--mip"]).contains("a.exr: cannot be read"));
    assert!(
        refused(&["s.zarr", "--isotropic", "--hold-out-poses", "0.1"]).contains("there is no such store")
    );
}

#[test]
fn maps_say_which_poses_of_their_samples_weigh_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (store, _) = store_and_index(folder.path());
    let args = parsed(&[&store, "-o", "material.exr"]);
    let report = Report::new("fit", 1);
    assert!(!made(&args, &report).contains_key("fit.left_out_poses"));
    let mut sampled = SampledSbrdf::read_zarr(Path::new(&store)).unwrap();
    [3, 7].into_iter().for_each(|pose| sampled.poses[pose].weight = 0.0);
    sampled.write_zarr(Path::new(&store)).unwrap();
    assert_eq!(made(&args, &report)["fit.left_out_poses"], "3 7");
}

#[test]
fn held_out_poses_are_told_the_same_for_a_fit_at_once_and_in_parts() {
    let folder = tempfile::tempdir().unwrap();
    let (store, _) = store_and_index(folder.path());
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let (whole, part, merged) = (path("whole.exr"), path("part.exr"), path("merged.exr"));
    let fixed = ["--lobes", "1", "--isotropic", "--hold-out-poses", "every:5"];
    let run = |more: &[&str]| {
        let arguments: Vec<&str> = std::iter::once(&store[..]).chain(more.iter().copied()).collect();
        fit_input(&parsed(&arguments), 1)
    };
    let at_once = run(&[&fixed[..], &["-o", &whole]].concat()).unwrap();
    assert_eq!(
        (&at_once.figures["poses_fitted"], at_once.figures["poses_held_out"][1].as_u64()),
        (&32.into(), Some(5))
    );
    let named = |outcome: &Findings| -> Vec<ErrorFigure> {
        outcome.errors.iter().filter(|error| error.name.starts_with("held_out")).cloned().collect()
    };
    let groups = named(&at_once);
    assert!(groups.len() >= 8 && groups[0].depends["poses"] == "all" && groups[0].value < 0.2, "{groups:?}");
    run(&[&fixed[..], &["--chunks", "1/1", "-o", &part]].concat()).unwrap();
    let joined = run(&[&fixed[2..], &["-o", &merged, "--merge", &part]].concat()).unwrap();
    assert_eq!(named(&joined), groups);
    let [whole, merged] = [whole, merged].map(|path| std::fs::read(path).unwrap());
    assert!(whole == merged);
    // A part that saw other poses is of other samples.
    let error = run(&["-o", &path("other.exr"), "--merge", &part]).unwrap_err();
    assert!(error.exit_code() == 2 && error.to_string().contains("other samples"), "{error}");
    let arguments = ["--hold-out-poses", "0.1", "-o", &path("other.exr"), "--merge", &part];
    assert!(fit_input(&parsed(&arguments), 1).unwrap_err().to_string().contains("name the sampled SBRDF"));
    let error = run(&["--hold-out-poses", "list:40", "-o", &path("other.exr")]).unwrap_err();
    assert!(error.exit_code() == 2 && error.to_string().contains("pose 40 is not there"), "{error}");
}

#[test]
fn the_command_and_the_library_decide_alike_and_make_the_same_map() {
    let folder = tempfile::tempdir().unwrap();
    let (noisy, _) = store_and_index(folder.path());
    let plain = folder.path().join("plain.zarr");
    let mut sampled = SampledSbrdf::read_zarr(Path::new(&noisy)).unwrap();
    // Without standard deviations the weights are others.
    assert!(sampled.sigma.take().is_some());
    sampled.write_zarr(&plain).unwrap();
    for (store, weights) in [(Path::new(&noisy), "sigma"), (&plain, "pose")] {
        let output = folder.path().join("m.exr");
        fit_input(&parsed(&[store.to_str().unwrap(), "-o", output.to_str().unwrap()]), 1).unwrap();
        let store = SampledStore::open(store).unwrap();
        let map = crate::fit::request::Request::default().fit(&store).unwrap();
        assert_eq!(map.attributes["fit.weights"], weights);
        assert!(map == SbrdfMap::read_exr(&output).unwrap());
    }
    let (table, output) = (folder.path().join("paint.brdf"), folder.path().join("paint.exr"));
    std::fs::write(&table, table_text()).unwrap();
    fit_input(&parsed(&[table.to_str().unwrap(), "-o", output.to_str().unwrap()]), 1).unwrap();
    let table = crate::reflectance::MeasuredTable::read(&table).unwrap();
    let map = crate::fit::request::Request::default().fit_table(&table).unwrap();
    assert!(map == SbrdfMap::read_exr(&output).unwrap());
}
