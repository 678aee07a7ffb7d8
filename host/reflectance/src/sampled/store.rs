//! The Zarr v3 store of a sampled SBRDF: chunked by texel block over all poses, so that a fit reads a block
//! once.

use std::collections::BTreeMap;
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DVec2, DVec3};
use half::f16;
use rayon::prelude::*;
use zarrs::array::{ArrayBuilder, CodecOptions, DataType, Element, FillValue, data_type};
use zarrs::filesystem::FilesystemStore;
use zarrs::group::GroupBuilder;

use super::zarr::ZarrArray;
use super::{PoseGeometry, SampledSbrdf};
use lobelia_base::durable;
use lobelia_base::error::{Error, Result};
use lobelia_base::files;
use lobelia_base::hash::sha256;

/// Edge of a chunk in texels.
const BLOCK: usize = 16;

/// Attribute of the root group that tells a sampled SBRDF from other stores.
const LAYOUT_KEY: &str = "lobelia_layout";

/// Attribute of a store that is a part of a sample: from the sample's centre to the part's, texels along x
/// and y.
const OFFSET_KEY: &str = "offset_texels";

/// Attribute of a developed store: for each pose the share of its samples that are saturated in every
/// exposure, which are NaN.
pub const CLIPPED_KEY: &str = "clipped_by_pose";
/// The attribute of a store's root with the area of the lamp's aperture, mm²: by it a mirror's peak becomes a
/// reflectance.
pub const APERTURE_KEY: &str = "lamp_aperture_mm2";

/// Attribute of a store that Lobelia wrote: the hash of its samples, by which parts of a fit know that they
/// were made of one store.
const SAMPLES_KEY: &str = "samples_sha256";

/// Version of the layout.
const LAYOUT: u64 = 1;

impl SampledSbrdf {
    /// Whether a store may and can be written at `path`: nothing is there, an empty folder, or an earlier
    /// sampled SBRDF and nothing besides.
    ///
    /// # Errors
    /// Input errors for anything else, which a store would destroy; failures when the disk refuses.
    pub fn may_write_zarr(path: &Path) -> Result<()> {
        let refused =
            |why: String| Err(Error::input(format!("{}: {why}; name another output", path.display())));
        if path.exists() {
            let entries =
                fs::read_dir(path).into_iter().flatten().filter_map(|entry| Some(entry.ok()?.path()));
            let entries: Vec<PathBuf> = entries.collect();
            let earlier =
                fs::read_to_string(path.join("zarr.json")).is_ok_and(|text| text.contains(LAYOUT_KEY));
            if !path.is_dir() || (!entries.is_empty() && !earlier) {
                return refused("there already and no sampled SBRDF".into());
            }
            let of_a_store =
                |entry: &PathBuf| entry.ends_with("zarr.json") || entry.join("zarr.json").is_file();
            if let Some(other) = entries.iter().find(|entry| !of_a_store(entry)) {
                let name = other.file_name().unwrap_or_default().to_string_lossy();
                return refused(format!("a sampled SBRDF, but it holds {name} besides"));
            }
        }
        durable::try_writing(path).map_err(|error| Error::writing(path, error))
    }

    /// Writes the store; an earlier one at `path` is removed only when the new one is complete and on the
    /// disk.
    ///
    /// # Errors
    /// As [`Self::may_write_zarr`], and when the disk refuses; nothing half-written is left under `path`.
    pub fn write_zarr(&self, path: &Path) -> Result<()> {
        self.write_zarr_with(path, &Attributes::new())
    }

