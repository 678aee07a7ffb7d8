//! Mosaics in TIFF files: grey values of 16 bits, plain or deflated or in LZW, and of 10 to 14 bits packed.
//!
//! A mosaic's photometric interpretation is 32803 (TIFF/EP, colour filter array) or that of grey. The tiff
//! crate knows the one of grey alone, so a copy of the file is given to it that says so. It does not read
//! packed bits; those are unpacked here.

use std::io::Cursor;

use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::{TiffError, TiffUnsupportedError};

/// Tags by number (TIFF 6.0).
const WIDTH: u16 = 256;
const HEIGHT: u16 = 257;
const BITS: u16 = 258;
const COMPRESSION: u16 = 259;
const PHOTOMETRIC: u16 = 262;
const STRIP_OFFSETS: u16 = 273;
const ORIENTATION: u16 = 274;
const SAMPLES: u16 = 277;
const ROWS_PER_STRIP: u16 = 278;
const STRIP_BYTES: u16 = 279;
const SUB_IMAGES: u16 = 330;
const DNG_VERSION: u16 = 50706;

/// Photometric interpretations: black is zero; colour filter array.
const BLACK_IS_ZERO: u32 = 1;
const FILTER_ARRAY: u32 = 32803;

/// Bytes of pixels that one byte of a compressed file can stand for: deflate reaches 1032 to 1, LZW less.
const MOST_RATIO: usize = 1 << 11;

/// A mosaic.
#[derive(Debug)]
pub(super) struct Mosaic {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Values row by row.
    pub(super) values: Vec<u16>,
}

/// Whether a file says that its rows do not lie as the sensor's.
pub(super) fn is_turned(bytes: &[u8]) -> bool {
    Directory::first(bytes).and_then(|directory| directory.number(ORIENTATION)).is_some_and(|value| value > 1)
}

/// Reads the first image of a file.
///
/// # Errors
/// Half a sentence for a file that is cut short, no TIFF, turned, compressed in a way that is not read, or no
/// mosaic.
pub(super) fn read(bytes: &[u8]) -> Result<Mosaic, String> {
    if bytes.starts_with(b"II+\0") || bytes.starts_with(b"MM\0+") {
        return Err("the frame is a BigTIFF, which is not read; store it as a TIFF".into());
    }
    let broken = || "the frame is truncated or not a TIFF".to_string();
    let directory = Directory::first(bytes).ok_or_else(broken)?;
    if let Some(turned) = directory.number(ORIENTATION).filter(|&value| value > 1) {
        return Err(format!(
            "its Orientation is {turned}, so its rows are not the sensor's as they lie; switch off the \
             rotation of photographs in the camera or its software"
        ));
    }
    let compression = directory.number(COMPRESSION).unwrap_or(1);
    let how = match compression {
        1 => None,
        5 => Some("LZW"),
        8 | 32946 => Some("deflate"),
        other => {
            let name = compression_name(other);
            return Err(format!(
                "its pixels are compressed by {name}, which is not read; store them uncompressed"
            ));
        }
    };
    match (directory.number(BITS).unwrap_or(1), directory.number(SAMPLES).unwrap_or(1)) {
        (16, 1) => whole(bytes, &directory),
        (bits @ (10 | 12 | 14), 1) => match how {
            None => packed(bytes, &directory, bits as usize).ok_or_else(broken),
            Some(how) => Err(format!(
                "its {bits}-bit pixels are compressed by {how}, which is not read together; store them \
                 uncompressed or in 16 bits"
            )),
        },
        // The first image of a raw file is a small view of it.
        _ if [SUB_IMAGES, DNG_VERSION].iter().any(|&tag| directory.entry(tag).is_some()) => {
            Err("a camera's raw file (as DNG or NEF), which is not read; have it converted to a TIFF of the \
             mosaic, 16 bits a value"
                .into())
        }
        (bits, samples) => Err(format!(
            "not a mosaic of 16, 14, 12 or 10 bits: it has {samples} values of {bits} bits a pixel"
        )),
    }
}

fn compression_name(compression: u32) -> String {
    match compression {
        2..=4 => "a fax code".into(),
        6 | 7 => "JPEG".into(),
        32773 => "PackBits".into(),
        34892 => "lossy JPEG".into(),
        50000 => "zstd".into(),
        50002 | 52546 => "JPEG XL".into(),
        other => format!("method {other}"),
    }
}

