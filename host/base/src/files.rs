//! Files that are there whole or not at all, see [`durable`]; outputs that are tried before the work.

use std::io::Write;
use std::path::{Path, PathBuf};

use crate::durable;
use crate::error::{Error, Result};

/// Writes a file through `fill`, and the folders that it lacks; a process killed at any moment leaves the old
/// file or the new one.
///
/// # Errors
/// When the folder or the disk refuses.
pub fn write_atomically(path: &Path, fill: impl FnOnce(&mut dyn Write) -> std::io::Result<()>) -> Result<()> {
    durable::write(path, fill).map_err(|error| Error::writing(path, error))
}

/// Writes bytes atomically, see [`write_atomically`].
///
/// # Errors
/// As [`write_atomically`].
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    write_atomically(path, |writer| writer.write_all(bytes))
}

/// Tries whether a file can be written at `path`, before the work whose result it shall hold; leaves nothing
/// behind.
///
/// # Errors
/// An input error for a name that a folder has, and a failure where folder or disk refuse.
pub fn try_file(path: &Path) -> Result<()> {
    if path.is_dir() {
        return Err(Error::input(format!("{}: a folder, so no file can be written there", path.display())));
    }
    durable::try_writing(path).map_err(|error| Error::writing(path, error))
}

/// Tries whether files can be written into the folder `path`, which may be missing; leaves nothing behind.
///
/// # Errors
/// As [`try_file`], for a name that a file has.
pub fn try_folder(path: &Path) -> Result<()> {
    if path.exists() && !path.is_dir() {
        return Err(Error::input(format!(
            "{}: no folder, so no files can be written into it",
            path.display()
        )));
    }
    durable::try_writing(&path.join("file")).map_err(|error| Error::writing(path, error))
}

/// Whether two names are those of one file or folder, which need not be there yet. What is neither, as a
/// pipe, may be named twice.
pub fn same(first: &Path, second: &Path) -> bool {
    match (std::fs::metadata(first), std::fs::metadata(second)) {
        (Ok(first_meta), Ok(second_meta)) => {
            (first_meta.is_file() || first_meta.is_dir())
                && (same_entry(&first_meta, &second_meta) || whole_name(first) == whole_name(second))
        }
        (Err(_), Err(_)) => whole_name(first) == whole_name(second),
        _ => false,
    }
}

#[cfg(unix)]
fn same_entry(first: &std::fs::Metadata, second: &std::fs::Metadata) -> bool {
    use std::os::unix::fs::MetadataExt;
    (first.dev(), first.ino()) == (second.dev(), second.ino())
}

#[cfg(not(unix))]
fn same_entry(_: &std::fs::Metadata, _: &std::fs::Metadata) -> bool {
    false
}

/// A name from the root on, links followed as far as there is something.
fn whole_name(path: &Path) -> PathBuf {
    if let Ok(whole) = path.canonicalize() {
        return whole;
    }
    match (path.parent(), path.file_name()) {
        (Some(folder), Some(name)) => {
            let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
            whole_name(folder).join(name)
        }
        _ => path.into(),
    }
}

/// What a file or folder is that stands in another's place, by its content or its name's ending; none for
/// what that does not tell.
pub fn what_is(path: &Path) -> Option<&'static str> {
    if path.is_dir() {
        let has = |name: &str| path.join(name).is_file();
        let kinds = [
            ("journal.jsonl", "a run"),
            ("zarr.json", "a sampled SBRDF"),
            ("bake.json", "what was baked of a scene"),
        ];
        return Some(kinds.into_iter().find(|(name, _)| has(name)).map_or("a folder", |(_, what)| what));
    }
    Some(match ending(path).as_str() {
        "exr" => "an SBRDF map or a picture",
        "hdr" | "pic" | "png" | "jpg" | "jpeg" => "a picture",
        "tif" | "tiff" => "a photograph",
        "gltf" | "glb" | "obj" | "ply" | "bpt" => "a mesh",
        "zarr" => "a sampled SBRDF",
        "brdf" | "binary" | "alta" => "a measured table",
        _ => return None,
    })
}

/// What a file's name ends in, in small letters whatever the name has; empty without a point.
pub fn ending(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_lowercase()
}

/// Creates a folder and its parents, there to stay.
///
/// # Errors
/// When the folder cannot be made.
pub fn create_folder(path: &Path) -> Result<()> {
    let create = || -> std::io::Result<()> {
        std::fs::create_dir_all(path)?;
        durable::sync_folder(durable::folder_of(path))
    };
    create().map_err(|error| Error::writing(path, error))
}

/// Reads a whole text file.
///
/// # Errors
/// Input errors for a missing or non-UTF-8 file.
pub fn read_text(path: &Path) -> Result<String> {
    let bytes = std::fs::read(path).map_err(|error| Error::reading(path, error))?;
    let not_utf8 = || {
        let what = what_is(path).map_or_else(
            || "not a text in UTF-8; save it as one".to_string(),
            |what| format!("{what}, not a text in UTF-8"),
        );
        Error::input(format!("{}: {what}", path.display()))
    };
    String::from_utf8(bytes).map_err(|_| not_utf8())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_one_file_are_told_to_be_that_whatever_they_look_like() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        write_bytes(&place("a/file"), b"here").unwrap();
        assert!(same(&place("a/file"), &place("a/../a/file")) && same(&place("a/new"), &place("a/./new")));
        assert!(same(&place("b/c/new"), &place("b/c/new")) && !same(&place("a/file"), &place("a/new")));
        assert!(same(Path::new("new"), Path::new("./new")) && !same(&place("a"), &place("a/file")));
        write_bytes(&place("run/journal.jsonl"), b"").unwrap();
        assert_eq!(what_is(&place("run")), Some("a run"));
        assert_eq!(
            (what_is(&place("a")), what_is(&place("m.EXR"))),
            (Some("a folder"), Some("an SBRDF map or a picture"))
        );
    }

    #[test]
    fn an_output_that_cannot_be_is_told_before_the_work_by_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file.txt");
        write_bytes(&file, b"here").unwrap();
        assert_eq!(try_file(folder.path()).unwrap_err().exit_code(), 2);
        assert_eq!(try_folder(&file).unwrap_err().exit_code(), 2);
        let below = try_file(&file.join("out.exr")).unwrap_err();
        assert!(below.exit_code() == 1 && below.to_string().contains("file.txt"), "{below}");
        try_file(&file).unwrap();
        try_folder(&folder.path().join("new/folder")).unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
