//! No light is made where no pose looked: the directional albedo of a model is at most a limit, at every
//! incidence and in every channel.
//!
//! Given the shapes, an albedo is linear in the amplitudes, so that the amplitudes under the bound are a
//! small quadratic programme (`quadratic`); the shapes are then searched as without it, with amplitudes that
//! move along the albedos that press against the limit. Where none presses all is as without the bound. What
//! this leaves to lobes of which the samples do not tell the shape, a glare in directions that no pose saw,
//! `wild` limits.

use std::sync::LazyLock;

use glam::DVec3;

use super::super::coat::WIDTHS;
use super::super::linear::{self, MOST_UNKNOWNS};
use super::super::model::Model;
use super::super::quadratic::{self, Inequality};
use super::columns::Gram;
use super::data::Data;
use super::extended;
use super::layout::{CHANNELS, Extension, Family, LINEAR, Layout, MOST_LOBES, UNKNOWNS, WIDTH};
use super::normal::{self, Amplitudes, Most, Normal, Pressing};
use super::shape;
use lobelia_reflectance::albedo::{self, INCIDENCES_DEG};
use lobelia_reflectance::{LobeBrdf, Microfacet, Rgb};

/// Azimuths of the incidences in quarter turns: of isotropic lobes, of anisotropic ones against their axes,
/// of lobes about a normal of their own.
const ISOTROPIC: [f64; 1] = [0.0];
const ANISOTROPIC: [f64; 3] = [0.0, 0.5, 1.0];
const TILTED: [f64; 8] = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5];
/// Step of differences in the shapes' unknowns.
const STEP: f64 = 1e-4;
/// A column of squares below this share of the largest has no amplitude.
const UNSEEN: f64 = 1e-14;
/// What the diagonal is raised by, of 1.
const RIDGE: f64 = 1e-11;
/// Widths of the table of microfacet terms.
const COAT_WIDTHS: usize = 40;

/// Directional albedos of a model's terms.
#[derive(Debug, Clone, Default)]
pub struct Albedos {
    /// For every incidence that of ρ_d and of each term at an amplitude of 1.
    rows: Vec<[f64; LINEAR]>,
}

/// The incidences of a model, in the lobes' frame unless they are tilted.
fn incidences(model: &Model) -> impl Iterator<Item = DVec3> + Clone {
    let turns: &[f64] = if model.normal.is_some() {
        &TILTED
    } else if model.lobes.iter().all(|lobe| lobe.c.x == lobe.c.y) {
        &ISOTROPIC
    } else {
        &ANISOTROPIC
    };
    turns.iter().flat_map(|turn| {
        let (y, x) = (turn * std::f64::consts::FRAC_PI_2).sin_cos();
        DIRECTIONS.iter().map(move |[sin, cos]| DVec3::new(sin * x, sin * y, *cos))
    })
}

/// Sines and cosines of [`INCIDENCES_DEG`].
static DIRECTIONS: LazyLock<[[f64; 2]; INCIDENCES_DEG.len()]> =
    LazyLock::new(|| INCIDENCES_DEG.map(|degrees| degrees.to_radians().sin_cos().into()));

impl Albedos {
    /// Those of a model of a family.
    pub fn set(&mut self, family: Family, model: &Model) {
        let frame = Frame::new(family, model);
        self.rows.clear();
        self.rows.extend(incidences(model).enumerate().map(|(place, wi)| frame.row(model, place, wi)));
    }

    /// How many incidences there are.
    fn len(&self) -> usize {
        self.rows.len()
    }
}

/// The lobes' frame.
struct Frame {
    /// From the sample's frame; none where that is of no account.
    turn: Option<glam::DMat3>,
    normal: DVec3,
}

impl Frame {
    fn new(family: Family, model: &Model) -> Self {
        let Some(normal) = model.normal else { return Self { turn: None, normal: DVec3::Z } };
        let beta = if family == Family::Anisotropic { model.beta } else { 0.0 };
        let turn = glam::DMat3::from_rotation_z(-beta) * extended::turn_to(normal).transpose();
        Self { normal: turn * DVec3::Z, turn: Some(turn) }
    }

