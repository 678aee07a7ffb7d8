//! Fits sampled SBRDFs that are larger than memory, and fits them in parts on as many machines as there are.
//!
//! A store is read block by block ([`SampledStore::blocks`]); at any time as many blocks are in memory as
//! twice the number of threads. Part i of n is a run of consecutive blocks. Its fit is a shard: an SBRDF map
//! of one row with the part's texels in order of blocks, whose attributes say what it was made from and how.
//! Texels are fitted one by one whatever is read with them, so the joined shards are the same, byte for byte,
//! as one run.

use std::ops::Range;
use std::path::Path;

use rayon::prelude::*;

use super::weights::Weights;
use super::{FitOptions, fit_window, has_samples};
use lobelia_base::error::{Error, Result};
use lobelia_base::hash::sha256;
use lobelia_base::progress;
use lobelia_reflectance::mip;
use lobelia_reflectance::sampled::{SampledSbrdf, SampledStore, Window};
use lobelia_reflectance::warning::samples::Tally;
use lobelia_reflectance::{MIRROR_SOLID_ANGLE, SbrdfMap};

/// Part `index` (from 1) of `count`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Part {
    /// 1 to `count`.
    pub index: usize,
    /// Number of parts.
    pub count: usize,
}

impl std::fmt::Display for Part {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

impl std::str::FromStr for Part {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let numbers = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match numbers {
            Some((index, count)) if (1..=count).contains(&index) => Ok(Self { index, count }),
            _ => Err("must be I/N with I from 1 to N, such as 2/8".into()),
        }
    }
}

impl Part {
    /// The part's blocks of `blocks`.
    fn range(self, blocks: usize) -> Range<usize> {
        (self.index - 1) * blocks / self.count..self.index * blocks / self.count
    }
}

/// Attributes of a shard.
const PART: &str = "shard.part";
const GEOMETRY: &str = "shard.geometry_sha256";
const SAMPLES: &str = "shard.samples_sha256";
const STORE: &str = "shard.store_sha256";
const OPTIONS: &str = "shard.options";
const SIZE: &str = "shard.size";

/// Fits a whole store with bounded memory: the map of [`super::fit_sbrdf`].
///
/// # Errors
/// As there; and when a chunk cannot be read.
pub fn fit_store(store: &SampledStore, options: &FitOptions) -> Result<SbrdfMap> {
    fit_level(store, options, 0)
}

/// As [`fit_store`]; each block of samples that was read is counted.
///
/// # Errors
/// As there.
pub fn fit_store_counted(store: &SampledStore, options: &FitOptions, tally: &Tally) -> Result<SbrdfMap> {
    fit_level_counted(store, options, 0, Some(tally))
}

/// Fits a MIP level of a store to the averaged samples of its texels ([`mip`]); level 0 is the store itself.
///
/// # Errors
/// As [`fit_store`].
pub fn fit_level(store: &SampledStore, options: &FitOptions, level: u32) -> Result<SbrdfMap> {
    fit_level_counted(store, options, level, None)
}

/// Fits all MIP levels of a store but the finest, one after another; each names the finest that it belongs
/// to.
pub fn fit_levels(
    store: &SampledStore,
    options: &FitOptions,
    finest: &SbrdfMap,
) -> impl Iterator<Item = Result<(u32, SbrdfMap)>> {
    let of = mip::fingerprint(finest);
    (1..=mip::last([store.width, store.height])).map(move |level| {
        let mut map = fit_level(store, options, level)?;
        map.attributes.insert(mip::OF.into(), of.clone());
        Ok((level, map))
    })
}

fn fit_level_counted(
    store: &SampledStore,
    options: &FitOptions,
    level: u32,
    tally: Option<&Tally>,
) -> Result<SbrdfMap> {
    options.check()?;
    let size = mip::size([store.width, store.height], level);
    let blocks = Window::blocks(size, store.block_size());
    let read = |window: &Window| mip::read(store, level, window, options.weights == Weights::Sigma);
    let count = |sampled: &SampledSbrdf| {
        tally.iter().for_each(|tally| tally.count(sampled));
        String::new()
    };
    let row = fit_blocks(options, &blocks, read, count)?.0;
    let mut map = laid_out(size, &blocks, &[&row]);
    has_samples(&map)?;
    if level > 0 {
        map.attributes.insert("mip.level".into(), level.to_string());
    }
    tell_lamp(store, &mut map);
    Ok(map)
}

