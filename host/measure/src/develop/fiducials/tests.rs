//! Detection and refinement against tags that the simulator's own table draws, seen by a pinhole camera.

use glam::{DMat3, DQuat, DVec2, DVec3};
use lobelia_hil_sim::optics::tags::{COUNT, is_white};

use super::*;

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
/// Tags nearer to the picture's edge than this are not counted.
const RIM: f64 = 10.0;
const WHITE: f64 = 0.9;
const BLACK: f64 = 0.04;

/// A sheet of tags seven a row, each with one module of white around it and dark between.
#[derive(Clone, Copy)]
struct Sheet {
    /// Side of a tag in pixels at the picture's middle, before foreshortening.
    side: f64,
    /// Turn of the sheet's normal away from the camera, and of the sheet about its normal, in degrees.
    tilt_deg: f64,
    roll_deg: f64,
    /// Standard deviation of the lens's blur in pixels, and of the noise as a part of white.
    blur: f64,
    noise: f64,
    first: u32,
    seed: u64,
}

impl Default for Sheet {
    fn default() -> Self {
        Self { side: 30.0, tilt_deg: 0.0, roll_deg: 0.0, blur: 0.5, noise: 0.0, first: 0, seed: 1 }
    }
}

/// Pinhole: focal length and distance of the sheet in pixels, as of a 50 mm lens a metre away.
const FOCAL: f64 = 3000.0;
const COLUMNS: u32 = 7;
const ROWS: u32 = 5;
/// From tag to tag, in sides.
const PITCH: f64 = 1.5;

impl Sheet {
    fn rotation(&self) -> DMat3 {
        DMat3::from_quat(
            DQuat::from_axis_angle(DVec3::Y, self.tilt_deg.to_radians())
                * DQuat::from_rotation_z(self.roll_deg.to_radians()),
        )
    }

    /// The pixel of a point of the sheet, in pixels of its middle (x right, y down).
    fn pixel(&self, sheet: DVec2) -> DVec2 {
        let p = self.rotation() * sheet.extend(0.0) + DVec3::Z * FOCAL;
        middle() + p.truncate() * (FOCAL / p.z)
    }

    fn sheet(&self, pixel: DVec2) -> DVec2 {
        let (rotation, ray) = (self.rotation(), (pixel - middle()).extend(FOCAL));
        let normal = rotation.z_axis;
        let p = ray * (normal.z * FOCAL / normal.dot(ray)) - DVec3::Z * FOCAL;
        (rotation.transpose() * p).truncate()
    }

    fn origin(&self, index: u32) -> DVec2 {
        let cell = DVec2::new(f64::from(index % COLUMNS), f64::from(index / COLUMNS));
        let shape = DVec2::new(f64::from(COLUMNS - 1), f64::from(ROWS - 1));
        ((cell - shape * 0.5) * PITCH - 0.5) * self.side
    }

    /// The tags and their corners, those in the picture.
    fn truth(&self) -> Vec<Detection> {
        let corners = [DVec2::ZERO, DVec2::X, DVec2::ONE, DVec2::Y];
        let tag = |i: u32| Detection {
            id: (self.first + i) % COUNT,
            corners: corners.map(|c| self.pixel(self.origin(i) + c * self.side)),
        };
        (0..COLUMNS * ROWS).map(tag).filter(|tag| in_picture(tag, RIM)).collect()
    }

    fn reflectance(&self, pixel: DVec2) -> f64 {
        let p = self.sheet(pixel) / self.side;
        let shape = DVec2::new(f64::from(COLUMNS - 1), f64::from(ROWS - 1));
        let cell = (p / PITCH + shape * 0.5).round();
        let at = p - (cell - shape * 0.5) * PITCH + 0.5;
        let inside = cell.cmpge(DVec2::ZERO).all() && cell.cmple(shape).all();
        let quiet = (at - 0.5).abs().max_element() < 0.5 + 0.125;
        let id = || (self.first + cell.y as u32 * COLUMNS + cell.x as u32) % COUNT;
        if inside && quiet && is_white(id(), at.x, at.y) { WHITE } else { BLACK }
    }

