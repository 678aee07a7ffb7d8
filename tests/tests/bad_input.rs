//! Bad input and failures through the command: the exit code, one sentence that says where, and nothing
//! half-written.

#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::fs;
use std::path::Path;

use lobelia::reflectance::SbrdfMap;
use lobelia::rig::config::RigConfig;
use lobelia_tests::command::{Said, root, run, succeed};
use lobelia_tests::{folder, small};

const SIMULATED: [&str; 4] = ["--port", "sim", "--camera", "sim"];

/// A folder with a small rig and a plan of two poses.
fn inputs() -> (tempfile::TempDir, RigConfig) {
    let folder = tempfile::tempdir().unwrap();
    let rig = small::rig(8);
    small::write_inputs(folder.path(), &rig, &small::plan(&rig, 2));
    (folder, rig)
}

/// The same with a finished run in `run`.
fn finished_run() -> tempfile::TempDir {
    let (folder, rig) = inputs();
    small::acquire(&folder.path().join("run"), &small::plan(&rig, 2), &rig, small::layout(&rig));
    folder
}

fn acquire(folder: &Path, more: &[&str]) -> Said {
    run(folder, &[&["acquire", "plan.toml", "--rig", "rig.toml", "-o", "run"], more].concat())
}

/// Runs a command that must be refused and leave the folder as it is.
fn refused(folder: &Path, arguments: &[&str], code: i32, parts: &[&str]) {
    let before = folder::listing(folder);
    run(folder, arguments).refuses(code, parts);
    assert_eq!(folder::listing(folder), before, "{arguments:?} left something behind");
}

/// Replaces the first `old` in a file.
fn edit(path: &Path, old: &str, new: &str) {
    let text = fs::read_to_string(path).unwrap();
    assert!(text.contains(old), "{} has no `{old}`", path.display());
    fs::write(path, text.replacen(old, new, 1)).unwrap();
}

/// `NAME, line N` of the first line that holds `text`.
fn place(folder: &Path, name: &str, text: &str) -> String {
    let content = fs::read_to_string(folder.join(name)).unwrap();
    let line = content.lines().position(|line| line.contains(text)).unwrap();
    format!("{name}, line {}", line + 1)
}

#[test]
fn an_unknown_key_of_a_rig_or_a_plan_is_named_with_file_line_and_nearest_key() {
    let (folder, _) = inputs();
    let path = folder.path();
    edit(&path.join("rig.toml"), "warm_up_s = ", "warmup_s = ");
    let here = place(path, "rig.toml", "warmup_s");
    let parts = [&here, "`warmup_s`", "nearest known key is `warm_up_s`"];
    let arguments = [&["acquire", "plan.toml", "--rig", "rig.toml", "-o", "run"], &SIMULATED[..]].concat();
    refused(path, &arguments, 2, &parts);
    refused(path, &["plan", "rig.toml", "--budget", "4", "-o", "new.toml"], 2, &parts);

    edit(&path.join("rig.toml"), "warmup_s = ", "warm_up_s = ");
    edit(&path.join("plan.toml"), "tilt_deg = ", "tild_deg = ");
    let here = place(path, "plan.toml", "tild_deg");
    refused(path, &arguments, 2, &[&here, "`tild_deg`", "nearest known key is `tilt_deg`"]);
}

#[test]
fn a_run_that_lasts_longer_than_the_lamp_may_burn_is_told_by_plan_and_refused_by_acquire() {
    let (folder, mut rig) = inputs();
    let path = folder.path();
    rig.lamp.longest_s = rig.lamp.warm_up_s;
    fs::write(path.join("rig.toml"), toml::to_string(&rig).unwrap()).unwrap();
    let arguments = [&["acquire", "plan.toml", "--rig", "rig.toml", "-o", "run"], &SIMULATED[..]].concat();
    refused(path, &arguments, 2, &["plan.toml: the lamp has to burn", "raise lamp.longest_s"]);
    let said = run(path, &["plan", "rig.toml", "--budget", "4", "-o", "new.toml"]);
    assert_eq!(said.code, Some(0), "{}", said.stderr);
    assert!(said.stderr.contains("warning: the lamp has to burn"), "{}", said.stderr);
}

