//! What follows from the Gram matrix of the columns: amplitudes in closed form, and the normal equations of
//! the shapes with the amplitudes projected out (Kaufman's approximation of the Jacobian of variable
//! projection).

use super::super::linear;
use super::columns::Gram;
use super::layout::{CHANNELS, LINEAR, Layout, MOST_LOBES, MOST_TERMS, PER_LOBE, UNKNOWNS, WIDTH};

/// Derivative columns at most.
const DERIVATIVES: usize = MOST_LOBES * (PER_LOBE - 1) + 2;

/// The albedos that press against the limit in one channel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pressing {
    /// Places of the incidences.
    pub(super) places: [u8; LINEAR],
    pub(super) count: usize,
}

impl Pressing {
    pub(super) fn places(&self) -> &[u8] {
        &self.places[..self.count]
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }
}

/// The linear part at given shapes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Amplitudes {
    /// ρ_d and amplitudes times the channel's scale.
    pub x: [[f64; LINEAR]; CHANNELS],
    /// Which of them are at no bound.
    pub free: [[bool; LINEAR]; CHANNELS],
    /// Directional albedos at their limit, where the amplitudes are held to one ([`bound`](super::bound)).
    pub pressing: [Pressing; CHANNELS],
    /// Σ over channels of the squared residuals.
    pub cost: f64,
}

/// What amplitudes are at most.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Most {
    /// A lobe's, channel by channel.
    pub lobes: [f64; CHANNELS],
    /// A microfacet term's.
    pub coats: [f64; CHANNELS],
    /// The share of it that each lobe may take.
    pub shares: [f64; MOST_LOBES],
}

impl Most {
    /// That of a linear unknown in a channel.
    pub fn of(&self, layout: Layout, unknown: usize, channel: usize) -> f64 {
        match unknown {
            0 => f64::INFINITY,
            lobe if lobe <= layout.lobes => self.lobes[channel] * self.shares[lobe - 1],
            _ => self.coats[channel],
        }
    }
}

/// The amplitudes within 0 and their most, channel by channel, that minimise the cost, and that cost.
pub fn amplitudes(gram: &Gram, layout: Layout, most: &Most) -> Amplitudes {
    let first = usize::from(!layout.diffuse);
    let size = layout.terms() + 1 - first;
    let place = |i: usize| layout.column(first + i);
    let mut small = [0.0; LINEAR * LINEAR];
    for i in 0..size {
        for j in 0..size {
            small[i * size + j] = gram[place(i) * WIDTH + place(j)];
        }
    }
    let small = &mut small[..size * size];
    let mut factor = [0.0; LINEAR * LINEAR];
    let factor = &mut factor[..size * size];
    factor.copy_from_slice(small);
    for i in 0..size {
        factor[i * size + i] *= 1.0 + 1e-12;
    }
    let regular = linear::factor(factor, size);
    let mut found = Amplitudes::default();
    for channel in 0..layout.channels {
        let goal = 1 + channel;
        let mut rhs = [0.0; LINEAR];
        for i in 0..size {
            rhs[i] = gram[place(i) * WIDTH + goal];
        }
        let cap = |i: usize| most.of(layout, first + i, channel);
        let mut x = rhs;
        let mut free = [true; LINEAR];
        let inside = |x: &[f64]| x.iter().enumerate().all(|(i, &x)| x >= 0.0 && x <= cap(i));
        if regular {
            linear::substitute(factor, &mut x[..size]);
        }
        if !regular || !inside(&x[..size]) {
            bounded(small, &rhs[..size], cap, &mut x[..size], &mut free);
        }
        let mut cost = gram[goal * WIDTH + goal];
        for i in 0..size {
            let product: f64 = (0..size).map(|j| small[i * size + j] * x[j]).sum();
            cost += x[i] * (product - 2.0 * rhs[i]);
            found.x[channel][first + i] = x[i];
            found.free[channel][first + i] = free[i];
        }
        found.cost += squares(cost);
    }
    found
}

/// Squared residuals from their expanded form: rounding may take it below 0, and products that overflowed are
/// the worst fit there is.
pub(super) fn squares(expanded: f64) -> f64 {
    if expanded.is_finite() { expanded.max(0.0) } else { f64::INFINITY }
}

/// Least squares between 0 and `cap`: what exceeds its cap is held there, and the rest solved again.
fn bounded(gram: &[f64], rhs: &[f64], cap: impl Fn(usize) -> f64, x: &mut [f64], free: &mut [bool]) {
    let size = rhs.len();
    let mut held = [false; LINEAR];
    loop {
        let members: Vec<usize> = (0..size).filter(|&i| !held[i]).collect();
        let count = members.len();
        let (mut part, mut right, mut solved) = ([0.0; LINEAR * LINEAR], [0.0; LINEAR], [0.0; LINEAR]);
        for (a, &i) in members.iter().enumerate() {
            right[a] =
                rhs[i] - (0..size).filter(|&j| held[j]).map(|j| gram[i * size + j] * cap(j)).sum::<f64>();
            for (b, &j) in members.iter().enumerate() {
                part[a * count + b] = gram[i * size + j];
            }
        }
        linear::nnls(&part[..count * count], &right[..count], &mut solved[..count]);
        for i in 0..size {
            x[i] = cap(i);
            free[i] = false;
        }
        let mut worst = None;
        for (a, &i) in members.iter().enumerate() {
            (x[i], free[i]) = (solved[a], solved[a] > 0.0);
            if solved[a] > cap(i) && worst.is_none_or(|(_, over)| solved[a] - cap(i) > over) {
                worst = Some((i, solved[a] - cap(i)));
            }
        }
        match worst {
            Some((i, _)) => held[i] = true,
            None => return,
        }
    }
}

