//! Folders of what was baked: their files, and what may be wrong with them.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use serde::{Deserialize, Serialize};

use super::{FORMAT, Made, MadeOf, part_file};
use lobelia_base::error::{Error, Result};
use lobelia_base::files;
use lobelia_base::hash::sha256;

/// What was baked of what.
const DESCRIPTION: &str = "bake.json";
/// How long parts took.
const LOG: &str = "log.jsonl";
/// What a part begins with.
const MAGIC: &[u8; 8] = b"LOBEBAKE";
/// Parts at most: what a damaged description asks for beyond is not looked for.
const MOST_PARTS: usize = 1 << 20;
/// Bytes before a part's content.
pub(super) const HEAD: usize = 8 + 4 + 4 + 8 + 8 + 64 + 64;

/// The content of `bake.json`.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Description {
    format: u32,
    #[serde(flatten)]
    made_of: MadeOf,
    parts: usize,
}

/// A line of the log.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(super) struct Logged {
    pub(super) part: usize,
    pub(super) seconds: f64,
}

/// A folder.
#[derive(Debug, Clone)]
pub(super) struct Folder {
    pub(super) path: PathBuf,
    pub(super) made_of: MadeOf,
    pub(super) parts: usize,
    /// Hash of the description.
    key: String,
}

/// The head of a part.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Head {
    pub(super) rays: u64,
    pub(super) bytes: u64,
    key: String,
    content: String,
}

impl Folder {
    /// A folder to bake into; made where it is missing, kept where it is of the same.
    ///
    /// # Errors
    /// Input errors for a folder of something else, failures of the disk.
    pub(super) fn create(path: &Path, made_of: &MadeOf, parts: usize) -> Result<Self> {
        if path.join(DESCRIPTION).exists() {
            let folder = Self::open(path)?;
            folder.must_be(made_of).map_err(|error| error.hint("or name another folder"))?;
            if folder.parts != parts {
                return Err(folder.damaged(DESCRIPTION));
            }
            return Ok(folder);
        }
        files::try_folder(path)?;
        if parts > MOST_PARTS {
            return Err(Error::failure(format!("a bake has at most {MOST_PARTS} parts, not {parts}")));
        }
        let description = Description { format: FORMAT, made_of: made_of.clone(), parts };
        let text = serde_json::to_string_pretty(&description)
            .map_err(|error| Error::writing(&path.join(DESCRIPTION), error))?;
        files::write_bytes(&path.join(DESCRIPTION), text.as_bytes())?;
        Ok(Self { path: path.into(), made_of: made_of.clone(), parts, key: sha256(text.as_bytes()) })
    }

    /// Reads what a folder holds.
    ///
    /// # Errors
    /// Input errors for a folder without a description, and for one of another format.
    pub(super) fn open(path: &Path) -> Result<Self> {
        let file = path.join(DESCRIPTION);
        let text = match std::fs::read(&file) {
            Err(error) if error.kind() == ErrorKind::NotFound => {
                let message = "nothing was baked there; `lobelia bake SCENE --method M -o DIR` does";
                return Err(Error::input(format!("{}: {message}", path.display())));
            }
            read => read.map_err(|error| Error::reading(&file, error))?,
        };
        let damaged = || Error::input(format!("{}: damaged; bake into a new folder", file.display()));
        let value: serde_json::Value = serde_json::from_slice(&text).map_err(|_| damaged())?;
        let format = value.get("format").and_then(serde_json::Value::as_u64).ok_or_else(damaged)?;
        if format != u64::from(FORMAT) {
            return Err(Error::input(format!(
                "{}: baked in format {format} by another version, this one has format {FORMAT}; bake again",
                path.display()
            )));
        }
        let Description { made_of, parts, .. } = serde_json::from_value(value).map_err(|_| damaged())?;
        if parts > MOST_PARTS {
            return Err(damaged());
        }
        Ok(Self { path: path.into(), made_of, parts, key: sha256(&text) })
    }

    /// Refuses a folder that is of something else; the sentence says of what.
    pub(super) fn must_be(&self, made_of: &MadeOf) -> Result<()> {
        match difference(&self.made_of, made_of) {
            Some(difference) => {
                Err(Error::input(format!("{}: baked {difference}; bake again", self.path.display())))
            }
            None => Ok(()),
        }
    }

