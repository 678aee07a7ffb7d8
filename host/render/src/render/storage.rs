//! Coefficients in fewer bits (stability case G15): f16 and 8 bits against f32. What is written here
//! shaders/lights/texels.wgsl reads.
//!
//! A texel is a header (ρ_d and β as tan β/2), its lobes (ρ_s and n; C and the exponent toward grazing, n
//! again for most) and its microfacet terms (f0 and nothing; f90 and the roughness √α): groups of four
//! values. In a scene with lobes about normals of their own or that sharpen the header has a second group, x
//! and y of the normal and nothing.

use std::f32::consts::PI;

use exr::prelude::f16;

use crate::scene::{Material, Reflectance, Scene};
use lobelia_reflectance::{Lobe, LobeBrdf, Microfacet, Rgb, SbrdfMap};

/// Bounds of the logarithmic 8-bit exponent.
const LOG_EXPONENT: [f32; 2] = [0.5, 5000.0];

/// A way to store coefficients.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Storage {
    /// 32-bit floats.
    #[default]
    F32,
    /// 16-bit floats.
    F16,
    /// 16-bit floats, C scaled so that a lobe's largest base is exactly 1; ρ_s is then its peak. A lobe that
    /// sharpens toward grazing keeps its C: with two exponents no ρ_s makes up for the scale.
    F16Scaled,
    /// 8 bits a coefficient as the source did: C over −1..1, n over 0..255, albedos over 0..1 sr⁻¹, all
    /// clamped.
    Bits8,
    /// 8 bits: C scaled as above, or clamped to −1..1, ln n, and albedos over the map's own range.
    Bits8Scaled,
}

/// What a coefficient is.
#[derive(Clone, Copy)]
enum Kind {
    Albedo,
    C,
    Exponent,
    /// tan β/2, for β within ±90°.
    Beta,
    /// x or y of a normal.
    Normal,
    /// √α.
    Roughness,
}