/// Adds the solid angle of the lamp to a map in which a mirror was met, where the store knows the lamp: the
/// mean over its poses at the sample's centre.
fn tell_lamp(store: &SampledStore, map: &mut SbrdfMap) {
    let Some(aperture) = store.lamp_aperture_mm2.filter(|_| map.extra.contains_key("mirror.R")) else {
        return;
    };
    let poses = store.poses.iter().filter(|pose| pose.weight > 0.0);
    let angles: Vec<f64> = poses.map(|pose| aperture / pose.light_mm.length_squared()).collect();
    let mean = angles.iter().sum::<f64>() / angles.len().max(1) as f64;
    if mean > 0.0 {
        map.attributes.insert(MIRROR_SOLID_ANGLE.into(), mean.to_string());
    }
}

/// Fits a part of a store into a shard; its samples are counted.
///
/// # Errors
/// As [`fit_store`]; and when there are more parts than blocks.
pub fn fit_part(store: &SampledStore, options: &FitOptions, part: Part, tally: &Tally) -> Result<SbrdfMap> {
    options.check()?;
    let blocks = blocks_of(store, part)?;
    let read = |window: &Window| store.read(window, options.weights == Weights::Sigma);
    let counted_hash = |sampled: &SampledSbrdf| {
        tally.count(sampled);
        hash(sampled)
    };
    let (mut shard, samples) = fit_blocks(options, &blocks, read, counted_hash)?;
    let [columns, rows] = store.block_size();
    for (key, value) in [
        (PART, part.to_string()),
        (GEOMETRY, store.geometry_sha256()),
        (SAMPLES, samples),
        (STORE, of_store(store)?),
        (OPTIONS, options_text(options)),
        (SIZE, format!("{} {} {columns} {rows}", store.width, store.height)),
    ] {
        shard.attributes.insert(key.into(), value);
    }
    Ok(shard)
}

/// Whether the shard at `path` is that of this part, these options and this store: then there is nothing left
/// to do. Reads the part's samples, fits nothing.
///
/// # Errors
/// Input errors when the file is no shard, or one of something else; the sentence says of what.
pub fn is_done(path: &Path, store: &SampledStore, options: &FitOptions, part: Part) -> Result<()> {
    let shard = read_shard(path)?;
    let wrong = |what: &str| {
        let advice = "remove it to fit it again, or name another output";
        Error::input(format!("{}: this shard {what}; {advice}", path.display()))
    };
    if shard.attributes[PART] != part.to_string() {
        return Err(wrong(&format!("is {}, not {part}", shard.attributes[PART])));
    }
    if shard.attributes[OPTIONS] != options_text(options) {
        return Err(wrong("was fitted with other options or by another version"));
    }
    if !fits_samples(&shard, store, part)? {
        let what = "was fitted to other samples: the sampled SBRDF has changed since, or the poses held out";
        return Err(wrong(what));
    }
    Ok(())
}

/// Refuses a shard that was fitted with other options.
///
/// # Errors
/// Input errors when the file is no shard, or one of other options.
pub fn same_options(path: &Path, options: &FitOptions) -> Result<()> {
    if read_shard(path)?.attributes[OPTIONS] == options_text(options) {
        return Ok(());
    }
    let message = "was fitted with other options or by another version; name those of the parts, so that all \
         levels are fitted alike";
    Err(Error::input(format!("{}: this shard {message}", path.display())))
}