    /// Albedos of ρ_d and the terms at an amplitude of 1.
    fn row(&self, model: &Model, place: usize, wi: DVec3) -> [f64; LINEAR] {
        let mut row = [0.0; LINEAR];
        row[0] = std::f64::consts::PI;
        let local = self.turn.map_or(wi, |turn| turn * wi);
        for (entry, lobe) in row[1..].iter_mut().zip(&model.lobes) {
            let exponents = [lobe.n, lobe.n_grazing.unwrap_or(lobe.n)];
            *entry = albedo::lobe_on(lobe.c / lobe.reference, exponents, local, self.normal);
        }
        if let Some(coat) = model.coat {
            let of = coat_albedos(coat.alpha, place % INCIDENCES_DEG.len());
            row[1 + model.lobes.len()..3 + model.lobes.len()].copy_from_slice(&of);
        }
        row
    }
}

/// Directional albedos of a microfacet term by width and incidence: of f0 = 1 alone and of f90 = 1 alone.
static COATS: LazyLock<Vec<[[f64; 2]; INCIDENCES_DEG.len()]>> = LazyLock::new(|| {
    let [low, high] = WIDTHS.map(f64::ln);
    let of = |f0: f32, f90: f32, alpha: f64, [sin, cos]: [f64; 2]| {
        let coat = Microfacet { f0: Rgb::splat(f0), f90: Rgb::splat(f90), alpha: alpha as f32 };
        let brdf = LobeBrdf { microfacets: vec![coat], ..LobeBrdf::default() };
        f64::from(albedo::directional(&brdf, DVec3::new(sin, 0.0, cos).as_vec3()).x)
    };
    (0..COAT_WIDTHS)
        .map(|k| (low + (high - low) * k as f64 / (COAT_WIDTHS - 1) as f64).exp())
        .map(|alpha| {
            DIRECTIONS.map(|direction| [of(1.0, 0.0, alpha, direction), of(0.0, 1.0, alpha, direction)])
        })
        .collect()
});

fn coat_albedos(alpha: f64, incidence: usize) -> [f64; 2] {
    let [low, high] = WIDTHS.map(f64::ln);
    let place = (alpha.ln() - low) / (high - low) * (COAT_WIDTHS - 1) as f64;
    let i = (place.max(0.0) as usize).min(COAT_WIDTHS - 2);
    let t = place - i as f64;
    [0, 1].map(|k| COATS[i][incidence][k] * (1.0 - t) + COATS[i + 1][incidence][k] * t)
}

/// What directional albedos are held to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bound {
    /// Largest albedo.
    pub albedo: f64,
    /// Albedo of a ρ_d that is no unknown, for the channels that are fitted together.
    pub fixed: [f64; CHANNELS],
}

/// What amplitudes are held to.
#[derive(Debug, Clone, Copy)]
pub struct Caps {
    /// Of the albedos.
    pub bound: Bound,
    /// Largest amplitudes.
    pub most: Most,
    /// Scale of the channels' amplitudes.
    pub scale: [f64; CHANNELS],
}

/// Whether a model of plain lobes keeps the limit for sure: |p|ⁿ 2π / (n + 1), with p = C ω_i at its longest,
/// is more than a lobe's albedo anywhere.
fn surely_kept(layout: Layout, model: &Model, at: &Amplitudes, caps: &Caps) -> bool {
    let Extension { sharpening, coat, .. } = layout.extension;
    if sharpening || coat {
        return false;
    }
    let most = model.lobes.iter().map(|lobe| {
        let longest = lobe.c.abs().max_element() / lobe.reference;
        (lobe.n * longest.ln()).min(100.0).exp() * std::f64::consts::TAU / (lobe.n + 1.0)
    });
    let most: [f64; MOST_LOBES] = {
        let mut list = [0.0; MOST_LOBES];
        list.iter_mut().zip(most).for_each(|(place, most)| *place = most);
        list
    };
    (0..layout.channels).all(|channel| {
        let x = &at.x[channel];
        let lobes: f64 = x[1..=layout.lobes].iter().zip(most).map(|(x, most)| x * most).sum();
        (std::f64::consts::PI * x[0] + lobes) / caps.scale[channel] <= room(caps, channel)
    })
}

