//! The whole task on a page of its own.

use super::*;

const PAGE: &str = "# A page

A run took 2.0 s and was off by 0.46 %, or at most 3 texels;
the other by 12 %.

| lobes | error, % |
|---|---|
| 1 | 9.6 |
| 2 | 0.5 |

<!-- written -->
| a | 1 |
<!-- end -->

A lease of 2 s.
";

const PAGE_REGISTRY: &str = r#"
texts = ["page.md"]

[commands.first]
class = "quick"
run = ["cp {repo}/first.json out.json", "cat {repo}/first.txt"]
output = "out.json"

[commands.second]
class = "quick"
run = ["cp {first}/stdout copy", "cp {repo}/block.md block.md"]

[[figure]]
file = "page.md"
text = "off by {} %, or"
kind = "error"
command = "first"
at = ["errors/name=rms/value"]
times = 100

[[figure]]
file = "page.md"
text = "at most {} texels"
kind = "error"
command = "first"
at = ["errors/name=worst/value"]
bound = "most"

[[figure]]
file = "page.md"
text = "took {} s"
kind = "time"
command = "first"
in = "steps"
at = ["max(steps/*/seconds)"]

[[figure]]
file = "page.md"
text = "the other by {} %"
kind = "error"
command = "first"
in = "stdout"
at = ["the other: {} %"]

[[figure]]
file = "page.md"
text = "| 1 | {} | | 2 | {} |"
kind = "error"
command = "second"
in = "copy"
at = ["one lobe {},", "two lobes {}."]

[[block]]
file = "page.md"
from = "<!-- written -->"
to = "<!-- end -->"
command = "second"
in = "block.md"

[[exempt]]
file = "page.md"
reason = "a constant of the protocol"
texts = ["lease of {} s"]
"#;

/// A repository of one page, and what its commands find.
fn repository(first: &str, words: &str, block: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in [("page.md", PAGE), ("first.json", first), ("first.txt", words), ("block.md", block)]
    {
        fs::write(folder.path().join(name), text).unwrap();
    }
    folder
}

const FIRST: &str =
    r#"{ "errors": [{ "name": "rms", "value": 0.0047 }, { "name": "worst", "value": 2.2 }] }"#;
const WORDS: &str = "the other: 12.3 %\none lobe 9.62, two lobes 0.49.\n";
const BLOCK: &str = "<!-- written -->\n| a | 1 |\n<!-- end -->\n";

/// Runs all but times on a repository, and gives the page afterwards.
fn run(root: &Path, update: bool) -> (Result<()>, String) {
    let registry = Registry::parse(PAGE_REGISTRY).unwrap();
    let (texts, placed) = checked(&registry, root).unwrap();
    let runner =
        Runner { registry: &registry, root, folder: root.join("work"), program: "true".into(), reuse: false };
    let placed =
        placed.into_iter().filter(|placed| placed.figure.kind != super::registry::Kind::Time).collect();
    let options = Options { update, ..Options::default() };
    let outcome = compare(&runner, &texts, placed, &options, Class::Quick);
    (outcome, fs::read_to_string(root.join("page.md")).unwrap())
}

#[test]
fn figures_within_their_tolerance_stand() {
    let folder = repository(FIRST, WORDS, BLOCK);
    let (outcome, page) = run(folder.path(), false);
    outcome.unwrap();
    assert_eq!(page, PAGE);
}

#[test]
fn figures_that_moved_fail_and_are_written_when_that_is_asked_for() {
    let first = FIRST.replace("0.0047", "0.00712").replace("2.2", "4.1");
    let words = WORDS.replace("0.49", "0.71");
    let folder = repository(&first, &words, &BLOCK.replace("| 1 |", "| 7 |"));
    let (outcome, page) = run(folder.path(), false);
    assert!(format!("{:#}", outcome.unwrap_err()).contains("4 figures are no longer so"));
    assert_eq!(page, PAGE);
    let (outcome, page) = run(folder.path(), true);
    outcome.unwrap();
    let expected =
        PAGE.replace("0.46 %", "0.71 %").replace("most 3 ", "most 4 ").replace("| 2 | 0.5 |", "| 2 | 0.71 |");
    assert_eq!(page, expected.replace("| a | 1 |", "| a | 7 |"));
    run(folder.path(), false).0.unwrap();
}

