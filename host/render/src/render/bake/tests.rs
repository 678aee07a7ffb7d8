//! Folders, with a method whose parts are known: part k holds its number, and, of the second half, the sum of
//! the first.

use std::cell::Cell;

use super::folder::HEAD;
use super::*;
use crate::render::{Player, environment};
use crate::scene::{Environment, showcase};
use lobelia_fit::fit::chunks::Part as Chunk;

/// A method of so many parts a stage.
struct Known {
    stage: usize,
    settings: &'static str,
    version: u32,
    /// Parts that may be made before the process is killed.
    lives: Cell<usize>,
}

impl Known {
    fn new(stage: usize) -> Self {
        Self { stage, settings: "plain", version: 1, lives: Cell::new(usize::MAX) }
    }
}

impl Renderer for Known {
    fn name(&self) -> &'static str {
        "known"
    }

    fn made_of(&self, scene: &Scene) -> Result<Option<MadeOf>> {
        Ok(Some(MadeOf {
            method: "known".into(),
            version: self.version,
            settings: self.settings.into(),
            of: BTreeMap::from([("the lights".into(), crate::scene::hash::lights(&scene.lights))]),
        }))
    }

    fn bake<'a>(&'a self, _: &'a Scene) -> Result<Option<Box<dyn Bake + 'a>>> {
        Ok(Some(Box::new(Work(self))))
    }

    fn open(&self, _: &Scene, _: &Baked) -> Result<Box<dyn Player>> {
        Err(Error::input("it is baked, not drawn"))
    }
}

struct Work<'a>(&'a Known);

impl Bake for Work<'_> {
    fn parts(&self) -> Vec<Part> {
        let stage = self.0.stage;
        let part = |k: usize| Part { work: 1.0, bytes: 8, needs: if k < stage { 0..0 } else { 0..stage } };
        (0..2 * stage).map(part).collect()
    }

    fn part(&self, index: usize, done: &Baked) -> Result<Made> {
        let lives = &self.0.lives;
        lives.set(lives.get().checked_sub(1).ok_or_else(|| Error::failure("killed"))?);
        let number = |k: usize| -> Result<u64> {
            let content = done.part(k)?;
            Ok(u64::from_le_bytes(content.try_into().unwrap()))
        };
        let value = match index < self.0.stage {
            true => index as u64,
            false => (0..self.0.stage).map(number).sum::<Result<u64>>()? + index as u64,
        };
        Ok(Made { content: value.to_le_bytes().into(), rays: 10 })
    }
}

fn task(folder: &Path) -> Task<'_> {
    Task { folder, chunk: None, estimate_only: false }
}

/// Name and content of all files but the log.
pub(in crate::render) fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let of = |path: PathBuf| {
        (path.file_name().unwrap().to_string_lossy().into_owned(), std::fs::read(path).unwrap())
    };
    entries.map(of).filter(|(name, _)| name != "log.jsonl").collect()
}

#[test]
fn a_killed_bake_goes_on_and_leaves_the_bytes_of_one_that_was_not() {
    let (temporary, scene) = (tempfile::tempdir().unwrap(), showcase::published(8, 6));
    let [whole, killed] = ["whole", "killed"].map(|name| temporary.path().join(name));
    let mut told = None;
    let outcome = bake(&Known::new(3), &scene, task(&whole), |estimate| told = Some(*estimate)).unwrap();
    let told = told.unwrap();
    assert_eq!((outcome.parts, outcome.rays, outcome.left), ([6, 0, 6], 60, 0));
    assert_eq!((told.parts, told.bytes, outcome.bytes), (6, 6 * (HEAD as u64 + 8), told.bytes));
    for lives in [2, 0, 1] {
        let method = Known { lives: Cell::new(lives), ..Known::new(3) };
        let error = bake(&method, &scene, task(&killed), |_| ()).unwrap_err();
        assert_eq!(error.to_string(), "killed");
        assert!(Baked::open(&killed, &method, &scene).unwrap_err().to_string().contains("missing"));
    }
    let outcome = bake(&Known::new(3), &scene, task(&killed), |_| ()).unwrap();
    assert_eq!(outcome.parts, [3, 3, 6]);
    assert!(files(&whole) == files(&killed));
    assert_eq!(bake(&Known::new(3), &scene, task(&killed), |_| ()).unwrap().parts, [0, 6, 6]);
    let baked = Baked::open(&killed, &Known::new(3), &scene).unwrap();
    assert_eq!((baked.rays, baked.bytes, baked.part(5).unwrap()), (60, 48, 8u64.to_le_bytes().into()));
    let held = &list(&[temporary.path().into()]).unwrap()[0];
    assert!(held.path == killed && held.parts == [6, 6] && held.age_seconds < 600.0, "{held:?}");
}

