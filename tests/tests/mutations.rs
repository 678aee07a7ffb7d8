//! Every reader of every format against 10,000 mutations of small sound files (`cargo xtask long`: 30 s
//! each): it reads a file or refuses it in one sentence with its name and exit code 2, does not panic, and
//! asks for no more memory than [`MOST_MEMORY`].
//!
//! MERL's tables, of 35 MB each, are mutated in memory: `lobelia-reflectance`, `table::merl`.

#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::alloc::System;
use std::path::Path;
use std::time::Duration;

use cap::Cap;
use lobelia::acquire::{journal, recipe::Recipe};
use lobelia::develop::frame;
use lobelia::edit::{palette, picture};
use lobelia::plan::Plan;
use lobelia::reflectance::{FormatError, LobeBrdf, MeasuredTable, Microfacet, Rgb, SbrdfMap, materials};
use lobelia::render::{Picture, bake, environment as environment_maps};
use lobelia::rig::config::RigConfig;
use lobelia::rig::trace;
use lobelia::sampled::{PoseGeometry, SampledSbrdf};
use lobelia::scene::{Environment, Mesh, Scene};
use lobelia::{Error, Result};
use lobelia_hil_sim::optics::frame::{FrameNotes, write_tiff};
use lobelia_tests::command::root;
use lobelia_tests::mutate::{Extent, MOST_MEMORY, Sound, survives};
use lobelia_tests::{folder, small};

/// Counts memory, and refuses what would bring the machine down.
#[global_allocator]
static MEMORY: Cap<System> = Cap::new(System, 4 * MOST_MEMORY);

const COUNT: Extent = Extent::Count(10_000);
const LONG: Extent = Extent::Time(Duration::from_secs(30));

/// Files of tests/cases, and of a larger collection where there is one.
fn cases(kind: &str, endings: &[&str]) -> Vec<Sound> {
    let folders = [root().join("tests/cases"), root().join("../shared/data/cases")];
    let found = folders.iter().flat_map(|folder| Sound::of_folder(&folder.join(kind), endings));
    // The largest would take most of the time.
    let mut found: Vec<Sound> = found.filter(|sound| sound.bytes.len() < 1 << 16).collect();
    found.sort_by(|a, b| a.name.cmp(&b.name));
    found.dedup_by(|a, b| a.name == b.name);
    found
}

/// Runs a reader on mutations of its corpus.
fn reads(corpus: &[Sound], extent: Extent, read: impl Fn(&Path) -> Result<()>) {
    let folder = tempfile::tempdir().unwrap();
    let peak = || MEMORY.max_allocated();
    survives(folder.path(), corpus, "", extent, peak, read);
}

/// The bytes of a file that `write` makes.
fn made(name: &str, write: impl FnOnce(&Path)) -> Sound {
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join(name));
    Sound::new(name, std::fs::read(folder.path().join(name)).unwrap())
}

/// Makes a test of each reader with its corpus, and a longer one.
macro_rules! readers {
    ($($name:ident, $long:ident: $corpus:expr, $read:expr;)*) => {
        $(
            #[test]
            fn $name() {
                reads(&$corpus, COUNT, $read);
            }

            #[test]
            #[ignore = "30 s; cargo xtask long"]
            fn $long() {
                reads(&$corpus, LONG, $read);
            }
        )*
    };
}

readers! {
    damaged_maps_are_read_or_refused, maps_for_long: maps(), |path| map(SbrdfMap::read_exr(path));
    damaged_openexr_environments_are_read_or_refused, openexr_for_long: pictures(), environment;
    damaged_radiance_environments_are_read_or_refused, radiance_for_long: cases("hdr", &[".hdr"]),
        environment;
    damaged_photographs_are_read_or_refused, photographs_for_long: photographs(), photo;
    damaged_obj_meshes_are_read_or_refused, obj_for_long: cases("obj", &[".obj"]), mesh;
    damaged_ply_meshes_are_read_or_refused, ply_for_long: ply(), mesh;
    damaged_gltf_meshes_are_read_or_refused, gltf_for_long: gltf(), mesh;
    damaged_tables_are_read_or_refused, tables_for_long: tables(),
        |path| MeasuredTable::read(path).map(drop).map_err(Error::format);
    damaged_frames_are_read_or_refused, frames_for_long: frames(), |path| frame::read(path).map(drop);
    damaged_rigs_are_read_or_refused, rigs_for_long: rigs(), |path| RigConfig::read(path).map(drop);
    damaged_plans_are_read_or_refused, plans_for_long: plans(),
        |path| Plan::read(path, &small::rig(8)).map(drop);
    damaged_scenes_are_read_or_refused, scenes_for_long: scenes(), |path| Scene::read(path).map(drop);
    damaged_recipes_are_read_or_refused, recipes_for_long: recipes(),
        |path| Recipe::read(path, &small::rig(8).carrier).map(drop);
    damaged_palettes_are_read_or_refused, palettes_for_long: palettes(), |path| palette::read(path).map(drop);
    damaged_index_images_are_read_or_refused, index_images_for_long: index_images(),
        |path| palette::apply(path, &entries()).map(drop);
    damaged_journals_are_read_or_refused, journals_for_long: journals(),
        |path| journal::read(path.parent().unwrap()).map(drop);
    damaged_traces_are_read_or_refused, traces_for_long: traces(), |path| trace::read(path).map(drop);
}

