//! Warnings: silence after a good run, one line each after a bad one, and all of them in the report.

#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::fs;
use std::path::Path;

use glam::DVec3;
use lobelia::plan::{Plan, exposure};
use lobelia::reflectance::SbrdfMap;
use lobelia::rig::config::RigConfig;
use lobelia::rig::geometry::MotorAngles;
use lobelia::sampled::SampledSbrdf;
use lobelia_tests::command::run;
use lobelia_tests::small;
use serde_json::Value;

/// Runs a command that succeeds; its warnings as the terminal and as the report have them, and the report.
fn warned(folder: &Path, arguments: &[&str]) -> (Vec<String>, Vec<String>, Value) {
    let mut all = arguments.to_vec();
    all.extend(["--report", "report.json"]);
    let said = run(folder, &all);
    assert_eq!(said.code, Some(0), "{said:?}");
    let lines: Vec<String> =
        said.stderr.lines().filter_map(|line| line.strip_prefix("warning: ")).map(str::to_string).collect();
    let report: Value = serde_json::from_slice(&fs::read(folder.join("report.json")).unwrap()).unwrap();
    let listed = report["warnings"].as_array().unwrap();
    let texts: Vec<&str> = listed.iter().map(|warning| warning["text"].as_str().unwrap()).collect();
    assert_eq!(lines, texts, "terminal and report differ");
    let kinds = listed.iter().map(|warning| warning["kind"].as_str().unwrap().to_string()).collect();
    (kinds, lines, report)
}

/// A rig's file and a plan of 40 poses, with the exposures times a factor.
fn planned(folder: &Path, factor: f64) -> RigConfig {
    let rig = small::rig(24);
    let mut plan = small::plan(&rig, 40);
    let (least, most) = (rig.camera.min_exposure_s, rig.camera.max_exposure_s);
    for seconds in plan.poses.iter_mut().flat_map(|pose| &mut pose.exposures_s) {
        *seconds = (*seconds * factor).clamp(least, most);
    }
    small::write_inputs(folder, &rig, &plan);
    rig
}

const ACQUIRE: [&str; 9] =
    ["acquire", "plan.toml", "--rig", "rig.toml", "--port", "sim", "--camera", "sim", "-oRUN"];
const DEVELOP: [&str; 4] = ["develop", "RUN", "-o", "sampled.zarr"];
const FIT: [&str; 7] = ["fit", "sampled.zarr", "--lobes", "2", "--isotropic", "-o", "material.exr"];

#[test]
fn a_good_run_is_not_warned_of_from_plan_to_fit_and_the_report_has_the_shares_by_pose() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    planned(path, 1.0);
    let plan = ["plan", "rig.toml", "--budget", "40", "-o", "other.toml"];
    for arguments in [&plan[..], &ACQUIRE, &DEVELOP, &FIT] {
        let (kinds, lines, report) = warned(path, arguments);
        assert!(kinds.is_empty(), "{arguments:?}: {lines:?}");
        let shares = report["figures"]["samples_by_pose"].as_array().unwrap();
        assert_eq!((shares.len(), &shares[39]["pose"]), (40, &39.into()), "{arguments:?}");
        assert!(shares.iter().all(|share| share["missing"].as_f64().unwrap() < 0.01));
    }
    let report: Value = serde_json::from_slice(&fs::read(path.join("report.json")).unwrap()).unwrap();
    assert_eq!(report["figures"]["residual_by_pose"].as_array().unwrap().len(), 40);
    assert!(report["figures"]["texels_unexplained"].as_u64().is_some());
}

