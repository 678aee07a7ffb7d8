//! Arrays of Zarr v3 stores, read as other programs write them too: float16, float32 and float64 in chunks of
//! any shape, compressed by zstd (Python's default) or gzip. Nothing is allocated that a chunk's file does
//! not stand behind.

use std::io::Read;
use std::ops::Range;
use std::path::{Path, PathBuf};

use half::f16;
use rayon::prelude::*;
use serde::Deserialize;
use serde_json::Value;

/// Bytes of a chunk at most, decompressed.
const MOST_BYTES: usize = 1 << 32;
/// Bytes that one byte of a compressed chunk can stand for: zstd repeats one 2¹⁷ times in four.
const MOST_RATIO: u64 = 1 << 17;

/// An array's metadata as `zarr.json` has it.
#[derive(Deserialize)]
struct Metadata {
    zarr_format: u64,
    node_type: String,
    shape: Vec<usize>,
    data_type: Value,
    chunk_grid: Named<Grid>,
    #[serde(default)]
    chunk_key_encoding: Option<Named<Keys>>,
    codecs: Vec<Named<Codec>>,
}

#[derive(Deserialize)]
struct Named<T> {
    name: String,
    configuration: Option<T>,
}

#[derive(Deserialize)]
struct Grid {
    chunk_shape: Vec<usize>,
}

#[derive(Deserialize)]
struct Keys {
    separator: Option<String>,
}

