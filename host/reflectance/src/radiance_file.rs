//! Radiance pictures (`.hdr`, `.pic`): shared-exponent pixels after a header of text (Ward 1991, and
//! `picture` of Radiance's manual).
//!
//! `EXPOSURE` and `COLORCORR` say by what the pixels were multiplied; they are divided out. `PRIMARIES` are
//! converted to Rec. 709.

use std::path::Path;

use glam::Vec3;

use crate::Rgb;
use crate::colour::Primaries;
use lobelia_base::error::{Error, Result};

/// Pixels that one byte of a file can stand for: 4 bytes repeat a pixel 255 times.
const MOST_RATIO: usize = 64;

/// A picture's size and its pixels, row by row from the top.
pub struct Radiance {
    /// Pixels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row by row from the top.
    pub pixels: Vec<Rgb>,
}

/// Whether a file begins as a Radiance picture.
pub fn is_radiance(bytes: &[u8]) -> bool {
    bytes.starts_with(b"#?")
}

/// Reads a picture.
///
/// # Errors
/// Input errors for a file that is missing or no Radiance picture, and for pixels in CIE XYZ.
pub fn read(path: &Path) -> Result<Radiance> {
    let bytes = std::fs::read(path).map_err(|error| Error::reading(path, error))?;
    parse(&bytes).map_err(|message| Error::reading(path, message))
}

/// Parses a whole file.
fn parse(bytes: &[u8]) -> std::result::Result<Radiance, String> {
    if !is_radiance(bytes) {
        return Err("it is no Radiance picture, which begins with #?RADIANCE or #?RGBE".into());
    }
    let mut rest = bytes;
    let factor = header(&mut rest)?;
    let order = Order::parse(&line(&mut rest).ok_or("it ends in its header")?)?;
    let most = bytes.len().saturating_mul(MOST_RATIO);
    let [scanlines, length] = order.counts;
    if scanlines.checked_mul(length).is_none_or(|count| count > most) {
        return Err(format!(
            "its {} bytes cannot hold {} × {} pixels; the file is damaged or cut short",
            bytes.len(),
            order.width(),
            order.height()
        ));
    }
    let (width, height) = (order.width(), order.height());
    let mut pixels = vec![Rgb::ZERO; width * height];
    let mut scanline = vec![[0u8; 4]; length];
    for k in 0..scanlines {
        read_scanline(&mut rest, &mut scanline)
            .ok_or_else(|| format!("it is cut short or damaged in scanline {k} of {scanlines}"))?;
        for (j, &pixel) in scanline.iter().enumerate() {
            pixels[order.index(k, j)] = factor * decode(pixel);
        }
    }
    Ok(Radiance { width, height, pixels })
}

/// The next line without its end; the rest begins behind it.
fn line(rest: &mut &[u8]) -> Option<String> {
    let end = rest.iter().position(|&byte| byte == b'\n')?;
    let line = String::from_utf8_lossy(&rest[..end]).trim_end_matches('\r').to_string();
    *rest = &rest[end + 1..];
    Some(line)
}

/// Reads the header up to its empty line: the matrix from stored values to linear Rec. 709 radiance.
fn header(rest: &mut &[u8]) -> std::result::Result<glam::Mat3, String> {
    let mut divisor = Vec3::ONE;
    let mut matrix = glam::Mat3::IDENTITY;
    loop {
        let line = line(rest).ok_or("it ends in its header")?;
        if line.trim().is_empty() {
            return Ok(matrix * glam::Mat3::from_diagonal(divisor.recip()));
        }
        let Some((key, value)) = line.split_once('=') else { continue };
        let numbers: Vec<f32> = value.split_whitespace().map_while(|number| number.parse().ok()).collect();
        let positive = numbers.iter().all(|number| number.is_finite() && *number > 0.0);
        match (key.trim(), &numbers[..]) {
            ("FORMAT", _) if value.trim() != "32-bit_rle_rgbe" => {
                return Err(format!(
                    "its pixels are {}; convert them to 32-bit_rle_rgbe (ra_xyze -r)",
                    value.trim()
                ));
            }
            // Each program that scales the pixels adds a line.
            ("EXPOSURE", &[exposure]) if positive => divisor *= exposure,
            ("COLORCORR", &[r, g, b]) if positive => divisor *= Vec3::new(r, g, b),
            ("EXPOSURE" | "COLORCORR", _) => {
                return Err(format!("its header's line `{}` has no positive numbers", line.trim()));
            }
            ("PRIMARIES", &[a, b, c, d, e, f, g, h]) => {
                let xy = |x: f32, y: f32| [f64::from(x), f64::from(y)];
                let primaries = Primaries { red: xy(a, b), green: xy(c, d), blue: xy(e, f), white: xy(g, h) };
                let known = primaries.to_rec709();
                matrix = known.ok_or("its PRIMARIES span no colour space")?;
            }
            _ => {}
        }
    }
}

