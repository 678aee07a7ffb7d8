//! Triangles of patches: a grid a patch, as fine as the tolerance asks. Patches that share an edge have as
//! many cells along it and the same points on it, so that the mesh is closed where the patches are.

use std::collections::HashMap;

use glam::{DVec3, Vec2};
use rayon::prelude::*;

use super::{Patch, Patches, Point, on_curve};
use crate::scene::frame::perpendicular;
use crate::scene::mesh::{Mesh, RawMesh, Vertex};
use crate::scene::shapes::tolerance as limits;
use lobelia_base::error::Result;

/// Cells along u or v of a patch at most.
const MOST: f64 = 4096.0;
/// Rounds in which the numbers of cells may fall, and in which they settle.
const ROUNDS: [usize; 2] = [3, 24];
/// Where in a triangle its distance from the surface is looked at: weights of the corners.
const LOOKS: [[f64; 3]; 7] = [
    [0.5, 0.5, 0.0],
    [0.0, 0.5, 0.5],
    [0.5, 0.0, 0.5],
    [1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0],
    [0.6, 0.2, 0.2],
    [0.2, 0.6, 0.2],
    [0.2, 0.2, 0.6],
];

/// The control points of the edges u = 0, u = 1, v = 0 and v = 1, and the axis along which each runs.
const EDGES: [([usize; 4], usize); 4] =
    [([0, 1, 2, 3], 1), ([12, 13, 14, 15], 1), ([0, 4, 8, 12], 0), ([3, 7, 11, 15], 0)];

impl Patches {
    /// Triangles at most `tolerance` from the patches, and what their positions are relative to, as for
    /// [`Mesh::read`]. Texture coordinates run from 0 to 1 over each patch, v along the patch's u.
    ///
    /// # Errors
    /// Input errors for a tolerance that is not positive or takes too many triangles.
    pub fn mesh(&self, tolerance: f64) -> Result<(Mesh, DVec3)> {
        limits::check(tolerance)?;
        let origin = RawMesh { positions: self.points.clone(), ..RawMesh::default() }.origin();
        let cells = self.cells(tolerance)?;
        let mut mesh = Mesh::default();
        let grids: Vec<Mesh> = (0..self.patches.len())
            .into_par_iter()
            .map(|index| self.grid(index, cells[index], origin))
            .collect();
        for grid in grids {
            let first = mesh.vertices.len() as u32;
            mesh.vertices.extend(grid.vertices);
            mesh.triangles.extend(grid.triangles.iter().map(|triangle| triangle.map(|i| i + first)));
        }
        Ok((mesh, origin))
    }

    /// Cells along u and v by patch.
    pub(super) fn cells(&self, tolerance: f64) -> Result<Vec<[usize; 2]>> {
        let all: Vec<Patch> = (0..self.patches.len()).map(|index| self.patch(index)).collect();
        let classes = self.classes();
        let mut counts = vec![1usize; classes.len()];
        let wanted: Vec<[f64; 2]> = all.par_iter().map(|patch| estimate(patch, tolerance)).collect();
        for (node, &class) in classes.iter().enumerate() {
            counts[class] = counts[class].max(wanted[node / 2][node % 2].min(MOST) as usize);
        }
        let of = |counts: &[usize], index: usize| [0, 1].map(|axis| counts[classes[2 * index + axis]]);
        for round in 0..ROUNDS[1] {
            let triangles: f64 = (0..all.len())
                .map(|index| of(&counts, index).iter().map(|&count| count as f64).product::<f64>() * 2.0)
                .sum();
            limits::check_triangles(triangles, tolerance)?;
            let ratios: Vec<f64> = (0..all.len())
                .into_par_iter()
                .map(|index| deviation(&all[index], of(&counts, index)) / tolerance)
                .collect();
            if round >= ROUNDS[0] && ratios.iter().all(|&ratio| ratio <= 1.0) {
                break;
            }
            let mut worst = vec![0.0f64; counts.len()];
            for (node, &class) in classes.iter().enumerate() {
                worst[class] = worst[class].max(ratios[node / 2]);
            }
            for (count, worst) in counts.iter_mut().zip(worst) {
                if worst > 1.0 || round < ROUNDS[0] {
                    *count = (*count as f64 * worst.sqrt().clamp(0.5, 2.0)).ceil().min(MOST) as usize;
                }
            }
        }
        Ok((0..all.len()).map(|index| of(&counts, index)).collect())
    }

    /// By patch and axis, two entries a patch, which of them must have as many cells: opposite edges of a
    /// patch have, and the patches on both sides of an edge.
    fn classes(&self) -> Vec<usize> {
        let mut above: Vec<usize> = (0..2 * self.patches.len()).collect();
        fn root(above: &[usize], mut node: usize) -> usize {
            while above[node] != node {
                node = above[node];
            }
            node
        }
        let mut seen = HashMap::new();
        for index in 0..self.patches.len() {
            for (corners, axis) in EDGES {
                let edge = corners.map(|k| self.patches[index][k]);
                if edge.iter().all(|&i| i == edge[0]) {
                    continue;
                }
                let node = root(&above, 2 * index + axis);
                let other = *seen.entry(canonical(edge).0).or_insert(node);
                let other = root(&above, other);
                above[node] = other;
            }
        }
        (0..above.len()).map(|node| root(&above, node)).collect()
    }

