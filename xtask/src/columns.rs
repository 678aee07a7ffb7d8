//! Lines keep to the columns that rustfmt keeps code to: comments and strings, which it leaves as they are,
//! and code in macros.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Result, bail};

/// The limit, as in rustfmt.toml.
const COLUMNS: usize = 110;

/// Refuses tracked Rust files with lines beyond the limit.
pub(crate) fn check() -> Result<()> {
    let listed = Command::new("git").args(["ls-files", "-z", "--", "*.rs"]).output()?;
    if !listed.status.success() {
        bail!("git ls-files failed ({})", listed.status);
    }
    let names = String::from_utf8(listed.stdout)?;
    let mut count = 0;
    for path in names.split_terminator('\0').map(PathBuf::from).filter(|path| path.exists()) {
        for (line, columns) in beyond(&std::fs::read_to_string(&path)?) {
            eprintln!("{}", told(&path, line, columns));
            count += 1;
        }
    }
    if count > 0 {
        bail!("{count} lines have more than {COLUMNS} columns");
    }
    Ok(())
}

fn told(path: &Path, line: usize, columns: usize) -> String {
    format!("{}:{line}: {columns} columns", path.display())
}

/// The lines beyond the limit, from 1, with their columns. Rows of tables in documentation cannot be broken.
fn beyond(text: &str) -> Vec<(usize, usize)> {
    let lines = text.lines().enumerate().map(|(index, line)| (index + 1, line));
    let is_row = |line: &str| {
        ["//! |", "/// |"].iter().any(|row| line.trim_start().starts_with(row)) && line.ends_with('|')
    };
    lines
        .filter(|(_, line)| !is_row(line))
        .map(|(number, line)| (number, line.chars().count()))
        .filter(|&(_, columns)| columns > COLUMNS)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_measured_in_characters_and_tables_are_left() {
        let [fits, long] = [COLUMNS, COLUMNS + 1].map(|count| "é".repeat(count));
        assert_eq!(beyond(&format!("{fits}\n{long}\n\n    {fits}\n")), [(2, 111), (4, 114)]);
        assert_eq!(beyond(&format!("    /// | a | {long} |\n//! | {long} |\n")), []);
        assert_eq!(beyond(&format!("/// |{long}| of it\n// | {long} |")).len(), 2);
    }
}