#[test]
fn damaged_stores_are_read_or_refused() {
    stores(COUNT);
}

#[test]
#[ignore = "30 s; cargo xtask long"]
fn stores_for_long() {
    stores(LONG);
}

#[test]
fn damaged_bakes_are_read_or_refused() {
    bakes(COUNT);
}

#[test]
#[ignore = "30 s; cargo xtask long"]
fn bakes_for_long() {
    bakes(LONG);
}

/// Every file of a folder of what was baked, each mutated beside the others as they are.
fn bakes(extent: Extent) {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path().join("baked");
    let mut scene = Scene::open(Path::new("studio-ball")).unwrap();
    scene.environment = Some(Environment::uniform(Rgb::ONE));
    let settings = environment_maps::Settings { map_error: 0.3, ..Default::default() };
    let task = bake::Task { folder: &folder, chunk: None, estimate_only: false };
    bake::bake(&settings, &scene, task, |_| ()).unwrap();
    std::fs::remove_file(folder.join("log.jsonl")).unwrap();
    let corpus = Sound::of_folder(&folder, &[".json", ".part"]);
    let peak = || MEMORY.max_allocated();
    survives(&folder, &corpus, "baked", extent, peak, |path| {
        let baked = bake::Baked::open(path.parent().unwrap(), &settings, &scene)?;
        (0..baked.parts()).try_for_each(|part| baked.part(part).map(drop))
    });
}

/// What must hold of a map that is taken.
fn map(read: std::result::Result<SbrdfMap, FormatError>) -> Result<()> {
    let map = read.map_err(Error::format)?;
    map.check().expect("a map that was read is sound");
    Ok(())
}

fn environment(path: &Path) -> Result<()> {
    let environment = Environment::read(path)?;
    let sound = environment.pixels.iter().all(|pixel| pixel.is_finite() && pixel.min_element() >= 0.0);
    assert!(sound && !environment.pixels.is_empty(), "an environment holds radiance");
    Ok(())
}

fn photo(path: &Path) -> Result<()> {
    let photo = picture::Photo::read(path)?;
    assert_eq!(photo.pixels.len(), photo.width * photo.height);
    assert!(photo.pixels.iter().all(|pixel| pixel.is_finite() && pixel.min_element() >= 0.0));
    Ok(())
}

fn mesh(path: &Path) -> Result<()> {
    let (mesh, origin) = Mesh::read(path)?;
    assert!(origin.is_finite() && !mesh.triangles.is_empty());
    for vertex in &mesh.vertices {
        let vectors = [vertex.position, vertex.normal, vertex.tangent];
        assert!(vectors.iter().all(|v| v.is_finite()) && vertex.uv.is_finite(), "{vertex:?}");
        assert!((vertex.normal.length() - 1.0).abs() < 1e-3, "{vertex:?}");
        assert!(vertex.normal.dot(vertex.tangent).abs() < 1e-3, "{vertex:?}");
    }
    let count = mesh.vertices.len();
    assert!(mesh.triangles.as_flattened().iter().all(|&index| (index as usize) < count));
    Ok(())
}

fn maps() -> Vec<Sound> {
    let mut extended = LobeBrdf::diffuse(Rgb::splat(0.1));
    extended.microfacets.push(Microfacet { f0: Rgb::splat(0.04), f90: Rgb::ONE, alpha: 0.3 });
    let texels = [materials::published("clay").unwrap(), extended];
    let small = made("small.exr", |path| SbrdfMap::from_texels(2, 1, &texels).write_exr(path).unwrap());
    cases("map", &[".exr"]).into_iter().chain([small]).collect()
}