#[test]
fn chunks_of_a_second_stage_wait_for_the_first_and_merged_they_are_one_run() {
    let (temporary, scene) = (tempfile::tempdir().unwrap(), showcase::published(8, 6));
    let at = |name: &str| temporary.path().join(name);
    let method = Known::new(4);
    let chunk = |index: usize, folder: &Path| {
        bake(&method, &scene, Task { chunk: Some(Chunk { index, count: 3 }), ..task(folder) }, |_| ())
            .unwrap()
    };
    bake(&method, &scene, task(&at("whole")), |_| ()).unwrap();
    for (index, name) in [(1, "a"), (2, "b"), (3, "c")] {
        let outcome = chunk(index, &at(name));
        assert!(outcome.waiting > 0 && outcome.parts[0] + outcome.waiting < 4, "{outcome:?}");
    }
    let all = ["c", "a", "b"].map(at);
    let error = merge(&all, &at("joined")).unwrap_err().to_string();
    assert!(error.contains("missing: 4, 5, 6, 7 of 8"), "{error}");
    // With the first stage there, each goes on in the folder of all.
    for index in [2, 3, 1] {
        assert_eq!(chunk(index, &at("joined")).waiting, 0);
    }
    assert!(files(&at("joined")) == files(&at("whole")));
    let merged = merge(&[at("joined"), at("b")], &at("copy")).unwrap();
    assert_eq!((merged.rays, merged.parts()), (80, 8));
    assert!(files(&at("copy")) == files(&at("whole")));
    let error =
        bake(&method, &scene, Task { chunk: Some(Chunk { index: 1, count: 9 }), ..task(&at("d")) }, |_| ());
    assert!(error.unwrap_err().to_string().contains("9 chunks were asked for; there is 8 parts"));
}

#[test]
fn another_scene_other_settings_another_version_and_damage_are_each_refused_in_one_sentence() {
    let (temporary, scene) = (tempfile::tempdir().unwrap(), showcase::published(8, 6));
    let folder = temporary.path().join("baked");
    bake(&Known::new(2), &scene, task(&folder), |_| ()).unwrap();
    let refused = |method: &Known, scene: &Scene, words: &str| {
        for error in [
            Baked::open(&folder, method, scene).unwrap_err(),
            bake(method, scene, task(&folder), |_| ()).unwrap_err(),
        ] {
            let text = error.to_string();
            assert!(error.exit_code() == 2 && text.contains(words) && text.contains("bake again"), "{text}");
            assert!(text.contains("baked:") && !text.contains('\n'), "{text}");
        }
    };
    let mut other = scene.clone();
    other.lights.pop();
    refused(&Known::new(2), &other, "of another scene: the lights differs");
    refused(&Known { settings: "fine", ..Known::new(2) }, &scene, "other settings (plain; here fine)");
    refused(&Known { version: 2, ..Known::new(2) }, &scene, "by version 1 of `known`, this is version 2");
    let environment = environment::Settings::default();
    let error = Baked::open(&folder, &environment, &scene).unwrap_err().to_string();
    assert!(error.contains("baked for `known`, not for `environment`"), "{error}");

    // A bit of a part's content, its end, all of it; the description.
    let part = part_file(&folder, 1);
    let bytes = std::fs::read(&part).unwrap();
    let mut flipped = bytes.clone();
    flipped[HEAD + 3] ^= 4;
    std::fs::write(&part, &flipped).unwrap();
    let opened = Baked::open(&folder, &Known::new(2), &scene).unwrap();
    assert!(opened.part(0).is_ok() && opened.part(1).unwrap_err().to_string().contains("part 1 is damaged"));
    std::fs::write(&part, &bytes[..HEAD + 2]).unwrap();
    let open = || Baked::open(&folder, &Known::new(2), &scene).map(|_| ()).unwrap_err().to_string();
    assert!(open().contains("part 1 is damaged"));
    std::fs::remove_file(&part).unwrap();
    assert!(open().contains("missing: 1 of 4"));
    // Baking mends what is damaged.
    std::fs::write(&part, &flipped).unwrap();
    let outcome = bake(&Known::new(2), &scene, task(&folder), |_| ()).unwrap();
    assert_eq!((outcome.damaged, outcome.parts), (1, [1, 3, 4]));
    assert!(std::fs::read(&part).unwrap() == bytes);
    let description = folder.join("bake.json");
    let text = std::fs::read_to_string(&description).unwrap();
    std::fs::write(&description, text.replace("\"format\": 1", "\"format\": 7")).unwrap();
    assert!(open().contains("baked in format 7 by another version"));
    std::fs::write(&description, &text[..40]).unwrap();
    assert!(open().contains("bake.json: damaged"));
    let empty = Baked::open(temporary.path(), &Known::new(2), &scene).unwrap_err().to_string();
    assert!(empty.contains("nothing was baked there"));
}

