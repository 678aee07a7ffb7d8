//! The boards' programs: built, measured, compared with a snapshot, put where the tests look for them, and
//! flashed.

mod elf;
mod rates;
mod sizes;
mod stack;
mod toolchain;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::packages;
use elf::Elf;
use sizes::Sizes;
use toolchain::Toolchain;

/// A board.
struct Board {
    /// Its folder's name, and after `lobelia-` its program's.
    name: &'static str,
    target: &'static str,
    /// Where its flash begins, and in it the vector table.
    flash: u32,
    /// The chip's name for probe-rs; none for a board that is only emulated.
    chip: Option<&'static str>,
}

const BOARDS: [Board; 2] = [
    Board { name: "lm3s6965", target: "thumbv7m-none-eabi", flash: 0, chip: None },
    Board {
        name: "stm32f405",
        target: "thumbv7em-none-eabihf",
        flash: 0x0800_0000,
        chip: Some("STM32F405RGTx"),
    },
];

impl Board {
    fn folder(&self) -> PathBuf {
        root().join("firmware/boards").join(self.name)
    }

    fn target_folder(&self) -> PathBuf {
        root().join("target/firmware").join(self.name)
    }

    /// Builds the programs and puts them into target/firmware/`real` or `qemu`, by their names.
    fn build(&self, toolchain: &Toolchain, feature: Option<&str>) -> Result<PathBuf> {
        let mut arguments = vec!["build", "--release", "--quiet"];
        let folder = self.target_folder().display().to_string();
        arguments.extend(["--target", self.target, "--target-dir", &folder]);
        arguments.extend(feature.iter().flat_map(|feature| ["--features", feature]));
        run(&mut toolchain.cargo(&self.folder(), &arguments, false))?;
        // Both kinds have one name, so the next build would replace this one.
        let to = root().join("target/firmware").join(feature.unwrap_or("real"));
        fs::create_dir_all(&to)?;
        let program = to.join(self.name);
        let built = self.target_folder().join(self.target).join("release");
        fs::copy(built.join(format!("lobelia-{}", self.name)), &program)?;
        if feature.is_some() {
            fs::copy(built.join("rates"), to.join(format!("{}-rates", self.name)))?;
        }
        Ok(program)
    }

    /// Formatting, and clippy for both kinds of the programs.
    fn lint(&self, toolchain: &Toolchain) -> Result<()> {
        let mut fmt = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        run(fmt.current_dir(self.folder()).args(["fmt", "--check"]))?;
        let folder = root().join("target/firmware/clippy").join(self.name).display().to_string();
        for features in [&[][..], &["--features", "qemu"]] {
            let arguments =
                [&["check", "--quiet", "--target", self.target, "--target-dir", &folder], features];
            run(&mut toolchain.cargo(&self.folder(), &arguments.concat(), true))?;
        }
        Ok(())
    }
}

/// The repository.
fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap_or(Path::new("."))
}

/// `cargo xtask firmware`.
pub(crate) fn task(arguments: impl Iterator<Item = String>) -> Result<()> {
    let (mut chosen, mut update, mut count) = (None, false, false);
    let mut arguments = arguments;
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--update" => update = true,
            "--rates" => count = true,
            "--board" => chosen = Some(arguments.next().context("--board needs a board's name")?),
            other => bail!("firmware has no option `{other}`; see `cargo xtask help`"),
        }
    }
    let boards: Vec<_> =
        BOARDS.iter().filter(|board| chosen.as_ref().is_none_or(|name| name == board.name)).collect();
    if boards.is_empty() {
        bail!("no such board; there are {}", BOARDS.map(|board| board.name).join(" and "));
    }
    let toolchain = find_toolchain(&boards)?;
    println!("xtask: firmware with compiler {}", toolchain.release);
    build_and_measure(&toolchain, &boards, update)?;
    for board in &boards {
        board.lint(&toolchain)?;
    }
    println!("xtask: formatting and clippy for {}: fine", names(&boards));
    if count {
        if !packages::ensure_qemu() {
            bail!("instructions are counted in QEMU, which is not there");
        }
        for board in &boards {
            board.build(&toolchain, Some("qemu"))?;
            rates::print(board.name, &root().join("target/firmware/qemu"))?;
        }
    }
    Ok(())
}

fn find_toolchain(boards: &[&Board]) -> Result<Toolchain> {
    let targets: Vec<_> = boards.iter().map(|board| board.target).collect();
    Toolchain::find(root(), &targets)
}

fn names(boards: &[&Board]) -> String {
    boards.iter().map(|board| board.name).collect::<Vec<_>>().join(", ")
}

/// Builds the programs that real boards get, prints their sizes and compares them.
fn build_and_measure(toolchain: &Toolchain, boards: &[&Board], update: bool) -> Result<()> {
    let mut measured = Vec::new();
    println!("{:>12} {:>8} {:>8} {:>8} {:>11}  in bytes", "", "text", "data", "bss", "worst stack");
    for board in boards {
        let program = Elf::read(&board.build(toolchain, None)?)?;
        let sizes = Sizes::of(&program);
        let stack = stack::worst(&program, board.flash);
        let Sizes { text, data, bss } = sizes;
        print!("{:>12} {text:>8} {data:>8} {bss:>8} {:>11}", board.name, stack.bytes);
        let recursive = if stack.recursive { " and of recursion" } else { "" };
        println!("  without what is below {} calls through pointers{recursive}", stack.pointers);
        let room = stack_room(&program).context("the program tells no bounds of its stack")?;
        if stack.bytes > room {
            bail!(
                "{}: the stack may take {} bytes and has {room}; see its memory.x",
                board.name,
                stack.bytes
            );
        }
        measured.push((board.name, sizes));
    }
    sizes::check(&root().join("firmware/boards/sizes.toml"), &toolchain.release, &measured, update)
}

