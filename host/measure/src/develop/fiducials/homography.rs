//! The plane of a tag in the picture: the projective map that takes the unit square to four corners.

use glam::{DMat3, DVec2, DVec3};

/// A projective map from tag coordinates (0..1 across the black border's outer edge) to pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct TagMap {
    matrix: DMat3,
    inverse: DMat3,
}

impl TagMap {
    /// The map of the unit square to the corners (Heckbert 1989, section 2.2.3), if they span an area.
    pub(super) fn to_quad(corners: &[DVec2; 4]) -> Option<Self> {
        let [a, b, c, d] = *corners;
        let (right, down, sum) = (b - c, d - c, a - b + c - d);
        let area = right.perp_dot(down);
        let (g, h) = (sum.perp_dot(down) / area, right.perp_dot(sum) / area);
        let matrix =
            DMat3::from_cols((b * (1.0 + g) - a).extend(g), (d * (1.0 + h) - a).extend(h), a.extend(1.0));
        let sound = matrix.is_finite() && matrix.determinant().abs() > 1e-6;
        sound.then(|| Self { matrix, inverse: matrix.inverse() })
    }

    /// The pixel that shows a point of the tag's plane.
    pub(super) fn pixel(&self, tag: DVec2) -> DVec2 {
        divide(self.matrix * tag.extend(1.0))
    }

    /// The point of the tag's plane that a pixel shows.
    pub(super) fn tag(&self, pixel: DVec2) -> DVec2 {
        divide(self.inverse * pixel.extend(1.0))
    }

    /// How fast tag coordinates change along the picture at a pixel: (∂/∂x, ∂/∂y).
    pub(super) fn tag_per_pixel(&self, pixel: DVec2) -> (DVec2, DVec2) {
        let p = self.inverse * pixel.extend(1.0);
        let along = |column: DVec3| (column.truncate() - divide(p) * column.z) / p.z;
        (along(self.inverse.x_axis), along(self.inverse.y_axis))
    }

    /// How fast the pixel that shows a point of the tag's plane moves when each corner moves: two columns a
    /// corner, for its x and its y. The difference quotient is taken once a map, not once a point.
    pub(super) fn sensitivity(corners: &[DVec2; 4]) -> Option<Sensitivity> {
        const STEP: f64 = 1e-4;
        let at = Self::to_quad(corners)?.matrix;
        let mut slopes = [DMat3::ZERO; 8];
        for (k, slope) in slopes.iter_mut().enumerate() {
            let mut moved = *corners;
            moved[k / 2][k % 2] += STEP;
            *slope = (Self::to_quad(&moved)?.matrix - at) * (1.0 / STEP);
        }
        Some(Sensitivity { at, slopes })
    }
}

/// The derivative of a [`TagMap`] by the eight coordinates of its corners.
pub(super) struct Sensitivity {
    at: DMat3,
    slopes: [DMat3; 8],
}

impl Sensitivity {
    /// The motion of the pixel that shows a point of the tag's plane, for each coordinate of the corners.
    pub(super) fn pixel(&self, tag: DVec2) -> [DVec2; 8] {
        let p = self.at * tag.extend(1.0);
        self.slopes.map(|slope| {
            let d = slope * tag.extend(1.0);
            (d.truncate() - divide(p) * d.z) / p.z
        })
    }
}

/// Whether four corners form a convex quadrilateral that turns from x to y (clockwise as seen, y being down),
/// with every side at least `side` pixels long.
pub(super) fn is_convex(corners: &[DVec2; 4], side: f64) -> bool {
    (0..4).all(|i| {
        let (a, b, c) = (corners[i], corners[(i + 1) % 4], corners[(i + 2) % 4]);
        (b - a).perp_dot(c - b) > 0.0 && a.distance(b) >= side
    })
}

/// The area of a convex quadrilateral in pixels.
pub(super) fn area(corners: &[DVec2; 4]) -> f64 {
    0.5 * (corners[2] - corners[0]).perp_dot(corners[3] - corners[1]).abs()
}

/// The distance of the nearest corners of the tag's modules to one another: the least width of a module in
/// pixels.
pub(super) fn module_width(corners: &[DVec2; 4]) -> f64 {
    let longest = (0..4).map(|i| corners[i].distance(corners[(i + 1) % 4])).fold(0.0, f64::max);
    area(corners) / longest.max(1e-9) / super::family::MODULES as f64
}

fn divide(p: DVec3) -> DVec2 {
    p.truncate() / p.z
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: [DVec2; 4] = [DVec2::ZERO, DVec2::X, DVec2::ONE, DVec2::Y];
    const QUAD: [DVec2; 4] =
        [DVec2::new(10.0, 20.0), DVec2::new(41.0, 17.0), DVec2::new(38.0, 50.0), DVec2::new(13.0, 44.0)];

    #[test]
    fn corners_map_to_corners_and_back() {
        let map = TagMap::to_quad(&QUAD).unwrap();
        for (corner, square) in QUAD.iter().zip(SQUARE) {
            assert!(map.pixel(square).distance(*corner) < 1e-9);
            assert!(map.tag(*corner).distance(square) < 1e-9);
        }
    }

    #[test]
    fn slopes_are_those_of_the_map() {
        let map = TagMap::to_quad(&QUAD).unwrap();
        let pixel = DVec2::new(25.0, 31.0);
        let (x, y) = map.tag_per_pixel(pixel);
        let quotient = |step: DVec2| (map.tag(pixel + step * 1e-5) - map.tag(pixel - step * 1e-5)) / 2e-5;
        assert!(x.distance(quotient(DVec2::X)) < 1e-8 && y.distance(quotient(DVec2::Y)) < 1e-8);

        let tag = DVec2::new(0.3, 0.8);
        let motion = TagMap::sensitivity(&QUAD).unwrap().pixel(tag);
        for (k, motion) in motion.iter().enumerate() {
            let mut moved = QUAD;
            moved[k / 2][k % 2] += 1e-3;
            let quotient = (TagMap::to_quad(&moved).unwrap().pixel(tag) - map.pixel(tag)) / 1e-3;
            assert!(motion.distance(quotient) < 1e-3, "coordinate {k}");
        }
    }

    #[test]
    fn corners_on_a_line_have_no_map() {
        let line = [0.0, 1.0, 2.0, 3.0].map(|x| DVec2::new(x, 2.0 * x));
        assert!(TagMap::to_quad(&line).is_none());
        assert!(!is_convex(&line, 0.1) && is_convex(&QUAD, 10.0));
    }
}
