//! A sampled SBRDF: the measured reflectance of every texel at every pose, with where light and camera stood.
//!
//! Shapes and names are those of the Zarr store: `reflectance` [y, x, pose, rgb] in sr⁻¹, NaN where a texel
//! has no valid exposure; `sigma` [y, x, pose, rgb], where it is known, is the standard deviation of each;
//! `light_position_mm`, `camera_position_mm` [pose, xyz] in the sample's frame.

use glam::{DVec2, DVec3, Vec3};
use half::f16;

use crate::Rgb;

mod store;
mod zarr;

pub use store::{
    APERTURE_KEY, Attributes, CLIPPED_KEY, SampledStore, Window, attributes_of, geometry_sha256,
};

/// Where the light and the camera stood for one pose, in the sample's frame (origin at its centre, z
/// outward).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseGeometry {
    /// Centre of the light's aperture, mm.
    pub light_mm: DVec3,
    /// Centre of projection of the camera, mm.
    pub camera_mm: DVec3,
    /// Weight of the pose's squared residuals in every fit: the inverse of its noise's variance (in units of
    /// any pose's) where that is known, else 1; 0 for a pose that was rejected.
    pub weight: f64,
}

impl PoseGeometry {
    /// Whether positions and weight are numbers.
    pub fn is_known(&self) -> bool {
        self.light_mm.is_finite() && self.camera_mm.is_finite() && !self.weight.is_nan()
    }

    /// The pose with which nothing that is not a number can be computed: one that is not known counts as one
    /// that was rejected, above the sample.
    #[must_use]
    pub fn known(self) -> Self {
        let placed = |place: DVec3| if place.is_finite() { place } else { DVec3::Z * 1000.0 };
        let weight = if self.is_known() { self.weight } else { 0.0 };
        Self { light_mm: placed(self.light_mm), camera_mm: placed(self.camera_mm), weight }
    }

    /// Moves the camera to within about 6° of the mirror direction of the light, by as much as its own
    /// direction is off the normal.
    pub fn aim_at_highlight(&mut self) {
        let mirror = DVec3::new(-self.light_mm.x, -self.light_mm.y, self.light_mm.z);
        let camera = self.camera_mm;
        self.camera_mm = mirror + 0.1 * DVec3::new(camera.x, camera.y, 0.0);
    }
}

/// Reflectance of `height` × `width` texels at every pose: a whole sample, or a window of one.
#[derive(Debug, Clone, PartialEq)]
pub struct SampledSbrdf {
    /// Texels a row.
    pub width: usize,
    /// Rows; row 0 is the sample's +y edge.
    pub height: usize,
    /// Edge of a texel, mm.
    pub texel_mm: f64,
    /// From the sample's centre to that of this window, texels along x and y; 0 for a whole sample.
    pub offset_texels: DVec2,
    /// Geometry a pose.
    pub poses: Vec<PoseGeometry>,
    /// [y, x, pose, rgb] in sr⁻¹; NaN without a valid exposure.
    pub reflectance: Vec<f32>,
    /// [y, x, pose, rgb] in sr⁻¹: the standard deviation of each value by noise that is independent from
    /// value to value, where it is known. Half precision (0.05 % down to 6e-5 sr⁻¹, 6e-8 sr⁻¹ below): a
    /// weight needs no more, and it makes a store half as large again, not twice.
    pub sigma: Option<Vec<f16>>,
}

impl SampledSbrdf {
    /// A store of NaN for the given size.
    pub fn empty(width: usize, height: usize, texel_mm: f64, poses: Vec<PoseGeometry>) -> Self {
        let reflectance = vec![f32::NAN; width * height * poses.len() * 3];
        Self { width, height, texel_mm, offset_texels: DVec2::ZERO, poses, reflectance, sigma: None }
    }

    /// Number of texels.
    pub fn texels(&self) -> usize {
        self.width * self.height
    }

    /// A copy of some columns and rows, at the same place on the sample.
    ///
    /// # Panics
    /// When the window reaches beyond the texels.
    pub fn part(&self, window: &Window) -> Self {
        let indices = || window.indices(self.width);
        let sigma = self
            .sigma
            .is_some()
            .then(|| indices().filter_map(|k| self.sigmas(k)).flatten().copied().collect());
        Self {
            width: window.x.len(),
            height: window.y.len(),
            offset_texels: self.offset_texels + window.offset([self.width, self.height]),
            poses: self.poses.clone(),
            reflectance: indices().flat_map(|k| self.values(k)).copied().collect(),
            sigma,
            ..*self
        }
    }

