//! Makes a map from one photograph (section 4.6, the recipe for cherry wood): the photograph is the diffuse
//! channel, and over it lies one white lobe that grows toward grazing angles, sharp but for the darkest
//! pixels, the wood's grain.

use std::f32::consts::PI;

use glam::Vec3;

use super::picture::Photo;
use lobelia_base::error::{Error, Result};
use lobelia_base::random::Random;
use lobelia_reflectance::{Lobe, LobeBrdf, Rgb, SbrdfMap, colour};

/// The lobe over the photograph. The defaults are the source's for cherry wood.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Recipe {
    /// Mean exponent.
    pub n: f64,
    /// Standard deviation of the exponent from texel to texel.
    pub n_sigma: f64,
    /// Exponent in the dark grain.
    pub n_dark: f64,
    /// Share of the pixels that count as dark grain, by luminance, percent.
    pub dark_percent: f64,
    /// Cx = Cy and Cz.
    pub c: [f64; 2],
    /// ρ_s times π: 1 is as bright as white paper where the lobe's base is 1.
    pub specular: f64,
}

impl Default for Recipe {
    fn default() -> Self {
        Self { n: 110.0, n_sigma: 1.0, n_dark: 6.0, dark_percent: 10.0, c: [-1.01, 0.9], specular: 1.0 }
    }
}

impl Recipe {
    /// # Errors
    /// Input errors for exponents that are not positive, a percentage outside 0..100 and a negative albedo.
    pub fn check(&self) -> Result<()> {
        if !(self.n > 0.0 && self.n_dark > 0.0 && self.n_sigma >= 0.0) {
            return Err(Error::input("exponents must be above 0 and their deviation at least 0"));
        }
        if !(0.0..=100.0).contains(&self.dark_percent) {
            return Err(Error::input(format!(
                "{} % of dark pixels lies outside 0 to 100",
                self.dark_percent
            )));
        }
        if !(self.specular >= 0.0 && self.specular.is_finite() && self.c.iter().all(|c| c.is_finite())) {
            return Err(Error::input("the lobe's albedo must be at least 0 and its C finite"));
        }
        let base = self.c[0].abs().max(self.c[1].abs());
        let peak = self.specular * base.powf(self.n.max(self.n_dark) + 3.0 * self.n_sigma);
        if peak > MOST_PEAK {
            return Err(Error::input(format!(
                "the lobe would be {peak:.1e} times as bright as white paper; give Cx, Cz or the exponent \
                 less"
            )));
        }
        Ok(())
    }
}

/// The largest factor of the lobe's own albedo at its peak; the source's is about 3.
const MOST_PEAK: f64 = 1e4;

/// The share of pixels that may be brighter than a perfect diffuser, as highlights are.
const MOST_BRIGHT: f64 = 0.01;

/// The map of a photograph, whose linear colour is the diffuse albedo; it is cut out where the photograph is
/// transparent.
///
/// # Errors
/// As [`Recipe::check`], and for a photograph in other units than albedos.
pub fn from_photo(photo: &Photo, recipe: &Recipe, seed: u64) -> Result<SbrdfMap> {
    recipe.check()?;
    let bright = |pixel: &&Rgb| pixel.max_element() > 1.0;
    let count = photo.pixels.iter().filter(bright).count();
    if count as f64 > MOST_BRIGHT * photo.pixels.len() as f64 {
        let most = photo.pixels.iter().map(|pixel| pixel.max_element()).fold(0.0, f32::max);
        return Err(Error::input(format!(
            "{count} of {} pixels, up to {most:.3}, are brighter than 1, which stands for a perfect \
             diffuser: the map would reflect more light than it receives; scale the photograph",
            photo.pixels.len()
        )));
    }
    let mut random = Random::new(seed);
    let threshold = dark_threshold(photo, recipe.dark_percent);
    let [cx, cz] = recipe.c.map(|c| c as f32);
    let texels: Vec<LobeBrdf> = photo
        .pixels
        .iter()
        .map(|&pixel| {
            let drawn = (recipe.n + recipe.n_sigma * random.normal()).max(0.5);
            let n = if colour::luminance(pixel) < threshold { recipe.n_dark } else { drawn } as f32;
            let rho_s = Vec3::splat(recipe.specular as f32 / PI);
            LobeBrdf {
                rho_d: pixel / PI,
                beta: 0.0,
                lobes: vec![Lobe::new(rho_s, Vec3::new(cx, cx, cz), n)],
                ..LobeBrdf::default()
            }
        })
        .collect();
    let mut map = SbrdfMap::from_texels(photo.width, photo.height, &texels);
    if let Some(alpha) = &photo.alpha {
        map.extra.insert(super::ALPHA.into(), alpha.clone());
    }
    Ok(map)
}

