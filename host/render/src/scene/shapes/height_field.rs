//! Height fields: the smooth surface through samples of height on a grid, in right triangles as large as the
//! tolerance allows.
//!
//! The square of the texture is halved into right triangles again and again, across the longest side; a
//! triangle stays whole where all samples that it covers are within the tolerance of it, and both triangles
//! at a side are halved together (Evans et al. 2001, "Right-triangulated irregular networks").

use std::collections::HashMap;

use glam::{DVec2, DVec3, Vec2};

use super::tolerance as limits;
use crate::scene::mesh::{Mesh, Vertex};
use lobelia_base::error::{Error, Result};

/// Halvings of the square's sides at most: 2048 cells.
const MOST_LEVELS: u32 = 11;

/// Corners on the grid; the longest side is between the first two.
type Triangle = [[usize; 2]; 3];

/// Samples of height, row by row, row 0 at v = 0.
pub struct Heights<'a> {
    /// Samples a row.
    pub columns: usize,
    /// The samples, in scene units.
    pub samples: &'a [f64],
}

/// A sheet of `size` (along x and z), centred on the origin, that faces +y; u along +x, v along +z. The first
/// and last samples lie on its sides; between samples it is cubic (Catmull and Rom). Heights differ from that
/// surface by `tolerance` at most, measured along y.
///
/// # Errors Input errors for fewer than 2 × 2 samples, numbers that are not finite, and a tolerance that is
/// not positive or takes too many triangles.
pub fn height_field(heights: &Heights<'_>, size: [f64; 2], tolerance: f64) -> Result<Mesh> {
    limits::check(tolerance)?;
    if !size.iter().all(|&side| side.is_finite() && side > 0.0) {
        return Err(Error::input(format!(
            "key size: {size:?} has a side that is no length; use more than 0"
        )));
    }
    let Heights { columns, samples } = *heights;
    let rows = samples.len() / columns.max(1);
    if columns < 2 || rows < 2 || rows * columns != samples.len() {
        return Err(Error::input("heights must be two rows of two at least, all rows as long"));
    }
    if samples.iter().any(|height| !(*height as f32).is_finite()) {
        return Err(Error::input("heights must be finite"));
    }
    let surface = Surface { columns, rows, samples };
    let (grid, off) = Grid::new(&surface, tolerance)?;
    Ok(grid.mesh(&surface, size, tolerance - off))
}

/// The smooth surface.
struct Surface<'a> {
    columns: usize,
    rows: usize,
    samples: &'a [f64],
}

/// Weights of the four samples about a place between the middle two, and their derivatives.
fn weights(t: f64) -> [[f64; 4]; 2] {
    let (t2, t3) = (t * t, t * t * t);
    [
        [
            -0.5 * t3 + t2 - 0.5 * t,
            1.5 * t3 - 2.5 * t2 + 1.0,
            -1.5 * t3 + 2.0 * t2 + 0.5 * t,
            0.5 * (t3 - t2),
        ],
        [-1.5 * t2 + 2.0 * t - 0.5, 4.5 * t2 - 5.0 * t, -4.5 * t2 + 4.0 * t + 0.5, 1.5 * t2 - t],
    ]
}

impl Surface<'_> {
    /// A sample; beyond the sides it goes on straight.
    fn sample(&self, row: isize, column: isize) -> f64 {
        let clamp = |k: isize, count: usize| k.clamp(0, count as isize - 1);
        let inside = |row: isize, column: isize| self.samples[row as usize * self.columns + column as usize];
        let (r, c) = (clamp(row, self.rows), clamp(column, self.columns));
        let (mirror_r, mirror_c) = (clamp(2 * r - row, self.rows), clamp(2 * c - column, self.columns));
        2.0 * inside(r, c) - inside(mirror_r, mirror_c)
    }

    /// Height and its derivatives along u and v, at u and v in 0..1.
    fn at(&self, uv: DVec2) -> [f64; 3] {
        let cells = DVec2::new((self.columns - 1) as f64, (self.rows - 1) as f64);
        let place = uv * cells;
        let cell = place.floor().clamp(DVec2::ZERO, cells - 1.0);
        let [along_u, along_v] = (place - cell).to_array().map(weights);
        let mut found = [0.0; 3];
        for (j, i) in (0..16).map(|k| (k / 4, k % 4)) {
            let (row, column) = (j as isize - 1, i as isize - 1);
            let height = self.sample(cell.y as isize + row, cell.x as isize + column);
            found[0] += height * along_u[0][i] * along_v[0][j];
            found[1] += height * along_u[1][i] * along_v[0][j] * cells.x;
            found[2] += height * along_u[0][i] * along_v[1][j] * cells.y;
        }
        found
    }
}

