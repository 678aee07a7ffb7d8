//! Surfaces of bicubic Bézier patches: points, derivatives, normals with their limits at degenerate edges,
//! and triangles to a tolerance.

mod file;
mod tessellate;
#[cfg(test)]
mod tests;

use std::collections::HashMap;

use glam::DVec3;

use super::shapes::tolerance::USUAL as USUAL_TOLERANCE;
use lobelia_base::error::{Error, Result};

/// Newell's teapot (1975): 32 patches, the last four of which are its bottom; z points up.
const TEAPOT: &str = include_str!("../../../../../examples/meshes/teapot.bpt");
/// Patches of the teapot without its bottom.
const BOTTOMLESS: usize = 28;
/// Area of du × dv, in squares of the patch's size, below which it has no direction.
const DEGENERATE: f64 = 1e-9;

/// A bicubic Bézier patch: control points by row along u, then along v.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patch(pub [[DVec3; 4]; 4]);

/// A point of a patch with its derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// The point.
    pub position: DVec3,
    /// First derivatives along u and v.
    pub first: [DVec3; 2],
    /// Second derivatives uu, uv, vv.
    pub second: [DVec3; 3],
}

/// Patches over shared control points.
#[derive(Debug, Clone, PartialEq)]
pub struct Patches {
    /// Control points.
    pub points: Vec<DVec3>,
    /// Sixteen indices a patch: rows of u, then v.
    pub patches: Vec<[u32; 16]>,
    /// Whether du × dv points to the outside.
    pub outward: bool,
}

/// Bernstein's polynomials of degree 3 with their first and second derivatives.
fn bernstein(t: f64) -> [[f64; 4]; 3] {
    let s = 1.0 - t;
    [
        [s * s * s, 3.0 * s * s * t, 3.0 * s * t * t, t * t * t],
        [-3.0 * s * s, 3.0 * s * (s - 2.0 * t), 3.0 * t * (2.0 * s - t), 3.0 * t * t],
        [6.0 * s, 6.0 * (t - 2.0 * s), 6.0 * (s - 2.0 * t), 6.0 * t],
    ]
}

/// A point of a cubic Bézier curve.
fn on_curve(points: [DVec3; 4], t: f64) -> DVec3 {
    let [weights, ..] = bernstein(t);
    (0..4).map(|k| points[k] * weights[k]).sum()
}

impl Patch {
    /// The point at (u, v) in 0..1.
    pub fn at(&self, u: f64, v: f64) -> Point {
        let (along_u, along_v) = (bernstein(u), bernstein(v));
        let sum = |i: usize, j: usize| -> DVec3 {
            let row = |row: &[DVec3; 4]| (0..4).map(|l| row[l] * along_v[j][l]).sum::<DVec3>();
            (0..4).map(|k| row(&self.0[k]) * along_u[i][k]).sum()
        };
        Point {
            position: sum(0, 0),
            first: [sum(1, 0), sum(0, 1)],
            second: [sum(2, 0), sum(1, 1), sum(0, 2)],
        }
    }

    /// The unit normal along du × dv. Where that vanishes, its limit from within the patch: of the derivative
    /// of du × dv along u, else along v, else of a point a little further in.
    pub fn normal(&self, u: f64, v: f64) -> DVec3 {
        let size = self.size();
        let has_length = |n: DVec3| (n.length() > DEGENERATE * size * size).then(|| n.normalize());
        let Point { first: [du, dv], second: [duu, duv, dvv], .. } = self.at(u, v);
        let inward = |t: f64| if t < 0.5 { 1.0 } else { -1.0 };
        has_length(du.cross(dv))
            .or_else(|| has_length((duu.cross(dv) + du.cross(duv)) * inward(u)))
            .or_else(|| has_length((duv.cross(dv) + du.cross(dvv)) * inward(v)))
            .unwrap_or_else(|| {
                const STEP: f64 = 1e-3;
                let point = self.at(u + inward(u) * STEP, v + inward(v) * STEP);
                point.first[0].cross(point.first[1]).normalize_or(DVec3::Y)
            })
    }

