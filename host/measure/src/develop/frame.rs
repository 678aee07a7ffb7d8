//! Reads camera frames: TIFF mosaics with EXIF exposure. JPEG is refused: it is not linear.

use std::io::Cursor;
use std::path::Path;

use super::mosaic::{self, Mosaic};
use crate::rig::config::ExifExposure;
use lobelia_base::error::{Error, Result};

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

/// A photograph as a camera's software stores it.
#[derive(Debug, Clone, PartialEq)]
pub struct Photograph {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Values row by row.
    pub values: Vec<u16>,
    /// What its EXIF block says, as far as it says anything.
    pub notes: ExifNotes,
}

/// What a camera notes in the EXIF block.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ExifNotes {
    /// Exposure time, s; often the nominal speed.
    pub exposure_s: Option<f64>,
    /// When it was taken by the camera's clock, s since some midnight, and how finely that is told, s.
    pub taken_s: Option<(f64, f64)>,
}

/// Reads a frame and its exposure.
///
/// # Errors
/// Input errors for a missing, truncated or non-linear file, or one without an exposure time.
pub fn read(path: &Path) -> Result<RawFrame> {
    let Photograph { width, height, values, notes } = read_photograph(path)?;
    let exposure_s = notes.exposure_s.ok_or_else(|| {
        Error::input(format!("{}: no readable EXIF block with an exposure time", path.display()))
    })?;
    Ok(RawFrame { width, height, values, exposure_s })
}

/// Reads a photograph and what it says of itself.
///
/// # Errors
/// Input errors for a missing, truncated or non-linear file.
pub fn read_photograph(path: &Path) -> Result<Photograph> {
    decode(&std::fs::read(path).map_err(|error| Error::reading(path, error))?, path)
}

/// The photograph that the bytes of a file are; `path` is for errors.
///
/// # Errors
/// As [`read_photograph`].
pub fn decode(bytes: &[u8], path: &Path) -> Result<Photograph> {
    if bytes.starts_with(&JPEG_START) {
        let message = "a JPEG, which is not linear; give the camera's 16-bit TIFF";
        return Err(Error::input(format!("{}: {message}", path.display())));
    }
    let Mosaic { width, height, values } =
        mosaic::read(bytes).map_err(|why| Error::input(format!("{}: {why}", path.display())))?;
    Ok(Photograph { width, height, values, notes: notes(bytes) })
}

/// Whether the bytes of a file are those of a photograph that says that it is turned.
pub(crate) fn is_turned(bytes: &[u8]) -> bool {
    mosaic::is_turned(bytes)
}

/// What the EXIF block of a file says.
fn notes(bytes: &[u8]) -> ExifNotes {
    let Ok(block) = exif::Reader::new().read_from_container(&mut Cursor::new(bytes)) else {
        return ExifNotes::default();
    };
    // TIFF/EP has them in the image's own directory, EXIF in one of its own.
    let value = |tag: exif::Tag| {
        let of = |context| block.get_field(exif::Tag(context, tag.number()), exif::In::PRIMARY);
        of(exif::Context::Exif).or_else(|| of(exif::Context::Tiff)).map(|field| &field.value)
    };
    let exposure_s = match value(exif::Tag::ExposureTime) {
        Some(exif::Value::Rational(times)) => {
            times.first().filter(|time| time.denom > 0 && time.num > 0).map(exif::Rational::to_f64)
        }
        _ => None,
    };
    let text = |tag: exif::Tag| match value(tag) {
        Some(exif::Value::Ascii(lines)) => lines.first(),
        _ => None,
    };
    let taken_s = text(exif::Tag::DateTimeOriginal)
        .and_then(|text| exif::DateTime::from_ascii(text).ok())
        .map(|date| fine(seconds(&date), text(exif::Tag::SubSecTimeOriginal)));
    ExifNotes { exposure_s, taken_s }
}

/// A time to the second with the digits of its fraction, where those are told, and its resolution.
fn fine(whole_s: f64, fraction: Option<&Vec<u8>>) -> (f64, f64) {
    let digits: Option<f64> = fraction.and_then(|text| {
        let text = std::str::from_utf8(text).ok()?.trim_matches([' ', '\0']);
        (!text.is_empty() && text.bytes().all(|b| b.is_ascii_digit()))
            .then(|| format!("0.{text}").parse().ok())?
    });
    digits.map_or((whole_s, 1.0), |fraction| (whole_s + fraction, 0.1))
}