/// Joins all shards of a fit into its map. With a store, the shards are checked against its samples.
///
/// # Errors
/// Input errors that name the file that is no shard or does not belong to the others, or the shard that is
/// missing.
pub fn merge(paths: &[impl AsRef<Path>], store: Option<&SampledStore>) -> Result<SbrdfMap> {
    let mut shards = Vec::with_capacity(paths.len());
    for path in paths {
        shards.push((path.as_ref(), read_shard(path.as_ref())?));
    }
    let Some((first_path, first)) = shards.first() else {
        return Err(Error::input("no shard was named"));
    };
    let count = part_of(first_path, first)?.count;
    let mut parts: Vec<Option<usize>> = vec![None; count];
    for (place, (path, shard)) in shards.iter().enumerate() {
        belongs(&shards[0], &shards[place])?;
        let part = part_of(path, shard)?;
        if let Some(other) = parts[part.index - 1].replace(place) {
            let other = shards[other].0.display();
            return Err(Error::input(format!("{other} and {} are both shard {part}", path.display())));
        }
        if let Some(store) = store
            && !fits_samples(shard, store, part)?
        {
            let message = "was fitted to other samples than the sampled SBRDF holds, or with other poses \
                 held out; fit it again, or give --hold-out-poses and --seed as for the parts";
            return Err(Error::input(format!("{}: shard {part} {message}", path.display())));
        }
    }
    let missing =
        (0..count).filter(|&k| parts[k].is_none()).map(|k| Part { index: k + 1, count }.to_string());
    let missing: Vec<String> = missing.collect();
    if !missing.is_empty() {
        return Err(Error::input(format!("not all shards are there; missing: {}", missing.join(", "))));
    }
    let in_order: Vec<&SbrdfMap> = parts.iter().flatten().map(|&place| &shards[place].1).collect();
    join(&in_order)
        .ok_or_else(|| Error::input(format!("{}: the shard's size is damaged", first_path.display())))
        .and_then(|map| has_samples(&map).map(|()| map))
}

/// Refuses a shard that is not of the same fit as the first.
fn belongs(first: &(&Path, SbrdfMap), other: &(&Path, SbrdfMap)) -> Result<()> {
    let names = format!("{} and {}", first.0.display(), other.0.display());
    let different = |what: &str| Error::input(format!("{names} were fitted with different {what}"));
    let [a, b] = [first, other].map(|(path, shard)| part_of(path, shard));
    if a?.count != b?.count {
        return Err(different("numbers of shards"));
    }
    for (key, what) in
        [(OPTIONS, "options or versions"), (GEOMETRY, "poses"), (SIZE, "sizes"), (STORE, "samples")]
    {
        if first.1.attributes.get(key) != other.1.attributes.get(key) {
            return Err(different(what));
        }
    }
    Ok(())
}

/// The shards, in order and complete, as one map; none when the texels are not as many as the size says.
fn join(shards: &[&SbrdfMap]) -> Option<SbrdfMap> {
    let numbers: Vec<usize> =
        shards[0].attributes[SIZE].split(' ').filter_map(|number| number.parse().ok()).collect();
    let &[width, height, columns, rows] = numbers.as_slice() else { return None };
    if columns * rows == 0 || width * height != shards.iter().map(|shard| shard.width).sum::<usize>() {
        return None;
    }
    let mut map = laid_out([width, height], &Window::blocks([width, height], [columns, rows]), shards);
    map.attributes.retain(|name, _| !name.starts_with("shard."));
    Some(map)
}

fn options_text(options: &FitOptions) -> String {
    format!("lobelia {}: {options:?}", env!("CARGO_PKG_VERSION"))
}

fn blocks_of(store: &SampledStore, part: Part) -> Result<Vec<Window>> {
    let mut blocks = store.blocks();
    if part.count > blocks.len() {
        let chunks = progress::counted(blocks.len() as u64, "chunk", "chunks");
        let message = format!("{} parts were asked for; the store has {chunks}", part.count);
        return Err(Error::input(format!("{message}, of which each part takes at least one")));
    }
    let range = part.range(blocks.len());
    blocks.truncate(range.end);
    Ok(blocks.split_off(range.start))
}

/// Reads a shard.
fn read_shard(path: &Path) -> Result<SbrdfMap> {
    let shard = SbrdfMap::read_exr(path).map_err(|error| Error::reading(path, error))?;
    if [PART, GEOMETRY, SAMPLES, OPTIONS, SIZE].iter().any(|&key| !shard.attributes.contains_key(key)) {
        let message = "no shard of a fit, as `lobelia fit --chunks I/N` writes them";
        return Err(Error::input(format!("{}: {message}", path.display())));
    }
    part_of(path, &shard)?;
    Ok(shard)
}