#[test]
fn an_unknown_key_of_a_material_or_a_scene_is_named_with_file_line_and_nearest_key() {
    let (folder, _) = inputs();
    let path = folder.path();
    let text = "[pattern]\nkind = \"checks\"\nsize_mm = 4\n\n[[material]]\npublish = \"felt\"\n";
    fs::write(path.join("m.toml"), text).unwrap();
    let arguments = ["acquire", "plan.toml", "--rig", "rig.toml", "-o", "run", "--material", "m.toml"];
    let parts = ["m.toml, line 6", "`publish`", "nearest known key is `published`"];
    refused(path, &[&arguments, &SIMULATED[..]].concat(), 2, &parts);

    let text = "[camera]\nposition = [0, 0, 4]\ntarget = [0, 0, 0]\nfov = 30\nwidth = 8\nheight = 8\n";
    fs::write(path.join("scene.toml"), text).unwrap();
    let parts = ["scene.toml, line 4", "`fov`", "nearest known key is `fov_deg`"];
    refused(path, &["render", "scene.toml", "-o", "out.exr"], 2, &parts);
}

#[test]
fn a_missing_file_is_named_and_nothing_is_begun() {
    let (folder, _) = inputs();
    let path = folder.path();
    let rest = ["--rig", "rig.toml", "-o", "run"];
    refused(path, &[&["acquire", "gone.toml"], &rest[..], &SIMULATED].concat(), 2, &["gone.toml"]);
    let rest = ["--rig", "gone.toml", "-o", "run"];
    refused(path, &[&["acquire", "plan.toml"], &rest[..], &SIMULATED].concat(), 2, &["gone.toml"]);
    let resume = [&["acquire", "--resume", "-o", "run"], &SIMULATED[..]].concat();
    refused(path, &resume, 2, &["no run to resume", "run: there is no such run"]);
    refused(path, &["develop", "gone", "-o", "sampled.zarr"], 2, &["gone: there is no such run"]);
    refused(path, &["fit", "gone.brdf"], 2, &["gone.brdf"]);
    refused(path, &["fit", "gone.zarr", "-o", "material.exr"], 2, &["gone.zarr"]);
    refused(path, &["render", "gone.toml", "-o", "out.exr"], 2, &["gone.toml"]);
}

#[test]
fn a_pose_outside_the_limits_is_named() {
    let (folder, rig) = inputs();
    let mut plan = small::plan(&rig, 2);
    plan.poses[1].light_deg = 176.0;
    plan.write(&folder.path().join("plan.toml")).unwrap();
    let arguments = [&["acquire", "plan.toml", "--rig", "rig.toml", "-o", "run"], &SIMULATED[..]].concat();
    refused(folder.path(), &arguments, 2, &["plan.toml", "pose 1", "light", "176", "175"]);
}

#[test]
fn a_folder_that_holds_a_run_is_left_alone() {
    let folder = finished_run();
    let before = folder::contents(folder.path());
    acquire(folder.path(), &SIMULATED).refuses(2, &["run: a run was recorded here already", "--resume"]);
    assert!(folder::contents(folder.path()) == before, "the run was changed");
    fs::write(folder.path().join("notes.txt"), "mine").unwrap();
    // The folder looks like a demo's, and its owner would lose a measurement.
    refused(folder.path(), &["demo", "--out", "."], 2, &["--out"]);
}

#[test]
fn a_run_whose_rig_was_changed_meanwhile_is_refused() {
    let folder = finished_run();
    edit(&folder.path().join("run/rig.toml"), "light_radius_mm = 1000", "light_radius_mm = 1001");
    refused(folder.path(), &["develop", "run", "-o", "s.zarr"], 2, &["run/rig.toml", "changed"]);
}

#[test]
fn a_port_that_does_not_exist_is_named_and_no_run_begun() {
    let (folder, _) = inputs();
    fs::create_dir(folder.path().join("photos")).unwrap();
    let with = |port: &'static str| {
        ["acquire", "plan.toml", "--rig", "rig.toml", "-o", "run", "--camera", "watch:photos", "--port", port]
    };
    refused(folder.path(), &with("/dev/no-such-port"), 2, &["/dev/no-such-port"]);
    // Nothing listens on port 1 of a machine that runs tests.
    refused(folder.path(), &with("tcp://127.0.0.1:1"), 1, &["tcp://127.0.0.1:1"]);
    refused(folder.path(), &with("tcp://nowhere"), 2, &["tcp://nowhere"]);
    refused(folder.path(), &with("sim"), 2, &["--camera sim"]);
}

