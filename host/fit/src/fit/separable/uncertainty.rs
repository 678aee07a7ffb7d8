//! Standard deviations of the coefficients from the information matrix at the solution.
//!
//! With the noise σ² of a weighted residual taken from the fit's own cost, the shapes θ have the covariance
//! σ² (JᵀJ)⁻¹ of the projected normal equations, and a channel's amplitudes x = x(θ) + e have σ² G⁻¹ + M
//! cov(θ) Mᵀ with M = dx/dθ = −G⁻¹ ΦᵀD x. What the map holds follows to first order. It holds for noise that
//! the weights describe and for a model that can describe the material.

use glam::DVec3;

use super::super::coat::WIDTHS;
use super::super::linear;
use super::super::lm::tangents;
use super::super::model::{EXPONENTS, Model};
use super::extended::MOST_TILT;
use super::layout::{Family, LINEAR, Layout, UNKNOWNS, WIDTH};
use super::normal::{self, Amplitudes, Normal};
use super::solver::Solver;

/// Standard deviations of one lobe's coefficients.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LobeSigma {
    /// Of ρ_s a channel, sr⁻¹.
    pub rho_s: [f64; 3],
    /// Of the diagonal of C.
    pub c: DVec3,
    /// Of the exponent.
    pub n: f64,
    /// Of the exponent toward grazing, where the lobe sharpens.
    pub n_grazing: f64,
}

/// Standard deviations of a microfacet term's coefficients.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CoatSigma {
    /// Of f0 a channel.
    pub f0: [f64; 3],
    /// Of f90 a channel.
    pub f90: [f64; 3],
    /// Of α.
    pub alpha: f64,
}

/// Standard deviations of a texel's coefficients, in the order of the map. What the samples do not tell has
/// the width of its range: π/4 for β, 1 for C, the largest exponent for n; an amplitude at a bound has 0.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sigma {
    /// Of ρ_d a channel, sr⁻¹.
    pub rho_d: [f64; 3],
    /// Of β, radians.
    pub beta: f64,
    /// Of x and y of the normal.
    pub normal: [f64; 2],
    /// Of the lobes.
    pub lobes: Vec<LobeSigma>,
    /// Of the microfacet term.
    pub coat: CoatSigma,
}

impl Sigma {
    /// Takes over those of a group of channels, of which the model has the direction `beta`; x and y of C
    /// change places where the map's β lies a quarter turn from it.
    pub fn take(&mut self, channels: &[usize], group: Self, beta: f64) {
        let turned = (beta / std::f64::consts::FRAC_PI_2).round() as i64 % 2 != 0 && group.beta > 0.0;
        (self.beta, self.normal, self.coat) = (group.beta, group.normal, group.coat);
        let spread = |values: [f64; 3]| {
            let mut all = [0.0; 3];
            for (&channel, value) in channels.iter().zip(values) {
                all[channel] = value;
            }
            all
        };
        for (total, own) in self.rho_d.iter_mut().zip(spread(group.rho_d)) {
            *total += own;
        }
        self.lobes.extend(group.lobes.into_iter().map(|lobe| LobeSigma {
            rho_s: spread(lobe.rho_s),
            c: if turned { DVec3::new(lobe.c.y, lobe.c.x, lobe.c.z) } else { lobe.c },
            ..lobe
        }));
    }
}

/// The error of n is normal on a logarithmic scale: its standard deviation is stated so that this many of it
/// reach upwards as far as so many of ln n's.
const REACH: f64 = 5.0;
/// A lobe is told from noise where the sum of squares without it would be larger by so many times the noise's
/// variance. The best of all shapes takes up to about 40 of it from samples that hold nothing but noise.
const TOLD: f64 = 50.0;
/// Standard deviation of n over n beyond which it says nothing: shapes far from the one that was found then
/// fit as well.
const VAGUE: f64 = 0.2;
/// Standard deviation of an unknown shape about which the samples say nothing.
const UNTOLD: f64 = 1e3;

/// The covariance of the shapes' unknowns but for σ², row by row.
pub(super) struct Covariance {
    matrix: Vec<f64>,
    size: usize,
}

