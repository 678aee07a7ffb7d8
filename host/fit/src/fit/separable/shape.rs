//! The unknowns of the shapes: which there are, how a lobe's base depends on them, and how a step changes a
//! model.

use glam::DVec3;

use super::super::lm::tangents;
use super::super::model::{EXPONENTS, Model, ModelLobe, isotropic_c};
use super::extended;
use super::form::Form;
use super::layout::{Family, Layout};

/// The base of an isotropic lobe in (plane, zz).
pub fn isotropic_form(lobe: &ModelLobe) -> Form<2, 1> {
    let [tangent, _] = tangents(lobe.c, true);
    let scaled = |v: DVec3| [v.x / lobe.reference, v.z / lobe.reference];
    Form { base: scaled(lobe.c), tangents: [scaled(tangent)], n: lobe.n }
}

/// The base of a lobe in (xx, yy, zz, xy) with the two tangents of C and β.
pub fn anisotropic_form(lobe: &ModelLobe, beta: f64) -> Form<4, 3> {
    let (sin, cos) = beta.sin_cos();
    let (cos2, sin2, cross) = (cos * cos, sin * sin, sin * cos);
    let scaled = |v: DVec3| {
        [cos2 * v.x + sin2 * v.y, sin2 * v.x + cos2 * v.y, v.z, cross * (v.x - v.y)]
            .map(|x| x / lobe.reference)
    };
    let [u, v] = tangents(lobe.c, false);
    let spread = (lobe.c.x - lobe.c.y) / lobe.reference;
    let turning = [-2.0 * cross, 2.0 * cross, 0.0, cos2 - sin2].map(|x| x * spread);
    Form { base: scaled(lobe.c), tangents: [scaled(u), scaled(v), turning], n: lobe.n }
}

/// The base of an isotropic lobe in (xx, yy, zz, xy) with its angle and the two entries that make C
/// anisotropic.
pub fn split_form(lobe: &ModelLobe) -> Form<4, 3> {
    let [u, _] = tangents(lobe.c, true);
    let scaled = |v: DVec3| [v.x, v.y, v.z, 0.0].map(|x| x / lobe.reference);
    let entries = [[1.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]].map(|e| e.map(|x| x / lobe.reference));
    Form { base: scaled(lobe.c), tangents: [scaled(u), entries[0], entries[1]], n: lobe.n }
}

/// Takes a step from `model`; steps too long to trust the linear model over are cut.
pub fn advance(family: Family, model: &mut Model, step: &[f64]) {
    let lobes = model.lobes.len();
    extended::advance(Layout::of(family, model), model, step);
    if family == Family::Anisotropic && lobes > 0 {
        model.beta += step[3 * lobes].clamp(-0.3, 0.3);
    }
    for (index, lobe) in model.lobes.iter_mut().enumerate() {
        let at = |column| step[family.unknown(index, column, lobes)];
        lobe.n = (lobe.n * at(0).clamp(-1.5, 1.5).exp()).clamp(EXPONENTS[0], EXPONENTS[1]);
        let isotropic = family != Family::Anisotropic;
        let [u, v] = tangents(lobe.c, isotropic);
        let turn = if isotropic { u * at(1) } else { u * at(1) + v * at(2) };
        lobe.c = (lobe.c + turn.clamp_length_max(0.7)).normalize();
        if isotropic {
            // Exactly on the circle.
            lobe.c = isotropic_c((lobe.c.x * std::f64::consts::SQRT_2).atan2(lobe.c.z));
        }
    }
}
