//! The simulated camera: pinhole with Brown–Conrady distortion before a Bayer RGGB sensor.

use super::noise;

/// Lens and pixel grid. Pixel coordinates have the centre of the first pixel at (0, 0).
#[derive(Debug, Clone, PartialEq)]
pub struct CameraModel {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Focal lengths, pixels.
    pub focal_px: [f64; 2],
    /// Principal point, pixels.
    pub principal_px: [f64; 2],
    /// k1, k2, p1, p2, k3.
    pub distortion: [f64; 5],
}

impl CameraModel {
    /// Distorts normalised image coordinates (x right, y down, at unit distance).
    pub fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ]
    }

    /// The normalised coordinates that [`Self::distort`] takes to `distorted`, by fixed-point iteration.
    pub fn undistort(&self, distorted: [f64; 2]) -> [f64; 2] {
        let mut point = distorted;
        for _ in 0..50 {
            let moved = self.distort(point);
            let step = [distorted[0] - moved[0], distorted[1] - moved[1]];
            point = [point[0] + step[0], point[1] + step[1]];
            if step[0].abs() + step[1].abs() < 1e-14 {
                break;
            }
        }
        point
    }

    /// Pixel coordinates of normalised coordinates.
    pub fn pixel(&self, normalised: [f64; 2]) -> [f64; 2] {
        let distorted = self.distort(normalised);
        [0, 1].map(|k| self.focal_px[k] * distorted[k] + self.principal_px[k])
    }

    /// Normalised coordinates seen by a point of the sensor.
    pub fn normalised(&self, pixel: [f64; 2]) -> [f64; 2] {
        self.undistort([0, 1].map(|k| (pixel[k] - self.principal_px[k]) / self.focal_px[k]))
    }
}

/// The colour (0 red, 1 green, 2 blue) of the filter over a pixel of an RGGB mosaic.
pub fn bayer_channel(x: usize, y: usize) -> usize {
    match (y % 2, x % 2) {
        (0, 0) => 0,
        (1, 1) => 2,
        _ => 1,
    }
}

/// Electrons to pixel values.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorModel {
    /// Pixel value above black a unit of radiance and second, for R, G and B.
    pub responsivity: [f64; 3],
    /// Pixel value without light.
    pub black_level: f64,
    /// Value at which a pixel saturates.
    pub white_level: f64,
    /// Electrons a pixel value.
    pub electrons_per_value: f64,
    /// Read noise, electrons RMS.
    pub read_noise_e: f64,
    /// Dark signal, electrons a second.
    pub dark_e_s: f64,
}

impl SensorModel {
    /// The value that a pixel of colour `channel` records for a radiance (already scaled to the lamp's state)
    /// over `open_s` seconds: shot noise of light and dark signal, read noise, clipping, quantisation.
    pub fn record(&self, radiance: f32, channel: usize, open_s: f64, key: u64) -> u16 {
        let light = f64::from(radiance) * self.responsivity[channel] * open_s * self.electrons_per_value;
        let mean = (light + self.dark_e_s * open_s) as f32;
        let electrons = noise::electrons(key, mean, self.read_noise_e as f32);
        let value = f64::from(electrons) / self.electrons_per_value + self.black_level;
        // Truncation of a positive number plus a half rounds; `round` is a library call on this path.
        (value + 0.5).clamp(0.0, self.white_level) as u16
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn undistorting_inverts_distorting_over_the_frame() {
        let camera = CameraModel {
            width: 800,
            height: 600,
            focal_px: [4060.0, 4050.0],
            principal_px: [402.3, 297.6],
            distortion: [-1.2, 5.0, 4e-4, -3e-4, 0.1],
        };
        for pixel in [[0.0, 0.0], [799.0, 599.0], [13.5, 580.2], [400.0, 300.0]] {
            let back = camera.pixel(camera.normalised(pixel));
            assert!((back[0] - pixel[0]).hypot(back[1] - pixel[1]) < 1e-8);
        }
    }

    #[test]
    fn a_pixel_saturates_at_the_white_level_and_is_black_without_light() {
        let sensor = SensorModel {
            responsivity: [1e6; 3],
            black_level: 512.0,
            white_level: 16383.0,
            electrons_per_value: 2.5,
            read_noise_e: 0.0,
            dark_e_s: 0.0,
        };
        assert_eq!(sensor.record(1e3, 1, 1.0, 5), 16383);
        assert_eq!(sensor.record(0.0, 1, 1.0, 5), 512);
        let mean =
            (0..4000).map(|k| f64::from(sensor.record(1e-3, 0, 1.0, noise::combine(&[k])))).sum::<f64>()
                / 4000.0;
        assert!((mean - 1512.0).abs() < 2.0, "{mean}");
    }
}
