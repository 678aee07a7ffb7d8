//! SBRDF maps as OpenEXR files: one named f32 channel a coefficient, text attributes for units and provenance.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;

use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, LineOrder, SmallVec, Text,
    WritableImage, attribute::AttributeValue, read_first_flat_layer_from_file,
};
use glam::{Vec2, Vec3};

use crate::{FormatError, LobePlane, MicrofacetPlane, SbrdfMap, durable};

/// Attributes that every map carries.
const UNITS: [(&str, &str); 2] = [
    (
        "lobelia:units",
        "rho_d, lobeN.rho_s: 1/sr; beta: rad; normal, C, n, n_grazing, f0, f90, alpha: none; reflectance excludes the cosine",
    ),
    (
        "lobelia:model",
        "rho_d + sum rho_s max(0, (R(-beta) C R(beta) wi).wo)^n, wi and wo in the frame of the normal, n to n_grazing as (cos_i + cos_o)/2 falls + sum ggx: Schlick(f0, f90) D(alpha) G / (4 cos_i cos_o)",
    ),
];

/// Names the error of the exr crate by what it means for the caller.
fn exr_error(path: &Path, error: exr::error::Error) -> FormatError {
    match error {
        exr::error::Error::Io(error) => FormatError::Io(error),
        other => FormatError::Invalid(format!("{}: not a readable OpenEXR file: {other}", path.display())),
    }
}

/// See [`SbrdfMap::write_exr`].
pub(crate) fn write(map: &SbrdfMap, path: &Path) -> Result<(), FormatError> {
    let mut planes: Vec<(String, Vec<f32>)> = Vec::new();
    push_vectors(&mut planes, "rho_d", ["R", "G", "B"], &map.rho_d);
    planes.push(("beta".into(), map.beta.clone()));
    for (axis, name) in ["normal.x", "normal.y"].into_iter().enumerate().filter(|_| !map.normal.is_empty()) {
        planes.push((name.into(), map.normal.iter().map(|normal| normal[axis]).collect()));
    }
    for (j, lobe) in map.lobes.iter().enumerate() {
        push_vectors(&mut planes, &format!("lobe{j}.rho_s"), ["R", "G", "B"], &lobe.rho_s);
        push_vectors(&mut planes, &format!("lobe{j}.C"), ["x", "y", "z"], &lobe.c);
        planes.push((format!("lobe{j}.n"), lobe.n.clone()));
        if !lobe.n_grazing.is_empty() {
            planes.push((format!("lobe{j}.n_grazing"), lobe.n_grazing.clone()));
        }
    }
    for (j, coat) in map.microfacets.iter().enumerate() {
        push_vectors(&mut planes, &format!("ggx{j}.f0"), ["R", "G", "B"], &coat.f0);
        push_vectors(&mut planes, &format!("ggx{j}.f90"), ["R", "G", "B"], &coat.f90);
        planes.push((format!("ggx{j}.alpha"), coat.alpha.clone()));
    }
    planes.extend(map.extra.iter().map(|(name, plane)| (name.clone(), plane.clone())));

    let channels: SmallVec<[AnyChannel<FlatSamples>; 4]> = planes
        .into_iter()
        .map(|(name, plane)| AnyChannel::new(Text::new_or_panic(name), FlatSamples::F32(plane)))
        .collect();
    let mut attributes = LayerAttributes::named("sbrdf");
    let texts = map.attributes.iter().map(|(name, value)| (name.as_str(), value.as_str())).chain(UNITS);
    for (name, value) in texts {
        attributes.other.insert(
            Text::from(name),
            AttributeValue::Text(Text::new_or_none(value).unwrap_or_else(|| Text::from("not printable"))),
        );
    }
    // Tiles in order: unordered ones are written as the threads that compress them end, other bytes each time.
    let encoding = Encoding { line_order: LineOrder::Increasing, ..Encoding::FAST_LOSSLESS };
    let layer = Layer::new((map.width, map.height), attributes, encoding, AnyChannels::sort(channels));

    let mut bytes = Cursor::new(Vec::new());
    Image::from_layer(layer).write().to_buffered(&mut bytes).map_err(|error| exr_error(path, error))?;
    let mut bytes = bytes.into_inner();
    sort_attributes(&mut bytes);
    Ok(durable::write(path, |writer| writer.write_all(&bytes))?)
}

/// Sorts the header's attributes by name: the exr crate writes them in the order of a hash map, which differs from
/// process to process. Their order means nothing and their length stays, so all offsets hold.
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

/// Splits vectors into three planes named `prefix.component`.
fn push_vectors(planes: &mut Vec<(String, Vec<f32>)>, prefix: &str, names: [&str; 3], vectors: &[Vec3]) {
    for (k, name) in names.iter().enumerate() {
        planes.push((format!("{prefix}.{name}"), vectors.iter().map(|v| v[k]).collect()));
    }
}

