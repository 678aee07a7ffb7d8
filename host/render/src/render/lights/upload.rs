//! A scene as the shader reads it.

use std::ops::Range;
use std::time::Duration;

use glam::{Vec3A, Vec4};
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::triangle::Triangle;

use super::Settings;
use crate::render::geometry;
use crate::render::shading;
use crate::render::storage::{Storage, brightest_of};
use crate::scene::{Filter, Light, Material, Mesh, Reflectance, Scene, Vertex};
use lobelia_gpu::lights::{self, Lamp, Leaf, Node};
use lobelia_reflectance::{Microfacet, Rgb};

/// Everything of a scene that is uploaded.
pub(super) struct Uploads {
    pub(super) lamps: Vec<Lamp>,
    /// One an object, then one a rectangular light.
    pub(super) materials: Vec<lights::Material>,
    /// The first word of every texel, and the end of the last.
    pub(super) starts: Vec<u32>,
    /// Texels, then masks.
    pub(super) words: Vec<u32>,
    pub(super) shape: Shape,
    /// Whether any material has lobes about normals of their own or that sharpen.
    pub(super) extended: bool,
}

/// The triangles of a scene, rectangular lights included.
pub(super) struct Shape {
    pub(super) mesh: Mesh,
    /// The run of triangles of every object and rectangular light.
    pub(super) runs: Vec<Range<u32>>,
    /// The tree that shadow rays are tested with; empty without shadows.
    pub(super) nodes: Vec<Node>,
    pub(super) leaves: Vec<Leaf>,
    /// Length by which rays are kept off the surface that they start from.
    pub(super) offset: f32,
}

impl Uploads {
    /// Packs a scene that has the levels and coefficients to be drawn.
    pub(super) fn new(scene: &Scene, settings: &Settings) -> Self {
        let mut uploads = Self {
            lamps: shading::lamps(&scene.lights),
            materials: vec![],
            starts: vec![],
            words: vec![],
            extended: scene.objects.iter().any(|object| object.material.is_extended()),
            shape: Shape::new(scene, settings.shadows),
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
        uploads.materials.extend(shining(scene));
        uploads
    }

    /// Adds a material's texels.
    fn add(&mut self, material: &Material, storage: Storage) {
        let brightest = brightest_of(material);
        let first = self.starts.len() as u32;
        let mut lobes = 0;
        let coats = material.brdfs().map(|brdf| brdf.microfacets.len()).max().unwrap_or(0);
        for mut brdf in material.brdfs() {
            brdf.microfacets.resize(coats, Microfacet { f0: Rgb::ZERO, f90: Rgb::ZERO, alpha: 1.0 });
            self.starts.push(self.words.len() as u32);
            storage.append(&brdf, brightest, self.extended, &mut self.words);
            lobes = lobes.max(brdf.lobes.iter().filter(|lobe| lobe.rho_s != Rgb::ZERO).count() as u32);
        }
        let (width, height) = match &material.reflectance {
            Reflectance::Uniform(_) => (1, 1),
            Reflectance::Map(map) => (map.width as u32, map.height as u32),
        };
        self.materials.push(lights::Material {
            first,
            width,
            height,
            bilinear: u32::from(material.filter == Filter::Bilinear && (width, height) != (1, 1)),
            tiling: material.tiling.to_array(),
            levels: material.levels.len() as u32,
            brightest: if storage == Storage::Bits8Scaled { brightest } else { 1.0 },
            lobes,
            coats: coats as u32,
            ..lights::Material::default()
        });
    }

    /// Bytes on the device.
    pub(super) fn bytes(&self) -> usize {
        size_of_val(&self.lamps[..])
            + size_of_val(&self.materials[..])
            + size_of_val(&self.starts[..])
            + size_of_val(&self.words[..])
            + size_of_val(&self.shape.mesh.vertices[..])
            + size_of_val(&self.shape.mesh.triangles[..])
            + size_of_val(&self.shape.nodes[..])
            + size_of_val(&self.shape.leaves[..])
    }
}

/// The materials of a scene's rectangular lights.
pub(super) fn shining(scene: &Scene) -> impl Iterator<Item = lights::Material> {
    scene.lights.iter().filter_map(|light| {
        let Light::Rectangle { radiance, .. } = light else { return None };
        Some(lights::Material { emission: radiance.to_array(), emits: 1, ..lights::Material::default() })
    })
}

impl Shape {
    /// Places a scene's triangles; with a tree where there are shadows.
    pub(super) fn new(scene: &Scene, shadows: bool) -> Self {
        let (mesh, runs) = geometry::joined(scene);
        let offset = geometry::offset(&mesh);
        let mut shape = Self { mesh, runs, nodes: vec![], leaves: vec![], offset };
        if shadows {
            shape.grow();
        }
        shape
    }

    /// Builds the tree of triangles that shadow rays are tested with.
    fn grow(&mut self) {
        if self.mesh.triangles.is_empty() {
            return;
        }
        let corner = |i: u32| Vec3A::from(self.mesh.vertices[i as usize].position);
        let triangle = |&[a, b, c]: &[u32; 3]| Triangle { v0: corner(a), v1: corner(b), v2: corner(c) };
        let triangles: Vec<Triangle> = self.mesh.triangles.iter().map(triangle).collect();
        let tree = build_bvh2_from_tris(&triangles, BvhBuildParams::medium_build(), &mut Duration::default());
        self.nodes = in_depth_first_order(&tree);
        let leaf = |&index: &u32| {
            let Triangle { v0, v1, v2 } = triangles[index as usize];
            let object = self.runs.partition_point(|run| run.end <= index) as u32;
            Leaf::new(v0.to_array(), [(v0 - v1).to_array(), (v2 - v0).to_array()], index, object)
        };
        self.leaves = tree.primitive_indices.iter().map(leaf).collect();
    }

    /// The vertices as the shader reads them, three four-vectors each.
    pub(super) fn vertices(&self) -> &[[Vec4; 3]] {
        const { assert!(size_of::<Vertex>() == size_of::<[Vec4; 3]>()) }
        bytemuck::cast_slice(&self.mesh.vertices)
    }
}

/// The nodes of a tree in an order that needs no stack: a node's first child after it, then its second.
fn in_depth_first_order(tree: &Bvh2) -> Vec<Node> {
    enum Step {
        Enter(usize),
        Leave(usize),
    }
    let mut nodes = Vec::with_capacity(tree.nodes.len());
    let mut steps = vec![Step::Enter(0)];
    while let Some(step) = steps.pop() {
        match step {
            Step::Enter(index) => {
                let node = &tree.nodes[index];
                if node.prim_count == 0 {
                    let child = node.first_index as usize;
                    steps.extend([Step::Leave(nodes.len()), Step::Enter(child + 1), Step::Enter(child)]);
                }
                nodes.push(Node {
                    low: node.aabb().min.to_array(),
                    first: node.first_index,
                    high: node.aabb().max.to_array(),
                    count: node.prim_count,
                });
            }
            Step::Leave(at) => nodes[at].first = nodes.len() as u32,
        }
    }
    nodes
}
