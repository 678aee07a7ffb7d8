//! Bases of lobes as linear forms in the products of directions.

/// A lobe's base as a linear form in the products, and its derivatives by the shape's unknowns.
#[derive(Debug, Clone, Copy)]
pub struct Form<const P: usize, const T: usize> {
    /// Coefficients of the base, referred to the reference: the shape is baseⁿ.
    pub base: [f64; P],
    /// Coefficients of the base's derivatives.
    pub tangents: [[f64; P]; T],
    /// Exponent.
    pub n: f64,
}

/// exp of less than this is nothing beside any measured value.
pub(super) const NEGLIGIBLE: f64 = -40.0;

/// A linear form in the products at every sample.
#[inline(always)]
pub(super) fn linear_form<const P: usize>(coefficients: &[f64; P], products: [&[f64]; P], out: &mut [f64]) {
    for (out, product) in out.iter_mut().zip(products[0]) {
        *out = coefficients[0] * product;
    }
    for p in 1..P {
        for (out, product) in out.iter_mut().zip(products[p]) {
            *out += coefficients[p] * product;
        }
    }
}
