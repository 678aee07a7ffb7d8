//! `cargo xtask figures`: the figures of the texts, measured again. `docs/figures.toml` says where each comes
//! from.

mod check;
mod judge;
mod lookup;
mod number;
mod registry;
mod run;
mod scan;
mod template;
mod tested;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail};

use crate::target;
use check::{Placed, Texts};
use judge::Moved;
use registry::{Class, Registry};
use run::Runner;

/// What was asked for.
#[derive(Debug, Default, PartialEq)]
struct Options {
    /// Nothing is run.
    check: bool,
    /// The longest commands that are run; a few minutes where nothing is said.
    class: Option<Class>,
    /// Texts or commands whose names have one of these; all where there is none.
    only: Vec<String>,
    /// New values are written into the texts.
    update: bool,
    /// Output that is there is taken as it is.
    reuse: bool,
}

impl Options {
    fn parse(mut arguments: impl Iterator<Item = String>) -> Result<Self> {
        let mut options = Self::default();
        while let Some(argument) = arguments.next() {
            match argument.as_str() {
                "--check" => options.check = true,
                "--quick" => options.class = Some(Class::Quick),
                "--long" => options.class = Some(Class::Long),
                "--only" => options.only.push(arguments.next().context("--only needs a text or a command")?),
                "--update" => options.update = true,
                "--reuse" => options.reuse = true,
                other => bail!("figures has no option `{other}`; see `cargo xtask help`"),
            }
        }
        Ok(options)
    }

    fn wants(&self, file: &str, command: &str) -> bool {
        self.only.is_empty() || self.only.iter().any(|only| file.contains(only) || command.contains(only))
    }
}

/// The repository's root and the registry in it.
fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap_or(Path::new("."))
}

const REGISTRY: &str = "docs/figures.toml";

/// `cargo xtask figures`.
pub(crate) fn task(arguments: impl Iterator<Item = String>) -> Result<()> {
    let options = Options::parse(arguments)?;
    let registry = Registry::read(&root().join(REGISTRY))?;
    let (texts, placed) = checked(&registry, root())?;
    if options.check {
        println!("xtask: {} figures are where {REGISTRY} says", placed.len());
        return Ok(());
    }
    let class = options.class.unwrap_or(Class::Minutes);
    let profile = if class == Class::Quick { "debug" } else { "release" };
    let release: &[&str] = if class == Class::Quick { &[] } else { &["--release"] };
    let build = [&["build", "--package", "lobelia", "--quiet"], release].concat();
    crate::step("the lobelia command", &build, &[])?;
    let runner = Runner {
        registry: &registry,
        root: root(),
        folder: target::folder()?.join("figures"),
        program: target::lobelia(profile)?,
        reuse: options.reuse,
    };
    let figures = |placed: &Placed<'_>| {
        registry.commands[&placed.figure.command].class <= class
            && options.wants(&placed.figure.file, &placed.figure.command)
    };
    compare(&runner, &texts, placed.into_iter().filter(figures).collect(), &options, class)
}

/// The texts and their figures, where the registry is right about them.
fn checked<'a>(registry: &'a Registry, root: &Path) -> Result<(Texts, Vec<Placed<'a>>)> {
    let texts = check::read_texts(registry, root)?;
    let mut faults = Vec::new();
    let placed = check::place(registry, &texts, &mut faults);
    check::cover(registry, &texts, &placed, &mut faults);
    tested::names(registry, root, &mut faults);
    if faults.is_empty() {
        return Ok((texts, placed));
    }
    faults.iter().for_each(|fault| println!("{fault}"));
    bail!("{} places of the texts and {REGISTRY} do not agree", faults.len())
}

/// Runs what the figures need and tells, or writes, what is no longer so.
fn compare(
    runner: &Runner<'_>,
    texts: &Texts,
    placed: Vec<Placed<'_>>,
    options: &Options,
    class: Class,
) -> Result<()> {
    let registry = runner.registry;
    let blocks: Vec<_> = registry
        .blocks
        .iter()
        .filter(|block| {
            registry.commands[&block.command].class <= class && options.wants(&block.file, &block.command)
        })
        .collect();
    let names = placed.iter().map(|placed| &placed.figure.command);
    let names = names.chain(blocks.iter().map(|block| &block.command));
    let mut done = BTreeMap::new();
    let mut failed = Vec::new();
    for name in judge::commands(registry, names) {
        if let Err(error) = runner.run(name, &mut done) {
            failed.push(format!("`{name}`: {error}"));
        }
    }
    let ran = |name: &String| done.get(name).is_some_and(Result::is_ok);
    let mut moved: Vec<Moved> = Vec::new();
    let mut count = 0;
    for placed in placed.iter().filter(|placed| ran(&placed.figure.command)) {
        count += placed.numbers.len();
        match judge::judge(runner, placed) {
            Ok(found) => moved.extend(found),
            Err(error) => {
                failed.push(format!("`{}` of {}: {error:#}", placed.figure.text, placed.figure.file))
            }
        }
    }
    for block in blocks.into_iter().filter(|block| ran(&block.command)) {
        count += 1;
        match judge::judge_block(runner, block, &texts[&block.file]) {
            Ok(found) => moved.extend(found),
            Err(error) => failed.push(format!("`{}` of {}: {error:#}", block.from, block.file)),
        }
    }
    moved.sort_by(|a, b| (&a.file, a.span.start).cmp(&(&b.file, b.span.start)));
    moved.iter().for_each(|moved| tell(moved, &texts[&moved.file]));
    failed.iter().for_each(|failed| println!("not measured: {failed}"));
    if options.update {
        for (name, text) in written(texts, &moved) {
            fs::write(runner.root.join(&name), text).with_context(|| name.clone())?;
            println!("xtask: {name} was written");
        }
    }
    println!("xtask: {count} figures were measured, {} are no longer so", moved.len());
    match (moved.is_empty() || options.update, failed.is_empty()) {
        (true, true) => Ok(()),
        (false, true) => bail!("{} figures are no longer so", moved.len()),
        _ => bail!("{} figures are no longer so, {} were not measured", moved.len(), failed.len()),
    }
}

/// One line on a figure that is no longer so.
fn tell(moved: &Moved, text: &str) {
    let old = &text[moved.span.clone()];
    let line = check::line_of(text, moved.span.start);
    let Moved { file, new, measured, command, .. } = moved;
    if old.contains('\n') {
        println!("{file}, line {line}: `{command}` writes these lines otherwise:\n{new}");
        return;
    }
    let around = check::around(text, &moved.span);
    println!("{file}, line {line}: {old} is {new} now ({measured} by `{command}`): “{around}”");
}

/// The texts that have new values.
fn written(texts: &Texts, moved: &[Moved]) -> BTreeMap<String, String> {
    let mut changed: BTreeMap<String, String> = BTreeMap::new();
    // From the end, so that places before stay where they are.
    for moved in moved.iter().rev() {
        let text = changed.entry(moved.file.clone()).or_insert_with(|| texts[&moved.file].clone());
        text.replace_range(moved.span.clone(), &moved.new);
    }
    changed
}
