//! Files of bicubic patches, `.bpt`. Numbers stand between blanks or commas, `#` begins a comment. First is
//! the number of patches; then either, as in Newell's list, sixteen indices a patch, the number of points and
//! the points (the least index, 0 or 1, tells from where they count); or a patch after the other, its degrees
//! `3 3` and sixteen points.

use std::path::Path;

use glam::DVec3;

use super::Patches;
use lobelia_base::error::{Error, Result};
use lobelia_base::files;

/// Words that may stand before the two numbers.
const WORDS: [&str; 3] = ["patches", "points", "vertices"];

/// Lines of numbers, each with its line in the file.
struct Numbers {
    numbers: Vec<(usize, f64)>,
    next: usize,
}

impl Numbers {
    /// All numbers of a text, and how many the second line of them has.
    fn new(text: &str) -> Result<(Self, usize)> {
        let mut numbers = Vec::new();
        let mut counts = Vec::new();
        for (line, content) in (1..).zip(text.trim_start_matches('\u{feff}').lines()) {
            let content = content.split('#').next().unwrap_or_default();
            let before = numbers.len();
            for word in content.split([' ', '\t', ',', '\r']).filter(|word| !word.is_empty()) {
                if WORDS.contains(&word) {
                    continue;
                }
                let number: f64 = word
                    .parse()
                    .map_err(|_| Error::input(format!("line {line}: \"{word}\" is not a number")))?;
                numbers.push((line, number));
            }
            if numbers.len() > before {
                counts.push(numbers.len() - before);
            }
        }
        Ok((Self { numbers, next: 0 }, counts.get(1).copied().unwrap_or_default()))
    }

    fn number(&mut self, what: &str) -> Result<f64> {
        let found = self.numbers.get(self.next);
        let (_, number) = *found.ok_or_else(|| Error::input(format!("the file ends before {what}")))?;
        self.next += 1;
        Ok(number)
    }

    /// A whole number.
    fn whole(&mut self, what: &str) -> Result<u32> {
        let number = self.number(what)?;
        if number.fract() != 0.0 || !(0.0..=f64::from(u32::MAX)).contains(&number) {
            let line = self.numbers[self.next - 1].0;
            return Err(Error::input(format!("line {line}: {what} is {number}, which is no whole number")));
        }
        Ok(number as u32)
    }

    fn point(&mut self, what: &str) -> Result<DVec3> {
        Ok(DVec3::new(self.number(what)?, self.number(what)?, self.number(what)?))
    }

    /// Refuses a count of things of so many numbers each that the file cannot hold.
    fn count(&mut self, what: &str, each: usize) -> Result<usize> {
        let count = self.whole(&format!("the number of {what}"))? as usize;
        let left = (self.numbers.len() - self.next) / each;
        if count > left {
            return Err(Error::input(format!("there must be {count} {what}, but numbers for {left} follow")));
        }
        Ok(count)
    }
}

impl Patches {
    /// Reads a file of patches.
    ///
    /// # Errors
    /// Input errors that name the file, and the line where one number is wrong.
    pub fn read(path: &Path) -> Result<Self> {
        Self::parse(&files::read_text(path)?).map_err(|error| error.at(path.display()))
    }

    /// Parses the text of such a file.
    ///
    /// # Errors
    /// Input errors that name the line where one number is wrong.
    pub fn parse(text: &str) -> Result<Self> {
        let (mut numbers, second) = Numbers::new(text)?;
        let (points, patches) = if second == 2 { one_by_one(&mut numbers)? } else { indexed(&mut numbers)? };
        if let Some((line, number)) = numbers.numbers.get(numbers.next) {
            return Err(Error::input(format!("line {line}: {number} follows after the last point")));
        }
        Self::new(&points, &patches)
    }
}

/// Newell's list.
fn indexed(numbers: &mut Numbers) -> Result<(Vec<DVec3>, Vec<[u32; 16]>)> {
    let count = numbers.count("patches", 16)?;
    let mut patches = vec![[0; 16]; count];
    for index in patches.iter_mut().flatten() {
        *index = numbers.whole("an index")?;
    }
    let count = numbers.count("points", 3)?;
    let points = (0..count).map(|_| numbers.point("a point")).collect::<Result<_>>()?;
    if patches.iter().flatten().min() == Some(&1) {
        patches.iter_mut().flatten().for_each(|index| *index -= 1);
    }
    Ok((points, patches))
}

/// Patches with their own points.
fn one_by_one(numbers: &mut Numbers) -> Result<(Vec<DVec3>, Vec<[u32; 16]>)> {
    let count = numbers.count("patches", 50)?;
    let mut points = Vec::with_capacity(16 * count);
    for patch in 0..count {
        let degrees = [numbers.whole("a degree")?, numbers.whole("a degree")?];
        if degrees != [3, 3] {
            let [u, v] = degrees;
            return Err(Error::input(format!(
                "patch {patch} has the degrees {u} and {v}; only 3 and 3 are read"
            )));
        }
        for _ in 0..16 {
            points.push(numbers.point("a point")?);
        }
    }
    let indices = |patch: usize| std::array::from_fn(|k| (16 * patch + k) as u32);
    Ok((points, (0..count).map(indices).collect()))
}
