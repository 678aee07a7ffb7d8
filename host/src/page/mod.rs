//! Pages: the style, numbers, scales, colour maps and pieces of HTML that the demo's page and the charts share.

// Without the simulator there is no demo, which alone uses some of it.
#![cfg_attr(not(feature = "sim"), allow(dead_code))]

pub(crate) mod colour_map;
pub(crate) mod html;
pub(crate) mod numbers;
pub(crate) mod scale;

/// The style of every page.
const STYLE: &str = include_str!("style.css");

/// A whole page that needs no other file and no network; `body` is HTML.
pub(crate) fn document(title: &str, body: &str) -> String {
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n{body}</body>\n</html>\n",
        html::escape(title)
    )
}
