//! An SBRDF map: the fitted coefficients of every texel, row by row from the +y edge, each coefficient a
//! plane.

use std::collections::BTreeMap;
use std::path::Path;

use glam::{Vec2, Vec3};

use crate::{FormatError, Lobe, LobeBrdf, MapEncoding, Microfacet, Rgb, map_exr};

/// The attribute of a map with the solid angle, sr, of the lamp that its mirror term (`mirror.*`, f cosθ_i)
/// was measured with: their product is ρ_m of L_r = ρ_m L_i.
pub const MIRROR_SOLID_ANGLE: &str = "mirror.solid_angle_sr";

/// The coefficients of one lobe at every texel.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LobePlane {
    /// ρ_s a texel, sr⁻¹.
    pub rho_s: Vec<Rgb>,
    /// Diagonal of C a texel.
    pub c: Vec<Vec3>,
    /// Exponent a texel.
    pub n: Vec<f32>,
    /// Exponent toward grazing a texel, that of `n` where the lobe does not sharpen; empty when it does
    /// nowhere.
    pub n_grazing: Vec<f32>,
}

impl LobePlane {
    fn at(&self, index: usize) -> Lobe {
        let n_grazing = self.n_grazing.get(index).copied().filter(|&grazing| grazing != self.n[index]);
        Lobe { rho_s: self.rho_s[index], c: self.c[index], n: self.n[index], n_grazing }
    }

    fn set(&mut self, index: usize, lobe: &Lobe) {
        (self.rho_s[index], self.c[index]) = (lobe.rho_s, lobe.c);
        if self.n_grazing.is_empty() && lobe.n_grazing.is_some() {
            self.n_grazing = self.n.clone();
        }
        if let Some(grazing) = self.n_grazing.get_mut(index) {
            *grazing = lobe.n_grazing.unwrap_or(lobe.n);
        }
        self.n[index] = lobe.n;
    }
}

/// The coefficients of one microfacet term at every texel.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MicrofacetPlane {
    /// Fresnel reflectance at θ_d = 0 a texel.
    pub f0: Vec<Rgb>,
    /// Fresnel reflectance at θ_d = 90° a texel.
    pub f90: Vec<Rgb>,
    /// Width α a texel.
    pub alpha: Vec<f32>,
}

impl MicrofacetPlane {
    fn at(&self, index: usize) -> Microfacet {
        Microfacet { f0: self.f0[index], f90: self.f90[index], alpha: self.alpha[index] }
    }
}

/// The fitted coefficients of every texel (2.11 in the form (4.1)).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SbrdfMap {
    /// Texels a row.
    pub width: usize,
    /// Rows; row 0 is the sample's +y edge.
    pub height: usize,
    /// Diffuse reflectance ρ_d a texel, sr⁻¹.
    pub rho_d: Vec<Rgb>,
    /// Direction of anisotropy β a texel, radians.
    pub beta: Vec<f32>,
    /// x and y of the lobes' unit normal a texel; empty when it is the surface's own everywhere.
    pub normal: Vec<Vec2>,
    /// The lobes; every texel has all of them, unused ones with ρ_s = 0.
    pub lobes: Vec<LobePlane>,
    /// The microfacet terms; unused ones with f0 = f90 = 0.
    pub microfacets: Vec<MicrofacetPlane>,
    /// Further planes by channel name, such as the fit's residual `error.rms`.
    pub extra: BTreeMap<String, Vec<f32>>,
    /// Text attributes: units and provenance.
    pub attributes: BTreeMap<String, String>,
}

impl SbrdfMap {
    /// A black map of the given size and number of lobes.
    pub fn new(width: usize, height: usize, lobes: usize) -> Self {
        let count = width * height;
        let plane = LobePlane {
            rho_s: vec![Rgb::ZERO; count],
            c: vec![Vec3::new(-1.0, -1.0, 1.0); count],
            n: vec![1.0; count],
            n_grazing: Vec::new(),
        };
        Self {
            width,
            height,
            rho_d: vec![Rgb::ZERO; count],
            beta: vec![0.0; count],
            lobes: vec![plane; lobes],
            ..Self::default()
        }
    }

    /// A map whose texels are the given BRDFs, row by row; shorter lists are filled up with black lobes and
    /// microfacet terms.
    ///
    /// # Panics
    /// When `texels` is not `width` × `height` long.
    pub fn from_texels(width: usize, height: usize, texels: &[LobeBrdf]) -> Self {
        assert_eq!(texels.len(), width * height, "one BRDF a texel");
        let lobes = texels.iter().map(|texel| texel.lobes.len()).max().unwrap_or(0);
        let mut map = Self::new(width, height, lobes);
        map.add_microfacets(texels.iter().map(|texel| texel.microfacets.len()).max().unwrap_or(0));
        for (index, texel) in texels.iter().enumerate() {
            map.set(index, texel);
        }
        map
    }

    /// Adds black microfacet terms until there are `count`.
    pub fn add_microfacets(&mut self, count: usize) {
        let (texels, has) = (self.width * self.height, self.microfacets.len());
        let black = vec![Rgb::ZERO; texels];
        let plane = MicrofacetPlane { f0: black.clone(), f90: black, alpha: vec![1.0; texels] };
        self.microfacets.resize(has.max(count), plane);
    }

