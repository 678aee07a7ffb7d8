//! Photographs that are not what the journal says: left out and named, never believed.

#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::fs;
use std::path::Path;

use lobelia::acquire::{self, RunFolder, simulated};
use lobelia::develop::{self, frame};
use lobelia::reflectance::SbrdfMap;
use lobelia::rig::config::RigConfig;
use lobelia::sampled::SampledSbrdf;
use lobelia_tests::command::{run, succeed};
use lobelia_tests::{folder, small};

/// A finished run of `poses` poses, all with the same exposures, so that nothing but the photographs tells
/// them apart.
fn measured(poses: usize) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let rig = small::rig(8);
    let mut plan = small::plan(&rig, poses);
    plan.poses.iter_mut().for_each(|pose| pose.exposures_s = vec![0.02, 0.2]);
    small::acquire(&folder.path().join("run"), &plan, &rig, small::layout(&rig));
    folder
}

fn photograph(folder: &Path, pose: usize, exposure: usize) -> std::path::PathBuf {
    folder.join(format!("run/frames/pose-{pose:05}-{exposure}.tiff"))
}

/// Puts the photographs of pose `from` where those of pose `to` were.
fn put(folder: &Path, from: usize, to: usize) {
    for exposure in 0..2 {
        fs::copy(photograph(folder, from, exposure), photograph(folder, to, exposure)).unwrap();
    }
}

/// Indices of the poses that are registered, and the sentences for the others.
fn developed(folder: &Path) -> (Vec<usize>, Vec<String>, Option<String>) {
    let developed = develop::run(&folder.join("run")).unwrap();
    let all = developed.registrations.iter().enumerate();
    let (kept, left_out): (Vec<_>, Vec<_>) = all.partition(|(_, found)| found.is_ok());
    for (pose, _) in &left_out {
        assert_eq!(developed.sampled.poses[*pose].weight, 0.0);
        let samples = developed.sampled.samples(0).nth(*pose).unwrap();
        assert!(!samples.is_finite(), "pose {pose} has samples");
    }
    let sentences = left_out.into_iter().map(|(_, found)| found.as_ref().err().unwrap().to_string());
    (kept.into_iter().map(|(pose, _)| pose).collect(), sentences.collect(), developed.common_fault)
}

/// The simulator knows which pose each photograph is of.
#[test]
fn a_photograph_of_another_pose_is_left_out_and_named() {
    let folder = measured(8);
    assert_eq!(developed(folder.path()).0.len(), 8, "all are right at first");
    put(folder.path(), 3, 4);
    let (kept, why, common) = developed(folder.path());
    assert_eq!(kept, [0, 1, 2, 3, 5, 6, 7]);
    assert!(why[0].contains("from where the motors had it") && why[0].contains("they fit pose 3"), "{why:?}");
    assert_eq!(common, None);
}

#[test]
fn one_exposure_of_another_pose_in_a_bracket_is_noticed() {
    let folder = measured(8);
    fs::copy(photograph(folder.path(), 3, 1), photograph(folder.path(), 4, 1)).unwrap();
    let (kept, why, _) = developed(folder.path());
    assert_eq!(kept, [0, 1, 2, 3, 5, 6, 7]);
    assert!(
        why[0].contains("pose-00004-0.tiff and frames/pose-00004-1.tiff do not show the same"),
        "{why:?}"
    );
}

#[test]
fn a_run_that_is_one_pose_late_is_refused_and_told_so_and_one_that_becomes_so_keeps_its_beginning() {
    let folder = measured(10);
    for pose in (7..10).rev() {
        put(folder.path(), pose - 1, pose);
    }
    let (kept, why, common) = developed(folder.path());
    assert_eq!(kept, [0, 1, 2, 3, 4, 5, 6]);
    assert!(why[2].contains("they fit pose 8"), "{why:?}");
    let common = common.unwrap();
    assert!(common.contains("of poses 7 to 9, show the pose before theirs"), "{common}");
    for pose in (1..7).rev() {
        put(folder.path(), pose - 1, pose);
    }
    // Poses 7 to 9 are one late, poses 1 to 6 are now, and pose 0 is right by itself.
    let said = run(folder.path(), &["develop", "run", "-o", "sampled.zarr"]);
    said.refuses(2, &["poses 1 to 9, show the pose before theirs", "photograph these poses again"]);
    assert!(!said.stderr.contains(['\\', '\t']) && !said.stderr.contains("  "), "{}", said.stderr);
    assert!(!folder.path().join("sampled.zarr").exists());
}

