//! The reference renderer beside Mitsuba 3: Z-tests of the pictures, and time to equal error in the same run.

use std::process::Command;

use anyhow::Result;

use super::python;
use crate::target;

/// Renders the scenes of tests/peers/render with both.
pub(super) fn task() -> Result<()> {
    python::run(Command::new("cargo").args(["build", "--release", "--quiet", "--package", "lobelia"]))?;
    // Mitsuba's vectorised variant, which its plugin in Python needs, compiles by LLVM's shared library.
    let python = python::venv(&["mitsuba", "numpy"])?;
    let script = "tests/peers/render/peer.py";
    let folder = target::folder()?.join("peers/render");
    python::run(Command::new(python).arg(script).arg(target::lobelia("release")?).arg(folder))
}