    /// Centre of texel `index` (row · width + column) in the sample's frame, mm.
    pub fn position_mm(&self, index: usize) -> DVec3 {
        let centred = texel_position_mm(self.width, self.height, 1.0, index);
        (centred + self.offset_texels.extend(0.0)) * self.texel_mm
    }

    /// Unit directions toward the light and the camera from texel `index` at `pose`.
    pub fn directions(&self, index: usize, pose: usize) -> (Vec3, Vec3) {
        let position = self.position_mm(index);
        let geometry = &self.poses[pose];
        let towards = |point: DVec3| (point - position).normalize().as_vec3();
        (towards(geometry.light_mm), towards(geometry.camera_mm))
    }

    /// The samples of texel `index`, one a pose; NaN without a valid exposure.
    pub fn samples(&self, index: usize) -> impl Iterator<Item = Rgb> + '_ {
        self.values(index).chunks_exact(3).map(Rgb::from_slice)
    }

    /// The same as a flat list, [pose, rgb].
    pub fn values(&self, index: usize) -> &[f32] {
        let count = self.poses.len() * 3;
        &self.reflectance[index * count..(index + 1) * count]
    }

    /// Their standard deviations, where they are known.
    pub fn sigmas(&self, index: usize) -> Option<&[f16]> {
        let count = self.poses.len() * 3;
        self.sigma.as_ref().map(|sigma| &sigma[index * count..(index + 1) * count])
    }
}

/// Centre of texel `index` of a sample of `width` × `height` texels, in the sample's frame, mm.
pub fn texel_position_mm(width: usize, height: usize, texel_mm: f64, index: usize) -> DVec3 {
    let (x, y) = ((index % width) as f64, (index / width) as f64);
    DVec3::new(x + 0.5 - width as f64 / 2.0, height as f64 / 2.0 - y - 0.5, 0.0) * texel_mm
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_that_is_not_known_weighs_nothing_and_holds_no_nan_and_a_known_one_stays_as_it_is() {
        let known = PoseGeometry { light_mm: DVec3::X, camera_mm: DVec3::Y, weight: 0.5 };
        assert_eq!(known.known(), known);
        for unknown in [
            PoseGeometry { light_mm: DVec3::new(1.0, f64::NAN, 2.0), ..known },
            PoseGeometry { camera_mm: DVec3::INFINITY, ..known },
            PoseGeometry { weight: f64::NAN, ..known },
        ] {
            let pose = unknown.known();
            assert!(!unknown.is_known() && pose.weight == 0.0);
            assert!(pose.light_mm.is_finite() && pose.camera_mm.is_finite());
        }
    }

    #[test]
    fn row_zero_lies_on_the_plus_y_edge_and_columns_run_along_x() {
        let first = texel_position_mm(4, 2, 0.5, 0);
        assert_eq!(first, DVec3::new(-0.75, 0.25, 0.0));
        assert_eq!(texel_position_mm(4, 2, 0.5, 7), -first);
    }

    #[test]
    fn a_part_has_the_samples_places_and_deviations_of_the_whole() {
        let pose = PoseGeometry { light_mm: DVec3::Z, camera_mm: DVec3::Z, weight: 1.0 };
        let mut whole = SampledSbrdf::empty(5, 4, 0.5, vec![pose; 2]);
        whole.reflectance = (0..120).map(|k| k as f32).collect();
        whole.sigma = Some((0..120).map(|k| f16::from_f32(k as f32)).collect());
        let window = Window { x: 1..4, y: 2..4 };
        let part = whole.part(&window);
        assert_eq!((part.width, part.height, part.texels()), (3, 2, window.texels()));
        for (own, index) in window.indices(5).enumerate() {
            assert_eq!(part.position_mm(own), whole.position_mm(index));
            assert_eq!(part.values(own), whole.values(index));
            assert_eq!(part.sigmas(own), whole.sigmas(index));
        }
    }
}
