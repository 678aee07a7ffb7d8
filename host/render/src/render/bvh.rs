//! The tree that finds the triangle a ray meets: four boxes a node and four triangles a packet, each four
//! tested at once in the lanes of a vector. obvhs builds the binary tree that it is collapsed from.

use std::time::Duration;

use glam::{Vec3, Vec3A, Vec4};
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::triangle::Triangle;

/// Children a node, triangles a packet.
const WIDTH: usize = 4;
/// Marks a child that is a leaf; the other bits are its first packet.
const LEAF: u32 = 1 << 31;
/// Levels of nodes; what a degenerate tree has below becomes one leaf.
const LEVELS: usize = 20;
/// Entries that wait at most: on every level all children but the one that is visited.
const WAITING: usize = LEVELS * (WIDTH - 1) + 1;
/// Boxes are left a little later, so that rounding loses no triangle.
const WIDER: f32 = 1.0 + 4.0 * f32::EPSILON;
/// A node: its children's boxes, lane by lane.
#[derive(Clone, Copy)]
struct Node {
    /// Lower and upper faces by axis. A child that is missing has an empty box.
    faces: [[Vec4; 2]; 3],
    /// Nodes or leaves.
    children: [u32; WIDTH],
}

/// Four triangles, lane by lane; a lane that is not used holds a point, which no ray meets.
#[derive(Clone, Copy)]
struct Packet {
    corners: [[Vec4; 3]; 3],
    /// (v₀ − v₁) × (v₂ − v₀).
    normal: [Vec4; 3],
    triangles: [u32; WIDTH],
    /// Whether the leaf ends here.
    last: bool,
}

/// A tree over triangles.
pub(crate) struct Bvh {
    nodes: Vec<Node>,
    packets: Vec<Packet>,
}

/// Where a ray met a triangle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hit {
    pub(crate) triangle: u32,
    /// Weights of the triangle's second and third corner, within rounding of 0..1.
    pub(crate) weights: [f32; 2],
}

/// A ray with each coordinate in all lanes.
struct Ray {
    origin: [Vec4; 3],
    /// By [`Self::axes`].
    direction: [Vec4; 3],
    inverse: [Vec4; 3],
    /// Index of the face by which a box is entered, by axis.
    near: [usize; 3],
    /// The axes, that of the direction's largest coordinate last.
    axes: [usize; 3],
    /// What of the last axis the others lose, for the ray to run along it.
    shear: [Vec4; 2],
}

