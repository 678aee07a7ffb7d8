//! glTF 2.0, text or binary: the triangles of the default scene with their nodes' transforms, as the file
//! shows them at rest: morph targets by their weights, skins by their joints, instances one by one. Its v
//! points down already. Where normals are missing triangles are flat, as the specification has it. Points and
//! lines are no surfaces.

use std::path::Path;

use glam::{DMat3, DMat4, DQuat, DVec3, Vec2};

use super::gltf_accessor;
use super::gltf_json::{self, Document, Node, Primitive};
use crate::scene::mesh::{Corner, RawMesh};
use lobelia_base::error::{Error, Result};

/// Instances of a mesh at most: they are all made triangles.
const MOST_TRIANGLES: usize = 1 << 28;

/// Joins all triangle primitives of the scene.
pub(super) fn read(path: &Path) -> Result<RawMesh> {
    let (document, buffers) = gltf_json::read(path)?;
    let file = File { document, buffers };
    let (raw, others) = file.mesh().map_err(|message| Error::reading(path, message))?;
    super::left_out(path, others, ["primitive of points or lines", "primitives of points or lines"]);
    Ok(raw)
}

/// A document with its buffers.
struct File {
    document: Document,
    buffers: Vec<Vec<u8>>,
}

type Fallible<T> = std::result::Result<T, String>;

impl File {
    /// The triangles, and how many primitives are something else.
    fn mesh(&self) -> Fallible<(RawMesh, usize)> {
        let places = self.places()?;
        let mut raw = RawMesh::default();
        let mut others = 0;
        for (index, node) in self.document.nodes.iter().enumerate() {
            let (Some(place), Some(mesh)) = (places.shown[index].then_some(places.world[index]), node.mesh)
            else {
                continue;
            };
            let mesh = self
                .document
                .meshes
                .get(mesh)
                .ok_or_else(|| format!("node {index} refers to mesh {mesh}"))?;
            let weights = node.weights.as_ref().or(mesh.weights.as_ref()).map_or(&[][..], Vec::as_slice);
            for primitive in &mesh.primitives {
                let Some(triangles) = self.triangles(primitive)? else {
                    others += 1;
                    continue;
                };
                let shape = self.shape(primitive, weights)?;
                let shape = match node.skin {
                    Some(skin) => self.skinned(shape, primitive, skin, &places)?,
                    None => shape,
                };
                // A skinned mesh stands where its joints are: its node's place does not count.
                let base = if node.skin.is_some() { DMat4::IDENTITY } else { place };
                for instance in self.instances(node)? {
                    if raw.triangles.len() + triangles.len() > MOST_TRIANGLES {
                        return Err(format!("its instances have more than {MOST_TRIANGLES} triangles"));
                    }
                    append(&mut raw, &shape, &triangles, base * instance)?;
                }
            }
        }
        if raw.triangles.is_empty() && others > 0 {
            return Err("it has only points and lines, which are no surfaces".into());
        }
        Ok((raw, others))
    }

    /// Where every node stands, and which belong to the scene.
    fn places(&self) -> Fallible<Places> {
        let nodes = &self.document.nodes;
        let mut parent: Vec<Option<usize>> = vec![None; nodes.len()];
        for (index, node) in nodes.iter().enumerate() {
            for &child in &node.children {
                let of = parent.get_mut(child).ok_or_else(|| format!("node {index} has no child {child}"))?;
                if let Some(other) = of.replace(index) {
                    return Err(format!(
                        "node {child} is a child of nodes {other} and {index}; it can be one's alone"
                    ));
                }
            }
        }
        let mut world = vec![DMat4::IDENTITY; nodes.len()];
        let mut reached = vec![false; nodes.len()];
        let mut stack: Vec<usize> = (0..nodes.len()).filter(|&index| parent[index].is_none()).collect();
        while let Some(index) = stack.pop() {
            reached[index] = true;
            let above = parent[index].map_or(DMat4::IDENTITY, |parent| world[parent]);
            world[index] = above * local(&nodes[index]);
            stack.extend(&nodes[index].children);
        }
        if let Some(index) = reached.iter().position(|&reached| !reached) {
            return Err(format!("its nodes form a loop through node {index}"));
        }
        let mut shown = vec![false; nodes.len()];
        let scene = self.document.scene.unwrap_or(0);
        let scene = self.document.scenes.get(scene).ok_or_else(|| match self.document.scenes.len() {
            0 => "it has no scene".to_string(),
            _ => format!("it has no scene {scene}"),
        })?;
        let mut stack = scene.nodes.clone();
        while let Some(index) = stack.pop() {
            let node = nodes.get(index).ok_or_else(|| format!("its scene has no node {index}"))?;
            if !std::mem::replace(&mut shown[index], true) {
                stack.extend(&node.children);
            }
        }
        Ok(Places { world, shown })
    }

