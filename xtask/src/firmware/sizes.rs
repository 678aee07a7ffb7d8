//! Sizes of a program, read from its ELF file, and the snapshot that keeps them from growing unnoticed.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail};

use super::elf::{Elf, Section};

/// A program may grow by so many per cent without the snapshot's being renewed.
const GROWTH_PERCENT: u64 = 2;

/// Bytes of a program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Sizes {
    /// Code and constants, in flash.
    pub(crate) text: u64,
    /// Variables with a first value, in flash and RAM.
    pub(crate) data: u64,
    /// Variables that start as zero, in RAM.
    pub(crate) bss: u64,
}

impl Sizes {
    /// Of a program.
    pub(crate) fn of(program: &Elf) -> Self {
        let mut sizes = Self { text: 0, data: 0, bss: 0 };
        for section in program.sections.iter().filter(|section| section.flags & Section::ALLOC != 0) {
            let kind = match section.flags & Section::WRITE != 0 {
                true if section.is_zero() => &mut sizes.bss,
                true => &mut sizes.data,
                false => &mut sizes.text,
            };
            *kind += section.size as u64;
        }
        sizes
    }
}

/// Compares with the snapshot, or renews it.
pub(crate) fn check(snapshot: &Path, release: &str, boards: &[(&str, Sizes)], update: bool) -> Result<()> {
    let text = fs::read_to_string(snapshot).unwrap_or_default();
    let mut table: toml::Table = text.parse().with_context(|| snapshot.display().to_string())?;
    if update {
        table.insert("compiler".into(), release.into());
        for (board, sizes) in boards {
            let mut of_board = toml::Table::new();
            for (name, bytes) in [("text", sizes.text), ("data", sizes.data), ("bss", sizes.bss)] {
                of_board.insert(name.into(), (bytes as i64).into());
            }
            table.insert((*board).into(), of_board.into());
        }
        let head = "# Bytes of the boards' programs; renewed by `cargo xtask firmware --update`.\n";
        fs::write(snapshot, format!("{head}{table}"))?;
        return Ok(());
    }
    let compiler = table.get("compiler").and_then(toml::Value::as_str).unwrap_or("another");
    if compiler != release {
        println!(
            "xtask: sizes were not compared: the snapshot is of compiler {compiler}, these of {release}"
        );
        return Ok(());
    }
    let grown = grown(&table, boards);
    if !grown.is_empty() {
        bail!(
            "{grown}if that is worth it, run `cargo xtask firmware --update` and commit {}",
            snapshot.display()
        );
    }
    Ok(())
}

/// A line for each figure that has grown too much.
fn grown(table: &toml::Table, boards: &[(&str, Sizes)]) -> String {
    let mut lines = String::new();
    for (board, sizes) in boards {
        let was = |name: &str| table.get(*board)?.get(name)?.as_integer().map(|bytes| bytes as u64);
        let ram_was = was("data").zip(was("bss")).map(|(data, bss)| data + bss);
        let figures = [("text", sizes.text, was("text")), ("data + bss", sizes.data + sizes.bss, ram_was)];
        for (name, is, was) in figures {
            match was {
                Some(was) if is * 100 <= was * (100 + GROWTH_PERCENT) => {}
                Some(was) => _ = writeln!(lines, "{board}: {name} grew from {was} to {is} bytes"),
                None => _ = writeln!(lines, "{board}: {name} is not in the snapshot"),
            }
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_of_more_than_two_per_cent_is_told() {
        let table: toml::Table = "[b]\ntext = 1000\ndata = 0\nbss = 100\n".parse().unwrap();
        let of = |text, bss| grown(&table, &[("b", Sizes { text, data: 0, bss })]);
        assert_eq!(of(1020, 102), "");
        assert_eq!(of(900, 10), "");
        assert!(of(1021, 100).contains("text grew from 1000 to 1021"));
        assert!(of(1000, 103).contains("data + bss"));
    }

    #[test]
    fn what_is_no_elf_file_has_no_sizes() {
        assert!(Elf::parse(b"\x7fELF\x02\x01 64 bits".to_vec()).is_none());
        assert!(Elf::parse(Vec::new()).is_none());
    }
}