fn part_of(path: &Path, shard: &SbrdfMap) -> Result<Part> {
    shard.attributes[PART].parse().map_err(|what| Error::input(format!("{}: {PART} {what}", path.display())))
}

/// Whether the samples of a part of the store are those that the shard was fitted to.
fn fits_samples(shard: &SbrdfMap, store: &SampledStore, part: Part) -> Result<bool> {
    if shard.attributes[GEOMETRY] != store.geometry_sha256() {
        return Ok(false);
    }
    let sigma = shard.attributes.get("fit.weights").is_some_and(|weights| weights == Weights::Sigma.name());
    let mut hashes = String::new();
    for window in blocks_of(store, part)? {
        hashes += &hash(&store.read(&window, sigma)?);
    }
    Ok(shard.attributes[SAMPLES] == sha256(hashes.as_bytes()))
}

/// What tells the samples of a whole store from those of another one of the same size and poses: what the
/// store says of them, and a hash of its first chunk, the middle one and the last, since one of all would
/// have each part read all.
fn of_store(store: &SampledStore) -> Result<String> {
    let blocks = store.blocks();
    let mut places = vec![0, blocks.len() / 2, blocks.len().saturating_sub(1)];
    places.dedup();
    let mut hashes = store.samples_mark();
    for window in places.into_iter().filter_map(|place| blocks.get(place)) {
        hashes += &hash(&store.read(window, true)?);
    }
    Ok(sha256(hashes.as_bytes()))
}

/// Hash of all values that were read.
fn hash(sampled: &SampledSbrdf) -> String {
    let mut hash = sha256(bytemuck::cast_slice(&sampled.reflectance));
    if let Some(sigma) = &sampled.sigma {
        let bytes: Vec<u8> = sigma.iter().flat_map(|value| value.to_le_bytes()).collect();
        hash += &sha256(&bytes);
    }
    hash
}

/// Fits blocks, a few at a time, into a map of one row; and the hash of their samples, each block's by
/// `hash`, which sees every block once.
fn fit_blocks(
    options: &FitOptions,
    blocks: &[Window],
    read: impl Fn(&Window) -> Result<SampledSbrdf> + Sync,
    hash: impl Fn(&SampledSbrdf) -> String + Sync,
) -> Result<(SbrdfMap, String)> {
    let texels: usize = blocks.iter().map(Window::texels).sum();
    let bar = progress::bar("fitting", texels as u64, "texels");
    let mut row = SbrdfMap::new(texels, 1, 0);
    let (mut first, mut hashes) = (0, String::new());
    for group in blocks.chunks(2 * rayon::current_num_threads()) {
        let fits: Vec<Result<(SbrdfMap, String)>> = (group.par_iter())
            .map(|window| {
                let sampled = read(window)?;
                Ok((fit_window(&sampled, options, || bar.advance(1))?, hash(&sampled)))
            })
            .collect();
        for fit in fits {
            let (map, hash) = fit?;
            let count = map.width * map.height;
            paste(&mut row, &map, &(first..first + count).collect::<Vec<_>>());
            first += count;
            hashes += &hash;
        }
    }
    Ok((row, sha256(hashes.as_bytes())))
}

/// Rows of texels in order of blocks, laid out as the image that the blocks make up.
pub(super) fn laid_out([width, height]: [usize; 2], blocks: &[Window], rows: &[&SbrdfMap]) -> SbrdfMap {
    let mut places = blocks
        .iter()
        .flat_map(|block| block.y.clone().flat_map(|y| block.x.clone().map(move |x| y * width + x)));
    let mut map = SbrdfMap::new(width, height, 0);
    for row in rows {
        let places: Vec<usize> = places.by_ref().take(row.width).collect();
        paste(&mut map, row, &places);
    }
    map
}

