//! The homography from the sample's plane to normalised image coordinates, by least squares on fiducial
//! corners (3.6).

use glam::{DMat3, DVec2, DVec3};

use lobelia_base::linalg::Normal;

/// A corner on the sample's plane (mm) and where it was seen (normalised, undistorted).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correspondence {
    /// Sample plane, mm.
    pub plane_mm: DVec2,
    /// Normalised image coordinates.
    pub image: DVec2,
}

/// A plane-to-image homography.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Homography {
    matrix: DMat3,
}

/// Steps of Gauss–Newton after the linear start; two reach rounding on tag-sized data, more cost nothing.
const STEPS: usize = 5;

impl Homography {
    /// Fits by the linear method, then by Gauss–Newton on the reprojection error.
    /// `None` with fewer than four correspondences or when they do not determine the homography.
    pub fn fit(points: &[Correspondence]) -> Option<Self> {
        if points.len() < 4 {
            return None;
        }
        // Scales that bring both sides near 1, for conditioning.
        let spread = |get: fn(&Correspondence) -> DVec2| {
            let centre = points.iter().map(get).sum::<DVec2>() / points.len() as f64;
            let mean = points.iter().map(|p| (get(p) - centre).length()).sum::<f64>() / points.len() as f64;
            (centre, mean.max(1e-12))
        };
        let (plane_centre, plane_scale) = spread(|p| p.plane_mm);
        let (image_centre, image_scale) = spread(|p| p.image);
        let scaled: Vec<(DVec2, DVec2)> = points
            .iter()
            .map(|p| ((p.plane_mm - plane_centre) / plane_scale, (p.image - image_centre) / image_scale))
            .collect();
        let mut h = linear_start(&scaled)?;
        for _ in 0..STEPS {
            h = refine(&h, &scaled)?;
        }
        let into_plane =
            DMat3::from_scale(DVec2::splat(1.0 / plane_scale)) * DMat3::from_translation(-plane_centre);
        let from_image = DMat3::from_translation(image_centre) * DMat3::from_scale(DVec2::splat(image_scale));
        Some(Self { matrix: from_image * as_matrix(&h) * into_plane })
    }

    /// The matrix that takes (x, y, 1), mm, to normalised image coordinates times their depth, up to a
    /// factor.
    pub(super) fn matrix(&self) -> DMat3 {
        self.matrix
    }

    /// Normalised image coordinates of a point of the plane, mm.
    pub fn apply(&self, plane_mm: DVec2) -> DVec2 {
        project(self.matrix, plane_mm)
    }

    /// The homography of a plane whose points are counted from `origin_mm`.
    pub fn from_origin(&self, origin_mm: DVec2) -> Self {
        Self { matrix: self.matrix * DMat3::from_translation(origin_mm) }
    }

    /// The point of the plane (mm) seen at normalised image coordinates.
    pub fn invert(&self, image: DVec2) -> DVec2 {
        project(self.matrix.inverse(), image)
    }
}

fn project(matrix: DMat3, point: DVec2) -> DVec2 {
    let p = matrix * DVec3::new(point.x, point.y, 1.0);
    DVec2::new(p.x / p.z, p.y / p.z)
}

fn as_matrix(h: &[f64; 8]) -> DMat3 {
    DMat3::from_cols_array(&[h[0], h[3], h[6], h[1], h[4], h[7], h[2], h[5], 1.0])
}

/// The linear least squares for h33 = 1 (the scaled origin is in front of the camera, so h33 is not 0).
fn linear_start(points: &[(DVec2, DVec2)]) -> Option<[f64; 8]> {
    let mut equations = Normal::<8>::new();
    for (p, q) in points {
        equations.add(&[p.x, p.y, 1.0, 0.0, 0.0, 0.0, -q.x * p.x, -q.x * p.y], q.x, 1.0);
        equations.add(&[0.0, 0.0, 0.0, p.x, p.y, 1.0, -q.y * p.x, -q.y * p.y], q.y, 1.0);
    }
    equations.solve(0.0)
}

/// One Gauss–Newton step on the distance between projected and seen points.
fn refine(h: &[f64; 8], points: &[(DVec2, DVec2)]) -> Option<[f64; 8]> {
    let matrix = as_matrix(h);
    let mut equations = Normal::<8>::new();
    for (p, q) in points {
        let mapped = matrix * DVec3::new(p.x, p.y, 1.0);
        let (w, at) = (1.0 / mapped.z, DVec2::new(mapped.x / mapped.z, mapped.y / mapped.z));
        let (x, y) = (p.x * w, p.y * w);
        equations.add(&[x, y, w, 0.0, 0.0, 0.0, -at.x * x, -at.x * y], q.x - at.x, 1.0);
        equations.add(&[0.0, 0.0, 0.0, x, y, w, -at.y * x, -at.y * y], q.y - at.y, 1.0);
    }
    let step = equations.solve(0.0)?;
    Some(std::array::from_fn(|k| h[k] + step[k]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> Vec<Correspondence> {
        let truth = DMat3::from_cols_array(&[1e-3, 2e-4, 1e-4, -3e-4, 8e-4, -2e-4, 0.01, -0.02, 1.0]);
        (0..64)
            .map(|k| {
                let plane_mm = DVec2::new(f64::from(k % 8) * 12.0 - 42.0, f64::from(k / 8) * 12.0 - 42.0);
                Correspondence { plane_mm, image: project(truth, plane_mm) }
            })
            .collect()
    }

    #[test]
    fn exact_points_give_the_exact_homography_and_its_inverse() {
        let points = example();
        let fitted = Homography::fit(&points).unwrap();
        for p in &points {
            assert!((fitted.apply(p.plane_mm) - p.image).length() < 1e-12);
            assert!((fitted.invert(p.image) - p.plane_mm).length() < 1e-8);
        }
    }

    #[test]
    fn refining_leaves_no_smaller_reprojection_error_nearby() {
        let mut points = example();
        for (k, p) in points.iter_mut().enumerate() {
            p.image += DVec2::new(((k * 37) % 11) as f64 - 5.0, ((k * 53) % 13) as f64 - 6.0) * 1e-5;
        }
        let cost = |matrix: DMat3| -> f64 {
            points.iter().map(|p| (project(matrix, p.plane_mm) - p.image).length_squared()).sum()
        };
        let fitted = Homography::fit(&points).unwrap().matrix;
        let best = cost(fitted);
        for k in 0..9 {
            let mut entries = fitted.to_cols_array();
            entries[k] *= 1.0 + 1e-5;
            assert!(cost(DMat3::from_cols_array(&entries)) >= best);
        }
    }

    #[test]
    fn points_on_a_line_are_refused() {
        let points: Vec<Correspondence> = (0..10)
            .map(|k| Correspondence {
                plane_mm: DVec2::new(f64::from(k), 0.0),
                image: DVec2::new(f64::from(k), 1.0),
            })
            .collect();
        assert!(Homography::fit(&points).is_none());
    }
}
