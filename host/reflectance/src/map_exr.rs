//! SBRDF maps as OpenEXR files: one named f32 channel a coefficient, text attributes for units and
//! provenance, and R, G, B for programs that show pictures.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;

use exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image, Layer, LayerAttributes,
    LineOrder, SmallVec, Text, WritableImage, attribute::AttributeValue, f16,
};
use glam::{Vec2, Vec3};

use lobelia_base::durable;

use crate::{FormatError, LobePlane, MicrofacetPlane, Rgb, SbrdfMap, exr_file};

/// Attributes that every map carries.
const UNITS: [(&str, &str); 3] = [
    (
        "lobelia:units",
        "rho_d, lobeN.rho_s: 1/sr; beta: rad; normal, C, n, n_grazing, f0, f90, alpha: none; reflectance \
         excludes the cosine",
    ),
    (
        "lobelia:model",
        "rho_d + sum rho_s max(0, (R(-beta) C R(beta) wi).wo)^n, wi and wo in the frame of the normal, n to \
         n_grazing as (cos_i + cos_o)/2 falls + sum ggx: Schlick(f0, f90) D(alpha) G / (4 cos_i cos_o)",
    ),
    ("lobelia:preview", "R, G, B: the albedo for light along the normal, to be looked at; not read"),
];
/// How many lobes and microfacet terms the file has: one that was lost on the way is missed.
const COUNTS: [&str; 2] = ["lobelia:lobes", "lobelia:ggx"];
/// The channels that are there to be looked at.
const PREVIEW: [&str; 3] = ["R", "G", "B"];

/// How the pixels of a map's file lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum MapEncoding {
    /// Tiles of run lengths: written and read fastest.
    #[default]
    Tiles,
    /// Lines, deflated (ZIP): what every program that reads OpenEXR opens, and smaller.
    Scanlines,
}

/// Names the error of the exr crate by what it means for the caller.
fn exr_error(path: &Path, error: exr::error::Error) -> FormatError {
    match error {
        exr::error::Error::Io(error) => FormatError::Io(error),
        other => FormatError::Invalid(format!("{}: cannot be written as OpenEXR: {other}", path.display())),
    }
}

/// Gives all coefficients by the names of their channels, then the further planes, one plane at a time.
fn planes(
    map: &SbrdfMap,
    mut give: impl FnMut(&str, Vec<f32>) -> Result<(), FormatError>,
) -> Result<(), FormatError> {
    let mut vectors = |prefix: &str, names: [&str; 3], vectors: &[Vec3]| {
        (names.iter().enumerate()).try_for_each(|(k, name)| {
            give(&format!("{prefix}.{name}"), vectors.iter().map(|v| v[k]).collect())
        })
    };
    vectors("rho_d", ["R", "G", "B"], &map.rho_d)?;
    for (j, lobe) in map.lobes.iter().enumerate() {
        vectors(&format!("lobe{j}.rho_s"), ["R", "G", "B"], &lobe.rho_s)?;
        vectors(&format!("lobe{j}.C"), ["x", "y", "z"], &lobe.c)?;
    }
    for (j, coat) in map.microfacets.iter().enumerate() {
        vectors(&format!("ggx{j}.f0"), ["R", "G", "B"], &coat.f0)?;
        vectors(&format!("ggx{j}.f90"), ["R", "G", "B"], &coat.f90)?;
    }
    give("beta", map.beta.clone())?;
    for (axis, name) in ["normal.x", "normal.y"].into_iter().enumerate().filter(|_| !map.normal.is_empty()) {
        give(name, map.normal.iter().map(|normal| normal[axis]).collect())?;
    }
    for (j, lobe) in map.lobes.iter().enumerate() {
        give(&format!("lobe{j}.n"), lobe.n.clone())?;
        if !lobe.n_grazing.is_empty() {
            give(&format!("lobe{j}.n_grazing"), lobe.n_grazing.clone())?;
        }
    }
    for (j, coat) in map.microfacets.iter().enumerate() {
        give(&format!("ggx{j}.alpha"), coat.alpha.clone())?;
    }
    map.extra.iter().try_for_each(|(name, plane)| give(name, plane.clone()))
}

