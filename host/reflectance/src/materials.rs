//! The six materials that Lafortune et al. published in 1997 as cosine lobes (as printed in pbrt), and plain
//! ones.
//!
//! The publication gives every channel its own C and n, so a lobe here often carries the albedo of one
//! channel only.

#![allow(clippy::excessive_precision, reason = "the numbers are as printed")]

use glam::Vec3;

use crate::{Lobe, LobeBrdf, Rgb};

/// Names of the published materials, as [`published`] takes them.
pub const NAMES: [&str; 6] = ["clay", "blue-paint", "felt", "primer", "brushed-metal", "skin"];

/// One published lobe: Cx = Cy, Cz and n, an RGB triple each.
type PublishedLobe = ([f32; 3], [f32; 3], [f32; 3]);

/// A published material: diffuse albedo and three lobes.
struct Published {
    albedo: [f32; 3],
    lobes: [PublishedLobe; 3],
}

const CLAY: Published = Published {
    albedo: [0.383626, 0.260749, 0.274207],
    lobes: [
        (
            [-1.089701, -1.102701, -1.107603],
            [-1.354682, -2.714801, -1.569866],
            [17.968505, 11.024489, 21.270282],
        ),
        ([-0.733381, -0.793320, -0.848206], [0.676108, 0.679314, 0.726031], [8.219745, 9.055139, 11.261951]),
        (
            [-1.010548, -1.012378, -1.011263],
            [0.910783, 0.885239, 0.892451],
            [152.912795, 141.937171, 201.046802],
        ),
    ],
};
const BLUE_PAINT: Published = Published {
    albedo: [0.3094, 0.39667, 0.70837],
    lobes: [
        ([0.870567, 0.857255, 0.670982], [0.803624, 0.774290, 0.586674], [21.820103, 18.597755, 7.472717]),
        ([-0.451218, -0.406681, -0.477976], [0.023123, 0.017625, 0.227295], [2.774499, 2.581499, 3.677653]),
        (
            [-1.031545, -1.029426, -1.026588],
            [0.706734, 0.696530, 0.687715],
            [66.899060, 63.767912, 57.489181],
        ),
    ],
};
const FELT: Published = Published {
    albedo: [0.025865; 3],
    lobes: [
        ([-0.304075; 3], [-0.065992; 3], [3.047892; 3]),
        ([-0.749561; 3], [-1.167929; 3], [6.931827; 3]),
        ([1.004921; 3], [-0.205529; 3], [94.117332; 3]),
    ],
};
const PRIMER: Published = Published {
    albedo: [0.118230, 0.121218, 0.133209],
    lobes: [
        ([-0.399286, -1.033473, -1.058104], [0.167504, 0.009545, -0.068002], [2.466633, 7.637253, 8.117645]),
        (
            [-1.041861, -1.100108, -1.087779],
            [0.014375, -0.198147, -0.053605],
            [7.993722, 29.446268, 41.988990],
        ),
        ([-1.098605, -0.379883, -0.449038], [-0.145110, 0.159127, 0.173224], [31.899719, 2.372852, 2.636161]),
    ],
};
const BRUSHED_METAL: Published = Published {
    albedo: [0.0; 3],
    lobes: [
        ([-1.11854, -1.11845, -1.11999], [1.01272, 1.01469, 1.01942], [15.8708, 15.6489, 15.4571]),
        ([-1.05334, -1.06409, -1.08378], [0.69541, 0.662178, 0.626672], [111.267, 88.9222, 65.2179]),
        ([-1.01684, -1.01635, -1.01529], [1.00132, 1.00112, 1.00108], [180.181, 184.152, 195.773]),
    ],
};
const SKIN: Published = Published {
    albedo: [0.428425, 0.301341, 0.331054],
    lobes: [
        (
            [-1.131747, -1.016939, -0.966018],
            [-1.209182, -1.462488, -1.222419],
            [6.421658, 3.699932, 3.524889],
        ),
        ([-0.546570, -0.643533, -0.638934], [0.380123, 0.410559, 0.437367], [3.685044, 4.266495, 4.539742]),
        (
            [-0.998888, -1.020153, -1.027479],
            [0.857998, 0.703913, 0.573625],
            [64.208486, 63.919687, 43.809866],
        ),
    ],
};

/// A published material by name (see [`NAMES`]): f = d/π + Σ (Cxy (ω_ix ω_ox + ω_iy ω_oy) + Cz ω_iz ω_oz)ⁿ,
/// sr⁻¹.
pub fn published(name: &str) -> Option<LobeBrdf> {
    let material = match name {
        "clay" => &CLAY,
        "blue-paint" => &BLUE_PAINT,
        "felt" => &FELT,
        "primer" => &PRIMER,
        "brushed-metal" => &BRUSHED_METAL,
        "skin" => &SKIN,
        _ => return None,
    };
    let mut brdf = LobeBrdf::diffuse(Rgb::from_array(material.albedo));
    for lobe in &material.lobes {
        brdf.lobes.extend(shared_or_single_channel(lobe));
    }
    Some(brdf)
}

/// One white lobe when the channels agree, else one lobe a channel.
fn shared_or_single_channel((cxy, cz, n): &PublishedLobe) -> Vec<Lobe> {
    let lobe = |k: usize, rho_s| Lobe::new(rho_s, Vec3::new(cxy[k], cxy[k], cz[k]), n[k]);
    let same = |x: &[f32; 3]| x[0] == x[1] && x[1] == x[2];
    if same(cxy) && same(cz) && same(n) {
        return vec![lobe(0, Rgb::ONE)];
    }
    (0..3)
        .map(|k| lobe(k, Rgb::from_array(std::array::from_fn(|i| if i == k { 1.0 } else { 0.0 }))))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Brdf;

    #[test]
    fn every_published_name_is_known_and_no_other() {
        assert!(NAMES.iter().all(|name| published(name).is_some()));
        assert!(published("velvet").is_none());
    }

    #[test]
    fn clay_at_normal_incidence_follows_the_printed_formula() {
        let up = Vec3::Z;
        let f = published("clay").unwrap().eval(up, up);
        let red = 0.383626 / std::f32::consts::PI + 0.676108f32.powf(8.219745) + 0.910783f32.powf(152.912795);
        assert!((f.x - red).abs() < 1e-6, "{} {red}", f.x);
    }

    #[test]
    fn felt_shares_its_lobes_between_the_channels() {
        assert_eq!(published("felt").unwrap().lobes.len(), 3);
        assert_eq!(published("skin").unwrap().lobes.len(), 9);
    }
}
