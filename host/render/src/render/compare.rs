//! One report of how far a picture is from a reference: RMSE, relative RMSE and FLIP.

use glam::Vec3;

use super::flip;
use lobelia_base::error::{Error, Result};
use lobelia_base::figures::ErrorFigure;
use lobelia_reflectance::Rgb;
use lobelia_reflectance::picture::Picture;

/// The reference's mean times this is added (in squares) to what relative errors are divided by, so that
/// black pixels count little.
const FLOOR: f64 = 0.1;

/// How far a picture is from a reference, over all pixels and the three channels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Errors {
    /// Root of the mean squared difference, in the pictures' unit of radiance.
    pub rmse: f64,
    /// Root of the mean of (a − b)² / (b² + ε²), b the reference, ε a tenth of its mean.
    pub relative_rmse: f64,
    /// Mean HDR-FLIP, 0 to 1 (Andersson et al. 2021), for a display of 67 pixels a degree.
    pub flip: f64,
    /// Pixels.
    pub pixels: usize,
}

impl Errors {
    /// The errors as a report has them.
    pub fn figures(&self) -> Vec<ErrorFigure> {
        let over = format!("{} pixels × 3 channels", self.pixels);
        vec![
            ErrorFigure::new("rmse", self.rmse, "radiance", over.as_str()),
            ErrorFigure::new("relative_rmse", self.relative_rmse, "1", over),
            ErrorFigure::new("flip", self.flip, "1", format!("{} pixels", self.pixels)),
        ]
    }
}

/// Compares a picture with a reference.
///
/// # Errors
/// Input errors for pictures of different sizes.
pub fn compare(picture: &Picture, reference: &Picture) -> Result<Errors> {
    let size = |p: &Picture| (p.width, p.height);
    if size(picture) != size(reference) {
        return Err(Error::input(format!(
            "a picture of {} × {} pixels cannot be compared with one of {} × {}",
            picture.width, picture.height, reference.width, reference.height
        )));
    }
    let rgb = |p: &Picture| p.pixels.iter().map(|pixel| pixel.truncate()).collect::<Vec<_>>();
    let (a, b) = (rgb(picture), rgb(reference));
    let squares: Vec<Vec3> = a.iter().zip(&b).map(|(a, b)| (a - b) * (a - b)).collect();
    Ok(Errors {
        rmse: (sum(squares.iter().copied()) / (3 * squares.len()) as f64).sqrt(),
        relative_rmse: expected_relative_rmse(b.iter().copied(), &squares),
        flip: flip::hdr(&b, &a, picture.width),
        pixels: a.len(),
    })
}

/// The relative RMSE of a picture, estimated by three noisy pictures of the reference that are independent of
/// it and of each other: the noise of two cancels in the mean of (a − r₁)(a − r₂), and errors are relative to
/// the third.
pub fn relative_rmse_by(judges: &[Picture; 3], picture: &Picture) -> f64 {
    relative_square_by(judges.each_ref(), picture).max(0.0).sqrt()
}

/// The square of what [`relative_rmse_by`] gives, which noise may make negative.
pub(crate) fn relative_square_by(judges: [&Picture; 3], picture: &Picture) -> f64 {
    let [first, second, third] = judges.map(|judge| judge.pixels.iter().map(|p| p.truncate()));
    let a = picture.pixels.iter().map(|pixel| pixel.truncate());
    let squares: Vec<Vec3> = a.zip(first.zip(second)).map(|(a, (r, s))| (a - r) * (a - s)).collect();
    relative_square(third, &squares)
}

/// What the square of an error at a pixel of some mean counts in the square of the relative RMSE of a picture
/// of mean `whole`.
pub(crate) fn relative_weight(mean: f32, whole: f32) -> f32 {
    let floor = FLOOR as f32 * whole;
    1.0 / (mean * mean + floor * floor).max(f32::MIN_POSITIVE)
}

/// The relative RMSE of a picture whose pixels have the means and the variances given.
pub(crate) fn expected_relative_rmse(means: impl Iterator<Item = Rgb> + Clone, variance: &[Vec3]) -> f64 {
    relative_square(means, variance).max(0.0).sqrt()
}

/// The mean of squares relative to those of the means.
fn relative_square(means: impl Iterator<Item = Rgb> + Clone, squares: &[Vec3]) -> f64 {
    let values = (3 * squares.len()) as f64;
    let floor = (FLOOR * sum(means.clone()) / values).powi(2).max(f64::MIN_POSITIVE) as f32;
    let relative = means.zip(squares).map(|(mean, square)| *square / (mean * mean + Vec3::splat(floor)));
    sum(relative) / values
}

/// Sum over all values and channels.
fn sum(values: impl Iterator<Item = Vec3>) -> f64 {
    values.map(|v| f64::from(v.x) + f64::from(v.y) + f64::from(v.z)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(value: impl Fn(usize) -> f32) -> Picture {
        let pixels = (0..12).map(|i| Vec3::splat(value(i)).extend(1.0)).collect();
        Picture { width: 4, height: 3, pixels }
    }

    #[test]
    fn errors_of_a_known_difference_follow_their_definitions() {
        let errors =
            compare(&picture(|i| 2.0 + if i % 2 == 0 { 0.3 } else { -0.3 }), &picture(|_| 2.0)).unwrap();
        assert!((errors.rmse - 0.3).abs() < 1e-6);
        assert!((errors.relative_rmse - (0.09f64 / (4.0 + 0.04)).sqrt()).abs() < 1e-6, "{errors:?}");
        assert!(errors.flip > 0.01 && errors.flip < 1.0);
        let same = compare(&picture(|i| i as f32), &picture(|i| i as f32)).unwrap();
        assert_eq!((same.rmse, same.relative_rmse, same.flip), (0.0, 0.0, 0.0));
    }

    #[test]
    fn noise_of_the_judges_cancels() {
        let noise = |k: u32| crate::render::sampler::hash(k) as f32 / u32::MAX as f32 - 0.5;
        let picture = |value: &dyn Fn(u32) -> f32| {
            let pixels = (0..40_000).map(|i| Vec3::splat(value(i)).extend(1.0)).collect();
            Picture { width: 200, height: 200, pixels }
        };
        let judges = [1, 2, 3].map(|k| picture(&|i| 2.0 + noise(i + k * 1_000_000)));
        let found = relative_rmse_by(&judges, &picture(&|_| 2.1));
        // The third's noise, 14 %, makes the inverse square 6 % larger.
        assert!((found / (0.01f64 / (4.0 + 0.04)).sqrt() - 1.0).abs() < 0.1, "{found}");
    }

    #[test]
    fn sizes_must_agree() {
        let other = Picture { width: 3, height: 4, ..picture(|_| 1.0) };
        assert_eq!(compare(&picture(|_| 1.0), &other).unwrap_err().exit_code(), 2);
    }
}
