//! The run's journal: one JSON record a line, only ever appended to, synced after every record.
//!
//! A run killed at any moment leaves whole records and at most one torn last line, which reading drops.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use lobelia_base::durable;
use lobelia_base::error::{Error, Result};
use lobelia_base::files;
use lobelia_base::toml_file::plain;

/// Name of the journal in a run's folder.
pub const FILE_NAME: &str = "journal.jsonl";

/// One step of a run that is done and whose files are on the disk.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "record", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Record {
    /// The run began: what it was planned with.
    Started {
        /// Version of the program.
        lobelia: String,
        /// SHA-256 of plan.toml.
        plan_sha256: String,
        /// SHA-256 of rig.toml.
        rig_sha256: String,
    },
    /// All axes found their switches.
    Homed {
        /// The controller's clock.
        controller_us: u64,
    },
    /// A frame without light was taken.
    Dark {
        /// Number of the dark frame.
        index: usize,
        /// The frame.
        exposure: ExposureRecord,
        /// The controller's clock.
        controller_us: u64,
    },
    /// The lamp was switched on.
    LampOn {
        /// The controller's clock.
        controller_us: u64,
    },
    /// All exposures of a pose were taken.
    Pose {
        /// Number of the pose in the plan.
        index: usize,
        /// Its frames, shortest first.
        exposures: Vec<ExposureRecord>,
        /// The controller's clock.
        controller_us: u64,
    },
    /// The home switches were where they should be: so many poses were photographed where the plan has them.
    Checked {
        /// Poses from the plan's first one on.
        poses: usize,
        /// By how many steps each axis was off, within the tolerance.
        lost_steps: [i32; 4],
        /// The controller's clock.
        controller_us: u64,
    },
    /// They were not: poses from one on have to be photographed again.
    Suspect {
        /// The first of them.
        from: usize,
        /// By how many steps each axis was off.
        lost_steps: [i32; 4],
        /// The controller's clock.
        controller_us: u64,
    },
    /// How well the controller kept up until the run's end, the worst since it was started.
    Health {
        /// How late the latest step was, µs.
        worst_late_us: u32,
        /// How long the longest turn of its main loop took while axes moved, µs; 0 where it does not tell.
        longest_poll_us: u32,
        /// Bytes of its stack used, and that there are, where it can tell.
        stack: Option<[u32; 2]>,
        /// Bytes lost on receipt.
        overruns: u32,
        /// Its supply, mV, where it can tell.
        supply_mv: Option<u16>,
        /// The controller's clock.
        controller_us: u64,
    },
    /// The run is complete.
    Finished {
        /// The controller's clock.
        controller_us: u64,
    },
}

impl Record {
    /// The controller's clock when the record was written, µs; `None` before the controller was asked.
    pub fn controller_us(&self) -> Option<u64> {
        match self {
            Self::Started { .. } => None,
            Self::Homed { controller_us }
            | Self::Dark { controller_us, .. }
            | Self::LampOn { controller_us }
            | Self::Pose { controller_us, .. }
            | Self::Checked { controller_us, .. }
            | Self::Suspect { controller_us, .. }
            | Self::Health { controller_us, .. }
            | Self::Finished { controller_us } => Some(*controller_us),
        }
    }
}

/// One photograph.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExposureRecord {
    /// File, relative to the run's folder.
    pub file: String,
    /// Time that the shutter was open, by the controller, s.
    pub open_s: f64,
    /// The lamp's reference reading over that time.
    pub lamp_reading: f64,
    /// How much the lamp flickered meanwhile: standard deviation of its readings over their mean.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flicker: Option<f64>,
}

/// The journal, open for appending.
pub struct Journal {
    path: PathBuf,
    file: File,
}

impl Journal {
    /// Starts the journal of a new run. One without a whole record, which a run killed at its very start
    /// leaves, is replaced.
    ///
    /// # Errors
    /// When a run was recorded there already, or the disk refuses.
    pub fn create(folder: &Path) -> Result<Self> {
        refuse_recorded(folder)?;
        let path = folder.join(FILE_NAME);
        let opened = OpenOptions::new().append(true).create(true).open(&path);
        let file = opened.map_err(|error| Error::writing(&path, error))?;
        lock(&file, folder)?;
        let emptied = file.set_len(0).map(|()| file);
        let kept = emptied.and_then(|file| {
            file.sync_all()?;
            durable::sync_folder(folder)?;
            Ok(file)
        });
        let file = kept.map_err(|error| Error::writing(&path, error))?;
        Ok(Self { path, file })
    }

