//! A compiler for the boards: rustup's where it has `core` for the target, else Debian's with a `core` built
//! from its source.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::packages;

/// Debian's compiler, which has its standard library's source in a package.
const DEBIAN_RUSTC: &str = "/usr/bin/rustc";
const DEBIAN_CLIPPY: &str = "/usr/bin/clippy-driver";

/// How to compile for the boards.
pub(crate) struct Toolchain {
    /// The compiler, and clippy's.
    pub(crate) rustc: PathBuf,
    clippy: PathBuf,
    /// Where `core` is, unless the compiler has it.
    sysroot: Option<PathBuf>,
    linker: PathBuf,
    /// The compiler's release, as 1.96.0.
    pub(crate) release: String,
}

impl Toolchain {
    /// Finds a compiler with `core` for the targets, or makes one.
    pub(crate) fn find(root: &Path, targets: &[&str]) -> Result<Self> {
        let linker = linker()?;
        if targets.iter().all(|target| has_core(target)) {
            let (rustc, clippy) = ("rustc".into(), "clippy-driver".into());
            let release = version("rustc".as_ref())?.0;
            return Ok(Self { rustc, clippy, sysroot: None, linker, release });
        }
        install_debian(targets)?;
        let rustc = PathBuf::from(DEBIAN_RUSTC);
        let (release, commit) = version(&rustc)?;
        let sysroot = root.join("target/arm-sysroot").join(format!("{release}-{commit}"));
        build_core(&sysroot, targets)?;
        Ok(Self { rustc, clippy: DEBIAN_CLIPPY.into(), sysroot: Some(sysroot), linker, release })
    }

    /// Cargo in a board's folder, with the arguments and the environment that the compiler needs.
    pub(crate) fn cargo(&self, board: &Path, arguments: &[&str], clippy: bool) -> Command {
        let mut flags = vec!["-Clink-arg=-Tlink.x".to_owned(), "-Clink-arg=--nmagic".to_owned()];
        flags.push(format!("-Clinker={}", self.linker.display()));
        flags.push("-Clinker-flavor=ld.lld".to_owned());
        if let Some(sysroot) = &self.sysroot {
            flags.extend(["--sysroot".to_owned(), sysroot.display().to_string()]);
        }
        let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        cargo.current_dir(board).args(arguments).arg("--locked");
        cargo.env("RUSTC", &self.rustc).env("CARGO_ENCODED_RUSTFLAGS", flags.join("\x1f"));
        cargo.env_remove("CARGO_TARGET_DIR").env_remove("RUSTFLAGS");
        if clippy {
            // What `cargo clippy` does; it would take the compiler of its own toolchain.
            cargo.env("RUSTC_WORKSPACE_WRAPPER", &self.clippy);
            cargo.env("CLIPPY_ARGS", "-Dwarnings__CLIPPY_HACKERY__");
        }
        cargo
    }
}

/// Whether the compiler on the path has `core` for a target.
fn has_core(target: &str) -> bool {
    output(Command::new("rustc").args(["--print", "target-libdir", "--target", target]))
        .is_ok_and(|folder| is_built(Path::new(folder.trim())))
}

fn is_built(folder: &Path) -> bool {
    fs::read_dir(folder).is_ok_and(|mut entries| {
        entries
            .any(|entry| entry.is_ok_and(|entry| entry.file_name().to_string_lossy().starts_with("libcore-")))
    })
}

/// Release and short commit of a compiler.
fn version(rustc: &Path) -> Result<(String, String)> {
    let text = output(Command::new(rustc).arg("-vV"))?;
    let field = |name: &str| text.lines().find_map(|line| line.strip_prefix(name)).map(str::trim);
    let release = field("release:").context("the compiler tells no release")?;
    let commit = field("commit-hash:").unwrap_or("unknown");
    Ok((release.to_owned(), commit.chars().take(9).collect()))
}

