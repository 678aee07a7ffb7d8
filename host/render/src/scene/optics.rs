//! What a material has beyond lobes: mirrors, glass, metal, a BRDF of its own form, and light of its own.

use std::path::Path;
use std::sync::Arc;

use glam::Vec2;

use super::Scene;
use lobelia_base::error::{Error, Result};
use lobelia_reflectance::picture::Picture;
use lobelia_reflectance::{AshikhminShirley, Rgb, SbrdfMap};

/// How a surface reflects or transmits where it is not, or not only, lobes.
#[derive(Debug, Clone, PartialEq)]
pub enum Optics {
    /// A perfect mirror over the lobes: L_r = ρ_m L_i from the mirror direction, no unit.
    Mirror(Texture),
    /// A smooth metal of index n + i k a channel, without lobes.
    Conductor {
        /// Index of refraction a channel.
        n: Rgb,
        /// Index of absorption a channel.
        k: Rgb,
    },
    /// The surface of a smooth transparent body, without lobes.
    Dielectric(Dielectric),
    /// The BRDF of Ashikhmin and Shirley, without lobes.
    AshikhminShirley(AshikhminShirley),
}

/// A transparent body within a closed mesh. Where bodies overlap the one of the highest priority is there,
/// and the surfaces of the others within it are not (Schmidt and Budge 2002).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dielectric {
    /// Index of refraction.
    pub index: f32,
    /// Absorption a unit of length a channel: a length d transmits exp(−a d).
    pub absorption: Rgb,
    /// The higher goes before the lower.
    pub priority: i32,
}

/// A colour over the texture's repeat: the same everywhere, or texels that are blended.
#[derive(Debug, Clone, PartialEq)]
pub enum Texture {
    /// The same everywhere.
    Uniform(Rgb),
    /// Texels a row, rows, and the texels row by row; row 0 is at v = 0.
    Texels(usize, usize, Arc<[Rgb]>),
}

impl Texture {
    /// The planes `NAME.R`, `.G` and `.B` of a map times a factor, where it has them.
    pub fn of_map(map: &SbrdfMap, name: &str, factor: f32) -> Option<Self> {
        let plane = |letter: &str| map.extra.get(&format!("{name}.{letter}"));
        let [red, green, blue] = [plane("R")?, plane("G")?, plane("B")?];
        let texel = |k: usize| Rgb::new(red[k], green[k], blue[k]) * factor;
        Some(Self::Texels(map.width, map.height, (0..red.len()).map(texel).collect()))
    }

    /// A linear OpenEXR picture times a colour.
    ///
    /// # Errors
    /// Those of [`Picture::read_exr`].
    pub fn read(path: &Path, factor: Rgb) -> Result<Self> {
        let picture = Picture::read_exr(path)?;
        let texels = picture.pixels.iter().map(|pixel| pixel.truncate() * factor).collect();
        Ok(Self::Texels(picture.width, picture.height, texels))
    }

    /// The colour at a place of the texture, whose repeats are 1 apart.
    pub fn at(&self, place: Vec2) -> Rgb {
        match self {
            Self::Uniform(colour) => *colour,
            Self::Texels(width, height, texels) => {
                let along = |x: f32, size: usize| {
                    let x = (x - x.floor()) * size as f32 - 0.5;
                    let first = (x.floor() as i64).rem_euclid(size as i64) as usize;
                    (first, (first + 1) % size, x - x.floor())
                };
                let ((x0, x1, fx), (y0, y1, fy)) = (along(place.x, *width), along(place.y, *height));
                let row = |y: usize| texels[y * width + x0] * (1.0 - fx) + texels[y * width + x1] * fx;
                row(y0) * (1.0 - fy) + row(y1) * fy
            }
        }
    }

    /// The same, each colour times a factor.
    #[must_use]
    pub fn scaled(&self, factor: f32) -> Self {
        match self {
            Self::Uniform(colour) => Self::Uniform(*colour * factor),
            Self::Texels(width, height, texels) => {
                Self::Texels(*width, *height, texels.iter().map(|texel| *texel * factor).collect())
            }
        }
    }

