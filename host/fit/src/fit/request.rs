//! What is asked of a fit. What a request leaves open is decided by what is fitted: the method by the
//! residual, weights and residual by whether the samples have standard deviations, the number of lobes by the
//! method, the device by the time that it takes.

use super::extensions::{Extensions, Microfacets};
use super::table::{self, Size, TableOptions, Take};
use super::weights::Weights;
use super::{AlbedoBound, Device, Diffuse, FitOptions, MOST_LOBES, Method, Residual, chunks, gpu};
use lobelia_base::error::{Error, Result};
use lobelia_reflectance::sampled::SampledStore;
use lobelia_reflectance::{MeasuredTable, SbrdfMap};

/// Lobes where the method cannot choose: what most materials need and no start fails on.
const DEFAULT_LOBES: usize = 2;
/// Most lobes beside a microfacet term that are tried on a table.
const MOST_BESIDE: usize = 3;

/// A number of lobes, or the choice among several.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lobes {
    /// What the samples support up to this many; where the method cannot choose, two, or one with the line
    /// search, if that is no more.
    Auto(usize),
    /// This many.
    Count(usize),
}

impl Default for Lobes {
    fn default() -> Self {
        Self::Auto(MOST_LOBES)
    }
}

impl std::str::FromStr for Lobes {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        if text == "auto" {
            return Ok(Self::default());
        }
        let (number, lobes): (_, fn(usize) -> Self) = match text.strip_prefix("auto:") {
            Some(most) => (most, Self::Auto),
            None => (text, Self::Count),
        };
        match number.parse() {
            Ok(count) if count <= MOST_LOBES => Ok(lobes(count)),
            _ => Err(format!("must be `auto`, `auto:N` or N, with N from 0 to {MOST_LOBES}")),
        }
    }
}

/// What is fitted beside the diffuse term.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Terms {
    /// Lobes alone, or with a microfacet term where that predicts better what is left out.
    Choose,
    /// Lobes alone.
    Lobes,
    /// Lobes and one GGX microfacet term.
    Ggx,
}

/// What is asked of a fit; `None` and [`Lobes::Auto`] leave it open. The default leaves all open that can be.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Request {
    /// Lobes.
    pub lobes: Lobes,
    /// Terms. Where open: lobes for texels; the choice for a table, lobes where their number is fixed.
    pub terms: Option<Terms>,
    /// Method. Where open: separable for texels if the residual is linear in f, else Levenberg–Marquardt, as
    /// for tables.
    pub method: Option<Method>,
    /// Scale of comparison. Where open: proportional for texels, linear where they weigh by their standard
    /// deviations; balanced for tables.
    pub residual: Option<Residual>,
    /// Weights of samples. Where these and the residual are open and the method is separable: sigma if the
    /// store has standard deviations.
    pub weights: Option<Weights>,
    /// Device. Where open: the faster one, [`Request::device`].
    pub device: Option<Device>,
    /// Isotropic lobes only; tables are always fitted so.
    pub isotropic: bool,
    /// Lobes of its own for every channel; implies isotropic ones.
    pub separate_channels: bool,
    /// Source of ρ_d.
    pub diffuse: Diffuse,
    /// Whether samples that lie far off weigh less.
    pub robust: bool,
    /// What directional albedos are held to.
    pub bound: AlbedoBound,
    /// Normals of texels.
    pub normals: bool,
    /// Lobes that sharpen toward grazing.
    pub sharpening: bool,
}

impl Request {
    /// Fits a store with all that is open decided: the map that `lobelia fit` writes, but for what that says
    /// of who made it.
    ///
    /// # Errors
    /// As [`Self::of_texels`] and [`chunks::fit_store`].
    pub fn fit(&self, store: &SampledStore) -> Result<SbrdfMap> {
        let options = self.of_texels(Some(store))?;
        let device = self.device(store, &options)?;
        chunks::fit_store(store, &FitOptions { device, ..options })
    }

