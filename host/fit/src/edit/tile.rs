//! Makes a map tileable (section 4.6). Its opposite borders are laid over each other, and a seam is cut
//! through where they differ least: the minimum-error boundary cut of image quilting (Efros and
//! Freeman 2001), with the difference taken of reflectance. Every texel of the result is one of the map, so
//! nothing is blurred, averaged or fitted.

use rayon::prelude::*;

use super::gather;
use super::pairs::{Pairs, squared_distance};
use lobelia_base::error::{Error, Result};
use lobelia_base::progress::counted;
use lobelia_reflectance::{LobeBrdf, SbrdfMap};

/// Pairs of directions at which texels are compared.
const PAIRS: usize = 64;

/// A tileable map.
#[derive(Debug, Clone, PartialEq)]
pub struct Tile {
    /// The map, smaller by the overlap in both directions.
    pub map: SbrdfMap,
    /// How much the borders laid over each other differ, over the mean difference between neighbours of the
    /// map: all over the overlap, and along the seams. Below about 1 a seam cannot be told from the pattern.
    pub mismatch: [f64; 2],
}

/// Texels as indices into the map.
struct Grid {
    width: usize,
    height: usize,
    indices: Vec<usize>,
}

impl Grid {
    fn transposed(&self) -> Self {
        let at = |k: usize| self.indices[k % self.height * self.width + k / self.height];
        Self { width: self.height, height: self.width, indices: (0..self.indices.len()).map(at).collect() }
    }

    fn at(&self, x: usize, y: usize) -> usize {
        self.indices[y % self.height * self.width + x % self.width]
    }
}

/// The map made tileable over an overlap of `overlap` texels.
///
/// # Errors
/// Input errors: no overlap, or one of more than half the map.
pub fn tile(map: &SbrdfMap, overlap: usize) -> Result<Tile> {
    if overlap == 0 || 2 * overlap > map.width.min(map.height) {
        return Err(Error::input(format!(
            "an overlap of {} was asked for; a map of {} × {} can have 1 to {}",
            counted(overlap as u64, "texel", "texels"),
            map.width,
            map.height,
            map.width.min(map.height) / 2
        )));
    }
    let texels: Vec<LobeBrdf> = (0..map.width * map.height).map(|k| map.texel(k)).collect();
    let pairs = Pairs::over(&texels, PAIRS);
    let difference = |a: usize, b: usize| {
        if a == b { 0.0 } else { squared_distance(&pairs.features(&texels[a]), &pairs.features(&texels[b])) }
    };
    let whole = Grid { width: map.width, height: map.height, indices: (0..texels.len()).collect() };
    let (across, first) = cut(&whole, overlap, false, &difference);
    // The second seam meets itself where the first has joined left and right.
    let (down, second) = cut(&across.transposed(), overlap, true, &difference);
    let cut = down.transposed();
    let inside = between_neighbours(&whole, &difference);
    let mismatch = [0, 1].map(|k| {
        let mean = (first[k] + second[k]) / 2.0;
        if inside > 0.0 { mean / inside } else { mean }
    });
    Ok(Tile { map: gather(map, cut.width, cut.height, &cut.indices), mismatch })
}

/// Lays the right border over the left one and cuts; also the mean difference over the overlap and along the
/// seam.
fn cut(
    grid: &Grid,
    overlap: usize,
    cyclic: bool,
    difference: &(impl Fn(usize, usize) -> f32 + Sync),
) -> (Grid, [f64; 2]) {
    let (width, height) = (grid.width - overlap, grid.height);
    let cost: Vec<f32> = (0..overlap * height)
        .into_par_iter()
        .map(|k| {
            let (x, y) = (k % overlap, k / overlap);
            difference(grid.at(x, y), grid.at(x + width, y))
        })
        .collect();
    let seam = seam(&cost, overlap, cyclic);
    let from = |k: usize| {
        let (x, y) = (k % width, k / width);
        grid.at(if x < seam[y] { x + width } else { x }, y)
    };
    let root = |cost: f32| f64::from(cost).sqrt();
    let all = cost.iter().map(|&cost| root(cost)).sum::<f64>() / cost.len() as f64;
    let along =
        seam.iter().enumerate().map(|(y, &x)| root(cost[y * overlap + x])).sum::<f64>() / height as f64;
    (Grid { width, height, indices: (0..width * height).map(from).collect() }, [all, along])
}

/// The cheapest path through the rows of a table of `width` columns, at most one column aside from row to
/// row; `cyclic` has the last row beside the first.
fn seam(cost: &[f32], width: usize, cyclic: bool) -> Vec<usize> {
    if !cyclic {
        return path(cost, width, None).1;
    }
    let paths = (0..width).into_par_iter().map(|start| path(cost, width, Some(start)));
    let best = paths.min_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.cmp(&b.1)));
    best.map(|(_, path)| path).unwrap_or_default()
}

