//! Plots of series of points as SVG: lines with marks, on linear or logarithmic axes.

use std::fmt::Write as _;

use serde::Serialize;

use super::scale::Scale;
use super::{html, numbers};

/// Size of a drawing.
const SIZE: [f64; 2] = [560.0, 400.0];
/// Plot area: left, top, width, height. The legend stands below.
const AREA: [f64; 4] = [64.0, 24.0, 480.0, 270.0];
/// Height of a row of the legend, and entries in a row.
const LEGEND: (f64, usize) = (18.0, 3);
/// Colours that people with any colour vision can tell apart, readable on light and dark (Okabe and Ito).
const COLOURS: [&str; 8] =
    ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f7f7f", "#8c5fd0"];

/// What an axis shows.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Axis {
    /// Quantity and unit.
    pub label: String,
    /// Whether it is logarithmic; values at or below 0 are then left out.
    pub log: bool,
}

impl Axis {
    /// A linear axis, which contains 0.
    pub fn linear(label: &str) -> Self {
        Self { label: label.into(), log: false }
    }

    /// A logarithmic axis.
    pub fn log(label: &str) -> Self {
        Self { label: label.into(), log: true }
    }

    /// The scale that holds the values.
    fn scale(&self, values: impl Iterator<Item = f64>) -> Scale {
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
        match (low.is_finite(), self.log) {
            (false, _) => Scale::linear(0.0, 1.0),
            (_, true) => Scale::log(low, high).rounded(),
            (_, false) => Scale::linear(low.min(0.0), 1.05 * high.max(0.0)),
        }
    }

    fn shows(&self, value: f64) -> bool {
        value.is_finite() && (!self.log || value > 0.0)
    }
}

/// Points that belong together.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Series {
    /// Name for the legend.
    pub name: String,
    /// The points \[x, y\], in the order in which the line joins them.
    pub points: Vec<[f64; 2]>,
    /// What each point is, shown when it is pointed at; may be empty.
    pub labels: Vec<String>,
    /// Whether a line joins the points.
    pub line: bool,
}

impl Series {
    /// Points joined by a line.
    pub fn new(name: impl Into<String>, points: Vec<[f64; 2]>) -> Self {
        Self { name: name.into(), points, labels: Vec::new(), line: true }
    }

    /// Points by themselves, each with a label.
    pub fn scattered(name: impl Into<String>, points: Vec<[f64; 2]>, labels: Vec<String>) -> Self {
        Self { name: name.into(), points, labels, line: false }
    }
}

/// A plot of several series.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Plot {
    /// What it shows.
    pub title: String,
    /// Across.
    pub x: Axis,
    /// Upward.
    pub y: Axis,
    /// The series; colours and marks follow their order.
    pub series: Vec<Series>,
}

impl Plot {
    /// The drawing, for a page whose style it takes.
    pub(super) fn svg(&self) -> String {
        self.drawing("", "")
    }

    /// The drawing as a file of its own.
    pub(super) fn svg_file(&self) -> String {
        let style = "<style>text{font:12px sans-serif;fill:#555}\
                     .middle{text-anchor:middle}.end{text-anchor:end}\
                     .grid{stroke:#ddd;fill:none}.axis{stroke:#777;fill:none}</style>\
                     <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>";
        self.drawing(" xmlns=\"http://www.w3.org/2000/svg\"", style)
    }

    fn drawing(&self, attributes: &str, style: &str) -> String {
        let shown = |points: &[[f64; 2]]| -> Vec<[f64; 2]> {
            points.iter().copied().filter(|[x, y]| self.x.shows(*x) && self.y.shows(*y)).collect()
        };
        let all: Vec<[f64; 2]> = self.series.iter().flat_map(|series| shown(&series.points)).collect();
        let scales = [self.x.scale(all.iter().map(|p| p[0])), self.y.scale(all.iter().map(|p| p[1]))];
        let series: String =
            self.series.iter().enumerate().map(|(index, series)| self.draw(&scales, index, series)).collect();
        let rows = self.series.len().div_ceil(LEGEND.1) as f64;
        let height = SIZE[1] - 60.0 + LEGEND.0 * rows;
        format!(
            "<svg{attributes} role=\"img\" aria-label=\"{}\" viewBox=\"0 0 {} \
             {height}\">{style}{}{series}{}</svg>",
            html::escape(&self.title),
            SIZE[0],
            self.axes(&scales),
            self.legend()
        )
    }