impl Bvh {
    /// Builds the tree.
    pub(crate) fn new(triangles: &[Triangle]) -> Self {
        let mut built = Self { nodes: Vec::new(), packets: Vec::new() };
        if !triangles.is_empty() {
            let parameters =
                BvhBuildParams { max_prims_per_leaf: WIDTH as u32, ..BvhBuildParams::slow_build() };
            let binary = build_bvh2_from_tris(triangles, parameters, &mut Duration::default());
            // The root may be a leaf: it is then the only child.
            built.add_node(&binary, triangles, &[0], 0);
        }
        built
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.nodes[..]) + size_of_val(&self.packets[..])
    }

    /// Adds the node whose children are at first `roots` of the binary tree, opened largest first.
    fn add_node(&mut self, binary: &Bvh2, triangles: &[Triangle], roots: &[u32], level: usize) -> u32 {
        let mut children = roots.to_vec();
        let node = |index: u32| &binary.nodes[index as usize];
        while children.len() < WIDTH {
            let area = |index: u32| node(index).aabb().half_area();
            let inner = (0..children.len()).filter(|&k| !node(children[k]).is_leaf());
            let Some(largest) = inner.max_by(|&a, &b| area(children[a]).total_cmp(&area(children[b]))) else {
                break;
            };
            let first = node(children[largest]).first_index;
            children[largest] = first;
            children.push(first + 1);
        }
        let index = self.nodes.len();
        let empty = [Vec4::INFINITY, Vec4::NEG_INFINITY];
        self.nodes.push(Node { faces: [empty; 3], children: [0; WIDTH] });
        for (lane, &child) in children.iter().enumerate() {
            let (low, high) = (node(child).aabb().min, node(child).aabb().max);
            for (axis, faces) in self.nodes[index].faces.iter_mut().enumerate() {
                (faces[0][lane], faces[1][lane]) = (low[axis], high[axis]);
            }
            let added = if node(child).is_leaf() || level + 1 == LEVELS {
                self.add_leaf(&leaf_triangles(binary, child), triangles)
            } else {
                self.add_node(binary, triangles, &[child], level + 1)
            };
            self.nodes[index].children[lane] = added;
        }
        index as u32
    }

    fn add_leaf(&mut self, indices: &[u32], triangles: &[Triangle]) -> u32 {
        let first = self.packets.len() as u32;
        for four in indices.chunks(WIDTH) {
            let lanes = |vector: &dyn Fn(&Triangle) -> Vec3A| -> [Vec4; 3] {
                std::array::from_fn(|axis| {
                    let of = |lane| four.get(lane).map_or(0.0, |&i| vector(&triangles[i as usize])[axis]);
                    Vec4::from_array(std::array::from_fn(of))
                })
            };
            let triangles = std::array::from_fn(|lane| four.get(lane).copied().unwrap_or_default());
            self.packets.push(Packet {
                corners: [lanes(&|t| t.v0), lanes(&|t| t.v1), lanes(&|t| t.v2)],
                normal: lanes(&|t| (t.v0 - t.v1).cross(t.v2 - t.v0)),
                triangles,
                last: false,
            });
        }
        if let Some(packet) = self.packets.last_mut() {
            packet.last = true;
        }
        LEAF | first
    }

    /// The nearest triangle along a ray of unit direction that is `solid` at its distance, and that distance.
    pub(crate) fn nearest(
        &self,
        origin: Vec3,
        direction: Vec3,
        solid: impl Fn(u32, f32) -> bool,
    ) -> Option<(Hit, f32)> {
        let ray = Ray::new(origin, direction);
        let mut found = None;
        let mut reach = f32::INFINITY;
        // Distance in the upper half, child in the lower: distances are not negative, so integers sort them.
        let mut waiting = [0u64; WAITING];
        let mut count = usize::from(!self.nodes.is_empty());
        while count > 0 {
            count -= 1;
            let entry = waiting[count];
            if f32::from_bits((entry >> 32) as u32) > reach {
                continue;
            }
            let child = entry as u32;
            if child & LEAF != 0 {
                for packet in &self.packets[(child ^ LEAF) as usize..] {
                    let (mut lanes, distances, weights) = ray.meets(packet, reach);
                    while lanes != 0 {
                        let lane = lanes.trailing_zeros() as usize & 3;
                        lanes &= lanes - 1;
                        if distances[lane] < reach && solid(packet.triangles[lane], distances[lane]) {
                            reach = distances[lane];
                            let weights = weights.map(|weight| weight[lane]);
                            found = Some((Hit { triangle: packet.triangles[lane], weights }, reach));
                        }
                    }
                    if packet.last {
                        break;
                    }
                }
                continue;
            }
            let node = &self.nodes[child as usize];
            let (mut lanes, distances) = ray.enters(node, reach);
            let (distances, first) = (distances.to_array(), count);
            while lanes != 0 {
                let lane = lanes.trailing_zeros() as usize & 3;
                lanes &= lanes - 1;
                let entry = u64::from(distances[lane].to_bits()) << 32 | u64::from(node.children[lane]);
                // The nearest child comes last, to be visited first.
                let mut place = count;
                while place > first && waiting[place - 1] < entry {
                    waiting[place] = waiting[place - 1];
                    place -= 1;
                }
                waiting[place] = entry;
                count += 1;
            }
        }
        found
    }

    /// Whether any triangle lies on a ray of unit direction before `reach` and is `solid` at its distance.
    pub(crate) fn any(
        &self,
        origin: Vec3,
        direction: Vec3,
        reach: f32,
        solid: impl Fn(u32, f32) -> bool,
    ) -> bool {
        let ray = Ray::new(origin, direction);
        let mut waiting = [0u32; WAITING];
        let mut count = usize::from(!self.nodes.is_empty());
        while count > 0 {
            count -= 1;
            let child = waiting[count];
            if child & LEAF != 0 {
                for packet in &self.packets[(child ^ LEAF) as usize..] {
                    let (mut lanes, distances, _) = ray.meets(packet, reach);
                    while lanes != 0 {
                        let lane = lanes.trailing_zeros() as usize & 3;
                        lanes &= lanes - 1;
                        if solid(packet.triangles[lane], distances[lane]) {
                            return true;
                        }
                    }
                    if packet.last {
                        break;
                    }
                }
                continue;
            }
            let node = &self.nodes[child as usize];
            let (mut lanes, _) = ray.enters(node, reach);
            while lanes != 0 {
                let lane = lanes.trailing_zeros() as usize & 3;
                lanes &= lanes - 1;
                waiting[count] = node.children[lane];
                count += 1;
            }
        }
        false
    }
}

