//! Dark quadrilaterals in a picture: where the tags may be.
//!
//! A local threshold between the darkest and the brightest of the neighbourhood makes dark regions; the
//! convex hull of each is cut down to the four sides that enclose it with the least area (a tag's black
//! border is convex whatever its data modules are); what fills its four sides badly is dropped.

use glam::DVec2;

use super::GrayImage;
use super::homography::{area, is_convex};

/// Pixels across a tile of the threshold; it looks at the tile and its eight neighbours, so at 12 pixels.
const TILE: usize = 4;

/// A neighbourhood with less contrast (brightest minus darkest, over brightest) has no edge of a tag in it.
const LEAST_CONTRAST: f32 = 0.25;

/// The shortest side of a tag, in pixels: less than a pixel a module cannot be decoded.
const LEAST_SIDE: f64 = 5.0;

/// The part of a quadrilateral that the hull of its dark region covers.
const LEAST_FILL: f64 = 0.8;

/// How far a tag's edge lies beyond the outermost pixel centres inside it, in pixels, on average over
/// directions.
const OUTSET: f64 = 0.35;

/// Where the threshold lies between the square roots of the neighbourhood's extremes. A low one keeps the
/// thin quiet zone of a small tag open; the middle keeps the border of a tag in bad light together. Of the
/// photographs' 47 tags 0.25, 0.35, 0.5 and 0.6 alone find 40, 39, 35 and 15; these two together 44.
const SPLITS: [f32; 2] = [0.3, 0.5];

/// The dark quadrilaterals of a picture: corners clockwise as seen, from any corner. One may come up more
/// than once.
pub(super) fn find(image: &GrayImage) -> Vec<[DVec2; 4]> {
    let tiles = Tiles::of(image).spread();
    let mut quads = Vec::new();
    let mut region = Vec::new();
    for split in SPLITS {
        let mut dark = Binary::threshold(image, &tiles, split);
        for start in 0..dark.is_dark.len() {
            if dark.is_dark[start] {
                dark.take_region(start, &mut region);
                quads.extend(quad_of(&region));
            }
        }
    }
    quads
}

/// Which pixels are darker than their neighbourhood's middle.
struct Binary {
    width: usize,
    height: usize,
    is_dark: Vec<bool>,
}

impl Binary {
    /// Thresholds square roots between the neighbourhood's extremes: the root keeps a highlight from hiding
    /// what is beside it.
    fn threshold(image: &GrayImage, tiles: &Tiles, split: f32) -> Self {
        let (width, height) = (image.width, image.height);
        let is_dark = (0..width * height)
            .map(|i| {
                let (low, high) = tiles.extremes[i / width / TILE * tiles.width + i % width / TILE];
                let middle = low.sqrt() + split * (high.sqrt() - low.sqrt());
                high - low > LEAST_CONTRAST * high && image.data[i] < middle * middle
            })
            .collect();
        Self { width, height, is_dark }
    }

    /// Moves the connected dark pixels around a start, diagonal neighbours included, out of the picture.
    fn take_region(&mut self, start: usize, region: &mut Vec<(usize, usize)>) {
        region.clear();
        self.is_dark[start] = false;
        region.push((start % self.width, start / self.width));
        let mut next = 0;
        while let Some(&(x, y)) = region.get(next) {
            next += 1;
            for ny in y.saturating_sub(1)..(y + 2).min(self.height) {
                for nx in x.saturating_sub(1)..(x + 2).min(self.width) {
                    if std::mem::take(&mut self.is_dark[ny * self.width + nx]) {
                        region.push((nx, ny));
                    }
                }
            }
        }
    }
}

/// The darkest and the brightest value of each tile.
struct Tiles {
    width: usize,
    extremes: Vec<(f32, f32)>,
}

const NONE: (f32, f32) = (f32::INFINITY, 0.0);

impl Tiles {
    fn of(image: &GrayImage) -> Self {
        let width = image.width.div_ceil(TILE);
        let mut extremes = vec![NONE; width * image.height.div_ceil(TILE)];
        for (y, row) in image.data.chunks_exact(image.width.max(1)).enumerate() {
            for (x, &value) in row.iter().enumerate().filter(|(_, v)| v.is_finite()) {
                let tile = &mut extremes[y / TILE * width + x / TILE];
                *tile = union(*tile, (value.max(0.0), value.max(0.0)));
            }
        }
        Self { width, extremes }
    }

    /// Each tile together with its eight neighbours.
    fn spread(&self) -> Self {
        let (width, height) = (self.width, self.extremes.len() / self.width.max(1));
        let around = |i: usize| {
            let (x, y) = (i % width, i / width);
            let rows = y.saturating_sub(1)..(y + 2).min(height);
            rows.flat_map(|y| &self.extremes[y * width..][x.saturating_sub(1)..(x + 2).min(width)])
                .fold(NONE, |all, &tile| union(all, tile))
        };
        Self { width, extremes: (0..self.extremes.len()).map(around).collect() }
    }
}

fn union(a: (f32, f32), b: (f32, f32)) -> (f32, f32) {
    (a.0.min(b.0), a.1.max(b.1))
}

/// The quadrilateral that a dark region fills, if it does.
fn quad_of(region: &[(usize, usize)]) -> Option<[DVec2; 4]> {
    if (region.len() as f64) < LEAST_SIDE * LEAST_SIDE {
        return None;
    }
    let hull = hull_of(region);
    let hull_area = polygon_area(&hull);
    let quad = outset(&enclose(hull)?);
    let filled = hull_area >= LEAST_FILL * (area(&quad) - OUTSET * perimeter(&quad));
    (filled && is_convex(&quad, LEAST_SIDE)).then_some(quad)
}

