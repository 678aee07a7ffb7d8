//! Fits in parts, as a scheduler drives them: plain processes for the shards, one to join them.

#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::fs;
use std::path::Path;

use lobelia::reflectance::{Brdf, LobeBrdf, materials};
use lobelia::sampled::{PoseGeometry, SampledSbrdf};
use lobelia_tests::command::{lobelia, run, said, succeed};

/// Writes a sampled SBRDF of 48 × 20 texels: two published materials, dimmer from row to row.
fn write_sampled(path: &Path) {
    let pose = |k: u32| {
        let (angle, radius) = (f64::from(k) * 2.4, 150.0 + 30.0 * f64::from(k % 7));
        PoseGeometry {
            light_mm: glam::DVec3::new(radius * angle.cos(), radius * angle.sin(), 400.0),
            camera_mm: glam::DVec3::new(-15.0 * f64::from(k), 40.0, 500.0),
            weight: 1.0,
        }
    };
    let mut sampled = SampledSbrdf::empty(48, 20, 0.5, (0..30).map(pose).collect());
    let [clay, paint] = ["clay", "blue-paint"].map(|name| materials::published(name).unwrap());
    let of = |index: usize| -> &LobeBrdf { if index % 48 < 24 { &clay } else { &paint } };
    sampled.reflectance = (0..sampled.texels() * 30)
        .flat_map(|k| {
            let (wi, wo) = sampled.directions(k / 30, k % 30);
            (of(k / 30).eval(wi, wo) / (1.0 + (k / 30 / 48) as f32)).to_array()
        })
        .collect();
    sampled.write_zarr(path).unwrap();
}

fn shard<'a>(part: &'a str, output: &'a str) -> [&'a str; 8] {
    ["fit", "s.zarr", "--lobes", "1", "--chunks", part, "-o", output]
}

#[test]
fn two_processes_and_a_merge_give_the_bytes_of_one_run_and_can_be_started_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    write_sampled(&path.join("s.zarr"));
    succeed(path, &["fit", "s.zarr", "--lobes", "1", "--mip", "-o", "whole.exr"]);
    let both = [("1/2", "a.exr"), ("2/2", "b.exr")].map(|(part, output)| {
        let mut command = lobelia(path, &shard(part, output));
        command.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped()).spawn().unwrap()
    });
    for process in both {
        let said = said(process.wait_with_output().unwrap());
        assert_eq!(said.code, Some(0), "{}", said.stderr);
    }
    let mip = ["fit", "s.zarr", "--lobes", "1", "--mip", "--merge", "b.exr", "a.exr", "-o", "material.exr"];
    succeed(path, &mip);
    let bytes = |name: &str| fs::read(path.join(name)).unwrap();
    let levels: Vec<String> = (1..=6).map(|level| format!(".mip{level}")).collect();
    for level in std::iter::once("").chain(levels.iter().map(String::as_str)) {
        let [merged, whole] = ["material", "whole"].map(|name| bytes(&format!("{name}{level}.exr")));
        assert!(merged == whole, "the merged map{level} differs from that of one run");
    }
    succeed(path, &["fit", "--merge", "b.exr", "a.exr", "-o", "finest.exr"]);
    assert!(bytes("finest.exr") == bytes("whole.exr") && !path.join("finest.mip1.exr").exists());
    // A store that is named behind the shards is no shard.
    succeed(path, &["fit", "--merge", "b.exr", "a.exr", "s.zarr", "-o", "finest.exr"]);
    assert!(bytes("finest.exr") == bytes("whole.exr"));
    let others = ["fit", "s.zarr", "--lobes", "0", "--mip", "--merge", "b.exr", "a.exr", "-o", "m.exr"];
    run(path, &others).refuses(2, &["b.exr", "other options"]);
    let blind = ["fit", "--lobes", "1", "--mip", "--merge", "b.exr", "a.exr", "-o", "m.exr"];
    run(path, &blind).refuses(2, &["name the sampled SBRDF"]);
    let part = ["fit", "s.zarr", "--chunks", "1/2", "--mip", "-o", "m.exr"];
    run(path, &part).refuses(2, &["give --mip to --merge"]);

    let before = bytes("a.exr");
    assert!(succeed(path, &shard("1/2", "a.exr")).contains("there already"));
    assert!(bytes("a.exr") == before);
    run(path, &shard("2/2", "a.exr")).refuses(2, &["a.exr", "is 1/2, not 2/2"]);
    run(path, &["fit", "--merge", "a.exr", "-o", "m.exr"]).refuses(2, &["missing: 2/2"]);
    run(path, &["fit", "--merge", "whole.exr", "-o", "m.exr"]).refuses(2, &["whole.exr", "no shard"]);
    assert_eq!(run(path, &shard("3/2", "c.exr")).code, Some(2));
    let mut changed = SampledSbrdf::read_zarr(&path.join("s.zarr")).unwrap();
    changed.reflectance[0] += 0.1;
    changed.write_zarr(&path.join("s.zarr")).unwrap();
    run(path, &shard("1/2", "a.exr")).refuses(2, &["a.exr", "the sampled SBRDF has changed since"]);
    let merge = ["fit", "s.zarr", "--merge", "a.exr", "b.exr", "-o", "m.exr"];
    run(path, &merge).refuses(2, &["a.exr", "shard 1/2 was fitted to other samples"]);
    assert!(!path.join("m.exr").exists());
}