    /// As [`Self::write_zarr`], with attributes of the root that say where it comes from.
    ///
    /// # Errors
    /// As [`Self::write_zarr`].
    pub fn write_zarr_with(&self, path: &Path, attributes: &Attributes) -> Result<()> {
        Self::may_write_zarr(path)?;
        let path = &durable::target(path);
        files::create_folder(durable::folder_of(path))?;
        let temporary = durable::unused_name(path, "tmp");
        let written = write_store(self, &temporary, attributes).map_err(|error| Error::writing(path, error));
        let replaced = written.and_then(|()| {
            durable::replace_folder(&temporary, path).map_err(|error| Error::writing(path, error))
        });
        if replaced.is_err() {
            // Best effort: the first error is the one to tell.
            let _ = fs::remove_dir_all(&temporary);
        }
        replaced
    }

    /// Reads a store that [`Self::write_zarr`] or another Zarr v3 writer made.
    ///
    /// # Errors
    /// As [`SampledStore::open`].
    pub fn read_zarr(path: &Path) -> Result<Self> {
        let store = SampledStore::open(path)?;
        store.read(&Window { x: 0..store.width, y: 0..store.height }, true)
    }
}

/// What a store's root says of where it comes from, by name.
pub type Attributes = BTreeMap<String, serde_json::Value>;

/// Texts as attributes.
pub fn attributes_of(texts: BTreeMap<String, String>) -> Attributes {
    texts.into_iter().map(|(name, text)| (name, text.into())).collect()
}

/// Columns and rows of a sample.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Window {
    /// Columns.
    pub x: Range<usize>,
    /// Rows.
    pub y: Range<usize>,
}

impl Window {
    /// Columns × rows in blocks, row by row; those at the right and lower edge may be smaller.
    pub fn blocks([width, height]: [usize; 2], [columns, rows]: [usize; 2]) -> Vec<Self> {
        let row = |y: usize| {
            (0..width)
                .step_by(columns)
                .map(move |x| Self { x: x..(x + columns).min(width), y: y..(y + rows).min(height) })
        };
        (0..height).step_by(rows).flat_map(row).collect()
    }

    /// Number of texels.
    pub fn texels(&self) -> usize {
        self.x.len() * self.y.len()
    }

    /// Indices (row · width + column) of its texels in a sample of `width` columns, row by row.
    pub fn indices(&self, width: usize) -> impl Iterator<Item = usize> + '_ {
        self.y.clone().flat_map(move |y| self.x.clone().map(move |x| y * width + x))
    }

    /// From the middle of columns × rows to that of the window, texels along x and y.
    pub fn offset(&self, [width, height]: [usize; 2]) -> DVec2 {
        let middle =
            |range: &Range<usize>, whole: usize| (range.start + range.end) as f64 / 2.0 - whole as f64 / 2.0;
        DVec2::new(middle(&self.x, width), -middle(&self.y, height))
    }
}

/// A store whose samples are read window by window; the poses are in memory.
pub struct SampledStore {
    path: PathBuf,
    array: ZarrArray<4>,
    sigma: Option<ZarrArray<4>>,
    /// Texels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Edge of a texel, mm.
    pub texel_mm: f64,
    /// From the sample's centre to that of the store, texels along x and y.
    pub offset_texels: DVec2,
    /// Geometry a pose; nothing of it is NaN.
    pub poses: Vec<PoseGeometry>,
    /// The poses of which light, camera or weight are not known (NaN): their weight is 0.
    pub unknown_poses: Vec<usize>,
    /// Share of each pose's samples that are saturated in every exposure, where the store says so
    /// ([`CLIPPED_KEY`]).
    pub clipped: Option<Vec<f64>>,
    /// What the store says of its samples, where it does ([`SAMPLES_KEY`]).
    samples_sha256: Option<String>,
    /// Area of the lamp's aperture, mm², where the store says so ([`APERTURE_KEY`]).
    pub lamp_aperture_mm2: Option<f64>,
}

