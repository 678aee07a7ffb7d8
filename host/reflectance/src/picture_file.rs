//! PNG and JPEG files that people hand in: turned upright as their EXIF says, within bounds that the file's length sets.

use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader};

use lobelia_base::error::{Error, Result};

/// Bytes of pixels that one byte of a file can stand for: deflate reaches 1032 to 1, runs of empty blocks of a progressive JPEG more.
const MOST_RATIO: u64 = 1 << 12;
/// Bytes of pixels that any file may ask for.
const MOST_OF_SMALL: u64 = 1 << 26;
/// Bytes of pixels at most.
const MOST: u64 = 1 << 33;

/// Decodes a PNG or JPEG, whatever its name ends in, and turns it upright.
///
/// # Errors
/// Input errors for a file that is missing, of another kind, damaged, or larger than its bytes can hold.
pub fn decode(path: &Path) -> Result<DynamicImage> {
    Ok(decode_with_profile(path)?.0)
}

/// As [`decode`], and the ICC colour profile where there is one.
///
/// # Errors
/// As [`decode`].
pub fn decode_with_profile(path: &Path) -> Result<(DynamicImage, Option<Vec<u8>>)> {
    let reading = |error: image::ImageError| Error::reading(path, sentence(&error));
    let length = std::fs::metadata(path).map_err(|error| Error::reading(path, error))?.len();
    let reader = ImageReader::open(path)
        .and_then(ImageReader::with_guessed_format)
        .map_err(|error| Error::reading(path, error))?;
    if !matches!(reader.format(), Some(ImageFormat::Png | ImageFormat::Jpeg)) {
        return Err(Error::reading(path, "it is neither PNG nor JPEG"));
    }
    let mut reader = reader;
    reader.no_limits();
    let mut decoder = reader.into_decoder().map_err(reading)?;
    let (width, height) = decoder.dimensions();
    if decoder.total_bytes() > length.saturating_mul(MOST_RATIO).clamp(MOST_OF_SMALL, MOST) {
        return Err(Error::reading(
            path,
            format!("its {length} bytes cannot hold {width} × {height} pixels; the file is damaged"),
        ));
    }
    let orientation = decoder.orientation().map_err(reading)?;
    let profile = decoder.icc_profile().map_err(reading)?;
    let mut picture = DynamicImage::from_decoder(decoder).map_err(reading)?;
    picture.apply_orientation(orientation);
    Ok((picture, profile))
}

/// An error of the image crate on one line.
fn sentence(error: &image::ImageError) -> String {
    error.to_string().split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Whether the colourants of an ICC profile are those of sRGB (Rec. 709 adapted to D50); none for a profile without colourants, such as
/// one of grey or of tables.
pub fn is_srgb(profile: &[u8]) -> Option<bool> {
    /// X and Y of red, green and blue.
    const SRGB: [[f64; 2]; 3] = [[0.4361, 0.2225], [0.3851, 0.7169], [0.1431, 0.0606]];
    let word =
        |at: usize| Some(u32::from_be_bytes(*profile.get(at..at.checked_add(4)?)?.first_chunk::<4>()?));
    let count = word(128)?.min(256) as usize;
    let tag = |name: &[u8; 4]| {
        let at = (0..count).map(|k| 132 + 12 * k).find(|&at| profile.get(at..at + 4) == Some(name))?;
        let value = word(at + 4)? as usize;
        let number = |k: usize| Some(f64::from(word(value.checked_add(8 + 4 * k)?)? as i32) / 65536.0);
        Some([number(0)?, number(1)?])
    };
    let found = [tag(b"rXYZ")?, tag(b"gXYZ")?, tag(b"bXYZ")?];
    let near = |(a, b): (&[f64; 2], &[f64; 2])| (a[0] - b[0]).abs() < 0.01 && (a[1] - b[1]).abs() < 0.01;
    Some(found.iter().zip(&SRGB).all(near))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jpeg_that_lies_on_its_head_is_turned_upright() {
        // EXIF orientation 3: the sensor's first row is the bottom.
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/cases/ldr/exif3.jpg");
        let upright = decode(&path).unwrap().to_luma8();
        let mut reader = ImageReader::open(&path).unwrap();
        reader.set_format(ImageFormat::Jpeg);
        let stored = reader.decode().unwrap().to_luma8();
        let (width, height) = stored.dimensions();
        assert_eq!(upright.dimensions(), (width, height));
        assert_ne!(upright, stored);
        for (x, y, pixel) in stored.enumerate_pixels() {
            assert_eq!(pixel, upright.get_pixel(width - 1 - x, height - 1 - y));
        }
    }

    #[test]
    fn a_header_that_promises_more_than_the_file_holds_is_refused_before_memory_is_asked_for() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("huge.png");
        // Size, 8 bits, RGBA; then no pixels.
        let size = [60_000u32.to_be_bytes(), 60_000u32.to_be_bytes()].concat();
        let header = [size, vec![8, 6, 0, 0, 0]].concat();
        let mut bytes = b"\x89PNG\r\n\x1a\n".to_vec();
        for (name, content) in [(b"IHDR", header), (b"IDAT", vec![0x78, 0x9c]), (b"IEND", vec![])] {
            let mut check = flate2::Crc::new();
            check.update(name);
            check.update(&content);
            bytes.extend((content.len() as u32).to_be_bytes());
            bytes.extend(name.iter().chain(&content));
            bytes.extend(check.sum().to_be_bytes());
        }
        std::fs::write(&path, bytes).unwrap();
        let error = decode(&path).unwrap_err();
        let text = error.to_string();
        assert!(error.exit_code() == 2 && text.contains("cannot hold 60000 × 60000 pixels"), "{text}");
    }

    #[test]
    fn profiles_are_told_apart_by_their_colourants() {
        let profile = |red: [f64; 2]| {
            let mut bytes = vec![0; 128];
            bytes.extend(3u32.to_be_bytes());
            let colourants = [(b"rXYZ", red), (b"gXYZ", [0.3851, 0.7169]), (b"bXYZ", [0.1431, 0.0606])];
            for (k, (name, _)) in colourants.iter().enumerate() {
                bytes.extend(*name);
                bytes.extend((168 + 20 * k as u32).to_be_bytes());
                bytes.extend(20u32.to_be_bytes());
            }
            for (_, xy) in colourants {
                bytes.extend([0; 8]);
                xy.into_iter().for_each(|x| bytes.extend(((x * 65536.0) as i32).to_be_bytes()));
                bytes.extend([0; 4]);
            }
            bytes
        };
        assert_eq!(is_srgb(&profile([0.4361, 0.2225])), Some(true));
        // Adobe RGB (1998).
        assert_eq!(is_srgb(&profile([0.6097, 0.3111])), Some(false));
        assert_eq!(is_srgb(b"short"), None);
    }
}