/// Albedo of texel `index` for light along the normal: π ρ_d + Σ ρ_s C_zⁿ 2π / (n + 2) + Σ f0, exact where
/// lobes stand about the surface's normal.
fn preview(map: &SbrdfMap, index: usize) -> Rgb {
    let lobe = |plane: &LobePlane| {
        let (c, n) = (plane.c[index].z.max(0.0), plane.n[index]);
        plane.rho_s[index] * (c.powf(n) * std::f32::consts::TAU / (n + 2.0))
    };
    let lobes: Rgb = map.lobes.iter().map(lobe).sum();
    let coats: Rgb = map.microfacets.iter().map(|plane| plane.f0[index]).sum();
    let albedo = std::f32::consts::PI * map.rho_d[index] + lobes + coats;
    // Half precision ends at 65504, and a picture has no NaN.
    albedo.map(|x| if x.is_nan() { 0.0 } else { x.clamp(0.0, 65504.0) })
}

/// Text as OpenEXR files hold it everywhere: what is not ASCII is escaped.
fn text(value: &str) -> AttributeValue {
    let escape = |c: char| if c.is_ascii() { c.to_string() } else { c.escape_unicode().to_string() };
    AttributeValue::Text(Text::from(value.chars().map(escape).collect::<String>().as_str()))
}

/// See [`SbrdfMap::write_exr`].
pub(crate) fn write(map: &SbrdfMap, path: &Path, encoding: MapEncoding) -> Result<(), FormatError> {
    let mut channels: SmallVec<[AnyChannel<FlatSamples>; 4]> = SmallVec::new();
    planes(map, |name, plane| {
        let name = Text::new_or_none(name).ok_or_else(|| {
            FormatError::Invalid(format!("{}: no channel of OpenEXR can be named `{name}`", path.display()))
        })?;
        channels.push(AnyChannel::new(name, FlatSamples::F32(plane)));
        Ok(())
    })?;
    let shown: Vec<Rgb> = (0..map.width * map.height).map(|index| preview(map, index)).collect();
    for (k, name) in PREVIEW.into_iter().enumerate() {
        let plane = shown.iter().map(|colour| f16::from_f32(colour[k])).collect();
        channels.push(AnyChannel::new(name, FlatSamples::F16(plane)));
    }
    let mut attributes = LayerAttributes::named("sbrdf");
    let counts = [map.lobes.len(), map.microfacets.len()].map(|count| count.to_string());
    let texts = map.attributes.iter().map(|(name, value)| (name.as_str(), value.as_str())).chain(UNITS);
    for (name, value) in texts.chain(COUNTS.into_iter().zip(counts.iter().map(String::as_str))) {
        attributes.other.insert(Text::from(name), text(value));
    }
    // Tiles in order: unordered ones are written as the threads that compress them end, other bytes each
    // time.
    let encoding = match encoding {
        MapEncoding::Tiles => Encoding { line_order: LineOrder::Increasing, ..Encoding::FAST_LOSSLESS },
        MapEncoding::Scanlines => Encoding {
            compression: Compression::ZIP16,
            blocks: Blocks::ScanLines,
            line_order: LineOrder::Increasing,
        },
    };
    let layer = Layer::new((map.width, map.height), attributes, encoding, AnyChannels::sort(channels));

    let mut bytes = Cursor::new(Vec::new());
    Image::from_layer(layer).write().to_buffered(&mut bytes).map_err(|error| exr_error(path, error))?;
    let mut bytes = bytes.into_inner();
    sort_attributes(&mut bytes);
    Ok(durable::write(path, |writer| writer.write_all(&bytes))?)
}

/// Sorts the header's attributes by name: the exr crate writes them in the order of a hash map, which differs
/// from process to process. Their order means nothing and their length stays, so all offsets hold.
fn sort_attributes(bytes: &mut [u8]) -> Option<()> {
    /// Length of the magic number and the version before the attributes, which a zero byte ends.
    const START: usize = 8;
    let mut place = START;
    let mut attributes: Vec<Vec<u8>> = Vec::new();
    while *bytes.get(place)? != 0 {
        let begin = place;
        // Name and type, each ended by a zero byte, the value's size, the value.
        for _ in 0..2 {
            place += bytes.get(place..)?.iter().position(|&byte| byte == 0)? + 1;
        }
        let size = bytes.get(place..)?.first_chunk::<4>()?;
        place += 4 + u32::from_le_bytes(*size) as usize;
        attributes.push(bytes.get(begin..place)?.to_vec());
    }
    attributes.sort();
    bytes[START..place].copy_from_slice(&attributes.concat());
    Some(())
}