    /// Indices of a primitive's triangles; none for points and lines.
    fn triangles(&self, primitive: &Primitive) -> Fallible<Option<Vec<[u32; 3]>>> {
        let mode = primitive.mode.unwrap_or(4);
        if mode < 4 {
            return Ok(None);
        }
        let position = primitive.attributes.position.ok_or("a primitive has no POSITION")?;
        let indices: Vec<u32> = match primitive.indices {
            Some(indices) => self.read::<1>(indices)?.into_iter().map(|[index]| index as u32).collect(),
            None => {
                let accessor = self.document.accessors.get(position);
                // Read once to hold the count against the buffers.
                let count = accessor.map_or(Ok(0), |_| self.read::<3>(position).map(|all| all.len()))?;
                (0..count as u32).collect()
            }
        };
        let triangles = match mode {
            4 => indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
            5 => {
                let strip = indices.windows(3).enumerate();
                strip.map(|(k, t)| if k % 2 == 0 { [t[0], t[1], t[2]] } else { [t[1], t[0], t[2]] }).collect()
            }
            6 => (2..indices.len()).map(|k| [indices[0], indices[k - 1], indices[k]]).collect(),
            _ => return Err(format!("a primitive has the unknown mode {mode}")),
        };
        Ok(Some(triangles))
    }

    /// Positions, normals and texture coordinates of a primitive, its morph targets added by their weights.
    fn shape(&self, primitive: &Primitive, weights: &[f64]) -> Fallible<Shape> {
        let attributes = &primitive.attributes;
        let vectors = |index: usize| -> Fallible<Vec<DVec3>> {
            Ok(self.read::<3>(index)?.into_iter().map(DVec3::from_array).collect())
        };
        let mut positions = vectors(attributes.position.ok_or("a primitive has no POSITION")?)?;
        let mut normals = attributes.normal.map_or(Ok(Vec::new()), vectors)?;
        let uvs = attributes.texcoord_0.map_or(Ok(Vec::new()), |index| self.read::<2>(index))?;
        let uvs: Vec<Vec2> = uvs.into_iter().map(|[u, v]| Vec2::new(u as f32, v as f32)).collect();
        for (target, &weight) in primitive.targets.iter().zip(weights).filter(|(_, weight)| **weight != 0.0) {
            for (index, base) in [(target.position, &mut positions), (target.normal, &mut normals)] {
                let moved = index.map_or(Ok(Vec::new()), vectors)?;
                base.iter_mut().zip(moved).for_each(|(vector, by)| *vector += weight * by);
            }
        }
        for (name, count) in [("NORMAL", normals.len()), ("TEXCOORD_0", uvs.len())] {
            if count != 0 && count != positions.len() {
                return Err(format!("a primitive has {count} {name} for {} POSITION", positions.len()));
            }
        }
        Ok(Shape { positions, normals, uvs })
    }

    /// The shape bent by the joints of a skin, in the world.
    fn skinned(&self, shape: Shape, primitive: &Primitive, skin: usize, places: &Places) -> Fallible<Shape> {
        let skin = self.document.skins.get(skin).ok_or_else(|| format!("it has no skin {skin}"))?;
        if primitive.attributes.joints_1.is_some() {
            return Err("a skin has more than four joints a vertex (JOINTS_1), which is not read".into());
        }
        let attributes = (primitive.attributes.joints_0, primitive.attributes.weights_0);
        let (Some(joints), Some(weights)) = attributes else {
            return Err("a skinned primitive has no JOINTS_0 or no WEIGHTS_0".into());
        };
        let (joints, weights) = (self.read::<4>(joints)?, self.read::<4>(weights)?);
        let bind: Vec<DMat4> = match skin.inverse_bind_matrices {
            Some(index) => self.read::<16>(index)?.iter().map(DMat4::from_cols_array).collect(),
            None => vec![DMat4::IDENTITY; skin.joints.len()],
        };
        let joint = |(&node, bind): (&usize, &DMat4)| {
            places
                .world
                .get(node)
                .map(|world| *world * *bind)
                .ok_or_else(|| format!("a skin has no joint {node}"))
        };
        let matrices: Vec<DMat4> = skin.joints.iter().zip(&bind).map(joint).collect::<Fallible<_>>()?;
        if joints.len() != shape.positions.len() || weights.len() != joints.len() {
            return Err("a skinned primitive has not as many joints and weights as vertices".into());
        }
        let mut bent = Shape { uvs: shape.uvs, ..Shape::default() };
        for (k, (joints, weights)) in joints.iter().zip(&weights).enumerate() {
            let mut matrix = DMat4::ZERO;
            for (&joint, &weight) in joints.iter().zip(weights).filter(|(_, weight)| **weight != 0.0) {
                let known =
                    matrices.get(joint as usize).ok_or_else(|| format!("a skin has no joint {joint}"))?;
                matrix += *known * weight;
            }
            bent.positions.push(matrix.transform_point3(shape.positions[k]));
            if let Some(&normal) = shape.normals.get(k) {
                bent.normals.push(normal_matrix(&matrix) * normal);
            }
        }
        Ok(bent)
    }

