//! A palette of BRDFs as a TOML file to edit by hand, and the index image that says which texel takes which,
//! to edit in a paint program.
//!
//! The index image is an indexed PNG. Each BRDF has a swatch, the colour by which it is known there: paint
//! programs reorder a palette at will, so colours count and not places.

use std::fmt::Write as _;
use std::path::Path;

use glam::Vec3;
use serde::Deserialize;

use super::ALPHA;
use super::pairs::Pairs;
use lobelia_base::error::{Error, Result};
use lobelia_base::files;
use lobelia_base::toml_file;
use lobelia_reflectance::{Lobe, LobeBrdf, Rgb, SbrdfMap, colour};

/// Pairs of directions for a swatch.
const PAIRS: usize = 256;

/// A BRDF with the colour by which the index image knows it.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// 8-bit sRGB.
    pub swatch: [u8; 3],
    /// The BRDF.
    pub brdf: LobeBrdf,
}

/// Gives each BRDF a swatch: its mean albedo, moved a little where another has that colour.
pub fn with_swatches(brdfs: Vec<LobeBrdf>) -> Vec<Entry> {
    let mut entries: Vec<Entry> = Vec::with_capacity(brdfs.len());
    for brdf in brdfs {
        let albedo = Pairs::over([&brdf], PAIRS).albedo(&brdf);
        let mut swatch = colour::to_srgb8(albedo);
        let mut step = 0;
        while entries.iter().any(|entry| entry.swatch == swatch) {
            step += 1;
            swatch[step % 3] = swatch[step % 3].wrapping_add(if swatch[step % 3] < 128 { 1 } else { 255 });
        }
        entries.push(Entry { swatch, brdf });
    }
    entries
}

/// A colour as `#a0b1c2`.
pub(crate) fn hex(swatch: [u8; 3]) -> String {
    format!("#{:02x}{:02x}{:02x}", swatch[0], swatch[1], swatch[2])
}

/// The palette as TOML; `notes` say more on each BRDF.
pub fn to_toml(entries: &[Entry], notes: &[String]) -> String {
    let mut text = String::from(HEADING);
    for (entry, note) in entries.iter().zip(notes) {
        let Entry { swatch, brdf } = entry;
        let list = |v: Vec3| format!("[{:?}, {:?}, {:?}]", v.x, v.y, v.z);
        // Writing to a string cannot fail.
        let _ = write!(
            text,
            "\n[[brdf]]  # {note}\nswatch = \"{}\"\nrho_d = {}\nbeta_deg = {:?}\nlobes = [\n",
            hex(*swatch),
            list(brdf.rho_d),
            brdf.beta.to_degrees()
        );
        for lobe in &brdf.lobes {
            let _ = writeln!(
                text,
                "  {{ rho_s = {}, c = {}, n = {:?} }},",
                list(lobe.rho_s),
                list(lobe.c),
                lobe.n
            );
        }
        text += "]\n";
    }
    text
}

