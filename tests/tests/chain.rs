//! The whole chain: the demo as a process, samples whose truth is known, and every command as a user would
//! type them.

#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::fs;
use std::path::Path;

use lobelia::develop;
use lobelia::reflectance::{Brdf, InterpolatedBrdf, LobeBrdf, MeasuredTable, SbrdfMap};
use lobelia::rig::config::RigConfig;
use lobelia::sampled::SampledSbrdf;
use lobelia_tests::command::succeed;
use lobelia_tests::{folder, small};
use serde_json::Value;

fn report(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

/// Asserts what design.md says that every report holds.
fn assert_complete(report: &Value, command: &str) {
    assert_eq!(report["command"], command);
    assert!(report["lobelia"].is_string() && report["arguments"].is_array() && report["seed"].is_u64());
    assert!(report["machine"]["cpu"].is_string() && report["machine"]["cores"].as_u64() >= Some(1));
    assert!(report["machine"].get("gpu").is_some());
    assert!(report["inputs"].is_array() && report["figures"].is_object());
    assert!(report["peak_memory_bytes"].as_u64() > Some(0));
    for stage in report["stages"].as_array().unwrap() {
        assert!(stage["name"].is_string() && stage["seconds"].as_f64() >= Some(0.0), "{stage}");
    }
    for input in report["inputs"].as_array().unwrap() {
        assert!(input["path"].is_string() && input.get("sha256").is_some(), "{input}");
    }
    for error in report["errors"].as_array().unwrap() {
        assert!(error["name"].is_string() && error["value"].is_f64(), "{error}");
        assert!(error["unit"].is_string() && error["over"].is_string(), "{error}");
    }
}

/// The value of the error with a name that depends on what `on` says.
fn error_value(report: &Value, name: &str, on: &[(&str, Value)]) -> f64 {
    let is = |error: &&Value| error["name"] == name && on.iter().all(|(key, value)| error[key] == *value);
    let found = report["errors"].as_array().unwrap().iter().find(is);
    found.unwrap_or_else(|| panic!("no {name} in {}", report["errors"]))["value"].as_f64().unwrap()
}

#[test]
fn the_small_demo_meets_its_bounds() {
    let folder = tempfile::tempdir().unwrap();
    succeed(folder.path(), &["demo", "--size", "small", "--quiet", "--out", "all"]);
    let all = folder.path().join("all");
    let report = report(&all.join("report.json"));
    assert_complete(&report, "demo");
    let stages: Vec<&str> =
        report["stages"].as_array().unwrap().iter().filter_map(|stage| stage["name"].as_str()).collect();
    assert!(["plan", "acquire", "develop"].iter().all(|name| stages.contains(name)), "{stages:?}");
    assert_eq!(report["figures"]["poses_registered"], report["figures"]["poses"]);
    assert_eq!(report["figures"]["poses"], 80);
    let registration = error_value(&report, "registration_rms", &[]);
    assert!(registration < 0.25, "registration is off by {registration} texels RMS");
    let lobes = [("method", Value::from("separable")), ("lobes", Value::from(2))];
    let reflectance = error_value(&report, "relative_rms_reflectance", &lobes);
    assert!(reflectance < 0.06, "two lobes are off by {reflectance}");
    // One lobe by any method is off by more; every percentile is there, over all texels and over each
    // material's.
    for (method, lobes) in
        [("line-search", 1), ("line-search-scaled", 1), ("lm", 1), ("separable", 1), ("lm", 2)]
    {
        let on = |material: Value, percentile: u32| {
            let on =
                [("method", Value::from(method)), ("lobes", lobes.into()), ("percentile", percentile.into())];
            error_value(&report, "relative_rms_reflectance", &[&on[..], &[("material", material)]].concat())
        };
        let all = [50, 95, 99, 100].map(|percentile| on("all".into(), percentile));
        assert!(all.is_sorted() && (lobes == 2 || all[0] > 2.0 * reflectance), "{method}, {lobes}: {all:?}");
        assert!((0..4).all(|material| on(material.into(), 50) <= all[3]));
    }
    let by_angle = |cone: &str, theta_deg: &str| {
        let on = [("cone", cone.into()), ("theta_deg", theta_deg.into()), ("percentile", 50.into())];
        error_value(&report, "relative_rms_by_angle", &[&lobes[..], &on].concat())
    };
    assert!(by_angle("inside", "30-60") < by_angle("outside", "75-90"));

    for file in [
        "run/journal.jsonl",
        "run/plan.toml",
        "run/rig.toml",
        "material.exr",
        "sampled.zarr/zarr.json",
        "report.html",
    ] {
        assert!(all.join(file).is_file(), "{file} is missing");
    }
}

/// Asserts that two folders' runs, sampled SBRDFs and maps are the same.
fn assert_same_results(left: &Path, right: &Path) {
    for name in ["run", "sampled.zarr"] {
        folder::assert_same(&left.join(name), &right.join(name), name);
    }
    for name in ["plan.toml", "material.exr", "out.exr", "out.png"] {
        let bytes = |folder: &Path| fs::read(folder.join(name)).ok();
        assert!(bytes(left) == bytes(right), "{name} differs");
    }
}

#[test]
#[ignore = "long: cargo xtask long"]
fn the_demo_is_the_same_on_one_thread_byte_for_byte() {
    let folder = tempfile::tempdir().unwrap();
    let demo = ["demo", "--size", "small", "--quiet"];
    succeed(folder.path(), &[&demo[..], &["--out", "all"]].concat());
    succeed(folder.path(), &[&demo[..], &["--out", "one", "--threads", "1"]].concat());
    assert_same_results(&folder.path().join("all"), &folder.path().join("one"));
}

/// Relative errors of a developed run's valid samples against `truth` of texel, light and view; texels that
/// `of` refuses are left out.
fn sample_errors(
    sampled: &SampledSbrdf,
    of: impl Fn(usize) -> bool,
    truth: impl Fn(usize, glam::Vec3, glam::Vec3) -> glam::Vec3,
) -> Vec<f64> {
    let mut errors = Vec::new();
    for texel in (0..sampled.texels()).filter(|&texel| of(texel)) {
        for (pose, sample) in sampled.samples(texel).enumerate().filter(|(_, sample)| sample.is_finite()) {
            let (wi, wo) = sampled.directions(texel, pose);
            errors.push(small::relative_error(sample, truth(texel, wi, wo)));
        }
    }
    errors
}

/// The text of a Cornell `.brdf` table of a material, on a regular grid of directions.
fn table_text(material: &LobeBrdf) -> String {
    let direction = |theta: f64, phi: f64| {
        let r = theta.sin();
        glam::DVec3::new(r * phi.cos(), r * phi.sin(), theta.cos()).as_vec3()
    };
    let mut text = String::from("3\n450 550 650\n");
    for (i, o, p) in (0..9).flat_map(|i| (0..10).flat_map(move |o| (0..13).map(move |p| (i, o, p)))) {
        let (theta_i, theta_o, phi_o) = (f64::from(i) * 0.18, f64::from(o) * 0.16, f64::from(p) * 0.26);
        let f = material.eval(direction(theta_i, 0.0), direction(theta_o, phi_o));
        text += &format!("{theta_i:.6} 0 {theta_o:.6} {phi_o:.6} {} {} {}\n", f.z, f.y, f.x);
    }
    text
}

#[test]
fn a_measured_table_on_the_carrier_comes_back_as_its_interpolation_to_three_percent() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = small::recipe(
        "[pattern]\nkind = \"checks\"\nsize_mm = 64\n[[material]]\nrho_d = [0.10, 0.06, 0.03]\n\
         lobe = [{ rho_s = [0.5, 0.4, 0.3], c = [-1, -1, 0.95], n = 12 }]\n",
    );
    let lobe = &recipe.materials[0].lobes[0];
    let material = LobeBrdf {
        rho_d: recipe.materials[0].rho_d.unwrap().into(),
        lobes: vec![lobelia::reflectance::Lobe::new(lobe.rho_s.into(), lobe.c.into(), lobe.n)],
        ..LobeBrdf::default()
    };
    let path = folder.path().join("made.brdf");
    fs::write(&path, table_text(&material)).unwrap();
    let recipe = small::recipe(
        "[pattern]\nkind = \"checks\"\nsize_mm = 64\n[[material]]\ntable = \"made.brdf\"\n\
         wavelengths_nm = [650, 550, 450]\n",
    );
    let rig = small::rig(24);
    let run = folder.path().join("run");
    let sample = recipe.layout(folder.path(), &rig.carrier).unwrap();
    small::acquire(&run, &small::plan(&rig, 16), &rig, sample);
    let sampled = SampledSbrdf::read_zarr(&small::develop(&run)).unwrap();

    let truth = InterpolatedBrdf::new(&MeasuredTable::read(&path).unwrap(), [650.0, 550.0, 450.0]).unwrap();
    let errors = sample_errors(&sampled, |_| true, |_, wi, wo| truth.eval(wi, wo));
    let (all, valid) = (sampled.texels() * sampled.poses.len(), errors.len());
    let middle = small::median(errors);
    println!("measured table: median relative error {:.2} % over {valid} of {all} samples", 100.0 * middle);
    assert!(10 * valid > 9 * all, "only {valid} of {all} samples are valid");
    assert!(middle < 0.03, "median relative error {middle}");
}