/// What a channel's values may be.
#[derive(Clone, Copy, PartialEq)]
enum Range {
    Finite,
    NotNegative,
    Positive,
}

impl Range {
    /// Of a channel by its name: albedos and exponents are not negative, the width of a microfacet term is
    /// positive.
    fn of(name: &str) -> Self {
        let last = name.split('.').skip(1).collect::<Vec<_>>();
        let coefficient = numbered(name, "lobe").is_some() || numbered(name, "ggx").is_some();
        match last.first().copied() {
            Some("alpha") if coefficient => Self::Positive,
            Some("rho_s" | "n" | "n_grazing" | "f0" | "f90") if coefficient => Self::NotNegative,
            _ if name.starts_with("rho_d.") => Self::NotNegative,
            _ => Self::Finite,
        }
    }

    fn holds(self, value: f32) -> bool {
        value.is_finite()
            && match self {
                Self::Finite => true,
                Self::NotNegative => value >= 0.0,
                Self::Positive => value > 0.0,
            }
    }

    fn words(self) -> &'static str {
        match self {
            Self::Finite => "it must be a finite number",
            Self::NotNegative => "it must be a finite number and not negative",
            Self::Positive => "it must be a finite number above 0",
        }
    }
}

/// The number in a channel's name that starts with `lobe3.` or `ggx0.`.
fn numbered(name: &str, prefix: &str) -> Option<usize> {
    let (number, _) = name.strip_prefix(prefix)?.split_once('.')?;
    number.parse().ok()
}

/// Refuses a value that a coefficient cannot have, by its channel and texel.
fn check_plane(name: &str, plane: &[f32], width: usize) -> Result<(), FormatError> {
    let range = Range::of(name);
    match plane.iter().position(|&value| !range.holds(value)) {
        None => Ok(()),
        Some(index) => Err(FormatError::Invalid(format!(
            "channel {name} is {} at texel ({}, {}); {}",
            plane[index],
            index % width,
            index / width,
            range.words()
        ))),
    }
}

/// Refuses normals that are longer than a unit vector.
fn check_normals(normals: &[Vec2], width: usize) -> Result<(), FormatError> {
    match normals.iter().position(|normal| normal.length_squared() >= 1.0) {
        None => Ok(()),
        Some(index) => Err(FormatError::Invalid(format!(
            "channels normal.x and normal.y are {} at texel ({}, {}); they must be those of a unit vector",
            normals[index],
            index % width,
            index / width
        ))),
    }
}

/// See [`SbrdfMap::check`].
pub(crate) fn check(map: &SbrdfMap) -> Result<(), FormatError> {
    planes(map, |name, plane| check_plane(name, &plane, map.width))?;
    check_normals(&map.normal, map.width)
}

/// See [`crate::LobeBrdf::check`].
pub(crate) fn check_one(brdf: &crate::LobeBrdf) -> Result<(), FormatError> {
    let map = SbrdfMap::from_texels(1, 1, std::slice::from_ref(brdf));
    planes(&map, |name, plane| {
        let range = Range::of(name);
        if range.holds(plane[0]) {
            return Ok(());
        }
        Err(FormatError::Invalid(format!("{name} is {}; {}", plane[0], range.words())))
    })?;
    check_normals(&map.normal, 1)
}

/// See [`SbrdfMap::read_exr`].
pub(crate) fn read(path: &Path) -> Result<SbrdfMap, FormatError> {
    let all = |names: &[&str]| {
        let is_map = names.contains(&"rho_d.R");
        is_map.then(|| {
            names.iter().filter(|name| !PREVIEW.contains(name)).map(|name| name.to_string()).collect()
        })
    };
    let layer = exr_file::read(path, "channel rho_d.R, which an SBRDF map has", all)?;
    let place = |error: FormatError| FormatError::Invalid(format!("{}: {error}", path.display()));
    assemble(layer).map_err(place)
}

