//! What is kept of a sample beside its sum: nothing for a picture, its parts for layers.

use lobelia_reflectance::Rgb;

/// Takes what one sample of a pixel finds.
pub(super) trait Tally {
    /// Whether the diffuse term is to be told from the rest.
    const SPLITS: bool;

    /// Radiance that came to the viewer by so many reflections, and the part of it, by channel, that is the
    /// first surface's diffuse term's.
    fn add(&mut self, reflections: u32, radiance: Rgb, diffuse: Rgb);

    /// Radiance that the first surface reflects, found by samples of emitters, and that of its diffuse term.
    fn first(&mut self, radiance: Rgb, diffuse: Rgb);

    /// The object that the camera's ray meets, or beyond them a rectangular light.
    fn meets(&mut self, object: u32);
}

impl Tally for () {
    const SPLITS: bool = false;

    #[inline(always)]
    fn add(&mut self, _: u32, _: Rgb, _: Rgb) {}

    #[inline(always)]
    fn first(&mut self, _: Rgb, _: Rgb) {}

    #[inline(always)]
    fn meets(&mut self, _: u32) {}
}
