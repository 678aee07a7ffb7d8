//! Where cargo puts what it builds: `target`, or what CARGO_TARGET_DIR or cargo's configuration say.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

/// The folder, by cargo itself.
pub(crate) fn folder() -> Result<PathBuf> {
    asked(&mut cargo())
}

/// The `lobelia` command that was built with a profile, `debug` or `release`.
pub(crate) fn lobelia(profile: &str) -> Result<PathBuf> {
    Ok(folder()?.join(profile).join(format!("lobelia{}", std::env::consts::EXE_SUFFIX)))
}

fn cargo() -> Command {
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.current_dir(Path::new(env!("CARGO_MANIFEST_DIR")));
    cargo
}

fn asked(cargo: &mut Command) -> Result<PathBuf> {
    let told = cargo.args(["metadata", "--no-deps", "--offline", "--format-version", "1"]).output()?;
    if !told.status.success() {
        bail!("cargo metadata failed: {}", String::from_utf8_lossy(&told.stderr).trim());
    }
    let metadata: serde_json::Value = serde_json::from_slice(&told.stdout)?;
    let folder = metadata.get("target_directory").and_then(serde_json::Value::as_str);
    Ok(PathBuf::from(folder.context("cargo metadata names no target_directory")?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_folder_is_where_the_environment_says_or_in_the_workspace() {
        let elsewhere = tempfile::tempdir().unwrap();
        let told = asked(cargo().env("CARGO_TARGET_DIR", elsewhere.path())).unwrap();
        assert_eq!(told, elsewhere.path());
        let own = asked(cargo().env_remove("CARGO_TARGET_DIR")).unwrap();
        assert!(own.is_absolute() && own.ends_with("target"), "{}", own.display());
    }
}
