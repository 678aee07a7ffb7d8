//! Models beyond lobes of one exponent about the surface's normal (section 7): lobes about a normal of the
//! texel's own, lobes that sharpen toward grazing (6.19), a GGX microfacet term. Their columns, for the same
//! solver.
//!
//! About a normal N the base is ω_iᵀ R C' Rᵀ ω_o, with R the shortest turn from z to N: linear in the six
//! products of a symmetric matrix. A microfacet term counts as two terms beside the lobes, f0 and f90, with α
//! as the one shape unknown of both.

use glam::{DMat3, DVec2, DVec3};

use super::super::coat::{self, WIDTHS};
use super::super::lm::tangents;
use super::super::model::{EXPONENTS, Model};
use super::form::{NEGLIGIBLE, linear_form};
use super::layout::{Family, Layout};
use super::math::{self, LANES};

/// Derivatives of a lobe's base at most: those of a family, and two of the normal.
const TANGENTS: usize = 5;
/// The normal stays within 30° of the surface's.
pub const MOST_TILT: f64 = 0.5;

/// A lobe's base as a linear form in xx, yy, zz, xy, xz and yz, and its derivatives by the shape's unknowns.
#[derive(Debug, Clone, Copy)]
pub struct Form {
    base: [f64; 6],
    tangents: [[f64; 6]; TANGENTS],
    /// Tangents that there are.
    count: usize,
    n: f64,
    n_grazing: Option<f64>,
}

/// The turn from z to a normal and its derivatives by the normal's x and y.
fn tilt(normal: DVec2) -> (DMat3, [DMat3; 2]) {
    let z = (1.0 - normal.length_squared()).sqrt();
    let share = 1.0 / (1.0 + z);
    let at = normal.extend(z);
    let turn = DMat3::from_cols(
        DVec3::new(1.0 - normal.x * normal.x * share, -normal.x * normal.y * share, -normal.x),
        DVec3::new(-normal.x * normal.y * share, 1.0 - normal.y * normal.y * share, -normal.y),
        at,
    );
    let slopes = [0, 1].map(|axis| {
        // d(1 / (1 + z)) and dz by the axis.
        let (by_share, by_z) = (share * share * normal[axis] / z, -normal[axis] / z);
        let entry = |i: usize, j: usize| {
            let moved =
                f64::from(u8::from(i == axis)) * normal[j] + f64::from(u8::from(j == axis)) * normal[i];
            -(moved * share + normal[i] * normal[j] * by_share)
        };
        let unit = |i: usize| f64::from(u8::from(i == axis));
        DMat3::from_cols(
            DVec3::new(entry(0, 0), entry(1, 0), -unit(0)),
            DVec3::new(entry(0, 1), entry(1, 1), -unit(1)),
            DVec3::new(unit(0), unit(1), by_z),
        )
    });
    (turn, slopes)
}

/// The turn from z to a normal.
pub(super) fn turn_to(normal: DVec2) -> DMat3 {
    tilt(normal).0
}

/// The coefficients of a symmetric matrix in the six products.
fn coefficients(m: DMat3) -> [f64; 6] {
    [m.x_axis.x, m.y_axis.y, m.z_axis.z, m.y_axis.x, m.z_axis.x, m.z_axis.y]
}

/// diag(v) turned about z by β, and its derivative by β.
fn turned(v: DVec3, beta: f64) -> [DMat3; 2] {
    let (sin, cos) = beta.sin_cos();
    let (mean, half) = (0.5 * (v.x + v.y), 0.5 * (v.x - v.y));
    let (cos2, sin2) = (cos * cos - sin * sin, 2.0 * sin * cos);
    let of = |along: f64, across: f64, mean: f64, z: f64| {
        DMat3::from_cols_array(&[mean + along, across, 0.0, across, mean - along, 0.0, 0.0, 0.0, z])
    };
    [of(half * cos2, half * sin2, mean, v.z), of(-2.0 * half * sin2, 2.0 * half * cos2, 0.0, 0.0)]
}

/// The form of a lobe of a model.
pub fn form(model: &Model, index: usize, family: Family, cone: [f64; 2]) -> Form {
    let lobe = &model.lobes[index];
    let beta = if family == Family::Anisotropic { model.beta } else { 0.0 };
    let (turn, slopes) = tilt(model.normal.unwrap_or_default());
    let scaled = |m: DMat3| coefficients(turn * m * turn.transpose()).map(|x| x / lobe.reference);
    let [plain, by_beta] = turned(lobe.c, beta);
    let base = scaled(plain);
    // Of a lobe that sharpens the reference is part of the shape, not of the amplitude.
    let along = |tangent: DVec3| {
        let shift = lobe.n_grazing.map_or(0.0, |_| lobe.reference_slope(tangent, cone));
        let [moved, _] = turned(tangent, beta);
        let mut moved = scaled(moved);
        moved.iter_mut().zip(base).for_each(|(moved, base)| *moved -= shift * base);
        moved
    };
    let mut form =
        Form { base, tangents: [[0.0; 6]; TANGENTS], count: 0, n: lobe.n, n_grazing: lobe.n_grazing };
    let mut push = |tangent| {
        form.tangents[form.count] = tangent;
        form.count += 1;
    };
    let [u, v] = tangents(lobe.c, family != Family::Anisotropic);
    push(along(u));
    match family {
        Family::Isotropic => {}
        Family::Anisotropic => {
            push(along(v));
            push(scaled(by_beta));
        }
        Family::Split => {
            push(scaled(DMat3::from_diagonal(DVec3::new(1.0, -1.0, 0.0))));
            push(scaled(DMat3::from_cols_array(&[0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])));
        }
    }
    if model.normal.is_some() {
        for slope in slopes {
            let half = slope * plain * turn.transpose();
            push(coefficients(half + half.transpose()).map(|x| x / lobe.reference));
        }
    }
    form
}