#[test]
fn a_damaged_frame_is_named_with_its_pose_and_no_store_is_written() {
    let folder = finished_run();
    let path = folder.path();
    let frame = path.join("run/frames/pose-00001-1.tiff");
    let whole = fs::read(&frame).unwrap();
    let develop = ["develop", "run", "-o", "sampled.zarr"];
    let named = ["pose 1", "pose-00001-1.tiff"];
    let refuse = |bytes: &[u8], parts: &[&str]| {
        fs::write(&frame, bytes).unwrap();
        refused(path, &develop, 2, &[&named[..], parts].concat());
    };
    for length in [0, 7, whole.len() / 2, whole.len() - 1] {
        refuse(&whole[..length], &["truncated"]);
    }
    refuse(b"\xff\xd8\xff\xe0\x00\x10JFIF\0 and so on", &["JPEG", "not linear"]);
    refuse(&frame_of(200, 150), &["200 × 150", "400 × 300"]);
    fs::remove_file(&frame).unwrap();
    refused(path, &develop, 2, &named);
    fs::write(&frame, &whole).unwrap();
    fs::write(path.join("run/frames/dark-00.tiff"), frame_of(300, 400)).unwrap();
    refused(path, &develop, 2, &["dark-00.tiff", "300 × 400"]);
}

/// A frame as the simulated camera writes it, of another size.
fn frame_of(width: usize, height: usize) -> Vec<u8> {
    use lobelia_hil_sim::optics::frame::{FrameNotes, write_tiff};
    let notes = FrameNotes { exposure_s: 0.01, f_number: 16.0, taken_s: 1 };
    let mut file = std::io::Cursor::new(Vec::new());
    write_tiff(&mut file, width, height, &vec![600; width * height], &notes).unwrap();
    file.into_inner()
}

#[test]
fn an_unfinished_or_damaged_run_is_not_developed() {
    let folder = finished_run();
    let journal = folder.path().join("run/journal.jsonl");
    let text = fs::read_to_string(&journal).unwrap();
    let lines: Vec<&str> = text.split_inclusive('\n').collect();
    fs::write(&journal, folder::before_last_pose(&text)).unwrap();
    let develop = ["develop", "run", "-o", "sampled.zarr"];
    refused(folder.path(), &develop, 2, &["1 of 2 poses", "--resume"]);
    let damaged = [lines[0], "{\"record\":\"homed\"\n", lines[2]].concat();
    fs::write(&journal, damaged).unwrap();
    refused(folder.path(), &develop, 2, &["journal.jsonl, line 2"]);
}

#[test]
fn a_truncated_store_is_not_fitted() {
    let folder = finished_run();
    let path = folder.path();
    succeed(path, &["develop", "run", "-o", "sampled.zarr"]);
    let fit = ["fit", "sampled.zarr", "-o", "material.exr", "--lobes", "1"];
    for file in folder::listing(&path.join("sampled.zarr")) {
        let name = path.join("sampled.zarr").join(&file);
        if name.is_dir() {
            continue;
        }
        let whole = fs::read(&name).unwrap();
        fs::write(&name, &whole[..whole.len() / 3]).unwrap();
        refused(path, &fit, 2, &["sampled.zarr"]);
        fs::write(&name, whole).unwrap();
    }
    succeed(path, &fit);
}

#[test]
fn a_table_with_nan_or_a_row_cut_short_is_named_by_line_and_row() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let table = |rows: &str| {
        fs::write(path.join("paint.brdf"), format!("3\n450 550 650\n0.1 0 0.2 0 1 2 3\n{rows}\n")).unwrap();
    };
    table("0.2 0 0.3 0 1 nan 3");
    let fit = ["fit", "paint.brdf", "-o", "paint.exr"];
    refused(path, &fit, 2, &["paint.brdf", "line 4", "row 2", "550 nm", "nan"]);
    table("0.2 0 0.3 0 1 2");
    refused(path, &fit, 2, &["paint.brdf", "line 4", "row 2"]);
    fs::write(path.join("paint.csv"), "").unwrap();
    refused(path, &["fit", "paint.csv"], 2, &["paint.csv", ".brdf"]);
}

