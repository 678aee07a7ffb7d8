//! Tables of numbers and words, as HTML, JSON and text.

use serde::Serialize;

use super::{html, numbers};

/// Significant digits of numbers that are shown; JSON has them all.
const DIGITS: usize = 3;

/// One entry of a table.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Cell {
    /// A word or a sentence.
    Text(String),
    /// A whole number, shown in full.
    Count(u64),
    /// A measured number, shown with three digits; NaN as a dash.
    Number(f64),
}

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Self::Text(text.into())
    }
}

impl From<String> for Cell {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl From<f64> for Cell {
    fn from(number: f64) -> Self {
        Self::Number(number)
    }
}

impl From<usize> for Cell {
    fn from(count: usize) -> Self {
        Self::Count(count as u64)
    }
}

impl Cell {
    fn text(&self) -> String {
        match self {
            Self::Text(text) => text.clone(),
            Self::Count(count) => numbers::count(*count as usize),
            Self::Number(number) => numbers::significant(*number, DIGITS),
        }
    }

    fn is_text(&self) -> bool {
        matches!(self, Self::Text(_))
    }
}

/// Rows under named columns.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Table {
    /// Names of the columns, with units.
    pub columns: Vec<String>,
    /// The rows, each as long as `columns`.
    pub rows: Vec<Vec<Cell>>,
}

impl Table {
    /// An empty table.
    pub fn new<const N: usize>(columns: [&str; N]) -> Self {
        Self { columns: columns.map(String::from).to_vec(), rows: Vec::new() }
    }

    /// Adds a row.
    pub fn row<const N: usize>(&mut self, cells: [Cell; N]) {
        self.rows.push(cells.to_vec());
    }

    /// Whether a column holds numbers, which stand at its right edge.
    fn numeric(&self, column: usize) -> bool {
        self.rows.iter().filter_map(|row| row.get(column)).all(|cell| !cell.is_text())
    }

    /// The table as HTML.
    pub fn html(&self) -> String {
        let class = |column| if self.numeric(column) { " class=\"number\"" } else { "" };
        let line = |tag: &str, texts: Vec<String>| {
            let cells = texts
                .iter()
                .enumerate()
                .map(|(column, text)| format!("<{tag}{}>{}</{tag}>", class(column), html::escape(text)));
            format!("<tr>{}</tr>\n", cells.collect::<String>())
        };
        let rows = self.rows.iter().map(|row| line("td", row.iter().map(Cell::text).collect()));
        format!(
            "<table><thead>{}</thead><tbody>\n{}</tbody></table>\n",
            line("th", self.columns.clone()),
            rows.collect::<String>()
        )
    }
}

impl std::fmt::Display for Table {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let rows = self.rows.iter().map(|row| row.iter().map(Cell::text).collect());
        let lines: Vec<Vec<String>> = std::iter::once(self.columns.clone()).chain(rows).collect();
        let width = |column: usize| {
            lines.iter().filter_map(|line| line.get(column)).map(|text| text.chars().count()).max()
        };
        let widths: Vec<usize> = (0..self.columns.len()).map(|column| width(column).unwrap_or(0)).collect();
        for line in &lines {
            let cells = line.iter().zip(&widths).enumerate().map(|(column, (text, &width))| {
                if self.numeric(column) { format!("{text:>width$}") } else { format!("{text:<width$}") }
            });
            writeln!(f, "{}", cells.collect::<Vec<_>>().join("  ").trim_end())?;
        }
        Ok(())
    }
}