    pub(super) fn damaged(&self, what: &str) -> Error {
        Error::input(format!("{}: {what} is damaged; bake again to replace it", self.path.display()))
    }

    /// The heads of all parts, none for one that is missing.
    ///
    /// # Errors
    /// An input error for a part that is damaged or of another bake.
    pub(super) fn heads(&self) -> Result<Vec<Option<Head>>> {
        (0..self.parts).map(|index| self.head(index)).collect()
    }

    /// The parts that are missing.
    ///
    /// # Errors
    /// As [`Self::heads`].
    pub(super) fn missing(&self) -> Result<Vec<usize>> {
        let heads = self.heads()?;
        Ok((0..self.parts).filter(|index| heads[*index].is_none()).collect())
    }

    /// The head of a part, if that is there with as many bytes as the head says.
    ///
    /// # Errors
    /// As [`Self::heads`].
    pub(super) fn head(&self, index: usize) -> Result<Option<Head>> {
        let file = part_file(&self.path, index);
        let damaged = || self.damaged(&format!("part {index}"));
        let mut bytes = [0; HEAD];
        let mut opened = match File::open(&file) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            opened => opened.map_err(|error| Error::reading(&file, error))?,
        };
        opened.read_exact(&mut bytes).map_err(|_| damaged())?;
        let head = parse(&bytes, index).filter(|head| head.key == self.key).ok_or_else(damaged)?;
        let length = opened.metadata().map_err(|error| Error::reading(&file, error))?.len();
        if length != HEAD as u64 + head.bytes {
            return Err(damaged());
        }
        Ok(Some(head))
    }

    /// The content of a part.
    ///
    /// # Errors
    /// An input error for a part that is missing or damaged.
    pub(super) fn content(&self, index: usize) -> Result<Vec<u8>> {
        let file = part_file(&self.path, index);
        let mut bytes = std::fs::read(&file).map_err(|error| Error::reading(&file, error))?;
        let whole = bytes.first_chunk().and_then(|head| parse(head, index)).filter(|head| {
            head.key == self.key
                && (bytes.len() - HEAD) as u64 == head.bytes
                && sha256(&bytes[HEAD..]) == head.content
        });
        if whole.is_none() {
            return Err(self.damaged(&format!("part {index}")));
        }
        bytes.drain(..HEAD);
        Ok(bytes)
    }

    /// Writes a part, there whole or not at all.
    ///
    /// # Errors
    /// Failures of the disk.
    pub(super) fn write(&self, index: usize, made: &Made) -> Result<()> {
        let mut head = Vec::with_capacity(HEAD);
        head.extend(MAGIC);
        head.extend(FORMAT.to_le_bytes());
        head.extend((index as u32).to_le_bytes());
        head.extend(made.rays.to_le_bytes());
        head.extend((made.content.len() as u64).to_le_bytes());
        head.extend(self.key.as_bytes());
        head.extend(sha256(&made.content).as_bytes());
        files::write_atomically(&part_file(&self.path, index), |writer| {
            writer.write_all(&head)?;
            writer.write_all(&made.content)
        })
    }

    /// Notes how long parts took.
    ///
    /// # Errors
    /// Failures of the disk.
    pub(super) fn log(&self, lines: &[Logged]) -> Result<()> {
        let path = self.path.join(LOG);
        let text: String = lines
            .iter()
            .filter_map(|line| serde_json::to_string(line).ok())
            .map(|line| format!("{line}\n"))
            .collect();
        let append = || File::options().create(true).append(true).open(&path)?.write_all(text.as_bytes());
        append().map_err(|error| Error::writing(&path, error))
    }

    /// How long each part took, the last time that it was made; lines that a killed bake left half are passed
    /// over.
    pub(super) fn logged(&self) -> BTreeMap<usize, f64> {
        let text = std::fs::read_to_string(self.path.join(LOG)).unwrap_or_default();
        let lines = text.lines().filter_map(|line| serde_json::from_str::<Logged>(line).ok());
        lines.map(|line| (line.part, line.seconds)).collect()
    }

    /// Seconds that all parts took, as far as they are known.
    pub(super) fn seconds(&self) -> f64 {
        self.logged().values().sum()
    }
}