/// Chunks that were not baked of the same, one of which would be taken for the other's.
#[test]
fn chunks_of_different_bakes_are_not_merged() {
    let (temporary, scene) = (tempfile::tempdir().unwrap(), showcase::published(8, 6));
    let at = |name: &str| temporary.path().join(name);
    bake(&Known::new(2), &scene, task(&at("a")), |_| ()).unwrap();
    bake(&Known { settings: "fine", ..Known::new(2) }, &scene, task(&at("b")), |_| ()).unwrap();
    let error = merge(&[at("a"), at("b")], &at("c")).unwrap_err().to_string();
    assert!(error.contains("does not belong to") && error.contains("other settings"), "{error}");
    assert!(!at("c").exists());
}

/// A scene of few exponents under a small sky.
fn sky() -> Scene {
    let mut scene = showcase::published(24, 18);
    scene.environment = Some(Environment::from_function(64, 32, |d| {
        glam::Vec3::new(0.5 + 0.4 * d.x, 0.4 + 40.0 * (20.0 * (d.y - 1.0)).exp(), 0.3 + 0.2 * d.z)
    }));
    scene
}

#[test]
fn maps_from_a_folder_give_the_picture_of_maps_made_at_once_byte_for_byte() {
    let (temporary, scene) = (tempfile::tempdir().unwrap(), sky());
    let settings = environment::Settings { map_error: 0.1, samples: 4, ..Default::default() };
    let folder = temporary.path().join("baked");
    bake(&settings, &scene, task(&folder), |_| ()).unwrap();
    let at_once = settings.render(&scene, &scene.camera).unwrap();
    // Lights, views and the environment's turn are no part of what was baked.
    let mut other = scene.clone();
    other.lights.pop();
    other.environment = other.environment.map(|environment| environment.rotated(1.0));
    let draw =
        |scene: &Scene, baked: &Baked| settings.open(scene, baked).unwrap().frame(&scene.state()).unwrap();
    let baked = Baked::open(&folder, &settings, &scene).unwrap();
    let rendering = draw(&scene, &baked);
    assert!(rendering.picture == at_once.picture);
    let (cost, bytes) = (rendering.cost, at_once.cost.baked_bytes);
    assert!(cost.bake_seconds > 0.0 && cost.baked_bytes == bytes && bytes > 1000, "{cost:?}");
    let memory = Baked::in_memory(&settings, &scene).unwrap();
    assert!(draw(&scene, &memory).picture == at_once.picture);
    let moved = draw(&other, &Baked::open(&folder, &settings, &other).unwrap());
    assert!(moved.picture == settings.render(&other, &other.camera).unwrap().picture);

    let finer = environment::Settings { map_error: 0.05, ..settings };
    let error = Baked::open(&folder, &finer, &scene).unwrap_err().to_string();
    assert!(error.contains("other settings (slices, map error 0.1; here slices, map error 0.05)"), "{error}");
    other.environment = Some(Environment::sky());
    let error = Baked::open(&folder, &settings, &other).unwrap_err().to_string();
    assert!(error.contains("of another scene: the environment differs"), "{error}");
    let reference = crate::render::reference::Settings::default();
    let error = Baked::open(&folder, &reference, &scene).unwrap_err().to_string();
    assert!(error.contains("`reference` bakes nothing"), "{error}");
    let error = bake(&reference, &scene, task(&temporary.path().join("no")), |_| ()).unwrap_err();
    assert!(error.exit_code() == 2 && error.to_string().contains("`reference` bakes nothing"));
}
