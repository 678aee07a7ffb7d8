//! Maps of the fitted coefficients and of the fit's residual.

use crate::demo::fits::{FitOutcome, Fits};
use crate::error::Result;
use crate::page::colour_map::ColourMap;
use crate::page::html::{self, Raster};
use crate::page::numbers;
use crate::page::scale::{Scale, quantile};
use crate::reflectance::{Lobe, Rgb, SbrdfMap, colour};

/// The section.
pub(super) fn section(fits: &Fits) -> Result<String> {
    let map = &fits.result.map;
    let mut content = format!(
        "<h3>Diffuse term and errors</h3>\n<div class=\"four\">{}</div>\n",
        of_texels(map, &fits.result.errors)?
    );
    for (rank, lobes) in ranked_lobes(map).iter().enumerate() {
        let name = lobe_name(rank, map.lobes.len());
        let figures = lobe_maps(map.width, lobes)?;
        let class = match figures.matches("<figure>").count() {
            4 => "four",
            5 => "five",
            _ => "three",
        };
        content += &format!("<h3>{name}</h3>\n<div class=\"{class}\">{figures}</div>\n");
    }
    content +=
        &format!("<h3>What the fit says of itself</h3>\n<div class=\"four\">{}</div>\n", own_doubts(map)?);
    if let Some(auto) = fits.others.iter().find(|fit| fit.options.choose) {
        content += &as_needed(auto)?;
    }
    let lead = "The coefficients of f = ρ<sub>d</sub> + Σ ρ<sub>s</sub> \
         (C<sub>x</sub>ω<sub>ix</sub>ω<sub>ox</sub> + C<sub>y</sub>ω<sub>iy</sub>ω<sub>oy</sub> + \
         C<sub>z</sub>ω<sub>iz</sub>ω<sub>oz</sub>)<sup>n</sup> at every texel, as <code>material.exr</code> \
         holds them, but each texel’s lobes sorted by exponent and scaled so that the largest |C| is 1. \
         C<sub>x</sub> below 0 reflects forward, above 0 back to the light. σ is the standard deviation that \
         the fit states.";
    Ok(html::section("maps", "Maps of the fitted coefficients", lead, &content))
}

/// Maps of what a texel has once.
fn of_texels(map: &SbrdfMap, errors: &[f32]) -> Result<String> {
    let mut figures = colours("ρ<sub>d</sub>, diffuse", "diffuse reflectance", map.width, &map.rho_d)?;
    figures +=
        &deviations("σ of ρ<sub>d</sub>, share of its brightest channel", map.width, &diffuse_sigma(map))?;
    if map.beta.iter().any(|&beta| beta != 0.0) {
        let degrees: Vec<f32> = map.beta.iter().map(|beta| beta.to_degrees()).collect();
        let scale = Scale::linear(-45.0, 45.0);
        figures +=
            &scalars("β, direction of anisotropy", "°", map.width, &degrees, scale, ColourMap::Signed)?;
    }
    for (name, values) in
        [("Residual, relative RMS", plane(map, "error.relative")), ("Error against the truth", errors)]
    {
        let scale = Scale::of(values, 0.01, 0.99, true);
        figures += &scalars(name, "", map.width, values, scale, ColourMap::Viridis)?;
    }
    let samples = plane(map, "samples");
    let [fewest, most] = [0.0, 1.0].map(|share| quantile(samples, share));
    if fewest < most {
        let scale = Scale::linear(0.0, most);
        figures += &scalars("Valid samples", "", map.width, samples, scale, ColourMap::Viridis)?;
    }
    Ok(figures)
}

/// A plane of the map; empty where it has none.
fn plane<'a>(map: &'a SbrdfMap, name: &str) -> &'a [f32] {
    map.extra.get(name).map(Vec::as_slice).unwrap_or_default()
}

/// The standard deviation of ρ_d as a share of it, in its brightest channel; NaN where none is stated.
fn diffuse_sigma(map: &SbrdfMap) -> Vec<f32> {
    let planes = ["R", "G", "B"].map(|channel| plane(map, &format!("sigma.rho_d.{channel}")));
    let share = |(texel, rho_d): (usize, &Rgb)| {
        let brightest = rho_d.max_position();
        stated(planes[brightest].get(texel)) / rho_d[brightest]
    };
    map.rho_d
        .iter()
        .enumerate()
        .map(share)
        .map(|share| if share.is_finite() { share } else { f32::NAN })
        .collect()
}

