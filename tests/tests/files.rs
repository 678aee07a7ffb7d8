//! What people hand in, through the command: odd tables and names, sizes that no machine holds, and what a
//! file says of how it was made.

#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::fs;
use std::path::{Path, PathBuf};

use lobelia::reflectance::SbrdfMap;
use lobelia_tests::command::{executable, lobelia, root, run, said, succeed};
use lobelia_tests::folder;
use serde_json::Value;

fn case(name: &str) -> PathBuf {
    root().join("tests/cases").join(name)
}

/// Tables of one row, of equal rows, of zeros, at the horizon, in degrees, with commas: finite numbers or one
/// sentence.
#[test]
fn degenerate_tables_give_finite_fits_or_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let (mut fitted, mut refused) = (0, 0);
    for file in folder::listing(&case("text")) {
        let name = file.to_string_lossy().into_owned();
        fs::copy(case("text").join(&file), folder.path().join(&name)).unwrap();
        if !name.ends_with(".brdf") {
            continue;
        }
        let said = run(folder.path(), &["fit", &name, "--lobes", "1", "--model", "lobes"]);
        match said.code {
            Some(0) => {
                let numbers = said.stdout.split_whitespace().filter_map(|word| word.parse::<f64>().ok());
                assert!(numbers.into_iter().all(f64::is_finite), "{name}: {}", said.stdout);
                fitted += 1;
            }
            _ => {
                said.refuses(2, &[&name]);
                refused += 1;
            }
        }
    }
    assert!(fitted >= 1 && refused >= 4, "{fitted} fitted, {refused} refused");
}

#[test]
fn endings_in_capitals_say_what_a_file_is() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    fs::copy(case("text/comment-first.dat"), path.join("PAINT.DAT")).unwrap();
    let fit = ["fit", "PAINT.DAT", "--lobes", "1", "--model", "lobes", "-o", "PAINT.EXR"];
    succeed(path, &fit);
    succeed(path, &["edit", "mean", "PAINT.EXR", "-o", "MEAN.EXR"]);
    SbrdfMap::read_exr(&path.join("MEAN.EXR")).unwrap();
}

#[test]
fn what_no_machine_holds_is_refused_in_one_sentence_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    for (arguments, parts) in [
        (&["synth", "clay", "--size", "100000x100000"][..], &["100000 × 100000 texels", "GiB"][..]),
        (&["synth", "clay", "--poses", "18446744073709551615"], &["18446744073709551615 poses"]),
        (&["synth", "clay", "--threads", "100000"], &["--threads is 100000", "1 to 1024"]),
        (&["render", "lamps", "-o", "a.png", "--width", "100000"], &["100000", "16384"]),
        (&["render", "lamps", "-o", "a.png", "--max-error", "nan"], &["--max-error is nan"]),
        (&["rig", "move", "--port", "sim", "--pan-deg", "inf"], &["--pan-deg is inf"]),
    ] {
        run(folder.path(), arguments).refuses(2, parts);
    }
    assert!(folder::listing(folder.path()).is_empty());
}

#[test]
fn arguments_in_the_wrong_place_are_named_for_what_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    fs::create_dir(path.join("run")).unwrap();
    fs::copy(case("map/negative-n.exr"), path.join("m.exr")).unwrap();
    run(path, &["compare", "m.exr", "run"]).refuses(2, &["the run comes first", "RUN MAP.exr"]);
    run(path, &["render", "m.exr", "-o", "a.png"])
        .refuses(2, &["m.exr: an SBRDF map or a picture, not a scene"]);
    run(path, &["fit", "gone.zarr", "-o", "a.exr"]).refuses(2, &["gone.zarr: there is no such store"]);
    folder::copy(&case("zarr/width0.zarr"), &path.join("empty.zarr"));
    run(path, &["fit", "empty.zarr", "-o", "a.exr"]).refuses(2, &["empty.zarr", "a texel at least"]);
    let said = run(path, &["fit", "m.brdf"]);
    assert_eq!(said.stderr.matches("m.brdf").count(), 1, "the file is named once: {}", said.stderr);
}