/// The largest albedo of a model in any channel, over its limit: above 1 where the bound is broken. The
/// albedos are set where that is not plain to see.
pub fn excess(albedos: &mut Albedos, layout: Layout, model: &Model, at: &Amplitudes, caps: &Caps) -> f64 {
    if surely_kept(layout, model, at, caps) {
        return 0.0;
    }
    albedos.set(layout.family, model);
    (0..layout.channels).map(|channel| excess_of(albedos, layout, at, caps, channel)).fold(0.0, f64::max)
}

fn excess_of(albedos: &Albedos, layout: Layout, at: &Amplitudes, caps: &Caps, channel: usize) -> f64 {
    let x = &at.x[channel][..=layout.terms()];
    let of = |row: &[f64; LINEAR]| row.iter().zip(x).map(|(a, x)| a * x).sum::<f64>();
    let largest = albedos.rows.iter().map(of).fold(0.0, f64::max) / caps.scale[channel];
    largest / room(caps, channel)
}

/// What the unknown amplitudes may reflect of the light.
fn room(caps: &Caps, channel: usize) -> f64 {
    (caps.bound.albedo - caps.bound.fixed[channel]).max(1e-6)
}

/// Holds the amplitudes of a model in every channel that breaks the limit to it.
pub fn hold(
    albedos: &mut Albedos,
    at: &mut Amplitudes,
    gram: &Gram,
    layout: Layout,
    model: &Model,
    caps: &Caps,
) {
    if excess(albedos, layout, model, at, caps) <= 1.0 {
        return;
    }
    for channel in 0..layout.channels {
        if excess_of(albedos, layout, at, caps, channel) > 1.0 {
            hold_channel(albedos, at, gram, layout, caps, channel);
        }
    }
}

fn hold_channel(
    albedos: &Albedos,
    at: &mut Amplitudes,
    gram: &Gram,
    layout: Layout,
    caps: &Caps,
    channel: usize,
) {
    let first = usize::from(!layout.diffuse);
    let column = |unknown: usize| layout.column(unknown);
    let square = |unknown: usize| gram[column(unknown) * (WIDTH + 1)];
    let largest = (first..=layout.terms()).map(square).fold(0.0, f64::max);
    let mut members = [0; MOST_UNKNOWNS];
    let mut count = 0;
    for unknown in (first..=layout.terms()).filter(|&unknown| square(unknown) > UNSEEN * largest) {
        members[count] = unknown;
        count += 1;
    }
    let members = &members[..count];
    let root = |i: usize| square(members[i]).sqrt();
    let goal = 1 + channel;
    let (mut hessian, mut rhs) = ([0.0; MOST_UNKNOWNS * MOST_UNKNOWNS], [0.0; MOST_UNKNOWNS]);
    for (i, &a) in members.iter().enumerate() {
        rhs[i] = gram[column(a) * WIDTH + goal] / root(i);
        for (j, &b) in members.iter().enumerate() {
            hessian[i * count + j] = gram[column(a) * WIDTH + column(b)] / (root(i) * root(j));
        }
        hessian[i * count + i] += RIDGE;
    }
    let mut inequalities = Vec::with_capacity(albedos.len() + 2 * count);
    for row in &albedos.rows {
        let mut scaled = [0.0; MOST_UNKNOWNS];
        for (i, &unknown) in members.iter().enumerate() {
            scaled[i] = row[unknown] / (caps.scale[channel] * root(i) * room(caps, channel));
        }
        inequalities.push(Inequality { row: scaled, most: 1.0 });
    }
    let single = |i: usize, value: f64| std::array::from_fn(|k| if k == i { value } else { 0.0 });
    for (i, &unknown) in members.iter().enumerate() {
        inequalities.push(Inequality { row: single(i, -1.0), most: 0.0 });
        let cap = caps.most.of(layout, unknown, channel);
        if cap.is_finite() && cap > 0.0 {
            inequalities.push(Inequality { row: single(i, 1.0 / (cap * root(i))), most: 1.0 });
        }
    }
    let was = cost(at, gram, layout, channel);
    if !was.is_finite() {
        return;
    }
    at.x[channel] = [0.0; LINEAR];
    at.free[channel] = [false; LINEAR];
    if let Some(found) = quadratic::minimise(&hessian[..count * count], &rhs[..count], &inequalities) {
        for (i, &unknown) in members.iter().enumerate() {
            at.x[channel][unknown] = found.x[i].max(0.0) / root(i);
            at.free[channel][unknown] = true;
        }
        let pressing = &mut at.pressing[channel];
        for (place, _) in found.pressing() {
            if place < albedos.len() {
                pressing.places[pressing.count] = place as u8;
                pressing.count += 1;
            } else if let Some(i) = (0..count).find(|&i| inequalities[place].row[i] != 0.0) {
                at.free[channel][members[i]] = false;
                if inequalities[place].row[i] < 0.0 {
                    at.x[channel][members[i]] = 0.0;
                }
            }
        }
    }
    at.cost += cost(at, gram, layout, channel) - was;
}