#[test]
fn the_report_of_a_command_that_failed_says_why() {
    let folder = tempfile::tempdir().unwrap();
    run(folder.path(), &["fit", "gone.brdf", "--report", "report.json"]).refuses(2, &["gone.brdf"]);
    let text = fs::read_to_string(folder.path().join("report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(report["command"], "fit");
    assert!(report["failure"].as_str().unwrap().contains("gone.brdf"), "{report}");
}

#[test]
fn options_that_make_no_sense_are_bad_input() {
    let folder = tempfile::tempdir().unwrap();
    refused(folder.path(), &["demo", "--size", "small", "--threads", "0"], 2, &["--threads"]);
    // What the command line's grammar refuses is told with a hint of the usage, on several lines.
    for (arguments, part) in [
        (&["develope", "run"][..], "develop"),
        (&["acquire", "plan.toml"], "--port"),
        (&["plan", "rig.toml"], "--budget"),
        (&["demo", "--size", "tiny"], "medium"),
    ] {
        let said = run(folder.path(), arguments);
        assert_eq!(said.code, Some(2), "{said:?}");
        assert!(said.stderr.contains(part), "{said:?}");
    }
    assert!(folder::listing(folder.path()).is_empty());
}

/// /proc takes no files, whoever asks. What is refused must be refused before the work: nothing else is wrong
/// with these commands.
#[cfg(target_os = "linux")]
#[test]
fn an_output_that_cannot_be_written_is_told_before_the_work_and_a_folder_that_is_missing_is_made() {
    let folder = finished_run();
    let path = folder.path();
    fs::write(path.join("file"), "mine").unwrap();
    succeed(path, &["develop", "run", "-o", "new/folder/sampled.zarr"]);
    succeed(path, &["fit", "new/folder/sampled.zarr", "--lobes", "1", "-o", "maps/of/it.exr"]);
    assert!(path.join("maps/of/it.exr").is_file());
    let refuse = |line: &str| {
        let arguments: Vec<&str> = line.split(' ').collect();
        refused(path, &arguments, 1, &["/proc/lobelia", "cannot be written"]);
    };
    refuse("plan rig.toml --budget 2 -o /proc/lobelia/plan.toml");
    refuse("acquire plan.toml --rig rig.toml --port sim --camera sim -o /proc/lobelia/run");
    refuse("develop run -o /proc/lobelia/sampled.zarr");
    refuse("fit new/folder/sampled.zarr --lobes 1 -o /proc/lobelia/map.exr");
    refuse("edit mean maps/of/it.exr -o /proc/lobelia/mean.exr");
    refuse("compare run maps/of/it.exr -o /proc/lobelia/pages");
    refuse("render studio-ball -o /proc/lobelia/picture.png");
    refuse("prefilter studio -n 4 -o /proc/lobelia/maps");
    refuse("chart fit -o /proc/lobelia/charts");
    refuse("demo --size small -o /proc/lobelia/demo");
    refuse("develop run -o sampled.zarr --report /proc/lobelia/report.json");
    refused(path, &["develop", "run", "-o", "file"], 2, &["file", "no sampled SBRDF"]);
    refused(path, &["render", "studio-ball", "-o", "maps/of/it.exr/x.png"], 1, &["it.exr is no folder"]);
}

/// What lies on a real carrier is no file's to say.
#[test]
fn a_material_goes_with_the_simulated_camera_alone() {
    let (folder, _) = inputs();
    fs::write(folder.path().join("m.toml"), "").unwrap();
    let real = ["--port", "tcp://localhost:1", "--camera", "watch:.", "--material", "m.toml"];
    acquire(folder.path(), &real).refuses(2, &["--material is what the simulated camera sees"]);
}

/// A scene of one mesh, a few pixels.
fn scene(folder: &Path, name: &str, object: &str) {
    let text = format!(
        "[camera]\nposition = [0, 1, 6]\ntarget = [0, 0, 0]\nfov_deg = 40\nwidth = 8\nheight = \
         6\n[[light]]\nkind = \"directional\"\ntoward = [1, 1, 1]\nirradiance = [3, 3, \
         3]\n[[object]]\n{object}\n"
    );
    fs::write(folder.join(name), text).unwrap();
}

const GREY: &str = "material.albedo = [0.5, 0.5, 0.5]";

const TRACED: [&str; 6] = ["--method", "reference", "--samples", "1", "-o", "a.png"];

/// Lines and points are no surfaces; what is not drawn is told by its file.
#[test]
fn what_of_a_mesh_is_no_surface_is_told_to_be_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let cases = root().join("tests/cases");
    let text = fs::read_to_string(cases.join("gltf/modes.gltf")).unwrap();
    let mut document: serde_json::Value = serde_json::from_str(&text).unwrap();
    let primitives = document["meshes"][0]["primitives"].as_array_mut().unwrap();
    let mut line = primitives[0].clone();
    line["mode"] = 1.into();
    primitives.push(line);
    fs::write(path.join("mix.gltf"), document.to_string()).unwrap();
    fs::copy(cases.join("gltf/modes.gltf"), path.join("whole.gltf")).unwrap();
    fs::copy(cases.join("obj/polyline.obj"), path.join("mix.obj")).unwrap();
    for (mesh, told) in [
        ("mix.gltf", "mix.gltf: left out as no surface: 1 primitive of points or lines\n"),
        ("mix.obj", "mix.obj: left out as no surface: 1 point, line or curved surface\n"),
        ("whole.gltf", ""),
    ] {
        scene(path, "scene.toml", &format!("mesh = \"{mesh}\"\n{GREY}"));
        let said = run(path, &[&["render", "scene.toml"], &TRACED[..]].concat());
        assert_eq!(said.code, Some(0), "{said:?}");
        assert_eq!(said.stderr.contains("left out"), !told.is_empty(), "{}", said.stderr);
        assert!(said.stderr.contains(told), "{}", said.stderr);
    }
}

/// Rays meet triangles in single precision, in which the volumes of such a sphere are infinite: the picture
/// would never end.
#[test]
fn an_object_larger_than_can_be_drawn_and_values_of_another_kind_are_refused_in_words() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    for (object, parts) in [
        ("mesh = \"sphere\"\nscale = [1e20, 1e20, 1e20]", &["reaches", "less than 1e12"][..]),
        ("mesh = \"sphere\"\ntranslate = [0, 1e25, 0]", &["scene.toml"]),
        ("mesh = \"sphere\"\nscale = 3", &["expected a list of 3 numbers"]),
    ] {
        scene(path, "scene.toml", &format!("{object}\n{GREY}"));
        run(path, &[&["render", "scene.toml"], &TRACED[..]].concat()).refuses(2, parts);
    }
    assert!(!path.join("a.png").exists());
}

