//! The `lobelia` command as a process.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;
use std::time::SystemTime;

/// Folders whose sources the command is built from.
const SOURCES: [&str; 5] = ["host", "hil-sim", "firmware", "protocol", "shaders"];

/// The command's executable of the profile that this test was built with; built first when it is missing or
/// older than its sources.
pub fn executable() -> &'static Path {
    static BUILT: OnceLock<PathBuf> = OnceLock::new();
    BUILT.get_or_init(|| {
        // target/PROFILE/deps/TEST
        let test = std::env::current_exe().expect("the test knows its own path");
        let folder = test.parent().and_then(Path::parent).expect("a test lies in target/PROFILE/deps");
        let path = folder.join(format!("lobelia{}", std::env::consts::EXE_SUFFIX));
        let modified = path.metadata().and_then(|meta| meta.modified()).ok();
        if modified.is_none_or(|built| SOURCES.iter().any(|source| newest(&root().join(source)) > built)) {
            build(folder.file_name() == Some(OsStr::new("release")));
        }
        path
    })
}

/// The workspace's root.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("tests/ lies in the workspace").to_path_buf()
}

/// When the newest source below a folder was changed.
fn newest(folder: &Path) -> SystemTime {
    let entries = std::fs::read_dir(folder).expect("the sources are there");
    let changed = entries.filter_map(|entry| {
        let entry = entry.ok()?;
        let path = entry.path();
        if path.is_dir() {
            return Some(newest(&path));
        }
        let is_source = path.extension().is_some_and(|e| e == "rs" || e == "wgsl" || e == "toml");
        is_source.then(|| entry.metadata().and_then(|meta| meta.modified()).ok())?
    });
    changed.max().unwrap_or(SystemTime::UNIX_EPOCH)
}

fn build(release: bool) {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut command = Command::new(cargo);
    command.args(["build", "--quiet", "--package", "lobelia"]).current_dir(root());
    if release {
        command.arg("--release");
    }
    assert!(command.status().expect("cargo runs").success(), "the lobelia command does not build");
}

/// The command with arguments, to be run in `folder`.
pub fn lobelia<S: AsRef<OsStr>>(folder: &Path, arguments: &[S]) -> Command {
    let mut command = Command::new(executable());
    command.args(arguments).current_dir(folder).stdin(Stdio::null());
    command
}

/// What a command that ended said.
#[derive(Debug)]
pub struct Said {
    /// Exit code; `None` after a signal.
    pub code: Option<i32>,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
}

/// Runs the command to its end.
pub fn run<S: AsRef<OsStr>>(folder: &Path, arguments: &[S]) -> Said {
    said(lobelia(folder, arguments).output().expect("the command starts"))
}

/// What a finished process said.
pub fn said(output: Output) -> Said {
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("the command writes UTF-8");
    Said { code: output.status.code(), stdout: text(output.stdout), stderr: text(output.stderr) }
}

/// Runs the command, which must succeed; gives its standard output.
pub fn succeed<S: AsRef<OsStr>>(folder: &Path, arguments: &[S]) -> String {
    let said = run(folder, arguments);
    assert_eq!(said.code, Some(0), "{}", said.stderr);
    said.stdout
}

impl Said {
    /// Asserts an exit code and, beside warnings, exactly one sentence on standard error that holds every one
    /// of `parts`.
    pub fn refuses(&self, code: i32, parts: &[&str]) {
        assert_eq!(self.code, Some(code), "{self:?}");
        let lines: Vec<&str> = self.stderr.lines().filter(|line| !line.starts_with("warning: ")).collect();
        assert_eq!(lines.len(), 1, "not one sentence: {}", self.stderr);
        assert!(lines[0].starts_with("lobelia: "), "{}", self.stderr);
        for part in parts {
            assert!(self.stderr.contains(part), "`{part}` is not in: {}", self.stderr);
        }
    }
}
