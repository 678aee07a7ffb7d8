//! What is baked: the transfer of receivers, some thousands a part, as f32 in order, little-endian. It
//! depends on the meshes, where they stand, and what is cut out of them; lights, views and reflectances may
//! change.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::Settings;
use super::harmonics;
use super::transfer::{Directions, Receivers};
use crate::render::bake::{Bake, Baked, Made, MadeOf, Part};
use crate::render::geometry::Geometry;
use crate::scene::{Scene, hash};
use lobelia_base::error::{Error, Result};

/// Raised when parts change.
const VERSION: u32 = 1;
/// Receivers a part.
const PART: usize = 4096;
/// Seconds that a ray is expected to take, all cores together.
const RAY_SECONDS: f64 = 2e-7;

/// The scene whose transfer is meant: as it stands, without lights, which are no part of it.
fn still(scene: &Scene) -> Result<Scene> {
    let mut still = scene.at(&scene.state())?;
    still.lights.clear();
    Ok(still)
}

/// What the transfer of a scene depends on.
pub(super) fn made_of(settings: &Settings, scene: &Scene) -> Result<MadeOf> {
    scene.check()?;
    settings.check()?;
    let still = still(scene)?;
    let Settings { degree, rays, .. } = *settings;
    Ok(MadeOf {
        method: "incident".into(),
        version: VERSION,
        settings: format!("degree {degree}, {rays} rays"),
        of: BTreeMap::from([
            ("the meshes".into(), hash::meshes(&still)),
            ("what is cut out of them".into(), hash::masks(&still)),
        ]),
    })
}

/// Seconds that baking is expected to take.
pub(super) fn expected_seconds(settings: &Settings, scene: &Scene) -> f64 {
    let vertices: usize = scene.objects.iter().map(|object| object.mesh.vertices.len()).sum();
    vertices as f64 * f64::from(settings.rays) * RAY_SECONDS
}

/// The transfer to be made.
struct Work {
    receivers: Receivers,
    geometry: Geometry,
    directions: Directions,
    degree: usize,
}

/// The work of baking a scene's transfer.
pub(super) fn work<'a>(settings: &Settings, scene: &Scene) -> Result<Box<dyn Bake + 'a>> {
    scene.check()?;
    settings.check()?;
    let still = still(scene)?;
    let degree = settings.degree as usize;
    Ok(Box::new(Work {
        receivers: Receivers::new(&still),
        geometry: Geometry::new(&still),
        directions: Directions::new(degree, settings.rays),
        degree,
    }))
}

impl Work {
    fn run(&self, index: usize) -> std::ops::Range<usize> {
        index * PART..((index + 1) * PART).min(self.receivers.len())
    }
}

impl Bake for Work {
    fn parts(&self) -> Vec<Part> {
        let part = |index: usize| {
            let receivers = self.run(index).len();
            let bytes = receivers * harmonics::count(self.degree) * size_of::<f32>();
            Part { work: receivers as f64, bytes: bytes as u64, needs: 0..0 }
        };
        (0..self.receivers.len().div_ceil(PART)).map(part).collect()
    }

    fn part(&self, index: usize, _: &Baked) -> Result<Made> {
        let count = harmonics::count(self.degree);
        let transfer = |receiver: usize| self.directions.transfer(&self.receivers, receiver, &self.geometry);
        let all: Vec<_> = self.run(index).into_par_iter().map(transfer).collect();
        let content = all
            .iter()
            .flat_map(|(transfer, _)| transfer[..count].iter().flat_map(|value| value.to_le_bytes()));
        Ok(Made { content: content.collect(), rays: all.iter().map(|(_, rays)| rays).sum() })
    }
}

/// The transfer of all receivers that was baked, coefficients one receiver after another.
pub(super) fn transfers(baked: &Baked, receivers: usize, degree: usize) -> Result<Vec<f32>> {
    let mut all = Vec::with_capacity(receivers * harmonics::count(degree));
    for index in 0..baked.parts() {
        let content = baked.part(index)?;
        let (values, rest) = content.as_chunks::<4>();
        let damaged = !rest.is_empty();
        all.extend(values.iter().map(|&bytes| f32::from_le_bytes(bytes)));
        if damaged || all.iter().rev().take(values.len()).any(|value| !value.is_finite()) {
            return Err(Error::input(format!("part {index} is no transfer")));
        }
    }
    if all.len() != receivers * harmonics::count(degree) {
        return Err(Error::input("what was baked is not the transfer of this scene's vertices"));
    }
    Ok(all)
}
