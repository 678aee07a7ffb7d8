//! The fit of texels beside SciPy's `least_squares` and Ceres: the same samples, the same model, one core
//! each.

use std::path::Path;
use std::process::Command;

use anyhow::{Result, bail};

use super::python::{self, run};
use crate::{packages, target};

/// Ceres and a compiler for it.
const CERES: [&str; 3] = ["libceres-dev", "g++", "libgoogle-glog-dev"];

/// Makes samples, fits them with all three, and prints rates and costs.
pub(super) fn task() -> Result<()> {
    run(Command::new("cargo").args(["build", "--release", "--quiet", "--package", "lobelia"]))?;
    let python = python::venv(&["numpy", "scipy", "zarr", "OpenEXR"])?;
    let folder = target::folder()?.join("peers/fit");
    std::fs::create_dir_all(&folder)?;
    let program = folder.join("ceres");
    ensure_ceres()?;
    let mut compiler = Command::new("g++");
    compiler.args(["-O3", "-march=native", "-DNDEBUG", "-I/usr/include/eigen3", "tests/peers/fit/ceres.cpp"]);
    run(compiler.arg("-o").arg(&program).args(["-lceres", "-lglog"]))?;
    let mut script = Command::new(python);
    script.arg("tests/peers/fit/peer.py").arg(target::lobelia("release")?).arg(&folder);
    // NumPy's linear algebra would use every core.
    run(script.envs(["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"].map(|name| (name, "1"))))
}

fn ensure_ceres() -> Result<()> {
    let there = || {
        Path::new("/usr/include/ceres/ceres.h").exists()
            && Command::new("g++").arg("--version").output().is_ok()
    };
    let packages = CERES.join(" ");
    if there() || (packages::can_install() && packages::install(&CERES, None) && there()) {
        return Ok(());
    }
    bail!("no Ceres; on Debian: sudo apt-get install {packages}")
}
