//! TOML files that people write: unknown keys are refused with file, line and the nearest known key.

use std::path::Path;

use serde::de::DeserializeOwned;

use crate::error::{Error, Result};
use crate::files;

/// Reads and parses a TOML file into a type that denies unknown fields.
///
/// # Errors
/// Input errors that name the file, the line and, for an unknown key, the nearest known one.
pub fn read<T: DeserializeOwned>(path: &Path) -> Result<T> {
    parse(&files::read_text(path)?, &path.display().to_string())
}

/// A TOML file of one of these kinds; told from the others by a table or key that none of them has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// `lobelia template rig`.
    Rig,
    /// `lobelia plan`.
    Plan,
    /// `lobelia template scene`.
    Scene,
    /// `lobelia template material`.
    Material,
}

impl Kind {
    /// With its article, and where such a file comes from.
    fn name(self) -> (&'static str, &'static str) {
        match self {
            Self::Rig => ("a rig", "lobelia template rig"),
            Self::Plan => ("a plan", "lobelia plan"),
            Self::Scene => ("a scene", "lobelia template scene"),
            Self::Material => ("a material", "lobelia template material"),
        }
    }

    /// The kind of a text, as far as it can be told.
    fn of(text: &str) -> Option<Self> {
        let table: toml::Table = toml::from_str(text).ok()?;
        let has = |key: &str| table.contains_key(key);
        let kinds = [
            (Self::Plan, has("spacing_deg") || has("pose")),
            (Self::Rig, has("axes") || has("carrier") || has("simulator")),
            (Self::Material, has("pattern")),
            (Self::Scene, has("object") || has("light")),
        ];
        kinds.into_iter().find(|(_, is)| *is).map(|(kind, _)| kind)
    }
}

/// Reads a TOML file that should be of a kind.
///
/// # Errors
/// As [`read`]; a file of another kind is named as what it is.
pub fn read_as<T: DeserializeOwned>(path: &Path, kind: Kind) -> Result<T> {
    let text = files::read_text(path)?;
    parse(&text, &path.display().to_string()).map_err(|error| match Kind::of(&text) {
        Some(other) if other != kind => {
            let (wanted, source) = kind.name();
            let message =
                format!("this is {}, but {wanted} is needed here ({source} writes one)", other.name().0);
            Error::input(format!("{}: {message}", path.display()))
        }
        _ => error,
    })
}

/// Parses TOML text; `name` stands for the file in errors.
///
/// # Errors
/// As [`read`].
pub fn parse<T: DeserializeOwned>(text: &str, name: &str) -> Result<T> {
    toml::from_str(text).map_err(|error| {
        let line = error.span().map(|span| 1 + text[..span.start.min(text.len())].matches('\n').count());
        let place = line.map_or_else(|| name.to_string(), |line| format!("{name}, line {line}"));
        Error::input(format!("{place}: {}", sentence(error.message()))).caused_by(error)
    })
}

/// Turns serde's "unknown field `x`, expected one of `a`, `b`" into a sentence with the nearest known key.
fn sentence(message: &str) -> String {
    let quoted: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    if !message.starts_with("unknown field") || quoted.len() < 2 {
        return plain(message.replace('\n', " ").trim());
    }
    let (unknown, known) = (quoted[0], &quoted[1..]);
    let nearest = known.iter().max_by(|a, b| {
        strsim::jaro_winkler(unknown, a).total_cmp(&strsim::jaro_winkler(unknown, b)).then(b.cmp(a))
    });
    let hint = nearest.map_or_else(String::new, |key| format!("; the nearest known key is `{key}`"));
    format!("unknown key `{unknown}`{hint} (known keys: {})", known.join(", "))
}