/// The cheapest path by dynamic programming and its cost; with `start` one that begins there and ends at most
/// one column aside.
fn path(cost: &[f32], width: usize, start: Option<usize>) -> (f64, Vec<usize>) {
    let near = |x: usize| x.saturating_sub(1)..(x + 2).min(width);
    let mut sums: Vec<Vec<f64>> = Vec::with_capacity(cost.len() / width);
    for row in cost.chunks_exact(width) {
        let sum = |x: usize| {
            let before = match (sums.last(), start) {
                (Some(last), _) => near(x).map(|x: usize| last[x]).fold(f64::INFINITY, f64::min),
                (None, Some(start)) if start != x => f64::INFINITY,
                (None, _) => 0.0,
            };
            before + f64::from(row[x])
        };
        let next: Vec<f64> = (0..width).map(sum).collect();
        sums.push(next);
    }
    let cheapest = |row: &[f64], columns: std::ops::Range<usize>| {
        columns.min_by(|&a, &b| row[a].total_cmp(&row[b])).unwrap_or_default()
    };
    let mut columns = start.map_or(0..width, near);
    let mut total = 0.0;
    let mut path = Vec::with_capacity(sums.len());
    for (place, row) in sums.iter().rev().enumerate() {
        let x = cheapest(row, columns);
        if place == 0 {
            total = row[x];
        }
        path.push(x);
        columns = near(x);
    }
    path.reverse();
    (total, path)
}

/// Mean difference between neighbours.
fn between_neighbours(grid: &Grid, difference: &(impl Fn(usize, usize) -> f32 + Sync)) -> f64 {
    let steps: Vec<f64> = (0..grid.indices.len())
        .into_par_iter()
        .flat_map_iter(|k| {
            let (x, y) = (k % grid.width, k / grid.width);
            let right = (x + 1 < grid.width).then(|| grid.at(x + 1, y));
            let below = (y + 1 < grid.height).then(|| grid.at(x, y + 1));
            right.into_iter().chain(below).map(move |next| f64::from(difference(grid.at(x, y), next)).sqrt())
        })
        .collect();
    steps.iter().sum::<f64>() / steps.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_reflectance::Rgb;

    fn map(width: usize, height: usize, albedo: impl Fn(usize, usize) -> f32) -> SbrdfMap {
        let texel = |k: usize| LobeBrdf::diffuse(Rgb::splat(albedo(k % width, k / width)));
        SbrdfMap::from_texels(width, height, &(0..width * height).map(texel).collect::<Vec<_>>())
    }

    #[test]
    fn a_periodic_pattern_cut_off_in_mid_period_is_periodic_again() {
        // Period 7 in both directions; an overlap of 8 leaves 21 texels: three periods.
        let pattern = |x: usize, y: usize| 0.1 + 0.02 * ((x % 7) * 3 + (y % 7) * (x % 7 + 1)) as f32;
        let tile = tile(&map(29, 29, pattern), 8).unwrap();
        assert_eq!((tile.map.width, tile.map.height), (21, 21));
        assert_eq!(tile.mismatch, [0.0, 0.0]);
        for (k, rho_d) in tile.map.rho_d.iter().enumerate() {
            assert!((rho_d.x * std::f32::consts::PI - pattern(k % 21, k / 21)).abs() < 1e-5, "texel {k}");
        }
    }

    #[test]
    fn the_seam_goes_where_both_borders_agree() {
        // A slope from left to right with a dark thread in each border, at columns that come to lie on each
        // other.
        let pattern = |x: usize, _: usize| if x == 3 || x == 35 { 0.01 } else { 0.1 + 0.02 * x as f32 };
        let found = tile(&map(40, 20, pattern), 8).unwrap();
        // Left of the thread the right border goes on; the thread itself is in both.
        let row: Vec<f32> = (0..5).map(|x| found.map.rho_d[x].x * std::f32::consts::PI).collect();
        for (albedo, expected) in row.iter().zip([0.74, 0.76, 0.78, 0.01, 0.18]) {
            assert!((albedo - expected).abs() < 1e-5, "{row:?}");
        }
        assert!(found.mismatch[0] > 1.0 && found.mismatch[1] == 0.0, "{:?}", found.mismatch);
    }

    #[test]
    fn the_second_seam_ends_where_it_begins() {
        // Cheapest without the condition: from column 0 down to column 4.
        let cost: Vec<f32> =
            (0..5).flat_map(|y| (0..5).map(move |x: usize| if x == y { 0.0 } else { 1.0 })).collect();
        assert_eq!(seam(&cost, 5, false), [0, 1, 2, 3, 4]);
        let closed = seam(&cost, 5, true);
        assert!(closed[0].abs_diff(closed[4]) <= 1, "{closed:?}");
        let zeros: f32 = closed.iter().enumerate().map(|(y, &x)| cost[5 * y + x]).sum();
        assert_eq!(zeros, 2.0);
    }

    #[test]
    fn overlaps_that_do_not_fit_are_refused() {
        for overlap in [0, 6] {
            assert_eq!(tile(&map(20, 10, |_, _| 0.5), overlap).unwrap_err().exit_code(), 2);
        }
    }
}