impl SampledStore {
    /// Opens a store that [`SampledSbrdf::write_zarr`] or another Zarr v3 writer made, compressed by zstd or
    /// gzip or not. A pose whose light or camera is not known (NaN) has the weight 0.
    ///
    /// # Errors
    /// Input errors for a folder that is no such store, whose shapes disagree or that lacks a chunk.
    pub fn open(path: &Path) -> Result<Self> {
        if !path.exists() {
            return Err(Error::input(format!("{}: there is no such store", path.display())));
        }
        if !path.join("zarr.json").is_file() {
            let message = "not a Zarr v3 store: it has no zarr.json";
            return Err(Error::input(format!("{}: {message}", path.display())));
        }
        open_store(path).map_err(|message| Error::input(format!("{}: {message}", path.display())))
    }

    /// Columns and rows of a chunk of the samples.
    pub fn block_size(&self) -> [usize; 2] {
        [self.array.chunk[1], self.array.chunk[0]]
    }

    /// The store's chunks as windows, row by row.
    pub fn blocks(&self) -> Vec<Window> {
        Window::blocks([self.width, self.height], self.block_size())
    }

    /// The parts of a window that lie in one chunk each, row by row.
    pub fn blocks_within(&self, window: &Window) -> Vec<Window> {
        let [columns, rows] = self.block_size();
        let parts = |range: &Range<usize>, edge: usize| -> Vec<Range<usize>> {
            let chunks = range.start / edge..range.end.div_ceil(edge);
            chunks.map(|k| (k * edge).max(range.start)..((k + 1) * edge).min(range.end)).collect()
        };
        let (xs, ys) = (parts(&window.x, columns), parts(&window.y, rows));
        ys.iter().flat_map(|y| xs.iter().map(|x| Window { x: x.clone(), y: y.clone() })).collect()
    }

    /// Whether the standard deviations of the samples are there.
    pub fn has_sigma(&self) -> bool {
        self.sigma.is_some()
    }

    /// Reads a window; its standard deviations, which make up a third of a store, only where asked for and
    /// there.
    ///
    /// # Errors
    /// When a chunk cannot be read or is no longer there.
    pub fn read(&self, window: &Window, sigma: bool) -> Result<SampledSbrdf> {
        let ranges = [window.y.clone(), window.x.clone(), 0..self.poses.len(), 0..3];
        let reading = |message| Error::input(format!("{}: {message}", self.path.display()));
        let reflectance = self.array.read(&ranges, |value| value as f32).map_err(reading)?;
        let sigma = self.sigma.as_ref().filter(|_| sigma);
        let sigma = sigma.map(|array| array.read(&ranges, f16::from_f64)).transpose().map_err(reading)?;
        Ok(SampledSbrdf {
            width: window.x.len(),
            height: window.y.len(),
            texel_mm: self.texel_mm,
            offset_texels: self.offset_texels + window.offset([self.width, self.height]),
            poses: self.poses.clone(),
            reflectance,
            sigma,
        })
    }

    /// What tells the samples from those of another store of the same size and poses, without reading them:
    /// the hash that Lobelia writes into its stores, and the lengths of the chunks' files, which in a
    /// compressed store change with what is in them.
    pub fn samples_mark(&self) -> String {
        let ranges = self.array.shape.map(|edge| 0..edge);
        let arrays = std::iter::once(&self.array).chain(&self.sigma);
        let lengths: Vec<String> =
            arrays.flat_map(|array| array.lengths(&ranges)).map(|length| length.to_string()).collect();
        format!("{} {}", self.samples_sha256.as_deref().unwrap_or("none"), lengths.join(" "))
    }

    /// Hash of all but the samples: size, texel and poses.
    pub fn geometry_sha256(&self) -> String {
        let numbers = [self.width as f64, self.height as f64, self.texel_mm].into_iter();
        let of = |pose: &PoseGeometry| {
            let (light, camera) = (pose.light_mm, pose.camera_mm);
            [light.x, light.y, light.z, camera.x, camera.y, camera.z, pose.weight]
        };
        // A whole sample's hash is that of numbers without an offset.
        let offset = self.offset_texels.to_array().into_iter().filter(|_| self.offset_texels != DVec2::ZERO);
        let numbers = numbers.chain(offset);
        let bytes: Vec<u8> =
            numbers.chain(self.poses.iter().flat_map(of)).flat_map(f64::to_le_bytes).collect();
        sha256(&bytes)
    }
}

