//! Bicubic resampling of a Bayer mosaic at points of the sensor: every colour from its own half-resolution
//! plane.

use glam::DVec2;

use super::radiance::MosaicRadiance;

/// The four half-resolution planes of an RGGB mosaic, of its values or of their variances.
pub struct BayerPlanes {
    columns: usize,
    rows: usize,
    /// Red, green of the red rows, green of the blue rows, blue.
    planes: [Vec<f32>; 4],
}

/// Offset of each plane's first pixel in the mosaic.
const OFFSETS: [(usize, usize); 4] = [(0, 0), (1, 0), (0, 1), (1, 1)];

impl BayerPlanes {
    /// Splits a mosaic; an odd last row or column is left out.
    pub fn new(mosaic: &MosaicRadiance) -> Self {
        Self::split(mosaic.width, mosaic.height, &mosaic.data)
    }

    /// The planes of the variances, which the mosaic has to know, for [`Self::variance`].
    pub fn of_variance(mosaic: &MosaicRadiance) -> Self {
        Self::split(mosaic.width, mosaic.height, &mosaic.variance)
    }

    fn split(width: usize, height: usize, data: &[f32]) -> Self {
        let (columns, rows) = (width / 2, height / 2);
        let planes = OFFSETS.map(|(dx, dy)| {
            let at = |k: usize| data[(2 * (k / columns) + dy) * width + 2 * (k % columns) + dx];
            (0..columns * rows).map(at).collect()
        });
        Self { columns, rows, planes }
    }

    /// Whether all neighbours of a point of the sensor in pixels are on it.
    pub fn contains(&self, pixel: DVec2) -> bool {
        OFFSETS.iter().all(|&(dx, dy)| {
            let (x, y) = ((pixel.x - dx as f64) / 2.0, (pixel.y - dy as f64) / 2.0);
            within(x.floor(), self.columns) && within(y.floor(), self.rows)
        })
    }

    /// Red, green and blue at a point of the sensor in pixels; NaN when the point is too near the edge or
    /// when a saturated pixel is among its neighbours.
    pub fn sample(&self, pixel: DVec2) -> [f32; 3] {
        let [red, first, second, blue] = self.resampled(pixel, |weight| weight);
        [red, 0.5 * (first + second), blue]
    }

    /// The variances of what [`Self::sample`] gives of the values, where these are their variances; pixels
    /// are independent.
    pub fn variance(&self, pixel: DVec2) -> [f32; 3] {
        let [red, first, second, blue] = self.resampled(pixel, |weight| weight * weight);
        [red, 0.25 * (first + second), blue]
    }

    /// Every plane at a point of the sensor.
    fn resampled(&self, pixel: DVec2, weight: fn(f32) -> f32) -> [f32; 4] {
        std::array::from_fn(|k| {
            let (dx, dy) = OFFSETS[k];
            self.bicubic(k, (pixel.x - dx as f64) / 2.0, (pixel.y - dy as f64) / 2.0, weight)
        })
    }

    /// A sum over one plane with a function of Catmull–Rom's weights.
    fn bicubic(&self, plane: usize, x: f64, y: f64, weight: fn(f32) -> f32) -> f32 {
        let (left, top) = (x.floor(), y.floor());
        if !(within(left, self.columns) && within(top, self.rows)) {
            return f32::NAN;
        }
        let [wx, wy] = [x - left, y - top].map(|fraction| catmull_rom(fraction as f32).map(weight));
        let (left, top) = (left as usize - 1, top as usize - 1);
        let data = &self.planes[plane];
        (0..4)
            .map(|j| {
                let start = (top + j) * self.columns + left;
                let row = &data[start..start + 4];
                wy[j] * (row[0] * wx[0] + row[1] * wx[1] + row[2] * wx[2] + row[3] * wx[3])
            })
            .sum()
    }
}

/// Whether one neighbour before and two after a place in `count` are there.
fn within(first: f64, count: usize) -> bool {
    first >= 1.0 && first + 2.0 < count as f64
}

/// Catmull–Rom weights of the four neighbours for a fraction 0..1 between the middle two.
fn catmull_rom(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        0.5 * (-t3 + 2.0 * t2 - t),
        0.5 * (3.0 * t3 - 5.0 * t2 + 2.0),
        0.5 * (-3.0 * t3 + 4.0 * t2 + t),
        0.5 * (t3 - t2),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mosaic(value: impl Fn(f64, f64) -> f64) -> MosaicRadiance {
        let (width, height) = (40, 30);
        let data =
            (0..width * height).map(|k| value((k % width) as f64, (k / width) as f64) as f32).collect();
        MosaicRadiance { width, height, data, variance: Vec::new() }
    }

    #[test]
    fn quadratic_light_is_resampled_exactly_in_every_colour() {
        let light = |x: f64, y: f64| 2.0 + 0.3 * x - 0.2 * y + 0.01 * x * x + 0.02 * x * y;
        let planes = BayerPlanes::new(&mosaic(light));
        for (x, y) in [(9.3, 11.8), (20.0, 14.0), (15.5, 7.25)] {
            for value in planes.sample(DVec2::new(x, y)) {
                assert!((f64::from(value) - light(x, y)).abs() < 1e-4, "{value} {}", light(x, y));
            }
        }
    }

    #[test]
    fn points_near_the_edge_or_near_saturation_are_not_numbers() {
        let mut image = mosaic(|_, _| 1.0);
        assert!(BayerPlanes::new(&image).sample(DVec2::new(0.5, 15.0))[0].is_nan());
        image.data[14 * 40 + 20] = f32::NAN;
        let colours = BayerPlanes::new(&image).sample(DVec2::new(21.0, 15.0));
        assert!(colours[0].is_nan() && !colours[2].is_nan());
    }
}
