//! Histograms with their median, as SVG.

use crate::page::scale::{Histogram, Scale};
use crate::page::{html, numbers};

/// Plot area in a drawing of 360 × 230: left, top, width, height.
const AREA: [f64; 4] = [46.0, 20.0, 288.0, 160.0];

/// The axes of a histogram.
pub(super) struct Axes<'a> {
    /// Across.
    pub(super) scale: &'a Scale,
    /// The highest column's count.
    pub(super) most: usize,
    /// What is counted, with its unit.
    pub(super) x: &'a str,
    /// What counts.
    pub(super) y: &'a str,
    /// How the median is written.
    pub(super) label: fn(f64) -> String,
}

impl Axes<'_> {
    /// The histogram as SVG with its median marked.
    pub(super) fn draw(&self, histogram: &Histogram, median: f64, alt: &str) -> String {
        let [left, top, width, height] = AREA;
        let bottom = top + height;
        let top_count = Scale::linear(0.0, 1.05 * self.most.max(1) as f64);
        let y = |count: f64| bottom - height * top_count.place(count);
        let step = width / histogram.counts.len() as f64;
        let mut drawn = String::new();
        for tick in top_count.ticks(5).into_iter().filter(|tick| tick.fract() == 0.0) {
            let at = y(tick);
            drawn += &format!(
                "<path class=\"grid\" d=\"M{left} {at:.1}h{width}\"/><text class=\"end\" x=\"{:.1}\" \
                 y=\"{:.1}\">{}</text>",
                left - 6.0,
                at + 4.0,
                numbers::count(tick as usize)
            );
        }
        for (bin, &count) in histogram.counts.iter().enumerate().filter(|(_, count)| **count > 0) {
            let (x, at) = (left + step * bin as f64, y(count as f64));
            drawn += &format!(
                "<rect class=\"column\" x=\"{:.1}\" y=\"{at:.1}\" width=\"{:.1}\" height=\"{:.1}\"/>",
                x + 0.5,
                step - 1.0,
                bottom - at
            );
        }
        drawn += &self.x_axis(bottom);
        if median.is_finite() {
            drawn += &self.median(median);
        }
        format!(
            "<svg role=\"img\" aria-label=\"histogram: {}\" viewBox=\"0 0 360 230\">{drawn}<text \
             class=\"middle name\" x=\"{:.1}\" y=\"222\">{}</text><text class=\"name\" x=\"4\" \
             y=\"13\">{}</text></svg>",
            html::escape(alt),
            left + width / 2.0,
            self.x,
            self.y
        )
    }

    /// Line and ticks under the columns.
    fn x_axis(&self, bottom: f64) -> String {
        let [left, _, width, _] = AREA;
        let percent = self.x.starts_with("relative");
        let ticks = self.scale.ticks(6).into_iter().map(|value| {
            let x = left + width * self.scale.place(value);
            let text = if percent {
                format!("{}\u{202f}%", numbers::tick(100.0 * value))
            } else {
                numbers::tick(value)
            };
            format!(
                "<path class=\"axis\" d=\"M{x:.1} {bottom}v4\"/><text class=\"middle\" x=\"{x:.1}\" \
                 y=\"{:.1}\">{text}</text>",
                bottom + 17.0
            )
        });
        format!("<path class=\"axis\" d=\"M{left} {bottom}h{width}\"/>{}", ticks.collect::<String>())
    }

    /// A line at the median, its value above.
    fn median(&self, median: f64) -> String {
        let [left, top, width, height] = AREA;
        let x = left + width * self.scale.place(median).clamp(0.0, 1.0);
        format!(
            "<path class=\"median\" d=\"M{x:.1} {top}v{height}\"/><text class=\"middle strong\" x=\"{:.1}\" \
             y=\"{:.1}\">median {}</text>",
            x.clamp(left + 56.0, left + width - 40.0),
            top - 7.0,
            (self.label)(median)
        )
    }
}