/// A mosaic of 16 bits.
fn whole(bytes: &[u8], directory: &Directory<'_>) -> Result<Mosaic, String> {
    let damaged = |error: TiffError| match error {
        TiffError::UnsupportedError(TiffUnsupportedError::UnsupportedCompressionMethod(_)) => {
            format!("its pixels are compressed in a way that is not read ({error}); store them uncompressed")
        }
        TiffError::UnsupportedError(error) => {
            format!("the frame is a TIFF of a kind that is not read: {error}")
        }
        // The reader's own words tell of its buffers.
        _ => "the frame is truncated or not a TIFF".into(),
    };
    let mut grey = bytes.to_vec();
    if directory.number(PHOTOMETRIC) == Some(FILTER_ARRAY)
        && let Some((size, _, place)) = directory.entry(PHOTOMETRIC)
    {
        let mut value = BLACK_IS_ZERO.to_le_bytes()[..size].to_vec();
        if directory.big_endian {
            value.reverse();
        }
        grey[place..place + size].copy_from_slice(&value);
    }
    let mut limits = Limits::default();
    limits.decoding_buffer_size = bytes.len().saturating_mul(MOST_RATIO);
    limits.intermediate_buffer_size = limits.decoding_buffer_size;
    limits.ifd_value_size = bytes.len();
    let mut decoder = Decoder::new(Cursor::new(grey)).map_err(damaged)?.with_limits(limits);
    let (width, height) = decoder.dimensions().map_err(damaged)?;
    let DecodingResult::U16(values) = decoder.read_image().map_err(damaged)? else {
        return Err("not a 16-bit frame of whole numbers without a sign".into());
    };
    let (width, height) = (width as usize, height as usize);
    if values.len() != width * height {
        return Err(format!("{} values for {width} × {height} pixels: not a mosaic", values.len()));
    }
    Ok(Mosaic { width, height, values })
}

/// A mosaic of packed values, the highest bit first, each row from a byte of its own on; none where the file
/// is too short for it.
fn packed(bytes: &[u8], directory: &Directory<'_>, bits: usize) -> Option<Mosaic> {
    let [width, height] = [WIDTH, HEIGHT].map(|tag| directory.number(tag));
    let (width, height) = (width? as usize, height? as usize);
    let row_bytes = width.checked_mul(bits)?.div_ceil(8);
    if width == 0 || height == 0 || row_bytes.checked_mul(height)? > bytes.len() {
        return None;
    }
    let rows_per_strip =
        directory.number(ROWS_PER_STRIP).map_or(height, |rows| rows as usize).clamp(1, height);
    let (offsets, counts) = (directory.numbers(STRIP_OFFSETS)?, directory.numbers(STRIP_BYTES)?);
    let mut values = Vec::with_capacity(width * height);
    for (strip, first) in (0..height).step_by(rows_per_strip).enumerate() {
        let rows = rows_per_strip.min(height - first);
        let (offset, count) = (*offsets.get(strip)? as usize, *counts.get(strip)? as usize);
        let content = bytes.get(offset..)?.get(..count)?;
        for row in 0..rows {
            let row = content.get(row * row_bytes..(row + 1) * row_bytes)?;
            values.extend((0..width).map(|x| value(row, x * bits, bits)));
        }
    }
    Some(Mosaic { width, height, values })
}

/// The number of so many bits, 16 at most, that begins at a bit of a row.
fn value(row: &[u8], at: usize, bits: usize) -> u16 {
    let byte = |k: usize| u32::from(row.get(at / 8 + k).copied().unwrap_or_default());
    let three = byte(0) << 16 | byte(1) << 8 | byte(2);
    (three >> (24 - at % 8 - bits) & ((1 << bits) - 1)) as u16
}

/// The first directory of a file.
struct Directory<'a> {
    bytes: &'a [u8],
    big_endian: bool,
    /// Where the entries, of twelve bytes each, begin and end.
    begin: usize,
    end: usize,
}

impl<'a> Directory<'a> {
    fn first(bytes: &'a [u8]) -> Option<Self> {
        let big_endian = match bytes.get(..4)? {
            b"II*\0" => false,
            b"MM\0*" => true,
            _ => return None,
        };
        let mut directory = Self { bytes, big_endian, begin: 0, end: 0 };
        let place = directory.long(4)? as usize;
        let count = directory.short(place)? as usize;
        directory.begin = place.checked_add(2)?;
        directory.end = directory.begin.checked_add(12 * count)?;
        (directory.end <= bytes.len()).then_some(directory)
    }

    fn short(&self, at: usize) -> Option<u32> {
        let two = *self.bytes.get(at..)?.first_chunk::<2>()?;
        Some(u32::from(if self.big_endian { u16::from_be_bytes(two) } else { u16::from_le_bytes(two) }))
    }