impl Covariance {
    pub(super) fn new(normal: &Normal) -> Self {
        let size = normal.size;
        let largest = (0..size).map(|i| normal.matrix[i * size + i]).fold(0.0, f64::max);
        let told: Vec<usize> = (0..size).filter(|&i| normal.matrix[i * size + i] > 1e-13 * largest).collect();
        let mut matrix = vec![0.0; size * size];
        let count = told.len();
        // Scaled to a diagonal of 1, so that the ridge is the same share of everything.
        let scale = |i: usize| normal.matrix[i * size + i].sqrt();
        let mut factor: Vec<f64> = (0..count * count)
            .map(|k| (told[k / count], told[k % count]))
            .map(|(i, j)| {
                normal.matrix[i * size + j] / (scale(i) * scale(j)) + if i == j { 1e-12 } else { 0.0 }
            })
            .collect();
        let regular = linear::factor(&mut factor, count);
        for i in 0..size {
            matrix[i * size + i] = UNTOLD * UNTOLD;
        }
        for (a, &i) in told.iter().enumerate().filter(|_| regular) {
            let mut column = vec![0.0; count];
            column[a] = 1.0;
            linear::substitute(&factor, &mut column);
            for (b, &j) in told.iter().enumerate() {
                matrix[i * size + j] = column[b] / (scale(i) * scale(j));
            }
        }
        Self { matrix, size }
    }

    /// gᵀ cov g.
    fn along(&self, gradient: &[f64; UNKNOWNS]) -> f64 {
        let product = gradient.iter().zip(self.times(gradient)).map(|(g, x)| g * x);
        product.sum::<f64>().max(0.0)
    }

    /// Standard deviation of one unknown at a variance σ².
    fn of(&self, unknown: usize, variance: f64) -> f64 {
        let mut gradient = [0.0; UNKNOWNS];
        gradient[unknown] = 1.0;
        (variance * self.along(&gradient)).sqrt()
    }

    /// cov g.
    pub(super) fn times(&self, g: &[f64; UNKNOWNS]) -> [f64; UNKNOWNS] {
        let mut product = [0.0; UNKNOWNS];
        for (row, place) in self.matrix.chunks_exact(self.size.max(1)).zip(&mut product).take(self.size) {
            *place = row.iter().zip(g).map(|(x, g)| x * g).sum();
        }
        product
    }
}

/// The standard deviations at a model that was evaluated last, for the channels that were fitted together (in
/// their order).
pub fn sigma(solver: &Solver, family: Family, diffuse: bool, model: &Model, at: &Amplitudes) -> Sigma {
    let layout = solver.layout(family, diffuse, model);
    // What is held at the cap of amplitudes is not known any better for that.
    let mut at = *at;
    for (free, x) in at.free.iter_mut().flatten().zip(at.x.iter().flatten()) {
        *free |= *x > 0.0;
    }
    let at = &at;
    let normal = normal::normal(&solver.gram, layout, at);
    let variance = variance(solver, layout, at);
    let covariance = Covariance::new(&normal);
    let lobes = model.lobes.len();
    let mut sigma = Sigma { lobes: vec![LobeSigma::default(); lobes], ..Sigma::default() };
    for (index, lobe) in sigma.lobes.iter_mut().enumerate() {
        (lobe.c, lobe.n) = of_shape(solver, layout, model, index, &covariance, variance);
        if let Some(grazing) = model.lobes[index].n_grazing {
            let unknown = layout.unknown(index, layout.derivatives(index) - 1);
            lobe.n_grazing = of_exponent(grazing, covariance.of(unknown, variance));
        }
    }
    if layout.extension.normals {
        let of = |axis| covariance.of(layout.unknown(0, family.derivatives() + axis), variance);
        sigma.normal = [of(0), of(1)].map(|deviation| deviation.min(MOST_TILT));
    }
    if let Some(coat) = model.coat {
        sigma.coat.alpha = (coat.alpha * covariance.of(layout.unknown(lobes, 0), variance)).min(WIDTHS[1]);
    }
    if family == Family::Anisotropic && lobes > 0 {
        sigma.beta = covariance.of(family.unknown(0, 3, lobes), variance).min(std::f64::consts::FRAC_PI_4);
    }
    let told = told(solver, layout, at);
    for channel in 0..layout.channels {
        let of_channel = of_amplitudes(solver, layout, model, at, channel, &covariance);
        let deviation = |unknown: usize| (variance * of_channel[unknown]).sqrt() / solver.data.scale[channel];
        sigma.rho_d[channel] = deviation(0);
        for (index, lobe) in sigma.lobes.iter_mut().enumerate() {
            lobe.rho_s[channel] = deviation(1 + index).min(most(solver, channel));
        }
        if layout.extension.coat {
            let [f0, f90] = [1, 2].map(|term| deviation(lobes + term).min(1.0));
            (sigma.coat.f0[channel], sigma.coat.f90[channel]) = (f0, f90);
        }
    }
    for (index, lobe) in sigma.lobes.iter_mut().enumerate() {
        if lobe.n > VAGUE * model.lobes[index].n || !told[index] {
            let n_grazing = if layout.extension.sharpening { EXPONENTS[1] } else { 0.0 };
            *lobe = LobeSigma { n_grazing, ..untold(solver) };
        }
    }
    sigma
}

