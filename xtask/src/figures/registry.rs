//! `docs/figures.toml`: which command each figure of the texts comes from, where in its output it is, and how
//! far it may move.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, bail};
use serde::Deserialize;

use super::template::Template;

/// The file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Registry {
    /// The texts that are kept true, from the repository's root.
    pub(super) texts: Vec<String>,
    /// The commands by name.
    pub(super) commands: BTreeMap<String, Recipe>,
    /// The figures.
    #[serde(rename = "figure")]
    pub(super) figures: Vec<Figure>,
    /// Parts of texts that a command writes whole.
    #[serde(rename = "block", default)]
    pub(super) blocks: Vec<Block>,
    /// Numbers that nothing measures.
    #[serde(rename = "exempt", default)]
    pub(super) exempt: Vec<Exempt>,
}

/// How long a command takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Class {
    /// Seconds, by the program as tests have it.
    Quick,
    /// A few minutes.
    Minutes,
    /// More.
    Long,
}

/// A command, or several that belong together.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Recipe {
    /// How long it takes.
    pub(super) class: Class,
    /// The shell's command lines, run in a folder of their own. `lobelia` is the program, `{repo}` the
    /// repository's root, `{data}` the folder of measured data, `{python}` a Python with NumPy, zarr and
    /// OpenEXR, and `{NAME}` the folder of another command, which is run before.
    pub(super) run: Vec<String>,
    /// Files of the repository that are copied into the folder first.
    #[serde(default)]
    pub(super) copy: Vec<String>,
    /// The output where its figures are, unless they say otherwise.
    #[serde(default)]
    pub(super) output: Option<String>,
}

/// What a figure is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Default)]
#[serde(rename_all = "lowercase")]
pub(super) enum Kind {
    /// An error, where nothing else is said.
    #[default]
    Error,
    /// Bytes.
    Size,
    /// A number of things.
    Count,
    /// A time, or a rate.
    Time,
    /// One time over another of the same run.
    Ratio,
}

impl Kind {
    /// How far a figure may be off, as a share of it, where nothing else is said.
    pub(super) fn within(self) -> f64 {
        match self {
            Self::Error => 0.1,
            Self::Size => 0.05,
            Self::Count => 0.0,
            Self::Time => 0.5,
            Self::Ratio => 0.3,
        }
    }
}

/// A bound that a text states.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Bound {
    /// At most.
    Most,
    /// At least.
    Least,
}

/// One or more numbers of a sentence or a row.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Figure {
    /// The text, from the repository's root.
    pub(super) file: String,
    /// Its words, a template that fits in one place.
    pub(super) text: String,
    /// What it is of.
    #[serde(default)]
    pub(super) kind: Kind,
    /// The command.
    pub(super) command: String,
    /// The file that the command writes, `stdout`, or `steps` for the seconds of each command line.
    #[serde(rename = "in", default)]
    pub(super) output: Option<String>,
    /// Where each number is; see [`super::lookup`]. `./` stands for `base`.
    pub(super) at: Vec<String>,
    /// A path that several places have in common.
    #[serde(default)]
    pub(super) base: String,
    /// What is taken off them.
    #[serde(default)]
    pub(super) less: f64,
    /// What they are then multiplied by.
    #[serde(default = "one")]
    pub(super) times: f64,
    /// How far they may be off, as a share; the last digit may always be off by one.
    #[serde(default)]
    pub(super) within: Option<f64>,
    /// Whether the text states a bound.
    #[serde(default)]
    pub(super) bound: Option<Bound>,
}

fn one() -> f64 {
    1.0
}

/// A part of a text that a command writes.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Block {
    /// The text.
    pub(super) file: String,
    /// The line that it begins after, and the line that it ends before.
    pub(super) from: String,
    pub(super) to: String,
    /// The command, and the file in which it writes the block between the same lines.
    pub(super) command: String,
    #[serde(rename = "in")]
    pub(super) output: String,
}

/// Numbers that nothing measures, and why.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Exempt {
    /// The text.
    pub(super) file: String,
    /// Why.
    pub(super) reason: String,
    /// Templates; each fits in one place or more.
    pub(super) texts: Vec<String>,
}

impl Registry {
    /// Reads the file and checks that it agrees with itself.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
        Self::parse(&text).with_context(|| path.display().to_string())
    }

    pub(super) fn parse(text: &str) -> Result<Self> {
        let registry: Self = toml::from_str(text)?;
        for figure in &registry.figures {
            registry
                .check(figure)
                .with_context(|| format!("the figure `{}` of {}", figure.text, figure.file))?;
        }
        for (name, recipe) in &registry.commands {
            if let Some(unknown) = recipe.needs().find(|needed| !registry.commands.contains_key(*needed)) {
                bail!("the command `{name}` uses `{{{unknown}}}`, which no command is called");
            }
        }
        let named = registry.figures.iter().map(|figure| (&figure.file, &figure.command));
        let named = named.chain(registry.blocks.iter().map(|block| (&block.file, &block.command)));
        for (file, command) in named {
            if !registry.commands.contains_key(command) {
                bail!("a figure of {file} comes from `{command}`, which no command is called");
            }
        }
        let files = registry.figures.iter().map(|figure| &figure.file);
        let files = files.chain(registry.exempt.iter().map(|exempt| &exempt.file));
        let files = files.chain(registry.blocks.iter().map(|block| &block.file));
        for file in files {
            if !registry.texts.contains(file) {
                bail!("{file} is not among `texts`");
            }
        }
        if let Some(exempt) = registry.exempt.iter().find(|exempt| exempt.reason.trim().is_empty()) {
            bail!("numbers of {} are exempt without a reason: {:?}", exempt.file, exempt.texts);
        }
        Ok(registry)
    }

    fn check(&self, figure: &Figure) -> Result<()> {
        let wanted = Template::parse(&figure.text)?.wanted();
        if wanted != figure.at.len() || wanted == 0 {
            bail!("it has {wanted} numbers and {} places", figure.at.len());
        }
        Ok(())
    }

    /// The output that holds a figure.
    pub(super) fn output<'a>(&'a self, figure: &'a Figure) -> &'a str {
        let of_command = || self.commands.get(&figure.command)?.output.as_deref();
        figure.output.as_deref().or_else(of_command).unwrap_or("stdout")
    }
}

impl Recipe {
    /// The names of other commands that stand in braces.
    pub(super) fn needs(&self) -> impl Iterator<Item = &str> {
        let braces = self.run.iter().flat_map(|line| line.split('{').skip(1));
        let names = braces.filter_map(|rest| rest.split_once('}')).map(|(name, _)| name);
        names.filter(|name| !["repo", "data", "python"].contains(name))
    }
}