/// Batch systems limit a process's addresses; an allocation beyond them ends it.
#[cfg(target_os = "linux")]
#[test]
fn what_a_batch_system_does_not_allow_is_refused_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    let limited = "ulimit -v 4000000; exec \"$0\" render lamps -o a.png --width 16384 --height 16384";
    let mut command = std::process::Command::new("sh");
    command.arg("-c").arg(limited).arg(executable()).current_dir(folder.path());
    said(command.output().unwrap()).refuses(2, &["16384 × 16384 pixels needs", "GiB", "--width less"]);
}

/// What each is, not what a parser stumbles over in it; numbers as they were written.
#[test]
fn sentences_name_the_mistake() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    fs::create_dir_all(path.join("run/frames")).unwrap();
    fs::write(path.join("run/journal.jsonl"), "").unwrap();
    succeed(path, &["synth", "clay", "--size", "4x4", "--poses", "30", "-o", "s.zarr"]);
    SbrdfMap::new(4, 4, 1).write_exr(&path.join("m.exr")).unwrap();
    fs::copy(case("text/comment-first.dat"), path.join("t.dat")).unwrap();
    let rig = succeed(path, &["template", "rig"]);
    fs::write(path.join("rig.toml"), &rig).unwrap();
    fs::write(path.join("latin.toml"), b"# \xe4\n").unwrap();
    fs::write(path.join("late.toml"), rig.replacen("max_exposure_s = 2.0", "max_exposure_s = 61.0", 1))
        .unwrap();
    succeed(path, &["plan", "rig.toml", "--budget", "2", "-o", "plan.toml"]);
    for (line, parts) in [
        ("develop gone -o a.zarr", &["gone: there is no such run"][..]),
        ("develop s.zarr -o a.zarr", &["s.zarr: a sampled SBRDF, not a run"]),
        ("develop m.exr -o a.zarr", &["m.exr: an SBRDF map or a picture, not a run"]),
        ("compare rig.toml m.exr", &["rig.toml: a file, not a run's folder"]),
        ("compare run s.zarr", &["s.zarr: a sampled SBRDF, not an SBRDF map", "fit it first"]),
        ("render rig.toml -o a.png", &["this is a rig, but a scene is needed"]),
        ("render plan.toml -o a.png", &["this is a plan, but a scene is needed"]),
        ("render run -o a.png", &["run: a run, not a scene"]),
        ("plan m.exr --budget 4", &["m.exr: an SBRDF map or a picture, not a text in UTF-8"]),
        ("plan latin.toml --budget 4", &["latin.toml: not a text in UTF-8; save it as one"]),
        ("plan late.toml --budget 4", &["camera.max_exposure_s is 61, must lie in 0.0001 to 60"]),
        ("plan rig.toml --budget 4 -o rig.toml", &["rig.toml: read as RIG", "written over by --output"]),
        ("fit run -o a.exr", &["run: a run; develop it first"]),
        ("fit --merge s.zarr -o a.exr", &["--merge names no shard"]),
        ("fit t.dat --robust", &["--robust is for sampled SBRDFs"]),
        ("fit s.zarr --wavelengths-nm 550 -o a.exr", &["--wavelengths-nm is for measured tables"]),
        ("rig expose 0.00005 --dark --port sim", &["0.00005 s is not between 0.0001 and 60 s"]),
        ("rig monitor --port sim --for-s -3", &["--for-s is -3, must be 0 to"]),
        ("rig monitor --port sim --telemetry-s 0.001", &["--telemetry-s is 0.001, must be 0.02 to"]),
        ("acquire plan.toml --rig rig.toml --port sim --camera foo -o new", &["--camera foo is not known"]),
        ("acquire plan.toml --rig rig.toml --port= --camera watch:run -o new", &["--port is empty"]),
    ] {
        run(path, &line.split(' ').collect::<Vec<_>>()).refuses(2, parts);
    }
    assert_eq!(
        fs::read_to_string(path.join("rig.toml")).unwrap(),
        rig,
        "what was measured by is still there"
    );
}

