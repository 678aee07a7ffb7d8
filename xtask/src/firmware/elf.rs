//! As much of a 32-bit little-endian ELF file as sizes and stacks need.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};

/// A section's header and where its bytes are.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Section {
    kind: u32,
    pub(crate) flags: u32,
    address: u32,
    offset: usize,
    pub(crate) size: usize,
    link: usize,
}

impl Section {
    pub(crate) const WRITE: u32 = 1;
    pub(crate) const ALLOC: u32 = 2;
    const SYMBOLS: u32 = 2;
    const NO_BITS: u32 = 8;

    /// Whether it has no bytes in the file: it starts as zeros.
    pub(crate) fn is_zero(&self) -> bool {
        self.kind == Self::NO_BITS
    }
}

/// A symbol.
#[derive(Debug, Clone)]
pub(crate) struct Symbol {
    pub(crate) name: String,
    pub(crate) value: u32,
    pub(crate) is_function: bool,
}

/// A file, read.
#[derive(Debug)]
pub(crate) struct Elf {
    bytes: Vec<u8>,
    pub(crate) sections: Vec<Section>,
}

impl Elf {
    /// Reads a file.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let bytes = fs::read(path).with_context(|| path.display().to_string())?;
        Self::parse(bytes).with_context(|| format!("{} is no 32-bit ELF file", path.display()))
    }

    pub(crate) fn parse(bytes: Vec<u8>) -> Option<Self> {
        let mut elf = Self { bytes, sections: Vec::new() };
        if elf.bytes.get(..6)? != b"\x7fELF\x01\x01" {
            return None;
        }
        let start = elf.word(32)? as usize;
        let (size, count) = (usize::from(elf.half(46)?), usize::from(elf.half(48)?));
        for header in (0..count).map(|section| start + section * size) {
            let field = |index: usize| elf.word(header + 4 * index);
            elf.sections.push(Section {
                kind: field(1)?,
                flags: field(2)?,
                address: field(3)?,
                offset: field(4)? as usize,
                size: field(5)? as usize,
                link: field(6)? as usize,
            });
        }
        Some(elf)
    }

    fn half(&self, at: usize) -> Option<u16> {
        Some(u16::from_le_bytes(self.bytes.get(at..at + 2)?.try_into().ok()?))
    }

    fn word(&self, at: usize) -> Option<u32> {
        Some(u32::from_le_bytes(self.bytes.get(at..at + 4)?.try_into().ok()?))
    }

    /// Where an address of flash is in the file.
    fn place(&self, address: u32) -> Option<usize> {
        let inside = |section: &&Section| {
            section.flags & Section::ALLOC != 0
                && !section.is_zero()
                && (section.address..section.address + section.size as u32).contains(&address)
        };
        let section = self.sections.iter().find(inside)?;
        Some(section.offset + (address - section.address) as usize)
    }

    /// Half a word of the program's memory.
    pub(crate) fn half_at(&self, address: u32) -> Option<u16> {
        self.half(self.place(address)?)
    }

    /// A word of the program's memory.
    pub(crate) fn word_at(&self, address: u32) -> Option<u32> {
        self.word(self.place(address)?)
    }

    /// All symbols.
    pub(crate) fn symbols(&self) -> Vec<Symbol> {
        const FUNCTION: u8 = 2;
        let Some(table) = self.sections.iter().find(|section| section.kind == Section::SYMBOLS) else {
            return Vec::new();
        };
        let Some(names) = self.sections.get(table.link) else { return Vec::new() };
        let symbol = |at: usize| {
            let name = self.bytes.get(names.offset + self.word(at)? as usize..)?;
            let name = String::from_utf8_lossy(name.split(|&byte| byte == 0).next()?).into_owned();
            let is_function = self.bytes.get(at + 12)? & 0xF == FUNCTION;
            Some(Symbol { name, value: self.word(at + 4)?, is_function })
        };
        (table.offset..table.offset + table.size).step_by(16).filter_map(symbol).collect()
    }
}