/// The luminance below which the given percentage of the pixels lies.
fn dark_threshold(photo: &Photo, percent: f64) -> f32 {
    let mut luminance: Vec<f32> = photo.pixels.iter().map(|&pixel| colour::luminance(pixel)).collect();
    luminance.sort_by(f32::total_cmp);
    let dark = (luminance.len() as f64 * percent / 100.0).round() as usize;
    luminance.get(dark).copied().unwrap_or(f32::INFINITY)
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_reflectance::Brdf;

    fn wood() -> Photo {
        let pixels =
            (0..1000).map(|k| Rgb::new(0.6, 0.3, 0.1) * (0.2 + 0.8 * (k % 100) as f32 / 100.0)).collect();
        Photo { width: 40, height: 25, pixels, alpha: None }
    }

    #[test]
    fn exponents_follow_the_recipe_and_the_darkest_tenth_is_grain() {
        let map = from_photo(&wood(), &Recipe::default(), 1).unwrap();
        let (grain, clear): (Vec<f32>, Vec<f32>) = map.lobes[0].n.iter().partition(|&&n| n == 6.0);
        assert_eq!((grain.len(), clear.len()), (100, 900));
        let mean = clear.iter().sum::<f32>() / 900.0;
        let variance = clear.iter().map(|n| (n - mean).powi(2)).sum::<f32>() / 899.0;
        // Five standard errors of a mean and of a variance over 900 draws of N(110, 1).
        assert!((mean - 110.0).abs() < 5.0 / 30.0 && (variance - 1.0).abs() < 0.236, "{mean} {variance}");
        assert!((map.rho_d[99] * PI - wood().pixels[99]).abs().max_element() < 1e-6);
    }

    #[test]
    fn the_lobe_is_faint_from_above_and_strong_at_grazing_angles() {
        let map = from_photo(&wood(), &Recipe { n_sigma: 0.0, ..Recipe::default() }, 1).unwrap();
        let gloss = |theta: f32| {
            let (wi, wo) =
                (Vec3::new(theta.sin(), 0.0, theta.cos()), Vec3::new(-theta.sin(), 0.0, theta.cos()));
            let texel = map.texel(99);
            (texel.eval(wi, wo) - texel.rho_d).x * PI
        };
        let at = |theta: f32| (1.01 * theta.sin().powi(2) + 0.9 * theta.cos().powi(2)).powf(110.0);
        for theta in [0.0, 0.7, 1.4] {
            assert!((gloss(theta) / at(theta) - 1.0).abs() < 1e-3 || at(theta) < 1e-4, "{theta}");
        }
        assert!(gloss(0.0) < 1e-4 && gloss(1.5) > 2.0);
    }

    /// A renderer's or a camera's linear values are no albedos; single highlights are let pass.
    #[test]
    fn a_photograph_that_is_brighter_than_white_paper_is_refused() {
        let mut photo = wood();
        photo.pixels[7] = Rgb::new(0.5, 3.0, 0.5);
        assert!(from_photo(&photo, &Recipe::default(), 1).is_ok());
        photo.pixels.iter_mut().for_each(|pixel| *pixel *= 900.0);
        let error = from_photo(&photo, &Recipe::default(), 1).unwrap_err();
        assert!(
            error.exit_code() == 2 && error.to_string().contains("of 1000 pixels, up to 2700.000"),
            "{error}"
        );
    }

    #[test]
    fn recipes_that_make_no_sense_are_refused() {
        let standard = Recipe::default();
        for wrong in [
            Recipe { n: 0.0, ..standard },
            Recipe { dark_percent: 101.0, ..standard },
            Recipe { specular: f64::NAN, ..standard },
            Recipe { c: [5.0, 5.0], n: 100.0, ..standard },
        ] {
            assert_eq!(from_photo(&wood(), &wrong, 1).unwrap_err().exit_code(), 2);
        }
    }
}