/// The squared residuals of a channel.
fn cost(at: &Amplitudes, gram: &Gram, layout: Layout, channel: usize) -> f64 {
    let (x, goal) = (&at.x[channel], 1 + channel);
    let mut cost = gram[goal * (WIDTH + 1)];
    for i in 0..=layout.terms() {
        let product: f64 =
            (0..=layout.terms()).map(|j| gram[layout.column(i) * WIDTH + layout.column(j)] * x[j]).sum();
        cost += x[i] * (product - 2.0 * gram[layout.column(i) * WIDTH + goal]);
    }
    normal::squares(cost)
}

/// The normal equations of the shapes where amplitudes press against the limit: they move along it as the
/// shapes change.
pub fn normal(gram: &Gram, layout: Layout, model: &Model, at: &Amplitudes, data: &Data) -> Normal {
    // Channels at the limit have no part in the plain equations.
    let mut plain = *at;
    for channel in (0..layout.channels).filter(|&channel| !at.pressing[channel].is_empty()) {
        plain.x[channel] = [0.0; LINEAR];
    }
    let mut normal = normal::normal(gram, layout, &plain);
    let slopes = slopes(layout, model, at, data.cone);
    for channel in (0..layout.channels).filter(|&channel| !at.pressing[channel].is_empty()) {
        let pressing = at.pressing[channel].places();
        let pressed: Vec<(&Slope, f64)> = (slopes.iter().filter(|slope| pressing.contains(&slope.place)))
            .map(|slope| (slope, data.scale[channel]))
            .collect();
        add_pressing(&mut normal, gram, layout, at, channel, &pressed);
    }
    normal
}

/// An albedo that presses in some channel.
struct Slope {
    place: u8,
    /// That of the terms.
    row: [f64; LINEAR],
    /// Their derivatives by each of the shapes' unknowns.
    by_shape: Vec<[f64; LINEAR]>,
}

