//! Tests that a command of the registry runs for what they print: libtest succeeds where a filter matches
//! none of them, and the figures would be looked for in an empty output.

use std::fs;
use std::path::Path;

use super::registry::Registry;

/// The filter of a command line in which `cargo test` runs and no test did, by its `stdout` and the file that
/// it sends its output to.
pub(super) fn none_ran(line: &str, stdout: &[u8], folder: &Path) -> Option<String> {
    let filter = filter(line)?;
    let files = line.split('>').skip(1).filter_map(|rest| rest.split_whitespace().next());
    let sent = files.filter_map(|file| fs::read(folder.join(file)).ok());
    let ran: usize =
        std::iter::once(stdout.to_vec()).chain(sent).map(|text| tests(&String::from_utf8_lossy(&text))).sum();
    (ran == 0).then(|| format!("`{filter}`"))
}

/// Tells in `faults` which filters are of no function or module in the sources.
pub(super) fn names(registry: &Registry, root: &Path, faults: &mut Vec<String>) {
    let lines =
        registry.commands.iter().flat_map(|(name, recipe)| recipe.run.iter().map(move |line| (name, line)));
    let filters: Vec<(&String, &str)> =
        lines.filter_map(|(name, line)| Some((name, filter(line)?))).collect();
    if filters.is_empty() {
        return;
    }
    let mut sources = Vec::new();
    read_sources(root, &mut sources);
    for (name, filter) in filters {
        // A filter may end in the midst of a name.
        let last = filter.rsplit("::").next().unwrap_or(filter);
        let found = |source: &String| {
            source.contains(&format!("fn {last}")) || source.contains(&format!("mod {last}"))
        };
        if !sources.iter().any(found) {
            faults.push(format!("`{name}` runs the test `{filter}`, and there is none of that name"));
        }
    }
}

/// The Rust sources below a folder, without what is built or hidden.
fn read_sources(folder: &Path, sources: &mut Vec<String>) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let (path, name) = (entry.path(), entry.file_name());
        let name = name.to_string_lossy();
        match entry.file_type() {
            Ok(kind) if kind.is_dir() && name != "target" && !name.starts_with('.') => {
                read_sources(&path, sources)
            }
            Ok(kind) if kind.is_file() && name.ends_with(".rs") => sources.extend(fs::read_to_string(&path)),
            _ => {}
        }
    }
}

/// The tests that libtest says it runs, over all programs.
fn tests(said: &str) -> usize {
    let of = |line: &str| line.strip_prefix("running ")?.split_once(" test")?.0.parse::<usize>().ok();
    said.lines().filter_map(of).sum()
}

/// The part of a name by which the `cargo test` of a line chooses: its last argument.
fn filter(line: &str) -> Option<&str> {
    let command = line.split("cargo test").nth(1)?.split(['>', '|', ';', '&']).next()?;
    command.split_whitespace().last().filter(|word| !word.starts_with('-'))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_filter_that_matches_no_test_is_told_and_one_that_does_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let line = "cd /r && cargo test -q -p c --lib -- --nocapture a::so_it_does > out";
        let wrong = |said: &str, sent: &str| {
            fs::write(folder.path().join("out"), sent).unwrap();
            none_ran(line, said.as_bytes(), folder.path())
        };
        // As libtest says it, quiet or not.
        let none = "\nrunning 0 tests\n\ntest result: ok. 0 passed; 0 failed; 0 ignored; 9 filtered out\n";
        let one = "\nrunning 1 test\nrho_d 0.1\n.\ntest result: ok. 1 passed; 0 failed\n";
        for (said, sent) in [("", none), (none, ""), ("", "")] {
            assert_eq!(wrong(said, sent).unwrap(), "`a::so_it_does`", "{said} {sent}");
        }
        assert_eq!((wrong("", one), wrong(one, ""), wrong(none, one)), (None, None, None));
        assert_eq!(none_ran("lobelia fit a.zarr > out", b"", folder.path()), None);
    }

    #[test]
    fn a_filter_of_a_name_that_no_source_has_is_told_without_a_run() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir_all(folder.path().join("a/target")).unwrap();
        fs::write(folder.path().join("a/b.rs"), "mod tests { fn so_it_does_well() {} }").unwrap();
        // What is built is no source.
        fs::write(folder.path().join("a/target/c.rs"), "fn so_it_did() {}").unwrap();
        let faults = |filter: &str| {
            let text = format!(
                "texts = [\"p.md\"]\nfigure = []\n[commands.t]\nclass = \"quick\"\nrun = [\"cargo test \
                 {filter} > o\"]\n"
            );
            let mut faults = Vec::new();
            names(&Registry::parse(&text).unwrap(), folder.path(), &mut faults);
            faults
        };
        for right in ["-q -- a::tests::so_it_does", "tests", "-p a --lib -- --nocapture"] {
            assert!(faults(right).is_empty(), "{right}");
        }
        assert_eq!(
            faults("-- b::so_it_did"),
            ["`t` runs the test `b::so_it_did`, and there is none of that name"]
        );
    }
}