/// The head of a part of an index.
fn parse(bytes: &[u8; HEAD], index: usize) -> Option<Head> {
    let (magic, rest) = bytes.split_first_chunk::<8>()?;
    let (format, rest) = rest.split_first_chunk()?;
    let (own, rest) = rest.split_first_chunk()?;
    let (rays, rest) = rest.split_first_chunk()?;
    let (count, rest) = rest.split_first_chunk()?;
    let text = |bytes: &[u8]| Some(std::str::from_utf8(bytes).ok()?.to_string());
    let is_own = magic == MAGIC
        && u32::from_le_bytes(*format) == FORMAT
        && usize::try_from(u32::from_le_bytes(*own)) == Ok(index);
    is_own.then_some(Head {
        rays: u64::from_le_bytes(*rays),
        bytes: u64::from_le_bytes(*count),
        key: text(&rest[..64])?,
        content: text(&rest[64..])?,
    })
}

/// What something baked was baked for or of that this is not, in words.
pub(super) fn difference(baked: &MadeOf, wanted: &MadeOf) -> Option<String> {
    if baked.method != wanted.method {
        return Some(format!("for `{}`, not for `{}`", baked.method, wanted.method));
    }
    if baked.version != wanted.version {
        let (old, new) = (baked.version, wanted.version);
        return Some(format!("by version {old} of `{}`, this is version {new}", wanted.method));
    }
    if baked.settings != wanted.settings {
        return Some(format!("with other settings ({}; here {})", baked.settings, wanted.settings));
    }
    let names = baked.of.keys().chain(wanted.of.keys());
    let other = names.into_iter().find(|name| baked.of.get(*name) != wanted.of.get(*name))?;
    let value = |of: &MadeOf| of.of.get(other).filter(|value| value.len() < 64).cloned();
    let values =
        value(baked).zip(value(wanted)).map_or_else(String::new, |(a, b)| format!(" ({a}; here {b})"));
    Some(format!("of another scene: {other} differs{values}"))
}

/// The method that a folder was baked for.
///
/// # Errors
/// Input errors for a folder where nothing was baked, and for one of another format.
pub fn method_of(folder: &Path) -> Result<String> {
    Ok(Folder::open(folder)?.made_of.method)
}

/// What one folder holds.
#[derive(Debug, Clone)]
pub struct Held {
    /// The folder.
    pub path: PathBuf,
    /// What it was baked for and of.
    pub made_of: MadeOf,
    /// Parts that are there and whole by their heads, and all.
    pub parts: [usize; 2],
    /// Bytes of its files.
    pub bytes: u64,
    /// Seconds that baking took, as far as they are known.
    pub bake_seconds: f64,
    /// Seconds since the last part was written.
    pub age_seconds: f64,
}

/// What some folders hold, each one itself or, where nothing was baked there, the folders in it.
///
/// # Errors
/// Input errors for a folder that neither is one nor has any, and for descriptions that cannot be read.
pub fn list(paths: &[PathBuf]) -> Result<Vec<Held>> {
    let mut all = Vec::new();
    for path in paths {
        if path.join(DESCRIPTION).exists() {
            all.push(held(path)?);
            continue;
        }
        let entries = std::fs::read_dir(path).map_err(|error| Error::reading(path, error))?;
        let mut within: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
        within.retain(|path| path.join(DESCRIPTION).exists());
        within.sort();
        if within.is_empty() {
            return Err(Error::input(format!("{}: nothing was baked there", path.display())));
        }
        for path in within {
            all.push(held(&path)?);
        }
    }
    Ok(all)
}

fn held(path: &Path) -> Result<Held> {
    let folder = Folder::open(path)?;
    let there = (0..folder.parts).filter(|index| matches!(folder.head(*index), Ok(Some(_)))).count();
    let (mut bytes, mut last) = (0, SystemTime::UNIX_EPOCH);
    let entries = std::fs::read_dir(path).map_err(|error| Error::reading(path, error))?;
    for meta in entries.filter_map(|entry| entry.ok()?.metadata().ok()) {
        bytes += meta.len();
        last = last.max(meta.modified().unwrap_or(last));
    }
    Ok(Held {
        path: path.into(),
        parts: [there, folder.parts],
        bytes,
        bake_seconds: folder.seconds(),
        age_seconds: last.elapsed().unwrap_or_default().as_secs_f64(),
        made_of: folder.made_of,
    })
}
