//! The time of each stage, and on which machine.

use crate::page::{html, numbers};
use crate::report::Report;

/// The section.
pub(super) fn section(report: &Report) -> String {
    let longest = report.stages.iter().map(|stage| stage.seconds).fold(1e-9, f64::max);
    let row = |name: &str, seconds: f64, class: &str| {
        format!(
            "<tr{class}><th scope=\"row\">{}</th><td class=\"track\"><div \
             style=\"width:{:.1}%\"></div></td><td class=\"number\">{}</td></tr>\n",
            html::escape(name),
            (100.0 * seconds / longest).min(100.0),
            numbers::seconds(seconds)
        )
    };
    let bars: String = report.stages.iter().map(|stage| row(&stage.name, stage.seconds, "")).collect();
    let total = format!(
        "<tr class=\"total\"><th scope=\"row\">total</th><td></td><td class=\"number\">{}</td></tr>\n",
        numbers::seconds(report.seconds())
    );
    let content = format!("<table class=\"stages\"><tbody>\n{bars}{total}</tbody></table>\n");
    let machine = &report.machine;
    let gpu = machine
        .gpu
        .as_ref()
        .map_or("no GPU, CPU only".to_string(), |name| format!("GPU: {}", html::escape(name)));
    let lead = format!(
        "Seconds by the clock on {} with {} {}; {gpu}. Peak memory {}.",
        html::escape(&machine.cpu),
        machine.cores,
        if machine.cores == 1 { "thread" } else { "threads" },
        numbers::bytes(report.peak_memory_bytes)
    );
    html::section("timing", "Time of each stage", &lead, &content)
}