/// See [`SbrdfMap::read_exr`].
pub(crate) fn read(path: &Path) -> Result<SbrdfMap, FormatError> {
    let image = read_first_flat_layer_from_file(path).map_err(|error| exr_error(path, error))?;
    let (width, height) = (image.layer_data.size.0, image.layer_data.size.1);
    let mut planes: BTreeMap<String, Vec<f32>> = image
        .layer_data
        .channel_data
        .list
        .iter()
        .map(|channel| (channel.name.to_string(), channel.sample_data.values_as_f32().collect()))
        .collect();
    for (name, plane) in &planes {
        if let Some(index) = plane.iter().position(|value| !value.is_finite()) {
            let (x, y) = (index % width, index / width);
            let message =
                format!("{}: channel {name} is {} at texel ({x}, {y})", path.display(), plane[index]);
            return Err(FormatError::Invalid(message));
        }
    }

    let mut map = SbrdfMap { width, height, ..SbrdfMap::default() };
    map.rho_d = take_vectors(&mut planes, "rho_d", ["R", "G", "B"], path)?;
    map.beta = planes.remove("beta").unwrap_or_else(|| vec![0.0; width * height]);
    if planes.contains_key("normal.x") {
        let (x, y) = (take(&mut planes, "normal.x", path)?, take(&mut planes, "normal.y", path)?);
        map.normal = x.into_iter().zip(y).map(|(x, y)| Vec2::new(x, y)).collect();
    }
    while planes.contains_key(&format!("lobe{}.n", map.lobes.len())) {
        let j = map.lobes.len();
        map.lobes.push(LobePlane {
            rho_s: take_vectors(&mut planes, &format!("lobe{j}.rho_s"), ["R", "G", "B"], path)?,
            c: take_vectors(&mut planes, &format!("lobe{j}.C"), ["x", "y", "z"], path)?,
            n: take(&mut planes, &format!("lobe{j}.n"), path)?,
            n_grazing: planes.remove(&format!("lobe{j}.n_grazing")).unwrap_or_default(),
        });
    }
    while planes.contains_key(&format!("ggx{}.alpha", map.microfacets.len())) {
        let j = map.microfacets.len();
        map.microfacets.push(MicrofacetPlane {
            f0: take_vectors(&mut planes, &format!("ggx{j}.f0"), ["R", "G", "B"], path)?,
            f90: take_vectors(&mut planes, &format!("ggx{j}.f90"), ["R", "G", "B"], path)?,
            alpha: take(&mut planes, &format!("ggx{j}.alpha"), path)?,
        });
    }
    map.extra = planes;
    for (name, value) in &image.layer_data.attributes.other {
        if let AttributeValue::Text(text) = value {
            map.attributes.insert(name.to_string(), text.to_string());
        }
    }
    map.attributes.retain(|name, _| !UNITS.iter().any(|(unit, _)| unit == name));
    Ok(map)
}

/// Removes one plane by name.
fn take(planes: &mut BTreeMap<String, Vec<f32>>, name: &str, path: &Path) -> Result<Vec<f32>, FormatError> {
    planes.remove(name).ok_or_else(|| {
        FormatError::Invalid(format!("{}: not an SBRDF map: it has no channel {name}", path.display()))
    })
}

/// Joins three planes named `prefix.component` into vectors.
fn take_vectors(
    planes: &mut BTreeMap<String, Vec<f32>>,
    prefix: &str,
    names: [&str; 3],
    path: &Path,
) -> Result<Vec<Vec3>, FormatError> {
    let mut parts = Vec::with_capacity(3);
    for name in names {
        parts.push(take(planes, &format!("{prefix}.{name}"), path)?);
    }
    Ok((0..parts[0].len()).map(|i| Vec3::new(parts[0][i], parts[1][i], parts[2][i])).collect())
}

#[cfg(test)]
mod tests {
    use glam::Vec2;

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

    #[test]
    fn a_texel_that_is_not_a_number_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.exr");
        let mut map = example();
        map.lobes[0].n[4] = f32::NAN;
        map.write_exr(&path).unwrap();
        let text = SbrdfMap::read_exr(&path).unwrap_err().to_string();
        assert!(text.contains("lobe0.n") && text.contains("(1, 1)"), "{text}");
    }

    #[test]
    fn a_file_that_is_no_map_is_refused_with_a_sentence() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.exr");
        std::fs::write(&path, b"not an image").unwrap();
        assert!(SbrdfMap::read_exr(&path).unwrap_err().to_string().contains("not a readable OpenEXR"));
    }
}
