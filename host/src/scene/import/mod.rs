//! Meshes from glTF 2.0, Wavefront OBJ and PLY files.

mod gltf_file;
mod obj_file;
mod ply_file;

use std::path::Path;

use super::mesh::Mesh;
use crate::error::{Error, Result};

impl Mesh {
    /// Reads every triangle of a `.gltf`, `.glb`, `.obj` or `.ply` file into one mesh.
    ///
    /// # Errors
    /// Input errors that name the file and what is wrong in it.
    pub fn read(path: &Path) -> Result<Self> {
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        let raw = match extension.as_str() {
            "gltf" | "glb" => gltf_file::read(path)?,
            "obj" => obj_file::read(path)?,
            "ply" => ply_file::read(path)?,
            _ => return Err(Error::reading(path, "a mesh is a .gltf, .glb, .obj or .ply file")),
        };
        Self::from_raw(raw).map_err(|error| error.at(path.display()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use base64::Engine;
    use glam::{Vec2, Vec3};

    fn write(name: &str, bytes: &[u8]) -> (tempfile::TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        (folder, path)
    }

    #[test]
    fn an_obj_quad_keeps_its_corners_and_its_v_is_turned_downwards() {
        let text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n";
        let (_folder, path) = write("quad.obj", text.as_bytes());
        let mesh = Mesh::read(&path).unwrap();
        assert_eq!(mesh.triangles.len(), 2);
        let origin = mesh.vertices.iter().find(|v| v.position == Vec3::ZERO).unwrap();
        assert_eq!(origin.uv, Vec2::new(0.0, 1.0));
        assert!((origin.tangent - Vec3::X).length() < 1e-6 && origin.handedness == 1.0);
    }

    #[test]
    fn ply_quads_become_triangles_with_their_texture() {
        let text = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
            property float s\nproperty float t\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n\
            0 0 0 0 0\n1 0 0 1 0\n1 1 0 1 1\n0 1 0 0 1\n4 0 1 2 3\n";
        let (_folder, path) = write("quad.ply", text.as_bytes());
        let mesh = Mesh::read(&path).unwrap();
        assert_eq!((mesh.triangles.len(), mesh.vertices.len()), (2, 4));
        assert_eq!(mesh.vertices[0].uv, Vec2::new(0.0, 1.0));
        assert!((mesh.vertices[0].normal - Vec3::Z).length() < 1e-6);
    }

    #[test]
    fn a_gltf_triangle_is_moved_by_its_node() {
        let mut buffer: Vec<u8> = Vec::new();
        for x in [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0] {
            buffer.extend(x.to_le_bytes());
        }
        let data = base64::engine::general_purpose::STANDARD.encode(&buffer);
        let text = format!(
            r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],
            "nodes":[{{"mesh":0,"translation":[5,0,0]}}],
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
            "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}}],
            "bufferViews":[{{"buffer":0,"byteLength":36}}],
            "buffers":[{{"byteLength":36,"uri":"data:application/octet-stream;base64,{data}"}}]}}"#
        );
        let (_folder, path) = write("triangle.gltf", text.as_bytes());
        let mesh = Mesh::read(&path).unwrap();
        assert_eq!(mesh.vertices[0].position, Vec3::new(5.0, 0.0, 0.0));
        assert!((mesh.vertices[0].normal - Vec3::Z).length() < 1e-6);
    }

    #[test]
    fn broken_files_are_refused_by_name() {
        for (name, bytes) in [
            ("a.obj", &b"v 0 0\nf 1 2 3\n"[..]),
            ("b.ply", b"ply\nformat ascii 1.0\nelement vertex 3\n"),
            ("c.gltf", b"{}"),
            ("d.glb", b"glTF"),
            ("e.stl", b"solid"),
            ("f.obj", b""),
        ] {
            let (_folder, path) = write(name, bytes);
            let error = Mesh::read(&path).unwrap_err();
            assert_eq!(error.exit_code(), 2);
            assert!(error.to_string().contains(name), "{error}");
        }
    }
}
