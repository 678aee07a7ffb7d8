//! The camera's projection: pinhole and Brown–Conrady distortion, both ways. Pixel (0, 0) is the first
//! pixel's centre.

use glam::{DVec2, DVec3};

use crate::rig::config::Camera;

/// Distorts normalised image coordinates (x right, y down, at unit distance).
pub fn distort(camera: &Camera, point: DVec2) -> DVec2 {
    let [k1, k2, p1, p2, k3] = camera.distortion;
    let r2 = point.length_squared();
    let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
    let (x, y) = (point.x, point.y);
    let tangential =
        DVec2::new(2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x), p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y);
    point * radial + tangential
}

/// The pixel of normalised, undistorted coordinates.
pub fn to_pixel(camera: &Camera, normalised: DVec2) -> DVec2 {
    distort(camera, normalised) * DVec2::from(camera.focal_px) + DVec2::from(camera.principal_px)
}

/// Normalised, undistorted coordinates of a pixel, by fixed-point iteration.
pub fn to_normalised(camera: &Camera, pixel: DVec2) -> DVec2 {
    let distorted = (pixel - DVec2::from(camera.principal_px)) / DVec2::from(camera.focal_px);
    let mut point = distorted;
    for _ in 0..30 {
        let step = distorted - distort(camera, point);
        point += step;
        if step.length_squared() < 1e-26 {
            break;
        }
    }
    point
}

/// Normalised coordinates of a point on the bench, seen by the camera at `centre` on +z looking along −z.
pub fn project(centre: DVec3, bench: DVec3) -> DVec2 {
    let depth = centre.z - bench.z;
    DVec2::new((bench.x - centre.x) / depth, -(bench.y - centre.y) / depth)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_and_normalised_coordinates_are_inverse() {
        let camera = Camera::default();
        for pixel in [DVec2::ZERO, DVec2::new(799.0, 599.0), DVec2::new(17.0, 431.5)] {
            assert!((to_pixel(&camera, to_normalised(&camera, pixel)) - pixel).length() < 1e-9);
        }
    }
}