fn write_store(
    sampled: &SampledSbrdf,
    path: &Path,
    more: &Attributes,
) -> std::result::Result<(), Box<dyn std::error::Error + Send + Sync>> {
    let store = Arc::new(FilesystemStore::new(path)?);
    let mut root = GroupBuilder::new().build(store.clone(), "/")?;
    let attributes = root.attributes_mut();
    attributes.insert(LAYOUT_KEY.into(), LAYOUT.into());
    attributes.insert("texel_mm".into(), sampled.texel_mm.into());
    attributes.insert("reflectance_unit".into(), "1/sr".into());
    attributes.insert(SAMPLES_KEY.into(), samples_sha256(sampled).into());
    if sampled.offset_texels != DVec2::ZERO {
        attributes.insert(OFFSET_KEY.into(), sampled.offset_texels.to_array().to_vec().into());
    }
    attributes.extend(more.iter().map(|(name, value)| (name.clone(), value.clone())));
    root.store_metadata()?;

    let poses = sampled.poses.len();
    let xyz = |get: fn(&PoseGeometry) -> DVec3| {
        sampled.poses.iter().flat_map(|pose| get(pose).to_array()).collect::<Vec<f64>>()
    };
    for (name, values) in
        [("light_position_mm", xyz(|pose| pose.light_mm)), ("camera_position_mm", xyz(|pose| pose.camera_mm))]
    {
        write_small(&store, name, &[poses, 3], &["pose", "xyz"], &values)?;
    }
    let weights: Vec<f64> = sampled.poses.iter().map(|pose| pose.weight).collect();
    write_small(&store, "weight", &[poses], &["pose"], &weights)?;

    let nan = FillValue::from(f32::NAN);
    write_samples(&store, "/reflectance", sampled, &sampled.reflectance, data_type::float32(), nan)?;
    if let Some(sigma) = &sampled.sigma {
        let nan = FillValue::from(f16::NAN);
        write_samples(&store, "/sigma", sampled, sigma, data_type::float16(), nan)?;
    }
    Ok(())
}

/// Hash of all samples and their standard deviations.
fn samples_sha256(sampled: &SampledSbrdf) -> String {
    const PIECE: usize = 1 << 20;
    let values = sampled.reflectance.par_chunks(PIECE).map(|piece| {
        let bytes: Vec<u8> = piece.iter().flat_map(|value| value.to_le_bytes()).collect();
        sha256(&bytes)
    });
    let sigmas = sampled.sigma.as_deref().unwrap_or_default().par_chunks(PIECE).map(|piece| {
        let bytes: Vec<u8> = piece.iter().flat_map(|value| value.to_le_bytes()).collect();
        sha256(&bytes)
    });
    sha256(values.chain(sigmas).collect::<Vec<String>>().concat().as_bytes())
}

