//! A scene as the shader reads it.

use std::ops::Range;
use std::time::Duration;

use bytemuck::{Pod, Zeroable};
use glam::{Mat4, Vec3A, Vec4};
use obvhs::BvhBuildParams;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::triangle::Triangle;

use super::{POINTS_ACROSS, Settings};
use crate::error::{Error, Result};
use crate::reflectance::Rgb;
use crate::render::geometry;
use crate::render::shading::{self, Lamp};
use crate::render::storage::{Storage, brightest_of};
use crate::scene::{Filter, Light, Material, Mesh, Reflectance, Scene, Vertex};

/// The deepest tree that the shader's stack takes.
const DEEPEST: usize = 96;

/// Uniforms.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(super) struct View {
    pub(super) projection: Mat4,
    /// w: number of lamps.
    pub(super) eye: Vec4,
    /// x: length by which shadow rays are kept off surfaces.
    pub(super) offset: Vec4,
}

/// A material: its texels and how they are looked up.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub(super) struct PackedMaterial {
    first: u32,
    width: u32,
    height: u32,
    bilinear: u32,
    tiling: [f32; 2],
    levels: u32,
    brightest: f32,
    emission: [f32; 3],
    emits: u32,
    /// First word, columns, rows.
    mask: [u32; 3],
    /// Most lobes of a texel.
    lobes: u32,
}

/// A node of the tree; for leaves the run of triangles, else the first of two children and a count of 0.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Node {
    low: [f32; 3],
    first: u32,
    high: [f32; 3],
    count: u32,
}

/// Everything of a scene that is uploaded.
pub(super) struct Uploads {
    pub(super) lamps: Vec<Lamp>,
    /// One an object, then one a rectangular light.
    pub(super) materials: Vec<PackedMaterial>,
    /// The first word of every texel, and the end of the last.
    pub(super) starts: Vec<u32>,
    /// Texels, then masks.
    pub(super) words: Vec<u32>,
    pub(super) mesh: Mesh,
    pub(super) nodes: Vec<Node>,
    /// Triangle and object in the tree's order.
    pub(super) leaves: Vec<[u32; 2]>,
    /// The run of triangles of every object and rectangular light, and whether parts of it are cut out.
    pub(super) runs: Vec<(Range<u32>, bool)>,
    pub(super) offset: f32,
}

impl Uploads {
    /// Packs a scene that has the levels and coefficients to be drawn.
    ///
    /// # Errors
    /// A failure for triangles whose tree is too deep for the shader.
    pub(super) fn new(scene: &Scene, settings: &Settings) -> Result<Self> {
        let (mesh, runs) = geometry::joined(scene);
        let mut uploads = Self {
            lamps: shading::lamps(&scene.lights, POINTS_ACROSS),
            materials: vec![],
            starts: vec![],
            words: vec![],
            offset: geometry::offset(&mesh),
            mesh,
            nodes: vec![],
            leaves: vec![],
            runs: vec![],
        };
        for object in &scene.objects {
            uploads.add(&object.material, settings.storage);
        }
        uploads.starts.push(uploads.words.len() as u32);
        for (packed, object) in uploads.materials.iter_mut().zip(&scene.objects) {
            if let Some(mask) = &object.material.mask {
                packed.mask = [uploads.words.len() as u32, mask.width, mask.height];
                uploads.words.extend(&mask.bits);
            }
        }
        for light in &scene.lights {
            if let Light::Rectangle { radiance, .. } = light {
                let emission = radiance.to_array();
                uploads.materials.push(PackedMaterial { emission, emits: 1, ..PackedMaterial::default() });
            }
        }
        if settings.shadows {
            uploads.grow(&runs)?;
        }
        uploads.runs =
            runs.into_iter().zip(&uploads.materials).map(|(run, m)| (run, m.mask[1] > 0)).collect();
        Ok(uploads)
    }

    /// Adds a material's texels.
    fn add(&mut self, material: &Material, storage: Storage) {
        let brightest = brightest_of(material);
        let first = self.starts.len() as u32;
        let mut lobes = 0;
        for brdf in material.brdfs() {
            self.starts.push(self.words.len() as u32);
            storage.append(&brdf, brightest, &mut self.words);
            lobes = lobes.max(brdf.lobes.iter().filter(|lobe| lobe.rho_s != Rgb::ZERO).count() as u32);
        }
        let (width, height) = match &material.reflectance {
            Reflectance::Uniform(_) => (1, 1),
            Reflectance::Map(map) => (map.width as u32, map.height as u32),
        };
        self.materials.push(PackedMaterial {
            first,
            width,
            height,
            bilinear: u32::from(material.filter == Filter::Bilinear && (width, height) != (1, 1)),
            tiling: material.tiling.to_array(),
            levels: material.levels.len() as u32,
            brightest: if storage == Storage::Bits8Scaled { brightest } else { 1.0 },
            lobes,
            ..PackedMaterial::default()
        });
    }

    /// Builds the tree of triangles that shadow rays are tested with.
    fn grow(&mut self, runs: &[Range<u32>]) -> Result<()> {
        if self.mesh.triangles.is_empty() {
            return Ok(());
        }
        let corner = |i: u32| Vec3A::from(self.mesh.vertices[i as usize].position);
        let triangle = |&[a, b, c]: &[u32; 3]| Triangle { v0: corner(a), v1: corner(b), v2: corner(c) };
        let triangles: Vec<Triangle> = self.mesh.triangles.iter().map(triangle).collect();
        let tree = build_bvh2_from_tris(&triangles, BvhBuildParams::medium_build(), &mut Duration::default());
        let depth = tree.depth(0);
        if depth > DEEPEST {
            return Err(Error::failure(format!(
                "GPU: the tree of the scene's triangles is {depth} levels deep; {DEEPEST} are the most"
            )));
        }
        self.nodes = tree
            .nodes
            .iter()
            .map(|node| Node {
                low: node.aabb().min.to_array(),
                first: node.first_index,
                high: node.aabb().max.to_array(),
                count: node.prim_count,
            })
            .collect();
        let object = |triangle: u32| runs.partition_point(|run| run.end <= triangle) as u32;
        self.leaves = tree.primitive_indices.iter().map(|&triangle| [triangle, object(triangle)]).collect();
        Ok(())
    }

    /// The vertices as the shader reads them, three four-vectors each.
    pub(super) fn vertices(&self) -> &[[Vec4; 3]] {
        const { assert!(size_of::<Vertex>() == size_of::<[Vec4; 3]>()) }
        bytemuck::cast_slice(&self.mesh.vertices)
    }

    /// Bytes on the device.
    pub(super) fn bytes(&self) -> usize {
        size_of_val(&self.lamps[..])
            + size_of_val(&self.materials[..])
            + size_of_val(&self.starts[..])
            + size_of_val(&self.words[..])
            + size_of_val(&self.mesh.vertices[..])
            + size_of_val(&self.mesh.triangles[..])
            + size_of_val(&self.nodes[..])
            + size_of_val(&self.leaves[..])
    }
}
