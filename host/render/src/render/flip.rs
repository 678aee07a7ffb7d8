//! FLIP: the difference between two pictures that people see when they flip between them.
//!
//! Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström, Fairchild: "FLIP: A Difference Evaluator for
//! Alternating Images" (2020), and its extension to high dynamic range, "Visualizing Errors in Rendered High
//! Dynamic Range Images" (2021).

use std::f32::consts::PI;

use glam::{Mat3, Vec3};
use rayon::prelude::*;

use lobelia_reflectance::{Rgb, colour};

/// Pixels a degree of the field of view: a display 0.7 m wide with 3840 pixels, seen from 0.7 m.
const PIXELS_A_DEGREE: f32 = 67.020_645;

/// Linear Rec. 709 to XYZ (D65).
const TO_XYZ: Mat3 = Mat3::from_cols(
    Vec3::new(0.412_390_8, 0.212_639, 0.019_330_82),
    Vec3::new(0.357_584_34, 0.715_168_7, 0.119_194_78),
    Vec3::new(0.180_480_8, 0.072_192_32, 0.950_532_15),
);

/// Mean HDR-FLIP of a picture against a reference, 0 to 1: the largest LDR-FLIP over a range of exposures of
/// the reference, a pixel.
pub(super) fn hdr(reference: &[Rgb], test: &[Rgb], width: usize) -> f64 {
    let [start, stop] = exposures(reference);
    let count = ((stop - start).ceil() as usize).max(2);
    let mut largest = vec![0f32; reference.len()];
    for k in 0..count {
        let exposure = (start + (stop - start) * k as f32 / (count - 1) as f32).exp2();
        let map = |picture: &[Rgb]| picture.iter().map(|&p| tone_map(p * exposure)).collect::<Vec<_>>();
        let errors = ldr(&map(reference), &map(test), width);
        largest.iter_mut().zip(errors).for_each(|(most, error)| *most = most.max(error));
    }
    largest.iter().map(|&error| f64::from(error)).sum::<f64>() / largest.len().max(1) as f64
}

/// A filmic curve (Narkowicz's fit of ACES at exposure 0.6), linear in and out, clamped to 0..1.
fn tone_map(rgb: Rgb) -> Rgb {
    let x = rgb.max(Rgb::ZERO);
    let value = (x * x * 0.9036 + x * 0.018) / (x * x * 0.8748 + x * 0.354 + Rgb::splat(0.14));
    value.map(|v| if v.is_finite() { v.clamp(0.0, 1.0) } else { 1.0 })
}

/// Logarithms (base 2) of the first and the last exposure: they take the reference's brightest and median
/// luminance to where the tone curve is 0.85.
fn exposures(reference: &[Rgb]) -> [f32; 2] {
    let (a, b, c): (f32, f32, f32) = (0.9036 - 0.85 * 0.8748, 0.018 - 0.85 * 0.354, -0.85 * 0.14);
    let bright = (-b + (b * b - 4.0 * a * c).sqrt()) / (2.0 * a);
    let mut luminances: Vec<f32> = reference.iter().map(|&p| colour::luminance(p)).collect();
    luminances.sort_by(f32::total_cmp);
    let middle = luminances.len() / 2;
    let median = match luminances.len() {
        0 => 0.0,
        n if n % 2 == 0 => (luminances[middle - 1] + luminances[middle]) / 2.0,
        _ => luminances[middle],
    };
    let most = luminances.last().copied().unwrap_or_default();
    let log = |luminance: f32| (bright / luminance.max(1e-5)).log2();
    [log(most), log(median)]
}

/// LDR-FLIP a pixel for linear colours in 0..1.
fn ldr(reference: &[Rgb], test: &[Rgb], width: usize) -> Vec<f32> {
    let opponent = |picture: &[Rgb]| picture.iter().map(|&p| to_opponent(p)).collect::<Vec<_>>();
    let (reference, test) = (opponent(reference), opponent(test));
    let colour = colour_differences(&reference, &test, width);
    let features = feature_differences(&reference, &test, width);
    colour.iter().zip(features).map(|(colour, feature)| colour.powf(1.0 - feature)).collect()
}

/// Linear Rec. 709 to YCxCz.
fn to_opponent(rgb: Rgb) -> Vec3 {
    let white = TO_XYZ * Vec3::ONE;
    let n = TO_XYZ * rgb / white;
    Vec3::new(116.0 * n.y - 16.0, 500.0 * (n.x - n.y), 200.0 * (n.y - n.z))
}

