//! What is baked of a scene, as a user bakes it: killed, in chunks, joined, listed, and rendered from.

#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use lobelia_tests::command::{lobelia, run, succeed};

/// A ball of gloss and a plane under a sky and a lamp, with an animation of both and of a parameter.
const SCENE: &str = "background = \"environment\"\n\
    [camera]\nposition = [0, 1, 4]\ntarget = [0, 0, 0]\nfov_deg = 40\nwidth = 24\nheight = 18\n\
    [environment]\nbuiltin = \"sky\"\n\
    [[object]]\nname = \"ball\"\nmesh = \"sphere\"\n[object.material]\nrho_d = [0.1, 0.1, 0.1]\n\
    lobes = [{ rho_s = [0.2, 0.2, 0.2], c = [-1, -1, 1], n = 8 }, \
    { rho_s = [9, 9, 9], c = [-1, -1, 1], n = 200 }]\n\
    [[light]]\nname = \"lamp\"\nkind = \"point\"\nposition = [2, 2, 2]\nintensity = [4, 4, 4]\n\
    [[parameter]]\nname = \"evening\"\nrange = [0, 1]\nlight.lamp = { dim = 0 }\n\
    [animation]\nframes = 3\n[[animation.key]]\n[[animation.key]]\nposition = [1, 1, 4]\n\
    environment_turn_deg = 60\nlight.lamp.move = [-4, 0, 0]\nparameter.evening = 0.5\n";

const METHOD: [&str; 4] = ["--method", "environment", "--map-error", "0.02"];

/// Name and content of all files but the log of times.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let of = |path: std::path::PathBuf| {
        (path.file_name().unwrap().to_string_lossy().into_owned(), fs::read(path).unwrap())
    };
    entries.map(of).filter(|(name, _)| name != "log.jsonl").collect()
}

fn bake<'a>(more: &[&'a str]) -> Vec<&'a str> {
    [&["bake", "s.toml"], &METHOD[..], more].concat()
}

#[test]
fn a_bake_killed_while_it_runs_goes_on_and_chunks_are_joined_to_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    fs::write(path.join("s.toml"), SCENE).unwrap();
    let said = succeed(path, &bake(&["-o", "whole"]));
    assert!(said.contains("baked"), "{said}");
    let mut process = lobelia(path, &bake(&["-o", "killed"]));
    let mut process = process.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let begun = Instant::now();
    while fs::read_dir(path.join("killed")).map_or(0, Iterator::count) < 3 {
        assert!(begun.elapsed() < Duration::from_secs(120), "nothing is baked");
        std::thread::sleep(Duration::from_millis(1));
    }
    // It may be done already: then there is nothing to go on with, and the bytes must be the same all the
    // same.
    let _ = process.kill();
    process.wait().unwrap();
    succeed(path, &bake(&["-o", "killed"]));
    let whole = files(&path.join("whole"));
    // What was being written when it was killed is no part.
    let killed: BTreeMap<_, _> =
        files(&path.join("killed")).into_iter().filter(|(name, _)| !name.contains(".tmp")).collect();
    assert!(killed == whole && whole.len() > 4, "{:?} {:?}", killed.keys(), whole.keys());

    for (chunk, output) in [("1/2", "a"), ("2/2", "b")] {
        succeed(path, &bake(&["--chunks", chunk, "-o", output]));
    }
    run(path, &["bake", "--merge", "a", "-o", "joined"]).refuses(2, &["joined", "missing: 1, 3"]);
    succeed(path, &["bake", "--merge", "b", "a", "-o", "joined"]);
    assert!(files(&path.join("joined")) == whole);
    let listed = succeed(path, &["bake", "--list", "."]);
    for row in ["./whole", "./joined", "slices, map error 0.02", "of 1"] {
        assert!(listed.contains(row), "{listed}");
    }
}

#[test]
fn an_animation_from_a_folder_is_that_without_and_what_is_of_something_else_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    fs::write(path.join("s.toml"), SCENE).unwrap();
    succeed(path, &bake(&["-o", "baked"]));
    let render = |more: &[&str]| run(path, &[&["render", "s.toml", "--samples", "2"], more].concat());
    let method = &METHOD[..];
    for (more, output) in [(&["--baked", "baked"][..], "a-#.exr"), (&[], "b-#.exr")] {
        let said = render(&[method, more, &["-o", output, "--report", "r.json"]].concat());
        assert_eq!(said.code, Some(0), "{}", said.stderr);
    }
    let frame = |name: &str, k: u32| fs::read(path.join(format!("{name}-{k}.exr"))).unwrap();
    for k in 0..3 {
        assert!(frame("a", k) == frame("b", k), "frame {k} differs from that which is not from a folder");
    }
    assert!(frame("a", 0) != frame("a", 1));
    let report = fs::read_to_string(path.join("r.json")).unwrap();
    assert!(report.contains("baked_bytes") && report.contains("light_seconds"), "{report}");
    // The last frame is the scene with the light as the animation has it there.
    let last = SCENE
        .replace("position = [0, 1, 4]", "position = [1, 1, 4]")
        .replace("builtin = \"sky\"", "builtin = \"sky\"\nrotation_deg = 60")
        .replace(
            "position = [2, 2, 2]\nintensity = [4, 4, 4]",
            "position = [-2, 2, 2]\nintensity = [2, 2, 2]",
        );
    fs::write(path.join("last.toml"), last.split("[[parameter]]").next().unwrap()).unwrap();
    let of_last = [&["render", "last.toml", "--samples", "2", "-o", "c-2.exr"], method].concat();
    succeed(path, &of_last);
    assert!(frame("c", 2) == frame("b", 2));

    let with = |more: &[&str]| render(&[&["-o", "x.png", "--baked", "baked"], more].concat());
    // Without a method the folder's is taken, whose settings must be the same.
    with(&[]).refuses(
        2,
        &["baked: baked with other settings (slices, map error 0.02; here slices, map error 0.01)"],
    );
    with(&["--method", "reference"]).refuses(2, &["`reference` bakes nothing"]);
    fs::write(path.join("s.toml"), SCENE.replace("\"sky\"", "\"studio\"")).unwrap();
    with(method).refuses(2, &["of another scene: the environment differs; bake again"]);
    fs::write(path.join("s.toml"), SCENE.replace("n = 200", "n = 300")).unwrap();
    with(method).refuses(2, &["the range of exponents differs (8 to 200; here 8 to 300)"]);
    fs::write(path.join("s.toml"), SCENE).unwrap();
    let part = path.join("baked/000001.part");
    let mut bytes = fs::read(&part).unwrap();
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    fs::write(&part, &bytes).unwrap();
    with(method).refuses(2, &["baked: part 1 is damaged; bake again to replace it"]);
    fs::remove_file(&part).unwrap();
    with(method).refuses(2, &["not all parts are baked; missing: 1 of"]);
    with(&["--method", "environment", "--map-error", "0.02", "--frames", "9"]).refuses(2, &["--max-error"]);
    run(path, &["render", "s.toml", "-o", "baked/bake.json.png", "--baked", "gone"]).refuses(2, &["gone"]);
}
