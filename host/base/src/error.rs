//! The one error type of the host: what went wrong, in one sentence, and whose fault it is (which decides the exit code).

use std::fmt;
use std::path::Path;

use crate::files;

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
        let message: String = message.into();
        // Names and keys of a file may hold line breaks of their own.
        let message = if message.contains(char::is_control) { one_line(message) } else { message };
        Self { kind: Kind::Input, message }
    }

    /// A failure of a device, the disk or the link; the command exits with 1.
    pub fn failure(message: impl Into<String>) -> Self {
        Self { kind: Kind::Failure, message: message.into() }
    }

    /// A file that could not be read: input when it is missing or not readable as what it should be. What stands in its place is named
    /// where it is a folder.
    pub fn reading(path: &Path, error: impl fmt::Display) -> Self {
        if path.is_dir() {
            let what = files::what_is(path).unwrap_or("a folder");
            return Self::input(format!("{}: {what}, where a file is needed", path.display()));
        }
        let (name, error) = (path.display().to_string(), one_line(error));
        // Some readers name the file themselves.
        if error.starts_with(&name) {
            return Self::input(error);
        }
        Self::input(format!("{name}: cannot be read: {error}"))
    }

    /// A file that is not what it should be; the sentence names it.
    pub fn format(error: impl fmt::Display) -> Self {
        Self::input(error.to_string())
    }

    /// A file that could not be written.
    pub fn writing(path: &Path, error: impl fmt::Display) -> Self {
        Self::failure(format!("{}: cannot be written: {}", path.display(), one_line(error)))
    }

    /// Puts a place (file, pose, texel) in front of the sentence, unless it is there already.
    pub fn at(mut self, place: impl fmt::Display) -> Self {
        let place = place.to_string();
        let named = self.message.strip_prefix(&place).is_some_and(|rest| rest.starts_with([':', ',']));
        if !named {
            self.message = format!("{place}: {}", self.message);
        }
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

/// A message of another program's part on one line: some draw pictures of the place.
fn one_line(error: impl fmt::Display) -> String {
    let text = error.to_string().replace(|c: char| c.is_control(), " ");
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Error {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reader_s_message_is_one_line_and_names_the_file_once() {
        let path = Path::new("a folder/m.obj");
        let text = Error::reading(path, "at line 3\n  |\n  ^ here").to_string();
        assert_eq!(text, "a folder/m.obj: cannot be read: at line 3 | ^ here");
        assert_eq!(Error::reading(path, "a folder/m.obj: damaged").to_string(), "a folder/m.obj: damaged");
    }

    #[test]
    fn a_place_is_named_once() {
        let error = Error::input("m.obj, line 3: damaged").at("m.obj");
        assert_eq!(error.to_string(), "m.obj, line 3: damaged");
        assert_eq!(error.at("scene.toml").at("scene.toml").to_string(), "scene.toml: m.obj, line 3: damaged");
        // Another file whose name begins alike.
        assert_eq!(Error::input("m.obj2: damaged").at("m.obj").to_string(), "m.obj: m.obj2: damaged");
    }
}
