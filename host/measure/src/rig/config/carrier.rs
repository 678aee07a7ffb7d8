//! The sample's carrier and the fiducials on it.

use serde::{Deserialize, Serialize};

/// The sample and its carrier.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Carrier {
    /// Width of the sample.
    pub sample_width_mm: f64,
    /// Height of the sample.
    pub sample_height_mm: f64,
    /// Texels across the sample's width; rows follow from the height.
    pub texels_across: usize,
    /// Outer edge of a tag's black border.
    pub tag_size_mm: f64,
    /// The printed tags (family 36h11), upright in the sample's frame.
    pub tags: Vec<Tag>,
    /// Radius of the cylinder that the sample is bent over, its axis along y and its two side edges on the
    /// carrier; without it the sample lies flat. Such a run cannot be developed: `compare` sets a map of the
    /// flat sample against it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cylinder_radius_mm: Option<f64>,
}

/// One printed tag.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tag {
    /// Identity in the family 36h11.
    pub id: u32,
    /// Centre, sample frame.
    pub x_mm: f64,
    /// Centre, sample frame.
    pub y_mm: f64,
}

impl Default for Carrier {
    fn default() -> Self {
        Self {
            sample_width_mm: 64.0,
            sample_height_mm: 64.0,
            texels_across: 128,
            tag_size_mm: 16.0,
            tags: ring_of_tags(44.0, 5),
            cylinder_radius_mm: None,
        }
    }
}

impl Carrier {
    /// Edge of a texel, mm.
    pub fn texel_mm(&self) -> f64 {
        self.sample_width_mm / self.texels_across as f64
    }

    /// Rows of texels.
    pub fn texels_down(&self) -> usize {
        (self.sample_height_mm / self.texel_mm()).round() as usize
    }
}

/// Tags on the edge of a square of half-width `half_mm`, `per_side` on each side (corners shared).
fn ring_of_tags(half_mm: f64, per_side: usize) -> Vec<Tag> {
    let at = |k: usize| half_mm * (2.0 * k as f64 / (per_side - 1) as f64 - 1.0);
    let places = (0..per_side).flat_map(|row| (0..per_side).map(move |column| (row, column)));
    let edge = |k: usize| k == 0 || k == per_side - 1;
    places
        .filter(|&(row, column)| edge(row) || edge(column))
        .enumerate()
        .map(|(id, (row, column))| Tag { id: id as u32, x_mm: at(column), y_mm: -at(row) })
        .collect()
}