/// The simulator's truth: a frame without light is the black level and little more, whatever burnt before.
#[test]
fn a_lamp_that_an_earlier_program_left_burning_does_not_light_the_dark_frames() {
    let folder = tempfile::tempdir().unwrap();
    let rig = small::rig(8);
    let plan = small::plan(&rig, 2);
    let path = folder.path().join("run");
    let (run, mut journal) = RunFolder::create(&path, &plan, &rig).unwrap();
    let mut station = simulated::station(&rig, small::layout(&rig)).unwrap();
    station.client.configure(&rig.configuration().unwrap()).unwrap();
    station.client.lamp(true, 1.0).unwrap();
    station.client.wait_until_warm(|_| ()).unwrap();
    acquire::run(&run, &mut journal, &mut station).unwrap();
    for file in ["dark-00", "dark-03"] {
        let frame = frame::read(&path.join(format!("frames/{file}.tiff"))).unwrap();
        let mean = frame.values.iter().map(|&v| f64::from(v)).sum::<f64>() / frame.values.len() as f64;
        let dark = rig.camera.black_level
            + frame.exposure_s * rig.simulator.dark_e_s / rig.simulator.electrons_per_value;
        assert!((mean - dark).abs() < 0.5, "{file}: {mean}, {dark} without light");
    }
    small::develop(&path);
}

#[test]
fn dark_frames_that_were_lit_by_the_lamp_are_refused_by_name() {
    let folder = measured(2);
    let journal = folder.path().join("run/journal.jsonl");
    let text = fs::read_to_string(&journal).unwrap();
    let lines: Vec<String> = text
        .lines()
        .map(|line| {
            let mut record: serde_json::Value = serde_json::from_str(line).unwrap();
            if record["record"] == "dark" && record["index"] == 4 {
                record["exposure"]["lamp_reading"] = 1500.0.into();
            }
            record.to_string() + "\n"
        })
        .collect();
    fs::write(&journal, lines.concat()).unwrap();
    run(folder.path(), &["develop", "run", "-o", "sampled.zarr"])
        .refuses(2, &["dark-04.tiff", "the lamp burnt", "0.500 of its warm light"]);
}

/// The kinds and the poses of a report's warnings.
fn warnings(report: &Path) -> Vec<(String, Vec<u64>)> {
    let report: serde_json::Value = serde_json::from_slice(&fs::read(report).unwrap()).unwrap();
    let poses = |warning: &serde_json::Value| {
        let poses = warning["poses"].as_array().cloned().unwrap_or_default();
        poses.iter().filter_map(serde_json::Value::as_u64).collect()
    };
    let all = report["warnings"].as_array().unwrap();
    all.iter().map(|warning| (warning["kind"].as_str().unwrap().to_string(), poses(warning))).collect()
}

#[test]
fn what_is_left_out_is_a_warning_that_a_quiet_report_has_too_in_develop_and_in_compare() {
    let folder = measured(8);
    let path = folder.path();
    put(path, 3, 4);
    SbrdfMap::new(8, 8, 1).write_exr(&path.join("m.exr")).unwrap();
    for command in [&["develop", "run", "-o", "s.zarr"][..], &["compare", "run", "m.exr"]] {
        let said = run(path, &[command, &["--report", "told.json"]].concat());
        assert_eq!(said.code, Some(0), "{said:?}");
        assert!(said.stderr.contains("warning: pose 4 is left out: the tags show"), "{}", said.stderr);
        succeed(path, &[command, &["--quiet", "--report", "quiet.json"]].concat());
        for report in ["told.json", "quiet.json"] {
            let left_out: Vec<_> =
                warnings(&path.join(report)).into_iter().filter(|w| w.0 == "left_out").collect();
            assert_eq!(left_out, [("left_out".to_string(), vec![4])], "{command:?} {report}");
        }
    }
    assert!(
        fs::read_to_string(path.join("compare/compare.html"))
            .unwrap()
            .contains("pose 4</td><td>the tags show")
    );
    // What was asked for is none.
    succeed(path, &["develop", "run", "-o", "s.zarr", "--skip-pose", "4", "--report", "asked.json"]);
    assert!(warnings(&path.join("asked.json")).iter().all(|(kind, _)| kind != "left_out"));
    for pose in (1..8).rev() {
        put(path, pose - 1, pose);
    }
    run(path, &["compare", "run", "m.exr"]).refuses(2, &["show the pose before theirs"]);
    run(path, &["develop", "run", "-o", "no.zarr", "--skip-pose", "0-7"])
        .refuses(2, &["all poses are left out"]);
}