/// A picture of 6 × 4 pixels.
fn picture() -> Picture {
    let pixel = |k: usize| glam::Vec4::new(k as f32 * 0.1, 0.5, 2.0 / (k + 1) as f32, 1.0);
    Picture { width: 6, height: 4, pixels: (0..24).map(pixel).collect() }
}

fn pictures() -> Vec<Sound> {
    let small = made("small.exr", |path| picture().write(path, 1.0).unwrap());
    cases("exr", &[".exr"]).into_iter().chain([small]).collect()
}

fn photographs() -> Vec<Sound> {
    let png = made("small.png", |path| picture().write(path, 1.0).unwrap());
    cases("ldr", &[".jpg", ".png"]).into_iter().chain([png]).chain(index_images()).collect()
}

/// Text, and the same square in binary.
fn ply() -> Vec<Sound> {
    let mut binary =
        b"ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\n\
        property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
            .to_vec();
    for corner in [[0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]] {
        binary.extend(corner.iter().flat_map(|x| x.to_le_bytes()));
    }
    binary.push(4);
    binary.extend((0i32..4).flat_map(i32::to_le_bytes));
    cases("ply", &[".ply"]).into_iter().chain([Sound::new("square.ply", binary)]).collect()
}

/// Documents with their buffers within them, and one in the binary container.
fn gltf() -> Vec<Sound> {
    let json = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0,
    "scale":[1,2,3]}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}],
        "bufferViews":[{"buffer":0,"byteLength":36}],"buffers":[{"byteLength":36}]}"#;
    let json = format!("{json:<width$}", width = json.len().next_multiple_of(4));
    let corners = [0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].map(f32::to_le_bytes);
    let mut glb = b"glTF".to_vec();
    for word in [2, (12 + 8 + json.len() + 8 + 36) as u32, json.len() as u32] {
        glb.extend(word.to_le_bytes());
    }
    glb.extend(b"JSON");
    glb.extend(json.bytes());
    glb.extend(36u32.to_le_bytes());
    glb.extend(b"BIN\0");
    glb.extend(corners.as_flattened());
    cases("gltf", &[".gltf"]).into_iter().chain([Sound::new("triangle.glb", glb)]).collect()
}

/// Cornell's tables and ALTA's, text and binary.
fn tables() -> Vec<Sound> {
    let mut binary = b"#ALTA_BEGIN_HEADER\n#DIM 3 3\n#PARAM_IN ISOTROPIC_TL_TV_PROJ_DPHI\n#PARAM_OUT \
         RGB_COLOR\n#VERSION 0\n#FORMAT binary\n#ENDIAN little\n#PRECISION ieee754-double\n#SAMPLE_COUNT \
         2\n#ALTA_END_HEADER\n"
        .to_vec();
    for number in [0.1f64, 0.2, 0.0, 0.3, 0.2, 0.1, 0.5, 0.1, 1.0, 0.3, 0.2, 0.1] {
        binary.extend(number.to_le_bytes());
    }
    cases("text", &[".brdf", ".dat"]).into_iter().chain([Sound::new("binary.dat", binary)]).collect()
}

fn frames() -> Vec<Sound> {
    let notes = FrameNotes { exposure_s: 0.0125, f_number: 16.0, taken_s: 5 };
    let values: Vec<u16> = (0..96).map(|k| 600 + k).collect();
    let mut file = std::io::Cursor::new(Vec::new());
    write_tiff(&mut file, 12, 8, &values, &notes).unwrap();
    cases("tiff", &[".tif", ".tiff"])
        .into_iter()
        .chain([Sound::new("frame.tiff", file.into_inner())])
        .collect()
}

fn rigs() -> Vec<Sound> {
    vec![Sound::new("rig.toml", toml::to_string(&RigConfig::default()).unwrap())]
}

fn plans() -> Vec<Sound> {
    vec![Sound::new("plan.toml", small::plan(&small::rig(8), 6).to_toml().unwrap())]
}

