//! What made a map or a store, in attributes of its own: version, command and hashes of what it was made
//! from.
//!
//! The same inputs give the same bytes, on any number of threads and in any number of parts. So the command
//! is told without what changes nothing in the file (its own name, folders, threads, parts), and a date only
//! where the environment variable SOURCE_DATE_EPOCH gives one (reproducible-builds.org); reports have the
//! date of the run.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use serde::Serialize;

/// Options with a value, and options without, that change nothing in what is made.
const WITH_VALUE: [&str; 6] = ["-o", "--output", "--out", "--report", "--threads", "--chunks"];
const WITHOUT_VALUE: [&str; 5] = ["-q", "--quiet", "-v", "--verbose", "--mip"];
/// The option that takes shards, which are parts of the same fit.
const SHARDS: &str = "--merge";

/// A file that was read.
#[derive(Debug, Clone, Serialize)]
pub struct Input {
    /// As named by the user.
    pub path: String,
    /// Hash of the file; of a sampled SBRDF, that of its size and poses; of another folder, that of its
    /// files' names and hashes.
    pub sha256: Option<String>,
}

/// Texts by name, as maps and stores hold them.
pub type Texts = BTreeMap<String, String>;

/// What is said of a file that a command line made of some inputs.
pub fn texts(arguments: &[String], inputs: &[Input]) -> Texts {
    let epoch = std::env::var("SOURCE_DATE_EPOCH").ok().and_then(|text| text.trim().parse().ok());
    of(arguments, inputs, epoch)
}

fn of(arguments: &[String], inputs: &[Input], epoch_s: Option<u64>) -> Texts {
    let hash = |input: &Input| {
        let sha256 = input.sha256.as_ref()?;
        Some(format!("{} sha256 {sha256}", file_name(&input.path)))
    };
    let mut texts = Texts::from([
        ("made.by".to_string(), format!("lobelia {}", env!("CARGO_PKG_VERSION"))),
        ("made.command".to_string(), command(arguments)),
    ]);
    let inputs: Vec<String> = inputs.iter().filter_map(hash).collect();
    if !inputs.is_empty() {
        texts.insert("made.inputs".into(), inputs.join(", "));
    }
    texts.extend(epoch_s.map(|epoch_s| ("made.date".to_string(), date(epoch_s))));
    texts
}

/// The command line without what changes nothing in the file.
fn command(arguments: &[String]) -> String {
    let mut words = vec!["lobelia".to_string()];
    let mut rest = arguments.iter().peekable();
    while let Some(argument) = rest.next() {
        let name = argument.split('=').next().unwrap_or_default();
        if argument == SHARDS {
            // A sampled SBRDF that is named behind the shards is none of them.
            while rest
                .next_if(|next| !next.starts_with('-') && !next.to_lowercase().ends_with(".zarr"))
                .is_some()
            {}
        } else if WITH_VALUE.contains(&name) {
            if name == argument {
                rest.next();
            }
        } else if !WITHOUT_VALUE.contains(&name) && !argument.starts_with("-o") {
            words.push(without_folder(argument));
        }
    }
    words.join(" ")
}

/// A file's name without its folders, also behind an option's name.
fn without_folder(argument: &str) -> String {
    match argument.split_once('=') {
        Some((name, value)) if name.starts_with("--") => format!("{name}={}", file_name(value)),
        _ => file_name(argument),
    }
}

fn file_name(path: &str) -> String {
    let name = Path::new(path).file_name().map(|name| name.to_string_lossy().into_owned());
    name.unwrap_or_else(|| path.to_string())
}

/// The date and time now, as `date` writes it.
pub fn now() -> String {
    date(SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs()))
}

/// Seconds since 1970 as a date and time of ISO 8601 in UTC (Richards 2013, civil date from days).
fn date(epoch_s: u64) -> String {
    let (days, of_day) = (epoch_s / 86_400, epoch_s % 86_400);
    // Days since 0000-03-01, in eras of 400 years.
    let days = days + 719_468;
    let (era, of_era) = (days / 146_097, days % 146_097);
    let year_of_era = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted = (5 * of_year + 2) / 153;
    let day = of_year - (153 * shifted + 2) / 5 + 1;
    let month = if shifted < 10 { shifted + 3 } else { shifted - 9 };
    let year = year_of_era + 400 * era + u64::from(month <= 2);
    let (hour, minute, second) = (of_day / 3600, of_day / 60 % 60, of_day % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}Z")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(line: &str) -> String {
        command(&line.split(' ').map(String::from).collect::<Vec<_>>())
    }

    #[test]
    fn a_command_is_told_without_what_changes_nothing_in_the_file() {
        let whole = told("fit /data/s.zarr --lobes 1 -o maps/whole.exr --threads 3 --report=r.json -q");
        assert_eq!(whole, "lobelia fit s.zarr --lobes 1");
        for same in [
            "fit s.zarr --lobes 1 --chunks 2/8 -o part2.exr",
            "fit s.zarr --lobes 1 --mip --merge a.exr b.exr --output=whole.exr",
            "--threads 2 fit ../s.zarr --lobes 1 -owhole.exr",
        ] {
            assert_eq!(told(same), whole, "{same}");
        }
        assert_eq!(
            told("fit --lobes 1 --mip --merge a.exr b.exr data/s.zarr -o m.exr"),
            "lobelia fit --lobes 1 s.zarr"
        );
        assert_eq!(told("edit mean a.exr --mask=m/x.png -o b.exr"), "lobelia edit mean a.exr --mask=x.png");
    }

    #[test]
    fn a_file_says_what_made_it_and_a_date_only_where_one_is_given() {
        let input = Input { path: "runs/rig.toml".into(), sha256: Some("abc".into()) };
        let unknown = Input { path: "gone".into(), sha256: None };
        let arguments = ["develop", "run"].map(String::from);
        let texts = of(&arguments, &[input, unknown], None);
        assert_eq!(texts["made.by"], format!("lobelia {}", env!("CARGO_PKG_VERSION")));
        assert_eq!(
            (texts["made.command"].as_str(), texts["made.inputs"].as_str()),
            ("lobelia develop run", "rig.toml sha256 abc")
        );
        assert!(!texts.contains_key("made.date"));
        assert_eq!(of(&arguments, &[], Some(0))["made.date"], "1970-01-01T00:00:00Z");
    }

    /// Dates that `date -u -d @N` of GNU coreutils gives.
    #[test]
    fn dates_are_those_of_the_calendar() {
        for (seconds, expected) in [
            (951_782_399, "2000-02-28T23:59:59Z"),
            (951_868_800, "2000-03-01T00:00:00Z"),
            (1_709_210_096, "2024-02-29T12:34:56Z"),
            (4_102_444_799, "2099-12-31T23:59:59Z"),
        ] {
            assert_eq!(date(seconds), expected);
        }
    }
}