/// The map of a file's channels and attributes.
fn assemble(layer: exr_file::ExrLayer) -> Result<SbrdfMap, FormatError> {
    let exr_file::ExrLayer { width, height, channels: mut planes, mut texts, .. } = layer;
    planes.iter().try_for_each(|(name, plane)| check_plane(name, plane, width))?;
    let mut map = SbrdfMap { width, height, ..SbrdfMap::default() };
    let mut count = |key: &str, prefix: &str| {
        // A deviation of a lobe tells of the lobe too.
        let bare = planes.keys().map(|name| name.strip_prefix("sigma.").unwrap_or(name));
        let named = bare.filter_map(|name| numbered(name, prefix)).max().map_or(0, |last| last + 1);
        texts.remove(key).and_then(|count| count.parse().ok()).unwrap_or(named).max(named)
    };
    let (lobes, coats) = (count(COUNTS[0], "lobe"), count(COUNTS[1], "ggx"));
    map.rho_d = take_vectors(&mut planes, "rho_d", ["R", "G", "B"])?;
    let beta = planes.remove("beta");
    let has_sigma = planes.contains_key("sigma.beta");
    if planes.contains_key("normal.x") || planes.contains_key("normal.y") {
        let (x, y) = (take(&mut planes, "normal.x")?, take(&mut planes, "normal.y")?);
        map.normal = x.into_iter().zip(y).map(|(x, y)| Vec2::new(x, y)).collect();
        check_normals(&map.normal, width)?;
    }
    for j in 0..lobes {
        map.lobes.push(LobePlane {
            rho_s: take_vectors(&mut planes, &format!("lobe{j}.rho_s"), ["R", "G", "B"])?,
            c: take_vectors(&mut planes, &format!("lobe{j}.C"), ["x", "y", "z"])?,
            n: take(&mut planes, &format!("lobe{j}.n"))?,
            n_grazing: planes.remove(&format!("lobe{j}.n_grazing")).unwrap_or_default(),
        });
    }
    // Lobes that are round about the normal need no direction.
    let turned = map.lobes.iter().any(|lobe| lobe.c.iter().any(|c| c.x != c.y));
    map.beta = match beta {
        Some(beta) => beta,
        None if has_sigma || turned => take(&mut planes, "beta")?,
        None => vec![0.0; width * height],
    };
    for j in 0..coats {
        map.microfacets.push(MicrofacetPlane {
            f0: take_vectors(&mut planes, &format!("ggx{j}.f0"), ["R", "G", "B"])?,
            f90: take_vectors(&mut planes, &format!("ggx{j}.f90"), ["R", "G", "B"])?,
            alpha: take(&mut planes, &format!("ggx{j}.alpha"))?,
        });
    }
    map.extra = planes;
    map.attributes = texts;
    map.attributes.retain(|name, _| !UNITS.iter().any(|(unit, _)| unit == name));
    Ok(map)
}

/// Removes one plane by name.
fn take(planes: &mut BTreeMap<String, Vec<f32>>, name: &str) -> Result<Vec<f32>, FormatError> {
    planes
        .remove(name)
        .ok_or_else(|| FormatError::Invalid(format!("it has no channel {name}, which this SBRDF map needs")))
}

/// Joins three planes named `prefix.component` into vectors.
fn take_vectors(
    planes: &mut BTreeMap<String, Vec<f32>>,
    prefix: &str,
    names: [&str; 3],
) -> Result<Vec<Vec3>, FormatError> {
    let mut parts = Vec::with_capacity(3);
    for name in names {
        parts.push(take(planes, &format!("{prefix}.{name}"))?);
    }
    Ok((0..parts[0].len()).map(|i| Vec3::new(parts[0][i], parts[1][i], parts[2][i])).collect())
}

#[cfg(test)]
mod tests {
    use exr::prelude::{Blocks, Compression};
    use glam::Vec2;

    use super::MapEncoding;
    use crate::{Microfacet, Rgb, SbrdfMap, materials};