#[test]
fn renderings_of_the_true_map_are_the_photographs_and_those_of_another_map_are_not() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = small::recipe(
        "[pattern]\nkind = \"checks\"\nsize_mm = 64\n[[material]]\nrho_d = [0.12, 0.08, 0.05]\n\
         lobe = [{ rho_s = [0.3, 0.3, 0.3], c = [-1, -1, 0.98], n = 20 }]\n",
    );
    let brdf = |rho_d: f32| LobeBrdf {
        rho_d: glam::Vec3::new(rho_d, 0.08, 0.05),
        lobes: vec![lobelia::reflectance::Lobe::new(
            glam::Vec3::splat(0.3),
            glam::Vec3::new(-1.0, -1.0, 0.98),
            20.0,
        )],
        ..LobeBrdf::default()
    };
    let mut rig = small::rig(16);
    let acquire = |run: &str, poses, rig: &RigConfig| {
        let sample = recipe.layout(folder.path(), &rig.carrier).unwrap();
        small::acquire(&folder.path().join(run), &small::plan(rig, poses), rig, sample);
    };
    acquire("run", 6, &rig);

    let compared = |run: &str, name: &str, rho_d: f32| {
        let map = SbrdfMap::from_texels(16, 16, &vec![brdf(rho_d); 256]);
        map.write_exr(&folder.path().join(name)).unwrap();
        succeed(folder.path(), &["compare", run, name, "-o", "pages", "--report", "compare.json"]);
        let report = report(&folder.path().join("compare.json"));
        for (input, file) in ["journal.jsonl", "plan.toml", "rig.toml"].iter().enumerate() {
            let input = &report["inputs"][input];
            assert!(
                input["path"].as_str().unwrap().ends_with(file) && input["sha256"].is_string(),
                "{input}"
            );
        }
        ["relative_rms_radiance", "psnr", "mean_delta_e_2000"].map(|error| error_value(&report, error, &[]))
    };
    let [relative, psnr, delta_e] = compared("run", "true.exr", 0.12);
    println!("true map: relative RMS {:.2} %, PSNR {psnr:.1} dB, mean ΔE {delta_e:.2}", 100.0 * relative);
    assert!(relative < 0.02 && psnr > 38.0 && delta_e < 1.0, "{relative} {psnr} {delta_e}");
    let [_, psnr, delta_e] = compared("run", "other.exr", 0.18);
    assert!(psnr < 32.0 && delta_e > 3.0, "{psnr} {delta_e}");

    let page = fs::read_to_string(folder.path().join("pages/compare.html")).unwrap();
    assert_eq!(page.matches("data:image/png").count(), 9);
    // A run's own photographs are all inside the cone of its poses.
    let by_angle = |cone: &str| {
        let report = report(&folder.path().join("compare.json"));
        let errors = report["errors"].as_array().unwrap().clone();
        errors
            .iter()
            .filter(|error| error["cone"] == cone)
            .filter_map(|error| error["value"].as_f64())
            .collect::<Vec<_>>()
    };
    assert!(page.contains("No photograph was taken outside") && by_angle("outside").is_empty());
    let inside = by_angle("inside");
    assert!(
        !inside.is_empty() && inside.iter().all(|&error| error > 0.1),
        "rho_d is off by half: {inside:?}"
    );

    rig.carrier.cylinder_radius_mm = Some(30.0);
    acquire("bent", 3, &rig);
    let [relative, psnr, delta_e] = compared("bent", "true.exr", 0.12);
    println!(
        "on a cylinder: relative RMS {:.2} %, PSNR {psnr:.1} dB, mean ΔE {delta_e:.2}",
        100.0 * relative
    );
    // Pixels that the edge of the sample's own shadow crosses are most of the relative error.
    assert!(relative < 0.1 && psnr > 50.0 && delta_e < 0.5, "{relative} {psnr} {delta_e}");
    let [_, psnr, delta_e] = compared("bent", "other.exr", 0.18);
    assert!(psnr < 32.0 && delta_e > 3.0, "{psnr} {delta_e}");
    assert!(!by_angle("unknown").is_empty(), "the bent run does not tell what the map was fitted from");
    let bent =
        ["compare", "bent", "true.exr", "-o", "pages", "--report", "compare.json", "--measured-in", "run"];
    succeed(folder.path(), &bent);
    assert!(by_angle("unknown").is_empty() && !by_angle("inside").is_empty());
    let error = develop::run(&folder.path().join("bent")).err().unwrap();
    assert!(error.exit_code() == 2 && error.to_string().contains("cylinder"), "{error}");
}