/// The triangles below a node of the binary tree.
fn leaf_triangles(binary: &Bvh2, root: u32) -> Vec<u32> {
    let (mut found, mut waiting) = (Vec::new(), vec![root]);
    while let Some(index) = waiting.pop() {
        let node = &binary.nodes[index as usize];
        let first = node.first_index;
        if node.is_leaf() {
            found.extend(&binary.primitive_indices[first as usize..(first + node.prim_count) as usize]);
        } else {
            waiting.extend([first, first + 1]);
        }
    }
    found
}

impl Ray {
    fn new(origin: Vec3, direction: Vec3) -> Self {
        let splat = |v: Vec3| v.to_array().map(Vec4::splat);
        // Finite, so that a face through the origin gives 0 and not NaN.
        let inverse =
            direction.to_array().map(|d| 1.0 / if d.abs() < 1e-18 { 1e-18f32.copysign(d) } else { d });
        let longest = direction.abs().max_position();
        let axes = [(longest + 1) % 3, (longest + 2) % 3, longest];
        let shear = |k: usize| Vec4::splat(direction[axes[k]] / direction[longest]);
        Self {
            origin: splat(origin),
            direction: axes.map(|axis| Vec4::splat(direction[axis])),
            inverse: inverse.map(Vec4::splat),
            near: inverse.map(|i| usize::from(i < 0.0)),
            axes,
            shear: [shear(0), shear(1)],
        }
    }

    /// The children whose boxes the ray enters before `reach`, one bit each, and where.
    #[inline(always)]
    fn enters(&self, node: &Node, reach: f32) -> (u32, Vec4) {
        let distance =
            |axis: usize, face: usize| (node.faces[axis][face & 1] - self.origin[axis]) * self.inverse[axis];
        let [x, y, z] = self.near;
        let enter = distance(0, x).max(distance(1, y)).max(distance(2, z).max(Vec4::ZERO));
        let leave = distance(0, 1 ^ x).min(distance(1, 1 ^ y)).min(distance(2, 1 ^ z)) * WIDER;
        (enter.cmple(leave.min(Vec4::splat(reach))).bitmask(), enter)
    }

    /// The triangles that the ray meets before `reach`, one bit each, and where: distance, and weights of the
    /// second and the third corner.
    ///
    /// Whether the ray passes inside is told by edges in the plane across it (Woop, Benthin and Wald 2013):
    /// an edge has the same value, but for the sign, in both of its triangles, so that no ray slips between
    /// them. The distance is that of the plane, which is exact where the plane is along two axes.
    #[inline(always)]
    fn meets(&self, packet: &Packet, reach: f32) -> (u32, Vec4, [Vec4; 2]) {
        let [i, j, k] = self.axes.map(|axis| axis.min(2));
        let to = |corner: usize| [i, j, k].map(|axis| packet.corners[corner][axis] - self.origin[axis]);
        let across = |to: [Vec4; 3]| [to[0] - self.shear[0] * to[2], to[1] - self.shear[1] * to[2]];
        let first = to(0);
        let [[ax, ay], [bx, by], [cx, cy]] = [first, to(1), to(2)].map(across);
        let (u, v, w) = (cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax);
        let (least, most) = (u.min(v).min(w), u.max(v).max(w));
        let inside = least.cmpge(Vec4::ZERO) | most.cmple(Vec4::ZERO);
        let normal = [i, j, k].map(|axis| packet.normal[axis]);
        // A ray in the triangle's plane makes this NaN or infinite, which is a miss.
        let distance = dot(&normal, &first) / dot(&normal, &self.direction);
        let within = distance.cmpgt(Vec4::ZERO) & distance.cmplt(Vec4::splat(reach));
        let inverse = Vec4::ONE / (u + v + w);
        ((inside & within).bitmask(), distance, [v * inverse, w * inverse])
    }
}