    /// Where the instances of a node's mesh stand in the node's frame.
    fn instances(&self, node: &Node) -> Fallible<Vec<DMat4>> {
        let Some(instancing) = &node.extensions.instancing else { return Ok(vec![DMat4::IDENTITY]) };
        let attributes = &instancing.attributes;
        let read = |index: Option<usize>| index.map(|index| self.read::<3>(index)).transpose();
        let (translations, scales) = (read(attributes.translation)?, read(attributes.scale)?);
        let rotations = attributes.rotation.map(|index| self.read::<4>(index)).transpose()?;
        let lengths = [&translations, &scales].map(|vectors| vectors.as_ref().map(Vec::len));
        let count = lengths.into_iter().chain([rotations.as_ref().map(Vec::len)]).flatten().min();
        let instance = |k: usize| {
            DMat4::from_scale_rotation_translation(
                scales.as_ref().map_or(DVec3::ONE, |all| DVec3::from_array(all[k])),
                rotations.as_ref().map_or(DQuat::IDENTITY, |all| DQuat::from_array(all[k]).normalize()),
                translations.as_ref().map_or(DVec3::ZERO, |all| DVec3::from_array(all[k])),
            )
        };
        Ok((0..count.unwrap_or(0)).map(instance).collect())
    }

    fn read<const N: usize>(&self, index: usize) -> Fallible<Vec<[f64; N]>> {
        gltf_accessor::read(&self.document, &self.buffers, index)
    }
}

/// Where nodes stand.
struct Places {
    /// To the file's world, a node.
    world: Vec<DMat4>,
    /// Whether a node belongs to the scene.
    shown: Vec<bool>,
}

/// A primitive's vertices.
#[derive(Default)]
struct Shape {
    positions: Vec<DVec3>,
    /// As many, or none.
    normals: Vec<DVec3>,
    /// As many, or none.
    uvs: Vec<Vec2>,
}

/// A node's own transform.
fn local(node: &Node) -> DMat4 {
    if let Some(matrix) = &node.matrix {
        return DMat4::from_cols_array(matrix);
    }
    let rotation = node.rotation.map_or(DQuat::IDENTITY, DQuat::from_array);
    let rotation = if rotation.length_squared() > 0.0 { rotation.normalize() } else { DQuat::IDENTITY };
    DMat4::from_scale_rotation_translation(
        node.scale.map_or(DVec3::ONE, DVec3::from_array),
        rotation,
        node.translation.map_or(DVec3::ZERO, DVec3::from_array),
    )
}

/// What turns normals where points are turned by a matrix; that of a flat one is left as it is.
fn normal_matrix(matrix: &DMat4) -> DMat3 {
    let linear = DMat3::from_mat4(*matrix);
    // Cofactors: the inverse's transpose but for a factor, also where there is no inverse.
    DMat3::from_cols(
        linear.y_axis.cross(linear.z_axis),
        linear.z_axis.cross(linear.x_axis),
        linear.x_axis.cross(linear.y_axis),
    ) * linear.determinant().signum()
}

/// Adds a primitive at a place.
fn append(raw: &mut RawMesh, shape: &Shape, triangles: &[[u32; 3]], place: DMat4) -> Fallible<()> {
    let first = [raw.positions.len(), raw.normals.len(), raw.uvs.len()].map(|count| count as u32);
    let count = shape.positions.len();
    if u32::try_from(raw.positions.len() + count).is_err() {
        return Err("it has more than 4 billion vertices".into());
    }
    raw.positions.extend(shape.positions.iter().map(|&position| place.transform_point3(position)));
    let turn = normal_matrix(&place);
    raw.normals.extend(shape.normals.iter().map(|&normal| (turn * normal).normalize_or_zero().as_vec3()));
    raw.uvs.extend(&shape.uvs);
    let mirrored = DMat3::from_mat4(place).determinant() < 0.0;
    for triangle in triangles {
        if let Some(index) = triangle.iter().find(|&&index| index as usize >= count) {
            return Err(format!("a primitive refers to vertex {index} of {count}"));
        }
        let [a, b, c] = *triangle;
        let triangle = if mirrored { [a, c, b] } else { [a, b, c] };
        let mut corners = triangle.map(|index| Corner {
            position: first[0] + index,
            normal: (!shape.normals.is_empty()).then_some(first[1] + index),
            uv: (!shape.uvs.is_empty()).then_some(first[2] + index),
        });
        if shape.normals.is_empty() {
            let [a, b, c] = corners.map(|corner| raw.positions[corner.position as usize]);
            let flat = raw.normals.len() as u32;
            raw.normals.push((b - a).cross(c - a).normalize_or_zero().as_vec3());
            corners.iter_mut().for_each(|corner| corner.normal = Some(flat));
        }
        raw.triangles.push(corners);
    }
    Ok(())
}
