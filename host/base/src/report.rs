//! The machine-readable report that every command can write (`--report FILE.json`).

use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::Serialize;
use serde_json::{Map, Value, json};

use crate::error::{Error, Result};
use crate::figures::ErrorFigure;
use crate::hash::sha256;
use crate::interrupt::interrupted;
use crate::warning::Warning;
use crate::{files, progress, provenance};

pub use crate::provenance::Input;

/// What a command did, with what, how long it took and how wrong it is.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// Version of the program.
    pub lobelia: String,
    /// The subcommand.
    pub command: String,
    /// When it began, UTC.
    pub date: String,
    /// The command line after the program's name.
    pub arguments: Vec<String>,
    /// Seed of every random choice.
    pub seed: u64,
    /// The machine.
    pub machine: Machine,
    /// Files read, with their hashes.
    pub inputs: Vec<Input>,
    /// Stages in order.
    pub stages: Vec<Stage>,
    /// Most memory that the process held, bytes; 0 where the system does not tell.
    pub peak_memory_bytes: u64,
    /// Errors.
    pub errors: Vec<ErrorFigure>,
    /// Counts and rates.
    pub figures: Map<String, Value>,
    /// What a person needs to know before the result is trusted; each was told in a line of its own.
    pub warnings: Vec<Warning>,
    /// Why the command failed; none when it did what it was asked for.
    pub failure: Option<String>,
}

/// The machine that a report was made on.
#[derive(Debug, Clone, Serialize)]
pub struct Machine {
    /// Processor.
    pub cpu: String,
    /// Threads that the program may use.
    pub cores: usize,
    /// Adapter of the GPU, when one was used.
    pub gpu: Option<String>,
}

/// A stage and its duration.
#[derive(Debug, Clone, Serialize)]
pub struct Stage {
    /// Name.
    pub name: String,
    /// Duration, s.
    pub seconds: f64,
}

impl Report {
    /// An empty report of this process's command.
    pub fn new(command: &str, seed: u64) -> Self {
        Self {
            lobelia: env!("CARGO_PKG_VERSION").into(),
            command: command.into(),
            date: provenance::now(),
            arguments: std::env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned()).collect(),
            seed,
            machine: Machine { cpu: cpu_name(), cores: rayon::current_num_threads(), gpu: None },
            inputs: Vec::new(),
            stages: Vec::new(),
            peak_memory_bytes: 0,
            errors: Vec::new(),
            figures: Map::new(),
            warnings: Vec::new(),
            failure: None,
        }
    }

    /// Runs a stage and notes its duration, also when it fails.
    pub fn stage<T>(&mut self, name: &str, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = work();
        self.stages.push(Stage { name: name.into(), seconds: start.elapsed().as_secs_f64() });
        result
    }

    /// Notes an input and, for a file, its hash. What can be read only once, as a pipe, has none.
    pub fn input(&mut self, path: &Path) {
        let sha256 = path.is_file().then(|| file_sha256(path)).flatten();
        self.inputs.push(Input { path: path.display().to_string(), sha256 });
    }

    /// Notes a count or a rate.
    pub fn figure(&mut self, name: &str, value: impl Into<Value>) {
        self.figures.insert(name.into(), value.into());
    }

    /// Seconds of all stages.
    pub fn seconds(&self) -> f64 {
        self.stages.iter().map(|stage| stage.seconds).sum()
    }

    /// Notes an input of which a part tells which one it is, with the hash of that.
    pub fn input_by(&mut self, path: &Path, sha256: String) {
        self.inputs.push(Input { path: path.display().to_string(), sha256: Some(sha256) });
    }

    /// What a file that this command made says of it.
    pub fn provenance(&self) -> provenance::Texts {
        provenance::texts(&self.arguments, &self.inputs)
    }

    /// Notes the hashes of folders, which take as long as reading them, and the peak of memory so far; called
    /// last. `of_store` gives that of a sampled SBRDF's size and poses, since its samples take as long to
    /// read as the work took.
    pub fn finish(&mut self, of_store: impl Fn(&Path) -> Option<String>) {
        for input in self.inputs.iter_mut().filter(|input| input.sha256.is_none()) {
            let folder = Path::new(&input.path);
            let is_store = folder.join("zarr.json").is_file();
            input.sha256 = if is_store { of_store(folder) } else { folder_sha256(folder) };
        }
        self.peak_memory_bytes = peak_memory_bytes();
    }

    /// Writes the report.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn write(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_vec_pretty(&json!(self)).map_err(|error| {
            Error::failure(format!("the report cannot be written: {error}")).caused_by(error)
        })?;
        files::write_bytes(path, &text)
    }
}