#[test]
fn both_thread_directions_of_a_weave_come_back_with_their_own_reflectance() {
    /// From thread to thread, and how far from a thread's edge samples count: more than the resampling
    /// filter's reach at the most oblique view.
    const PITCH_MM: f64 = 32.0;
    const MARGIN_MM: f64 = 9.0;
    let folder = tempfile::tempdir().unwrap();
    let recipe = small::recipe(
        "[pattern]\nkind = \"weave\"\npitch_mm = 32\n[[material]]\nrho_d = [0.08, 0.06, 0.05]\n\
         lobe = [{ rho_s = [0.4, 0.4, 0.3], c = [-1, -0.6, 0.9], n = 14 }]\n",
    );
    let rig = small::rig(24);
    let layout = |rig: &RigConfig| recipe.layout(Path::new("."), &rig.carrier).unwrap();
    let run = folder.path().join("run");
    small::acquire(&run, &small::plan(&rig, 24), &rig, layout(&rig));
    let sampled = SampledSbrdf::read_zarr(&small::develop(&run)).unwrap();

    let sample = layout(&rig);
    let cell = |length: f64| (length + 32.0).div_euclid(PITCH_MM) as i64;
    let inside = |length: f64| {
        let place = (length + 32.0).rem_euclid(PITCH_MM);
        (MARGIN_MM..PITCH_MM - MARGIN_MM).contains(&place)
    };
    for (thread, parity) in [("warp", 0), ("weft", 1)] {
        let of = |texel: usize| {
            let place = sampled.position_mm(texel);
            inside(place.x) && inside(place.y) && (cell(place.x) + cell(-place.y)) % 2 == parity
        };
        let at = |texel: usize| sampled.position_mm(texel);
        let own = sample_errors(&sampled, of, |k, wi, wo| sample.at(at(k).x, at(k).y).eval(wi, wo));
        // The other thread's material, one pitch further.
        let further = |x: f64| if x > 0.0 { x - PITCH_MM } else { x + PITCH_MM };
        let mut other =
            sample_errors(&sampled, of, |k, wi, wo| sample.at(further(at(k).x), at(k).y).eval(wi, wo));
        let mut sorted = own.clone();
        sorted.sort_by(f64::total_cmp);
        let (middle, high) = (small::median(own), sorted[sorted.len() * 95 / 100]);
        other.sort_by(f64::total_cmp);
        let count = sorted.len();
        println!(
            "{thread}: median {:.2} %, 95 % below {:.2} %, {count} samples",
            100.0 * middle,
            100.0 * high
        );
        assert!(count > 500 && middle < 0.02 && high < 0.05, "{thread}: {middle} {high} {count}");
        // Most pairs of directions see little of either highlight.
        let away = other[other.len() * 95 / 100];
        assert!(away > 5.0 * high, "{thread}: the other thread is off by no more than {away}");
    }
}

