//! Where a command's result is found: a path into JSON such as `errors/name=registration_rms/value` or a
//! template for text; `sum(…)`, `mean(…)`, `min(…)`, `max(…)` or `count(…)` of several; of such `A + B`, `A −
//! B`, `A ÷ B`, `A ∨ B` (the greater) and `A ∧ B` (the lesser).
//!
//! A segment of a path is a member's name, an index, `*` for all of a list, or `name=value`, which keeps
//! those of a list that have the value. A table of a chart (`columns` and `rows`) is a list of rows whose
//! members are the columns. `~TEMPLATE` at the end reads a number in a text, and `\/` stands for `/` in a
//! name.

use anyhow::{Context, Result, bail};
use serde_json::Value;

use super::template::Template;

/// What a command wrote.
pub(super) enum Output {
    /// JSON, or TOML as JSON.
    Document(Value),
    /// Plain text.
    Text(String),
}

/// A sign with what it makes of two numbers.
type Operator = (&'static str, fn(f64, f64) -> f64);
/// A name with what it makes of many.
type Summary = (&'static str, fn(&[f64]) -> f64);

/// What stands between two places, the loosest first.
const OPERATORS: [Operator; 5] = [
    (" ∨ ", f64::max),
    (" ∧ ", f64::min),
    (" + ", |a, b| a + b),
    (" − ", |a, b| a - b),
    (" ÷ ", |a, b| a / b),
];

/// The number at a place.
pub(super) fn number(output: &Output, place: &str) -> Result<f64> {
    for (sign, of) in OPERATORS {
        if let Some((a, b)) = place.split_once(sign) {
            return Ok(of(number(output, a)?, number(output, b)?));
        }
    }
    let kinds: [Summary; 4] = [
        ("sum", |all| all.iter().sum()),
        ("mean", |all| all.iter().sum::<f64>() / all.len() as f64),
        ("min", |all| all.iter().copied().fold(f64::INFINITY, f64::min)),
        ("max", |all| all.iter().copied().fold(f64::NEG_INFINITY, f64::max)),
    ];
    let inner = |name: &str| place.strip_prefix(name)?.strip_prefix('(')?.strip_suffix(')');
    if let Some(path) = inner("count") {
        return Ok(output.count(path)? as f64);
    }
    for (name, aggregate) in kinds {
        if let Some(path) = inner(name) {
            let all = output.numbers(path)?;
            return if all.is_empty() { bail!("nothing is at `{path}`") } else { Ok(aggregate(&all)) };
        }
    }
    match output.numbers(place)?.as_slice() {
        [only] => Ok(*only),
        all => bail!("{} numbers are at `{place}`, where one is wanted", all.len()),
    }
}

impl Output {
    fn numbers(&self, place: &str) -> Result<Vec<f64>> {
        match self {
            Self::Document(document) => numbers(document, place),
            Self::Text(text) => {
                let found = Template::parse(place)?.find(text);
                Ok(found.into_iter().flatten().map(|number| number.value).collect())
            }
        }
    }

    fn count(&self, place: &str) -> Result<usize> {
        match self {
            Self::Document(document) => Ok(select(document, place)?.0.len()),
            Self::Text(text) => Ok(Template::parse(place)?.find(text).len()),
        }
    }
}

/// All numbers at a path.
fn numbers(document: &Value, path: &str) -> Result<Vec<f64>> {
    let (found, template) = select(document, path)?;
    found
        .iter()
        .map(|value| match (&template, value) {
            (Some(template), Value::String(text)) => match template.find(text).as_slice() {
                [numbers] if numbers.len() == 1 => Ok(numbers[0].value),
                _ => bail!("`{text}` does not have one number as `{path}` wants it"),
            },
            (None, Value::Number(number)) => number.as_f64().context("a number is too large"),
            (None, Value::Bool(is)) => Ok(f64::from(u8::from(*is))),
            (None, Value::String(text)) => {
                text.trim().parse().with_context(|| format!("`{text}` at `{path}` is no number"))
            }
            (_, other) => bail!("`{path}` leads to `{other}`, which is no number"),
        })
        .collect()
}

/// The values at a path, and the template that reads them.
fn select(document: &Value, path: &str) -> Result<(Vec<Value>, Option<Template>)> {
    let (path, template) = match path.split_once("/~") {
        Some((path, template)) => (path, Some(Template::parse(template)?)),
        None => (path, None),
    };
    let mut found = vec![document.clone()];
    for segment in path.replace("\\/", "\0").split('/') {
        found = step(found, &segment.replace('\0', "/"));
        if found.is_empty() {
            bail!("nothing is at `{segment}` of `{path}`");
        }
    }
    Ok((found, template))
}

/// One segment further.
fn step(found: Vec<Value>, segment: &str) -> Vec<Value> {
    let all = || found.iter().flat_map(elements);
    if segment == "*" {
        return all().collect();
    }
    // A column may be called `n = 3`.
    let is_member = found.iter().any(|value| value.get(segment).is_some());
    if let Some((name, wanted)) = segment.split_once('=').filter(|_| !is_member) {
        return all().filter(|element| element.get(name).is_some_and(|value| is(value, wanted))).collect();
    }
    let member = |value: &Value| match segment.parse::<usize>() {
        Ok(index) if value.get(segment).is_none() => elements(value).into_iter().nth(index),
        _ => value.get(segment).cloned(),
    };
    found.iter().filter_map(member).collect()
}

/// The elements of a list, the rows of a table as objects, or the value itself.
fn elements(value: &Value) -> Vec<Value> {
    if let Value::Array(elements) = value {
        return elements.clone();
    }
    let (Some(columns), Some(rows)) =
        (value.get("columns").and_then(Value::as_array), value.get("rows").and_then(Value::as_array))
    else {
        return vec![value.clone()];
    };
    let names = || columns.iter().filter_map(Value::as_str).map(String::from);
    let row =
        |row: &Value| Value::Object(names().zip(row.as_array().into_iter().flatten().cloned()).collect());
    rows.iter().map(row).collect()
}

/// Whether a value is what a segment wants it to be.
fn is(value: &Value, wanted: &str) -> bool {
    match value {
        Value::String(text) => text == wanted,
        Value::Number(number) => wanted.parse().is_ok_and(|wanted: f64| number.as_f64() == Some(wanted)),
        Value::Bool(truth) => wanted == if *truth { "true" } else { "false" },
        Value::Null => wanted == "null",
        Value::Array(_) | Value::Object(_) => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn document() -> Output {
        Output::Document(json!({
            "errors": [
                { "name": "rms", "lobes": 1, "value": 0.5 },
                { "name": "rms", "lobes": 2, "value": 0.25 },
                { "name": "worst", "lobes": 2, "value": 4.0 },
            ],
            "stages": [{ "seconds": 1.5 }, { "seconds": 2.0 }],
            "tables": [{ "columns": ["fit", "cost / bound", "both", "n = 3"], "rows": [["lm", 1.1, "0.4 / \
                 0.7", 7], ["auto", 1.0, "0.3 \
                 / 0.2", 8]] }],
        }))
    }

    #[test]
    fn members_rows_and_aggregates_are_found() {
        for (place, expected) in [
            ("errors/name=rms/lobes=2/value", 0.25),
            ("errors/2/value", 4.0),
            ("sum(stages/*/seconds)", 3.5),
            ("mean(errors/name=rms/value)", 0.375),
            ("min(errors/*/value)", 0.25),
            ("max(errors/name=rms/value)", 0.5),
            ("count(errors/lobes=2)", 2.0),
            ("tables/0/fit=lm/cost \\/ bound", 1.1),
            ("tables/0/1/cost \\/ bound", 1.0),
            ("tables/0/fit=lm/n = 3", 7.0),
            ("tables/0/fit=auto/both/~{*} / {}", 0.2),
            ("errors/2/value ÷ errors/0/value", 8.0),
            ("errors/2/value − errors/0/value", 3.5),
            ("errors/0/value ∨ errors/1/value + errors/2/value", 4.25),
            ("errors/0/value ∧ errors/1/value ÷ errors/2/value", 0.0625),
        ] {
            assert!((number(&document(), place).unwrap() - expected).abs() < 1e-12, "{place}");
        }
        let text = Output::Text("a 1: 3 lobes\na 2: 4 lobes\nb 1: 3 lobes\n".into());
        for (place, expected) in [
            ("count(a {*}: 3 lobes) + count(b {*}: 3 lobes)", 2.0),
            ("max(a {*}: {} lobes)", 4.0),
            ("b 1: {}", 3.0),
        ] {
            assert_eq!(number(&text, place).unwrap(), expected, "{place}");
        }
    }

    #[test]
    fn what_is_not_one_number_is_refused_with_its_path() {
        for (place, words) in [
            ("errors/name=rms/value", "2 numbers"),
            ("errors/name=mean/value", "name=mean"),
            ("errors/0", "no number"),
            ("tables/0/fit=lm/fit", "`lm`"),
            ("sum(stages/*/hours)", "hours"),
        ] {
            let said = format!("{:#}", number(&document(), place).unwrap_err());
            assert!(said.contains(words), "{place}: {said}");
        }
    }
}
