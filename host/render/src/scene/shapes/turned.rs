//! Surfaces of revolution about the y axis: a profile of lines, arcs and cubic curves, turned.

use std::f64::consts::{FRAC_PI_4, TAU};

use glam::{DVec2, DVec3, Vec2};

use super::tolerance as limits;
use crate::scene::mesh::{Mesh, Vertex};
use lobelia_base::error::{Error, Result};

/// Columns at least.
const LEAST: f64 = 8.0;
/// Places of a segment where its curvature is looked at.
const LOOKS: usize = 64;

/// A piece of a profile over t in 0..1; x is the radius, y the height.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Segment {
    /// From a point to another.
    Line([DVec2; 2]),
    /// Part of a circle; angles from the direction of the radius toward that of the height, radians.
    Arc {
        /// The circle's centre.
        centre: DVec2,
        /// The circle's radius.
        radius: f64,
        /// Angle at t = 0.
        from: f64,
        /// Angle at t = 1.
        to: f64,
    },
    /// A cubic Bézier curve.
    Cubic([DVec2; 4]),
}

impl Segment {
    /// The point and the first two derivatives.
    fn at(&self, t: f64) -> [DVec2; 3] {
        let s = 1.0 - t;
        match *self {
            Self::Line([a, b]) => [a * s + b * t, b - a, DVec2::ZERO],
            Self::Arc { centre, radius, from, to } => {
                let turn = to - from;
                let toward = DVec2::from_angle(from + turn * t) * radius;
                let point = centre + toward;
                // A pole lies on the axis and not a rounding beside it.
                let on_axis = point.x.abs() < 1e-12 * radius;
                let point = if on_axis { DVec2::new(0.0, point.y) } else { point };
                [point, toward.perp() * turn, -toward * (turn * turn)]
            }
            Self::Cubic([a, b, c, d]) => [
                a * (s * s * s) + b * (3.0 * s * s * t) + c * (3.0 * s * t * t) + d * (t * t * t),
                ((b - a) * (s * s) + (c - b) * (2.0 * s * t) + (d - c) * (t * t)) * 3.0,
                ((c - b * 2.0 + a) * s + (d - c * 2.0 + b) * t) * 6.0,
            ],
        }
    }

    /// The outward normal in the profile's plane; where the curve stands still, that of a little further in.
    fn normal(&self, t: f64) -> DVec2 {
        const STEP: f64 = 1e-4;
        let still = 1e-9 * self.size();
        let along = [t, if t < 0.5 { t + STEP } else { t - STEP }]
            .map(|t| self.at(t)[1])
            .into_iter()
            .find(|along| along.length() > still)
            .unwrap_or(DVec2::NEG_Y);
        along.perp().normalize()
    }

    /// Length from its start to `t`, by Simpson's rule.
    fn length(&self, t: f64) -> f64 {
        const STEPS: usize = 64;
        let speed = |k: usize| self.at(t * k as f64 / STEPS as f64)[1].length();
        let weight = |k: usize| match k {
            0 | STEPS => 1.0,
            k if k % 2 == 1 => 4.0,
            _ => 2.0,
        };
        (0..=STEPS).map(|k| weight(k) * speed(k)).sum::<f64>() * t / (3.0 * STEPS as f64)
    }

    fn size(&self) -> f64 {
        match *self {
            Self::Line([a, b]) => a.distance(b),
            Self::Arc { radius, .. } => radius,
            Self::Cubic([a, b, c, d]) => a.distance(b) + b.distance(c) + c.distance(d),
        }
    }

    /// The same piece from its end to its start.
    fn reversed(&self) -> Self {
        match *self {
            Self::Line([a, b]) => Self::Line([b, a]),
            Self::Arc { centre, radius, from, to } => Self::Arc { centre, radius, from: to, to: from },
            Self::Cubic([a, b, c, d]) => Self::Cubic([d, c, b, a]),
        }
    }

    /// Curvature around the axis and along the profile, each as the second derivative along the normal over
    /// the whole turn and the whole piece.
    fn curvature(&self, t: f64) -> [f64; 2] {
        let (normal, [point, _, second]) = (self.normal(t), self.at(t));
        [TAU * TAU * (point.x * normal.x).abs(), second.dot(normal).abs()]
    }