    fn axes(&self, [x, y]: &[Scale; 2]) -> String {
        let [left, top, width, height] = AREA;
        let bottom = top + height;
        let mut drawn = String::new();
        let ticks = x.ticks(7);
        for (value, text) in ticks.iter().zip(numbers::ticks(&ticks)) {
            let at = left + width * x.place(*value);
            let _ = write!(
                drawn,
                "<path class=\"grid\" d=\"M{at:.1} {top}v{height}\"/><text class=\"middle\" x=\"{at:.1}\" \
                 y=\"{:.1}\">{text}</text>",
                bottom + 17.0
            );
        }
        let ticks = y.ticks(6);
        for (value, text) in ticks.iter().zip(numbers::ticks(&ticks)) {
            let at = bottom - height * y.place(*value);
            let _ = write!(
                drawn,
                "<path class=\"grid\" d=\"M{left} {at:.1}h{width}\"/><text class=\"end\" x=\"{:.1}\" \
                 y=\"{:.1}\">{text}</text>",
                left - 6.0,
                at + 4.0
            );
        }
        format!(
            "{drawn}<path class=\"axis\" d=\"M{left} {top}v{height}h{width}\"/><text class=\"middle\" \
             x=\"{:.1}\" y=\"{:.1}\">{}</text><text x=\"4\" y=\"14\">{}</text>",
            left + width / 2.0,
            bottom + 36.0,
            html::escape(&self.x.label),
            html::escape(&self.y.label)
        )
    }

    fn draw(&self, [x, y]: &[Scale; 2], index: usize, series: &Series) -> String {
        let [left, top, width, height] = AREA;
        let colour = COLOURS[index % COLOURS.len()];
        let (mut path, mut marks) = (String::new(), String::new());
        let mut pen_down = false;
        for (k, &[px, py]) in series.points.iter().enumerate() {
            if !(self.x.shows(px) && self.y.shows(py)) {
                pen_down = false;
                continue;
            }
            let at = [left + width * x.place(px), top + height * (1.0 - y.place(py))];
            let _ = write!(path, "{}{:.1} {:.1}", if pen_down { 'L' } else { 'M' }, at[0], at[1]);
            pen_down = true;
            let label = series.labels.get(k).map_or(series.name.as_str(), String::as_str);
            let value = |v: f64| numbers::significant(v, 3);
            let _ = write!(
                marks,
                "<g class=\"point\"><title>{}: {}, {}</title>{}</g>",
                html::escape(label),
                value(px),
                value(py),
                mark(index, at, colour)
            );
        }
        let line = if series.line {
            format!("<path d=\"{path}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.8\"/>")
        } else {
            String::new()
        };
        line + &marks
    }

    fn legend(&self) -> String {
        let [left, top, width, height] = AREA;
        let (row, columns) = LEGEND;
        let entry = |(index, series): (usize, &Series)| {
            let x = left + width / columns as f64 * (index % columns) as f64;
            let y = top + height + 58.0 + row * (index / columns) as f64;
            let colour = COLOURS[index % COLOURS.len()];
            format!(
                "{}<text x=\"{:.1}\" y=\"{:.1}\">{}</text>",
                mark(index, [x, y - 4.0], colour),
                x + 10.0,
                y,
                html::escape(&series.name)
            )
        };
        self.series.iter().enumerate().map(entry).collect()
    }
}

/// The mark of a series at a place: its shape tells it apart without colour.
fn mark(index: usize, [x, y]: [f64; 2], colour: &str) -> String {
    match index % 4 {
        0 => format!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4\" fill=\"{colour}\"/>"),
        1 => format!(
            "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"7\" height=\"7\" fill=\"{colour}\"/>",
            x - 3.5,
            y - 3.5
        ),
        2 => format!("<path d=\"M{x:.1} {:.1}l4.5 4.5l-4.5 4.5l-4.5 -4.5z\" fill=\"{colour}\"/>", y - 4.5),
        _ => format!("<path d=\"M{x:.1} {:.1}l4.5 8h-9z\" fill=\"{colour}\"/>", y - 5.0),
    }
}