/// The albedos that press in any channel, with their derivatives by differences.
fn slopes(layout: Layout, model: &Model, at: &Amplitudes, cone: [f64; 2]) -> Vec<Slope> {
    let mut places: Vec<u8> = at.pressing.iter().flat_map(Pressing::places).copied().collect();
    places.sort_unstable();
    places.dedup();
    let directions: Vec<DVec3> = incidences(model).collect();
    let rows = |model: &Model| -> Vec<[f64; LINEAR]> {
        let frame = Frame::new(layout.family, model);
        let row = |&place: &u8| frame.row(model, place.into(), directions[usize::from(place)]);
        places.iter().map(row).collect()
    };
    let moved = |unknown: usize, by: f64| {
        let mut step = [0.0; UNKNOWNS];
        step[unknown] = by;
        let mut moved = model.clone();
        shape::advance(layout.family, &mut moved, &step);
        // Of a lobe that sharpens the reference is part of the shape.
        for lobe in moved.lobes.iter_mut().filter(|lobe| lobe.n_grazing.is_some()) {
            *lobe = lobe.within(cone);
        }
        rows(&moved)
    };
    let of = |(&place, row): (&u8, [f64; LINEAR])| Slope { place, row, by_shape: Vec::new() };
    let mut slopes: Vec<Slope> = places.iter().zip(rows(model)).map(of).collect();
    for unknown in 0..layout.size() {
        let (ahead, behind) = (moved(unknown, STEP), moved(unknown, -STEP));
        for (slope, (ahead, behind)) in slopes.iter_mut().zip(ahead.iter().zip(&behind)) {
            slope.by_shape.push(std::array::from_fn(|term| (ahead[term] - behind[term]) / (2.0 * STEP)));
        }
    }
    slopes
}

/// Adds a channel at the limit. With D the derivatives of the shapes' sum by the unknowns and M those of the
/// free amplitudes, its Jacobian is J = D + Φ M, where Φᵀ(D + Φ M) + Gᵀ μ = 0 and G M = −∂G x for the albedos
/// G that press.
fn add_pressing(
    normal: &mut Normal,
    gram: &Gram,
    layout: Layout,
    at: &Amplitudes,
    channel: usize,
    pressed: &[(&Slope, f64)],
) {
    let (x, goal) = (&at.x[channel], 1 + channel);
    // Every unknown's column of J as columns with weights, first D.
    let mut columns: Vec<Vec<(usize, f64)>> = vec![Vec::new(); normal.size];
    for (term, column) in layout.each_derivative().filter(|&(term, _)| x[1 + term] != 0.0) {
        columns[layout.unknown(term, column)].push((layout.derivative(term, column), x[1 + term]));
    }
    let with = |column: usize, list: &[(usize, f64)]| -> f64 {
        list.iter().map(|&(other, weight)| weight * gram[column * WIDTH + other]).sum()
    };
    let free: Vec<usize> = (0..=layout.terms()).filter(|&unknown| at.free[channel][unknown]).collect();
    let (count, size) = (free.len(), free.len() + pressed.len());
    let mut system = vec![0.0; size * size];
    for (i, &a) in free.iter().enumerate() {
        for (j, &b) in free.iter().enumerate() {
            system[i * size + j] = gram[layout.column(a) * WIDTH + layout.column(b)];
        }
        for (k, (slope, scale)) in pressed.iter().enumerate() {
            system[i * size + count + k] = slope.row[a] / scale;
            system[(count + k) * size + i] = slope.row[a] / scale;
        }
    }
    for (unknown, list) in columns.iter_mut().enumerate() {
        let mut response: Vec<f64> = free.iter().map(|&a| -with(layout.column(a), list)).collect();
        for (slope, scale) in pressed {
            let turned: f64 = slope.by_shape[unknown].iter().zip(x).map(|(by, x)| by * x).sum();
            response.push(-turned / scale);
        }
        if linear::solve(&mut system.clone(), &mut response) {
            list.extend(free.iter().zip(response).map(|(&a, moved)| (layout.column(a), moved)));
        }
    }
    for s in 0..normal.size {
        for &(column, weight) in &columns[s] {
            let value: f64 =
                (0..=layout.terms()).map(|u| gram[column * WIDTH + layout.column(u)] * x[u]).sum();
            normal.gradient[s] += weight * (value - gram[column * WIDTH + goal]);
        }
        for t in 0..normal.size {
            let product: f64 =
                columns[s].iter().map(|&(column, weight)| weight * with(column, &columns[t])).sum();
            normal.matrix[s * normal.size + t] += product;
        }
    }
}