    fn example() -> SbrdfMap {
        let mut texels: Vec<_> =
            materials::NAMES.iter().map(|name| materials::published(name).unwrap().rotated(0.3)).collect();
        texels[2].normal = Vec2::new(0.1, -0.02);
        texels[2].lobes[1].n_grazing = Some(70.0);
        texels[1].microfacets.push(Microfacet { f0: Rgb::splat(0.04), f90: Rgb::ONE, alpha: 0.1 });
        let mut map = SbrdfMap::from_texels(3, 2, &texels);
        map.extra.insert("error.rms".into(), vec![0.25; 6]);
        map.attributes.insert("lobelia:source".into(), "published lobes".into());
        map
    }

    #[test]
    fn a_map_survives_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.exr");
        example().write_exr(&path).unwrap();
        assert_eq!(SbrdfMap::read_exr(&path).unwrap(), example());
    }

    #[test]
    fn a_map_of_many_tiles_has_the_same_bytes_each_time() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.exr");
        let clay = materials::published("clay").unwrap();
        let mut map = SbrdfMap::from_texels(300, 200, &vec![clay; 60_000]);
        // Some tiles take long to compress, some do not.
        map.beta
            .iter_mut()
            .enumerate()
            .for_each(|(k, beta)| *beta = if k % 300 < 100 { k as f32 } else { 0.0 });
        let write = || {
            map.write_exr(&path).unwrap();
            std::fs::read(&path).unwrap()
        };
        let first = write();
        assert!((0..4).all(|_| write() == first));
    }

    /// An example that was damaged in memory, written and read again; and what its own check says.
    fn refusals(damage: impl Fn(&mut SbrdfMap)) -> [String; 2] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.exr");
        let mut map = example();
        damage(&mut map);
        map.write_exr(&path).unwrap();
        let read = SbrdfMap::read_exr(&path).unwrap_err().to_string();
        assert!(read.matches("map.exr").count() == 1, "{read}");
        [read, map.check().unwrap_err().to_string()]
    }

    #[test]
    fn a_coefficient_that_no_reflectance_has_is_refused_with_its_channel_and_texel() {
        type Fault = (&'static str, fn(&mut SbrdfMap));
        let cases: [Fault; 9] = [
            ("lobe0.n is NaN", |map| map.lobes[0].n[4] = f32::NAN),
            ("lobe0.n is -3", |map| map.lobes[0].n[4] = -3.0),
            ("lobe1.n_grazing is -1", |map| map.lobes[1].n_grazing[4] = -1.0),
            ("lobe2.rho_s.G is -0.5", |map| map.lobes[2].rho_s[4].y = -0.5),
            ("rho_d.B is -0.01", |map| map.rho_d[4].z = -0.01),
            ("ggx0.alpha is 0", |map| map.microfacets[0].alpha[4] = 0.0),
            ("ggx0.f90.R is -1", |map| map.microfacets[0].f90[4].x = -1.0),
            ("error.rms is inf", |map| map.extra.get_mut("error.rms").unwrap()[4] = f32::INFINITY),
            ("normal.x and normal.y are [0.8, 0.7]", |map| map.normal[4] = Vec2::new(0.8, 0.7)),
        ];
        for (part, damage) in cases {
            for text in refusals(damage) {
                assert!(text.contains(part) && text.contains("(1, 1)"), "{text} lacks {part}");
            }
        }
    }

    /// A map's file without one of its channels, as a program that cannot hold them all would store it.
    fn without(removed: &str) -> String {
        read_without(&example(), removed).unwrap_err().to_string()
    }

    fn read_without(map: &SbrdfMap, removed: &str) -> Result<SbrdfMap, crate::FormatError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.exr");
        map.write_exr(&path).unwrap();
        let mut image = exr::prelude::read_first_flat_layer_from_file(&path).unwrap();
        let list = &mut image.layer_data.channel_data.list;
        list.retain(|channel| !channel.name.to_string().starts_with(removed));
        exr::prelude::WritableImage::write(&image).to_file(&path).unwrap();
        SbrdfMap::read_exr(&path)
    }

    /// Turned by 0 where nothing is said is right for lobes round about the normal alone.
    #[test]
    fn a_map_that_lost_the_direction_of_its_lobes_is_refused_where_it_needs_one() {
        let mut round = example();
        round.lobes.iter_mut().for_each(|lobe| lobe.c.iter_mut().for_each(|c| c.y = c.x));
        round.beta.fill(0.0);
        assert_eq!(read_without(&round, "beta").unwrap(), round);
        let (mut turned, mut fitted) = (round.clone(), round);
        turned.lobes[1].c[4].y *= 0.5;
        fitted.extra.insert("sigma.beta".into(), vec![0.1; 6]);
        for map in [turned, fitted] {
            let text = read_without(&map, "beta").unwrap_err().to_string();
            assert!(text.contains("no channel beta,"), "{text}");
        }
    }

    #[test]
    fn a_map_that_lost_a_channel_or_a_whole_lobe_is_refused_with_the_channel() {
        for (removed, named) in [
            ("lobe0", "lobe0.rho_s.R"),
            ("lobe0.n", "lobe0.n"),
            ("lobe8", "lobe8.rho_s.R"),
            ("lobe1.C.y", "lobe1.C.y"),
            ("ggx0", "ggx0.f0.R"),
            ("normal.y", "normal.y"),
            ("rho_d.G", "rho_d.G"),
        ] {
            let text = without(removed);
            assert!(text.contains(&format!("no channel {named},")), "{text}");
        }
        let cases = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/cases/map");
        for (name, part) in [("lobe0-removed.exr", "no channel lobe0.rho_s.R"), ("negative-n.exr", ".n is -")]
        {
            let text = SbrdfMap::read_exr(&cases.join(name)).unwrap_err().to_string();
            assert!(text.contains(part) && text.contains(name), "{text}");
        }
    }

    #[test]
    fn programs_that_show_pictures_find_the_albedo_in_r_g_and_b_and_short_names() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.exr");
        example().write_exr_as(&path, MapEncoding::Scanlines).unwrap();
        assert_eq!(SbrdfMap::read_exr(&path).unwrap(), example());
        let image = exr::prelude::read_first_flat_layer_from_file(&path).unwrap();
        let encoding = image.layer_data.encoding;
        assert!(encoding.compression == Compression::ZIP16 && encoding.blocks == Blocks::ScanLines);
        let channels = &image.layer_data.channel_data.list;
        let plane = |name: &str| {
            let channel = channels.iter().find(|channel| channel.name.to_string() == name).unwrap();
            channel.sample_data.values_as_f32().collect::<Vec<_>>()
        };
        // Clay has no tilted lobe: the sum over the hemisphere of its reflectance for light along the normal.
        let albedo = crate::albedo::directional(&example().texel(0), glam::Vec3::Z);
        for (name, expected) in ["R", "G", "B"].into_iter().zip(albedo.to_array()) {
            assert!((plane(name)[0] / expected - 1.0).abs() < 2e-3, "{name}: {} {expected}", plane(name)[0]);
        }
        let names = channels.iter().map(|channel| channel.name.to_string());
        let attributes = image.layer_data.attributes.other.keys().map(ToString::to_string);
        for name in names.chain(attributes) {
            assert!(name.len() <= 31, "{name} is too long for programs that know short names alone");
        }
    }

    #[test]
    fn attributes_beyond_ascii_are_escaped_and_not_lost() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.exr");
        let mut map = example();
        map.attributes.insert("made.command".into(), "fit Größe.zarr".into());
        map.write_exr(&path).unwrap();
        let read = SbrdfMap::read_exr(&path).unwrap();
        assert_eq!(read.attributes["made.command"], r"fit Gr\u{f6}\u{df}e.zarr");
    }

    #[test]
    fn a_file_that_is_no_map_is_refused_with_a_sentence_and_its_channels() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.exr");
        std::fs::write(&path, b"not an image").unwrap();
        assert!(SbrdfMap::read_exr(&path).unwrap_err().to_string().contains("not a readable OpenEXR"));
        exr::prelude::write_rgb_file(&path, 4, 2, |_, _| (0.0f32, 1.0f32, 2.0f32)).unwrap();
        let text = SbrdfMap::read_exr(&path).unwrap_err().to_string();
        assert!(text.contains("no channel rho_d.R") && text.contains("B, G, R"), "{text}");
        let text = SbrdfMap::read_exr(&folder.path().join("none.exr")).unwrap_err().to_string();
        assert!(text.contains("none.exr: cannot be read"), "{text}");
    }
}
