//! PNG and JPEG files that people hand in: turned upright as their EXIF says, within bounds that the file's
//! length sets.

use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader};

use crate::colour::srgb_decode;
use lobelia_base::error::{Error, Result};

/// Bytes of pixels that one byte of a file can stand for: deflate reaches 1032 to 1, runs of empty blocks of
/// a progressive JPEG more.
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
    let reading = |error: image::ImageError| Error::reading(path, sentence(&error)).caused_by(error);
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
    match error {
        image::ImageError::Limits(_) => "it needs more memory than a picture may".into(),
        image::ImageError::Decoding(error) => {
            format!("it is damaged, or not what its name says: {}", words(error))
        }
        other => words(other),
    }
}

fn words(error: &impl std::fmt::Display) -> String {
    error.to_string().split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Whether an ICC profile is sRGB's: its colourants (Rec. 709 adapted to D50) and the curves of its channels,
/// or that of its grey. One of tables instead is judged by its name. None for what is no profile.
pub fn is_srgb(profile: &[u8]) -> Option<bool> {
    /// X and Y of red, green and blue.
    const SRGB: [[f64; 2]; 3] = [[0.4361, 0.2225], [0.3851, 0.7169], [0.1431, 0.0606]];
    let count = word(profile, 128)?.min(256) as usize;
    let tag = |name: &[u8; 4]| {
        let at = (0..count).map(|k| 132 + 12 * k).find(|&at| profile.get(at..at + 4) == Some(name))?;
        Some(word(profile, at + 4)? as usize)
    };
    let colourant = |name: &[u8; 4]| {
        let value = tag(name)?;
        let number =
            |k: usize| Some(f64::from(word(profile, value.checked_add(8 + 4 * k)?)? as i32) / 65536.0);
        Some([number(0)?, number(1)?])
    };
    let curves = [b"rTRC", b"gTRC", b"bTRC", b"kTRC"].map(tag);
    let curves_are = curves.into_iter().flatten().all(|at| is_srgb_curve(profile, at) != Some(false));
    let near = |(a, b): (&[f64; 2], &[f64; 2])| (a[0] - b[0]).abs() < 0.01 && (a[1] - b[1]).abs() < 0.01;
    let colourants = [b"rXYZ", b"gXYZ", b"bXYZ"].map(colourant);
    if let [Some(red), Some(green), Some(blue)] = colourants {
        return Some([red, green, blue].iter().zip(&SRGB).all(near) && curves_are);
    }
    if curves[3].is_some() {
        return Some(curves_are);
    }
    let named = |name: &[u8]| profile.windows(name.len()).any(|part| part == name);
    (count > 0).then(|| named(b"sRGB") || named(b"s\0R\0G\0B"))
}

/// Whether the curve of a profile at `at` is near that of sRGB.
fn is_srgb_curve(profile: &[u8], at: usize) -> Option<bool> {
    let kind = profile.get(at..at.checked_add(4)?)?;
    let half = |at: usize| {
        Some(f64::from(u16::from_be_bytes(*profile.get(at..at.checked_add(2)?)?.first_chunk::<2>()?)))
    };
    let fixed = |k: usize| Some(f64::from(word(profile, at + 12 + 4 * k)? as i32) / 65536.0);
    let decoded = |x: f64| -> Option<f64> {
        match kind {
            b"curv" => match word(profile, at + 8)? as usize {
                0 => Some(x),
                1 => Some(x.powf(half(at + 12)? / 256.0)),
                count => {
                    let place = x * (count - 1) as f64;
                    let value = |k: usize| Some(half((at + 12).checked_add(k.checked_mul(2)?)?)? / 65535.0);
                    let [low, high] = [value(place.floor() as usize)?, value(place.ceil() as usize)?];
                    Some(low + (high - low) * place.fract())
                }
            },
            b"para" => {
                let [g, a, b] = [fixed(0)?, fixed(1).unwrap_or(1.0), fixed(2).unwrap_or(0.0)];
                match half(at + 8)? as u16 {
                    0 => Some(x.powf(g)),
                    1 => Some((a * x + b).max(0.0).powf(g)),
                    2 => Some((a * x + b).max(0.0).powf(g) + fixed(3)?),
                    3 | 4 if x < fixed(4)? => Some(fixed(3)? * x),
                    3 | 4 => Some((a * x + b).max(0.0).powf(g)),
                    _ => None,
                }
            }
            _ => None,
        }
    };
    let near = |x: f32| Some((decoded(f64::from(x))? - f64::from(srgb_decode(x))).abs() < 0.02);
    Some(near(0.1)? && near(0.5)? && near(0.9)?)
}

/// Four bytes as a number.
fn word(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_be_bytes(*bytes.get(at..at.checked_add(4)?)?.first_chunk::<4>()?))
}

