//! Replaces the diffuse channel by one sharp photograph of the same mean (section 4.6): a photograph straight
//! from above has detail that hundreds of resampled poses have lost.

use std::f32::consts::PI;

use glam::DVec3;

use super::gather;
use super::picture::Photo;
use lobelia_base::error::{Error, Result};
use lobelia_reflectance::{Rgb, SbrdfMap};

/// The map with ρ_d from the photograph, scaled channel by channel so that the mean ρ_d stays. A photograph
/// of k times the map's size in both directions gives a map of the photograph's size, each texel's lobes
/// repeated k × k times.
///
/// # Errors
/// Input errors: sizes that do not fit, or a channel without any light in the photograph that the map
/// reflects.
pub fn replace(map: &SbrdfMap, photo: &Photo) -> Result<SbrdfMap> {
    let times = photo.width / map.width.max(1);
    if times == 0 || (photo.width, photo.height) != (times * map.width, times * map.height) {
        return Err(Error::input(format!(
            "the photograph has {} × {} pixels, the map {} × {} texels: the photograph must be as large, or \
             a whole number of times as large in both directions",
            photo.width, photo.height, map.width, map.height
        )));
    }
    let scale = mean(&map.rho_d) / mean(&photo.pixels);
    for (channel, name) in ["red", "green", "blue"].iter().enumerate() {
        if !scale[channel].is_finite() {
            return Err(Error::input(format!(
                "the photograph has no {name} light; the map's diffuse channel needs it"
            )));
        }
    }
    let from = |k: usize| (k / photo.width / times) * map.width + k % photo.width / times;
    let indices: Vec<usize> = (0..photo.pixels.len()).map(from).collect();
    let mut replaced = gather(map, photo.width, photo.height, &indices);
    replaced.rho_d = photo.pixels.iter().map(|&pixel| pixel * scale.as_vec3()).collect();
    // The fit's figures were those of the diffuse channel that is gone; where the material is, stays.
    replaced.extra.retain(|name, _| name == super::ALPHA);
    Ok(replaced)
}

/// How many texels reflect more light than they receive by their diffuse channel alone, and the largest
/// diffuse albedo.
pub fn too_bright(map: &SbrdfMap) -> (usize, f32) {
    let albedos = map.rho_d.iter().map(|rho_d| PI * rho_d.max_element());
    (albedos.clone().filter(|albedo| *albedo > 1.0).count(), albedos.fold(0.0, f32::max))
}

/// Mean colour; where it is 0 the scale of a black map is 0 and not undefined.
fn mean(colours: &[Rgb]) -> DVec3 {
    colours.iter().map(|colour| colour.as_dvec3()).sum::<DVec3>() / colours.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_reflectance::{LobeBrdf, materials};

    fn map() -> SbrdfMap {
        let texels = ["clay", "felt"].map(|name| materials::published(name).unwrap());
        SbrdfMap::from_texels(2, 1, &texels)
    }

    fn photo(width: usize, height: usize) -> Photo {
        let pixels = (0..width * height).map(|k| Rgb::new(0.1, 0.2, 0.4) * (1 + k) as f32).collect();
        Photo { width, height, pixels, alpha: None }
    }

    #[test]
    fn the_mean_stays_and_the_detail_is_the_photographs() {
        let (map, photo) = (map(), photo(4, 2));
        let replaced = replace(&map, &photo).unwrap();
        assert_eq!((replaced.width, replaced.height), (4, 2));
        assert!((mean(&replaced.rho_d) - mean(&map.rho_d)).abs().max_element() < 1e-6);
        assert!((replaced.rho_d[7].x / replaced.rho_d[0].x - 8.0).abs() < 1e-4);
        for (k, source) in [0, 0, 1, 1, 0, 0, 1, 1].into_iter().enumerate() {
            assert_eq!(replaced.texel(k).lobes, map.texel(source).lobes);
        }
    }

    /// One pixel of a highlight among eight; the mean stays, and so the texel gets nearly eight times the
    /// mean albedo.
    #[test]
    fn texels_that_a_highlight_makes_brighter_than_their_light_are_counted() {
        let map = SbrdfMap::from_texels(
            2,
            1,
            &[LobeBrdf::diffuse(Rgb::splat(0.2)), LobeBrdf::diffuse(Rgb::splat(0.2))],
        );
        assert_eq!(too_bright(&replace(&map, &photo(4, 2)).unwrap()).0, 0);
        let pixels: Vec<Rgb> = (0..8).map(|k| Rgb::splat(if k == 3 { 700.0 } else { 1.0 })).collect();
        let glossy = Photo { width: 4, height: 2, pixels, alpha: None };
        let (count, most) = too_bright(&replace(&map, &glossy).unwrap());
        assert!(count == 1 && (most - 0.2 * 8.0 * 700.0 / 707.0).abs() < 1e-3, "{count} {most}");
    }

    #[test]
    fn sizes_that_do_not_fit_and_missing_light_are_refused() {
        for (width, height) in [(3, 1), (4, 3), (1, 1)] {
            let text = replace(&map(), &photo(width, height)).unwrap_err().to_string();
            assert!(
                text.contains(&format!("{width} × {height} pixels")) && text.contains("2 × 1 texels"),
                "{text}"
            );
        }
        let pixels = vec![Rgb::new(0.5, 0.0, 0.5); 2];
        let dark = Photo { width: 2, height: 1, pixels, alpha: None };
        assert!(replace(&map(), &dark).unwrap_err().to_string().contains("no green light"));
    }

    #[test]
    fn where_the_material_is_cut_out_stays_and_figures_of_the_fit_go() {
        let mut map = map();
        map.extra.insert("alpha".into(), vec![0.0, 1.0]);
        map.extra.insert("error.rms".into(), vec![0.1; 2]);
        let replaced = replace(&map, &photo(4, 2)).unwrap();
        assert_eq!(replaced.extra["alpha"], [0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0]);
        assert_eq!(replaced.extra.len(), 1);
    }

    #[test]
    fn a_black_diffuse_channel_stays_black() {
        let black = SbrdfMap::from_texels(1, 1, &[LobeBrdf::default()]);
        assert_eq!(replace(&black, &photo(1, 1)).unwrap().rho_d, [Rgb::ZERO]);
    }
}