/// The hashes of all that a picture is made of, or two reports could not be told apart.
#[test]
fn a_pictures_report_has_the_files_that_its_scene_is_made_of() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let cases = root().join("tests/cases/gltf");
    fs::copy(cases.join("percent.gltf"), path.join("percent.gltf")).unwrap();
    fs::copy(cases.join("Box With Spaces.bin"), path.join("Box With Spaces.bin")).unwrap();
    SbrdfMap::new(2, 1, 1).write_exr(&path.join("m.exr")).unwrap();
    SbrdfMap::new(1, 1, 1).write_exr(&path.join("m.mip1.exr")).unwrap();
    scene(path, "scene.toml", "mesh = \"percent.gltf\"\nmaterial = { map = \"m.exr\" }");
    succeed(path, &[&["render", "scene.toml", "--report", "r.json"], &TRACED[..]].concat());
    let report: serde_json::Value = serde_json::from_slice(&fs::read(path.join("r.json")).unwrap()).unwrap();
    let inputs = report["inputs"].as_array().unwrap();
    let mut names: Vec<&str> = inputs.iter().filter_map(|input| input["path"].as_str()).collect();
    names.sort_unstable();
    assert_eq!(names, ["Box With Spaces.bin", "m.exr", "m.mip1.exr", "percent.gltf", "scene.toml"]);
    assert!(inputs.iter().all(|input| input["sha256"].as_str().is_some_and(|hash| hash.len() == 64)));
    let over = ["render", "scene.toml", "-o", "m.mip1.exr", "--method", "reference"];
    run(path, &over).refuses(2, &["m.mip1.exr", "name another file"]);
}

#[test]
fn a_runs_folder_that_holds_a_users_own_files_is_refused() {
    let (folder, _) = inputs();
    let before = folder::contents(folder.path());
    let arguments = [&["acquire", "plan.toml", "--rig", "rig.toml", "-o", "."], &SIMULATED[..]].concat();
    run(folder.path(), &arguments).refuses(2, &["something else than a run"]);
    assert!(folder::contents(folder.path()) == before, "files were changed");
}

#[test]
fn a_file_of_another_kind_and_a_number_below_0_are_named_for_what_they_are() {
    let (folder, _) = inputs();
    let path = folder.path();
    let swapped = [&["acquire", "rig.toml", "--rig", "plan.toml", "-o", "run"], &SIMULATED[..]].concat();
    refused(path, &swapped, 2, &["plan.toml: this is a plan, but a rig is needed here"]);
    refused(path, &["plan", "plan.toml", "--budget", "2", "-o", "p.toml"], 2, &["this is a plan"]);
    refused(
        path,
        &["plan", "rig.toml", "--density-deg", "-5", "-o", "p.toml"],
        2,
        &["--density-deg", "above 0"],
    );
    let null = ["rig", "status", "--port", "/dev/null", "--rig", "rig.toml"];
    refused(path, &null, 2, &["/dev/null is no serial port"]);
}
