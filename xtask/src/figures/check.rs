//! What can be checked without a run: every figure is where the registry says, and every number that looks
//! measured is in it.

use std::collections::BTreeMap;
use std::fs;
use std::ops::Range;
use std::path::Path;

use anyhow::{Context, Result};

use super::number::Number;
use super::registry::{Block, Figure, Registry};
use super::scan;
use super::template::Template;

/// The texts by name.
pub(super) type Texts = BTreeMap<String, String>;

/// A figure of the registry with its numbers in the text.
pub(super) struct Placed<'a> {
    pub(super) figure: &'a Figure,
    pub(super) numbers: Vec<Number>,
}

/// Reads the registry's texts.
pub(super) fn read_texts(registry: &Registry, root: &Path) -> Result<Texts> {
    let read = |name: &String| {
        let text = fs::read_to_string(root.join(name)).with_context(|| name.clone())?;
        Ok((name.clone(), text))
    };
    registry.texts.iter().map(read).collect()
}

/// The line of a byte of a text, from 1.
pub(super) fn line_of(text: &str, at: usize) -> usize {
    text[..at].matches('\n').count() + 1
}

/// Finds every figure in its text; those that are not there once are told in `faults`.
pub(super) fn place<'a>(registry: &'a Registry, texts: &Texts, faults: &mut Vec<String>) -> Vec<Placed<'a>> {
    let mut placed: Vec<Placed<'a>> = Vec::new();
    for figure in &registry.figures {
        let Ok(template) = Template::parse(&figure.text) else { continue };
        let mut found = template.find(&texts[&figure.file]);
        match (found.pop(), found.len()) {
            (Some(numbers), 0) => placed.push(Placed { figure, numbers }),
            (None, _) => faults.push(format!("{}: nothing reads `{}`", figure.file, figure.text)),
            (_, others) => {
                faults.push(format!("{}: {} places read `{}`", figure.file, others + 1, figure.text));
            }
        }
    }
    placed
}

/// The bytes of a block's lines in a text.
pub(super) fn block_span(block: &Block, text: &str) -> Option<Range<usize>> {
    let from = text.find(&block.from)?;
    let start = from + text[from..].find('\n')? + 1;
    let end = start + text[start..].find(&block.to)?;
    Some(start..end)
}

/// Tells in `faults` what the registry has twice, what looks measured and is not in it, and which exemptions
/// are of nothing.
pub(super) fn cover(registry: &Registry, texts: &Texts, placed: &[Placed<'_>], faults: &mut Vec<String>) {
    for (name, text) in texts {
        let mut covered: Vec<Range<usize>> = Vec::new();
        for number in placed.iter().filter(|one| one.figure.file == *name).flat_map(|one| &one.numbers) {
            if covered.contains(&number.span) {
                let (line, number) = (line_of(text, number.span.start), &text[number.span.clone()]);
                faults.push(format!("{name}, line {line}: {number} is in the registry twice"));
            }
            covered.push(number.span.clone());
        }
        for block in registry.blocks.iter().filter(|block| block.file == *name) {
            match block_span(block, text) {
                Some(span) => covered.push(span),
                None => faults.push(format!("{name}: no block from `{}` to `{}`", block.from, block.to)),
            }
        }
        for exempt in registry.exempt.iter().filter(|exempt| exempt.file == *name) {
            for template in &exempt.texts {
                match Template::parse(template).map(|template| template.find(text)) {
                    Ok(found) if !found.is_empty() => {
                        covered.extend(found.into_iter().flatten().map(|number| number.span));
                    }
                    Ok(_) => faults.push(format!("{name}: nothing reads `{template}`, which is exempt")),
                    Err(error) => faults.push(format!("{name}: {error:#}")),
                }
            }
        }
        for span in scan::measured(text) {
            let inside = |own: &Range<usize>| own.start <= span.start && span.end <= own.end;
            if !covered.iter().any(inside) {
                faults.push(format!(
                    "{name}, line {}: {} is neither in the registry nor exempt: “{}”",
                    line_of(text, span.start),
                    &text[span.clone()],
                    around(text, &span)
                ));
            }
        }
    }
}

/// A number's surroundings in its line.
pub(super) fn around(text: &str, span: &Range<usize>) -> String {
    let before: Vec<char> = text[..span.start].chars().rev().take(32).take_while(|c| *c != '\n').collect();
    let after = text[span.end..].chars().take(24).take_while(|c| *c != '\n');
    let before: String = before.into_iter().rev().collect();
    format!("{before}{}{}", &text[span.clone()], after.collect::<String>()).trim().to_owned()
}
