//! Editing of SBRDF maps (section 4.6 of the spec): palettes, means, composites, diffuse photographs, tiles.
//!
//! BRDFs are compared and blended by their reflectance ([`pairs`], [`blend`]), never by their coefficients,
//! which mean nothing one by one: lobes may stand in any order, and C and ρ_s share a scale.

pub mod blend;
pub mod cluster;
pub mod composite;
pub mod diffuse;
pub mod levels;
pub mod pairs;
pub mod palette;
pub mod photo;
pub mod picture;
pub mod tile;

use lobelia_base::error::{Error, Result};
use lobelia_reflectance::{LobePlane, MicrofacetPlane, SbrdfMap};

/// The plane of a map that says where its material is: 1 there, 0 where it is cut out.
pub const ALPHA: &str = "alpha";

/// A map whose texels are those of `map` with the given indices, further planes and attributes included.
///
/// # Panics
/// When there are not `width` × `height` indices or one is outside the map.
pub fn gather(map: &SbrdfMap, width: usize, height: usize, indices: &[usize]) -> SbrdfMap {
    assert_eq!(indices.len(), width * height, "one index a texel");
    fn pick<T: Copy>(plane: &[T], indices: &[usize]) -> Vec<T> {
        indices.iter().map(|&index| plane[index]).collect()
    }
    let lobe = |plane: &LobePlane| LobePlane {
        rho_s: pick(&plane.rho_s, indices),
        c: pick(&plane.c, indices),
        n: pick(&plane.n, indices),
        n_grazing: if plane.n_grazing.is_empty() { Vec::new() } else { pick(&plane.n_grazing, indices) },
    };
    let coat = |plane: &MicrofacetPlane| MicrofacetPlane {
        f0: pick(&plane.f0, indices),
        f90: pick(&plane.f90, indices),
        alpha: pick(&plane.alpha, indices),
    };
    SbrdfMap {
        width,
        height,
        rho_d: pick(&map.rho_d, indices),
        beta: pick(&map.beta, indices),
        normal: if map.normal.is_empty() { Vec::new() } else { pick(&map.normal, indices) },
        lobes: map.lobes.iter().map(lobe).collect(),
        microfacets: map.microfacets.iter().map(coat).collect(),
        extra: map.extra.iter().map(|(name, plane)| (name.clone(), pick(plane, indices))).collect(),
        attributes: map.attributes.clone(),
    }
}

/// Notes an edit in the map's attributes: `edit.1`, `edit.2`, … in the order in which they were made.
pub fn note(map: &mut SbrdfMap, what: impl Into<String>) {
    let mut place = 1;
    while map.attributes.contains_key(&format!("edit.{place}")) {
        place += 1;
    }
    map.attributes.insert(format!("edit.{place}"), what.into());
}

/// Refuses two pictures of different size; `names` say which they are.
///
/// # Errors
/// An input error with both names and sizes.
pub fn same_size(names: [&str; 2], first: (usize, usize), second: (usize, usize)) -> Result<()> {
    if first == second {
        return Ok(());
    }
    Err(Error::input(format!(
        "{} has {} × {} texels, {} has {} × {}: both must be of one size",
        names[0], first.0, first.1, names[1], second.0, second.1
    )))
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_reflectance::materials;

    #[test]
    fn gathered_texels_keep_their_coefficients_and_planes_and_edits_are_noted_in_order() {
        let texels = ["clay", "felt"].map(|name| materials::published(name).unwrap());
        let mut map = SbrdfMap::from_texels(2, 1, &texels);
        map.extra.insert("error.rms".into(), vec![0.1, 0.2]);
        let mut turned = gather(&map, 1, 2, &[1, 0]);
        assert_eq!((turned.texel(0), turned.texel(1)), (texels[1].clone(), texels[0].clone()));
        assert_eq!(turned.extra["error.rms"], [0.2, 0.1]);
        note(&mut turned, "first");
        note(&mut turned, "second");
        assert_eq!(turned.attributes["edit.2"], "second");
    }

    #[test]
    fn different_sizes_are_refused_with_both_names() {
        let text = same_size(["a.exr", "mask.png"], (4, 5), (4, 6)).unwrap_err().to_string();
        assert!(text.contains("a.exr has 4 × 5") && text.contains("mask.png has 4 × 6"), "{text}");
    }
}
