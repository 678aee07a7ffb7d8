//! `cargo xtask peers`: Lobelia beside independent implementations, which are no part of the default test.

mod environment;
mod fit;
pub(crate) mod python;
mod render;

use anyhow::{Result, bail};

/// Runs the peers named, or all.
pub(crate) fn task(mut arguments: impl Iterator<Item = String>) -> Result<()> {
    match arguments.next().as_deref() {
        Some("fit") => fit::task(),
        Some("render") => render::task(),
        Some("environment") => environment::task(),
        None => fit::task().and_then(|()| render::task()).and_then(|()| environment::task()),
        Some(other) => bail!("there is no peer `{other}`; use fit, render or environment"),
    }
}
