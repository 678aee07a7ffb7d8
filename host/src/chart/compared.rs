//! The fits that pages set beside each other: each method with the same numbers of lobes, and as many as a
//! texel needs.

use crate::fit::{FitOptions, MOST_LOBES, Method};

/// A fit that is compared.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Compared {
    /// Method.
    pub(crate) method: Method,
    /// Lobes; the most, where their number is a choice.
    pub(crate) lobes: usize,
    /// Whether their number is a choice.
    pub(crate) choose: bool,
    /// What tables call it.
    pub(crate) name: &'static str,
}

/// In the order of the pages. The line searches have one lobe.
pub(crate) const COMPARED: [Compared; 7] = [
    Compared::fixed(Method::LineSearch, 1, "line search"),
    Compared::fixed(Method::LineSearchScaled, 1, "line search, scaled"),
    Compared::fixed(Method::Lm, 1, "LM, 1 lobe"),
    Compared::fixed(Method::Lm, 2, "LM, 2 lobes"),
    Compared::fixed(Method::Separable, 1, "separable, 1 lobe"),
    Compared::fixed(Method::Separable, 2, "separable, 2 lobes"),
    Compared { choose: true, ..Compared::fixed(Method::Separable, MOST_LOBES, "separable, auto") },
];

impl Compared {
    const fn fixed(method: Method, lobes: usize, name: &'static str) -> Self {
        Self { method, lobes, choose: false, name }
    }

    /// How texels are fitted, everything else as it comes.
    pub(crate) fn options(&self) -> FitOptions {
        FitOptions { method: self.method, lobes: self.lobes, choose: self.choose, ..FitOptions::default() }
    }
}
