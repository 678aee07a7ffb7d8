//! Folders: compared byte for byte, copied, listed.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Every file below `folder` with its bytes, by relative path.
pub fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    listing(folder)
        .into_iter()
        .filter(|path| folder.join(path).is_file())
        .map(|path| {
            let bytes = std::fs::read(folder.join(&path)).expect("a listed file can be read");
            (path, bytes)
        })
        .collect()
}

/// Relative paths of all files and folders below `folder`, sorted.
pub fn listing(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut open = vec![folder.to_path_buf()];
    while let Some(next) = open.pop() {
        for entry in std::fs::read_dir(&next).expect("the folder is there") {
            let path = entry.expect("the folder can be listed").path();
            found.push(path.strip_prefix(folder).expect("a path below the folder").to_path_buf());
            if path.is_dir() {
                open.push(path);
            }
        }
    }
    found.sort();
    found
}

/// Asserts that two folders hold the same files with the same bytes, and at least one.
pub fn assert_same(left: &Path, right: &Path, what: &str) {
    let (left, right) = (contents(left), contents(right));
    assert!(!left.is_empty(), "{what}: nothing to compare");
    let names = |files: &BTreeMap<PathBuf, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(&left), names(&right), "{what}: other files");
    for (path, bytes) in &left {
        assert!(bytes == &right[path], "{what}: {} differs", path.display());
    }
}

/// Copies a folder with all that is in it.
pub fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).expect("the copy's folder can be made");
    for path in listing(from) {
        let (source, target) = (from.join(&path), to.join(&path));
        if source.is_dir() {
            std::fs::create_dir_all(target).expect("the copy's folder can be made");
        } else {
            std::fs::copy(source, target).expect("the file can be copied");
        }
    }
}

/// A run's journal up to where its last pose was photographed.
pub fn before_last_pose(journal: &str) -> &str {
    let pose = journal.rfind("{\"record\":\"pose\"").expect("a journal of at least one pose");
    &journal[..pose]
}