#[derive(Deserialize)]
struct Codec {
    endian: Option<String>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Number {
    F16,
    F32,
    F64,
}

impl Number {
    fn bytes(self) -> usize {
        match self {
            Self::F16 => 2,
            Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Converts the numbers that bytes in little-endian order hold into as many entries.
    fn convert<T>(self, bytes: &[u8], entries: &mut [T], convert: impl Fn(f64) -> T) {
        // One loop a kind, of arrays of known length: only such loops become vector code.
        match self {
            Self::F16 => {
                let numbers = bytes.as_chunks().0.iter().map(|&bytes| f16::from_le_bytes(bytes).to_f64());
                entries.iter_mut().zip(numbers).for_each(|(entry, number)| *entry = convert(number));
            }
            Self::F32 => {
                let numbers = bytes.as_chunks().0.iter().map(|&bytes| f64::from(f32::from_le_bytes(bytes)));
                entries.iter_mut().zip(numbers).for_each(|(entry, number)| *entry = convert(number));
            }
            Self::F64 => {
                let numbers = bytes.as_chunks().0.iter().map(|&bytes| f64::from_le_bytes(bytes));
                entries.iter_mut().zip(numbers).for_each(|(entry, number)| *entry = convert(number));
            }
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Compression {
    Zstd,
    Gzip,
    /// A checksum behind the bytes, which is not looked at.
    Crc32c,
}

/// An array of N dimensions.
pub(super) struct ZarrArray<const N: usize> {
    folder: PathBuf,
    name: String,
    /// Entries an axis.
    pub(super) shape: [usize; N],
    /// Entries of a chunk an axis.
    pub(super) chunk: [usize; N],
    number: Number,
    big_endian: bool,
    compressions: Vec<Compression>,
    /// What stands before and between the numbers in a chunk's name.
    prefix: &'static str,
    separator: char,
}

impl<const N: usize> ZarrArray<N> {
    /// Opens the array of a name in a store's folder.
    ///
    /// # Errors
    /// A sentence for metadata that are missing, make no sense, or name what is not read.
    pub(super) fn open(store: &Path, name: &str) -> Result<Self, String> {
        let folder = store.join(name);
        let text = std::fs::read(folder.join("zarr.json"))
            .map_err(|error| format!("it has no array `{name}` ({name}/zarr.json: {error})"))?;
        let metadata: Metadata =
            serde_json::from_slice(&text).map_err(|error| format!("{name}/zarr.json: {error}"))?;
        Self::new(folder, name, metadata).map_err(|message| format!("{name} {message}"))
    }

    fn new(folder: PathBuf, name: &str, metadata: Metadata) -> Result<Self, String> {
        if metadata.zarr_format != 3 || metadata.node_type != "array" {
            return Err("is no array of Zarr v3".into());
        }
        let number = match metadata.data_type.as_str() {
            Some("float16") => Number::F16,
            Some("float32") => Number::F32,
            Some("float64") => Number::F64,
            _ => return Err(format!("holds {}, must hold float16, float32 or float64", metadata.data_type)),
        };
        if metadata.chunk_grid.name != "regular" {
            return Err(format!("has a chunk grid `{}`; it must be regular", metadata.chunk_grid.name));
        }
        let wrong = |shape: &[usize]| format!("has the shape {shape:?}, must have {N} dimensions");
        let shape: [usize; N] = metadata.shape[..].try_into().map_err(|_| wrong(&metadata.shape))?;
        let chunk = metadata.chunk_grid.configuration.map(|grid| grid.chunk_shape).unwrap_or_default();
        let chunk: [usize; N] =
            chunk[..].try_into().map_err(|_| format!("has chunks of the shape {chunk:?}"))?;
        let bytes = chunk.iter().try_fold(number.bytes(), |bytes, &edge| bytes.checked_mul(edge));
        if chunk.contains(&0) || bytes.is_none_or(|bytes| bytes > MOST_BYTES) {
            return Err(format!(
                "has chunks of {chunk:?} entries, which cannot be; chunks have 4 GiB at most"
            ));
        }
        let (prefix, default) = match metadata.chunk_key_encoding.as_ref().map(|keys| keys.name.as_str()) {
            None | Some("default") => ("c", '/'),
            Some("v2") => ("", '.'),
            Some(other) => return Err(format!("has a chunk key encoding `{other}`, which is not read")),
        };
        let separator = metadata.chunk_key_encoding.and_then(|keys| keys.configuration?.separator);
        let separator = separator.and_then(|text| text.chars().next()).unwrap_or(default);
        let (mut big_endian, mut compressions) = (None, Vec::new());
        for codec in metadata.codecs {
            match (codec.name.as_str(), big_endian) {
                ("bytes", None) => {
                    let endian = codec.configuration.and_then(|configuration| configuration.endian);
                    big_endian = Some(endian.as_deref() == Some("big"));
                }
                ("zstd", Some(_)) => compressions.push(Compression::Zstd),
                ("gzip", Some(_)) => compressions.push(Compression::Gzip),
                ("crc32c", Some(_)) => compressions.push(Compression::Crc32c),
                (other, _) => {
                    return Err(format!(
                        "is written by the codec `{other}`, which is not read; write it by bytes alone, or \
                         by bytes with zstd or gzip"
                    ));
                }
            }
        }
        let big_endian = big_endian.ok_or("has no codec `bytes`")?;
        Ok(Self {
            folder,
            name: name.into(),
            shape,
            chunk,
            number,
            big_endian,
            compressions,
            prefix,
            separator,
        })
    }

    /// The name of a chunk in the store.
    fn key(&self, place: &[usize; N]) -> String {
        let numbers = place.map(|number| number.to_string());
        let begin =
            if self.prefix.is_empty() { String::new() } else { format!("{}{}", self.prefix, self.separator) };
        format!("{begin}{}", numbers.join(&self.separator.to_string()))
    }

    /// Refuses the array where a chunk of some ranges of entries is not there, or its file cannot hold it.
    /// Zarr reads a missing one as its fill value; here that would be a block of texels lost without a word.
    ///
    /// # Errors
    /// A sentence with the chunk's name.
    pub(super) fn chunks_are_there(&self, ranges: &[Range<usize>; N]) -> Result<(), String> {
        let expected = self.chunk_bytes();
        self.places(ranges).try_for_each(|place| {
            let key = self.key(&place);
            let Some(file) = self.folder.join(&key).metadata().ok().filter(std::fs::Metadata::is_file) else {
                return Err(format!(
                    "the chunk {}/{key} is missing (of one without samples too: Python's zarr leaves those \
                     out unless it is told write_empty_chunks)",
                    self.name
                ));
            };
            let ratio = if self.compressions.is_empty() { 1 } else { MOST_RATIO };
            if file.len().saturating_mul(ratio) < expected as u64 {
                return Err(format!(
                    "the chunk {}/{key} has {} bytes, which cannot hold {expected}; it is cut short",
                    self.name,
                    file.len()
                ));
            }
            Ok(())
        })
    }

    /// Bytes of the files of the chunks that ranges of entries touch; 0 where there is none.
    pub(super) fn lengths(&self, ranges: &[Range<usize>; N]) -> impl Iterator<Item = u64> {
        let length = |place| self.folder.join(self.key(&place)).metadata().map_or(0, |file| file.len());
        self.places(ranges).map(length)
    }

    /// Bytes of a chunk that is not compressed.
    fn chunk_bytes(&self) -> usize {
        self.number.bytes() * self.chunk.iter().product::<usize>()
    }

    /// Places of the chunks that ranges of entries touch, the last axis fastest.
    fn places(&self, ranges: &[Range<usize>; N]) -> impl Iterator<Item = [usize; N]> + use<N> {
        let chunks: [Range<usize>; N] = std::array::from_fn(|axis| {
            ranges[axis].start / self.chunk[axis]..ranges[axis].end.div_ceil(self.chunk[axis])
        });
        let mut next = (!chunks.iter().any(Range::is_empty)).then(|| chunks.clone().map(|range| range.start));
        std::iter::from_fn(move || {
            let place = next?;
            let mut after = place;
            next = (0..N).rev().find_map(|axis| {
                after[axis] += 1;
                if after[axis] < chunks[axis].end {
                    return Some(after);
                }
                after[axis] = chunks[axis].start;
                None
            });
            Some(place)
        })
    }

    /// The entries of some ranges, in the order of the axes.
    ///
    /// # Errors
    /// A sentence for a chunk that is missing or damaged.
    pub(super) fn read<T: Copy + Default + Send>(
        &self,
        ranges: &[Range<usize>; N],
        convert: impl Fn(f64) -> T + Sync,
    ) -> Result<Vec<T>, String> {
        self.chunks_are_there(ranges)?;
        let count: usize = ranges.iter().map(ExactSizeIterator::len).product();
        let mut entries = vec![T::default(); count];
        // Each row of chunks has a part of its own.
        let row: usize = ranges[1..].iter().map(ExactSizeIterator::len).product();
        let mut parts = Vec::new();
        let (mut rest, mut start) = (&mut entries[..], ranges[0].start);
        while start < ranges[0].end && row > 0 {
            let end = ((start / self.chunk[0] + 1) * self.chunk[0]).min(ranges[0].end);
            let (part, after) = std::mem::take(&mut rest).split_at_mut((end - start) * row);
            parts.push((part, start..end));
            (rest, start) = (after, end);
        }
        parts.into_par_iter().try_for_each(|(part, rows)| {
            let mut within = ranges.clone();
            within[0] = rows;
            self.places(&within).try_for_each(|place| {
                let chunk = self.decoded(&place)?;
                self.copy(&chunk, &place, &within, part, &convert);
                Ok::<(), String>(())
            })
        })?;
        Ok(entries)
    }

    /// Copies what a chunk has of some ranges to where they are kept.
    fn copy<T>(
        &self,
        chunk: &[u8],
        place: &[usize; N],
        ranges: &[Range<usize>; N],
        part: &mut [T],
        convert: &impl Fn(f64) -> T,
    ) {
        let size = self.number.bytes();
        let begin: [usize; N] = std::array::from_fn(|axis| place[axis] * self.chunk[axis]);
        let shared: [Range<usize>; N] = std::array::from_fn(|axis| {
            let end = (begin[axis] + self.chunk[axis]).min(ranges[axis].end);
            begin[axis].max(ranges[axis].start)..end
        });
        // Runs along the last axis, over all entries of the others.
        let runs: usize = shared[..N - 1].iter().map(ExactSizeIterator::len).product();
        let length = shared[N - 1].len();
        for run in 0..runs {
            let (mut left, mut from, mut to) = (run, 0, 0);
            let mut strides = (self.chunk[N - 1], ranges[N - 1].len());
            for axis in (0..N - 1).rev() {
                let index = shared[axis].start + left % shared[axis].len();
                left /= shared[axis].len();
                from += (index - begin[axis]) * strides.0;
                to += (index - ranges[axis].start) * strides.1;
                strides = (strides.0 * self.chunk[axis], strides.1 * ranges[axis].len());
            }
            from += shared[N - 1].start - begin[N - 1];
            to += shared[N - 1].start - ranges[N - 1].start;
            let bytes = &chunk[from * size..(from + length) * size];
            self.number.convert(bytes, &mut part[to..to + length], convert);
        }
    }

    /// The bytes of a chunk, decompressed, in little-endian order.
    fn decoded(&self, place: &[usize; N]) -> Result<Vec<u8>, String> {
        let key = self.key(place);
        let wrong = |what: &str| format!("the chunk {}/{key} {what}", self.name);
        let expected = self.chunk_bytes();
        let mut bytes = std::fs::read(self.folder.join(&key))
            .map_err(|error| wrong(&format!("cannot be read: {error}")))?;
        for compression in self.compressions.iter().rev() {
            bytes = match compression {
                Compression::Crc32c => {
                    let length = bytes.len().checked_sub(4).ok_or_else(|| wrong("is cut short"))?;
                    bytes.truncate(length);
                    bytes
                }
                Compression::Gzip => expanded(flate2::read::GzDecoder::new(&bytes[..]), expected)
                    .map_err(|error| wrong(&format!("is no gzip: {error}")))?,
                Compression::Zstd => ruzstd::decoding::StreamingDecoder::new(&bytes[..])
                    .map_err(|error| error.to_string())
                    .and_then(|decoder| expanded(decoder, expected).map_err(|error| error.to_string()))
                    .map_err(|error| wrong(&format!("is no zstd: {error}")))?,
            };
        }
        if bytes.len() != expected {
            return Err(wrong(&format!("has {} bytes where {expected} are expected", bytes.len())));
        }
        if self.big_endian {
            bytes.chunks_exact_mut(self.number.bytes()).for_each(<[u8]>::reverse);
        }
        Ok(bytes)
    }
}

/// What a decoder gives, one byte more than expected at most, so that a chunk that grows without end is
/// noticed; a checksum may follow.
fn expanded(decoder: impl Read, expected: usize) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    decoder.take(expected as u64 + 5).read_to_end(&mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::sampled::SampledSbrdf;

    /// tests/cases/zarr/zstd.zarr was written by zarr 3.1.6 for Python with its defaults but for the shapes
    /// of the chunks: zstd, float64 reflectance, float16 sigma, float32 weights. Texel (x, y) at pose k has
    /// (4 y + x) / 16 + k / 256 + c / 1024 in channel c, and nothing at the last texel of pose 1; sigma
    /// is 0.01 and an eighth of that.
    #[test]
    fn a_store_of_pythons_zarr_with_its_defaults_is_read() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/cases/zarr/zstd.zarr");
        let read = SampledSbrdf::read_zarr(&path).unwrap();
        assert_eq!((read.width, read.height, read.poses.len(), read.texel_mm), (4, 3, 4, 0.5));
        for texel in 0..12 {
            let sigmas = read.sigmas(texel).unwrap();
            for (place, &value) in read.values(texel).iter().enumerate() {
                let (pose, channel) = (place / 3, place % 3);
                let expected = texel as f32 / 16.0 + pose as f32 / 256.0 + channel as f32 / 1024.0;
                let lost = texel == 11 && pose == 1;
                assert!(if lost { value.is_nan() } else { value == expected }, "{texel} {place}: {value}");
                let sigma = if lost { 0.01 } else { 0.01 + 0.125 * expected };
                assert!((sigmas[place].to_f32() - sigma).abs() < 5e-4 * sigma, "{texel} {place}");
            }
        }
        let expected =
            |k: usize| (DVec3::new(100.0 * k as f64, 0.0, 1000.0), DVec3::new(0.0, 50.0 * k as f64, 1050.0));
        for (k, pose) in read.poses.iter().enumerate() {
            assert_eq!((pose.light_mm, pose.camera_mm), expected(k));
            assert_eq!(pose.weight, if k == 2 { 0.5 } else { 1.0 });
        }
    }

    #[test]
    fn a_chunk_that_its_file_cannot_hold_is_refused_before_memory_is_asked_for() {
        let folder = tempfile::tempdir().unwrap();
        let array = folder.path().join("a");
        std::fs::create_dir_all(array.join("c")).unwrap();
        std::fs::write(array.join("c/0"), [0; 64]).unwrap();
        for (codecs, refused) in [
            (
                r#"[{"name":"bytes","configuration":{"endian":"little"}}]"#,
                "has 64 bytes, which cannot hold 4000000000",
            ),
            (r#"[{"name":"bytes"},{"name":"zstd"}]"#, "has 64 bytes, which cannot hold 4000000000"),
            (r#"[{"name":"bytes"},{"name":"blosc"}]"#, "codec `blosc`, which is not read"),
            (r#"[{"name":"sharding_indexed"}]"#, "codec `sharding_indexed`, which is not read"),
        ] {
            let text = format!(
                r#"{{"zarr_format":3,"node_type":"array","shape":[1000000000],"data_type":"float32",
                "chunk_grid":
                {{"name":"regular","configuration":{{"chunk_shape":[1000000000]}}}},"codecs":{codecs}}}"#
            );
            std::fs::write(array.join("zarr.json"), text).unwrap();
            let read = ZarrArray::<1>::open(folder.path(), "a")
                .and_then(|array| array.read(std::array::from_ref(&(0..1_000_000_000)), |value| value));
            let error = read.unwrap_err();
            assert!(error.contains(refused), "{error}");
        }
    }
}
