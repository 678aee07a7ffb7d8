//! Wavefront OBJ. Its v points up and is turned downwards here.

use std::path::Path;

use glam::{Vec2, Vec3};

use crate::error::{Error, Result};
use crate::scene::mesh::RawMesh;

/// Joins all models of the file; vertices that differ in texture or normal are apart.
pub(super) fn read(path: &Path) -> Result<RawMesh> {
    let options = tobj::LoadOptions { triangulate: true, single_index: true, ..Default::default() };
    let file = std::fs::File::open(path).map_err(|error| Error::reading(path, error))?;
    // Material libraries are not used: a scene names its own materials.
    let (models, _) =
        tobj::load_obj_buf(&mut std::io::BufReader::new(file), &options, |_| Ok(Default::default()))
            .map_err(|error| Error::reading(path, error))?;

    let mut raw = RawMesh::default();
    let has_uvs = models.iter().all(|m| m.mesh.texcoords.len() / 2 == m.mesh.positions.len() / 3);
    let has_normals = models.iter().all(|m| m.mesh.normals.len() == m.mesh.positions.len());
    for mesh in models.iter().map(|model| &model.mesh) {
        let first = raw.positions.len() as u32;
        raw.positions.extend(mesh.positions.chunks_exact(3).map(Vec3::from_slice));
        if has_uvs {
            raw.uvs.extend(mesh.texcoords.chunks_exact(2).map(|t| Vec2::new(t[0], 1.0 - t[1])));
        }
        if has_normals {
            raw.normals.extend(mesh.normals.chunks_exact(3).map(Vec3::from_slice));
        }
        raw.triangles
            .extend(mesh.indices.chunks_exact(3).map(|t| [t[0] + first, t[1] + first, t[2] + first]));
    }
    Ok(raw)
}
