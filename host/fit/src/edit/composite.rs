//! Composites two maps by a mask, and takes the mean BRDF of a mask (section 4.6).

use rayon::prelude::*;

use super::ALPHA;
use super::blend::{Blend, blend};
use super::picture::Mask;
use crate::fit::texel::Workspace;
use lobelia_base::error::{Error, Result};
use lobelia_base::progress;
use lobelia_reflectance::{LobeBrdf, SbrdfMap};

/// `base` where the mask is black, `over` where it is white, blended by reflectance in between; map, and the
/// largest relative error of a blend, NaN where one could not be computed. The three have one size.
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
    if let Some(alpha) = alpha(base, over, mask) {
        map.extra.insert(ALPHA.into(), alpha);
    }
    let worst = |worst: f64, blend: &Blend| if blend.relative <= worst { worst } else { blend.relative };
    (map, blends.iter().fold(0.0, |most: f64, blend| if most.is_nan() { most } else { worst(most, blend) }))
}

/// Where the composite's material is, of maps of which one at least says it: a map that does not is
/// everywhere.
fn alpha(base: &SbrdfMap, over: &SbrdfMap, mask: &Mask) -> Option<Vec<f32>> {
    let planes = [base, over].map(|map| map.extra.get(ALPHA));
    if planes.iter().all(Option::is_none) {
        return None;
    }
    let [base, over] = planes.map(|plane| move |k: usize| plane.map_or(1.0, |plane| plane[k]));
    let blended = |(k, &share): (usize, &f32)| (1.0 - share) * base(k) + share * over(k);
    Some(mask.share.iter().enumerate().map(blended).collect())
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
    fn an_error_that_is_no_number_is_not_lost_among_those_that_are() {
        let mask = Mask { width: 3, height: 1, share: vec![0.5, 0.0, 0.25] };
        let mut base = uniform(&texel(0.1, 0.2, 20.0));
        base.rho_d[0] = Rgb::splat(1e30);
        assert!(composite(&base, &uniform(&texel(0.1, 0.2, 35.0)), &mask).1.is_nan());
    }

    #[test]
    fn what_is_cut_out_of_either_map_is_cut_out_where_it_shows() {
        let mask = Mask { width: 3, height: 1, share: vec![0.0, 1.0, 0.25] };
        let plain = uniform(&texel(0.1, 0.2, 20.0));
        let mut cut = plain.clone();
        cut.extra.insert(ALPHA.into(), vec![0.0, 0.5, 0.2]);
        let alpha = |base: &SbrdfMap, over: &SbrdfMap| composite(base, over, &mask).0.extra.remove(ALPHA);
        assert_eq!(alpha(&plain, &plain), None);
        assert_eq!(alpha(&cut, &plain), Some(vec![0.0, 1.0, 0.75 * 0.2 + 0.25]));
        assert_eq!(alpha(&plain, &cut), Some(vec![1.0, 0.5, 0.75 + 0.25 * 0.2]));
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