/// The inverse of [`to_opponent`].
fn from_opponent(opponent: Vec3) -> Rgb {
    let y = (opponent.x + 16.0) / 116.0;
    let n = Vec3::new(y + opponent.y / 500.0, y, y - opponent.z / 200.0);
    TO_XYZ.inverse() * (n * (TO_XYZ * Vec3::ONE))
}

/// Linear Rec. 709 to L*a*b* with chroma scaled by lightness (Hunt's effect).
fn to_hunt_lab(rgb: Rgb) -> Vec3 {
    let n = TO_XYZ * rgb / (TO_XYZ * Vec3::ONE);
    const DELTA: f32 = 6.0 / 29.0;
    let f = n.map(|t| if t > DELTA.powi(3) { t.cbrt() } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 });
    let lightness = 116.0 * f.y - 16.0;
    let scale = 0.01 * lightness;
    Vec3::new(lightness, 500.0 * (f.x - f.y) * scale, 200.0 * (f.y - f.z) * scale)
}

/// Lightness and chroma differences added (HyAB).
fn hyab(a: Vec3, b: Vec3) -> f32 {
    let d = a - b;
    d.x.abs() + d.y.hypot(d.z)
}

/// Differences of colour after the eye's contrast sensitivity, 0..1.
fn colour_differences(reference: &[Vec3], test: &[Vec3], width: usize) -> Vec<f32> {
    const POWER: f32 = 0.7;
    const KNEE: (f32, f32) = (0.4, 0.95);
    let lab = |picture: &[Vec3]| {
        let filtered = contrast_filtered(picture, width);
        filtered
            .iter()
            .map(|&p| to_hunt_lab(from_opponent(p).clamp(Vec3::ZERO, Vec3::ONE)))
            .collect::<Vec<_>>()
    };
    let (reference, test) = (lab(reference), lab(test));
    let most = hyab(to_hunt_lab(Vec3::Y), to_hunt_lab(Vec3::Z)).powf(POWER);
    let knee = KNEE.0 * most;
    let map = |(&a, &b): (&Vec3, &Vec3)| {
        let error = hyab(a, b).powf(POWER);
        if error < knee {
            error * KNEE.1 / knee
        } else {
            KNEE.1 + (error - knee) / (most - knee) * (1.0 - KNEE.1)
        }
    };
    reference.iter().zip(&test).map(map).collect()
}

/// YCxCz filtered by the contrast sensitivity functions: one Gaussian each for Y and Cx, the sum of two for
/// Cz.
fn contrast_filtered(picture: &[Vec3], width: usize) -> Vec<Vec3> {
    // Amplitude and width a of a exp(−π² x² / b) sqrt(π / b), x in degrees.
    const WIDEST: f32 = 0.04;
    let radius = (3.0 * (WIDEST / (2.0 * PI * PI)).sqrt() * PIXELS_A_DEGREE).ceil() as i32;
    let kernel = |b: f32| -> Vec<f32> {
        let weight = |x: i32| (-(PI * x as f32 / PIXELS_A_DEGREE).powi(2) / b).exp();
        (-radius..=radius).map(weight).collect()
    };
    let total = |kernel: &[f32]| kernel.iter().sum::<f32>().powi(2);
    let [y, cx, cz, narrow] = [0.0047, 0.0053, 0.04, 0.025].map(kernel);
    let amplitude = |a: f32, b: f32| a * (PI / b).sqrt();
    let (wide_part, narrow_part) =
        (amplitude(34.1, 0.04) * total(&cz), amplitude(13.5, 0.025) * total(&narrow));
    let share = narrow_part / (wide_part + narrow_part);

    let normal = |kernel: Vec<f32>| {
        let sum: f32 = kernel.iter().sum();
        kernel.into_iter().map(|weight| weight / sum).collect::<Vec<_>>()
    };
    let [y, cx, cz, narrow] = [y, cx, cz, narrow].map(normal);
    let channel = |k: usize| picture.iter().map(|p| p[k]).collect::<Vec<_>>();
    let planes: Vec<Vec<f32>> = [(0, &y), (1, &cx), (2, &cz), (2, &narrow)]
        .into_par_iter()
        .map(|(k, kernel)| convolve(&channel(k), width, kernel, kernel))
        .collect();
    (0..picture.len())
        .map(|i| {
            let cz = planes[2][i] + (planes[3][i] - planes[2][i]) * share;
            Vec3::new(planes[0][i], planes[1][i], cz)
        })
        .collect()
}