    /// Rows at least, so that the form is not lost.
    fn least_rows(&self) -> f64 {
        match *self {
            Self::Line(_) => 1.0,
            Self::Arc { from, to, .. } => ((to - from).abs() / FRAC_PI_4).ceil().max(1.0),
            Self::Cubic([a, b, c, d]) => {
                let off = [b, c].map(|p| (p - a).perp_dot(d - a).abs());
                let straight = off.iter().all(|&off| off <= 1e-12 * self.size() * self.size());
                if straight { 1.0 } else { 3.0 }
            }
        }
    }

    /// Rows that keep within a tolerance with so many columns, if any do.
    fn rows(&self, columns: f64, tolerance: f64) -> Option<f64> {
        let mut squared = 0.0f64;
        for k in 0..=LOOKS {
            let [around, along] = self.curvature(k as f64 / LOOKS as f64);
            let left = 8.0 * tolerance - around / (columns * columns);
            if left < 0.0 || (left == 0.0 && along > 0.0) {
                return None;
            }
            if along > 0.0 {
                squared = squared.max(along / left);
            }
        }
        let mut rows = squared.sqrt().ceil().max(self.least_rows());
        // A cubic is not run through evenly: the chords tell.
        while matches!(self, Self::Cubic(_)) && self.off_chords(rows, columns) > tolerance {
            rows = (rows * 1.03).ceil().max(rows + 1.0);
        }
        Some(rows)
    }

    /// Largest distance of the triangles of so many rows and columns, along the normal.
    fn off_chords(&self, rows: f64, columns: f64) -> f64 {
        let mut worst = 0.0f64;
        for row in 0..rows as usize {
            let [from, to] = [row, row + 1].map(|row| row as f64 / rows);
            let [a, b] = [self.at(from)[0], self.at(to)[0]];
            for part in [0.0, 0.25, 0.5, 0.75, 1.0] {
                let t = from + (to - from) * part;
                let off = (a + (b - a) * part - self.at(t)[0]).dot(self.normal(t)).abs();
                worst = worst.max(off + self.curvature(t)[0] / (8.0 * columns * columns));
            }
        }
        worst
    }
}

/// A profile turned about the y axis, its triangles at most `tolerance` from the surface. u runs once around
/// to the east from +z, v along the profile by its length. The profile is taken in the direction in which its
/// left, the outside, is away from the axis: downwards where it bounds the surface outside.
///
/// # Errors Input errors for a profile without length, a radius below 0, numbers that are not finite, and a
/// tolerance that is not positive or takes too many triangles.
pub fn turned(profile: &[Segment], tolerance: f64) -> Result<Mesh> {
    limits::check(tolerance)?;
    let profile = outward(profile)?;
    let lengths: Vec<f64> = profile.iter().map(|segment| segment.length(1.0)).collect();
    let (columns, rows) = cells(&profile, tolerance)?;
    let total: f64 = lengths.iter().sum();
    let start = profile[0].at(0.0)[0];
    let mut mesh = Mesh::default();
    let (mut before, mut joint) = (0.0, start);
    for (index, ((segment, &rows), length)) in profile.iter().zip(&rows).zip(&lengths).enumerate() {
        let first = mesh.vertices.len() as u32;
        for row in 0..=rows {
            let t = row as f64 / rows as f64;
            // Neighbours share their points exactly.
            let point = match row {
                0 => joint,
                row if row == rows && index + 1 == profile.len() => closing(segment.at(1.0)[0], start, total),
                _ => segment.at(t)[0],
            };
            joint = point;
            let v = ((before + segment.length(t)) / total).min(1.0);
            ring(&mut mesh, columns, point, segment.normal(t), v as f32, (row > 0) as i32);
        }
        before += length;
        cover(&mut mesh, first, rows as u32, columns as u32);
    }
    Ok(mesh)
}

/// The end of a profile: its start where they meet.
fn closing(end: DVec2, start: DVec2, length: f64) -> DVec2 {
    if end.distance(start) < 1e-9 * length { start } else { end }
}