    /// The unit direction in which v grows: where dv vanishes, its limit from within the patch.
    pub fn along_v(&self, u: f64, v: f64) -> DVec3 {
        let limit = DEGENERATE.sqrt() * self.size();
        let Point { first: [_, dv], second: [_, duv, dvv], .. } = self.at(u, v);
        let inward = |t: f64| if t < 0.5 { 1.0 } else { -1.0 };
        [dv, duv * inward(u), dvv * inward(v)]
            .into_iter()
            .find(|direction| direction.length() > limit)
            .map_or(DVec3::ZERO, DVec3::normalize)
    }

    /// Longest side of the box about the control points.
    fn size(&self) -> f64 {
        let points = || self.0.iter().flatten().copied();
        let low = points().fold(DVec3::INFINITY, DVec3::min);
        (points().fold(DVec3::NEG_INFINITY, DVec3::max) - low).max_element()
    }
}

impl Patches {
    /// Patches of control points by index; control points at one place become one. The outside is where the
    /// enclosed volume is positive; patches that enclose none face along du × dv.
    ///
    /// # Errors
    /// Input errors for no patches, an index beyond the points, and numbers that are not finite.
    pub fn new(points: &[DVec3], patches: &[[u32; 16]]) -> Result<Self> {
        if patches.is_empty() {
            return Err(Error::input("there are no patches"));
        }
        if let Some(k) = points.iter().position(|point| !point.as_vec3().is_finite()) {
            return Err(Error::input(format!("control point {k} is not finite")));
        }
        if let Some(k) = patches.iter().position(|patch| patch.iter().any(|&i| i as usize >= points.len())) {
            return Err(Error::input(format!("patch {k} names a control point beyond the {}", points.len())));
        }
        let mut places = HashMap::new();
        let mut kept = Vec::new();
        let merged: Vec<u32> = points
            .iter()
            .map(|&point| {
                // Adding 0 makes −0 the same place.
                *places.entry((point + 0.0).to_array().map(f64::to_bits)).or_insert_with(|| {
                    kept.push(point);
                    kept.len() as u32 - 1
                })
            })
            .collect();
        let patches = patches.iter().map(|patch| patch.map(|i| merged[i as usize])).collect();
        let mut made = Self { points: kept, patches, outward: true };
        made.outward = made.volume() >= 0.0;
        Ok(made)
    }

    /// Newell's teapot with y up, standing on y = 0, 3.15 high; its bottom was not in the original.
    ///
    /// # Errors
    /// None: its file comes with the program.
    pub fn teapot(bottom: bool) -> Result<Self> {
        let mut all = Self::parse(TEAPOT)?;
        if !bottom {
            all.patches.truncate(BOTTOMLESS);
        }
        for point in &mut all.points {
            *point = DVec3::new(point.x, point.z, -point.y);
        }
        Ok(all)
    }

    /// The tolerance that a mesh has where none is named: 1/2000 of its longest side.
    pub fn usual_tolerance(&self) -> f64 {
        self.extent().0 * USUAL_TOLERANCE
    }

    /// A patch by its number.
    pub fn patch(&self, index: usize) -> Patch {
        let point = |k: usize| self.points[self.patches[index][k] as usize];
        Patch(std::array::from_fn(|u| std::array::from_fn(|v| point(4 * u + v))))
    }

    /// The longest side of the box about the control points, and their middle.
    fn extent(&self) -> (f64, DVec3) {
        let low = self.points.iter().copied().fold(DVec3::INFINITY, DVec3::min);
        let high = self.points.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
        ((high - low).max_element(), (low + high) / 2.0)
    }

    /// Volume that the patches enclose as seen from their middle, with the sign of du × dv; 0 where it is
    /// lost in rounding.
    fn volume(&self) -> f64 {
        const STEPS: usize = 8;
        let (size, middle) = self.extent();
        let mut sum = 0.0;
        for index in 0..self.patches.len() {
            let patch = self.patch(index);
            for k in 0..STEPS * STEPS {
                let [u, v] = [k / STEPS, k % STEPS].map(|k| (k as f64 + 0.5) / STEPS as f64);
                let Point { position, first: [du, dv], .. } = patch.at(u, v);
                sum += (position - middle).dot(du.cross(dv));
            }
        }
        let volume = sum / (3.0 * (STEPS * STEPS) as f64);
        if volume.abs() > 1e-6 * size.powi(3) { volume } else { 0.0 }
    }
}