/// The attribute of a map.
fn attribute(path: &Path, name: &str) -> Option<String> {
    SbrdfMap::read_exr(path).unwrap().attributes.remove(name)
}

#[test]
fn maps_stores_and_reports_say_what_made_them_and_the_same_inputs_give_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let synth = ["synth", "clay", "--size", "20x4", "--poses", "40", "-o"];
    succeed(path, &[&synth[..], &["s.zarr"]].concat());
    succeed(path, &[&synth[..], &["other/t.zarr", "--threads", "1"]].concat());
    folder::assert_same(&path.join("s.zarr"), &path.join("other/t.zarr"), "a store of another name");
    let root: Value = serde_json::from_slice(&fs::read(path.join("s.zarr/zarr.json")).unwrap()).unwrap();
    assert_eq!(root["attributes"]["made.command"], "lobelia synth clay --size 20x4 --poses 40");

    let fit = ["fit", "s.zarr", "--lobes", "1", "--report", "r.json", "-o"];
    succeed(path, &[&fit[..], &["a.exr"]].concat());
    succeed(path, &[&fit[..], &["maps/b.exr", "--threads", "1", "-q"]].concat());
    assert!(fs::read(path.join("a.exr")).unwrap() == fs::read(path.join("maps/b.exr")).unwrap());
    let of = |file: &str, name: &str| attribute(&path.join(file), name).unwrap();
    assert_eq!(of("a.exr", "made.command"), "lobelia fit s.zarr --lobes 1");
    assert!(of("a.exr", "made.by").starts_with("lobelia "));
    assert!(of("a.exr", "made.inputs").starts_with("s.zarr sha256 "));
    assert_eq!(attribute(&path.join("a.exr"), "made.date"), None);

    let report: Value = serde_json::from_slice(&fs::read(path.join("r.json")).unwrap()).unwrap();
    assert!(report["date"].as_str().unwrap().ends_with('Z'), "{report}");
    let hash = report["inputs"][0]["sha256"].as_str().unwrap();
    assert_eq!(of("a.exr", "made.inputs"), format!("s.zarr sha256 {hash}"));

    // An edit says what made it, and keeps the notes of the edits before; a date is there where one is given.
    let mut command = lobelia(path, &["edit", "mean", "a.exr", "-o", "mean.exr"]);
    let mean = said(command.env("SOURCE_DATE_EPOCH", "951782399").output().unwrap());
    assert_eq!(mean.code, Some(0), "{}", mean.stderr);
    assert_eq!(of("mean.exr", "made.date"), "2000-02-28T23:59:59Z");
    assert_eq!(of("mean.exr", "made.command"), "lobelia edit mean a.exr");
    let hash = of("mean.exr", "edit.1").rsplit(' ').next().unwrap().to_string();
    assert_eq!(of("mean.exr", "made.inputs"), format!("a.exr sha256 {hash}"));
    // The date of the map before is not this one's.
    succeed(path, &["edit", "mean", "mean.exr", "-o", "again.exr"]);
    assert_eq!(attribute(&path.join("again.exr"), "made.date"), None);
    assert_eq!(of("again.exr", "made.command"), "lobelia edit mean mean.exr");
}

/// With a driver's software device or without any: nobody is told of a folder of the session.
#[test]
fn opening_a_gpu_without_a_session_makes_no_noise() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["render", "lamps", "-o", "a.png", "--width", "16", "--samples", "1"];
    let mut command = lobelia(folder.path(), &arguments);
    let said = said(command.env_remove("XDG_RUNTIME_DIR").output().unwrap());
    assert_eq!(said.code, Some(0), "{}", said.stderr);
    assert!(!said.stderr.contains("XDG_RUNTIME_DIR"), "{}", said.stderr);
}
