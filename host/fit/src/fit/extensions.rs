//! What texels may be fitted with beyond lobes of one exponent about the surface's normal (sections 6 and 7
//! of the spec).

use super::separable::uncertainty::Sigma;
use super::texel::TexelFit;
use super::{Device, FitOptions, Method};
use lobelia_base::error::{Error, Result};
use lobelia_reflectance::SbrdfMap;

/// When texels get a microfacet term.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Microfacets {
    /// Never.
    #[default]
    Never,
    /// Always.
    Always,
    /// Where the samples are predicted better with one.
    Choose,
}

/// What is fitted beside lobes. Where the number of lobes is a choice, so is each of these: a texel has it
/// where left-out poses are predicted better with it, beyond doubt.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Extensions {
    /// A normal of the texel's own, which its lobes share.
    pub normals: bool,
    /// An exponent toward grazing for every lobe (6.19).
    pub sharpening: bool,
    /// A GGX microfacet term.
    pub microfacets: Microfacets,
}

impl Extensions {
    /// Whether there is nothing beside plain lobes.
    pub fn is_none(self) -> bool {
        self == Self::default()
    }

    /// Unknowns of a texel beside those of its lobes, and those that a lobe has more.
    pub(super) fn unknowns(self) -> [usize; 2] {
        let of_coat = if self.microfacets == Microfacets::Never { 0 } else { 3 };
        [of_coat + if self.normals { 2 } else { 0 }, usize::from(self.sharpening)]
    }

    /// Refuses what goes with no plain fit.
    ///
    /// # Errors
    /// Another method than the separable one, the GPU, lobes of separate channels.
    pub(super) fn check(options: &FitOptions) -> Result<()> {
        if options.extensions.is_none() {
            return Ok(());
        }
        let refused = if options.method != Method::Separable {
            "need the separable method"
        } else if options.device == Device::Gpu {
            "are fitted on the CPU alone; use --device cpu"
        } else if options.separate_channels {
            "are shared by the channels; leave out --separate-channels"
        } else {
            return Ok(());
        };
        Err(Error::input(format!("normals, sharpening and microfacet terms of texels {refused}")))
    }

    /// Attributes of a map.
    pub(super) fn attributes(self) -> impl Iterator<Item = (&'static str, String)> {
        let model = match self.microfacets {
            Microfacets::Never => None,
            Microfacets::Always => Some("ggx"),
            Microfacets::Choose => Some("auto"),
        };
        let flag = |name, set: bool| set.then(|| (name, true.to_string()));
        let model = model.map(|model| ("fit.model", model.to_string()));
        [flag("fit.normals", self.normals), flag("fit.sharpening", self.sharpening), model]
            .into_iter()
            .flatten()
    }
}

/// The planes `sigma.*` of what the fits have beside lobes.
pub(super) fn add_sigmas(map: &mut SbrdfMap, fits: &[TexelFit]) {
    let mut plane = |name: String, value: &dyn Fn(&Sigma) -> f64| {
        let of = |fit: &TexelFit| fit.sigma.as_ref().map_or(0.0, |sigma| value(sigma) as f32);
        map.extra.insert(format!("sigma.{name}"), fits.iter().map(of).collect());
    };
    if !map.normal.is_empty() {
        for (axis, letter) in ["x", "y"].into_iter().enumerate() {
            plane(format!("normal.{letter}"), &|sigma| sigma.normal[axis]);
        }
    }
    let sharpens = map.lobes.iter().enumerate().filter(|(_, plane)| !plane.n_grazing.is_empty());
    for (lobe, _) in sharpens {
        plane(format!("lobe{lobe}.n_grazing"), &|sigma| {
            sigma.lobes.get(lobe).map_or(0.0, |lobe| lobe.n_grazing)
        });
    }
    if !map.microfacets.is_empty() {
        for (channel, letter) in ["R", "G", "B"].into_iter().enumerate() {
            plane(format!("ggx0.f0.{letter}"), &|sigma| sigma.coat.f0[channel]);
            plane(format!("ggx0.f90.{letter}"), &|sigma| sigma.coat.f90[channel]);
        }
        plane("ggx0.alpha".into(), &|sigma| sigma.coat.alpha);
    }
}
