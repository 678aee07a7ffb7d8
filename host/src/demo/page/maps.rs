//! Maps of the fitted coefficients and of the fit's residual.

use crate::demo::FitOutcome;
use crate::error::Result;
use crate::page::colour_map::ColourMap;
use crate::page::html::{self, Raster};
use crate::page::numbers;
use crate::page::scale::{Scale, quantile};
use crate::reflectance::{Lobe, Rgb, SbrdfMap, colour};

/// The section.
pub(super) fn section(fit: &FitOutcome) -> Result<String> {
    let map = &fit.map;
    let mut figures = colours("ρ<sub>d</sub>, diffuse", "diffuse reflectance", map.width, &map.rho_d)?;
    if map.beta.iter().any(|&beta| beta != 0.0) {
        let degrees: Vec<f32> = map.beta.iter().map(|beta| beta.to_degrees()).collect();
        let scale = Scale::linear(-45.0, 45.0);
        figures +=
            &scalars("β, direction of anisotropy", "°", map.width, &degrees, scale, ColourMap::Signed)?;
    }
    let relative = map.extra.get("error.relative").map(Vec::as_slice).unwrap_or_default();
    for (name, values) in [("Residual, relative RMS", relative), ("Error against the truth", &fit.errors)] {
        let scale = Scale::of(values, 0.01, 0.99, true);
        figures += &scalars(name, "", map.width, values, scale, ColourMap::Viridis)?;
    }
    let samples = map.extra.get("samples").map(Vec::as_slice).unwrap_or_default();
    let [fewest, most] = [0.0, 1.0].map(|share| quantile(samples, share));
    if fewest < most {
        let scale = Scale::linear(0.0, most);
        figures += &scalars("Valid samples", "", map.width, samples, scale, ColourMap::Viridis)?;
    }
    let mut content = format!("<h3>Diffuse term and errors</h3>\n<div class=\"four\">{figures}</div>\n");
    for (rank, lobes) in ranked_lobes(map).iter().enumerate() {
        let name = lobe_name(rank, map.lobes.len());
        content += &format!("<h3>{name}</h3>\n<div class=\"four\">{}</div>\n", lobe_maps(map.width, lobes)?);
    }
    let lead = "The coefficients of f = ρ<sub>d</sub> + Σ ρ<sub>s</sub> (C<sub>x</sub>ω<sub>ix</sub>ω<sub>ox</sub> + C<sub>y</sub>ω<sub>iy</sub>ω<sub>oy</sub> + C<sub>z</sub>ω<sub>iz</sub>ω<sub>oz</sub>)<sup>n</sup> at every texel, as <code>material.exr</code> holds them, but each texel’s lobes sorted by exponent and scaled so that the largest |C| is 1. C<sub>x</sub> below 0 reflects forward, above 0 back to the light.";
    Ok(html::section("maps", "Maps of the fitted coefficients", lead, &content))
}

/// What the lobe of a rank is called.
pub(super) fn lobe_name(rank: usize, lobes: usize) -> String {
    match (rank, lobes) {
        (_, 1) => "The lobe".into(),
        (0, 2) => "Sharper lobe".into(),
        (1, 2) => "Broader lobe".into(),
        _ => format!("Lobe {}, by sharpness", rank + 1),
    }
}

/// A texel's lobes, sharpest first, each scaled so that its largest |C| is 1.
pub(super) fn sorted_lobes(map: &SbrdfMap, texel: usize) -> Vec<Lobe> {
    let mut lobes: Vec<Lobe> = map.texel(texel).lobes.iter().map(Lobe::normalised).collect();
    lobes.sort_by(|a, b| b.n.total_cmp(&a.n));
    lobes
}

/// For every rank of sharpness the lobe of each texel, where it has so many.
fn ranked_lobes(map: &SbrdfMap) -> Vec<Vec<Option<Lobe>>> {
    let texels: Vec<Vec<Lobe>> = (0..map.width * map.height).map(|texel| sorted_lobes(map, texel)).collect();
    (0..map.lobes.len()).map(|rank| texels.iter().map(|lobes| lobes.get(rank).copied()).collect()).collect()
}