    /// The triangles of a patch.
    pub(super) fn grid(&self, index: usize, [rows, columns]: [usize; 2], origin: DVec3) -> Mesh {
        let patch = self.patch(index);
        let side = if self.outward { 1.0 } else { -1.0 };
        let mut mesh = Mesh::default();
        for row in 0..=rows {
            for column in 0..=columns {
                let [u, v] = [row as f64 / rows as f64, column as f64 / columns as f64];
                let position = self
                    .on_edge(index, [row, column], [rows, columns])
                    .unwrap_or_else(|| patch.at(u, v).position);
                let normal = (patch.normal(u, v) * side).as_vec3();
                // So that the texture is not mirrored seen from outside.
                let across = if self.outward { v } else { 1.0 - v };
                mesh.vertices.push(Vertex {
                    position: (position - origin).as_vec3(),
                    normal,
                    tangent: perpendicular((patch.along_v(u, v) * side).as_vec3(), normal),
                    handedness: 1.0,
                    uv: Vec2::new(across as f32, u as f32),
                });
            }
        }
        let at = |row: usize, column: usize| (row * (columns + 1) + column) as u32;
        for (row, column) in (0..rows * columns).map(|k| (k / columns, k % columns)) {
            let [a, b, c, d] =
                [at(row, column), at(row + 1, column), at(row + 1, column + 1), at(row, column + 1)];
            for triangle in [[a, b, c], [a, c, d]] {
                let [p, q, r] = triangle.map(|i| mesh.vertices[i as usize].position);
                // At a degenerate edge every other triangle has two corners in one point.
                if p != q && q != r && r != p {
                    let [a, b, c] = triangle;
                    mesh.triangles.push(if self.outward { [a, b, c] } else { [a, c, b] });
                }
            }
        }
        mesh
    }

    /// A grid's point that lies on an edge of the patch, by the edge's control points alone.
    fn on_edge(&self, index: usize, [row, column]: [usize; 2], [rows, columns]: [usize; 2]) -> Option<DVec3> {
        let (edge, step, steps) = match (row, column) {
            (0, _) => (0, column, columns),
            (row, _) if row == rows => (1, column, columns),
            (_, 0) => (2, row, rows),
            (_, column) if column == columns => (3, row, rows),
            _ => return None,
        };
        let (corners, turned) = canonical(EDGES[edge].0.map(|k| self.patches[index][k]));
        let step = if turned { steps - step } else { step };
        Some(on_curve(corners.map(|i| self.points[i as usize]), step as f64 / steps as f64))
    }
}

/// An edge in the direction that all its patches agree on, and whether it was turned for that.
fn canonical(edge: [u32; 4]) -> ([u32; 4], bool) {
    let [a, b, c, d] = edge;
    let turned = [d, c, b, a];
    if turned < edge { (turned, true) } else { (edge, false) }
}

/// The fewest cells along u and v with which curvature keeps the triangles within a tolerance: over cells of
/// a × b a surface of second fundamental form L, M, N leaves its triangles by (|L| a² + 2 |M| a b + |N| b²) /
/// 8 at most.
fn estimate(patch: &Patch, tolerance: f64) -> [f64; 2] {
    const LOOKS: usize = 12;
    let forms: Vec<[f64; 3]> = (0..=LOOKS)
        .flat_map(|i| (0..=LOOKS).map(move |j| [i, j].map(|k| k as f64 / LOOKS as f64)))
        .map(|[u, v]| {
            let normal = patch.normal(u, v);
            patch.at(u, v).second.map(|second| second.dot(normal).abs())
        })
        .collect();
    let along_u = |columns: f64| -> f64 {
        let widest = |&[l, m, n]: &[f64; 3]| {
            let (m, left) = (m / columns, 8.0 * tolerance - n / (columns * columns));
            if left <= 0.0 {
                return 0.0;
            }
            // The positive root of l x² + 2 m x = left, in the form that l = 0 leaves finite.
            left / (m + (m * m + l * left).sqrt()).max(f64::MIN_POSITIVE)
        };
        1.0 / forms.iter().map(widest).fold(1.0, f64::min)
    };
    let mut best = [MOST, MOST];
    let mut columns = 1.0f64;
    while columns <= MOST {
        let rows = along_u(columns).ceil();
        if rows * columns < best[0] * best[1] {
            best = [rows, columns];
        }
        columns = (columns * 1.05).ceil().max(columns + 1.0);
    }
    best
}

/// The largest distance of a patch's triangles from the patch, along its normal, where it is looked at.
fn deviation(patch: &Patch, [rows, columns]: [usize; 2]) -> f64 {
    let place = |row: usize, column: usize| [row as f64 / rows as f64, column as f64 / columns as f64];
    let mut worst = 0.0f64;
    for (row, column) in (0..rows * columns).map(|k| (k / columns, k % columns)) {
        let [a, b, c, d] =
            [place(row, column), place(row + 1, column), place(row + 1, column + 1), place(row, column + 1)]
                .map(|[u, v]| ([u, v], patch.at(u, v).position));
        for corners in [[a, b, c], [a, c, d]] {
            for weights in LOOKS {
                let mut on_triangle = DVec3::ZERO;
                let mut at = [0.0; 2];
                for (([u, v], position), weight) in corners.iter().zip(weights) {
                    on_triangle += *position * weight;
                    at[0] += u * weight;
                    at[1] += v * weight;
                }
                let Point { position, .. } = patch.at(at[0], at[1]);
                worst = worst.max((on_triangle - position).dot(patch.normal(at[0], at[1])).abs());
            }
        }
    }
    worst
}