/// Writes an array [y, x, pose, rgb].
fn write_samples<T: Element + Copy + Sync>(
    store: &Arc<FilesystemStore>,
    name: &str,
    sampled: &SampledSbrdf,
    values: &[T],
    of: DataType,
    fill: FillValue,
) -> std::result::Result<(), Box<dyn std::error::Error + Send + Sync>> {
    let poses = sampled.poses.len();
    let shape = [sampled.height, sampled.width, poses, 3].map(|n| n as u64);
    let chunk = [BLOCK, BLOCK, poses.max(1), 3].map(|n| n as u64);
    let array = ArrayBuilder::new(shape.to_vec(), chunk.to_vec(), of, fill)
        .dimension_names(["y", "x", "pose", "rgb"].into())
        .build(store.clone(), name)?;
    array.store_metadata()?;
    // A block of texels without any sample is written as well: a chunk that is not there counts as lost.
    let options = CodecOptions::default().with_store_empty_chunks(true);
    let rows: Vec<usize> = (0..sampled.height).step_by(BLOCK).collect();
    rows.into_par_iter().try_for_each(|row| {
        (0..sampled.width).step_by(BLOCK).try_for_each(|column| {
            let (bottom, right) = ((row + BLOCK).min(sampled.height), (column + BLOCK).min(sampled.width));
            let span = poses * 3;
            let mut block: Vec<T> = Vec::with_capacity((bottom - row) * (right - column) * span);
            for y in row..bottom {
                let line = y * sampled.width;
                block.extend_from_slice(&values[(line + column) * span..(line + right) * span]);
            }
            let subset = [row as u64..bottom as u64, column as u64..right as u64, 0..poses as u64, 0..3];
            array.store_array_subset_opt(&subset, block.as_slice(), &options)
        })
    })?;
    Ok(())
}

/// Writes a small f64 array as one chunk.
fn write_small(
    store: &Arc<FilesystemStore>,
    name: &str,
    shape: &[usize],
    dimensions: &[&str],
    values: &[f64],
) -> std::result::Result<(), Box<dyn std::error::Error + Send + Sync>> {
    let shape: Vec<u64> = shape.iter().map(|&n| n as u64).collect();
    let chunk: Vec<u64> = shape.iter().map(|&n| n.max(1)).collect();
    let array = ArrayBuilder::new(shape.clone(), chunk, data_type::float64(), FillValue::from(f64::NAN))
        .dimension_names(Some(dimensions.iter().copied()))
        .build(store.clone(), &format!("/{name}"))?;
    array.store_metadata()?;
    let subset: Vec<std::ops::Range<u64>> = shape.iter().map(|&n| 0..n).collect();
    array.store_array_subset(&subset, values)?;
    Ok(())
}

fn open_store(path: &Path) -> std::result::Result<SampledStore, String> {
    let root =
        fs::read(path.join("zarr.json")).map_err(|error| format!("zarr.json cannot be read: {error}"))?;
    let root: serde_json::Value =
        serde_json::from_slice(&root).map_err(|error| format!("zarr.json: {error}"))?;
    let attribute = |name: &str| root.get("attributes").and_then(|attributes| attributes.get(name));
    if attribute(LAYOUT_KEY).and_then(serde_json::Value::as_u64) != Some(LAYOUT) {
        return Err("not a sampled SBRDF of this version (attribute lobelia_layout is not 1)".into());
    }
    let texel_mm = attribute("texel_mm").and_then(serde_json::Value::as_f64);
    let texel_mm = texel_mm.filter(|edge| edge.is_finite() && *edge > 0.0);
    let texel_mm = texel_mm.ok_or("lacks the attribute texel_mm, a positive number")?;

    let offset_texels = match attribute(OFFSET_KEY) {
        None => DVec2::ZERO,
        Some(value) => serde_json::from_value::<[f64; 2]>(value.clone())
            .map(DVec2::from)
            .map_err(|_| format!("its attribute {OFFSET_KEY} is not two numbers"))?,
    };
    let array: ZarrArray<4> = ZarrArray::open(path, "reflectance")?;
    let [height, width, poses, colours] = array.shape;
    if colours != 3 || width == 0 || height == 0 {
        return Err(format!(
            "reflectance has the shape {:?}, must be [y, x, pose, 3] with a texel at least",
            array.shape
        ));
    }
    if array.shape.iter().try_fold(1usize, |count, &edge| count.checked_mul(edge)).is_none() {
        return Err(format!("reflectance has the shape {:?}, more than any store holds", array.shape));
    }
    let sigma = path.join("sigma").exists().then(|| ZarrArray::open(path, "sigma")).transpose()?;
    if sigma.as_ref().is_some_and(|sigma| sigma.shape != array.shape) {
        return Err("sigma has not the shape of reflectance".into());
    }
    for array in std::iter::once(&array).chain(&sigma) {
        array.chunks_are_there(&array.shape.map(|edge| 0..edge))?;
    }
    let light = read_small(path, "light_position_mm", [poses, 3])?;
    let camera = read_small(path, "camera_position_mm", [poses, 3])?;
    let weight = read_small(path, "weight", [poses])?;
    if let Some(pose) = weight.iter().position(|&weight| weight < 0.0 || weight.is_infinite()) {
        return Err(format!(
            "the weight of pose {pose} is {}; it must be a number of 0 or more",
            weight[pose]
        ));
    }
    let aperture = attribute(APERTURE_KEY).map(|value| {
        value.as_f64().filter(|area| area.is_finite() && *area > 0.0).ok_or_else(|| {
            format!("its attribute {APERTURE_KEY} is {value}, not an area above 0; correct it or delete it")
        })
    });
    let lamp_aperture_mm2 = aperture.transpose()?;
    let clipped = attribute(CLIPPED_KEY).map(|value| clipped_shares(value, poses)).transpose()?;
    let pose = |pose: usize| {
        let [light_mm, camera_mm] = [&light, &camera].map(|places| DVec3::from_slice(&places[3 * pose..]));
        PoseGeometry { light_mm, camera_mm, weight: weight[pose] }
    };
    let poses: Vec<PoseGeometry> = (0..poses).map(pose).collect();
    let unknown_poses = (0..poses.len()).filter(|&pose| !poses[pose].is_known()).collect();
    Ok(SampledStore {
        path: path.to_path_buf(),
        array,
        sigma,
        width,
        height,
        texel_mm,
        offset_texels,
        poses: poses.into_iter().map(PoseGeometry::known).collect(),
        unknown_poses,
        clipped,
        samples_sha256: attribute(SAMPLES_KEY).and_then(serde_json::Value::as_str).map(str::to_owned),
        lamp_aperture_mm2,
    })
}

