//! The folder of a run: `plan.toml`, `rig.toml`, `journal.jsonl` and `frames/`. Who acquires writes it, who
//! develops reads it.

use std::path::{Path, PathBuf};

use lobelia_base::error::{Error, Result};
use lobelia_base::files;
use lobelia_base::hash::sha256;

use crate::plan::Plan;
use crate::rig::config::RigConfig;

pub mod journal;

use journal::{Journal, Record};

/// Name of the rig's file in a run's folder.
pub const RIG_FILE: &str = "rig.toml";

/// Name of the plan in a run's folder.
pub const PLAN_FILE: &str = "plan.toml";

/// A run's folder, read.
pub struct RunFolder {
    /// The folder.
    pub path: PathBuf,
    /// What to photograph.
    pub plan: Plan,
    /// The rig.
    pub rig: RigConfig,
    /// What has been done.
    pub records: Vec<Record>,
}

impl RunFolder {
    /// Lays out the folder of a new run and starts its journal.
    ///
    /// # Errors
    /// When a run was recorded there already, the plan does not fit the rig, or the disk refuses.
    pub fn create(path: &Path, plan: &Plan, rig: &RigConfig) -> Result<(Self, Journal)> {
        rig.validate()?;
        plan.validate(rig)?;
        // The journal first: a folder with one is a run's, whatever becomes of the rest.
        files::create_folder(path)?;
        let mut journal = Journal::create(path)?;
        files::create_folder(&path.join("frames"))?;
        let rig_text = toml::to_string(rig)
            .map_err(|error| Error::failure(format!("rig.toml: {error}")).caused_by(error))?;
        let plan_text = plan.to_toml()?;
        files::write_bytes(&path.join(RIG_FILE), rig_text.as_bytes())?;
        files::write_bytes(&path.join(PLAN_FILE), plan_text.as_bytes())?;
        let started = Record::Started {
            lobelia: env!("CARGO_PKG_VERSION").into(),
            plan_sha256: sha256(plan_text.as_bytes()),
            rig_sha256: sha256(rig_text.as_bytes()),
        };
        journal.append(&started)?;
        let run = Self { path: path.into(), plan: plan.clone(), rig: rig.clone(), records: vec![started] };
        Ok((run, journal))
    }

    /// Opens a run to read it.
    ///
    /// # Errors
    /// Input errors for missing or damaged files, and for a plan or rig that was changed after the run began.
    pub fn open(path: &Path) -> Result<Self> {
        let records = journal::read(path)?;
        Self::with_records(path, records, None)
    }

    /// Opens a run to read it by another rig's numbers than those that it was begun with; its own file may
    /// then have been changed.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_by(path: &Path, rig: RigConfig) -> Result<Self> {
        let records = journal::read(path)?;
        Self::with_records(path, records, Some(rig))
    }

    /// Opens a run to continue it.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn resume(path: &Path) -> Result<(Self, Journal)> {
        let (journal, records) = Journal::resume(path)?;
        Ok((Self::with_records(path, records, None)?, journal))
    }

    fn with_records(path: &Path, records: Vec<Record>, other: Option<RigConfig>) -> Result<Self> {
        let Some(Record::Started { plan_sha256, rig_sha256, .. }) = records.first() else {
            let message = "the run was broken off before it began; start it again without --resume";
            return Err(Error::input(format!("{}: {message}", path.display())));
        };
        let unchanged = |file: &Path, recorded: &str, hint: &str| {
            let changed = sha256(files::read_text(file)?.as_bytes()) != recorded;
            let message = || Error::input(format!("{}: changed since the run began{hint}", file.display()));
            if changed { Err(message()) } else { Ok(()) }
        };
        let (rig_path, plan_path) = (path.join(RIG_FILE), path.join(PLAN_FILE));
        let rig = match other {
            Some(rig) => rig,
            None => {
                let rig = RigConfig::read_recorded(&rig_path)?;
                unchanged(
                    &rig_path,
                    rig_sha256,
                    "; put it back, or name it with --rig, which develop and compare have",
                )?;
                rig
            }
        };
        let plan = Plan::read(&plan_path, &rig)?;
        unchanged(&plan_path, plan_sha256, "")?;
        Ok(Self { path: path.into(), plan, rig, records })
    }

    /// The first pose that has to be photographed; the number of poses where none has.
    pub fn first_left(&self) -> usize {
        first_left(&self.records).min(self.plan.poses.len())
    }

    /// Whether the run is complete.
    pub fn finished(&self) -> bool {
        matches!(self.records.last(), Some(Record::Finished { .. }))
    }
}

/// The first pose that has to be photographed, by what the journal holds.
pub(crate) fn first_left(records: &[Record]) -> usize {
    records.iter().fold(0, |next, record| match record {
        Record::Pose { index, .. } => index + 1,
        Record::Suspect { from, .. } => *from,
        _ => next,
    })
}
