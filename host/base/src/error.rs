//! The one error type of the host: what went wrong, in one sentence, and whose fault it is (which decides the
//! exit code).

use std::any::TypeId;
use std::fmt;
use std::path::Path;
use std::sync::Arc;

use crate::files;

/// An error with a sentence for the user: what is wrong, where (file, line, pose, texel) and what to do. What
/// it came from, where that was an error of another library, is its [source](std::error::Error::source); the
/// sentence stands without it.
#[derive(Debug, Clone)]
pub struct Error {
    kind: Kind,
    message: String,
    source: Option<Source>,
}

type Source = Arc<dyn std::error::Error + Send + Sync>;

/// An error of any library, or a sentence.
type Cause = Box<dyn std::error::Error + Send + Sync>;

/// Errors are the same that say the same, wherever they came from.
impl PartialEq for Error {
    fn eq(&self, other: &Self) -> bool {
        (self.kind, &self.message) == (other.kind, &other.message)
    }
}

impl Eq for Error {}

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
        Self { kind: Kind::Input, message, source: None }
    }

    /// A failure of a device, the disk or the link; the command exits with 1.
    pub fn failure(message: impl Into<String>) -> Self {
        Self { kind: Kind::Failure, message: message.into(), source: None }
    }

    /// A file that could not be read: input when it is missing or not readable as what it should be. What
    /// stands in its place is named where it is a folder.
    pub fn reading<E: Into<Cause> + 'static>(path: &Path, error: E) -> Self {
        if path.is_dir() {
            let what = files::what_is(path).unwrap_or("a folder");
            return Self::input(format!("{}: {what}, where a file is needed", path.display()));
        }
        let (cause, source) = told(error);
        let (name, cause) = (path.display().to_string(), one_line(cause));
        // Some readers name the file themselves.
        let message =
            if cause.starts_with(&name) { cause } else { format!("{name}: cannot be read: {cause}") };
        Self { source, ..Self::input(message) }
    }

    /// A file that is not what it should be; the sentence names it.
    pub fn format<E: Into<Cause> + 'static>(error: E) -> Self {
        let (message, source) = told(error);
        Self { source, ..Self::input(message) }
    }

    /// A file that could not be written.
    pub fn writing<E: Into<Cause> + 'static>(path: &Path, error: E) -> Self {
        let (cause, source) = told(error);
        let message = format!("{}: cannot be written: {}", path.display(), one_line(cause));
        Self { source, ..Self::failure(message) }
    }

    /// Says what the error came from; the sentence stays as it is.
    pub fn caused_by<E: Into<Cause> + 'static>(mut self, error: E) -> Self {
        self.source = told(error).1;
        self
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

/// What a cause says, and the cause itself unless it is no more than a sentence.
fn told<E: Into<Cause> + 'static>(error: E) -> (String, Option<Source>) {
    let sentence = [TypeId::of::<String>(), TypeId::of::<&'static str>()].contains(&TypeId::of::<E>());
    let cause: Cause = error.into();
    (cause.to_string(), (!sentence).then(|| Arc::from(cause)))
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

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        self.source.as_ref().map(|source| source.as_ref() as &(dyn std::error::Error + 'static))
    }
}

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
    fn an_error_keeps_what_it_came_from_through_places_and_hints() {
        use std::error::Error as _;
        let lost = || std::io::Error::from(std::io::ErrorKind::StorageFull);
        let path = Path::new("m.exr");
        for error in [Error::writing(path, lost()), Error::input("no room").caused_by(lost())] {
            let error = error.at("texel 3").hint("make room");
            let source = error.source().and_then(|source| source.downcast_ref::<std::io::Error>());
            assert_eq!(source.map(std::io::Error::kind), Some(std::io::ErrorKind::StorageFull));
            assert_eq!(error.to_string().lines().count(), 1);
        }
        // A sentence is no cause of itself.
        assert!(Error::reading(path, "too short").source().is_none());
        assert!(Error::format(String::from("too short")).source().is_none());
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