/// The attribute with the share of the samples of each pose that are saturated in every exposure.
fn clipped_shares(value: &serde_json::Value, poses: usize) -> std::result::Result<Vec<f64>, String> {
    let shares: Option<Vec<f64>> = serde_json::from_value(value.clone()).ok();
    shares
        .filter(|shares| shares.len() == poses && shares.iter().all(|share| (0.0..=1.0).contains(share)))
        .ok_or_else(|| {
            format!(
                "its attribute {CLIPPED_KEY} is not a share of 0 to 1 for each of {poses} poses; correct it, \
                 or delete it, as where poses were taken out"
            )
        })
}

fn read_small<const N: usize>(
    path: &Path,
    name: &str,
    shape: [usize; N],
) -> std::result::Result<Vec<f64>, String> {
    let array: ZarrArray<N> = ZarrArray::open(path, name)?;
    if array.shape != shape {
        return Err(format!("{name} has the shape {:?}, must be {shape:?}", array.shape));
    }
    array.read(&shape.map(|edge| 0..edge), |value| value)
}

/// [`SampledStore::geometry_sha256`] of a folder; none where it holds no store.
pub fn geometry_sha256(folder: &Path) -> Option<String> {
    SampledStore::open(folder).ok().map(|store| store.geometry_sha256())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> SampledSbrdf {
        let poses = (0..5)
            .map(|k| PoseGeometry {
                light_mm: DVec3::new(f64::from(k), 2.0, 1000.0),
                camera_mm: DVec3::new(0.25, f64::from(k) * 0.1, 1050.0),
                weight: if k == 3 { 0.0 } else { 1.0 },
            })
            .collect();
        // Neither edge is a multiple of the chunk's.
        let mut sampled = SampledSbrdf::empty(19, 33, 0.5, poses);
        for (k, value) in sampled.reflectance.iter_mut().enumerate() {
            *value = k as f32 * 1e-3;
        }
        sampled
    }

    #[test]
    fn a_sampled_sbrdf_survives_its_store_and_replaces_an_older_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sampled.zarr");
        SampledSbrdf::empty(4, 4, 1.0, Vec::new()).write_zarr(&path).unwrap();
        example().write_zarr(&path).unwrap();
        assert_eq!(SampledSbrdf::read_zarr(&path).unwrap(), example());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn standard_deviations_are_kept_in_half_precision_and_a_lost_block_of_them_is_missed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sampled.zarr");
        let mut sampled = example();
        let deviations = sampled.reflectance.iter().map(|value| f16::from_f32(0.01 + 0.1 * value));
        sampled.sigma = Some(deviations.collect());
        sampled.write_zarr(&path).unwrap();
        assert_eq!(SampledSbrdf::read_zarr(&path).unwrap(), sampled);
        let store = SampledStore::open(&path).unwrap();
        let block = store.read(&Window { x: 16..19, y: 16..32 }, true).unwrap();
        assert!(block.sigmas(0).unwrap() == sampled.sigmas(16 * 19 + 16).unwrap());
        fs::remove_file(path.join("sigma/c/1/0/0/0")).unwrap();
        let lost = SampledSbrdf::read_zarr(&path).unwrap_err().to_string();
        assert!(lost.contains("sigma/c/1/0/0/0 is missing"), "{lost}");
    }

    #[test]
    fn the_blocks_of_a_store_make_up_the_whole_with_the_same_directions() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sampled.zarr");
        let whole = example();
        whole.write_zarr(&path).unwrap();
        let store = SampledStore::open(&path).unwrap();
        let blocks = store.blocks();
        assert_eq!((blocks.len(), blocks.iter().map(Window::texels).sum::<usize>()), (6, 19 * 33));
        for window in blocks {
            let block = store.read(&window, true).unwrap();
            for (k, (y, x)) in window.y.flat_map(|y| window.x.clone().map(move |x| (y, x))).enumerate() {
                let index = y * whole.width + x;
                assert!(block.samples(k).eq(whole.samples(index)));
                assert_eq!(block.directions(k, 2), whole.directions(index, 2));
            }
        }
    }

    #[test]
    fn a_part_of_a_sample_keeps_its_place_and_texts_their_words() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("part.zarr");
        let part = SampledSbrdf { offset_texels: DVec2::new(2.5, -1.0), ..example() };
        let texts = Attributes::from([("rig_toml".to_string(), "[camera]\n".into())]);
        part.write_zarr_with(&path, &texts).unwrap();
        assert_eq!(SampledSbrdf::read_zarr(&path).unwrap(), part);
        let root: serde_json::Value =
            serde_json::from_slice(&fs::read(path.join("zarr.json")).unwrap()).unwrap();
        assert_eq!(root["attributes"]["rig_toml"], "[camera]\n");
    }

    #[test]
    fn a_folder_that_is_no_store_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let error = SampledSbrdf::read_zarr(folder.path()).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains("zarr.json"));
    }

    #[test]
    fn a_block_without_any_sample_is_written_and_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sampled.zarr");
        let mut sampled = example();
        let first_rows = 16 * 19 * 5 * 3;
        sampled.reflectance[..first_rows].fill(f32::NAN);
        sampled.write_zarr(&path).unwrap();
        let read = SampledSbrdf::read_zarr(&path).unwrap();
        assert!(read.reflectance[..first_rows].iter().all(|value| value.is_nan()));
        assert_eq!(read.reflectance[first_rows..], sampled.reflectance[first_rows..]);
    }

    #[test]
    fn a_missing_chunk_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sampled.zarr");
        example().write_zarr(&path).unwrap();
        let store = SampledStore::open(&path).unwrap();
        fs::remove_file(path.join("reflectance/c/1/0/0/0")).unwrap();
        assert!(store.read(&Window { x: 0..16, y: 0..16 }, true).is_ok());
        let lost = store.read(&Window { x: 0..16, y: 8..24 }, true).unwrap_err().to_string();
        assert!(lost.contains("reflectance/c/1/0/0/0 is missing"), "{lost}");
        let text = SampledSbrdf::read_zarr(&path).unwrap_err().to_string();
        assert!(text.contains("reflectance/c/1/0/0/0"), "{text}");
    }

    /// Names that a writer might be tempted to use hold a user's own copies.
    #[test]
    fn what_lies_beside_or_in_a_store_is_never_removed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sampled.zarr");
        let others = ["sampled.zarr.old", "sampled.zarr.tmp"].map(|name| folder.path().join(name));
        for other in &others {
            example().write_zarr(other).unwrap();
            fs::write(other.join("notes.txt"), "mine").unwrap();
        }
        for _ in 0..2 {
            example().write_zarr(&path).unwrap();
            assert!(others.iter().all(|other| SampledSbrdf::read_zarr(other).unwrap() == example()));
            assert!(others.iter().all(|other| other.join("notes.txt").is_file()));
            assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 3);
        }
        let refused = example().write_zarr(&others[0]).unwrap_err();
        assert!(refused.exit_code() == 2 && refused.to_string().contains("notes.txt"), "{refused}");
    }

    #[test]
    fn a_folder_of_something_else_is_never_replaced() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("thesis.txt"), "years of work").unwrap();
        assert_eq!(example().write_zarr(folder.path()).unwrap_err().exit_code(), 2);
        assert!(folder.path().join("thesis.txt").is_file());
    }

    fn case(name: &str) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/cases/zarr").join(name)
    }

    #[test]
    fn a_pose_whose_light_is_not_known_has_no_weight_and_nothing_of_it_is_nan() {
        let store = SampledStore::open(&case("light-nan.zarr")).unwrap();
        let without: Vec<usize> = (0..store.poses.len()).filter(|&k| store.poses[k].weight == 0.0).collect();
        assert_eq!((without.len(), &store.unknown_poses), (1, &without));
        assert!(store.poses.iter().all(|pose| pose.light_mm.is_finite() && pose.camera_mm.is_finite()));
    }

    #[test]
    fn stores_without_texels_and_stores_that_are_not_there_are_refused() {
        for (path, part) in
            [(case("width0.zarr"), "a texel at least"), (PathBuf::from("no.zarr"), "there is no such store")]
        {
            let error = SampledStore::open(&path).map(|_| ()).unwrap_err();
            assert!(error.exit_code() == 2 && error.to_string().contains(part), "{error}");
        }
    }

    #[test]
    fn the_shares_of_clipped_samples_are_read_back_and_wrong_ones_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sampled.zarr");
        let write = |shares: serde_json::Value| {
            let more = Attributes::from([(CLIPPED_KEY.to_string(), shares)]);
            example().write_zarr_with(&path, &more).unwrap();
            SampledStore::open(&path).map(|store| store.clipped)
        };
        let shares = [0.0, 0.57, 0.0, 1.0, 0.25];
        assert_eq!(write(shares.to_vec().into()).unwrap(), Some(shares.to_vec()));
        for wrong in [vec![0.0; 4], vec![2.0; 5]] {
            let error = write(wrong.into()).unwrap_err();
            let text = error.to_string();
            assert!(text.contains(CLIPPED_KEY) && text.contains("delete it"), "{text}");
            assert_eq!(error.exit_code(), 2);
        }
        example().write_zarr(&path).unwrap();
        assert_eq!(SampledStore::open(&path).unwrap().clipped, None);
    }

    #[test]
    fn a_missing_array_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sampled.zarr");
        example().write_zarr(&path).unwrap();
        fs::remove_dir_all(path.join("weight")).unwrap();
        assert_eq!(SampledSbrdf::read_zarr(&path).unwrap_err().exit_code(), 2);
    }
}
