//! Polygons into triangles: a fan where they are convex, ears where they are not (Meisters 1975), so that a
//! notch stays open.

use glam::{DVec2, DVec3};

/// Corners beyond which ears, whose search takes the square of their number, are not looked for.
const MOST_CORNERS: usize = 2048;

/// Triangles, as indices into `points`, that run the same way round as the polygon. A polygon without area,
/// or one that meets itself so that no ear is left, gives what is left of it as a fan.
pub(super) fn triangles(points: &[DVec3]) -> Vec<[usize; 3]> {
    let mut left: Vec<usize> = (0..points.len()).collect();
    let mut found = Vec::with_capacity(points.len().saturating_sub(2));
    if points.len() > 3 && points.len() <= MOST_CORNERS {
        let flat = flattened(points);
        if !is_convex(&flat) {
            while left.len() > 3 {
                let Some(ear) = (0..left.len()).find(|&k| is_ear(&flat, &left, k)) else { break };
                found.push(around(&left, ear));
                left.remove(ear);
            }
        }
    }
    found.extend((2..left.len()).map(|k| [left[0], left[k - 1], left[k]]));
    found
}

/// The points in the plane of the polygon (Newell's normal), in which it runs counter-clockwise.
fn flattened(points: &[DVec3]) -> Vec<DVec2> {
    let next = |k: usize| points[(k + 1) % points.len()];
    // About the first point: far from the origin differences would drown.
    let origin = points[0];
    let normal: DVec3 = (0..points.len()).map(|k| (points[k] - origin).cross(next(k) - origin)).sum();
    let (right, up) = normal.try_normalize().unwrap_or(DVec3::Z).any_orthonormal_pair();
    points.iter().map(|&point| DVec2::new((point - origin).dot(right), (point - origin).dot(up))).collect()
}

/// Whether no corner turns to the right, and all turns together are one.
fn is_convex(points: &[DVec2]) -> bool {
    let count = points.len();
    let edge = |k: usize| points[(k + 1) % count] - points[k % count];
    let turns = (0..count).map(|k| edge(k).perp_dot(edge(k + 1)));
    let whole: f64 = (0..count).map(|k| edge(k).angle_to(edge(k + 1))).filter(|turn| turn.is_finite()).sum();
    turns.into_iter().all(|turn| turn >= 0.0) && whole < 1.5 * std::f64::consts::TAU
}

/// The corner at `k` between its neighbours.
fn around(left: &[usize], k: usize) -> [usize; 3] {
    let count = left.len();
    [left[(k + count - 1) % count], left[k], left[(k + 1) % count]]
}

/// Whether the triangle at a corner lies inside the polygon and holds none of its other corners.
fn is_ear(points: &[DVec2], left: &[usize], k: usize) -> bool {
    let [a, b, c] = around(left, k).map(|index| points[index]);
    let side = |from: DVec2, to: DVec2, point: DVec2| (to - from).perp_dot(point - from);
    if side(a, b, c) < 0.0 {
        return false;
    }
    left.iter().map(|&index| points[index]).all(|point| {
        // Polygons with a bridge to a hole come by a corner twice.
        let corner = point == a || point == b || point == c;
        corner || side(a, b, point) < 0.0 || side(b, c, point) < 0.0 || side(c, a, point) < 0.0
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn area(points: &[DVec3], [a, b, c]: [usize; 3]) -> f64 {
        0.5 * (points[b] - points[a]).cross(points[c] - points[a]).z
    }

    fn polygon(points: &[[f64; 2]]) -> Vec<DVec3> {
        points.iter().map(|&[x, y]| DVec3::new(x, y, 0.0)).collect()
    }

    #[test]
    fn a_notch_stays_open_whichever_way_the_polygon_runs() {
        let mut tee = polygon(&[
            [-3.0, 0.0],
            [-1.0, 0.0],
            [-1.0, -4.0],
            [1.0, -4.0],
            [1.0, 0.0],
            [3.0, 0.0],
            [3.0, 2.0],
            [-3.0, 2.0],
        ]);
        for sign in [1.0, -1.0] {
            let cut = triangles(&tee);
            assert_eq!(cut.len(), 6);
            // Triangles of one sign whose areas make up the polygon's do not overlap, and leave the notch
            // free.
            assert!(cut.iter().all(|&t| sign * area(&tee, t) > 0.0), "{cut:?}");
            assert!((cut.iter().map(|&t| area(&tee, t)).sum::<f64>() - sign * 20.0).abs() < 1e-9);
            tee.reverse();
        }
    }

    #[test]
    fn convex_polygons_are_fans_from_their_first_corner_and_small_ones_are_what_they_are() {
        let square = polygon(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]);
        assert_eq!(triangles(&square), [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(triangles(&square[..3]), [[0, 1, 2]]);
        assert!(triangles(&square[..2]).is_empty() && triangles(&[]).is_empty());
        // Without area: a fan, and no endless search.
        assert_eq!(triangles(&[DVec3::ONE; 5]).len(), 3);
    }

    proptest! {
        #[test]
        fn stars_about_a_point_are_covered_without_overlap(
            radii in prop::collection::vec(0.2f64..1.0, 4..24), far in -1e6f64..1e6,
        ) {
            let count = radii.len() as f64;
            let at = |(k, radius): (usize, &f64)| {
                let (sin, cos) = (k as f64 / count * std::f64::consts::TAU).sin_cos();
                DVec3::new(far + radius * cos, radius * sin, 0.0)
            };
            let points: Vec<DVec3> = radii.iter().enumerate().map(at).collect();
            let cut = triangles(&points);
            let whole: f64 = (0..points.len())
                .map(|k| 0.5 * (points[k] - DVec3::X * far).cross(points[(k + 1) % points.len()]
                    - DVec3::X * far).z)
                .sum();
            let sum: f64 = cut.iter().map(|&t| area(&points, t).abs()).sum();
            prop_assert!((sum - whole).abs() < 1e-6 * whole.max(1.0), "{sum} {whole}");
        }
    }
}