    /// The photograph under a light that falls off by a third from left to right.
    fn photograph(&self) -> GrayImage {
        // As many samples a pixel as an edge along its rows needs; three across show whether there is an
        // edge.
        let average = |x: usize, y: usize, count: usize, reach: f64| {
            let offset = |k: usize| reach * ((k as f64 + 0.5) / count as f64 - 0.5);
            let point = |k: usize| DVec2::new(x as f64 + offset(k % count), y as f64 + offset(k / count));
            (0..count * count).map(|k| self.reflectance(point(k))).sum::<f64>() / (count * count) as f64
        };
        let average = |x: usize, y: usize| match average(x, y, 3, 1.5) {
            rough if (rough - WHITE).abs().min((rough - BLACK).abs()) < 1e-9 => rough,
            _ => average(x, y, 16, 1.0),
        };
        let sharp = (0..WIDTH * HEIGHT).map(|i| average(i % WIDTH, i / WIDTH)).collect();
        let mut random = Random(self.seed);
        let blurred = blurred(sharp, self.blur);
        let lit = blurred.iter().enumerate().map(|(i, value)| {
            let light = 37.0 * (1.0 - 0.33 * (i % WIDTH) as f64 / WIDTH as f64);
            (light * (value + WHITE * self.noise * random.normal())) as f32
        });
        GrayImage { width: WIDTH, height: HEIGHT, data: lit.collect() }
    }
}

fn middle() -> DVec2 {
    DVec2::new(WIDTH as f64 - 1.0, HEIGHT as f64 - 1.0) * 0.5
}

fn blurred(image: Vec<f64>, deviation: f64) -> Vec<f64> {
    let weights: Vec<f64> = (-4..=4).map(|k| (-0.5 * (f64::from(k) / deviation).powi(2)).exp()).collect();
    let sum: f64 = weights.iter().sum();
    let along = |image: &[f64], step: usize| -> Vec<f64> {
        let at = |i: usize, k: usize| image[(i + k * step).saturating_sub(4 * step).min(image.len() - 1)];
        let mix = |i| weights.iter().enumerate().map(|(k, w)| w * at(i, k)).sum::<f64>() / sum;
        (0..image.len()).map(mix).collect()
    };
    along(&along(&image, 1), WIDTH)
}

/// SplitMix64, and normal numbers by Box and Muller's method.
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ z >> 31) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    fn direction(&mut self) -> DVec2 {
        DVec2::from_angle(std::f64::consts::TAU * self.uniform())
    }
}

fn in_picture(tag: &Detection, rim: f64) -> bool {
    let size = DVec2::new(WIDTH as f64, HEIGHT as f64);
    tag.corners.iter().all(|c| c.cmpgt(DVec2::splat(rim)).all() && c.cmplt(size - rim).all())
}

/// The truth of each detection, and how many tags were not found; panics on a tag that is not there.
fn matched(found: &[Detection], truth: &[Detection]) -> (Vec<(Detection, Detection)>, usize) {
    let pair = |tag: &Detection| {
        let truth = truth.iter().find(|t| t.id == tag.id && t.middle().distance(tag.middle()) < 3.0);
        assert!(truth.is_some() || !in_picture(tag, RIM + 3.0), "no such tag: {tag:?}");
        Some((*tag, *truth?))
    };
    let pairs: Vec<_> = found.iter().filter_map(pair).collect();
    let missed = truth.len() - pairs.len();
    (pairs, missed)
}

/// Root mean square of the distance of corners, in pixels.
fn corner_error(pairs: &[(Detection, Detection)]) -> f64 {
    let squares = pairs.iter().flat_map(|(a, b)| (0..4).map(|i| a.corners[i].distance_squared(b.corners[i])));
    (squares.sum::<f64>() / (4 * pairs.len()) as f64).sqrt()
}

/// Detects and refines all tags of a sheet: (corner error before, after, tags missed, tags in the picture).
fn run(sheet: &Sheet) -> (f64, f64, usize, usize) {
    let (image, truth) = (sheet.photograph(), sheet.truth());
    let (mut pairs, missed) = matched(&detect(&image), &truth);
    let before = corner_error(&pairs);
    for (tag, _) in &mut pairs {
        assert!(refine(&image, tag).is_some(), "{tag:?} is not refined");
    }
    let after = corner_error(&pairs);
    println!(
        "side {} px, tilt {}°, roll {}°, noise {}: {missed} of {} missed, {before:.3} px, refined {after:.4} \
         px",
        sheet.side,
        sheet.tilt_deg,
        sheet.roll_deg,
        sheet.noise,
        truth.len()
    );
    (before, after, missed, truth.len())
}

#[test]
fn every_drawn_tag_is_found_upright_in_any_rotation() {
    for (k, roll_deg) in [0.0, 37.0, 90.0, 171.0, 270.0].into_iter().enumerate() {
        let (before, _, missed, count) =
            run(&Sheet { roll_deg, side: 40.0, first: 13 * k as u32, ..Sheet::default() });
        assert!(count >= 30 && missed == 0 && before < 1.0);
    }
}