/// Heights at the corners of 2^levels × 2^levels cells.
struct Grid {
    levels: u32,
    heights: Vec<f64>,
}

impl Grid {
    /// A grid whose own triangles leave the surface by a third of the tolerance at most where that can be,
    /// and how far they leave it.
    fn new(surface: &Surface<'_>, tolerance: f64) -> Result<(Self, f64)> {
        let longest = surface.columns.max(surface.rows) - 1;
        let mut levels = longest.next_power_of_two().ilog2().min(MOST_LEVELS);
        loop {
            let side = 1usize << levels;
            let place = |k: usize| DVec2::new((k % (side + 1)) as f64, (k / (side + 1)) as f64) / side as f64;
            let heights = (0..(side + 1) * (side + 1)).map(|k| surface.at(place(k))[0]).collect();
            let grid = Self { levels, heights };
            let off = grid.off(surface);
            if off <= tolerance / 3.0 {
                return Ok((grid, off));
            }
            if levels == MOST_LEVELS {
                return Err(Error::input(format!(
                    "key tolerance: {tolerance:e} takes more than {side} × {side} cells; use a larger one"
                )));
            }
            levels += 1;
        }
    }

    fn side(&self) -> usize {
        1 << self.levels
    }

    fn height(&self, [x, y]: [usize; 2]) -> f64 {
        self.heights[y * (self.side() + 1) + x]
    }

    /// How far the surface leaves the cells' triangles, whichever way a cell is halved, looked at between the
    /// corners.
    fn off(&self, surface: &Surface<'_>) -> f64 {
        let side = self.side();
        let mut worst = 0.0f64;
        for (x, y) in (0..side * side).map(|k| (k % side, k / side)) {
            let [a, b, c, d] = [[x, y], [x + 1, y], [x, y + 1], [x + 1, y + 1]].map(|at| self.height(at));
            for (dx, dy) in [(0.5, 0.0), (0.0, 0.5), (0.25, 0.25), (0.75, 0.75), (0.25, 0.75), (0.75, 0.25)] {
                let height = surface.at(DVec2::new(x as f64 + dx, y as f64 + dy) / side as f64)[0];
                let falling =
                    if dx >= dy { a + (b - a) * dx + (d - b) * dy } else { a + (c - a) * dy + (d - c) * dx };
                let rising = if dx + dy <= 1.0 {
                    a + (b - a) * dx + (c - a) * dy
                } else {
                    d + (c - d) * (1.0 - dx) + (b - d) * (1.0 - dy)
                };
                worst = worst.max((height - falling).abs()).max((height - rising).abs());
            }
        }
        worst
    }

    /// The triangles within `tolerance` of the grid's heights.
    fn mesh(&self, surface: &Surface<'_>, size: [f64; 2], tolerance: f64) -> Mesh {
        let side = self.side();
        let halves = [[[0, 0], [side, side], [side, 0]], [[side, side], [0, 0], [0, side]]];
        let halved = self.halved(&halves, tolerance);
        let mut mesh = Mesh::default();
        let mut indices = HashMap::new();
        let mut waiting = halves.to_vec();
        while let Some(triangle) = waiting.pop() {
            if self.can_halve(triangle) && halved[self.middle(triangle).1] {
                waiting.extend(self.children(triangle));
                continue;
            }
            mesh.triangles.push(triangle.map(|at| {
                *indices.entry(at).or_insert_with(|| {
                    mesh.vertices.push(self.vertex(surface, at, size));
                    mesh.vertices.len() as u32 - 1
                })
            }));
        }
        mesh
    }

