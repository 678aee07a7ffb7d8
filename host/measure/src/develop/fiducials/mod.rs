//! AprilTags of the family tag36h11 in photographs of a carrier, for registration (section 3.6 of the
//! source).
//!
//! [`detect`] finds tags whose place is not known, [`refine`] puts their corners right to a few hundredths of
//! a pixel, and [`refine_predicted`] adds those that were missed once the others tell where they must be.
//!
//! # Why not a crate
//!
//! Measured on two cores of an AMD EPYC that others used too, with the photographs of tag36h11 in the
//! AprilTag project's tests (three of 799 × 533, tags of 12 to 47 pixels on the faces of cubes; its corner
//! files list 47):
//!
//! | | found of 47 | all found | ms a photograph | corners | cold build |
//! |---|---|---|---|---|---|
//! | aprilgrid 0.8 | 0 | 0 | 10 | | 195 s of processor time, 218 packages |
//! | kornia-apriltag 0.2, full size | 36 | 41 | 13 | outline only | 174 s, 182 packages |
//! | kornia-apriltag 0.2, as it comes (half size) | 22 | 24 | 4 | outline only | |
//! | this module | 44 | 65 | 8 to 10 | whole pattern | 2 s, none |
//!
//! - aprilgrid looks for the saddle points between the corner squares of a Kalibr board; a lone tag has none.
//!   It needs `image` with all its codecs (an AV1 encoder among them) and faer, neither of which a feature
//!   leaves out.
//! - kornia-apriltag takes 8-bit pictures, so a photograph with a highlight has to be cut down first, and
//!   brings faer, nalgebra and kiddo for poses that are not used here. Those corners follow the outline
//!   alone.
//! - apriltag wraps the C library and builds it with CMake.
//!
//! The photographs' reference corners are good to about half a pixel and agree with ours to 0.57 (RMS).
//! Against a truth (`tests`, RMS distance of refined corners in pixels): 0.013 or better for tags of 25 to 50
//! pixels that face the camera; 0.07 or better for tags of 30 to 50 pixels turned away by 60° and 65° with 2
//! % noise; 0.03 for tags of 12 to 18 pixels with 1 % noise; 0.16 for tags of 14 pixels turned away by 65°,
//! by [`refine_predicted`]. Detection in 800 × 600 pixels of nothing but noise takes 20 ms; refinement takes
//! 1 to 4 ms a tag.

mod family;
mod fit;
mod homography;
mod pattern;
mod quads;
mod read;
#[cfg(test)]
mod tests;

pub use family::COUNT;
use glam::DVec2;

/// A tag in a photograph.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Detection {
    /// Its number in the family tag36h11.
    pub id: u32,
    /// The corners of the black border's outer edge in pixels, integers being pixel centres: top left, top
    /// right, bottom right and bottom left of the upright tag.
    pub corners: [DVec2; 4],
}

impl Detection {
    /// The mean of the corners.
    fn middle(&self) -> DVec2 {
        self.corners.iter().sum::<DVec2>() * 0.25
    }

    /// Whether two detections are of one tag: the middle of either is well within the other.
    fn overlaps(&self, other: &Self) -> bool {
        let reach = self.corners.map(|corner| corner.distance(self.middle()));
        self.middle().distance(other.middle()) < 0.5 * reach.into_iter().fold(f64::INFINITY, f64::min)
    }
}

/// How well the printed pattern fits the photograph.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// The part of the pixels' variance that the pattern explains, up to 1.
    pub explained: f64,
    /// (white − black) / white at the tag's centre.
    pub contrast: f64,
    /// Standard deviation of the blur of lens and pixel, in pixels.
    pub blur_px: f64,
    /// Standard deviation of a corner's coordinate, in pixels, that the residuals make one expect.
    pub corner_sigma_px: f64,
}

/// A picture of one channel, linear in radiance, of any scale.
#[derive(Debug, Clone, PartialEq)]
pub struct GrayImage {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Values row by row from the top left. What is not finite is no pixel of a tag.
    pub data: Vec<f32>,
}

impl GrayImage {
    /// The value between pixels, by linear interpolation; nothing outside of the outermost centres.
    fn between(&self, at: DVec2) -> Option<f64> {
        let inside = at.x >= 0.0 && at.y >= 0.0 && at.x < self.width as f64 && at.y < self.height as f64;
        let (x, y) = (at.x as usize, at.y as usize);
        if !inside || x + 1 >= self.width || y + 1 >= self.height {
            return None;
        }
        let (fx, fy) = (at.x - x as f64, at.y - y as f64);
        let value = |x: usize, y: usize| f64::from(self.data[y * self.width + x]);
        let row = |y: usize| value(x, y) * (1.0 - fx) + value(x + 1, y) * fx;
        Some(row(y) * (1.0 - fy) + row(y + 1) * fy)
    }
}

/// The tags of a photograph, corners to about half a pixel: see [`refine`]. Tags narrower than about 1.2
/// pixels a module are not found; [`refine_predicted`] gets those whose place is known.
///
/// # Panics
///
/// If the picture's data do not fill it.
pub fn detect(image: &GrayImage) -> Vec<Detection> {
    assert_eq!(image.data.len(), image.width * image.height, "a picture's data must fill it");
    let mut found: Vec<(Detection, u32)> =
        quads::find(image).iter().filter_map(|quad| read::read(image, quad)).collect();
    found.sort_by_key(|(tag, errors)| (*errors, tag.id));
    let mut tags: Vec<Detection> = Vec::new();
    for (tag, _) in found {
        if !tags.iter().any(|other| other.overlaps(&tag)) {
            tags.push(tag);
        }
    }
    tags
}

/// Moves the corners of a detected tag to where the printed pattern fits the photograph best. Nothing, and
/// the detection is left alone, when the fit is poor: covered by a highlight, cut by the picture's edge, not
/// that tag.
pub fn refine(image: &GrayImage, detection: &mut Detection) -> Option<Fit> {
    let (found, quality) = fit::from_detected(image, detection)?;
    *detection = found;
    Some(quality)
}

/// The tag of a known number near predicted corners, right to about three pixels; nothing when contrast or
/// fit is poor. It need not be one that [`detect`] finds.
pub fn refine_predicted(image: &GrayImage, id: u32, predicted: &[DVec2; 4]) -> Option<Detection> {
    fit::from_predicted(image, id, predicted).map(|found| found.0)
}