/// A linker for ARM: rustup's own, or a system's.
fn linker() -> Result<PathBuf> {
    if let Ok(sysroot) = output(Command::new("rustc").args(["--print", "sysroot"])) {
        let rustlib = Path::new(sysroot.trim()).join("lib/rustlib");
        let hosts = fs::read_dir(rustlib).into_iter().flatten().flatten();
        if let Some(found) = hosts.map(|host| host.path().join("bin/rust-lld")).find(|linker| linker.exists())
        {
            return Ok(found);
        }
    }
    let path = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&path)
        .map(|folder| folder.join("ld.lld"))
        .find(|linker| linker.exists())
        .context("no linker for ARM: rustup's toolchain has rust-lld; on Debian: sudo apt-get install lld")
}

/// Whether Debian's compiler, its library's source and its clippy are there.
fn has_debian() -> bool {
    let Ok(sysroot) = output(Command::new(DEBIAN_RUSTC).args(["--print", "sysroot"])) else { return false };
    let source = Path::new(sysroot.trim()).join("lib/rustlib/src/rust/library/core/src/lib.rs");
    source.exists() && Path::new(DEBIAN_CLIPPY).exists()
}

fn install_debian(targets: &[&str]) -> Result<()> {
    if has_debian() {
        return Ok(());
    }
    let mut named = vec!["rustc-web", "rust-web-src", "rust-web-clippy"];
    if packages::can_install() {
        // The source has to be of the compiler's version, and both may be there in several.
        packages::install(&["rustc-web"], None);
        let version = output(Command::new("dpkg-query").args(["-W", "-f", "${Version}", "rustc-web"]));
        let source = version.map(|version| format!("rust-web-src={}", version.trim()));
        if let Ok(source) = &source {
            named[1] = source;
        }
        packages::install(&named, None);
        if has_debian() {
            return Ok(());
        }
    }
    bail!(
        "no compiler for {}; run `rustup target add {}`, or on Debian: sudo apt-get install \
         --no-install-recommends rustc-web rust-web-clippy and rust-web-src of the same version",
        targets.join(", "),
        targets.join(" ")
    )
}

/// Builds `core`, `alloc` and `compiler_builtins` for the targets that aren't in the sysroot.
fn build_core(sysroot: &Path, targets: &[&str]) -> Result<()> {
    let folder = |target: &str| sysroot.join("lib/rustlib").join(target).join("lib");
    let missing: Vec<_> = targets.iter().copied().filter(|target| !is_built(&folder(target))).collect();
    if missing.is_empty() {
        return Ok(());
    }
    println!("xtask: building core for {} (a minute, once a compiler)", missing.join(", "));
    let package = sysroot.join("empty");
    fs::create_dir_all(package.join("src"))?;
    fs::write(package.join("Cargo.toml"), EMPTY_PACKAGE)?;
    fs::write(package.join("src/lib.rs"), "#![no_std]\n")?;
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.current_dir(&package).args(["build", "--quiet", "--release", "--target-dir", "target"]);
    cargo.args(["-Zbuild-std=core,alloc,compiler_builtins", "-Zbuild-std-features=compiler-builtins-mem"]);
    cargo.args(missing.iter().flat_map(|target| ["--target", target]));
    // A released compiler refuses -Z else.
    cargo.env("RUSTC", DEBIAN_RUSTC).env("RUSTC_BOOTSTRAP", "1");
    cargo.env("RUSTFLAGS", "-Cembed-bitcode=yes").env_remove("CARGO_ENCODED_RUSTFLAGS");
    if !cargo.status()?.success() {
        bail!("core could not be built for {}", missing.join(", "));
    }
    for target in missing {
        let to = folder(target);
        let unfinished = to.with_extension("tmp");
        fs::create_dir_all(&unfinished)?;
        for entry in fs::read_dir(package.join("target").join(target).join("release/deps"))? {
            let entry = entry?;
            if entry.path().extension().is_some_and(|extension| extension == "rlib") {
                fs::copy(entry.path(), unfinished.join(entry.file_name()))?;
            }
        }
        fs::rename(&unfinished, &to)?;
    }
    Ok(fs::remove_dir_all(package)?)
}

const EMPTY_PACKAGE: &str = "[package]\nname = \"empty\"\nversion = \"0.0.0\"\nedition = \"2024\"\n\
    [workspace]\n[profile.release]\npanic = \"abort\"\ndebug = 1\n";

/// What a command prints.
fn output(command: &mut Command) -> Result<String> {
    let output = command.output()?;
    if !output.status.success() {
        bail!("{command:?} failed ({})", output.status);
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}
