//! Pages: plots, tables and pictures as documents; and the style, numbers, scales, colour maps and pieces of
//! HTML that they are made of.

mod chart;
pub mod colour_map;
pub mod html;
pub mod numbers;
mod plot;
pub mod scale;
mod table;

pub use chart::{Chart, Picture, Section};
pub use plot::{Axis, Plot, Series};
pub use table::{Cell, Table};

/// The style of every page.
const STYLE: &str = include_str!("style.css");

/// A whole page that needs no other file and no network; `body` is HTML.
pub fn document(title: &str, body: &str) -> String {
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n{body}</body>\n</html>\n",
        html::escape(title)
    )
}