    fn long(&self, at: usize) -> Option<u32> {
        let four = *self.bytes.get(at..)?.first_chunk::<4>()?;
        Some(if self.big_endian { u32::from_be_bytes(four) } else { u32::from_le_bytes(four) })
    }

    /// The entry of a tag, where its type is that of a whole number of two or four bytes: that size, how many
    /// there are, and where the first stands.
    fn entry(&self, tag: u16) -> Option<(usize, usize, usize)> {
        let mut entries = (self.begin..self.end).step_by(12);
        let entry = entries.find(|&entry| self.short(entry) == Some(u32::from(tag)))?;
        let size = match self.short(entry + 2)? {
            3 => 2,
            4 => 4,
            _ => return None,
        };
        let count = self.long(entry + 4)? as usize;
        let inside = count.checked_mul(size)? <= 4;
        Some((size, count, if inside { entry + 8 } else { self.long(entry + 8)? as usize }))
    }

    /// A tag's first number.
    fn number(&self, tag: u16) -> Option<u32> {
        let (size, count, place) = self.entry(tag)?;
        let number = if size == 2 { self.short(place) } else { self.long(place) };
        number.filter(|_| count > 0)
    }

    /// All numbers of a tag; none where they reach beyond the file.
    fn numbers(&self, tag: u16) -> Option<Vec<u32>> {
        let (size, count, place) = self.entry(tag)?;
        let end = place.checked_add(count.checked_mul(size)?)?;
        if end > self.bytes.len() {
            return None;
        }
        let number =
            |k: usize| if size == 2 { self.short(place + k * size) } else { self.long(place + k * size) };
        (0..count).map(number).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn case(name: &str) -> Vec<u8> {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/cases/tiff");
        std::fs::read(folder.join(name)).unwrap()
    }

    /// The files of tests/cases/tiff were written by tifffile for Python: 7 × 5 pixels, pixel k of 600 + 97
    /// k, with the photometric interpretation of a colour filter array.
    #[test]
    fn mosaics_of_a_filter_array_are_read_in_either_byte_order_compressed_and_packed() {
        for name in ["cfa.tif", "cfa-big-endian.tif", "cfa-lzw.tif", "cfa-deflate.tif", "cfa-12bit.tif"] {
            let mosaic = read(&case(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
            assert_eq!((mosaic.width, mosaic.height), (7, 5), "{name}");
            assert!(
                mosaic.values.iter().zip(0..).all(|(&value, k)| value == 600 + 97 * k),
                "{name}: {:?}",
                mosaic.values
            );
        }
    }

    #[test]
    fn a_mosaic_that_is_compressed_in_another_way_is_called_compressed() {
        assert!(read(&case("cfa-zstd.tif")).unwrap_err().contains("compressed by zstd, which is not read"));
        let mut packed = case("cfa-12bit.tif");
        let at = |bytes: &[u8]| Directory::first(bytes).unwrap().entry(COMPRESSION).unwrap().2;
        let place = at(&packed);
        packed[place] = 5;
        assert!(read(&packed).unwrap_err().contains("12-bit pixels are compressed by LZW"));
        assert!(read(b"II+\0\x08\0\0\0").unwrap_err().contains("a BigTIFF, which is not read"));
        let mut jpeg = case("cfa.tif");
        let place = at(&jpeg);
        jpeg[place] = 7;
        assert!(read(&jpeg).unwrap_err().contains("compressed by JPEG"));
    }

    #[test]
    fn packed_values_begin_at_their_bit() {
        // 0x123, 0x456 in 12 bits; 0x3fff, 0 and 0x2aaa in 14.
        assert_eq!([0, 12].map(|at| value(&[0x12, 0x34, 0x56], at, 12)), [0x123, 0x456]);
        let row = [0xff, 0xfc, 0x00, 0x0a, 0xaa, 0x80];
        assert_eq!([0, 14, 28].map(|at| value(&row, at, 14)), [0x3fff, 0, 0x2aaa]);
        assert_eq!(value(&[0xff, 0xc0], 0, 10), 0x3ff);
    }

    #[test]
    fn a_packed_mosaic_that_its_file_cannot_hold_is_refused() {
        let mut bytes = case("cfa-12bit.tif");
        let place = Directory::first(&bytes).unwrap().entry(HEIGHT).unwrap().2;
        bytes[place] = 200;
        assert!(read(&bytes).unwrap_err().contains("truncated"));
        let colour = read(&case("cfa.tif")).unwrap();
        assert_eq!(colour.values.len(), 35);
    }
}
