//! Meshes from glTF 2.0, Wavefront OBJ and PLY files, and patches.

mod gltf_accessor;
mod gltf_file;
mod gltf_json;
mod obj_file;
mod ply_file;
mod ply_header;
mod polygon;

use std::path::{Path, PathBuf};

use glam::DVec3;

use super::bezier::Patches;
use super::mesh::Mesh;
use lobelia_base::error::{Error, Result};
use lobelia_base::progress;

impl Mesh {
    /// Reads every triangle of a `.gltf`, `.glb`, `.obj` or `.ply` file, or the patches of a `.bpt` file,
    /// into one mesh, and what its positions are relative to: 0, or the middle of a mesh whose coordinates
    /// are too large for single precision.
    ///
    /// # Errors
    /// Input errors that name the file and what is wrong in it.
    pub fn read(path: &Path) -> Result<(Self, DVec3)> {
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        let raw = match extension.as_str() {
            "gltf" | "glb" => gltf_file::read(path)?,
            "obj" => obj_file::read(path)?,
            "ply" => ply_file::read(path)?,
            "bpt" => {
                let patches = Patches::read(path)?;
                return patches.mesh(patches.usual_tolerance()).map_err(|error| error.at(path.display()));
            }
            _ => return Err(Error::reading(path, "a mesh is a .gltf, .glb, .obj, .ply or .bpt file")),
        };
        Self::from_raw(raw).map_err(|error| error.at(path.display()))
    }

    /// The files beside a `.gltf` file in which its numbers lie.
    pub fn gltf_buffers(path: &Path) -> Vec<PathBuf> {
        gltf_json::buffer_files(path)
    }
}

/// Says what of a file is no surface, where there is such.
fn left_out(path: &Path, count: usize, [one, more]: [&str; 2]) {
    if count > 0 {
        let what = progress::counted(count as u64, one, more);
        progress::note(&format!("{}: left out as no surface: {what}", path.display()));
    }
}

#[cfg(test)]
mod tests;