/// The maps of one lobe.
fn lobe_maps(width: usize, lobes: &[Option<Lobe>]) -> Result<String> {
    let plane = |value: fn(&Lobe) -> f32| -> Vec<f32> {
        lobes.iter().map(|lobe| lobe.as_ref().map_or(f32::NAN, value)).collect()
    };
    let rho_s: Vec<Rgb> = lobes.iter().map(|lobe| lobe.map_or(Rgb::ZERO, |lobe| lobe.rho_s)).collect();
    let n = plane(|lobe| lobe.n);
    let signed = Scale::linear(-1.0, 1.0);
    let mut figures = colours("ρ<sub>s</sub>", "specular reflectance", width, &rho_s)?;
    figures += &scalars("n, exponent", "", width, &n, Scale::of(&n, 0.01, 0.99, true), ColourMap::Viridis)?;
    let anisotropic = lobes.iter().flatten().any(|lobe| lobe.c.x != lobe.c.y);
    let across = anisotropic.then(|| ("C<sub>y</sub>", plane(|lobe| lobe.c.y)));
    let along = [("C<sub>x</sub>", plane(|lobe| lobe.c.x)), ("C<sub>z</sub>", plane(|lobe| lobe.c.z))];
    for (name, values) in along.into_iter().chain(across) {
        figures += &scalars(name, "", width, &values, signed, ColourMap::Signed)?;
    }
    Ok(figures)
}

/// A map of colours.
fn colours(name: &str, alt: &str, width: usize, values: &[Rgb]) -> Result<String> {
    let brightest: Vec<f32> = values.iter().map(|rgb| rgb.max_element()).collect();
    // Texels on an edge of the pattern can have a few needle-sharp lobes of any height: they do not set the white.
    let white = quantile(&brightest, 0.98).min(3.0 * quantile(&brightest, 0.6)).max(1e-6);
    let raster =
        Raster::opaque(width, values.len() / width.max(1), |k| colour::to_srgb8(values[k] / white as f32));
    let caption = format!(
        "<b>{name}</b>, white is {} sr⁻¹; median of the brightest channel {}",
        numbers::significant(white, 2),
        numbers::significant(quantile(&brightest, 0.5), 2)
    );
    Ok(html::figure(&html::picture(&raster.png()?, alt, "texels"), &caption))
}

/// A map of numbers with its colour bar.
fn scalars(
    name: &str,
    unit: &str,
    width: usize,
    values: &[f32],
    scale: Scale,
    map: ColourMap,
) -> Result<String> {
    let png = Raster::mapped(width, values, &scale, map).png()?;
    let [low, middle, high] = [0.01, 0.5, 0.99].map(|share| numbers::significant(quantile(values, share), 2));
    let caption =
        format!("<b>{name}</b>: 98 % of the texels from {low}{unit} to {high}{unit}, median {middle}{unit}");
    let picture = html::picture(&png, &strip_tags(name), "texels");
    Ok(html::figure(&format!("{picture}{}", html::colour_bar(map, &scale, unit, 5)), &caption))
}

/// A name without its HTML, for alternative texts.
fn strip_tags(name: &str) -> String {
    name.replace("<sub>", "").replace("</sub>", "")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reflectance::LobeBrdf;
    use glam::Vec3;

    #[test]
    fn lobes_are_sorted_by_sharpness_in_every_texel() {
        let lobe = |n: f32| Lobe::new(Rgb::ONE, Vec3::new(-1.0, -1.0, 1.0), n);
        let texel = |lobes: Vec<Lobe>| LobeBrdf { lobes, ..LobeBrdf::default() };
        let texels =
            [texel(vec![lobe(5.0), lobe(40.0)]), texel(vec![lobe(9.0), lobe(3.0)]), texel(vec![lobe(2.0)])];
        let ranked = ranked_lobes(&SbrdfMap::from_texels(3, 1, &texels));
        let exponents =
            |rank: usize| ranked[rank].iter().map(|lobe| lobe.map(|lobe| lobe.n)).collect::<Vec<_>>();
        assert_eq!(exponents(0), [Some(40.0), Some(9.0), Some(2.0)]);
        assert_eq!(exponents(1), [Some(5.0), Some(3.0), None]);
    }
}
