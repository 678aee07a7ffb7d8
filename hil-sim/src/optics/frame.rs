//! Camera files: 16-bit TIFF mosaics with the EXIF tags that a camera writes.

use std::io::{Seek, Write};

use tiff::encoder::{Rational, TiffEncoder, colortype::Gray16};
use tiff::tags::Tag;

/// What the camera notes beside the pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameNotes {
    /// Time that the shutter was open, s.
    pub exposure_s: f64,
    /// Relative aperture.
    pub f_number: f64,
    /// Rig time of the exposure, s since power-up; written as a date from 2000-01-01.
    pub taken_s: u64,
}

/// EXIF tags by number (JEITA CP-3451).
const EXPOSURE_TIME: u16 = 0x829a;
const F_NUMBER: u16 = 0x829d;
const ISO: u16 = 0x8827;
const DATE_TIME_ORIGINAL: u16 = 0x9003;
const CFA_REPEAT_DIMENSIONS: u16 = 0x828d;
const CFA_PATTERN: u16 = 0x828e;

/// Writes one mosaic of `width` × `height` values.
///
/// # Errors
/// When the writer refuses.
pub fn write_tiff<W: Write + Seek>(
    writer: W,
    width: usize,
    height: usize,
    values: &[u16],
    notes: &FrameNotes,
) -> std::io::Result<()> {
    let other = |error: tiff::TiffError| match error {
        tiff::TiffError::IoError(error) => error,
        error => std::io::Error::other(error),
    };
    let mut encoder = TiffEncoder::new(writer).map_err(other)?;
    let mut exif = encoder.extra_directory().map_err(other)?;
    // Microseconds: what the controller counts in.
    let exposure = Rational { n: (notes.exposure_s * 1e6).round() as u32, d: 1_000_000 };
    let aperture = Rational { n: (notes.f_number * 10.0).round() as u32, d: 10 };
    exif.write_tag(Tag::Unknown(EXPOSURE_TIME), exposure).map_err(other)?;
    exif.write_tag(Tag::Unknown(F_NUMBER), aperture).map_err(other)?;
    exif.write_tag(Tag::Unknown(ISO), 100u16).map_err(other)?;
    exif.write_tag(Tag::Unknown(DATE_TIME_ORIGINAL), date(notes.taken_s).as_str()).map_err(other)?;
    let exif = exif.finish_with_offsets().map_err(other)?;

    let mut image = encoder.new_image::<Gray16>(width as u32, height as u32).map_err(other)?;
    let directory = image.encoder();
    directory.write_tag(Tag::Make, "Lobelia").map_err(other)?;
    directory.write_tag(Tag::Model, "Simulated RGGB camera").map_err(other)?;
    directory.write_tag(Tag::Unknown(CFA_REPEAT_DIMENSIONS), &[2u16, 2][..]).map_err(other)?;
    directory.write_tag(Tag::Unknown(CFA_PATTERN), &[0u8, 1, 1, 2][..]).map_err(other)?;
    directory.write_tag(Tag::ExifDirectory, exif.offset).map_err(other)?;
    image.write_data(values).map_err(other)
}

/// EXIF's date of a number of seconds after 2000-01-01 00:00:00, within January.
fn date(seconds: u64) -> String {
    let (minutes, s) = (seconds / 60, seconds % 60);
    let (hours, m) = (minutes / 60, minutes % 60);
    format!("2000:01:{:02} {:02}:{m:02}:{s:02}", 1 + (hours / 24).min(30), hours % 24)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_follow_the_exif_form() {
        assert_eq!(date(90_061), "2000:01:02 01:01:01");
    }
}
