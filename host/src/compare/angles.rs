//! Errors against photographs by the angles at each texel, inside and outside the measured cone.

use glam::DVec2;

use super::Place;
use super::surface::SurfacePoint;
use crate::by_angle::{self, ByAngle, Cone, Zone};
use crate::develop::radiance::MosaicRadiance;
use crate::develop::reflectance::light_from;
use crate::reflectance::SbrdfMap;
use crate::rig::config::{Carrier, RigConfig};
use crate::sampled::{PoseGeometry, texel_position_mm};

/// Most texels that are judged.
const MOST_TEXELS: usize = 4096;

/// Texels spread evenly over a map: every so many columns and rows.
pub(super) struct Lattice {
    step: usize,
    width: usize,
    height: usize,
    texel_mm: f64,
}

impl Lattice {
    /// As many texels of a map as are judged.
    pub(super) fn over(map: &SbrdfMap, carrier: &Carrier) -> Self {
        let (width, height) = (map.width, map.height);
        let count = |step: usize| width.div_ceil(step) * height.div_ceil(step);
        let step = (1..width.max(height)).find(|&step| count(step) <= MOST_TEXELS).unwrap_or(1);
        Self { step, width, height, texel_mm: carrier.texel_mm() }
    }

    fn columns(&self) -> usize {
        self.width.div_ceil(self.step)
    }

    /// Number of its texels.
    pub(super) fn len(&self) -> usize {
        self.columns() * self.height.div_ceil(self.step)
    }

    /// Its texel at a place of the sample laid flat; none for the texels between.
    pub(super) fn at(&self, flat_mm: DVec2) -> Option<usize> {
        let column = flat_mm.x / self.texel_mm + self.width as f64 / 2.0;
        let row = self.height as f64 / 2.0 - flat_mm.y / self.texel_mm;
        let whole = |place: f64, count: usize| (place.max(0.0) as usize).min(count - 1);
        let (column, row) = (whole(column, self.width), whole(row, self.height));
        let chosen = column.is_multiple_of(self.step) && row.is_multiple_of(self.step);
        chosen.then(|| row / self.step * self.columns() + column / self.step)
    }

    /// The middle of one of its texels on the sample laid flat, mm.
    fn middle_mm(&self, index: usize) -> DVec2 {
        let (column, row) = (index % self.columns() * self.step, index / self.columns() * self.step);
        texel_position_mm(self.width, self.height, self.texel_mm, row * self.width + column).truncate()
    }
}

/// What one photograph says of one texel.
pub(super) struct Seen {
    texel: usize,
    zone: Zone,
    off: f64,
    all: f64,
}

/// What one photograph says of each texel: squared difference and squared reflectance over the texel's
/// pixels, by the directions at its middle.
pub(super) fn of_photograph(
    lattice: &Lattice,
    cone: Option<&Cone>,
    (config, geometry): (&RigConfig, &PoseGeometry),
    [photograph, rendering]: [&MosaicRadiance; 2],
    places: &[Place],
) -> Vec<Seen> {
    let mut sums = vec![[0.0f64; 2]; lattice.len()];
    for ((photographed, rendered), place) in photograph.data.iter().zip(&rendering.data).zip(places) {
        let &Place { texel: Some(texel), irradiance } = place else { continue };
        let [f, found] = [photographed, rendered].map(|&radiance| f64::from(radiance / irradiance));
        if f.is_finite() && found.is_finite() {
            let sum = &mut sums[texel as usize];
            (sum[0], sum[1]) = (sum[0] + (found - f).powi(2), sum[1] + f * f);
        }
    }
    let mut last = 0;
    let seen = sums.into_iter().enumerate().filter(|(_, [_, all])| *all > 0.0).map(|(texel, [off, all])| {
        let point = SurfacePoint::at(&config.carrier, lattice.middle_mm(texel));
        let (toward, _) = light_from(config, geometry, point.position_mm);
        let wi = point.local(toward).as_vec3();
        let wo = point.local((geometry.camera_mm - point.position_mm).normalize()).as_vec3();
        Seen { texel, zone: by_angle::zone(cone, wi, wo, &mut last), off, all }
    });
    seen.collect()
}

/// All photographs together, added in their order.
pub(super) fn together<'a>(texels: usize, photographs: impl IntoIterator<Item = &'a Vec<Seen>>) -> ByAngle {
    let mut all = ByAngle::empty(texels);
    for seen in photographs.into_iter().flatten() {
        all.add(seen.texel, seen.zone, seen.off, seen.all);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::by_angle::Side;
    use crate::reflectance::LobeBrdf;
    use glam::DVec3;

    #[test]
    fn texels_of_the_lattice_are_found_by_their_middles_and_those_between_are_not_judged() {
        let map = SbrdfMap::from_texels(100, 90, &vec![LobeBrdf::default(); 9000]);
        let carrier = Carrier { sample_width_mm: 50.0, texels_across: 100, ..Carrier::default() };
        let lattice = Lattice::over(&map, &carrier);
        assert_eq!((lattice.step, lattice.len()), (2, 50 * 45));
        for index in [0, 49, 50, 2249] {
            assert_eq!(lattice.at(lattice.middle_mm(index)), Some(index));
            assert_eq!(lattice.at(lattice.middle_mm(index) + DVec2::new(0.5, 0.0)), None);
        }
    }

    #[test]
    fn an_error_is_that_of_a_texels_own_pixels_in_the_zone_of_its_angles() {
        let map = SbrdfMap::from_texels(2, 1, &vec![LobeBrdf::default(); 2]);
        let config = RigConfig::default();
        let lattice = Lattice::over(&map, &config.carrier);
        let light_mm = 1000.0 * DVec3::new(0.6, 0.0, 0.8);
        let geometry = PoseGeometry { light_mm, camera_mm: DVec3::Z * 1000.0, weight: 1.0 };
        let mosaic =
            |data: Vec<f32>| MosaicRadiance { width: data.len(), height: 1, data, variance: Vec::new() };
        let [photograph, rendering] =
            [vec![4.0, 3.0, 8.0, f32::NAN, 9.0], vec![4.4, 3.0, 8.8, 1.0, 1.0]].map(mosaic);
        let place = |texel, irradiance| Place { texel, irradiance };
        // Reflectances of 2 and 3 at one texel, 2 at the other; a saturated pixel and one beside the sample.
        let places = [
            place(Some(0), 2.0),
            place(Some(0), 1.0),
            place(Some(1), 4.0),
            place(Some(1), 1.0),
            place(None, 1.0),
        ];
        let seen = of_photograph(&lattice, None, (&config, &geometry), [&photograph, &rendering], &places);
        let all = together(2, [&seen]);
        let row = all.side(Side::Unknown).unwrap();
        let expected = [0.2 / 13f64.sqrt(), 0.1];
        assert!((row.errors[3] - expected[1]).abs() < 1e-6 && row.texels == 2, "{row:?}");
        let first = all.of([0]).side(Side::Unknown).unwrap();
        assert!((first.errors[0] - expected[0]).abs() < 1e-6, "{first:?}");
        // Light at 37° puts both into the band of 30° to 60°.
        assert_eq!(all.rows().iter().filter_map(|row| row.band).collect::<Vec<_>>(), [1]);
    }
}