/// The run's own plan and rig are those in its folder.
#[test]
fn a_run_goes_on_by_no_other_plan_and_rig_than_its_own() {
    let folder = measured(2);
    let path = folder.path();
    let rig = fs::read_to_string(path.join("run/rig.toml")).unwrap();
    fs::write(path.join("other.toml"), rig.replacen("read_noise_e = 6", "read_noise_e = 7", 1)).unwrap();
    let resume = |more: &[&str]| {
        let resume = ["acquire", "--resume", "--port", "sim", "--camera", "sim", "-o", "run"];
        run(path, &[&resume[..], more].concat())
    };
    assert_eq!(resume(&["run/plan.toml", "--rig", "run/rig.toml"]).code, Some(0));
    resume(&["--seed", "77"]).refuses(2, &["--seed is 77, but the run's is"]);
    resume(&["--rig", "other.toml"]).refuses(2, &["other.toml: not the rig of the run"]);
    let other = small::plan(&small::rig(8), 3);
    other.write(&path.join("three.toml")).unwrap();
    resume(&["three.toml"]).refuses(2, &["three.toml: not the plan of the run"]);
}

/// What the controller refuses is told where the rig's file is read first.
#[test]
fn a_rig_that_the_controller_refuses_is_not_planned_for() {
    let folder = tempfile::tempdir().unwrap();
    let mut rig = small::rig(8);
    small::write_inputs(folder.path(), &rig, &small::plan(&rig, 2));
    succeed(folder.path(), &["plan", "rig.toml", "--budget", "2"]);
    rig.axes.pan.take_up_deg = 5.5;
    fs::write(folder.path().join("rig.toml"), toml::to_string(&rig).unwrap()).unwrap();
    run(folder.path(), &["plan", "rig.toml", "--budget", "2"])
        .refuses(2, &["rig.toml: the rig's controller refuses the home position of pan"]);
}

/// From a third of the highest speed the axis would need 10° to stop, and 8° behind the switch's edge it
/// cannot go on.
#[test]
fn a_rig_that_brakes_softly_loses_no_steps_when_it_looks_for_its_switches() {
    let folder = tempfile::tempdir().unwrap();
    let mut rig = small::rig(8);
    rig.axes.pan.acceleration_deg_s2 = 20.0;
    let plan = small::plan(&rig, 2);
    small::acquire(&folder.path().join("run"), &plan, &rig, small::layout(&rig));
    assert!(RunFolder::open(&folder.path().join("run")).unwrap().finished());
}

/// Stands for exposures that are all the same, by which nothing is told apart.
const ANY_EXPOSURE: [&str; 2] = ["--set", "camera.exif=\"ignore\""];

fn dark_frame(folder: &Path, index: usize) -> std::path::PathBuf {
    folder.join(format!("run/frames/dark-{index:02}.tiff"))
}

/// A camera that is one photograph early gives the first of the poses for the last dark frame.
#[test]
fn a_photograph_in_a_dark_frames_place_is_refused_by_name_and_left_out_where_that_is_allowed() {
    let folder = measured(3);
    let path = folder.path();
    let last = (0..).take_while(|index| dark_frame(path, *index).exists()).last().unwrap();
    let develop = |store: &str, more: &[&str]| {
        run(path, &[&["develop", "run", "-o", store][..], &ANY_EXPOSURE, more].concat())
    };
    assert_eq!(develop("right.zarr", &[]).code, Some(0));
    for (dark, exposure) in [(0, 0), (0, 1), (last, 0), (last, 1)] {
        let own = fs::read(dark_frame(path, dark)).unwrap();
        fs::copy(photograph(path, 0, exposure), dark_frame(path, dark)).unwrap();
        let name = format!("dark-{dark:02}.tiff");
        develop("no.zarr", &[]).refuses(2, &[&name, "--partial leaves it out"]);
        let partial = develop("part.zarr", &["--partial"]);
        assert_eq!(partial.code, Some(0), "{}", partial.stderr);
        assert!(partial.stderr.contains(&name), "{}", partial.stderr);
        fs::write(dark_frame(path, dark), own).unwrap();
        // The other dark frames say the same, within their noise.
        let [right, part] =
            ["right.zarr", "part.zarr"].map(|name| SampledSbrdf::read_zarr(&path.join(name)).unwrap());
        for (a, b) in right.reflectance.iter().zip(&part.reflectance) {
            let same = (a - b).abs() < 0.02 * a.abs() + 2e-3 || (a.is_nan() && b.is_nan());
            assert!(same, "{name}: {a} {b}");
        }
    }
}