#[test]
fn the_commands_chain_through_their_files_with_the_same_results_on_one_thread() {
    let (all, one) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    type_the_chain(all.path(), "");
    type_the_chain(one.path(), " --threads 1");
    assert_same_results(all.path(), one.path());
}

/// Plan, acquire, develop, fit and render as a user would type them, each with `options`.
fn type_the_chain(path: &Path, options: &str) {
    let lobelia = |line: &str| {
        let line = line.to_string() + options;
        succeed(path, &line.split_whitespace().collect::<Vec<_>>())
    };
    let rig = lobelia("template rig");
    assert!(rig.contains("texels_across = 128"), "{rig}");
    fs::write(path.join("rig.toml"), rig.replace("texels_across = 128", "texels_across = 32")).unwrap();
    fs::write(path.join("material.toml"), lobelia("template material")).unwrap();

    lobelia("plan rig.toml --budget 24 --anisotropic -o plan.toml --report plan.json");
    lobelia(
        "acquire plan.toml --rig rig.toml --port sim --camera sim --material material.toml -o run --report \
         acquire.json",
    );
    lobelia("develop run -o sampled.zarr --report develop.json");
    lobelia("fit sampled.zarr -o material.exr --lobes 1 --report fit.json");
    let scene = "[camera]\nposition = [0.0, 0.0, 4.0]\ntarget = [0.0, 0.0, 0.0]\nfov_deg = 30.0\nwidth = 48\n\
                 height = 32\n[[object]]\nmesh = \"sphere\"\n[object.material]\nmap = \"material.exr\"\n\
                 [[light]]\nkind = \"directional\"\ntoward = [0.3, 1.0, 0.8]\nirradiance = [2.0, 2.0, 2.0]\n";
    fs::write(path.join("scene.toml"), scene).unwrap();
    lobelia("render scene.toml -o out.exr -o out.png --method reference --samples 4 --report render.json");

    for command in ["plan", "acquire", "develop", "fit", "render"] {
        assert_complete(&report(&path.join(format!("{command}.json"))), command);
    }
    assert_eq!(report(&path.join("develop.json"))["figures"]["poses_registered"], 24);
    let map = SbrdfMap::read_exr(&path.join("material.exr")).unwrap();
    assert_eq!((map.width, map.height), (32, 32));
    assert!(fs::read(path.join("out.png")).unwrap().starts_with(b"\x89PNG"));
    assert!(fs::read(path.join("out.exr")).unwrap().starts_with(&[0x76, 0x2f, 0x31, 0x01]));
}

#[test]
fn help_and_completions_are_there() {
    let folder = tempfile::tempdir().unwrap();
    assert!(succeed(folder.path(), &["help", "acquire"]).contains("--resume"));
    assert!(succeed(folder.path(), &["completions", "bash"]).contains("lobelia"));
}