    /// Opens the journal of a run to continue it, cutting off a torn last line; returns what it holds.
    ///
    /// # Errors
    /// Input errors for a missing or damaged journal, naming the line.
    pub fn resume(folder: &Path) -> Result<(Self, Vec<Record>)> {
        let path = folder.join(FILE_NAME);
        let mut file = OpenOptions::new().read(true).write(true).open(&path).map_err(|error| {
            no_run(folder).unwrap_or_else(|| Error::reading(&path, error)).at("no run to resume")
        })?;
        lock(&file, folder)?;
        let (records, whole) = parse(&mut file, &path)?;
        file.set_len(whole).map_err(|error| Error::writing(&path, error))?;
        file.seek(SeekFrom::End(0)).map_err(|error| Error::writing(&path, error))?;
        Ok((Self { path, file }, records))
    }

    /// Appends a record and waits until it is on the disk.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn append(&mut self, record: &Record) -> Result<()> {
        let mut line = serde_json::to_vec(record)
            .map_err(|error| Error::failure(format!("journal: {error}")).caused_by(error))?;
        line.push(b'\n');
        let written = self.file.write_all(&line).and_then(|()| self.file.sync_data());
        written.map_err(|error| Error::writing(&self.path, error))
    }
}

/// Keeps a run to one process at a time, until its journal is closed or the process is gone. Where a file
/// system has no locks, nothing is kept.
fn lock(journal: &File, folder: &Path) -> Result<()> {
    match journal.try_lock() {
        Err(TryLockError::WouldBlock) => {
            let message = "another acquire is at work on this run; let it end, or stop it with Ctrl-C";
            Err(Error::input(format!("{}: {message}", folder.display())))
        }
        Ok(()) | Err(TryLockError::Error(_)) => Ok(()),
    }
}

/// Refuses a folder whose journal holds a record, and one with files of something else, which a run would
/// overwrite.
///
/// # Errors
/// An input error that says how to go on.
pub fn refuse_recorded(folder: &Path) -> Result<()> {
    let refused = |why: &str| Err(Error::input(format!("{}: {why}", folder.display())));
    match std::fs::read(folder.join(FILE_NAME)) {
        // A run that has done nothing yet, as one whose rig the controller refuses, has nothing to lose.
        Ok(bytes) if bytes.contains(&b'\n') && !has_only_begun(&bytes) => {
            refused("a run was recorded here already; continue it with --resume or name another folder")
        }
        Ok(_) => Ok(()),
        Err(_) => {
            let taken = ["plan.toml", "rig.toml", "frames"].iter().any(|name| folder.join(name).exists());
            if taken {
                refused("holds files of something else than a run; name another folder")
            } else {
                Ok(())
            }
        }
    }
}

/// Whether a journal's one whole line says that a run began.
fn has_only_begun(journal: &[u8]) -> bool {
    let Some(end) = journal.iter().position(|&byte| byte == b'\n') else { return true };
    let begun = matches!(serde_json::from_slice(&journal[..end]), Ok(Record::Started { .. }));
    begun && !journal[end + 1..].contains(&b'\n')
}

/// Reads the whole records of a run.
///
/// # Errors
/// Input errors for a missing or damaged journal, naming the line.
pub fn read(folder: &Path) -> Result<Vec<Record>> {
    let path = folder.join(FILE_NAME);
    let mut file =
        File::open(&path).map_err(|error| no_run(folder).unwrap_or_else(|| Error::reading(&path, error)))?;
    Ok(parse(&mut file, &path)?.0)
}

/// What is where a run should be, if that is none.
fn no_run(folder: &Path) -> Option<Error> {
    let what = match files::what_is(folder) {
        Some("a run") => return None,
        _ if !folder.exists() => "there is no such run".to_string(),
        Some(what) => format!("{what}, not a run, which has a {FILE_NAME}"),
        None => format!("a file, not a run's folder, which has a {FILE_NAME}"),
    };
    Some(Error::input(format!("{}: {what}", folder.display())))
}

