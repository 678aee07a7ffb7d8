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

/// Parses TOML text; `name` stands for the file in errors.
///
/// # Errors
/// As [`read`].
pub fn parse<T: DeserializeOwned>(text: &str, name: &str) -> Result<T> {
    toml::from_str(text).map_err(|error| {
        let line = error.span().map(|span| 1 + text[..span.start.min(text.len())].matches('\n').count());
        let place = line.map_or_else(|| name.to_string(), |line| format!("{name}, line {line}"));
        Error::input(format!("{place}: {}", sentence(error.message())))
    })
}

/// Turns serde's "unknown field `x`, expected one of `a`, `b`" into a sentence with the nearest known key.
fn sentence(message: &str) -> String {
    let quoted: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    if !message.starts_with("unknown field") || quoted.len() < 2 {
        return message.replace('\n', " ").trim().to_string();
    }
    let (unknown, known) = (quoted[0], &quoted[1..]);
    let nearest = known.iter().max_by(|a, b| {
        strsim::jaro_winkler(unknown, a).total_cmp(&strsim::jaro_winkler(unknown, b)).then(b.cmp(a))
    });
    let hint = nearest.map_or_else(String::new, |key| format!("; the nearest known key is `{key}`"));
    format!("unknown key `{unknown}`{hint} (known keys: {})", known.join(", "))
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
    fn wrong_types_name_the_line() {
        let text =
            parse::<Lamp>("radius_mm = 3.0\nwarm_up_s = \"long\"\n", "rig.toml").unwrap_err().to_string();
        assert!(text.contains("line 2") && !text.contains('\n'), "{text}");
    }
}
