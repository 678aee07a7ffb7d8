//! Charts: plots and tables of what a method costs against how right it is, as HTML, SVG and JSON.
//!
//! Whoever measures fills a [`Chart`] with plots, tables, pictures and sentences; [`Chart::write`] makes one
//! page of it, every plot also as an SVG file of its own, and every number once more as JSON.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::{Plot, Table, html};
use crate::error::{Error, Result};
use crate::files;

/// A page of plots and tables.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Chart {
    /// Name of its files.
    pub name: String,
    /// Heading.
    pub title: String,
    /// What was measured, against what, in a few sentences.
    pub lead: String,
    /// The sections, in order.
    pub sections: Vec<Section>,
}

/// A part of a chart: a heading, a sentence, plots side by side, the table of their numbers.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Section {
    /// Heading.
    pub title: String,
    /// What is seen and how it was measured.
    pub text: String,
    /// The plots.
    pub plots: Vec<Plot>,
    /// Pictures in rows of three.
    pub pictures: Vec<Picture>,
    /// The numbers.
    pub tables: Vec<Table>,
}

/// A picture of a chart.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Picture {
    /// What it shows.
    pub title: String,
    /// The bytes of a PNG file.
    #[serde(skip)]
    pub png: Vec<u8>,
}

impl Chart {
    /// Writes `NAME.html`, `NAME.json` and an SVG file a plot into a folder, which is created. Gives the
    /// page's path.
    ///
    /// # Errors
    /// When the folder or a file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<PathBuf> {
        files::create_folder(folder)?;
        let plots = self.sections.iter().flat_map(|section| &section.plots);
        for (index, plot) in plots.enumerate() {
            let path = folder.join(format!("{}-{}.svg", self.name, index + 1));
            files::write_bytes(&path, plot.svg_file().as_bytes())?;
        }
        let json = serde_json::to_vec_pretty(self).map_err(|error| {
            Error::failure(format!("the chart cannot be written as JSON: {error}")).caused_by(error)
        })?;
        files::write_bytes(&folder.join(format!("{}.json", self.name)), &json)?;
        let path = folder.join(format!("{}.html", self.name));
        files::write_bytes(&path, self.html().as_bytes())?;
        Ok(path)
    }

    fn html(&self) -> String {
        let heading = format!(
            "<header><h1>{}</h1><p class=\"lead\">{}</p></header>\n",
            html::escape(&self.title),
            html::escape(&self.lead)
        );
        let sections = self.sections.iter().enumerate().map(|(index, section)| {
            html::section(
                &format!("section-{}", index + 1),
                &section.title,
                &html::escape(&section.text),
                &section.html(),
            )
        });
        let body = format!("<main>\n{heading}{}</main>\n", sections.collect::<String>());
        super::document(&self.title, &body)
    }
}

impl Section {
    fn html(&self) -> String {
        let plots = self.plots.iter().map(|plot| html::figure(&plot.svg(), &html::escape(&plot.title)));
        let plots: String = plots.collect();
        let class = if self.plots.len() > 1 { "two" } else { "one" };
        let picture = |picture: &Picture| {
            html::figure(
                &html::picture(&picture.png, &picture.title, "rendered"),
                &html::escape(&picture.title),
            )
        };
        let pictures: String = self.pictures.iter().map(picture).collect();
        let table = |table: &Table| format!("<div class=\"scroll\">{}</div>\n", table.html());
        let tables: String = self.tables.iter().map(table).collect();
        format!("<div class=\"{class}\">{plots}</div>\n<div class=\"three\">{pictures}</div>\n{tables}")
    }
}

impl std::fmt::Display for Chart {
    /// The tables as text, for a terminal.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for section in &self.sections {
            for table in &section.tables {
                writeln!(f, "{}\n{table}", section.title)?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::page::{Axis, Series};

    fn chart() -> Chart {
        let series = Series::new("a < b", vec![[1.0, 0.1], [10.0, 0.01], [100.0, f64::NAN]]);
        let plot = Plot {
            title: "error by time".into(),
            x: Axis::log("time, s"),
            y: Axis::log("error"),
            series: vec![series],
        };
        let mut table = Table::new(["method", "time, s"]);
        table.row(["<x>".into(), 0.012_34.into()]);
        let section = Section {
            title: "Fits".into(),
            text: "All.".into(),
            plots: vec![plot],
            tables: vec![table],
            ..Section::default()
        };
        Chart { name: "fit".into(), title: "T".into(), lead: "L".into(), sections: vec![section] }
    }

    #[test]
    fn a_chart_is_a_page_with_its_numbers_a_drawing_a_plot_and_json() {
        let folder = tempfile::tempdir().unwrap();
        let page = std::fs::read_to_string(chart().write(folder.path()).unwrap()).unwrap();
        assert!(page.contains("a &lt; b") && page.contains("&lt;x&gt;") && page.contains("0.0123"), "{page}");
        // What is no number is not drawn.
        assert_eq!(page.matches("class=\"point\"").count(), 2);
        let drawing = std::fs::read_to_string(folder.path().join("fit-1.svg")).unwrap();
        assert!(drawing.starts_with("<svg xmlns"));
        let json: serde_json::Value =
            serde_json::from_slice(&std::fs::read(folder.path().join("fit.json")).unwrap()).unwrap();
        assert_eq!(json["sections"][0]["plots"][0]["series"][0]["points"][1][1], 0.01);
        assert_eq!(json["sections"][0]["tables"][0]["rows"][0][1], 0.012_34);
    }

    #[test]
    fn the_terminal_sees_the_tables_in_columns() {
        let text = chart().to_string();
        assert!(text.contains("method  time, s\n<x>      0.0123\n"), "{text}");
    }
}
