//! What a map says of the options that it was fitted with, as far as the number of a texel's unknowns goes.

use super::extensions::{Extensions, Microfacets};
use super::{FitOptions, MOST_LOBES};
use lobelia_reflectance::SbrdfMap;

/// The lobes, how they were chosen and what a texel may have beside them; all else is as by default. None of
/// a map that no fit of texels made, or whose attributes say otherwise than they were written.
pub(crate) fn options(map: &SbrdfMap) -> Option<FitOptions> {
    let text = |name: &str| map.attributes.get(name).map(String::as_str);
    let lobes = text("fit.lobes")?;
    let (choose, count) = lobes.strip_prefix("auto:").map_or((false, lobes), |most| (true, most));
    let lobes = count.parse().ok().filter(|&lobes| lobes <= MOST_LOBES)?;
    let flag = |name: &str| text(name) == Some("true");
    let microfacets = match text("fit.model") {
        Some("ggx") => Microfacets::Always,
        Some("auto") => Microfacets::Choose,
        _ => Microfacets::Never,
    };
    let extensions =
        Extensions { normals: flag("fit.normals"), sharpening: flag("fit.sharpening"), microfacets };
    Some(FitOptions { lobes, choose, isotropic: flag("fit.isotropic"), extensions, ..FitOptions::default() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::fit_sbrdf;
    use crate::fit::texel::unknowns;
    use lobelia_reflectance::{LobeBrdf, Rgb};

    #[test]
    fn a_map_tells_how_many_unknowns_a_texel_of_its_fit_had() {
        let case = crate::synth::Options {
            width: 1,
            height: 1,
            texel_mm: 0.5,
            poses: 30,
            noise: 0.0,
            relative_noise: 0.0,
            seed: 1,
        };
        let paper = crate::synth::sample(&case, |_, _, _, _| Rgb::splat(0.2));
        let all = Extensions { normals: true, sharpening: true, microfacets: Microfacets::Choose };
        for (lobes, choose, isotropic, extensions) in [
            (1, false, false, Extensions::default()),
            (2, false, true, Extensions { microfacets: Microfacets::Always, ..Extensions::default() }),
            (3, true, false, Extensions { sharpening: true, ..Extensions::default() }),
            (2, true, true, all),
        ] {
            let asked = FitOptions { lobes, choose, isotropic, extensions, ..FitOptions::default() };
            let noted = options(&fit_sbrdf(&paper, &asked).unwrap()).unwrap();
            assert_eq!((noted.lobes, noted.choose), (lobes, choose));
            assert_eq!(unknowns(noted.lobes, &noted), unknowns(lobes, &asked), "{asked:?}");
        }
        assert!(options(&SbrdfMap::from_texels(1, 1, &[LobeBrdf::default()])).is_none());
    }
}
