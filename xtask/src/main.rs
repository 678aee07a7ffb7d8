//! Project tasks, run as `cargo xtask TASK`.

mod columns;
mod figures;
mod firmware;
mod packages;
mod peers;
mod target;

use std::process::{Command, ExitCode};
use std::time::Instant;

use anyhow::{Result, bail};

const HELP: &str = "cargo xtask TASK

  test    formatting, clippy, documentation, and all unit, property, end-to-end and doc tests;
          tells what each step took
  columns lines of Rust files beyond 110 columns, comments and strings too
  long    the long sweeps that `test` leaves out
  firmware [--board lm3s6965|stm32f405] [--update] [--rates]
          builds the boards' programs with clippy, prints and checks their sizes (--update renews the
          snapshot); --rates counts the instructions of a step
  figures [--check|--quick|--long] [--only TEXT|COMMAND]… [--update] [--reuse]
          measures the figures of README.md and docs again that take a few minutes (--long: all, --quick:
          seconds), and fails with old and new value if one is no longer so; --check only compares the
          texts with docs/figures.toml; --update writes new values into the texts; --reuse takes what an
          earlier run left in target/figures
  link-table  measures sessions on bad lines on the simulated rig's clock, and writes them into docs/link.md
  flash [--board B] [--probe VID:PID[:SERIAL]]
          writes a board's program, the stm32f405's unless told otherwise, by probe-rs, and leaves stored
          parameters as they are
  peers [fit|render|environment]
          runs independent implementations on the same data: the fit beside SciPy and Ceres, pictures
          beside Mitsuba 3, prefiltered environments beside Filament's cmgen (python3 and LLVM's shared
          library are needed)
  help    this text

`test` installs the software Vulkan driver that the GPU tests need when it runs as root on a Debian-like
machine, and names it otherwise; without it those tests are skipped and say so. So it does with QEMU and a
compiler for the boards, without which the tests of the boards' programs are skipped, or fail where the
environment has CI=true.";

fn main() -> ExitCode {
    let task = std::env::args().nth(1);
    let done = match task.as_deref() {
        Some("test") => test(),
        Some("columns") => columns::check(),
        Some("long") => long(),
        Some("figures") => figures::task(std::env::args().skip(2)),
        Some("firmware") => firmware::task(std::env::args().skip(2)),
        Some("link-table") => link_table(),
        Some("flash") => firmware::flash(std::env::args().skip(2)),
        Some("peers") => peers::task(std::env::args().skip(2)),
        Some("help" | "--help" | "-h") | None => {
            println!("{HELP}");
            Ok(())
        }
        Some(other) => {
            eprintln!("xtask: no task is called `{other}`\n\n{HELP}");
            return ExitCode::from(2);
        }
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("xtask: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// Everything that a change has to pass.
fn test() -> Result<()> {
    let start = Instant::now();
    packages::ensure_vulkan_driver();
    step("formatting", &["fmt", "--all", "--check"], &[])?;
    println!("xtask: columns of comments and strings: cargo xtask columns");
    columns::check()?;
    let clippy = ["clippy", "--workspace", "--all-targets", "--quiet", "--", "-D", "warnings"];
    step("clippy", &clippy, &[])?;
    step(
        "clippy without the simulator",
        &["clippy", "-p", "lobelia", "--no-default-features", "--quiet", "--", "-D", "warnings"],
        &[],
    )?;
    step("the lobelia command", &["build", "--package", "lobelia", "--quiet"], &[])?;
    firmware::for_tests()?;
    step("tests", &["test", "--workspace", "--quiet"], &[])?;
    println!("xtask: figures of the texts and their registry: cargo xtask figures --check");
    figures::task(std::iter::once("--check".to_string()))?;
    let documentation = ["doc", "--workspace", "--no-deps", "--quiet"];
    step("documentation", &documentation, &[("RUSTDOCFLAGS", "-D warnings")])?;
    println!("xtask: all passed in {:.0} s", start.elapsed().as_secs_f64());
    Ok(())
}

/// The tests that are too long for every change, optimised.
fn long() -> Result<()> {
    step("the lobelia command", &["build", "--release", "--package", "lobelia", "--quiet"], &[])?;
    step("long sweeps", &["test", "--release", "--workspace", "--", "--ignored"], &[])
}

/// The tables of docs/link.md.
fn link_table() -> Result<()> {
    let example = ["run", "--release", "--quiet", "--package", "lobelia", "--example", "link_table"];
    step("sessions on bad lines", &[&example[..], &["--", "docs/link.md"]].concat(), &[])
}

/// Runs cargo with some arguments and environment, telling what for.
fn step(name: &str, arguments: &[&str], environment: &[(&str, &str)]) -> Result<()> {
    println!("xtask: {name}: cargo {}", arguments.join(" "));
    let start = Instant::now();
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let status = Command::new(cargo).args(arguments).envs(environment.iter().copied()).status()?;
    if !status.success() {
        bail!("{name} failed ({status})");
    }
    println!("xtask: {name} took {:.0} s", start.elapsed().as_secs_f64());
    Ok(())
}