#[test]
fn corners_of_tags_of_25_to_50_pixels_are_right_to_a_tenth_of_a_pixel() {
    for (side, roll_deg) in [(25.0, 0.0), (32.0, 12.0), (50.0, 31.0)] {
        let (_, after, missed, _) = run(&Sheet { side, roll_deg, noise: 0.002, ..Sheet::default() });
        assert!(missed == 0 && after < 0.05, "{after}");
    }
}

#[test]
fn foreshortened_noisy_tags_are_right_to_a_fifth_of_a_pixel() {
    for (side, tilt_deg, roll_deg) in
        [(30.0, 60.0, 0.0), (30.0, 60.0, 33.0), (40.0, 65.0, 45.0), (50.0, 65.0, 10.0)]
    {
        let (_, after, missed, count) =
            run(&Sheet { side, tilt_deg, roll_deg, noise: 0.02, seed: 7, ..Sheet::default() });
        assert!(after < 0.2, "{after}");
        assert!(missed * 10 <= count, "{missed} of {count}");
    }
}

#[test]
fn tags_of_12_pixels_are_found_and_refined() {
    for (side, roll_deg) in [(12.0, 0.0), (12.0, 45.0), (14.0, 20.0), (18.0, 45.0)] {
        let (_, after, missed, count) = run(&Sheet { side, roll_deg, noise: 0.01, ..Sheet::default() });
        assert!(missed * 10 <= count && after < 0.1, "{missed} of {count}, {after}");
    }
}

/// Highlights a thousand times brighter than paper over some of the tags, and a glow around them.
#[test]
fn a_highlight_costs_only_the_tags_that_it_covers() {
    let sheet = Sheet { noise: 0.01, side: 36.0, ..Sheet::default() };
    let mut image = sheet.photograph();
    let (centre, radius) = (sheet.truth()[17].middle(), 24.0);
    for (i, value) in image.data.iter_mut().enumerate() {
        let off = DVec2::new((i % WIDTH) as f64, (i / WIDTH) as f64).distance(centre);
        *value += if off < radius { 3e4 } else { (100.0 / (off - radius + 1.0).powi(2)) as f32 };
    }
    let (mut pairs, missed) = matched(&detect(&image), &sheet.truth());
    assert_eq!(missed, 1, "{pairs:?}");
    for (tag, _) in &mut pairs {
        assert!(refine(&image, tag).is_some(), "{tag:?}");
    }
    assert!(corner_error(&pairs) < 0.1, "{}", corner_error(&pairs));
    assert_eq!(refine_predicted(&image, 17, &sheet.truth()[17].corners), None);
}

#[test]
fn predicted_tags_are_refined_from_three_pixels_off() {
    let mut random = Random(5);
    for (side, tilt_deg, roll_deg, limit) in
        [(12.0, 0.0, 0.0, 0.1), (14.0, 65.0, 20.0, 0.2), (30.0, 65.0, 45.0, 0.1)]
    {
        let sheet = Sheet { side, tilt_deg, roll_deg, noise: 0.015, ..Sheet::default() };
        let (image, truth) = (sheet.photograph(), sheet.truth());
        let refined = truth.iter().filter_map(|tag| {
            let shift = random.direction() * 2.7;
            let predicted = tag.corners.map(|c| c + shift + random.direction() * 0.3);
            Some((refine_predicted(&image, tag.id, &predicted)?, *tag))
        });
        let pairs: Vec<_> = refined.collect();
        let error = corner_error(&pairs);
        println!("side {side}, tilt {tilt_deg}°: {} of {} refined, {error:.3} px", pairs.len(), truth.len());
        assert!(pairs.len() * 20 >= truth.len() * 19 && error < limit);
    }
}

#[test]
fn a_prediction_of_what_is_not_there_is_refused() {
    let sheet = Sheet { noise: 0.02, ..Sheet::default() };
    let (image, truth) = (sheet.photograph(), sheet.truth());
    for tag in &truth {
        assert_eq!(refine_predicted(&image, (tag.id + 1) % COUNT, &tag.corners), None, "another tag");
        assert_eq!(refine_predicted(&image, COUNT, &tag.corners), None, "an unknown number");
        let between = tag.corners.map(|c| c + DVec2::splat(0.75 * sheet.side));
        assert_eq!(refine_predicted(&image, tag.id, &between), None, "between the tags");
        let outside = tag.corners.map(|c| c - tag.middle());
        assert_eq!(refine_predicted(&image, tag.id, &outside), None, "beyond the picture");
    }
    let nowhere = [DVec2::NAN; 4];
    assert_eq!(refine_predicted(&image, 0, &nowhere), None);
}

