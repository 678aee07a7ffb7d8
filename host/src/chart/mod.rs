//! Charts: what a method costs against how right it is. Each module measures and fills a [`Chart`].

#[cfg(feature = "sim")]
pub(crate) mod compared;
mod device;
pub mod environment;
mod filtering;
pub mod fit;
pub mod incident;
pub mod interpolation;
pub mod lights;
#[cfg(feature = "sim")]
pub mod materials;
mod models;
pub mod plan;
pub mod pool;
pub mod render;
mod residual;
pub mod stability;
pub mod storage;
mod unposed;

pub use crate::page::{Axis, Cell, Chart, Picture, Plot, Section, Series, Table};

/// The number of a cell.
#[cfg(test)]
fn number(cell: &Cell) -> Option<f64> {
    match cell {
        Cell::Text(_) => None,
        Cell::Count(count) => Some(*count as f64),
        Cell::Number(number) => Some(*number),
    }
}
