//! Photographs that are not what the journal says: left out and named, never believed.

#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::fs;
use std::path::Path;

use lobelia::acquire::{self, RunFolder, simulated};
use lobelia::develop::{self, frame};
use lobelia_tests::command::run;
use lobelia_tests::small;

/// A finished run of `poses` poses, all with the same exposures, so that nothing but the photographs tells them apart.
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
    assert!(why[0].contains("pose-00004-0.tiff and frames/pose-00004-1.tiff do not show the same"), "{why:?}");
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
    run(folder.path(), &["develop", "run", "-o", "sampled.zarr"])
        .refuses(2, &["poses 1 to 9, show the pose before theirs", "photograph these poses again"]);
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