/// 280 coordinates: the ratio of their scatter to the one that the fit expects has a standard deviation of 4
/// %. The noise is high enough that the model's own error does not count.
#[test]
fn the_uncertainty_that_a_fit_expects_is_its_error() {
    let sheet =
        Sheet { side: 36.0, tilt_deg: 30.0, roll_deg: 25.0, noise: 0.05, seed: 3, ..Sheet::default() };
    let image = sheet.photograph();
    let (mut squares, mut expected, mut count) = (0.0, 0.0, 0.0);
    for (mut tag, truth) in matched(&detect(&image), &sheet.truth()).0 {
        let fit = refine(&image, &mut tag).unwrap();
        squares += tag.corners.iter().zip(truth.corners).map(|(a, b)| a.distance_squared(b)).sum::<f64>();
        expected += 8.0 * fit.corner_sigma_px.powi(2);
        count += 8.0;
        assert!(fit.explained > 0.9 && (fit.contrast - (1.0 - BLACK / WHITE)).abs() < 0.05);
        assert!((0.3..0.9).contains(&fit.blur_px));
    }
    let ratio = (squares / expected).sqrt();
    println!("{count} coordinates, error over expectation {ratio:.3}");
    assert!(count > 200.0 && (0.75..1.35).contains(&ratio), "{ratio}");
}

#[test]
fn noise_darkness_and_what_is_not_finite_hold_no_tags() {
    let mut random = Random(11);
    let noise = (0..WIDTH * HEIGHT).map(|_| random.normal() as f32).collect();
    for data in [
        noise,
        vec![0.0; WIDTH * HEIGHT],
        vec![f32::NAN; WIDTH * HEIGHT],
        vec![f32::INFINITY; WIDTH * HEIGHT],
    ] {
        assert_eq!(detect(&GrayImage { width: WIDTH, height: HEIGHT, data }), []);
    }
    for (width, height) in [(0, 0), (3, 0), (1, 1), (5, 2)] {
        assert_eq!(detect(&GrayImage { width, height, data: vec![1.0; width * height] }), []);
    }
}

/// The tags of a corner file: the number and four corners a line. Its pixel centres are at halves.
fn reference(path: &std::path::Path) -> std::io::Result<Vec<[DVec2; 4]>> {
    let tag = |line: &str| {
        let numbers: Vec<f64> = line.split([' ', ',', '(', ')']).filter_map(|n| n.parse().ok()).collect();
        std::array::from_fn(|i| DVec2::new(numbers[1 + 2 * i], numbers[2 + 2 * i]) - 0.5)
    };
    Ok(std::fs::read_to_string(path)?.lines().map(tag).collect())
}

#[test]
fn nine_of_ten_tags_are_found_in_photographs() {
    let data = std::env::var("LOBELIA_DATA").map_or_else(
        |_| std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"),
        std::path::PathBuf::from,
    );
    let Ok(folder) = std::fs::read_dir(data.join("fiducials")) else {
        println!("skipped: no photographs in {} (set LOBELIA_DATA)", data.join("fiducials").display());
        return;
    };
    let (mut found, mut total, mut squares) = (0, 0, 0.0);
    for path in
        folder.map(|entry| entry.unwrap().path()).filter(|p| p.extension().is_some_and(|e| e == "jpg"))
    {
        let photograph = image::open(&path).unwrap().to_luma8();
        let (width, height) = (photograph.width() as usize, photograph.height() as usize);
        let data = photograph.iter().map(|&v| (f32::from(v) / 255.0).powf(2.2)).collect();
        let image = GrayImage { width, height, data };
        let mut tags = detect(&image);
        tags.retain_mut(|tag| refine(&image, tag).is_some() && tag.id == 0);
        for expected in reference(&path.with_extension("txt")).unwrap() {
            let middle = expected.iter().sum::<DVec2>() / 4.0;
            total += 1;
            if let Some(tag) = tags.iter().find(|tag| tag.middle().distance(middle) < 4.0) {
                found += 1;
                let nearest =
                    |c: &DVec2| expected.iter().map(|e| e.distance_squared(*c)).fold(f64::MAX, f64::min);
                squares += tag.corners.iter().map(nearest).sum::<f64>() / 4.0;
            }
        }
    }
    let error = (squares / f64::from(found)).sqrt();
    println!("{found} of {total} found, corners within {error:.2} px RMS of the reference");
    assert!(found * 10 >= total * 9 && error < 0.8);
}
