//! What lies on the carrier: materials laid out over the sample by a pattern.

use std::path::Path;
use std::sync::Arc;

use glam::Vec3;
use lobelia_reflectance::{Brdf, LobeBrdf, Rgb};

/// A material: lobes, or a measured table rendered from the table itself.
#[derive(Clone)]
pub enum Material {
    /// A sum of lobes, which may be turned with the pattern.
    Lobes(LobeBrdf),
    /// Any other BRDF; it must be isotropic where the pattern turns it.
    Measured(Arc<dyn Brdf>),
}

impl Brdf for Material {
    fn eval(&self, wi: Vec3, wo: Vec3) -> Rgb {
        match self {
            Self::Lobes(brdf) => brdf.eval(wi, wo),
            Self::Measured(brdf) => brdf.eval(wi, wo),
        }
    }

    fn eval_channel(&self, wi: Vec3, wo: Vec3, channel: usize) -> f32 {
        match self {
            Self::Lobes(brdf) => brdf.eval_channel(wi, wo, channel),
            Self::Measured(brdf) => brdf.eval_channel(wi, wo, channel),
        }
    }
}

impl Material {
    /// The material turned about the normal by `angle` radians.
    fn rotated(&self, angle: f32) -> Self {
        match self {
            Self::Lobes(brdf) => Self::Lobes(brdf.rotated(angle)),
            Self::Measured(_) => self.clone(),
        }
    }
}

/// How materials are laid out. Lengths in mm, the sample's centre at (0, 0), y up.
#[derive(Debug, Clone, PartialEq)]
pub enum Pattern {
    /// Vertical stripes of the materials in turn.
    Stripes {
        /// Width of a stripe.
        width_mm: f64,
    },
    /// A board of squares, the materials in turn along each diagonal.
    Checks {
        /// Edge of a square.
        size_mm: f64,
    },
    /// A plain weave: warp threads along y of the even materials, weft threads along x (turned by 90°) of the
    /// odd ones, over and under in turn.
    Weave {
        /// From one thread to the next.
        pitch_mm: f64,
    },
    /// An image over the whole sample whose pixels index the materials.
    Image {
        /// Columns.
        columns: usize,
        /// Rows; row 0 is the +y edge.
        rows: usize,
        /// Material index a pixel.
        indices: Vec<u8>,
    },
}

impl Pattern {
    /// Reads an image and ranks its pixels by brightness into `materials` equal steps, darkest first.
    ///
    /// # Errors
    /// A sentence when the file is no readable image.
    pub fn from_image(path: &Path, materials: usize) -> Result<Self, String> {
        let image = image::open(path).map_err(|error| format!("{}: {error}", path.display()))?.to_luma8();
        let steps = materials.clamp(1, 256);
        let indices = image.pixels().map(|pixel| (usize::from(pixel.0[0]) * steps / 256) as u8).collect();
        Ok(Self::Image { columns: image.width() as usize, rows: image.height() as usize, indices })
    }
}

/// How far the sample reaches beyond the measured part on every side, mm, so that texels at the edge see no
/// carrier.
const ALLOWANCE_MM: f64 = 1.5;

/// The sample: its size, its materials and their pattern.
pub struct SampleLayout {
    width_mm: f64,
    height_mm: f64,
    pattern: Pattern,
    /// The materials along the warp, then the same turned by 90°.
    along: Vec<Material>,
    across: Vec<Material>,
}

impl SampleLayout {
    /// A sample whose measured part has the given size, mm.
    ///
    /// # Panics
    /// Without any material.
    pub fn new(width_mm: f64, height_mm: f64, materials: Vec<Material>, pattern: Pattern) -> Self {
        assert!(!materials.is_empty(), "a sample needs a material");
        let across = materials.iter().map(|material| material.rotated(std::f32::consts::FRAC_PI_2)).collect();
        Self { width_mm, height_mm, pattern, along: materials, across }
    }

    /// Width and height of the measured part, mm.
    pub fn size_mm(&self) -> [f64; 2] {
        [self.width_mm, self.height_mm]
    }