/// σ² of a weighted residual, from the cost.
pub(super) fn variance(solver: &Solver, layout: Layout, at: &Amplitudes) -> f64 {
    let free = at.free.iter().take(layout.channels).flatten().filter(|&&free| free).count();
    let unknowns = free + layout.size();
    at.cost / (solver.data.telling() * layout.channels).saturating_sub(unknowns).max(1) as f64
}

/// Which lobes of a model that was evaluated last are told from noise.
pub fn told(solver: &Solver, layout: Layout, at: &Amplitudes) -> Vec<bool> {
    let mut rises = vec![0.0; layout.terms()];
    for (x, free) in at.x.iter().zip(&at.free).take(layout.channels) {
        let members: Vec<usize> = (0..=layout.terms()).filter(|&unknown| free[unknown]).collect();
        let Some(factor) = factor(solver, layout, &members) else { continue };
        for (place, &unknown) in members.iter().enumerate().filter(|&(_, &unknown)| unknown > 0) {
            let mut own = [0.0; LINEAR];
            own[place] = 1.0;
            linear::substitute(&factor, &mut own[..members.len()]);
            rises[unknown - 1] += x[unknown] * x[unknown] / own[place];
        }
    }
    let least = TOLD * variance(solver, layout, at);
    rises.into_iter().map(|rise| rise > least).collect()
}

/// The Cholesky factor of the products of some linear unknowns; none where they are not independent.
fn factor(solver: &Solver, layout: Layout, members: &[usize]) -> Option<Vec<f64>> {
    let count = members.len();
    let mut factor: Vec<f64> = (0..count * count)
        .map(|k| (layout.column(members[k / count]), layout.column(members[k % count])))
        .map(|(a, b)| solver.gram[a * WIDTH + b] * if a == b { 1.0 + 1e-12 } else { 1.0 })
        .collect();
    linear::factor(&mut factor, count).then_some(factor)
}

/// The standard deviations of a lobe about which the samples say nothing.
pub fn untold(solver: &Solver) -> LobeSigma {
    let channels = solver.data.channels;
    let rho_s = std::array::from_fn(|k| if k < channels { most(solver, k) } else { 0.0 });
    LobeSigma { rho_s, c: DVec3::ONE, n: EXPONENTS[1], n_grazing: 0.0 }
}

/// Largest amplitude of a lobe.
fn most(solver: &Solver, channel: usize) -> f64 {
    solver.data.most[channel] / solver.data.scale[channel]
}

/// The unknowns that turn a lobe's C, with the derivatives of C and of ln(reference) by them.
fn turns(solver: &Solver, layout: Layout, model: &Model, index: usize) -> Vec<(usize, DVec3, f64)> {
    let lobe = &model.lobes[index];
    let isotropic = layout.family != Family::Anisotropic;
    let count = if isotropic { 1 } else { 2 };
    let directions = tangents(lobe.c, isotropic);
    (directions.into_iter().take(count).enumerate())
        .map(|(k, tangent)| {
            let by_reference = lobe.reference_slope(tangent, solver.data.cone);
            (layout.family.unknown(index, 1 + k, layout.lobes), tangent, by_reference)
        })
        .collect()
}

