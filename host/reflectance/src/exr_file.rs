//! Layers of OpenEXR files, read within bounds: nothing is allocated before the header has been held against
//! the file's length, and only the channels that are asked for are kept.
//!
//! Pixels stand where the file says: a data window smaller than the display window leaves the rest 0, a
//! larger one is cut.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use exr::block::{self, UncompressedBlock, reader::ChunksReader};
use exr::compression::Compression;
use exr::meta::attribute::{AttributeValue, EnvironmentMap, SampleType};
use exr::meta::header::Header;
use exr::prelude::f16;

use lobelia_base::files;

use crate::FormatError;
use crate::colour::Primaries;

/// Values of a display window, over the channels that are read, that are believed whatever the file's length:
/// what lies outside the data window costs the file nothing.
const MOST_EMPTY_VALUES: usize = 1 << 26;

/// One layer, or part, of a file: the pixels of its display window.
#[derive(Debug, Clone, PartialEq)]
pub struct ExrLayer {
    /// Pixels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// The channels asked for by name, each row by row from the top.
    pub channels: BTreeMap<String, Vec<f32>>,
    /// Text attributes.
    pub texts: BTreeMap<String, String>,
    /// The primaries of R, G and B where they are given.
    pub primaries: Option<Primaries>,
    /// Whether the pixels are the six faces of a cube, one below the other.
    pub cube: bool,
}

/// Reads the first layer of a file in which `choose` finds what it wants: of a layer's channel names it gives
/// those to read. `wanted` says what that is, for the error when there is none.
///
/// # Errors
/// [`FormatError::Invalid`] that names the file: it is missing or no OpenEXR file, larger than its bytes can
/// hold, cut short, or has no such layer, in which case its channels are named.
pub fn read(
    path: &Path,
    wanted: &str,
    choose: impl Fn(&[&str]) -> Option<Vec<String>>,
) -> Result<ExrLayer, FormatError> {
    let named = |what: String| FormatError::Invalid(format!("{}: {what}", path.display()));
    let unreadable = |what: String, source: Box<dyn std::error::Error + Send + Sync>| {
        FormatError::Unreadable { message: format!("{}: {what}", path.display()), source }
    };
    let no_file = |error: std::io::Error| unreadable(format!("cannot be read: {error}"), error.into());
    let file = File::open(path).map_err(no_file)?;
    let metadata = file.metadata().map_err(no_file)?;
    if metadata.is_dir() {
        return Err(named(format!("{}, no OpenEXR file", files::what_is(path).unwrap_or("a folder"))));
    }
    let length = metadata.len();
    let broken = |error: exr::error::Error| unreadable(sentence(&error), error.into());
    let reader = block::read(BufReader::new(file), false).map_err(broken)?;

    let (index, channels) = chosen(reader.headers(), &choose)
        .ok_or_else(|| named(format!("it has no {wanted}; {}", channels_in_words(reader.headers()))))?;
    for header in reader.headers() {
        check(header, length).map_err(&named)?;
    }
    let header = reader.headers()[index].clone();
    let mut layer = Placed::new(&header, &channels).map_err(&named)?;
    let chunks = reader
        .filter_chunks(false, |_, tile, block| block.layer == index && tile.is_largest_resolution_level());
    let chunks = chunks.map_err(broken)?;
    chunks.decompress_parallel(false, |_, block| layer.place(&header, &block)).map_err(broken)?;
    layer.finish(&header).map_err(named)
}

/// The first layer that has what is wanted, and its channels.
fn chosen(
    headers: &[Header],
    choose: impl Fn(&[&str]) -> Option<Vec<String>>,
) -> Option<(usize, Vec<String>)> {
    headers.iter().enumerate().find_map(|(index, header)| {
        let names: Vec<String> =
            header.channels.list.iter().map(|channel| channel.name.to_string()).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        Some((index, choose(&names)?))
    })
}

/// `its channels are a, b and c`, at most two dozen of them.
fn channels_in_words(headers: &[Header]) -> String {
    const MOST: usize = 24;
    let names: Vec<String> = (headers.iter())
        .flat_map(|header| header.channels.list.iter().map(|channel| channel.name.to_string()))
        .collect();
    match names.len() {
        0 => "it has no channels".into(),
        1..=MOST => format!("its channels are {}", names.join(", ")),
        count => format!("its channels are {} and {} more", names[..MOST].join(", "), count - MOST),
    }
}

