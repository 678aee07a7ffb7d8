//! What a method prepares once and stores: [`Bake`], and what it comes to, [`Baked`].
//!
//! A folder holds `bake.json`, which says what was baked of what, a file a part, and `log.jsonl`, which says
//! how long parts took and is no part of what was baked. The same scene and settings give the same
//! `bake.json` and the same parts, byte for byte, whatever the number of threads, of chunks, and of times
//! that baking was killed. Numbers of a part's head are little-endian:
//!
//! | bytes | what |
//! |---|---|
//! | 8 | `LOBEBAKE` |
//! | 4 | [`FORMAT`] |
//! | 4 | the part's index |
//! | 8 | rays cast for it |
//! | 8 | bytes of its content |
//! | 64 | hash of `bake.json`'s content, hexadecimal |
//! | 64 | hash of its content |
//! | … | its content, which is the method's own |

mod folder;
mod run;
#[cfg(test)]
pub(in crate::render) mod tests;

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::{Deserialize, Serialize};

use super::Renderer;
use crate::scene::Scene;
use folder::Folder;
use lobelia_base::error::{Error, Result};
use lobelia_base::progress;

pub use folder::{Held, list, method_of};
pub use run::{Estimate, Outcome, Task, bake, merge};

/// Number of the format of folders. Folders of another are refused.
pub const FORMAT: u32 = 1;

/// What tells what was baked from anything else: if it is the same, so are all parts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct MadeOf {
    /// The method's name.
    pub method: String,
    /// Number of the method's own format, which it raises when its parts, or how they come about, change.
    pub version: u32,
    /// The settings that baking depends on, in words.
    pub settings: String,
    /// Hashes ([`crate::scene::hash`]) or values of what it is of, by name ("the environment", "the meshes"):
    /// of those things alone that baking depends on, so that what it does not depend on may change.
    pub of: BTreeMap<String, String>,
}

/// One part of what is to be baked.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// Work, in a unit that the method's parts share.
    pub work: f64,
    /// Bytes of its content, as far as they are known.
    pub bytes: u64,
    /// Parts before it that must have been baked.
    pub needs: Range<usize>,
}

/// What came of a part.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Made {
    /// Its content, a function of scene and settings.
    pub content: Vec<u8>,
    /// Rays cast.
    pub rays: u64,
}

/// The work of baking a scene. Its parts are made one after another; a part that takes long shares its work
/// among threads.
pub trait Bake {
    /// All parts, of some seconds and some megabytes each at most where that is possible: one is what a
    /// killed bake loses.
    fn parts(&self) -> Vec<Part>;

    /// Makes a part; `done` has those that it needs.
    ///
    /// # Errors
    /// Failures of the device, and of reading what is done.
    fn part(&self, index: usize, done: &Baked) -> Result<Made>;
}

/// What was baked, in a folder or in memory, or nothing for a method that bakes nothing.
#[derive(Debug)]
pub struct Baked {
    store: Store,
    /// Seconds that it took, as far as they are known.
    pub seconds: f64,
    /// Rays that it took.
    pub rays: u64,
    /// Bytes of all parts.
    pub bytes: u64,
}

#[derive(Debug)]
enum Store {
    Memory(Vec<Vec<u8>>),
    Folder(Folder),
}

impl Baked {
    /// For methods that bake nothing.
    pub fn nothing() -> Self {
        Self { store: Store::Memory(Vec::new()), seconds: 0.0, rays: 0, bytes: 0 }
    }

    /// Bakes a scene in memory.
    ///
    /// # Errors
    /// Those of the method.
    pub fn in_memory<R: Renderer + ?Sized>(renderer: &R, scene: &Scene) -> Result<Self> {
        let start = Instant::now();
        let Some(work) = renderer.bake(scene)? else { return Ok(Self::nothing()) };
        let parts = work.parts();
        let bar = progress::bar("baking", parts.len() as u64, "parts");
        let mut baked = Self::nothing();
        for index in 0..parts.len() {
            let made = work.part(index, &baked)?;
            baked.bytes += made.content.len() as u64;
            baked.rays += made.rays;
            if let Store::Memory(parts) = &mut baked.store {
                parts.push(made.content);
            }
            bar.advance(1);
        }
        baked.seconds = start.elapsed().as_secs_f64();
        Ok(baked)
    }

    /// Opens a folder, whose parts must all be there, of the sizes that they should have; their content is
    /// checked as it is read.
    ///
    /// # Errors
    /// Input errors for a folder that is none, or of another scene, of other settings, or of another version;
    /// and for a part that is missing or damaged.
    pub fn open(path: &Path, renderer: &dyn Renderer, scene: &Scene) -> Result<Self> {
        let folder = Folder::open(path)?;
        let made_of = renderer.made_of(scene)?.ok_or_else(|| {
            let own = renderer.name();
            Error::input(format!(
                "{}: `{own}` bakes nothing; it was baked for another method",
                path.display()
            ))
        })?;
        folder.must_be(&made_of)?;
        Self::of(folder)
    }

    /// A folder that is complete.
    fn of(folder: Folder) -> Result<Self> {
        let missing = folder.missing()?;
        if !missing.is_empty() {
            let [named, all] = [run::named(&missing), folder.parts.to_string()];
            return Err(Error::input(format!(
                "{}: not all parts are baked; missing: {named} of {all}; bake again to go on",
                folder.path.display()
            )));
        }
        let mut baked = Self { seconds: folder.seconds(), ..Self::nothing() };
        for head in folder.heads()?.into_iter().flatten() {
            baked.rays += head.rays;
            baked.bytes += head.bytes;
        }
        baked.store = Store::Folder(folder);
        Ok(baked)
    }

    /// The parts of a folder, as far as there are any.
    fn of_parts_in(folder: Folder) -> Self {
        Self { store: Store::Folder(folder), ..Self::nothing() }
    }

    /// Number of parts.
    pub fn parts(&self) -> usize {
        match &self.store {
            Store::Memory(parts) => parts.len(),
            Store::Folder(folder) => folder.parts,
        }
    }

    /// The content of a part.
    ///
    /// # Errors
    /// An input error for a part that is missing or damaged.
    pub fn part(&self, index: usize) -> Result<Vec<u8>> {
        match &self.store {
            Store::Memory(parts) => {
                let content = parts.get(index).cloned();
                content.ok_or_else(|| Error::failure(format!("part {index} was not baked")))
            }
            Store::Folder(folder) => folder.content(index),
        }
    }

    /// The folder that it is in, for a method that reads parts of parts.
    pub fn folder(&self) -> Option<&Path> {
        match &self.store {
            Store::Memory(_) => None,
            Store::Folder(folder) => Some(&folder.path),
        }
    }
}

/// The file of a part in a folder.
pub fn part_file(folder: &Path, index: usize) -> PathBuf {
    folder.join(format!("{index:06}.part"))
}
