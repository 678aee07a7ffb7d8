//! PLY, text or binary of either byte order: elements `vertex`, `face` and `tristrips`; other elements and
//! properties are passed over. Its v points up and is turned downwards here.

use std::path::Path;

use glam::{DVec3, Vec2};

use super::ply_header::{Element, Header, Source};
use super::polygon;
use crate::scene::mesh::{Corner, RawMesh};
use lobelia_base::error::{Error, Result};

/// Names of texture coordinates of vertices.
const UV_NAMES: [[&str; 2]; 3] = [["u", "v"], ["s", "t"], ["texture_u", "texture_v"]];

/// Reads vertices and faces.
pub(super) fn read(path: &Path) -> Result<RawMesh> {
    let bytes = std::fs::read(path).map_err(|error| Error::reading(path, error))?;
    parse(&bytes).map_err(|message| Error::reading(path, message))
}

fn parse(bytes: &[u8]) -> std::result::Result<RawMesh, String> {
    let (header, mut source) = Header::parse(bytes)?;
    let mut raw = RawMesh::default();
    for name in ["vertex", "face"] {
        let strips = name == "face" && header.elements.iter().any(|element| element.name == "tristrips");
        if !strips && !header.elements.iter().any(|element| element.name == name) {
            return Err(format!("it has no element \"{name}\""));
        }
    }
    let mut faces = Faces::default();
    for element in &header.elements {
        match element.name.as_str() {
            "vertex" => read_vertices(element, &mut source, &mut raw)?,
            "face" => faces.read(element, &mut source)?,
            "tristrips" => faces.read_strips(element, &mut source)?,
            _ => {
                for row in 0..element.count {
                    source.row(element, row)?;
                }
            }
        }
    }
    faces.into_triangles(&mut raw)?;
    Ok(raw)
}

fn read_vertices(
    element: &Element,
    source: &mut Source<'_>,
    raw: &mut RawMesh,
) -> std::result::Result<(), String> {
    let all = |names: &[&str]| names.iter().map(|name| element.scalar(name)).collect::<Option<Vec<usize>>>();
    let position = all(&["x", "y", "z"]).ok_or("its vertices need x, y and z, a number each")?;
    let normal = all(&["nx", "ny", "nz"]);
    let uv = UV_NAMES.iter().find_map(|names| all(names));
    for row in 0..element.count {
        source.row(element, row)?;
        let number = |property: &usize| source.values(*property)[0];
        raw.positions.push(DVec3::from_slice(&position.iter().map(number).collect::<Vec<_>>()));
        if let Some(normal) = &normal {
            let normal = DVec3::from_slice(&normal.iter().map(number).collect::<Vec<_>>());
            raw.normals.push(normal.as_vec3());
        }
        if let Some(uv) = &uv {
            raw.uvs.push(Vec2::new(number(&uv[0]) as f32, (1.0 - number(&uv[1])) as f32));
        }
    }
    Ok(())
}

/// Polygons by their vertices, with texture coordinates of their own where the file has those by face.
#[derive(Default)]
struct Faces {
    polygons: Vec<(Vec<f64>, Vec<Vec2>)>,
}

impl Faces {
    fn read(&mut self, element: &Element, source: &mut Source<'_>) -> std::result::Result<(), String> {
        let list = |names: &[&str]| names.iter().find_map(|name| element.list(name));
        let indices =
            list(&["vertex_indices", "vertex_index"]).ok_or("its faces have no list vertex_indices")?;
        let texture = list(&["texcoord"]);
        for row in 0..element.count {
            source.row(element, row)?;
            let corners = source.values(indices).to_vec();
            let uvs = texture.map_or(&[][..], |texture| source.values(texture));
            if !uvs.is_empty() && uvs.len() != 2 * corners.len() {
                return Err(format!(
                    "face {row} has {} texture coordinates for {} corners; it needs two each",
                    uvs.len(),
                    corners.len()
                ));
            }
            let uvs = uvs.chunks_exact(2).map(|uv| Vec2::new(uv[0] as f32, (1.0 - uv[1]) as f32)).collect();
            self.polygons.push((corners, uvs));
        }
        Ok(())
    }

    /// Strips in which −1 begins another.
    fn read_strips(&mut self, element: &Element, source: &mut Source<'_>) -> std::result::Result<(), String> {
        let names = ["vertex_indices", "vertex_index"];
        let indices = names.iter().find_map(|name| element.list(name));
        let indices = indices.ok_or("its strips have no list vertex_indices")?;
        for row in 0..element.count {
            source.row(element, row)?;
            for strip in source.values(indices).split(|&index| index == -1.0) {
                for (k, corners) in strip.windows(3).enumerate() {
                    let [a, b, c] = [corners[0], corners[1], corners[2]];
                    let triangle = if k % 2 == 0 { [a, b, c] } else { [b, a, c] };
                    self.polygons.push((triangle.to_vec(), Vec::new()));
                }
            }
        }
        Ok(())
    }

    /// Cuts the polygons, once all vertices are there.
    fn into_triangles(self, raw: &mut RawMesh) -> std::result::Result<(), String> {
        let by_vertex = !raw.uvs.is_empty();
        for (face, (indices, uvs)) in self.polygons.into_iter().enumerate() {
            let first_uv = raw.uvs.len() as u32;
            let mut corners = Vec::with_capacity(indices.len());
            for (k, index) in (0u32..).zip(indices) {
                if index.fract() != 0.0 || index < 0.0 || index >= raw.positions.len() as f64 {
                    let count = raw.positions.len();
                    return Err(format!("face {face} refers to vertex {index}; there are {count}"));
                }
                let position = index as u32;
                let normal = (!raw.normals.is_empty()).then_some(position);
                let uv = if uvs.is_empty() { by_vertex.then_some(position) } else { Some(first_uv + k) };
                corners.push(Corner { position, normal, uv });
            }
            raw.uvs.extend(uvs);
            let points: Vec<DVec3> =
                corners.iter().map(|corner| raw.positions[corner.position as usize]).collect();
            let cut = polygon::triangles(&points);
            raw.triangles.extend(cut.into_iter().map(|triangle| triangle.map(|k| corners[k])));
        }
        Ok(())
    }
}
