//! Prefiltering beside cmgen of Filament, from Debian: CPU time, memory and error of maps of equal size.

use std::process::Command;

use anyhow::{Result, bail};

use super::python::{self, run};
use crate::{packages, target};

/// The Debian package of cmgen.
const CMGEN: &str = "libfilament-tools";

/// Filters one sky by both, and prints times and errors.
pub(super) fn task() -> Result<()> {
    run(Command::new("cargo").args(["build", "--release", "--quiet", "--package", "lobelia"]))?;
    ensure_cmgen()?;
    let python = python::venv(&["numpy", "OpenEXR"])?;
    let script = "tests/peers/environment/peer.py";
    let folder = target::folder()?.join("peers/environment");
    run(Command::new(python).arg(script).arg(target::lobelia("release")?).arg("cmgen").arg(folder))
}

fn ensure_cmgen() -> Result<()> {
    let there = || Command::new("cmgen").arg("--help").output().is_ok();
    if there() || (packages::can_install() && packages::install(&[CMGEN], None) && there()) {
        return Ok(());
    }
    bail!("no cmgen; on Debian: sudo apt-get install {CMGEN}")
}