/// What a PNG without a profile says of its colours, where that is not sRGB: its gamma or its primaries.
/// `None` for other files.
pub fn png_not_srgb(path: &Path) -> Option<String> {
    let file = std::io::BufReader::new(std::fs::File::open(path).ok()?);
    let reader = png::Decoder::new(file).read_info().ok()?;
    let info = reader.info();
    // These chunks are for programs that know neither of the two.
    if info.srgb.is_some() || info.icc_profile.is_some() {
        return None;
    }
    if let Some(gamma) = info.gama_chunk.map(png::ScaledFloat::into_value)
        && (gamma * 2.2 - 1.0).abs() > 0.05
    {
        return Some(format!("its gamma is {gamma}, sRGB's 0.45455"));
    }
    let primaries = info.chrm_chunk?;
    let srgb = [(0.64, 0.33), (0.3, 0.6), (0.15, 0.06)];
    let found = [primaries.red, primaries.green, primaries.blue];
    let near = |((x, y), (of_x, of_y)): ((png::ScaledFloat, png::ScaledFloat), (f32, f32))| {
        (x.into_value() - of_x).abs() < 0.01 && (y.into_value() - of_y).abs() < 0.01
    };
    let all = found.into_iter().zip(srgb).all(near);
    (!all).then(|| "its primaries are not sRGB's".to_string())
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

    /// A profile with sRGB's colourants or none, and one curve for all channels.
    fn with_curve(colourants: bool, curve: &[u8]) -> Vec<u8> {
        let mut values: Vec<(&[u8; 4], Vec<u8>)> = Vec::new();
        if colourants {
            for (name, x, y) in
                [(b"rXYZ", 0.4361, 0.2225), (b"gXYZ", 0.3851, 0.7169), (b"bXYZ", 0.1431, 0.0606)]
            {
                let [x, y] = [x, y].map(|value: f64| ((value * 65536.0) as i32).to_be_bytes());
                values.push((name, [&[0; 8][..], &x, &y, &[0; 4]].concat()));
            }
            values.push((b"rTRC", curve.to_vec()));
        } else {
            values.push((b"kTRC", curve.to_vec()));
        }
        let mut bytes = vec![0; 128];
        bytes.extend((values.len() as u32).to_be_bytes());
        let mut place = bytes.len() + 12 * values.len();
        for (name, value) in &values {
            bytes.extend(*name);
            bytes.extend([place as u32, value.len() as u32].map(u32::to_be_bytes).concat());
            place += value.len();
        }
        values.iter().for_each(|(_, value)| bytes.extend(value));
        bytes
    }

    #[test]
    fn profiles_are_told_apart_by_their_curves() {
        let curve = |values: &[u16]| {
            let count = (values.len() as u32).to_be_bytes();
            let values: Vec<u8> = values.iter().flat_map(|value| value.to_be_bytes()).collect();
            [&b"curv\0\0\0\0"[..], &count, &values].concat()
        };
        let para = |kind: u16, numbers: &[f64]| {
            let numbers: Vec<u8> =
                numbers.iter().flat_map(|number| ((number * 65536.0).round() as i32).to_be_bytes()).collect();
            [&b"para\0\0\0\0"[..], &kind.to_be_bytes(), &[0; 2], &numbers].concat()
        };
        let table: Vec<u16> = (0..1024).map(|k| (65535.0 * srgb_decode(k as f32 / 1023.0)) as u16).collect();
        let srgb = [2.4, 1.0 / 1.055, 0.055 / 1.055, 1.0 / 12.92, 0.04045];
        for colourants in [true, false] {
            for (curve, is) in [
                (curve(&[]), false),
                (curve(&[0x0100]), false),
                (curve(&[0x0233]), true),
                (curve(&[0x01cd]), false),
                (curve(&table), true),
                (para(3, &srgb), true),
                (para(0, &[1.0]), false),
            ] {
                assert_eq!(is_srgb(&with_curve(colourants, &curve)), Some(is), "{colourants} {curve:?}");
            }
        }
        // Tables instead of colourants: by the name.
        let mut of_tables = with_curve(false, b"mft2");
        of_tables[132] = b'A';
        assert_eq!(is_srgb(&of_tables), Some(false));
        of_tables.extend(b"sRGB v4 ICC preference");
        assert_eq!(is_srgb(&of_tables), Some(true));
    }

    #[test]
    fn a_png_that_is_linear_or_of_other_primaries_by_its_own_word_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p.png");
        let told = |set: &dyn Fn(&mut png::Info<'_>)| {
            let mut info = png::Info::with_size(1, 1);
            info.color_type = png::ColorType::Rgb;
            info.bit_depth = png::BitDepth::Eight;
            set(&mut info);
            let file = std::fs::File::create(&path).unwrap();
            let mut writer = png::Encoder::with_info(file, info).unwrap().write_header().unwrap();
            writer.write_image_data(&[9, 9, 9]).unwrap();
            writer.finish().unwrap();
            png_not_srgb(&path)
        };
        let value = png::ScaledFloat::new;
        let primaries = |green: [f32; 2]| png::SourceChromaticities {
            white: (value(0.3127), value(0.329)),
            red: (value(0.64), value(0.33)),
            green: (value(green[0]), value(green[1])),
            blue: (value(0.15), value(0.06)),
        };
        assert_eq!(told(&|_| ()), None);
        assert_eq!(told(&|info| info.source_gamma = Some(value(0.45455))), None);
        assert!(told(&|info| info.source_gamma = Some(value(1.0))).unwrap().contains("gamma is 1"));
        assert_eq!(told(&|info| info.source_chromaticities = Some(primaries([0.3, 0.6]))), None);
        // Adobe RGB (1998).
        assert!(told(&|info| info.source_chromaticities = Some(primaries([0.21, 0.71]))).is_some());
    }
}