/// A stated standard deviation; 0 in a map means that there is none.
fn stated(sigma: Option<&f32>) -> f32 {
    sigma.copied().filter(|&sigma| sigma > 0.0).unwrap_or(f32::NAN)
}

/// Where poses did not tell, where albedos were held to 1, and at what price.
fn own_doubts(map: &SbrdfMap) -> Result<String> {
    let mut figures = counted("<code>tied</code>: coefficients that the poses do not tell", map, "tied")?;
    figures += &counted("<code>bounded</code>: changed so that they make no light", map, "bounded")?;
    let price = plane(map, "error.bound_price");
    if price.iter().any(|&price| price > 0.0) {
        let paid: Vec<f32> = price.iter().map(|&price| if price > 0.0 { price } else { f32::NAN }).collect();
        let name = "<code>error.bound_price</code>: rise of the residual for that";
        let scale = Scale::of(&paid, 0.0, 1.0, true).rounded();
        figures += &scalars(name, "", map.width, &paid, scale, ColourMap::Viridis)?;
    }
    Ok(figures)
}

/// Maps of the fit that chose the number of lobes.
fn as_needed(auto: &FitOutcome) -> Result<String> {
    let map = &auto.map;
    let lobes = plane(map, "lobes");
    let most = quantile(lobes, 1.0).max(1.0);
    let shares = (0..=most as usize).map(|count| {
        let texels = lobes.iter().filter(|&&lobes| lobes as usize == count).count();
        format!("{count}: {}", numbers::percent(texels as f64 / lobes.len().max(1) as f64))
    });
    let png = Raster::mapped(map.width, lobes, &Scale::linear(0.0, most), ColourMap::Viridis).png()?;
    let caption = format!(
        "<b><code>lobes</code>: number of lobes</b>, share of the texels with {}",
        shares.collect::<Vec<_>>().join(", ")
    );
    let bar = html::colour_bar(ColourMap::Viridis, &Scale::linear(0.0, most), "", most as usize);
    let mut figures =
        html::figure(&format!("{}{bar}", html::picture(&png, "number of lobes", "texels")), &caption);
    figures += &counted(
        "<code>lobes.doubtful</code>: another number would do almost as well",
        map,
        "lobes.doubtful",
    )?;
    figures += &counted("<code>tied</code>: coefficients that the poses do not tell", map, "tied")?;
    figures += &counted("<code>bounded</code>: changed so that they make no light", map, "bounded")?;
    Ok(format!(
        "<h3>As many lobes as needed, over {} × {} texels</h3>\n<div class=\"four\">{figures}</div>\n",
        map.width, map.height
    ))
}

/// A map of a count, and at how many texels it is not 0.
fn counted(name: &str, map: &SbrdfMap, channel: &str) -> Result<String> {
    let zeros = vec![0.0; map.rho_d.len()];
    let values = if map.extra.contains_key(channel) { plane(map, channel) } else { &zeros };
    let most = quantile(values, 1.0).max(1.0);
    let png = Raster::mapped(map.width, values, &Scale::linear(0.0, most), ColourMap::Viridis).png()?;
    let some = values.iter().filter(|&&value| value > 0.0).count();
    let highest = if most > 1.0 { format!(", at most {most}") } else { String::new() };
    let caption = format!(
        "<b>{name}</b>: {} of {} texels{highest}",
        numbers::count(some),
        numbers::count(values.len())
    );
    Ok(html::figure(&html::picture(&png, channel, "texels"), &caption))
}

/// A map of standard deviations as shares of their values, on a logarithmic scale that ends where nothing is
/// known; nothing where none is stated.
fn deviations(name: &str, width: usize, values: &[f32]) -> Result<String> {
    if !values.iter().any(|value| value.is_finite()) {
        return Ok(String::new());
    }
    let Scale { low, high, .. } = Scale::of(values, 0.01, 0.99, true);
    let scale = Scale::log(low.min(0.5), high.min(1.0));
    scalars(name, "", width, values, scale, ColourMap::Viridis)
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
    ranked(map, texel).into_iter().map(|ranked| ranked.lobe).collect()
}