/// Standard deviations of C as the map holds it, divided by its reference, and of n.
fn of_shape(
    solver: &Solver,
    layout: Layout,
    model: &Model,
    index: usize,
    covariance: &Covariance,
    variance: f64,
) -> (DVec3, f64) {
    let lobe = &model.lobes[index];
    let mut c = DVec3::ZERO;
    for axis in 0..3 {
        let mut gradient = [0.0; UNKNOWNS];
        for (unknown, tangent, by_reference) in turns(solver, layout, model, index) {
            gradient[unknown] = (tangent[axis] - lobe.c[axis] * by_reference) / lobe.reference;
        }
        c[axis] = (variance * covariance.along(&gradient)).sqrt().min(1.0);
    }
    (c, of_exponent(lobe.n, covariance.of(layout.unknown(index, 0), variance)))
}

/// The standard deviation of an exponent from that of its logarithm.
fn of_exponent(n: f64, of_ln_n: f64) -> f64 {
    (n * ((REACH * of_ln_n).exp() - 1.0) / REACH).min(EXPONENTS[1])
}

/// How a channel's free amplitudes follow the samples and the shapes.
pub(super) struct Response {
    /// Linear unknowns that are free.
    pub members: Vec<usize>,
    /// Cholesky factor of their products G.
    pub factor: Vec<f64>,
    /// M, their derivatives by the shapes' unknowns, a row a member.
    pub by_shape: Vec<[f64; UNKNOWNS]>,
}

impl Response {
    /// The response at a model that was evaluated last; none where the columns are not independent.
    pub(super) fn new(solver: &Solver, layout: Layout, at: &Amplitudes, channel: usize) -> Option<Self> {
        let (gram, x) = (&solver.gram, &at.x[channel]);
        let members: Vec<usize> = (0..=layout.terms()).filter(|&unknown| at.free[channel][unknown]).collect();
        let entry = |a: usize, b: usize| gram[a * WIDTH + b];
        let factor = factor(solver, layout, &members)?;
        let mut by_shape = vec![[0.0; UNKNOWNS]; members.len()];
        for (term, column) in layout.each_derivative() {
            let derivative = layout.derivative(term, column);
            let mut along: Vec<f64> =
                members.iter().map(|&i| -x[1 + term] * entry(layout.column(i), derivative)).collect();
            linear::substitute(&factor, &mut along);
            for (row, along) in by_shape.iter_mut().zip(along) {
                row[layout.unknown(term, column)] += along;
            }
        }
        Some(Self { members, factor, by_shape })
    }
}

/// Variances of a channel's ρ_d and amplitudes, but for σ² and the channel's scale.
fn of_amplitudes(
    solver: &Solver,
    layout: Layout,
    model: &Model,
    at: &Amplitudes,
    channel: usize,
    covariance: &Covariance,
) -> [f64; LINEAR] {
    let mut variances = [0.0; LINEAR];
    let Some(Response { members, factor, by_shape }) = Response::new(solver, layout, at, channel) else {
        return variances;
    };
    for (place, (&unknown, mut gradient)) in members.iter().zip(by_shape).enumerate() {
        // The amplitude of a lobe that sharpens is that at its reference; others keep it as C turns.
        let lobe = unknown.checked_sub(1).and_then(|place| model.lobes.get(place));
        if let Some(lobe) = lobe.filter(|lobe| lobe.n_grazing.is_none()) {
            for (turn, _, by_reference) in turns(solver, layout, model, unknown - 1) {
                gradient[turn] += at.x[channel][unknown] * lobe.n * by_reference;
            }
        }
        let mut own = vec![0.0; members.len()];
        own[place] = 1.0;
        linear::substitute(&factor, &mut own);
        variances[unknown] = own[place] + covariance.along(&gradient);
    }
    variances
}