    /// Sets the coefficients of texel `index` (row · width + column); what is beyond the map's number of
    /// lobes or microfacet terms is dropped.
    pub fn set(&mut self, index: usize, texel: &LobeBrdf) {
        self.rho_d[index] = texel.rho_d;
        self.beta[index] = texel.beta;
        for (plane, lobe) in self.lobes.iter_mut().zip(&texel.lobes) {
            plane.set(index, lobe);
        }
        if self.normal.is_empty() && texel.normal != Vec2::ZERO {
            self.normal = vec![Vec2::ZERO; self.rho_d.len()];
        }
        if let Some(normal) = self.normal.get_mut(index) {
            *normal = texel.normal;
        }
        for (plane, coat) in self.microfacets.iter_mut().zip(&texel.microfacets) {
            (plane.f0[index], plane.f90[index], plane.alpha[index]) = (coat.f0, coat.f90, coat.alpha);
        }
    }

    /// The BRDF of texel `index` (row · width + column), without what is black.
    pub fn texel(&self, index: usize) -> LobeBrdf {
        let lobes = self.lobes.iter().map(|plane| plane.at(index));
        let coats = self.microfacets.iter().map(|plane| plane.at(index));
        LobeBrdf {
            rho_d: self.rho_d[index],
            beta: self.beta[index],
            normal: self.normal_of(index),
            lobes: lobes.filter(|lobe| lobe.rho_s != Rgb::ZERO).collect(),
            microfacets: coats.filter(|coat| coat.f0 != Rgb::ZERO || coat.f90 != Rgb::ZERO).collect(),
        }
    }

    fn normal_of(&self, index: usize) -> Vec2 {
        self.normal.get(index).copied().unwrap_or(Vec2::ZERO)
    }

    /// What its lobes have beyond one exponent and the surface's normal, in words.
    pub fn extension(&self) -> Option<&'static str> {
        if !self.normal.is_empty() {
            return Some("lobes about a normal of their own");
        }
        let sharpens = self.lobes.iter().any(|plane| !plane.n_grazing.is_empty());
        sharpens.then_some("lobes that sharpen toward grazing")
    }

    /// Reflectance of texel `index` in sr⁻¹ without building a [`LobeBrdf`].
    pub fn eval(&self, index: usize, wi: Vec3, wo: Vec3) -> Rgb {
        if wi.z <= 0.0 || wo.z <= 0.0 {
            return Rgb::ZERO;
        }
        let (normal, beta, t) = (self.normal_of(index), self.beta[index], 0.5 * (wi.z + wo.z));
        let coats: Rgb = self.microfacets.iter().map(|plane| plane.at(index).eval(wi, wo)).sum();
        let [wi, wo] = [wi, wo].map(|direction| crate::lobe::into_lobe_frame(direction, normal, beta));
        let mut reflectance = self.rho_d[index] + coats;
        for plane in &self.lobes {
            let rho_s = plane.rho_s[index];
            if rho_s != Rgb::ZERO {
                reflectance += rho_s * plane.at(index).shape(wi, wo, t);
            }
        }
        reflectance
    }

    /// Writes the map as OpenEXR with one named f32 channel a coefficient (`rho_d.R`, `lobe0.C.x`, `lobe0.n`,
    /// `beta`, …), and R, G and B to be looked at.
    ///
    /// # Errors
    /// When the file cannot be written; nothing is left half-written under `path`.
    pub fn write_exr(&self, path: &Path) -> Result<(), FormatError> {
        self.write_exr_as(path, MapEncoding::default())
    }

    /// As [`Self::write_exr`], with the pixels laid out as told.
    ///
    /// # Errors
    /// As [`Self::write_exr`].
    pub fn write_exr_as(&self, path: &Path, encoding: MapEncoding) -> Result<(), FormatError> {
        map_exr::write(self, path, encoding)
    }

    /// Reads a map that [`Self::write_exr`] or another tool wrote with the same channel names. R, G and B are
    /// passed over.
    ///
    /// # Errors
    /// [`FormatError::Invalid`] that names the file, when it is missing or not OpenEXR, lacks a channel, or
    /// as [`Self::check`].
    pub fn read_exr(path: &Path) -> Result<Self, FormatError> {
        map_exr::read(path)
    }

    /// Refuses coefficients that no reflectance has: numbers that are not finite, a negative ρ_d, ρ_s, n, f0
    /// or f90, an α that is not above 0, a normal longer than 1.
    ///
    /// # Errors
    /// [`FormatError::Invalid`] with the channel and the texel.
    pub fn check(&self) -> Result<(), FormatError> {
        map_exr::check(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Brdf, materials};

    #[test]
    fn a_texel_comes_back_as_it_was_set_and_evaluates_alike() {
        let (felt, skin) = (materials::published("felt").unwrap(), materials::published("skin").unwrap());
        let coat = Microfacet { f0: Rgb::splat(0.04), f90: Rgb::ONE, alpha: 0.1 };
        let mut skin = LobeBrdf { microfacets: vec![coat], normal: Vec2::new(0.05, -0.1), ..skin };
        skin.lobes[1].n_grazing = Some(40.0);
        let map = SbrdfMap::from_texels(2, 1, &[felt.clone(), skin.clone()]);
        assert_eq!(map.texel(0), felt);
        assert_eq!(map.texel(1), skin);
        let (wi, wo) = (Vec3::new(0.3, 0.1, 0.8).normalize(), Vec3::new(-0.4, 0.0, 0.7).normalize());
        assert!((map.eval(1, wi, wo) - skin.eval(wi, wo)).abs().max_element() < 1e-6);
    }
}