/// A lobe and what the fit states of its exponent.
#[derive(Debug, Clone, Copy)]
struct Ranked {
    lobe: Lobe,
    /// The standard deviation of n as a share of n; NaN where none is stated.
    n_sigma: f32,
}

/// As [`sorted_lobes`], with the stated deviations.
fn ranked(map: &SbrdfMap, texel: usize) -> Vec<Ranked> {
    let planes = (0..map.lobes.len()).filter(|&plane| map.lobes[plane].rho_s[texel] != Rgb::ZERO);
    let lobes = map.texel(texel).lobes.into_iter().zip(planes).map(|(lobe, number)| {
        let sigma = plane(map, &format!("sigma.lobe{number}.n")).get(texel);
        Ranked { lobe: lobe.normalised(), n_sigma: stated(sigma) / lobe.n }
    });
    let mut lobes: Vec<Ranked> = lobes.collect();
    lobes.sort_by(|a, b| b.lobe.n.total_cmp(&a.lobe.n));
    lobes
}

/// For every rank of sharpness the lobe of each texel, where it has so many.
fn ranked_lobes(map: &SbrdfMap) -> Vec<Vec<Option<Ranked>>> {
    let texels: Vec<Vec<Ranked>> = (0..map.width * map.height).map(|texel| ranked(map, texel)).collect();
    (0..map.lobes.len()).map(|rank| texels.iter().map(|lobes| lobes.get(rank).copied()).collect()).collect()
}

/// The maps of one lobe.
fn lobe_maps(width: usize, lobes: &[Option<Ranked>]) -> Result<String> {
    let plane = |value: fn(&Lobe) -> f32| -> Vec<f32> {
        lobes.iter().map(|ranked| ranked.as_ref().map_or(f32::NAN, |ranked| value(&ranked.lobe))).collect()
    };
    let rho_s: Vec<Rgb> =
        lobes.iter().map(|ranked| ranked.map_or(Rgb::ZERO, |ranked| ranked.lobe.rho_s)).collect();
    let n = plane(|lobe| lobe.n);
    let n_sigma: Vec<f32> =
        lobes.iter().map(|ranked| ranked.map_or(f32::NAN, |ranked| ranked.n_sigma)).collect();
    let signed = Scale::linear(-1.0, 1.0);
    let mut figures = colours("ρ<sub>s</sub>", "specular reflectance", width, &rho_s)?;
    figures += &scalars("n, exponent", "", width, &n, Scale::of(&n, 0.01, 0.99, true), ColourMap::Viridis)?;
    figures += &deviations("σ of n, share of n", width, &n_sigma)?;
    let anisotropic = lobes.iter().flatten().any(|ranked| ranked.lobe.c.x != ranked.lobe.c.y);
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
    // Texels on an edge of the pattern can have a few needle-sharp lobes of any height: they do not set the
    // white.
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
    ["<sub>", "</sub>", "<code>", "</code>"].iter().fold(name.to_string(), |name, tag| name.replace(tag, ""))
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
        let mut map = SbrdfMap::from_texels(3, 1, &texels);
        map.extra.insert("sigma.lobe0.n".into(), vec![0.5, 0.9, 0.0]);
        map.extra.insert("sigma.lobe1.n".into(), vec![4.0, 0.6, 7.0]);
        let ranked = ranked_lobes(&map);
        let exponents = |rank: usize| {
            ranked[rank].iter().map(|ranked| ranked.map(|ranked| ranked.lobe.n)).collect::<Vec<_>>()
        };
        assert_eq!(exponents(0), [Some(40.0), Some(9.0), Some(2.0)]);
        assert_eq!(exponents(1), [Some(5.0), Some(3.0), None]);
        // Each stated deviation stays with its lobe, as a share of its n.
        let shares = |rank: usize| ranked[rank].iter().map(|ranked| ranked.map(|ranked| ranked.n_sigma));
        let sharper: Vec<_> = shares(0).collect();
        assert_eq!(sharper[..2], [Some(4.0 / 40.0), Some(0.9 / 9.0)]);
        assert!(sharper[2].is_some_and(f32::is_nan));
        assert_eq!(shares(1).collect::<Vec<_>>(), [Some(0.5 / 5.0), Some(0.6 / 3.0), None]);
    }
}