impl Storage {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::F32, Self::F16, Self::F16Scaled, Self::Bits8, Self::Bits8Scaled];

    /// Name on the command line, and what it is.
    pub fn option(self) -> (&'static str, &'static str) {
        match self {
            Self::F32 => ("f32", "32-bit floats"),
            Self::F16 => ("f16", "16-bit floats"),
            Self::F16Scaled => (
                "f16-scaled",
                "16-bit floats, C scaled so that a lobe's largest base is exactly 1; ρ_s is then its peak. A \
                 lobe that sharpens toward grazing keeps its C: with two exponents no ρ_s makes up for the \
                 scale",
            ),
            Self::Bits8 => (
                "8bit",
                "8 bits a coefficient as the source did: C over −1..1, n over 0..255, albedos over 0..1 \
                 sr⁻¹, all clamped",
            ),
            Self::Bits8Scaled => (
                "8bit-scaled",
                "8 bits: C scaled as above, or clamped to −1..1, ln n, and albedos over the map's own range",
            ),
        }
    }

    /// Name in charts.
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F16 => "f16",
            Self::F16Scaled => "f16, C scaled",
            Self::Bits8 => "8 bits, as published",
            Self::Bits8Scaled => "8 bits, C scaled, log n",
        }
    }

    /// Bytes of a coefficient.
    fn width(self) -> usize {
        match self {
            Self::F32 => 4,
            Self::F16 | Self::F16Scaled => 2,
            Self::Bits8 | Self::Bits8Scaled => 1,
        }
    }

    /// Bytes of a texel with one lobe: ρ_d, ρ_s, C and n, with β.
    pub fn bytes(self) -> usize {
        11 * self.width()
    }

    /// 32-bit words of a group of four values.
    pub(crate) fn group(self) -> usize {
        self.width()
    }

    fn is_scaled(self) -> bool {
        matches!(self, Self::F16Scaled | Self::Bits8Scaled)
    }

    /// Range and number of steps of a coefficient in 8 bits; the exponent's logarithm where C is scaled. An
    /// even number of steps has 0 among them.
    fn steps(self, kind: Kind, brightest: f32) -> ([f32; 2], f32) {
        match (kind, self.is_scaled()) {
            (Kind::Albedo, false) => ([0.0, 1.0], 255.0),
            (Kind::Albedo, true) => ([0.0, brightest], 255.0),
            (Kind::Roughness, _) => ([0.0, 1.0], 255.0),
            (Kind::Exponent, false) => ([0.0, 255.0], 255.0),
            (Kind::Exponent, true) => (LOG_EXPONENT.map(f32::ln), 255.0),
            (Kind::C, false) => ([-1.0, 1.0], 255.0),
            (Kind::C, true) | (Kind::Beta | Kind::Normal, _) => ([-1.0, 1.0], 254.0),
        }
    }

    /// The bits of a coefficient; `brightest` is the largest albedo factor of the map.
    fn code(self, kind: Kind, value: f32, brightest: f32) -> u32 {
        match self.width() {
            4 => value.to_bits(),
            2 => f16::from_f32(value).to_bits().into(),
            _ => {
                let value =
                    if self.is_scaled() && matches!(kind, Kind::Exponent) { value.ln() } else { value };
                let ([low, high], steps) = self.steps(kind, brightest);
                let part = if high > low { (value - low) / (high - low) } else { 0.0 };
                (part.clamp(0.0, 1.0) * steps).round() as u32
            }
        }
    }

    /// The coefficient of some bits.
    fn value(self, kind: Kind, code: u32, brightest: f32) -> f32 {
        match self.width() {
            4 => f32::from_bits(code),
            2 => f16::from_bits(code as u16).to_f32(),
            _ => {
                let ([low, high], steps) = self.steps(kind, brightest);
                let value = low + code as f32 / steps * (high - low);
                if self.is_scaled() && matches!(kind, Kind::Exponent) { value.exp() } else { value }
            }
        }
    }

    /// The BRDF as it comes back; `brightest` is the largest albedo factor of the map.
    pub fn stored(self, brdf: &LobeBrdf, brightest: f32) -> LobeBrdf {
        if self == Self::F32 {
            return brdf.clone();
        }
        let through = |kind| move |value| self.value(kind, self.code(kind, value, brightest), brightest);
        let lobe = |lobe: &Lobe| {
            let Lobe { rho_s, c, n, n_grazing } = if self.is_scaled() { scaled(lobe) } else { *lobe };
            Lobe {
                rho_s: rho_s.map(through(Kind::Albedo)),
                c: c.map(through(Kind::C)),
                n: through(Kind::Exponent)(n),
                n_grazing: n_grazing.map(through(Kind::Exponent)),
            }
        };
        let coat = |coat: &Microfacet| Microfacet {
            f0: coat.f0.map(through(Kind::Albedo)),
            f90: coat.f90.map(through(Kind::Albedo)),
            alpha: through(Kind::Roughness)(coat.alpha.sqrt()).powi(2),
        };
        LobeBrdf {
            rho_d: brdf.rho_d.map(through(Kind::Albedo)),
            beta: 2.0 * through(Kind::Beta)(half_tangent(brdf.beta)).atan(),
            lobes: brdf.lobes.iter().map(lobe).collect(),
            microfacets: brdf.microfacets.iter().map(coat).collect(),
            normal: brdf.normal.map(through(Kind::Normal)),
        }
    }

    /// Appends the words of a texel that [`Self::stored`] gave; `extended` where the scene has lobes about
    /// normals of their own or that sharpen.
    pub(crate) fn append(self, stored: &LobeBrdf, brightest: f32, extended: bool, words: &mut Vec<u32>) {
        let mut group = |values: [(Kind, f32); 4]| {
            let codes = values.map(|(kind, value)| self.code(kind, value, brightest));
            let a_word = 4 / self.width();
            words.extend(codes.chunks(a_word).map(|codes| {
                let bits = 32 / a_word;
                codes.iter().rev().fold(0u32, |word, code| word.checked_shl(bits as u32).unwrap_or(0) | code)
            }));
        };
        let albedo = |rho: Rgb| rho.to_array().map(|rho| (Kind::Albedo, rho));
        let [r, g, b] = albedo(stored.rho_d);
        group([r, g, b, (Kind::Beta, half_tangent(stored.beta))]);
        if extended {
            let [x, y] = stored.normal.to_array();
            group([x, y, 0.0, 0.0].map(|part| (Kind::Normal, part)));
        }
        for lobe in stored.lobes.iter().filter(|lobe| lobe.rho_s != Rgb::ZERO) {
            let [r, g, b] = albedo(lobe.rho_s);
            group([r, g, b, (Kind::Exponent, lobe.n)]);
            let [x, y, z] = lobe.c.to_array().map(|c| (Kind::C, c));
            group([x, y, z, (Kind::Exponent, lobe.n_grazing.unwrap_or(lobe.n))]);
        }
        for coat in &stored.microfacets {
            let [r, g, b] = albedo(coat.f0);
            group([r, g, b, (Kind::Albedo, 0.0)]);
            let [r, g, b] = albedo(coat.f90);
            group([r, g, b, (Kind::Roughness, coat.alpha.sqrt())]);
        }
    }

    /// The scene with the coefficients that its materials have after storage.
    pub fn stored_scene(self, scene: &Scene) -> Scene {
        let mut scene = scene.clone();
        if self != Self::F32 {
            scene.objects.iter_mut().for_each(|object| self.store(&mut object.material));
        }
        scene
    }

    /// Puts what is left of a material's coefficients in their place.
    fn store(self, material: &mut Material) {
        let brightest = brightest_of(material);
        let through = |map: &SbrdfMap| {
            let texels: Vec<LobeBrdf> =
                (0..map.width * map.height).map(|k| self.stored(&map.texel(k), brightest)).collect();
            SbrdfMap::from_texels(map.width, map.height, &texels).into()
        };
        material.reflectance = match &material.reflectance {
            Reflectance::Uniform(brdf) => Reflectance::Uniform(self.stored(brdf, brightest)),
            Reflectance::Map(map) => Reflectance::Map(through(map)),
        };
        material.levels = material.levels.iter().map(|level| through(level)).collect();
    }
}