fn scenes() -> Vec<Sound> {
    let text = "[camera]\nposition = [0, 1, 4]\ntarget = [0, 0, 0]\nfov_deg = 40\nwidth = 64\nheight = \
         48\n[[object]]\nmesh = \"plane\"\nmaterial.published = \"clay\"\nscale = [1, 2, 1]\nrotate_deg = \
         [10, 0, 0]\n[[light]]\nkind = \"directional\"\ntoward = [1, 1, 1]\nirradiance = [3, 3, \
         3]\n[[light]]\nkind = \"point\"\nposition = [1, 2, 1]\nintensity = [3, 3, 3]\n[animation]\nframes = \
         4\n[[animation.key]]\nposition = [0, 1, 4]\ntarget = [0, 0, 0]\n[[animation.key]]\nposition = [1, \
         1, 4]\ntarget = [0, 0, 0]\nfov_deg = 30\n";
    let sound = Sound::new("scene.toml", text);
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join(&sound.name), text).unwrap();
    Scene::read(&folder.path().join(&sound.name)).expect("the scene is sound before it is mutated");
    vec![sound]
}

fn recipes() -> Vec<Sound> {
    let text = "[pattern]\nkind = \"checks\"\nsize_mm = 4\n[[material]]\npublished = \"felt\"\nbeta_deg = \
         30\n[[material]]\nrho_d = [0.1, 0.2, 0.3]\nnormal = [0.1, 0.0]\n[[material.lobe]]\nrho_s = [0.1, \
         0.1, 0.1]\nc = [-1, -1, 0.9]\nn = 12\nn_grazing = 30\n";
    small::recipe(text);
    vec![Sound::new("material.toml", text)]
}

fn entries() -> Vec<palette::Entry> {
    palette::with_swatches(["clay", "felt"].map(|name| materials::published(name).unwrap()).to_vec())
}

fn palettes() -> Vec<Sound> {
    let notes = ["clay", "felt"].map(String::from);
    vec![Sound::new("palette.toml", palette::to_toml(&entries(), &notes))]
}

fn index_images() -> Vec<Sound> {
    vec![made("index.png", |path| palette::write_index(path, 3, 2, &[0, 1, 0, 1, 1, 0], &entries()).unwrap())]
}

fn journals() -> Vec<Sound> {
    let exposure = r#"{"file":"frames/x.tiff","open_s":0.25,"lamp_reading":30000.0}"#;
    let text = format!(
        "{}\n{}\n{}\n{}\n",
        r#"{"record":"started","lobelia":"0.1.0","plan_sha256":"00","rig_sha256":"11"}"#,
        r#"{"record":"homed","controller_us":5}"#,
        format_args!(r#"{{"record":"dark","index":0,"exposure":{exposure},"controller_us":7}}"#),
        format_args!(r#"{{"record":"pose","index":0,"exposures":[{exposure}],"controller_us":9}}"#),
    );
    vec![Sound::new(journal::FILE_NAME, text)]
}

fn traces() -> Vec<Sound> {
    let pause = serde_json::to_string(&trace::Entry::PauseUs(20)).unwrap();
    vec![made("session.jsonl", |path| {
        drop(trace::Recorder::create(path).unwrap());
        let begun = std::fs::read_to_string(path).unwrap();
        let step = r#"{"steps":[{"axis":"Pan","up":true,"at_us":5}]}"#;
        std::fs::write(path, format!("{begun}{pause}\n{step}\n{pause}\n")).unwrap();
    })]
}

/// A store is a folder: one of its files at a time is mutated.
fn stores(extent: Extent) {
    let folder = tempfile::tempdir().unwrap();
    let poses = (0..2).map(|k| PoseGeometry {
        light_mm: glam::DVec3::new(f64::from(k), 2.0, 1000.0),
        camera_mm: glam::DVec3::new(0.25, 0.1, 1050.0),
        weight: 1.0,
    });
    let mut sampled = SampledSbrdf::empty(3, 2, 0.5, poses.collect());
    sampled.reflectance.iter_mut().enumerate().for_each(|(k, value)| *value = k as f32 * 0.01);
    sampled.write_zarr(&folder.path().join("store.zarr")).unwrap();
    // Of Python's zarr, compressed by zstd.
    let compressed = root().join("tests/cases/zarr/zstd.zarr");
    folder::copy(&compressed, &folder.path().join("zstd.zarr"));
    let files = folder::listing(folder.path()).into_iter().filter(|path| folder.path().join(path).is_file());
    let corpus: Vec<Sound> = files
        .map(|path| Sound::new(&path.to_string_lossy(), std::fs::read(folder.path().join(&path)).unwrap()))
        .collect();
    let peak = || MEMORY.max_allocated();
    survives(folder.path(), &corpus, ".zarr", extent, peak, |path| {
        let store = path.ancestors().find(|folder| folder.extension().is_some_and(|e| e == "zarr")).unwrap();
        SampledSbrdf::read_zarr(store).map(drop)
    });
}