/// Sets the texels of `map` at `places` to those of `piece`, and takes its attributes. Lobes and planes that
/// the map lacks are added, black elsewhere.
fn paste(map: &mut SbrdfMap, piece: &SbrdfMap, places: &[usize]) {
    fn scatter<T: Copy>(into: &mut [T], from: &[T], places: &[usize]) {
        places.iter().zip(from).for_each(|(&place, &value)| into[place] = value);
    }
    let texels = map.width * map.height;
    while map.lobes.len() < piece.lobes.len() {
        map.lobes.append(&mut SbrdfMap::new(map.width, map.height, 1).lobes);
    }
    scatter(&mut map.rho_d, &piece.rho_d, places);
    scatter(&mut map.beta, &piece.beta, places);
    for (into, from) in map.lobes.iter_mut().zip(&piece.lobes) {
        scatter(&mut into.rho_s, &from.rho_s, places);
        scatter(&mut into.c, &from.c, places);
        scatter(&mut into.n, &from.n, places);
        if into.n_grazing.is_empty() && !from.n_grazing.is_empty() {
            into.n_grazing.clone_from(&into.n);
        }
        let grazing = if from.n_grazing.is_empty() { &from.n } else { &from.n_grazing };
        if !into.n_grazing.is_empty() {
            scatter(&mut into.n_grazing, grazing, places);
        }
    }
    map.add_microfacets(piece.microfacets.len());
    for (into, from) in map.microfacets.iter_mut().zip(&piece.microfacets) {
        scatter(&mut into.f0, &from.f0, places);
        scatter(&mut into.f90, &from.f90, places);
        scatter(&mut into.alpha, &from.alpha, places);
    }
    if map.normal.is_empty() && !piece.normal.is_empty() {
        map.normal = vec![glam::Vec2::ZERO; texels];
    }
    if !piece.normal.is_empty() {
        scatter(&mut map.normal, &piece.normal, places);
    }
    for (name, plane) in &piece.extra {
        scatter(map.extra.entry(name.clone()).or_insert_with(|| vec![0.0; texels]), plane, places);
    }
    map.attributes.extend(piece.attributes.iter().map(|(name, value)| (name.clone(), value.clone())));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::fit_sbrdf;
    use glam::DVec3;
    use lobelia_reflectance::sampled::PoseGeometry;

    /// 40 × 20 texels at 24 poses: a lobe that changes from texel to texel, a corner block without samples.
    fn sampled() -> SampledSbrdf {
        let poses = (0..24).map(|k| {
            let angle = f64::from(k) * 0.7;
            PoseGeometry {
                light_mm: DVec3::new(300.0 * angle.cos(), 300.0 * angle.sin(), 500.0),
                camera_mm: DVec3::new(-20.0 * f64::from(k), 50.0, 600.0),
                weight: 1.0,
            }
        });
        let mut sampled = SampledSbrdf::empty(40, 20, 1.0, poses.collect());
        for index in 0..sampled.texels() {
            if index % 40 >= 32 && index / 40 >= 16 {
                continue;
            }
            for pose in 0..24 {
                let (wi, wo) = sampled.directions(index, pose);
                let base = wi.z * wo.z - wi.x * wo.x - wi.y * wo.y;
                let value = 0.1 + 0.5 * base.max(0.0).powf(5.0 + index as f32 * 0.05);
                let place = (index * 24 + pose) * 3;
                sampled.reflectance[place..place + 3].copy_from_slice(&[value, 0.5 * value, 0.1]);
            }
        }
        sampled
    }

    struct Case {
        folder: tempfile::TempDir,
        store: SampledStore,
        shards: Vec<std::path::PathBuf>,
    }

    const OPTIONS_OF_CASE: FitOptions = FitOptions {
        choose: false,
        lobes: 1,
        method: crate::fit::Method::Separable,
        isotropic: true,
        separate_channels: false,
        diffuse: crate::fit::Diffuse::Joint,
        residual: crate::fit::Residual::Proportional,
        weights: Weights::Pose,
        robust: false,
        device: crate::fit::Device::Cpu,
        bound: crate::fit::AlbedoBound::Bounded,
        extensions: crate::fit::extensions::Extensions {
            normals: false,
            sharpening: false,
            microfacets: crate::fit::extensions::Microfacets::Never,
        },
    };

    /// A store of six blocks and the shards of its fit in `count` parts.
    fn case(count: usize) -> Case {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.zarr");
        sampled().write_zarr(&path).unwrap();
        let store = SampledStore::open(&path).unwrap();
        let write = |index: usize| {
            let shard = fit_part(&store, &OPTIONS_OF_CASE, Part { index, count }, &Tally::default()).unwrap();
            let path = folder.path().join(format!("shard{index}.exr"));
            shard.write_exr(&path).unwrap();
            path
        };
        let shards = (1..=count).map(write).collect();
        Case { folder, store, shards }
    }

    #[test]
    fn blocks_and_merged_shards_give_the_map_of_one_run_in_memory() {
        let whole = fit_sbrdf(&sampled(), &OPTIONS_OF_CASE).unwrap();
        let Case { folder: _folder, store, mut shards } = case(4);
        assert!(fit_store(&store, &OPTIONS_OF_CASE).unwrap() == whole);
        shards.rotate_left(1);
        assert!(merge(&shards, None).unwrap() == whole);
        assert!(merge(&shards, Some(&store)).unwrap() == whole);
    }

    #[test]
    fn pieces_with_and_without_what_goes_beyond_lobes_make_one_map() {
        use lobelia_reflectance::{Microfacet, Rgb, materials};
        let plain = materials::published("clay").unwrap();
        let coat = Microfacet { f0: Rgb::splat(0.04), f90: Rgb::ONE, alpha: 0.2 };
        let mut beyond = plain.clone();
        beyond.normal = glam::Vec2::new(0.1, 0.0);
        beyond.microfacets.push(coat);
        beyond.lobes[0].n_grazing = Some(50.0);
        let texels = [plain.clone(), beyond, plain];
        for order in [[0, 1, 2], [1, 0, 2]] {
            let mut map = SbrdfMap::new(3, 1, 0);
            for place in order {
                paste(&mut map, &SbrdfMap::from_texels(1, 1, &texels[place..=place]), &[place]);
            }
            assert!(map == SbrdfMap::from_texels(3, 1, &texels));
        }
    }

    #[test]
    fn a_level_is_fitted_to_the_mean_reflectance_of_its_texels() {
        let Case { folder: _folder, store, .. } = case(1);
        let map = fit_level(&store, &OPTIONS_OF_CASE, 2).unwrap();
        assert_eq!((map.width, map.height, map.attributes["mip.level"].as_str()), (10, 5, "2"));
        let (fine, poses) = (sampled(), 24);
        let coarse = mip::read(&store, 2, &Window { x: 0..10, y: 0..5 }, false).unwrap();
        // The texels of (3, 1) are rows 4 to 7 and columns 12 to 15.
        for pose in 0..poses {
            let texels = (4..8).flat_map(|y| (12..16).map(move |x| y * 40 + x));
            let mean = texels.map(|k| fine.samples(k).nth(pose).unwrap().x).sum::<f32>() / 16.0;
            let (wi, wo) = coarse.directions(13, pose);
            let fitted = map.eval(13, wi, wo).x;
            assert!((fitted / mean - 1.0).abs() < 0.02, "pose {pose}: {fitted} {mean}");
        }
        assert_eq!(map.extra["samples"][4 * 10 + 9], 0.0);
    }

    #[test]
    fn missing_double_and_foreign_shards_are_named() {
        let Case { folder, store, shards } = case(3);
        let refused = |paths: &[std::path::PathBuf]| {
            let error = merge(paths, None).unwrap_err();
            assert_eq!(error.exit_code(), 2);
            error.to_string()
        };
        assert!(refused(&shards[..1]).contains("missing: 2/3, 3/3"));
        let double = [shards[0].clone(), shards[1].clone(), shards[1].clone()];
        assert!(refused(&double).contains("are both shard 2/3"));
        let other = folder.path().join("other.exr");
        let more = FitOptions { lobes: 0, ..OPTIONS_OF_CASE };
        fit_part(&store, &more, Part { index: 3, count: 3 }, &Tally::default())
            .unwrap()
            .write_exr(&other)
            .unwrap();
        assert!(
            refused(&[shards[0].clone(), shards[1].clone(), other.clone()]).contains("different options")
        );
        fit_part(&store, &OPTIONS_OF_CASE, Part { index: 2, count: 2 }, &Tally::default())
            .unwrap()
            .write_exr(&other)
            .unwrap();
        assert!(refused(&[shards[0].clone(), other.clone()]).contains("numbers of shards"));
        // Another store of the same size, poses and directions: half of the map would be twice as bright.
        let mut brighter = sampled();
        brighter.reflectance.iter_mut().for_each(|value| *value *= 2.0);
        let path = folder.path().join("brighter.zarr");
        brighter.write_zarr(&path).unwrap();
        let brighter = SampledStore::open(&path).unwrap();
        fit_part(&brighter, &OPTIONS_OF_CASE, Part { index: 3, count: 3 }, &Tally::default())
            .unwrap()
            .write_exr(&other)
            .unwrap();
        assert!(
            refused(&[shards[0].clone(), shards[1].clone(), other.clone()]).contains("different samples")
        );
        // One that differs in a single sample of a chunk that is neither the first, the middle nor the last.
        let mut nudged = sampled();
        nudged.reflectance[(35 * 24 + 3) * 3] += 0.01;
        nudged.write_zarr(&path).unwrap();
        let nudged = SampledStore::open(&path).unwrap();
        fit_part(&nudged, &OPTIONS_OF_CASE, Part { index: 3, count: 3 }, &Tally::default())
            .unwrap()
            .write_exr(&other)
            .unwrap();
        assert!(
            refused(&[shards[0].clone(), shards[1].clone(), other.clone()]).contains("different samples")
        );
        fit_store(&store, &OPTIONS_OF_CASE).unwrap().write_exr(&other).unwrap();
        assert!(refused(&[other]).contains("no shard of a fit"));
        let many =
            fit_part(&store, &OPTIONS_OF_CASE, Part { index: 1, count: 7 }, &Tally::default()).unwrap_err();
        assert!(many.to_string().contains("6 chunks"), "{many}");
    }

    #[test]
    fn a_shard_is_done_until_its_samples_or_the_options_change() {
        let Case { folder, store, shards } = case(3);
        let part = |index| Part { index, count: 3 };
        is_done(&shards[1], &store, &OPTIONS_OF_CASE, part(2)).unwrap();
        let says = |store: &SampledStore, options: &FitOptions, index: usize| {
            is_done(&shards[1], store, options, part(index)).unwrap_err().to_string()
        };
        assert!(says(&store, &OPTIONS_OF_CASE, 1).contains("is 2/3, not 1/3"));
        assert!(says(&store, &FitOptions { lobes: 0, ..OPTIONS_OF_CASE }, 2).contains("other options"));
        // A sample of the third block, which is part 2's.
        let mut changed = sampled();
        changed.reflectance[(35 * 24 + 3) * 3] += 0.01;
        let path = folder.path().join("changed.zarr");
        changed.write_zarr(&path).unwrap();
        let changed = SampledStore::open(&path).unwrap();
        assert!(says(&changed, &OPTIONS_OF_CASE, 2).contains("has changed since"));
        is_done(&shards[2], &changed, &OPTIONS_OF_CASE, part(3)).unwrap();
        let merged = merge(&shards, Some(&changed)).unwrap_err().to_string();
        assert!(merged.contains("shard2.exr: shard 2/3 was fitted to other samples"), "{merged}");
    }

    #[test]
    fn parts_are_read_from_text_and_cover_all_blocks_once() {
        assert_eq!("2/8".parse(), Ok(Part { index: 2, count: 8 }));
        for wrong in ["0/3", "4/3", "1", "a/b", "1/0"] {
            assert!(wrong.parse::<Part>().is_err(), "{wrong}");
        }
        let ranges: Vec<usize> = (1..=5).flat_map(|index| Part { index, count: 5 }.range(13)).collect();
        assert_eq!(ranges, (0..13).collect::<Vec<_>>());
    }
}
