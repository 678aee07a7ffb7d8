//! The hot loop: columns of a model (shapes and their derivatives at every sample, times the root of the
//! weight) and their Gram matrix, from which everything that the solver does follows.

use super::data::Data;
use super::extended;
use super::form::{Form, NEGLIGIBLE, linear_form};
use super::layout::{CHANNELS, COMMON, Layout, WIDTH};
use super::levels;
use super::math::{self, LANES};

/// Writes a lobe's columns: shape, derivative by ln n, derivatives along the tangents. `slope` is scratch of
/// the same length.
///
/// Blocks are copied into local arrays, where a compiler sees that lists do not overlap, and there is no
/// branch: that makes vector code.
#[inline(always)]
fn lobe<const P: usize, const T: usize>(
    form: &Form<P, T>,
    products: [&[f64]; P],
    root: &[f64],
    slope: &mut [f64],
    columns: &mut [f64],
) {
    let count = root.len();
    let (shape, rest) = columns.split_at_mut(count);
    let (by_n, tangents) = rest.split_at_mut(count);
    linear_form(&form.base, products, shape);
    let shapes = shape.as_chunks_mut::<LANES>().0.iter_mut().zip(by_n.as_chunks_mut::<LANES>().0);
    let others = root.as_chunks::<LANES>().0.iter().zip(slope.as_chunks_mut::<LANES>().0);
    for ((shape, by_n), (root, slope)) in shapes.zip(others) {
        let (base, root) = (*shape, *root);
        let (mut values, mut derivatives, mut slopes) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
        for lane in 0..LANES {
            // What is not positive becomes so small that its power is negligible whatever the exponent.
            let safe = if base[lane] > 1e-300 { base[lane] } else { 1e-300 };
            let power = form.n * math::ln(safe);
            let enough = power > NEGLIGIBLE;
            let power = if enough { power } else { NEGLIGIBLE };
            // A mask rather than a choice: a choice would become a branch.
            let seen = u64::from(enough).wrapping_neg();
            let value = f64::from_bits((root[lane] * math::exp(power)).to_bits() & seen);
            values[lane] = value;
            derivatives[lane] = value * power;
            slopes[lane] = value * form.n / safe;
        }
        (*shape, *by_n, *slope) = (values, derivatives, slopes);
    }
    for (tangent, column) in form.tangents.iter().zip(tangents.chunks_exact_mut(count.max(1))) {
        linear_form(tangent, products, column);
        for (along, slope) in column.iter_mut().zip(slope.iter()) {
            *along *= slope;
        }
    }
}

/// The columns of a model and their Gram matrix.
#[derive(Debug, Clone, Default)]
pub struct Columns {
    /// [column][sample]: root of the weight, goals, lobe by lobe.
    values: Vec<f64>,
    /// Scratch, a place a sample.
    slope: Vec<f64>,
    /// Samples.
    count: usize,
    /// Where texels with a ρ_d each begin, as in the data.
    texels: Vec<usize>,
}

/// Products of columns, row by row with [`WIDTH`] places a row; both halves are filled.
pub type Gram = [f64; WIDTH * WIDTH];

impl Columns {
    /// Starts with the columns of the data; returns their products in `gram`.
    #[inline(always)]
    pub fn begin(&mut self, data: &Data, gram: &mut Gram) {
        debug_assert!(data.len().is_multiple_of(LANES));
        self.count = data.len();
        self.texels.clone_from(&data.texels);
        self.values.resize(WIDTH * self.count, 0.0);
        self.slope.resize(self.count, 0.0);
        self.values[..self.count].copy_from_slice(&data.root);
        for channel in 0..data.channels {
            let start = (1 + channel) * self.count;
            self.values[start..start + self.count].copy_from_slice(&data.goal[channel]);
        }
        for channel in data.channels..CHANNELS {
            let start = (1 + channel) * self.count;
            self.values[start..start + self.count].fill(0.0);
        }
        self.products(0, COMMON, gram);
    }

    /// A column.
    pub fn column(&self, index: usize) -> &[f64] {
        &self.values[index * self.count..(index + 1) * self.count]
    }

    /// Fills the columns of the lobes; needs [`Self::begin`] once before.
    #[inline(always)]
    pub fn fill<const P: usize, const T: usize>(
        &mut self,
        forms: &[Form<P, T>],
        products: [&[f64]; P],
        gram: &mut Gram,
    ) {
        let count = self.count;
        let (common, rest) = self.values.split_at_mut(COMMON * count);
        for (form, columns) in forms.iter().zip(rest.chunks_exact_mut(((2 + T) * count).max(1))) {
            lobe(form, products, &common[..count], &mut self.slope, columns);
        }
        self.level(COMMON, COMMON + (2 + T) * forms.len());
        self.products(COMMON, COMMON + (2 + T) * forms.len(), gram);
    }

    /// As [`Self::fill`] for an extended model: its lobes, then its microfacet term by its α.
    #[inline(always)]
    pub fn fill_extended(
        &mut self,
        forms: &[extended::Form],
        coat: Option<f64>,
        data: &Data,
        layout: Layout,
        gram: &mut Gram,
    ) {
        let (count, products) = (self.count, &data.products);
        let [xz, yz] = &products.off_normal;
        let all: [&[f64]; 6] = [&products.xx, &products.yy, &products.zz, &products.xy, xz, yz];
        let cosines = products.cos.each_ref().map(|list| &list[..]);
        let (common, rest) = self.values.split_at_mut(COMMON * count);
        let root = &common[..count];
        let span = (1 + layout.derivatives(0)) * count;
        let (lobes, coats) = rest.split_at_mut(if forms.is_empty() { 0 } else { forms.len() * span });
        for (form, columns) in forms.iter().zip(lobes.chunks_exact_mut(span.max(1))) {
            extended::fill_lobe(form, all, cosines, root, &mut self.slope, columns);
        }
        if let Some(alpha) = coat {
            extended::fill_coat(alpha, [&products.plane, &products.zz], cosines, root, coats);
        }
        self.level(COMMON, layout.columns());
        self.products(COMMON, layout.columns(), gram);
    }

    /// Takes from the columns `from..to` what the texels' own ρ_d make up for.
    #[inline(always)]
    fn level(&mut self, from: usize, to: usize) {
        if self.texels.is_empty() {
            return;
        }
        let (root, columns) = self.values.split_at_mut(self.count);
        let columns = &mut columns[(from - 1) * self.count..(to - 1) * self.count];
        for column in columns.chunks_exact_mut(self.count.max(1)) {
            levels::take_off(&self.texels, root, column);
        }
    }

    /// The products of columns `from..to` with all up to them.
    #[inline(always)]
    fn products(&self, from: usize, to: usize, gram: &mut Gram) {
        for i in (from..to).step_by(2) {
            // Places beyond the last are computed again.
            let rows = [i, (i + 1).min(to - 1)];
            for j in (0..=rows[1]).step_by(3) {
                let others = [j, j + 1, j + 2].map(|j| j.min(rows[1]));
                let products = math::dots(rows.map(|i| self.column(i)), others.map(|j| self.column(j)));
                for (i, products) in rows.into_iter().zip(products) {
                    for (j, product) in others.into_iter().zip(products) {
                        gram[i * WIDTH + j] = product;
                        gram[j * WIDTH + i] = product;
                    }
                }
            }
        }
    }
}