    /// How texels are fitted. Without their store as if it had no standard deviations. An open device is the
    /// CPU: it alone gives the same bytes on every machine.
    ///
    /// # Errors
    /// As [`FitOptions::check`].
    pub fn of_texels(&self, store: Option<&SampledStore>) -> Result<FitOptions> {
        let weights = self.weights.unwrap_or_default();
        let open = if weights == Weights::Sigma { Residual::Linear } else { FitOptions::default().residual };
        let residual = self.residual.unwrap_or(open);
        let method = self.method_for(residual);
        let (lobes, choose) = match self.lobes {
            Lobes::Auto(most) if method == Method::Separable => (most, true),
            _ => (self.number_of_lobes(), false),
        };
        let mut options = FitOptions {
            lobes,
            choose,
            method,
            isotropic: self.isotropic || self.separate_channels,
            separate_channels: self.separate_channels,
            robust: self.robust,
            diffuse: self.diffuse,
            residual,
            weights,
            device: self.device.unwrap_or_default(),
            bound: self.bound,
            extensions: Extensions {
                normals: self.normals,
                sharpening: self.sharpening,
                microfacets: match self.terms {
                    Some(Terms::Ggx) => Microfacets::Always,
                    Some(Terms::Choose) if choose => Microfacets::Choose,
                    _ => Microfacets::Never,
                },
            },
        };
        options.check()?;
        let open = self.weights.is_none() && self.residual.is_none() && method == Method::Separable;
        if open && store.is_some_and(SampledStore::has_sigma) {
            (options.weights, options.residual) = (Weights::Sigma, Residual::Linear);
        }
        Ok(options)
    }

    /// The device that was asked for; else the GPU if there are 16,384 texels or more, it is no software, and
    /// it fits the middle chunk in less time than the CPU.
    ///
    /// # Errors
    /// When that chunk cannot be read.
    pub fn device(&self, store: &SampledStore, options: &FitOptions) -> Result<Device> {
        self.device.map_or_else(|| gpu::faster(store, options), Ok)
    }

    /// Method and residual of a table, the sizes to compare and which of them to take.
    ///
    /// # Errors
    /// Input errors: what is for texels alone.
    pub fn of_table(&self) -> Result<TableRequest> {
        let texels_only = [
            (
                self.weights == Some(Weights::Sigma),
                "--weights sigma is",
                "; tables have no noise of their own",
            ),
            (self.device == Some(Device::Gpu), "--device gpu is", "; tables are fitted on the CPU"),
            (
                self.diffuse != Diffuse::Joint || self.separate_channels,
                "--diffuse-percentile and --separate-channels are",
                "",
            ),
            (self.robust, "--robust is", ""),
            (self.normals, "--normals is", ": tables are isotropic"),
            (
                matches!(self.method, Some(Method::Separable | Method::Ratio)),
                "--method separable and ratio are",
                "; tables are fitted by lm",
            ),
        ];
        if let Some((_, what, why)) = texels_only.iter().find(|(asked, ..)| *asked) {
            return Err(Error::input(format!("{what} for sampled SBRDFs (.zarr){why}")));
        }
        let method = self.method.unwrap_or(Method::Lm);
        let (sizes, take) = self.sizes(method);
        let residual = self.residual.unwrap_or(Residual::Balanced);
        Ok(TableRequest { method, residual, sizes, take })
    }

    /// Fits a table at blue, green and red, or at its only wavelength: the map of one texel that `lobelia
    /// fit` writes, but for what that says of who made it.
    ///
    /// # Errors
    /// As [`Self::of_table`] and [`table::fit`].
    pub fn fit_table(&self, measured: &MeasuredTable) -> Result<SbrdfMap> {
        let TableRequest { method, residual, sizes, take } = self.of_table()?;
        let options = TableOptions {
            method,
            residual,
            hold_out_theta_deg: Vec::new(),
            random_starts: 0,
            seed: 0,
            bound: self.bound,
        };
        let wavelengths_nm = table::wavelengths_nm(measured);
        table::map(&table::fit(measured, &wavelengths_nm, &sizes, take, &options)?, &options)
    }

    fn method_for(&self, residual: Residual) -> Method {
        let open = if residual.is_linear() { Method::Separable } else { Method::Lm };
        self.method.unwrap_or(open)
    }

    /// The number where the method cannot choose.
    fn number_of_lobes(&self) -> usize {
        match (self.lobes, self.method.and_then(Method::line_search)) {
            (Lobes::Count(count), _) => count,
            (Lobes::Auto(most), Some(_)) => most.min(1),
            (Lobes::Auto(most), None) => most.min(DEFAULT_LOBES),
        }
    }