/// Normal equations of the shapes' unknowns.
#[derive(Debug, Clone)]
pub struct Normal {
    /// JᵀJ, row by row with `size` places a row.
    pub matrix: Vec<f64>,
    /// Jᵀr.
    pub gradient: [f64; UNKNOWNS],
    /// Unknowns.
    pub size: usize,
}

/// The normal equations at a model, with each channel's free amplitudes projected out.
pub fn normal(gram: &Gram, layout: Layout, at: &Amplitudes) -> Normal {
    let (terms, size) = (layout.terms(), layout.size());
    let mut normal = Normal { matrix: vec![0.0; size * size], gradient: [0.0; UNKNOWNS], size };
    for channel in 0..layout.channels {
        let free = &at.free[channel];
        if at.free[..channel].contains(free) {
            continue;
        }
        // Channels with the same free amplitudes share their projection.
        let mut weight = [0.0; MOST_TERMS * MOST_TERMS];
        let channels = at.x.iter().zip(&at.free).take(layout.channels);
        for (x, _) in channels.filter(|(_, other)| *other == free) {
            for i in 0..terms {
                for j in 0..terms {
                    weight[i * MOST_TERMS + j] += x[1 + i] * x[1 + j];
                }
            }
        }
        project(gram, layout, free, &weight, &mut normal);
    }
    for (term, column) in layout.each_derivative() {
        let derivative = layout.derivative(term, column);
        let mut sum = 0.0;
        for channel in 0..layout.channels {
            let x = &at.x[channel];
            let mut residual = -gram[derivative * WIDTH + 1 + channel];
            for (unknown, x) in x.iter().enumerate().take(terms + 1) {
                residual += gram[derivative * WIDTH + layout.column(unknown)] * x;
            }
            sum += x[1 + term] * residual;
        }
        normal.gradient[layout.unknown(term, column)] += sum;
    }
    normal
}

/// Adds the products of the derivatives, without what the free columns span, times the amplitudes' products.
fn project(gram: &Gram, layout: Layout, free: &[bool; LINEAR], weight: &[f64], normal: &mut Normal) {
    let mut members = [0; LINEAR];
    let mut count = 0;
    for unknown in (0..=layout.terms()).filter(|&unknown| free[unknown]) {
        members[count] = layout.column(unknown);
        count += 1;
    }
    let mut factor = [0.0; LINEAR * LINEAR];
    for i in 0..count {
        for j in 0..count {
            factor[i * count + j] = gram[members[i] * WIDTH + members[j]];
        }
        factor[i * count + i] *= 1.0 + 1e-12;
    }
    if !linear::factor(&mut factor[..count * count], count) {
        count = 0;
    }
    // L⁻¹ Φᵀ D, a row a derivative.
    let mut inner = [[0.0; LINEAR]; DERIVATIVES];
    for (row, (term, column)) in inner.iter_mut().zip(layout.each_derivative()) {
        let column = layout.derivative(term, column);
        for i in 0..count {
            let dot: f64 = (0..i).map(|k| factor[i * count + k] * row[k]).sum();
            row[i] = (gram[members[i] * WIDTH + column] - dot) / factor[i * count + i];
        }
    }
    for ((term_a, column_a), row_a) in layout.each_derivative().zip(&inner) {
        let (s, place_a) = (layout.unknown(term_a, column_a), layout.derivative(term_a, column_a));
        for ((term_b, column_b), row_b) in layout.each_derivative().zip(&inner) {
            let t = layout.unknown(term_b, column_b);
            let spanned: f64 = (0..count).map(|k| row_a[k] * row_b[k]).sum();
            let product = gram[place_a * WIDTH + layout.derivative(term_b, column_b)];
            normal.matrix[s * normal.size + t] += weight[term_a * MOST_TERMS + term_b] * (product - spanned);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::layout::Family;
    use super::*;

    /// f64's own maximum of NaN and 0 is 0, a perfect fit.
    #[test]
    fn shapes_whose_products_are_no_numbers_are_the_worst_fit_and_not_the_best() {
        let layout = Layout { channels: 1, ..Layout::of(Family::Isotropic, &Default::default()) };
        let mut gram: Box<Gram> = Box::new([1.0; WIDTH * WIDTH]);
        let most = Most { lobes: [1.0; CHANNELS], coats: [1.0; CHANNELS], shares: [1.0; MOST_LOBES] };
        assert!(amplitudes(&gram, layout, &most).cost < 1e-9);
        for bad in [f64::NAN, f64::INFINITY] {
            gram[layout.column(0) * (WIDTH + 1)] = bad;
            gram[layout.column(0) * WIDTH + 1] = bad;
            assert_eq!(amplitudes(&gram, layout, &most).cost, f64::INFINITY, "{bad}");
        }
    }
}
