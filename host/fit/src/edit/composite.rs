//! Composites two maps by a mask, and takes the mean BRDF of a mask (section 4.6).

use rayon::prelude::*;

use super::blend::{Blend, blend};
use super::picture::Mask;
use crate::fit::texel::Workspace;
use lobelia_base::error::{Error, Result};
use lobelia_base::progress;
use lobelia_reflectance::{LobeBrdf, SbrdfMap};

/// `base` where the mask is black, `over` where it is white, blended by reflectance in between; map, and the largest relative
/// error of a blend. The three have one size.
pub fn composite(base: &SbrdfMap, over: &SbrdfMap, mask: &Mask) -> (SbrdfMap, f64) {
    let lobes = base.lobes.len().max(over.lobes.len());
    let bar = progress::bar("blending", mask.share.len() as u64, "texels");
    let blends: Vec<Blend> = (mask.share.par_iter().enumerate())
        .map_init(Workspace::default, |workspace, (k, &share)| {
            let parts = [(1.0 - share, &base.texel(k)), (share, &over.texel(k))];
            let blend = blend(&parts, lobes, workspace);
            bar.advance(1);
            blend
        })
        .collect();
    let mut map = SbrdfMap::new(base.width, base.height, lobes);
    blends.iter().enumerate().for_each(|(k, blend)| map.set(k, &blend.brdf));
    map.attributes = base.attributes.clone();
    (map, blends.iter().map(|blend| blend.relative).fold(0.0, f64::max))
}

/// The mean BRDF of all texels, or of those of a mask by their share, as one of at most `lobes` lobes.
///
/// # Errors
/// An input error for a mask that is black all over.
pub fn mean(map: &SbrdfMap, mask: Option<&Mask>, lobes: usize) -> Result<Blend> {
    let share = |k: usize| mask.map_or(1.0, |mask| mask.share[k]);
    let texels: Vec<(f32, LobeBrdf)> =
        (0..map.width * map.height).filter(|&k| share(k) > 0.0).map(|k| (share(k), map.texel(k))).collect();
    if texels.is_empty() {
        return Err(Error::input("the mask is black all over: no texel to take the mean of"));
    }
    let parts: Vec<(f32, &LobeBrdf)> = texels.iter().map(|(share, brdf)| (*share, brdf)).collect();
    Ok(blend(&parts, lobes, &mut Workspace::default()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use lobelia_reflectance::{Brdf, Lobe, Rgb};

    fn texel(rho_d: f32, rho_s: f32, n: f32) -> LobeBrdf {
        let lobe = Lobe::new(Rgb::splat(rho_s), Vec3::new(-1.0, -1.0, 0.9), n);
        LobeBrdf { rho_d: Rgb::splat(rho_d), beta: 0.0, lobes: vec![lobe], ..LobeBrdf::default() }
    }

    fn uniform(brdf: &LobeBrdf) -> SbrdfMap {
        SbrdfMap::from_texels(3, 1, &vec![brdf.clone(); 3])
    }

    #[test]
    fn a_composite_is_one_map_or_the_other_or_their_blend() {
        let (base, over) = (texel(0.1, 0.2, 20.0), texel(0.3, 0.6, 20.0));
        let mask = Mask { width: 3, height: 1, share: vec![0.0, 1.0, 0.25] };
        let (map, error) = composite(&uniform(&base), &uniform(&over), &mask);
        assert_eq!((map.texel(0), map.texel(1), error), (base, over, 0.0));
        // Equal shapes: a quarter of the way in every albedo.
        let between = map.texel(2);
        assert!((between.rho_d.x - 0.15).abs() < 1e-6 && (between.lobes[0].rho_s.x - 0.3).abs() < 1e-6);
    }

    #[test]
    fn the_mean_of_a_mask_has_the_mean_reflectance() {
        let map = SbrdfMap::from_texels(
            3,
            1,
            &[texel(0.1, 0.2, 10.0), texel(0.9, 0.9, 9.0), texel(0.2, 0.8, 60.0)],
        );
        let mask = Mask { width: 3, height: 1, share: vec![0.75, 0.0, 0.25] };
        let found = mean(&map, Some(&mask), 2).unwrap();
        let (wi, wo) = (Vec3::new(0.5, 0.0, 0.8).normalize(), Vec3::new(-0.4, 0.1, 0.9).normalize());
        let expected = 0.75 * map.eval(0, wi, wo) + 0.25 * map.eval(2, wi, wo);
        assert!((found.brdf.eval(wi, wo) - expected).abs().max_element() < 1e-5, "{found:?}");
        // A mean exponent of the coefficients would be 22.5; the mean's one lobe is broader than that.
        let one = mean(&map, Some(&mask), 1).unwrap();
        assert!(one.relative > 0.0 && (one.brdf.lobes[0].n - 22.5).abs() > 2.0, "{one:?}");
        let nothing = Mask { share: vec![0.0; 3], ..mask };
        assert_eq!(mean(&map, Some(&nothing), 1).unwrap_err().exit_code(), 2);
    }
}