/// The profile in the direction in which it has the outside on its left.
fn outward(profile: &[Segment]) -> Result<Vec<Segment>> {
    let points = |segment: &Segment| (0..=LOOKS).map(|k| segment.at(k as f64 / LOOKS as f64)[0]).collect();
    let points: Vec<Vec<DVec2>> = profile.iter().map(points).collect();
    let all = || points.iter().flatten();
    let size = all().map(|point| point.abs().max_element()).fold(0.0, f64::max);
    if !all().all(|point| point.is_finite()) || size > f64::from(f32::MAX) {
        return Err(Error::input("the profile's numbers must be finite"));
    }
    if all().any(|point| point.x < -1e-9 * size) {
        return Err(Error::input("the profile has a radius below 0"));
    }
    if profile.is_empty() || profile.iter().any(|segment| segment.length(1.0) <= 1e-9 * size) {
        return Err(Error::input("the profile has a piece without length"));
    }
    // π times the sum of r² dy is the volume that it encloses with the axis, negative downwards.
    let volume: f64 = points
        .iter()
        .flat_map(|points| points.windows(2))
        .map(|pair| (pair[0].x + pair[1].x).powi(2) / 4.0 * (pair[1].y - pair[0].y))
        .sum();
    if volume > 0.0 {
        return Ok(profile.iter().rev().map(Segment::reversed).collect());
    }
    Ok(profile.to_vec())
}

/// The columns, and the rows of each piece, that take the fewest triangles.
fn cells(profile: &[Segment], tolerance: f64) -> Result<(usize, Vec<usize>)> {
    let around = |segment: &Segment| {
        (0..=LOOKS).map(|k| segment.curvature(k as f64 / LOOKS as f64)[0]).fold(0.0, f64::max)
    };
    let widest = profile.iter().map(around).fold(0.0, f64::max);
    let least = (widest / (8.0 * tolerance)).sqrt().ceil().max(LEAST);
    limits::check_triangles(2.0 * least, tolerance)?;
    let mut best: Option<(f64, f64, Vec<f64>)> = None;
    let mut columns = least;
    while columns <= 3.0 * least {
        let rows: Option<Vec<f64>> = profile.iter().map(|segment| segment.rows(columns, tolerance)).collect();
        if let Some(rows) = rows {
            let triangles = 2.0 * columns * rows.iter().sum::<f64>();
            if best.as_ref().is_none_or(|best| triangles < best.0) {
                best = Some((triangles, columns, rows));
            }
        }
        columns = (columns * 1.01).ceil().max(columns + 1.0);
    }
    let (triangles, columns, rows) =
        best.ok_or_else(|| Error::input(format!("key tolerance: {tolerance:e} cannot be met")))?;
    limits::check_triangles(triangles, tolerance)?;
    Ok((columns as usize, rows.into_iter().map(|rows| rows as usize).collect()))
}

/// Adds the vertices of one turn of a point.
fn ring(mesh: &mut Mesh, columns: usize, point: DVec2, normal: DVec2, v: f32, below: i32) {
    let pole = point.x == 0.0;
    for column in 0..=columns {
        // The one triangle of a pole's vertex lies in the middle of its column.
        let shift = if pole { 0.5 - f64::from(below) } else { 0.0 };
        let u = ((column as f64 + shift) / columns as f64).clamp(0.0, 1.0);
        let around = if pole { u } else { (column % columns) as f64 / columns as f64 };
        let (sin, cos) = (around * TAU).sin_cos();
        let turned = |p: DVec2| DVec3::new(p.x * sin, p.y, p.x * cos).as_vec3();
        mesh.vertices.push(Vertex {
            position: if pole { DVec3::new(0.0, point.y, 0.0).as_vec3() } else { turned(point) },
            normal: turned(normal),
            tangent: DVec3::new(cos, 0.0, -sin).as_vec3(),
            handedness: 1.0,
            uv: Vec2::new(u as f32, v),
        });
    }
}

/// Adds the triangles between the rings from `first` on.
fn cover(mesh: &mut Mesh, first: u32, rows: u32, columns: u32) {
    let at = |row: u32, column: u32| first + row * (columns + 1) + column;
    for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column))) {
        let [a, b, c, d] =
            [at(row, column), at(row + 1, column), at(row + 1, column + 1), at(row, column + 1)];
        for triangle in [[a, b, c], [a, c, d]] {
            let [p, q, r] = triangle.map(|i| mesh.vertices[i as usize].position);
            if p != q && q != r && r != p {
                mesh.triangles.push(triangle);
            }
        }
    }
}