#[test]
fn overexposed_photographs_are_told_by_acquire_develop_and_fit_with_the_worst_poses() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    planned(path, 12.0);
    for arguments in [&ACQUIRE[..], &DEVELOP, &FIT] {
        let (kinds, lines, report) = warned(path, arguments);
        assert_eq!(kinds.first().map(String::as_str), Some("clipped"), "{arguments:?}: {lines:?}");
        assert!(
            lines[0].contains("saturated in every exposure") && lines[0].contains("most in poses"),
            "{lines:?}"
        );
        let worst = report["warnings"][0]["poses"][0].as_u64().unwrap() as usize;
        let shares = report["figures"]["samples_by_pose"].as_array().unwrap();
        let clipped = |share: &Value| share["clipped"].as_f64().unwrap();
        let of_worst = shares.iter().find(|share| share["pose"] == worst).map(clipped).unwrap();
        assert!(shares.iter().all(|share| clipped(share) <= of_worst) && of_worst > 0.5, "{arguments:?}");
    }
}

/// A black velvet beside tags that are well exposed.
#[test]
fn a_sample_too_dark_for_its_exposures_is_told_by_acquire_develop_and_fit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let rig = planned(path, 1.0);
    let mut plan = Plan::read(&path.join("plan.toml"), &rig).unwrap();
    plan.poses.iter_mut().for_each(|pose| pose.exposures_s = vec![0.01]);
    plan.write(&path.join("plan.toml")).unwrap();
    let black =
        "pattern = { kind = \"stripes\", width_mm = 4.0 }\n[[material]]\nrho_d = [1e-4, 1e-4, 1e-4]\n";
    fs::write(path.join("black.toml"), black).unwrap();
    let acquire = [&ACQUIRE[..], &["--material", "black.toml"]].concat();
    for arguments in [&acquire[..], &DEVELOP, &FIT] {
        let (kinds, lines, _) = warned(path, arguments);
        assert!(has(&kinds, "starved") && !has(&kinds, "clipped"), "{arguments:?}: {lines:?}");
    }
}

fn has(kinds: &[String], kind: &str) -> bool {
    kinds.iter().any(|other| other == kind)
}

#[test]
fn poses_in_a_plane_and_few_poses_are_told_before_the_run_and_after_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let rig = small::rig(24);
    let mut plan = small::plan(&rig, 12);
    for (k, pose) in plan.poses.iter_mut().enumerate() {
        let (pan_deg, light) = (5.0 + 3.0 * k as f64, 20.0 + 10.0 * (k % 3) as f64);
        (pose.pan_deg, pose.tilt_deg, pose.roll_deg) = (pan_deg, 0.0, 0.0);
        pose.light_deg = pan_deg + light;
        pose.exposures_s = exposure::predict(&rig, &MotorAngles::from_degrees(pose.degrees()));
    }
    small::write_inputs(path, &rig, &plan);
    for arguments in [&ACQUIRE[..], &DEVELOP, &FIT] {
        let (kinds, lines, _) = warned(path, arguments);
        let lines = lines.concat();
        assert!(has(&kinds, "shape") && lines.contains("in one plane"), "{arguments:?}: {lines}");
        // The fit is of two lobes, for which 12 poses are enough.
        assert_eq!(has(&kinds, "few_poses"), arguments != FIT, "{arguments:?}: {lines}");
    }
    let few = ["plan", "rig.toml", "--budget", "5", "-o", "few.toml"];
    let (kinds, lines, _) = warned(path, &few);
    assert!(has(&kinds, "few_poses") && lines.concat().contains("5 poses"), "{lines:?}");
}

/// Zarr stores f64 as they are in memory: the file of a chunk can be changed in place where it is not
/// compressed.
fn set_light(store: &Path, pose: usize, place: DVec3) {
    let chunk = store.join("light_position_mm/c/0/0");
    let mut bytes = fs::read(&chunk).unwrap();
    for (axis, value) in place.to_array().into_iter().enumerate() {
        let start = 8 * (3 * pose + axis);
        bytes[start..start + 8].copy_from_slice(&value.to_le_bytes());
    }
    fs::write(&chunk, bytes).unwrap();
}