/// The convex hull of a region's pixel centres, turning from x to y (Andrew's monotone chain on each row's
/// ends).
fn hull_of(region: &[(usize, usize)]) -> Vec<DVec2> {
    let top = region.iter().map(|p| p.1).min().unwrap_or(0);
    let bottom = region.iter().map(|p| p.1).max().unwrap_or(0);
    let mut ends = vec![(usize::MAX, 0); bottom - top + 1];
    for &(x, y) in region {
        let row = &mut ends[y - top];
        *row = (row.0.min(x), row.1.max(x));
    }
    let point = |x: usize, row: usize| DVec2::new(x as f64, (top + row) as f64);
    let right = ends.iter().enumerate().map(|(row, end)| point(end.1, row));
    let left = ends.iter().enumerate().rev().map(|(row, end)| point(end.0, row));
    let mut hull = chain(right);
    hull.extend(chain(left));
    hull.dedup();
    if hull.len() > 1 && hull.first() == hull.last() {
        hull.pop();
    }
    hull
}

/// The points of a side of a hull: those at which it turns from x to y.
fn chain(points: impl Iterator<Item = DVec2>) -> Vec<DVec2> {
    let mut chain: Vec<DVec2> = Vec::new();
    for point in points {
        while let [.., a, b] = chain[..]
            && (b - a).perp_dot(point - b) <= 0.0
        {
            chain.pop();
        }
        chain.push(point);
    }
    chain
}

/// Cuts a convex polygon down to four sides: again and again the side whose removal, its neighbours being
/// drawn out to meet, adds the least area.
fn enclose(mut polygon: Vec<DVec2>) -> Option<[DVec2; 4]> {
    while polygon.len() > 4 {
        let removable = (0..polygon.len()).filter_map(|i| without_side(&polygon, i).map(|found| (i, found)));
        let (side, (meeting, _)) = removable.min_by(|a, b| a.1.1.total_cmp(&b.1.1))?;
        polygon[side] = meeting;
        polygon.remove((side + 1) % polygon.len());
    }
    polygon.try_into().ok()
}

/// Where the neighbours of a side meet beyond it, and the area that this adds.
fn without_side(polygon: &[DVec2], side: usize) -> Option<(DVec2, f64)> {
    let at = |k: usize| polygon[(side + k) % polygon.len()];
    let (before, a, b, after) = (at(polygon.len() - 1), at(0), at(1), at(2));
    let meeting = meet(before, a, after, b)?;
    let added = 0.5 * (meeting - a).perp_dot(b - a);
    (added >= 0.0 && (meeting - a).dot(a - before) >= 0.0).then_some((meeting, added))
}

/// Where the lines through a, b and through c, d meet.
fn meet(a: DVec2, b: DVec2, c: DVec2, d: DVec2) -> Option<DVec2> {
    let (u, v) = (b - a, d - c);
    let sine = u.perp_dot(v);
    (sine.abs() > 1e-9 * u.length() * v.length()).then(|| a + u * ((c - a).perp_dot(v) / sine))
}

/// The quadrilateral with its sides moved out by [`OUTSET`].
fn outset(quad: &[DVec2; 4]) -> [DVec2; 4] {
    let side = |i: usize| {
        let (a, b) = (quad[i % 4], quad[(i + 1) % 4]);
        let out = -(b - a).perp().normalize_or_zero() * OUTSET;
        (a + out, b + out)
    };
    std::array::from_fn(|i| {
        let ((a, b), (c, d)) = (side(i + 3), side(i));
        meet(a, b, c, d).unwrap_or(quad[i])
    })
}

fn polygon_area(polygon: &[DVec2]) -> f64 {
    let n = polygon.len();
    (0..n).map(|i| 0.5 * polygon[i].perp_dot(polygon[(i + 1) % n])).sum()
}

fn perimeter(quad: &[DVec2; 4]) -> f64 {
    (0..4).map(|i| quad[i].distance(quad[(i + 1) % 4])).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dark_square_is_found_to_a_pixel_under_a_falloff_and_beside_a_highlight() {
        let inside = |x: usize, y: usize| (20..45).contains(&x) && (30..60).contains(&y);
        let value = |x: usize, y: usize| match (x, y) {
            (70.., 70..) => 5000.0,
            _ if inside(x, y) => 0.05 * (1.0 - 0.005 * x as f32),
            _ => 1.0 - 0.005 * x as f32,
        };
        let data = (0..100 * 100).map(|i| value(i % 100, i / 100)).collect();
        let quads = find(&GrayImage { width: 100, height: 100, data });
        let corners = [(19.5, 29.5), (44.5, 29.5), (44.5, 59.5), (19.5, 59.5)].map(DVec2::from);
        let near = |quad: &[DVec2; 4]| corners.iter().all(|c| quad.iter().any(|q| q.distance(*c) < 0.5));
        assert!(quads.iter().any(near), "{quads:?}");
    }

    #[test]
    fn a_triangle_and_an_even_picture_hold_no_quadrilateral() {
        let triangle = |i: usize| {
            let (x, y) = (i % 60, i / 60);
            if y < 50 && x > 5 && x + 5 < y { 0.1 } else { 1.0 }
        };
        for data in
            [(0..3600).map(triangle).collect(), vec![0.0; 3600], vec![1.0; 3600], vec![f32::NAN; 3600]]
        {
            assert!(find(&GrayImage { width: 60, height: 60, data }).is_empty());
        }
        assert!(find(&GrayImage { width: 0, height: 0, data: vec![] }).is_empty());
    }
}