fn file_sha256(path: &Path) -> Option<String> {
    std::fs::read(path).ok().map(|bytes| sha256(&bytes))
}

/// Hash of the names and hashes of all files of a folder. None where one cannot be read, and after Ctrl-C.
fn folder_sha256(folder: &Path) -> Option<String> {
    let mut files = Vec::new();
    list(folder, &mut files).ok()?;
    files.sort();
    let bar = progress::bar("hashing", files.len() as u64, "files");
    let mut all = String::new();
    for path in &files {
        if interrupted() {
            return None;
        }
        let name = path.strip_prefix(folder).unwrap_or(path).to_string_lossy();
        all += &format!("{name} {}\n", file_sha256(path)?);
        bar.advance(1);
    }
    Some(sha256(all.as_bytes()))
}

/// All files in a folder and those within. Links, which may lead out of it or round in circles, and pipes are
/// left out.
fn list(folder: &Path, files: &mut Vec<PathBuf>) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        let kind = path.symlink_metadata()?;
        if kind.is_dir() {
            list(&path, files)?;
        } else if kind.is_file() {
            files.push(path);
        }
    }
    Ok(())
}

/// The processor's name as Linux tells it, or the architecture.
fn cpu_name() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name =
        info.lines().find(|line| line.starts_with("model name")).and_then(|line| line.split(": ").nth(1));
    name.unwrap_or(std::env::consts::ARCH).to_string()
}

/// Seconds of CPU time of all the process's threads, as Linux tells them in hundredths.
pub fn cpu_seconds() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    // After the name, which may have spaces, the 12th and 13th field: user and system.
    let ticks = stat.rsplit(')').next()?.split_whitespace().skip(11).take(2);
    Some(ticks.filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / 100.0)
}

/// The process's largest resident set, bytes, as Linux tells it; 0 elsewhere.
fn peak_memory_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kib = line.and_then(|text| text.trim().trim_end_matches("kB").trim().parse::<u64>().ok());
    kib.unwrap_or(0) * 1024
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_s_hash_is_that_of_its_files_and_their_names() {
        let folder = tempfile::tempdir().unwrap();
        let of = |name: &str, content: &str| {
            files::write_bytes(&folder.path().join("store/c/0"), b"chunk").unwrap();
            files::write_bytes(&folder.path().join("store").join(name), content.as_bytes()).unwrap();
            let mut report = Report::new("fit", 1);
            report.input(&folder.path().join("store"));
            report.finish(|_| None);
            std::fs::remove_dir_all(folder.path().join("store")).unwrap();
            report.inputs[0].sha256.clone().unwrap()
        };
        let hash = of("a.json", "{}");
        assert!(hash.len() == 64 && hash == of("a.json", "{}"));
        assert!(hash != of("a.json", "[]") && hash != of("other.json", "{}"));
        let mut report = Report::new("fit", 1);
        report.input(&folder.path().join("gone"));
        report.finish(|_| None);
        assert_eq!(report.inputs[0].sha256, None);
        assert!(report.date.starts_with("20") && report.date.ends_with('Z'), "{}", report.date);
    }

    #[cfg(unix)]
    #[test]
    fn a_folder_s_hash_follows_no_links() {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("store");
        files::write_bytes(&store.join("a/0"), b"chunk").unwrap();
        let before = folder_sha256(&store).unwrap();
        std::os::unix::fs::symlink(&store, store.join("a/round")).unwrap();
        std::os::unix::fs::symlink(store.join("a/0"), store.join("b")).unwrap();
        assert_eq!(folder_sha256(&store).unwrap(), before);
    }

    #[test]
    fn a_store_s_hash_is_asked_of_who_knows_stores() {
        let folder = tempfile::tempdir().unwrap();
        files::write_bytes(&folder.path().join("zarr.json"), b"{}").unwrap();
        let mut report = Report::new("fit", 1);
        report.input(folder.path());
        report.finish(|path| Some(path.display().to_string()));
        assert_eq!(report.inputs[0].sha256, Some(folder.path().display().to_string()));
    }
}