#[test]
fn spoilt_poses_of_a_measured_store_are_named_and_one_without_a_place_is_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let rig = small::rig(32);
    let plan = small::plan(&rig, 60);
    small::acquire(&path.join("RUN"), &plan, &rig, small::layout(&rig));
    let store = small::develop(&path.join("RUN"));
    let clean = SampledSbrdf::read_zarr(&store).unwrap();
    let sampled = path.join("sampled.zarr");
    clean.write_zarr(&sampled).unwrap();
    let (kinds, lines, _) = warned(path, &FIT);
    assert!(kinds.is_empty(), "{lines:?}");

    // The light of pose 9 stood nearer than is said, at 0.8 of its distance: of that no tag tells.
    let mut nearer = clean.clone();
    let span = 3 * clean.poses.len();
    for texel in 0..clean.texels() {
        nearer.reflectance[texel * span + 27..texel * span + 30].iter_mut().for_each(|f| *f /= 0.64);
    }
    nearer.write_zarr(&sampled).unwrap();
    let (kinds, lines, report) = warned(path, &FIT);
    // Its samples may also be more than noise explains in many texels.
    let place =
        kinds.iter().position(|kind| kind == "outstanding_pose").unwrap_or_else(|| panic!("{lines:?}"));
    assert!(kinds.iter().all(|kind| ["outstanding_pose", "unexplained_texels"].contains(&kind.as_str())));
    assert!(lines[place].contains("pose 9 (") && lines[place].contains("brighter than the fit"), "{lines:?}");
    assert_eq!(report["warnings"][place]["poses"], serde_json::json!([9]));

    // Without a place the pose is left out, and the fit is as good as that of the others.
    let mut without = clean.clone();
    without.poses[9].weight = 0.0;
    without.write_zarr(&sampled).unwrap();
    assert!(warned(path, &FIT).0.is_empty());
    let residuals =
        || SbrdfMap::read_exr(&path.join("material.exr")).unwrap().extra["error.relative"].clone();
    let expected = residuals();
    clean.write_zarr(&sampled).unwrap();
    set_light(&sampled, 9, DVec3::NAN);
    let (kinds, lines, _) = warned(path, &FIT);
    assert_eq!(kinds, ["unknown_pose"], "{lines:?}");
    assert!(lines[0].starts_with("pose 9 is left out"), "{lines:?}");
    let found = residuals();
    let off = expected.iter().zip(&found).filter(|(a, b)| (*a - *b).abs() > 1e-3).count();
    assert!(100 * off <= found.len(), "{off} of {} texels are fitted otherwise", found.len());
}

/// Photographs that are all shifted against each other by another distance: nothing but the residual tells.
#[test]
fn photographs_that_do_not_fit_together_leave_texels_that_noise_does_not_explain() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let rig = small::rig(32);
    let plan = small::plan(&rig, 60);
    small::acquire(&path.join("RUN"), &plan, &rig, small::layout(&rig));
    let clean = SampledSbrdf::read_zarr(&small::develop(&path.join("RUN"))).unwrap();
    let mut shifted = clean.clone();
    let (side, span) = (clean.width, 3 * clean.poses.len());
    for texel in 0..clean.texels() {
        for pose in 0..clean.poses.len() {
            let move_by = |x: usize, by: usize| (x + by).min(side - 1);
            let (x, y) = (move_by(texel % side, pose % 4), move_by(texel / side, pose / 4 % 4));
            let (from, to) = ((y * side + x) * span + 3 * pose, texel * span + 3 * pose);
            shifted.reflectance[to..to + 3].copy_from_slice(&clean.reflectance[from..from + 3]);
        }
    }
    shifted.write_zarr(&path.join("sampled.zarr")).unwrap();
    let (kinds, lines, report) = warned(path, &FIT);
    assert!(has(&kinds, "unexplained_texels"), "{lines:?}");
    let of_texels = lines.iter().find(|line| line.contains("error.over_noise")).unwrap();
    assert!(of_texels.contains("most in columns"), "{of_texels}");
    assert!(report["figures"]["texels_unexplained"].as_u64().unwrap() > 100);
    let map = SbrdfMap::read_exr(&path.join("material.exr")).unwrap();
    assert_eq!(map.extra["error.over_noise"].len(), side * side);
}
