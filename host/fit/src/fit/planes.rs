//! The map of texels' fits, with its planes of errors and deviations, and what it says of how it was made.

use super::separable::mirror::Mirror;
use super::separable::uncertainty::Sigma;
use super::texel::{self, TexelFit};
use super::weights::Weights;
use super::{Device, Diffuse, FitOptions, Method, PERCENTILE, extensions};
use lobelia_reflectance::SbrdfMap;
use lobelia_reflectance::sampled::SampledSbrdf;

/// The planes `sigma.*`.
fn add_sigmas(map: &mut SbrdfMap, fits: &[TexelFit]) {
    let mut plane = |name: String, value: &dyn Fn(&Sigma) -> f64| {
        let of = |fit: &TexelFit| fit.sigma.as_ref().map_or(0.0, |sigma| value(sigma) as f32);
        map.extra.insert(format!("sigma.{name}"), fits.iter().map(of).collect());
    };
    for (channel, letter) in ["R", "G", "B"].into_iter().enumerate() {
        plane(format!("rho_d.{letter}"), &|sigma| sigma.rho_d[channel]);
    }
    plane("beta".into(), &|sigma| sigma.beta);
    let lobes = fits.iter().filter_map(|fit| fit.sigma.as_ref()).map(|sigma| sigma.lobes.len()).max();
    for lobe in 0..lobes.unwrap_or(0) {
        let of = |sigma: &Sigma| sigma.lobes.get(lobe).copied().unwrap_or_default();
        for (channel, letter) in ["R", "G", "B"].into_iter().enumerate() {
            plane(format!("lobe{lobe}.rho_s.{letter}"), &|sigma| of(sigma).rho_s[channel]);
        }
        for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
            plane(format!("lobe{lobe}.C.{letter}"), &|sigma| of(sigma).c[axis]);
        }
        plane(format!("lobe{lobe}.n"), &|sigma| of(sigma).n);
    }
}

/// The planes `mirror.*`.
fn add_mirrors(map: &mut SbrdfMap, fits: &[TexelFit]) {
    let mut plane = |name: &str, value: &dyn Fn(&Mirror) -> f32| {
        let of = |fit: &TexelFit| fit.mirror.as_ref().map_or(0.0, value);
        map.extra.insert(format!("mirror.{name}"), fits.iter().map(of).collect());
    };
    for (channel, letter) in ["R", "G", "B"].into_iter().enumerate() {
        plane(letter, &|mirror| mirror.value[channel] as f32);
    }
    plane("poses", &|mirror| mirror.poses.len() as f32);
}

/// The map of the fits, with planes of errors and provenance.
pub(super) fn map_of(sampled: &SampledSbrdf, options: &FitOptions, fits: &[TexelFit]) -> SbrdfMap {
    let planes = if options.choose {
        fits.iter().map(|fit| fit.brdf.lobes.len()).max().unwrap_or(0)
    } else {
        options.lobes * if options.separate_channels { 3 } else { 1 }
    };
    let mut map = SbrdfMap::new(sampled.width, sampled.height, planes);
    map.add_microfacets(fits.iter().map(|fit| fit.brdf.microfacets.len()).max().unwrap_or(0));
    for (index, fit) in fits.iter().enumerate() {
        map.set(index, &fit.brdf);
    }
    let mut plane = |name: &str, value: fn(&TexelFit) -> f32| {
        map.extra.insert(name.into(), fits.iter().map(value).collect());
    };
    plane("error.rms", |fit| fit.rms as f32);
    plane("error.relative", |fit| fit.relative as f32);
    plane("samples", |fit| fit.samples as f32);
    if options.choose {
        plane("lobes", |fit| fit.brdf.lobes.len() as f32);
        plane("lobes.doubtful", |fit| f32::from(u8::from(fit.doubtful)));
        plane("anisotropic", |fit| {
            f32::from(u8::from(fit.brdf.lobes.iter().any(|lobe| lobe.c.x != lobe.c.y)))
        });
    }
    if options.weights == Weights::Sigma {
        plane(texel::OVER_NOISE, |fit| fit.over_noise.unwrap_or(0.0) as f32);
    }
    if options.largest_albedo().is_some() {
        plane("bounded", |fit| f32::from(u8::from(fit.bound_price.is_some())));
        plane("error.bound_price", |fit| fit.bound_price.unwrap_or(0.0) as f32);
    }
    if fits.iter().any(|fit| fit.tied > 0) {
        map.extra.insert("tied".into(), fits.iter().map(|fit| fit.tied as f32).collect());
    }
    if fits.iter().any(|fit| fit.mirror.is_some()) {
        add_mirrors(&mut map, fits);
    }
    if options.method == Method::Separable {
        add_sigmas(&mut map, fits);
        extensions::add_sigmas(&mut map, fits);
    }
    let diffuse = match options.diffuse {
        Diffuse::Joint if options.method.line_search().is_none() => "joint".to_string(),
        Diffuse::Joint => format!("percentile {PERCENTILE}"),
        Diffuse::Percentile(percentile) => format!("percentile {percentile}"),
    };
    for (key, value) in [
        ("fit.method", options.method.name().to_string()),
        (
            "fit.lobes",
            if options.choose { format!("auto:{}", options.lobes) } else { options.lobes.to_string() },
        ),
        ("fit.residual", options.residual.name().to_string()),
        ("fit.diffuse", diffuse),
        ("fit.isotropic", options.isotropic.to_string()),
        ("fit.weights", options.weights.name().to_string()),
        ("fit.robust", options.robust.to_string()),
        ("fit.bound", options.bound.name().to_string()),
        ("texel_mm", sampled.texel_mm.to_string()),
    ] {
        map.attributes.insert(key.into(), value);
    }
    for (key, value) in options.extensions.attributes() {
        map.attributes.insert(key.into(), value);
    }
    if options.device == Device::Gpu {
        map.attributes.insert("fit.device".into(), "gpu".into());
    }
    map
}