#[inline(always)]
fn dot(a: &[Vec4; 3], b: &[Vec4; 3]) -> Vec4 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::sampler::hash;

    fn unit(seed: u32) -> f32 {
        hash(seed) as f32 / u32::MAX as f32
    }

    fn vector(seed: u32) -> Vec3A {
        Vec3A::new(unit(3 * seed), unit(3 * seed + 1), unit(3 * seed + 2)) * 2.0 - 1.0
    }

    /// Triangles of many sizes, large ones among them, and all of them twice.
    fn soup(count: u32) -> Vec<Triangle> {
        let one = |i: u32| {
            let size = 2.0 * unit(7 * i).powi(6) + 0.05;
            let corner = |k: u32| vector(i) + vector(1_000_000 + 3 * i + k) * size;
            Triangle { v0: corner(0), v1: corner(1), v2: corner(2) }
        };
        (0..2 * count).map(|i| one(i % count)).collect()
    }

    /// Möller and Trumbore's test in f64.
    fn distance(triangle: &Triangle, origin: Vec3, direction: Vec3) -> Option<f64> {
        let corner = triangle.v0.as_dvec3();
        let (a, b) = (triangle.v1.as_dvec3() - corner, triangle.v2.as_dvec3() - corner);
        let (to, d) = (origin.as_dvec3() - corner, direction.as_dvec3());
        let determinant = a.dot(d.cross(b));
        let u = to.dot(d.cross(b)) / determinant;
        let v = d.dot(to.cross(a)) / determinant;
        let t = b.dot(to.cross(a)) / determinant;
        (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t >= 0.0).then_some(t)
    }

    #[test]
    fn the_tree_finds_what_a_search_of_all_triangles_finds() {
        for count in [1, 3, 5, 400] {
            let triangles = soup(count);
            let bvh = Bvh::new(&triangles);
            let mut hits = 0;
            for ray in 0..2000 {
                let origin = Vec3::from(vector(5_000_000 + ray)) * 2.0;
                // Every other ray aims at the middle of a triangle.
                let one = &triangles[ray as usize % triangles.len()];
                let aim =
                    if ray % 2 == 0 { vector(6_000_000 + ray) } else { (one.v0 + one.v1 + one.v2) / 3.0 };
                let mut direction = (Vec3::from(aim) - origin).normalize();
                if ray % 10 == 0 {
                    // Along an axis, where the boxes' planes are parallel to the ray.
                    direction = Vec3::AXES[ray as usize % 3] * if ray % 20 == 0 { 1.0 } else { -1.0 };
                }
                let all = triangles.iter().filter_map(|t| distance(t, origin, direction));
                let expected = all.fold(f64::INFINITY, f64::min);
                let found = bvh
                    .nearest(origin, direction, |_, _| true)
                    .map_or(f64::INFINITY, |(_, distance)| f64::from(distance));
                // Triangles seen nearly edge on are met less exactly.
                let same = expected == found || (expected - found).abs() < 2e-3;
                assert!(same, "{count} triangles, ray {ray}: {found} instead of {expected}");
                if expected.is_finite() {
                    hits += 1;
                    assert!(bvh.any(origin, direction, expected as f32 + 5e-3, |_, _| true));
                    assert!(!bvh.any(origin, direction, expected as f32 - 5e-3, |_, _| true));
                }
            }
            assert!(hits > 900, "{hits} of the rays meet {count} triangles");
        }
        assert!(Bvh::new(&[]).nearest(Vec3::ZERO, Vec3::X, |_, _| true).is_none());
    }

    #[test]
    fn a_tree_deeper_than_its_levels_ends_in_leaves_of_many_packets() {
        let triangles = soup(20);
        let mut bvh = Bvh::new(&[]);
        let parameters = BvhBuildParams { max_prims_per_leaf: 1, ..BvhBuildParams::fast_build() };
        let binary = build_bvh2_from_tris(&triangles, parameters, &mut Duration::default());
        bvh.add_node(&binary, &triangles, &[0], LEVELS - 1);
        let whole = Bvh::new(&triangles);
        assert!(bvh.nodes.len() == 1 && bvh.packets.iter().any(|packet| !packet.last));
        for ray in 0..500 {
            let (origin, direction) =
                (Vec3::from(vector(ray)), Vec3::from(vector(900_000 + ray)).normalize());
            let distance =
                |bvh: &Bvh| bvh.nearest(origin, direction, |_, _| true).map(|(_, distance)| distance);
            assert_eq!(distance(&bvh), distance(&whole));
        }
    }
}