    /// By the middle of a longest side, whether the triangles on both of its sides are halved there: where
    /// heights leave one of them, or one below them is halved. The smallest come first, so that those above
    /// know.
    fn halved(&self, halves: &[Triangle], tolerance: f64) -> Vec<bool> {
        let mut halved = vec![false; self.heights.len()];
        for depth in (0..2 * self.levels).rev() {
            let mut waiting: Vec<(Triangle, u32)> = halves.iter().map(|&half| (half, 0)).collect();
            while let Some((triangle, level)) = waiting.pop() {
                let children = self.children(triangle);
                if level < depth {
                    waiting.extend(children.map(|child| (child, level + 1)));
                    continue;
                }
                let place = self.middle(triangle).1;
                let below =
                    || children.iter().any(|&child| self.can_halve(child) && halved[self.middle(child).1]);
                if !halved[place] && self.can_halve(triangle) {
                    halved[place] = below() || self.leaves(triangle) > tolerance;
                }
            }
        }
        halved
    }

    /// The middle of a triangle's longest side, and its place in the grid.
    fn middle(&self, [a, b, _]: Triangle) -> ([usize; 2], usize) {
        let [x, y] = [0, 1].map(|axis| (a[axis] + b[axis]) / 2);
        ([x, y], y * (self.side() + 1) + x)
    }

    /// The halves of a triangle.
    fn children(&self, triangle @ [a, b, c]: Triangle) -> [Triangle; 2] {
        let middle = self.middle(triangle).0;
        [[c, a, middle], [b, c, middle]]
    }

    /// Whether the middle of the longest side is a point of the grid.
    fn can_halve(&self, [a, b, _]: Triangle) -> bool {
        a[0].abs_diff(b[0]).max(a[1].abs_diff(b[1])) > 1
    }

    /// How far heights within a triangle leave it.
    fn leaves(&self, [a, b, c]: Triangle) -> f64 {
        let [p, q, r] = [a, b, c].map(|[x, y]| DVec2::new(x as f64, y as f64));
        let area = (q - p).perp_dot(r - p);
        let [hp, hq, hr] = [a, b, c].map(|at| self.height(at));
        let range = |axis: usize| {
            let all = [a[axis], b[axis], c[axis]];
            all.into_iter().min().unwrap_or(0)..=all.into_iter().max().unwrap_or(0)
        };
        let mut worst = 0.0f64;
        for y in range(1) {
            for x in range(0) {
                let at = DVec2::new(x as f64, y as f64);
                let wq = (at - p).perp_dot(r - p) / area;
                let wr = (q - p).perp_dot(at - p) / area;
                if wq >= -1e-9 && wr >= -1e-9 && wq + wr <= 1.0 + 1e-9 {
                    let plane = hp + (hq - hp) * wq + (hr - hp) * wr;
                    worst = worst.max((plane - self.height([x, y])).abs());
                }
            }
        }
        worst
    }

    fn vertex(&self, surface: &Surface<'_>, at: [usize; 2], size: [f64; 2]) -> Vertex {
        let uv = DVec2::new(at[0] as f64, at[1] as f64) / self.side() as f64;
        let [height, du, dv] = surface.at(uv);
        let [slope_x, slope_z] = [du / size[0], dv / size[1]];
        let place = (uv - 0.5) * DVec2::from_array(size);
        Vertex {
            position: DVec3::new(place.x, height, place.y).as_vec3(),
            normal: DVec3::new(-slope_x, 1.0, -slope_z).normalize().as_vec3(),
            tangent: DVec3::new(1.0, slope_x, 0.0).normalize().as_vec3(),
            handedness: 1.0,
            uv: Vec2::new(uv.x as f32, uv.y as f32),
        }
    }
}
