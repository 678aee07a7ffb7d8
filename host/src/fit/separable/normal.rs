//! What follows from the Gram matrix of the columns: amplitudes in closed form, and the normal equations of the shapes with the
//! amplitudes projected out (Kaufman's approximation of the Jacobian of variable projection).

use super::super::linear;
use super::columns::{CHANNELS, COMMON, Gram, MOST_LOBES, WIDTH};
use super::shape::{Family, UNKNOWNS};

/// Linear unknowns of a channel: ρ_d and the amplitudes.
pub const LINEAR: usize = 1 + MOST_LOBES;

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
}

impl Layout {
    /// The column of linear unknown `unknown`: 0 is ρ_d, then the lobes.
    pub fn column(&self, unknown: usize) -> usize {
        match unknown {
            0 => 0,
            lobe => COMMON + (lobe - 1) * (1 + self.family.derivatives()),
        }
    }

    /// Column of a derivative.
    pub(super) fn derivative(&self, lobe: usize, column: usize) -> usize {
        self.column(lobe + 1) + 1 + column
    }
}

/// The linear part at given shapes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Amplitudes {
    /// ρ_d and amplitudes times the channel's scale.
    pub x: [[f64; LINEAR]; CHANNELS],
    /// Which of them are at no bound.
    pub free: [[bool; LINEAR]; CHANNELS],
    /// Σ over channels of the squared residuals.
    pub cost: f64,
}

/// The amplitudes within 0 and `most` that minimise the cost, channel by channel, and that cost.
pub fn amplitudes(gram: &Gram, layout: Layout, most: [f64; CHANNELS]) -> Amplitudes {
    let first = usize::from(!layout.diffuse);
    let size = layout.lobes + 1 - first;
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
    for (channel, &most) in most.iter().enumerate().take(layout.channels) {
        let goal = 1 + channel;
        let mut rhs = [0.0; LINEAR];
        for i in 0..size {
            rhs[i] = gram[place(i) * WIDTH + goal];
        }
        let cap = |i: usize| if first + i == 0 { f64::INFINITY } else { most };
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
        found.cost += cost.max(0.0);
    }
    found
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
#[derive(Debug, Clone, Copy)]
pub struct Normal {
    /// JᵀJ, row by row with `size` places a row.
    pub matrix: [f64; UNKNOWNS * UNKNOWNS],
    /// Jᵀr.
    pub gradient: [f64; UNKNOWNS],
    /// Unknowns.
    pub size: usize,
}

/// The normal equations at a model, with each channel's free amplitudes projected out.
pub fn normal(gram: &Gram, layout: Layout, at: &Amplitudes) -> Normal {
    let Layout { family, lobes, .. } = layout;
    let size = family.size(lobes);
    let mut normal = Normal { matrix: [0.0; UNKNOWNS * UNKNOWNS], gradient: [0.0; UNKNOWNS], size };
    for channel in 0..layout.channels {
        let free = &at.free[channel];
        if at.free[..channel].contains(free) {
            continue;
        }
        // Channels with the same free amplitudes share their projection.
        let mut weight = [0.0; MOST_LOBES * MOST_LOBES];
        let channels = at.x.iter().zip(&at.free).take(layout.channels);
        for (x, _) in channels.filter(|(_, other)| *other == free) {
            for i in 0..lobes {
                for j in 0..lobes {
                    weight[i * MOST_LOBES + j] += x[1 + i] * x[1 + j];
                }
            }
        }
        project(gram, layout, free, &weight, &mut normal);
    }
    for lobe in 0..lobes {
        for column in 0..family.derivatives() {
            let derivative = layout.derivative(lobe, column);
            let mut sum = 0.0;
            for channel in 0..layout.channels {
                let x = &at.x[channel];
                let mut residual = -gram[derivative * WIDTH + 1 + channel];
                for (unknown, x) in x.iter().enumerate().take(lobes + 1) {
                    residual += gram[derivative * WIDTH + layout.column(unknown)] * x;
                }
                sum += x[1 + lobe] * residual;
            }
            normal.gradient[family.unknown(lobe, column, lobes)] += sum;
        }
    }
    normal
}

/// Adds the products of the derivatives, without what the free columns span, times the amplitudes' products.
fn project(gram: &Gram, layout: Layout, free: &[bool; LINEAR], weight: &[f64], normal: &mut Normal) {
    let Layout { family, lobes, .. } = layout;
    let derivatives = family.derivatives();
    let mut members = [0; LINEAR];
    let mut count = 0;
    for unknown in (0..=lobes).filter(|&unknown| free[unknown]) {
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
    let total = lobes * derivatives;
    // L⁻¹ Φᵀ D, a row a derivative.
    let mut inner = [[0.0; LINEAR]; MOST_LOBES * 4];
    for (index, row) in inner.iter_mut().enumerate().take(total) {
        let column = layout.derivative(index / derivatives, index % derivatives);
        for i in 0..count {
            let dot: f64 = (0..i).map(|k| factor[i * count + k] * row[k]).sum();
            row[i] = (gram[members[i] * WIDTH + column] - dot) / factor[i * count + i];
        }
    }
    for a in 0..total {
        let (lobe_a, column_a) = (a / derivatives, a % derivatives);
        let s = family.unknown(lobe_a, column_a, lobes);
        for b in 0..total {
            let (lobe_b, column_b) = (b / derivatives, b % derivatives);
            let t = family.unknown(lobe_b, column_b, lobes);
            let spanned: f64 = (0..count).map(|k| inner[a][k] * inner[b][k]).sum();
            let product =
                gram[layout.derivative(lobe_a, column_a) * WIDTH + layout.derivative(lobe_b, column_b)];
            normal.matrix[s * normal.size + t] += weight[lobe_a * MOST_LOBES + lobe_b] * (product - spanned);
        }
    }
}
