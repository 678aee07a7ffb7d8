//! The one error type of the host: what went wrong, in one sentence, and whose fault it is (which decides the exit code).

use std::fmt;
use std::path::Path;

/// An error with a sentence for the user: what is wrong, where (file, line, pose, texel) and what to do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Error {
    kind: Kind,
    message: String,
}

/// Whether the input or the machine is at fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The user's input is wrong: exit code 2.
    Input,
    /// The input is fine but the work failed (device, disk, link): exit code 1.
    Failure,
}

/// The host's result type.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// Input that the user can put right; the command exits with 2.
    pub fn input(message: impl Into<String>) -> Self {
        Self { kind: Kind::Input, message: message.into() }
    }

    /// A failure of a device, the disk or the link; the command exits with 1.
    pub fn failure(message: impl Into<String>) -> Self {
        Self { kind: Kind::Failure, message: message.into() }
    }

    /// A file that could not be read: input when it is missing or not readable as what it should be.
    pub fn reading(path: &Path, error: impl fmt::Display) -> Self {
        Self::input(format!("{}: cannot be read: {error}", path.display()))
    }

    /// A file that could not be written.
    pub fn writing(path: &Path, error: impl fmt::Display) -> Self {
        Self::failure(format!("{}: cannot be written: {error}", path.display()))
    }

    /// Puts a place (file, pose, texel) in front of the sentence.
    pub fn at(mut self, place: impl fmt::Display) -> Self {
        self.message = format!("{place}: {}", self.message);
        self
    }

    /// Says at the end what to do.
    pub fn hint(mut self, hint: impl fmt::Display) -> Self {
        self.message = format!("{}; {hint}", self.message);
        self
    }

    /// Input or failure.
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// The process exit code: 2 for bad input, 1 for a failure.
    pub fn exit_code(&self) -> u8 {
        match self.kind {
            Kind::Input => 2,
            Kind::Failure => 1,
        }
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Error {}