/// An error of the exr crate as half a sentence.
fn sentence(error: &exr::error::Error) -> String {
    match error {
        exr::error::Error::Io(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => {
            "not a readable OpenEXR file: it is cut short".into()
        }
        exr::error::Error::Invalid(what) if what == "file identifier missing" => {
            "not a readable OpenEXR file: it does not begin as one does".into()
        }
        other => format!("not a readable OpenEXR file: {other}"),
    }
}

/// Refuses what no file of this length can hold, and kinds of pixels that are not read.
fn check(header: &Header, length: u64) -> Result<(), String> {
    if header.deep {
        return Err("it has deep data (several samples a pixel); flatten it".into());
    }
    // Bytes that one byte of the file can stand for at most: run lengths take 2 bytes for 128, deflate
    // reaches 1032 to 1, wavelets and cosine transforms of one even colour more than that.
    let ratio: u128 = match header.compression {
        Compression::Uncompressed => 1,
        Compression::RLE => 64,
        _ => 1 << 14,
    };
    let most = u128::from(length) * ratio;
    let bytes: usize =
        header.channels.list.iter().map(|channel| channel.sample_type.bytes_per_sample()).sum();
    let size = header.layer_size;
    let needed = size.width() as u128 * size.height() as u128 * bytes as u128;
    if needed > most {
        return Err(format!(
            "its {length} bytes cannot hold {} × {} pixels of {} channels; the file is damaged or cut short",
            size.width(),
            size.height(),
            header.channels.list.len()
        ));
    }
    if let exr::meta::BlockDescription::Tiles(tiles) = header.blocks {
        let area = tiles.tile_size.width() as u128 * tiles.tile_size.height() as u128;
        if area * bytes as u128 > most.max(1 << 26) {
            return Err("its tiles are larger than the file can hold; the file is damaged".into());
        }
    }
    Ok(())
}

/// The display window being filled.
struct Placed {
    size: [usize; 2],
    /// From the data window to the display window.
    offset: [i64; 2],
    /// By index of the layer's channels, the plane that it goes to.
    planes: Vec<Option<(String, Vec<f32>)>>,
    /// Upper left corners of the blocks that came.
    blocks: BTreeSet<[usize; 2]>,
    pixels: usize,
}

impl Placed {
    fn new(header: &Header, wanted: &[String]) -> Result<Self, String> {
        let display = header.shared_attributes.display_window;
        let size = [display.size.width(), display.size.height()];
        let data = header.layer_size.width() * header.layer_size.height();
        let count = size[0]
            .checked_mul(size[1])
            .filter(|&count| count <= data.max(MOST_EMPTY_VALUES / wanted.len().max(1)));
        let too_large = || {
            format!(
                "its display window of {} × {} pixels is much larger than its data window; crop it",
                size[0], size[1]
            )
        };
        let count = count.ok_or_else(too_large)?;
        let mut planes = Vec::new();
        for channel in &header.channels.list {
            let name = channel.name.to_string();
            if !wanted.contains(&name) {
                planes.push(None);
                continue;
            }
            if (channel.sampling.x(), channel.sampling.y()) != (1, 1) {
                return Err(format!("its channel {name} is subsampled; convert it to full resolution"));
            }
            let mut plane = Vec::new();
            plane
                .try_reserve_exact(count)
                .map_err(|_| format!("there is not enough memory for {} × {} pixels", size[0], size[1]))?;
            plane.resize(count, 0.0);
            planes.push(Some((name, plane)));
        }
        let from = header.own_attributes.layer_position;
        let to = display.position;
        let offset = [i64::from(from.x()) - i64::from(to.x()), i64::from(from.y()) - i64::from(to.y())];
        Ok(Self { size, offset, planes, blocks: BTreeSet::new(), pixels: 0 })
    }

    /// Copies the lines of a block.
    fn place(&mut self, header: &Header, block: &UncompressedBlock) -> exr::error::UnitResult {
        let at = [block.index.pixel_position.x(), block.index.pixel_position.y()];
        if self.blocks.insert(at) {
            self.pixels += block.index.pixel_size.width() * block.index.pixel_size.height();
        }
        for line in block.lines(&header.channels) {
            let place = line.location;
            let Some(Some((_, plane))) = self.planes.get_mut(place.channel) else { continue };
            let row = place.position.y() as i64 + self.offset[1];
            if row < 0 || row >= self.size[1] as i64 {
                continue;
            }
            let first = place.position.x() as i64 + self.offset[0];
            let width = self.size[0] as i64;
            let row = &mut plane[row as usize * self.size[0]..][..self.size[0]];
            let mut put = |k: usize, value: f32| {
                let x = first + k as i64;
                if (0..width).contains(&x) {
                    row[x as usize] = value;
                }
            };
            match header.channels.list[place.channel].sample_type {
                SampleType::F16 => {
                    for (k, value) in line.read_samples::<f16>().enumerate() {
                        put(k, value?.to_f32());
                    }
                }
                SampleType::F32 => {
                    for (k, value) in line.read_samples::<f32>().enumerate() {
                        put(k, value?);
                    }
                }
                SampleType::U32 => {
                    for (k, value) in line.read_samples::<u32>().enumerate() {
                        put(k, value? as f32);
                    }
                }
            }
        }
        Ok(())
    }

    /// The layer, once all blocks have come.
    fn finish(self, header: &Header) -> Result<ExrLayer, String> {
        if self.pixels != header.layer_size.width() * header.layer_size.height() {
            return Err("not a readable OpenEXR file: some of its blocks are missing".into());
        }
        let text = |(name, value): (&exr::prelude::Text, &AttributeValue)| match value {
            AttributeValue::Text(text) => Some((name.to_string(), text.to_string())),
            _ => None,
        };
        let given = header.shared_attributes.chromaticities;
        Ok(ExrLayer {
            width: self.size[0],
            height: self.size[1],
            channels: self.planes.into_iter().flatten().collect(),
            texts: header.own_attributes.other.iter().filter_map(text).collect(),
            primaries: given.map(|given| {
                let of = |v: exr::math::Vec2<f32>| [f64::from(v.x()), f64::from(v.y())];
                Primaries {
                    red: of(given.red),
                    green: of(given.green),
                    blue: of(given.blue),
                    white: of(given.white),
                }
            }),
            cube: header.own_attributes.environment_map == Some(EnvironmentMap::Cube),
        })
    }
}