/// With two exposures a pose: one late, a pose's first shows what was before it, and its second the first.
#[test]
fn a_run_that_is_one_photograph_late_is_refused_and_told_so_and_a_single_such_pose_is_left_out() {
    let folder = measured(6);
    let path = folder.path();
    let last = (0..).take_while(|index| dark_frame(path, *index).exists()).last().unwrap();
    let mut frames = vec![dark_frame(path, last)];
    frames.extend((0..6).flat_map(|pose| [0, 1].map(|exposure| photograph(path, pose, exposure))));
    let late = |count: usize| {
        for place in (1..count).rev() {
            fs::copy(&frames[place - 1], &frames[place]).unwrap();
        }
    };
    // Darkness for the short exposure of pose 0, and that one for the long exposure.
    late(3);
    let develop = [&["develop", "run", "-o", "sampled.zarr"][..], &ANY_EXPOSURE].concat();
    let said = run(path, &develop);
    assert_eq!(said.code, Some(0), "{}", said.stderr);
    assert!(said.stdout.contains("5 of 6 poses registered"), "{}", said.stdout);
    assert!(said.stderr.contains("pose 0 is left out: frames/pose-00000-0.tiff and"), "{}", said.stderr);
    fs::remove_dir_all(path.join("sampled.zarr")).unwrap();
    late(frames.len());
    run(path, &develop)
        .refuses(2, &["the first show the pose before theirs", "photograph these poses again"]);
    assert!(!path.join("sampled.zarr").exists());
}

/// The same photographs by another lens: the store says by which, texels and region are those asked for, and
/// a part is the whole's.
#[test]
fn a_run_is_developed_again_by_other_settings_which_the_store_keeps_beside_the_runs_own() {
    let folder = measured(4);
    let path = folder.path();
    let develop = |more: &[&str]| succeed(path, &[&["develop", "run", "--quiet", "-o"], more].concat());
    develop(&["whole.zarr"]);
    develop(&["fine.zarr", "--set", "carrier.texels_across=32", "--set", "camera.focal_px=[2030, 2031]"]);
    let fine = SampledSbrdf::read_zarr(&path.join("fine.zarr")).unwrap();
    assert_eq!((fine.width, fine.height, fine.texel_mm), (32, 32, 2.0));
    let root: serde_json::Value =
        serde_json::from_slice(&fs::read(path.join("fine.zarr/zarr.json")).unwrap()).unwrap();
    let by: RigConfig =
        toml::from_str(root["attributes"]["developed_by_rig_toml"].as_str().unwrap()).unwrap();
    assert_eq!((by.carrier.texels_across, by.camera.focal_px), (32, [2030.0, 2031.0]));
    let own = fs::read_to_string(path.join("run/rig.toml")).unwrap();
    assert_eq!(root["attributes"]["run_rig_toml"].as_str().unwrap(), own);

    // What was developed otherwise is compared otherwise.
    SbrdfMap::new(32, 32, 1).write_exr(&path.join("fine.exr")).unwrap();
    run(path, &["compare", "run", "fine.exr"]).refuses(2, &["32 × 32", "8 × 8", "--set"]);
    succeed(path, &["compare", "run", "fine.exr", "--set", "carrier.texels_across=32"]);

    for (region, says) in [("2,1,4,30", "goes beyond the sample's 8 × 8"), ("2,1,0,3", "is empty")] {
        run(path, &["develop", "run", "-o", "no.zarr", "--region", region]).refuses(2, &[says]);
    }
    develop(&["part.zarr", "--region", "2,1,4,3"]);
    let [whole, part] =
        ["whole.zarr", "part.zarr"].map(|name| SampledSbrdf::read_zarr(&path.join(name)).unwrap());
    assert_eq!((part.width, part.height), (4, 3));
    for (texel, of_whole) in [(0, 8 + 2), (3, 8 + 5), (11, 3 * 8 + 5)] {
        assert_eq!(part.position_mm(texel), whole.position_mm(of_whole));
        assert!(
            part.values(texel).iter().zip(whole.values(of_whole)).all(|(a, b)| a.to_bits() == b.to_bits())
        );
    }

    // A rig that was changed after the run is taken when it is named, and only then.
    fs::write(path.join("run/rig.toml"), own.replacen("read_noise_e = 6", "read_noise_e = 7", 1)).unwrap();
    run(path, &["develop", "run", "-o", "no.zarr"]).refuses(2, &["run/rig.toml", "changed", "--rig"]);
    run(path, &["develop", "run", "-o", "no.zarr", "--set", "carrier.texels_across=4"])
        .refuses(2, &["changed"]);
    develop(&["named.zarr", "--rig", "run/rig.toml"]);
    SbrdfMap::new(8, 8, 1).write_exr(&path.join("m.exr")).unwrap();
    run(path, &["compare", "run", "m.exr"]).refuses(2, &["run/rig.toml", "changed", "--rig"]);
    succeed(path, &["compare", "run", "m.exr", "--rig", "run/rig.toml"]);
    run(path, &["develop", "run", "-o", "no.zarr", "--rig", "run/rig.toml", "--set", "camera.width=0"])
        .refuses(2, &["--set camera.width=0", "camera.width"]);
    run(path, &["develop", "run", "-o", "no.zarr", "--rig", "run/plan.toml"])
        .refuses(2, &["this is a plan, but a rig is needed here"]);
}

