//! What is baked: the prefiltered maps, a part each. They depend on the environment's pixels, not on its
//! turn, on the range of the lobes' exponents and on the maps' error; the scene's meshes, lights and views
//! may change.
//!
//! A part's content, little-endian: whether the map is of D(N), of S, or both (1, 2, 3, u32), its exponent
//! (f32), width and height (u32), then red, green and blue of every pixel (f32).

use std::collections::BTreeMap;

use super::horizon;
use super::prefilter::{Plan, Wanted};
use super::{Coats, Materials, Prefiltered, Settings, gpu};
use crate::render::bake::{Bake, Baked, Made, MadeOf, Part};
use crate::scene::{Environment, Scene, hash};
use lobelia_base::error::{Error, Result};
use lobelia_gpu::Gpu;
use lobelia_reflectance::Rgb;

/// Raised when parts change.
const VERSION: u32 = 1;
/// Bytes before a map's pixels, and of one.
const HEAD: usize = 16;
const PIXEL: usize = 12;

/// The least and the largest exponent that the lobes of some materials ask for.
pub(super) fn range(materials: &Materials, settings: &Settings) -> (f32, f32) {
    let coats = (!materials.microfacets.is_empty()).then(Coats::table);
    let of_coats = coats.into_iter().flat_map(|table| {
        materials.microfacets.values().flatten().flat_map(|coat| table.exponents(coat.alpha))
    });
    let exponents = materials.lobes.iter().flat_map(|lobe| [lobe.n, lobe.n_grazing]).chain(of_coats);
    let (low, high) = exponents.fold((f32::INFINITY, 0.0f32), |(a, b), n| (a.min(n), b.max(n)));
    match (low <= high, settings.horizon) {
        (false, _) => (1.0, 1.0),
        (true, false) => (low, high),
        (true, true) => (low, high.max(horizon::widest_clipped(high))),
    }
}

/// A GPU that is to prefilter: a software driver would take far longer than the CPU's own way.
pub(super) fn in_hardware(gpu: Option<&Gpu>) -> Option<&Gpu> {
    gpu.filter(|gpu| !gpu.is_software())
}

/// What the maps of a scene depend on; nothing without an environment.
pub(super) fn made_of(settings: &Settings, scene: &Scene) -> Result<Option<MadeOf>> {
    scene.check()?;
    settings.check()?;
    let Some(environment) = &scene.environment else { return Ok(None) };
    let (low, high) = range(&Materials::new(scene), settings);
    let Settings { encoding, map_error, gpu, .. } = *settings;
    let by = if gpu { ", on the GPU" } else { "" };
    Ok(Some(MadeOf {
        method: "environment".into(),
        version: VERSION,
        settings: format!("{}, map error {map_error}{by}", encoding.option().0),
        of: BTreeMap::from([
            ("the environment".into(), hash::environment(environment)),
            ("the range of exponents".into(), format!("{low} to {high}")),
        ]),
    }))
}

/// The maps to be made.
struct Work {
    plan: Plan,
    gpu: Option<Gpu>,
}

/// The work of baking a scene's maps; none without an environment.
pub(super) fn work<'a>(settings: &Settings, scene: &Scene) -> Result<Option<Box<dyn Bake + 'a>>> {
    scene.check()?;
    settings.check()?;
    let Some(environment) = &scene.environment else { return Ok(None) };
    let gpu = settings.gpu.then(Gpu::open).transpose()?;
    let Settings { encoding, map_error, .. } = *settings;
    let range = range(&Materials::new(scene), settings);
    Ok(Some(Box::new(Work { plan: Plan::new(environment, range, encoding, map_error), gpu })))
}

impl Bake for Work {
    fn parts(&self) -> Vec<Part> {
        let part = |wanted: &Wanted| {
            let (rows, pixels) = (wanted.height as f64, 2 * wanted.height * wanted.height);
            // Rows times the square of a band that grows with them.
            Part { work: rows.powi(3), bytes: (HEAD + PIXEL * pixels) as u64, needs: 0..0 }
        };
        self.plan.maps.iter().map(part).collect()
    }

    fn part(&self, index: usize, _: &Baked) -> Result<Made> {
        let gpu = in_hardware(self.gpu.as_ref()).map(gpu::Prefilter::new).transpose()?;
        let map = self.plan.map(index, gpu.as_ref())?;
        Ok(Made { content: content(&self.plan.maps[index], &map), rays: 0 })
    }
}

fn content(wanted: &Wanted, map: &Environment) -> Vec<u8> {
    let [diffuse, lobes] = wanted.roles.map(u32::from);
    let mut content = Vec::with_capacity(HEAD + PIXEL * map.pixels.len());
    content.extend((diffuse | lobes << 1).to_le_bytes());
    content.extend(wanted.n.to_le_bytes());
    content.extend((map.width as u32).to_le_bytes());
    content.extend((map.height as u32).to_le_bytes());
    map.pixels
        .iter()
        .flat_map(|pixel| pixel.to_array())
        .for_each(|value| content.extend(value.to_le_bytes()));
    content
}

/// The maps that were baked.
pub(super) fn maps(baked: &Baked, rotation: f32) -> Result<Prefiltered> {
    let map = |index: usize| {
        read(&baked.part(index)?).ok_or_else(|| Error::input(format!("part {index} is no prefiltered map")))
    };
    Prefiltered::of_maps((0..baked.parts()).map(map).collect::<Result<_>>()?, rotation)
}

fn read(content: &[u8]) -> Option<(Wanted, Environment)> {
    let (head, pixels) = content.split_first_chunk::<HEAD>()?;
    let word = |k: usize| [head[4 * k], head[4 * k + 1], head[4 * k + 2], head[4 * k + 3]];
    let roles = u32::from_le_bytes(word(0));
    let n = f32::from_le_bytes(word(1));
    let [width, height] = [2, 3].map(|k| u32::from_le_bytes(word(k)) as usize);
    let whole = width.checked_mul(height)?.checked_mul(PIXEL)?;
    if pixels.len() != whole || width < 2 || height < 2 || !(n.is_finite() && n > 0.0) {
        return None;
    }
    let pixel = |bytes: &[u8]| {
        let value = |k: usize| f32::from_le_bytes([bytes[k], bytes[k + 1], bytes[k + 2], bytes[k + 3]]);
        Rgb::new(value(0), value(4), value(8))
    };
    let pixels: Vec<Rgb> = pixels.chunks_exact(PIXEL).map(pixel).collect();
    let map = Environment { width, height, pixels: pixels.into(), rotation: 0.0 };
    Some((Wanted { n, height, roles: [roles & 1 > 0, roles & 2 > 0] }, map))
}