/// The whole records and the length of the text that holds them.
fn parse(file: &mut File, path: &Path) -> Result<(Vec<Record>, u64)> {
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).map_err(|error| Error::reading(path, error))?;
    let whole = bytes.iter().rposition(|&byte| byte == b'\n').map_or(0, |last| last + 1);
    let lines = bytes[..whole].split(|&byte| byte == b'\n').filter(|line| !line.is_empty());
    let records = lines
        .enumerate()
        .map(|(index, line)| {
            serde_json::from_slice(line).map_err(|error| {
                // The parser knows of this line alone.
                let place = format!(" at line {} column {}", error.line(), error.column());
                let why = plain(&error.to_string().replace(&place, ""));
                let (path, line, column) = (path.display(), index + 1, error.column());
                Error::input(format!("{path}, line {line}, column {column}: damaged record: {why}"))
            })
        })
        .collect::<Result<Vec<Record>>>()?;
    Ok((records, whole as u64))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn records() -> Vec<Record> {
        let exposure = ExposureRecord {
            file: "frames/x.tiff".into(),
            open_s: 0.25,
            lamp_reading: 30000.0,
            flicker: Some(0.001),
        };
        vec![
            Record::Homed { controller_us: 5 },
            Record::Dark { index: 0, exposure: exposure.clone(), controller_us: 7 },
            Record::Pose { index: 0, exposures: vec![exposure], controller_us: 9 },
        ]
    }

    #[test]
    fn a_journal_cut_at_any_byte_gives_its_whole_records_and_can_be_continued() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE_NAME);
        let mut journal = Journal::create(folder.path()).unwrap();
        records().iter().for_each(|record| journal.append(record).unwrap());
        drop(journal);
        let bytes = std::fs::read(&path).unwrap();
        for length in 0..=bytes.len() {
            std::fs::write(&path, &bytes[..length]).unwrap();
            let whole = bytes[..length].iter().filter(|&&byte| byte == b'\n').count();
            let (mut journal, found) = Journal::resume(folder.path()).unwrap();
            assert_eq!(found, records()[..whole]);
            journal.append(&Record::Finished { controller_us: 1 }).unwrap();
            assert_eq!(read(folder.path()).unwrap().len(), whole + 1);
        }
    }

    #[test]
    fn a_run_that_is_being_written_is_left_to_the_one_that_writes_it() {
        let folder = tempfile::tempdir().unwrap();
        let mut first = Journal::create(folder.path()).unwrap();
        first.append(&records()[0]).unwrap();
        let error = Journal::resume(folder.path()).err().unwrap();
        assert!(error.exit_code() == 2 && error.to_string().contains("another acquire"), "{error}");
        first.append(&records()[1]).unwrap();
        assert_eq!(read(folder.path()).unwrap().len(), 2, "who only reads may");
        drop(first);
        assert_eq!(Journal::resume(folder.path()).unwrap().1.len(), 2);
    }

    #[test]
    fn a_run_that_has_only_begun_may_be_begun_anew() {
        let folder = tempfile::tempdir().unwrap();
        let started =
            Record::Started { lobelia: "1".into(), plan_sha256: "a".into(), rig_sha256: "b".into() };
        Journal::create(folder.path()).unwrap().append(&started).unwrap();
        let mut anew = Journal::create(folder.path()).unwrap();
        anew.append(&started).unwrap();
        anew.append(&records()[0]).unwrap();
        drop(anew);
        assert_eq!(read(folder.path()).unwrap().len(), 2);
        assert!(Journal::create(folder.path()).is_err());
    }

    #[test]
    fn a_damaged_line_is_named_and_a_second_run_in_the_folder_refused() {
        let folder = tempfile::tempdir().unwrap();
        Journal::create(folder.path()).unwrap().append(&records()[0]).unwrap();
        assert!(Journal::create(folder.path()).err().unwrap().to_string().contains("--resume"));
        std::fs::write(folder.path().join(FILE_NAME), "{\"record\":\"homed\",\"controller_us\":1}\n{]\n")
            .unwrap();
        let message = read(folder.path()).unwrap_err().to_string();
        assert!(
            message.contains("line 2, column 2: damaged record") && !message.contains("line 1"),
            "{message}"
        );
    }
}