/// Seconds of a date since 0000-03-01 in the proleptic Gregorian calendar (Richards 2013, days from a civil
/// date).
fn seconds(date: &exif::DateTime) -> f64 {
    let (year, month, day) = (i64::from(date.year), i64::from(date.month), i64::from(date.day));
    let (year, month) = if month < 3 { (year - 1, month + 9) } else { (year, month - 3) };
    let days = 365 * year + year.div_euclid(4) - year.div_euclid(100)
        + year.div_euclid(400)
        + (153 * month + 2) / 5
        + day
        - 1;
    let of_day = i64::from(date.hour) * 3600 + i64::from(date.minute) * 60 + i64::from(date.second);
    (days * 86_400 + of_day) as f64
}

impl ExifExposure {
    /// Whether a photograph that says that it was exposed for `exif_s` can be of a shutter that was open for
    /// `open_s`.
    ///
    /// # Errors
    /// A sentence's end that says why not.
    pub fn agrees(self, exif_s: Option<f64>, open_s: f64) -> std::result::Result<(), String> {
        // A third of a stop each way is what nominal speeds are apart.
        let (most, rule) = match self {
            Self::Ignore => return Ok(()),
            Self::Exact => (1.02, "exact"),
            Self::Nominal => (2f64.cbrt(), "nominal"),
        };
        let hint = "set the camera's exposure to bulb, or camera.exif in rig.toml to";
        let Some(exif_s) = exif_s else {
            return Err(format!(
                "no readable EXIF block with an exposure time; {hint} \"ignore\" if it writes none"
            ));
        };
        let ratio = exif_s / open_s;
        if ratio.max(1.0 / ratio) > most * (1.0 + 1e-6) {
            let weaker = if self == Self::Exact { "\"nominal\" for nominal speeds" } else { "\"ignore\"" };
            return Err(format!(
                "its EXIF exposure is {exif_s} s, the controller opened the shutter for {open_s} s, which is \
                 more than {rule} speeds differ; {hint} {weaker}"
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
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
    fn the_exposure_of_tiff_ep_stands_in_the_image_s_own_directory() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/cases/tiff/cfa.tif");
        let frame = read(&path).unwrap();
        assert_eq!((frame.width, frame.height, frame.exposure_s), (7, 5, 1.0 / 80.0));
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

    /// Julian day numbers of the Astronomical Almanac: 2000-01-01 is 2451545, 1858-11-17 is 2400001.
    #[test]
    fn the_cameras_clock_counts_days_as_the_calendar_does_and_fractions_where_they_are_told() {
        let at = |text: &str| seconds(&exif::DateTime::from_ascii(text.as_bytes()).unwrap());
        assert_eq!(at("2000:01:01 00:00:00") - at("1858:11:17 00:00:00"), 51_544.0 * 86_400.0);
        assert_eq!(at("2024:03:01 00:00:10") - at("2024:02:28 23:59:50"), 86_420.0);
        assert_eq!(at("2023:03:01 00:00:00") - at("2023:02:28 00:00:00"), 86_400.0);
        assert_eq!(fine(5.0, Some(&b"25\0".to_vec())), (5.25, 0.1));
        assert_eq!(fine(5.0, Some(&b"   ".to_vec())), (5.0, 1.0));
        let folder = tempfile::tempdir().unwrap();
        let taken = read_photograph(&written(folder.path())).unwrap().notes.taken_s.unwrap();
        assert_eq!(taken, (at("2000:01:01 00:00:05"), 1.0));
    }

    /// The speeds that cameras write (ISO 2720's series is powers of two; what is engraved is not) against
    /// what they do.
    #[test]
    fn nominal_speeds_are_taken_for_what_they_stand_for_and_a_third_of_a_stop_is_the_end_of_it() {
        use ExifExposure::{Exact, Ignore, Nominal};
        for (exif_s, open_s) in
            [(1.0 / 60.0, 1.0 / 64.0), (0.4, 0.3788), (1.0 / 15.0, 1.0 / 16.0), (30.0, 32.0)]
        {
            assert_eq!(Nominal.agrees(Some(exif_s), open_s), Ok(()));
            assert!(Exact.agrees(Some(exif_s), open_s).unwrap_err().contains("nominal"));
        }
        for (exif_s, open_s) in [(1.0 / 60.0, 1.0 / 80.0), (0.5, 0.3788), (0.25, 0.5)] {
            assert!(Nominal.agrees(Some(exif_s), open_s).unwrap_err().contains("EXIF exposure"));
            assert_eq!(Ignore.agrees(Some(exif_s), open_s), Ok(()));
        }
        assert_eq!(Exact.agrees(Some(0.101), 0.1), Ok(()));
        assert!(Nominal.agrees(None, 0.1).is_err() && Ignore.agrees(None, 0.1).is_ok());
    }
}
