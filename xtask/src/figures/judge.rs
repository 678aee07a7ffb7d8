//! What was measured against what the texts say.

use std::ops::Range;

use anyhow::{Context, Result};

use super::check::{Placed, block_span};
use super::lookup;
use super::number::Number;
use super::registry::{Block, Bound, Figure, Registry};
use super::run::Runner;

/// A number of a text that is no longer so.
pub(super) struct Moved {
    /// The text.
    pub(super) file: String,
    /// Where.
    pub(super) span: Range<usize>,
    /// As it should be written.
    pub(super) new: String,
    /// What was measured, in full.
    pub(super) measured: String,
    /// The command.
    pub(super) command: String,
}

/// The numbers of a figure as its command has them now.
pub(super) fn measure(runner: &Runner<'_>, figure: &Figure) -> Result<Vec<f64>> {
    let output = runner.output(&figure.command, runner.registry.output(figure))?;
    let one = |place: &String| {
        let place = place.replace("./", &format!("{}/", figure.base));
        Ok((lookup::number(&output, &place).with_context(|| place.clone())? - figure.less) * figure.times)
    };
    figure.at.iter().map(one).collect()
}

/// Whether a text's number still stands for what was measured.
pub(super) fn holds(figure: &Figure, number: &Number, measured: f64) -> bool {
    let usual = if figure.bound.is_some() { 0.0 } else { figure.kind.within() };
    let share = figure.within.unwrap_or(usual) * number.value.abs();
    let slack = share.max(number.half_step) * (1.0 + 1e-9);
    match figure.bound {
        None => (measured - number.value).abs() <= slack,
        Some(Bound::Most) => measured <= number.value + slack,
        Some(Bound::Least) => measured >= number.value - slack,
    }
}

/// The numbers of a figure that are no longer so.
pub(super) fn judge(runner: &Runner<'_>, placed: &Placed<'_>) -> Result<Vec<Moved>> {
    let Placed { figure, numbers } = placed;
    let measured = measure(runner, figure)?;
    let pairs = numbers.iter().zip(measured).filter(|(number, measured)| !holds(figure, number, *measured));
    let moved = pairs.map(|(number, measured)| Moved {
        file: figure.file.clone(),
        span: number.span.clone(),
        new: number.written(measured),
        measured: format!("{measured}"),
        command: figure.command.clone(),
    });
    Ok(moved.collect())
}

/// A block that its command would write otherwise.
pub(super) fn judge_block(runner: &Runner<'_>, block: &Block, text: &str) -> Result<Option<Moved>> {
    let path = runner.folder_of(&block.command).join(&block.output);
    let written = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
    let own = block_span(block, text).context("the text has no such block")?;
    let new = block_span(block, &written).context("the command wrote no such block")?;
    let differs = text[own.clone()] != written[new.clone()];
    Ok(differs.then(|| Moved {
        file: block.file.clone(),
        span: own,
        new: written[new].to_owned(),
        measured: "other lines".into(),
        command: block.command.clone(),
    }))
}

/// Commands of the registry that some figures come from.
pub(super) fn commands<'a>(registry: &'a Registry, names: impl Iterator<Item = &'a String>) -> Vec<&'a str> {
    let mut wanted: Vec<&str> = names.map(String::as_str).collect();
    wanted.sort_unstable();
    wanted.dedup();
    wanted.sort_by_key(|name| registry.commands.get(*name).map(|recipe| recipe.class));
    wanted
}
