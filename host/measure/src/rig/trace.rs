//! Traces: a session with a controller as JSON lines, a header and then each request with its outcome, and
//! each pause. On demand, where a port can tell as under simulation and emulation, the steps that motors were
//! given follow the request that caused them.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use lobelia_protocol::{Axis, Command, Outcome, schema};
use serde::{Deserialize, Serialize};

use lobelia_base::error::{Error, Result};
use lobelia_base::files;

/// One line of a trace.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Entry {
    /// The first line: which messages the trace is made of.
    Trace(Header),
    /// A request and what came of it.
    Exchange(Box<Exchange>),
    /// The host let time pass, µs.
    PauseUs(u64),
    /// The steps that the last request caused, in order.
    Steps(Vec<Step>),
}

/// A step of a motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Step {
    /// Whose.
    pub axis: Axis,
    /// Whether the motor went up.
    pub up: bool,
    /// When, in µs of the controller's clock after the first step of its request.
    pub at_us: u32,
}

/// Which protocol a trace was recorded with.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Header {
    /// Identity of the schema, in hexadecimal digits.
    pub schema: String,
    /// Version of the schema, for people.
    pub version: u32,
}

/// A request and what came of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Exchange {
    /// What was asked for.
    pub command: Command,
    /// What came of it.
    pub outcome: Outcome,
}

impl Header {
    /// The header of this program's traces.
    fn current() -> Self {
        Self { schema: format!("{:016x}", schema::IDENTITY), version: schema::VERSION }
    }
}

/// Writes a trace, line by line, so that a session that ends badly is recorded up to its end.
#[derive(Debug)]
pub struct Recorder {
    path: PathBuf,
    file: File,
    steps: bool,
}

impl Recorder {
    /// Begins a trace; one that was there before is replaced.
    ///
    /// # Errors
    /// When the file can't be written.
    pub fn create(path: &Path) -> Result<Self> {
        let file = File::create(path).map_err(|error| Error::writing(path, error))?;
        let mut recorder = Self { path: path.to_path_buf(), file, steps: false };
        recorder.write(&Entry::Trace(Header::current()))?;
        Ok(recorder)
    }

    /// Records steps too, where the port can tell them: some 40 bytes each.
    pub fn with_steps(self) -> Self {
        Self { steps: true, ..self }
    }

    /// Whether steps are recorded.
    pub(crate) fn has_steps(&self) -> bool {
        self.steps
    }

    pub(crate) fn steps(&mut self, steps: Vec<Step>) -> Result<()> {
        if self.steps && !steps.is_empty() { self.write(&Entry::Steps(steps)) } else { Ok(()) }
    }

    pub(crate) fn exchange(&mut self, command: &Command, outcome: &Outcome) -> Result<()> {
        self.write(&Entry::Exchange(Box::new(Exchange { command: *command, outcome: *outcome })))
    }

    pub(crate) fn pause(&mut self, time: Duration) -> Result<()> {
        self.write(&Entry::PauseUs(time.as_micros().try_into().unwrap_or(u64::MAX)))
    }

    fn write(&mut self, entry: &Entry) -> Result<()> {
        let mut line = serde_json::to_vec(entry).map_err(|error| Error::writing(&self.path, error))?;
        line.push(b'\n');
        self.file.write_all(&line).map_err(|error| Error::writing(&self.path, error))
    }
}

/// Reads a trace: each entry after the header with the number of its line.
///
/// # Errors
/// An input error that names the line, or both versions when the trace is one of another protocol.
pub fn read(path: &Path) -> Result<Vec<(usize, Entry)>> {
    let text = files::read_text(path)?;
    let mut lines = text.lines().enumerate();
    let header = lines.next().and_then(|(_, line)| serde_json::from_str(line).ok());
    let Some(Entry::Trace(header)) = header else {
        return Err(Error::input("is no trace of a rig; record one with `lobelia rig … --record FILE`")
            .at(path.display()));
    };
    if header != Header::current() {
        return Err(Error::input(format!(
            "was recorded with protocol version {} (schema {}), this program speaks version {} (schema \
             {:016x}); record it again",
            header.version,
            header.schema,
            schema::VERSION,
            schema::IDENTITY
        ))
        .at(path.display()));
    }
    lines
        .map(|(index, line)| {
            let entry = serde_json::from_str(line).map_err(|error| {
                Error::input(format!("is no request, no pause: {error}")).caused_by(error).at(format!(
                    "{}, line {}",
                    path.display(),
                    index + 1
                ))
            })?;
            Ok((index + 1, entry))
        })
        .collect()
}
