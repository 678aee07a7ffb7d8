//! Damaged files: a reader is given mutations of sound ones and must read each or refuse it in one sentence,
//! within memory that the file's length bounds.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::{Duration, Instant};

use lobelia::{Error, Result};

use crate::small::Random;

/// Bytes that no reader of a file of some kilobytes may ask for.
pub const MOST_MEMORY: usize = 1 << 30;

/// Numbers at which readers break: sizes, signs, and what is no number.
const WORDS: [&str; 18] = [
    "0",
    "-1",
    "1",
    "2",
    "255",
    "65535",
    "65536",
    "2147483647",
    "4294967295",
    "4294967296",
    "-9223372036854775808",
    "18446744073709551615",
    "1e308",
    "-1e-308",
    "nan",
    "inf",
    "\"\"",
    "null",
];

/// How long mutations are made.
#[derive(Debug, Clone, Copy)]
pub enum Extent {
    /// This many.
    Count(u64),
    /// As many as fit in a time.
    Time(Duration),
}

/// A mutation of `file`, one to four changes; now and then a part of it comes from `other`.
pub fn mutated(random: &mut Random, file: &[u8], other: &[u8]) -> Vec<u8> {
    let mut bytes = file.to_vec();
    for _ in 0..=random.below(4) {
        change(random, &mut bytes, other);
    }
    bytes
}

fn change(random: &mut Random, bytes: &mut Vec<u8>, other: &[u8]) {
    let length = bytes.len() as u64;
    if length == 0 {
        return bytes.extend_from_slice(other);
    }
    let at = random.below(length) as usize;
    let some = (1 + random.below(32)) as usize;
    let end = (at + some).min(bytes.len());
    match random.below(10) {
        0 => bytes[at] ^= 1 << random.below(8),
        1 => bytes[at] = [0, 1, 0x7f, 0x80, 0xff, random.below(256) as u8][random.below(6) as usize],
        2 => bytes.truncate(at),
        3 => drop(bytes.drain(at..end)),
        4 => {
            let part = bytes[at..end].to_vec();
            bytes.splice(at..at, part);
        }
        5 => {
            let values = [0, 1, u64::MAX, 1 << 31, (1 << 31) - 1, 1 << 16, random.below(u64::MAX)];
            let value = values[random.below(7) as usize];
            let count = [2, 4, 8][random.below(3) as usize];
            let word = if random.below(2) == 0 {
                value.to_le_bytes()
            } else {
                (value << (64 - 8 * count)).to_be_bytes()
            };
            bytes.iter_mut().skip(at).zip(&word[..count]).for_each(|(byte, new)| *byte = *new);
        }
        6 if !other.is_empty() => {
            let from = random.below(other.len() as u64) as usize;
            let part = &other[from..(from + 4 * some).min(other.len())];
            bytes.splice(at..end, part.iter().copied());
        }
        7 => {
            // A line again, or without it.
            let begin = bytes[..at].iter().rposition(|&byte| byte == b'\n').map_or(0, |newline| newline + 1);
            let stop = bytes[at..]
                .iter()
                .position(|&byte| byte == b'\n')
                .map_or(bytes.len(), |newline| at + newline + 1);
            let line = bytes[begin..stop].to_vec();
            let kept = if random.below(2) == 0 { line.repeat(2) } else { Vec::new() };
            bytes.splice(begin..stop, kept);
        }
        _ => {
            // The number or word that stands here becomes another.
            let part_of = |byte: &u8| byte.is_ascii_alphanumeric() || b".+-_".contains(byte);
            let begin = bytes[..at].iter().rposition(|byte| !part_of(byte)).map_or(0, |place| place + 1);
            let stop =
                bytes[at..].iter().position(|byte| !part_of(byte)).map_or(bytes.len(), |count| at + count);
            if begin <= stop && stop - begin < 64 {
                let word = WORDS[random.below(WORDS.len() as u64) as usize];
                bytes.splice(begin..stop, word.bytes());
            }
        }
    }
}

/// A file or folder of a reader's corpus.
pub struct Sound {
    /// The name of the file that is mutated, relative to the folder of a case; its ending tells its kind.
    pub name: String,
    /// Its bytes.
    pub bytes: Vec<u8>,
}

impl Sound {
    /// A file of this name.
    pub fn new(name: &str, bytes: impl Into<Vec<u8>>) -> Self {
        Self { name: name.into(), bytes: bytes.into() }
    }

    /// Every file of `folder` whose name ends in one of these; none where the folder is missing.
    pub fn of_folder(folder: &Path, endings: &[&str]) -> Vec<Self> {
        if !folder.is_dir() {
            return Vec::new();
        }
        let paths = crate::folder::listing(folder).into_iter().map(|path| folder.join(path));
        let wanted = paths.filter(|path| {
            let name = path.to_string_lossy().to_lowercase();
            path.is_file() && endings.iter().any(|ending| name.ends_with(ending))
        });
        let read = |path: std::path::PathBuf| {
            let name = path.file_name().expect("a file has a name").to_string_lossy().into_owned();
            Self { name, bytes: std::fs::read(&path).expect("a listed file can be read") }
        };
        wanted.map(read).collect()
    }
}

/// Gives mutations of the corpus to `read`, each written to its name in `folder`; `named` is what the error
/// must name, the file itself if it is empty. Panics with the seed and the file left in place where a reader
/// does not keep its promise.
pub fn survives(
    folder: &Path,
    corpus: &[Sound],
    named: &str,
    extent: Extent,
    allocated: impl Fn() -> usize,
    read: impl Fn(&Path) -> Result<()>,
) {
    assert!(!corpus.is_empty(), "there is nothing to mutate");
    let start = Instant::now();
    let mut seed = 0;
    let mut refused = 0;
    let goes_on = |seed: u64| match extent {
        Extent::Count(count) => seed < count,
        Extent::Time(time) => start.elapsed() < time,
    };
    while goes_on(seed) {
        let mut random = Random(seed);
        let pick = |random: &mut Random| &corpus[random.below(corpus.len() as u64) as usize];
        let (sound, other) = (pick(&mut random), pick(&mut random));
        let path = folder.join(&sound.name);
        std::fs::write(&path, mutated(&mut random, &sound.bytes, &other.bytes))
            .expect("a case can be written");
        let case = || format!("mutation {seed} of {}", sound.name);
        let outcome = catch_unwind(AssertUnwindSafe(|| read(&path)));
        let outcome = outcome.unwrap_or_else(|_| panic!("{}: the reader panicked", case()));
        if let Err(error) = outcome {
            refused += 1;
            let name = if named.is_empty() { &sound.name } else { named };
            check(&error, name).unwrap_or_else(|wrong| panic!("{}: {wrong}: {error}", case()));
        }
        let peak = allocated();
        assert!(peak < MOST_MEMORY, "{} or one beside it: {peak} bytes of memory were asked for", case());
        std::fs::write(&path, &sound.bytes).expect("a case can be written");
        seed += 1;
    }
    // Mutations that break nothing would test nothing.
    assert!(5 * refused > seed, "only {refused} of {seed} mutations were refused");
}

/// What is wrong with how a reader refuses a file.
fn check(error: &Error, name: &str) -> std::result::Result<(), &'static str> {
    let text = error.to_string();
    if error.exit_code() != 2 {
        return Err("it is the input's fault, and the exit code is not 2");
    }
    if text.contains(char::is_control) {
        return Err("the sentence has control characters or several lines");
    }
    if text.len() > 2000 {
        return Err("the sentence is longer than anyone reads");
    }
    if !text.contains(name) {
        return Err("the sentence does not name the file");
    }
    Ok(())
}
