//! Which columns a model has and which unknowns its shapes: sizes, families of shapes, what is beyond plain
//! lobes.

use super::super::model::Model;

/// Most lobes.
pub const MOST_LOBES: usize = super::super::MOST_LOBES;
/// Channels at most.
pub const CHANNELS: usize = 3;
/// Columns of a lobe at most: shape, derivative by ln n, three tangents; two of its normal and one by the
/// exponent toward grazing.
pub const PER_LOBE: usize = 8;
/// Terms with an amplitude at most: the lobes, and two of a microfacet term.
pub const MOST_TERMS: usize = MOST_LOBES + 2;
/// Columns of a microfacet term.
pub const PER_COAT: usize = 4;
/// The columns that every model has: 1 and the channels' goals.
pub const COMMON: usize = 1 + CHANNELS;
/// Columns at most.
pub const WIDTH: usize = COMMON + MOST_LOBES * PER_LOBE + PER_COAT;

/// Linear unknowns of a channel: ρ_d and the amplitudes of the lobes, then f0 and f90.
pub const LINEAR: usize = 1 + MOST_TERMS;

/// Unknowns at most: three a lobe and β, or four a lobe; two of the normal, an exponent toward grazing a
/// lobe, and α.
pub const UNKNOWNS: usize = 4 * MOST_LOBES + 2 + MOST_LOBES + 1;

/// Which shapes are fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Family {
    /// ln n and one angle of C a lobe: Cx = Cy.
    Isotropic,
    /// ln n and two tangents of C a lobe, and β for all of them.
    Anisotropic,
    /// ln n, the isotropic angle, and the two entries that a symmetric C has besides, (xx − yy)/2 and xy:
    /// every lobe with a direction of its own, without the singularity that β has at Cx = Cy. Steps start at
    /// isotropic lobes.
    Split,
}

impl Family {
    /// Derivative columns a lobe: ln n and the tangents.
    pub fn derivatives(self) -> usize {
        if self == Self::Isotropic { 2 } else { 4 }
    }

    /// The unknown that derivative `column` of `lobe` belongs to.
    pub fn unknown(self, lobe: usize, column: usize, lobes: usize) -> usize {
        match self {
            Self::Isotropic => 2 * lobe + column,
            Self::Split => 4 * lobe + column,
            Self::Anisotropic if column == 3 => 3 * lobes,
            Self::Anisotropic => 3 * lobe + column,
        }
    }

    /// Number of unknowns.
    pub fn size(self, lobes: usize) -> usize {
        match self {
            Self::Isotropic => 2 * lobes,
            Self::Split => 4 * lobes,
            Self::Anisotropic => 3 * lobes + usize::from(lobes > 0),
        }
    }
}

/// What a model has beyond plain lobes: what is searched with them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Extension {
    /// A normal that the lobes share: two unknowns.
    pub normals: bool,
    /// An exponent toward grazing a lobe.
    pub sharpening: bool,
    /// A microfacet term: α, and f0 and f90 as amplitudes.
    pub coat: bool,
}

impl Extension {
    /// That of a model.
    pub fn of(model: &Model) -> Self {
        Self {
            normals: model.normal.is_some() && !model.lobes.is_empty(),
            sharpening: model.lobes.first().is_some_and(|lobe| lobe.n_grazing.is_some()),
            coat: model.coat.is_some(),
        }
    }

    /// Whether there is nothing.
    pub fn is_none(self) -> bool {
        self == Self::default()
    }
}

/// Which columns are what.
#[derive(Debug, Clone, Copy)]
pub struct Layout {
    /// Shapes' unknowns.
    pub family: Family,
    /// Lobes.
    pub lobes: usize,
    /// Channels that are fitted.
    pub channels: usize,
    /// Whether ρ_d is an unknown.
    pub diffuse: bool,
    /// What there is beyond plain lobes.
    pub extension: Extension,
}

impl Layout {
    /// That of a model, for one channel with ρ_d as an unknown.
    pub fn of(family: Family, model: &Model) -> Self {
        let extension = Extension::of(model);
        Self { family, lobes: model.lobes.len(), channels: 1, diffuse: true, extension }
    }

    /// Terms that have an amplitude: the lobes, and f0 and f90 of a microfacet term.
    pub fn terms(&self) -> usize {
        self.lobes + if self.extension.coat { 2 } else { 0 }
    }

    /// Derivative columns of a term: of a lobe the family's, then those of its normal and by its exponent
    /// toward grazing.
    pub fn derivatives(&self, term: usize) -> usize {
        let Extension { normals, sharpening, .. } = self.extension;
        let of_lobe = self.family.derivatives() + if normals { 2 } else { 0 } + usize::from(sharpening);
        if term < self.lobes { of_lobe } else { 1 }
    }

    /// The unknown that derivative `column` of `term` belongs to.
    pub fn unknown(&self, term: usize, column: usize) -> usize {
        let own = self.family.derivatives();
        if term < self.lobes && column < own {
            return self.family.unknown(term, column, self.lobes);
        }
        let start = self.family.size(self.lobes);
        match (self.extension.normals, column.wrapping_sub(own)) {
            _ if term >= self.lobes => self.size() - 1,
            (true, axis @ (0 | 1)) => start + axis,
            (normals, _) => start + if normals { 2 } else { 0 } + term,
        }
    }

    /// Number of the shapes' unknowns.
    pub fn size(&self) -> usize {
        let Extension { normals, sharpening, coat } = self.extension;
        self.family.size(self.lobes)
            + if normals { 2 } else { 0 }
            + if sharpening { self.lobes } else { 0 }
            + usize::from(coat)
    }

    /// The column of linear unknown `unknown`: 0 is ρ_d, then the terms.
    pub fn column(&self, unknown: usize) -> usize {
        let of_lobes = |lobes: usize| COMMON + lobes * (1 + self.derivatives(0));
        match unknown {
            0 => 0,
            lobe if lobe <= self.lobes => of_lobes(lobe - 1),
            coat => COMMON + self.lobes * self.per_lobe() + 2 * (coat - 1 - self.lobes),
        }
    }

    /// All columns.
    pub fn columns(&self) -> usize {
        COMMON + self.lobes * self.per_lobe() + if self.extension.coat { 4 } else { 0 }
    }

    /// Columns of a lobe, 0 where there are none.
    fn per_lobe(&self) -> usize {
        if self.lobes == 0 { 0 } else { 1 + self.derivatives(0) }
    }

    /// Column of a derivative.
    pub(super) fn derivative(&self, term: usize, column: usize) -> usize {
        self.column(term + 1) + 1 + column
    }

    /// The terms' derivative columns: term and place.
    pub(super) fn each_derivative(self) -> impl Iterator<Item = (usize, usize)> + Clone {
        (0..self.terms()).flat_map(move |term| (0..self.derivatives(term)).map(move |column| (term, column)))
    }
}