/// A parser's sentence with the types of the program's own language put in words.
pub fn plain(message: &str) -> String {
    const WORDS: [(&str, &str); 18] = [
        ("usize", "a whole number, 0 or more"),
        ("u8", "a whole number, 0 to 255"),
        ("u16", "a whole number, 0 to 65535"),
        ("u32", "a whole number, 0 to 4294967295"),
        ("u64", "a whole number, 0 or more"),
        ("i8", "a whole number"),
        ("i16", "a whole number"),
        ("i32", "a whole number"),
        ("i64", "a whole number"),
        ("f32", "a number"),
        ("f64", "a number"),
        ("a sequence", "a list"),
        ("a map", "a table"),
        ("a boolean", "true or false"),
        ("a borrowed string", "a text"),
        ("a string", "a text"),
        ("unit", "nothing"),
        ("path string", "the name of a file"),
    ];
    const FOUND: [(&str, &str); 5] = [
        ("floating point", "the number"),
        ("integer", "the number"),
        ("sequence", "a list"),
        ("map", "a table"),
        ("string", "the text"),
    ];
    let Some((found, expected)) = message.split_once(", expected ") else { return message.to_string() };
    let (what, value) = found.split_once(": ").unwrap_or(("", found));
    let value = FOUND.iter().find_map(|(word, words)| Some(format!("{words}{}", value.strip_prefix(word)?)));
    let found = value.map_or_else(|| found.to_string(), |value| format!("{what}: {value}"));
    let expected = match WORDS.iter().find(|(word, _)| *word == expected) {
        Some((_, words)) => (*words).to_string(),
        None if expected.starts_with("struct ") => "a table".into(),
        None => ["f32 values", "f64 values"]
            .iter()
            .fold(expected.to_string(), |text, values| text.replace(values, "numbers"))
            .replace("a sequence", "a list")
            .replace("an array", "a list"),
    };
    format!("{found}, expected {expected}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Lamp {
        #[allow(dead_code, reason = "only parsed")]
        radius_mm: f64,
        #[allow(dead_code, reason = "only parsed")]
        warm_up_s: f64,
    }

    #[test]
    fn unknown_keys_are_refused_with_file_line_and_nearest_key() {
        let error = parse::<Lamp>("radius_mm = 3.0\nwarmup_s = 2.0\n", "rig.toml").unwrap_err();
        let text = error.to_string();
        assert_eq!(error.exit_code(), 2);
        assert!(text.contains("rig.toml, line 2"), "{text}");
        assert!(text.contains("`warmup_s`") && text.contains("nearest known key is `warm_up_s`"), "{text}");
    }

    #[test]
    fn a_file_of_another_kind_is_named_as_what_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            path
        };
        let plan = write("plan.toml", "format = 1\nspacing_deg = 5.0\npose = []\n");
        let message = read_as::<Lamp>(&plan, Kind::Rig).unwrap_err().to_string();
        assert!(message.contains("plan.toml: this is a plan, but a rig is needed here"), "{message}");
        let rig = write("rig.toml", "[axes.pan]\nmin_deg = 3\n");
        let message = read_as::<Lamp>(&rig, Kind::Plan).unwrap_err().to_string();
        assert!(message.contains("this is a rig, but a plan is needed"), "{message}");
        // Of the right kind, but wrong: what is wrong is told.
        let message = read_as::<Lamp>(&rig, Kind::Rig).unwrap_err().to_string();
        assert!(message.contains("line 1") && message.contains("axes"), "{message}");
    }

    #[test]
    fn no_type_of_the_programs_own_language_is_named() {
        for (message, words) in [
            (
                "invalid type: floating point `100000.0`, expected usize",
                "the number `100000.0`, expected a whole number, 0 or more",
            ),
            (
                "invalid value: integer `-3`, expected usize",
                "the number `-3`, expected a whole number, 0 or more",
            ),
            ("invalid type: string \"wide\", expected f64", "the text \"wide\", expected a number"),
            ("invalid type: integer `3`, expected struct Camera", "the number `3`, expected a table"),
            (
                "invalid length 2, expected an array of length 3",
                "invalid length 2, expected a list of length 3",
            ),
            ("invalid type: string \"a map\", expected f64", "the text \"a map\", expected a number"),
            (
                "invalid type: map, expected a sequence of 3 f32 values",
                "a table, expected a list of 3 numbers",
            ),
            ("missing field `n`", "missing field `n`"),
        ] {
            assert!(plain(message).ends_with(words), "{}", plain(message));
        }
    }

    #[test]
    fn wrong_types_name_the_line() {
        let text =
            parse::<Lamp>("radius_mm = 3.0\nwarm_up_s = \"long\"\n", "rig.toml").unwrap_err().to_string();
        assert!(text.contains("line 2") && !text.contains('\n'), "{text}");
    }
}
