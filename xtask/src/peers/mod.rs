//! `cargo xtask peers`: Lobelia beside independent implementations, which are no part of the default test.

mod python;
mod render;

use anyhow::{Result, bail};

/// Runs the peers named, or all.
pub(crate) fn task(mut arguments: impl Iterator<Item = String>) -> Result<()> {
    match arguments.next().as_deref() {
        None | Some("render") => render::task(),
        Some(other) => bail!("there is no peer `{other}`; use render"),
    }
}