#[test]
fn a_command_that_fails_leaves_its_figures_unmeasured_and_the_others_measured() {
    let folder = repository(FIRST, WORDS, BLOCK);
    fs::remove_file(folder.path().join("block.md")).unwrap();
    let said = format!("{:#}", run(folder.path(), false).0.unwrap_err());
    assert!(said.contains("0 figures are no longer so, 1 were not measured"), "{said}");
}

/// What is wrong with a page and a registry, a line a fault.
fn faults(page: &str, registry: &str) -> String {
    let registry = Registry::parse(registry).unwrap();
    let texts = Texts::from([("page.md".to_owned(), page.to_owned())]);
    let mut faults = Vec::new();
    let placed = check::place(&registry, &texts, &mut faults);
    check::cover(&registry, &texts, &placed, &mut faults);
    faults.join("\n")
}

#[test]
fn numbers_that_no_one_answers_for_are_told_with_their_line() {
    assert_eq!(faults(PAGE, PAGE_REGISTRY), "");
    let more = PAGE.replace("A lease", "A claim of 99 %.\nA lease");
    assert_eq!(
        faults(&more, PAGE_REGISTRY),
        "page.md, line 15: 99 is neither in the registry nor exempt: “A claim of 99 %.”"
    );
    assert!(faults(&PAGE.replace("off by", "wrong by"), PAGE_REGISTRY).contains("nothing reads `off by"));
    assert!(faults(&format!("{PAGE}\nIt took 3 s."), PAGE_REGISTRY).contains("2 places read `took {} s`"));
    assert!(
        faults(&PAGE.replace("lease", "loan"), PAGE_REGISTRY).contains("`lease of {} s`, which is exempt")
    );
    assert!(faults(&PAGE.replace("<!-- written", "<!-- w"), PAGE_REGISTRY).contains("no block from"));
    let twice = format!(
        "{PAGE_REGISTRY}\n{}",
        PAGE_REGISTRY[PAGE_REGISTRY.find("[[figure]]").unwrap()..].split("\n\n").next().unwrap()
    );
    assert!(faults(PAGE, &twice).contains("0.46 is in the registry twice"));
}

#[test]
fn a_registry_that_disagrees_with_itself_is_refused() {
    for (from, to, words) in [
        ("command = \"second\"", "command = \"third\"", "no command is called"),
        ("{first}/stdout", "{fifth}/stdout", "fifth"),
        ("at = [\"the other: {} %\"]", "at = []", "1 numbers and 0 places"),
        ("class = \"quick\"", "class = \"soon\"", "soon"),
        ("reason = \"a constant of the protocol\"", "reason = \"\"", "without a reason"),
        ("texts = [\"page.md\"]", "texts = []", "not among"),
        ("bound = \"most\"", "band = \"most\"", "band"),
    ] {
        let registry = PAGE_REGISTRY.replacen(from, to, 1);
        let said = format!("{:#}", Registry::parse(&registry).unwrap_err());
        assert!(said.contains(words), "{to}: {said}");
    }
}

#[test]
fn options_are_read_and_unknown_ones_refused() {
    let parse = |words: &[&str]| Options::parse(words.iter().map(|word| (*word).to_owned()));
    let options = parse(&["--long", "--only", "fit.md", "--only", "demo", "--update", "--reuse"]).unwrap();
    assert_eq!(options.class, Some(Class::Long));
    assert!(options.update && options.reuse && !options.check);
    assert!(options.wants("docs/fit.md", "chart-fit") && options.wants("README.md", "demo"));
    assert!(!options.wants("README.md", "peers"));
    assert!(parse(&["--only"]).is_err() && parse(&["--all"]).is_err());
}