/// tan β/2 of the β within ±90° that means the same.
fn half_tangent(beta: f32) -> f32 {
    ((beta - PI * (beta / PI).round()) / 2.0).tan()
}

/// The same lobe with the largest base over all pairs of directions scaled to 1: ρ_s is then its peak. A lobe
/// whose base is nowhere positive stays as it is, and one that sharpens.
fn scaled(lobe: &Lobe) -> Lobe {
    let largest = lobe.c.x.abs().max(lobe.c.y.abs()).max(lobe.c.z);
    if largest <= 0.0 || lobe.n_grazing.is_some() {
        return *lobe;
    }
    let factor = f64::from(largest).powf(f64::from(lobe.n)) as f32;
    Lobe::new(lobe.rho_s * factor, lobe.c / largest, lobe.n)
}

/// The largest albedo factor of a BRDF after scaling C.
pub fn brightest(brdf: &LobeBrdf) -> f32 {
    let lobes = brdf.lobes.iter().map(|lobe| scaled(lobe).rho_s.max_element());
    let coats = brdf.microfacets.iter().map(|coat| coat.f0.max(coat.f90).max_element());
    lobes.chain(coats).fold(brdf.rho_d.max_element(), f32::max)
}

/// The largest albedo factor of a material, its levels included.
pub(crate) fn brightest_of(material: &Material) -> f32 {
    material.brdfs().map(|brdf| brightest(&brdf)).fold(0.0, f32::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Vec2, Vec3};

    fn lobe(cx: f32, cz: f32, n: f32) -> LobeBrdf {
        let lobe = Lobe::new(Rgb::splat(0.3), Vec3::new(cx, cx, cz), n);
        LobeBrdf { rho_d: Rgb::splat(0.1), beta: 0.0, lobes: vec![lobe], ..LobeBrdf::default() }
    }

    #[test]
    fn storage_rounds_to_its_steps_and_clamps() {
        let stored = Storage::Bits8.stored(&lobe(-1.3, 0.5, 300.0), 1.0).lobes[0];
        assert_eq!((stored.c.x, stored.n), (-1.0, 255.0));
        assert!((stored.c.z - 0.5).abs() <= 1.0 / 255.0 && stored.c.z != 0.5);
        let half = Storage::F16.stored(&lobe(-1.0, 0.9, 10.0), 1.0).lobes[0];
        assert!((half.c.z / 0.9 - 1.0).abs() <= 2f32.powi(-11) && half.c.z != 0.9 && half.n == 10.0);
        let exact = lobe(-1.0, 1.0, 64.0);
        assert_eq!(Storage::F32.stored(&exact, 1.0), exact);
        assert_eq!(
            Storage::F16Scaled.stored(&lobe(-2.0, 2.0, 8.0), 1.0).lobes[0].c,
            Vec3::new(-1.0, -1.0, 1.0)
        );
    }

    #[test]
    fn what_is_stored_does_not_change_when_it_is_stored_again() {
        let plain = lobe(-1.1, 0.7, 33.0).rotated(2.2);
        let mut extended = LobeBrdf { normal: Vec2::new(0.1, -0.23), ..plain.clone() };
        extended.lobes[0].n_grazing = Some(70.0);
        let most = brightest(&plain).max(brightest(&extended));
        for (storage, brdf) in
            Storage::ALL.into_iter().flat_map(|storage| [(storage, &plain), (storage, &extended)])
        {
            let once = storage.stored(brdf, most);
            let twice = storage.stored(&once, most);
            let error = (once.lobes[0].c - twice.lobes[0].c).abs().max_element()
                + (once.rho_d - twice.rho_d).abs().max_element()
                + (once.lobes[0].rho_s / twice.lobes[0].rho_s - Rgb::ONE).abs().max_element()
                + (once.lobes[0].n / twice.lobes[0].n - 1.0).abs()
                + (once.lobes[0].exponent(0.0) / twice.lobes[0].exponent(0.0) - 1.0).abs()
                + (once.normal - twice.normal).length();
            assert!(error < 1e-5, "{storage:?} {once:?} {twice:?}");
            // Half a step of 1/127, and of 1/255 of ln 5000 − ln 0.5.
            let tilt = (once.normal - brdf.normal).abs().max_element();
            let grazing = (once.lobes[0].exponent(0.0) / brdf.lobes[0].exponent(0.0) - 1.0).abs();
            assert!(tilt < 4e-3 && grazing < 0.019, "{storage:?} {once:?}");
        }
    }

    #[test]
    fn words_hold_the_bits_of_the_values_from_the_lowest_up() {
        let brdf = Storage::Bits8.stored(&lobe(-1.0, 1.0, 40.0), 1.0);
        let mut words = vec![];
        Storage::Bits8.append(&brdf, 1.0, false, &mut words);
        // ρ_d = 0.1 is step 25.5, ρ_s = 0.3 step 76.5, both rounded up or to the even side by f32.
        let bytes: Vec<[u8; 4]> = words.iter().map(|word| word.to_le_bytes()).collect();
        assert_eq!(bytes.len(), 3);
        assert_eq!((bytes[0][3], bytes[1][3]), (127, 40));
        assert_eq!(bytes[2], [0, 0, 255, 40]);
        for (storage, extended, count) in
            [(Storage::F32, false, 12), (Storage::F16, false, 6), (Storage::F16, true, 8)]
        {
            let mut words = vec![];
            storage.append(&brdf, 1.0, extended, &mut words);
            assert_eq!(words.len(), count);
        }
    }
}
