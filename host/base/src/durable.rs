//! Files and folders that are there whole or not at all, after a crash or a cut of the power too: written
//! under a name that nothing else has, synced, renamed, and the folder synced.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

/// A name beside `path` that no file has: its own, then `ending` and a number that differs from process to
/// process and from call to call.
pub fn unused_name(path: &Path, ending: &str) -> PathBuf {
    static CALLS: AtomicU64 = AtomicU64::new(0);
    let time = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    loop {
        let call = CALLS.fetch_add(1, Ordering::Relaxed);
        let number = (u64::from(std::process::id()) << 32) ^ time.as_nanos() as u64 ^ (call << 16);
        let mut name = path.file_name().unwrap_or_default().to_os_string();
        name.push(format!(".{ending}-{number:012x}"));
        let unused = path.with_file_name(name);
        if unused.symlink_metadata().is_err() {
            return unused;
        }
    }
}

/// What a name stands for: the target of a symbolic link, which is to be replaced and not the link.
pub fn target(path: &Path) -> PathBuf {
    fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf())
}

/// The folder that a file or folder lies in.
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Waits until the names in a folder are on the disk.
///
/// # Errors
/// When the disk refuses.
pub fn sync_folder(folder: &Path) -> io::Result<()> {
    // Elsewhere a folder cannot be opened as a file, and renaming is as durable as it gets.
    if cfg!(unix) { File::open(folder)?.sync_all() } else { Ok(()) }
}

/// Writes a file through `fill`, and its folder first if that is missing. A process killed at any moment
/// leaves the old file or the new one. What is no file, as `/dev/null` or a pipe, is written to and not
/// replaced.
///
/// # Errors
/// When the folder or the disk refuses; the temporary file is then removed.
pub fn write(path: &Path, fill: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    let path = target(path);
    if path.metadata().is_ok_and(|meta| !meta.is_file() && !meta.is_dir()) {
        let mut writer = BufWriter::new(File::options().write(true).open(&path)?);
        return fill(&mut writer).and_then(|()| writer.flush());
    }
    fs::create_dir_all(folder_of(&path))?;
    let temporary = unused_name(&path, "tmp");
    let write = || -> io::Result<()> {
        let mut writer = BufWriter::new(File::create_new(&temporary)?);
        fill(&mut writer)?;
        writer.flush()?;
        writer.get_ref().sync_all()?;
        fs::rename(&temporary, &path)?;
        sync_folder(folder_of(&path))
    };
    write().inspect_err(|_| {
        // It may not exist; that it cannot be removed adds nothing to the first error.
        let _ = fs::remove_file(&temporary);
    })
}

/// Puts a folder, complete under a temporary name, in the place of `path`. What was there, if anything, is
/// removed once the new one is there to stay; nothing else is.
///
/// # Errors
/// When the disk refuses; what was there before is then put back.
pub fn replace_folder(temporary: &Path, path: &Path) -> io::Result<()> {
    sync_tree(temporary)?;
    // A folder cannot be replaced in one step: the earlier one goes aside, so that one of the two is always
    // whole.
    let aside = unused_name(path, "old");
    let earlier = path.exists();
    if earlier {
        fs::rename(path, &aside)?;
    }
    if let Err(error) = fs::rename(temporary, path) {
        if earlier {
            let _ = fs::rename(&aside, path);
        }
        return Err(error);
    }
    sync_folder(folder_of(path))?;
    if earlier { fs::remove_dir_all(&aside) } else { Ok(()) }
}

/// Waits until all files and names below a folder are on the disk.
fn sync_tree(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() { sync_tree(&path)? } else { File::open(&path)?.sync_all()? }
    }
    sync_folder(folder)
}

/// Tries whether a file or folder could be written at `path`: leaves nothing behind. Folders that are missing
/// can be made where the first one that there is takes a file.
///
/// # Errors
/// As writing there would give.
pub fn try_writing(path: &Path) -> io::Result<()> {
    let path = target(path);
    if path.metadata().is_ok_and(|meta| !meta.is_file() && !meta.is_dir()) {
        return Ok(());
    }
    let mut folder = folder_of(&path);
    while !folder.exists() {
        folder = folder_of(folder);
    }
    if !folder.is_dir() {
        return Err(io::Error::new(
            io::ErrorKind::NotADirectory,
            format!("{} is no folder", folder.display()),
        ));
    }
    let trial = unused_name(&folder.join("lobelia"), "try");
    File::create_new(&trial)?;
    fs::remove_file(&trial)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name());
        let mut names: Vec<String> = entries.map(|name| name.to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_temporary_and_takes_nobody_elses() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("kept.txt");
        fs::write(folder.path().join("kept.txt.tmp"), "mine").unwrap();
        write(&path, |writer| writer.write_all(b"old")).unwrap();
        let failed = write(&path, |writer| {
            writer.write_all(b"half of the n")?;
            Err(io::Error::other("disk full"))
        });
        assert_eq!(failed.unwrap_err().to_string(), "disk full");
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read(folder.path().join("kept.txt.tmp")).unwrap(), b"mine");
        assert_eq!(names(folder.path()), ["kept.txt", "kept.txt.tmp"]);
    }

    #[test]
    fn a_folder_is_made_for_a_file_and_tried_without_leaving_anything() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/b/new.txt");
        try_writing(&path).unwrap();
        assert!(names(folder.path()).is_empty());
        write(&path, |writer| writer.write_all(b"new")).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert!(try_writing(&path.join("below-a-file")).is_err());
    }

    #[cfg(unix)]
    #[test]
    fn links_and_devices_stay_what_they_are() {
        let folder = tempfile::tempdir().unwrap();
        let (link, file) = (folder.path().join("link"), folder.path().join("file"));
        fs::write(&file, "old").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        write(&link, |writer| writer.write_all(b"new")).unwrap();
        assert!(link.is_symlink() && fs::read(&file).unwrap() == b"new");
        let null = Path::new("/dev/null");
        try_writing(null).unwrap();
        write(null, |writer| writer.write_all(b"nothing")).unwrap();
        assert!(!null.metadata().unwrap().is_file());
        // A file system that takes no files, whoever asks.
        assert!(try_writing(Path::new("/proc/lobelia/out.exr")).is_err());
    }

    #[test]
    fn a_folder_takes_the_place_of_what_was_there_and_of_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in ["store", "store.old", "store.new", "store.zarr.old"] {
            fs::create_dir(at(name)).unwrap();
            fs::write(at(name).join("who"), name).unwrap();
        }
        replace_folder(&at("store.new"), &at("store")).unwrap();
        assert_eq!(names(folder.path()), ["store", "store.old", "store.zarr.old"]);
        assert_eq!(fs::read(at("store/who")).unwrap(), b"store.new");
        assert!(replace_folder(&at("gone"), &at("store")).is_err());
        assert_eq!(fs::read(at("store/who")).unwrap(), b"store.new");
    }
}