/// Differences of edges and points, 0..1.
fn feature_differences(reference: &[Vec3], test: &[Vec3], width: usize) -> Vec<f32> {
    const FEATURE_DEGREES: f32 = 0.082;
    let sd = 0.5 * FEATURE_DEGREES * PIXELS_A_DEGREE;
    let radius = (3.0 * sd).ceil() as i32;
    let sample = |f: &dyn Fn(f32) -> f32| (-radius..=radius).map(|x| f(x as f32)).collect::<Vec<_>>();
    let gauss = |x: f32| (-x * x / (2.0 * sd * sd)).exp();
    let smooth = sample(&gauss);
    let edge = sample(&|x| -x * gauss(x));
    let point = sample(&|x| (x * x / (sd * sd) - 1.0) * gauss(x));
    let (edge, point) = (balanced(edge), balanced(point));
    let sum: f32 = smooth.iter().sum();
    let smooth: Vec<f32> = smooth.iter().map(|weight| weight / sum).collect();

    let strengths = |picture: &[Vec3]| {
        let y: Vec<f32> = picture.iter().map(|p| (p.x + 16.0) / 116.0).collect();
        [&edge, &point].map(|kernel| {
            let across = convolve(&y, width, kernel, &smooth);
            let down = convolve(&y, width, &smooth, kernel);
            across.iter().zip(down).map(|(a, b)| a.hypot(b)).collect::<Vec<_>>()
        })
    };
    let (reference, test) = rayon::join(|| strengths(reference), || strengths(test));
    let difference = |k: usize, i: usize| (reference[k][i] - test[k][i]).abs();
    (0..reference[0].len())
        .map(|i| (std::f32::consts::FRAC_1_SQRT_2 * difference(0, i).max(difference(1, i))).sqrt().min(1.0))
        .collect()
}

/// A kernel whose positive weights sum to 1 and whose negative ones to −1.
fn balanced(kernel: Vec<f32>) -> Vec<f32> {
    let positive: f32 = kernel.iter().filter(|&&w| w > 0.0).sum();
    let negative: f32 = -kernel.iter().filter(|&&w| w < 0.0).sum::<f32>();
    kernel.into_iter().map(|w| if w > 0.0 { w / positive } else { w / negative }).collect()
}

/// A separable filter; the outermost pixels are repeated beyond the picture.
fn convolve(plane: &[f32], width: usize, across: &[f32], down: &[f32]) -> Vec<f32> {
    let height = plane.len() / width;
    let radius = across.len() as i64 / 2;
    let pass = |source: &[f32], kernel: &[f32], horizontal: bool| -> Vec<f32> {
        let mut filtered = vec![0.0; source.len()];
        filtered.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            for (x, value) in row.iter_mut().enumerate() {
                *value = (-radius..=radius)
                    .zip(kernel)
                    .map(|(offset, weight)| {
                        let near =
                            |at: usize, size: usize| (at as i64 + offset).clamp(0, size as i64 - 1) as usize;
                        let index =
                            if horizontal { y * width + near(x, width) } else { near(y, height) * width + x };
                        weight * source[index]
                    })
                    .sum();
            }
        });
        filtered
    };
    pass(&pass(plane, across, true), down, false)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture of waves and a bright spot, and the same with the waves shifted and noise.
    fn pair(shift: f32) -> [Vec<Rgb>; 2] {
        let (width, height) = (64, 48);
        let value = |i: usize, shift: f32| {
            let (x, y) = ((i % width) as f32, (i / width) as f32);
            let spot = if (x - 40.0).powi(2) + (y - 20.0).powi(2) < 16.0 { 8.0 } else { 0.0 };
            let wave = |a: f32, b: f32| 0.5 + 0.4 * (a * x + b * y + shift).sin();
            Rgb::new(wave(0.3, 0.1) + spot, wave(0.05, 0.4), wave(0.7, -0.2) + 0.5 * spot)
        };
        let noise = |i: usize| 1.0 + 0.1 * ((i * 7919 % 101) as f32 / 50.0 - 1.0);
        let pixels = 0..width * height;
        [
            pixels.clone().map(|i| value(i, 0.0)).collect(),
            pixels.map(|i| value(i, shift) * noise(i)).collect(),
        ]
    }

    #[test]
    fn values_agree_with_the_published_implementation() {
        // Means by NVIDIA's flip-evaluator 1.7 from PyPI, HDR with its defaults.
        for (shift, expected) in [(0.3, 0.329_961), (0.02, 0.054_182_7)] {
            let [reference, test] = pair(shift);
            let got = hdr(&reference, &test, 64);
            assert!((got - expected).abs() < 2e-4, "{shift}: {got} {expected}");
        }
    }
}