/// Poses keep their numbers whatever is missing.
#[test]
fn what_is_there_of_a_run_is_developed_and_what_is_not_is_named() {
    let folder = measured(6);
    let path = folder.path();
    let whole = {
        succeed(path, &["develop", "run", "-o", "whole.zarr"]);
        SampledSbrdf::read_zarr(&path.join("whole.zarr")).unwrap()
    };
    let journal = path.join("run/journal.jsonl");
    let text = fs::read_to_string(&journal).unwrap();
    fs::write(&journal, folder::before_last_pose(&text)).unwrap();
    fs::write(photograph(path, 1, 1), b"damaged").unwrap();
    let develop = ["develop", "run", "-o", "part.zarr"];
    run(path, &develop).refuses(2, &["1 of 6 poses", "--partial"]);
    let said = run(path, &[&develop[..], &["--partial", "--skip-pose", "3"]].concat());
    assert_eq!(said.code, Some(0), "{said:?}");
    for part in [
        "pose 3 is left out: it was asked for",
        "pose 5 is left out: it is not photographed yet",
        "pose-00001-1.tiff",
    ] {
        assert!(said.stderr.contains(part), "{part}: {}", said.stderr);
    }
    let part = SampledSbrdf::read_zarr(&path.join("part.zarr")).unwrap();
    let weights: Vec<f64> = part.poses.iter().map(|pose| pose.weight).collect();
    assert_eq!(weights, [1.0, 1.0, 1.0, 0.0, 1.0, 0.0]);
    let bits = |sampled: &SampledSbrdf, pose: usize| {
        sampled.samples(20).nth(pose).unwrap().to_array().map(f32::to_bits)
    };
    let same = |pose: usize| bits(&part, pose) == bits(&whole, pose);
    assert!(same(0) && same(2) && same(4), "poses that are whole are as they were");
    assert!(!same(1) && part.samples(20).nth(1).unwrap().is_finite(), "one exposure is enough for pose 1");

    // Without leave to leave out, a damaged frame ends it, and says what would help.
    fs::write(&journal, &text).unwrap();
    run(path, &develop).refuses(2, &["pose 1", "pose-00001-1.tiff", "--skip-pose 1"]);
    succeed(path, &[&develop[..], &["--skip-pose", "1", "--quiet"]].concat());
    run(path, &[&develop[..], &["--skip-pose", "4-9"]].concat()).refuses(2, &["pose 6 is not in the plan"]);
}

/// Killed between its last photograph and its last look at the home switches, which alone tells of steps that
/// the light's arm lost.
#[test]
fn a_run_whose_last_check_is_still_to_come_is_not_taken_for_a_finished_one() {
    let folder = measured(2);
    let path = folder.path();
    let journal = path.join("run/journal.jsonl");
    let text = fs::read_to_string(&journal).unwrap();
    let place = text.find("{\"record\":\"checked\"").unwrap();
    fs::write(&journal, &text[..place]).unwrap();
    let develop = ["develop", "run", "-o", "s.zarr"];
    run(path, &develop).refuses(2, &["not that the run ended", "--resume", "--partial"]);
    succeed(path, &[&develop[..], &["--partial"]].concat());
    succeed(path, &["acquire", "--resume", "--port", "sim", "--camera", "sim", "-o", "run"]);
    succeed(path, &develop);
}