/// Writes a lobe's columns: shape, derivative by ln n, those along the tangents, and that by ln n₀ where it
/// sharpens. `slope` is scratch of the same length.
#[inline(always)]
pub fn fill_lobe(
    form: &Form,
    products: [&[f64]; 6],
    cosines: [&[f64]; 2],
    root: &[f64],
    slope: &mut [f64],
    columns: &mut [f64],
) {
    let count = root.len();
    let (shape, rest) = columns.split_at_mut(count);
    let (by_n, rest) = rest.split_at_mut(count);
    let (along, by_grazing) = rest.split_at_mut(form.count * count);
    linear_form(&form.base, products, shape);
    let sharpens = form.n_grazing.is_some();
    let grazing = form.n_grazing.unwrap_or(0.0);
    for start in (0..count).step_by(LANES) {
        let (mut values, mut derivatives, mut slopes) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
        let mut others = [0.0; LANES];
        for lane in 0..LANES {
            let k = start + lane;
            let t = if sharpens { 0.5 * (cosines[0][k] + cosines[1][k]) } else { 1.0 };
            // See `columns::lobe`.
            let safe = if shape[k] > 1e-300 { shape[k] } else { 1e-300 };
            let (log, n) = (math::ln(safe), form.n * t + grazing * (1.0 - t));
            let power = n * log;
            let enough = power > NEGLIGIBLE && power < -NEGLIGIBLE;
            let power = if enough { power } else { NEGLIGIBLE };
            let seen = u64::from(enough).wrapping_neg();
            let value = f64::from_bits((root[k] * math::exp(power)).to_bits() & seen);
            values[lane] = value;
            derivatives[lane] = value * log * form.n * t;
            others[lane] = value * log * grazing * (1.0 - t);
            slopes[lane] = value * n / safe;
        }
        shape[start..start + LANES].copy_from_slice(&values);
        by_n[start..start + LANES].copy_from_slice(&derivatives);
        slope[start..start + LANES].copy_from_slice(&slopes);
        if sharpens {
            by_grazing[start..start + LANES].copy_from_slice(&others);
        }
    }
    for (tangent, column) in form.tangents.iter().zip(along.chunks_exact_mut(count.max(1))) {
        linear_form(tangent, products, column);
        for (along, slope) in column.iter_mut().zip(slope.iter()) {
            *along *= slope;
        }
    }
}

/// Writes a microfacet term's columns: of f0 the shape and its derivative by ln α, then of f90.
#[inline(always)]
pub fn fill_coat(
    alpha: f64,
    [plane, zz]: [&[f64]; 2],
    cosines: [&[f64]; 2],
    root: &[f64],
    columns: &mut [f64],
) {
    let count = root.len();
    for k in 0..count {
        let seen = root[k] > 0.0;
        // What is not seen has a place above the texel.
        let at = if seen { [cosines[0][k], cosines[1][k], plane[k] + zz[k]] } else { [1.0; 3] };
        let (weight, shape, slope) = coat::parts(alpha, at);
        let value = root[k] * shape;
        columns[k] = value * (1.0 - weight);
        columns[count + k] = value * (1.0 - weight) * slope;
        columns[2 * count + k] = value * weight;
        columns[3 * count + k] = value * weight * slope;
    }
}

/// Takes a step's part that goes beyond plain lobes.
pub fn advance(layout: Layout, model: &mut Model, step: &[f64]) {
    let own = layout.family.derivatives();
    if layout.extension.normals
        && let Some(normal) = &mut model.normal
    {
        let at = |axis| step[layout.unknown(0, own + axis)];
        let moved = *normal + DVec2::new(at(0), at(1)).clamp_length_max(0.15);
        *normal = moved.clamp_length_max(MOST_TILT);
    }
    for (index, lobe) in model.lobes.iter_mut().enumerate() {
        if let Some(grazing) = &mut lobe.n_grazing {
            let factor = step[layout.unknown(index, layout.derivatives(index) - 1)].clamp(-1.5, 1.5).exp();
            *grazing = (*grazing * factor).clamp(EXPONENTS[0], EXPONENTS[1]);
        }
    }
    if let Some(coat) = &mut model.coat {
        let factor = step[layout.unknown(layout.lobes, 0)].clamp(-1.0, 1.0).exp();
        coat.alpha = (coat.alpha * factor).clamp(WIDTHS[0], WIDTHS[1]);
    }
}
