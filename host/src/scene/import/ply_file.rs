//! PLY, text or binary: elements `vertex` and `face`. Its v points up and is turned downwards here.

use std::path::Path;

use glam::{Vec2, Vec3};
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{Property, PropertyAccess, PropertyAccessResult};

use crate::error::{Error, Result};
use crate::scene::mesh::RawMesh;

/// A vertex or a face; other properties are passed over.
#[derive(Default)]
struct Record {
    position: Vec3,
    normal: Vec3,
    uv: Vec2,
    corners: Vec<i64>,
}

impl PropertyAccess for Record {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        if matches!(name, "vertex_indices" | "vertex_index") {
            self.corners = match property {
                Property::ListChar(list) => list.into_iter().map(i64::from).collect(),
                Property::ListUChar(list) => list.into_iter().map(i64::from).collect(),
                Property::ListShort(list) => list.into_iter().map(i64::from).collect(),
                Property::ListUShort(list) => list.into_iter().map(i64::from).collect(),
                Property::ListInt(list) => list.into_iter().map(i64::from).collect(),
                Property::ListUInt(list) => list.into_iter().map(i64::from).collect(),
                _ => return PropertyAccessResult::Ignored,
            };
            return PropertyAccessResult::Set;
        }
        let value = match property {
            Property::Float(value) => value,
            Property::Double(value) => value as f32,
            Property::Int(value) => value as f32,
            _ => return PropertyAccessResult::Ignored,
        };
        let place = match name {
            "x" => &mut self.position.x,
            "y" => &mut self.position.y,
            "z" => &mut self.position.z,
            "nx" => &mut self.normal.x,
            "ny" => &mut self.normal.y,
            "nz" => &mut self.normal.z,
            "u" | "s" | "texture_u" => &mut self.uv.x,
            "v" | "t" | "texture_v" => &mut self.uv.y,
            _ => return PropertyAccessResult::Ignored,
        };
        *place = value;
        PropertyAccessResult::Set
    }
}

/// Reads vertices and faces; polygons become fans of triangles.
pub(super) fn read(path: &Path) -> Result<RawMesh> {
    let file = std::fs::File::open(path).map_err(|error| Error::reading(path, error))?;
    let mut ply = Parser::<Record>::new()
        .read_ply(&mut std::io::BufReader::new(file))
        .map_err(|error| Error::reading(path, error))?;
    let has = |names: &[&str]| {
        ply.header
            .elements
            .get("vertex")
            .is_some_and(|e| names.iter().any(|name| e.properties.contains_key(*name)))
    };
    let (has_normals, has_uvs) = (has(&["nx"]), has(&["u", "s", "texture_u"]));
    let missing = |element: &str| Error::reading(path, format!("it has no element \"{element}\""));
    let vertices = ply.payload.shift_remove("vertex").ok_or_else(|| missing("vertex"))?;
    let faces = ply.payload.shift_remove("face").ok_or_else(|| missing("face"))?;

    let mut raw = RawMesh { positions: vertices.iter().map(|v| v.position).collect(), ..RawMesh::default() };
    if has_normals {
        raw.normals = vertices.iter().map(|v| v.normal.normalize_or(Vec3::Y)).collect();
    }
    if has_uvs {
        raw.uvs = vertices.iter().map(|v| Vec2::new(v.uv.x, 1.0 - v.uv.y)).collect();
    }
    for (number, face) in faces.iter().enumerate() {
        let index = |corner: i64| {
            u32::try_from(corner).map_err(|_| {
                Error::reading(path, format!("face {number} refers to vertex {corner}, which cannot be"))
            })
        };
        for k in 2..face.corners.len() {
            raw.triangles.push([
                index(face.corners[0])?,
                index(face.corners[k - 1])?,
                index(face.corners[k])?,
            ]);
        }
    }
    Ok(raw)
}