/// Bytes that a program's linker script sets aside for its stack.
fn stack_room(program: &Elf) -> Option<u32> {
    let symbols = program.symbols();
    let value = |name: &str| symbols.iter().find(|symbol| symbol.name == name).map(|symbol| symbol.value);
    value("_stack_start")?.checked_sub(value("_stack_end")?)
}

/// What `cargo xtask test` needs: the programs for QEMU, and sizes as in the snapshot. Without a compiler or
/// QEMU it says so and goes on, unless under CI.
pub(crate) fn for_tests() -> Result<()> {
    println!("xtask: the boards' programs");
    let boards: Vec<_> = BOARDS.iter().collect();
    let has_qemu = packages::ensure_qemu();
    match find_toolchain(&boards) {
        Ok(toolchain) => {
            build_and_measure(&toolchain, &boards, false)?;
            for board in &boards {
                board.build(&toolchain, Some("qemu"))?;
            }
        }
        Err(error) if !is_ci() => println!("xtask: tests of the boards' programs will be skipped: {error:#}"),
        Err(error) => return Err(error),
    }
    if !has_qemu && is_ci() {
        bail!("CI needs QEMU for the tests of the boards' programs");
    }
    Ok(())
}

fn is_ci() -> bool {
    std::env::var_os("CI").is_some_and(|value| value == "true")
}

/// What `cargo xtask flash` was asked for.
struct Flashing {
    board: &'static Board,
    /// The chip's name for probe-rs.
    chip: &'static str,
    probe: Option<String>,
}

impl Flashing {
    fn parse(arguments: impl Iterator<Item = String>) -> Result<Self> {
        let (mut name, mut probe) = ("stm32f405".to_owned(), None);
        let mut arguments = arguments;
        while let Some(argument) = arguments.next() {
            match argument.as_str() {
                "--board" => name = arguments.next().context("--board needs a board's name")?,
                "--probe" => probe = Some(arguments.next().context("--probe needs a probe's VID:PID")?),
                other => bail!("flash has no option `{other}`; see `cargo xtask help`"),
            }
        }
        let names = BOARDS.map(|board| board.name).join(" and ");
        let board = BOARDS.iter().find(|board| board.name == name);
        let board = board.with_context(|| format!("there is no board `{name}`; there are {names}"))?;
        let chip =
            board.chip.with_context(|| format!("{name} is only emulated, so it can't be written to"))?;
        Ok(Self { board, chip, probe })
    }

    /// probe-rs, as it writes the program, checks it and starts it.
    fn commands(&self, program: &Path) -> [Command; 2] {
        let command = |task: &str| {
            let mut command = Command::new("probe-rs");
            command.args([task, "--chip", self.chip]);
            command.args(self.probe.iter().flat_map(|probe| ["--probe", probe]));
            command
        };
        let mut download = command("download");
        download.arg("--verify").arg(program);
        [download, command("reset")]
    }
}

/// `cargo xtask flash`.
pub(crate) fn flash(arguments: impl Iterator<Item = String>) -> Result<()> {
    let flashing = Flashing::parse(arguments)?;
    if Command::new("probe-rs").arg("--version").output().is_err() {
        bail!(
            "probe-rs writes the program, and it is not there; \
             https://probe.rs/docs/getting-started/installation tells how to get it"
        );
    }
    let board = flashing.board;
    let program = board.build(&find_toolchain(&[board])?, None)?;
    println!("xtask: writing {} to a {}", program.display(), flashing.chip);
    flashing.commands(&program).iter_mut().try_for_each(run)
}

/// Runs a command that has to succeed.
fn run(command: &mut Command) -> Result<()> {
    let status = command.status().with_context(|| format!("{command:?}"))?;
    if !status.success() {
        bail!("{command:?} failed ({status})");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(arguments: &[&str]) -> Result<Flashing> {
        Flashing::parse(arguments.iter().map(|&argument| argument.to_owned()))
    }

    fn words(command: &Command) -> String {
        let words = std::iter::once(command.get_program()).chain(command.get_args());
        words.map(|word| word.to_string_lossy().into_owned()).collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn flash_writes_checks_and_starts_the_program_of_the_board_named() {
        let commands =
            |arguments: &[&str]| parse(arguments).unwrap().commands(Path::new("fw")).each_ref().map(words);
        let expected =
            ["probe-rs download --chip STM32F405RGTx --verify fw", "probe-rs reset --chip STM32F405RGTx"];
        assert_eq!(commands(&[]), expected);
        assert_eq!(commands(&["--board", "stm32f405"]), expected);
        let [download, reset] = commands(&["--probe", "0483:374b"]);
        assert!(download.ends_with("--probe 0483:374b --verify fw"), "{download}");
        assert!(reset.ends_with("--probe 0483:374b"), "{reset}");
    }

    #[test]
    fn flash_refuses_what_it_does_not_know_and_says_what_there_is() {
        let refused = |arguments: &[&str]| parse(arguments).err().map(|error| format!("{error:#}")).unwrap();
        assert_eq!(refused(&["--board", "uno"]), "there is no board `uno`; there are lm3s6965 and stm32f405");
        assert!(refused(&["--board", "lm3s6965"]).contains("only emulated"));
        assert!(refused(&["--board"]).contains("needs a board's name"));
        assert!(refused(&["--probe"]).contains("needs a probe's"));
        assert!(refused(&["now"]).contains("no option `now`"));
    }
}
