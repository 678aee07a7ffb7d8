//! glTF 2.0, text or binary: the triangles of the default scene with their nodes' transforms. Its v points down already.

use std::path::Path;

use base64::Engine;
use glam::{Mat4, Vec2, Vec3};

use crate::error::{Error, Result};
use crate::scene::mesh::RawMesh;

/// Joins all triangle primitives of the scene.
pub(super) fn read(path: &Path) -> Result<RawMesh> {
    let fail = |error: &dyn std::fmt::Display| Error::reading(path, error);
    let gltf = gltf::Gltf::open(path).map_err(|error| fail(&error))?;
    let mut blob = gltf.blob.clone();
    let mut buffers = Vec::new();
    for buffer in gltf.buffers() {
        let bytes = match buffer.source() {
            gltf::buffer::Source::Bin => blob.take().ok_or_else(|| fail(&"its binary chunk is missing"))?,
            gltf::buffer::Source::Uri(uri) => read_uri(path, uri)?,
        };
        if bytes.len() < buffer.length() {
            let message =
                format!("buffer {} has {} of its {} bytes", buffer.index(), bytes.len(), buffer.length());
            return Err(fail(&message));
        }
        buffers.push(bytes);
    }
    check_views(&gltf, &buffers).map_err(|message| fail(&message))?;

    let mut raw = RawMesh::default();
    let scene = gltf.default_scene().or_else(|| gltf.scenes().next());
    let Some(scene) = scene else { return Err(fail(&"it has no scene")) };
    let mut stack: Vec<_> = scene.nodes().map(|node| (node, Mat4::IDENTITY, 0)).collect();
    let mut parts = Vec::new();
    while let Some((node, parent, depth)) = stack.pop() {
        if depth > 256 {
            return Err(fail(&"its nodes form a loop"));
        }
        let matrix = parent * Mat4::from_cols_array_2d(&node.transform().matrix());
        stack.extend(node.children().map(|child| (child, matrix, depth + 1)));
        for primitive in node.mesh().into_iter().flat_map(|mesh| mesh.primitives()) {
            if primitive.mode() == gltf::mesh::Mode::Triangles {
                parts.push(part(&primitive, &buffers, matrix).map_err(|message| fail(&message))?);
            }
        }
    }
    let (has_normals, has_uvs) =
        (parts.iter().all(|p| !p.normals.is_empty()), parts.iter().all(|p| !p.uvs.is_empty()));
    for mut part in parts {
        let first = raw.positions.len() as u32;
        raw.positions.append(&mut part.positions);
        if has_normals {
            raw.normals.append(&mut part.normals);
        }
        if has_uvs {
            raw.uvs.append(&mut part.uvs);
        }
        raw.triangles.extend(part.triangles.iter().map(|t| t.map(|i| i.saturating_add(first))));
    }
    Ok(raw)
}

/// Bytes of a data URI or of a file beside the glTF file.
fn read_uri(path: &Path, uri: &str) -> Result<Vec<u8>> {
    if let Some(data) = uri.strip_prefix("data:") {
        let encoded = data.split_once(";base64,").map(|(_, encoded)| encoded);
        let encoded = encoded.ok_or_else(|| Error::reading(path, "a data URI is not in base64"))?;
        return base64::engine::general_purpose::STANDARD
            .decode(encoded)
            .map_err(|error| Error::reading(path, error));
    }
    let beside = path.with_file_name(uri);
    std::fs::read(&beside).map_err(|error| Error::reading(&beside, error))
}

/// Refuses accessors that reach beyond their buffers, which the reader would panic on.
fn check_views(gltf: &gltf::Gltf, buffers: &[Vec<u8>]) -> std::result::Result<(), String> {
    for view in gltf.views() {
        let length = buffers[view.buffer().index()].len();
        if view.offset().checked_add(view.length()).is_none_or(|end| end > length) {
            return Err(format!("buffer view {} reaches beyond its buffer", view.index()));
        }
    }
    for accessor in gltf.accessors() {
        let Some(view) = accessor.view() else { continue };
        let stride = view.stride().unwrap_or(accessor.size());
        let needed = accessor.count().checked_sub(1).map_or(Some(0), |gaps| {
            gaps.checked_mul(stride)?.checked_add(accessor.size())?.checked_add(accessor.offset())
        });
        if needed.is_none_or(|needed| needed > view.length()) {
            return Err(format!("accessor {} reaches beyond its buffer view", accessor.index()));
        }
    }
    Ok(())
}

/// The triangles of one primitive in the file's world frame.
fn part(
    primitive: &gltf::Primitive<'_>,
    buffers: &[Vec<u8>],
    matrix: Mat4,
) -> std::result::Result<RawMesh, String> {
    let reader = primitive.reader(|buffer| buffers.get(buffer.index()).map(Vec::as_slice));
    let positions = reader.read_positions().ok_or("a primitive has no POSITION")?;
    let mut raw = RawMesh {
        positions: positions.map(|p| matrix.transform_point3(Vec3::from_array(p))).collect(),
        ..RawMesh::default()
    };
    let normal_matrix = matrix.inverse().transpose();
    if let Some(normals) = reader.read_normals() {
        raw.normals = normals
            .map(|n| normal_matrix.transform_vector3(Vec3::from_array(n)).normalize_or(Vec3::Y))
            .collect();
    }
    if let Some(uvs) = reader.read_tex_coords(0) {
        raw.uvs = uvs.into_f32().map(Vec2::from_array).collect();
    }
    let indices: Vec<u32> = match reader.read_indices() {
        Some(indices) => indices.into_u32().collect(),
        None => (0..raw.positions.len() as u32).collect(),
    };
    let mirrored = matrix.determinant() < 0.0;
    let turn = |t: &[u32]| if mirrored { [t[0], t[2], t[1]] } else { [t[0], t[1], t[2]] };
    raw.triangles = indices.chunks_exact(3).map(turn).collect();
    Ok(raw)
}
