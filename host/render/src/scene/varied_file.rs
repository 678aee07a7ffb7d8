//! What of a scene file varies: keys of the animation, named parameters, and the placements of both.

use std::collections::BTreeMap;

use glam::{DVec3, Vec3};
use serde::Deserialize;

use super::file::{either, one};
use super::state::Drive;
use super::{Camera, Parameter, Placement, Scene, State};
use lobelia_base::error::{Error, Result};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct AnimationFile {
    pub(super) frames: u32,
    #[serde(default)]
    pub(super) closed: bool,
    #[serde(default)]
    pub(super) key: Vec<KeyFile>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct KeyFile {
    position: Option<DVec3>,
    target: Option<DVec3>,
    fov_deg: Option<f32>,
    #[serde(default)]
    environment_turn_deg: f32,
    #[serde(default)]
    light: BTreeMap<String, PlacementFile>,
    #[serde(default)]
    object: BTreeMap<String, PlacementFile>,
    #[serde(default)]
    parameter: BTreeMap<String, f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ParameterFile {
    name: String,
    range: [f64; 2],
    value: Option<f64>,
    #[serde(default)]
    environment_turn_deg: f32,
    #[serde(default)]
    light: BTreeMap<String, PlacementFile>,
    #[serde(default)]
    object: BTreeMap<String, PlacementFile>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PlacementFile {
    #[serde(default, rename = "move")]
    shift: Vec3,
    #[serde(default)]
    turn_deg: Vec3,
    #[serde(default = "one")]
    dim: f32,
}

/// The names that lights and objects have in the file, by which they are placed.
pub(super) struct Names {
    pub(super) lights: Vec<Option<String>>,
    pub(super) objects: Vec<Option<String>>,
}

impl Names {
    /// Placements by the index of what is placed.
    fn placed(
        names: &[Option<String>],
        what: &str,
        entries: &BTreeMap<String, PlacementFile>,
    ) -> Result<Vec<(usize, Placement)>> {
        let placed = |(name, entry): (&String, &PlacementFile)| {
            let number = || name.parse().ok().filter(|index| *index < names.len());
            let index = names.iter().position(|own| own.as_ref() == Some(name)).or_else(number);
            let index = index.ok_or_else(|| {
                let known: Vec<&str> = names.iter().flatten().map(String::as_str).collect();
                Error::input(format!(
                    "there is no {what} \"{name}\"; use a number from 0 or a name{}{}",
                    if known.is_empty() { "" } else { ": " },
                    either(&known)
                ))
            })?;
            let turn = entry.turn_deg.map(f32::to_radians);
            Ok((index, Placement { shift: entry.shift, turn, dim: entry.dim }))
        };
        entries.iter().map(placed).collect()
    }

    /// A parameter with what it drives.
    pub(super) fn parameter(&self, entry: &ParameterFile) -> Result<Parameter> {
        let drive = || {
            Ok(Drive {
                turn: entry.environment_turn_deg.to_radians(),
                lights: Self::placed(&self.lights, "light", &entry.light)?,
                objects: Self::placed(&self.objects, "object", &entry.object)?,
            })
        };
        let drive = drive().map_err(|error: Error| error.at(format!("parameter {}", entry.name)))?;
        let value = entry.value.unwrap_or(entry.range[0]);
        Ok(Parameter { name: entry.name.clone(), range: entry.range, value, drive })
    }

    /// The state of the scene at a key of its animation.
    pub(super) fn state(
        &self,
        key: &KeyFile,
        scene: &Scene,
        local: &impl Fn(DVec3) -> Vec3,
    ) -> Result<State> {
        let camera = scene.camera;
        let fov = key.fov_deg.map_or(camera.fov, f32::to_radians);
        let position = key.position.map_or(camera.position, local);
        let target = key.target.map_or(camera.target, local);
        let mut state = scene.seen_by(&Camera { position, target, fov, ..camera });
        state.turn = key.environment_turn_deg.to_radians();
        for (index, placement) in Self::placed(&self.lights, "light", &key.light)? {
            state.lights[index] = placement;
        }
        for (index, placement) in Self::placed(&self.objects, "object", &key.object)? {
            state.objects[index] = placement;
        }
        for (name, value) in &key.parameter {
            let index = scene.parameters.iter().position(|parameter| parameter.name == *name);
            let index = index.ok_or_else(|| {
                let known: Vec<&str> = scene.parameters.iter().map(|one| one.name.as_str()).collect();
                Error::input(format!("there is no parameter \"{name}\"; the scene has {}", either(&known)))
            })?;
            state.parameters[index] = *value;
        }
        Ok(state)
    }
}