/// The order of the pixels, from a line such as `-Y 512 +X 1024`.
struct Order {
    /// Scanlines, and pixels in each.
    counts: [usize; 2],
    /// Whether scanlines are rows.
    rows: bool,
    /// Whether scanlines, and pixels in them, go down or to the right.
    forward: [bool; 2],
}

impl Order {
    fn parse(line: &str) -> std::result::Result<Self, String> {
        let wrong = || format!("its size `{}` is not like -Y 512 +X 1024", line.trim());
        let words: Vec<&str> = line.split_whitespace().collect();
        let &[first, scanlines, second, length] = &words[..] else { return Err(wrong()) };
        let count = |word: &str| word.parse::<usize>().ok().filter(|&count| count > 0).ok_or_else(wrong);
        let counts = [count(scanlines)?, count(length)?];
        let axis = |word: &str| match word {
            "-Y" => Some((true, true)),
            "+Y" => Some((true, false)),
            "+X" => Some((false, true)),
            "-X" => Some((false, false)),
            _ => None,
        };
        match (axis(first), axis(second)) {
            (Some((rows, down)), Some((other, right))) if rows != other => {
                Ok(Self { counts, rows, forward: [down, right] })
            }
            _ => Err(wrong()),
        }
    }

    fn width(&self) -> usize {
        self.counts[usize::from(self.rows)]
    }

    fn height(&self) -> usize {
        self.counts[usize::from(!self.rows)]
    }

    /// Index, row by row from the top, of pixel `j` of scanline `k`.
    fn index(&self, k: usize, j: usize) -> usize {
        let [k, j] = [0, 1].map(|axis| {
            let place = [k, j][axis];
            if self.forward[axis] { place } else { self.counts[axis] - 1 - place }
        });
        let (row, column) = if self.rows { (k, j) } else { (j, k) };
        row * self.width() + column
    }
}

/// Reads one scanline in any of the three encodings; none where the file ends or a run is longer than the
/// line.
fn read_scanline(rest: &mut &[u8], scanline: &mut [[u8; 4]]) -> Option<()> {
    let length = scanline.len();
    let begin = rest.first_chunk::<4>()?;
    let separate = begin[..2] == [2, 2] && usize::from(u16::from_be_bytes([begin[2], begin[3]])) == length;
    if (8..0x8000).contains(&length) && separate {
        *rest = &rest[4..];
        return (0..4).try_for_each(|component| read_component(rest, scanline, component));
    }
    let mut place = 0;
    let mut shift = 0;
    while place < length {
        let &pixel = rest.first_chunk::<4>()?;
        *rest = &rest[4..];
        if pixel[..3] != [1, 1, 1] {
            scanline[place] = pixel;
            (place, shift) = (place + 1, 0);
            continue;
        }
        let count = usize::from(pixel[3]).checked_shl(shift)?;
        let previous = *scanline.get(place.checked_sub(1)?)?;
        scanline.get_mut(place..place.checked_add(count)?)?.fill(previous);
        (place, shift) = (place + count, (shift + 8).min(24));
    }
    Some(())
}

/// Reads the runs of one component of a scanline.
fn read_component(rest: &mut &[u8], scanline: &mut [[u8; 4]], component: usize) -> Option<()> {
    let mut place = 0;
    while place < scanline.len() {
        let (&code, after) = rest.split_first()?;
        let (run, count) =
            if code > 128 { (true, usize::from(code) - 128) } else { (false, usize::from(code)) };
        let taken = if run { 1 } else { count };
        if count == 0 || after.len() < taken {
            return None;
        }
        let target = scanline.get_mut(place..place + count)?;
        for (k, pixel) in target.iter_mut().enumerate() {
            pixel[component] = after[if run { 0 } else { k }];
        }
        *rest = &after[taken..];
        place += count;
    }
    Some(())
}

/// A pixel with a shared exponent.
fn decode([r, g, b, e]: [u8; 4]) -> Rgb {
    if e == 0 {
        return Rgb::ZERO;
    }
    let scale = 2f64.powi(i32::from(e) - 136);
    Rgb::from_array([r, g, b].map(|mantissa| (f64::from(mantissa) * scale) as f32))
}

#[cfg(test)]
mod tests;