    /// All of its colours.
    pub fn colours(&self) -> &[Rgb] {
        match self {
            Self::Uniform(colour) => std::slice::from_ref(colour),
            Self::Texels(_, _, texels) => texels,
        }
    }

    fn check(&self, what: &str, most: f32) -> Result<()> {
        if self.colours().is_empty() {
            return Err(Error::input(format!("{what}: the texture has no texels")));
        }
        let holds = |c: &Rgb| c.is_finite() && c.min_element() >= 0.0 && c.max_element() <= most;
        match self.colours().iter().find(|colour| !holds(colour)) {
            Some(colour) if most.is_finite() => {
                Err(Error::input(format!("{what}: {colour} is not between 0 and {most}")))
            }
            Some(colour) => Err(Error::input(format!("{what}: {colour} is not finite or negative"))),
            None => Ok(()),
        }
    }
}

impl Optics {
    /// What it is, with an article.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Mirror(_) => "a mirror",
            Self::Conductor { .. } => "a conductor",
            Self::Dielectric(_) => "a dielectric",
            Self::AshikhminShirley(_) => "of the BRDF of Ashikhmin and Shirley",
        }
    }

    /// Refuses numbers that no renderer can work with.
    pub(super) fn check(&self) -> Result<()> {
        let positive = |v: Rgb| v.is_finite() && v.min_element() > 0.0;
        let reflectance = |v: Rgb| v.is_finite() && v.min_element() >= 0.0 && v.max_element() <= 1.0;
        match self {
            // Noise of measurements reaches a little over 1.
            Self::Mirror(texture) => texture.check("mirror", 1.2),
            Self::Conductor { n, k } if !positive(*n) || !k.is_finite() || k.min_element() < 0.0 => {
                Err(Error::input("conductor: n must be positive, k not negative"))
            }
            Self::Dielectric(Dielectric { index, absorption, .. })
                if !(0.1..=10.0).contains(index)
                    || !absorption.is_finite()
                    || absorption.min_element() < 0.0 =>
            {
                Err(Error::input("dielectric: index must be between 0.1 and 10, absorption not negative"))
            }
            Self::AshikhminShirley(AshikhminShirley { diffuse, specular, exponents, .. })
                if !(reflectance(*diffuse)
                    && reflectance(*specular)
                    && exponents.is_finite()
                    && exponents.min_element() >= 0.0) =>
            {
                Err(Error::input("ashikhmin: rho_d and rho_s must be between 0 and 1, n not negative"))
            }
            _ => Ok(()),
        }
    }
}

/// Refuses an emission that no renderer can work with.
pub(super) fn check_emission(emission: &Texture) -> Result<()> {
    emission.check("emission", f32::INFINITY)
}

impl Scene {
    /// The first object that only a path tracer draws, by its name and what it is; none when all are of lobes
    /// that do not shine.
    pub fn beyond_lobes(&self) -> Option<String> {
        self.objects.iter().find_map(|object| {
            let material = &object.material;
            let what = match (&material.optics, &material.emission) {
                (Some(optics), _) => optics.name(),
                (None, Some(_)) => "which shines",
                (None, None) => return None,
            };
            Some(format!("object \"{}\", {what}", object.name))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_texture_is_its_texels_at_their_centres_blends_between_them_and_repeats() {
        let texels = (0..6).map(|k| Rgb::splat(k as f32)).collect();
        let texture = Texture::Texels(3, 2, texels);
        for (k, (x, y)) in (0..6).map(|k| (k, (k % 3, k / 3))) {
            let centre = Vec2::new((x as f32 + 0.5) / 3.0, (y as f32 + 0.5) / 2.0);
            for repeat in [-1.0, 0.0, 2.0] {
                assert!((texture.at(centre + repeat).x - k as f32).abs() < 1e-4);
            }
        }
        // Half way between the last texel of the first row and its first.
        assert!((texture.at(Vec2::new(0.0, 0.25)).x - 1.0).abs() < 1e-5);
    }
}