const HEADING: &str = "\
# A palette of BRDFs. Each texel of the index image has the colour of one swatch here and takes that BRDF.
# rho_d and rho_s in 1/sr (R, G, B), beta_deg the direction of anisotropy, c the diagonal of \
C (x, y, z), n the exponent.
# BRDFs may be changed, added (with a swatch of their own) and removed. Then: \
lobelia edit palette PALETTE.toml --index INDEX.png
";

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PaletteFile {
    brdf: Vec<BrdfFile>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct BrdfFile {
    swatch: String,
    rho_d: Rgb,
    #[serde(default)]
    beta_deg: f32,
    #[serde(default)]
    lobes: Vec<Lobe>,
}

/// Reads a palette.
///
/// # Errors
/// Input errors that name file and line or the BRDF.
pub fn read(path: &Path) -> Result<Vec<Entry>> {
    let file: PaletteFile = toml_file::read(path)?;
    let mut entries: Vec<Entry> = Vec::with_capacity(file.brdf.len());
    for (place, brdf) in file.brdf.into_iter().enumerate() {
        let wrong = |what: &str| Error::input(format!("{}: BRDF {}: {what}", path.display(), place + 1));
        let swatch = parse_hex(&brdf.swatch).ok_or_else(|| {
            wrong(&format!("the swatch \"{}\" is no colour such as \"#a0b1c2\"", brdf.swatch))
        })?;
        if let Some(other) = entries.iter().position(|entry| entry.swatch == swatch) {
            return Err(wrong(&format!("the swatch {} is that of BRDF {} as well", brdf.swatch, other + 1)));
        }
        let finite = |v: Vec3| v.is_finite();
        let lobes = brdf.lobes.iter().all(|lobe| finite(lobe.rho_s) && finite(lobe.c) && lobe.n.is_finite());
        if !(finite(brdf.rho_d) && brdf.beta_deg.is_finite() && lobes) {
            return Err(wrong("a coefficient is not finite"));
        }
        let brdf = LobeBrdf {
            rho_d: brdf.rho_d,
            beta: brdf.beta_deg.to_radians(),
            lobes: brdf.lobes,
            ..LobeBrdf::default()
        };
        entries.push(Entry { swatch, brdf });
    }
    Ok(entries)
}

/// The colour that a text such as `#a0b1c2` names.
pub fn parse_hex(text: &str) -> Option<[u8; 3]> {
    let digits = text.strip_prefix('#').filter(|digits| digits.len() == 6)?;
    let value = u32::from_str_radix(digits, 16).ok()?;
    let [_, r, g, b] = value.to_be_bytes();
    Some([r, g, b])
}

/// Writes the index image of a map that is cut out where `alpha` is 0: a PNG in true colour, as transparent
/// as the map. Without `alpha` it is [`write_index`]'s.
///
/// # Errors
/// When the disk refuses.
pub fn write_index_cut(
    path: &Path,
    size: (usize, usize),
    index: &[u8],
    alpha: Option<&[f32]>,
    entries: &[Entry],
) -> Result<()> {
    let Some(alpha) = alpha else { return write_index(path, size.0, size.1, index, entries) };
    let pixel = |(&index, alpha): (&u8, &f32)| {
        let [r, g, b] = entries[usize::from(index)].swatch;
        [r, g, b, (255.0 * alpha.clamp(0.0, 1.0)).round() as u8]
    };
    let pixels: Vec<u8> = index.iter().zip(alpha).flat_map(pixel).collect();
    files::write_atomically(path, |writer| {
        let mut encoder = png::Encoder::new(writer, size.0 as u32, size.1 as u32);
        encoder.set_color(png::ColorType::Rgba);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.write_header()?.write_image_data(&pixels)?;
        Ok(())
    })
}

/// Writes an index image: an indexed PNG whose palette is the swatches.
///
/// # Errors
/// When the disk refuses.
pub fn write_index(path: &Path, width: usize, height: usize, index: &[u8], entries: &[Entry]) -> Result<()> {
    files::write_atomically(path, |writer| {
        let mut encoder = png::Encoder::new(writer, width as u32, height as u32);
        encoder.set_color(png::ColorType::Indexed);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_palette(entries.iter().flat_map(|entry| entry.swatch).collect::<Vec<u8>>());
        encoder.write_header()?.write_image_data(index)?;
        Ok(())
    })
}

/// The map that an index image and a palette describe, cut out where the image is transparent.
///
/// # Errors
/// Input errors: a file that is no picture, or a pixel whose colour is no swatch.
pub fn apply(index: &Path, entries: &[Entry]) -> Result<SbrdfMap> {
    let image = lobelia_reflectance::picture_file::decode(index)?.to_rgba8();
    let (width, height) = (image.width() as usize, image.height() as usize);
    let lobes = entries.iter().map(|entry| entry.brdf.lobes.len()).max().unwrap_or(0);
    let mut map = SbrdfMap::new(width, height, lobes);
    if image.pixels().any(|pixel| pixel.0[3] < u8::MAX) {
        let alpha = image.pixels().map(|pixel| f32::from(pixel.0[3]) / f32::from(u8::MAX)).collect();
        map.extra.insert(ALPHA.into(), alpha);
    }
    for (k, pixel) in image.pixels().enumerate() {
        let [r, g, b, opacity] = pixel.0;
        let Some(entry) = entries.iter().find(|entry| entry.swatch == [r, g, b]) else {
            // Paint programs keep no colour where nothing is seen of it.
            if opacity == 0 {
                continue;
            }
            return Err(Error::input(format!(
                "{}: pixel ({}, {}) has the colour {}, which is no swatch of the palette; paint without \
                 smoothing, or add a BRDF",
                index.display(),
                k % width,
                k / width,
                hex([r, g, b])
            )));
        };
        map.set(k, &entry.brdf);
    }
    Ok(map)
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_reflectance::materials;

    fn entries() -> Vec<Entry> {
        let brdfs = ["clay", "felt", "clay"].map(|name| materials::published(name).unwrap().rotated(0.1));
        with_swatches(brdfs.to_vec())
    }

    #[test]
    fn a_palette_survives_its_file_and_its_swatches_differ() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("palette.toml");
        let entries = entries();
        assert_ne!(entries[0].swatch, entries[2].swatch);
        std::fs::write(&path, to_toml(&entries, &vec!["a note".to_string(); 3])).unwrap();
        let read = read(&path).unwrap();
        for (entry, known) in read.iter().zip(&entries) {
            assert_eq!((entry.swatch, &entry.brdf.lobes), (known.swatch, &known.brdf.lobes));
            assert!((entry.brdf.beta - known.brdf.beta).abs() < 1e-7 && entry.brdf.rho_d == known.brdf.rho_d);
        }
    }

    #[test]
    fn the_index_image_gives_the_texels_back_also_when_a_paint_program_saved_it_as_true_colour() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("index.png");
        let entries = entries();
        write_index(&path, 2, 2, &[1, 0, 2, 1], &entries).unwrap();
        let check = || {
            let map = apply(&path, &entries).unwrap();
            for (k, index) in [1, 0, 2, 1].into_iter().enumerate() {
                assert_eq!(map.texel(k), entries[index].brdf);
            }
        };
        check();
        let saved = image::open(&path).unwrap().to_rgba8();
        saved.save(&path).unwrap();
        check();
    }

    #[test]
    fn a_map_that_is_cut_out_is_so_after_its_way_through_a_palette() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("index.png");
        let entries = entries();
        write_index_cut(&path, (2, 2), &[1, 0, 2, 1], Some(&[1.0, 0.0, 0.6, 1.0]), &entries).unwrap();
        let map = apply(&path, &entries).unwrap();
        assert_eq!(map.extra[ALPHA], [1.0, 0.0, 0.6, 1.0]);
        assert_eq!([0, 1, 2].map(|k| map.texel(k)), [1, 0, 2].map(|k: usize| entries[k].brdf.clone()));
        // A paint program that keeps no colour where nothing is seen.
        let mut painted = image::open(&path).unwrap().to_rgba8();
        painted.put_pixel(1, 0, image::Rgba([0; 4]));
        painted.save(&path).unwrap();
        assert_eq!(apply(&path, &entries).unwrap().extra[ALPHA], [1.0, 0.0, 0.6, 1.0]);
        write_index_cut(&path, (2, 2), &[1, 0, 2, 1], None, &entries).unwrap();
        assert!(!apply(&path, &entries).unwrap().extra.contains_key(ALPHA));
    }

    #[test]
    fn colours_and_palettes_that_make_no_sense_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let (path, index) = (folder.path().join("p.toml"), folder.path().join("i.png"));
        let refused = |text: &str| {
            std::fs::write(&path, text).unwrap();
            read(&path).unwrap_err().to_string()
        };
        let one = "[[brdf]]\nswatch = \"#102030\"\nrho_d = [0.1, 0.1, 0.1]\n";
        assert!(refused(&format!("{one}{one}")).contains("BRDF 2: the swatch #102030 is that of BRDF 1"));
        assert!(refused("[[brdf]]\nswatch = \"red\"\nrho_d = [0, 0, 0]\n").contains("\"red\" is no colour"));
        assert!(refused(&format!("{one}n = 3\n")).contains("line 4"));
        assert!(refused(&one.replace("0.1]", "nan]")).contains("not finite"));
        image::RgbImage::from_pixel(2, 1, image::Rgb([1, 2, 3])).save(&index).unwrap();
        let text = apply(&index, &entries()).unwrap_err().to_string();
        assert!(text.contains("pixel (0, 0)") && text.contains("#010203"), "{text}");
    }
}
