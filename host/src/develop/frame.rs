//! Reads camera frames: 16-bit TIFF mosaics with EXIF exposure. JPEG is refused: it is not linear.

use std::io::Cursor;
use std::path::Path;

use tiff::decoder::{Decoder, DecodingResult};

use crate::error::{Error, Result};

/// The first bytes of every JPEG.
pub const JPEG_START: [u8; 3] = [0xff, 0xd8, 0xff];

/// One photograph as the sensor recorded it.
#[derive(Debug, Clone, PartialEq)]
pub struct RawFrame {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Values row by row, in the camera's RGGB mosaic.
    pub values: Vec<u16>,
    /// Exposure time of the EXIF block, s.
    pub exposure_s: f64,
}

/// Reads a frame and its exposure.
///
/// # Errors
/// Input errors for a missing, truncated or non-linear file, or one without an exposure time.
pub fn read(path: &Path) -> Result<RawFrame> {
    decode(&std::fs::read(path).map_err(|error| Error::reading(path, error))?, path)
}

/// The frame that the bytes of a file are; `path` is for errors.
///
/// # Errors
/// As [`read`].
pub fn decode(bytes: &[u8], path: &Path) -> Result<RawFrame> {
    if bytes.starts_with(&JPEG_START) {
        let message = "a JPEG, which is not linear; give the camera's 16-bit TIFF";
        return Err(Error::input(format!("{}: {message}", path.display())));
    }
    let damaged = |error: tiff::TiffError| {
        Error::input(format!("{}: the frame is truncated or not a TIFF: {error}", path.display()))
    };
    let mut decoder = Decoder::new(Cursor::new(bytes)).map_err(damaged)?;
    let (width, height) = decoder.dimensions().map_err(damaged)?;
    let orientation = decoder.find_tag(tiff::tags::Tag::Orientation).map_err(damaged)?;
    if let Some(turned) = orientation.and_then(|value| value.into_u32().ok()).filter(|&value| value > 1) {
        let message = format!(
            "its Orientation is {turned}, so its rows are not the sensor's as they lie; switch off the rotation of \
             photographs in the camera or its software"
        );
        return Err(Error::input(format!("{}: {message}", path.display())));
    }
    let DecodingResult::U16(values) = decoder.read_image().map_err(damaged)? else {
        return Err(Error::input(format!("{}: not a 16-bit frame", path.display())));
    };
    let (width, height) = (width as usize, height as usize);
    if values.len() != width * height {
        let message = format!("{} values for {width} × {height} pixels: not a mosaic", values.len());
        return Err(Error::input(format!("{}: {message}", path.display())));
    }
    Ok(RawFrame { width, height, values, exposure_s: exposure(bytes, path)? })
}

/// The EXIF exposure time of a file, s.
fn exposure(bytes: &[u8], path: &Path) -> Result<f64> {
    let metadata = exif::Reader::new()
        .read_from_container(&mut Cursor::new(bytes))
        .map_err(|error| Error::input(format!("{}: no readable EXIF block: {error}", path.display())))?;
    let field = metadata.get_field(exif::Tag::ExposureTime, exif::In::PRIMARY);
    match field.map(|field| &field.value) {
        Some(exif::Value::Rational(times)) if times.first().is_some_and(|t| t.denom > 0 && t.num > 0) => {
            Ok(times[0].to_f64())
        }
        _ => Err(Error::input(format!("{}: the EXIF block has no exposure time", path.display()))),
    }
}

#[cfg(all(test, feature = "sim"))]
#[allow(clippy::unwrap_used, reason = "clippy does not see that this is a test module")]
mod tests {
    use std::fs::File;

    use super::*;
    use lobelia_hil_sim::optics::frame::{FrameNotes, write_tiff};

    fn written(folder: &Path) -> std::path::PathBuf {
        let path = folder.join("frame.tiff");
        let values: Vec<u16> = (0..96).collect();
        let notes = FrameNotes { exposure_s: 0.0125, f_number: 16.0, taken_s: 5 };
        write_tiff(File::create(&path).unwrap(), 12, 8, &values, &notes).unwrap();
        path
    }

    #[test]
    fn a_cameras_file_gives_its_pixels_and_its_exposure() {
        let folder = tempfile::tempdir().unwrap();
        let frame = read(&written(folder.path())).unwrap();
        assert_eq!((frame.width, frame.height, frame.values[95]), (12, 8, 95));
        assert!((frame.exposure_s - 0.0125).abs() < 1e-9);
    }

    #[test]
    fn a_frame_cut_at_any_byte_is_refused_with_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = written(folder.path());
        let bytes = std::fs::read(&path).unwrap();
        for length in (0..bytes.len()).step_by(7) {
            std::fs::write(&path, &bytes[..length]).unwrap();
            let error = read(&path).unwrap_err();
            assert_eq!(error.exit_code(), 2);
            assert!(error.to_string().contains("frame.tiff"));
        }
    }

    #[test]
    fn jpeg_is_refused_whatever_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("shot.tiff");
        std::fs::write(&path, b"\xff\xd8\xff\xe0\x00\x10JFIF").unwrap();
        assert!(read(&path).unwrap_err().to_string().contains("not linear"));
    }

    /// TIFF 6.0, page 36: 1 is the one orientation whose rows lie as they are stored.
    #[test]
    fn a_frame_that_says_that_it_is_turned_is_refused() {
        use tiff::encoder::{Rational, TiffEncoder, colortype::Gray16};
        let of = |orientation: u16| {
            let mut bytes = Cursor::new(Vec::new());
            let mut encoder = TiffEncoder::new(&mut bytes).unwrap();
            let mut image = encoder.new_image::<Gray16>(4, 2).unwrap();
            let directory = image.encoder();
            directory.write_tag(tiff::tags::Tag::Orientation, orientation).unwrap();
            directory.write_tag(tiff::tags::Tag::Unknown(0x829a), Rational { n: 1, d: 50 }).unwrap();
            image.write_data(&[5; 8]).unwrap();
            decode(bytes.get_ref(), Path::new("shot.tiff"))
        };
        assert_eq!(of(1).unwrap().values, [5; 8]);
        for turned in 2..=8 {
            let message = of(turned).unwrap_err().to_string();
            assert!(message.contains(&format!("shot.tiff: its Orientation is {turned}")), "{message}");
        }
    }
}