    fn sizes(&self, method: Method) -> (Vec<Size>, Take) {
        let alone = |lobes: usize| Size { lobes, sharpening: false, microfacet: false };
        let with = |lobes: usize| Size { lobes, sharpening: false, microfacet: true };
        if let (Lobes::Auto(limit), Method::Lm) = (self.lobes, method) {
            let mut sizes = Vec::new();
            if self.terms != Some(Terms::Ggx) {
                sizes.extend((0..=limit).map(alone));
            }
            if self.terms != Some(Terms::Lobes) {
                sizes.extend((0..=limit.min(MOST_BESIDE)).map(with));
            }
            if self.sharpening {
                let sharpening = |size: &Size| (size.lobes > 0).then_some(Size { sharpening: true, ..*size });
                sizes.extend(sizes.iter().filter_map(sharpening).collect::<Vec<_>>());
            }
            return (sizes, Take::Choose);
        }
        let most = if method.line_search().is_some() { 1 } else { DEFAULT_LOBES };
        let wanted = self.number_of_lobes();
        let size = if self.terms == Some(Terms::Ggx) { with } else { alone };
        let size = |lobes: usize| Size { sharpening: self.sharpening && lobes > 0, ..size(lobes) };
        ((0..=most.max(wanted)).map(size).collect(), Take::Size(size(wanted)))
    }
}

/// What is asked of a table's fit, with all that was open decided.
#[derive(Debug, Clone, PartialEq)]
pub struct TableRequest {
    /// Method.
    pub method: Method,
    /// Scale of comparison.
    pub residual: Residual,
    /// Sizes to fit.
    pub sizes: Vec<Size>,
    /// Which of them to take.
    pub take: Take,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_lobes_are_read_from_text() {
        assert_eq!("auto".parse(), Ok(Lobes::Auto(MOST_LOBES)));
        assert_eq!("auto:2".parse(), Ok(Lobes::Auto(2)));
        assert_eq!("0".parse(), Ok(Lobes::Count(0)));
        for wrong in ["5", "auto:5", "-1", "two", ""] {
            assert!(wrong.parse::<Lobes>().is_err(), "{wrong}");
        }
    }

    /// What docs/fit.md says of `auto`.
    #[test]
    fn what_is_open_follows_from_what_is_named() {
        let of = |request: Request| request.of_texels(None).unwrap();
        let open = of(Request::default());
        assert_eq!((open.method, open.residual), (Method::Separable, Residual::Proportional));
        assert_eq!((open.weights, open.lobes, open.choose), (Weights::Pose, MOST_LOBES, true));
        let log = of(Request { residual: Some(Residual::Log), ..Request::default() });
        assert_eq!((log.method, log.lobes, log.choose), (Method::Lm, 2, false));
        let line = of(Request { method: Some(Method::LineSearch), ..Request::default() });
        assert_eq!((line.lobes, line.choose), (1, false));
        let sigma = of(Request { weights: Some(Weights::Sigma), ..Request::default() });
        assert_eq!((sigma.residual, sigma.method), (Residual::Linear, Method::Separable));
        let colours = of(Request { separate_channels: true, ..Request::default() });
        assert!(colours.isotropic);
    }

    #[test]
    fn a_table_chooses_among_lobes_with_and_without_a_microfacet_term() {
        let open = Request::default().of_table().unwrap();
        assert_eq!((open.sizes.len(), open.take, open.method), (9, Take::Choose, Method::Lm));
        let lobes = Request { terms: Some(Terms::Lobes), sharpening: true, ..Request::default() };
        assert_eq!(lobes.of_table().unwrap().sizes.len(), 9);
        let two = Request { lobes: Lobes::Count(3), ..Request::default() }.of_table().unwrap();
        let size = Size { lobes: 3, sharpening: false, microfacet: false };
        assert_eq!((two.sizes.len(), two.take), (4, Take::Size(size)));
        let refused = Request { robust: true, ..Request::default() }.of_table().unwrap_err();
        assert_eq!((refused.exit_code(), refused.to_string().contains("--robust is for sampled")), (2, true));
    }
}