    /// Whether a point of the carrier's plane lies on the sample, which is cut a little larger than what is
    /// measured of it.
    pub fn contains(&self, x_mm: f64, y_mm: f64) -> bool {
        let within = |place: f64, length: f64| place.abs() <= 0.5 * length + ALLOWANCE_MM;
        within(x_mm, self.width_mm) && within(y_mm, self.height_mm)
    }

    /// The material at a point of the sample.
    pub fn at(&self, x_mm: f64, y_mm: f64) -> &Material {
        let (index, turned) = self.place(x_mm, y_mm);
        if turned { &self.across[index] } else { &self.along[index] }
    }

    /// The number of the material at a point of the sample.
    pub fn index_at(&self, x_mm: f64, y_mm: f64) -> usize {
        self.place(x_mm, y_mm).0
    }

    /// The number of the material at a point of the sample, and whether it is turned by 90°.
    fn place(&self, x_mm: f64, y_mm: f64) -> (usize, bool) {
        let count = self.along.len();
        // Columns from the left edge, rows from the top, as in images.
        let (right, down) = (x_mm + self.width_mm / 2.0, self.height_mm / 2.0 - y_mm);
        let cell = |length: f64, size: f64| (length / size).floor().max(0.0) as usize;
        match &self.pattern {
            Pattern::Stripes { width_mm } => (cell(right, *width_mm) % count, false),
            Pattern::Checks { size_mm } => ((cell(right, *size_mm) + cell(down, *size_mm)) % count, false),
            Pattern::Weave { pitch_mm } => {
                let (column, row) = (cell(right, *pitch_mm), cell(down, *pitch_mm));
                if (column + row).is_multiple_of(2) {
                    ((2 * column) % count, false)
                } else {
                    ((2 * row + 1) % count, true)
                }
            }
            Pattern::Image { columns, rows, indices } => {
                let column = cell(right, self.width_mm / *columns as f64).min(columns - 1);
                let row = cell(down, self.height_mm / *rows as f64).min(rows - 1);
                (usize::from(indices[row * columns + column]) % count, false)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(value: f32) -> Material {
        Material::Lobes(LobeBrdf { rho_d: Rgb::splat(value), ..LobeBrdf::default() })
    }

    fn value(layout: &SampleLayout, x: f64, y: f64) -> f32 {
        layout.at(x, y).eval(Vec3::Z, Vec3::Z).x
    }

    #[test]
    fn stripes_run_from_the_left_and_checks_alternate_both_ways() {
        let stripes =
            SampleLayout::new(8.0, 8.0, vec![grey(0.1), grey(0.2)], Pattern::Stripes { width_mm: 2.0 });
        assert_eq!((value(&stripes, -3.9, 1.0), value(&stripes, -1.9, 1.0)), (0.1, 0.2));
        let checks =
            SampleLayout::new(8.0, 8.0, vec![grey(0.1), grey(0.2)], Pattern::Checks { size_mm: 2.0 });
        assert_eq!((value(&checks, -3.9, 3.9), value(&checks, -3.9, 1.9)), (0.1, 0.2));
    }

    #[test]
    fn weft_threads_are_turned_by_a_right_angle() {
        let lobe = lobelia_reflectance::Lobe::new(Rgb::ONE, Vec3::new(-1.0, -0.5, 0.9), 20.0);
        let thread = Material::Lobes(LobeBrdf { lobes: vec![lobe], ..LobeBrdf::default() });
        let weave = SampleLayout::new(8.0, 8.0, vec![thread], Pattern::Weave { pitch_mm: 1.0 });
        let (wi, wo) = (Vec3::new(0.5, 0.0, 0.8).normalize(), Vec3::new(-0.4, 0.0, 0.9).normalize());
        let turn = |v: Vec3| Vec3::new(-v.y, v.x, v.z);
        let (warp, weft) = (weave.at(-3.5, 3.5), weave.at(-2.5, 3.5));
        assert!((warp.eval(wi, wo) - weft.eval(turn(wi), turn(wo))).abs().max_element() < 1e-6);
        assert!((warp.eval(wi, wo) - weft.eval(wi, wo)).abs().max_element() > 0.1);
    }
}
